"""Boxes of steel as stiffness and mass matrices, for tests of parts by matrices."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from unlike_meshes import COMM, STEEL

from fenics_joints import forms
from fenics_joints.matrices import MatrixJoint, MatrixPart, MatrixStructure, NodeInterface
from fenics_joints.structure import Parameter

#: The plates of `unlike_meshes.lap`.
LOW, HIGH = ([0, 0, 0], [0.2, 0.04, 0.01]), ([0.12, 0, 0.01], [0.32, 0.04, 0.02])


def box(name: str, corners, counts) -> MatrixPart:
    """Hexahedra of first order between two corners, the same on every rank."""
    msh = mesh.create_box(MPI.COMM_SELF, list(corners), counts, mesh.CellType.hexahedron)
    V = fem.functionspace(msh, ("Lagrange", 1, (3,)))
    u, v, dx = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.dx(domain=msh)
    K = forms.elasticity(u, v, STEEL["E"], STEEL["nu"], dx)
    M = forms.mass(u, v, STEEL["rho"], dx)
    x = V.tabulate_dof_coordinates()
    dofs = np.column_stack([np.repeat(np.arange(len(x)), 3), np.tile([0, 1, 2], len(x))])
    return MatrixPart(name, _csr(K), _csr(M), x, dofs)


def _csr(form) -> sp.csr_matrix:
    A = fem_petsc.assemble_matrix(fem.form(form))
    A.assemble()
    rows, columns, values = A.getValuesCSR()
    return sp.csr_matrix((values, columns, rows), shape=A.getSize())


def lap_parts(low, high) -> tuple[MatrixPart, MatrixPart]:
    """Both plates."""
    return box("low", LOW, low), box("high", HIGH, high)


def lap_structure(low, high, k_n=1e12, k_t=1e12, law=None, **more) -> MatrixStructure:
    """Both plates with springs between them, of parameters k_n, k_t, and E and rho of steel."""
    parts = lap_parts(low, high)
    own = {"k_n": "k_n", "k_t": "k_t"}
    joint = MatrixJoint(
        "joint", NodeInterface.between(*parts), own, **({"law": law} if law else {})
    )
    known = [Parameter("k_n", k_n, "Pa/m"), Parameter("k_t", k_t, "Pa/m")]
    known += [Parameter(f"steel.{key}", STEEL[key]) for key in ("E", "rho")]
    return MatrixStructure(
        parts,
        [joint],
        known,
        properties={"steel": {"E": "steel.E", "rho": "steel.rho"}},
        regions={"steel": ("low", "high")},
        comm=COMM,
        **more,
    )
