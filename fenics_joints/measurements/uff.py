"""Measured functions from universal files (UFF), read by pyuff.

Used are datasets 58 (functions, ASCII or binary) of type 4 (frequency response), 6 and 26
(coherence), 15 and 2411 (nodes), 18 and 2420 (axes in which a node moves) and 164 (units), in any
order.
The meaning of the fields: "Universal file formats", Structural Dynamics Research Laboratory,
University of Cincinnati.
"""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.measurements.records import (
    CoherenceRecord,
    Contents,
    Dof,
    FRFRecord,
    Node,
    Said,
)
from fenics_joints.response.units import MOTION, a_kind, frf_unit, length_factor, ratio_unit
from fenics_joints.units import factor_to_si

__all__ = ["read_uff"]

#: Function types of dataset 58 that files of FRFs often hold too.
_TYPES = {
    0: "unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum",
    4: "frequency response function", 5: "transmissibility", 6: "coherence",
    7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    12: "spectrum", 26: "multiple coherence",
}  # fmt: skip
_FRF, _COHERENCE, _MULTIPLE = 4, 6, 26

#: Specific data types of dataset 58.
_DATA = {
    0: "unknown", 1: "general", 2: "stress", 3: "strain", 8: "displacement", 9: "reaction force",
    11: "velocity", 12: "acceleration", 13: "excitation force", 15: "pressure", 17: "time",
    18: "frequency", 19: "rpm", 20: "order",
}  # fmt: skip
_MOTIONS = {8: "receptance", 11: "mobility", 12: "accelerance"}
_UNSAID, _FORCE, _FREQUENCY = (0, 1), 13, 18
_NOT_IEEE = {1: "DEC VMS", 3: "IBM 370"}
_FORMS = {2: "real single", 4: "real double", 5: "complex single", 6: "complex double"}


def read_uff(path: Path, said: Said) -> Contents:
    """What a universal file holds.

    Args:
        path: The file.
        said: What the user says about it.

    Raises:
        InputError: If pyuff is missing, or for what is wrong in the file; names the file, the
            dataset by its place (from 1) and type, and what was expected.
    """
    sets = _read_sets(path)
    length, force = _units(sets, said)
    contents = Contents()
    axes = _axes(sets)
    for where, data in sets:
        if data["type"] in (15, 2411):
            _add_nodes(contents, where, data, length, axes)
    other: Counter[str] = Counter()
    for where, data in sets:
        if data["type"] != 58:
            continue
        if data["func_type"] == _FRF:
            contents.functions.append(_function(where, data, (length, force), said))
        elif data["func_type"] in (_COHERENCE, _MULTIPLE):
            contents.coherences.append(_coherence(where, data))
        else:
            other[_word(_TYPES, data["func_type"])] += 1
    left = ", ".join(f"{n} of type {word}" for word, n in other.items())
    if left and not contents.functions:
        raise InputError(
            f"{path}: its datasets 58 are {left}; expected some of type 4 (frequency response "
            "function)"
        )
    if left:
        contents.notes.append(f"{path}: datasets 58 that were not used: {left}")
    return contents


# -- datasets --------------------------------------------------------------------------------------


def _read_sets(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """(place, content) of each dataset."""
    pyuff = _pyuff()
    tail = path.read_bytes().rstrip()
    if not tail.endswith(b"-1"):
        raise InputError(
            f"{path}: stops within a dataset ({len(tail)} bytes); expected '    -1' at its end: "
            "the file is truncated, or no universal file"
        )
    try:
        file = pyuff.UFF(str(path))
        types = [int(t) for t in file.get_set_types()]
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a universal file ({error})") from error
    if not types:
        raise InputError(f"{path}: holds no dataset; expected blocks between lines of '    -1'")
    sets = []
    for i, kind in enumerate(types):
        where = f"{path}: dataset {i + 1} (type {kind or 'unknown'})"
        if not kind:
            raise InputError(f"{where}: has no type; expected its number after the line '    -1'")
        if kind in (15, 18, 58, 164, 2411, 2420):
            sets.append((where, _read_set(file, i, kind, where)))
    return sets


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


def _read_set(file, i: int, kind: int, where: str) -> dict[str, Any]:
    try:
        return file.read_sets(i)
    except Exception as error:  # pyuff raises plain Exception
        raise InputError(f"{where}: {_why(file, i, kind)}") from error


def _why(file, i: int, kind: int) -> str:
    """What is wrong with a dataset that pyuff cannot read."""
    if kind != 58:
        return "cannot be read; expected the records of that dataset, numbers apart by blanks"
    try:
        head = file.read_sets(i, header_only=True)
    except Exception:
        return "its head cannot be read; expected the eleven records of dataset 58"
    form = "binary" if head["binary"] else "ASCII"
    return (
        f"its values cannot be read; expected {head['num_pts']} {form} values, "
        f"{_word(_FORMS, head['ord_data_type'])}, spacing {head['abscissa_spacing']} (0 uneven, 1 "
        "even) as in its record 7: the data are damaged or truncated, or the record is wrong"
    )


def _word(words: dict[int, str], code: int) -> str:
    return f"{code} ({words[code]})" if code in words else str(code)


# -- units and nodes -------------------------------------------------------------------------------


def _units(sets, said: Said) -> tuple[float | None, float | None]:
    """Metres and newtons of one unit of the file's, each None where it does not say.

    Dataset 164 has the factors by which to divide.
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
    if said.length_unit is not None:
        given = length_factor(said.length_unit)
        if length is not None and not np.isclose(given, length, rtol=1e-3):
            raise InputError(
                f"length_unit = {said.length_unit!r}: but {found[0][0]} says a unit of "
                f"{length:.6g} m; expected no length_unit, or one that agrees"
            )
        length = given
    return length, force


def _axes(sets) -> dict[int, np.ndarray | None]:
    """Transformations (4, 3) of coordinate systems: axes as rows, and the origin.

    None for one that is not Cartesian (its axes would differ from place to place), or is given in
    another one.
    """
    found = {}
    for where, data in sets:
        if data["type"] == 2420:
            systems = zip(data["CS_sys_labels"], data["CS_types"], data["CS_matrices"], strict=True)
        elif data["type"] == 18:
            matrices = [*map(_frame, data["ref_o"], data["x_point"], data["xz_point"])]
            kinds = np.asarray(data["cs_type"]) + np.asarray(data["ref_cs_num"])
            systems = zip(data["cs_num"], kinds, matrices, strict=True)
        else:
            continue
        for label, kind, matrix in systems:
            good = matrix.shape == (4, 3) and np.allclose(
                matrix[:3] @ matrix[:3].T, np.eye(3), atol=1e-4
            )
            if kind == 0 and not good:
                raise InputError(
                    f"{where}: axes of coordinate system {int(label)} are no rotation; expected an "
                    "origin and three axes at right angles"
                )
            found[int(label)] = matrix if kind == 0 else None
    return found


def _frame(origin: np.ndarray, on_x: np.ndarray, on_xz: np.ndarray) -> np.ndarray:
    """Axes as rows, and the origin, by a point on x and one in the plane of x and z."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (on_x - origin) / np.linalg.norm(on_x - origin)
        y = np.cross(on_xz - origin, x)
        y = y / np.linalg.norm(y)
    return np.vstack([x, y, np.cross(x, y), origin])


def _add_nodes(contents: Contents, where: str, data, length: float | None, axes) -> None:
    columns = [np.asarray(data[key], dtype=float) for key in ("x", "y", "z")]
    labels = np.asarray(data["node_nums"], dtype=float)
    if any(len(c) != len(labels) or not np.isfinite(c).all() for c in columns):
        raise InputError(f"{where}: expected label, two systems, colour and x, y, z of each node")
    if length is None:
        raise InputError(
            f"{where}: the unit of coordinates is not known; expected a dataset 164, or length_unit"
        )
    systems = [np.asarray(data[key], dtype=int) for key in ("def_cs", "disp_cs")]
    for i, label in enumerate(labels):
        point, problem = np.array([c[i] for c in columns]), ""
        moves, trouble = _system(int(systems[1][i]), axes)
        if data["type"] == 15:  # in 2411 coordinates are in the part's system
            defined, problem = _system(int(systems[0][i]), axes)
            point = point @ defined[:3] + defined[3]
        problem = f"its definition system {problem}" if problem else ""
        if trouble and not problem:
            problem = f"its displacement system {trouble}"
        node = Node(length * point, moves[:3], where, problem)
        contents.add_node(str(int(label)), node)


def _system(label: int, axes) -> tuple[np.ndarray, str]:
    """Axes and origin of a coordinate system, and what is wrong with it.

    0, and 1 unless it is defined, are the global one.
    """
    common = np.vstack([np.eye(3), np.zeros(3)])
    if label == 0 or (label == 1 and 1 not in axes):
        return common, ""
    if axes.get(label) is not None:
        return axes[label], ""
    kind = "is not Cartesian in global axes" if label in axes else "is not in the file"
    return common, (
        f"{label} {kind}; expected 0 or 1 (global), a Cartesian one in a dataset 18 or 2420, or "
        "the node in points"
    )


# -- functions -------------------------------------------------------------------------------------


def _function(where: str, data, units, said: Said) -> FRFRecord:
    x = _abscissa(where, data)
    denominator = data["orddenom_spec_data_type"]
    if denominator != _FORCE and denominator not in _UNSAID:
        raise InputError(
            f"{where}: reference is of type {_word(_DATA, denominator)}, expected 13 (excitation "
            "force)"
        )
    if not np.iscomplexobj(data["data"]):
        raise InputError(
            f"{where}: ordinate data type {_word(_FORMS, data['ord_data_type'])}, expected 5 or 6 "
            "(complex): a frequency response function has a phase"
        )
    kind, factor = _scale(where, data, units, said)
    return FRFRecord(
        _dof(where, data, "rsp", "response"), _dof(where, data, "ref", "reference"),
        x, factor * np.asarray(data["data"]), kind, where,
    )  # fmt: skip


def _coherence(where: str, data) -> CoherenceRecord:
    multiple = data["func_type"] == _MULTIPLE
    return CoherenceRecord(
        _dof(where, data, "rsp", "response"),
        None if multiple else _dof(where, data, "ref", "reference"),
        _abscissa(where, data), np.real(data["data"]), where,
    )  # fmt: skip


def _abscissa(where: str, data) -> np.ndarray:
    if data["binary"] and data["fp_format"] in _NOT_IEEE:
        raise InputError(
            f"{where}: binary numbers are of format {_word(_NOT_IEEE, data['fp_format'])}, "
            "expected 2 (IEEE 754)"
        )
    kind, label = data["abscissa_spec_data_type"], _label(data, "abscissa")
    if kind != _FREQUENCY and kind not in _UNSAID:
        raise InputError(
            f"{where}: abscissa is of type {_word(_DATA, kind)}, expected 18 (frequency)"
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


def _scale(where: str, data, units, said: Said) -> tuple[str, float]:
    """Kind of a function and its factor to SI.

    By the order of what is said: the user's units, the axes' labels, dataset 164.
    """
    kind, factor = _file_kind(where, data, said), None
    if said.units is not None:
        kind_said, factor = frf_unit(said.units)
        if kind not in (None, kind_said):
            raise InputError(
                f"{where}: response is of type {_word(_DATA, data['ordinate_spec_data_type'])}, "
                f"expected that of units = {said.units!r}, {a_kind(kind_said)}"
            )
        return kind_said, factor
    label_kind, by_label = _by_labels(where, data, units[1])
    kind = kind or label_kind
    if kind is None:
        raise InputError(
            f"{where}: response is of type {_word(_DATA, data['ordinate_spec_data_type'])}, "
            "expected 8, 11 or 12 (displacement, velocity, acceleration), or kind"
        )
    if label_kind not in (None, kind):
        raise InputError(
            f"{where}: units {_label(data, 'ordinate')!r} are those of {a_kind(label_kind)}, "
            f"expected those of {a_kind(kind)} as its response type says, or units"
        )
    length, force = units
    by_set = None if length is None or force is None else length / force
    if by_label is None and by_set is None:
        raise InputError(
            f"{where}: the units are not known; expected a dataset 164, labels of the axes' units, "
            f"or units such as '{MOTION[kind]}/N'"
        )
    if by_label is not None and by_set is not None and not np.isclose(by_label, by_set, rtol=1e-3):
        raise InputError(
            f"{where}: the unit {_label(data, 'ordinate')!r} by "
            f"{_label(data, 'orddenom') or 'force'!r} is {by_label:.6g} {MOTION[kind]}/N, but by "
            f"dataset 164 it is {by_set:.6g}; expected that they agree, or units"
        )
    return kind, by_set if by_label is None else by_label


def _file_kind(where: str, data, said: Said) -> str | None:
    code = data["ordinate_spec_data_type"]
    if code in (9, 13):
        raise InputError(
            f"{where}: response is of type {_word(_DATA, code)}, expected 8, 11 or 12 "
            "(displacement, velocity, acceleration): numerator and denominator may be exchanged"
        )
    if code not in _MOTIONS and code not in _UNSAID:
        raise InputError(
            f"{where}: response is of type {_word(_DATA, code)}, expected 8, 11 or 12 "
            "(displacement, velocity, acceleration)"
        )
    kind = _MOTIONS.get(code)
    if kind is not None and said.kind not in (None, kind):
        raise InputError(
            f"{where}: response is of type {_word(_DATA, code)}, {a_kind(kind)}; expected that of "
            f"kind = {said.kind!r}"
        )
    return kind or said.kind


def _by_labels(where: str, data, force: float | None) -> tuple[str | None, float | None]:
    """Kind and factor by the labels of the axes' units; None where there are none."""
    motion, by = _label(data, "ordinate"), _label(data, "orddenom")
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
        raise InputError(f"{where}: labels of the units: {error}; or say units") from error
    if force is None:
        raise InputError(
            f"{where}: the unit of the reference is not known; expected a dataset 164, its label, "
            "or units"
        )
    return kind, factor / force


def _label(data, axis: str) -> str:
    """Label of an axis's unit; empty where there is none."""
    # pyuff reads UTF-8; what most often is none is a square in Latin-1.
    text = str(data.get(f"{axis}_axis_units_lab", "")).strip().replace("\ufffd", "²")
    return "" if text.upper() == "NONE" else text
