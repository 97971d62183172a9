"""Solids of a STEP file in gmsh's current model, named; a separate process reads it first.

All lengths here are in millimetres, OpenCASCADE's own unit whatever the file's.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.files import is_file
from fenics_joints.meshes.gmsh_apart import run_apart

#: A solid by its label in the file, its number there from 1, or a point inside.
Place = str | int | Sequence[float]
#: Spelling of letters that are no plain ones with an accent, or are usually spelt otherwise.
_LETTERS = str.maketrans(
    {
        "ä": "ae",
        "ö": "oe",
        "ü": "ue",
        "Ä": "Ae",
        "Ö": "Oe",
        "Ü": "Ue",
        "ß": "ss",
        "æ": "ae",
        "Æ": "Ae",
        "ø": "oe",
        "Ø": "Oe",
        "ł": "l",
        "Ł": "L",
    }
)
#: Begin of a STEP file: comments may come first.
_STEP = re.compile(rb"(\xef\xbb\xbf)?(?:\s|/\*(?:[^*]|\*(?!/))*\*/)*ISO-10303-21\s*;")


@dataclass(frozen=True)
class Solids:
    """The solids of a file, in its order: our name of each, and gmsh's number."""

    names: list[str]
    tags: list[int]


def import_solids(
    path: Path, model, names: Mapping[str, Place], without: Sequence[Place] = ()
) -> Solids:
    """Read a STEP file into gmsh's current model, and name its solids.

    Both times a copy is read: somebody may change the user's file in between.

    Args:
        path: The file.
        model: gmsh's model; its option ``Geometry.OCCTargetUnit`` is ``MM``.
        names: Where the solid of each name is; others are called by their label, or ``solid_1``.
        without: Solids that are left out.

    Raises:
        MeshError: The file is missing, is no STEP file, or has no solid; or a name or a place fits
            no solid, or two; or all are left out.
    """
    if not is_file(path):
        raise MeshError("no such file, expected a STEP file")
    with TemporaryDirectory(prefix="fenics-joints-") as folder:
        copy = Path(folder) / "solids.step"
        try:
            shutil.copyfile(path, copy)
        except OSError as error:
            raise MeshError(f"cannot be read ({error.strerror})") from error
        _check_step(copy)
        try:
            with _silenced():
                found = model.occ.importShapes(str(copy), format="step")
            model.occ.synchronize()
        except Exception as error:
            words = str(error).replace(str(copy), path.name)
            raise MeshError(f"gmsh cannot read it: {words}") from error
    tags = [tag for dim, tag in found if dim == 3]
    labels = [_label(model.getEntityName(3, tag)) for tag in tags]
    if not tags:
        raise MeshError("it has no solid; expected one or more")
    every = {f"without[{i}]": place for i, place in enumerate(without)}
    found = _named(model, tags, labels, {**names, **every})
    kept = [(name, tag) for name, tag in zip(found, tags, strict=True) if name not in every]
    out = [(3, tag) for name, tag in zip(found, tags, strict=True) if name in every]
    if not kept:
        raise MeshError("without leaves out all solids; expected some that stay")
    if out:
        model.occ.remove(out, recursive=True)
        model.occ.synchronize()
    return Solids([name for name, _ in kept], [tag for _, tag in kept])


#: SHA-256 of files that gmsh has read in a separate process.
_readable: set[bytes] = set()


def _check_step(copy: Path) -> None:
    """Refuse what is no STEP file, and what gmsh cannot read or crashes on."""
    with copy.open("rb") as file:
        start = file.read(4096)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 4096))
        whole = b"END-ISO-10303-21" in file.read()
    digest = hashlib.sha256(copy.read_bytes()).digest()
    if not _STEP.match(start):
        raise MeshError("not a STEP file, expected it to begin with ISO-10303-21;")
    if digest in _readable:
        return
    try:
        run_apart(copy.parent, copy.name, size)
    except MeshError as error:
        if whole:
            raise
        expected = "it is truncated, expected END-ISO-10303-21; at its end"
        raise MeshError(f"gmsh cannot read it: {expected}") from error
    _readable.add(digest)


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep the drawing kernel from the terminal, where it writes beside gmsh and Python."""
    if sys.stdout is not None:
        sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # there is no standard output
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _label(path: str) -> list[str]:
    """The names along the path of a solid in the assembly, the solid's own last."""
    parts = [part.strip() for part in path.split("/")]
    return parts[1:] if len(parts) > 1 else parts


def _named(model, tags, labels, names: Mapping[str, Place]) -> list[str]:
    given: dict[int, str] = {}
    own = [label[-1] for label in labels]
    shown = ["/".join(label) if own.count(label[-1]) > 1 else label[-1] for label in labels]
    listing = "; ".join(f"{i}: {label!r}" for i, label in enumerate(shown, start=1))
    for name, place in names.items():
        which = _matching(model, tags, labels, place)
        if len(which) != 1:
            if not isinstance(place, str | int):
                place = f"({', '.join(f'{x:.6g}' for x in np.ravel(place))}) mm"
            raise MeshError(
                f"{_key(name)} = {place!r} fits {len(which)} solids, expected one by its "
                f"label, its number from 1, or a point inside; there are: {listing}"
            )
        if which[0] in given:
            both = f"{_key(given[which[0]])} and {_key(name)}"
            twice = f"{both} are both solid {which[0] + 1}"
            raise MeshError(f"{twice}, expected one name for it; there are: {listing}")
        given[which[0]] = name
    used, found = set(given.values()), []
    for i, label in enumerate(labels):
        name = given.get(i) or _free(_sanitised(label[-1]) or f"solid_{i + 1}", used)
        used.add(name)
        found.append(name)
    return found


def _key(name: str) -> str:
    return name if name.startswith("without[") else f"parts.{name}"


def _matching(model, tags, labels, place: Place) -> list[int]:
    if isinstance(place, str):
        own = [i for i, label in enumerate(labels) if label[-1] == place]
        # Names may have slashes themselves; and a longer path tells instances of a part apart.
        paths = ["/" + "/".join(label) for label in labels]
        own = own or [i for i, path in enumerate(paths) if path.endswith(f"/{place}")]
        return own or [i for i, label in enumerate(labels) if place in label]
    if isinstance(place, int | np.integer):
        return [place - 1] if 1 <= place <= len(tags) else []
    point = np.asarray(place, dtype=float)
    if point.shape != (3,):
        return []
    return [i for i, tag in enumerate(tags) if model.isInside(3, tag, point.tolist())]


def _sanitised(label: str) -> str:
    plain = unicodedata.normalize("NFKD", label.translate(_LETTERS))
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    return re.sub(r"^[^A-Za-z]+", "", re.sub(r"[^A-Za-z0-9_-]+", "_", plain)).strip("_")


def _free(name: str, used: set[str]) -> str:
    number, free = 1, name
    while free in used:
        number += 1
        free = f"{name}_{number}"
    return free
