"""Integrals over the tagged faces of a structure, and the loads that are spread over them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.structure.structure import Structure


class Surfaces:
    """Faces of a structure by name, on a half section with the weight 2 pi r.

    Args:
        structure: The structure.
    """

    def __init__(self, structure: Structure):
        self.structure, self.V, self.tagged = structure, structure.V, structure.tagged

    def _ds(self, name: str):
        return ufl.Measure(
            "ds",
            domain=self.V.mesh,
            subdomain_data=self.tagged.facet_tags,
            metadata={"quadrature_degree": 4},
        )(self.tagged.facet_tag(name))

    def _weight(self):
        """Weight of the surface measure, as UFL."""
        x = ufl.SpatialCoordinate(self.V.mesh)
        return 2 * ufl.pi * x[0] if self.structure.axisymmetric else ufl.as_ufl(1.0)

    def _integral(self, form) -> float:
        return self.V.mesh.comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM)

    def centre(self, name: str) -> np.ndarray:
        """Centroid of a face, m, (gdim,). Collective."""
        ds, x = self._ds(name), ufl.SpatialCoordinate(self.V.mesh)
        area = self._integral(1.0 * ds)
        return np.array([self._integral(x[i] * ds) / area for i in range(self.structure.gdim)])

    def forces(
        self, given: Iterable[tuple[str, np.ndarray]], profile: Callable | None = None
    ) -> PETSc.Vec:
        """Load in u of forces, N, (gdim,), spread over faces, evenly or by a profile. Collective.

        Raises:
            InputError: If the profile has no resultant.
        """
        v, weight, total = ufl.TestFunction(self.V), self._weight(), None
        q = ufl.as_ufl(1.0) if profile is None else self._function(profile)
        for name, force in given:
            ds = self._ds(name)
            area = self._integral(weight * q * ds)
            if not abs(area) > 0:
                raise InputError(f"{name}: the load's profile has no resultant there.")
            # A constant, so that one compiled form serves all forces and areas.
            traction = fem.Constant(self.V.mesh, np.asarray(force, dtype=float) / area)
            form = weight * q * ufl.dot(traction, v) * ds
            total = form if total is None else total + form
        return self._assembled(total)

    def pressure(self, name: str, pressure: float) -> PETSc.Vec:
        """Load in u of an even pressure, Pa, against a face's outward normal. Collective."""
        v, n = ufl.TestFunction(self.V), ufl.FacetNormal(self.V.mesh)
        size = fem.Constant(self.V.mesh, -float(pressure))
        return self._assembled(size * self._weight() * ufl.dot(n, v) * self._ds(name))

    def resultant(self, load: PETSc.Vec) -> np.ndarray:
        """Resultant of a load in u, N, (gdim,). Collective."""
        # Shape functions sum to one, those of moments too.
        own = load.array_r.reshape(-1, self.structure.gdim).sum(axis=0)
        return self.V.mesh.comm.allreduce(own, op=MPI.SUM)

    def _function(self, profile: Callable) -> fem.Function:
        Q = fem.functionspace(self.V.mesh, ("Lagrange", self.structure.degree))
        q = fem.Function(Q)
        q.interpolate(lambda x: profile(x[: self.structure.gdim].T))
        return q

    def _assembled(self, form) -> PETSc.Vec:
        b = fem_petsc.assemble_vector(fem.form(form))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return b
