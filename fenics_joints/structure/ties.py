"""Faces that are tied though their meshes differ.

A layer of a joint stands on the facets of one of its two parts. Where the other part has other
facets, each vertex of the layer's free face follows an average over the other part's face
(`fenics_joints.meshes.mortar`): constant stress and linear displacements pass exactly. At degree 2
the free face has the bubbles of the layer's other face, so that the jump over the layer is that of
the vertices, piecewise linear.
"""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
import scipy.sparse
from dolfinx import fem
from petsc4py import PETSc
from scipy.spatial import cKDTree

from fenics_joints.errors import MeshError
from fenics_joints.meshes.tagged import TaggedMesh
from fenics_joints.structure.faces import Interface, couple_faces, read_face
from fenics_joints.structure.jumps import Jumps
from fenics_joints.structure.points import node_positions
from fenics_joints.structure.sparse import product

#: `fenics_joints.structure.assembly.Assembly`, which has ties.
Assembly = Any


def edge_middle(assembly: Assembly) -> float:
    """Value of a midside's shape function in the middle of its edge; 0 if there is none."""
    if assembly.degree == 1:
        return 0.0
    V = assembly.V
    cell = getattr(basix.CellType, V.mesh.topology.cell_name())
    middle = basix.geometry(cell)[basix.topology(cell)[1][0]].mean(axis=0, keepdims=True)
    dof = V.dofmap.dof_layout.entity_dofs(1, 0)[0]
    return float(assembly.element.tabulate(0, middle)[0][0, dof])


class Ties:
    """Displacements of tied faces in terms of the others: u = T x. Collective.

    Vectors x have the layout of u. Entries of tied and of held DOFs are zero.

    Args:
        assembly: A structure, whose mesh says what is tied (`TaggedMesh.ties`).
        held: Its DOFs that supports hold, this rank's, (n_local,).

    Attributes:
        T: The matrix.
        tied: This rank's DOFs that follow others, (n_local,).
        outside: Cells of this rank, ghosts included, that are not of a tied layer.

    Raises:
        MeshError: If displacements are of the third degree, faces do not lie on one another, or a
            support holds a tied one.
    """

    def __init__(self, assembly: Assembly, held: np.ndarray):
        if assembly.degree > 2:
            raise MeshError("degree = 3: expected 1 or 2 with faces that are tied")
        tagged: TaggedMesh = assembly.tagged
        options = {"bubble": edge_middle(assembly), "bonded": True, "tied": True}
        if assembly.axisymmetric:
            options["weight"] = lambda x: 2 * np.pi * x[:, 0]
        pairs = []
        for tie in tagged.ties:
            lower = read_face(assembly.V, tagged, *tie.to, of=tie.part)
            upper = read_face(assembly.V, tagged, tie.face)
            pairs.append(couple_faces(tie.face, lower, upper, tolerance=tie.reach, **options))
        layers = np.any([_layer_cells(assembly.V, pair) for pair in pairs], axis=0)
        self.outside = np.flatnonzero(~layers).astype(np.int32)
        jumps = Jumps(assembly.V, [], pairs)
        self.T, self.tied = jumps.T, np.zeros(assembly.n_local, dtype=bool)
        self.tied[jumps.local(jumps.unused)] = True
        if assembly.degree > 1:
            bubbles = _opposite_bubbles(assembly, pairs)
            middles = jumps.entries(np.concatenate([c.coupling.midsides for c in pairs])).ravel()
            self.tied[jumps.local(middles[jumps.owned(middles)])] = True
            self.T = self.T.matMult(bubbles)
            jumps.T.destroy(), bubbles.destroy()
        if assembly.comm.allreduce(bool(np.any(held & self.tied))):
            faces = ", ".join(tie.face for tie in tagged.ties)
            raise MeshError(f"a support holds {faces}, which follows a part: expected that held.")
        kept = self.T.createVecRight()
        kept.array[:] = ~(held | self.tied)
        self.T.diagonalScale(None, kept)
        self._back = self.T.transpose(PETSc.Mat())
        kept.array[:] = 0.0
        self._diagonal = PETSc.Mat().createDiagonal(kept)
        self._diagonal.convert(PETSc.Mat.Type.AIJ)
        kept.destroy()

    def displacement(self, x: PETSc.Vec) -> PETSc.Vec:
        """u = T x, a new vector."""
        return self.T * x

    def loads(self, loads: np.ndarray) -> np.ndarray:
        """Loads on the entries of x, (n_local, k), of those on u."""
        return product(self._back, loads)

    def matrix(self, A: PETSc.Mat, fixed: np.ndarray, diagonal: float) -> PETSc.Mat:
        """T^T A T, with a number on the diagonal of fixed entries; A is destroyed.

        Args:
            A: A matrix over u.
            fixed: This rank's tied and held DOFs, (n_local,).
            diagonal: The number.
        """
        right = A.matMult(self.T)
        found = self._back.matMult(right)
        A.destroy(), right.destroy()
        number = found.createVecRight()
        number.array[:] = diagonal * fixed
        # Zeros are stored too, so that all matrices have a diagonal.
        self._diagonal.setDiagonal(number)
        number.destroy()
        found.axpy(1.0, self._diagonal, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        return found


def _layer_cells(V: fem.FunctionSpace, pair: Interface) -> np.ndarray:
    """Mask of the cells of this rank, ghosts included, that are of the layer on a tied face: each
    has a vertex there. Its other face it shares with a part."""
    imap = V.dofmap.index_map
    known = imap.local_to_global(np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32))
    return np.isin(known, pair.upper)[V.dofmap.list].any(axis=1)


def _opposite_bubbles(assembly: Assembly, pairs: list[Interface]) -> PETSc.Mat:
    """The identity, but for bubbles of free faces, which are those of the layers' other faces."""
    V, gdim, comm = assembly.V, assembly.gdim, assembly.comm
    imap, cells = V.dofmap.index_map, V.dofmap.list
    x, rows, columns, values = node_positions(V), [], [], []
    for pair in pairs:
        inside = _layer_cells(V, pair)
        both = np.intersect1d(cells[inside], cells[~inside])
        told = comm.allgather((imap.local_to_global(both.astype(np.int32)), x[both]))
        numbers, places = (np.concatenate(part) for part in zip(*told, strict=True))
        tree, ends = cKDTree(places), pair.coupling.edges
        x_ends = pair.points[ends]
        at = x_ends.mean(axis=1), *x_ends.swapaxes(0, 1)
        for points, value in zip(at, (1.0, -0.5, -0.5), strict=True):
            blocks = numbers[tree.query(points)[1]]
            rows.append(pair.coupling.midsides), columns.append(blocks)
            values.append(np.full(len(blocks), value))
    rows, columns, values = map(np.concatenate, (rows, columns, values))
    first, last = imap.local_range
    mine = (rows >= first) & (rows < last)
    plain = np.setdiff1d(np.arange(last - first), rows[mine] - first)
    at = np.concatenate([rows[mine] - first, plain])
    to = np.concatenate([columns[mine], plain + first])
    one = np.concatenate([values[mine], np.ones(len(plain))])
    blocks = scipy.sparse.csr_matrix((one, (at, to)), shape=(last - first, imap.size_global))
    A = scipy.sparse.kron(blocks, scipy.sparse.identity(gdim), format="csr")
    sizes = assembly.n_local, gdim * imap.size_global
    return PETSc.Mat().createAIJ(
        (sizes, sizes),
        csr=(A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data),
        comm=comm,
    )
