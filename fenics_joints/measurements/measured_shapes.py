"""Modes that a test lab identified: frequencies, damping and shapes at nodes, from universal files.

Datasets 55 or 2414, one for each mode, of analysis 2 (normal modes), 3 or 7 (complex eigenvalues).
Nodes and their axes come from datasets 15, 2411, 18 and 2420, units from 164, and lines for
pictures from 82, in any order. The meaning of the fields: "Universal file formats", Structural
Dynamics Research Laboratory, University of Cincinnati. pyuff reads no shapes with six complex
components, none in lines that are filled with blanks, and no exponents with D, so they are read
here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems, measured
from fenics_joints.files import is_file, paths_of, shown_path
from fenics_joints.formatting import first_of
from fenics_joints.measurements.files import Contents, FileMetadata
from fenics_joints.measurements.uff import (
    DATA,
    GEOMETRY,
    Dataset,
    add_nodes,
    axes_of,
    read_sets,
    units_of,
    word,
)
from fenics_joints.structure.points import Sensors

#: Types of analysis in datasets 55 and 2414.
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
#: Those of normal and of complex modes.
_NORMAL, _COMPLEX = 2, (3, 7)
#: Characters of data in datasets 55 and 2414.
_CHARACTER = {
    0: "unknown",
    1: "scalar",
    2: "translations",
    3: "translations and rotations",
    4: "symmetric tensor",
    5: "tensor",
}
#: Types of data that are shapes: unknown, general, displacement, velocity, acceleration.
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


def read_uff_shapes(
    paths: Sequence[Path], metadata: FileMetadata
) -> tuple[Contents, list[ShapeRecord]]:
    """Nodes, lines and shapes of universal files; nodes and units may stand in other files.

    Args:
        paths: The files.
        metadata: What the user says about them.

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
    found, shapes, others = Contents(), [], []
    length, _ = problems.tried(lambda: units_of(sets, metadata)) or (1.0, 1.0)
    axes = problems.tried(lambda: axes_of(sets)) or {}
    for where, data in sets:
        if data["type"] in (15, 2411):
            problems.tried(lambda w=where, d=data: add_nodes(found, w, d, length, axes))
        elif data["type"] == 82:
            found.lines += _lines(data)
        elif data["type"] in (55, 2414):
            record = problems.tried(lambda w=where, d=data: _shape(w, d["type"], d["lines"]))
            if isinstance(record, ShapeRecord):
                shapes.append(record)
            elif record is not None:
                others.append(record)
    problems.check()
    if not shapes:
        _refuse_none(paths, sets, others)
    found.notes += [f"{text}, left out" for text in others]
    return found, shapes


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
        "FRFs (datasets 58), [test.frfs.identify] finds the modes"
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
        return f"{where}: its data are of type {word(DATA, kind)} and no displacements"
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
    table = _node_values(where, lines[start:], count * (2 if is_complex else 1))
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


def _node_values(where: str, lines: Sequence[str], count: int) -> dict[str, np.ndarray]:
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


# -- shapes at sensors -----------------------------------------------------------------------------


#: How many nodes or modes a sentence names.
_NAMED = 12
#: Below this MAC of a real shape with the complex one it stands for, the mode is doubtful.
_REAL = 0.95
#: Relative distance of frequencies, and 1 - MAC, below which two modes are one that is there twice:
#: round-off of the file.
_SAME_HZ, _SAME_SHAPE = 1e-6, 1e-6


@dataclass(frozen=True, eq=False)
class MeasuredShapes:
    """Modes with their shapes, in the order of their frequencies.

    Attributes:
        frequencies_hz: Undamped natural frequencies, Hz, shape (m,).
        damping: Damping ratios, shape (m,); nan where the files have none.
        shapes: Real shapes at the sensors in any scale, shape (n, m); nan where not measured.
        sensors: Nodes and directions that were measured, with names such as ``12:x``.
        collinearity: Modal phase collinearity of the shapes as they were measured, shape (m,): 1
            for one that is real but for a factor.
        mac_real: MAC of each real shape with the complex one, shape (m,).
        lines: Points, m, of lines for pictures of the test, each (k, 3).
        notes: What was left out or is doubtful, in sentences.
        sources: The files.
    """

    frequencies_hz: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    sensors: Sensors
    collinearity: np.ndarray
    mac_real: np.ndarray
    lines: tuple[np.ndarray, ...] = ()
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    def __repr__(self) -> str:
        low, high = self.frequencies_hz[[0, -1]]
        return (
            f"MeasuredShapes({len(self.frequencies_hz)} modes, {low:.5g} to {high:.5g} Hz, at "
            f"{len(self.sensors)} sensors)"
        )

    def nearest(self, frequencies_hz: np.ndarray, within: float = 0.1) -> np.ndarray:
        """Index of the mode that belongs to each of some frequencies, in their order.

        Both ascend, so that the order of each is that of the other; of spare modes those are left
        out whose loss changes the frequencies least.

        Args:
            frequencies_hz: Hz, shape (k,).
            within: Largest relative distance of a pair.

        Raises:
            InputError: If one has no mode within the distance.
        """
        wanted = np.log(np.asarray(frequencies_hz, dtype=float))
        cost = np.abs(wanted[:, None] - np.log(self.frequencies_hz))
        index = in_order(cost)
        bad = index is None or np.any(cost[np.arange(len(wanted)), index] > within)
        if bad:
            here = ", ".join(f"{f:.5g}" for f in self.frequencies_hz)
            there = ", ".join(f"{f:.5g}" for f in frequencies_hz)
            raise InputError(
                f"{', '.join(self.sources)}: has shapes at {here} Hz; expected one within "
                f"{100 * within:g} % of each of {there} Hz, the frequencies of the test"
            )
        return index


def in_order(cost: np.ndarray) -> np.ndarray | None:
    """Ascending columns, one for each row, of the least sum of squared costs; None if too few."""
    n, m = cost.shape
    if m < n:
        return None
    best, back = np.zeros(m + 1), np.zeros((n, m), dtype=int)
    for i in range(n):
        reach = np.full(m + 1, np.inf)
        for j in range(i, m):
            kept, taken = reach[j], best[j] + cost[i, j] ** 2
            back[i, j] = j if taken < kept else back[i, j - 1]
            reach[j + 1] = min(kept, taken)
        best = reach
    index, j = np.zeros(n, dtype=int), m - 1
    for i in reversed(range(n)):
        index[i] = back[i, j]
        j = index[i] - 1
    return index


def read_shapes(
    paths: str | Path | Sequence[str | Path], *, length_unit: str | None = None
) -> MeasuredShapes:
    """Read the modes of universal files: datasets 55 or 2414 with 15, 2411, 18, 2420, 164 and 82.

    A direction in which no mode moves was not measured. Complex shapes are turned until they are
    as real as they get, and their real part is taken.

    Args:
        paths: The files; nodes may stand in another one than shapes.
        length_unit: Unit of the nodes' coordinates, where no file says it.

    Raises:
        InputError: For what is wrong in a file; names the file, the place in it and what was
            expected.
    """
    paths = paths_of(paths)
    for path in paths:
        if not is_file(path):
            name = shown_path(path)
            raise InputError(f"{name}: no such file, expected mode shapes in a universal file")
    contents, records = read_uff_shapes(paths, FileMetadata(length_unit=length_unit))
    records = sorted(records, key=lambda record: record.frequency_hz)
    notes = list(contents.notes)
    still = [record for record in records if record.frequency_hz == 0]
    if still:
        notes.append(f"{first_of([r.where for r in still])}: without a frequency, left out")
    records = [record for record in records if record.frequency_hz > 0]
    if not records:
        raise InputError(f"{paths[0]}: no mode has a frequency, expected it in Hz in record 8")
    sensors, measured = _at_sensors(contents, records, notes)
    _check_once(records, measured)
    shapes, collinearity, mac = made_real(measured)
    damping = _damping(records, notes)
    notes += _complexity(records, collinearity, mac)
    return MeasuredShapes(
        np.array([record.frequency_hz for record in records]),
        damping,
        shapes,
        sensors,
        collinearity,
        mac,
        _points_of_lines(contents),
        tuple(notes),
        tuple(map(str, paths)),
    )


def made_real(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Complex shapes turned until they are as real as they get, their real parts alone.

    Args:
        shapes: Shape (n, m), complex; nan where not measured.

    Returns:
        The real shapes, (n, m); the modal phase collinearity |s^T s|^2 / (s^H s)^2 of the complex
        ones, (m,) (Juang and Pappa, 1985, about zero and not about the mean); and the MAC of real
        with complex, (m,), which is (1 + sqrt(collinearity)) / 2.

    Raises:
        InputError: If these are no numbers, or one of the shapes is zero or was not measured.
    """
    shapes = measured("shapes", shapes, "iufc").astype(complex)
    if shapes.ndim != 2 or not np.all(np.nansum(np.abs(shapes), axis=0) > 0):
        raise InputError(
            f"shapes have shape {shapes.shape}: expected (n_sensors, n_modes), none of them zero"
        )
    there = np.where(np.isnan(shapes), 0.0, shapes)
    square, size = (there**2).sum(axis=0), (np.abs(there) ** 2).sum(axis=0)
    # The sum of squares of a shape turned by an angle is turned by twice that.
    real = (shapes * np.exp(-0.5j * np.angle(square))).real
    largest = np.nanargmax(np.abs(real), axis=0)
    real = real * np.where(real[largest, np.arange(real.shape[1])] < 0, -1.0, 1.0)
    collinearity = (np.abs(square) / size) ** 2
    return real, collinearity, 0.5 * (1 + np.sqrt(collinearity))


def _at_sensors(
    contents: Contents, records: Sequence[ShapeRecord], notes: list[str]
) -> tuple[Sensors, np.ndarray]:
    """Sensors, and complex shapes there, (n, m)."""
    nodes = list(dict.fromkeys(node for record in records for node in record.values))
    _check_places(contents, records, nodes)
    blank = np.full(3, np.nan + 0j)
    values = np.array([[r.values.get(node, blank) for r in records] for node in nodes])
    values = values.transpose(0, 2, 1)  # node, axis, mode
    for record, column in zip(records, values.transpose(2, 0, 1), strict=True):
        if not np.nan_to_num(column).any():
            raise InputError(f"{record.where}: is zero at all nodes, expected a mode shape")
        lacking = [n for n, row in zip(nodes, column, strict=True) if np.isnan(row).any()]
        if lacking:
            notes.append(
                f"{record.where}: has no value at {_node_list(lacking)}, which others have"
            )
    moves = np.nan_to_num(values).any(axis=2)
    silent = [node for node, row in zip(nodes, moves, strict=True) if not row.any()]
    if silent:
        notes.append(f"{_node_list(silent).capitalize()}: zero in all modes, taken as not measured")
    if any(record.rotates for record in records):
        notes.append("Rotations in the files were not used")
    at, axis = np.nonzero(moves)
    places = [contents.nodes[nodes[i]] for i in at]
    sensors = Sensors(
        [place.point for place in places],
        [place.axes[k] for place, k in zip(places, axis, strict=True)],
        [f"{nodes[i]}:{'xyz'[k]}" for i, k in zip(at, axis, strict=True)],
    )
    return sensors, values[at, axis]


def _check_places(contents: Contents, records, nodes: Sequence[str]) -> None:
    known = contents.nodes
    missing = [node for node in nodes if node not in known]
    if missing:
        there = f"{len(known)} others have" if known else "no node has"
        raise InputError(
            f"{records[0].where}: {_node_list(missing)} of the {len(nodes)} that move: no "
            f"coordinates; {there} them. Expected a dataset 15 or 2411 with all nodes, in this "
            "file or another"
        )
    bad = [
        f"node {node} from {known[node].where}: {known[node].problem}"
        for node in nodes
        if known[node].problem
    ]
    if bad:
        raise InputError(first_of(bad, _NAMED, "\n  "))


def _check_once(records: Sequence[ShapeRecord], shapes: np.ndarray) -> None:
    for i, (first, second) in enumerate(zip(records, records[1:], strict=False)):
        a, b = np.nan_to_num(shapes[:, i]), np.nan_to_num(shapes[:, i + 1])
        mac = np.abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)
        near = second.frequency_hz - first.frequency_hz <= _SAME_HZ * first.frequency_hz
        if near and mac > 1 - _SAME_SHAPE:
            raise InputError(
                f"{second.where}: mode at {second.frequency_hz:.6g} Hz was already in "
                f"{first.where}; expected each once"
            )


def _damping(records: Sequence[ShapeRecord], notes: list[str]) -> np.ndarray:
    ratios = np.array([record.damping for record in records])
    bad = np.flatnonzero((ratios < 0) | (ratios >= 1))
    if len(bad):
        first = records[bad[0]]
        notes.append(
            f"{first.where}: damping ratio {first.damping:g}, expected 0 to below 1 (it may be in "
            f"per cent): the damping of {len(bad)} modes was left out"
        )
        ratios[bad] = np.nan
    return ratios


def _complexity(records: Sequence[ShapeRecord], collinearity, mac) -> list[str]:
    complex_ones = np.flatnonzero([record.is_complex for record in records])
    if not len(complex_ones):
        return []
    least = complex_ones[np.argmin(mac[complex_ones])]
    notes = [
        f"{len(complex_ones)} complex shapes were made real: MAC of real with complex from "
        f"{mac[least]:.3f} ({records[least].frequency_hz:.5g} Hz) to {mac[complex_ones].max():.3f},"
        f" phase collinearity from {collinearity[least]:.3f}"
    ]
    poor = [f"{records[i].frequency_hz:.5g}" for i in complex_ones if mac[i] < _REAL]
    if poor:
        notes.append(
            f"Too complex to be compared with modes without damping (MAC below {_REAL:g}): those "
            f"at {first_of(poor)} Hz; sensors out of phase, close modes or local damping make them"
        )
    return notes


def _points_of_lines(contents: Contents) -> tuple[np.ndarray, ...]:
    known = contents.nodes
    lines = [[known[n].point for n in line if n in known] for line in contents.lines]
    return tuple(np.array(line) for line in lines if len(line) > 1)


def _node_list(labels: Sequence[str]) -> str:
    return f"node{'s' if len(labels) > 1 else ''} {first_of(labels)}"
