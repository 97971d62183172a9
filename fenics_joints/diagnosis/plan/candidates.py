"""The measurements that could be added to a case's test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fenics_joints.case.test import StaticTest
from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.effects.library import case_effects
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.entries import FUNCTION, STIFFNESS
from fenics_joints.diagnosis.evidence.evidence import DAMPING_NOISE, Evidence
from fenics_joints.diagnosis.evidence.of_test import evidence_of
from fenics_joints.diagnosis.evidence.weighed import WHOLE, on_a_scale
from fenics_joints.diagnosis.model.at_points import stiffness_at
from fenics_joints.diagnosis.model.functions import planned_function
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.model.static import most_yielding
from fenics_joints.diagnosis.plan.added import (
    ADDED_MASS,
    MORE_MODES,
    Candidate,
    Joined,
    altered,
    loaded,
    measurement,
    missed_modes,
    next_modes,
    shifted,
    table,
    widened,
)
from fenics_joints.diagnosis.plan.study import Measurement, Study
from fenics_joints.diagnosis.zones.sites import without_attached
from fenics_joints.formatting import condition_value, point_mm, spaced
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction import ArrayModel, Forward
from fenics_joints.structure.points import Sensors

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
        found = [*self._modes(), *self._conditions(), *self._damping(), *self._shapes()]
        return [
            *found,
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
                forward = Forward(
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
    def _wide_forward(self) -> Forward:
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
        effects, _ = case_effects(m.case, two, m.zones, m.dimensions)
        return {e.key: e for e in effects}

    def _damping(self) -> list[Candidate]:
        data = self.model.data
        useful = any(e.loss is not None for e in self.study.effects)
        if data.damping is not None or not useful or (data.by_level and len(data) < 2):
            return []
        noise = data.damping_noise or DAMPING_NOISE
        damping = np.full(data.frequencies_hz.shape, 1e-3)
        evidence = evidence_of(
            replace(data, damping=damping, damping_noise=noise),
            self.evidence.discrepancy,
            scalars=self.evidence.scalars,
            mesh_error=self.evidence.mesh_error,
        )
        name = f"the damping ratios of the same modes, to {100 * noise:.3g} %"
        return [Candidate(name, self._measurement(evidence))]

    def _shapes(self) -> list[Candidate]:
        m = self.model
        if m.data.shapes is not None or m.data.sensors is None:
            return []
        shapes = m.surrogate.pairing.shapes
        evidence = evidence_of(
            replace(m.data, shapes=shapes),
            self.evidence.discrepancy,
            scalars=self.evidence.scalars,
            mesh_error=self.evidence.mesh_error,
        )
        name = f"the mode shapes at the same {len(m.data.sensors)} sensors"
        return [Candidate(name, self._measurement(evidence))]

    def _weighing(self) -> list[Candidate]:
        """A scale under all of it."""
        m, known = self.model, self.evidence.scalars
        if any(s.name == WHOLE for s in known):
            return []
        scale = on_a_scale(m.case, m.full, m.baseline)
        evidence = replace(self.evidence, scalars=(scale, *known))
        name = f"the mass of {scale.name}, to {100 * scale.sd:.3g} %"
        return [Candidate(name, self._measurement(evidence))]

    def _static(self) -> list[Candidate]:
        """A force on a structure that is held, where it gives way most."""
        m, known = self.model, self.evidence.scalars
        there = any(scalar.kind == STIFFNESS for scalar in known)
        if m.surrogate.nominal.n_rigid or there or m.data.sensors is None:
            return []
        best, stiffness = most_yielding(m.full, m.data.sensors, m.baseline)
        point, way = m.data.sensors.points[best], m.data.sensors.directions[best]
        given = StaticTest.model_construct(
            point=point.tolist(), direction=way.tolist(), stiffness=stiffness
        )
        evidence = replace(self.evidence, scalars=(*known, *stiffness_at(m, {"planned": given})))
        name = f"the static stiffness at {point_mm(point)} mm, to {100 * given.noise:.3g} %"
        return [Candidate(name, self._measurement(evidence))]

    def _driven(self) -> list[Candidate]:
        """A force where all modes move, and the motion there."""
        m, known = self.model, self.evidence.scalars
        there = any(scalar.kind == FUNCTION for scalar in known)
        if there or m.data.sensors is None or not m.case.diagnose.frfs:
            return []
        moved = np.abs(m.surrogate.pairing.shapes)
        best = int(np.argmax(np.mean(np.log(np.maximum(moved, 1e-9 * moved.max())), axis=1)))
        at = Sensors(m.data.sensors.points[best], m.data.sensors.directions[best])
        lines = planned_function(m, at, self._everywhere)
        if not lines:
            return []
        evidence = replace(self.evidence, scalars=(*known, *lines))
        name = f"the function of a force and the motion at {point_mm(at.points[0])} mm"
        return [Candidate(name, self._measurement(evidence))]

    # -- changes of the structure ------------------------------------------------------------

    def _shifted(self, name: str, other: Forward, *effects: Effect) -> Candidate:
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

    def _rig(self) -> list[Candidate]:
        """The same structure without a roving mass, or on a softer suspension."""
        case, forward = self.model.case, self._wide_forward
        found = []
        for name, section in case.attached.items():
            key = next(iter(section.nominal()))
            if key == "mass" and section.travel is None:
                continue  # part of the structure: it cannot be taken off
            factor = 0.0 if key == "mass" else _SOFTER
            what = "without the" if key == "mass" else f"with a {1 / _SOFTER:.0f} times softer"
            words = f"the shifts of the frequencies {what} {spaced(name)}"
            found.append(self._shifted(words, forward, altered(f"{name}.{key}", factor)))
        for name in case.springs:
            softer = f"{1 / _SOFTER:.0f} times softer {spaced(name)}"
            words = f"the shifts of the frequencies with a {softer}"
            found.append(self._shifted(words, forward, altered(f"{name}.stiffness", _SOFTER)))
        return found


def _seen(model: ArrayModel, sensors: Sensors | None) -> ArrayModel:
    """A model as plain arrays, with what sensors read of it. Collective."""
    rows = None if sensors is None else model.observe(np.eye(model.n_dofs), sensors)
    return ArrayModel(model.pencil, model.scale_hz, rows, hung=model.hung)
