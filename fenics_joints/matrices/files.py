"""Matrices, tables of degrees of freedom and nodes from files of other codes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp

from fenics_joints.errors import InputError, located
from fenics_joints.files import check_size, check_unpacked, is_file
from fenics_joints.matrices.part import MatrixPart
from fenics_joints.meshes.decks import bad_numbers, inp_lines, set_members
from fenics_joints.units import to_si

#: Names under which files hold K and M, in the order in which they are sought.
NAMES = {
    "stiffness": ("K", "KGG", "KAA", "KXX", "MKAA", "KLL", "STIFFNESS"),
    "mass": ("M", "MGG", "MAA", "MXX", "MMAA", "MLL", "MASS"),
    "damping": ("C", "BGG", "BAA", "BXX", "MBAA", "DAMPING"),
}
#: Keywords of a deck whose first line of numbers is kept.
_SAID = ("*ELASTIC", "*DENSITY", "*SHELL SECTION")
#: Bytes that a packed file may unpack to.
_MOST = 16_000_000_000
#: Residual of a rigid rotation, over what the largest entries of K give, from which a part is not
#: free. [numerical: digits that files have]
_HELD = 1e-4


@dataclass
class LabelledMatrix:
    """A matrix of a file.

    Attributes:
        matrix: The matrix, whole.
        labels: Number of the node and direction, 1 to 6, of each row, (n, 2); None if the file has
            none.
    """

    matrix: sp.csr_matrix
    labels: np.ndarray | None = None


@dataclass
class Nodes:
    """Nodes of a file.

    Attributes:
        points: Their places by number, in the file's unit of length.
        sets: Numbers of the nodes of each named set.
        values: Modulus, Poisson's ratio and density, and the thickness of shells, by the deck's
            keyword, in its units; those of its first material and section.
    """

    points: dict[int, np.ndarray]
    sets: dict[str, np.ndarray] = field(default_factory=dict)
    values: dict[str, list[float]] = field(default_factory=dict)


def read_matrix(path: Path, what: str, name: str | None = None) -> LabelledMatrix:
    """A symmetric matrix.

    Args:
        path: ``.mtx`` of Matrix Market or Abaqus, ``.npz``, ``.mat`` to version 7, CalculiX's
            ``.sti`` and ``.mas``, Nastran's ``.op4``, ``.op2`` or ``.pch`` with DMIG, ANSYS'
            ``.full``.
        what: ``stiffness``, ``mass`` or ``damping``.
        name: Its name in a file of several; by default one of `NAMES`.

    Raises:
        InputError: Names the file, what is wrong and what was expected.
    """
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: expected a file of {', '.join(_READERS)}")
    _check_file(path)
    try:
        found = read(path, what, name)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # whatever a library says of a broken file
        raise InputError(f"{path}: cannot be read as {path.suffix}: {error}") from error
    n, m = found.matrix.shape
    if n != m:
        raise InputError(f"{path}: has {n} rows and {m} columns: expected a square matrix")
    if np.iscomplexobj(found.matrix.data) and np.any(found.matrix.data.imag):
        raise InputError(
            f"{path}: the {what} is complex: expected a real matrix; losses are in [damping]"
        )
    matrix = sp.csr_matrix(found.matrix, dtype=float)
    # Of a symmetric matrix each pair may be there once.
    other = sp.csr_matrix(matrix.T)
    return LabelledMatrix(sp.csr_matrix(matrix + other - other.multiply(matrix != 0)), found.labels)


def _check_file(path: Path) -> None:
    if not is_file(path):
        raise InputError(f"{path}: no such file")
    check_size(path)


def _picked(path: Path, there: Mapping[str, object], what: str, name: str | None):
    """One of several matrices by its name, or by the usual ones."""
    upper = {key.upper(): key for key in there}
    for each in (name,) if name is not None else NAMES[what]:
        if each.upper() in upper:
            return there[upper[each.upper()]]
    asked = f"no {name!r}" if name is not None else f"no {what} ({', '.join(NAMES[what])})"
    raise InputError(f"{path}: has {asked}: expected one of {', '.join(sorted(there)) or 'none'}")


def _table(path: Path, columns: int, what: str) -> np.ndarray:
    """Rows of numbers, separated by spaces or commas; lines of other text are left out."""
    text = path.read_text(encoding="latin-1").replace(",", " ")
    try:
        rows = np.array(
            [row for row in (line.split() for line in text.splitlines()) if _is_row(row, columns)],
            dtype=float,
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}: expected {what}") from error
    if not len(rows):
        raise InputError(f"{path}: expected {what}")
    return rows


def _is_row(row: Sequence[str], columns: int) -> bool:
    return len(row) == columns and (row[0][0].isdigit() or row[0][0] in "+-.")


def _numbers(path: Path, columns: int, what: str) -> np.ndarray:
    try:
        return np.loadtxt(path, ndmin=2, usecols=range(columns), encoding="latin-1")
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: {error}: expected {what}") from error


def _read_calculix(path: Path, what: str, name: str | None) -> LabelledMatrix:
    rows = _numbers(path, 3, "lines 'row column value'")
    i, j = rows[:, :2].astype(int).T - 1
    n = max(i.max(initial=-1), j.max(initial=-1)) + 1
    if n > len(rows) or min(i.min(initial=0), j.min(initial=0)) < 0:
        raise InputError(f"{path}: has {len(rows)} entries for {n} rows: expected one each or more")
    return LabelledMatrix(sp.csr_matrix((rows[:, 2], (i, j)), shape=(n, n)))


def _read_mtx(path: Path, what: str, name: str | None) -> LabelledMatrix:
    with path.open(encoding="latin-1") as file:
        if file.readline().startswith("%%MatrixMarket"):
            return LabelledMatrix(sp.csr_matrix(scipy.io.mmread(path)))
    rows = _table(path, 5, "Matrix Market, or lines 'node, DOF, node, DOF, value' of Abaqus")
    ends = rows[:, :4].astype(int).reshape(-1, 2)
    labels, place = np.unique(ends, axis=0, return_inverse=True)
    i, j = place.reshape(-1, 2).T
    return LabelledMatrix(sp.csr_matrix((rows[:, 4], (i, j)), shape=(len(labels),) * 2), labels)


def _read_npz(path: Path, what: str, name: str | None) -> LabelledMatrix:
    check_unpacked(path, _MOST)
    with np.load(path, allow_pickle=False) as there:
        if {"format", "shape", "data"} <= set(there.files):
            return LabelledMatrix(sp.csr_matrix(sp.load_npz(path)))
        arrays = {key: there[key] for key in there.files}
    return LabelledMatrix(sp.csr_matrix(_picked(path, arrays, what, name)))


def _read_mat(path: Path, what: str, name: str | None) -> LabelledMatrix:
    if "function" in {kind for *_, kind in scipy.io.whosmat(path)}:
        raise InputError(f"{path}: holds a function: expected matrices")
    there = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")}
    return LabelledMatrix(sp.csr_matrix(_picked(path, there, what, name)))


def _read_op4(path: Path, what: str, name: str | None) -> LabelledMatrix:
    op4 = _library("pyyeti.nastran.op4", "nastran")
    return LabelledMatrix(
        sp.csr_matrix(_picked(path, op4.read(str(path), sparse=True), what, name))
    )


def _read_op2(path: Path, what: str, name: str | None) -> LabelledMatrix:
    op2 = _library("pyyeti.nastran.op2", "nastran")
    with op2.OP2(str(path)) as file:
        there = file.rdop2mats()
    return LabelledMatrix(sp.csr_matrix(_picked(path, there, what, name)))


def _read_dmig(path: Path, what: str, name: str | None) -> LabelledMatrix:
    bulk = _library("pyyeti.nastran.bulk", "nastran")
    names = {f"{k}2GG": k for k in ("K", "M", "B")} | {f"{k}AAX": k for k in ("K", "M", "B")}
    there = bulk.rddmig(str(path))
    first = {"stiffness": "K", "mass": "M", "damping": "B"}[what]
    own = {key: frame for key, frame in there.items() if names.get(key.upper()) == first}
    frame = _picked(path, there, what, name if name or len(own) != 1 else next(iter(own)))
    labels = np.array([(int(node), max(int(way), 0)) for node, way in frame.index])
    return LabelledMatrix(sp.csr_matrix(frame.to_numpy()), labels)


def _read_full(path: Path, what: str, name: str | None) -> LabelledMatrix:
    if what == "damping":
        raise InputError(f"{path}: the damping of a .full file is not read: expected another file")
    reader = _library("ansys.mapdl.reader", "ansys")
    labels, stiffness, mass = reader.read_binary(str(path)).load_km()
    labels = np.column_stack([labels[:, 0], labels[:, 1] + 1])  # directions count from 0 there
    return LabelledMatrix(sp.csr_matrix(stiffness if what == "stiffness" else mass), labels)


def _library(module: str, extra: str):
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            f"this file needs {module.split('.')[0]}: pip install 'fenics-joints[{extra}]'"
        ) from error


_READERS: dict[str, Callable[[Path, str, str | None], LabelledMatrix]] = {
    ".sti": _read_calculix,
    ".mas": _read_calculix,
    ".mtx": _read_mtx,
    ".npz": _read_npz,
    ".mat": _read_mat,
    ".op4": _read_op4,
    ".op2": _read_op2,
    ".pch": _read_dmig,
    ".bdf": _read_dmig,
    ".full": _read_full,
}


def read_dofs(path: Path) -> np.ndarray:
    """Node and direction, 1 to 6, of each row, (n, 2): CalculiX's ``.dof`` ("node.direction"), or
    a table of two columns; a direction of 0 is a coordinate that is no displacement of a node.

    Raises:
        InputError: If it is none of these.
    """
    expected = "lines 'node.direction', or a table 'node, direction'"
    _check_file(path)
    text = path.read_text(encoding="latin-1")
    pairs = re.findall(r"^\s*(\d+)\s*[.,;\s]\s*(\d+)\s*$", text, re.MULTILINE)
    if not pairs:
        raise InputError(f"{path}: expected {expected}")
    with located(path), bad_numbers():
        return np.array(pairs, dtype=int)


def read_nodes(path: Path) -> Nodes:
    """Numbers and places of nodes: a table 'node, x, y, z', or a deck of CalculiX or Abaqus with
    its sets of nodes.

    Raises:
        InputError: If it is none of these, or nodes of a deck are in parts, each with its numbers.
    """
    _check_file(path)
    if path.suffix.lower() != ".inp":
        rows = _table(path, 4, "a table 'node, x, y, z'")
        return Nodes(dict(zip(rows[:, 0].astype(int).tolist(), rows[:, 1:], strict=True)))
    with located(path), bad_numbers():
        return _nodes_of_deck(path.read_text(encoding="latin-1"))


def _nodes_of_deck(text: str) -> Nodes:
    found, collected = Nodes({}), dict[str, set[int]]()
    for keyword, options, rows in inp_lines(text):
        name = options.get("NSET")
        if keyword in _SAID and rows:
            found.values.setdefault(keyword, [float(value) for value in rows[0]])
        elif keyword == "*NODE":
            for row in (row for row in rows if len(row) >= 4):
                found.points[int(row[0])] = np.array(row[1:4], dtype=float)
                if name:
                    collected.setdefault(name, set()).add(int(row[0]))
        elif keyword == "*NSET" and name:
            numbers, named = set_members(options, rows)
            collected.setdefault(name, set()).update(
                numbers, *(collected.get(other, ()) for other in named)
            )
        elif keyword == "*INSTANCE":
            raise InputError("has parts and instances: expected one part, its nodes by themselves")
    if not found.points:
        raise InputError("has no *NODE: expected the nodes of the part")
    found.sets = {name: np.array(sorted(numbers)) for name, numbers in collected.items()}
    return found


def matrix_part(
    name: str,
    stiffness: LabelledMatrix,
    mass: LabelledMatrix,
    nodes: Nodes,
    dofs: np.ndarray | None = None,
    *,
    length: float = 1.0,
    force: float = 1.0,
    thickness: float | None = None,
) -> MatrixPart:
    """A part from what files say.

    Args:
        name: Its name.
        stiffness: K.
        mass: M, in the same order.
        nodes: Its nodes.
        dofs: Node and direction of each row, (n, 2), if the matrices have no labels.
        length: Length of the files' unit of length, m.
        force: Force of its unit of force, N; masses are in force times second squared over length.
        thickness: Of a shell whose nodes the other code split through the thickness, m.

    Raises:
        InputError: If the tables do not match the matrices, or nodes are missing.
    """
    labels = stiffness.labels if dofs is None else dofs
    n = stiffness.matrix.shape[0]
    if labels is None:
        order = list(nodes.points)
        ways = n // max(len(order), 1)
        if ways * len(order) != n or ways not in (3, 6):
            raise InputError(
                f"{name}: {n} rows for {len(order)} nodes, and no table of degrees of freedom: "
                "expected dofs = a file with the node and direction of each row"
            )
        labels = np.column_stack(
            [np.repeat(order, ways), np.tile(np.arange(1, ways + 1), len(order))]
        )
    if len(labels) != n:
        raise InputError(f"{name}: {len(labels)} degrees of freedom are named, the matrix has {n}")
    if mass.matrix.shape[0] != n:
        raise InputError(f"{name}: the mass has {mass.matrix.shape[0]} rows, the stiffness {n}")
    M = mass.matrix
    if mass.labels is not None and not np.array_equal(mass.labels, labels):
        place = {tuple(label): i for i, label in enumerate(mass.labels.tolist())}
        if len(place) < n or any(tuple(label) not in place for label in labels.tolist()):
            raise InputError(f"{name}: stiffness and mass have other degrees of freedom")
        at = [place[tuple(label)] for label in labels.tolist()]
        M = M[at][:, at]
    labels = np.asarray(labels, dtype=int)
    count = _occurrence(labels)
    keys, place = np.unique(np.column_stack([labels[:, 0], count]), axis=0, return_inverse=True)
    inner = labels[:, 1] == 0
    outer = np.unique(labels[~inner, 0])
    missing = [int(node) for node in outer if int(node) not in nodes.points]
    if missing:
        more = f" and {len(missing) - 1} more" if missing[1:] else ""
        raise InputError(f"{name}: no place is known of node {missing[0]}{more}")
    points = length * np.array([nodes.points.get(int(node), np.zeros(3)) for node, _ in keys])
    if count.max() > 0:
        points = _through(name, points, keys, thickness, labels, place, stiffness.matrix)
    way = np.where(inner, -1, labels[:, 1] - 1)
    # Energy in SI units of displacements in metres and radians.
    scale = np.where(way < 3, 1 / length, 1.0)
    D = sp.diags(np.sqrt(force * length) * scale)
    own = np.column_stack([place.ravel(), way])
    return MatrixPart(name, D @ stiffness.matrix @ D, D @ M @ D, points, own, keys[:, 0])


def _occurrence(labels: np.ndarray) -> np.ndarray:
    """How often the label of each row stood in a row before, (n,)."""
    order = np.lexsort((np.arange(len(labels)), labels[:, 1], labels[:, 0]))
    ordered = labels[order]
    new = np.ones(len(labels), dtype=bool)
    new[1:] = np.any(np.diff(ordered, axis=0) != 0, axis=1)
    start = np.maximum.accumulate(np.where(new, np.arange(len(labels)), 0))
    found = np.empty(len(labels), dtype=int)
    found[order] = np.arange(len(labels)) - start
    return found


def _through(name, points, keys, thickness, labels, place, stiffness) -> np.ndarray:
    """Places of the nodes of a shell that CalculiX split: two of a node on its faces, of three one
    in its middle. Which is which is seen from K, which no rigid rotation strains."""
    if thickness is None:
        raise InputError(
            f"{name}: rows of node {keys[keys[:, 1] > 0][0, 0]} are there several times, as of a "
            "shell of CalculiX: expected its thickness"
        )
    if keys[:, 1].max() > 2:
        raise InputError(
            f"{name}: rows of node {keys[keys[:, 1] > 2][0, 0]} are there "
            f"{1 + keys[:, 1].max()} times: expected a shell of second order, S6 or S8, whose "
            "elements share their nodes"
        )
    middle = points - points.mean(axis=0)
    normal = np.linalg.svd(middle, full_matrices=False)[2][2]
    if np.ptp(middle @ normal) > thickness:
        raise InputError(f"{name}: is a curved shell: expected a flat one, or a mesh of solids")
    most = np.zeros(keys[:, 0].max() + 1, dtype=int)
    np.maximum.at(most, keys[:, 0], keys[:, 1])
    share = np.where(most[keys[:, 0]] > 0, keys[:, 1] / np.maximum(most[keys[:, 0]], 1) - 0.5, 0.0)
    options = [points + sign * thickness * share[:, None] * normal for sign in (1, -1)]
    return min(options, key=lambda x: _strain(x, labels, place, stiffness))


def _strain(points, labels, place, stiffness) -> float:
    """How much of K resists rigid rotations."""
    off = (points - points.mean(axis=0))[place.ravel()]
    way, total = labels[:, 1] - 1, 0.0
    for axis in np.eye(3):
        spun = np.where(way < 3, np.cross(axis, off)[np.arange(len(off)), np.minimum(way, 2)], 0.0)
        spun = np.where(way > 2, axis[np.clip(way - 3, 0, 2)], spun)
        total += float(np.linalg.norm(stiffness @ spun))
    return total


def held_note(part: MatrixPart) -> str | None:
    """A sentence if K resists motions as a rigid body, or None if the part is free."""
    rigid = part.rigid_motion(part.points.mean(axis=0))
    size = np.abs(part.stiffness).sum(axis=1).max() * np.abs(rigid).max(axis=0)
    rest = np.abs(part.stiffness @ rigid).max(axis=0) / size
    if rest[:3].max() > _HELD:
        return f"{part.name}: its stiffness resists being moved as a rigid body: it is held"
    if rest[3:].max() > _HELD:
        return (
            f"{part.name}: its stiffness resists being turned as a rigid body, though not being "
            "moved: are its nodes in another unit, or its directions in another order?"
        )
    return None


def unit_of(text: str, kind: str) -> float:
    """Size of a unit such as ``"mm"`` or ``"N"``, SI; ``kind`` is its SI unit."""
    return to_si(f"1 {text}", kind)
