"""Mode shapes from universal files (UFF): datasets 55 or 2414, one for each mode.

Used are the analyses 2 (normal modes) and 3 and 7 (complex eigenvalues). Nodes and their axes come
from datasets 15, 2411, 18 and 2420, units from 164, and lines for pictures from 82, in any order.
The meaning of the fields: "Universal file formats", Structural Dynamics Research Laboratory,
University of Cincinnati. pyuff reads no shapes with six complex components, none in lines that are
filled with blanks, and no exponents with D, so they are read here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems
from fenics_joints.measurements.records import Contents, Said
from fenics_joints.measurements.uff_sets import (
    GEOMETRY,
    Dataset,
    add_nodes,
    axes_of,
    read_sets,
    units_of,
    word,
)

_ANALYSES = {
    0: "unknown",
    1: "static",
    2: "normal mode",
    3: "complex eigenvalue",
    4: "transient",
    5: "frequency response",
    6: "buckling",
    7: "complex eigenvalue",
}
_NORMAL, _COMPLEX = 2, (3, 7)
_CHARACTER = {
    0: "unknown",
    1: "scalar",
    2: "translations",
    3: "translations and rotations",
    4: "symmetric tensor",
    5: "tensor",
}
_DATA = {
    0: "unknown",
    1: "general",
    2: "stress",
    3: "strain",
    8: "displacement",
    11: "velocity",
    12: "acceleration",
}
_MOTIONS = (0, 1, 8, 11, 12)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class ShapeRecord:
    """One mode as a file has it.

    Attributes:
        where: File and place in it, for messages.
        number: The file's number of the mode.
        frequency_hz: Undamped natural frequency, Hz; 0 where the file has none.
        damping: Damping ratio; nan where the file has none.
        values: Translations of each node in its own axes, shape (3,), complex, by label.
        is_complex: Whether the file has it as complex.
        rotates: Whether it has rotations too, which are not used.
    """

    where: str
    number: int
    frequency_hz: float
    damping: float
    values: dict[str, np.ndarray]
    is_complex: bool
    rotates: bool


@dataclass(eq=False)
class ShapeContents:
    """What one or more files hold: shapes, nodes, and lines between nodes."""

    shapes: list[ShapeRecord] = field(default_factory=list)
    places: Contents = field(default_factory=Contents)
    lines: list[list[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_uff_shapes(paths: Sequence[Path], said: Said) -> ShapeContents:
    """What universal files hold; nodes, axes and units may stand in other files than shapes.

    Args:
        paths: The files.
        said: What the user says about them.

    Raises:
        InputError: If pyuff is missing, or for what is wrong in a file; names the file, the
            dataset and what was expected.
    """
    problems = Problems(paths[0] if len(paths) == 1 else "")
    sets = [
        one
        for path in paths
        for one in problems.tried(
            lambda path=path: read_sets(path, (55, 82, 2414, *GEOMETRY), problems)
        )
        or ()
    ]
    found, others = ShapeContents(), []
    length, _ = problems.tried(lambda: units_of(sets, said)) or (1.0, 1.0)
    axes = problems.tried(lambda: axes_of(sets)) or {}
    for where, data in sets:
        if data["type"] in (15, 2411):
            problems.tried(lambda w=where, d=data: add_nodes(found.places, w, d, length, axes))
        elif data["type"] == 82:
            found.lines += _lines(data)
        elif data["type"] in (55, 2414):
            record = problems.tried(lambda w=where, d=data: _shape(w, d["type"], d["lines"]))
            if isinstance(record, ShapeRecord):
                found.shapes.append(record)
            elif record is not None:
                others.append(record)
    problems.check()
    if not found.shapes:
        _refuse_none(paths, sets, others)
    found.notes += [*found.places.notes, *(f"{text}, left out" for text in others)]
    return found


def _refuse_none(paths: Sequence[Path], sets: Sequence[Dataset], others: Sequence[str]) -> None:
    files = ", ".join(map(str, paths))
    if others:
        raise InputError(
            f"{files}: {'; '.join(others)}; expected mode shapes, datasets 55 or 2414 of "
            "analysis 2 (normal modes), 3 or 7 (complex ones)"
        )
    kinds = sorted({data["type"] for _, data in sets})
    there = f"of use are datasets {', '.join(map(str, kinds))} only" if kinds else "none is of use"
    raise InputError(
        f"{files}: no mode shape, {there}; expected datasets 55 or 2414. From "
        "functions (datasets 58), [test.frfs.identify] finds the modes"
    )


def _lines(data) -> list[list[str]]:
    """Nodes of each line; 0 lifts the pen."""
    lines: list[list[str]] = [[]]
    for node in np.asarray(data["nodes"], dtype=int):
        if node:
            lines[-1].append(str(node))
        else:
            lines.append([])
    return [line for line in lines if len(line) > 1]


def _shape(where: str, type_: int, lines: Sequence[str]) -> ShapeRecord | str:
    """The mode in a dataset 55 or 2414 of data at nodes; or what else it holds, in words."""
    head, ids, real, start = (5, 6, 7, 8) if type_ == 55 else (8, 9, 11, 13)
    if len(lines) < start:
        raise InputError(f"{where}: has {len(lines)} records, expected {start} and the nodes'")
    if type_ == 2414 and _integers(where, lines[2], 1, "record 3")[0] != 1:
        return f"{where}: its data are not at nodes (location {lines[2].strip()} in record 3)"
    _, analysis, character, kind, form, count = _integers(
        where, lines[head], 6, f"record {head + 1}"
    )[:6]
    if analysis != _NORMAL and analysis not in _COMPLEX:
        return f"{where}: is of analysis {word(_ANALYSES, analysis)}"
    if kind not in _MOTIONS:
        return f"{where}: its data are of type {word(_DATA, kind)} and no displacements"
    if count not in (3, 6):
        return (
            f"{where}: has {count} values for each node ({word(_CHARACTER, character)}), and not 3 "
            "translations, or 6 with rotations"
        )
    if form not in (2, 4, 5, 6):
        raise InputError(
            f"{where}: data type {form} in record {head + 1}, expected 2 or 4 (real), 5 or 6 "
            "(complex)"
        )
    numbers = _integers(where, lines[ids], 2, f"record {ids + 1}")
    number = (numbers[3:4] if type_ == 55 else numbers[5:6]) or [0]
    poles = _numbers(lines[real])
    if type_ == 2414:  # time, frequency, eigenvalue, modal mass, damping; or the eigenvalue below
        poles = [*poles[1:2], 0.0, *poles[4:6]] if analysis == _NORMAL else _numbers(lines[12])
    frequency, damping = _pole(where, analysis, poles)
    is_complex = form in (5, 6)
    table = _nodes(where, lines[start:], count * (2 if is_complex else 1))
    values = {
        node: row[0::2] + 1j * row[1::2] if is_complex else row.astype(complex)
        for node, row in table.items()
    }
    return ShapeRecord(
        where,
        number[0],
        frequency,
        damping,
        {node: v[:3] for node, v in values.items()},
        is_complex,
        any(v[3:].any() for v in values.values()),
    )


def _pole(where: str, analysis: int, real: Sequence[float]) -> tuple[float, float]:
    """Undamped natural frequency, Hz, and damping ratio, by record 8."""
    if analysis == _NORMAL:
        frequency, _, viscous, hysteretic = (*real, 0.0, 0.0, 0.0, 0.0)[:4]
        # At resonance a loss factor is twice a damping ratio.
        damping = viscous or 0.5 * hysteretic
    else:
        if len(real) < 2:
            raise InputError(f"{where}: record 8 holds {len(real)} numbers, expected an eigenvalue")
        eigenvalue = complex(real[0], real[1])
        size = abs(eigenvalue)
        if eigenvalue.real > 1e-9 * size:
            raise InputError(
                f"{where}: eigenvalue {eigenvalue:.6g} in record 8 grows in time; expected -sigma "
                "+ i omega in rad/s (not a frequency in Hz and a damping), as in analysis 3 or 7"
            )
        frequency, damping = size / (2 * np.pi), -eigenvalue.real / size if size else 0.0
    if not (np.isfinite(frequency) and frequency >= 0):
        raise InputError(f"{where}: frequency {frequency} Hz in record 8, expected 0 or more")
    return float(frequency), float(damping) if damping else np.nan


def _nodes(where: str, lines: Sequence[str], count: int) -> dict[str, np.ndarray]:
    """Values of each node: a line with its label, and lines of six values at most."""
    found: dict[str, list[float]] = {}
    label, rest = "", 0
    for line in lines:
        if not line.strip():
            continue
        if rest == 0:
            if not re.fullmatch(r"\s*\d+\s*", line):
                raise InputError(
                    f"{where}: line {line.strip()!r} after node {label or '(none)'}, expected the "
                    f"number of the next node: it has other than {count} values"
                )
            label, rest = str(int(line)), count
            if label in found:
                raise InputError(f"{where}: node {label} is there twice, expected it once")
            found[label] = []
            continue
        values = _numbers(line)
        if not values or len(values) > rest or not np.isfinite(values).all():
            raise InputError(
                f"{where}: node {label} has the line {line.strip()!r}; expected {count} finite "
                "numbers"
            )
        found[label] += values
        rest -= len(values)
    if rest:
        raise InputError(
            f"{where}: stops within node {label}: {count - rest} values, expected {count}; the "
            "file is truncated"
        )
    return {node: np.array(values) for node, values in found.items()}


def _numbers(line: str) -> list[float]:
    """Numbers of a line, also those that touch, as in the format 6E13.5."""
    return [float(text.upper().replace("D", "E")) for text in _NUMBER.findall(line)]


def _integers(where: str, line: str, least: int, record: str) -> list[int]:
    try:
        found = [int(text) for text in line.split()]
    except ValueError:
        found = []
    if len(found) < least:
        raise InputError(f"{where}: {record} is {line.strip()!r}, expected {least} whole numbers")
    return found
