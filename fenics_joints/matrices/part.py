"""A part given by its stiffness and mass matrices, and where its nodes are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from fenics_joints.errors import InputError, reals, text

#: Translations and rotations that a node may have.
WAYS = 6
#: Relative difference of a matrix from its transpose that files with few digits leave.
_SYMMETRIC = 1e-6
#: Nodes through which a displacement between nodes is fitted, a patch of a surface or of a body;
#: and how many, the nearest of a node, say how far apart nodes are. [numerical: chosen]
_AROUND, _BESIDE = 16, 6
#: Distance from the nearest node, over the spacing of nodes there, up to which a point is on the
#: part. [numerical: chosen]
_REACH = 1.5


class MatrixPart:
    """A part by its stiffness and mass matrices, as another code exported them.

    Args:
        name: Its name.
        stiffness: K, symmetric, (n, n), sparse or dense. With displacements in metres N/m, of
            rotations N m.
        mass: M, likewise, kg and kg m2.
        points: Places of the nodes, m, (n_nodes, 3).
        dofs: Of each row its node and its direction, (n, 2): 0 to 2 a translation along x, y, z,
            3 to 5 a rotation about them, radians; a direction of -1 is a coordinate of a
            superelement that is no displacement of a node.
        numbers: What the other code calls the nodes, (n_nodes,); by default 0, 1, 2, ...

    Raises:
        InputError: If sizes do not match, a matrix is not symmetric or has nan, or two rows are of
            the same node and direction.
    """

    def __init__(
        self,
        name: str,
        stiffness: ArrayLike,
        mass: ArrayLike,
        points: ArrayLike,
        dofs: ArrayLike,
        numbers: Sequence[int] | None = None,
    ):
        self.name = text("name", name)
        self.points = np.atleast_2d(reals(f"{name}.points", points, unit="m"))
        if self.points.ndim != 2 or self.points.shape[1] != 3 or not len(self.points):
            raise InputError(f"{name}.points: has shape {self.points.shape}, expected (n_nodes, 3)")
        self.dofs = np.asarray(dofs, dtype=int)
        if self.dofs.ndim != 2 or self.dofs.shape[1] != 2:
            raise InputError(f"{name}.dofs: has shape {self.dofs.shape}, expected (n, 2)")
        self.stiffness = _checked(f"{name}.stiffness", stiffness, len(self.dofs))
        self.mass = _checked(f"{name}.mass", mass, len(self.dofs))
        self.numbers = np.arange(len(self.points)) if numbers is None else np.asarray(numbers)
        if len(self.numbers) != len(self.points):
            raise InputError(
                f"{name}.numbers: {len(self.numbers)} for {len(self.points)} nodes: expected one "
                "for each"
            )
        node, way = self.dofs.T
        own = way >= 0
        if np.any((node[own] < 0) | (node[own] >= len(self.points)) | (way[own] >= WAYS)):
            raise InputError(
                f"{name}.dofs: expected nodes from 0 to {len(self.points) - 1} and directions from "
                "0 to 5, or -1"
            )
        #: Row of each node and direction, (n_nodes, 6); -1 where there is none.
        self.rows = np.full((len(self.points), WAYS), -1)
        rows = np.flatnonzero(own)
        self.rows[node[own], way[own]] = rows
        if np.count_nonzero(self.rows >= 0) < len(rows):
            raise InputError(f"{name}.dofs: expected each node and direction once")

    def __repr__(self) -> str:
        return f"MatrixPart({self.name!r}, {len(self.points)} nodes, {len(self.dofs)} DOFs)"

    def scale(self, stiffness: float, mass: float) -> None:
        """Multiply the matrices, in place."""
        self.stiffness, self.mass = stiffness * self.stiffness, mass * self.mass

    @cached_property
    def moved(self) -> np.ndarray:
        """Nodes that have all three translations, in order."""
        return np.flatnonzero(np.all(self.rows[:, :3] >= 0, axis=1))

    @cached_property
    def turned(self) -> np.ndarray:
        """Whether each node has all three rotations, (n_nodes,)."""
        return np.all(self.rows[:, 3:] >= 0, axis=1)

    @cached_property
    def _tree(self) -> cKDTree:
        if not len(self.moved):
            raise InputError(f"{self.name}: no node has all three translations")
        return cKDTree(self.points[self.moved])

    @cached_property
    def spacing(self) -> float:
        """Distance between neighbouring nodes, m: the median; of shells, whose nodes are several
        through the thickness, that along them."""
        count = min(_BESIDE + 1, len(self.moved))
        apart = self._tree.query(self.points[self.moved], k=count)[0]
        return float(np.median(apart.reshape(-1, count)[:, -1]))

    @cached_property
    def is_linked(self) -> sp.csr_matrix:
        """Which nodes share an element: those between which K has entries, (n_nodes, n_nodes)."""
        own = np.flatnonzero(self.dofs[:, 1] >= 0)
        n = len(self.points)
        place = sp.csr_matrix(
            (np.ones(len(own)), (self.dofs[own, 0], own)), shape=(n, len(self.dofs))
        )
        pattern = self.stiffness.copy()
        pattern.data = np.ones_like(pattern.data)
        return (place @ pattern @ place.T).tocsr()

    def rigid_motion(self, point: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
        """The six motions as a rigid body, about a point, (n, 6); rows that are no displacement
        of a node stay at rest."""
        off = self.points - np.asarray(point, dtype=float)
        found, axes = np.zeros((len(self.dofs), 6)), np.eye(3)
        node, way = self.dofs.T
        for k in range(3):
            spun = np.cross(axes[k], off)
            for c in range(3):
                at = way == c
                found[at, k] = axes[k, c]
                found[at, 3 + k] = spun[node[at], c]
            found[way == 3 + k, 3 + k] = 1.0
        return found

    @property
    def total_mass(self) -> float:
        """Mass, kg: twice the kinetic energy of a translation at 1 m/s along x."""
        x = self.rigid_motion()[:, 0]
        return float(x @ self.mass @ x)

    @cached_property
    def middle(self) -> np.ndarray:
        """Mean place of the nodes that move, m, (3,)."""
        return self.points[self.moved].mean(axis=0)

    def distance(self, point: np.ndarray) -> tuple[float, float]:
        """Distance of a point from what its nearest nodes span, m, and from the nearest node."""
        near, which = self._tree.query(point, k=min(_AROUND, len(self.moved)))
        off = (self.points[self.moved[np.atleast_1d(which)]] - point) / max(self.spacing, 1e-9)
        # Shares of the nodes, none negative, whose sum is one: a row that weighs much.
        system = np.vstack([off.T, np.full(len(off), 1e3)])
        rest = nnls(system, np.array([0.0, 0.0, 0.0, 1e3]))[1]
        return float(np.round(rest, 6)) * max(self.spacing, 1e-9), float(np.min(near))

    def displacement(self, points: ArrayLike) -> sp.csr_matrix:
        """Displacement at points, as rows over the DOFs, (3 n_points, n): x, y, z of each.

        At a node it is the node's. Near a node with rotations it is that of a rigid arm to the
        node; elsewhere that of a linear field through the nearest nodes.

        Args:
            points: m, (n_points, 3).

        Raises:
            InputError: If a point is not on the part.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        near, which = self._tree.query(points, k=min(_AROUND, len(self.moved)))
        near, which = near.reshape(len(points), -1), which.reshape(len(points), -1)
        rows, columns, values = [], [], []

        def put(row: int, column: int, value: float) -> None:
            if column >= 0 and value:
                rows.append(row), columns.append(column), values.append(value)

        size = max(np.ptp(self.points, axis=0).max(), 1e-12)
        for i, point in enumerate(points):
            nodes, weights = self.moved[which[i]], np.zeros(0)
            node = nodes[0]
            if near[i, 0] > _REACH * self.spacing + 1e-9 * size:
                at = ", ".join(f"{1e3 * c:g}" for c in self.points[node])
                raise InputError(
                    f"{self.name}: ({', '.join(f'{1e3 * c:g}' for c in point)}) mm is "
                    f"{1e3 * near[i, 0]:.3g} mm from the nearest node, at ({at}) mm: expected a "
                    f"point on the part, whose nodes are {1e3 * self.spacing:.3g} mm apart"
                )
            arm = point - self.points[node]
            if near[i, 0] <= 1e-9 * size or self.turned[node]:
                nodes, weights = nodes[:1], np.ones(1)
            else:
                # Exact at linear fields, of a flat patch at those in its plane; near nodes count
                # most.
                off = (self.points[nodes] - point) / self.spacing
                root = 1 / np.sqrt(np.sum(off**2, axis=1) + 0.01)
                system = root * np.vstack([np.ones(len(nodes)), off.T])
                weights = root * np.linalg.pinv(system, rcond=1e-6)[:, 0]
            for c in range(3):
                for one, weight in zip(nodes, weights, strict=True):
                    put(3 * i + c, self.rows[one, c], weight)
            if self.turned[node] and len(nodes) == 1:
                for k in range(3):
                    for c, value in enumerate(np.cross(np.eye(3)[k], arm)):
                        put(3 * i + c, self.rows[node, 3 + k], value)
        shape = 3 * len(points), len(self.dofs)
        return sp.csr_matrix((values, (rows, columns)), shape=shape)


def _checked(where: str, matrix, n: int) -> sp.csr_matrix:
    """A symmetric matrix, exactly so."""
    found = sp.csr_matrix(matrix, dtype=float)
    if found.shape != (n, n):
        raise InputError(f"{where}: has shape {found.shape}, expected ({n}, {n}), as dofs has {n}")
    if not np.isfinite(found.data).all():
        raise InputError(f"{where}: has nan or infinite entries")
    size = np.abs(found.data).max(initial=0.0)
    rest = found - found.T
    if np.abs(rest.data).max(initial=0.0) > _SYMMETRIC * size:
        raise InputError(f"{where}: is not symmetric")
    if not size:
        raise InputError(f"{where}: has no entries")
    return sp.csr_matrix(0.5 * (found + found.T))
