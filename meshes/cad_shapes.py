"""What a STEP file holds: named solids, the flat faces by which they touch, and holes in these.

All lengths here are in millimetres, OpenCASCADE's own unit whatever the file's.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.files import is_file
from fenics_joints.meshes.cad_kinds import TOUCH, circle_of, is_flat
from fenics_joints.meshes.gmsh_apart import run_apart

#: A solid by its label in the file, its number there from 1, or a point inside.
Place = str | int | Sequence[float]
_PARALLEL = 1e-6
#: Overlap, m, up to which faces touch: drawings are rounded, to micrometres or inches.
OVERLAP = 0.02
#: Share of a face below which a common area is round-off.
_NO_AREA = 1e-6
#: Letters that are more than a plain one with an accent.
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
        gap: Distance between the faces in the file; below 0 where they overlap.
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
    """A round hole in a flat face: its centre, shape (3,), radius, and number in the outline."""

    centre: np.ndarray
    radius: float
    circle: int


def import_solids(path: Path, model, names: Mapping[str, Place]) -> Solids:
    """Read a STEP file into gmsh's current model, and name its solids.

    A copy is read, twice: what the user's file is by then may be another.

    Args:
        path: The file.
        model: gmsh's model; its option ``Geometry.OCCTargetUnit`` is ``MM``.
        names: Where the solid of each name is; others are called by their label, or ``solid_1``.

    Raises:
        MeshError: The file is missing, is no STEP file, or has less than two solids; or a name
            fits no solid, or two.
    """
    if not is_file(path):
        raise MeshError(f"{path}: no such file, expected a STEP file")
    with TemporaryDirectory(prefix="fenics-joints-") as folder:
        copy = Path(folder) / "solids.step"
        try:
            shutil.copyfile(path, copy)
        except OSError as error:
            raise MeshError(f"{path}: cannot be read ({error.strerror})") from error
        _check_step(path, copy)
        try:
            with _unheard():
                found = model.occ.importShapes(str(copy), format="step")
            model.occ.synchronize()
        except Exception as error:
            words = str(error).replace(str(copy), path.name)
            raise MeshError(f"{path}: gmsh cannot read it: {words}") from error
    tags = [tag for dim, tag in found if dim == 3]
    labels = [_label(model.getEntityName(3, tag)) for tag in tags]
    if len(tags) < 2:
        there = f"one solid, {labels[0][-1] or 'unnamed'!r}" if tags else "no solid"
        raise MeshError(f"{path}: it has {there}; expected an assembly of at least two")
    return Solids(path, _named(path, model, tags, labels, names), tags)


#: SHA-256 of files that gmsh could read in a process of its own.
_readable: set[bytes] = set()


def _check_step(path: Path, copy: Path) -> None:
    """Refuse what is no STEP file, and what gmsh cannot read or crashes on."""
    with copy.open("rb") as file:
        start = file.read(4096)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 4096))
        whole = b"END-ISO-10303-21" in file.read()
    digest = hashlib.sha256(copy.read_bytes()).digest()
    if not _STEP.match(start):
        raise MeshError(f"{path}: not a STEP file, expected it to begin with ISO-10303-21;")
    if digest in _readable:
        return
    try:
        run_apart(path, copy.parent, copy.name, size)
    except MeshError as error:
        if whole:
            raise
        expected = "it is truncated, expected END-ISO-10303-21; at its end"
        raise MeshError(f"{path}: gmsh cannot read it: {expected}") from error
    _readable.add(digest)


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


#: Progress callback: the task, its finished parts, and their total number.
Told = Callable[[str, int, int], None]


def untold(words: str, done: int, of: int) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class _Flat:
    """A flat face: gmsh's number, its unit normal out of the solid, a point of it, its box."""

    tag: int
    normal: np.ndarray
    point: np.ndarray
    box: np.ndarray


def find_contacts(
    model, solids: Solids, reach: float, told: Told = untold, *, tidy: bool = True
) -> list[Contact]:
    """Pairs of flat faces that touch, or are apart by at most ``reach``; see `Contact`.

    Faces that overlap by at most `OVERLAP` touch, too. Faces with a gap do not touch if another
    solid lies in the gap, such as a sheet or a washer.

    Args:
        model: gmsh's model.
        solids: The solids.
        reach: How far apart faces may be.
        told: Progress callback.
        tidy: Whether to remove temporary shapes, which takes as long as the rest.
    """
    flats = [(i, flat) for i, tag in enumerate(solids.tags) for flat in _flats(model, tag)]
    pairs = _facing(flats, reach)
    found: list[tuple[Contact, list]] = []
    for n, (k, m, gap) in enumerate(pairs):
        if n % 20 == 0:
            told("pairs of faces", n, len(pairs))
        (i, a), (j, b) = flats[k], flats[m]
        common, area = _common(model, a, b, gap)
        if area > _NO_AREA * model.occ.getMass(2, a.tag):
            contact = Contact(i, j, a.normal, a.point, gap, (a.tag, b.tag), area)
            found.append((contact, common))
        elif common:
            model.occ.remove(common, recursive=True)
    free = [not _kept_apart(model, item, found) for item in found]
    if tidy:
        for _, common in found:
            model.occ.remove(common, recursive=True)
    return [contact for (contact, _), keep in zip(found, free, strict=True) if keep]


def _facing(flats: Sequence[tuple[int, _Flat]], reach: float) -> list[tuple[int, int, float]]:
    """Facing faces of two solids, within reach: the faces' numbers, and the gap."""
    if not flats:
        return []
    solid = np.array([i for i, _ in flats])
    normals, points = (np.array([getattr(f, k) for _, f in flats]) for k in ("normal", "point"))
    boxes = np.array([f.box for _, f in flats])
    found = []
    for k, (i, a) in enumerate(flats):
        gap = points @ a.normal - a.point @ a.normal
        near = (solid > i) & (normals @ a.normal <= _PARALLEL - 1)
        near &= (gap >= -OVERLAP) & (gap <= reach)
        moved = boxes - gap[:, None, None] * a.normal
        near &= np.all(moved[:, 1] >= a.box[0] - TOUCH, axis=1)
        near &= np.all(a.box[1] >= moved[:, 0] - TOUCH, axis=1)
        found += [(i, int(solid[m]), k, int(m), float(gap[m])) for m in np.flatnonzero(near)]
    return [(k, m, gap) for _, _, k, m, gap in sorted(found)]


def _kept_apart(model, item: tuple[Contact, list], found) -> bool:
    """Whether a solid lies between two faces: nearer to one than the other, where they meet."""
    contact, common = item
    if contact.gap <= TOUCH:
        return False
    for other, nearer in found:
        if other.gap < contact.gap and set(other.faces) & set(contact.faces):
            one, two = model.occ.copy(common), model.occ.copy(nearer)
            apart = (contact.point - other.point) @ contact.normal
            model.occ.translate(two, *(apart * contact.normal))
            both, _ = model.occ.intersect(one, two)
            area = sum(model.occ.getMass(2, tag) for dim, tag in both if dim == 2)
            model.occ.remove(both, recursive=True)
            if area > _NO_AREA * contact.area:
                return True
    return False


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
        (c.gap, names[c.lower], names[c.upper])
        for c in find_contacts(model, solids, np.inf)
        if frozenset((names[c.lower], names[c.upper])) in wanted and c.gap > reach
    ]
    if not apart:
        return ""
    gap, a, b = min(apart)
    return f"; those of {a!r} and {b!r} are {gap:.6g} mm apart (layer says how far they may be)"


def _common(model, a: _Flat, b: _Flat, gap: float) -> tuple[list[tuple[int, int]], float]:
    """Common part of two faces when the second is moved onto the first, and its area."""
    occ = model.occ
    first, second = occ.copy([(2, a.tag)]), occ.copy([(2, b.tag)])
    occ.translate(second, *(-gap * a.normal))
    common, _ = occ.intersect(first, second)
    return common, sum(occ.getMass(2, tag) for dim, tag in common if dim == 2)


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


@dataclass(frozen=True)
class Outline:
    """The edges of a flat face.

    Attributes:
        centres: Centres of the circles on which edges lie, shape (n, 3).
        radii: Radii of the circles, shape (n,).
        curves: gmsh's curves on each circle.
        holes: Numbers of the circles that are holes: whole, with edges outside them.
        pieces: All edges but holes, as straight pieces, shape (n_pieces, 2, 3).
    """

    centres: np.ndarray
    radii: np.ndarray
    curves: list[list[int]]
    holes: np.ndarray
    pieces: np.ndarray

    @classmethod
    def of(cls, model, face: int) -> Outline:
        """The edges of a face of gmsh's."""
        circles, curves, lengths = np.empty((0, 4)), [], []
        number, starts, all_points = [], [], []
        for _, curve in model.getBoundary([(2, face)], oriented=False):
            found, own = circle_of(model, curve), -1
            if found is not None:
                off = circles - [*found[0], found[1]]
                same = (np.abs(off[:, 3]) < TOUCH) & (np.sum(off[:, :3] ** 2, axis=1) < TOUCH**2)
                own = int(np.flatnonzero(same)[0]) if np.any(same) else len(circles)
                if own == len(circles):
                    circles = np.vstack([circles, [*found[0], found[1]]])
                    curves.append([])
                    lengths.append(0.0)
                curves[own].append(curve)
                lengths[own] += model.occ.getMass(1, curve)
            number.append(own)
            all_points.append(_along(model, curve))
            starts.append(all_points[-1][0])
        number, starts = np.array(number), np.array(starts)
        centres, radii = circles[:, :3], circles[:, 3]
        whole = np.abs(np.array(lengths) / (2 * np.pi * radii) - 1) < 1e-3
        holes = np.array(
            [
                i
                for i in np.flatnonzero(whole)
                if np.any(np.linalg.norm(starts[number != i] - centres[i], axis=1) > radii[i])
            ],
            dtype=int,
        )
        inner = set(holes.tolist())
        others = [x for x, of in zip(all_points, number, strict=True) if of not in inner]
        pieces = [np.stack([x[:-1], x[1:]], axis=1) for x in others]
        pieces = np.vstack(pieces) if pieces else np.empty((0, 2, 3))
        return cls(centres, radii, curves, holes, pieces)

    def clearance(self, point: np.ndarray, hole: int) -> float:
        """Distance of a point in the face's plane from the nearest edge, except those of a hole."""
        others = self.holes[self.holes != hole]
        apart = np.linalg.norm(self.centres[others] - point, axis=1)
        start, end = self.pieces[:, 0], self.pieces[:, 1]
        along = end - start
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(((point - start) * along).sum(axis=1) / length, 0, 1)
        beside = np.linalg.norm(start + share[:, None] * along - point, axis=1)
        return min(
            np.min(np.abs(apart - self.radii[others]), initial=np.inf),
            np.min(beside, initial=np.inf),
        )


def _along(model, curve: int) -> np.ndarray:
    """Points along a curve, its ends included, shape (n, 3)."""
    (low,), (high,) = model.getParametrizationBounds(1, curve)
    n = 2 if model.getType(1, curve) == "Line" else 65
    at = np.linspace(low, high, n).tolist()
    return np.reshape(model.getValue(1, curve, at), (-1, 3))


def holes(outline: Outline) -> list[Hole]:
    """Round holes in a flat face: whole circles that are not its outer edge."""
    return [Hole(outline.centres[i], float(outline.radii[i]), int(i)) for i in outline.holes]


def circle_points(normal: np.ndarray, n: int) -> np.ndarray:
    """Unit vectors, shape (n, 3), evenly around a normal."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    turn = 2 * np.pi * np.arange(n)[:, None] / n
    return np.cos(turn) * first + np.sin(turn) * np.cross(normal, first)
