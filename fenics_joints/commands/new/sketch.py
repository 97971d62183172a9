"""A case in the making: what was found in files, and what was guessed, as lines of TOML."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.formatting import printable
from fenics_joints.preload.threads import Thread

#: Pressure between faces where no bolt is, Pa: assumed.
UNBOLTED = 1e6


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
class PartSketch:
    """A section of ``[parts]``: its name, cells, what the file says of it, and its material.

    ``directions`` are those of its thickness and of its width, if it is thin in one of them.
    """

    name: str
    cells: tuple[str, ...]
    words: str
    material: str
    directions: tuple[Sequence[float], ...] = ()


@dataclass(frozen=True)
class JointSketch:
    """A section of ``[joints]``, and words on it.

    A layer that the mesh has is of a transition material, of its thickness, m. One that is to be
    grown has none, but springs by roughness and pressure: that of its bolts, or a given one, Pa.
    """

    name: str
    cells: tuple[str, ...]
    words: str
    normal: tuple[float, ...] = ()
    thickness: float | None = None
    pressure: float | None = None


@dataclass(frozen=True)
class TestSketch:
    """The test of a case.

    Attributes:
        lines: Of ``[test]``.
        found: What the files hold, in words.
        n_modes: How many modes were measured.
        at: The condition that an update would take; None for one condition.
        places: Sensors, m, shape (n, 3).
        questions: What was guessed.
    """

    __test__ = False

    lines: tuple[str, ...] = ()
    found: tuple[str, ...] = ()
    n_modes: int = 0
    at: float | None = None
    places: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    questions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sketch:
    """The structure of a case.

    Attributes:
        mesh: Lines of ``[mesh]`` and its tables.
        parts: Its parts.
        joints: Its joints.
        more: Lines of contacts and bolts.
        faces: Names of faces that could be held.
        found: What was found, in words.
        questions: What was guessed.
    """

    mesh: tuple[str, ...]
    parts: tuple[PartSketch, ...]
    joints: tuple[JointSketch, ...] = ()
    more: tuple[str, ...] = ()
    faces: tuple[str, ...] = ()
    found: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()


#: Stress in a bolt of which only the thread is known: 60 % of the proof stress of property class
#: 8.8 (ISO 898-1: 580 MPa). The class and the 60 % are assumed; for joints that are taken apart
#: again 75 % are recommended (Shigley's Mechanical Engineering Design, 9th ed., eq. 8-31). Force of
#: one of which not even the thread is known, N: assumed.
STRESS, FORCE = 0.6 * 580e6, 10e3
BOLT_FORCE = "of each bolt; assumed: 60 % of the proof stress of class 8.8 (ISO 898-1)"


def force_of(thread: Thread | None) -> float:
    """A likely force of a bolt, N."""
    return FORCE if thread is None else float(f"{STRESS * thread.stress_area:.2g}")


#: Asks: a question, an answer that is taken for granted, and what refuses a wrong one.
Ask = Callable[[str, str, Callable[[str], object]], str]


@dataclass(frozen=True)
class Ring:
    """One place where a bolt presses two parts together; lengths in m.

    Attributes:
        parts: The two parts.
        centre: Shape (3,).
        normal: Normal of the faces, shape (3,).
        radius: Radius of the hole.
        depths: Depths of the holes in the two parts; None if unknown.
    """

    parts: tuple
    centre: np.ndarray
    normal: np.ndarray
    radius: float
    depths: tuple[float, float] | None = None


def stacked(rings: Sequence[Ring]) -> list[int]:
    """The number, from 1, of each ring's bolt: a bolt presses all parts that it passes through.

    Two rings share a bolt if they share an axis and the hole of the part between them goes through.
    """
    bolt = list(range(len(rings)))
    for j, b in enumerate(rings):
        for i, a in enumerate(rings[:j]):
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


def _passes(a: Ring, b: Ring, part, apart: float) -> bool:
    """Whether two rings share one hole in a part, or their holes meet; blind holes do not."""
    if a.depths is None or b.depths is None:
        return True
    deep = sum(r.depths[r.parts.index(part)] for r in (a, b))
    return deep > apart * (1 - 1e-3)


def stacked_words(bolts: Sequence[int]) -> str:
    """The number of bolts, and of pressed faces where a bolt has several."""
    n, faces = max(bolts), sorted({bolts.count(bolt) for bolt in bolts})
    each = "" if faces == [1] else f" of {' or '.join(map(str, faces))} pressed faces each"
    return f"{n} bolt{'s' if n > 1 else ''}{each}"


def material_of(words: str, default: str) -> str:
    """The material that a label names, or the default."""
    low = words.lower()
    for name, material in MATERIALS.items():
        if any(word in low for word in material.words):
            return name
    return default


def ask_materials(parts: Sequence[PartSketch], ask: Ask) -> tuple[PartSketch, ...]:
    """The parts with the materials that the user says."""

    def known(answer: str) -> None:
        if answer not in MATERIALS:
            raise ValueError(f"{answer!r}: expected one of {', '.join(MATERIALS)}")

    return tuple(
        replace(part, material=ask(_material_of(part), part.material, known)) for part in parts
    )


def _material_of(part: PartSketch) -> str:
    return f"Material of {part.name}" + (f" ({part.words})" if part.words else "")


def millimetres(value: float, digits: int = 6) -> str:
    """A length as a case has it; without the round-off of a drawing program."""
    return f"{1e3 * round(float(value), 11) + 0.0:.{digits}g} mm"


def toml(value: object) -> str:
    """A value in TOML; texts, numbers, truth values, and lists of them."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(round(float(value), 12) + 0.0)
    return f"[{', '.join(toml(item) for item in value)}]"


def text_of(title: str, sketch: Sketch, test: TestSketch) -> str:
    """The whole case file."""
    asked = (*sketch.questions, *test.questions)
    lines = [
        "# Written by fenics-joints new from the files named below. A number with a unit is a",
        '# text; a bare number is in SI units. What was guessed has a "?" behind it:',
        *(f"# ? {question}" for question in asked),
        "# fenics-joints check says what else is wrong or unlikely.",
        "",
        f"title = {toml(printable(title))}",
        "",
        *sketch.mesh,
        "",
    ]
    for part in sketch.parts:
        lines += _part(part)
    for joint in sketch.joints:
        lines += _joint(joint)
    lines += [*sketch.more, *_supports(sketch.faces)]
    lines += [*test.lines, ""] if test.lines else _no_test()
    lines += _work(sketch, test)
    return "\n".join(lines) + "\n"


def _part(part: PartSketch) -> list[str]:
    material = MATERIALS[part.material]
    return [
        f"[parts.{part.name}]" + (f"  # {part.words}" if part.words else ""),
        f"cells = {toml(part.cells)}",
        f"E = {toml(material.E)}  # ? {part.material}, handbook",
        f"nu = {material.nu}",
        f"rho = {toml(material.rho)}",
        *_ways(part),
        '# mass = "1 kg"  # what it weighs, for check',
        "",
    ]


def _ways(part: PartSketch) -> list[str]:
    keys = {"normal": "of the thickness: the least extent", "across": "of the width: the next"}
    return [
        f"{key} = {toml([float(f'{c:.9f}') for c in way])}  # ? {words}"
        for (key, words), way in zip(keys.items(), part.directions, strict=False)
    ]


def _joint(joint: JointSketch) -> list[str]:
    head = [f"[joints.{joint.name}]  # {joint.words}", f"cells = {toml(joint.cells)}"]
    if joint.thickness is None:
        why = "assumed" if joint.pressure == UNBOLTED else "by the bolts' assumed forces"
        pressure = (
            []
            if joint.pressure is None
            else [
                f'pressure = "{1e-6 * joint.pressure:.3g} MPa"  # ? between the faces, mean; {why}'
            ]
        )
        return [
            *head,
            'law = "springs"  # where to start from: rough faces under this pressure',
            'roughness = "1.6 um"  # ? Ra; assumed: N7 of ISO 1302, common for machined faces',
            *pressure,
            "",
        ]
    normal = [float(f"{c:.9f}") + 0.0 for c in joint.normal]
    return [
        *head,
        'law = "transition"',
        'E = "6111 MPa"  # ? identified for M12 at 120 N·m in plates of 25 mm, Ra 1.6 µm',
        "nu = 0.253",
        f"h = {toml(millimetres(joint.thickness))}",
        f"normal = {toml(normal)}",
        "",
    ]


def _supports(faces: Sequence[str]) -> list[str]:
    there = f"one of {', '.join(faces)}" if faces else "a face that [mesh.faces] names"
    return [
        "# ? Free in space, as on soft ropes. If it is held:",
        "# [supports.ground]",
        f'# facets = "..."  # {there}',
        "",
    ]


def _no_test() -> list[str]:
    return [
        "# No test yet. With a table, a column for each mode and a row for each torque:",
        "# [test]",
        '# frequencies = "frequencies.csv"  # or shapes = "shapes.uff"',
        '# noise = "0.2 %"',
        "",
    ]


def _work(sketch: Sketch, test: TestSketch) -> list[str]:
    """What update and diagnose are to do."""
    if not test.n_modes:
        return []
    layers = [f"{joint.name}.E" for joint in sketch.joints if joint.thickness]
    across = [f"{joint.name}.k_n" for joint in sketch.joints if not joint.thickness]
    along = [f"{joint.name}.k_t" for joint in sketch.joints if not joint.thickness]
    names = [*layers, *across, *along]
    if len(names) > test.n_modes:  # more than the frequencies can say, whatever they are
        names = [*layers, *across][: max(test.n_modes, 3)]
    lines = []
    if names:
        at = [] if test.at is None else [f"at = {toml(test.at)}"]
        lines = ["[update]", *at, f"parameters = {toml(names)}  # ? what is known least", ""]
    more = max(20, 2 * test.n_modes + 6)
    return [*lines, "[diagnose]", f"n_modes = {more}", ""]
