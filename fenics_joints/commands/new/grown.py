"""Joints for a ``.msh`` file that has none: rings round the bolts in its holes, or layers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fenics_joints.commands.new.sketch import (
    BOLT_FORCE,
    UNBOLTED,
    JointSketch,
    Ring,
    Sketch,
    force_of,
    millimetres,
    stacked,
    stacked_words,
    toml,
)
from fenics_joints.meshes.msh import read_lists
from fenics_joints.meshes.touching import Touch, glued, round_holes, touches
from fenics_joints.preload.clearance import ThreadGuess, cone_radius, guess_thread, head_radius

#: Largest radius of a ring as a multiple of the hole's.
_MOST = 4.0
#: A ring is at least so much wider than its hole.
_LEAST = 1.2


@dataclass(frozen=True)
class _Bolt:
    """A bolt: its place, m, the faces' normal, radii of hole and ring, and its thread."""

    parts: tuple[str, str]
    centre: np.ndarray
    normal: np.ndarray
    hole: float
    ring: float
    guess: ThreadGuess | None


def with_joints(sketch: Sketch, path: Path, gdim: int, scale: float) -> Iterator[Sketch]:
    """The case with joints where its parts touch, the likeliest first; at last as it is.

    Args:
        sketch: A case of a mesh without joints.
        path: The mesh.
        gdim: Its dimension.
        scale: Metres of its unit.
    """
    mesh = glued(read_lists(path, gdim, scale))
    found = touches(mesh)
    if found:
        bolts = [bolt for touch in found for bolt in _bolts(mesh.x, touch)]
        if bolts:
            yield _with_rings(sketch, found, bolts)
        yield _with_layers(sketch, found)
    yield sketch


def _bolts(x: np.ndarray, touch: Touch) -> Iterator[_Bolt]:
    """Bolts in the round holes of a contact that leave room for a ring."""
    holes = round_holes(x, touch)
    rim = x[np.unique(touch.facets)]
    for hole in holes:
        guess = guess_thread(2 * hole.radius)
        cone = cone_radius(head_radius(hole.radius, guess), 2 * hole.radius)
        wanted = min(cone, _MOST * hole.radius)
        for other in holes:
            apart = float(np.linalg.norm(other.centre - hole.centre))
            if apart > hole.radius:
                wanted = min(wanted, 0.49 * apart)
        wanted = min(wanted, float(np.linalg.norm(rim - hole.centre, axis=1).max()))
        if wanted >= _LEAST * hole.radius:
            yield _Bolt(touch.parts, hole.centre, touch.normal, hole.radius, wanted, guess)


def _with_rings(sketch: Sketch, found: list[Touch], bolts: list[_Bolt]) -> Sketch:
    names = {bolt.guess.thread.name for bolt in bolts if bolt.guess}
    one = bolts[0].guess if len(names) == 1 and all(bolt.guess for bolt in bolts) else None
    numbers = stacked([Ring(b.parts, b.centre, b.normal, b.hole) for b in bolts])
    radii = [millimetres(math.floor(1e4 * bolt.ring) / 1e4) for bolt in bolts]
    lines = [
        *_bonded(found, bolts),
        "",
        "[mesh.bolts]  # a ring of the joint around each bolt",
        *(
            [
                f"thread = {toml(one.thread.name)}  # ? {one.why}",
                f'force = "{force_of(one.thread) / 1e3:g} kN"  # ? {BOLT_FORCE}',
                f"hole = {toml(millimetres(2 * max(bolt.hole for bolt in bolts), 3))}  # diameter",
            ]
            if one
            else []
        ),
        "# Outer radii of the rings, where the pressure ends: a cone from the head.",
        f"r_wai = {toml(radii[0] if len(set(radii)) == 1 else radii)}",
        "at = [",
        *(_line(i, bolt, of) for i, (bolt, of) in enumerate(zip(bolts, numbers, strict=True), 1)),
        "]",
    ]
    pressure = (
        None
        if one
        else float(
            np.mean(
                [
                    force_of(b.guess and b.guess.thread) / (math.pi * (b.ring**2 - b.hole**2))
                    for b in bolts
                ]
            )
        )
    )
    joint = JointSketch("bolts", ("ring_*",), stacked_words(numbers), pressure=pressure)
    asked = "The threads of the bolts, by the holes (ISO 273), and their force."
    words = f"{stacked_words(numbers)}: {', '.join(sorted(names)) or 'no standard thread'}"
    return _joined(sketch, lines, joint, words, asked)


def _line(number: int, bolt: _Bolt, of: int) -> str:
    name = bolt.guess.thread.name if bolt.guess else "no standard thread"
    at = toml([millimetres(c, 5) for c in np.round(bolt.centre, 7) + 0.0])
    of = f" (bolt {of})" if of != number else ""
    words = f"{' and '.join(bolt.parts)}, {2e3 * bolt.hole:.3g} mm, {name}?"
    return f"  {at},  # {number}{of}: {words}"


def _bonded(found: list[Touch], bolts: list[_Bolt]) -> list[str]:
    """A line with pairs that must hang together by something else than bolts."""
    group = {name: name for touch in found for name in touch.parts}

    def join(a: str, b: str) -> bool:
        old, new = group[b], group[a]
        group.update({name: new for name, own in group.items() if own == old})
        return old != new

    for bolt in bolts:
        join(*bolt.parts)
    largest = sorted(found, key=lambda touch: -touch.areas.sum())
    pairs = [list(touch.parts) for touch in largest if join(*touch.parts)]
    return [f"bonded = {toml(pairs)}  # ? they touch and have no bolt: welded?"] if pairs else []


def _with_layers(sketch: Sketch, found: list[Touch]) -> Sketch:
    lines = ['joint = "layer"  # on all that touches']
    cells = "joint" if len(found) == 1 else "joint_*"
    pairs = ", ".join(dict.fromkeys(" and ".join(touch.parts) for touch in found))
    joint = JointSketch("contact", (cells,), pairs, pressure=UNBOLTED)
    asked = "No bolts were found: a layer joins all that touches; is it clamped, glued, welded?"
    return _joined(sketch, lines, joint, f"touching: {pairs}", asked)


def _joined(sketch: Sketch, lines, joint: JointSketch, words: str, asked: str) -> Sketch:
    start = "The joints' stiffness, by roughness and pressure: it is what a test is to find."
    kept = tuple(q for q in sketch.questions if "no layer between" not in q and "pieces" not in q)
    return replace(
        sketch,
        mesh=(*sketch.mesh, *lines),
        joints=(joint,),
        found=(*sketch.found, words),
        questions=(*kept, asked, start),
    )
