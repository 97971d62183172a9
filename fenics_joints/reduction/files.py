"""Reduced models and other results as HDF5 files, which need no mesh to be read; and the `Cache`.

A file holds plain arrays and text in groups that follow the objects' attributes, and a digest of
them; nothing in it is run. A user's own law is found by its class, whose module must have been
imported before reading; so must `fenics_joints.beams` for a model of beams. Higher rooms name the
further classes that a file may hold by `register`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import fields
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.files import check_writable, is_file, path_of, sealed, shown_path, unsealed
from fenics_joints.joint_laws import Backbone, JointLaw, LawKernel
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.reduction.affine import (
    CONSTANT,
    POINT_MASS,
    SPRING,
    AffinePencil,
    RegionTerm,
    TravellingMass,
    of_few,
)
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure.changes import CHANGES
from fenics_joints.structure.components import Parameter
from fenics_joints.structure.laws import LINEAR_LAWS, Law
from fenics_joints.structure.points import PlaceRows

#: Name of the format of linear models.
ARRAYS = "fenics_joints reduced model"
#: The same of results that a `Cache` keeps, and the version of both.
_KEPT, _VERSION = "fenics_joints kept result", 4
_LAWS = {law.name: law for law in (*CHANGES, SPRING, POINT_MASS, CONSTANT)}
_CLASSES = {
    c.__name__: c
    for c in (AffinePencil, ArrayModel, TravellingMass, Parameter, PlaceRows, RegionTerm)
}
#: Fields that are not written: a mesh does not belong in the file.
_LEFT_OUT = {"source"}


def register(*kinds: type | Law) -> None:
    """Name further dataclasses and linear laws that a file may hold."""
    for kind in kinds:
        if isinstance(kind, Law):
            _LAWS[kind.name] = kind
        else:
            _CLASSES[kind.__name__] = kind


def write_array_model(model: ArrayModel, path: str | Path) -> None:
    """Write a linear reduced model to an HDF5 file, whole or not at all; on one rank.

    Raises:
        InputError: If it cannot be written.
    """
    write_model(model, path, ARRAYS)


def read_array_model(path: str | Path) -> ArrayModel:
    """Read what `write_array_model` wrote. Any rank may do so by itself.

    Raises:
        InputError: As `read_model`.
    """
    return read_model(path, ARRAYS, ArrayModel)


def write_model(model, path: str | Path, what: str, made: str = "") -> None:
    """Write a dataclass of arrays, laws and plain values, whole or not at all; on one rank.

    Args:
        model: Of a class that is known here.
        path: The file; one that exists is replaced.
        what: Name of the format.
        made: Digest of everything that determines the model, which `read_model` may ask for.

    Raises:
        InputError: If it cannot be written, or a law has an attribute that no file can hold.
    """
    import h5py

    path = check_writable(path, "model file").resolve()
    with sealed(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"], file.attrs["version"], file.attrs["made"] = what, _VERSION, made
        _encode(file, "model", model)


def read_model(path: str | Path, what: str, kind: type, made: str | None = None):
    """Read what `write_model` wrote. Any rank may do so by itself.

    Args:
        path: The file.
        what: Name of the format.
        kind: Class of the model.
        made: Digest of everything that determines the model now, for a file kept from an earlier
            run, which has to belong to the user. None for a file that the user names.

    Raises:
        InputError: If the file is missing, of another kind, damaged, of another version of the
            format, made from another structure or case, or has an unknown law.
    """
    import h5py

    path = path_of(path)
    if not is_file(path):
        name = shown_path(path)
        raise InputError(f"{name}: there is no such file; expected a reduced model in HDF5.")
    try:
        with unsealed(path, own=made is not None) as content, h5py.File(content, "r") as file:
            if file.attrs.get("format") != what:
                raise InputError(f"{path}: is no {what.removeprefix('fenics_joints ')}.")
            version = int(file.attrs["version"])
            if version != _VERSION:
                raise InputError(
                    f"{path}: has version {version} of the format; expected {_VERSION}. Another "
                    "version of fenics_joints reads it."
                )
            if made is not None and file.attrs["made"] != made:
                raise InputError(f"{path}: was made from another structure or case")
            model = _decode(file, "model", set())
    except InputError as error:
        raise error if str(path) in str(error) else InputError(f"{path}: {error}") from error
    except (
        OSError,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
        RuntimeError,
        MemoryError,
        ArithmeticError,
    ) as error:
        raise InputError(f"{path}: holds no such model ({error})") from error
    if not isinstance(model, kind):
        raise InputError(f"{path}: holds {type(model).__name__}; expected {kind.__name__}.")
    return model


class Cache:
    """Results of a run in a folder, for the runs after it.

    A file is written whole or not at all, ends with a digest of its content, and holds the key. One
    that is damaged, that others can write to, or that has another version or key is not read. Of
    two processes that write the same file the later one wins.

        cache = Cache(folder, key, comm)
        model = cache.read("model", ArrayModel)
        if model is None:
            model = make()
            cache.write("model", model)

    Args:
        folder: The folder; it exists.
        key: Digest of everything that determines the results.
        comm: Rank 0 writes; all ranks read, or none does.
        side_by_side: Whether the key is part of the files' names, so that results of several keys
            stay in the folder; otherwise a result replaces that of another key.
    """

    def __init__(
        self,
        folder: str | Path,
        key: str,
        comm: MPI.Intracomm = MPI.COMM_SELF,
        *,
        side_by_side: bool = False,
    ):
        self.folder, self.key, self.comm = Path(folder), key, comm
        self._ending = f"-{key}.h5" if side_by_side else ".h5"

    def path(self, name: str) -> Path:
        """The file of a result."""
        return self.folder / f"{name}{self._ending}"

    def on(self, comm: MPI.Intracomm) -> Cache:
        """The same files for other ranks."""
        found = copy(self)
        found.comm = comm
        return found

    def read(self, name: str, kind: type, progress: Progress | None = None):
        """A result of a class, or None if it cannot be read. Collective.

        Args:
            name: Name of the result.
            kind: Its class, which files may hold (see `register`).
            progress: Told why a file that exists cannot be read.
        """
        path, found, reason = self.path(name), None, ""
        if self.comm.bcast(path.is_file()):
            try:
                found = read_model(path, _KEPT, kind, self.key)
            except InputError as error:
                reason = str(error)
        if self.comm.allreduce(found is not None, op=MPI.LAND):
            return found
        reason = next(filter(None, self.comm.allgather(reason)), "")
        if reason and progress is not None:
            progress.step(f"{reason}; making it anew")
        return None

    def write(self, name: str, value: object) -> None:
        """Keep a result, that of rank 0. Collective.

        Raises:
            InputError: As `write_model`.
        """
        on_root(self.comm, lambda: write_model(value, self.path(name), _KEPT, self.key))


# -- a tree of groups ------------------------------------------------------------------------------


def _encode(parent, name: str, value) -> None:
    """Write one value: an array as a dataset, a plain one as an attribute, the rest as a group."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        whole = not _is_symmetric(value)
        item = parent.create_dataset(name, data=value if whole else _upper(value))
        if not whole:
            item.attrs["symmetric"] = value.shape[-1]
    elif value is None or isinstance(value, bool | int | float | str):
        parent.attrs[name] = json.dumps(value)
    elif isinstance(value, Law):
        parent.attrs[name] = json.dumps({"linear law": value.name})
    elif isinstance(value, Mapping):
        _encode_group(parent, name, "mapping", list(value), value.values())
    elif isinstance(value, list | tuple):
        _encode_group(parent, name, "sequence", len(value), value)
    else:
        kind, content = _content(value)
        _encode_group(parent, name, kind, list(content), content.values())


def _is_symmetric(value: np.ndarray) -> bool:
    """Whether an array is of symmetric matrices, to the last bit."""
    if value.ndim < 2 or value.shape[-1] != value.shape[-2] or value.shape[-1] < 2:
        return False
    return np.array_equal(value, value.swapaxes(-1, -2))


def _upper(value: np.ndarray) -> np.ndarray:
    """The upper halves of symmetric matrices, (..., n (n + 1) / 2)."""
    return value[(..., *np.triu_indices(value.shape[-1]))]


def _whole(upper: np.ndarray, n: int) -> np.ndarray:
    """Symmetric matrices from their upper halves."""
    if upper.ndim < 1 or n < 1 or upper.shape[-1] != n * (n + 1) // 2:
        raise ValueError(f"{upper.shape}: no upper halves of {n} by {n} matrices")
    rows, columns = np.triu_indices(n)
    found = np.empty((*upper.shape[:-1], n, n), upper.dtype)
    found[..., rows, columns] = found[..., columns, rows] = upper
    return found


def _encode_group(parent, name: str, kind: str, keys, values) -> None:
    group = parent.create_group(name)
    group.attrs["kind"], group.attrs["keys"] = kind, json.dumps(keys)
    for i, value in enumerate(values):
        _encode(group, str(i), value)


def _content(value) -> tuple[str, dict]:
    """Class and attributes of an object."""
    cls = type(value)
    if isinstance(value, JointLaw):
        kept = {k: v for k, v in vars(value).items() if not isinstance(v, LawKernel)}
        return f"law {cls.__module__}.{cls.__qualname__}", kept
    if isinstance(value, Backbone):
        return f"backbone {cls.__module__}.{cls.__qualname__}", _fields(value)
    if _CLASSES.get(cls.__name__) is cls:
        return cls.__name__, _fields(value)
    raise InputError(
        f"{value!r}: {cls.__name__} cannot be written to a file; expected numbers, text, arrays, "
        "laws and backbones."
    )


def _fields(value) -> dict:
    return {f.name: getattr(value, f.name) for f in fields(value) if f.name not in _LEFT_OUT}


def _decode(parent, name: str, read: set):
    """Read one value.

    Args:
        parent: Group of the file.
        name: The value's name there.
        read: Addresses in the file that were read so far.
    """
    if name in parent.attrs:
        value = json.loads(parent.attrs[name])
        return _linear_law(value["linear law"]) if isinstance(value, dict) else value
    item = _own(parent, name, read)
    if "kind" not in item.attrs:
        n = item.attrs.get("symmetric")
        return item[()] if n is None else _whole(item[()], int(n))
    kind, keys = item.attrs["kind"], json.loads(item.attrs["keys"])
    if kind == "sequence":
        return tuple(_decode(item, str(i), read) for i in range(keys))
    content = {key: _decode(item, str(i), read) for i, key in enumerate(keys)}
    return content if kind == "mapping" else _object(kind, content)


def _own(parent, name: str, read: set):
    """A group or dataset that stands in its parent alone and is as large as it says.

    `write_model` links nothing and packs nothing: a small file cannot become a large model.
    """
    import h5py

    if not isinstance(parent.get(name, getlink=True), h5py.HardLink | None):
        raise ValueError(f"{parent.name}/{name} is a link to another place")
    item = parent[name]
    place = h5py.h5o.get_info(item.id).addr
    if place in read:
        raise ValueError(f"{item.name} is in the file twice")
    read.add(place)
    if isinstance(item, h5py.Dataset):
        if item.dtype.kind not in "biufc" or item.external or item.is_virtual:
            raise ValueError(f"{item.name} is no array of numbers in this file")
        if item.nbytes > item.id.get_storage_size():
            stored = item.id.get_storage_size()
            raise ValueError(f"{item.name} has {stored} of its {item.nbytes} bytes")
    return item


def _linear_law(name: str) -> Law:
    whole, _, rows = name.rpartition(" [")
    if whole:  # with some of its scalars alone
        law = _linear_law(whole)
        rows = [int(row) for row in rows.rstrip("]").split(", ") if row]
        if not all(0 <= row < len(law.samples) for row in rows):
            raise InputError(f"{name}: expected indices of {len(law.samples)} scalars.")
        return of_few(law, rows)
    laws = LINEAR_LAWS | _LAWS
    if name not in laws:
        raise InputError(f"{name} is not known here; expected its module to be imported before.")
    return laws[name]


def _object(kind: str, content: dict):
    if kind in _CLASSES:
        return _CLASSES[kind](**content)
    what, _, name = kind.partition(" ")
    cls = _find({"law": JointLaw, "backbone": Backbone}[what], name)
    if what == "backbone":
        return cls(**content)
    if any(callable(getattr(cls, key, None)) for key in content):
        raise ValueError(f"{name} has a number in place of a method")
    law = object.__new__(cls)
    vars(law).update(content)
    JointLaw.__init__(law, **content["parameters"])
    return law


def _find(base: type, name: str) -> type:
    """A class of this name among those that have been imported."""
    # The suite's own.
    import fenics_joints.joint_laws.library  # noqa: F401

    for cls in _subclasses(base):
        if f"{cls.__module__}.{cls.__qualname__}" == name:
            return cls
    raise InputError(f"{name} is not known here; expected its module to be imported before.")


def _subclasses(base: type) -> Iterator[type]:
    for cls in base.__subclasses__():
        yield cls
        yield from _subclasses(cls)
