"""Parts of one mesh made separate bodies: vertices of their own, and a name for each face."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.meshes.skin import FACETS, add_faces, row_numbers
from fenics_joints.meshes.tagged import MeshLists


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
    groups = [(body,) if isinstance(body, str) else tuple(body) for body in bodies]
    body_of_part = _body_of_part(lists, groups)
    body = _body_of_cell(lists, body_of_part)
    n_bodies = len(groups)
    # A new vertex for each pair of a vertex and a body.
    pairs, inverse = np.unique(lists.cells * n_bodies + body[:, None], return_inverse=True)
    cells = inverse.reshape(lists.cells.shape)
    shared = np.bincount(pairs // n_bodies, minlength=len(lists.x)) > 1
    seam = _Seam(lists, body, shared)
    sides = {
        names: seam.between(_tag_pair(lists, body_of_part, pair)) for pair, names in faces.items()
    }
    for (a, b), (rows, _) in zip(faces, sides.values(), strict=True):
        if len(rows) == 0:
            raise MeshError(
                f"separate: faces has ({a!r}, {b!r}), expected parts that touch: they "
                "have no facet in common"
            )
    renamed = np.concatenate([np.empty(0, np.int64)] + [rows[0] for rows in sides.values()])
    keep = ~np.isin(seam.tagged_number, seam.number[renamed])
    owner = seam.body_of_tagged(body)[keep]
    facets = np.searchsorted(pairs, lists.facets[keep] * n_bodies + owner[:, None])
    parted = replace(
        lists,
        x=lists.x[pairs // n_bodies],
        cells=cells,
        facets=facets,
        facet_values=lists.facet_values[keep],
    )
    corners = FACETS[lists.cell]
    new = {}
    for names, rows in sides.items():
        for name, row in zip(names, rows, strict=True):
            found = cells[seam.cell[row, None], corners[seam.side[row]]]
            new[name] = np.vstack([new[name], found]) if name in new else found
    return add_faces(parted, new)


class _Seam:
    """The facets of cells all of whose vertices several bodies share.

    Attributes:
        cell, side: Cell of each such facet, and which of the cell's facets it is.
        number: Number of each such facet, the same for the two cells that have it.
        tagged_number: Number of each tagged facet, in the same numbering.
    """

    def __init__(self, lists: MeshLists, body: np.ndarray, shared: np.ndarray):
        self._lists, self._shared = lists, shared
        corners = lists.cells[:, FACETS[lists.cell]]
        self.cell, self.side = np.nonzero(shared[corners].all(axis=2))
        rows = corners[self.cell, self.side]
        numbers = row_numbers(np.vstack([rows, lists.facets]))
        self.number, self.tagged_number = numbers[: len(rows)], numbers[len(rows) :]
        self._order = np.lexsort([body[self.cell], self.number])
        self._body = body[self.cell]

    def between(self, tags: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the facets between two parts: as the first part has them, and the second."""
        order = self._order
        a, b = order[:-1], order[1:]
        apart = (self.number[a] == self.number[b]) & (self._body[a] != self._body[b])
        a, b = a[apart], b[apart]
        tag = self._lists.cell_values[self.cell]
        ahead = (tag[a] == tags[0]) & (tag[b] == tags[1])
        behind = (tag[a] == tags[1]) & (tag[b] == tags[0])
        return np.append(a[ahead], b[behind]), np.append(b[ahead], a[behind])

    def body_of_tagged(self, body: np.ndarray) -> np.ndarray:
        """Body of each tagged facet: that of its unshared vertices, or else of its cell."""
        lists, facets = self._lists, self._lists.facets
        of_vertex = np.zeros(len(lists.x), dtype=np.int64)
        of_vertex[lists.cells] = body[:, None]
        known = ~self._shared[facets]
        owner = of_vertex[np.take_along_axis(facets, known.argmax(axis=1)[:, None], axis=1)[:, 0]]
        # Of two cells that have the facet the first body's counts, the last that is written.
        of_number = np.full(int(self._top()), -1)
        back = self._order[::-1]
        of_number[self.number[back]] = self._body[back]
        owner = np.where(known.any(axis=1), owner, of_number[self.tagged_number])
        if np.any(owner < 0):
            raise MeshError(f"separate: {np.sum(owner < 0)} tagged facets are facets of no cell")
        return owner

    def _top(self) -> int:
        return max(self.number.max(initial=-1), self.tagged_number.max(initial=-1)) + 1


def _body_of_part(lists: MeshLists, groups: list[tuple[str, ...]]) -> dict[str, int]:
    found: dict[str, int] = {}
    for number, group in enumerate(groups):
        for part in group:
            if part not in lists.cell_names:
                known = ", ".join(sorted(lists.cell_names))
                raise MeshError(f"separate: bodies has {part!r}, expected parts of: {known}")
            if part in found:
                raise MeshError(f"separate: bodies has {part!r} twice, expected one body for it")
            found[part] = number
    return found


def _body_of_cell(lists: MeshLists, body_of_part: dict[str, int]) -> np.ndarray:
    body = np.full(int(lists.cell_values.max()) + 1, -1)
    for part, number in body_of_part.items():
        tag = lists.cell_names[part]
        if tag < len(body):
            body[tag] = number
    of_cell = body[lists.cell_values]
    if np.any(of_cell < 0):
        lost = set(np.unique(lists.cell_values[of_cell < 0]).tolist())
        named = [name for name, tag in lists.cell_names.items() if tag in lost]
        missing = ", ".join(named or map(str, sorted(lost)))
        raise MeshError(f"separate: bodies lacks {missing}, expected each part in one body")
    return of_cell


def _tag_pair(lists, body_of_part, pair) -> tuple[int, int]:
    for part in pair:
        if part not in body_of_part:
            known = ", ".join(sorted(body_of_part))
            raise MeshError(f"separate: faces has {pair!r}, expected two parts of: {known}")
    a, b = pair
    if body_of_part[a] == body_of_part[b]:
        raise MeshError(f"separate: faces has {pair!r}, expected parts of two bodies, not of one")
    return lists.cell_names[a], lists.cell_names[b]
