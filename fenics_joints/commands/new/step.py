"""A case from a STEP file: its solids, what touches, and the bolts that its holes are for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np

from fenics_joints.commands.new.bolted import NO_BOLTS, ON_ALL, BoltHole, free_name, with_rings
from fenics_joints.commands.new.draft import (
    UNBOLTED,
    Ask,
    Draft,
    Remark,
    guess,
    material_of,
    millimetres,
    parts_of,
    springs_joint,
)
from fenics_joints.meshes.cad_survey import Solid, StepSurvey, ThroughHole
from fenics_joints.preload.clearance import ThreadGuess, cone_radius, guess_thread, head_radius
from fenics_joints.preload.threads import thread

#: Vertices of the parts that a first mesh is to have; a mesh of degree 2 has 24 DOFs for each.
_VERTICES = 300
#: Gaps between faces that a layer closes by itself, m.
_GAP = 0.7e-3
#: Names of the joints' layers.
_LAYERS = re.compile(r"ring_\d+|joint(_\d+)?")
#: Edges of a circle: a ring's area is short by 10 %, twelve: by 5 %.
_CIRCLE = 8


def step_drafts(survey: StepSurvey, file: str, material: str, ask: Ask) -> Iterator[Draft]:
    """Cases of a STEP file, the likeliest first: rings at bolts, then layers on all that touches.

    Args:
        survey: What is in the file.
        file: Its name in the case.
        material: Of parts whose label names none.
        ask: Asks the user.
    """
    # A solid's name is changed where it is that of a joint's layer.
    names = [f"part_{s.name}" if _LAYERS.fullmatch(s.name) else s.name for s in survey.solids]
    base = _without_joints(survey, names, file, material, ask)
    bolts = [hole for hole in survey.holes if hole.room > 0]
    if bolts:
        yield _with_rings(survey, names, base, bolts, ask)
    joints, several = {}, len(survey.touching) > 1
    for number, touch in enumerate(survey.touching, start=1):
        a, b = (names[i] for i in touch.solids)
        name = free_name(f"joint_{a}_{b}" if several else "joint", joints, base)
        words = f"{a} and {b}, {1e4 * touch.area:.3g} cm2"
        cells = f"joint_{number}" if several else "joint"
        joints[name] = springs_joint((cells,), words, UNBOLTED)
    yield base.joined({"joint": ON_ALL, **_layer(survey)}, joints, (), [NO_BOLTS])


def _without_joints(
    survey: StepSurvey, names: Sequence[str], file: str, material: str, ask: Ask
) -> Draft:
    """What is the same for any kind of joint."""
    parts, numbers = {}, {}
    for number, (name, solid) in enumerate(zip(names, survey.solids, strict=True), start=1):
        volume = f"{1e6 * solid.volume:.4g} cm3"
        words = f"{solid.label!r}, {volume}" if solid.label else volume
        parts[name] = ((name,), words, material_of(solid.label, material))
        numbers[name] = Remark(number, words)
    size = millimetres(_size(survey.solids), 2)
    mesh = {
        "file": file,
        "size": guess(size, "of the largest cells; smaller is finer"),
        "circle": Remark(_CIRCLE, "edges of a circle"),
        "parts": Remark(numbers, "our names for the solids, by their number in the file"),
    }
    found = [f"{len(names)} solids: {', '.join(names)}"]
    for index, touch in enumerate(survey.touching):
        a, b = (names[i] for i in touch.solids)
        apart = f", {millimetres(touch.gap, 3)} apart" if touch.gap > 1e-6 else ""
        count = sum(hole.touch == index for hole in survey.holes)
        holes = f"{count} holes through both"
        found.append(f"{a} and {b} touch on {1e4 * touch.area:.3g} cm2{apart}, {holes}")
    return Draft(
        {"mesh": mesh, "parts": parts_of(parts, ask)},
        found=tuple(found),
        questions=(
            "The materials: a STEP file has none.",
            "The size of the cells: halve it and see what the frequencies do.",
        ),
    )


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
    holes = []
    for bolt, thread_guess in zip(bolts, _threads(bolts, ask), strict=True):
        touch = survey.touching[bolt.touch]
        holes.append(
            BoltHole(
                tuple(names[i] for i in touch.solids),
                bolt.centre,
                touch.normal,
                bolt.diameters,
                _ring(bolt, thread_guess),
                thread_guess,
                bolt.depths,
            )
        )
    largest = sorted(survey.touching, key=lambda touch: -touch.area)
    touching = [tuple(names[i] for i in touch.solids) for touch in largest if touch.gap < 1e-6]
    skipped = len(survey.holes) - len(bolts)
    more = f"Holes through two parts without room for a ring, taken as no bolts: {skipped}."
    found = with_rings(base, holes, touching, by_pair=True, more=[more] if skipped else [])
    width = millimetres(min(hole.ring - hole.radius for hole in holes), 2)
    mesh = {
        **found.tables["mesh"],
        **_layer(survey),
        "ring_size": Remark(width, "of the cells in the rings"),
    }
    return found.joined(mesh, found.tables["joints"], (), ())


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
