"""Weights of `fenics_joints.diagnosis.evidence.unlisted` from cases that were opened.

Cases and geometries that are for scoring only are left out, and those of two effects count as
inside the library. Beside the weights stands what each geometry is given by the other's, and how
often a cause that was named was right, confirmed on held-out data or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.blind import seal
from benchmarks.blind.score import read_records
from benchmarks.blind.seal import SealError
from fenics_joints.diagnosis.evidence.unlisted import misfit_in_nats
from fenics_joints.diagnosis.verdict import NAMED, UNKNOWN

__all__ = ["Sample", "calibrate", "log_loss", "named_right", "read_samples", "report"]

#: Weight of the square of the slope, against ln likelihood.
_RIDGE = 1.0


@dataclass(frozen=True)
class Sample:
    """A case: its geometry, misfit of its leading hypothesis in nats, whether it was outside."""

    geometry: str
    misfit: float
    outside: bool


def read_samples(folders: Sequence[Path]) -> list[Sample]:
    """Opened cases, but for those kept for scoring and those whose diagnosis failed."""
    found = []
    for folder in folders:
        for name, answer in seal.read_json(folder / seal.UNSEALED)["answers"].items():
            said = seal.read_json(folder / "diagnoses" / f"{name}.json").get("diagnosis")
            if said is not None and not answer["final_only"]:
                outside = answer["kind"] == "unknown"
                found.append(Sample(answer["geometry"], leader_misfit(said), outside))
    return found


def leader_misfit(diagnosis: Mapping) -> float:
    """Misfit of the most probable hypothesis but for the unknown, in nats."""
    known = [h for h in diagnosis["hypotheses"] if h["label"] != UNKNOWN]
    return misfit_in_nats(max(known, key=lambda h: h["probability"])["p_value"])


def named_right(folders: Sequence[Path]) -> dict[str, tuple[int, int]]:
    """How often what was named, as a class, was right, and how often something was, by verdict."""
    found = {verdict: (0, 0) for verdict in NAMED}
    for record in (r for folder in folders for r in read_records(folder, None)):
        said = record.statement("class")
        if said is not None and record.forecast.verdict in found and not record.truth["final_only"]:
            right, n = found[record.forecast.verdict]
            found[record.forecast.verdict] = right + said[1], n + 1
    return found


def _columns(samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """1 and misfit of each, (n, 2), and whether it was outside, (n,)."""
    misfit = np.array([s.misfit for s in samples])
    return np.column_stack([np.ones(len(samples)), misfit]), np.array([s.outside for s in samples])


def calibrate(samples: Sequence[Sample]) -> np.ndarray:
    """Most probable intercept and slope of a logistic function, shape (2,)."""
    X, outside = _columns(samples)
    sign = np.where(outside, 1.0, -1.0)

    def loss(w):
        return np.sum(np.logaddexp(0.0, -sign * (X @ w))) + _RIDGE * w[1] ** 2

    return minimize(loss, np.zeros(2)).x


def log_loss(samples: Sequence[Sample], weights: np.ndarray) -> float:
    """Mean of -ln of the probability that was given to what was so."""
    X, outside = _columns(samples)
    p = expit(X @ weights)
    return float(-np.mean(np.log(np.where(outside, p, 1 - p))))


def report(samples: Sequence[Sample]) -> str:
    """The weights in words, and how they carry over from geometry to geometry."""
    share = float(np.mean([s.outside for s in samples])) if samples else 0.0
    if not 0 < share < 1:
        raise SealError(f"{len(samples)} cases: expected some inside and some outside the library")
    weights = calibrate(samples)
    rate = np.array([np.log(share / (1 - share)), 0.0])
    lines = [
        f"{len(samples)} cases, {sum(s.outside for s in samples)} outside the library",
        f"intercept {weights[0]:.2f}, slope {weights[1]:.2f}",
        f"log loss {log_loss(samples, weights):.3f}; the mere rate {log_loss(samples, rate):.3f}",
    ]
    for geometry in sorted({s.geometry for s in samples}):
        others = [s for s in samples if s.geometry != geometry]
        own = [s for s in samples if s.geometry == geometry]
        if others:
            loss = log_loss(own, calibrate(others))
            lines.append(f"{geometry} by the others' weights: log loss {loss:.3f}")
    return "\n".join(lines)
