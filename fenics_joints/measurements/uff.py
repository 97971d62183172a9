"""Read universal files (UFF): functions, units, nodes and coordinate systems.

Datasets 58 (functions, ASCII or binary) of type 4 (frequency response), 6 and 26 (coherence), 15
and 2411 (nodes), 18 and 2420 (coordinate systems) and 164 (units) are read, in any order. pyuff
parses them, but for the values of datasets 58, which are read here. The meaning of the fields:
"Universal file formats", Structural Dynamics Research Laboratory, University of Cincinnati.
"""

from __future__ import annotations

import mmap
import re
import tempfile
import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fenics_joints.errors import InputError, Problems, located
from fenics_joints.files import check_size
from fenics_joints.measurements.files import (
    MISSING,
    CoherenceRecord,
    Contents,
    Dof,
    FileMetadata,
    FRFRecord,
    Node,
)
from fenics_joints.progress import reading
from fenics_joints.response.units import MOTION, a_kind, frf_unit, length_factor, ratio_unit
from fenics_joints.units import factor_to_si

#: A dataset: its place in the file, for messages, and its content.
Dataset = tuple[str, dict[str, Any]]
#: Datasets of nodes, coordinate systems and units.
GEOMETRY = (15, 18, 164, 2411, 2420)
#: Ordinate data types of dataset 58.
FORMS = {2: "real single", 4: "real double", 5: "complex single", 6: "complex double"}

#: Datasets of mode shapes, which are returned as lines of text.
_SHAPES = (55, 2414)
#: The mark -1 between datasets: alone on a line; or right behind binary data, which need not end
#: with a line break.
_MARK = re.compile(rb"^[ \t]{0,5}-1[ \t]*(?:\r?\n|\Z)", re.MULTILINE)
_BINARY_MARK = re.compile(rb"[\r\n]{0,2} {4}-1[ \t]*(?:\r?\n|\Z)")
_D = re.compile(r"(\d\.?)[Dd]([+-]?\d)")
_NUMBER = re.compile(
    r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[Ee][+-]?\d+|[+-]\d{3}(?![\d.]))?|[+-]?(?:nan|inf)", re.IGNORECASE
)
_BARE = re.compile(r"(\d\.?)([+-]\d{3})$")


def read_sets(
    path: Path, kinds: Collection[int], problems: Problems | None = None
) -> list[Dataset]:
    """(place, content) of each dataset of these types.

    The content of a dataset 55 or 2414 is its ``lines``; the values of a dataset 58 are read here,
    since pyuff does not read all variants that labs write.

    Args:
        path: The file.
        kinds: Types of the datasets to read.
        problems: Collects the errors of single datasets, so that the others are still read; if
            None, they are raised.

    Raises:
        InputError: If pyuff is missing, or a dataset cannot be read; names the file, the dataset
            by its place (from 1) and type, and what was expected.
    """
    pyuff = _pyuff()
    check_size(path)
    if not path.stat().st_size:
        raise InputError(f"{path}: is empty, expected a universal file")
    found = Problems(path) if problems is None else problems
    sets = []
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        progress = reading(path.name, len(data), len(data))
        for i, (kind, start, body, end) in enumerate(_blocks(path, data)):
            progress.advance(end - start)
            where = f"{path}: dataset {i + 1} (type {kind or 'unknown'})"
            if not kind:
                expected = "expected the type's number after the line '    -1'"
                found.add(f"{where}: has no type; {expected}")
            elif kind in kinds and kind in _SHAPES:
                lines = _text(data[body:end]).splitlines()
                sets.append((where, {"type": kind, "lines": lines}))
            elif kind in kinds:
                read = found.tried(
                    lambda k=kind, at=where, s=start, b=body, e=end: _read_set(
                        pyuff, k, at, data[s:b], data[b:e]
                    )
                )
                if read is not None:
                    sets.append((where, read))
    if problems is None:
        found.check()
    return sets


def _blocks(path: Path, data: mmap.mmap) -> Iterator[tuple[int, int, int, int]]:
    """Type, start, end of the head, and end of each dataset.

    The head is the line with the type; that of a dataset 58 has eleven more records. Binary data
    are skipped by their number of bytes, since the mark after them need not start a new line.
    """
    at, n = 0, 0
    while (mark := _MARK.search(data, at)) is not None:
        n += 1
        start = body = mark.end()
        line = _line(data, start)
        number = re.match(rb"\s*(\d+)(b?)(?!\S)", line, re.IGNORECASE)
        kind = int(number[1]) if number else 0
        heads = []
        for _ in range(12 if kind == 58 else 1):
            heads.append(_line(data, body))
            body += len(heads[-1])
        stop = _MARK.search(data, body)
        if kind == 58 and number[2]:
            sizes = [int(x) for x in line[31:43].split() if x.isdigit()] + [_bytes(heads)]
            left = len(data) - body
            ends = [_BINARY_MARK.match(data, body + size) for size in sizes if 0 <= size <= left]
            stop = next((end for end in ends if end), _BINARY_MARK.search(data, body) or stop)
        if stop is None:
            raise InputError(
                f"{path}: stops within a dataset ({len(data)} bytes); expected '    -1' at its end:"
                " the file is truncated, or not a universal file"
            )
        yield kind, start, body, stop.start()
        at = stop.end()
    if not n:
        raise InputError(
            f"{path}: cannot be read as a universal file: holds no dataset; it stops within a "
            "dataset, or is truncated; expected blocks between lines of '    -1'"
        )


def _line(data: mmap.mmap, at: int) -> bytes:
    end = data.find(b"\n", at)
    return data[at : len(data) if end < 0 else end + 1]


def _text(raw: bytes) -> str:
    """Text of a file in UTF-8, or else in Latin-1, as older programs write it."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _pyuff():
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import pyuff
    except ImportError as error:
        raise InputError(
            "universal files need pyuff, which is not installed; expected "
            "pip install 'fenics-joints[frf]'"
        ) from error
    return pyuff


def _read_set(pyuff, kind: int, where: str, head: bytes, body: bytes) -> dict[str, Any]:
    text = _text(head if kind == 58 else head + body).replace("\r", "").replace("\t", " ")
    lines = text.splitlines()
    if kind == 58:  # only in the record of numbers: labels stay as they are
        lines[7:8] = [_D.sub(r"\1E\2", line) for line in lines[7:8]]
        text = "\n".join(lines)
    else:
        text = _D.sub(r"\1E\2", text)
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / "a.uff"
        alone.write_text(f"    -1\n{text.rstrip()}\n    -1\n", encoding="utf-8", newline="\n")
        try:
            read = pyuff.UFF(str(alone)).read_sets(0, header_only=kind == 58)
        except Exception as error:  # pyuff raises plain Exception
            what = (
                "its head cannot be read; expected the eleven records of dataset 58"
                if kind == 58
                else "cannot be read; expected the records of that dataset, blanks between numbers"
            )
            raise InputError(f"{where}: {what}") from error
    return read if kind != 58 else read | _function_values(where, read, body)


def _form(code: int, spacing: int) -> tuple[int, int, int]:
    """How many numbers a value has (with an uneven abscissa) and an ASCII row; bytes of one."""
    count = (2 if code in (5, 6) else 1) + (spacing == 0)
    size = 8 if code in (4, 6) else 4
    row = 6 if size == 4 else 4 if spacing or code == 4 else 3
    return count, row, size


def _bytes(heads: Sequence[bytes]) -> int:
    """Number of bytes of binary data, from record 7; 0 if that cannot be read."""
    try:
        code, points, spacing = (int(x) for x in heads[7][:30].split())
    except ValueError:
        return 0
    count, _, size = _form(code, spacing)
    return count * points * size


def _function_values(where: str, head: dict[str, Any], body: bytes) -> dict[str, np.ndarray]:
    """Abscissa and values of a dataset 58, ``x`` and ``data``.

    Padding behind the last value is cut off: record 7 has the number of values.
    """
    code, spacing, points = (head[k] for k in ("ord_data_type", "abscissa_spacing", "num_pts"))
    count, row, size = _form(code, spacing)
    wanted = points * count
    if code not in FORMS:
        values = np.zeros(0)
    elif head["binary"]:
        kind = f"{'<' if head['byte_ordering'] == 1 else '>'}f{size}"
        # A line break, or the padding of a record, may follow the last value.
        values = np.frombuffer(body[: len(body) // size * size], kind).astype(float)
        values = values[:wanted] if len(body) < wanted * size + 2 * row * size else values
    else:
        values = _numbers(where, head, body)
        values = values[:wanted] if len(values) < wanted + row else values
    values = values[: len(values) // count * count].reshape(-1, count)
    if spacing:
        x = head["abscissa_min"] + np.arange(len(values)) * head["abscissa_inc"]
    else:
        x, values = values[:, 0], values[:, 1:]
    return {"x": x, "data": values[:, 0] if code in (2, 4) else values[:, 0] + 1j * values[:, -1]}


def _numbers(where: str, head: dict[str, Any], body: bytes) -> np.ndarray:
    """Numbers as Fortran writes them: 1.0D+02, 1.0-103 (no letter), or with no blanks between."""
    text = body.decode("latin-1").replace("D", "E").replace("d", "e")
    if (last := text[-90:].split()[-1:]) and _NUMBER.sub("", last[0]) == last[0][-1]:
        text = text.rstrip()[: -len(last[0])]  # half a number, where a file was cut
    try:
        return np.array(text.split(), dtype=float)
    except ValueError:
        pass
    rest = _NUMBER.sub("", text)
    if rest.strip():
        raise InputError(
            f"{where}: its values cannot be read; expected {head['num_pts']} ASCII values, "
            f"{word(FORMS, head['ord_data_type'])}, spacing {head['abscissa_spacing']} (0 uneven, "
            f"1 even) as in its record 7, not {rest.split()[0]!r}: the data are damaged or "
            "truncated, or the record is wrong"
        )
    return np.array([float(_BARE.sub(r"\1E\2", one)) for one in _NUMBER.findall(text)], dtype=float)


def word(words: Mapping[int, str], code: int) -> str:
    """A code and what it means."""
    return f"{code} ({words[code]})" if code in words else str(code)


# -- units and nodes -------------------------------------------------------------------------------


def units_of(sets: Sequence[Dataset], metadata: FileMetadata) -> tuple[float | None, float | None]:
    """The file's units of length and force, in m and N; each None where it is not stated.

    Values divided by the factors of dataset 164 are in SI units.
    """
    found = [(where, d) for where, d in sets if d["type"] == 164]
    for where, data in found:
        for key in ("length", "force"):
            if not (np.isfinite(data[key]) and data[key] > 0):
                raise InputError(f"{where}: factor of {key} is {data[key]}, expected above 0")
            if not np.isclose(data[key], found[0][1][key], rtol=1e-6):
                raise InputError(
                    f"{where}: factor of {key} is {data[key]:g}, expected "
                    f"{found[0][1][key]:g} as in {found[0][0]}"
                )
    length = 1 / found[0][1]["length"] if found else None
    force = 1 / found[0][1]["force"] if found else None
    if metadata.length_unit is not None:
        given = length_factor(metadata.length_unit)
        if length is not None and not np.isclose(given, length, rtol=1e-3):
            raise InputError(
                f"length_unit = {metadata.length_unit!r}: but {found[0][0]} says a unit of "
                f"{length:.6g} m; expected no length_unit, or one that agrees"
            )
        length = given
    return length, force


@dataclass(frozen=True, eq=False)
class CoordinateSystem:
    """A coordinate system of a file.

    Attributes:
        kind: 0 Cartesian, 1 cylindrical, 2 spherical.
        axes: Axes of x, y and z, as rows, shape (3, 3).
        origin: In the file's unit of length, shape (3,).
        problem: Why it cannot be used, in words.
    """

    kind: int = 0
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    problem: str = ""

    def directions(self, point: np.ndarray) -> tuple[np.ndarray, str]:
        """The system's directions at a point, as rows, and what is wrong with them, or "".

        Those of a cylindrical system are radial, tangential and axial.
        """
        if self.problem or self.kind == 0:
            return self.axes, self.problem
        if self.kind != 1:
            return self.axes, "is spherical, and programs differ in the order of its directions"
        x, y, _ = self.axes @ (point - self.origin)
        if self.on_axis(point):
            return self.axes, ""
        c, s = np.array([x, y]) / np.hypot(x, y)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ self.axes, ""

    def on_axis(self, point: np.ndarray) -> bool:
        """Whether a point is on the axis of a cylindrical system, where x is taken as radial."""
        x, y, z = self.axes @ (point - self.origin)
        return self.kind == 1 and np.hypot(x, y) <= 1e-9 * abs(z)


def axes_of(sets: Sequence[Dataset]) -> dict[int, CoordinateSystem]:
    """Coordinate systems of datasets 18 and 2420, by label."""
    found = {}
    for where, data in sets:
        if data["type"] == 2420:
            others = [0] * len(data["CS_types"])
            systems = zip(
                data["CS_sys_labels"], data["CS_types"], others, data["CS_matrices"], strict=True
            )
        elif data["type"] == 18:
            matrices = [*map(_frame, data["ref_o"], data["x_point"], data["xz_point"])]
            systems = zip(
                data["cs_num"], data["cs_type"], data["ref_cs_num"], matrices, strict=True
            )
        else:
            continue
        for label, kind, other, matrix in systems:
            if not np.isfinite([label, kind, other]).all():
                raise InputError(f"{where}: expected a label and a kind of each coordinate system")
            good = matrix.shape == (4, 3) and np.allclose(
                matrix[:3] @ matrix[:3].T, np.eye(3), atol=1e-4
            )
            problem = "is given in another system" if other else ""
            if not good and not problem:
                raise InputError(
                    f"{where}: axes of coordinate system {int(label)} are no rotation; expected an "
                    "origin and three axes at right angles"
                )
            found[int(label)] = (
                CoordinateSystem(problem=problem)
                if problem
                else CoordinateSystem(int(kind), matrix[:3], matrix[3])
            )
    return found


def _frame(origin: np.ndarray, on_x: np.ndarray, on_xz: np.ndarray) -> np.ndarray:
    """Axes and origin, as four rows, from the origin, a point on x and a point in the xz plane."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (on_x - origin) / np.linalg.norm(on_x - origin)
        y = np.cross(on_xz - origin, x)
        y = y / np.linalg.norm(y)
    return np.vstack([x, y, np.cross(x, y), origin])


def add_nodes(contents: Contents, where: str, data, length: float | None, axes) -> None:
    """Add the nodes of a dataset 15 or 2411 to ``contents``.

    ``length`` is the file's unit of length, m (None if not known); ``axes`` are those of `axes_of`.
    """
    columns = [np.asarray(data[key], dtype=float) for key in ("x", "y", "z")]
    labels = np.asarray(data["node_nums"], dtype=float)
    systems = [np.asarray(data[key], dtype=float) for key in ("def_cs", "disp_cs")]
    if any(len(c) != len(labels) or not np.isfinite(c).all() for c in (labels, *columns, *systems)):
        raise InputError(f"{where}: expected label, two systems, colour and x, y, z of each node")
    if length is None:
        spans = " x ".join(f"{np.ptp(c) if len(c) else 0:.6g}" for c in columns)
        raise InputError(
            f"{where}: the unit of coordinates is not known; expected a dataset 164, or "
            f"length_unit, such as length_unit = 'mm' if the nodes span {spans} mm"
        )
    on_axis: list[str] = []
    for i, label in enumerate(labels):
        point, problem = np.array([c[i] for c in columns]), ""
        if data["type"] == 15:  # in 2411 coordinates are in the part's system
            defined = _system(int(systems[0][i]), axes)
            if defined.problem or defined.kind:
                why = defined.problem or "is not Cartesian"
                problem = f"its definition system {int(systems[0][i])} {why}"
            point = point @ defined.axes + defined.origin
        system = _system(int(systems[1][i]), axes)
        moves, trouble = system.directions(point)
        if not trouble and system.on_axis(point):
            on_axis.append(str(int(label)))
        turned = f"its displacement system {int(systems[1][i])} {trouble}" if trouble else ""
        problem = problem or turned
        if problem:
            problem += (
                "; expected 0 or 1 (global), or a Cartesian or (for displacements) a cylindrical "
                "one of a dataset 18 or 2420"
            )
        contents.add_node(str(int(label)), Node(length * point, moves, where, problem, turned))
    if on_axis:
        contents.notes.append(
            f"{where}: nodes {', '.join(on_axis[:12])} are on the axis of their cylindrical "
            "system: their first direction is taken as the system's x"
        )


def _system(label: int, axes: Mapping[int, CoordinateSystem]) -> CoordinateSystem:
    """The coordinate system of a label; 0, and 1 unless the file defines it, are the global one."""
    if label in axes:
        return axes[label]
    return CoordinateSystem(problem="" if label in (0, 1) else MISSING)


# -- the whole file --------------------------------------------------------------------------------


#: Function types of dataset 58, by code; most are only named in notes and messages.
_TYPES = {
    0: "unknown",
    1: "time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    7: "auto correlation",
    8: "cross correlation",
    9: "power spectral density",
    12: "spectrum",
    26: "multiple coherence",
}
#: Function types that are read: frequency response, coherence, multiple coherence.
_FRF, _COHERENCE, _MULTIPLE = 4, 6, 26

#: Specific data types of dataset 58.
DATA = {
    0: "unknown",
    1: "general",
    2: "stress",
    3: "strain",
    8: "displacement",
    9: "reaction force",
    11: "velocity",
    12: "acceleration",
    13: "excitation force",
    15: "pressure",
    17: "time",
    18: "frequency",
    19: "rpm",
    20: "order",
}
#: Kinds of functions by the type of the response.
_MOTIONS = {8: "receptance", 11: "mobility", 12: "accelerance"}
#: Specific data types: unspecified; of a reference; of an abscissa.
_UNSAID, _FORCE, _FREQUENCY = (0, 1), 13, 18
#: Advice where responses were measured without their force.
_NO_FORCE = (
    "Responses alone give no frequency response function: test with a hammer or a shaker whose "
    "force is measured too; or, for frequencies and shapes only, give the modes that an "
    "operational modal analysis found in these data, as datasets 55: shapes = 'FILE.uff' in [test]"
)
#: Formats of binary numbers that are refused.
_NOT_IEEE = {1: "DEC VMS", 3: "IBM 370"}


def read_uff(path: Path, metadata: FileMetadata) -> Contents:
    """Functions, coherences and nodes of a universal file.

    Args:
        path: The file.
        metadata: What the user says about it.

    Raises:
        InputError: If pyuff is missing, or the file has errors; names the file, the dataset by its
            place (from 1) and type, and what was expected.
    """
    problems, contents = Problems(path), Contents()
    sets = read_sets(path, (58, *GEOMETRY), problems)
    units = length, force = problems.tried(lambda: units_of(sets, metadata)) or (1.0, 1.0)
    axes = problems.tried(lambda: axes_of(sets)) or {}
    other: Counter[str] = Counter()
    for where, data in sets:
        if data["type"] in (15, 2411):
            problems.tried(lambda w=where, d=data: add_nodes(contents, w, d, length, axes))
        if data["type"] != 58:
            continue
        if data["func_type"] == _FRF:
            one = problems.tried(
                lambda w=where, d=data: _function(w, d, units, metadata, contents.notes)
            )
            contents.functions.append(one)
        elif data["func_type"] in (_COHERENCE, _MULTIPLE):
            contents.coherences.append(problems.tried(lambda w=where, d=data: _coherence(w, d)))
        else:
            other[word(_TYPES, data["func_type"])] += 1
    problems.check()
    contents.notes = list(dict.fromkeys(contents.notes))
    left = ", ".join(f"{n} of type {kind}" for kind, n in other.items())
    if left and not contents.functions:
        raise InputError(
            f"{path}: its datasets 58 are {left}; expected some of type 4 (frequency response "
            f"function). {_NO_FORCE}"
        )
    if left:
        contents.notes.append(f"{path}: datasets 58 that were not used: {left}")
    return contents


# -- functions -------------------------------------------------------------------------------------


def _function(where: str, data, units, metadata: FileMetadata, notes: list[str]) -> FRFRecord:
    x = _abscissa(where, data)
    denominator = data["orddenom_spec_data_type"]
    if denominator != _FORCE and denominator not in _UNSAID:
        also = f" (a transmissibility). {_NO_FORCE}" if denominator in _MOTIONS else ""
        raise InputError(
            f"{where}: reference is of type {word(DATA, denominator)}, expected 13 (excitation "
            f"force){also}"
        )
    if not np.iscomplexobj(data["data"]):
        raise InputError(
            f"{where}: ordinate data type {word(FORMS, data['ord_data_type'])}, expected 5 or 6 "
            "(complex): a frequency response function has a phase"
        )
    kind, factor = _scale(where, data, units, metadata, notes)
    return FRFRecord(
        _dof(where, data, "rsp", "response"),
        _dof(where, data, "ref", "reference"),
        x,
        factor * np.asarray(data["data"]),
        kind,
        where,
    )


def _coherence(where: str, data) -> CoherenceRecord:
    multiple = data["func_type"] == _MULTIPLE
    return CoherenceRecord(
        _dof(where, data, "rsp", "response"),
        None if multiple else _dof(where, data, "ref", "reference"),
        _abscissa(where, data),
        np.real(data["data"]),
        where,
    )


def _abscissa(where: str, data) -> np.ndarray:
    if data["binary"] and data["fp_format"] in _NOT_IEEE:
        raise InputError(
            f"{where}: binary numbers are of format {word(_NOT_IEEE, data['fp_format'])}, "
            "expected 2 (IEEE 754)"
        )
    kind, label = data["abscissa_spec_data_type"], axis_label(data, "abscissa")
    if kind != _FREQUENCY and kind not in _UNSAID:
        raise InputError(
            f"{where}: abscissa is of type {word(DATA, kind)}, expected 18 (frequency)"
        )
    if len(data["data"]) != data["num_pts"] or len(data["x"]) != data["num_pts"]:
        raise InputError(
            f"{where}: holds {len(data['data'])} values, expected {data['num_pts']} as in its "
            f"record 7: the {'binary ' if data['binary'] else ''}data are truncated, or the record "
            "is wrong"
        )
    with located(f"{where}: unit of the abscissa"):
        return np.asarray(data["x"], dtype=float) * (factor_to_si(label, "Hz") if label else 1.0)


def _dof(where: str, data, side: str, word: str) -> Dof:
    node, code = int(data[f"{side}_node"]), int(data[f"{side}_dir"])
    if abs(code) > 3:
        raise InputError(
            f"{where}: {word} direction code {code} of node {node} is a rotation, expected +-1, 2 "
            "or 3 (translation along x, y or z)"
        )
    direction = np.zeros(3)
    direction[abs(code) - 1] = np.sign(code)
    return Dof(str(node), tuple(direction) if code else None)


def _scale(where: str, data, units, metadata: FileMetadata, notes: list[str]) -> tuple[str, float]:
    """Kind of a function and its factor to SI.

    The user's units come first, then the labels of the axes, then dataset 164. Labels may
    contradict a dataset 164 of SI units, since many programs write that whatever the units of
    their data; other contradictions are errors.
    """
    kind = _file_kind(where, data, metadata)
    if metadata.units is not None:
        return metadata.scale(where, None, kind)
    label_kind, by_label = _by_labels(where, data, units[1])
    kind = kind or label_kind
    if kind is None:
        raise InputError(
            f"{where}: response is of type {word(DATA, data['ordinate_spec_data_type'])}, "
            "expected 8, 11 or 12 (displacement, velocity, acceleration), or the key kind"
        )
    if label_kind not in (None, kind):
        raise InputError(
            f"{where}: units {axis_label(data, 'ordinate')!r} are those of {a_kind(label_kind)}, "
            f"expected those of {a_kind(kind)} as its response type says, or the key units"
        )
    length, force = units
    by_set = None if length is None or force is None else length / force
    if by_label is None and by_set is None:
        raise InputError(
            f"{where}: the units are not known; expected a dataset 164, labels of the axes' units, "
            f"or the key units, such as '{MOTION[kind]}/N'"
        )
    if by_label is not None and length == force == 1 and by_label != 1:
        text = f"{axis_label(data, 'ordinate')!r} by {axis_label(data, 'orddenom') or 'force'!r}"
        notes.append(
            f"FRFs are read in {text}, as their labels say, though dataset 164 says SI units; "
            "the key units overrides both"
        )
    elif None not in (by_label, by_set) and not np.isclose(by_label, by_set, rtol=1e-3):
        by = axis_label(data, "orddenom") or "force"
        raise InputError(
            f"{where}: the unit {axis_label(data, 'ordinate')!r} by {by!r} is {by_label:.6g} "
            f"{MOTION[kind]}/N, but by dataset 164 it is {by_set:.6g}; expected them to agree, or "
            "the key units"
        )
    return kind, by_set if by_label is None else by_label


def _file_kind(where: str, data, metadata: FileMetadata) -> str | None:
    code = data["ordinate_spec_data_type"]
    if code not in _MOTIONS and code not in _UNSAID:
        hint = ": numerator and denominator may be exchanged" if code in (9, 13) else ""
        raise InputError(
            f"{where}: response is of type {word(DATA, code)}, expected 8, 11 or 12 "
            f"(displacement, velocity, acceleration){hint}"
        )
    kind = _MOTIONS.get(code)
    if kind is not None and metadata.kind not in (None, kind):
        raise InputError(
            f"{where}: response is of type {word(DATA, code)}, {a_kind(kind)}; expected that of "
            f"kind = {metadata.kind!r}"
        )
    return kind or metadata.kind


def _by_labels(where: str, data, force: float | None) -> tuple[str | None, float | None]:
    """Kind and factor to SI from the labels of the axes' units; None where there are none."""
    motion, by = axis_label(data, "ordinate"), axis_label(data, "orddenom")
    if not motion:
        return None, None
    try:
        if by:
            return ratio_unit(motion, by)
        try:
            return frf_unit(motion)
        except InputError:
            kind, factor = ratio_unit(motion, "N")
    except InputError as error:
        raise InputError(f"{where}: labels of the units: {error}; or the key units") from error
    if force is None:
        raise InputError(
            f"{where}: the unit of the reference is not known; expected a dataset 164, its label, "
            "or the key units"
        )
    return kind, factor / force


def axis_label(data, axis: str) -> str:
    """Label of the unit of an axis; empty where there is none."""
    text = str(data.get(f"{axis}_axis_units_lab", "")).strip()
    return "" if text.upper() == "NONE" else text
