"""The ``modes`` command: natural frequencies and modes of a case's nominal model."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import Case, build_preload, build_structure, test_notes
from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.modes.compared import alone_words, compared
from fenics_joints.commands.modes.page import modes_page
from fenics_joints.commands.modes.result import ModeList
from fenics_joints.commands.modes.summary import show_modes
from fenics_joints.commands.outcome import Outcome
from fenics_joints.errors import InputError
from fenics_joints.modal.modes import solve_modes
from fenics_joints.modal.shape_files import check_meshed, write_shapes
from fenics_joints.preload import LinearJoint, solve_preload, status_conditions, stuck_conditions
from fenics_joints.progress import Progress
from fenics_joints.structure.paraview import check_fields_path


def run_modes(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    n_modes: int | None = None,
    state: str = "stuck",
    method: str = "direct",
    draw_all: bool = False,
    fields: Path | None = None,
) -> Outcome[ModeList]:
    """Modes of a case's nominal model. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        n_modes: Number of modes, rigid-body modes included; the case's ``diagnose.n_modes`` by
            default.
        state: What contacts are: ``"stuck"``, obstacles where the preload presses on them, or as
            the ``"preload"`` leaves them.
        method: ``"direct"`` or ``"iterative"``, see `solve_modes`; contacts need the direct one.
        draw_all: Whether the page draws all modes, also those that the test does not see.
        fields: A file to write all elastic modes to, ``.bp`` or ``.xdmf``.

    Raises:
        JointsError: If the case, the mesh or the solution fails.
    """
    n_modes = case.diagnose.n_modes if n_modes is None else n_modes
    if fields is not None:
        check_fields_path(comm, fields)
    progress.step("building the model")
    touches = bool(case.contacts or case.obstacles)
    if state != "stuck" and not touches:
        raise InputError(
            f"contacts = {state!r}: expected sections [contacts.NAME] or [obstacles.NAME] in the "
            "case"
        )
    if touches:
        model = _preloaded(case, comm, progress, state)
    else:
        model = build_structure(case, comm)
    if fields is not None:
        check_meshed(model, fields)
    progress.step(f"solving {n_modes} modes of {model.n_dofs} degrees of freedom")
    modes = solve_modes(model, n_modes=n_modes, method=method)
    sensors = case.sensors()
    visibility = None if sensors is None else modes.visibility(sensors)
    notes, beside = (*test_notes(case, model), *_unused(case, state)), compared(case, modes)
    if isinstance(beside, str):
        notes, beside = (*notes, beside), None
    elif beside is not None and beside.alone:
        notes = (*notes, alone_words(beside))
    written = ()
    if fields is not None:
        progress.step(f"writing {fields}")
        written = tuple(write_shapes(modes, fields))
    found = ModeList(case, modes, visibility, model.size_m, model.rings(), notes, beside, written)
    page = partial(modes_page, n_shapes=None) if draw_all else modes_page
    return Outcome.of(found, page, show_modes)


def _preloaded(case: Case, comm: MPI.Intracomm, progress: Progress, state: str) -> LinearJoint:
    """The bodies of a case with linear contacts and its bolts."""
    if state not in ("stuck", "preload"):
        raise InputError(f"contacts = {state!r}: expected 'stuck' or 'preload'.")
    stuck = state == "stuck" and not case.obstacles
    model = build_preload(case, comm, at_rest=stuck)
    if stuck:
        return LinearJoint(model)
    progress.step("contact under preload")
    conditions = stuck_conditions if state == "stuck" else status_conditions
    return LinearJoint(model, conditions(solve_preload(model)))


def _unused(case: Case, state: str) -> list[str]:
    """A sentence on what does not count as long as contacts are stuck whatever presses them."""
    if state != "stuck" or case.obstacles or not (case.loads or case.displacements):
        return []
    given = " and ".join(f"[{t}]" for t in ("loads", "displacements") if getattr(case, t))
    return [
        f"{OF_MODEL}contacts are stuck all over, whatever {given} do to them; faces that are moved "
        "are held; with --contacts preload it counts how far they are moved and pressed"
    ]
