"""What a test measured at single points: static stiffness, antiresonances and functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.case.test import AntiresonanceTest, StaticTest
from fenics_joints.diagnosis.evidence.entries import MASS
from fenics_joints.diagnosis.evidence.evidence import BEYOND, UNSURE, Evidence
from fenics_joints.diagnosis.evidence.observations import (
    Antiresonance,
    Observation,
    StaticStiffness,
)
from fenics_joints.diagnosis.model.functions import measured_functions, row_of
from fenics_joints.diagnosis.model.resolution import MOST
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.diagnosis.where.cells import StructureCells
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress
from fenics_joints.reduction.basis import Points
from fenics_joints.reduction.receptances import (
    Antiresonances,
    PointBasis,
    StaticModel,
    StaticSolver,
)
from fenics_joints.structure import Sensors, Structure

#: `fenics_joints.diagnosis.model.prepared.Prepared`, which asks for these.
Prepared = Any
#: Places all over the structure at which modes with a point held are compared. [numerical: chosen]
_PLACES = 40
#: Points at which the reduced model is checked in each round. [numerical: chosen]
_FRESH = 6
#: Distance in ln f within which an antiresonance is taken for the model's, once the model's are
#: shifted as the resonances nearby are. [decision: chosen]
_NEAR = 0.15


def measured_at_points(model: Prepared, progress: Progress) -> list[Observation]:
    """Static stiffnesses, antiresonances and functions of a case's test; the model's notes get
    what a reader must know of them. Collective; after the reduced model is made.

    Args:
        model: The case.
        progress: Told what is being done.

    Raises:
        InputError: See `stiffness_at` and `measured_functions`; and if an antiresonance is near
            none of the model's, or its point is beside the structure.
    """
    found, test = [], model.case.test
    if test is not None and test.stiffness:
        progress.step("static stiffness at samples of the parameters")
        found += stiffness_at(model, test.stiffness)
    if test is not None and test.antiresonances:
        progress.step("antiresonances at samples of the parameters")
        found += _antiresonances(model, test.antiresonances)
    frfs = model.case.frfs()
    if frfs is not None and model.case.diagnose.frfs:
        progress.step("FRFs at samples of the parameters")
        lines, notes = measured_functions(model, frfs, model.surrogate.everywhere(_PLACES))
        found += lines
        model.notes += notes
    return found


def _points(
    model: Prepared, table: str, given: Mapping[str, StaticTest | AntiresonanceTest]
) -> tuple[Sensors, list[int]]:
    """Where the sections of a table of the test measure, and the test's row of each."""
    names = tuple(f"test.{table}.{name}" for name in given)
    sections = given.values()
    rows = [
        row_of(model.case, name, s.at, model.data) for name, s in zip(names, sections, strict=True)
    ]
    return Sensors([s.point for s in sections], [s.direction for s in sections], names), rows


# -- static stiffness ------------------------------------------------------------------------------


def stiffness_at(model: Prepared, given: Mapping[str, StaticTest]) -> tuple[StaticStiffness, ...]:
    """Static stiffnesses that were measured, or would be. Collective.

    The error of any such model in a stiffness is twice that in a frequency.

    Args:
        model: The case.
        given: What was measured, by name; one at least.

    Raises:
        InputError: If the structure is free to move, a point is beside it, or a condition is none
            of the test's.
    """
    if n_rigid := model.surrogate.nominal.n_rigid:
        raise InputError(
            f"{model.case.path}: test.stiffness: the structure is free to move ({n_rigid} "
            "rigid-body modes): expected [supports] that hold it, as in the measurement"
        )
    at, rows = _points(model, "stiffness", given)
    noise = np.array([section.noise for section in given.values()])
    sd = np.hypot(noise, 2 * model.evidence.discrepancy)
    if model.full.is_dense:
        reduced, mesh = StaticModel(model.full.arrays(at)), np.zeros(len(given))
    else:
        reduced, mesh = _reduced(model, at, NEGLIGIBLE * sd.min())
    sd = np.hypot(sd, UNSURE * mesh)
    return tuple(
        StaticStiffness(
            name=name,
            measured=section.stiffness,
            sd=float(sd[i]),
            row=rows[i],
            model=reduced,
            index=i,
            mesh=float((1 + BEYOND) * mesh[i]),
        )
        for i, (name, section) in enumerate(given.items())
    )


def _reduced(model: Prepared, at: Sensors, tolerance: float) -> tuple[StaticModel, np.ndarray]:
    """The reduced model, and ln of how much too stiff the mesh makes each, (n,)."""
    full, (samples, travel) = model.full, model.to_span()
    twice = model.samples(2 * model.case.diagnose.samples)
    more = [values for values in twice if values not in samples]
    solver = StaticSolver(full, at)

    def fresh(turn: int) -> Points:
        return more[turn * _FRESH : (turn + 1) * _FRESH]

    reduced = StaticModel.made(solver, samples, travel, tolerance, fresh)
    solver.destroy()
    finer = full.finer() if model.case.diagnose.mesh_error and full.is_meshed else None
    if finer is None or finer.n_dofs > MOST:
        return reduced, np.zeros(len(at))
    better = StaticSolver(finer, at)
    # The baseline is the first of the samples: there the reduced model is the full one.
    mesh = better(model.baseline)[0] - reduced.log_compliance(model.baseline)
    better.destroy()
    return reduced, mesh


def most_yielding(full: Structure | BeamStructure, sensors: Sensors, baseline) -> tuple[int, float]:
    """The sensor at which a held structure is softest, and its stiffness there, N/m. Collective."""
    if full.is_dense:
        found = StaticModel(full.arrays(sensors)).log_compliance(baseline)
    else:
        solver = StaticSolver(full, sensors)
        found = solver(baseline)[0]
        solver.destroy()
    best = int(np.argmax(found))
    return best, float(np.exp(-found[best]))


# -- antiresonances --------------------------------------------------------------------------------


def _antiresonances(model: Prepared, given: Mapping[str, AntiresonanceTest]) -> list[Antiresonance]:
    """What ``[test.antiresonances]`` says. Collective."""
    evidence, n_modes = model.evidence, model.case.diagnose.n_modes
    at, rows = _points(model, "antiresonances", given)
    if model.full.is_meshed:
        model.full.rows(at.points, "antiresonance", at.names)  # whether they are on the mesh
    samples, travel = model.to_span()
    everywhere = model.surrogate.everywhere(_PLACES)
    nominal = model.forward(model.baseline)[0]
    basis = PointBasis(model.full, at, everywhere, samples, n_modes, travel)
    found = []
    for i, (name, s) in enumerate(zip(at.names, given.values(), strict=True)):
        zeros, log_f = (
            Antiresonances(basis, i, model.baseline, n_modes),
            np.log(sorted(s.frequencies)),
        )
        tested = np.log(model.data.frequencies_hz[rows[i]])
        which = paired_zeros(log_f, zeros.log_f, tested, nominal)
        if which is None:
            there = ", ".join(f"{hz:.4g}" for hz in np.exp(zeros.log_f))
            raise InputError(
                f"{model.case.path}: {name}.frequencies: expected such as the model has at this "
                f"point, {there} Hz, each at most {_NEAR:.0%} off once all frequencies are moved "
                "as the test's are"
            )
        zeros.follow(which)
        mesh = _of_mesh(zeros.log_f[which], evidence, nominal)
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
    return found


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
        nominal: ln f of the model's, (m,).
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
    """How much too high the mesh makes antiresonances, interpolated from the test's modes."""
    if evidence.mesh_shift is None:
        return np.zeros(len(log_f))
    order = np.argsort(nominal)
    return np.interp(log_f, nominal[order], evidence.mesh_shift[order])


# -- by patches ------------------------------------------------------------------------------------


def by_patches(
    measured: Sequence,
    cells: StructureCells,
    split: Patches,
    baseline: Mapping[str, float],
    soft: Mapping[str, float],
) -> tuple:
    """The same numbers, with what a change of each patch does to them. Collective.

    Changes of a joint's patches are those of a model with compliant joints, as in
    `fenics_joints.diagnosis.where.patches`.

    Args:
        measured: All single numbers.
        cells: The full model's cells.
        split: The patches.
        baseline: Parameter values of the nominal model.
        soft: Those with all joints compliant.
    """
    of_joint = np.array([region in cells.joints for region in split.region], dtype=bool)
    size = np.array([EXPECTED["E"], EXPECTED["rho"]])[:, None]

    def energies(x, omega: float, values) -> np.ndarray:
        both = cells.energies(x, omega, values)
        return np.array([cells.sums(split.number, each, len(split)) for each in both])

    # All at one model, then all at the other: some remember the model of their last call.
    placed = [s for s in measured if s.kind != MASS]
    changes = {s: size * s.by_logs(energies, baseline) for s in placed}
    if of_joint.any():
        for scalar in placed:
            try:
                with_compliant_joints = scalar.by_logs(energies, soft)[:, of_joint]
            except InputError:
                continue  # the compliant model lacks it: the change with stiff joints stays
            changes[scalar][:, of_joint] = np.array([[-1.0], [0.0]]) * with_compliant_joints
    return tuple(replace(s, patches=changes[s]) if s.kind != MASS else s for s in measured)
