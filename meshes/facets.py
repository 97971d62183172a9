"""Facets of a whole mesh on one rank: outer ones, those between parts, names for them; bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from fenics_joints.errors import MeshError
from fenics_joints.meshes.tagged import MeshLists

#: Corners of a cell's facets, each facet's in DOLFINx's order.
FACETS = {
    "triangle": np.array([[1, 2], [0, 2], [0, 1]]),
    "quadrilateral": np.array([[0, 1], [0, 2], [1, 3], [2, 3]]),
    "tetrahedron": np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]),
    "hexahedron": np.array(
        [[0, 1, 2, 3], [0, 1, 4, 5], [0, 2, 4, 6], [1, 3, 5, 7], [2, 3, 6, 7], [4, 5, 6, 7]]
    ),
}
#: Corners from 0 whose edges span a cell's volume, and the order of a mirrored cell's corners.
_SPANS = {
    "triangle": ([1, 2], [0, 2, 1]),
    "quadrilateral": ([1, 2], [1, 0, 3, 2]),
    "tetrahedron": ([1, 2, 3], [0, 1, 3, 2]),
    "hexahedron": ([1, 2, 4], [1, 0, 3, 2, 5, 4, 7, 6]),
}


def row_numbers(rows: np.ndarray) -> np.ndarray:
    """A number for each row, the same for rows of the same entries in any order.

    Args:
        rows: Whole numbers, such as the vertices of facets; shape (n, m).

    Returns:
        Numbers from 0, shape (n,).
    """
    rows = np.sort(rows, axis=1)
    order = np.lexsort(rows.T[::-1])
    changes = np.any(np.diff(rows[order], axis=0, prepend=rows[order[:1]]) != 0, axis=1)
    numbers = np.empty(len(rows), dtype=np.int64)
    numbers[order] = np.cumsum(changes)
    return numbers


def _sides(lists: MeshLists) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the facets of all cells, (n, n_corners), and the cell of each, (n,)."""
    corners = FACETS[lists.cell]
    facets = lists.cells[:, corners].reshape(-1, corners.shape[1])
    return facets, np.repeat(np.arange(len(lists.cells)), len(corners))


def exterior_facets(lists: MeshLists) -> tuple[np.ndarray, np.ndarray]:
    """Facets of one cell alone.

    Returns:
        Vertices of each facet in DOLFINx's order, shape (n, n_corners); its cell, shape (n,).
    """
    facets, cells = _sides(lists)
    numbers = row_numbers(facets)
    alone = np.bincount(numbers)[numbers] == 1
    return facets[alone], cells[alone]


def interfaces(lists: MeshLists, mark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets between cells of different marks.

    Args:
        lists: The mesh.
        mark: A whole number for each cell, such as its part or its body, shape (n_cells,).

    Returns:
        Vertices of each facet in DOLFINx's order as its first cell has them, shape
        (n, n_corners); and its two cells, that of the lower mark first, shape (n, 2).
    """
    of_vertex, shared = np.zeros(len(lists.x), dtype=mark.dtype), np.zeros(len(lists.x), dtype=bool)
    of_vertex[lists.cells] = mark[:, None]
    shared[lists.cells[of_vertex[lists.cells] != mark[:, None]]] = True
    facets, cells = _sides(lists)
    there = shared[facets].all(axis=1)
    facets, cells = facets[there], cells[there]
    numbers = row_numbers(facets)
    order = np.lexsort([mark[cells], numbers])
    first, second = order[:-1], order[1:]
    between = (numbers[first] == numbers[second]) & (mark[cells[first]] != mark[cells[second]])
    first, second = first[between], second[between]
    return facets[first], np.column_stack([cells[first], cells[second]])


def by_part(lists: MeshLists, numbers: Mapping[str, int]) -> np.ndarray:
    """The number of each cell's part, 0 for parts that have none, shape (n_cells,)."""
    of_tag = np.zeros(max(lists.cell_names.values()) + 1, dtype=np.int64)
    for name, number in numbers.items():
        of_tag[lists.cell_names[name]] = number
    return of_tag[lists.cell_values]


def facets_between(lists: MeshLists, part: str, *others: str) -> np.ndarray:
    """Vertices of the facets between a part and others, in DOLFINx's order, (n, n_corners)."""
    mark = by_part(lists, dict.fromkeys(others, 1) | {part: 2})
    facets, cells = interfaces(lists, mark)
    return facets[(mark[cells] > 0).all(axis=1)]


def add_faces(lists: MeshLists, faces: Mapping[str, np.ndarray]) -> MeshLists:
    """The same mesh with more named faces.

    Args:
        lists: The mesh.
        faces: Vertices of each face's facets, each of shape (n, n_corners). A name that the mesh
            has already is extended; facets must not have a tag yet, since they have but one.

    Returns:
        The mesh, with tags above its own for names that are new.
    """
    names = dict(lists.facet_names)
    facets, values = [lists.facets], [lists.facet_values]
    for name, new in faces.items():
        tag = names.setdefault(name, max(names.values(), default=0) + 1)
        facets.append(np.asarray(new).reshape(-1, lists.facets.shape[1]))
        values.append(np.full(len(new), tag, dtype=np.int32))
    return replace(
        lists, facets=np.vstack(facets), facet_values=np.concatenate(values), facet_names=names
    )


def name_between(lists: MeshLists, faces: Mapping[str, Sequence[str]]) -> MeshLists:
    """The same mesh with more named faces, each between its first part and the others."""
    return add_faces(lists, {name: facets_between(lists, *parts) for name, parts in faces.items()})


class Skin:
    """The outer facets of a mesh, some of which get names by where they are.

    Attributes:
        x: Corners of each facet, m, shape (n, n_corners, gdim).
        tag: Tag of the cell behind each facet, shape (n,).
    """

    def __init__(self, lists: MeshLists):
        self._lists = lists
        self._facets, cells = exterior_facets(lists)
        self.x, self.tag = lists.x[self._facets], lists.cell_values[cells]
        self._tolerance = 1e-9 * np.ptp(lists.x, axis=0).max()

    def at(self, axis: int, place: float | np.ndarray) -> np.ndarray:
        """Which facets lie where a coordinate has a value, one for all or one for each."""
        return self.equal(self.x[:, :, axis], place)

    def equal(self, values: np.ndarray, expected: float | np.ndarray) -> np.ndarray:
        """Which facets have a value, m, at all corners, whose values are (n, n_corners)."""
        off = np.abs(values - np.reshape(expected, (-1, 1)))
        return np.all(off < self._tolerance, axis=1)

    def within(self, values: np.ndarray, most: float) -> np.ndarray:
        """Which facets have at most a value, m, at all corners, whose values are (n, n_corners)."""
        return np.all(values < most + self._tolerance, axis=1)

    def from_axes(self, centres: np.ndarray, norm: float = 2) -> tuple[np.ndarray, np.ndarray]:
        """Distance, m, of a facet's corners from the bolt's axis that is nearest to its middle.

        Args:
            centres: The axes in the plan, shape (n_axes, 2), or along x, shape (n_axes, 1).
            norm: 2 for round distances, infinity for square ones.

        Returns:
            The distances, shape (n, n_corners), and the axis' number, shape (n,).
        """
        plan = self.x[:, :, : centres.shape[1]]
        nearest = KDTree(centres).query(plan.mean(axis=1), p=norm)[1]
        return np.linalg.norm(plan - centres[nearest][:, None], ord=norm, axis=2), nearest

    def named(self, faces: Mapping[str, np.ndarray]) -> MeshLists:
        """The mesh with names for its outer faces, from which facets each of them has."""
        return add_faces(self._lists, {name: self._facets[own] for name, own in faces.items()})


def layer_cells(lower: np.ndarray, upper: np.ndarray, simplex: bool) -> np.ndarray:
    """Cells between the facets of two faces, one on the other.

    A simplex is cut such that neighbours agree: the diagonal of a side runs from the vertex whose
    number in ``lower`` is less to the other's above.

    Args:
        lower: Vertices of edges, triangles or quadrilaterals, shape (n, n_corners).
        upper: Those opposite, each over the one below.
        simplex: Whether the cells are triangles or tetrahedra, from edges and triangles, two and
            three for each; otherwise they are quadrilaterals or hexahedra.

    Returns:
        Vertices in DOLFINx's order, those of one facet after the other; of any orientation.
    """
    if not simplex:
        return np.hstack([lower, upper])
    order = np.argsort(lower, axis=1)
    low, high = (np.take_along_axis(x, order, axis=1) for x in (lower, upper))
    n = lower.shape[1]
    cells = [np.hstack([low[:, : n - k], high[:, n - k - 1 :]]) for k in range(n)]
    return np.stack(cells, axis=1).reshape(-1, n + 1)


def oriented(cell: str, x: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """The same cells, all with a positive volume."""
    ends, mirrored = _SPANS[cell]
    corners = x[cells]
    inside_out = np.linalg.det(corners[:, ends] - corners[:, :1]) < 0
    return np.where(inside_out[:, None], cells[:, mirrored], cells)


class Bodies:
    """The vertices of a mesh whose bodies share none.

    Args:
        lists: The mesh, whose bodies share vertices where they touch.
        body: Body of each cell from 0, shape (n_cells,).

    Attributes:
        x: Vertices, one for each body that has it, m, shape (n, gdim).
        body: Body of each vertex, shape (n,).
        cells: Vertices of the cells, in the order of the mesh.
    """

    def __init__(self, lists: MeshLists, body: np.ndarray):
        self._lists, self._of_cell, self._n = lists, body, int(body.max()) + 1
        pairs, inverse = np.unique(lists.cells * self._n + body[:, None], return_inverse=True)
        self._pairs, self.body = pairs, pairs % self._n
        self.x, self.cells = lists.x[pairs // self._n], inverse.reshape(lists.cells.shape)

    def own(self, body: int | np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Rows of the mesh's vertices as a body has them; one body for all rows, or for each."""
        return np.searchsorted(self._pairs, rows * self._n + np.reshape(body, (-1, 1)))

    def lists(self) -> MeshLists:
        """The mesh; a tagged facet between two bodies goes to the first of them."""
        lists = replace(self._lists, x=self.x, cells=self.cells)
        if not len(lists.facets):
            return lists
        facets, cells = _sides(self._lists)
        numbers = row_numbers(np.vstack([facets, lists.facets]))
        owner = np.full(numbers.max() + 1, self._n)
        np.minimum.at(owner, numbers[: len(facets)], self._of_cell[cells])
        owner = owner[numbers[len(facets) :]]
        if np.any(owner == self._n):
            n = np.sum(owner == self._n)
            raise MeshError(f"{n} tagged facets are facets of no cell, expected facets of cells")
        return replace(lists, facets=self.own(owner, lists.facets))


def separate(
    lists: MeshLists,
    bodies: Iterable[str | Iterable[str]],
    faces: Mapping[tuple[str, str], tuple[str, str]],
) -> MeshLists:
    """Give each body vertices of its own where it touches another, and name the faces there.

    The two faces of an interface then coincide vertex by vertex and share none, which is what a
    contact needs. Facets keep their tags with their cell; a facet between two bodies that had a
    tag keeps it on the body that comes first, unless the interface has new names.

    Args:
        lists: The mesh, whose parts share vertices.
        bodies: The parts of each body, by name, or the name alone for a body of one part. Each
            part of the mesh is in one body; ``lists.cell_names`` makes each part a body.
        faces: For pairs of parts (a, b) of two bodies, the names of their faces towards each
            other, that of a and that of b.

    Returns:
        The mesh with the bodies separate. Coordinates and the order of the cells are unchanged.

    Raises:
        MeshError: A part is in no body, in two, or unknown; or the parts of a pair are in one
            body, or have no facet in common.
    """
    body_of = _body_of_part(lists, bodies)
    body = _body_of_cell(lists, body_of)
    between, cells = interfaces(lists, body)
    tags = np.sort(lists.cell_values[cells], axis=1)
    new: dict[str, list[tuple[str, np.ndarray]]] = {}
    renamed = [between[:0]]
    for pair, names in faces.items():
        rows = between[(tags == _tag_pair(lists, body_of, pair)).all(axis=1)]
        if not len(rows):
            raise MeshError(
                f"separate: faces has {pair!r}, expected parts that touch: they have no facet in "
                "common"
            )
        renamed.append(rows)
        for part, name in zip(pair, names, strict=True):
            new.setdefault(name, []).append((part, rows))
    numbers = row_numbers(np.vstack([lists.facets, *renamed]))
    keep = ~np.isin(numbers[: len(lists.facets)], numbers[len(lists.facets) :])
    kept = replace(lists, facets=lists.facets[keep], facet_values=lists.facet_values[keep])
    parted = Bodies(kept, body)
    return add_faces(
        parted.lists(),
        {
            name: np.vstack([parted.own(body_of[part], rows) for part, rows in found])
            for name, found in new.items()
        },
    )


def _body_of_part(lists: MeshLists, bodies: Iterable[str | Iterable[str]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for number, body in enumerate(bodies):
        for part in (body,) if isinstance(body, str) else body:
            if part not in lists.cell_names:
                known = ", ".join(sorted(lists.cell_names))
                raise MeshError(f"separate: bodies has {part!r}, expected parts of: {known}")
            if part in found:
                raise MeshError(f"separate: bodies has {part!r} twice, expected one body for it")
            found[part] = number
    return found


def _body_of_cell(lists: MeshLists, body_of: Mapping[str, int]) -> np.ndarray:
    present = set(np.unique(lists.cell_values).tolist())
    missing = [n for n, tag in lists.cell_names.items() if tag in present and n not in body_of]
    if missing:
        lost = ", ".join(missing)
        raise MeshError(f"separate: bodies lacks {lost}, expected each part in one body")
    return by_part(lists, body_of)


def _tag_pair(lists: MeshLists, body_of: Mapping[str, int], pair) -> list[int]:
    """Tags of two parts of two bodies, the lower first."""
    if not set(pair) <= set(body_of):
        known = ", ".join(sorted(body_of))
        raise MeshError(f"separate: faces has {pair!r}, expected two parts of: {known}")
    if body_of[pair[0]] == body_of[pair[1]]:
        raise MeshError(f"separate: faces has {pair!r}, expected parts of two bodies, not of one")
    return sorted(lists.cell_names[part] for part in pair)
