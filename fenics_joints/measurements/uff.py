"""Measured functions from universal files (UFF), read by pyuff.

Used are datasets 58 (functions, ASCII or binary) of type 4 (frequency response), 6 and 26
(coherence), 15 and 2411 (nodes), 18 and 2420 (axes in which a node moves) and 164 (units), in any
order.
The meaning of the fields: "Universal file formats", Structural Dynamics Research Laboratory,
University of Cincinnati.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems, located
from fenics_joints.measurements.records import CoherenceRecord, Contents, Dof, FRFRecord, Said
from fenics_joints.measurements.uff_sets import (
    FORMS,
    GEOMETRY,
    add_nodes,
    axes_of,
    read_sets,
    units_of,
    word,
)
from fenics_joints.response.units import MOTION, a_kind, frf_unit, ratio_unit
from fenics_joints.units import factor_to_si

#: Function types of dataset 58 that files of FRFs often hold too.
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
_FRF, _COHERENCE, _MULTIPLE = 4, 6, 26

#: Specific data types of dataset 58.
_DATA = {
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
_MOTIONS = {8: "receptance", 11: "mobility", 12: "accelerance"}
_UNSAID, _FORCE, _FREQUENCY = (0, 1), 13, 18
#: What data of the response alone would need.
_NO_FORCE = (
    "From responses alone no function by a force follows: needed is a test with a hammer or a "
    "shaker whose force is measured too; or, for frequencies and shapes only, the modes that an "
    "operational modal analysis found in these data, as datasets 55: shapes = 'FILE.uff' in [test]"
)
_NOT_IEEE = {1: "DEC VMS", 3: "IBM 370"}


def read_uff(path: Path, said: Said) -> Contents:
    """What a universal file holds.

    Args:
        path: The file.
        said: What the user says about it.

    Raises:
        InputError: If pyuff is missing, or for what is wrong in the file; names the file, the
            dataset by its place (from 1) and type, and what was expected.
    """
    problems, contents = Problems(path), Contents()
    sets = read_sets(path, (58, *GEOMETRY), problems)
    units = length, force = problems.tried(lambda: units_of(sets, said)) or (1.0, 1.0)
    axes = problems.tried(lambda: axes_of(sets)) or {}
    other: Counter[str] = Counter()
    for where, data in sets:
        if data["type"] in (15, 2411):
            problems.tried(lambda w=where, d=data: add_nodes(contents, w, d, length, axes))
        if data["type"] != 58:
            continue
        if data["func_type"] == _FRF:
            one = problems.tried(
                lambda w=where, d=data: _function(w, d, units, said, contents.notes)
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


def _function(where: str, data, units, said: Said, notes: list[str]) -> FRFRecord:
    x = _abscissa(where, data)
    denominator = data["orddenom_spec_data_type"]
    if denominator != _FORCE and denominator not in _UNSAID:
        also = f" (a transmissibility). {_NO_FORCE}" if denominator in _MOTIONS else ""
        raise InputError(
            f"{where}: reference is of type {word(_DATA, denominator)}, expected 13 (excitation "
            f"force){also}"
        )
    if not np.iscomplexobj(data["data"]):
        raise InputError(
            f"{where}: ordinate data type {word(FORMS, data['ord_data_type'])}, expected 5 or 6 "
            "(complex): a frequency response function has a phase"
        )
    kind, factor = _scale(where, data, units, said, notes)
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
    kind, label = data["abscissa_spec_data_type"], _label(data, "abscissa")
    if kind != _FREQUENCY and kind not in _UNSAID:
        raise InputError(
            f"{where}: abscissa is of type {word(_DATA, kind)}, expected 18 (frequency)"
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


def _scale(where: str, data, units, said: Said, notes: list[str]) -> tuple[str, float]:
    """Kind of a function and its factor to SI.

    The user's units go first, then the axes' labels, then dataset 164: many programs write a
    dataset 164 of SI units whatever the units of their data.
    """
    kind, factor = _file_kind(where, data, said), None
    if said.units is not None:
        kind_said, factor = frf_unit(said.units)
        if kind not in (None, kind_said):
            raise InputError(
                f"{where}: response is of type {word(_DATA, data['ordinate_spec_data_type'])}, "
                f"expected that of units = {said.units!r}, {a_kind(kind_said)}"
            )
        return kind_said, factor
    label_kind, by_label = _by_labels(where, data, units[1])
    kind = kind or label_kind
    if kind is None:
        raise InputError(
            f"{where}: response is of type {word(_DATA, data['ordinate_spec_data_type'])}, "
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
    if by_label is not None and length == force == 1 and by_label != 1:
        text = f"{_label(data, 'ordinate')!r} by {_label(data, 'orddenom') or 'force'!r}"
        notes.append(
            f"functions are read in {text}, as their labels say, though dataset 164 says SI units; "
            "the key units overrides both"
        )
    elif None not in (by_label, by_set) and not np.isclose(by_label, by_set, rtol=1e-3):
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
            f"{where}: response is of type {word(_DATA, code)}, expected 8, 11 or 12 "
            "(displacement, velocity, acceleration): numerator and denominator may be exchanged"
        )
    if code not in _MOTIONS and code not in _UNSAID:
        raise InputError(
            f"{where}: response is of type {word(_DATA, code)}, expected 8, 11 or 12 "
            "(displacement, velocity, acceleration)"
        )
    kind = _MOTIONS.get(code)
    if kind is not None and said.kind not in (None, kind):
        raise InputError(
            f"{where}: response is of type {word(_DATA, code)}, {a_kind(kind)}; expected that of "
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
    text = str(data.get(f"{axis}_axis_units_lab", "")).strip()
    return "" if text.upper() == "NONE" else text
