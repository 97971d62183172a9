"""A case in the making: its tables as in the file, with what was found and what was guessed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import member
from fenics_joints.preload.clearance import ThreadGuess
from fenics_joints.preload.threads import Thread
from fenics_joints.preload.torque import motosh_force

#: Pressure between faces where no bolt is, Pa: assumed.
UNBOLTED = 1e6
#: Stress, Pa, in a bolt of which only the thread is known: 60 % of the proof stress of property
#: class 8.8 (ISO 898-1: 580 MPa). The class and the 60 % are assumed; for joints that are taken
#: apart again 75 % are recommended (Shigley's Mechanical Engineering Design, 9th ed., eq. 8-31).
STRESS = 0.6 * 580e6
#: Friction of thread and head, which a torque needs: steel bolts as delivered, 0.10 to 0.16 (VDI
#: 2230-1, table A5, class B).
FRICTION = 0.12
#: Force, N, of a bolt of which not even the thread is known: assumed.
FORCE = 10e3
BOLT_FORCE = "of each bolt; assumed: 60 % of the proof stress of class 8.8 (ISO 898-1)"
START = "The joints' stiffness, guessed by roughness and pressure: the test is to identify it."
NO_BOLTS = "No bolts were found: a layer joins all that touches; is it clamped, glued, welded?"

#: Asks: a question, an answer that is taken for granted, and what refuses a wrong one.
Ask = Callable[[str, str, Callable[[str], object]], str]


@dataclass(frozen=True)
class Remark:
    """A value, or a table, with a comment of its own behind it in the file."""

    value: object
    words: str


def guess(value: object, words: str = "") -> Remark:
    """A value that was guessed, with the reason: the file has a "?" behind it."""
    return Remark(value, f"? {words}".rstrip())


#: A key that begins so stands in the file as a comment: what could be given, and is not known.
OPEN = "# "


@dataclass(frozen=True)
class Material:
    """A material of handbooks: E, nu and rho as a case has them, and words that name it."""

    E: str
    nu: float
    rho: str
    words: tuple[str, ...]


#: Handbook values; the words are looked for in the labels of parts.
MATERIALS = {
    "steel": Material("210 GPa", 0.3, "7850 kg/m3", ("steel", "stahl", "acier", "s235", "s355")),
    "stainless": Material("195 GPa", 0.29, "7950 kg/m3", ("stainless", "inox", "1.43", "304")),
    "aluminium": Material("70 GPa", 0.33, "2700 kg/m3", ("alu", "almg", "6061", "7075", "6082")),
    "cast-iron": Material("110 GPa", 0.26, "7200 kg/m3", ("cast", "iron", "guss", "gjl", "en-gj")),
    "ductile-iron": Material("170 GPa", 0.28, "7100 kg/m3", ("ductile", "gjs", "ggg")),
    "titanium": Material("110 GPa", 0.34, "4430 kg/m3", ("titan", "ti6", "ti-6")),
    "brass": Material("105 GPa", 0.34, "8500 kg/m3", ("brass", "messing", "cuzn")),
}


@dataclass(frozen=True)
class Draft:
    """The structure of a case.

    Attributes:
        tables: ``mesh``, ``parts``, ``joints``, ``contacts`` and ``bolts``.
        faces: Names of faces that could be held.
        found: What was found, in sentences.
        questions: What was guessed, in sentences.
    """

    tables: Mapping[str, Mapping]
    faces: tuple[str, ...] = ()
    found: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()

    def joined(
        self,
        mesh: Mapping,
        joints: Mapping,
        found: Sequence[str] = (),
        questions: Sequence[str] = (),
    ) -> Draft:
        """The same with joints, and with further keys of the mesh."""
        tables = {**self.tables, "mesh": {**self.tables["mesh"], **mesh}, "joints": joints}
        found, questions = (*self.found, *found), (*self.questions, *questions)
        return replace(self, tables=tables, found=found, questions=questions)


def material_of(words: str, default: str) -> str:
    """The material that a label names, or the default."""
    low = words.lower()
    for name, material in MATERIALS.items():
        if any(word in low for word in material.words):
            return name
    return default


def parts_of(parts: Mapping[str, tuple[Sequence[str], str, str]], ask: Ask) -> dict[str, Remark]:
    """``[parts]`` by name, with the materials that the user says.

    Args:
        parts: Cells, a comment, and the likely material.
        ask: Asks the user.
    """
    found = {}
    for name, (cells, words, likely) in parts.items():
        question = f"Material of {name}" + (f" ({words})" if words else "")
        answer = ask(question, likely, lambda answer: member("material", answer, MATERIALS))
        material = MATERIALS[answer]
        section = {
            "cells": cells,
            "E": guess(material.E, f"{answer}, handbook"),
            "nu": material.nu,
            "rho": material.rho,
            f"{OPEN}mass": "1 kg",
        }
        found[name] = Remark(section, words)
    return found


def springs_joint(cells: Sequence[str], words: str, pressure: float | None = None) -> Remark:
    """A joint that is to be grown: springs by roughness and pressure.

    Args:
        cells: Its cells.
        words: A comment.
        pressure: Mean pressure between its faces, Pa; by default that of its bolts.
    """
    section = {
        "cells": cells,
        "law": Remark("springs", "where to start from: rough faces under this pressure"),
        "roughness": guess("1.6 um", "Ra; assumed: N7 of ISO 1302, common for machined faces"),
    }
    if pressure is not None:
        why = "assumed" if pressure == UNBOLTED else "by the bolts' assumed forces"
        mega = f"{1e-6 * pressure:.3g} MPa"
        section["pressure"] = guess(mega, f"between the faces, mean; {why}")
    return Remark(section, words)


def direction(vector: Sequence[float]) -> list[float]:
    """A direction without round-off."""
    return [float(f"{c:.9f}") + 0.0 for c in vector]


def millimetres(value: float, digits: int = 6) -> str:
    """A length as a case has it; without the round-off of a drawing program."""
    return f"{1e3 * round(float(value), 11) + 0.0:.{digits}g} mm"


def force_of(thread: Thread | None) -> float:
    """A likely force of a bolt, N."""
    return FORCE if thread is None else float(f"{STRESS * thread.stress_area:.2g}")


def free_name(name: str, used: Iterable[str], draft: Draft) -> str:
    """A joint's name, numbered where parts or other joints have it."""
    taken, free, number = {*used, *draft.tables["parts"]}, name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


# -- rings of the joint round bolts ----------------------------------------------------------------


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
        """Radius of the wider hole."""
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

    def continues(self, other: BoltHole) -> bool:
        """Whether the bolt of another hole goes on through this one.

        Both have one axis, and the hole of the part between them goes through: blind holes do not
        meet.
        """
        between = self.centre - other.centre
        along = float(between @ other.normal)
        beside = float(np.linalg.norm(between - along * other.normal))
        shared = set(self.parts) & set(other.parts)
        if beside > 0.1 * other.radius or abs(along) < 1e-9 or not shared:
            return False
        if abs(other.normal @ self.normal) < 0.999:
            return False
        if self.depths is None or other.depths is None:
            return True
        deep = [sum(h.depths[h.parts.index(part)] for h in (self, other)) for part in shared]
        return max(deep) > abs(along) * (1 - 1e-3)


def torque_of(thread: Thread) -> float:
    """The torque of its likely force, N·m, with `FRICTION` (`preload.torque.motosh_force`)."""
    return float(f"{force_of(thread) / motosh_force(1.0, thread, FRICTION, FRICTION):.2g}")


def stacked(holes: Sequence[BoltHole]) -> list[int]:
    """The number, from 1, of each hole's bolt: a bolt presses all parts that it passes through."""
    n = len(holes)
    links = [(i, j) for j in range(n) for i in range(j) if holes[j].continues(holes[i])]
    return (1 + _groups(n, links)).tolist()


def _groups(n: int, links: Sequence[tuple[int, int]]) -> np.ndarray:
    """Number, from 0, of the group of each of n things that links join."""
    i, j = np.reshape(links, (-1, 2)).astype(int).T
    return connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), False)[1]


def _others(thread: ThreadGuess) -> str:
    return f"; or {' or '.join(thread.others)}" if thread.others else ""


def _bolts(n: int) -> str:
    return f"{n} bolt{'s' if n > 1 else ''}"


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
            own, instead of one joint of all bolts.
        more: Further questions.
    """
    numbers = stacked(holes)
    faces = sorted({numbers.count(number) for number in numbers})
    each = "" if faces == [1] else f" of {' or '.join(map(str, faces))} pressed faces each"
    words = _bolts(max(numbers)) + each
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
            "hole": ends if len(ends) > 1 else ends[0],
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
    mesh, questions = (
        {},
        ["The threads of the bolts, by the holes (ISO 273), and their force.", START],
    )
    if unbolted := unbolted_pairs(touching, [hole.parts for hole in holes]):
        mesh["bonded"] = guess(unbolted, "they touch and have no bolt: welded?")
        questions.append("Parts that touch without bolts are taken as welded.")
    mesh["bolts"] = bolts
    if by_pair:
        joints = _joints_by_pair(draft, holes, bolts_say=one is not None)
    else:
        pressure = None if one else fmean(hole.pressure for hole in holes)
        joints = {"bolts": springs_joint(("ring_*",), words, pressure)}
    found = f"{words}: {', '.join(sorted(names)) or 'no standard thread'}"
    return draft.joined(mesh, joints, [found], [*questions, *more])


def unbolted_pairs(
    touching: Sequence[tuple[str, str]], bolted: Sequence[tuple[str, str]]
) -> list[list[str]]:
    """Pairs of parts that something other than bolts must join, or the structure falls apart."""
    names = sorted({name for pair in (*touching, *bolted) for name in pair})
    links, found = [(names.index(a), names.index(b)) for a, b in bolted], []
    for a, b in touching:
        group = _groups(len(names), links)
        if group[names.index(a)] != group[names.index(b)]:
            links.append((names.index(a), names.index(b)))
            found.append([a, b])
    return found


def _joints_by_pair(draft: Draft, holes: Sequence[BoltHole], bolts_say: bool) -> dict[str, Remark]:
    """A section for all bolts between two parts that look the same way."""
    groups: dict[tuple, list[int]] = {}
    for number, hole in enumerate(holes, start=1):
        way = hole.normal * (1 if hole.normal[np.abs(hole.normal).argmax()] > 0 else -1)
        groups.setdefault((hole.parts, tuple(np.round(way, 6) + 0.0)), []).append(number)
    joints = {}
    for ((a, b), _), numbers in groups.items():
        name = free_name("joint" if len(groups) == 1 else f"joint_{a}_{b}", joints, draft)
        pressure = None if bolts_say else fmean(holes[n - 1].pressure for n in numbers)
        words = f"{_bolts(len(numbers))} between {a} and {b}"
        joints[name] = springs_joint([f"ring_{n}" for n in numbers], words, pressure)
    return joints
