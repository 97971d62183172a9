"""How far the gap shrinks on data that were neither fitted nor used to choose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.diagnosis.inference import Evidence, Fit, Forward, fit
from fenics_joints.gap import rms

__all__ = ["Shrinkage", "cross_validate", "folds"]

#: Far below what a held-out error is known to.
_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Shrinkage:
    """Relative RMS errors on held-out data, pooled over folds; and each fold.

    Attributes:
        before: Of the nominal model.
        after: Of what was chosen and fitted without the held-out data.
        placebo: Of the best wrong effect, chosen and fitted likewise.
        rows: A dict for each fold: name, n, before, after, placebo, chosen.
    """

    before: float
    after: float
    placebo: float
    rows: list[dict]


def folds(
    conditions: np.ndarray, mode_names: Sequence[str], condition: tuple[str, str], blocks: int = 3
) -> list[tuple[str, np.ndarray]]:
    """Masks (n, m) of what to hold out: each mode in turn, and the conditions in blocks.

    Blocks are neighbours in the condition, so that the outer ones ask for extrapolation.
    """
    n, m = len(conditions), len(mode_names)
    found = []
    if m > 1:
        for j, name in enumerate(mode_names):
            mask = np.zeros((n, m), dtype=bool)
            mask[:, j] = True
            found.append((name if name.startswith("mode") else f"mode {name}", mask))
    if n > 1:
        for block in np.array_split(np.arange(n), min(blocks, n)):
            mask = np.zeros((n, m), dtype=bool)
            mask[block] = True
            low, high = conditions[block[0]], conditions[block[-1]]
            span = f"{low:g}" if low == high else f"{low:g} to {high:g}"
            found.append((f"{condition[0]} {span} {condition[1]}".strip(), mask))
    return found


def cross_validate(
    candidates: Sequence[Fit],
    log_prior: Sequence[float],
    is_wrong: Callable[[Fit], bool],
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    masks: Sequence[tuple[str, np.ndarray]],
    *,
    progress: Callable[[], None] | None = None,
) -> Shrinkage:
    """Choose and fit anew without each fold, and predict it.

    Args:
        candidates: Hypotheses, fitted to all data (their parameters are starting points only).
        log_prior: ln of their prior probabilities.
        is_wrong: Whether a hypothesis counts as placebo.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        masks: From `folds`.
        progress: Called after each fold.
    """
    nominal = np.array([forward(baseline)[0]] * len(evidence.conditions))
    rows, errors = [], {"before": [], "after": [], "placebo": []}
    for name, mask in masks:
        held = mask & evidence.used
        left = evidence.without(mask)
        if not held.any() or not left.used.any():
            continue
        refits = [
            fit(c.hypothesis, forward, left, baseline, starts=[c.z], tolerance=_TOLERANCE)
            for c in candidates
        ]
        score = np.array([f.log_evidence for f in refits]) + np.asarray(log_prior)
        wrong = np.array([is_wrong(f) for f in refits])
        best = refits[int(np.argmax(score))]
        placebo = refits[int(np.argmax(np.where(wrong, score, -np.inf)))] if wrong.any() else None
        row = {"name": name, "n": int(held.sum()), "chosen": best.hypothesis.label}
        for key, log_f in (
            ("before", nominal),
            ("after", best.log_f),
            ("placebo", nominal if placebo is None else placebo.log_f),
        ):
            relative = np.expm1((log_f - evidence.log_f)[held])
            errors[key].append(relative)
            row[key] = rms(relative)
        rows.append(row)
        if progress:
            progress()
    if not rows:
        return Shrinkage(np.nan, np.nan, np.nan, [])
    pooled = {key: rms(np.concatenate(parts)) for key, parts in errors.items()}
    return Shrinkage(pooled["before"], pooled["after"], pooled["placebo"], rows)
