"""Opening a glued mesh at its contacts, and building layers of cells into the openings.

All lengths are in millimetres; see `fenics_joints.meshes.cad_shapes`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.meshes.cad_glue import Glued, Interface
from fenics_joints.meshes.cad_shapes import Contact

#: Thickness of a layer that moves nothing as a share of the smallest extent of the parts, and its
#: most as a share of the shortest edge of a cell, so that none is turned inside out.
_THIN, OF_EDGE = 1e-4, 0.1


class Opened:
    """The vertices of a glued mesh, one for each solid or layer that has it.

    Solids that are one body keep their common vertices; others have their own and move apart.

    Args:
        glued: The glued mesh.
        body: Body of each solid, shape (n_solids,).
        moves: How far each body moves, shape (n_bodies, 3).

    Attributes:
        x: Vertices, shape (n, 3).
        cells: The solids' tetrahedra, shape (n_cells, 4).
    """

    def __init__(self, glued: Glued, body: Sequence[int], moves: np.ndarray):
        self._body = np.asarray(body)
        self._n_bodies = len(moves)
        of_cell = self._body[glued.solid]
        pairs, inverse = np.unique(
            glued.cells * self._n_bodies + of_cell[:, None], return_inverse=True
        )
        self._pairs = pairs
        self.x = glued.x[pairs // self._n_bodies] + moves[pairs % self._n_bodies]
        self.cells = inverse.reshape(glued.cells.shape)

    def side(self, interface: Interface, upper: int) -> np.ndarray:
        """An interface's triangles as the lower (0) or the upper (1) solid has them."""
        return self.of(interface.solids[upper], interface.triangles)

    def of(self, solid: int | np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """Vertices of the glued mesh as a solid has them."""
        body = np.asarray(self._body[solid])
        body = body[..., None] if body.ndim else body
        return np.searchsorted(self._pairs, vertices * self._n_bodies + body)

    def spread(self, interfaces: Sequence[Interface], apart: np.ndarray) -> None:
        """Move the sides of interfaces apart, each by half of ``apart``, shape (3,)."""
        for upper, way in ((0, -0.5), (1, 0.5)):
            sides = [self.side(i, upper) for i in interfaces]
            self.x[np.unique(np.vstack(sides))] += way * apart

    def layer(self, interfaces: Sequence[Interface], n_layer: int) -> np.ndarray:
        """Fill what is open between the sides of interfaces; adds vertices where n_layer > 1.

        Args:
            interfaces: Of one pair of solids.
            n_layer: Cells through the layer.

        Returns:
            Tetrahedra, shape (n, 4).
        """
        lower = np.vstack([self.side(i, 0) for i in interfaces])
        upper = np.vstack([self.side(i, 1) for i in interfaces])
        flat, first = np.unique(lower, return_index=True)
        above = upper.ravel()[first]
        levels = [lower]
        for k in range(1, n_layer):
            share = k / n_layer
            new = len(self.x) + np.searchsorted(flat, lower)
            self.x = np.vstack([self.x, (1 - share) * self.x[flat] + share * self.x[above]])
            levels.append(new)
        levels.append(upper)
        cells = [
            prisms_to_tetrahedra(a, b, lower) for a, b in zip(levels[:-1], levels[1:], strict=True)
        ]
        return np.vstack(cells)

    def turned(self, cells: np.ndarray) -> np.ndarray:
        """The same tetrahedra, all with a positive volume."""
        x = self.x[cells]
        volume = np.linalg.det(x[:, 1:] - x[:, :1])
        cells = cells.copy()
        cells[volume < 0] = cells[volume < 0][:, [0, 1, 3, 2]]
        return cells


def thin_layer(smallest: float, edge: float) -> float:
    """Thickness of a layer that moves nothing.

    Args:
        smallest: Least extent of the parts.
        edge: Shortest edge of the mesh.
    """
    return min(_THIN * smallest, OF_EDGE * edge)


def open_thin(
    opened: Opened, solid: np.ndarray, filled: Sequence[Interface], contacts: Sequence[Contact]
) -> float:
    """Open interfaces by a thin layer, or as far as their contact has a gap; the thickness.

    Args:
        opened: The mesh, with the gaps of the file.
        solid: Solid of each cell, shape (n_cells,).
        filled: The interfaces.
        contacts: The contact that each is on.
    """
    x = opened.x[opened.cells]
    edges = np.linalg.norm(x[:, [0, 0, 0, 1, 1, 2]] - x[:, [1, 2, 3, 2, 3, 3]], axis=2)
    touching = {number for i in filled for number in i.solids}
    smallest = min(np.ptp(x[solid == number], axis=(0, 1)).min() for number in touching)
    thin = thin_layer(float(smallest), float(edges.min()))
    for contact in {id(contact): contact for contact in contacts}.values():
        here = [i for i, own in zip(filled, contacts, strict=True) if own is contact]
        if contact.gap < thin:
            opened.spread(here, (thin - contact.gap) * contact.normal)
    return thin


def prisms_to_tetrahedra(bottom, top, order):
    from fenics_joints.meshes.facets import layer_cells

    return layer_cells(bottom, top, True)
