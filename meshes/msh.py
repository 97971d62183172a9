"""Reading a user's own gmsh mesh with named physical groups: as a mesh, never as a script.

gmsh guesses a file's format from its name and first line, runs unknown formats as gmsh scripts,
which can start programs, and reads ``NAME.opt`` beside the file. So a file's first lines are
checked here, and a copy named ``mesh.msh`` in a private folder is read by a separate process, see
`fenics_joints.meshes.gmsh_apart`.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import MeshError, Problems, located
from fenics_joints.files import is_file, path_of, shown_path
from fenics_joints.meshes.arguments import is_positive, requirement
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.decks import DECKS, read_deck
from fenics_joints.meshes.gmsh_apart import run_apart
from fenics_joints.meshes.grid import thickened
from fenics_joints.meshes.grow import Grown, grow
from fenics_joints.meshes.rings import ring_centres
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

#: Bytes at the beginning of a file that are checked. Chosen: comments that come first are shorter.
_HEAD = 65_536
# gmsh's type of element -> our name, and its vertices in DOLFINx's order.
_CELLS = {
    2: ("triangle", [0, 1, 2]),
    3: ("quadrilateral", [0, 1, 3, 2]),
    4: ("tetrahedron", [0, 1, 2, 3]),
    5: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6]),
}
_FACETS = {1: ("interval", [0, 1]), 2: ("triangle", [0, 1, 2]), 3: ("quadrilateral", [0, 1, 3, 2])}
_KINDS = {1: "curve", 2: "surface", 3: "volume"}


def read_msh(
    path: str | Path,
    comm: MPI.Intracomm,
    *,
    gdim: int = 3,
    scale: float = 1.0,
    grown: Grown | None = None,
    thickness: float | None = None,
) -> TaggedMesh:
    """Read a gmsh ``.msh`` file whose physical groups name the parts and the faces.

    The groups of dimension ``gdim`` are the parts, those of dimension ``gdim - 1`` the faces,
    interior ones (a joint's interface) included; a cell or facet is in one group at most. Cells
    are straight-sided and of one shape; tags are the groups' numbers in the file. Parts named
    ``ring_1``, ``ring_2``, ... are rings of a layer around bolts: their centres are the points
    ``bolts``; see `fenics_joints.meshes.measure_ring`. Named groups of points, and in space of
    lines, are `TaggedMesh.points`, which a support can hold.

    Args:
        path: The file, in any version of the format, text or binary.
        comm: Communicator; the call is collective, gmsh runs on rank 0 alone, see
            `fenics_joints.meshes.gmsh_apart`.
        gdim: Dimension of the cells and of the coordinates, 3 or 2.
        scale: Length in metres of the file's unit, such as 1e-3 for millimetres.
        grown: Joint layers to grow where parts touch, see `fenics_joints.meshes.grow`; None: none,
            parts that share vertices are as one.
        thickness: Thickness of a sheet, m, whose middle surface is a plane mesh with ``gdim=2``:
            the result is a mesh of the solid, in space. None: the mesh is a section, in the plane.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: The file is missing or is not gmsh's; a group has no name, or a name is used
            twice; cells are in no group, in two, of several shapes, of a shape we cannot use, or
            of second order; facets are in two groups or are no facets of the cells; cells are
            inverted or flat. The message names it.
    """
    path = path_of(path)
    require = requirement("read_msh")
    require(gdim in (2, 3), "gdim", gdim, "2 or 3")
    require(is_positive(scale), "scale", scale, "a length above 0 m")
    require(grown is None or isinstance(grown, Grown), "grown", grown, "a Grown, or none")
    sheet = thickness is None or (is_positive(thickness) and gdim == 2)
    require(sheet, "thickness", thickness, "a length above 0 m with gdim = 2, or none")

    def build() -> MeshLists:
        lists = read_lists(path, gdim, scale)
        if thickness is not None:
            lists = thickened(lists, thickness)
        if grown is None:
            return lists
        with located(path):
            return grow(lists, grown)

    lists = on_root(comm, build)
    tagged = distribute(comm, lists)
    with located(path):
        check_mesh(tagged)
    _check_facets_found(path, tagged, lists)
    space = tagged.mesh.geometry.dim == 3
    bolts = ring_centres(tagged) if space and "bolts" not in tagged.points else None
    return tagged if bolts is None else replace(tagged, points=tagged.points | {"bolts": bolts})


def read_lists(path: Path, gdim: int, scale: float) -> MeshLists:
    """The whole mesh of a file, on one rank; raises as `read_msh`."""
    with located(shown_path(path)):
        file = _read(path)
    problems = Problems(path)
    cell_groups = _groups(path, file, gdim, problems)
    facet_groups = _groups(path, file, gdim - 1, problems)
    problems.tried(lambda: _check_ungrouped(path, file, gdim, cell_groups))
    found = [
        problems.tried(lambda d=dim, g=groups, s=shapes: _elements(path, file, d, g, s))
        for dim, groups, shapes in ((gdim, cell_groups, _CELLS), (gdim - 1, facet_groups, _FACETS))
    ]
    problems.check()
    (cell, cells, cell_values), (_, facets, facet_values) = found
    nodes = np.unique(cells)
    order = np.argsort(file.tags)
    x = file.x[order[np.searchsorted(file.tags, nodes, sorter=order)]] * scale
    if gdim == 2 and np.ptp(x[:, 2]) > 1e-9 * np.ptp(x):
        raise MeshError(
            f"{path}: gdim is 2, expected all vertices at one z, but they span "
            f"{np.ptp(x[:, 2]):.6g} m (folded or turned shells have to be meshed as solids)"
        )
    if not np.isin(facets, nodes).all():
        raise MeshError(f"{path}: a face has vertices that no cell has, expected facets of cells")
    return MeshLists(
        cell,
        x[:, :gdim],
        np.searchsorted(nodes, cells),
        cell_values,
        np.searchsorted(nodes, facets),
        facet_values,
        _names(cell_groups, cell_values),
        _names(facet_groups, facet_values),
        _points(file, gdim, scale),
        file.notes,
    )


def _points(file: MshFile, gdim: int, scale: float) -> dict[str, np.ndarray]:
    """Vertices, m, (n, 3), of the named groups of points and lines that are no faces."""
    found: dict[str, list[np.ndarray]] = {}
    for i, (dim, _, name, _) in enumerate(file.groups):
        # The rings' centres are named after the bolts.
        if dim < gdim - 1 and name not in ("", "bolts") and len(file.points[i]):
            found.setdefault(name, []).append(scale * file.points[i])
    return {name: np.vstack(x) for name, x in found.items()}


def _names(groups, values: np.ndarray) -> dict[str, int]:
    """Number of each named group that has elements."""
    present = set(values.tolist())
    return {name: tag for tag, (name, _) in groups.items() if tag in present}


def _groups(
    path: Path, file: MshFile, dim: int, problems: Problems
) -> dict[int, tuple[str, list[int]]]:
    """Name and entities of each physical group that has any, by the group's number."""
    groups: dict[int, tuple[str, list[int]]] = {}
    group_of: dict[int, str] = {}
    for own, tag, name, entities in file.groups:
        if own != dim:
            continue
        if not name:
            problems.add(MeshError(f"{path}: {_KINDS[dim]} group {tag} has no name, expected one"))
        elif name in (other for other, _ in groups.values()):
            what = f"two {_KINDS[dim]} groups are named {name!r}"
            problems.add(MeshError(f"{path}: {what}, expected one"))
        entities = [abs(entity) for entity in entities]
        for entity in entities:
            if group_of.setdefault(entity, name) != name:
                what = f"{_KINDS[dim]} {entity} is in {group_of[entity]!r} and {name!r}"
                problems.add(MeshError(f"{path}: {what}, expected one group"))
        groups[tag] = (name, entities)
    return groups


def _check_ungrouped(path: Path, file: MshFile, gdim: int, groups) -> None:
    grouped = {entity for _, entities in groups.values() for entity in entities}
    counts: dict[int, int] = {}
    for entity, _, nodes in file.elements(gdim):
        counts[entity] = counts.get(entity, 0) + len(nodes)
    if not any(counts.values()):
        surface = gdim == 3 and any(len(nodes) for _, _, nodes in file.elements(2))
        hint = ": it has only surfaces; read a flat sheet with gdim = 2 and its thickness"
        raise MeshError(
            f"{path}: the mesh has no cells of dimension {gdim}, expected some"
            f"{hint if surface else ''}"
        )
    missing = {entity: n for entity, n in counts.items() if n and entity not in grouped}
    if missing:
        entities = ", ".join(str(entity) for entity in missing)
        present = ", ".join(name for name, _ in groups.values()) or "none"
        raise MeshError(
            f"{path}: {sum(missing.values())} cells ({_KINDS[gdim]} {entities}) are in no named "
            f"group, expected every cell in one; groups of dimension {gdim}: {present}"
        )


def _elements(path: Path, file: MshFile, dim: int, groups, shapes):
    """Shape, vertices by gmsh's numbers (n, n_corners) and group (n,) of the groups' elements."""
    found = [
        (kind, nodes, tag, name)
        for tag, (name, entities) in groups.items()
        for entity in entities
        for _, kind, nodes in file.elements(dim, entity)
    ]
    for kind, _, _, name in found:
        title, order = file.kinds[kind]
        if order != 1:
            raise MeshError(
                f"{path}: group {name!r} has elements of order {order} ({title}), expected order 1 "
                "(gmsh -order 1; the order of the displacements is chosen in the analysis)"
            )
        if kind not in shapes:
            known = ", ".join(shape for shape, _ in shapes.values())
            raise MeshError(f"{path}: group {name!r} has {title} elements, expected {known}")
    kinds = {kind: shapes[kind][0] for kind, *_ in found}
    if len(kinds) > 1:
        mixed = " and ".join(sorted(kinds.values()))
        raise MeshError(f"{path}: the elements of dimension {dim} are {mixed}, expected one shape")
    # Without faces any shape of facet does, as long as there are none.
    kind = next(iter(kinds), next(iter(shapes)))
    shape, order = shapes[kind]
    if not found:
        return shape, np.empty((0, len(order)), np.int64), np.empty(0, np.int32)
    values = [np.full(len(nodes), tag) for _, nodes, tag, _ in found]
    return shape, np.vstack([n for _, n, _, _ in found])[:, order], np.concatenate(values)


def _check_facets_found(path: Path, tagged: TaggedMesh, lists: MeshLists | None) -> None:
    """Raise if DOLFINx did not find each facet of the file among the facets of the cells."""
    mesh, tags = tagged.mesh, tagged.facet_tags
    owned = tags.values[tags.indices < mesh.topology.index_map(tags.dim).size_local]
    for name, tag in tagged.facet_names.items():
        found = mesh.comm.allreduce(int((owned == tag).sum()))
        given = mesh.comm.bcast(int((lists.facet_values == tag).sum()) if lists else None)
        if found != given:
            raise MeshError(
                f"{path}: {found} of {given} facets of face {name!r} are facets of the cells, each "
                "once; expected all (cells and faces must share their vertices)"
            )


@dataclass(frozen=True)
class MshFile:
    """The content of a ``.msh`` file.

    Attributes:
        groups: Dimension, number, name (may be empty) and entities of each physical group.
        blocks: Dimension, entity, gmsh's type of element, and the vertices, (n, n_vertices).
        kinds: Title and order of each type of element.
        tags: Numbers of the vertices, shape (n,).
        x: Coordinates of the vertices in the file's unit, shape (n, 3).
        points: Coordinates of the vertices of groups of points and lines, by the group's index.
        notes: What was left out or changed of a deck.
    """

    groups: list[tuple[int, int, str, list[int]]]
    blocks: tuple[tuple[int, int, int, np.ndarray], ...]
    kinds: dict[int, tuple[str, int]]
    tags: np.ndarray
    x: np.ndarray
    points: dict[int, np.ndarray]
    notes: tuple[str, ...] = ()

    def elements(
        self, dim: int, entity: int | None = None
    ) -> Iterator[tuple[int, int, np.ndarray]]:
        """Entity, type and vertices of all blocks of a dimension."""
        for of, number, kind, nodes in self.blocks:
            if of == dim and entity in (None, number):
                yield number, kind, nodes


def _read(path: Path) -> MshFile:
    """Read a file on one rank.

    Raises:
        MeshError: The file is missing, does not begin as a ``.msh`` file does, or gmsh refuses it,
            crashes on it, or takes too long.
    """
    if not is_file(path):
        raise MeshError("no such file, expected a mesh, such as gmsh's .msh")
    if path.suffix.lower() in DECKS:
        return MshFile(*read_deck(path).as_msh())
    with tempfile.TemporaryDirectory(prefix="fenics-joints-") as folder:
        universal = path.suffix.lower() in (".unv", ".uff")
        copy = Path(folder) / ("mesh.unv" if universal else "mesh.msh")
        try:
            shutil.copyfile(path, copy)
        except OSError as error:
            raise MeshError(f"cannot be read ({error.strerror})") from error
        with copy.open("rb") as file:
            (_check_universal if universal else _check_head)(file.read(_HEAD))
        run_apart(Path(folder), copy.name, copy.stat().st_size)
        return _loaded(Path(folder) / "mesh.npz")


def _check_universal(head: bytes) -> None:
    """Refuse a file that is no universal file."""
    first = [line.strip() for line in head.split(b"\n", 2)[:2]]
    if len(first) < 2 or first[0] != b"-1" or not first[1].isdigit():
        raise MeshError("not a universal file, expected it to begin with -1 and a dataset")


def _check_head(head: bytes) -> None:
    """Refuse a file that gmsh, by its first line, would not read as a mesh."""
    lines = head.split(b"\n")
    first = lines[0].rstrip()
    if first not in (b"$MeshFormat", b"$Comments"):
        raise MeshError("not a gmsh .msh file, expected it to begin with $MeshFormat")
    at = next((i for i, line in enumerate(lines) if line.startswith(b"$MeshFormat")), None)
    line = b"" if at is None or at + 1 >= len(lines) else lines[at + 1].strip()
    if not re.fullmatch(rb"[1-4](\.\d+)?\s+[01]\s+[48]", line):
        raise MeshError(
            f"after $MeshFormat there is {line[:40]!r}, expected a version from 1 to 4.1, "
            "then 0 or 1, then 8"
        )


def _loaded(file: Path) -> MshFile:
    with np.load(file, allow_pickle=False) as found:
        head = json.loads(found["head"].tobytes())
        groups = [tuple(group) for group in head["groups"]]
        kinds = {int(k): v for k, v in head["kinds"].items()}
        blocks = tuple(
            (dim, entity, kind, found[f"block{i}"].astype(np.int64).reshape(-1, kinds[kind][2]))
            for i, (dim, entity, kind) in enumerate(head["blocks"])
        )
        points = {
            i: found[f"points{i}"].reshape(-1, 3) for i, (dim, *_) in enumerate(groups) if dim < 2
        }
        tags, x = found["tags"].astype(np.int64), found["x"].reshape(-1, 3)
    if not np.all(np.isfinite(x)):
        raise MeshError("a vertex is not finite, expected numbers")
    return MshFile(groups, blocks, {k: tuple(v[:2]) for k, v in kinds.items()}, tags, x, points)
