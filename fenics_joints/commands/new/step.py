"""A case from a STEP file: its solids, what touches, and the bolts that its holes are for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import fmean

import numpy as np

from fenics_joints.commands.new.sketch import (
    BOLT_FORCE,
    UNBOLTED,
    Ask,
    JointSketch,
    PartSketch,
    Ring,
    Sketch,
    ask_materials,
    force_of,
    material_of,
    millimetres,
    stacked,
    stacked_words,
    toml,
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


def step_sketches(survey: StepSurvey, file: str, material: str, ask: Ask) -> Iterator[Sketch]:
    """Cases of a STEP file, the likeliest first: rings at bolts, then layers on all that touches.

    Args:
        survey: What is in the file.
        file: Its name in the case.
        material: Of parts whose label names none.
        ask: Asks the user.
    """
    solids = tuple(replace(solid, name=_own_name(solid.name)) for solid in survey.solids)
    survey = replace(survey, solids=solids)
    bolts = [hole for hole in survey.holes if hole.room > 0]
    base = _base(survey, file, material, ask)
    if bolts:
        yield _with_rings(survey, base, bolts, ask)
    yield _with_layers(survey, base)


def _own_name(name: str) -> str:
    """A solid's name, changed where it is that of a joint's layer."""
    return f"part_{name}" if _LAYERS.fullmatch(name) else name


def _base(survey: StepSurvey, file: str, material: str, ask: Ask) -> Sketch:
    """What is the same for any kind of joint."""
    parts, lines = [], []
    for number, solid in enumerate(survey.solids, start=1):
        words = f"{solid.label!r}, {_cubic(solid.volume)}" if solid.label else _cubic(solid.volume)
        guess = material_of(solid.label, material)
        parts.append(PartSketch(solid.name, (solid.name,), words, guess))
        lines.append(f"{solid.name} = {number}  # {words}")
    size = _size(survey.solids)
    mesh = (
        "[mesh]",
        f"file = {toml(file)}",
        f"size = {toml(millimetres(size, 2))}  # ? of the largest cells; smaller is finer",
        f"circle = {_CIRCLE}  # edges of a circle",
        "",
        "[mesh.parts]  # our names for the solids, by their number in the file",
        *lines,
    )
    found = (
        f"{len(survey.solids)} solids: " + ", ".join(s.name for s in survey.solids),
        *(_touch_words(survey, i) for i in range(len(survey.touching))),
    )
    return Sketch(
        mesh,
        ask_materials(parts, ask),
        found=found,
        questions=(
            "The materials: a STEP file has none.",
            "The size of the cells: halve it and see what the frequencies do.",
        ),
    )


def _cubic(volume: float) -> str:
    return f"{1e6 * volume:.4g} cm3"


def _touch_words(survey: StepSurvey, index: int) -> str:
    touch = survey.touching[index]
    a, b = (survey.solids[i].name for i in touch.solids)
    apart = f", {millimetres(touch.gap, 3)} apart" if touch.gap > 1e-6 else ""
    count = sum(hole.touch == index for hole in survey.holes)
    return f"{a} and {b} touch on {1e4 * touch.area:.3g} cm2{apart}, {count} holes through both"


def _size(solids: Sequence[Solid]) -> float:
    """Size of cells with which the solids have about `_VERTICES`: on the surface and inside."""
    area, volume = sum(s.area for s in solids), sum(s.volume for s in solids)
    low, high = 1e-5, max(float(np.ptp(s.box, axis=0).max()) for s in solids)
    for _ in range(60):
        size = math.sqrt(low * high)
        count = 0.58 * area / size**2 + 1.41 * volume / size**3
        low, high = (size, high) if count > _VERTICES else (low, size)
    return size


# -- rings -----------------------------------------------------------------------------------------


def _with_rings(survey: StepSurvey, base: Sketch, bolts: Sequence[ThroughHole], ask: Ask) -> Sketch:
    guesses = _threads(bolts, ask)
    radii = [_radius(bolt, guess) for bolt, guess in zip(bolts, guesses, strict=True)]
    bonded = _bonded(survey, {survey.touching[bolt.touch].solids for bolt in bolts})
    numbers = stacked([_ring(survey, bolt) for bolt in bolts])
    names = {guess.thread.name for guess in guesses if guess}
    one = guesses[0] if len(names) == 1 and all(guesses) else None
    each = [millimetres(math.floor(1e4 * radius) / 1e4) for radius in radii]
    lines = [
        "",
        "[mesh.bolts]  # a ring of the joint's layer around each bolt",
        *(
            [
                f"thread = {toml(*names)}  # ? {one.why}{_or(one)}",
                f'force = "{force_of(one.thread) / 1e3:g} kN"  # ? {BOLT_FORCE}',
                f"hole = {toml(_holes(bolts))}  # diameter",
            ]
            if one
            else []
        ),
        "# Outer radii of the rings, where the pressure ends: a cone of 30 degrees from the head,",
        "# as far as there is room on the faces.",
        f"r_wai = {toml(each[0] if len(set(each)) == 1 else each)}",
        "at = [",
        *(
            _bolt_line(i, survey, *each)
            for i, each in enumerate(zip(bolts, guesses, numbers, strict=True), start=1)
        ),
        "]",
    ]
    pressures = (
        None
        if one
        else [
            force_of(guess and guess.thread) / (math.pi * (r**2 - (max(bolt.diameters) / 2) ** 2))
            for bolt, guess, r in zip(bolts, guesses, radii, strict=True)
        ]
    )
    joints = _ring_joints(survey, bolts, pressures)
    mesh, head = [*base.mesh], _layer(survey)
    widths = [r - max(b.diameters) / 2 for r, b in zip(radii, bolts, strict=True)]
    head.append(f"ring_size = {toml(millimetres(min(widths), 2))}  # of the cells in the rings")
    if bonded:
        pairs = [[survey.solids[i].name for i in pair] for pair in bonded]
        head.append(f"bonded = {toml(pairs)}  # ? they touch and have no bolt: welded?")
    mesh[4:4] = head
    skipped = len(survey.holes) - len(bolts)
    questions = [
        "The threads of the bolts, by the holes (ISO 273), and their force.",
        "The joints' stiffness, by roughness and pressure: it is what a test is to find.",
        *(["Parts that touch without bolts are taken as welded."] if bonded else []),
        *(
            [f"Holes through two parts without room for a ring, taken as no bolts: {skipped}."]
            if skipped
            else []
        ),
    ]
    there = [f"{stacked_words(numbers)}: {', '.join(sorted(names)) or 'no standard thread'}"]
    return replace(
        base,
        mesh=tuple([*mesh, *lines]),
        joints=tuple(joints),
        found=(*base.found, *there),
        questions=(*base.questions, *questions),
    )


def _holes(bolts: Sequence[ThroughHole]) -> str | list[str]:
    """Diameter of the bolts' holes, or the least and the largest."""
    found = [d for bolt in bolts for d in bolt.diameters]
    words = dict.fromkeys([millimetres(min(found)), millimetres(max(found))])
    return [*words] if len(words) > 1 else [*words][0]


def _threads(bolts: Sequence[ThroughHole], ask: Ask) -> list[ThreadGuess | None]:
    """The thread of each bolt; asked for once for each pair of diameters."""
    answers: dict[tuple[float, float], ThreadGuess | None] = {}
    found = []
    for bolt in bolts:
        low, high = sorted(round(1e6 * d) / 1e6 for d in bolt.diameters)
        if (low, high) not in answers:
            guess = guess_thread(high, low)
            if guess is not None:
                holes = (
                    f"{1e3 * low:.4g} and {1e3 * high:.4g} mm"
                    if low < high
                    else f"{1e3 * low:.4g} mm"
                )
                name = ask(f"Thread of the bolts in holes of {holes}", guess.thread.name, thread)
                if thread(name) != guess.thread:
                    guess = ThreadGuess(thread(name), "as you said", ())
            answers[low, high] = guess
        found.append(answers[low, high])
    return found


def _radius(bolt: ThroughHole, guess: ThreadGuess | None) -> float:
    """Where a bolt's pressure ends, by the cone from its head; not beyond the room there is."""
    hole = max(bolt.diameters) / 2
    depths = [d for d in bolt.depths if d > 0]
    cone = cone_radius(head_radius(hole, guess), min(depths, default=hole))
    return min(bolt.room, max(cone, 1.2 * hole))


def _or(guess: ThreadGuess) -> str:
    return f"; or {' or '.join(guess.others)}" if guess.others else ""


def _ring(survey: StepSurvey, bolt: ThroughHole) -> Ring:
    touch = survey.touching[bolt.touch]
    return Ring(touch.solids, bolt.centre, touch.normal, max(bolt.diameters) / 2, bolt.depths)


def _bolt_line(number: int, survey: StepSurvey, bolt: ThroughHole, guess, of: int) -> str:
    a, b = (survey.solids[i].name for i in survey.touching[bolt.touch].solids)
    holes = " and ".join(f"{1e3 * d:.4g}" for d in dict.fromkeys(np.round(bolt.diameters, 7)))
    name = f"{guess.thread.name}{_or(guess)}?" if guess else "no standard thread"
    at = toml([millimetres(c) for c in bolt.centre + 0.0])
    of = f" (bolt {of})" if of != number else ""
    return f"  {at},  # {number}{of}: {a} and {b}, {holes} mm, {name}"


def _layer(survey: StepSurvey) -> list[str]:
    """A line for the layer's thickness where the drawing has a gap that needs one."""
    gap = max((touch.gap for touch in survey.touching), default=0.0)
    if gap <= _GAP:
        return []
    return [f"layer = {toml(millimetres(1.05 * gap, 3))}  # of the joints; closes a gap"]


def _bonded(survey: StepSurvey, bolted: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs that must hang together by something else than bolts, as no bolts do it."""
    group = list(range(len(survey.solids)))

    def join(a: int, b: int) -> bool:
        old, new = group[b], group[a]
        group[:] = [new if g == old else g for g in group]
        return old != new

    for pair in sorted(bolted):
        join(*pair)
    largest = sorted(survey.touching, key=lambda touch: -touch.area)
    return [t.solids for t in largest if t.gap < 1e-6 and join(*t.solids)]


def _ring_joints(
    survey, bolts: Sequence[ThroughHole], pressures: Sequence[float] | None
) -> list[JointSketch]:
    """A section for all bolts between two parts that look the same way."""
    groups: dict[tuple, list[int]] = {}
    for number, bolt in enumerate(bolts, start=1):
        touch = survey.touching[bolt.touch]
        way = touch.normal * (1 if touch.normal[np.abs(touch.normal).argmax()] > 0 else -1)
        groups.setdefault((touch.solids, tuple(np.round(way, 6) + 0.0)), []).append(number)
    found, used = [], set()
    for (solids, _), numbers in groups.items():
        a, b = (survey.solids[i].name for i in solids)
        name = _free("joint" if len(groups) == 1 else f"joint_{a}_{b}", used, survey)
        words = f"{len(numbers)} bolt{'s' if len(numbers) > 1 else ''} between {a} and {b}"
        cells = tuple(f"ring_{n}" for n in numbers)
        mean = None if pressures is None else fmean(pressures[n - 1] for n in numbers)
        found.append(JointSketch(name, cells, words, pressure=mean))
    return found


def _free(name: str, used: set[str], survey: StepSurvey) -> str:
    taken = used | {solid.name for solid in survey.solids}
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    used.add(free)
    return free


# -- layers ----------------------------------------------------------------------------------------


def _with_layers(survey: StepSurvey, base: Sketch) -> Sketch:
    several = len(survey.touching) > 1
    joints, used = [], set()
    for number, touch in enumerate(survey.touching, start=1):
        a, b = (survey.solids[i].name for i in touch.solids)
        cells = f"joint_{number}" if several else "joint"
        name = _free(f"joint_{a}_{b}" if several else "joint", used, survey)
        words = f"{a} and {b}, {1e4 * touch.area:.3g} cm2"
        joints.append(JointSketch(name, (cells,), words, pressure=UNBOLTED))
    mesh = [*base.mesh]
    mesh[4:4] = ['joint = "layer"  # on all that touches', *_layer(survey)]
    asked = "No bolts were found: a layer joins all that touches; is it clamped, glued, welded?"
    return replace(base, mesh=tuple(mesh), joints=tuple(joints), questions=(*base.questions, asked))
