"""Which further measurement would tell the members of a class apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.row import RowPrediction
from fenics_joints.diagnosis.plan.added import (
    ADDED_MASS,
    DAMPING_NOISE,
    MORE_MODES,
    missed_modes,
    next_modes,
)
from fenics_joints.diagnosis.result import Separation
from fenics_joints.formatting import point_mm
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.surrogate import Surrogate

__all__ = ["best_measurement"]


#: Expected separation D of two hypotheses, and the measurement.
Candidate = tuple[float, str]


def best_measurement(
    class_name: str,
    members: Sequence[str],
    a: Fit,
    b: Fit,
    surrogate: Surrogate,
    baseline: dict[str, float],
    condition: tuple[str, str],
    noise: float,
    discrepancy: float,
) -> Separation | None:
    """The measurement with the largest expected separation of two hypotheses fitted to the test.

    Offered are: the modes that the test did not see, the next ones it would see, an added known
    mass at the best sensor, conditions outside the tested range, and damping, where it would
    change with the level and was not measured. The first three come from the full model at the
    middle condition.

    Args:
        class_name: Name of the class.
        members: Its effects' names.
        a: The leading hypothesis with one member.
        b: The leading hypothesis with another.
        surrogate: The full structure and its reduced model.
        baseline: Parameter values of the nominal model.
        condition: Name and unit of the condition.
        noise: Relative standard deviation of a measured frequency.
        discrepancy: That of any such model; it cancels in shifts of the same mode.
    """
    conditions = np.array(a.hypothesis.conditions)
    at, row = float(conditions[len(conditions) // 2]), len(conditions) // 2
    first, second = (
        solve_modes(
            surrogate.full,
            f.hypothesis.values(f.z, at, baseline, row),
            n_modes=surrogate.n_modes,
            solver=surrogate.nominal.solver,
        )
        for f in (a, b)
    )
    absolute = float(np.hypot(noise, discrepancy))
    sensors, n_test = surrogate.sensors, surrogate.n_test
    candidates = _modes(first, second, sensors, n_test, absolute, surrogate.unseen)
    candidates += _added_mass(first, second, sensors, n_test, noise * np.sqrt(2))
    candidates += _conditions(a, b, surrogate.forward, baseline, condition, conditions, absolute)
    candidates += _damping(a, b, surrogate.forward, baseline, condition)
    if not candidates:
        return None
    distance, name = max(candidates)
    return Separation(class_name, tuple(members), name, distance)


def _candidate(name: str, change: np.ndarray, sd: float) -> Candidate:
    return float(np.linalg.norm(change) / sd / 2), name


def _split(modes: Modes, sensors) -> tuple[np.ndarray, np.ndarray]:
    elastic = np.arange(modes.n_rigid, len(modes))
    if sensors is None:
        return elastic, elastic[:0]
    seen = modes.visibility(sensors)[elastic] > VISIBLE
    return elastic[seen], elastic[~seen]


def _modes(a: Modes, b: Modes, sensors, n_test, sd, unseen: str) -> list[Candidate]:
    (seen_a, unseen_a), (seen_b, unseen_b) = _split(a, sensors), _split(b, sensors)
    found = []
    for first, second, words in (
        (seen_a[n_test:], seen_b[n_test:], next_modes),
        (unseen_a, unseen_b, lambda n: missed_modes(n, unseen)),
    ):
        n = min(len(first), len(second), MORE_MODES)
        if n:
            change = np.log(a.frequencies_hz[first[:n]] / b.frequencies_hz[second[:n]])
            found.append(_candidate(words(n), change, sd))
    return found


def _added_mass(a: Modes, b: Modes, sensors, n_test, sd) -> list[Candidate]:
    """Frequency shifts by a small added mass: -m phi^2 / 2 of ln f for mass-normalised phi."""
    if sensors is None:
        return []
    mass = ADDED_MASS * a.model.total_mass(a.given)
    shifts = []
    for modes in (a, b):
        seen, _ = _split(modes, sensors)
        shifts.append(-0.5 * mass * modes.at(sensors)[:, seen[:n_test]] ** 2)
    change = shifts[0] - shifts[1]
    best = int(np.argmax(np.linalg.norm(change, axis=1)))
    at = point_mm(sensors.points[best])
    name = f"the shifts by a known mass of {1e3 * mass:.0f} g added at {at} mm"
    return [_candidate(name, change[best], sd)]


def _conditions(a: Fit, b: Fit, forward, baseline, condition, conditions, sd) -> list[Candidate]:
    """The same modes at half the lowest and twice the highest condition."""
    if not any(e.depends_on_condition for f in (a, b) for e in f.hypothesis.effects):
        return []
    found = []
    ends = (
        (conditions.min() / 2, conditions.min(), "half the lowest"),
        (conditions.max() * 2, conditions.max(), "twice the highest"),
    )
    for value, near, word in ends:
        log_f = []
        for f in (a, b):
            # Followed from the nearest tested condition: modes change places beyond it.
            follow = forward.of(forward.model)
            follow.track(f.hypothesis.values(f.z, float(near), baseline))
            log_f.append(RowPrediction(f.hypothesis, follow, f.z, float(value), baseline).log_f)
        name = f"the same modes at {word} {condition[0]} ({value:g} {condition[1]})"
        found.append(_candidate(name, log_f[0] - log_f[1], sd))
    return found


def _damping(a: Fit, b: Fit, forward, baseline, condition) -> list[Candidate]:
    """How damping grows over the tested levels; its value at rest is free in every mode."""
    known = a.hypothesis.damped or not any(e.by_level for e in a.hypothesis.effects)
    if known or len(a.hypothesis.conditions) < 2:
        return []
    grown = []
    for f in (a, b):
        hypothesis = replace(f.hypothesis, damped=True)
        z = np.concatenate([f.z, np.zeros(len(hypothesis.dampings))])
        rows = [
            RowPrediction(hypothesis, forward, z, c, baseline).data[f.shape[1] :]
            for c in hypothesis.conditions
        ]
        grown.append(np.array(rows) - np.mean(rows, axis=0))
    name = f"the damping ratios of the same modes, at the same values of the {condition[0]}"
    return [_candidate(name, (grown[0] - grown[1]).ravel(), DAMPING_NOISE)]
