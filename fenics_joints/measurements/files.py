"""Measured functions from files: single ones as files hold them, and the matrix that they make."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.formatting import first_of
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.time_records import TimeSettings
from fenics_joints.response.units import MOTION, a_kind, checked_kind, frf_unit, length_factor

#: Real part of a driving point's mobility, as a share of all, below which its sign says nothing.
_REACTIVE = 0.15
#: Most values of a matrix of functions, 4.8 GB: 500 responses, 6 references, 100,000 lines.
_VALUES = 300_000_000
#: How names of universal files end.
UFF_SUFFIXES = (".uff", ".unv", ".uf", ".ufb", ".58", ".bunv")
#: Problem of a node whose axes no file defines.
MISSING = "is not in the file"

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class FileMetadata:
    """What a user says about files that do not say it themselves.

    Attributes:
        kind: ``receptance``, ``mobility`` or ``accelerance``; or None.
        units: Unit of the functions, such as ``g/N``; it goes before what a file says. Or None.
        length_unit: Unit of the nodes' coordinates; or None.
        keys: Names of MATLAB variables, by those of `fenics_joints.measurements.mat.KEYS`.
        time: How functions are made of time records.
    """

    kind: str | None = None
    units: str | None = None
    length_unit: str | None = None
    keys: Mapping[str, str] = field(default_factory=dict)
    time: TimeSettings = TimeSettings()

    def __post_init__(self):
        if self.kind is not None:
            checked_kind(self.kind)
        if self.length_unit is not None:
            with located(f"length_unit = {self.length_unit!r}"):
                length_factor(self.length_unit)
        if self.units is None:
            return
        kind, _ = frf_unit(self.units)
        if self.kind not in (None, kind):
            raise InputError(
                f"units = {self.units!r}: are those of {a_kind(kind)}, expected those of kind = "
                f"{self.kind!r}"
            )

    def scale(self, where: str, units: str | None, kind: str | None = None) -> tuple[str, float]:
        """Kind of a function and its factor to SI, by the user's unit or else the file's.

        Args:
            where: File and place in it, for messages.
            units: What the file says of the unit.
            kind: What the file says of the kind.

        Raises:
            InputError: If the unit is not known, or is that of another kind.
        """
        text = self.units or units
        if not text:
            raise InputError(
                f"{where}: the unit is not known; expected it in the file, or units such as "
                f"'{MOTION.get(self.kind or kind, 'm/s2')}/N'"
            )
        with located(where):
            by_unit, factor = frf_unit(text)
        for given in (self.kind, kind):
            if given not in (None, by_unit):
                raise InputError(
                    f"{where}: {text!r} is the unit of {a_kind(by_unit)}, expected that of kind = "
                    f"{given!r}"
                )
        return by_unit, factor


@dataclass(frozen=True)
class Dof:
    """A node and a direction at it; None where the file does not say the direction."""

    node: str
    direction: Vector | None


@dataclass(frozen=True, eq=False)
class Node:
    """Where a node is.

    Attributes:
        point: m, shape (3,).
        axes: Axes in which its directions are given, as rows, shape (3, 3).
        where: File and place in it, for messages.
        problem: What is wrong with it, of importance only if something was measured there.
        turned: Problem of the node's axes, which other coordinates do not solve.
    """

    point: np.ndarray
    axes: np.ndarray
    where: str
    problem: str = ""
    turned: str = ""


@dataclass(frozen=True, eq=False)
class FRFRecord:
    """One function in SI units; ``where`` is the file and the place in it."""

    response: Dof
    reference: Dof
    frequencies_hz: np.ndarray
    values: np.ndarray
    kind: str
    where: str


@dataclass(frozen=True, eq=False)
class CoherenceRecord:
    """Coherence of one function, or with ``reference`` None the multiple one of a response."""

    response: Dof
    reference: Dof | None
    frequencies_hz: np.ndarray
    values: np.ndarray
    where: str


@dataclass(eq=False)
class Contents:
    """What one or more files hold.

    Attributes:
        functions: Functions.
        coherences: Their coherence.
        nodes: Nodes by label.
        notes: What was not used or is doubtful, in sentences.
        lines: Labels of the nodes along lines for pictures.
    """

    functions: list[FRFRecord] = field(default_factory=list)
    coherences: list[CoherenceRecord] = field(default_factory=list)
    nodes: dict[str, Node] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    lines: list[list[str]] = field(default_factory=list)

    def add_node(self, label: str, node: Node) -> None:
        """Add a node; raises InputError if it is known to be elsewhere."""
        known = self.nodes.setdefault(label, node)
        size = float(np.abs(np.concatenate([known.point, node.point])).max())
        # Dataset 15 has six digits.
        if np.abs(known.point - node.point).max() > 2e-5 * size:
            raise InputError(
                f"{node.where}: node {label} is at {node.point.tolist()} m, expected "
                f"{known.point.tolist()} m as in {known.where}"
            )

    def add(self, other: Contents) -> None:
        """Add what another file holds."""
        self.functions += other.functions
        self.coherences += other.coherences
        self.notes += other.notes
        for label, node in other.nodes.items():
            self.add_node(label, node)


def node_label(number: float) -> str:
    """Name of a node that a file gives by a number."""
    return str(int(number)) if float(number).is_integer() else f"{number:g}"


def as_dof(node: str, direction: Sequence[float] | None, where: str) -> Dof:
    """A degree of freedom, whose direction is a vector or None; InputError if that is zero."""
    if direction is None:
        return Dof(str(node), None)
    vector = _vector(direction, f"{where}: direction", zero=False)
    return Dof(str(node), tuple(float(c) for c in vector / np.linalg.norm(vector)))


def merge(
    contents: Contents,
    *,
    points: Mapping[str, Sequence[float]] | None = None,
    directions: Mapping[str, Sequence[float]] | None = None,
    sources: Sequence[str] = (),
) -> MeasuredFRFs:
    """The matrix of all functions.

    A direction against an axis is turned, and the sign of the function with it, so that a blow
    along -z and an accelerometer along +z at one node are one degree of freedom.

    Args:
        contents: What the files hold.
        points: Coordinates of nodes, m, which replace the files'; local axes stay the files'.
        directions: Directions of nodes for which a file does not say any.
        sources: The files.

    Raises:
        InputError: If a node is nowhere, a direction is not known, a function is there twice, or
            the frequencies or kinds differ; names the file and the place in it.
    """
    if not contents.functions:
        raise InputError(f"{', '.join(sources) or 'files'}: no frequency response function")
    places = _Places(contents.nodes, points or {}, directions or {})
    first = contents.functions[0]
    grid = first.frequencies_hz
    cells: dict[tuple, tuple[FRFRecord, float]] = {}
    for record in contents.functions:
        _check_like(record, first)
        response, a = places.resolve(record.response, f"{record.where}: response")
        reference, b = places.resolve(record.reference, f"{record.where}: reference")
        before = cells.setdefault((response, reference), (record, a * b))[0]
        if before is not record:
            raise InputError(
                f"{record.where}: response {places.names[response]}, reference "
                f"{places.names[reference]} was already in {before.where}; expected each once"
            )
    rows, columns = (
        {key: i for i, key in enumerate(sorted({key[side] for key in cells}, key=places.order))}
        for side in (0, 1)
    )
    shape = (len(grid), len(rows), len(columns))
    if math.prod(shape) > _VALUES:
        raise InputError(
            f"{', '.join(sources) or 'files'}: {len(columns)} references, {len(rows)} responses "
            f"and {len(grid)} lines are a matrix of {math.prod(shape):.2g} values, expected at "
            f"most {_VALUES:.2g}; read fewer files at once, or only those of some references"
        )
    values, coherence = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    for (row, column), (record, sign) in cells.items():
        values[:, rows[row], columns[column]] = sign * record.values
    for gamma in contents.coherences:
        _put_coherence(coherence, gamma, first, places, rows, columns)
    data = MeasuredFRFs(
        grid,
        values,
        first.kind,
        *places.arrays(rows),
        *places.arrays(columns),
        tuple(places.names[key] for key in rows),
        tuple(places.names[key] for key in columns),
        None if np.isnan(coherence).all() else coherence,
        tuple(sources),
        (*contents.notes, *places.notes),
    )
    where = {key: record.where for key, (record, _) in cells.items()}
    doubts = _check_power(data, where, list(rows), list(columns))
    return replace(data, notes=(*data.notes, *doubts)) if doubts else data


def _check_like(record: FRFRecord, first: FRFRecord) -> None:
    if not len(record.values):
        raise InputError(f"{record.where}: holds no line, expected some")
    if not np.isfinite(record.values).all():
        line = int(np.argmin(np.isfinite(record.values)))
        raise InputError(
            f"{record.where}: the value at {record.frequencies_hz[line]:g} Hz (line {line + 1} of "
            f"{len(record.values)}) is {record.values[line]}, expected a finite number"
        )
    if not record.values.imag.any():
        kind = "real at all lines, as a spectrum or a coherence" if record.values.any() else "zero"
        raise InputError(f"{record.where}: is {kind}; expected a function with magnitude and phase")
    if record.kind != first.kind:
        raise InputError(
            f"{record.where}: is {a_kind(record.kind)}, expected {a_kind(first.kind)} as in "
            f"{first.where}; read the files of each kind apart and convert one of them"
        )
    _check_grid(record.frequencies_hz, record.where, first)


def _check_grid(f: np.ndarray, where: str, first: FRFRecord) -> None:
    g = first.frequencies_hz
    if f.ndim != 1 or not len(f) or not np.isfinite(f).all() or (np.diff(f) <= 0).any():
        raise InputError(f"{where}: expected frequencies that are finite and ascend")
    # The files' headers and short formats have six digits.
    step = np.diff(g).min() if len(g) > 1 else 1.0
    if len(f) != len(g) or (np.abs(f - g) > 0.01 * step + 1e-5 * g).any():
        raise InputError(
            f"{where}: frequencies are {_lines(f)}, expected {_lines(g)} as in {first.where}"
        )


def _lines(f: np.ndarray) -> str:
    return f"{f[0]:g} to {f[-1]:g} Hz in {len(f)} lines"


def _put_coherence(coherence, gamma: CoherenceRecord, first, places, rows, columns) -> None:
    _check_grid(gamma.frequencies_hz, gamma.where, first)
    bad = ~((gamma.values >= -1e-6) & (gamma.values <= 1 + 1e-6))
    if bad.any():
        raise InputError(
            f"{gamma.where}: coherence {gamma.values[np.argmax(bad)]} at "
            f"{gamma.frequencies_hz[np.argmax(bad)]:g} Hz, expected 0 to 1"
        )
    row, _ = places.resolve(gamma.response, f"{gamma.where}: response")
    column = None
    if gamma.reference is not None:
        column, _ = places.resolve(gamma.reference, f"{gamma.where}: reference")
    if row not in rows or (column is not None and column not in columns):
        raise InputError(
            f"{gamma.where}: coherence of response {places.names[row]}"
            + ("" if column is None else f", reference {places.names[column]}")
            + " has no frequency response function; expected one"
        )
    where = slice(None) if column is None else columns[column]
    coherence[:, rows[row], where] = gamma.values[:, None] if column is None else gamma.values


class _Places:
    """Degrees of freedom with their points and global directions."""

    def __init__(self, nodes, points, directions):
        self.nodes = dict(nodes)
        self.directions = {str(k): v for k, v in directions.items()}
        self.notes: list[str] = []
        for label, point in points.items():
            known = self.nodes.get(str(label))
            axes, turned = (np.eye(3), "") if known is None else (known.axes, known.turned)
            if turned.endswith(MISSING):
                self.notes.append(f"node {label}: {turned}: its directions are taken as global")
                turned = ""
            at = _vector(point, f"points.{label}")
            self.nodes[str(label)] = Node(at, axes, "points", turned)
        self.names: dict[tuple, str] = {}
        self.found: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def resolve(self, dof: Dof, what: str) -> tuple[tuple, float]:
        """Key of a degree of freedom, and the sign of its direction."""
        node = self.nodes.get(dof.node)
        if node is None:
            known = sorted(self.nodes, key=_natural)
            raise InputError(
                f"{what} node {dof.node} has no coordinates: expected them in a file (dataset 15 "
                "or 2411, or a table of nodes) or in points; "
                + (f"known are nodes {first_of(known)}" if known else "no node is known")
            )
        if node.problem:
            raise InputError(f"{what} node {dof.node}, from {node.where}: {node.problem}")
        direction = self._direction(dof, node, what)
        sign = 1.0 if direction[np.argmax(np.abs(direction))] > 0 else -1.0
        direction = sign * direction
        key = (dof.node, *(round(float(c), 6) + 0.0 for c in direction))
        self.found.setdefault(key, (node.point, direction))
        self.names.setdefault(key, f"{dof.node}:{_direction_name(direction)}")
        return key, sign

    def _direction(self, dof: Dof, node: Node, what: str) -> np.ndarray:
        if dof.direction is not None:
            return np.asarray(dof.direction) @ node.axes
        if dof.node not in self.directions:
            raise InputError(
                f"{what} node {dof.node} has no direction (code 0 is a scalar): expected +-1, 2 or "
                f"3 for x, y, z, or directions with the vector of node {dof.node}"
            )
        vector = _vector(self.directions[dof.node], f"directions.{dof.node}", zero=False)
        return vector / np.linalg.norm(vector)

    def order(self, key: tuple) -> tuple:
        """By node, then x before y before z."""
        return (_natural(key[0]), *(-c for c in key[1:]))

    def arrays(self, keys) -> tuple[np.ndarray, np.ndarray]:
        found = [self.found[key] for key in keys]
        return np.array([p for p, _ in found]), np.array([d for _, d in found])


def _vector(value: Sequence[float], key: str, zero: bool = True) -> np.ndarray:
    try:
        vector = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.full(1, np.nan)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not (zero or vector.any()):
        more = "" if zero else ", not all zero"
        raise InputError(f"{key} = {value!r}: expected three finite numbers{more}")
    return vector


def _natural(label: str) -> tuple:
    return (0, int(label), "") if label.isdigit() else (1, 0, label)


def _direction_name(direction: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(direction)))
    if direction[axis] > 1 - 1e-9:
        return "+" + "xyz"[axis]
    return "[" + " ".join(f"{c + 0.0:.3g}" for c in direction) + "]"


def _check_power(data: MeasuredFRFs, where: Mapping[tuple, str], rows, columns) -> list[str]:
    """A force cannot take power out of a structure that is at rest: Re of its mobility is >= 0.

    A band without resonances has hardly a real part, whose sign is then that of a small error of
    phase, and says nothing.

    Returns:
        What is doubtful, in words: a real part of both signs.
    """
    doubts = []
    mobility = data.converted("mobility").values
    for i, j, sign in data.driving_points():
        size = np.abs(mobility[:, i, j])
        power = sign * mobility[:, i, j].real * size
        part, all_ = np.abs(power).sum(), (size**2).sum()
        if part < _REACTIVE * all_ or power.sum() > 0.5 * part:
            continue
        place = f"{where[rows[i], columns[j]]}: at the driving point {data.reference_names[j]} the"
        if power.sum() < -0.5 * part:
            raise InputError(
                f"{place} mobility's real part is negative, for {a_kind(data.kind)} as said; "
                "expected a sensor or force of the other sign, another kind, or the conjugate "
                "(phase with exp(+i omega t))"
            )
        doubts.append(
            f"{place} mobility's real part, which is never negative, has both signs, for "
            f"{a_kind(data.kind)} as said: the kind, or the phase, may be wrong"
        )
    return doubts
