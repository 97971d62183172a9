"""What a STEP file holds: named solids, the flat faces by which they touch, and holes in these.

All lengths here are in millimetres, OpenCASCADE's own unit whatever the file's.
"""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.files import is_file
from fenics_joints.meshes.cad_kinds import TOUCH, circle_of, is_flat
from fenics_joints.meshes.gmsh_apart import run_apart

__all__ = [
    "Contact",
    "Hole",
    "Place",
    "Solids",
    "find_contacts",
    "holes",
    "import_solids",
    "nearest",
]

#: A solid by its label in the file, its number there from 1, or a point inside.
Place = str | int | Sequence[float]
_PARALLEL = 1e-6
#: Share of a face below which a common area is round-off.
_NO_AREA = 1e-6
#: Letters that are more than a plain one with an accent.
_LETTERS = str.maketrans({
    "ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss",
    "æ": "ae", "Æ": "Ae", "ø": "oe", "Ø": "Oe", "ł": "l", "Ł": "L",
})  # fmt: skip
#: How a STEP file begins: comments may stand before it.
_STEP = re.compile(rb"(\xef\xbb\xbf)?(\s|/\*.*?\*/)*ISO-10303-21\s*;", re.DOTALL)
#: How far from a face a point is asked for being in the solid.
_PROBE = 1e-2


@dataclass(frozen=True)
class Solids:
    """The solids of a file, in its order.

    Attributes:
        path: The file.
        names: Our name of each.
        tags: gmsh's number of each.
    """

    path: Path
    names: list[str]
    tags: list[int]


@dataclass(frozen=True)
class Contact:
    """Two flat faces of two solids, one upon the other.

    Attributes:
        lower: Index of the first solid.
        upper: Index of the second.
        normal: Unit normal from the first to the second, shape (3,).
        point: A point of the first's face, shape (3,).
        gap: Distance of the second's face in the file.
        faces: gmsh's numbers of the two faces.
        area: Area that they have in common.
    """

    lower: int
    upper: int
    normal: np.ndarray
    point: np.ndarray
    gap: float
    faces: tuple[int, int]
    area: float


@dataclass(frozen=True)
class Hole:
    """A round hole in a flat face: its centre, shape (3,), and radius."""

    centre: np.ndarray
    radius: float


def import_solids(path: Path, model, names: Mapping[str, Place]) -> Solids:
    """Read a STEP file into gmsh's current model, and name its solids.

    Args:
        path: The file.
        model: gmsh's model; its option ``Geometry.OCCTargetUnit`` is ``MM``.
        names: Where the solid of each name is; others are called by their label, or ``solid_1``.

    Raises:
        MeshError: The file is missing, is no STEP file, or has less than two solids; or a name
            fits no solid, or two.
    """
    _check_step(path)
    try:
        with _unheard():
            found = model.occ.importShapes(str(path), format="step")
        model.occ.synchronize()
    except Exception as error:
        raise MeshError(f"{path}: gmsh cannot read it: {error}") from error
    tags = [tag for dim, tag in found if dim == 3]
    labels = [_label(model.getEntityName(3, tag)) for tag in tags]
    if len(tags) < 2:
        there = f"one solid, {labels[0][-1] or 'unnamed'!r}" if tags else "no solid"
        raise MeshError(f"{path}: it has {there}; expected an assembly of at least two")
    return Solids(path, _named(path, model, tags, labels, names), tags)


def _check_step(path: Path) -> None:
    """Refuse what is no STEP file, and what gmsh cannot read or crashes on."""
    if not is_file(path):
        raise MeshError(f"{path}: no such file, expected a STEP file")
    with path.open("rb") as file:
        start = file.read(4096)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 4096))
        whole = b"END-ISO-10303-21" in file.read()
    if not _STEP.match(start):
        raise MeshError(f"{path}: not a STEP file, expected it to begin with ISO-10303-21;")
    try:
        _read_apart(path.resolve(), size, path.stat().st_mtime_ns)
    except MeshError as error:
        if whole:
            raise
        expected = "it is truncated, expected END-ISO-10303-21; at its end"
        raise MeshError(f"{path}: gmsh cannot read it: {expected}") from error


@lru_cache(maxsize=8)
def _read_apart(path: Path, size: int, changed: int) -> None:
    """Read a file in a process of its own, once for each state of the file."""
    with TemporaryDirectory(prefix="fenics-joints-") as folder:
        run_apart(path, Path(folder), str(path), size)


@contextmanager
def _unheard() -> Iterator[None]:
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


def _named(path, model, tags, labels, names: Mapping[str, Place]) -> list[str]:
    given: dict[int, str] = {}
    own = [label[-1] for label in labels]
    said = ["/".join(label) if own.count(label[-1]) > 1 else label[-1] for label in labels]
    listing = "; ".join(f"{i}: {label!r}" for i, label in enumerate(said, start=1))
    for name, place in names.items():
        which = _matching(model, tags, labels, place)
        if len(which) != 1:
            if not isinstance(place, str | int):
                place = f"({', '.join(f'{x:.6g}' for x in np.ravel(place))}) mm"
            raise MeshError(
                f"{path}: parts.{name} = {place!r} fits {len(which)} solids, expected one by its "
                f"label, its number from 1, or a point inside; there are: {listing}"
            )
        if which[0] in given:
            twice = f"parts.{given[which[0]]} and parts.{name} are both solid {which[0] + 1}"
            raise MeshError(f"{path}: {twice}, expected one name for it; there are: {listing}")
        given[which[0]] = name
    used, found = set(given.values()), []
    for i, label in enumerate(labels):
        name = given.get(i) or _free(_sanitised(label[-1]) or f"solid_{i + 1}", used)
        used.add(name)
        found.append(name)
    return found


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


# -- faces -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Flat:
    """A flat face: gmsh's number, its unit normal out of the solid, a point of it, its box."""

    tag: int
    normal: np.ndarray
    point: np.ndarray
    box: np.ndarray


def find_contacts(model, solids: Solids, reach: float) -> list[Contact]:
    """Pairs of flat faces that touch, or are apart by at most ``reach``; see `Contact`."""
    flats = [_flats(model, tag) for tag in solids.tags]
    found = []
    for i, lower in enumerate(flats):
        for j in range(i + 1, len(flats)):
            pairs = [(a, b) for a in lower for b in flats[j]]
            found += [c for a, b in pairs if (c := _contact(model, i, j, a, b, reach))]
    return found


def nearest(
    model, solids: Solids, reach: float, pairs: Sequence[tuple[str, str]] | None = None
) -> str:
    """Why there are no contacts, for a message: solids that overlap, or how far faces are apart.

    Args:
        model: gmsh's model.
        solids: The solids.
        reach: How far faces that touch may be apart.
        pairs: Names of the pairs that are looked at; None: all.
    """
    names = solids.names
    if pairs is None:
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for a, b in pairs:
        both = [model.occ.copy([(3, solids.tags[names.index(name)])]) for name in (a, b)]
        common, _ = model.occ.intersect(*both)
        if volume := sum(model.occ.getMass(3, tag) for dim, tag in common if dim == 3):
            return f"; {a!r} and {b!r} overlap by {volume:.6g} mm3"
    wanted = {frozenset(pair) for pair in pairs}
    apart = [
        (c.gap, names[c.lower], names[c.upper]) for c in find_contacts(model, solids, np.inf)
        if frozenset((names[c.lower], names[c.upper])) in wanted and c.gap > reach
    ]  # fmt: skip
    if not apart:
        return ""
    gap, a, b = min(apart)
    return f"; those of {a!r} and {b!r} are {gap:.6g} mm apart (layer says how far they may be)"


def _contact(model, i: int, j: int, a: _Flat, b: _Flat, reach: float) -> Contact | None:
    if a.normal @ b.normal > _PARALLEL - 1:
        return None
    gap = float(a.normal @ (b.point - a.point))
    if not -TOUCH <= gap <= reach:
        return None
    shifted = b.box - gap * a.normal
    if np.any(shifted[1] < a.box[0] - TOUCH) or np.any(a.box[1] < shifted[0] - TOUCH):
        return None
    area = _common_area(model, a, b, gap)
    if area <= _NO_AREA * model.occ.getMass(2, a.tag):
        return None
    return Contact(i, j, a.normal, a.point, gap, (a.tag, b.tag), area)


def _common_area(model, a: _Flat, b: _Flat, gap: float) -> float:
    occ = model.occ
    first, second = occ.copy([(2, a.tag)]), occ.copy([(2, b.tag)])
    occ.translate(second, *(-gap * a.normal))
    common, _ = occ.intersect(first, second)
    area = sum(occ.getMass(2, tag) for dim, tag in common if dim == 2)
    occ.remove(common, recursive=True)
    return area


def _flats(model, solid: int) -> list[_Flat]:
    faces = [tag for _, tag in model.getBoundary([(3, solid)], oriented=False)]
    flats = (_flat(model, solid, tag) for tag in faces if is_flat(model, tag))
    return [flat for flat in flats if flat is not None]


def _flat(model, solid: int, tag: int) -> _Flat | None:
    uv = _inner_parameters(model, tag)
    if uv is None:
        return None
    point, normal = np.array(model.getValue(2, tag, uv)), np.array(model.getNormal(tag, uv))
    # Which way the normal points depends on who wrote the file.
    if model.isInside(3, solid, (point + _PROBE * normal).tolist()):
        normal = -normal
    box = np.array(model.getBoundingBox(2, tag)).reshape(2, 3)
    return _Flat(tag, normal, point, box)


def _inner_parameters(model, tag: int) -> list[float] | None:
    """Parameters of a point of the face that is in no hole of it."""
    low, high = (np.array(ends) for ends in model.getParametrizationBounds(2, tag))
    for n in (3, 8, 21, 55):
        steps = (np.arange(n) + 0.5) / n
        for s in steps:
            for t in steps:
                uv = (low + (high - low) * [s, t]).tolist()
                if model.isInside(2, tag, uv, parametric=True):
                    return uv
    return None


def holes(model, face: int) -> list[Hole]:
    """Round holes in a flat face: whole circles with the face outside them and not inside."""
    arcs: list[list] = []
    for _, curve in model.getBoundary([(2, face)], oriented=False):
        circle = circle_of(model, curve)
        if circle is None:
            continue
        (centre, radius), length = circle, model.occ.getMass(1, curve)
        for arc in arcs:
            if np.linalg.norm(arc[0] - centre) < TOUCH and abs(arc[1] - radius) < TOUCH:
                arc[2] += length
                break
        else:
            arcs.append([centre, radius, length])
    whole = [
        Hole(centre, radius) for centre, radius, length in arcs
        if abs(length / (2 * np.pi * radius) - 1) < 1e-3
    ]  # fmt: skip
    return [hole for hole in whole if _is_hole(model, face, hole)]


def _is_hole(model, face: int, hole: Hole) -> bool:
    uv = _inner_parameters(model, face)
    normal = np.array(model.getNormal(face, uv))
    around = circle_points(normal, 8)
    outside = [hole.centre + 1.02 * hole.radius * way for way in around]
    inside = [hole.centre + 0.98 * hole.radius * way for way in around]
    n_out, n_in = (sum(model.isInside(2, face, p.tolist()) for p in ps) for ps in (outside, inside))
    return n_out >= 5 and n_in == 0


def circle_points(normal: np.ndarray, n: int) -> np.ndarray:
    """Unit vectors, shape (n, 3), evenly around a normal."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    turn = 2 * np.pi * np.arange(n)[:, None] / n
    return np.cos(turn) * first + np.sin(turn) * np.cross(normal, first)
