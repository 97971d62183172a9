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
from fenics_joints.structure.points import Sensors

#: Added mass, as a share of the structure's. [decision: chosen]
ADDED_MASS = 0.05
#: Further modes of each kind that a longer test would see. [decision: chosen]
MORE_MODES = 3
#: Points, spread over the structure, at which modes are compared. [numerical: chosen]
_POINTS = 24
#: Stiffness of a suspension that a test could have instead, over the present one's. [decision:
#: chosen]
_SOFTER = 0.1
#: Pairs that decide where a mass is put. [numerical: chosen for time]
_PAIRS = 12


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
        factor: Factor on its value; 0 removes the mass or spring.
    """

    def apply(values, theta, condition):
        values[name] = factor * values[name]

    return Effect(f"{name} altered", "", (), apply)


def measured_by(
    model: Prepared,
    evidence: Evidence,
    forward: ModalPrediction | None = None,
    *,
    other_modes: bool = False,
    **changes,
) -> Measurement:
    """A test of a case as a `Measurement`.

    Args:
        model: The case.
        evidence: The test's layout, noise and discrepancy; its values do not count, unless they are
            nan.
        forward: Predicts frequencies and shapes; the model's own by default.
        other_modes: Whether its modes are not those of the planned test, in which some may be
            exchanged or missed.
        changes: Of the `Hypothesis` without effects.
    """
    used, forward = evidence.fitted, forward or model.forward

    def predicted(hypothesis, z, baseline):
        if other_modes:
            read = tuple(replace(e, sensing=None) for e in hypothesis.effects)
            hypothesis = replace(hypothesis, effects=read)
        values, slopes = ManyPredictions(hypothesis, forward, evidence, baseline).at(z)
        return values[used], slopes[used]

    bare = model.hypothesis((), evidence, **changes)
    return Measurement(bare, predicted, evidence.covariance())


# -- what they are worth ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidate:
    """A test with one more measurement.

    Attributes:
        name: The measurement, in words.
        test: The test with it.
        effects: Effects that have another form in this test, by their key: with a law over the
            torque where the planned test has one torque only.
    """

    name: str
    test: Measurement
    effects: Mapping[str, Effect] | None = None


@dataclass(frozen=True)
class Addition:
    """What a measurement would add.

    Attributes:
        measurement: The measurement, in words.
        apart: How many causes or classes of causes the test would then tell apart.
        seen: How many effects it would see.
        mean_gain: Mean gain of D over the pairs that the planned test leaves together.
        largest_gain: The largest.
        pair: The pair of that: the effect at work, and the one it is taken for (or "no gap").
    """

    measurement: str
    apart: int
    seen: int
    mean_gain: float
    largest_gain: float
    pair: tuple[str, str]


def rank(
    study: Study, candidates: Sequence[Candidate], progress: Callable[[], None] | None = None
) -> list[Addition]:
    """What each candidate adds to a planned test, the most telling first.

    For every pair of effects that the test leaves together the nearest prediction of the one to
    the other is sought again, with all the freedom it had: the gain is what no other parameters
    can explain.

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
    return sorted(found, key=lambda a: (-a.apart, -a.seen, -a.mean_gain))


def _worth(study: Study, candidate: Candidate) -> Addition:
    before, n = study.table, len(study.effects)
    changed = candidate.effects or {}
    richer = study.of(candidate.test, [changed.get(e.key, e) for e in study.effects])

    @cache
    def truth(i: int) -> Signature:
        """The signature of the same size in the richer test."""
        effect, own = richer.effects[i], study.expected[i].own
        return richer.signature(effect, _by_name(study.effects[i], own, effect))

    def again(i: int, j: int) -> float:
        """D of a pair in the richer test; ``j`` beyond the effects is "no gap"."""
        if j == n:
            return truth(i).d / 2
        rival = richer.effects[j]
        start = _by_name(study.effects[j], study.near[i, j], rival)
        return richer.distance(truth(i), rival, start)

    after = before.copy()

    def look(pairs: Sequence[tuple[int, int]]) -> None:
        for i, j in pairs:
            after[i, j] = max(before[i, j], again(i, j))

    # All from an effect that is not seen is near: first whether it is seen now.
    unseen = [(i, n) for i in np.flatnonzero(before[:, n] < APART)]
    look(unseen)
    seen = after[:, n] >= APART
    near = (before[:, :n] < APART) & np.outer(seen, seen) & ~np.eye(n, dtype=bool)
    together = list(zip(*np.nonzero(near), strict=True))
    look(together)
    gains = {pair: after[pair] - before[pair] for pair in [*together, *unseen]} or {(0, n): 0.0}
    best, names = max(gains, key=gains.__getitem__), [*(e.key for e in study.effects), "no gap"]
    return Addition(
        candidate.name,
        len(groups(after[:, :n], seen)),
        int(seen.sum()),
        float(np.mean(list(gains.values()))),
        float(gains[best]),
        (names[best[0]], names[best[1]]),
    )


def _by_name(old: Effect, own: np.ndarray, new: Effect) -> np.ndarray:
    """Parameters for an effect that may have more of them, in prior standard deviations."""
    values = {prior.name: z for prior, z in zip(old.priors, own, strict=True)}
    return np.array([values.get(prior.name, 0.0) for prior in new.priors])


# -- what there is ---------------------------------------------------------------------------------


class Candidates:
    """Tests with one more measurement each.

    Args:
        model: The prepared diagnosis: case, data, effects, nuisances, surrogate, forward.
        evidence: The planned test.
        study: Its signatures and distances.
    """

    def __init__(self, model: Prepared, evidence: Evidence, study: Study):
        self.model, self.evidence, self.study = model, evidence, study
        #: The condition at which single models are compared.
        self._row = len(evidence.conditions) // 2

    def all(self) -> list[Candidate]:
        """Every measurement that this case can offer. Collective."""
        return [
            *self._modes(),
            *self._conditions(),
            *self._damping(),
            *self._shapes(),
            *self._single_numbers(),
            *self._mass(),
            *self._rig(),
        ]

    # -- more of the same test ---------------------------------------------------------------

    def _modes(self) -> Iterator[Candidate]:
        """The next modes, and those that the sensors miss."""
        surrogate, reduced = self.model.surrogate, self._wide
        modes = solve_modes(
            reduced, self.model.baseline, n_modes=min(surrogate.n_modes, reduced.n_dofs)
        )
        own = self.model.forward.paired(modes)
        elastic = np.arange(modes.n_rigid, len(modes))
        seen = np.isin(elastic, own.visible)
        shapes, moves = modes.at(self._everywhere), modes.visibility(self._everywhere)[elastic]
        there = ~np.isin(elastic, own.index) & (moves > VISIBLE)
        for which, words in (
            (seen, next_modes),
            (~seen, lambda n: missed_modes(n, surrogate.unseen)),
        ):
            index = elastic[which & there][:MORE_MODES]
            if len(index):
                forward = ModalPrediction(
                    _seen(reduced, self._everywhere),
                    self._everywhere,
                    len(index),
                    len(modes),
                    reference=shapes[:, index],
                )
                yield Candidate(words(len(index)), self._with_frequencies(forward, len(index)))

    def _with_frequencies(self, forward: ModalPrediction, n: int) -> Measurement:
        """The test with the frequencies of ``n`` modes that were not in it.

        In a test by level they are measured at the first level alone, since nobody knows how much
        they move the joint at the others.
        """
        e = self.evidence
        frequencies, error = np.zeros((len(e.conditions), n)), e.mesh_error
        if self.model.data.by_level:
            frequencies[1:] = np.nan
        more = replace(
            e,
            log_f=frequencies,
            log_sd=np.full(frequencies.shape, np.nanmedian(e.log_sd)),
            used=np.isfinite(frequencies),
            log_damping=None,
            shapes=None,
            scalars=(),
            mesh_error=None if error is None else np.full(n, error.max()),
        )
        further = measured_by(self.model, more, forward, other_modes=True)
        return self.study.test.beside(further.predict, further.covariance)

    def _conditions(self) -> Iterator[Candidate]:
        data, e = self.model.data, self.evidence
        at, ratios = e.conditions, e.log_damping
        effects = self._with_a_law() if len(at) == 1 else None
        known = [*self.study.effects, *(effects or {}).values()]
        if not any(effect.depends_on_condition for effect in known) or np.any(at <= 0):
            return
        changes = {"scatter": self.model.case.diagnose.preload_scatter} if effects else {}
        for value, word in ((at.min() / 2, "half the lowest"), (at.max() * 2, "twice the highest")):
            more = replace(
                e,
                conditions=np.append(at, value),
                log_f=np.pad(e.log_f, [(0, 1), (0, 0)]),
                log_sd=np.vstack([e.log_sd, np.nanmedian(e.log_sd, axis=0)]),
                used=np.pad(e.used, [(0, 1), (0, 0)], constant_values=True),
                known=(*e.known, {}) if e.known else (),
                log_damping=None if ratios is None else np.pad(ratios, [(0, 1), (0, 0)]),
            )
            shown = condition_value(float(value), data.condition_unit)
            name = f"the same modes at {word} {data.condition_name} ({shown})"
            yield Candidate(name, measured_by(self.model, more, **changes), effects)

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

    def _of(self, data: TestData) -> Measurement:
        """A test that measures other quantities of the same modes."""
        e = self.evidence
        found = evidence_of(data, e.discrepancy, scalars=e.scalars, mesh_error=e.mesh_error)
        return measured_by(self.model, found)

    # -- single numbers ----------------------------------------------------------------------

    def _single_numbers(self) -> Iterator[Candidate]:
        """The mass of the whole structure; the static stiffness of a held one where it is softest;
        and a frequency response function at a point where all modes move."""
        m, e, sensors = self.model, self.evidence, self.model.data.sensors
        kinds = {scalar.kind for scalar in e.scalars}
        found: dict[str, Sequence[Observation]] = {}
        if not any(scalar.name == WHOLE for scalar in e.scalars):
            scale = on_a_scale(m.case, m.full, m.baseline)
            found[f"the mass of {scale.name}, to {100 * scale.sd:.3g} %"] = [scale]
        if sensors is not None and not m.surrogate.nominal.n_rigid and STIFFNESS not in kinds:
            best, stiffness = most_yielding(m.full, sensors, m.baseline)
            point, way = sensors.points[best].tolist(), sensors.directions[best].tolist()
            given = StaticTest.model_construct(point=point, direction=way, stiffness=stiffness)
            name = f"the static stiffness at {point_mm(point)} mm, to {100 * given.noise:.3g} %"
            found[name] = stiffness_at(m, {"planned": given})
        if sensors is not None and m.case.diagnose.frfs and FUNCTION not in kinds:
            moved = np.abs(m.surrogate.pairing.shapes)
            all_move = np.mean(np.log(np.maximum(moved, 1e-9 * moved.max())), axis=1)
            best = int(np.argmax(all_move))
            at = Sensors(sensors.points[best], sensors.directions[best])
            name = f"the driving-point FRF at {point_mm(at.points[0])} mm"
            found[name] = planned_function(m, at, self._everywhere)
        for name, more in found.items():
            if more:
                test = measured_by(m, replace(e, scalars=(*e.scalars, *more)))
                yield Candidate(name, test)

    # -- changes of the structure ------------------------------------------------------------

    @cached_property
    def _everywhere(self) -> Sensors:
        """Points all over the structure. Collective."""
        return self.model.surrogate.everywhere(_POINTS)

    @cached_property
    def _wide(self) -> ArrayModel:
        """A reduced model with all modes, whether the test sees them or not, at the nominal values
        and with every effect of its expected size. Collective."""
        points, baseline = [dict(self.model.baseline)], self.model.baseline
        for signature in self.study.expected:
            values = self._values(signature.effect, signature.own)
            values = without_attached(values, baseline)
            if values not in points:
                points.append(values)
        return self.model.surrogate.wide(points)

    @cached_property
    def _wide_forward(self) -> ModalPrediction:
        """The test's modes from it."""
        forward, model = self.model.forward, self._wide
        n_modes = min(self.model.surrogate.n_modes, model.n_dofs)
        return forward.of(_seen(model, forward.sensors), n_modes)

    def _values(self, effect: Effect, own: np.ndarray) -> dict[str, float]:
        """The model's parameter values with an effect."""
        hypothesis = self.study.test.hypothesis(effect)
        condition, base = float(self.evidence.conditions[self._row]), self.study.baseline(effect)
        return hypothesis.values(hypothesis.at(own), condition, base, self._row)

    def _shifted(self, name: str, other: ModalPrediction, *effects: Effect) -> Candidate:
        """The test and, at one of its conditions, the shifts of its frequencies by a known change.

        The discrepancy cancels in a shift of the same mode, between measurements without a new
        tightening; the noise counts twice.

        Args:
            name: In words.
            other: Frequencies of the changed structure.
            effects: Without parameters: what else is changed.
        """
        row, e, forward = self._row, self.evidence, self._wide_forward
        there = np.flatnonzero(e.used[row])
        entries = row * e.shape[1] + there
        plain = replace(e, log_damping=None, shapes=None, scalars=())

        def shifts(hypothesis, z, baseline):
            changed = replace(hypothesis, effects=(*hypothesis.effects, *effects))
            before, after = (
                ManyPredictions(h, f, plain, baseline).at(z)
                for h, f in ((hypothesis, forward), (changed, other))
            )
            return tuple((b - a)[entries] for a, b in zip(before, after, strict=True))

        covariance = np.diag(2 * e.log_sd[row, there] ** 2)
        return Candidate(name, self.study.test.beside(shifts, covariance))

    def _mass(self) -> Iterator[Candidate]:
        """A known mass where it moves the frequencies of the undecided pairs most apart."""
        m, surrogate = self.model, self.model.surrogate
        mass = ADDED_MASS * surrogate.full.total_mass(m.baseline)
        places = (self._everywhere if m.data.sensors is None else m.data.sensors).points
        places = np.unique(places, axis=0)
        rows = surrogate.point_rows(self._wide, places)
        best = self._best_place(rows)
        if best is not None:
            forward = self._wide_forward
            other = forward.of(loaded(forward.model, rows[best], mass))
            grams = f"{1e3 * mass:.0f} g" if mass < 1 else f"{mass:.2f} kg"
            at = f"({ADDED_MASS:.0%}) at {point_mm(places[best])} mm"
            yield self._shifted(f"the frequency shifts due to a known mass of {grams} {at}", other)

    def _best_place(self, rows: np.ndarray) -> int | None:
        """By the first-order shift -m phi^2 / 2 of ln f for mass-normalised phi."""
        D, n = self.study.table, len(self.study.effects)
        near = (D[:, :n] < APART) & (D[:, n:] >= APART) & ~np.eye(n, dtype=bool)
        pairs = np.argwhere(near).tolist()
        if not pairs:
            return None
        total = np.zeros(len(rows))
        for i, j in pairs[:: max(len(pairs) // _PAIRS, 1)]:
            truth, rival = self.study.expected[i], self.study.effects[j]
            first = self._squares(rows, self._values(truth.effect, truth.own))
            other = self._squares(rows, self._values(rival, self.study.near[i, j]))
            total += np.linalg.norm(first - other, axis=1)
        return int(np.argmax(total))

    def _squares(self, rows: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Squared motion of the test's modes at points, 1/kg, (n_points, m)."""
        modes, pairing = self._wide_forward.solve(values)
        return np.sum((rows @ modes.shapes[:, pairing.index]) ** 2, axis=1)

    def _rig(self) -> Iterator[Candidate]:
        """The same structure without a roving mass, or on a softer suspension."""
        case, softer = self.model.case, f"with a {1 / _SOFTER:.0f} times softer"
        changes = []
        for name, section in case.attached.items():
            key = next(iter(section.nominal()))
            if key != "mass":
                changes.append((f"{name}.{key}", _SOFTER, softer))
            elif section.travel is not None:  # else it is a part of the structure
                changes.append((f"{name}.mass", 0.0, "without the"))
        changes += [(f"{name}.stiffness", _SOFTER, softer) for name in case.springs]
        for name, factor, how in changes:
            words = f"the frequency shifts {how} {spaced(name.rpartition('.')[0])}"
            yield self._shifted(words, self._wide_forward, altered(name, factor))


def _seen(model: ArrayModel, sensors: Sensors | None) -> ArrayModel:
    """A model as plain arrays, with what sensors read of it. Collective."""
    rows = None if sensors is None else model.observe(np.eye(model.n_dofs), sensors)
    return ArrayModel(model.pencil, model.scale_hz, rows, hung=model.hung)
