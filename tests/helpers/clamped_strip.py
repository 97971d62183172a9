"""A strip in an elastic clamp by forms of one's own."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from fenics_joints.structure import FormModel, Parameter


def strip(nu: float = 0.33, degree: int = 2) -> FormModel:
    """300 x 30 x 4 mm of aluminium with the parameters E, rho, and k of the clamp."""
    msh = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [0.3, 0.03, 0.004]], [15, 2, 1])
    V = fem.functionspace(msh, ("Lagrange", degree, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    E, k, rho, p = (fem.Constant(msh, np.float64(x)) for x in (70e9, 1e11, 2700.0, nu))
    eps = ufl.sym(ufl.grad(u))
    stress = E / (1 + p) * (eps + p / (1 - 2 * p) * ufl.tr(eps) * ufl.Identity(3))
    end = mesh.locate_entities_boundary(msh, 2, lambda x: np.isclose(x[0], 0))
    ds = ufl.Measure("ds", subdomain_data=mesh.meshtags(msh, 2, np.sort(end), 1))
    a = ufl.inner(stress, ufl.grad(v)) * ufl.dx + k * ufl.dot(u, v) * ds(1)
    parameters = {"E": E, "k": (Parameter("k", 1e11, "Pa/m", 1e9, 1e13), k), "rho": rho}
    if nu != 0.33:
        parameters["nu"] = p
    return FormModel(a, rho * ufl.dot(u, v) * ufl.dx, parameters=parameters)
