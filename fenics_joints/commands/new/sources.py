"""A case from its structure: a STEP file, a ``.msh`` file with names, or a builder."""

from __future__ import annotations

import math
import re
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.case.mesh import BUILDERS
from fenics_joints.commands.check.weights import USUAL_KG, body_of
from fenics_joints.commands.new.draft import (
    BOLT_FORCE,
    FRICTION,
    MATERIALS,
    NO_BOLTS,
    START,
    UNBOLTED,
    Ask,
    BoltHole,
    Draft,
    Remark,
    direction,
    force_of,
    free_name,
    guess,
    material_of,
    millimetres,
    parts_of,
    springs_joint,
    stacked,
    torque_of,
    unbolted_pairs,
    with_rings,
)
from fenics_joints.errors import InputError, MeshError, member
from fenics_joints.meshes import TaggedMesh, measure_ring, read_msh
from fenics_joints.meshes.cad_survey import LeftOut, Solid, StepSurvey, ThroughHole
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.decks import DECKS, Deck, read_deck
from fenics_joints.meshes.grow import Touch, glued, round_holes, touches
from fenics_joints.meshes.msh import read_lists
from fenics_joints.meshes.rings import ring_names
from fenics_joints.meshes.tagged import limits
from fenics_joints.preload.clearance import ThreadGuess, cone_radius, guess_thread, head_radius
from fenics_joints.preload.threads import thread
from fenics_joints.structure.faces import check_contact
from fenics_joints.units import to_si

#: Factors to metres of the units that files are in, the largest first.
UNITS = {"m": 1.0, "inch": 0.0254, "cm": 1e-2, "mm": 1e-3}
#: Between these numbers of a unit, in metres, structures are that stand in a lab.
METRES = (1e-3, 15.0)
#: Sensors stand a little beside the drawing, too: share of its extent, and m.
_ROOM, _BESIDE = 1.02, 1e-3


@dataclass(frozen=True)
class Source:
    """Where the structure of a case comes from: a STEP file, a .msh file or a builder.

    With ``preload`` the parts of a STEP file are in contact under the force of its bolts.
    """

    step: Path | None = None
    msh: Path | None = None
    builder: str | None = None
    matrices: tuple[Path, ...] | None = None
    preload: bool = False

    def extents(self, survey: StepSurvey | None) -> np.ndarray | None:
        """Along the axes, m, shape (2,) or (3,); None if they cannot be known.

        Args:
            survey: What is in the STEP file, if it could be read.
        """
        if survey is not None:
            return np.ptp([solid.box for solid in survey.solids], axis=(0, 1))
        for gdim in (3, 2) if self.msh is not None else ():
            with suppress(MeshError):
                extents = np.ptp(read_lists(self.msh, gdim, 1.0).x, axis=0)
                return UNITS[likely_unit(extents, None)] * extents
        kind = BUILDERS.get(self.builder)
        if kind is None or kind.origin == "beams":
            return None
        built = kind(builder=self.builder).made().build(MPI.COMM_SELF)
        return np.ptp(built.mesh.geometry.x, axis=0)

    def drafts(
        self, survey: StepSurvey | None, file: str, places: np.ndarray, material: str, ask: Ask
    ) -> Iterator[Draft]:
        """Cases that the file may mean, the likeliest first.

        Args:
            survey: What is in the STEP file.
            file: The file's name in the case.
            places: Sensors of the test, m, which say the unit of a .msh file; shape (n, 3).
            material: Material of parts whose name says none.
            ask: Asks the user.

        Raises:
            MeshError: As `read_msh`.
            InputError: If there is no such builder.
        """
        if survey is not None:
            drafted = preload_draft if self.preload else step_drafts
            yield from drafted(survey, file, material, ask)
        elif self.msh is not None:
            yield from msh_drafts(self.msh, file, places, material, ask)
        elif self.builder is not None:
            yield builder_draft(self.builder, material, ask)


def likely_unit(spans: Sequence[float], extents: np.ndarray | None) -> str:
    """The largest unit with which places span no more than the structure.

    Turned or moved axes change nothing; sensors on a small part of a structure may mislead, so it
    is a guess.

    Args:
        spans: Of the places along their axes, in their unit.
        extents: Of the structure, m; None if they are not known, and then a usual size decides.
    """
    spans = np.sort(spans)[::-1]
    if extents is None:
        return "m" if METRES[0] <= spans[0] <= METRES[1] else "mm"
    room = np.zeros(len(spans))
    room[: len(extents)] = np.sort(extents)[::-1][: len(spans)]
    for unit, factor in UNITS.items():
        if np.all(factor * spans <= _ROOM * room + _BESIDE):
            return unit
    return "mm"


# -- STEP files ------------------------------------------------------------------------------------

#: Vertices of the parts that a first mesh is to have; a mesh of degree 2 has 24 DOFs for each.
_VERTICES = 300
#: Gaps between faces that a layer closes without a thickness of its own, m.
_GAP = 0.7e-3
#: Kinds of solids that are left out.
_KINDS = {"bolt": "bolt or pin", "ring": "nut or washer", "twin": "solid drawn twice"}
_PLURALS = {"bolt": "bolts or pins", "ring": "nuts or washers", "twin": "solids drawn twice"}
#: Where the mass of a bolt without a ring is put, as a multiple of its hole's radius. Chosen: heads
#: have 1.35 and more.
_UNDER_HEAD = 1.2
#: Names of the joints' layers.
_LAYERS = re.compile(r"ring_\d+|joint(_\d+)?")
#: Edges of a circle: a ring's area is short by 10 %, twelve: by 5 %.
_CIRCLE = 8
#: Edges of a circle in a preload, which shows the pressure around holes.
_FINE_CIRCLE = 16


def step_drafts(survey: StepSurvey, file: str, material: str, ask: Ask) -> Iterator[Draft]:
    """Cases of a STEP file, the likeliest first: rings at bolts, then layers on all that touches.

    Args:
        survey: What is in the file.
        file: Its name in the case.
        material: Of parts whose label names none.
        ask: Asks the user.
    """
    names = _names(survey)
    base = _without_joints(survey, names, file, material, ask)
    bolts = [hole for hole in survey.holes if hole.room > 0]
    if bolts:
        yield _with_rings(survey, names, _with_masses(base, survey, bolts), bolts, ask)
    base = _with_masses(base, survey, [])
    if len(survey.solids) - len(survey.left_out) == 1:
        yield replace(base, found=(*base.found, "one part, and so no joint"))
        return
    joints, several = {}, len(survey.touching) > 1
    for number, touch in enumerate(survey.touching, start=1):
        a, b = (names[i] for i in touch.solids)
        name = free_name(f"joint_{a}_{b}" if several else "joint", joints, base)
        words = f"{a} and {b}, {1e4 * touch.area:.3g} cm2"
        cells = f"joint_{number}" if several else "joint"
        joints[name] = springs_joint((cells,), words, UNBOLTED)
    yield base.joined({"joint": "layer", **_layer(survey)}, joints, (), [NO_BOLTS])


def preload_draft(survey: StepSurvey, file: str, material: str, ask: Ask) -> Iterator[Draft]:
    """The case of a STEP file whose parts are in contact, with bolts and faces under their heads.

    Args:
        survey: What is in the file.
        file: Its name in the case.
        material: Of parts whose label names none.
        ask: Asks the user.

    Raises:
        InputError: If there is no bolt whose two ends are found.
    """
    names = _names(survey)
    base = _with_masses(_without_joints(survey, names, file, material, ask), survey, [])
    threads = _threads(survey.holes, ask)
    holes = [
        _bolt_hole(survey, names, hole, likely)
        for hole, likely in zip(survey.holes, threads, strict=True)
    ]
    stacks: dict[int, list[int]] = {}
    for i, number in enumerate(stacked(holes)):
        stacks.setdefault(number, []).append(i)
    washers, faces, bolts, widths, bolted = {}, {}, {}, [], []
    for own in stacks.values():
        ends = _ends(survey, holes, own)
        if ends is None:
            continue
        axis = holes[own[0]].normal
        widest = max(own, key=lambda i: holes[i].radius)
        radius, likely = holes[widest].radius, threads[widest]
        name = f"bolt_{len(bolts) + 1}"
        for end, seat in zip(("lower", "upper"), ends, strict=True):
            if seat.room == 0:
                faces[f"{name}_{end}"] = [[millimetres(c) for c in seat.point]]
                continue
            outer = min(head_radius(radius, likely), 0.98 * seat.room)
            washers[f"{name}_{end}"] = {
                "at": [millimetres(c) for c in seat.centre],
                "radius": guess(
                    millimetres(outer, 4), "half the width across flats, if there is room"
                ),
            }
            widths.append(outer - radius)
        words = ", ".join(dict.fromkeys(holes[i].words for i in own))
        bolts[name] = Remark(_bolt(f"{name}_lower", f"{name}_upper", likely, axis), words)
        bolted += [holes[i].parts for i in own]
    if not bolts:
        raise InputError(
            "--preload: no bolt was found; expected a round hole through two parts that touch, "
            "with a flat face or a cone for a head at one end at least"
        )
    largest = sorted(survey.touching, key=lambda touch: -touch.area)
    pairs = list(dict.fromkeys(tuple(names[i] for i in touch.solids) for touch in largest))
    mesh = {"joint": "contact", "circle": _FINE_CIRCLE}
    questions = [
        "The bolts: their threads, by the holes (ISO 273), torque and friction.",
        "The friction of the contacts.",
    ]
    if glued_pairs := unbolted_pairs(pairs, bolted):
        mesh["bonded"] = guess(glued_pairs, "they touch and have no bolt: welded?")
        questions.append("Parts that touch without bolts are taken as welded.")
    if missing := len(stacks) - len(bolts):
        questions.append(f"Holes through parts whose ends show no bolt, taken as none: {missing}.")
    if widths:
        mesh["ring_size"] = Remark(millimetres(min(widths), 2), "of the cells under the washers")
    mesh |= {key: table for key, table in (("washers", washers), ("faces", faces)) if table}
    kept = [pair for pair in pairs if list(pair) not in glued_pairs]
    contacts = _contacts([(f"{a}_{b}", f"{a}_to_{b}", f"{b}_to_{a}") for a, b in kept])
    tables = {
        **base.tables,
        "mesh": {**base.tables["mesh"], **mesh},
        "contacts": contacts,
        "bolts": bolts,
    }
    found = f"{len(bolts)} bolts under their force, {len(contacts)} contacts"
    yield replace(
        base, tables=tables, found=(*base.found, found), questions=(*base.questions, *questions)
    )


def _names(survey: StepSurvey) -> list[str]:
    """Names of the solids, changed where they are those of a joint's layer."""
    return [f"part_{s.name}" if _LAYERS.fullmatch(s.name) else s.name for s in survey.solids]


def _bolt_hole(
    survey: StepSurvey, names: Sequence[str], hole: ThroughHole, likely: ThreadGuess | None
) -> BoltHole:
    touch = survey.touching[hole.touch]
    parts = tuple(names[i] for i in touch.solids)
    ring = _ring(hole, likely)
    return BoltHole(parts, hole.centre, touch.normal, hole.diameters, ring, likely, hole.depths)


def _ends(survey: StepSurvey, holes: Sequence[BoltHole], own: Sequence[int]):
    """The first and the last seat of a bolt along its axis; None where an end is not found."""
    axis = holes[own[0]].normal
    seats = [seat for i in own for seat in survey.holes[i].seats if seat is not None]
    if len(seats) != 2 or all(seat.kind == "thread" for seat in seats):
        return None
    return sorted(seats, key=lambda seat: float(seat.point @ axis))


def _bolt(
    lower: str, upper: str, likely: ThreadGuess | None, axis: np.ndarray
) -> dict[str, object]:
    """A bolt as a force on the faces under head and nut, by its torque if it has a thread."""
    bolt = {"kind": "washers", "lower": lower, "upper": upper, "axis": direction(axis)}
    if likely is None:
        return {
            **bolt,
            "force": guess(f"{force_of(None) / 1e3:g} kN", "assumed; or thread and torque"),
        }
    why = "for 60 % of the proof stress of class 8.8 (ISO 898-1): assumed"
    return {
        **bolt,
        "thread": guess(likely.thread.name, likely.why),
        "torque": guess(f"{torque_of(likely.thread):g} N m", why),
        "friction": guess(FRICTION, "of thread and head; VDI 2230-1, table A5: 0.10 to 0.16"),
    }


def _without_joints(
    survey: StepSurvey, names: Sequence[str], file: str, material: str, ask: Ask
) -> Draft:
    """What is the same for any kind of joint."""
    parts, numbers = {}, {}
    out = {item.solid for item in survey.left_out}
    for number, (name, solid) in enumerate(zip(names, survey.solids, strict=True), start=1):
        if number - 1 in out:
            continue
        volume = f"{1e6 * solid.volume:.4g} cm3"
        words = f"{solid.label!r}, {volume}" if solid.label else volume
        parts[name] = ((name,), words, material_of(solid.label, material))
        numbers[name] = Remark(number, words)
    own = [solid for i, solid in enumerate(survey.solids) if i not in out]
    size = millimetres(_size(own), 2)
    mesh = {
        "file": file,
        "size": guess(size, "of the largest cells; smaller is finer"),
        "circle": _CIRCLE,
        "parts": numbers,
    }
    found = [f"{len(names)} solid{'s' * (len(names) > 1)}: {', '.join(names)}"]
    questions = ["The materials: a STEP file has none."]
    if out:
        left = sorted(survey.left_out, key=lambda item: item.solid)
        words = {i.solid: f"{_KINDS[i.kind]}, {names[i.solid]}" for i in left}
        mesh["without"] = [guess(i + 1, said) for i, said in words.items()]
        counts = {kind: sum(item.kind == kind for item in left) for kind in _KINDS}
        said = [
            f"{n} {_PLURALS[kind] if n > 1 else _KINDS[kind]}" for kind, n in counts.items() if n
        ]
        found.append(f"left out: {', '.join(said)} ({', '.join(names[i] for i in sorted(out))})")
        questions.append(
            "Solids left out because of their shape and place: are they fasteners or duplicates?"
        )
    for index, touch in enumerate(survey.touching):
        a, b = (names[i] for i in touch.solids)
        apart = f", {millimetres(touch.gap, 3)} apart" if touch.gap > 1e-6 else ""
        count = sum(hole.touch == index for hole in survey.holes)
        holes = f"{count} holes through both"
        found.append(f"{a} and {b} touch on {1e4 * touch.area:.3g} cm2{apart}, {holes}")
    return Draft(
        {"mesh": mesh, "parts": parts_of(parts, ask)},
        found=tuple(found),
        questions=(*questions, "The size of the cells: halve it and see what the frequencies do."),
    )


def _with_masses(base: Draft, survey: StepSurvey, rings: Sequence[ThroughHole]) -> Draft:
    """The case with the mass of bolts, nuts and washers that are left out.

    It is put into the middle of a hole with a ring, which takes it, or else around the hole.

    Args:
        base: The case.
        survey: What is in the file.
        rings: Holes that have a ring.
    """
    rho, bolts = MATERIALS["steel"].rho, []
    for item in survey.left_out:
        if item.kind == "twin":
            continue
        kilograms = to_si(rho, "kg/m3") * survey.solids[item.solid].volume
        for there in bolts:
            if _on_axis(item.centre, there[0].centre, there[0]):
                there[1] += kilograms
                break
        else:
            bolts.append([item, kilograms])
    groups: dict[str, list] = {}
    for item, kilograms in bolts:
        groups.setdefault(f"{kilograms:.3g}", []).append((item, kilograms))
    masses = {}
    for number, own in enumerate(groups.values(), start=1):
        points = []
        for item, _ in own:
            here = [hole.centre for hole in rings if _on_axis(hole.centre, item.centre, item)]
            points += here[:1] or _around(item)
        name = f"fasteners_{number}" if len(groups) > 1 else "fasteners"
        each = f"{1e3 * own[0][1]:.3g} g each"
        words = f"{len(own)} bolt{'s' * (len(own) > 1)} with nuts and washers, {each}"
        masses[name] = Remark(
            {
                "mass": guess(f"{1e3 * sum(m for _, m in own):.4g} g", f"by volume, {rho}"),
                "points": [[millimetres(c) for c in point] for point in points],
            },
            words,
        )
    return replace(base, tables={**base.tables, **({"masses": masses} if masses else {})})


def _on_axis(point: np.ndarray, centre: np.ndarray, item: LeftOut) -> bool:
    beside = np.cross(point - centre, item.axis)
    return bool(np.linalg.norm(beside) < 0.5 * item.radius)


def _around(item: LeftOut) -> list[np.ndarray]:
    """Four points on the face around a bolt's hole, under its head or nut."""
    first, second = np.linalg.svd(item.axis[None])[2][1:]
    ways = (first, second, -first, -second)
    return [item.centre + _UNDER_HEAD * item.radius * way for way in ways]


def _size(solids: Sequence[Solid]) -> float:
    """Size of cells with which the solids have about `_VERTICES`: on the surface and inside."""
    area, volume = sum(s.area for s in solids), sum(s.volume for s in solids)
    low, high = 1e-5, max(float(np.ptp(s.box, axis=0).max()) for s in solids)
    for _ in range(60):
        size = math.sqrt(low * high)
        count = 0.58 * area / size**2 + 1.41 * volume / size**3
        low, high = (size, high) if count > _VERTICES else (low, size)
    return size


def _with_rings(
    survey: StepSurvey, names: Sequence[str], base: Draft, bolts: Sequence[ThroughHole], ask: Ask
) -> Draft:
    holes = [
        _bolt_hole(survey, names, bolt, likely)
        for bolt, likely in zip(bolts, _threads(bolts, ask), strict=True)
    ]
    largest = sorted(survey.touching, key=lambda touch: -touch.area)
    touching = [tuple(names[i] for i in touch.solids) for touch in largest if touch.gap < 1e-6]
    skipped = len(survey.holes) - len(bolts)
    more = f"Holes through two parts without room for a ring, taken as no bolts: {skipped}."
    found = with_rings(base, holes, touching, by_pair=True, more=[more] if skipped else [])
    width = millimetres(min(hole.ring - hole.radius for hole in holes), 2)
    mesh = {**_layer(survey), "ring_size": width}
    return found.joined(mesh, found.tables["joints"])


def _threads(bolts: Sequence[ThroughHole], ask: Ask) -> list[ThreadGuess | None]:
    """The thread of each bolt; asked for once for each pair of diameters."""
    answers: dict[tuple[float, float], ThreadGuess | None] = {}
    found = []
    for bolt in bolts:
        low, high = sorted(round(1e6 * d) / 1e6 for d in bolt.diameters)
        if (low, high) not in answers:
            likely = guess_thread(high, low)
            if likely is not None:
                holes = f"{1e3 * low:.4g}" + (f" and {1e3 * high:.4g}" if low < high else "")
                question = f"Thread of the bolts in holes of {holes} mm"
                name = ask(question, likely.thread.name, thread)
                if thread(name) != likely.thread:
                    likely = ThreadGuess(thread(name), "as you said", ())
            answers[low, high] = likely
        found.append(answers[low, high])
    return found


def _ring(bolt: ThroughHole, likely: ThreadGuess | None) -> float:
    """Where a bolt's pressure ends, by the cone from its head; not beyond the room there is."""
    hole = max(bolt.diameters) / 2
    depths = [d for d in bolt.depths if d > 0]
    cone = cone_radius(head_radius(hole, likely), min(depths, default=hole))
    return min(bolt.room, max(cone, 1.2 * hole))


def _layer(survey: StepSurvey) -> dict[str, Remark]:
    """The layer's thickness where the drawing has a gap that needs one."""
    gap = max((touch.gap for touch in survey.touching), default=0.0)
    if gap <= _GAP:
        return {}
    return {"layer": Remark(millimetres(1.05 * gap, 3), "of the joints; closes a gap")}


# -- .msh files ------------------------------------------------------------------------------------

#: Names that layers of joints have.
_JOINT = re.compile(r"joint|ring|layer|lap\b|zone|interface|contact|glue|fuge|naht|gasket", re.I)
#: Units of meshes, the most frequent first, and a density to recognise them by, kg/m3.
_UNITS, _STEEL = ("m", "mm", "inch", "cm"), 7850.0
#: Largest and least radius of a ring as a multiple of the hole's.
_MOST, _LEAST = 4.0, 1.2
_NO_LAYER = "The mesh has no layer between its parts: they are bonded where they share vertices."


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
    except MeshError as in_space:
        try:
            tagged, gdim = read_msh(path, MPI.COMM_SELF, gdim=2), 2
        except MeshError:
            raise in_space from None
    size = float(np.ptp(np.array(limits(tagged)), axis=0).max())
    volume = float(body_of(tagged).volumes.sum()) if gdim == 3 else None
    sizes = ", ".join(f"{1e3 * size * scale:.4g} mm in {name}" for name, scale in UNITS.items())
    question = f"Unit of the lengths in {path.name} (its extent is {size:.6g}: {sizes})"
    deck = read_deck(path) if path.suffix.lower() in DECKS else None
    system = None if deck is None else _system(deck)
    likely = _unit(size, volume, places) if system is None else _SYSTEMS[system][0]
    unit = ask(question, likely, lambda answer: member("unit", answer, UNITS))
    scale = UNITS[unit]
    words = f"the file is in {unit}: it is {size * scale:.4g} m long"
    mesh = {"file": file, "scale": guess(f"{scale:g} m", words)}
    questions, thickness = [f"The unit of the mesh, which {path.name} does not say."], None
    if gdim == 2:
        thickness = _thickness(path, ask)
        mesh["gdim"] = 2
        if thickness is not None:
            mesh["thickness"] = millimetres(thickness)
        else:
            mesh["# thickness"] = guess("2 mm", "for a sheet; without it a section, 1 m deep")
            questions.append(
                "The mesh is plane and is read as a section in plane strain, 1 m deep. For a sheet "
                "give its thickness."
            )
    tagged = read_msh(path, MPI.COMM_SELF, gdim=gdim, scale=scale, thickness=thickness)
    found = _draft(tagged, mesh, material, ask, None)
    if deck is not None:
        found = _with_deck(found, deck, scale, system)
    said = tuple(f"the mesh: {note}" for note in tagged.notes)
    found = replace(found, found=(*said, *found.found), questions=(*questions, *found.questions))
    if not (found.tables.keys() & {"joints", "contacts"} or thickness):
        yield from _grown(found, path, gdim, scale)
    yield found


def _system(deck: Deck) -> str | None:
    """The consistent units in which a deck's materials are usual; None if it says none."""
    for name, (_, pascal, density) in _SYSTEMS.items():
        usual = [
            _MODULI[0] <= pascal * E <= _MODULI[1]
            and (not rho or _DENSITIES[0] <= density * rho <= _DENSITIES[1])
            for E, _, rho in deck.materials.values()
            if E
        ]
        if usual and all(usual):
            return name
    return None


def _with_deck(draft: Draft, deck: Deck, scale: float, system: str | None) -> Draft:
    """The case with the materials and point masses that a deck says.

    Args:
        draft: The case.
        deck: The deck.
        scale: Length of its unit, m.
        system: Its units, of `_SYSTEMS`; None if they are not known.
    """
    if system is None:
        odd = "The units of the deck's materials were not recognised." if deck.materials else ""
        return replace(draft, questions=(*draft.questions, *([odd] if odd else [])))
    parts, (unit, pascal, density) = dict(draft.tables["parts"]), _SYSTEMS[system]
    whole = 0
    for name, (E, nu, rho) in deck.materials.items():
        part = parts.get(_plain(name))
        if part is None or not E:
            continue
        said = {"E": Remark(f"{1e-9 * pascal * E:.6g} GPa", f"of the deck, in {system}")}
        said |= {} if nu is None else {"nu": Remark(nu, "of the deck")}
        said |= {"rho": Remark(f"{density * rho:.6g} kg/m3", "of the deck")} if rho else {}
        parts[_plain(name)] = Remark({**part.value, **said}, part.words)
        whole += len(said) == 3
    questions = [q for q in draft.questions if q != _MATERIALS or whole < len(parts)]
    tables = {**draft.tables, "parts": parts}
    kilograms = density * UNITS[unit] ** 3 * deck.masses[:, 3]
    masses = {
        f"mass_{i + 1}": {
            "mass": f"{kg:.6g} kg",
            "points": [[millimetres(scale * c) for c in place]],
        }
        for i, (kg, place) in enumerate(zip(kilograms, deck.masses[:, :3], strict=True))
        if kg > 0
    }
    return replace(
        draft,
        tables={**tables, **({"masses": masses} if masses else {})},
        questions=tuple(questions),
    )


_MATERIALS = "The materials: a mesh has none."
#: Units of lengths, Pa in one of stress and kg/m3 in one of density, of consistent units of decks.
_SYSTEMS = {
    "Pa, m and kg": ("m", 1.0, 1.0),
    "MPa, mm and t": ("mm", 1e6, 1e12),
    "psi, inches and lbf s2/in": ("inch", 6894.757, 1.0686895e7),
    "kPa, mm and kg": ("mm", 1e3, 1e9),
    "GPa, mm and kg": ("mm", 1e9, 1e9),
}
#: Moduli, Pa, and densities, kg/m3, of usual solids.
_MODULI, _DENSITIES = (1e8, 1.2e12), (400.0, 25e3)


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
    yield draft.joined({"joint": "layer"}, joints, [f"touching: {pairs}"], [NO_BOLTS, START])


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
    mesh = {"builder": guess(name, "the numbers are the builder's defaults"), **numbers}
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
    paper = "normal; Jalali et al. 2019, Table 2: beams of 21 x 10.6 mm, 23 N·m"
    lap = {
        "cells": "lap",
        "law": "generic",
        "k1": guess("1763 N m", paper),
        "k2": guess("37400 N m", "tangential"),
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
    questions = [_MATERIALS, *odd]
    if contacts and bolts:
        tables |= {"contacts": _contacts(contacts), "bolts": _bolt_sections(bolts, hole)}
        questions += ["The bolts: their thread and force.", "The friction of the contacts."]
    if joints:
        questions.append("The joints' stiffness: the test is to identify it.")
    elif not contacts and len(parts) > 1:
        questions.append(_NO_LAYER)
    if bodies > 1 and not (contacts and bolts):
        questions.append(f"The mesh is in {bodies} pieces without common vertices: how joined?")
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
