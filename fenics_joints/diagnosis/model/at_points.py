"""What a test measured at single points, of a case that is being prepared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_joints.case.test import AntiresonanceTest, StaticTest
from fenics_joints.diagnosis.evidence.antiresonance import Antiresonance
from fenics_joints.diagnosis.evidence.at_point import AtPoint
from fenics_joints.diagnosis.evidence.scalars import Scalar
from fenics_joints.diagnosis.evidence.stiffness import StaticStiffness
from fenics_joints.diagnosis.model.antiresonances import antiresonances
from fenics_joints.diagnosis.model.functions import measured_functions
from fenics_joints.diagnosis.model.static import static_stiffness
from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress

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
    `fenics_joints.diagnosis.where.patch_signatures`.

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
