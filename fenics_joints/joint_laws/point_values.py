"""Values of UFL expressions at the points of a quadrature rule, as coefficients of a function."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI


class PointValues:
    """Values of an expression at the nodes of a space that are the quadrature points of a measure.

    By a lumped projection: int e phi / int phi. Exact, since every shape function is one at its own
    point and zero at the others; a node that two facets of a cell share has their mean.

    Args:
        expression: UFL vector.
        space: Space of as many components, its nodes on the points.
        dx: Measure with those points as its quadrature rule.
        side: ``"+"`` if dx is a measure of interior facets, else None.
    """

    def __init__(
        self, expression, space: fem.FunctionSpace, dx: ufl.Measure, side: str | None = None
    ):
        self._space, comm = space, space.mesh.comm
        test = ufl.TestFunction(space)
        on = test if side is None else test(side)
        ones = ufl.as_vector([1.0] * expression.ufl_shape[0])
        self._form = fem.form(ufl.inner(expression, on) * dx)
        weights = self._assemble(fem.form(ufl.inner(ones, on) * dx))
        # Nodes away from the joint, where a shape function's trace is round-off.
        largest = comm.allreduce(float(np.abs(weights).max(initial=0.0)), op=MPI.MAX)
        self._inside = np.abs(weights) > 1e-9 * largest
        self._weights = np.where(self._inside, weights, 1.0)

    def _assemble(self, form) -> np.ndarray:
        """Assembled vector with ghosts."""
        dofmap = self._space.dofmap
        vector = la.vector(dofmap.index_map, dofmap.index_map_bs)
        vector.array[:] = 0.0
        fem.assemble_vector(vector.array, form)
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        return vector.array.copy()

    def __call__(self) -> np.ndarray:
        """The values now, ghosts included; zero away from the measure. Collective."""
        return np.where(self._inside, self._assemble(self._form) / self._weights, 0.0)
