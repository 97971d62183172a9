"""Measured functions, or time records, from MATLAB's files and from HDF5."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import scipy.io

from fenics_joints.errors import InputError, located
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
from fenics_joints.measurements.time_records import TimeFRFs, frfs_from_time, sampling_rate
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
    "time": "s, n numbers in equal steps",
    "force": "n x n_references, in place of frequency and frf",
    "response": "n x n_responses",
}
#: Numbers of one variable, far more than any test has: a packed file says so before it unpacks.
_MOST = 200_000_000
#: Suffixes of HDF5 files.
HDF5 = (".h5", ".hdf5")
#: Kinds of variables that contain other variables, of any size.
_HOLDERS = ("cell", "struct", "object", "function", "opaque", "sparse")


def read_mat(path: Path, metadata: FileMetadata) -> Contents:
    """What a MATLAB file holds, under the names in `KEYS` or those in ``metadata.keys``.

    Raises:
        InputError: Names the file, the variable and what was expected.
    """
    file = _Variables(path, metadata)
    where = f"{path}: {file.name('units')}"
    kind, factor = metadata.scale(where, file.text("units"), file.text("kind"))
    length = length_factor(metadata.length_unit or file.text("length_unit") or "m")
    contents = Contents()
    if file.has("force") and not file.has("frf"):
        made = _from_time(file, metadata)
        f, frf = made.frequencies_hz, made.values
        coherence = np.repeat(made.coherence[:, :, None], frf.shape[2], axis=2)
        contents.notes += [f"{path}: {note}" for note in made.notes]
    else:
        f = file.numbers("frequency").ravel()
        frf = file.cube("frf", len(f))
        coherence = file.cube("coherence", len(f), frf.shape) if file.has("coherence") else None
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


def _from_time(file: _Variables, metadata: FileMetadata) -> TimeFRFs:
    """Functions of time records."""
    t = file.numbers("time").ravel().astype(float)
    with located(file.path):
        rate = sampling_rate(t)
        return frfs_from_time(rate, file.numbers("force"), file.numbers("response"), metadata.time)


class _Variables:
    """Variables of a file by the suite's names."""

    def __init__(self, path: Path, metadata: FileMetadata):
        unknown = [key for key in metadata.keys if key not in KEYS]
        if unknown:
            raise InputError(f"keys.{unknown[0]}: expected one of {', '.join(KEYS)}")
        self.path, self.keys = path, metadata.keys
        check_size(path)
        reading(path.name, path.stat().st_size)
        is_hdf = path.suffix.lower() in HDF5 or _is_hdf(path)
        listed = _hdf_list(path) if is_hdf else _scipy(path, scipy.io.whosmat)
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
        if is_hdf:
            self.found = _hdf_load(path, used)
        else:
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
    except Exception as error:  # scipy raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as a MATLAB file ({error})") from error


def _is_hdf(path: Path) -> bool:
    """Whether a file is HDF5, as MATLAB's version 7.3 is, behind a header of 512 bytes."""
    with path.open("rb") as file:
        head = file.read(520)
    return any(head[at : at + 8] == b"\x89HDF\r\n\x1a\n" for at in (0, 512))


@contextmanager
def hdf(path: Path):
    """An HDF5 file; raises InputError for what it cannot read."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as HDF5 ({error})") from error


def _hdf_list(path: Path) -> list[tuple[str, tuple, str]]:
    """Name, shape and kind of each dataset at the top; no links to elsewhere, nothing virtual."""
    import h5py

    found = []
    with hdf(path) as file:
        for name in file:
            item = file[name] if holds(file, name) else None
            if isinstance(item, h5py.Dataset):
                kind = decoded(item.attrs.get("MATLAB_class", b""))
                refers = item.dtype.kind == "O" and h5py.check_string_dtype(item.dtype) is None
                found.append((name, item.shape, "struct" if refers else kind or "numbers"))
            elif not name.startswith("#"):
                found.append((name, (), "struct"))
    return found


def holds(group, *names: str) -> bool:
    """Whether a group holds all of these itself: no links to elsewhere, nothing virtual."""
    import h5py

    for name in names:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return False
        item = group[name]
        if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
            return False
    return True


def decoded(value) -> str:
    """Text of an attribute or an entry of HDF5."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _hdf_load(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Datasets as loadmat gives them: MATLAB stores its arrays turned, text as numbers, and complex
    ones in pairs."""
    found = {}
    with hdf(path) as file:
        for name in names:
            item = file[name]
            value, kind = item[()], decoded(item.attrs.get("MATLAB_class", b""))
            if kind == "char":
                value = np.array(["".join(map(chr, np.ravel(value, order="F")))])
            elif item.dtype.kind in "OS":
                value = np.array([decoded(each) for each in np.ravel(value)])
            elif item.dtype.names and set(item.dtype.names) == {"real", "imag"}:
                value = value["real"] + 1j * value["imag"]
            found[name] = np.asarray(value).T if kind and kind != "char" else np.asarray(value)
    return found


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
