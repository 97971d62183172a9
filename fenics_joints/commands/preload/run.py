"""The ``preload`` command: contacts under the bolts' preload, and what it does to frequencies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_preload
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.preload.applied import applied_facts
from fenics_joints.commands.preload.contacts import bolt_axes, contact_facts
from fenics_joints.commands.preload.page import preload_html
from fenics_joints.commands.preload.result import PreloadReport
from fenics_joints.commands.preload.summary import show_preload
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import LinearJoint, PreloadSolver, status_conditions, stuck_conditions
from fenics_joints.preload.fields import write
from fenics_joints.progress import Progress
from fenics_joints.structure.paraview import check_fields_path

#: Elastic modes whose frequencies are compared.
_ELASTIC = 6
#: Relative difference of the frequencies of a symmetric structure's pair, whose shapes may turn.
_EQUAL = 1e-3


def run_preload(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, fields: Path | None = None
) -> Outcome[PreloadReport]:
    """Contacts at the case's bolt forces and loads, and the frequencies about it. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        fields: A file to write the fields to, ``.bp`` or ``.xdmf``.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    if fields is not None:
        check_fields_path(comm, fields)
    progress.step("building the model")
    model = build_preload(case, comm)
    progress.step(f"contact of {model.jumps.n} degrees of freedom")
    result = PreloadSolver(model).solve(monitor=lambda i, norm: progress.advance())
    axes = bolt_axes(result)
    contacts = [contact_facts(state, axes) for state in result.contacts.values()]
    progress.step("modes with the contacts stuck, and as the preload leaves them")
    joint = LinearJoint(model, stuck_conditions(result))
    stuck = _elastic_modes(joint)
    loose = _elastic_modes(joint.change(status_conditions(result)), stuck)
    written = ()
    if fields is not None:
        progress.step(f"writing {fields}")
        written = tuple(write(result, fields))
    hz = [modes.frequencies_hz[modes.n_rigid :] for modes in (stuck, loose)]
    compared = min(_ELASTIC, *map(len, hz))
    found = PreloadReport(
        case,
        result,
        contacts,
        *(f[:compared] for f in hz),
        written,
        tuple(applied_facts(result)),
        max(loose.n_rigid - stuck.n_rigid, 0),
        _become(joint, stuck, loose)[:compared],
    )
    return Outcome.of(found, preload_html, show_preload)


def _become(joint: LinearJoint, stuck: Modes, loose: Modes) -> np.ndarray:
    """Frequencies, Hz, (n,), of what the stuck elastic modes become in the preloaded state: of the
    mode, or the modes as good as equal, with more than half of the kinetic energy of the stuck
    shape; nan where none has."""
    mass, hz = joint.free_matrices()[1], loose.frequencies_hz[loose.n_rigid :]
    moved = [mass * shape for shape in loose.shapes[loose.n_rigid :]]
    found = np.full(len(stuck) - stuck.n_rigid, np.nan)
    for i, shape in enumerate(stuck.shapes[stuck.n_rigid :]):
        # Shapes have unit modal mass, so that these are shares, 1 in sum over all modes.
        shares = np.array([shape.dot(other) ** 2 for other in moved])
        near = hz[np.argmax(shares)]
        if shares[np.abs(hz / near - 1) < _EQUAL].sum() > 0.5:
            found[i] = near
    return found


def _elastic_modes(joint: LinearJoint, before: Modes | None = None) -> Modes:
    """Modes up to the compared elastic ones, however many free motions come before them.

    Faces that slide or are open let bodies move against one another.
    """
    wanted = (6 if before is None else before.n_rigid) + _ELASTIC + 1
    solver = None if before is None else before.solver
    modes = solve_modes(joint, n_modes=wanted, solver=solver)
    if len(modes) - modes.n_rigid < _ELASTIC and len(modes) == wanted:
        wanted = modes.n_rigid + 6 * _ELASTIC
        modes = solve_modes(joint, n_modes=wanted, solver=solver)
    return modes
