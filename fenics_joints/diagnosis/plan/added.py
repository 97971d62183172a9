"""Measurements that could be added to a test, and what each would tell apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.diagnosis.plan.groups import groups
from fenics_joints.diagnosis.plan.study import Measurement, Signature, Study
from fenics_joints.reduction import ArrayModel, Forward
from fenics_joints.reduction.lean import batched
from fenics_joints.reduction.many import Change, ManyModes, ManyValues
from fenics_joints.reduction.terms import MassTerm

#: Added mass, as a share of the structure's. [decision: chosen]
ADDED_MASS = 0.05
#: Further modes of each kind that a longer test would see. [decision: chosen]
MORE_MODES = 3


def next_modes(n: int) -> str:
    """The next modes that the test's sensors would see, in words."""
    return "the next mode of the same kind" if n == 1 else f"the next {n} modes of the same kind"


def missed_modes(n: int, kinds: str) -> str:
    """The lowest modes that the test's sensors do not see, in words.

    Args:
        n: How many.
        kinds: What motions they may be.
    """
    which = "lowest mode" if n == 1 else f"{n} lowest modes"
    return (
        f"the {which} that these sensors miss ({kinds}): "
        "put sensors off the line and in the other directions"
    )


# -- models as another test sees them --------------------------------------------------------------


class Joined:
    """The modes of two forwards of one structure beside each other; shapes of the first's only, and
    each told by itself at every condition.

    Args:
        first: Forward of the test's modes.
        second: Forward of further modes.
    """

    #: See `Forward`.
    batches, further = True, None

    def __init__(self, first: Forward, second: Forward):
        self._parts = batched(first), batched(second)
        self.model, self.sensors = self._parts[0].model, first.sensors

    def many(self, values: ManyValues, every: bool = True, followed=None) -> _JoinedModes:
        """See `LeanForward.many`."""
        first, second = self._parts  # whose derivatives of shapes nobody asks for
        return _JoinedModes(first.many(values, every), second.many(values, every=False))

    def change(self, *given) -> tuple[Change, ...]:
        """See `LeanForward.change`."""
        return tuple(part.change(*given) for part in self._parts)


@dataclass(frozen=True, eq=False)
class _JoinedModes:
    """See `ManyModes`; changes are those of each."""

    first: ManyModes
    second: ManyModes

    @property
    def index(self) -> np.ndarray:
        return np.concatenate([self.first.index, self.second.index], axis=1)

    @property
    def log_f(self) -> np.ndarray:
        return np.concatenate([self.first.log_f, self.second.log_f], axis=1)

    @property
    def good(self) -> np.ndarray:
        return self.first.good & self.second.good

    @property
    def x(self) -> np.ndarray:
        return self._padded(self.first.x)

    def _padded(self, shapes: np.ndarray) -> np.ndarray:
        return np.pad(shapes, [(0, 0), (0, 0), (0, self.second.index.shape[1])])

    def slopes(self, along: tuple[Change, ...]) -> np.ndarray:
        parts = zip((self.first, self.second), along, strict=True)
        return np.concatenate([modes.slopes(own) for modes, own in parts], axis=1)

    def share(self, name: str) -> np.ndarray:
        return np.concatenate([self.first.share(name), self.second.share(name)], axis=1)

    def shape_slope(self, along: tuple[Change, ...], k: int) -> np.ndarray:
        return self._padded(self.first.shape_slope(along[0], k))


def loaded(model: ArrayModel, rows: np.ndarray, mass: float) -> ArrayModel:
    """A model with a known mass put on.

    Args:
        model: The model, of plain arrays.
        rows: Displacement of its basis at the mass, shape (gdim, n_dofs).
        mass: Mass, kg.
    """
    term = MassTerm("added mass", mass, 0.0, 1.0, np.zeros(1), rows[None])
    masses = [*model.pencil.masses, term]
    return replace(model, pencil=replace(model.pencil, masses=masses))


def altered(name: str, factor: float) -> Effect:
    """A parameter changed on purpose.

    Args:
        name: The parameter's.
        factor: Factor on its value; 0 takes away what it is of.
    """

    def apply(values, theta, condition):
        values[name] = factor * values[name]

    return Effect(f"{name} altered", "", (), apply)


# -- tests -----------------------------------------------------------------------------------------


def measurement(
    nuisances: Sequence[Effect], scatter: float, modes: Sequence[str], evidence: Evidence, forward
) -> Measurement:
    """A test by what it would measure.

    Args:
        nuisances: What is free in any case.
        scatter: See `Hypothesis.scatter`.
        modes: Names of the modes.
        evidence: Its layout, noise and discrepancy; its values do not count, unless they are nan.
        forward: Predicts frequencies and shapes.
    """
    bare = Hypothesis(
        (),
        tuple(nuisances),
        scatter=scatter,
        modes=tuple(modes),
        conditions=tuple(float(c) for c in evidence.conditions),
        damped=evidence.log_damping is not None,
        driven=evidence.driven,
    )
    used = evidence.fitted

    def predicted(hypothesis, z, baseline):
        values, slopes = ManyPredictions(hypothesis, forward, evidence, baseline).at(z)
        return values[used], slopes[used]

    return Measurement(bare, predicted, evidence.covariance())


def shifted(
    test: Measurement, evidence: Evidence, forward, other, row: int, effects: Sequence[Effect] = ()
) -> Measurement:
    """A test and, at one of its conditions, the shifts of its frequencies by a known change.

    The discrepancy cancels in a shift of the same mode, between measurements without a new
    tightening; the noise counts twice.

    Args:
        test: The test.
        evidence: The test's, for the noise.
        forward: Frequencies of the structure as it is.
        other: Those of the changed one.
        row: Which condition.
        effects: Without parameters: what else is changed.
    """
    there = np.flatnonzero(evidence.used[row])
    noise = evidence.log_sd[row, there]
    at_row = row * evidence.shape[1] + there
    plain = replace(evidence, log_damping=None, shapes=None, scalars=())

    def predicted(hypothesis, z, baseline):
        values, slopes = test.predict(hypothesis, z, baseline)
        kept = np.ones(len(z), dtype=bool)
        kept[hypothesis.places["dampings"]] = False
        undamped = replace(hypothesis, damped=False)
        changed = replace(undamped, effects=(*hypothesis.effects, *effects))
        before, after = (
            ManyPredictions(h, f, plain, baseline).at(z[kept])
            for h, f in ((undamped, forward), (changed, other))
        )
        more = np.zeros((len(there), len(z)))
        more[:, kept] = (after[1] - before[1])[at_row]
        return np.append(values, (after[0] - before[0])[at_row]), np.vstack([slopes, more])

    n = len(test.covariance)
    covariance = np.diag(np.append(np.zeros(n), 2 * noise**2))
    covariance[:n, :n] = test.covariance
    return Measurement(test.bare, predicted, covariance)


def widened(evidence: Evidence, more: int = 0, conditions: Sequence[float] = ()) -> Evidence:
    """A test's layout with further modes and conditions; values are placeholders.

    Args:
        evidence: The test.
        more: Number of further modes, of which frequencies alone are measured.
        conditions: Further conditions, behind the others.
    """
    rows = len(conditions)

    def wider(a, value, columns=more):
        return np.pad(a, [(0, rows), (0, columns)], constant_values=value)

    noise = float(np.nanmedian(evidence.log_sd))
    sd = wider(evidence.log_sd, noise)
    if rows:
        sd[-rows:, : len(evidence.log_sd[0])] = np.nanmedian(evidence.log_sd, axis=0)
    changes = {
        "conditions": np.append(evidence.conditions, conditions),
        "log_f": wider(evidence.log_f, 0.0),
        "log_sd": sd,
        "used": wider(evidence.used, True),
    }
    if evidence.log_damping is not None:
        damping = wider(evidence.log_damping, np.nan)
        damping[len(evidence.conditions) :, : evidence.log_f.shape[1]] = 0.0
        changes["log_damping"] = damping
    if evidence.shapes is not None and more:
        changes["shapes"] = np.pad(evidence.shapes, [(0, 0), (0, more)], constant_values=np.nan)
    return replace(evidence, **changes)


# -- what they are worth ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidate:
    """A test with one more measurement.

    Attributes:
        name: The measurement, in words.
        measurement: The test with it.
        effects: Effects that are others in this test, by their key: with a law over the torque
            where the planned test has one torque only.
    """

    name: str
    measurement: Measurement
    effects: Mapping[str, Effect] | None = None


@dataclass(frozen=True)
class Addition:
    """What a measurement would add.

    Attributes:
        name: The measurement, in words.
        classes: How many causes or classes of causes the test would then tell apart.
        seen: How many effects it would see.
        mean: Mean gain of D over the pairs that the planned test leaves together.
        largest: The largest.
        pair: The pair of that: the effect at work, and the one it is taken for (or "no gap").
        distances: D of every pair with it, (n, n + 1), the last column "no gap".
    """

    name: str
    classes: int
    seen: int
    mean: float
    largest: float
    pair: tuple[str, str]
    distances: np.ndarray


def rank(
    study: Study, candidates: Sequence[Candidate], progress: Callable[[], None] | None = None
) -> list[Addition]:
    """What each candidate adds to a planned test, the most telling first.

    For every pair of effects that the test leaves together the nearest prediction of the one to
    the other is sought again, with all the freedom it had: so what one more measurement shows is
    what cannot be explained by other parameters.

    Args:
        study: The planned test.
        candidates: Tests with one more measurement.
        progress: Called after each.
    """
    found = []
    for candidate in candidates:
        found.append(_worth(study, candidate))
        if progress:
            progress()
    return sorted(found, key=lambda a: (-a.classes, -a.seen, -a.mean))


def table(study: Study) -> np.ndarray:
    """D of every pair, and from "no gap" in the last column, (n, n + 1)."""
    return np.column_stack([study.distances, [s.d / 2 for s in study.expected]])


def _worth(study: Study, candidate: Candidate) -> Addition:
    before = table(study)
    changed = candidate.effects or {}
    effects, n = [changed.get(e.key, e) for e in study.effects], len(study.effects)
    beneath = {e.key: study.baseline(e) for e in study.effects}
    richer = Study(candidate.measurement, effects, {}, beneath=beneath)
    after = before.copy()

    @cache
    def truth(i: int) -> Signature:
        """The signature of the same size in the richer test."""
        return richer.signature(
            effects[i], _by_name(study.effects[i], study.expected[i].own, effects[i])
        )

    def again(i: int, j: int) -> float:
        """D of a pair in the richer test; ``j`` beyond the effects is "no gap"."""
        if j == n:
            return truth(i).d / 2
        start = _by_name(study.effects[j], study.near[i, j], effects[j])
        return richer.distance(truth(i), effects[j], start)

    # All from an effect that is not seen is near: first whether it is seen now.
    for i in np.flatnonzero(before[:, n] < APART):
        after[i, n] = max(after[i, n], again(i, n))
    seen = after[:, n] >= APART
    together = [
        (i, j)
        for i in np.flatnonzero(seen)
        for j in np.flatnonzero(seen)
        if i != j and before[i, j] < APART
    ]
    for i, j in together:
        after[i, j] = max(after[i, j], again(i, j))
    open_ = [*together, *((i, n) for i in np.flatnonzero(before[:, n] < APART))]
    gains = np.array([after[i, j] - before[i, j] for i, j in open_] or [0.0])
    best = open_[int(np.argmax(gains))] if open_ else (0, n)
    names = [*(e.key for e in study.effects), "no gap"]
    return Addition(
        candidate.name,
        len(groups(after[:, :n], seen)),
        int(seen.sum()),
        float(gains.mean()),
        float(gains.max()),
        (names[best[0]], names[best[1]]),
        after,
    )


def _by_name(old: Effect, own: np.ndarray, new: Effect) -> np.ndarray:
    """Parameters for an effect that may have more of them, in prior standard deviations."""
    values = {prior.name: z for prior, z in zip(old.priors, own, strict=True)}
    return np.array([values.get(prior.name, 0.0) for prior in new.priors])
