"""Measurements that could be added to a test, and what each would tell apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from fenics_joints.case.test import StaticTest
from fenics_joints.diagnosis.effects.effect import Effect, Setting
from fenics_joints.diagnosis.effects.library import case_effects
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.entries import FUNCTION, STIFFNESS
from fenics_joints.diagnosis.evidence.evidence import DAMPING_NOISE, Evidence, evidence_of
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.observations import WHOLE, Observation, on_a_scale
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.model.at_points import most_yielding, stiffness_at
from fenics_joints.diagnosis.model.functions import planned_function
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.plan.study import Measurement, Signature, Study, groups
from fenics_joints.diagnosis.zones.sites import without_attached
from fenics_joints.formatting import condition_value, point_mm, spaced
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction import ArrayModel, ModalPrediction
from fenics_joints.reduction.affine import mass_term
from fenics_joints.reduction.batch_modes import BatchModes, BatchValues, Change
from fenics_joints.reduction.prediction import batched
from fenics_joints.structure.points import Sensors

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
        first: ModalPrediction of the test's modes.
        second: ModalPrediction of further modes.
    """

    #: See `ModalPrediction`.
    batches, further = True, None

    def __init__(self, first: ModalPrediction, second: ModalPrediction):
        self._parts = batched(first), batched(second)
        self.model, self.sensors = self._parts[0].model, first.sensors

    def batch(self, values: BatchValues, every: bool = True, followed=None) -> _JoinedModes:
        """See `BatchPrediction.batch`."""
        first, second = self._parts  # whose derivatives of shapes nobody asks for
        return _JoinedModes(first.batch(values, every), second.batch(values, every=False))

    def change(self, *given) -> tuple[Change, ...]:
        """See `BatchPrediction.change`."""
        return tuple(part.change(*given) for part in self._parts)


@dataclass(frozen=True, eq=False)
class _JoinedModes:
    """See `BatchModes`; changes are those of each."""

    first: BatchModes
    second: BatchModes

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
    term = mass_term("added mass", mass, 0.0, 1.0, np.zeros(1), rows[None])
    points = [*model.pencil.points, term]
    return replace(model, pencil=replace(model.pencil, points=points))


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


#: Points, spread over the structure, at which modes are told from each other. [numerical: chosen]
_POINTS = 24
#: A suspension that a test could have instead: this much softer. [decision: chosen]
_SOFTER = 0.1
#: Pairs that decide where a mass is put. [numerical: chosen for time]
_PAIRS = 12


@dataclass(eq=False)
class Candidates:
    """Tests with one more measurement each.

    Attributes:
        model: The prepared diagnosis: case, data, effects, nuisances, surrogate, forward.
        evidence: The planned test.
        test: The same by what it measures.
        study: Its signatures and distances.
    """

    model: Prepared
    evidence: Evidence
    test: Measurement
    study: Study

    def all(self) -> list[Candidate]:
        """Every measurement that this case can offer. Collective."""
        return [
            *self._modes(),
            *self._conditions(),
            *self._damping(),
            *self._shapes(),
            *self._weighing(),
            *self._static(),
            *self._driven(),
            *self._mass(),
            *self._rig(),
        ]

    def _measurement(self, evidence, forward=None, modes=None, scatter=None) -> Measurement:
        m = self.model
        return measurement(
            m.nuisances,
            m.scatter if scatter is None else scatter,
            modes or m.data.mode_names,
            evidence,
            forward or m.forward,
        )

    def _of(self, data: TestData) -> Measurement:
        """A test that measures other quantities of the same modes."""
        e = self.evidence
        found = evidence_of(data, e.discrepancy, scalars=e.scalars, mesh_error=e.mesh_error)
        return self._measurement(found)

    def _with(self, *more: Observation) -> Measurement:
        """The test with further single numbers."""
        return self._measurement(replace(self.evidence, scalars=(*self.evidence.scalars, *more)))

    def _has(self, kind: int) -> bool:
        return any(scalar.kind == kind for scalar in self.evidence.scalars)

    # -- further modes -----------------------------------------------------------------------

    def _modes(self) -> list[Candidate]:
        found = []
        for words, names, forward in self._further:
            more = len(forward(self.model.baseline)[0])
            test = self._measurement(
                widened(self.evidence, more),
                Joined(self.model.forward, forward),
                [*self.model.data.mode_names, *(f"{names} {i + 1}" for i in range(more))],
            )
            found.append(Candidate(words(more), test))
        return found

    @cached_property
    def _further(self) -> list[tuple]:
        """Words, a name and the forward of the next modes, and of those the sensors miss."""
        surrogate, reduced = self.model.surrogate, self._wide
        modes = solve_modes(
            reduced, self.model.baseline, n_modes=min(surrogate.n_modes, reduced.n_dofs)
        )
        own = self.model.forward.paired(modes)
        elastic = np.arange(modes.n_rigid, len(modes))
        seen = np.isin(elastic, own.visible)
        free = ~np.isin(elastic, own.index)
        everywhere = self._everywhere
        shapes, clear = modes.at(everywhere), modes.visibility(everywhere)[elastic] > VISIBLE
        found = []
        for words, name, which in (
            (next_modes, "next mode", seen),
            (lambda n: missed_modes(n, surrogate.unseen), "missed mode", ~seen),
        ):
            index = elastic[which & free & clear][:MORE_MODES]
            if len(index):
                forward = ModalPrediction(
                    _seen(reduced, everywhere),
                    everywhere,
                    len(index),
                    len(modes),
                    reference=shapes[:, index],
                )
                found.append((words, name, forward))
        return found

    @cached_property
    def _wide(self) -> ArrayModel:
        """A reduced model with all modes, whether the test sees them or not. Collective."""
        return self.model.surrogate.wide(self._points_of_sizes())

    @cached_property
    def _wide_forward(self) -> ModalPrediction:
        """The test's modes from it."""
        forward, model = self.model.forward, self._wide
        n_modes = min(self.model.surrogate.n_modes, model.n_dofs)
        return forward.of(_seen(model, forward.sensors), n_modes)

    def _points_of_sizes(self) -> list[Mapping[str, float]]:
        """The nominal values and those of every effect at its expected size: what to span."""
        row = len(self.evidence.conditions) // 2
        points = [dict(self.model.baseline)]
        for signature in self.study.expected:
            values = self._values(signature.effect, signature.own, row)
            values = without_attached(values, self.model.baseline)
            if values not in points:
                points.append(values)
        return points

    def _values(self, effect: Effect, own: np.ndarray, row: int) -> dict[str, float]:
        hypothesis = self.test.hypothesis(effect)
        condition, base = float(self.evidence.conditions[row]), self.study.baseline(effect)
        return hypothesis.values(hypothesis.at(own), condition, base, row)

    @cached_property
    def _everywhere(self) -> Sensors:
        """Points all over the structure. Collective."""
        return self.model.surrogate.everywhere(_POINTS)

    # -- more of the same test ---------------------------------------------------------------

    def _conditions(self) -> list[Candidate]:
        data = self.model.data
        at = self.evidence.conditions
        effects = self._with_a_law() if len(at) == 1 else None
        depends = any(e.depends_on_condition for e in (effects or {}).values())
        depends |= any(e.depends_on_condition for e in self.study.effects)
        if not depends or np.any(at <= 0):
            return []
        found = []
        for value, word in ((at.min() / 2, "half the lowest"), (at.max() * 2, "twice the highest")):
            shown = condition_value(float(value), data.condition_unit)
            name = f"the same modes at {word} {data.condition_name} ({shown})"
            scatter = self.model.case.diagnose.preload_scatter if effects else None
            test = self._measurement(widened(self.evidence, 0, [value]), scatter=scatter)
            found.append(Candidate(name, test, effects))
        return found

    def _with_a_law(self) -> dict[str, Effect]:
        """Effects as they are when the test has a second torque too, by key."""
        m, at = self.model, float(self.evidence.conditions[0])
        if at <= 0 or m.data.by_level or m.data.condition_name == "row":
            return {}
        two = replace(
            m.data,
            conditions=np.array([at / 2, at]),
            damping=None,
            shapes=None,
            shapes_at=None,
            frequencies_hz=np.repeat(m.data.frequencies_hz, 2, axis=0),
        )
        effects, _ = case_effects(Setting(m.case, two, m.zones, m.dimensions))
        return {e.key: e for e in effects}

    def _damping(self) -> Iterator[Candidate]:
        data = self.model.data
        useful = any(e.loss is not None for e in self.study.effects)
        if data.damping is None and useful and not (data.by_level and len(data) < 2):
            noise = data.damping_noise or DAMPING_NOISE
            damping = np.full(data.frequencies_hz.shape, 1e-3)
            name = f"the damping ratios of the same modes, to {100 * noise:.3g} %"
            yield Candidate(name, self._of(replace(data, damping=damping, damping_noise=noise)))

    def _shapes(self) -> Iterator[Candidate]:
        data = self.model.data
        if data.shapes is None and data.sensors is not None:
            name = f"the mode shapes at the same {len(data.sensors)} sensors"
            shapes = self.model.surrogate.pairing.shapes
            yield Candidate(name, self._of(replace(data, shapes=shapes)))

    def _weighing(self) -> Iterator[Candidate]:
        """A scale under all of it."""
        m = self.model
        if not any(scalar.name == WHOLE for scalar in self.evidence.scalars):
            scale = on_a_scale(m.case, m.full, m.baseline)
            name = f"the mass of {scale.name}, to {100 * scale.sd:.3g} %"
            yield Candidate(name, self._with(scale))

    def _static(self) -> Iterator[Candidate]:
        """A force on a structure that is held, where it gives way most."""
        m, sensors = self.model, self.model.data.sensors
        if m.surrogate.nominal.n_rigid or self._has(STIFFNESS) or sensors is None:
            return
        best, stiffness = most_yielding(m.full, sensors, m.baseline)
        point = sensors.points[best]
        given = StaticTest.model_construct(
            point=point.tolist(), direction=sensors.directions[best].tolist(), stiffness=stiffness
        )
        name = f"the static stiffness at {point_mm(point)} mm, to {100 * given.noise:.3g} %"
        yield Candidate(name, self._with(*stiffness_at(m, {"planned": given})))

    def _driven(self) -> Iterator[Candidate]:
        """A force where all modes move, and the motion there."""
        m, sensors = self.model, self.model.data.sensors
        if self._has(FUNCTION) or sensors is None or not m.case.diagnose.frfs:
            return
        moved = np.abs(m.surrogate.pairing.shapes)
        best = int(np.argmax(np.mean(np.log(np.maximum(moved, 1e-9 * moved.max())), axis=1)))
        at = Sensors(sensors.points[best], sensors.directions[best])
        if lines := planned_function(m, at, self._everywhere):
            name = f"the function of a force and the motion at {point_mm(at.points[0])} mm"
            yield Candidate(name, self._with(*lines))

    # -- changes of the structure ------------------------------------------------------------

    def _shifted(self, name: str, other: ModalPrediction, *effects: Effect) -> Candidate:
        row = len(self.evidence.conditions) // 2
        test = shifted(self.test, self.evidence, self._wide_forward, other, row, effects)
        return Candidate(name, test)

    def _mass(self) -> list[Candidate]:
        """A known mass where it moves the frequencies of the undecided pairs most apart."""
        m, surrogate = self.model, self.model.surrogate
        mass = ADDED_MASS * surrogate.full.total_mass(m.baseline)
        places = (self._everywhere if m.data.sensors is None else m.data.sensors).points
        places = np.unique(places, axis=0)
        rows = surrogate.point_rows(self._wide, places)
        best = self._best_place(rows)
        if best is None:
            return []
        forward = self._wide_forward
        other = forward.of(loaded(forward.model, rows[best], mass))
        at = point_mm(places[best])
        grams = f"{1e3 * mass:.0f} g" if mass < 1 else f"{mass:.2f} kg"
        name = f"the shifts by a known mass of {grams} ({ADDED_MASS:.0%}) put on at {at} mm"
        return [self._shifted(name, other)]

    def _best_place(self, rows: np.ndarray) -> int | None:
        """By the first-order shift -m phi^2 / 2 of ln f for mass-normalised phi."""
        D = table(self.study)
        n = len(self.study.effects)
        pairs = [
            (i, j)
            for i in range(n)
            for j in range(n)
            if i != j and D[i, n] >= APART and D[i, j] < APART
        ]
        if not pairs:
            return None
        step = max(len(pairs) // _PAIRS, 1)
        total = np.zeros(len(rows))
        row = len(self.evidence.conditions) // 2
        for i, j in pairs[::step]:
            truth, rival = self.study.expected[i], self.study.effects[j]
            first = self._squares(rows, self._values(truth.effect, truth.own, row))
            near = self.study.near[i, j]
            total += np.linalg.norm(
                first - self._squares(rows, self._values(rival, near, row)), axis=1
            )
        return int(np.argmax(total))

    def _squares(self, rows: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Squared motion of the test's modes at points, 1/kg, (n_points, m)."""
        forward = self._wide_forward
        modes = solve_modes(forward.model, values, n_modes=forward.n_modes)
        pairing = forward.paired(modes)
        return np.sum((rows @ modes.shapes[:, pairing.index]) ** 2, axis=1)

    def _rig(self) -> Iterator[Candidate]:
        """The same structure without a roving mass, or on a softer suspension."""
        case, forward = self.model.case, self._wide_forward
        for name, section in case.attached.items():
            key = next(iter(section.nominal()))
            if key == "mass" and section.travel is None:
                continue  # part of the structure: it cannot be taken off
            factor = 0.0 if key == "mass" else _SOFTER
            what = "without the" if key == "mass" else f"with a {1 / _SOFTER:.0f} times softer"
            words = f"the shifts of the frequencies {what} {spaced(name)}"
            yield self._shifted(words, forward, altered(f"{name}.{key}", factor))
        for name in case.springs:
            softer = f"{1 / _SOFTER:.0f} times softer {spaced(name)}"
            words = f"the shifts of the frequencies with a {softer}"
            yield self._shifted(words, forward, altered(f"{name}.stiffness", _SOFTER))


def _seen(model: ArrayModel, sensors: Sensors | None) -> ArrayModel:
    """A model as plain arrays, with what sensors read of it. Collective."""
    rows = None if sensors is None else model.observe(np.eye(model.n_dofs), sensors)
    return ArrayModel(model.pencil, model.scale_hz, rows, hung=model.hung)
