"""Weights of `fenics_joints.diagnosis.unlisted` from cases that were opened.

Cases and geometries that are for scoring only are left out, and those of two effects count as
inside the library. Beside the weights stands what each geometry is given by the other's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.blind import seal
from fenics_joints.diagnosis.unlisted import strain
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN

__all__ = ["Sample", "calibrate", "log_loss", "read_samples"]

#: Weight of the sum of squares of all weights but the first, against ln likelihood.
_RIDGE = 1.0


@dataclass(frozen=True)
class Sample:
    """A case: its geometry, `strain` of its leading hypothesis, and whether it was outside."""

    geometry: str
    strain: np.ndarray
    outside: bool


def read_samples(folders: Sequence[Path]) -> list[Sample]:
    """Opened cases, but for those kept for scoring and those whose diagnosis failed."""
    found = []
    for folder in folders:
        for name, answer in seal.read_json(folder / seal.UNSEALED)["answers"].items():
            said = seal.read_json(folder / "diagnoses" / f"{name}.json").get("diagnosis")
            if said is not None and not answer["final_only"]:
                outside = answer["kind"] == "unknown"
                found.append(Sample(answer["geometry"], leader_strain(said), outside))
    return found


def leader_strain(diagnosis: Mapping) -> np.ndarray:
    """`strain` of the most probable hypothesis but for the unknown, shape (4,)."""
    known = [h for h in diagnosis["hypotheses"] if h["label"] != UNKNOWN]
    lead = max(known, key=lambda h: h["probability"])
    departures = np.array([p["prior_sigmas"] for p in lead["parameters"] if p["nuisance"]])
    count = 0 if lead["label"] == NO_GAP else len(lead["effects"])
    return strain(lead["p_value"], departures, count)


def calibrate(samples: Sequence[Sample]) -> np.ndarray:
    """Most probable weights of a logistic function, shape (4,)."""
    X = np.array([s.strain for s in samples])
    sign = np.where([s.outside for s in samples], 1.0, -1.0)

    def loss(w):
        return np.sum(np.logaddexp(0.0, -sign * (X @ w))) + _RIDGE * np.sum(w[1:] ** 2)

    return minimize(loss, np.zeros(X.shape[1])).x


def log_loss(samples: Sequence[Sample], weights: np.ndarray) -> float:
    """Mean of -ln of the probability that was given to what was so."""
    p = expit(np.array([s.strain for s in samples]) @ weights)
    outside = np.array([s.outside for s in samples])
    return float(-np.mean(np.log(np.where(outside, p, 1 - p))))


def report(samples: Sequence[Sample]) -> str:
    """The weights in words, and how they carry over from geometry to geometry."""
    weights = calibrate(samples)
    share = np.mean([s.outside for s in samples])
    rate = np.array([np.log(share / (1 - share)), 0.0, 0.0, 0.0])
    lines = [
        f"{len(samples)} cases, {sum(s.outside for s in samples)} outside the library",
        "weights: " + ", ".join(f"{w:.2f}" for w in weights),
        f"log loss {log_loss(samples, weights):.3f}; the mere rate {log_loss(samples, rate):.3f}",
    ]
    for geometry in sorted({s.geometry for s in samples}):
        others = [s for s in samples if s.geometry != geometry]
        own = [s for s in samples if s.geometry == geometry]
        if others:
            lines.append(
                f"{geometry} by the others' weights: log loss {log_loss(own, calibrate(others)):.3f}"
            )
    return "\n".join(lines)
