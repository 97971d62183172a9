"""Histories of free decays from universal files (UFF): datasets 58 of time responses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.measurements.amplitude.columns import level_unit
from fenics_joints.measurements.amplitude.tables import History
from fenics_joints.measurements.records import Said
from fenics_joints.measurements.uff_sets import read_sets, units_of, word

#: Function type of a response over time, and kinds of response by the ordinate's data type.
_TIME = 1
_RESPONSES = {8: "displacement", 11: "velocity", 12: "acceleration"}
_AXES = {1: "+x", -1: "-x", 2: "+y", -2: "-y", 3: "+z", -3: "-z"}


def histories_of(path: Path, units: str | None = None) -> list[History]:
    """Records over time, each with all sensors: a sensor's second dataset is the second record.

    Args:
        path: The file.
        units: Unit of the responses; it goes before what the file says.

    Raises:
        InputError: Names the file, the dataset and what was expected.
    """
    sets = read_sets(path, (58, 164))
    length, _ = units_of(sets, Said())
    records: list[dict] = []
    for where, data in sets:
        if data["type"] != 58 or data["func_type"] != _TIME:
            continue
        code = data["ordinate_spec_data_type"]
        if code not in _RESPONSES:
            continue
        name = f"{int(data['rsp_node'])}:{_AXES.get(int(data['rsp_dir']), '')}".rstrip(":")
        values = np.asarray(data["data"], dtype=float)
        signal = values * _factor(where, data, _RESPONSES[code], length, units)
        turn = next((r for r in records if name not in r["signals"]), None)
        if turn is None:
            turn = {
                "where": where,
                "t": np.asarray(data["x"]),
                "kind": _RESPONSES[code],
                "signals": {},
            }
            records.append(turn)
        if len(turn["t"]) != len(values) or turn["kind"] != _RESPONSES[code]:
            raise InputError(
                f"{where}: {len(values)} samples of {_RESPONSES[code]}; expected "
                f"{len(turn['t'])} of {turn['kind']} as in {turn['where']}"
            )
        turn["signals"][name] = signal
    if not records:
        kinds = sorted({word({}, d["func_type"]) for _, d in sets if d["type"] == 58})
        raise InputError(
            f"{path}: holds no response over time (its datasets 58 are of type "
            f"{', '.join(kinds) or 'none'}); expected type 1 with displacement, velocity or "
            "acceleration; or, for functions (type 4), the level of each in levels"
        )
    return [History(r["t"], r["kind"], r["signals"], r["where"]) for r in records]


def _factor(where: str, data, kind: str, length: float | None, units: str | None) -> float:
    label = str(data.get("ordinate_axis_units_lab", "")).strip()
    text = units or ("" if label.upper() == "NONE" else label)
    if text:
        with located(f"{where}: unit of the response"):
            found, factor = level_unit(text)
            if found != kind:
                raise InputError(f"{text!r} is one of {found}, expected one of {kind}")
        return factor
    if length is None:
        raise InputError(
            f"{where}: the unit of the response is not known; expected a dataset 164, a label of "
            "the axis, or units"
        )
    return length
