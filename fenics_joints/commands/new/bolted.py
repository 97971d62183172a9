"""Joints where parts touch: rings round the bolts that their holes are for, or layers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from fenics_joints.commands.new.draft import (
    BOLT_FORCE,
    Draft,
    Remark,
    force_of,
    guess,
    millimetres,
    springs_joint,
)
from fenics_joints.preload.clearance import ThreadGuess

START = "The joints' stiffness, by roughness and pressure: it is what a test is to find."
NO_BOLTS = "No bolts were found: a layer joins all that touches; is it clamped, glued, welded?"
ON_ALL = Remark("layer", "on all that touches")


@dataclass(frozen=True, eq=False)
class BoltHole:
    """Where a bolt presses two parts together; lengths in m.

    Attributes:
        parts: Names of the two parts.
        centre: On the faces that touch, shape (3,).
        normal: Normal of these faces, shape (3,).
        diameters: Of the hole in the first part and in the second, or of both.
        ring: Outer radius of the ring that is pressed.
        guess: The bolt's thread, if it has a standard one.
        depths: How deep the holes in the two parts are; None if unknown.
    """

    parts: tuple[str, str]
    centre: np.ndarray
    normal: np.ndarray
    diameters: tuple[float, ...]
    ring: float = 0.0
    guess: ThreadGuess | None = None
    depths: tuple[float, float] | None = None

    @property
    def radius(self) -> float:
        """Of the wider hole."""
        return max(self.diameters) / 2

    @property
    def pressure(self) -> float:
        """Mean pressure on its ring under a likely force, Pa."""
        force = force_of(self.guess and self.guess.thread)
        return force / (math.pi * (self.ring**2 - self.radius**2))

    @property
    def words(self) -> str:
        """Parts, diameters and threads."""
        holes = " and ".join(f"{1e3 * d:.4g}" for d in dict.fromkeys(np.round(self.diameters, 7)))
        name = "no standard thread"
        if self.guess is not None:
            name = f"{self.guess.thread.name}{_others(self.guess)}?"
        return f"{' and '.join(self.parts)}, {holes} mm, {name}"


def stacked(holes: Sequence[BoltHole]) -> list[int]:
    """The number, from 1, of each hole's bolt: a bolt presses all parts that it passes through.

    Two of them share a bolt if they share an axis and the hole of the part between goes through.
    """
    bolt = list(range(len(holes)))
    for j, b in enumerate(holes):
        for i, a in enumerate(holes[:j]):
            between = b.centre - a.centre
            along = float(between @ a.normal)
            beside = float(np.linalg.norm(between - along * a.normal))
            shared = set(a.parts) & set(b.parts)
            if beside > 0.1 * a.radius or abs(along) < 1e-9 or abs(a.normal @ b.normal) < 0.999:
                continue
            if any(_passes(a, b, part, abs(along)) for part in shared):
                bolt = [bolt[i] if n == bolt[j] else n for n in bolt]
    numbers = {n: k for k, n in enumerate(dict.fromkeys(bolt), start=1)}
    return [numbers[n] for n in bolt]


def _passes(a: BoltHole, b: BoltHole, part, apart: float) -> bool:
    """Whether two share one hole in a part, or their holes meet; blind holes do not."""
    if a.depths is None or b.depths is None:
        return True
    deep = sum(hole.depths[hole.parts.index(part)] for hole in (a, b))
    return deep > apart * (1 - 1e-3)


def _stacked_words(bolts: Sequence[int]) -> str:
    """The number of bolts, and of pressed faces where a bolt has several."""
    n, faces = max(bolts), sorted({bolts.count(bolt) for bolt in bolts})
    each = "" if faces == [1] else f" of {' or '.join(map(str, faces))} pressed faces each"
    return f"{n} bolt{'s' if n > 1 else ''}{each}"


def _others(thread: ThreadGuess) -> str:
    return f"; or {' or '.join(thread.others)}" if thread.others else ""


def with_rings(
    draft: Draft,
    holes: Sequence[BoltHole],
    touching: Sequence[tuple[str, str]],
    *,
    by_pair: bool,
    more: Sequence[str] = (),
) -> Draft:
    """The case with a ring of the joint around each bolt.

    Args:
        draft: The case without joints.
        holes: The bolts, one or more.
        touching: Pairs of parts that touch, the largest faces first.
        by_pair: Whether the bolts between two parts that look the same way are a joint of their
            own, in place of one joint of all bolts.
        more: Further questions.
    """
    numbers, words = stacked(holes), _stacked_words(stacked(holes))
    names = {hole.guess.thread.name for hole in holes if hole.guess}
    one = holes[0].guess if len(names) == 1 and all(hole.guess for hole in holes) else None
    radii = [millimetres(math.floor(1e4 * hole.ring) / 1e4) for hole in holes]
    bolts = {}
    if one is not None:
        diameters = [d for hole in holes for d in hole.diameters]
        ends = list(dict.fromkeys(millimetres(end(diameters)) for end in (min, max)))
        bolts = {
            "thread": guess(one.thread.name, one.why + _others(one)),
            "force": guess(f"{force_of(one.thread) / 1e3:g} kN", BOLT_FORCE),
            "hole": Remark(ends if len(ends) > 1 else ends[0], "diameter"),
        }
    bolts["r_wai"] = Remark(
        radii[0] if len(set(radii)) == 1 else radii,
        "outer radii, where the pressure ends: a cone from the head, if there is room",
    )
    bolts["at"] = [
        Remark(
            [millimetres(c) for c in hole.centre + 0.0],
            f"{i}{f' (bolt {of})' if of != i else ''}: {hole.words}",
        )
        for i, (hole, of) in enumerate(zip(holes, numbers, strict=True), start=1)
    ]
    unbolted = _unbolted(touching, [hole.parts for hole in holes])
    welded = guess(unbolted, "they touch and have no bolt: welded?")
    mesh = {
        **({"bonded": welded} if unbolted else {}),
        "bolts": Remark(bolts, "a ring of the joint around each bolt"),
    }
    if by_pair:
        joints = _joints_by_pair(draft, holes, bolts_say=one is not None)
    else:
        pressure = None if one else fmean(hole.pressure for hole in holes)
        joints = {"bolts": springs_joint(("ring_*",), words, pressure)}
    questions = [
        "The threads of the bolts, by the holes (ISO 273), and their force.",
        START,
        *(["Parts that touch without bolts are taken as welded."] if unbolted else []),
        *more,
    ]
    found = f"{words}: {', '.join(sorted(names)) or 'no standard thread'}"
    return draft.joined(mesh, joints, [found], questions)


def _unbolted(
    touching: Sequence[tuple[str, str]], bolted: Sequence[tuple[str, str]]
) -> list[list[str]]:
    """Pairs that must hang together by something else than bolts, as no bolts do it."""
    group = {name: name for pair in (*touching, *bolted) for name in pair}

    def join(a: str, b: str) -> bool:
        old, new = group[b], group[a]
        group.update({name: new for name, own in group.items() if own == old})
        return old != new

    for pair in bolted:
        join(*pair)
    return [list(pair) for pair in touching if join(*pair)]


def _joints_by_pair(draft: Draft, holes: Sequence[BoltHole], bolts_say: bool) -> dict[str, Remark]:
    """A section for all bolts between two parts that look the same way."""
    groups: dict[tuple, list[int]] = {}
    for number, hole in enumerate(holes, start=1):
        way = hole.normal * (1 if hole.normal[np.abs(hole.normal).argmax()] > 0 else -1)
        groups.setdefault((hole.parts, tuple(np.round(way, 6) + 0.0)), []).append(number)
    joints = {}
    for ((a, b), _), numbers in groups.items():
        name = free_name("joint" if len(groups) == 1 else f"joint_{a}_{b}", joints, draft)
        words = f"{len(numbers)} bolt{'s' if len(numbers) > 1 else ''} between {a} and {b}"
        pressure = None if bolts_say else fmean(holes[n - 1].pressure for n in numbers)
        joints[name] = springs_joint([f"ring_{n}" for n in numbers], words, pressure)
    return joints


def free_name(name: str, used: Iterable[str], draft: Draft) -> str:
    """A joint's name, numbered where parts or other joints have it."""
    taken = {*used, *draft.tables["parts"]}
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free
