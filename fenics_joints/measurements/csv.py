"""Measured functions, or the nodes at which they were measured, from CSV (or TOML) tables.

A table of nodes has the columns ``node``, ``x [mm]``, ``y [mm]`` and ``z [mm]``, in any unit of
length. A table of functions has a column ``frequency [Hz]`` and for each function two columns, real
and imaginary part or magnitude and phase, and perhaps a third::

    frequency [Hz], 12:+z/5:-x re [m/s2/N], 12:+z/5:-x im [m/s2/N], 12:+z/5:-x coherence
    frequency [Hz], 12:+z/5:-x abs [g/N],   12:+z/5:-x phase [deg]

A table of time records has a column ``time [s]``, a column for each force and for each response,
all of one unit::

    time [s], force 5:-x [N], 12:+z [m/s2], 13:+z [m/s2]

Node 12 is that of the response and node 5 that of the force. The direction may be left out where
the user says it, and the unit too.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.measurements.files import (
    CoherenceRecord,
    Contents,
    Dof,
    FileMetadata,
    FRFRecord,
    Node,
    node_label,
)
from fenics_joints.measurements.tables import DataTable, read_table
from fenics_joints.measurements.time_records import frfs_from_time, sampling_rate
from fenics_joints.response.units import a_kind, length_factor

_DOF = r"([^\s:/]+)(?::([+-]?)([xyz]))?"
_HEAD = re.compile(rf"({_DOF}/{_DOF})\s+(re|im|abs|phase|coherence)")
_TIME_HEAD = re.compile(rf"(force\s+)?{_DOF}")
_EXAMPLE = "'12:+z/5:-x re [m/s2/N]', with re, im, abs, phase or coherence"


def read_csv(path: Path, metadata: FileMetadata) -> Contents:
    """What a table of functions or nodes holds.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    table = read_table(path)
    if "node" in table.names:
        return _nodes(table, metadata)
    if "time" in table.names:
        return _of_time(table, metadata)
    f = table.column("frequency", "Hz")
    parts: dict[str, dict[str, str]] = {}
    dofs = {}
    for name in table.names:
        if name == "frequency":
            continue
        match = _HEAD.fullmatch(name)
        if not match:
            raise InputError(f"{path}: column {name!r}: expected a head such as {_EXAMPLE}")
        parts.setdefault(match[1], {})[match[8]] = name
        dofs[match[1]] = (_dof(*match.groups()[1:4]), _dof(*match.groups()[4:7]))
    contents = Contents(notes=list(table.notes))
    for function, columns in parts.items():
        response, reference = dofs[function]
        where = f"{path}: {function}"
        if set(columns) != {"coherence"}:
            values, kind = _values(table, where, columns, metadata)
            contents.functions.append(FRFRecord(response, reference, f, values, kind, where))
        if "coherence" in columns:
            gamma = table.column(columns["coherence"], "")
            contents.coherences.append(CoherenceRecord(response, reference, f, gamma, where))
    return contents


def _of_time(table: DataTable, metadata: FileMetadata) -> Contents:
    """Functions of time records."""
    sides: dict[bool, list[tuple[str, Dof]]] = {True: [], False: []}
    for name in table.names:
        if name == "time":
            continue
        match = _TIME_HEAD.fullmatch(name)
        if not match:
            raise InputError(
                f"{table.path}: column {name!r}: expected 'force 5:-x [N]' or '12:+z [m/s2]'"
            )
        sides[bool(match[1])].append((name, _dof(*match.groups()[1:4])))
    units = [{table.unit(name) for name, _ in sides[is_force]} for is_force in (False, True)]
    if not all(len(own) == 1 for own in units):
        raise InputError(f"{table.path}: expected forces of one unit, and responses of one unit")
    (response,), (force,) = units
    kind, factor = metadata.scale(str(table.path), f"{response}/{force}" if response else None)
    with located(table.path):
        rate = sampling_rate(table.column("time", "s"))
        records = [np.column_stack([table.numbers(n) for n, _ in sides[s]]) for s in (True, False)]
        made = frfs_from_time(rate, *records, metadata.time)
    contents = Contents(notes=[*table.notes, *(f"{table.path}: {note}" for note in made.notes)])
    for i, (name, dof) in enumerate(sides[False]):
        for j, (_, reference) in enumerate(sides[True]):
            where, f = f"{table.path}: {name}", made.frequencies_hz
            record = dof, reference, f, factor * made.values[:, i, j], kind, where
            contents.functions.append(FRFRecord(*record))
            gamma = made.coherence[:, i]
            contents.coherences.append(CoherenceRecord(dof, reference, f, gamma, where))
    return contents


def _dof(node: str, sign: str, axis: str) -> Dof:
    if not axis:
        return Dof(node, None)
    direction = [0.0, 0.0, 0.0]
    direction["xyz".index(axis)] = -1.0 if sign == "-" else 1.0
    return Dof(node, tuple(direction))


def _values(table: DataTable, where: str, columns: dict[str, str], metadata: FileMetadata):
    have = set(columns) - {"coherence"}
    if have == {"re", "im"}:
        (kind, re_factor), (other, im_factor) = (
            _unit(table, columns[part], metadata) for part in ("re", "im")
        )
        if kind != other:
            raise InputError(
                f"{where}: re is {a_kind(kind)}, im {a_kind(other)}; expected one unit for both"
            )
        re_, im = (table.column(columns[part]) for part in ("re", "im"))
        return re_factor * re_ + 1j * im_factor * im, kind
    if have == {"abs", "phase"}:
        kind, factor = _unit(table, columns["abs"], metadata)
        phase, size = table.phase(columns["phase"]), table.column(columns["abs"])
        if (size < 0).any():
            raise InputError(
                f"{where} abs: {size.min():g}, expected magnitudes of 0 or more, not decibels"
            )
        return factor * size * np.exp(1j * phase), kind
    raise InputError(
        f"{where}: has the columns {', '.join(sorted(have))}; expected re and im, or abs and phase"
    )


def _unit(table: DataTable, column: str, metadata: FileMetadata) -> tuple[str, float]:
    return metadata.scale(f"{table.path}: column {column!r}", table.unit(column))


def _nodes(table: DataTable, metadata: FileMetadata) -> Contents:
    labels, contents = table.numbers("node"), Contents()
    columns = []
    for axis in ("x", "y", "z"):
        values = table.numbers(axis)
        unit = table.unit(axis) or metadata.length_unit
        if not unit:
            raise InputError(
                f"{table.path}: column {axis!r}: the unit is not known; expected a head such as "
                f"'{axis} [mm]', or length_unit"
            )
        with located(f"{table.path}: column {axis!r}"):
            columns.append(values * length_factor(unit))
    points = np.column_stack(columns)
    for label, point in zip(labels, points, strict=True):
        contents.add_node(node_label(label), Node(point, np.eye(3), str(table.path)))
    return contents
