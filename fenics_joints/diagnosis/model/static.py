"""Static stiffnesses of a case's test, and a reduced model that predicts them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.case import Case
from fenics_joints.case.test import StaticTest
from fenics_joints.diagnosis.evidence.evidence import BEYOND, UNSURE
from fenics_joints.diagnosis.evidence.stiffness import StaticStiffness
from fenics_joints.diagnosis.model.resolution import MOST
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.static import StaticModel, StaticSolver
from fenics_joints.structure import Sensors, Structure

#: Points of a round at which the reduced model is looked at. [numerical: chosen]
_FRESH = 6


def static_stiffness(
    case: Case,
    full: Structure | BeamStructure,
    data: TestData,
    baseline: Mapping[str, float],
    given: Mapping[str, StaticTest],
    *,
    n_rigid: int,
    discrepancy: float,
    samples: Points,
    more: Points,
    travel: Mapping | None,
) -> tuple[StaticStiffness, ...]:
    """What ``[test.stiffness]`` says, or a planned one. Collective.

    The error of any such model in a stiffness is twice that in a frequency.

    Args:
        case: The case.
        full: Its nominal model.
        data: The test.
        baseline: That model's parameter values.
        given: What was measured, by name; one at least.
        n_rigid: The nominal model's rigid-body modes.
        discrepancy: Error of any such model in a frequency.
        samples: Parameter values at which the reduced model is made, the baseline first.
        more: Others, at which it is looked at and made better.
        travel: See `fenics_joints.reduction.reduced.ReducedStructure`.

    Raises:
        InputError: If the structure is free to move, a point is beside it, or a condition is none
            of the test's.
    """
    if n_rigid:
        raise InputError(
            f"{case.path}: test.stiffness: the structure is free to move ({n_rigid} rigid-body "
            "modes): expected [supports] that hold it, as in the measurement"
        )
    sections = list(given.values())
    names = tuple(f"test.stiffness.{name}" for name in given)
    rows = [row_of(case, name, s.at, data) for name, s in zip(names, sections, strict=True)]
    at = Sensors([s.point for s in sections], [s.direction for s in sections], names)
    noise = np.array([s.noise for s in sections])
    sd = np.hypot(noise, 2 * discrepancy)
    if full.is_dense:
        model, mesh = StaticModel(full.arrays(at)), np.zeros(len(sections))
    else:
        tolerance = NEGLIGIBLE * sd.min()
        model, mesh = _reduced(case, full, at, baseline, samples, more, travel, tolerance)
    sd = np.hypot(sd, UNSURE * mesh)
    return tuple(
        StaticStiffness(
            name=name,
            measured=s.stiffness,
            sd=float(sd[i]),
            row=rows[i],
            model=model,
            index=i,
            mesh=float((1 + BEYOND) * mesh[i]),
        )
        for i, (name, s) in enumerate(zip(given, sections, strict=True))
    )


def most_yielding(full: Structure | BeamStructure, sensors: Sensors, baseline) -> tuple[int, float]:
    """The sensor at which a held structure gives way most, and its stiffness there, N/m.
    Collective."""
    if full.is_dense:
        found = StaticModel(full.arrays(sensors)).log_compliance(baseline)
    else:
        solver = StaticSolver(full, sensors)
        found = solver(baseline)[0]
        solver.destroy()
    best = int(np.argmax(found))
    return best, float(np.exp(-found[best]))


def _reduced(case: Case, full, at, baseline, samples, more, travel, tolerance: float):
    """The reduced model, and ln of how much too stiff the mesh makes each, (n,)."""
    solver = StaticSolver(full, at)

    def fresh(turn: int) -> Points:
        return more[turn * _FRESH : (turn + 1) * _FRESH]

    model = StaticModel.made(solver, samples, travel, tolerance, fresh)
    solver.destroy()
    finer = full.finer() if case.diagnose.mesh_error and full.is_meshed else None
    if finer is None or finer.n_dofs > MOST:
        return model, np.zeros(len(at))
    better = StaticSolver(finer, at)
    # The baseline is the first of the samples: there the reduced model is the full one.
    mesh = better(baseline)[0] - model.log_compliance(baseline)
    better.destroy()
    return model, mesh


def row_of(case: Case, name: str, at: float | None, data: TestData) -> int:
    """The test's row of a condition, those after a known change left out.

    Args:
        case: The case.
        name: Of the section that says it.
        at: The condition; None for the last one.
        data: The test.

    Raises:
        InputError: If it is none of the test's.
    """
    own = np.flatnonzero([not known for known in data.known] or np.ones(len(data), dtype=bool))
    if at is None:
        return int(own[-1])
    near = own[np.isclose(data.conditions[own], at)]
    if not len(near):
        there = ", ".join(f"{c:g}" for c in data.conditions[own])
        raise InputError(
            f"{case.path}: {name}.at = {at:g}: expected a condition of the test: {there}"
        )
    return int(near[0])
