"""How probable a cause is that looks like a listed one: the signs of strain, and their weights."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("dolfinx")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.blind.calibrate import Sample, calibrate, leader_strain, log_loss  # noqa: E402
from fenics_joints.diagnosis.unlisted import WEIGHTS, look_alike, strain  # noqa: E402


def leader(p_value=0.5, z=(0.3, -1.2, 2.5), own=(2,), n_effects=1):
    hypothesis = SimpleNamespace(own_columns=list(own), effects=(None,) * n_effects)
    return SimpleNamespace(p_value=p_value, z=np.array(z), hypothesis=hypothesis)


def test_an_effect_may_be_large_but_what_is_free_in_any_case_may_not():
    far = leader(z=(0.3, -1.2, 4.5))
    assert look_alike(far) == look_alike(leader()) < 0.2
    strained = look_alike(leader(z=(0.3, -3.0, 2.5)))
    assert strained > look_alike(leader()) and look_alike(leader(p_value=1e-6)) > 0.5
    assert look_alike(leader(n_effects=2)) > look_alike(leader())
    odds = strained / (1 - strained)
    by_hand = WEIGHTS[0] + WEIGHTS[1] * np.log(2) + WEIGHTS[2] * 3.0 + WEIGHTS[3]
    assert np.log(odds) == pytest.approx(by_hand)


def test_nothing_counts_without_bound():
    assert strain(0.0, np.array([50.0, -80.0]), 1) == pytest.approx([1, 10, 4, 1])
    assert strain(1.0, np.array([]), 0) == pytest.approx([1, 0, 0, 0])


def test_weights_are_found_again():
    """Cases drawn with known weights: recovered within their scatter, and better than the rate."""
    random, truth = np.random.default_rng(1), np.array([-2.0, 0.3, 0.6, 0.4])
    rows = [
        strain(random.uniform() ** 3, random.normal(size=6), int(random.integers(3)))
        for _ in range(6000)
    ]
    outside = random.uniform(size=6000) < 1 / (1 + np.exp(-np.array(rows) @ truth))
    samples = [Sample("a", row, bool(o)) for row, o in zip(rows, outside, strict=True)]
    found = calibrate(samples)
    assert found == pytest.approx(truth, abs=0.15)
    rate = np.array([np.log(outside.mean() / (1 - outside.mean())), 0, 0, 0])
    assert log_loss(samples, found) < log_loss(samples, rate)


def test_the_signs_are_read_from_what_a_diagnosis_writes():
    rows = [
        {"nuisance": True, "prior_sigmas": -2.0},
        {"nuisance": False, "prior_sigmas": 3.5},
    ]
    said = {
        "hypotheses": [
            {"label": "none of these", "probability": 0.7, "p_value": 1.0, "effects": [],
             "parameters": []},
            {"label": "a + b", "probability": 0.2, "p_value": 0.1, "effects": ["a", "b"],
             "parameters": rows},
            {"label": "no gap", "probability": 0.1, "p_value": 0.01, "effects": [],
             "parameters": rows[:1]},
        ]
    }  # fmt: skip
    assert leader_strain(said) == pytest.approx([1, -np.log(0.1), 2, 2])
