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

    Raises:
        MeshError: If displacements are of the third degree, or faces do not lie on one another.
    """

    def __init__(self, assembly: Assembly, held: np.ndarray):
        if assembly.degree > 2:
            raise MeshError("degree = 3: expected 1 or 2 with faces that are tied")
        tagged: TaggedMesh = assembly.tagged
        options = {"bubble": edge_middle(assembly), "bonded": True, "tied": True}
        if assembly.axisymmetric:
            options["weight"] = lambda x: 2 * np.pi * x[:, 0]
        faces = [
            (
                tie.face,
                read_face(assembly.V, tagged, *tie.to, outer_alone=True),
                read_face(assembly.V, tagged, tie.face),
            )
            for tie in tagged.ties
        ]
        pairs = [couple_faces(*each, **options) for each in faces]
        jumps = Jumps(assembly.V, [], pairs)
        self.T, self.tied = jumps.T, np.zeros(assembly.n_local, dtype=bool)
        self.tied[jumps.local(jumps.unused)] = True
        if assembly.degree > 1:
            bubbles = _opposite_bubbles(assembly, pairs)
            middles = jumps.entries(np.concatenate([c.coupling.midsides for c in pairs])).ravel()
            self.tied[jumps.local(middles[jumps.owned(middles)])] = True
            self.T = self.T.matMult(bubbles)
            jumps.T.destroy(), bubbles.destroy()
        kept = self.T.createVecRight()
        kept.array[:] = ~(held | self.tied)
        self.T.diagonalScale(None, kept)
        self._back = self.T.transpose(PETSc.Mat())
        kept.array[:] = 0.0
        self._diagonal = PETSc.Mat().createDiagonal(kept)
        self._diagonal.convert(PETSc.Mat.Type.AIJ)

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
        found.axpy(1.0, self._diagonal, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        return found


def _opposite_bubbles(assembly: Assembly, pairs: list[Interface]) -> PETSc.Mat:
    """The identity, but for bubbles of free faces, which are those of the layers' other faces."""
    V, gdim, comm = assembly.V, assembly.gdim, assembly.comm
    imap, cells = V.dofmap.index_map, V.dofmap.list
    # Every cell of a layer has a vertex on its free face, and shares its other face with a part.
    known = imap.local_to_global(np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32))
    free = np.isin(known, np.concatenate([pair.upper for pair in pairs]))
    inside = free[cells].any(axis=1)
    both = np.intersect1d(cells[inside], cells[~inside])
    x = node_positions(V)
    told = comm.allgather((known[both], x[both]))
    numbers, places = (np.concatenate(part) for part in zip(*told, strict=True))
    tree = cKDTree(places)
    rows, columns, values = [], [], []
    for pair in pairs:
        ends = pair.coupling.edges
        x_ends = pair.points[ends]
        opposite = [
            numbers[tree.query(at)[1]] for at in (x_ends.mean(axis=1), *x_ends.swapaxes(0, 1))
        ]
        for blocks, value in zip(opposite, (1.0, -0.5, -0.5), strict=True):
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
