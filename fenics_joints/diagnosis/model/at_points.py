"""What a test measured at single points: static stiffness, antiresonances and functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.case import Case
from fenics_joints.case.test import AntiresonanceTest, StaticTest
from fenics_joints.diagnosis.evidence.evidence import BEYOND, UNSURE, Evidence
from fenics_joints.diagnosis.evidence.observations import (
    Antiresonance,
    AtPoint,
    Scalar,
    StaticStiffness,
)
from fenics_joints.diagnosis.model.functions import measured_functions, row_of
from fenics_joints.diagnosis.model.resolution import MOST
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.grounded import Antiresonances, PointBasis
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


#: How far an antiresonance may be, in ln f, from the model's after what the test's frequencies say
#: of all modes thereabouts; beyond, it is another's. [decision: chosen]
_NEAR = 0.15


def antiresonances(
    case: Case,
    full: Structure | BeamStructure,
    data: TestData,
    evidence: Evidence,
    baseline: Mapping[str, float],
    given: Mapping[str, AntiresonanceTest],
    *,
    nominal_log_f: np.ndarray,
    everywhere: Sensors,
    samples: Points,
    travel: Mapping | None,
) -> tuple[Antiresonance, ...]:
    """What ``[test.antiresonances]`` says. Collective.

    Args:
        case: The case.
        full: Its nominal model.
        data: The test.
        evidence: The same, with the mesh's errors.
        baseline: The nominal model's parameter values.
        given: What was measured, by name; one at least.
        nominal_log_f: ln of the test's modes of the nominal model, (m,).
        everywhere: Places by whose motion modes are told.
        samples: Parameter values at which the reduced model is made, the baseline first.
        travel: See `fenics_joints.reduction.reduced.ReducedStructure`.

    Raises:
        InputError: If a point is beside the structure, a condition none of the test's, or a
            frequency near none of the model's.
    """
    sections, n_modes = list(given.values()), case.diagnose.n_modes
    names = tuple(f"test.antiresonances.{name}" for name in given)
    rows = [row_of(case, name, s.at, data) for name, s in zip(names, sections, strict=True)]
    at = Sensors([s.point for s in sections], [s.direction for s in sections], names)
    if full.is_meshed:
        full.rows(at.points, "antiresonance", names)  # whether they are on the mesh
    basis = PointBasis(full, at, everywhere, samples, n_modes, travel)
    found = []
    for i, (name, s) in enumerate(zip(names, sections, strict=True)):
        zeros, log_f = Antiresonances(basis, i, baseline, n_modes), np.log(sorted(s.frequencies))
        which = paired_zeros(
            log_f, zeros.log_f, np.log(data.frequencies_hz[rows[i]]), nominal_log_f
        )
        if which is None:
            there = ", ".join(f"{hz:.4g}" for hz in np.exp(zeros.log_f))
            raise InputError(
                f"{case.path}: {name}.frequencies: expected such as the model has at this point, "
                f"{there} Hz, each at most {_NEAR:.0%} off once all frequencies are moved as the "
                "test's are"
            )
        zeros.follow(which)
        mesh = _of_mesh(zeros.log_f[which], evidence, nominal_log_f)
        sd = np.sqrt(s.noise**2 + evidence.discrepancy**2 + (UNSURE * mesh / (1 + BEYOND)) ** 2)
        found += [
            Antiresonance(
                name=name,
                measured=float(np.exp(f)),
                sd=float(sd[k]),
                row=rows[i],
                zeros=zeros,
                index=k,
                mesh=float(mesh[k]),
            )
            for k, f in enumerate(log_f)
        ]
    return tuple(found)


def paired_zeros(
    measured: np.ndarray, zeros: np.ndarray, tested: np.ndarray, nominal: np.ndarray
) -> np.ndarray | None:
    """Which of a model's antiresonances the measured ones are, (k,); None where one is near none.

    A model that is stiffer as a whole has all of them higher, and its resonances too: so they are
    compared after those have been moved onto each other.

    Args:
        measured: ln f of the measured, ascending, (k,).
        zeros: ln f of the model's, ascending.
        tested: ln f of the test's resonances, (m,); nan where missing.
        nominal: ln f of these in the model, (m,).
    """
    there = np.flatnonzero(np.isfinite(tested))
    order = there[np.argsort(tested[there])]
    shift = np.interp(measured, tested[order], (nominal - tested)[order]) if len(order) else 0.0
    away = np.abs((measured + shift)[:, None] - zeros)
    if len(measured) > len(zeros):
        return None
    _, which = linear_sum_assignment(away)
    return which if np.all(away[range(len(measured)), which] <= _NEAR) else None


def _of_mesh(log_f: np.ndarray, evidence: Evidence, nominal: np.ndarray) -> np.ndarray:
    """How much too high the mesh makes antiresonances, as it does the test's modes thereabouts."""
    if evidence.mesh_shift is None:
        return np.zeros(len(log_f))
    order = np.argsort(nominal)
    return np.interp(log_f, nominal[order], evidence.mesh_shift[order])


#: `fenics_joints.diagnosis.model.prepared.Prepared`, which asks for these.
Prepared = Any
#: Places all over the structure by which modes with a point held are told. [numerical: chosen]
_PLACES = 40


def measured_at_points(model: Prepared, progress: Progress) -> list[Scalar]:
    """Static stiffnesses, antiresonances and functions of a case's test, with what is to be said of
    them in the model's notes. Collective; after the reduced model is made.

    Args:
        model: The case.
        progress: Told what is being done.

    Raises:
        InputError: See `static_stiffness`, `antiresonances` and `measured_functions`.
    """
    found, test = [], model.case.test
    if test is not None and test.stiffness:
        progress.step("static stiffness at samples of the parameters")
        found += stiffness_at(model, test.stiffness)
    if test is not None and test.antiresonances:
        progress.step("antiresonances at samples of the parameters")
        found += _antiresonances_at(model, test.antiresonances)
    frfs = model.case.frfs()
    if frfs is not None and model.case.diagnose.frfs:
        progress.step("functions at samples of the parameters")
        lines, notes = measured_functions(model, frfs, model.surrogate.everywhere(_PLACES))
        found += lines
        model.notes += notes
    return found


def stiffness_at(model: Prepared, given: Mapping[str, StaticTest]) -> tuple[StaticStiffness, ...]:
    """Static stiffnesses that were measured, or would be. Collective.

    Args:
        model: The case.
        given: What was measured, by name.
    """
    (samples, travel), more = model.to_span(), []
    if samples:
        twice = model.samples(2 * model.case.diagnose.samples)
        more = [values for values in twice if values not in samples]
    return static_stiffness(
        model.case,
        model.full,
        model.data,
        model.baseline,
        given,
        n_rigid=model.surrogate.nominal.n_rigid,
        discrepancy=model.evidence.discrepancy,
        samples=samples,
        more=more,
        travel=travel,
    )


def _antiresonances_at(
    model: Prepared, given: Mapping[str, AntiresonanceTest]
) -> tuple[Antiresonance, ...]:
    seen, (samples, travel) = model.surrogate, model.to_span()
    return antiresonances(
        model.case,
        model.full,
        model.data,
        model.evidence,
        model.baseline,
        given,
        nominal_log_f=seen.forward(model.baseline)[0],
        everywhere=seen.everywhere(_PLACES),
        samples=samples,
        travel=travel,
    )


def by_patches(
    measured: Sequence,
    cells: Cells,
    split: Patches,
    baseline: Mapping[str, float],
    soft: Mapping[str, float],
) -> tuple:
    """The same numbers, with what a change of each patch does to them. Collective.

    A patch of a joint is taken where all joints give way, as in
    `fenics_joints.diagnosis.where.patches`.

    Args:
        measured: All single numbers.
        cells: The full model's cells.
        split: The patches.
        baseline: Parameter values of the nominal model.
        soft: Those with all joints giving way.
    """
    of_joint = np.array([region in cells.joints for region in split.region], dtype=bool)
    size = np.array([EXPECTED["E"], EXPECTED["rho"]])[:, None]

    def energies(x, omega: float, values) -> np.ndarray:
        both = cells.energies(x, omega, values)
        return np.array([cells.sums(split.number, each, len(split)) for each in both])

    # All at one model, then all at the other: some know what the model was last.
    placed = [s for s in measured if isinstance(s, AtPoint)]
    changes = {s: size * s.by_logs(energies, baseline) for s in placed}
    if of_joint.any():
        for scalar in placed:
            try:
                given_way = scalar.by_logs(energies, soft)[:, of_joint]
            except InputError:
                continue  # the model has it no more: what stiff joints say stays
            changes[scalar][:, of_joint] = np.array([[-1.0], [0.0]]) * given_way
    return tuple(replace(s, patches=changes[s]) if isinstance(s, AtPoint) else s for s in measured)
