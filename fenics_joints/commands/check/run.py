"""The ``check`` command: all errors and unlikely values of a case, and its model's modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from mpi4py import MPI

import fenics_joints
from fenics_joints.case import (
    Case,
    CostEstimate,
    Examined,
    build_mesh,
    build_preload,
    build_structure,
    estimate,
    examine_case,
    plausibility,
)
from fenics_joints.case.dimensions import long_normals, measured_directions
from fenics_joints.case.own_code import find_again, references
from fenics_joints.case.preload import APPLIED
from fenics_joints.case.size import available_bytes, duration, estimate_refused, gibibytes
from fenics_joints.commands.check.costs import Cost, costs_of, known, too_much
from fenics_joints.commands.check.places import (
    CasePoint,
    applied_places,
    bolts_of,
    close_together,
    far_places,
    places_of,
    same_bolts,
    twice,
)
from fenics_joints.commands.check.solved import beside_model
from fenics_joints.commands.check.weights import (
    Body,
    Weight,
    body_of,
    doubtful,
    face_centres,
    weights_of,
)
from fenics_joints.commands.outcome import Outcome
from fenics_joints.errors import InputError, JointsError
from fenics_joints.files import plain, shown_path
from fenics_joints.formatting import extents, length_mm, quantity
from fenics_joints.measurements.amplitude.backbone import RESPONSES
from fenics_joints.measurements.mistakes import mistakes_within
from fenics_joints.meshes import TaggedMesh, check_mesh
from fenics_joints.meshes.tagged import limits
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.report.case_pictures import MARKS, structure_picture
from fenics_joints.report.document import (
    Document,
    Figure,
    Heading,
    Keys,
    OnPage,
    OnTerminal,
    Remarks,
    Table,
    Text,
)

#: Lengths, m, between which a structure is plausible; beyond, the unit of its file is doubted.
_SIZES = (2e-3, 100.0)
#: Most rows of a table on the terminal, so that it fits on a screen.
_ROWS = 16


@dataclass(frozen=True, eq=False)
class Checked:
    """The result of the ``check`` command.

    Attributes:
        path: The case file.
        case: The case, or what can be read of it; None if nothing can.
        errors: What is wrong, so that other commands would refuse the case.
        notes: What is unlikely, or was moved or left out.
        weights: Masses of parts, joints, bolts, ``[masses]`` and ``[attached]``.
        places: Sensors, forces, masses, springs; obstacles, displacements and loads, at faces.
        bolts: Bolts.
        body: The mesh, on rank 0; None where there is none.
        size_m: Its extents, m.
        dofs: Degrees of freedom; None where no model could be made.
        estimate: Size, time and memory of one modal solution; None where they are not known.
        costs: Time and memory of each command.
        directions: Directions ``normal`` and ``across``, measured on the mesh, of parts for which
            the case gives none.
        solved: Which modes of the model test and bands were compared with, or why none, in words.
    """

    path: Path
    case: Case | None
    errors: tuple[str, ...]
    notes: tuple[str, ...] = ()
    weights: tuple[Weight, ...] = ()
    places: tuple[CasePoint, ...] = ()
    bolts: tuple[CasePoint, ...] = ()
    body: Body | None = field(default=None, repr=False)
    size_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    dofs: int | None = None
    estimate: CostEstimate | None = None
    costs: tuple[Cost, ...] = ()
    directions: Mapping[str, tuple[tuple, tuple]] = MappingProxyType({})
    solved: str = ""

    def __repr__(self) -> str:
        return f"Checked({self.path.name}: {len(self.errors)} errors, {len(self.notes)} notes)"

    @property
    def title(self) -> str:
        """Title of the case, or the name of its folder; the file where it cannot be read."""
        return shown_path(self.path) if self.case is None else self.case.name

    @property
    def mass(self) -> float:
        """Mass of the model, kg, without ``[attached]`` masses, which are not in it."""
        return sum(w.mass for w in self.weights if w.kind != "attached")

    def moved(self) -> list[CasePoint]:
        """Sensors and forces that are not on the mesh, and are moved onto it."""
        return [p for p in self.places if p.kind in ("sensor", "force") and p.off > 1e-6]

    def test_words(self) -> str:
        """What was measured, in words; empty without a test."""
        case, words = self.case, []
        if case is None or case.test is None:
            return ""
        data, frfs = case.measured, case.frfs()
        if data is not None and np.isfinite(data.frequencies_hz).any():
            low, high = np.nanmin(data.frequencies_hz), np.nanmax(data.frequencies_hz)
            count, span = len(data.mode_names), f"{low:.5g} to {high:.5g} Hz"
            span = span if high > low else f"{low:.5g} Hz"
            words.append(f"{count} mode{'s' * (count > 1)}, {span}")
            if len(data) > 1:
                span = f"{data.conditions[0]:g} to {data.conditions[-1]:g} {data.condition_unit}"
                words.append(f"at {len(data)} values of {data.condition_name}, {span}".rstrip())
            if data.shapes is not None:
                words.append(f"shapes at {len(data.shapes)} sensors")
            if data.damping is not None:
                words.append("damping ratios")
        for name in case.test.amplitude if not case.test.is_by_amplitude else ():
            if (one := case.backbones().get(name)) is not None:
                a = one.amplitudes
                span = f"{a[0]:.3g} to {a[-1]:.3g} {RESPONSES[one.response]}"
                words.append(f"{name} at {len(one)} levels, {span}")
        if frfs is not None:
            words.append(
                f"{int(frfs.measured.sum())} FRFs, {frfs.frequencies_hz[0]:g} to "
                f"{frfs.frequencies_hz[-1]:g} Hz"
            )
        return ", ".join(words) or ("planned" if case.test.planned else "not read")

    def place_words(self) -> str:
        """Numbers of sensors, forces, obstacles, displacements, loads and bolts, in words."""
        counts = dict.fromkeys(("sensor", "force", "obstacle", "displacement", "load"), 0)
        for place in self.places:
            if place.kind in counts:
                counts[place.kind] += 1
        words = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
        if self.bolts:
            n, rings = len(self.bolts), self.case is not None and not self.case.bolts
            # These are rings of contact, one for each pair of faces that a bolt presses together.
            kind, where = ("ring", " at bolts") if rings else ("bolt", "")
            words.append(f"{n} {kind}{'s' if n > 1 else ''}{where}")
        return ", ".join(words)

    def to_json(self) -> dict[str, object]:
        """The content of ``--json``.

        Keys: ``version``, ``title``, ``errors`` and ``notes`` in sentences; ``masses`` (``name``,
        ``kind``, ``kg``, ``weighed_kg``), ``mass_kg`` of the model; ``places`` (``kind``, ``name``,
        ``at_m``, ``direction``, ``off_mm``); ``bolts``, likewise; ``test`` and ``solved`` in
        words; ``size_m``, ``dofs``, ``costs`` (``command``, ``seconds``, ``bytes``).
        """
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.title,
                "errors": list(self.errors),
                "notes": list(self.notes),
                "masses": [w.to_json() for w in self.weights],
                "mass_kg": self.mass if self.weights else None,
                "places": [p.to_json() for p in self.places],
                "bolts": [p.to_json() for p in self.bolts],
                "test": self.test_words(),
                "solved": self.solved,
                "size_m": self.size_m,
                "dofs": self.dofs,
                "costs": [vars(cost) for cost in self.costs],
            }
        )


def run_check(
    path: str | Path,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    large: bool = False,
    changes: Sequence[str] = (),
) -> Outcome[Checked]:
    """Check a case. Collective.

    Args:
        path: The case file, or its folder.
        comm: Communicator.
        progress: Told what is being done.
        large: Whether the mesh is made even if the model seems too large for the machine.
        changes: Keys of the case with other values, see `load_case`.
    """
    found = check_case(path, comm, progress, large=large, changes=changes)
    n = len(found.errors)
    failure = f"{found.path}: {n} {'error' if n == 1 else 'errors'}, listed above" if n else None
    return Outcome(found, check_document(found), failure)


def check_case(
    path: str | Path,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    large: bool = False,
    solve: bool = True,
    changes: Sequence[str] = (),
) -> Checked:
    """The result that `run_check` shows, without the model's modes if ``solve`` is false."""
    progress.step("reading the case")
    examined = comm.bcast(on_root(comm, lambda: examine_case(path, changes)))
    find_again(comm.bcast(references()), examined.path.parent)
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
    if case.mesh.origin in ("beams", "matrices"):
        found = _beams(found, examined, comm)
        found = _beside(found, examined, None, comm, progress) if solve else found
        return _with_costs(found, comm)
    if not large and _is_too_large(found, comm):
        note = (
            "the mesh was not made, as it seems too large: are the size of its cells and the unit "
            "of its file right? --large makes it anyway"
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
        unread = case.mesh.origin in ("file", "own")
        if not unread:
            return _with_costs(found, comm)
        about = comm.bcast(on_root(comm, lambda: estimate_refused(case, ranks=comm.size)))
        return found if about is None else _with_costs(found, comm, about)
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
    """Why a diagnosis would refuse the test, although each section of it is valid."""
    if errors or case.measured is None:
        return []
    try:
        case.diagnosed_test()
    except InputError as error:
        return [_own(case, error)]
    return []


def _more(found: Checked, errors=(), notes=()) -> Checked:
    """The result with further errors and notes, each only once."""
    return replace(
        found,
        errors=tuple(dict.fromkeys([*found.errors, *errors])),
        notes=tuple(dict.fromkeys([*found.notes, *notes])),
    )


def _own(case: Case, error: Exception) -> str:
    """A message without the name of the case file, which heads the list of messages."""
    return str(error).removeprefix(f"{case.path}: ")


def _lines(message: str) -> list[str]:
    """Messages on missing groups of the mesh, one by one; any other message as it is."""
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
    """The result with masses and size of beams or parts by matrices, and errors of their model and
    sensors."""
    case, errors = found.case, []
    dofs, size, body = None, np.empty(0), None
    if examined.whole and not found.errors:
        try:
            model = build_structure(case, comm)
            dofs, size = model.n_dofs, np.asarray(model.size_m)
            body = model if case.mesh.origin == "matrices" else None
            if (sensors := case.sensors()) is not None:
                model.loads(sensors)  # refuses those beside it
        except JointsError as error:
            errors.append(_own(case, error))
    if case.mesh.origin == "matrices" and body is None:
        return _more(found, errors)
    weights = weights_of(case, body, {})
    found = replace(found, weights=weights, dofs=dofs, size_m=size)
    found = _more(found, (), getattr(body, "notes", ()))
    return _more(found, errors, doubtful(case, weights))


def _meshed(found: Checked, examined: Examined, tagged: TaggedMesh) -> Checked:
    """The result with what the mesh tells: masses, places, and whether a model can be made."""
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
    spans = any(" places of sensors span " in line for line in far)
    small = [] if spans else close_together(places, size)
    odd = [*doubtful(case, weights), *small, *_odd_sizes(case, size)]
    if case.mesh.origin == "file" and tagged.mesh.geometry.dim == 2:
        odd.append(
            "mesh.gdim = 2: the mesh is a section in plane strain, 1 m deep, and masses are per "
            "metre of depth; for a sheet give mesh.thickness"
        )
    found = _more(found, [*far, *same_bolts(case, bolts)], odd)
    moved = found.moved()
    if moved and not far:
        most = max(moved, key=lambda p: p.off)
        count = sum(p.kind in ("sensor", "force") for p in places)
        note = (
            f"{len(moved)} of {count} sensors and forces are beside the mesh and are moved onto "
            f"it, the farthest ({most.name}) by {1e3 * most.off:.3g} mm"
        )
        found = _more(found, (), [note])
    if not examined.whole:
        return found
    model = _model(found, tagged)
    if isinstance(model, str):
        return _more(found, [model])
    odd = [*_apart(case, tagged), *long_normals(case, tagged)]
    found = replace(found, dofs=model, directions=measured_directions(case, tagged))
    return _more(found, (), odd)


def _odd_sizes(case: Case, size: float) -> Iterator[str]:
    """Notes on an implausible length of the structure, m, and on cells larger than it."""
    if not _SIZES[0] <= size <= _SIZES[1]:
        yield f"the structure is {quantity(size, 'm')} long: is the unit of its file right?"
    cells = getattr(case.mesh, "size", None)
    if cells is not None and cells > size:
        yield (
            f"mesh.size = {quantity(cells, 'm')} is more than the structure's "
            f"{quantity(size, 'm')}: cells become as large as the geometry allows"
        )


def _model(found: Checked, tagged: TaggedMesh) -> int | str:
    """Degrees of freedom of the model; or why there can be none. Points are checked elsewhere."""
    case, comm = found.case, tagged.mesh.comm
    bare = case.model_copy(update={"masses": {}, "springs": {}, "attached": {}})
    try:
        if case.contacts or any(getattr(case, table) for table in APPLIED):
            return build_preload(bare, comm, tagged=tagged, at_rest=True).structure.n_dofs
        return build_structure(bare, comm, tagged=tagged).n_dofs
    except JointsError as error:
        return _own(case, error)


def _apart(case: Case, tagged: TaggedMesh) -> list[str]:
    """A note if the mesh has bodies that nothing joins."""
    bodies = check_mesh(tagged).bodies
    if bodies < 2 or case.contacts:
        return []
    return [
        f"the mesh has {bodies} bodies that share no vertices, and the case has no [contacts]: "
        "nothing joins them, so each moves freely"
    ]


def _with_costs(found: Checked, comm: MPI.Intracomm, about: CostEstimate | None = None) -> Checked:
    """The result with time and memory of the commands, and notes on those that take too much.

    By the model's size, or by an estimate of it that is better than one from the files' heads.
    """
    try:
        rough = comm.bcast(on_root(comm, lambda: estimate(found.case, ranks=comm.size)))
    except InputError:
        return found  # said where the mesh is made
    dofs = found.dofs if about is None else about.dofs
    costs = costs_of(found.case, rough, dofs, comm.size)
    found = replace(found, costs=costs, estimate=known(found.case, rough, dofs, comm.size))
    return _more(found, (), too_much(costs))


# -- the document ----------------------------------------------------------------------------------


def check_document(result: Checked) -> Document:
    """The document of a checked case: errors, notes, a picture, masses, places, costs."""
    counts = {"error": len(result.errors), "note": len(result.notes)}
    keys = [(f"{word}s", n, word if n == 1 else f"{word}s") for word, n in counts.items()]
    if result.weights:
        keys.append(("mass", quantity(result.mass, "kg", 4), "mass of the model"))
    if result.dofs:
        keys.append(("dofs", result.dofs, "degrees of freedom"))
    if len(result.size_m):
        keys.append(("size", extents(result.size_m), "extents of the mesh"))
    if result.bolts:
        keys.append(("bolts", len(result.bolts), "bolts"))
    estimated = "" if result.dofs or result.estimate is None else str(result.estimate)
    test = f"test: {words}" if (words := result.test_words()) else ""
    said = [text for text in (estimated, result.place_words(), test, result.solved) if text]
    wrong = [
        Remarks("Errors", result.errors, "error {}: ", "bad", "error-list"),
        Remarks("Notes", result.notes, "note: ", id="note-list"),
    ]
    if not result.errors and not result.notes:
        wrong = [Text("no errors, nothing unlikely", "good")]
    return Document(
        result.title,
        "checked",
        "The case, compared with its baseline model",
        [
            Keys(keys),
            OnPage([*wrong, *_pictures(result)]),
            *_weights(result),
            *(Text(text) for text in said),
            *_costs_said(result.costs),
            OnTerminal(wrong),
            *_places(result),
        ],
        result.to_json,
    )


def _weights(result: Checked) -> list:
    """Table of masses; the last row is the mass of the whole model."""
    if not result.weights:
        return []
    table = Table(
        "mass of | kind | >in the model | >weighed",
        caption="To compare with weighing; give weighed masses as mass in [parts.NAME] and [test]",
        id="masses",
        most=_ROWS,
    )
    for w in result.weights:
        kind = "attached, not in the model" if w.kind == "attached" else w.kind
        weighed = "" if w.weighed is None else quantity(w.weighed, "kg")
        table.add(w.name, kind, quantity(w.mass, "kg"), weighed)
    test = None if result.case is None else result.case.test
    weighed = "" if test is None or test.mass is None else quantity(test.mass, "kg")
    table.add("all", "in the model", quantity(result.mass, "kg", 4), weighed)
    return [Heading("Masses"), table]


def _costs_said(costs: Sequence[Cost]) -> list:
    if not costs:
        return []
    table = Table(
        "command | >time | >memory",
        caption="Estimates for an idle machine, within a factor of two either way",
        id="costs",
    )
    for cost in costs:
        table.add(cost.command, f"about {duration(cost.seconds)}", gibibytes(cost.bytes))
    return [Heading("Time and memory of a run"), table]


def _places(result: Checked) -> list:
    places = [*result.bolts, *result.places]
    if not places:
        return []
    table = Table(
        "name | kind | >at, mm | >direction | >distance from the mesh, mm",
        caption="Bolts, sensors, forces and masses at points or faces",
        id="places",
    )
    size = float(max(result.size_m, default=0.0))
    for p in places:
        at = ", ".join(length_mm(x, size) for x in p.point)
        way = ", ".join(f"{round(x, 3) + 0.0:g}" for x in p.direction or ())
        table.add(p.name, p.kind, at, way, length_mm(p.off, size) if p.off >= 0 else "")
    return [OnPage([Heading("Places"), table])]


def _pictures(result: Checked) -> list[Figure]:
    """Pictures of the structure from above and from below, with all places."""
    body, places = result.body, [*result.bolts, *result.places]
    if body is None:
        return []
    by_kind = {kind: [p for p in places if p.kind == kind] for kind in MARKS}
    drawn = (
        partial(structure_picture, body.vertices, body.group, body.names, by_kind, below=below)
        for below in (False, True)
    )
    behind = "Marks behind the structure show through."
    return [
        Figure(draw, f"From {side}. {behind}")
        for side, draw in zip(("above", "below"), drawn, strict=True)
    ]
