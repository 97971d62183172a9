"""In which directions a part of a mesh is thin: the edges of the least box around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from fenics_joints._compat import geometry_dofmap
from fenics_joints.meshes.tagged import TaggedMesh

#: Most extent, as a share of the next larger one, of a direction in which a body is thin. Chosen:
#: what is thicker has two thicknesses that a test could mean.
_CLEARLY = 2 / 3
#: Sine of the angle below which a direction is an axis, and share by which extents are equal:
#: round-off of mesh files.
_SAME = 1e-6
#: Decimals of the normals of a hull's faces beyond which they are round-off.
_DIGITS = 9


@dataclass(frozen=True)
class BoxAround:
    """A box around a body, turned so that it is as flat as can be, and then as narrow.

    Attributes:
        axes: Unit vectors along the least, the middle and the largest extent, shape (3, 3).
        extents: Those extents, m, shape (3,).
    """

    axes: np.ndarray
    extents: np.ndarray

    @property
    def is_slender(self) -> bool:
        """Whether the body is a plate or a beam that is flat in one direction, and no block."""
        return bool(self.extents[0] <= _CLEARLY * self.extents[1])


def box_around(tagged: TaggedMesh, cells: Sequence[str]) -> BoxAround:
    """The box around groups of cells of a mesh in space. Collective.

    The least distance of two parallel planes with the body between them is found with one of them
    on a face of the convex hull, as it is for plates and prisms; likewise the width across it.

    Args:
        tagged: The mesh.
        cells: Names of the groups.
    """
    found = np.concatenate([tagged.cell_tags.find(tagged.cell_tag(name)) for name in cells])
    nodes = np.unique(geometry_dofmap(tagged.mesh)[found])
    points = _outermost(tagged.mesh.geometry.x[nodes])
    points = _outermost(np.concatenate(tagged.mesh.comm.allgather(points)))
    try:
        normal = _flattest(points, ConvexHull(points).equations[:, :3])
    except QhullError:  # a body without volume, which is refused elsewhere
        return BoxAround(np.eye(3), np.ptp(points, axis=0).max() * np.ones(3))
    plane = np.linalg.svd(normal[None])[2][1:]
    flat = points @ plane.T
    across = _flattest(flat, ConvexHull(flat).equations[:, :2]) @ plane
    axes = np.array([_towards(normal), _towards(across), np.cross(normal, across)])
    return BoxAround(axes, np.ptp(points @ axes.T, axis=0))


def _outermost(points: np.ndarray) -> np.ndarray:
    """The corners of the convex hull; all points where there are too few for one, or all flat."""
    if len(points) < 5:
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def _flattest(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The direction along which points extend least; an axis if several are equal."""
    normals = np.unique(np.round(normals, _DIGITS) + 0.0, axis=0)
    extents = np.ptp(points @ normals.T, axis=0)
    least = normals[extents <= extents.min() * (1 + _SAME)]
    best = least[np.argmax(np.abs(least).max(axis=1))]
    return best / np.linalg.norm(best)


def _towards(direction: np.ndarray) -> np.ndarray:
    """The direction with its largest component above zero; an axis if it is one up to round-off."""
    largest = np.argmax(np.abs(direction))
    rounded = np.where(np.abs(direction) < _SAME, 0.0, direction)
    return rounded * np.sign(direction[largest]) / np.linalg.norm(rounded) + 0.0
