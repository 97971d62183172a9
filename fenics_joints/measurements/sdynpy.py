"""Functions and geometry of sdynpy's ``.npz`` files (Sandia's structural dynamics library).

A file of functions has a structured array ``data`` with abscissa, ordinate and the coordinates
(node and direction) of response and reference, and the kind of function as in universal files. A
file of a geometry has ``node`` and ``coordinate_system``.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.files import check_size, check_unpacked
from fenics_joints.measurements.files import (
    CoherenceRecord,
    Contents,
    Dof,
    FileMetadata,
    FRFRecord,
    Node,
)
from fenics_joints.response.units import length_factor

#: Kinds of functions: frequency response, coherence and multiple coherence.
_FRF, _COHERENCE = 4, (6, 26)
_KEYS = "data function_type abscissa_start abscissa_step node coordinate_system".split()
#: Bytes that a file may unpack to.
_MOST = 8_000_000_000


def read_sdynpy(path: Path, metadata: FileMetadata) -> Contents:
    """Functions, coherence or nodes of a file.

    Raises:
        InputError: If it is no such file, or holds functions of another kind.
    """
    check_size(path)
    try:
        check_unpacked(path, _MOST)
        with np.load(path, allow_pickle=False) as file:
            # Others, such as a geometry's elements, are pickles.
            arrays = {key: file[key] for key in _KEYS if key in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as an .npz of numbers ({error})") from error
    try:
        if "node" in arrays:
            return _geometry(path, arrays, metadata)
        return _functions(path, arrays, metadata)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}: expected FRFs or a geometry of sdynpy") from error


def _functions(path: Path, arrays: dict[str, np.ndarray], metadata: FileMetadata) -> Contents:
    data, kind = np.atleast_1d(arrays["data"]).ravel(), int(arrays["function_type"])
    if kind != _FRF and kind not in _COHERENCE:
        raise InputError(
            f"{path}: holds functions of type {kind} of universal files; expected frequency "
            "response functions (4) or coherence"
        )
    contents = Contents()
    for i, row in enumerate(data):
        where, f = f"{path}: data[{i}]", _abscissa(row, arrays)
        keep, ends = f > 0, np.atleast_1d(row["coordinate"])
        dofs = [_dof(end) for end in ends]
        y = np.asarray(row["ordinate"])[keep]
        if kind == _FRF:
            own, factor = metadata.scale(where, None)
            contents.functions.append(FRFRecord(dofs[0], dofs[1], f[keep], factor * y, own, where))
        else:
            reference = dofs[1] if kind == _COHERENCE[0] and len(dofs) > 1 else None
            record = dofs[0], reference, f[keep], np.real(y), where
            contents.coherences.append(CoherenceRecord(*record))
    contents.notes.append(f"{path}: {len(data)} FRFs")
    return contents


def _abscissa(row, arrays: dict[str, np.ndarray]) -> np.ndarray:
    if "abscissa" in row.dtype.names:
        return np.asarray(row["abscissa"], dtype=float)
    steps = np.arange(np.size(row["ordinate"]))
    return float(arrays["abscissa_start"]) + float(arrays["abscissa_step"]) * steps


def _dof(end) -> Dof:
    """Node and direction: 1 to 3 are x, y and z, negative ones against them."""
    number, direction = int(end["direction"]), [0.0, 0.0, 0.0]
    if abs(number) not in (1, 2, 3):
        return Dof(str(int(end["node"])), None)
    direction[abs(number) - 1] = float(np.sign(number))
    return Dof(str(int(end["node"])), tuple(direction))


def _geometry(path: Path, arrays: dict[str, np.ndarray], metadata: FileMetadata) -> Contents:
    systems = np.atleast_1d(arrays["coordinate_system"])
    plain = [
        int(system["cs_type"]) == 0 and np.allclose(system["matrix"], np.eye(4, 3))
        for system in systems
    ]
    if not all(plain):
        raise InputError(f"{path}: has local axes: expected nodes in the global ones")
    if metadata.length_unit is None:
        raise InputError(f"{path}: does not say its unit of length: expected length_unit")
    factor, contents = length_factor(metadata.length_unit), Contents()
    for node in np.atleast_1d(arrays["node"]):
        place = factor * np.asarray(node["coordinate"], dtype=float)
        contents.add_node(str(int(node["id"])), Node(place, np.eye(3), str(path)))
    return contents
