"""A case from a mesh that has names: of a ``.msh`` file, or of a builder."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case.mesh import BUILDERS
from fenics_joints.commands.check.weights import USUAL_KG, body_of
from fenics_joints.commands.new.extents import METRES, UNITS, likely_unit
from fenics_joints.commands.new.grown import with_joints
from fenics_joints.commands.new.sketch import (
    BOLT_FORCE,
    Ask,
    JointSketch,
    PartSketch,
    Sketch,
    ask_materials,
    force_of,
    material_of,
    millimetres,
    toml,
)
from fenics_joints.errors import InputError, MeshError, member
from fenics_joints.meshes import TaggedMesh, check_contact, measure_ring, read_msh
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.rings import ring_names
from fenics_joints.meshes.tagged import limits
from fenics_joints.preload.clearance import guess_thread
from fenics_joints.units import to_si

#: Names that layers of joints have.
_JOINT = re.compile(r"joint|ring|layer|lap\b|zone|interface|contact|glue|fuge|naht|gasket", re.I)
#: Units of meshes, the most frequent first, and a density to recognise them by, kg/m3.
_UNITS, _STEEL = ("m", "mm", "inch", "cm"), 7850.0
#: Numbers of lapped beams that a case must have, where a builder has no defaults.
_BEAMS = (
    'lengths = ["360 mm", "260 mm"]  # ? of each beam, in a row',
    'laps = "50 mm"  # ? over which each lies on the next',
    'width = "21 mm"  # ?',
    'thickness = "10.6 mm"  # ?',
    "elements = [30, 20]",
    "lap_elements = 5",
)


def msh_sketches(
    path: Path, file: str, places: np.ndarray, material: str, ask: Ask
) -> Iterator[Sketch]:
    """Cases of a gmsh file, the likeliest first: with its own layers, or with joints grown.

    Args:
        path: The file.
        file: Its name in the case.
        places: Sensors of the test, m, which say its unit; shape (n, 3).
        material: Of parts whose name names none.
        ask: Asks the user.

    Raises:
        MeshError: As `read_msh`.
    """
    gdim = 3
    try:
        tagged = read_msh(path, MPI.COMM_SELF)
    except MeshError:
        try:
            tagged, gdim = read_msh(path, MPI.COMM_SELF, gdim=2), 2
        except MeshError:
            tagged = read_msh(path, MPI.COMM_SELF)  # says what is wrong in space
    size = float(np.ptp(np.array(limits(tagged)), axis=0).max())
    volume = float(body_of(tagged).volumes.sum()) if gdim == 3 else None

    def known(answer: str) -> None:
        member("unit", answer, UNITS)

    sizes = ", ".join(f"{1e3 * size * scale:.4g} mm in {name}" for name, scale in UNITS.items())
    question = f"Unit of the lengths in {path.name} (its extent is {size:.6g}: {sizes})"
    unit = ask(question, _unit(size, volume, places), known)
    scale = UNITS[unit]
    lines = [
        "[mesh]",
        f"file = {toml(file)}",
        f'scale = "{scale:g} m"  # ? the file is in {unit}: it is {size * scale:.4g} m long',
    ]
    questions, thickness = ["The unit of the mesh, which a .msh file does not say."], None
    if gdim == 2:
        thickness = _thickness(path, ask)
        lines.append("gdim = 2")
        if thickness is not None:
            lines.append(f"thickness = {toml(millimetres(thickness))}  # of the sheet")
        else:
            lines.append('# thickness = "2 mm"  # ? for a sheet; without it a section, 1 m deep')
            questions.append(
                "The mesh is plane and is read as a section in plane strain, 1 m deep. For a sheet "
                "give its thickness."
            )
    tagged = read_msh(path, MPI.COMM_SELF, gdim=gdim, scale=scale, thickness=thickness)
    found = _sketch(tagged, lines, material, ask, None)
    found = replace(found, questions=(*questions, *found.questions))
    if found.joints or found.more or len(found.parts) < 2 or thickness:
        yield found
    else:
        yield from with_joints(found, path, gdim, scale)


def _thickness(path: Path, ask: Ask) -> float | None:
    """Thickness of a plane mesh, m; None if it is a section and no sheet."""

    def known(answer: str) -> None:
        if answer != "none" and not to_si(answer, "m") > 0:
            raise ValueError(f"{answer!r}: expected a length above 0, such as 2 mm, or none")

    question = (
        f"Thickness of the plane mesh in {path.name} if it is a sheet, such as 2 mm (none: a "
        "section in plane strain, 1 m deep)"
    )
    answer = ask(question, "none", known)
    return None if answer == "none" else to_si(answer, "m")


def _unit(size: float, volume: float | None, places: np.ndarray) -> str:
    """The unit with which the sensors span the mesh, or else the mesh has a usual size.

    Args:
        size: The mesh's largest extent.
        volume: Volume of the solids; None for a plane mesh.
        places: Sensors, m, shape (n, 3).
    """
    if len(places) > 2 and (span := float(np.ptp(places, axis=0).max())) > 0:
        near = {unit: abs(np.log(size * scale / span)) for unit, scale in UNITS.items()}
        best = min(near, key=near.get)
        if near[best] < np.log(2.0):
            return best
    for unit in () if volume is None else _UNITS:
        scale = UNITS[unit]
        kilograms = _STEEL * volume * scale**3
        if METRES[0] <= size * scale <= METRES[1] and USUAL_KG[0] <= kilograms <= USUAL_KG[1]:
            return unit
    return likely_unit([size], None)


def builder_sketch(name: str, material: str, ask: Ask) -> Sketch:
    """A case of a builder with its own default numbers.

    Raises:
        InputError: If there is no such builder.
    """
    member("builder", name, BUILDERS)
    if BUILDERS[name].origin == "beams":
        return _beams(name, material, ask)
    made = BUILDERS[name](builder=name).made()
    kinds = typing.get_type_hints(type(made), include_extras=True)
    numbers = [
        f"{field.name} = {_written(getattr(made, field.name), kinds[field.name])}"
        for field in fields(made)
        if field.name not in ("cell",) and getattr(made, field.name) not in (None, ())
    ]
    lines = ["[mesh]", f"builder = {toml(name)}", "# ? The builder's own numbers:", *numbers]
    tagged = made.build(MPI.COMM_SELF)
    hole = getattr(made, "hole_diameter", None) or getattr(made, "hole", None) or None
    found = _sketch(tagged, lines, material, ask, hole)
    return replace(found, questions=("The builder's dimensions.", *found.questions))


def _written(value, kind) -> str:
    """An argument of a builder, lengths in mm."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(_written(item, kind) for item in value)}]"
    if isinstance(value, float) and "unit='m'" in repr(kind):
        return toml(millimetres(value))
    return toml(value)


def _beams(name: str, material: str, ask: Ask) -> Sketch:
    parts = [PartSketch("beams", ("beam_1", "beam_2"), "", material)]
    joint = [
        "[joints.lap]",
        'cells = "lap"',
        'law = "generic"',
        'k1 = "1763 N m"  # ? slap; Jalali et al. 2019, Table 2: beams of 21 x 10.6 mm, 23 N·m',
        'k2 = "37400 N m"  # ? slip',
        'c = "0.15 N m s"  # ?',
        "bolted = true",
        "",
    ]
    return Sketch(
        ("[mesh]", f"builder = {toml(name)}", *_BEAMS),
        ask_materials(parts, ask),
        (),
        tuple(joint),
        ("left", "right"),
        ("two beams in a lap",),
        ("The dimensions of the beams.", "The stiffness of the lap."),
    )


# -- what a mesh says ------------------------------------------------------------------------------


def _sketch(tagged: TaggedMesh, lines, material: str, ask: Ask, hole: float | None) -> Sketch:
    """Parts, joints, contacts and bolts by the names of a mesh."""
    body = body_of(tagged)
    volumes = {name: body.volume([name]) for name in tagged.cell_names}
    layers, odd = _joints(tagged, volumes)
    layered = {joint.cells[0] for joint in layers}
    joints = _together(layers, set(ring_names(list(volumes))))
    parts = [
        PartSketch(_plain(name), (name,), f"{1e6 * volume:.4g} cm3", material_of(name, material))
        for name, volume in volumes.items()
        if name not in layered
    ]
    contacts, bolts = _pairs(tagged, bool(joints))
    more, asked = _contact_lines(contacts, bolts, hole)
    bodies = check_mesh(tagged).bodies
    questions = ["The materials: a mesh has none.", *odd, *asked]
    if joints:
        questions.append("The joints' stiffness: it is what a test is to find.")
    elif not contacts and len(parts) > 1:
        questions.append(
            "The mesh has no layer between its parts: they are as one where they share vertices."
        )
    if bodies > 1 and not (contacts and bolts):
        questions.append(f"The mesh is in {bodies} pieces that share no vertices: what joins them?")
    found = [
        f"parts: {', '.join(part.name for part in parts)}",
        *([f"joints: {', '.join(joint.name for joint in joints)}"] * bool(joints)),
        *([f"faces that touch: {len(contacts)}; bolts: {len(bolts)}"] * bool(contacts or bolts)),
    ]
    return Sketch(
        (*lines,),
        ask_materials(parts, ask),
        tuple(joints),
        tuple(more),
        tuple(tagged.facet_names),
        tuple(found),
        tuple(questions),
    )


def _plain(name: str) -> str:
    """A group's name as a name of a section."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")
    return plain if re.match(r"[A-Za-z]", plain) else f"part_{plain}"


def _joints(tagged: TaggedMesh, volumes) -> tuple[list[JointSketch], list[str]]:
    """Layers among the groups: rings and what is named like a joint, where they are thin."""
    found, odd = [], []
    if tagged.mesh.geometry.dim != 3:
        return found, odd
    rings = set(ring_names(list(volumes)))
    for name in volumes:
        if name not in rings and not _JOINT.search(name):
            continue
        try:
            ring = measure_ring(tagged, name)
        except MeshError:
            odd.append(f"{name} is named like a joint, but is no flat layer: taken as a part.")
            continue
        words = f"{', '.join(ring.lower)} and {', '.join(ring.upper)}, {1e4 * ring.area:.3g} cm2"
        found.append(JointSketch(_plain(name), (name,), words, tuple(ring.normal), ring.thickness))
    return found, odd


def _together(found: Sequence[JointSketch], rings: set[str]) -> list[JointSketch]:
    """Rings that are alike as one joint."""
    own = [joint for joint in found if joint.cells[0] in rings]
    alike = {(np.round(np.abs(j.normal), 6).tobytes(), f"{j.thickness:.3g}") for j in own}
    if len(own) < 2 or len(alike) > 1:
        return list(found)
    cells = tuple(joint.cells[0] for joint in own)
    cells = ("ring_*",) if len(own) == len(rings) else cells
    words = f"the rings of {len(own)} bolts, {own[0].words.rpartition(',')[0]}"
    together = replace(own[0], name="rings", cells=cells, words=words)
    return [together, *(joint for joint in found if joint.cells[0] not in rings)]


def _pairs(tagged: TaggedMesh, layered: bool):
    """Names of faces that touch, and of those under washers: (name, lower, upper)."""
    names = list(tagged.facet_names)
    contacts, bolts = [], []
    for name in names:
        stem, end = name.removesuffix("_lower"), "_upper"
        other = f"{stem}{end}"
        if stem != name and other in names:
            if re.search("washer|head|bolt", stem, re.I):
                bolts.append((stem.replace("washer", "bolt"), name, other))
            elif not layered and _match(tagged, name, other):
                contacts.append((stem if stem != "interface" else "contact", name, other))
        between = re.fullmatch(r"(.+)_to_(.+)", name)
        if between and (back := f"{between[2]}_to_{between[1]}") in names and name < back:
            if not layered and _match(tagged, name, back):
                contacts.append((f"{between[1]}_{between[2]}", name, back))
    return contacts, bolts


def _match(tagged: TaggedMesh, lower: str, upper: str) -> bool:
    try:
        check_contact(tagged, lower, upper)
    except InputError:
        return False
    return True


def _contact_lines(contacts, bolts, hole: float | None) -> tuple[list[str], list[str]]:
    """Sections of contacts and bolts, which need each other."""
    if not contacts or not bolts:
        return [], []
    lines, guess = [], None if not hole else guess_thread(hole)
    for name, lower, upper in contacts:
        lines += [
            f"[contacts.{_plain(name)}]",
            f"lower = {toml(lower)}",
            f"upper = {toml(upper)}",
            "friction = 0.2  # ? assumed: bright metal has 0.14 to 0.24 (VDI 2230-1, table A5)",
            "",
        ]
    for name, lower, upper in bolts:
        lines += [f"[bolts.{_plain(name)}]"]
        if guess is None:
            kind = ['kind = "washers"']
        else:
            t = guess.thread
            kind = ['kind = "beam"', f"thread = {toml(t.name)}  # ? {guess.why}"]
        force = force_of(guess and guess.thread)
        why = "assumed" if guess is None else BOLT_FORCE
        lines += [
            *kind,
            f"lower = {toml(lower)}",
            f"upper = {toml(upper)}",
            f'force = "{force / 1e3:g} kN"  # ? {why}; or torque',
            "",
        ]
    return lines, ["The bolts: their thread and force.", "The friction of the contacts."]
