"""What is left for a cause that looks like a listed one, and where that number is from."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from benchmarks.blind.calibrate import (  # noqa: E402
    Sample,
    calibrate,
    leader_misfit,
    log_loss,
    read_samples,
)
from fenics_joints.diagnosis.evidence.unlisted import WEIGHTS, look_alike, misfit_in_nats  # noqa: E402


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
