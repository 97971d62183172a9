"""Modes that a test lab identified: frequencies, damping and shapes at nodes, from its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, measured
from fenics_joints.files import is_file, paths_of, shown_path
from fenics_joints.measurements.records import Said
from fenics_joints.measurements.uff_shapes import ShapeContents, ShapeRecord, read_uff_shapes
from fenics_joints.structure.points import Sensors

#: How many nodes or modes a sentence names.
_NAMED = 12
#: Below this MAC of a real shape with the complex one it stands for, the mode is doubtful.
_REAL = 0.95
#: Modes of one frequency (relative) and of one shape (1 - MAC) are one that is there twice.
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
    contents = read_uff_shapes(paths, Said(length_unit=length_unit))
    records = sorted(contents.shapes, key=lambda record: record.frequency_hz)
    notes = list(contents.notes)
    still = [record for record in records if record.frequency_hz == 0]
    if still:
        notes.append(f"{_listed([r.where for r in still])}: without a frequency, left out")
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
    contents: ShapeContents, records: Sequence[ShapeRecord], notes: list[str]
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
            notes.append(f"{record.where}: has no value at {_nodes(lacking)}, which others have")
    moves = np.nan_to_num(values).any(axis=2)
    silent = [node for node, row in zip(nodes, moves, strict=True) if not row.any()]
    if silent:
        notes.append(f"{_nodes(silent).capitalize()}: zero in all modes, taken as not measured")
    if any(record.rotates for record in records):
        notes.append("Rotations in the files were not used")
    at, axis = np.nonzero(moves)
    places = [contents.places.nodes[nodes[i]] for i in at]
    sensors = Sensors(
        [place.point for place in places],
        [place.axes[k] for place, k in zip(places, axis, strict=True)],
        [f"{nodes[i]}:{'xyz'[k]}" for i, k in zip(at, axis, strict=True)],
    )
    return sensors, values[at, axis]


def _check_places(contents: ShapeContents, records, nodes: Sequence[str]) -> None:
    known = contents.places.nodes
    missing = [node for node in nodes if node not in known]
    if missing:
        there = f"{len(known)} others have" if known else "no node has"
        raise InputError(
            f"{records[0].where}: {_nodes(missing)} of the {len(nodes)} that move: no coordinates; "
            f"{there} them. Expected a dataset 15 or 2411 with all nodes, in this file or another"
        )
    bad = [
        f"node {node} from {known[node].where}: {known[node].problem}"
        for node in nodes
        if known[node].problem
    ]
    if bad:
        more = f"\n  and {len(bad) - _NAMED} more" if len(bad) > _NAMED else ""
        raise InputError("\n  ".join(bad[:_NAMED]) + more)


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
            f"at {_listed(poor)} Hz; sensors out of phase, close modes or local damping make them"
        )
    return notes


def _points_of_lines(contents: ShapeContents) -> tuple[np.ndarray, ...]:
    known = contents.places.nodes
    lines = [[known[n].point for n in line if n in known] for line in contents.lines]
    return tuple(np.array(line) for line in lines if len(line) > 1)


def _nodes(labels: Sequence[str]) -> str:
    return f"node{'s' if len(labels) > 1 else ''} {_listed(labels)}"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - _NAMED} more" if len(items) > _NAMED else ""
    return ", ".join(items[:_NAMED]) + more
