"""A case from a mesh that has names: of a ``.msh`` file, or of a builder."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case.mesh import BUILDERS
from fenics_joints.commands.check.weights import USUAL_KG, body_of
from fenics_joints.commands.new.bolted import NO_BOLTS, ON_ALL, START, BoltHole, with_rings
from fenics_joints.commands.new.draft import (
    BOLT_FORCE,
    UNBOLTED,
    Ask,
    Draft,
    Remark,
    direction,
    force_of,
    guess,
    material_of,
    millimetres,
    parts_of,
    springs_joint,
)
from fenics_joints.commands.new.extents import METRES, UNITS, likely_unit
from fenics_joints.errors import InputError, MeshError, member
from fenics_joints.meshes import TaggedMesh, check_contact, measure_ring, read_msh
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.grow import Touch, glued, round_holes, touches
from fenics_joints.meshes.msh import read_lists
from fenics_joints.meshes.rings import ring_names
from fenics_joints.meshes.tagged import limits
from fenics_joints.preload.clearance import cone_radius, guess_thread, head_radius
from fenics_joints.units import to_si

#: Names that layers of joints have.
_JOINT = re.compile(r"joint|ring|layer|lap\b|zone|interface|contact|glue|fuge|naht|gasket", re.I)
#: Units of meshes, the most frequent first, and a density to recognise them by, kg/m3.
_UNITS, _STEEL = ("m", "mm", "inch", "cm"), 7850.0
#: Largest and least radius of a ring as a multiple of the hole's.
_MOST, _LEAST = 4.0, 1.2
_NO_LAYER = "The mesh has no layer between its parts: they are as one where they share vertices."


def msh_drafts(
    path: Path, file: str, places: np.ndarray, material: str, ask: Ask
) -> Iterator[Draft]:
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
    sizes = ", ".join(f"{1e3 * size * scale:.4g} mm in {name}" for name, scale in UNITS.items())
    question = f"Unit of the lengths in {path.name} (its extent is {size:.6g}: {sizes})"
    likely = _unit(size, volume, places)
    unit = ask(question, likely, lambda answer: member("unit", answer, UNITS))
    scale = UNITS[unit]
    words = f"the file is in {unit}: it is {size * scale:.4g} m long"
    mesh = {"file": file, "scale": guess(f"{scale:g} m", words)}
    questions, thickness = ["The unit of the mesh, which a .msh file does not say."], None
    if gdim == 2:
        thickness = _thickness(path, ask)
        mesh["gdim"] = 2
        if thickness is not None:
            mesh["thickness"] = Remark(millimetres(thickness), "of the sheet")
        else:
            mesh["# thickness"] = guess("2 mm", "for a sheet; without it a section, 1 m deep")
            questions.append(
                "The mesh is plane and is read as a section in plane strain, 1 m deep. For a sheet "
                "give its thickness."
            )
    tagged = read_msh(path, MPI.COMM_SELF, gdim=gdim, scale=scale, thickness=thickness)
    found = _draft(tagged, mesh, material, ask, None)
    found = replace(found, questions=(*questions, *found.questions))
    if not (found.tables.keys() & {"joints", "contacts"} or thickness):
        yield from _grown(found, path, gdim, scale)
    yield found


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


# -- joints that a file without layers gets --------------------------------------------------------


def _grown(draft: Draft, path: Path, gdim: int, scale: float) -> Iterator[Draft]:
    """The case with joints where its parts touch, the likeliest first."""
    mesh = glued(read_lists(path, gdim, scale))
    found = touches(mesh)
    if not found:
        return
    kept = [q for q in draft.questions if q != _NO_LAYER and "pieces" not in q]
    draft = replace(draft, questions=tuple(kept))
    largest = sorted(found, key=lambda touch: -touch.areas.sum())
    holes = [hole for touch in found for hole in _bolts(mesh.x, touch)]
    if holes:
        yield with_rings(draft, holes, [touch.parts for touch in largest], by_pair=False)
    pairs = ", ".join(dict.fromkeys(" and ".join(touch.parts) for touch in found))
    cells = "joint" if len(found) == 1 else "joint_*"
    joints = {"contact": springs_joint((cells,), pairs, UNBOLTED)}
    yield draft.joined({"joint": ON_ALL}, joints, [f"touching: {pairs}"], [NO_BOLTS, START])


def _bolts(x: np.ndarray, touch: Touch) -> Iterator[BoltHole]:
    """The round holes of a contact that leave room for a ring."""
    holes = round_holes(x, touch)
    rim = x[np.unique(touch.facets)]
    for hole in holes:
        thread = guess_thread(2 * hole.radius)
        cone = cone_radius(head_radius(hole.radius, thread), 2 * hole.radius)
        wanted = min(cone, _MOST * hole.radius)
        for other in holes:
            apart = float(np.linalg.norm(other.centre - hole.centre))
            if apart > hole.radius:
                wanted = min(wanted, 0.49 * apart)
        wanted = min(wanted, float(np.linalg.norm(rim - hole.centre, axis=1).max()))
        if wanted >= _LEAST * hole.radius:
            diameter = float(f"{2 * hole.radius:.3g}")
            at = np.round(hole.centre, 6)
            yield BoltHole(touch.parts, at, touch.normal, (diameter,), wanted, thread)


# -- builders --------------------------------------------------------------------------------------


def builder_draft(name: str, material: str, ask: Ask) -> Draft:
    """A case of a builder with its own default numbers.

    Raises:
        InputError: If there is no such builder.
    """
    member("builder", name, BUILDERS)
    if BUILDERS[name].origin == "beams":
        return _beams(name, material, ask)
    made = BUILDERS[name](builder=name).made()
    kinds = typing.get_type_hints(type(made), include_extras=True)
    given = {field.name: getattr(made, field.name) for field in fields(made)}
    numbers = {
        key: _written(value, kinds[key])
        for key, value in given.items()
        if key != "cell" and value not in (None, ())
    }
    hole = given.get("hole_diameter") or given.get("hole") or None
    mesh = {"builder": guess(name, "the numbers are the builder's own"), **numbers}
    found = _draft(made.build(MPI.COMM_SELF), mesh, material, ask, hole)
    return replace(found, questions=("The builder's dimensions.", *found.questions))


def _written(value: object, kind: object) -> object:
    """An argument of a builder, lengths in mm."""
    if isinstance(value, tuple | list):
        return [_written(item, kind) for item in value]
    is_length = isinstance(value, float) and "unit='m'" in repr(kind)
    return millimetres(value) if is_length else value


def _beams(name: str, material: str, ask: Ask) -> Draft:
    """Two beams in a lap; their builder has no numbers of its own."""
    mesh = {
        "builder": name,
        "lengths": guess(["360 mm", "260 mm"], "of each beam, in a row"),
        "laps": guess("50 mm", "over which each lies on the next"),
        "width": guess("21 mm"),
        "thickness": guess("10.6 mm"),
        "elements": [30, 20],
        "lap_elements": 5,
    }
    paper = "slap; Jalali et al. 2019, Table 2: beams of 21 x 10.6 mm, 23 N·m"
    lap = {
        "cells": "lap",
        "law": "generic",
        "k1": guess("1763 N m", paper),
        "k2": guess("37400 N m", "slip"),
        "c": guess("0.15 N m s"),
        "bolted": True,
    }
    parts = parts_of({"beams": (("beam_1", "beam_2"), "", material)}, ask)
    return Draft(
        {"mesh": mesh, "parts": parts, "joints": {"lap": Remark(lap, "")}},
        ("left", "right"),
        ("two beams in a lap",),
        ("The dimensions of the beams.", "The stiffness of the lap."),
    )


# -- what a mesh says ------------------------------------------------------------------------------


def _draft(tagged: TaggedMesh, mesh: Mapping, material: str, ask: Ask, hole: float | None) -> Draft:
    """Parts, joints, contacts and bolts by the names of a mesh; ``hole`` is the bolts' diameter."""
    body = body_of(tagged)
    volumes = {name: body.volume([name]) for name in tagged.cell_names}
    joints, layers, odd = _layers(tagged, list(volumes))
    parts = {
        _plain(name): ((name,), f"{1e6 * volume:.4g} cm3", material_of(name, material))
        for name, volume in volumes.items()
        if name not in layers
    }
    contacts, bolts = _pairs(tagged, bool(joints))
    bodies = check_mesh(tagged).bodies
    tables = {"mesh": mesh, "parts": parts_of(parts, ask), "joints": joints}
    questions = ["The materials: a mesh has none.", *odd]
    if contacts and bolts:
        tables |= {"contacts": _contacts(contacts), "bolts": _bolt_sections(bolts, hole)}
        questions += ["The bolts: their thread and force.", "The friction of the contacts."]
    if joints:
        questions.append("The joints' stiffness: it is what a test is to find.")
    elif not contacts and len(parts) > 1:
        questions.append(_NO_LAYER)
    if bodies > 1 and not (contacts and bolts):
        questions.append(f"The mesh is in {bodies} pieces that share no vertices: what joins them?")
    found = [f"parts: {', '.join(parts)}"]
    if joints:
        found.append(f"joints: {', '.join(joints)}")
    if contacts or bolts:
        found.append(f"faces that touch: {len(contacts)}; bolts: {len(bolts)}")
    tables = {name: table for name, table in tables.items() if table}
    return Draft(tables, tuple(tagged.facet_names), tuple(found), tuple(questions))


def _plain(name: str) -> str:
    """A group's name as a name of a section."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")
    return plain if re.match(r"[A-Za-z]", plain) else f"part_{plain}"


def _layers(tagged: TaggedMesh, names: list[str]) -> tuple[dict, set[str], list[str]]:
    """Layers among the groups: rings and what is named like a joint, where they are thin.

    Returns:
        ``[joints]``, rings that are alike as one of them; names of the groups; questions.
    """
    found, odd, joints = {}, [], {}
    rings = set(ring_names(names)) if tagged.mesh.geometry.dim == 3 else set()
    for name in names if tagged.mesh.geometry.dim == 3 else ():
        if name in rings or _JOINT.search(name):
            try:
                found[name] = measure_ring(tagged, name)
            except MeshError:
                odd.append(f"{name} is named like a joint, but is no flat layer: taken as a part.")
    own = [name for name in found if name in rings]
    alike = {
        (np.round(np.abs(found[name].normal), 6).tobytes(), f"{found[name].thickness:.3g}")
        for name in own
    }
    together = len(own) > 1 and len(alike) == 1
    for name, ring in found.items():
        faces = f"{', '.join(ring.lower)} and {', '.join(ring.upper)}"
        if together and name in own:
            cells = ("ring_*",) if len(own) == len(rings) else own
            words = f"the rings of {len(own)} bolts, {faces}"
            joints.setdefault("rings", _layer_joint(cells, words, ring))
        else:
            words = f"{faces}, {1e4 * ring.area:.3g} cm2"
            joints[_plain(name)] = _layer_joint((name,), words, ring)
    return joints, set(found), odd


def _layer_joint(cells, words: str, ring) -> Remark:
    """A joint that the mesh has: a layer of a transition material, of its thickness."""
    section = {
        "cells": cells,
        "law": "transition",
        "E": guess("6111 MPa", "identified for M12 at 120 N·m in plates of 25 mm, Ra 1.6 µm"),
        "nu": 0.253,
        "h": millimetres(ring.thickness),
        "normal": direction(ring.normal),
    }
    return Remark(section, words)


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


def _contacts(contacts) -> dict[str, dict]:
    friction = guess(0.2, "assumed: bright metal has 0.14 to 0.24 (VDI 2230-1, table A5)")
    return {
        _plain(name): {"lower": lower, "upper": upper, "friction": friction}
        for name, lower, upper in contacts
    }


def _bolt_sections(bolts, hole: float | None) -> dict[str, dict]:
    likely = guess_thread(hole) if hole else None
    kind: dict[str, object] = {"kind": "washers"}
    if likely is not None:
        kind = {"kind": "beam", "thread": guess(likely.thread.name, likely.why)}
    why = "assumed" if likely is None else BOLT_FORCE
    newtons = force_of(likely and likely.thread)
    force = guess(f"{newtons / 1e3:g} kN", f"{why}; or torque")
    return {
        _plain(name): {**kind, "lower": lower, "upper": upper, "force": force}
        for name, lower, upper in bolts
    }
