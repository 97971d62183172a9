"""A case in the making: its tables as in the file, with remarks on what was found and guessed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.errors import member
from fenics_joints.formatting import printable
from fenics_joints.preload.threads import Thread

#: Pressure between faces where no bolt is, Pa: assumed.
UNBOLTED = 1e6
#: Stress in a bolt of which only the thread is known: 60 % of the proof stress of property class
#: 8.8 (ISO 898-1: 580 MPa). The class and the 60 % are assumed; for joints that are taken apart
#: again 75 % are recommended (Shigley's Mechanical Engineering Design, 9th ed., eq. 8-31). Force of
#: one of which not even the thread is known, N: assumed.
STRESS, FORCE = 0.6 * 580e6, 10e3
BOLT_FORCE = "of each bolt; assumed: 60 % of the proof stress of class 8.8 (ISO 898-1)"

#: Asks: a question, an answer that is taken for granted, and what refuses a wrong one.
Ask = Callable[[str, str, Callable[[str], object]], str]


@dataclass(frozen=True)
class Remark:
    """A value, or a table, with a remark that stands behind it in the file."""

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
class TestDraft:
    """The test of a case.

    Attributes:
        table: ``[test]``; empty without a test.
        found: What the files hold, in words.
        n_modes: How many modes were measured.
        at: The condition that an update would take; None for one condition.
        places: Sensors, m, shape (n, 3).
        questions: What was guessed.
    """

    __test__ = False

    table: Mapping[str, object] = field(default_factory=dict)
    found: tuple[str, ...] = ()
    n_modes: int = 0
    at: float | None = None
    places: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    questions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Draft:
    """The structure of a case.

    Attributes:
        tables: ``mesh``, ``parts``, ``joints``, ``contacts`` and ``bolts``.
        faces: Names of faces that could be held.
        found: What was found, in words.
        questions: What was guessed.
    """

    tables: Mapping[str, Mapping]
    faces: tuple[str, ...] = ()
    found: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()

    def joined(
        self, mesh: Mapping, joints: Mapping, found: Sequence[str], questions: Sequence[str]
    ) -> Draft:
        """The same with joints, and with what the mesh is told of them."""
        tables = {**self.tables, "mesh": {**self.tables["mesh"], **mesh}, "joints": joints}
        return replace(
            self,
            tables=tables,
            found=(*self.found, *found),
            questions=(*self.questions, *questions),
        )


def force_of(thread: Thread | None) -> float:
    """A likely force of a bolt, N."""
    return FORCE if thread is None else float(f"{STRESS * thread.stress_area:.2g}")


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
        parts: Cells, words on it, and its likely material.
        ask: Asks the user.
    """
    found = {}
    for name, (cells, words, likely) in parts.items():
        question = f"Material of {name}" + (f" ({words})" if words else "")
        said = ask(question, likely, lambda answer: member("material", answer, MATERIALS))
        material = MATERIALS[said]
        section = {
            "cells": cells,
            "E": guess(material.E, f"{said}, handbook"),
            "nu": material.nu,
            "rho": material.rho,
            f"{OPEN}mass": Remark("1 kg", "what it weighs, for check"),
        }
        found[name] = Remark(section, words)
    return found


def springs_joint(cells: Sequence[str], words: str, pressure: float | None = None) -> Remark:
    """A joint that is to be grown: springs by roughness and pressure.

    Args:
        cells: Its cells.
        words: On it.
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


# -- the file --------------------------------------------------------------------------------------


def text_of(title: str, draft: Draft, test: TestDraft) -> str:
    """The whole case file."""
    faces = f"one of {', '.join(draft.faces)}" if draft.faces else "a face that [mesh.faces] names"
    free = guess({"facets": Remark("...", faces)}, "free in space, as on soft ropes; if it is held")
    no_test = {
        "frequencies": Remark("frequencies.csv", 'or shapes = "shapes.uff"'),
        "noise": "0.2 %",
    }
    words = "none yet; with a table, a column for each mode and a row for each torque"
    case = {
        "title": printable(title),
        **draft.tables,
        "supports": {f"{OPEN}ground": free},
        **({"test": test.table} if test.table else {f"{OPEN}test": Remark(no_test, words)}),
        **_work(draft.tables.get("joints", {}), test),
    }
    lines = [
        "# Written by fenics-joints new from the files named below. A number with a unit is a",
        '# text; a bare number is in SI units. What was guessed has a "?" behind it:',
        *(f"# ? {question}" for question in (*draft.questions, *test.questions)),
        "# fenics-joints check says what else is wrong or unlikely.",
        "",
        *_lines(case),
    ]
    return "\n".join(lines) + "\n"


def _work(joints: Mapping[str, Remark], test: TestDraft) -> dict[str, dict]:
    """What update and diagnose are to do."""
    if not test.n_modes:
        return {}
    law = {name: _bare(joint.value["law"]) for name, joint in joints.items()}
    layers = [f"{name}.E" for name in joints if law[name] == "transition"]
    springs = [name for name in joints if law[name] == "springs"]
    across, along = ([f"{name}.{key}" for name in springs] for key in ("k_n", "k_t"))
    names = [*layers, *across, *along]
    if len(names) > test.n_modes:  # more than the frequencies can say, whatever they are
        names = [*layers, *across][: max(test.n_modes, 3)]
    at = {} if test.at is None else {"at": test.at}
    update = {**at, "parameters": guess(names, "what is known least")}
    return {
        **({"update": update} if names else {}),
        "diagnose": {"n_modes": max(20, 2 * test.n_modes + 6)},
    }


def _lines(table: Mapping[str, object], path: tuple[str, ...] = (), begin: str = "") -> Iterator:
    """Lines of a table: its values, then the tables inside; each line after ``begin``."""
    tables = {}
    for key, value in table.items():
        value, words = (value.value, value.words) if isinstance(value, Remark) else (value, "")
        if isinstance(value, Mapping):
            tables[key] = (value, words)
        else:
            yield from (begin + line for line in _value(key, value, words))
    for key, (inside, words) in tables.items():
        name = key.removeprefix(OPEN)
        own, start = (*path, name), OPEN if key != name else begin
        if not all(isinstance(_bare(value), Mapping) for value in inside.values()):
            yield ""
            yield f"{start}[{'.'.join(map(_key, own))}]" + (f"  # {words}" if words else "")
        yield from _lines(inside, own, start)


def _value(key: str, value: object, words: str) -> list[str]:
    """A key with its value; a list whose items have remarks, each on a line."""
    end = f"  # {words}" if words else ""
    if isinstance(value, list | tuple) and any(isinstance(item, Remark) for item in value):
        items = [f"  {toml(item)}," + (f"  # {item.words}" * bool(item.words)) for item in value]
        return [f"{key} = [{end}", *items, "]"]
    return [f"{key} = {toml(value)}{end}"]


def _bare(value: object) -> object:
    return value.value if isinstance(value, Remark) else value


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml(name)


def toml(value: object) -> str:
    """A value in TOML; texts, numbers, truth values, and lists of them."""
    value = _bare(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(round(float(value), 12) + 0.0)
    return f"[{', '.join(toml(item) for item in value)}]"
