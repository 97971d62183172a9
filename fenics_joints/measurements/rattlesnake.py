"""Time records of the Rattlesnake controller (Sandia), netCDF4 files, as functions.

``time_data`` has a row for each channel; the group ``channels`` has for each its node, direction,
unit and kind as text. Forces are channels in units of force.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.files import check_size
from fenics_joints.measurements.files import CoherenceRecord, Contents, Dof, FileMetadata, FRFRecord
from fenics_joints.measurements.mat import decoded, hdf, holds
from fenics_joints.measurements.time_records import MOST, frfs_from_time
from fenics_joints.units import to_si

_EXPECTED = "expected a file of Rattlesnake with time_data, sample_rate and channels"


def read_rattlesnake(path: Path, metadata: FileMetadata) -> Contents:
    """Functions of the time records of a file.

    Raises:
        InputError: If it is no such file, or has no force.
    """
    check_size(path)
    with hdf(path) as file:
        if not holds(file, "time_data", "channels") or "sample_rate" not in file.attrs:
            raise InputError(f"{path}: {_EXPECTED}")
        keys = [k for k in ("node_number", "node_direction", "unit") if holds(file["channels"], k)]
        item, rate = file["time_data"], float(np.ravel(file.attrs["sample_rate"])[0])
        if item.ndim != 2 or item.size > MOST:
            raise InputError(f"{path}: time_data has shape {item.shape}; {_EXPECTED}")
        records = np.asarray(item[()], dtype=float)
        table = {
            key: [decoded(value).strip() for value in np.ravel(file["channels"][key][()])]
            for key in keys
        }
    if set(map(len, table.values())) != {len(records)} or len(table) < 3:
        raise InputError(f"{path}: has {len(records)} channels of data; {_EXPECTED} for each")
    forces = [i for i, unit in enumerate(table["unit"]) if _is_force(unit)]
    moved = [i for i in range(len(records)) if i not in forces]
    if not forces or not moved:
        raise InputError(f"{path}: expected channels in a unit of force, such as N, and others")
    contents = Contents()
    with located(path):
        made = frfs_from_time(rate, records[forces].T, records[moved].T, metadata.time)
    contents.notes += [f"{path}: {note}" for note in made.notes]
    for i, channel in enumerate(moved):
        for j, force in enumerate(forces):
            where = f"{path}: channels {channel + 1} and {force + 1}"
            units = f"{table['unit'][channel]}/{table['unit'][force]}"
            kind, factor = metadata.scale(where, units)
            dofs = [_dof(table, k) for k in (channel, force)]
            own = (*dofs, made.frequencies_hz)
            contents.functions.append(FRFRecord(*own, factor * made.values[:, i, j], kind, where))
            contents.coherences.append(CoherenceRecord(*own, made.coherence[:, i], where))
    return contents


def _is_force(unit: str) -> bool:
    try:
        return to_si(f"1 {unit}", "N") > 0
    except InputError:
        return False


def _dof(table: dict[str, list[str]], channel: int) -> Dof:
    """Node and direction such as ``X+`` of a channel."""
    word, direction = table["node_direction"][channel].upper(), [0.0, 0.0, 0.0]
    axis = word.strip("+-")
    if axis not in ("X", "Y", "Z"):
        return Dof(table["node_number"][channel], None)
    direction["XYZ".index(axis)] = -1.0 if "-" in word else 1.0
    return Dof(table["node_number"][channel], tuple(direction))
