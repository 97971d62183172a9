"""Two sets of nodes as faces that touch: triangles, and the displacement jump between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog
from scipy.spatial import Delaunay, QhullError, cKDTree

from fenics_joints.errors import InputError
from fenics_joints.matrices.part import MatrixPart

#: Points in a triangle for products of linear functions, and their shares.
_INSIDE = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
#: Gauss' points in a parallelogram, along its edges from 0 to 1.
_GAUSS = [(0.5 + i / 12**0.5, 0.5 + j / 12**0.5) for i in (-1, 1) for j in (-1, 1)]
#: How far a face may stand off a plane, over its extent. [numerical: chosen]
_FLAT = 0.05
#: Distance between faces of nodes without rotations, over the spacing of nodes: farther apart they
#: would resist being turned together. [numerical: chosen]
_APART = 0.05
#: Distance from the other part's nodes, beyond the least, over the spacing of nodes, up to which a
#: node may be on the face: less than a layer of cells. [numerical: chosen]
_NEXT = 0.75
#: Distance from the plane, over the reach, up to which a node is on it; and how far nodes may be
#: beyond a plane between two parts, over their extent. [numerical: digits of files]
_ON_PLANE, _SLACK = 0.02, 1e-6
#: Triangles smaller than this share of the mean are round-off of nodes in line.
_SLIVER = 1e-6


class NodeInterface:
    """Where the faces of two parts touch.

    The nodes of each face are joined to triangles and parallelograms in the plane of both, which
    count if their nodes share elements, so that holes and notches stay open. Displacements are
    linear, or bilinear, in them.
    Where only one of the faces is, there is no interface.

    Args:
        first: A part.
        first_nodes: Nodes of its face, (n,), by their place among `MatrixPart.points`. Of several
            nodes of one number, as through the thickness of a shell, the nearest counts.
        second: Another part.
        second_nodes: Likewise.
        area: Area of the interface, m2, if it is known better than by the triangles.

    Attributes:
        jump: Displacement of the second face relative to the first, as rows over the DOFs of the
            first and then of the second part, (3 n, n_dofs): x, y, z at each point.
        points: Where, m, (n, 3).
        areas: Area that each point stands for, m2, (n,).
        normal: Unit normal, from the first part to the second, (3,).

    Raises:
        InputError: If the faces are not flat, do not overlap, or are apart.
    """

    def __init__(
        self,
        first: MatrixPart,
        first_nodes: Sequence[int],
        second: MatrixPart,
        second_nodes: Sequence[int],
        area: float | None = None,
    ):
        self.parts = first, second
        what = f"{first.name} and {second.name}"
        sets = [
            _among_moved(p, n) for p, n in zip(self.parts, (first_nodes, second_nodes), strict=True)
        ]
        sets = [_nearest_copies(p, own, q, other) for p, own, q, other in (
            (first, sets[0], second, sets[1]), (second, sets[1], first, sets[0]))]  # fmt: skip
        clouds = [p.points[own] for p, own in zip(self.parts, sets, strict=True)]
        both = np.vstack(clouds)
        middle = both.mean(axis=0)
        _, sizes, axes = np.linalg.svd(both - middle, full_matrices=False)
        self.normal = axes[2]
        towards = second.middle - first.middle
        if self.normal @ towards < 0:
            self.normal = -self.normal
        for part, cloud in zip(self.parts, clouds, strict=True):
            off = (cloud - cloud.mean(axis=0)) @ self.normal
            if np.ptp(off) > _FLAT * np.ptp(cloud, axis=0).max():
                raise InputError(f"{what}: the nodes of {part.name} are not on a flat face")
        flat = [(cloud - middle) @ axes[:2].T for cloud in clouds]
        faces = [_NodeFace(*each, what) for each in zip(self.parts, sets, flat, strict=True)]
        # The finer face carries the points, the other one is looked up.
        fine = int(faces[1].spacing < faces[0].spacing)
        own, other = faces[fine], faces[1 - fine]
        shares, nodes, at, weights = own.points_inside()
        there, found = other.at(at)
        shares, nodes, weights = (a[found] for a in (shares, nodes, weights))
        if not len(weights):
            raise InputError(
                f"{what}: the faces do not overlap: expected nodes of faces that touch"
            )
        #: Share of the finer face that is opposite the other one.
        self.covered = float(weights.sum() / own.area)
        rows = {fine: (nodes, shares), 1 - fine: (there[0][found], there[1][found])}
        places = [
            np.einsum("pk,pkc->pc", rows[k][1], self.parts[k].points[rows[k][0]]) for k in (0, 1)
        ]
        self.points = 0.5 * (places[0] + places[1])
        self.areas = weights if area is None else weights * (area / weights.sum())
        gap = np.abs((places[1] - places[0]) @ self.normal).max()
        spacing = max(own.spacing, other.spacing)
        for k, part in enumerate(self.parts):
            if gap > _APART * spacing and not part.turned[rows[k][0]].all():
                raise InputError(
                    f"{what}: the faces are {1e3 * gap:.3g} mm apart, and nodes of {part.name} "
                    "have no rotations: expected faces that touch, or a part of shells with its "
                    "thickness"
                )
        sides = [_moving(part, *rows[k], self.points) for k, part in enumerate(self.parts)]
        self.jump = sp.hstack([-sides[0], sides[1]], format="csr")

    @classmethod
    def between(
        cls, first: MatrixPart, second: MatrixPart, area: float | None = None
    ) -> NodeInterface:
        """The interface of two parts by their nodes on the plane on which they are nearest.

        Raises:
            InputError: As the class.
        """
        nodes = [part.moved for part in (first, second)]
        clouds = [part.points[own] for part, own in zip((first, second), nodes, strict=True)]
        reach = _NEXT * max(first.spacing, second.spacing)
        off = [cKDTree(clouds[1 - k]).query(clouds[k])[0] for k in (0, 1)]
        near = [cloud[each <= each.min() + reach] for cloud, each in zip(clouds, off, strict=True)]
        normal = _separating(*near)
        if normal is None:
            raise InputError(
                f"{first.name} and {second.name}: no plane is between them where they are near: "
                "expected the nodes of both faces"
            )
        sets = []
        for k, (cloud, own) in enumerate(zip(clouds, near, strict=True)):
            height, top = (((1 - 2 * k) * (x @ normal)) for x in (cloud, own))
            on = np.abs(height - top.max()) <= _ON_PLANE * reach
            sets.append(nodes[k][on])
        found = cls(first, sets[0], second, sets[1], area)
        found.covered = 1.0  # the nodes are those of all that is on the plane
        return found

    def __repr__(self) -> str:
        names = " and ".join(part.name for part in self.parts)
        return f"NodeInterface({names}, {1e6 * self.areas.sum():.4g} mm2)"

    def matrix(self, tensor: np.ndarray, which: np.ndarray | None = None) -> sp.csr_matrix:
        """The integral of jump . D jump over the interface, (n_dofs, n_dofs).

        Args:
            tensor: D, (3, 3).
            which: Mask of the points that count, (n,); None for all.
        """
        areas = self.areas if which is None else np.where(which, self.areas, 0.0)
        along = [self.jump[c::3] for c in range(3)]
        found = sp.csr_matrix((self.jump.shape[1],) * 2)
        for i in range(3):
            for j in range(3):
                if tensor[i, j]:
                    found = found + tensor[i, j] * (along[i].T @ sp.diags(areas) @ along[j])
        return sp.csr_matrix(0.5 * (found + found.T))


class _NodeFace:
    """Nodes of one part as triangles and parallelograms in a plane.

    Attributes:
        area: Its area, m2.
        spacing: Length of its edges, m: the median.
    """

    def __init__(self, part: MatrixPart, nodes: np.ndarray, flat: np.ndarray, what: str):
        self.nodes, self.flat = nodes, flat
        try:
            self._all = Delaunay(flat)
        except (QhullError, ValueError) as error:
            raise InputError(
                f"{what}: the {len(nodes)} nodes of {part.name} make no face: expected three or "
                "more that are not in line"
            ) from error
        corners = self._all.simplices
        linked = part.is_linked[nodes][:, nodes]
        sizes = _areas(flat[corners])
        real = sizes > _SLIVER * sizes.mean()
        for i, j in ((0, 1), (1, 2), (2, 0)):
            real &= np.asarray(linked[corners[:, i], corners[:, j]]).ravel() != 0
        if not real.any():
            raise InputError(
                f"{what}: no three of the nodes of {part.name} share an element: expected all "
                "nodes of a face"
            )
        self._is_real, self.area = real, float(sizes[real].sum())
        self.spacing = float(np.sqrt(2 * np.median(sizes[real])))
        self._pair(linked)
        self._sizes = sizes

    def _pair(self, linked: sp.csr_matrix) -> None:
        """Join triangles to parallelograms, faces of hexahedra: which diagonal parts one of these
        is left to chance."""
        corners, beside = self._all.simplices, self._all.neighbors
        #: Corners of the parallelograms, one after the other; and which of them a triangle is in.
        quads, self._quad = [], np.full(len(corners), -1)
        near = _SLIVER**0.5 * self.spacing
        for i, j in np.argwhere(beside >= 0):
            other = beside[i, j]
            if other < i or not self._is_real[[i, other]].all():
                continue
            if self._quad[i] >= 0 or self._quad[other] >= 0:
                continue
            one, (first, second) = corners[i, j], np.delete(corners[i], j)
            far = int(np.setdiff1d(corners[other], corners[i])[0])
            middle = self.flat[[one, far]].mean(axis=0) - self.flat[[first, second]].mean(axis=0)
            if linked[one, far] != 0 and np.abs(middle).max() < near:
                self._quad[[i, other]] = len(quads)
                quads.append((one, first, far, second))
        self._quads = np.array(quads, dtype=int).reshape(-1, 4)

    def points_inside(self):
        """Shares of four nodes (three and none of a triangle) at points of integration, the nodes,
        the places in the plane, and areas."""
        alone = self._is_real & (self._quad < 0)
        triangles = self._all.simplices[alone]
        own = np.column_stack([triangles, triangles[:, 0]])
        in_quad = np.array([_bilinear(*at) for at in _GAUSS])
        shares = [np.tile(np.pad(_INSIDE, [(0, 0), (0, 1)]), (len(own), 1))]
        shares.append(np.tile(in_quad, (len(self._quads), 1)))
        corners = np.vstack([np.repeat(own, 3, axis=0), np.repeat(self._quads, 4, axis=0)])
        shares = np.vstack(shares)
        twice = 2 * _areas(self.flat[self._quads[:, :3]])
        areas = np.concatenate([np.repeat(self._sizes[alone] / 3, 3), np.repeat(twice / 4, 4)])
        at = np.einsum("pk,pkc->pc", shares, self.flat[corners])
        return shares, self.nodes[corners], at, areas

    def at(self, places: np.ndarray):
        """Nodes and shares at places in the plane, and which of these are on the face."""
        number = self._all.find_simplex(places, tol=1e-6)
        found = (number >= 0) & self._is_real[number]
        turn = self._all.transform[number]
        two = np.einsum("pij,pj->pi", turn[:, :2], places - turn[:, 2])
        shares = np.column_stack([two, 1 - two.sum(axis=1), np.zeros(len(two))])
        corners = self._all.simplices[number]
        corners = np.column_stack([corners, corners[:, 0]])
        in_quad = found & (self._quad[number] >= 0)
        quads = self._quads[self._quad[number[in_quad]]]
        origin, first, _, second = self.flat[quads].swapaxes(0, 1)
        edges = np.stack([first - origin, second - origin], axis=2)
        local = np.linalg.solve(edges, (places[in_quad] - origin)[..., None])[..., 0]
        corners[in_quad] = quads
        shares[in_quad] = np.array(_bilinear(*local.T)).T.reshape(-1, 4)
        return (self.nodes[corners], shares), found


def _bilinear(s, t):
    """Shares of the corners of a parallelogram, one after the other."""
    return (1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t


def _separating(below: np.ndarray, above: np.ndarray) -> np.ndarray | None:
    """Unit normal of a plane between two clouds, towards the second; None if there is none.

    Of clouds that are apart it is the one with the widest margin; of clouds that touch, the one
    from which both are farthest on average.
    """
    middle = below.mean(axis=0)
    size = max(np.ptp(np.vstack([below, above]), axis=0).max(), 1e-300)
    a, b = (below - middle) / size, (above - middle) / size
    # Unknowns: the normal, the height of the plane, and the margin.
    rows = np.vstack([
        np.column_stack([a, -np.ones(len(a)), np.ones(len(a))]),
        np.column_stack([-b, np.ones(len(b)), np.ones(len(b))]),
    ])  # fmt: skip
    bounds = [(-1, 1)] * 3 + [(None, None), (-_SLACK, None)]
    for cost in ([0, 0, 0, 0, -1.0], [*(a.mean(axis=0) - b.mean(axis=0)), 0, 0]):
        found = linprog(cost, rows, np.zeros(len(rows)), bounds=bounds)
        normal = found.x[:3] if found.status == 0 else np.zeros(3)
        if np.linalg.norm(normal) > 0.1 and (cost[4] == 0 or found.x[4] > 10 * _SLACK):
            return normal / np.linalg.norm(normal)
        bounds[4] = (-_SLACK, -_SLACK)
    return None


def _areas(corners: np.ndarray) -> np.ndarray:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def _among_moved(part: MatrixPart, nodes: Sequence[int]) -> np.ndarray:
    nodes = np.unique(np.asarray(nodes, dtype=int))
    if len(nodes) and not (0 <= nodes[0] and nodes[-1] < len(part.points)):
        raise InputError(f"{part.name}: expected nodes from 0 to {len(part.points) - 1}")
    return nodes


def _nearest_copies(part: MatrixPart, own, other_part: MatrixPart, other) -> np.ndarray:
    """Of nodes with one number those that are nearest to the other face."""
    numbers = part.numbers[own]
    if len(np.unique(numbers)) == len(own) or not len(other):
        return own
    off = cKDTree(other_part.points[other]).query(part.points[own])[0]
    order = np.lexsort((off, numbers))
    first = np.ones(len(own), dtype=bool)
    first[1:] = np.diff(numbers[order]) != 0
    return np.sort(own[order[first]])


def _moving(part: MatrixPart, nodes: np.ndarray, shares: np.ndarray, points: np.ndarray):
    """Displacement of a part at points on an interface, rows over its DOFs, (3 n, n_dofs)."""
    n = len(points)
    rows, columns, values = [], [], []
    first = 3 * np.arange(n)

    def put(c: int, columns_of: np.ndarray, amount: np.ndarray) -> None:
        there = (columns_of >= 0) & (amount != 0)
        rows.append((first + c)[there]), columns.append(columns_of[there])
        values.append(amount[there])

    for k in range(shares.shape[1]):
        node, share = nodes[:, k], shares[:, k]
        arm = points - part.points[node]
        for c in range(3):
            put(c, part.rows[node, c], share)
        for turn in range(3):
            spun = np.cross(np.eye(3)[turn], arm)
            for c in range(3):
                put(c, part.rows[node, 3 + turn], share * spun[:, c] * part.turned[node])
    flat = (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_matrix((np.concatenate(values), flat), shape=(3 * n, len(part.dofs)))


def face_of(part: MatrixPart, nodes: Sequence[int]) -> list[sp.csr_matrix]:
    """Matrices of springs of 1 Pa/m spread over a face, across it and along it, (n_dofs, n_dofs).

    Raises:
        InputError: If the nodes make no flat face.
    """
    nodes = np.unique(np.asarray(nodes, dtype=int))
    cloud = part.points[nodes]
    middle = cloud.mean(axis=0)
    axes = np.linalg.svd(cloud - middle, full_matrices=False)[2]
    face = _NodeFace(part, nodes, (cloud - middle) @ axes[:2].T, part.name)
    shares, own, _, weights = face.points_inside()
    places = np.einsum("pk,pkc->pc", shares, part.points[own])
    moving, areas = _moving(part, own, shares, places), sp.diags(np.repeat(weights, 3))
    whole = moving.T @ areas @ moving
    across = sum(axes[2][c] * moving[c::3] for c in range(3))
    normal = across.T @ sp.diags(weights) @ across
    return [sp.csr_matrix(normal), sp.csr_matrix(whole - normal)]
