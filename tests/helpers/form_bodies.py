"""Bodies with layers for the tests of the forms; matrices gathered to every rank.

These are then handled with numpy and scipy, so that nothing of the suite's own solvers is needed
and a run on several ranks meets the same closed forms.
"""

from __future__ import annotations

import basix.ufl
import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_matrix
from dolfinx.la import InsertMode
from mpi4py import MPI

CELLS = {
    "tri": mesh.CellType.triangle,
    "quad": mesh.CellType.quadrilateral,
    "tet": mesh.CellType.tetrahedron,
    "hex": mesh.CellType.hexahedron,
}
ELEMENTS = ["tri-P1", "tri-P2", "quad-P1", "quad-P2", "quad-S2"]
ELEMENTS += ["tet-P1", "tet-P2", "hex-P1", "hex-P2", "hex-S2"]
DIMENSION = {"tri": 2, "quad": 2, "tet": 3, "hex": 3}
# Moduli of order one keep round-off readable: E, nu of the parts; E, G, thickness of the layer.
E, NU, E_L, G_L, H = 7.0, 0.3, 0.8, 0.35, 0.2


def gathered(form):
    """Sparse matrix of a bilinear form, the same on every rank."""
    matrix = assemble_matrix(form if isinstance(form, fem.Form) else fem.form(form))
    matrix.assemble()
    comm, shape = matrix.getComm().tompi4py(), matrix.getLocalSize()
    indptr, indices, data = matrix.getValuesCSR()
    columns = matrix.getSize()[1]
    rows = comm.allgather(sp.csr_matrix((data, indices, indptr), shape=(shape[0], columns)))
    matrix.destroy()
    return sp.vstack(rows).tocsr()


def values(function):
    """Degrees of freedom of a function, in the order of `gathered`, the same on every rank."""
    V = function.function_space
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    return np.concatenate(V.mesh.comm.allgather(function.x.array[:owned].copy()))


def assembled_vector(form):
    """Vector of a linear form, the same on every rank."""
    V = form.arguments()[0].ufl_function_space()
    b = fem.assemble_vector(fem.form(form))
    b.scatter_reverse(InsertMode.add)
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    return np.concatenate(V.mesh.comm.allgather(b.array[:owned].copy()))


def total(form, comm):
    """Value of a functional over all ranks."""
    return comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM)


def interpolated(V, f):
    """Degrees of freedom of the interpolant of ``f(x)``, x of shape (3, n)."""
    u = fem.Function(V)
    u.interpolate(f)
    return values(u)


def rigid_modes(V):
    """Rigid translations and rotations about the origin, one column each, orthonormal."""
    d = V.mesh.geometry.dim
    fields = [lambda x, i=i: np.eye(d)[i][:, None] * np.ones(x.shape[1]) for i in range(d)]
    for i in range(d):
        for j in range(i):
            spin = np.zeros((d, d))
            spin[i, j], spin[j, i] = 1, -1
            fields.append(lambda x, spin=spin: spin @ x[: len(spin)])
    return sla.orth(np.column_stack([interpolated(V, f) for f in fields]))


def element_of(name):
    """Vector element of a name as in ELEMENTS."""
    cell, (family, degree) = name.split("-")[0], name.split("-")[1]
    return basix.ufl.element(family, CELLS[cell].name, int(degree), shape=(DIMENSION[cell],))


def box(cell, n, lengths, comm=MPI.COMM_WORLD):
    """Structured mesh of a box from the origin, ghosted for forms over interior facets."""
    corners = [np.zeros(len(n)), np.asarray(lengths, dtype=float)]
    create = mesh.create_rectangle if len(n) == 2 else mesh.create_box
    return create(comm, corners, n, CELLS[cell], ghost_mode=mesh.GhostMode.shared_facet)


def rotation(d):
    """An oblique rotation, so that no axis is the layer's normal."""
    if d == 2:
        c, s = np.cos(0.7), np.sin(0.7)
        return np.array([[c, -s], [s, c]])
    return sla.expm(np.array([[0, -0.5, 0.9], [0.5, 0, -0.3], [-0.9, 0.3, 0]]))


def rotate(msh, R):
    """Turn the mesh about the origin."""
    d = len(R)
    msh.geometry.x[:, :d] = msh.geometry.x[:, :d] @ R.T


def cells_between(msh, low, high):
    """Local cells whose vertices all have their last coordinate in [low, high]."""
    last, tol = msh.geometry.dim - 1, 1e-10
    return mesh.locate_entities(
        msh, msh.topology.dim, lambda x: (x[last] > low - tol) & (x[last] < high + tol)
    )


def tagged(msh, dim, groups):
    """MeshTags with the value k on the entities ``groups[k]``."""
    entities = np.concatenate(groups).astype(np.int32)
    marks = np.concatenate([np.full(len(g), k, np.int32) for k, g in enumerate(groups)])
    order = np.argsort(entities)
    return mesh.meshtags(msh, dim, entities[order], marks[order])


def constant_state(d):
    """Traction on the layer's plane, in-plane strain and spin, all in the local frame."""
    traction = np.array([0.3, -0.2, 0.5])[-d:]
    in_plane = np.array([[0.2, 0.1], [0.1, -0.3]])[: d - 1, : d - 1]
    spin = np.array([[0, 0.2, -0.4], [-0.2, 0, 0.3], [0.4, -0.3, 0]])[-d:, -d:]
    return traction, in_plane, spin


def slope_across(traction, trace, modulus, lmbda, shear):
    """Change of displacement per length across a slab that carries ``traction``."""
    return np.append(traction[:-1] / shear, (traction[-1] - lmbda * trace) / modulus)


def part_slope(d):
    traction, in_plane, _ = constant_state(d)
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    return slope_across(traction, np.trace(in_plane), lmbda + 2 * mu, lmbda, mu)


FORCE, R_HOLE, R_HEAD = 21e3, 5e-3, 9e-3
