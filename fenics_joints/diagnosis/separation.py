"""The further measurement that would best tell the members of a class apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import DAMPING_NOISE
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.predictions import at_conditions
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.plan.added import ADDED_MASS, MORE_MODES, missed_modes, next_modes
from fenics_joints.diagnosis.result import Separation
from fenics_joints.diagnosis.zones.sites import without_attached
from fenics_joints.errors import InputError, JointsError
from fenics_joints.formatting import point_mm
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.matched import PLACES, match_modes
from fenics_joints.reduction.reduced import solve_shared
from fenics_joints.reduction.surrogate import ReducedModel

#: Expected separation D of two hypotheses, and the measurement.
Offer = tuple[float, str]


def best_measurement(model: Prepared, a: Fit, b: Fit) -> Offer | None:
    """The measurement with the largest expected separation of two hypotheses fitted to the test.

    Considered are the modes that the sensors miss, the next ones that they would see, a known mass
    added at the best sensor, conditions outside the tested range, and damping if it changes with
    the level and was not measured. The first three come from the full model at the middle
    condition. The hypotheses are not fitted anew to the new measurement, so that the separation is
    an upper bound.

    Args:
        model: The case with its test.
        a: The leading hypothesis with one member of a class.
        b: The leading hypothesis with another.
    """
    surrogate, baseline, condition = model.surrogate, model.baseline, model.condition
    known = a.hypothesis.known or ({},) * len(a.hypothesis.conditions)
    own = [i for i, change in enumerate(known) if not change]
    conditions = np.array(a.hypothesis.conditions)[own]
    row = own[len(own) // 2]
    at = float(a.hypothesis.conditions[row])

    def solve(values: Mapping[str, float]) -> Modes:
        solver = surrogate.nominal.solver
        return solve_modes(surrogate.full, values, n_modes=surrogate.n_modes, solver=solver)

    points = [
        without_attached(f.hypothesis.values(f.z, at, baseline, row), baseline) for f in (a, b)
    ]
    first, second = solve_shared(model.ranks, surrogate.full, points, solve)
    noise = float(np.max(model.data.noise)) or 1e-3
    # A model's error cancels in shifts of the same mode.
    absolute = float(np.hypot(noise, model.evidence.discrepancy))
    pairs = same_in_both(first, second, surrogate)
    candidates = further_modes(first, second, pairs, absolute, surrogate.unseen)
    candidates += added_mass(first, second, pairs, surrogate.sensors, noise * np.sqrt(2))
    candidates += _conditions(a, b, surrogate.forward, baseline, condition, conditions, absolute)
    candidates += _damping(a, b, surrogate.forward, baseline, condition)
    return max(candidates, default=None)


def separations(
    model: Prepared, fits: Sequence[Fit], grouped: Mapping[str, str], leader: Fit
) -> tuple[list[Separation], list[str]]:
    """For each class of the leader with several members, the measurement that would split the
    leading two; and notes on those whose models cannot be solved, which must not stop a diagnosis.

    Args:
        model: The case with its test.
        fits: Hypotheses, most probable first.
        grouped: Class of each effect, by its key.
        leader: The leading one of them.
    """
    found, failed = [], []
    for name in dict.fromkeys(grouped[e.key] for e in leader.hypothesis.effects):
        members = {e.key: e.name for e in model.effects if grouped[e.key] == name}
        if len(members) < 2:
            continue
        mine = next(e.key for e in leader.hypothesis.effects if e.key in members)
        rival = _rival(fits, leader, mine, set(members))
        if rival is None:
            continue
        try:
            best = best_measurement(model, leader, rival)
        except JointsError as error:
            failed.append(
                f"No measurement is proposed to distinguish the effects of class {name} "
                f"({', '.join(members.values())}): {error}"
            )
            continue
        if best is not None:
            found.append(Separation(name, tuple(members.values()), best[1], best[0]))
    return found, failed


def _rival(fits: Sequence[Fit], leader: Fit, mine: str, members: set[str]) -> Fit | None:
    """The best hypothesis that has another member in place of the leader's, ``mine``."""
    rest = {e.key for e in leader.hypothesis.effects} - {mine}
    for f in fits:
        keys = {e.key for e in f.hypothesis.effects}
        others = keys - rest
        if rest <= keys and len(others) == 1 and others <= members - {mine}:
            return f
    return None


def _candidate(name: str, change: np.ndarray, sd: float) -> Offer:
    return float(np.linalg.norm(change) / sd / 2), name


class MatchedPairs(NamedTuple):
    """Modes of one model and the same ones of another, as indices, (k, 2).

    Attributes:
        tested: Those that the test has.
        seen: Others that its sensors would see.
        unseen: Those that they would not.
    """

    tested: np.ndarray
    seen: np.ndarray
    unseen: np.ndarray


def same_in_both(a: Modes, b: Modes, surrogate: ReducedModel) -> MatchedPairs:
    """Pairs of modes by their shapes all over the structure. By order, a mode that the sensors see
    in only one of the models would shift all modes above it. Collective.

    Args:
        a: Modes of the one model.
        b: Those of the other.
        surrogate: Says which of the first the test's are.
    """
    elastic = np.arange(a.n_rigid, len(a))[: len(b) - b.n_rigid]
    like, same = match_modes(a, elastic, b, surrogate.everywhere(PLACES))
    try:
        tested = np.isin(elastic, surrogate.forward.paired(a).index)
    except InputError:
        tested = np.zeros(len(elastic), dtype=bool)  # too few that the test could see
    seen = np.ones(len(elastic), dtype=bool)
    if surrogate.sensors is not None:
        seen = a.visibility(surrogate.sensors)[elastic] > VISIBLE
    pairs = np.column_stack([elastic, like])
    return MatchedPairs(*(pairs[same & one] for one in (tested, seen & ~tested, ~seen & ~tested)))


def further_modes(a: Modes, b: Modes, pairs: MatchedPairs, sd: float, unseen: str) -> list[Offer]:
    """What the next modes would tell, those that the sensors would see and those that they miss.

    Args:
        a: Modes of the one model.
        b: Those of the other.
        pairs: Which are the same.
        sd: Standard deviation of ln f.
        unseen: Motions that the sensors miss, in words.
    """
    found = []
    for which, words in (
        (pairs.seen, next_modes),
        (pairs.unseen, lambda n: missed_modes(n, unseen)),
    ):
        mine, theirs = which[:MORE_MODES].T
        if len(mine):
            change = np.log(a.frequencies_hz[mine] / b.frequencies_hz[theirs])
            found.append(_candidate(words(len(mine)), change, sd))
    return found


def added_mass(a: Modes, b: Modes, pairs: MatchedPairs, sensors, sd: float) -> list[Offer]:
    """Frequency shifts by a small added mass: -m phi^2 / 2 of ln f for mass-normalised phi.

    Args:
        a: Modes of the one model.
        b: Those of the other.
        pairs: Which are the same.
        sensors: Where it may be put; None offers nothing.
        sd: Standard deviation of a shift of ln f.
    """
    if sensors is None or not len(pairs.tested):
        return []
    mass = ADDED_MASS * a.model.total_mass(a.given)
    shifts = [
        -0.5 * mass * modes.at(sensors)[:, index] ** 2
        for modes, index in zip((a, b), pairs.tested.T, strict=True)
    ]
    change = shifts[0] - shifts[1]
    best = int(np.argmax(np.linalg.norm(change, axis=1)))
    at = point_mm(sensors.points[best])
    name = f"the frequency shifts due to a known mass of {1e3 * mass:.0f} g at {at} mm"
    return [_candidate(name, change[best], sd)]


def _conditions(a: Fit, b: Fit, forward, baseline, condition, conditions, sd) -> list[Offer]:
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
            # Tracked from the nearest tested condition, since modes change their order beyond it.
            follow = forward.of(forward.model)
            follow.track(f.hypothesis.values(f.z, float(near), baseline))
            log_f.append(
                at_conditions(f.hypothesis, follow, f.z, [value], baseline, f.shape[1])[0, 0]
            )
        name = f"the same modes at {word} {condition[0]} ({value:g} {condition[1]})"
        found.append(_candidate(name, log_f[0] - log_f[1], sd))
    return found


def _damping(a: Fit, b: Fit, forward, baseline, condition) -> list[Offer]:
    """The growth of damping over the tested levels; its value at rest is free in every mode."""
    known = a.hypothesis.damped or not any(e.by_level for e in a.hypothesis.effects)
    if known or len(a.hypothesis.conditions) < 2:
        return []
    grown = []
    for f in (a, b):
        hypothesis = replace(f.hypothesis, damped=True)
        z = np.concatenate([f.z, np.zeros(len(hypothesis.dampings))])
        _, ratios = at_conditions(
            hypothesis, forward, z, hypothesis.conditions, baseline, f.shape[1]
        )
        grown.append(ratios - np.mean(ratios, axis=0))
    name = f"the damping ratios of the same modes, at the same values of the {condition[0]}"
    return [_candidate(name, (grown[0] - grown[1]).ravel(), DAMPING_NOISE)]
