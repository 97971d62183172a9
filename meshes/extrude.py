"""Plane quadrilaterals extruded into columns of hexahedra or tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenics_joints.meshes.plane import cut_quads


@dataclass
class Extrusion:
    """Columns over a plane mesh: which cells exist, and which facets have a name.

    Vertex ``p`` of the plane at level ``k`` has the number ``p * len(z) + k``. A column is cut into
    hexahedra; or into tetrahedra, along the shorter diagonal of each plane cell, and upright along
    the diagonals that rise from the lower plane vertex number to the higher one. Neighbours see the
    same diagonal, so the cut conforms.

    Attributes:
        points: Plane vertices, shape (n_points, 2), in metres.
        quads: Plane cells (v00, v10, v01, v11), anticlockwise as v00, v10, v11, v01,
            shape (n_quads, 4).
        z: Levels, ascending, shape (n_levels,), in metres.
        values: Tag of each cell, 0 where there is none, shape (n_levels - 1, n_quads).
        cell: ``"hexahedron"`` or ``"tetrahedron"``.
    """

    points: np.ndarray
    quads: np.ndarray
    z: np.ndarray
    values: np.ndarray
    cell: str = "hexahedron"
    _facets: list[np.ndarray] = field(default_factory=list)
    _facet_values: list[np.ndarray] = field(default_factory=list)

    def tag_level(self, level: int, mask: np.ndarray, value: int) -> None:
        """Tag the facets at ``level`` of the plane cells in ``mask`` with ``value``."""
        base = self.quads[mask]
        if self.cell == "tetrahedron":
            base = cut_quads(self.points, base).reshape(-1, 3)
        self._tag(self._lift(base, np.full(len(base), level)), value)

    def tag_wall(self, edges: np.ndarray, layers: np.ndarray, value: int) -> None:
        """Tag the upright facets over plane edges.

        Args:
            edges: Plane vertices of each edge, shape (n_edges, 2).
            layers: Numbers of the layers of cells that the wall passes, shape (n_layers,).
            value: Tag.
        """
        edges = np.sort(edges, axis=1)
        a, b = np.repeat(edges, len(layers), axis=0).T
        low = np.tile(layers, len(edges))
        n = len(self.z)
        a, b = a * n + low, b * n + low
        if self.cell == "hexahedron":
            self._tag(np.stack([a, b, a + 1, b + 1], axis=1), value)
        else:
            self._tag(np.stack([a, b, b + 1], axis=1), value)
            self._tag(np.stack([a, a + 1, b + 1], axis=1), value)

    def lists(self) -> tuple[np.ndarray, ...]:
        """Return x, cells, cell_values, facets, facet_values, without unused vertices."""
        layer, quad = np.nonzero(self.values)
        if self.cell == "hexahedron":
            cells = self._lift(self.quads[quad], layer)
            cells = np.hstack([cells, cells + 1])
            values = self.values[layer, quad]
        else:
            cells = self._tetrahedra(layer, quad)
            values = np.repeat(self.values[layer, quad], 6)
        corners = 4 if self.cell == "hexahedron" else 3
        facets = np.vstack(self._facets) if self._facets else np.empty((0, corners), np.int64)
        facet_values = np.concatenate(self._facet_values or [np.empty(0, np.int32)])
        return *self._compress(cells, values, facets), facet_values

    def _compress(self, cells, values, facets):
        used = np.zeros(len(self.points) * len(self.z), dtype=bool)
        used[cells] = True
        number = np.cumsum(used) - 1
        point, level = np.divmod(np.flatnonzero(used), len(self.z))
        x = np.column_stack([self.points[point], self.z[level]])
        return x, number[cells], values, number[facets]

    def _lift(self, base: np.ndarray, level: np.ndarray) -> np.ndarray:
        return base * len(self.z) + level[:, None]

    def _tag(self, facets: np.ndarray, value: int) -> None:
        self._facets.append(facets)
        self._facet_values.append(np.full(len(facets), value, dtype=np.int32))

    def _tetrahedra(self, layer: np.ndarray, quad: np.ndarray) -> np.ndarray:
        triangles = cut_quads(self.points, self.quads[quad]).reshape(-1, 3)
        # Sorting may turn a triangle over, and each tetrahedron with it; remember which.
        turns = np.argsort(triangles, axis=1)
        odd = ((turns[:, 1] - turns[:, 0]) % 3) == 2
        a, b, c = self._lift(np.sort(triangles, axis=1), np.repeat(layer, 2)).T
        tets = np.stack(
            [
                np.stack([a, b, c, c + 1], axis=1),
                np.stack([a, b + 1, b, c + 1], axis=1),
                np.stack([a, a + 1, b + 1, c + 1], axis=1),
            ],
            axis=1,
        )
        tets[odd] = tets[odd][:, :, [0, 2, 1, 3]]
        return tets.reshape(-1, 4)
