"""Datasets of universal files (UFF), read by pyuff: units, nodes and their axes.

The meaning of the fields: "Universal file formats", Structural Dynamics Research Laboratory,
University of Cincinnati.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenics_joints.errors import InputError, Problems
from fenics_joints.measurements.records import Contents, Node, Said
from fenics_joints.response.units import length_factor

__all__ = ["GEOMETRY", "Dataset", "add_nodes", "axes_of", "read_sets", "units_of", "word"]

#: Place in a file, and content, of a dataset.
Dataset = tuple[str, dict[str, Any]]
#: Datasets of nodes, axes and units.
GEOMETRY = (15, 18, 164, 2411, 2420)
#: Ordinate data types of dataset 58.
FORMS = {2: "real single", 4: "real double", 5: "complex single", 6: "complex double"}


def read_sets(
    path: Path, kinds: Collection[int], problems: Problems | None = None
) -> list[Dataset]:
    """(place, content) of each dataset of these types.

    Of a dataset 55 the content is its ``lines``: pyuff does not read all that labs write.

    Args:
        path: The file.
        kinds: The types.
        problems: Takes the errors of single datasets, so that the caller finds those of the others
            too; without it they are raised.

    Raises:
        InputError: If pyuff is missing, or a dataset cannot be read; names the file, the dataset
            by its place (from 1) and type, and what was expected.
    """
    pyuff = _pyuff()
    tail = path.read_bytes().rstrip()
    if not tail:
        raise InputError(f"{path}: is empty, expected a universal file")
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
    sets, shapes = [], iter(_blocks(path, 55) if 55 in kinds else [])
    found = Problems(path) if problems is None else problems
    for i, kind in enumerate(types):
        where = f"{path}: dataset {i + 1} (type {kind or 'unknown'})"
        if not kind:
            expected = "expected its number after the line '    -1'"
            found.add(InputError(f"{where}: has no type; {expected}"))
        elif kind == 55 and kind in kinds:
            sets.append((where, {"type": 55, "lines": next(shapes, [])}))
        elif kind in kinds:
            read = found.tried(lambda i=i, kind=kind, at=where: _read_set(file, i, kind, at))
            if read is not None:
                sets.append((where, read))
    if problems is None:
        found.check()
    return sets


def _blocks(path: Path, kind: int) -> list[list[str]]:
    """Lines of each dataset of one type, those with its number and the marks left out."""
    found, block = [], None
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.rstrip() != "    -1":
            if block is not None:
                block.append(line)
        elif block is None:
            block = []
        else:
            if block and block[0].strip() == str(kind):
                found.append(block[1:])
            block = None
    return found


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
        f"{word(FORMS, head['ord_data_type'])}, spacing {head['abscissa_spacing']} (0 uneven, 1 "
        "even) as in its record 7: the data are damaged or truncated, or the record is wrong"
    )


def word(words: Mapping[int, str], code: int) -> str:
    """A code and what it means."""
    return f"{code} ({words[code]})" if code in words else str(code)


# -- units and nodes -------------------------------------------------------------------------------


def units_of(sets: Sequence[Dataset], said: Said) -> tuple[float | None, float | None]:
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


def axes_of(sets: Sequence[Dataset]) -> dict[int, np.ndarray | None]:
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
            if not np.isfinite([label, kind]).all():
                raise InputError(f"{where}: expected a label and a kind of each coordinate system")
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


def add_nodes(contents: Contents, where: str, data, length: float | None, axes) -> None:
    """Add the nodes of a dataset 15 or 2411, with the metres of a unit of length and `axes_of`."""
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


