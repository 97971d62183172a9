"""Measured functions from MATLAB's files, to version 7."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.io

from fenics_joints.errors import InputError
from fenics_joints.files import check_size
from fenics_joints.measurements.files import (
    CoherenceRecord,
    Contents,
    FileMetadata,
    FRFRecord,
    Node,
    as_dof,
    node_label,
)
from fenics_joints.progress import reading
from fenics_joints.response.units import length_factor

#: Variables of a file. Points and directions have a row of three for each response or reference; a
#: single direction stands for all. Nodes are labels, by the points if not there. Coherence, nodes,
#: kind, units and length_unit (m) need not be there.
KEYS = {
    "frequency": "Hz, n numbers",
    "frf": "complex, n x n_responses x n_references",
    "coherence": "as frf",
    "response_points": "n_responses x 3",
    "response_directions": "n_responses x 3",
    "response_nodes": "n_responses numbers",
    "reference_points": "n_references x 3",
    "reference_directions": "n_references x 3",
    "reference_nodes": "n_references numbers",
    "kind": "text",
    "units": "text, such as 'm/s2/N'",
    "length_unit": "text, such as 'mm'",
}
#: Numbers of one variable, far more than any test has: a packed file says so before it unpacks.
_MOST = 200_000_000
#: Kinds of variables that contain other variables, of any size.
_HOLDERS = ("cell", "struct", "object", "function", "opaque", "sparse")


def read_mat(path: Path, metadata: FileMetadata) -> Contents:
    """What a MATLAB file holds, under the names in `KEYS` or those in ``metadata.keys``.

    Raises:
        InputError: Names the file, the variable and what was expected.
    """
    file = _Variables(path, metadata)
    f = file.numbers("frequency").ravel()
    where = f"{path}: {file.name('units')}"
    kind, factor = metadata.scale(where, file.text("units"), file.text("kind"))
    length = length_factor(metadata.length_unit or file.text("length_unit") or "m")
    frf = file.cube("frf", len(f))
    coherence = file.cube("coherence", len(f), frf.shape) if file.has("coherence") else None
    contents = Contents()
    dofs = [
        _dofs(file, contents, side, n, length)
        for side, n in (("response", frf.shape[1]), ("reference", frf.shape[2]))
    ]
    for i, response in enumerate(dofs[0]):
        for j, reference in enumerate(dofs[1]):
            where = f"{path}: {file.name('frf')}(:, {i + 1}, {j + 1})"
            values = factor * frf[:, i, j]
            if not np.isnan(values).all():  # a whole function may be missing
                contents.functions.append(FRFRecord(response, reference, f, values, kind, where))
            if coherence is not None and not np.isnan(coherence[:, i, j]).all():
                where = f"{path}: {file.name('coherence')}(:, {i + 1}, {j + 1})"
                gamma = np.real(coherence[:, i, j])
                contents.coherences.append(CoherenceRecord(response, reference, f, gamma, where))
    return contents


class _Variables:
    """Variables of a file by the suite's names."""

    def __init__(self, path: Path, metadata: FileMetadata):
        unknown = [key for key in metadata.keys if key not in KEYS]
        if unknown:
            raise InputError(f"keys.{unknown[0]}: expected one of {', '.join(KEYS)}")
        self.path, self.keys = path, metadata.keys
        check_size(path)
        reading(path.name, path.stat().st_size)
        listed = _scipy(path, scipy.io.whosmat)
        shapes = {name: shape for name, shape, _ in listed}
        kinds = {name: kind for name, _, kind in listed}
        self.there = list(shapes)
        used = [name for name in map(self.name, KEYS) if name in shapes]
        for name in used:
            if kinds[name] in _HOLDERS:
                raise InputError(f"{path}: {name} is a {kinds[name]}: expected numbers or text")
            if math.prod(shapes[name]) > _MOST:
                raise InputError(
                    f"{path}: {name} is {' x '.join(map(str, shapes[name]))}: expected at most "
                    f"{_MOST:,} numbers"
                )
        self.found = _scipy(path, scipy.io.loadmat, variable_names=used)

    def name(self, key: str) -> str:
        return self.keys.get(key, key)

    def has(self, key: str) -> bool:
        return self.name(key) in self.found

    def _value(self, key: str):
        if not self.has(key):
            there = ", ".join(self.there)
            raise InputError(
                f"{self.path}: has no variable {self.name(key)!r}; expected it ({KEYS[key]}), or "
                f"its name in keys.{key}; there are {there or 'none'}"
            )
        return self.found[self.name(key)]

    def numbers(self, key: str) -> np.ndarray:
        value = np.asarray(self._value(key))
        if value.dtype.kind not in "iufc" or not value.size:
            raise InputError(f"{self.path}: {self.name(key)}: expected {KEYS[key]}")
        if key not in ("frf", "coherence") and not np.isfinite(value).all():
            raise InputError(f"{self.path}: {self.name(key)}: expected finite numbers")
        return value

    def text(self, key: str) -> str | None:
        if not self.has(key):
            return None
        value = np.ravel(self._value(key))
        if value.size != 1 or value.dtype.kind != "U":
            raise InputError(f"{self.path}: {self.name(key)}: expected {KEYS[key]}")
        return str(value[0]).strip()

    def cube(self, key: str, n: int, shape: tuple | None = None) -> np.ndarray:
        """A function of three indices, of which MATLAB leaves out the last if it has one value."""
        value = self.numbers(key)
        if key == "frf" and value.dtype.kind != "c":
            raise InputError(f"{self.path}: {self.name(key)} is real; expected {KEYS[key]}")
        if value.shape == (1, n):  # one function as a row
            value = value.T
        if value.ndim == 2:
            value = value[:, :, None]
        if value.ndim != 3 or len(value) != n or (shape is not None and value.shape != shape):
            raise InputError(
                f"{self.path}: {self.name(key)} is {' x '.join(map(str, value.shape))}; expected "
                f"{KEYS[key]}, with n = {n}"
                + (f", of {' x '.join(map(str, shape))}" if shape else "")
            )
        return value


def _scipy(path: Path, read: Callable, **options):
    """What a reader of scipy returns; raises InputError for a file that is not MATLAB's."""
    try:
        return read(path, **options)
    except NotImplementedError as error:
        raise InputError(
            f"{path}: is of MATLAB's version 7.3; expected one saved with '-v7'"
        ) from error
    except Exception as error:  # scipy raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as a MATLAB file ({error})") from error


def _dofs(file: _Variables, contents: Contents, side: str, n: int, length: float) -> list:
    rows = {}
    for what in ("points", "directions"):
        key = f"{side}_{what}"
        value = file.numbers(key)
        single = what == "directions" and value.size == 3
        value = np.broadcast_to(value.reshape(1, 3), (n, 3)) if single else value
        if value.shape != (n, 3) or value.dtype.kind == "c":
            raise InputError(
                f"{file.path}: {file.name(key)} is {' x '.join(map(str, value.shape))}; expected "
                f"{n} x 3, as {file.name('frf')} has {n} {side}s"
            )
        rows[what] = value.astype(float)
    labels = None
    if file.has(f"{side}_nodes"):
        labels = np.real(file.numbers(f"{side}_nodes")).ravel()
        if len(labels) != n:
            raise InputError(
                f"{file.path}: {file.name(f'{side}_nodes')} has {len(labels)} numbers; expected {n}"
            )
    dofs = []
    for i in range(n):
        point = length * rows["points"][i]
        # Points that are the same have the same name, in any file.
        label = node_label(labels[i]) if labels is not None else _point_name(point)
        where = f"{file.path}: {file.name(f'{side}_points')}({i + 1}, :)"
        contents.add_node(label, Node(point, np.eye(3), where))
        dofs.append(as_dof(label, rows["directions"][i], f"{file.path}: {side} {i + 1}"))
    return dofs


def _point_name(point: np.ndarray) -> str:
    return "(" + " ".join(f"{c + 0.0:.9g}" for c in point) + ")"
