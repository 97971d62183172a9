"""What is left for a cause that looks like a listed one, and where that number is from."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from benchmarks.blind.calibrate import (  # noqa: E402
    Sample,
    calibrate,
    leader_misfit,
    log_loss,
    named_right,
    read_samples,
)
from fenics_joints.diagnosis.evidence.unlisted import (  # noqa: E402
    WEIGHTS,
    WRONG,
    after_held_out,
    look_alike,
    misfit_in_nats,
)


def test_the_worse_the_fit_the_more_is_left():
    p = np.array([1.0, 0.5, 0.05, 1e-3, 1e-9, 0.0])
    left = np.array([look_alike(x) for x in p])
    assert np.all(np.diff(left[:-1]) > 0) and left[-1] == left[-2]
    odds = np.log(left / (1 - left))
    nats = np.array([0, np.log(2), np.log(20), np.log(1000), 10, 10])
    assert odds == pytest.approx(WEIGHTS[0] + WEIGHTS[1] * nats)


def test_weights_are_found_again():
    """Cases drawn with known weights: recovered within their scatter, and better than the rate."""
    random, truth = np.random.default_rng(1), np.array([-2.0, 0.4])
    misfit = np.array([misfit_in_nats(random.uniform() ** 3) for _ in range(6000)])
    outside = random.uniform(size=6000) < 1 / (1 + np.exp(-truth[0] - truth[1] * misfit))
    samples = [Sample("a", m, bool(o)) for m, o in zip(misfit, outside, strict=True)]
    found = calibrate(samples)
    assert found == pytest.approx(truth, abs=0.15)
    rate = np.array([np.log(outside.mean() / (1 - outside.mean())), 0])
    assert log_loss(samples, found) < log_loss(samples, rate)


def test_read_from_what_a_diagnosis_writes(tmp_path):
    """The unknown does not lead; cases kept for scoring and failed ones do not count."""
    said = {
        "hypotheses": [
            {"label": "none of these", "probability": 0.7, "p_value": 1.0},
            {"label": "a + b", "probability": 0.2, "p_value": 0.1},
            {"label": "no gap", "probability": 0.1, "p_value": 0.01},
        ]
    }
    assert leader_misfit(said) == pytest.approx(np.log(10))
    kept = {"geometry": "g", "kind": "unknown", "final_only": False}
    answers = {"a": kept, "b": kept | {"final_only": True}, "c": kept, "d": kept | {"kind": "pair"}}
    (tmp_path / "diagnoses").mkdir()
    (tmp_path / "answers.json").write_text(json.dumps({"answers": answers}))
    for name in answers:
        text = {"error": "stopped"} if name == "c" else {"diagnosis": said}
        (tmp_path / "diagnoses" / f"{name}.json").write_text(json.dumps(text))
    assert [s.outside for s in read_samples([tmp_path])] == [True, False]


def test_held_out_data_replace_the_fits_own_misfit():
    """Odds among the listed stay; what is left for the unknown is as often as named causes err."""
    p, unknown = 0.3, np.array([False, True, False])
    listed, other = np.array([6.0, 0.0, 1.0]), 1e-9
    for confirmed in (True, False):
        raw = np.where(unknown, other, listed) / (listed.sum() + other)
        before = raw * (1 - look_alike(p))
        before[1] += 1 - before.sum()
        found = after_held_out(before, unknown, p, confirmed)
        assert found.sum() == pytest.approx(1)
        assert found[0] / found[2] == pytest.approx(6)
        assert found[1] == pytest.approx(WRONG[confirmed], abs=1e-6)


def test_how_often_what_was_named_was_right(tmp_path):
    """Of four cases that name the same cause it is at work in two, one of these confirmed."""
    name = "compliance at one bolt"
    said = {
        "effects": [{"name": name, "region": "joint", "class": name, "probability": 0.8}],
        "hypotheses": [{"label": name, "effects": [f"{name} (joint)"], "probability": 0.8}],
    }
    (tmp_path / "diagnoses").mkdir()
    answers, digests = {}, {}
    for name, verdict, kind in (
        ("a", "cause", "single"), ("b", "likely", "single"), ("c", "cause", "unknown"),
        ("d", "likely", "none"), ("e", "ambiguous", "single"),
    ):  # fmt: skip
        effect = {"name": "loose_bolt", "region": "joint", "params": {}}
        effects = [effect] if kind == "single" else []
        answers[name] = {"geometry": "t_tubes", "kind": kind, "final_only": False,
                         "effects": effects, "noise": [0.0, 0.0]}  # fmt: skip
        text = json.dumps({"diagnosis": {**said, "verdict": verdict}})
        (tmp_path / "diagnoses" / f"{name}.json").write_text(text)
        digests[name] = hashlib.sha256(text.encode()).hexdigest()
    opened = {"answers": answers, "diagnoses_sha256": digests}
    (tmp_path / "answers.json").write_text(json.dumps(opened))
    assert named_right([tmp_path]) == {"cause": (1, 2), "likely": (1, 2)}
