"""The ``check`` command: all errors and unlikely values of a case, compared with its modes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case import (
    Case,
    Examined,
    build_mesh,
    build_preload,
    build_structure,
    estimate,
    examine_case,
    plausibility,
)
from fenics_joints.case.dimensions import long_normals, measured_directions
from fenics_joints.case.preload import APPLIED
from fenics_joints.case.size import available_bytes
from fenics_joints.commands.check.applied import applied_places
from fenics_joints.commands.check.body import body_of, face_centres
from fenics_joints.commands.check.costs import costs_of, known, too_much
from fenics_joints.commands.check.page import check_page
from fenics_joints.commands.check.places import (
    bolts_of,
    close_together,
    far_places,
    places_of,
    same_bolts,
    twice,
)
from fenics_joints.commands.check.result import Checked
from fenics_joints.commands.check.solved import beside_model
from fenics_joints.commands.check.summary import show_check
from fenics_joints.commands.check.weights import doubtful, weights_of
from fenics_joints.commands.outcome import Outcome
from fenics_joints.errors import InputError, JointsError
from fenics_joints.formatting import quantity
from fenics_joints.measurements.mistakes import mistakes_within
from fenics_joints.meshes import TaggedMesh, check_mesh
from fenics_joints.meshes.tagged import limits
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress

#: Between these lengths, m, a structure is taken to be of the unit that its file is read in.
_SIZES = (2e-3, 100.0)


def run_check(
    path: str | Path, comm: MPI.Intracomm, progress: Progress, *, large: bool = False
) -> Outcome[Checked]:
    """Look at a case. Collective.

    Args:
        path: The case file, or its folder.
        comm: Communicator.
        progress: Told what is being done.
        large: Whether a mesh is made also where the model seems too large for the machine.
    """
    found = check_case(path, comm, progress, large=large)
    n = len(found.errors)
    failure = f"{found.path}: {n} {'error' if n == 1 else 'errors'}, listed above" if n else None
    return Outcome.of(found, check_page, show_check, failure)


def check_case(
    path: str | Path,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    large: bool = False,
    solve: bool = True,
) -> Checked:
    """What `run_check` shows, without the model's modes if ``solve`` is false."""
    progress.step("reading the case")
    examined = comm.bcast(on_root(comm, lambda: examine_case(path)))
    case = examined.case
    if case is None:
        return Checked(examined.path, None, examined.errors)
    within = [] if case.measured is None else mistakes_within(case.measured)
    notes = [*case.test_notes(), *plausibility(case), *within]
    found = Checked(examined.path, case, examined.errors, tuple(notes))
    found = replace(found, places=tuple(places_of(case)))
    found = _more(found, _diagnosed(case, examined.errors), twice(found.places))
    if not examined.has_mesh:
        return found
    if case.mesh.origin == "beams":
        found = _beams(found, examined, comm)
        found = _beside(found, examined, None, comm, progress) if solve else found
        return _with_costs(found, comm)
    if not large and _is_too_large(found, comm):
        note = (
            "the mesh was not made, as it seems too large: are the size of its cells and the unit "
            "of its file right? --large makes it all the same"
        )
        return _with_costs(_more(found, same_bolts(case, []), [note]), comm)
    progress.step("making the mesh")
    try:
        tagged = build_mesh(case, comm)
    except (InputError, JointsError) as error:
        lines = _lines(_own(case, error))
        notes = [line.removeprefix("note: ") for line in lines if line.startswith("note: ")]
        errors = [line for line in lines if not line.startswith("note: ")]
        found = _more(found, [*same_bolts(case, []), *errors], notes)
        # The size of a file's mesh is known only once it is read.
        return found if case.mesh.origin == "file" else _with_costs(found, comm)
    found = _meshed(found, examined, tagged)
    found = _beside(found, examined, tagged, comm, progress) if solve else found
    return _with_costs(found, comm)


def _beside(found: Checked, examined: Examined, tagged, comm, progress) -> Checked:
    """The result with notes from the model's modes, where a model can be made."""
    if found.errors or not examined.whole or found.dofs is None:
        return found
    words, notes = beside_model(found.case, tagged, found.dofs, comm, progress)
    return _more(replace(found, solved=words), (), notes)


def _diagnosed(case: Case, errors) -> list[str]:
    """Why its test is none for a diagnosis, where each part of it is right by itself."""
    if errors or case.measured is None:
        return []
    try:
        case.diagnosed_test()
    except InputError as error:
        return [_own(case, error)]
    return []


def _more(found: Checked, errors=(), notes=()) -> Checked:
    """With further errors and notes, each once."""
    return replace(
        found,
        errors=tuple(dict.fromkeys([*found.errors, *errors])),
        notes=tuple(dict.fromkeys([*found.notes, *notes])),
    )


def _own(case: Case, error: Exception) -> str:
    """A message without the name of the case file, which stands above all of them."""
    return str(error).removeprefix(f"{case.path}: ")


def _lines(message: str) -> list[str]:
    """Groups of the mesh that are not there, one by one; any other message as it is."""
    head, *lines = message.split("\n  ")
    return lines if head.startswith("names groups") else [message]


def _is_too_large(found: Checked, comm: MPI.Intracomm) -> bool:
    def ask() -> bool:
        try:
            return estimate(found.case, ranks=comm.size).bytes > available_bytes()
        except InputError:
            return False  # said where the mesh is made

    return comm.bcast(on_root(comm, ask))


def _beams(found: Checked, examined: Examined, comm: MPI.Intracomm) -> Checked:
    """What beams weigh, and where things are on them."""
    case, errors = found.case, []
    dofs, size = None, np.empty(0)
    if examined.whole and not found.errors:
        try:
            model = build_structure(case, comm)
            dofs, size = model.n_dofs, np.asarray(model.size_m)
            if (sensors := case.sensors()) is not None:
                model.read(sensors)
        except JointsError as error:
            errors.append(_own(case, error))
    weights = weights_of(case, None, {})
    found = replace(found, weights=weights, dofs=dofs, size_m=size)
    return _more(found, errors, doubtful(case, weights))


def _meshed(found: Checked, examined: Examined, tagged: TaggedMesh) -> Checked:
    """What can be said with the mesh: masses, places, and whether a model can be made."""
    case, comm = found.case, tagged.mesh.comm
    centres = face_centres(tagged)
    places, far = far_places(found.places, tagged)
    acting = applied_places(case, centres, tagged.mesh.geometry.dim)
    bolts = bolts_of(case, tagged.points.get("bolts"), centres)
    body = body_of(tagged)
    weights = comm.bcast(weights_of(case, body, centres) if body is not None else None)
    low, high = limits(tagged)
    found = replace(
        found,
        places=(*places, *acting),
        bolts=tuple(bolts),
        weights=weights,
        body=body,
        size_m=high - low,
    )
    size = float(np.max(high - low))
    small = (
        []
        if any(" places of sensors span " in line for line in far)
        else close_together(places, size)
    )
    odd = [*doubtful(case, weights), *small, *_odd_size(size), *_odd_cells(case, size)]
    if case.mesh.origin == "file" and tagged.mesh.geometry.dim == 2:
        odd.append(
            "mesh.gdim = 2: the mesh is a section in plane strain, 1 m deep, and masses are per "
            "metre of depth; for a sheet give mesh.thickness"
        )
    found = _more(found, [*far, *same_bolts(case, bolts)], odd)
    moved = found.moved()
    if moved and not far:
        most = max(moved, key=lambda p: p.off)
        found = _more(
            found,
            (),
            [
                f"{len(moved)} of {sum(p.kind in ('sensor', 'force') for p in places)} sensors and "
                f"forces are beside the mesh and are moved onto it, the farthest ({most.name}) by "
                f"{1e3 * most.off:.3g} mm"
            ],
        )
    if not examined.whole:
        return found
    model = _model(found, tagged)
    if isinstance(model, str):
        return _more(found, [model])
    odd = [*_apart(case, tagged), *long_normals(case, tagged)]
    found = replace(found, dofs=model, directions=measured_directions(case, tagged))
    return _more(found, (), odd)


def _odd_size(size: float) -> list[str]:
    """A sentence for a structure that is of no lab's size, m."""
    if _SIZES[0] <= size <= _SIZES[1]:
        return []
    return [f"the structure is {quantity(size, 'm')} long: is the unit of its file right?"]


def _odd_cells(case: Case, size: float) -> list[str]:
    """A sentence if the requested cell size exceeds the structure's size, m."""
    asked = getattr(case.mesh, "size", None)
    if asked is None or asked <= size:
        return []
    return [
        f"mesh.size = {quantity(asked, 'm')} is more than the structure's {quantity(size, 'm')}: "
        "cells become as large as the geometry allows"
    ]


def _model(found: Checked, tagged: TaggedMesh) -> int | str:
    """Degrees of freedom of the model; or why there can be none. Points are looked at elsewhere."""
    case, comm = found.case, tagged.mesh.comm
    bare = case.model_copy(update={"masses": {}, "springs": {}, "attached": {}})
    try:
        if case.contacts or any(getattr(case, table) for table in APPLIED):
            return build_preload(bare, comm, tagged=tagged, at_rest=True).structure.n_dofs
        return build_structure(bare, comm, tagged=tagged).n_dofs
    except JointsError as error:
        return _own(case, error)


def _apart(case: Case, tagged: TaggedMesh) -> list[str]:
    """Bodies that nothing joins."""
    bodies = check_mesh(tagged).bodies
    if bodies < 2 or case.contacts:
        return []
    return [
        f"the mesh has {bodies} bodies that share no vertices, and the case no [contacts]: nothing "
        "joins them, and each moves by itself"
    ]


def _with_costs(found: Checked, comm: MPI.Intracomm) -> Checked:
    """With what the commands will take."""
    try:
        rough = comm.bcast(on_root(comm, lambda: estimate(found.case, ranks=comm.size)))
    except InputError:
        return found  # said where the mesh is made
    costs = costs_of(found.case, rough, found.dofs, comm.size)
    found = replace(found, costs=costs, estimate=known(found.case, rough, found.dofs, comm.size))
    return _more(found, (), too_much(costs))
