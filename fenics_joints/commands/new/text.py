"""The case file in TOML, with comments: on guesses their reason, on other keys what they mean."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping

import numpy as np

from fenics_joints.case.schema import meaning
from fenics_joints.commands.new.draft import OPEN, Draft, Remark, guess
from fenics_joints.commands.new.tests import TestDraft
from fenics_joints.formatting import printable


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
        '# text; a bare number is in SI units. Guesses are marked by a "?":',
        *(f"# ? {question}" for question in (*draft.questions, *test.questions)),
        "# fenics-joints check lists other errors and unlikely values.",
        "",
        *_lines(case, set()),
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
    update = {**at, "parameters": guess(names, "the least known ones")}
    return {
        **({"update": update} if names else {}),
        "diagnose": {"n_modes": max(20, 2 * test.n_modes + 6)},
    }


def _lines(
    table: Mapping[str, object], known: set[str], path: tuple[str, ...] = (), begin: str = ""
) -> Iterator[str]:
    """Lines of a table: its values, then the tables inside; each line after ``begin``.

    What a key means is written once; ``known`` are the comments that were.
    """
    tables, names = {}, [key.removeprefix(OPEN) for key in table]
    for name, (key, value) in zip(names, table.items(), strict=True):
        own, words = (*path, name), ""
        if isinstance(value, Remark):
            words = value.words
        elif path and (text := meaning(own, names)) not in known:
            known.add(words := text)
        end, value = f"  # {words}" if words else "", _bare(value)
        if isinstance(value, Mapping):
            start = begin if name == key else OPEN
            tables[own] = value, start, end
        elif isinstance(value, list | tuple) and any(isinstance(item, Remark) for item in value):
            items = [
                f"  {toml(item)}," + (f"  # {item.words}" * bool(item.words)) for item in value
            ]
            yield from (begin + line for line in (f"{key} = [{end}", *items, "]"))
        else:
            yield f"{begin}{key} = {toml(value)}{end}"
    for own, (inside, start, end) in tables.items():
        if not all(isinstance(_bare(value), Mapping) for value in inside.values()):
            yield from ("", f"{start}[{'.'.join(map(_key, own))}]{end}")
        yield from _lines(inside, known, own, start)


def _bare(value: object) -> object:
    return value.value if isinstance(value, Remark) else value


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml(name)


def toml(value: object) -> str:
    """A value in TOML; texts, numbers, truth values, and lists of them."""
    value = _bare(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(toml(item) for item in value)}]"
    if isinstance(value, float):
        return repr(round(value, 12) + 0.0)
    return json.dumps(value, ensure_ascii=False)
