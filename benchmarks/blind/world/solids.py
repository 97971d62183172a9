"""Solid meshes of a rig's two bodies (gmsh) and their matrices (dolfinx, quadratic tetrahedra)."""

from __future__ import annotations

from collections.abc import Callable

import basix.ufl
import gmsh
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy import sparse
from scipy.spatial import cKDTree

from .rigs import Rig

_FLAT = 1e-7  # m, of a vertex on a plane
_STEEL = (200e9, 0.3)


class Body:
    """One body with the heads on it: a mesh of its own, and its matrices.

    Attributes:
        mesh: The mesh; its coordinates move with `deform`.
        reference: Its coordinates as built, (n, 3).
        is_head: Whether a cell belongs to a head or nut.
        centres: Centres of the cells as built, (n_cells, 3).
        n_dofs: Unknowns.
    """

    def __init__(self, points: np.ndarray, tets: np.ndarray, is_head: np.ndarray, rig: Rig):
        element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
        self.mesh = mesh.create_mesh(
            MPI.COMM_SELF, cells=tets.astype(np.int64), x=points, e=ufl.Mesh(element)
        )
        order = np.asarray(self.mesh.topology.original_cell_index)
        self.is_head = is_head[order]
        self.reference = self.mesh.geometry.x.copy()
        geometry = self.mesh.geometry  # of one kind of cells, which 0.11 wants said
        corners = geometry.dofmaps[0] if hasattr(geometry, "cmaps") else geometry.dofmap
        self.centres = self.reference[corners].mean(axis=1)
        self._corners = np.asarray(corners)
        self.space = fem.functionspace(self.mesh, ("Lagrange", 2, (3,)))
        nodes = self.space.tabulate_dof_coordinates()
        self._tree = cKDTree(nodes)
        self.n_dofs = 3 * len(nodes)
        self.rig = rig
        self._forms()
        self.head_volume = float(self._volumes()[self.is_head].sum())

    def _forms(self) -> None:
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        constants = fem.functionspace(self.mesh, ("DG", 0))
        self.E, self.nu, self.rho = (fem.Function(constants) for _ in range(3))
        lmbda = self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))
        mu = self.E / (2 * (1 + self.nu))

        def strain(w):
            return ufl.sym(ufl.grad(w))

        stress = 2 * mu * strain(u) + lmbda * ufl.tr(strain(u)) * ufl.Identity(3)
        self._k = fem.form(ufl.inner(stress, strain(v)) * ufl.dx)
        self._m = fem.form(self.rho * ufl.inner(u, v) * ufl.dx)

    def _volumes(self) -> np.ndarray:
        x = self.mesh.geometry.x[self._corners]
        return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6

    def deform(self, move: Callable[[np.ndarray], np.ndarray]) -> None:
        """Put the vertices at ``move(reference)``."""
        self.mesh.geometry.x[:] = move(self.reference)

    def matrices(self, E, rho, head_mass) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """Stiffness and mass of the body.

        Args:
            E: Modulus of the body's cells, Pa, (n_cells,); heads are of steel.
            rho: Density of the body, kg/m3.
            head_mass: Mass of all heads and nuts on it together, kg.
        """
        head = self.is_head
        self.E.x.array[:] = np.where(head, _STEEL[0], E)
        self.nu.x.array[:] = np.where(head, _STEEL[1], self.rig.nu)
        self.rho.x.array[:] = np.where(head, head_mass / self._volumes()[head].sum(), rho)
        made = (fem.assemble_matrix(form).to_scipy() for form in (self._k, self._m))
        return tuple(sparse.csr_matrix(a) for a in made)

    def face(self, z: float) -> tuple[np.ndarray, np.ndarray]:
        """The body's triangles on the plane z as built, heads left out, in the present shape.

        Returns:
            Corners in the plan, (n, 3, 2); nodes, (n, 6): corners, then the middles of the sides
            opposite to them.
        """
        faces = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])
        return self._triangles(faces, lambda x: np.abs(x[..., 2] - z) < _FLAT)

    def end(self, x0: float) -> tuple[np.ndarray, np.ndarray]:
        """The same on the plane x = x0, corners in the plane of y and z."""
        faces = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])
        return self._triangles(faces, lambda x: np.abs(x[..., 0] - x0) < _FLAT, (1, 2))

    def _triangles(self, faces, on, axes=(0, 1)):
        cells = self._corners[~self.is_head][:, faces].reshape(-1, 3)
        corners = np.unique(np.sort(cells[on(self.reference[cells]).all(axis=1)], axis=1), axis=0)
        at = self.reference[corners]
        middles = np.stack([(at[:, (i + 1) % 3] + at[:, (i + 2) % 3]) / 2 for i in range(3)], 1)
        distance, nodes = self._tree.query(np.concatenate([at, middles], axis=1))
        if distance.max() > _FLAT:
            raise RuntimeError("a triangle's node is not a node of the body")
        return self.mesh.geometry.x[corners][..., list(axes)], nodes


def make_bodies(rig: Rig, size: float | None = None) -> tuple[Body, Body]:
    """Both bodies of a rig; their meshes match on the interface.

    Args:
        rig: The rig.
        size: Element size, m; the rig's by default.
    """
    points, tets, body, head = _gmsh(rig, rig.size if size is None else size)
    made = []
    for number in (0, 1):
        mine = body == number
        used, local = np.unique(tets[mine], return_inverse=True)
        made.append(Body(points[used], local.reshape(-1, 4), head[mine], rig))
    return tuple(made)


def _gmsh(rig: Rig, size: float):
    """Points, tetrahedra, the body of each, and whether it is a head's."""
    gmsh.initialize(["-nopopup"], interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(rig.name)
        occ = gmsh.model.occ
        solids = [
            (3, occ.addBox(*b.low, *(h - a for a, h in zip(b.low, b.high, strict=True))))
            for b in rig.boxes
        ]
        d, height = rig.head
        for bolt in rig.bolts:
            for sign in (-1, 1):
                at = (bolt.x, bolt.y, sign * rig.outer)
                solids.append((3, occ.addCylinder(*at, 0, 0, sign * height, d / 2)))
        occ.fragment(solids, [])
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        gmsh.option.setNumber("Mesh.RandomSeed", 1)
        gmsh.model.mesh.generate(3)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        row = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        row[tags.astype(np.int64)] = np.arange(len(tags))
        lists = []
        for _, volume in gmsh.model.getEntities(3):
            _, nodes = gmsh.model.mesh.getElementsByType(4, volume)
            z = occ.getCenterOfMass(3, volume)[2]
            tets = row[nodes.astype(np.int64).reshape(-1, 4)]
            lists.append((tets, int(z > 0), abs(z) > rig.outer))
    finally:
        gmsh.finalize()
    tets = np.concatenate([t for t, _, _ in lists])
    body = np.concatenate([np.full(len(t), b) for t, b, _ in lists])
    head = np.concatenate([np.full(len(t), h) for t, _, h in lists])
    return coordinates.reshape(-1, 3), tets, body, head
