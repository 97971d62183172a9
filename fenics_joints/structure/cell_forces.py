"""What each cell of a mesh adds to x^T K y and x^T M y of two motions."""

from __future__ import annotations

from collections.abc import Mapping

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenics_joints.structure.structure import Structure


class CellForces:
    """Forces of each cell by itself, at its own copy of the nodes that it shares with others.

    The sum over a cell of its forces by a motion x, times a motion y, is its part of x^T K y: one
    assembly for each x, whatever the number of y.

    Args:
        structure: Whose cells they are.
    """

    def __init__(self, structure: Structure):
        self._structure, msh = structure, structure.mesh
        apart = basix.ufl.element(
            *structure.element_of, shape=(msh.geometry.dim,), discontinuous=True
        )
        self._space = fem.functionspace(msh, apart)
        self._x, v = fem.Function(structure.V), ufl.TestFunction(self._space)
        self._forms = [
            fem.form(form(self._x, v))
            for form in (structure.stiffness_form, structure.inertia_form)
        ]
        owned = msh.topology.index_map(msh.topology.dim).size_local
        size = self._space.dofmap.index_map_bs
        dofs = self._space.dofmap.list[:owned]
        self._dofs = (size * dofs[:, :, None] + np.arange(size)).reshape(owned, -1)

    def motion(self, shape: PETSc.Vec) -> np.ndarray:
        """A motion at every cell's own nodes, (n_owned_cells, k). Collective.

        Args:
            shape: Displacement vector, owned entries.
        """
        self._put(shape)
        copy = fem.Function(self._space)
        copy.interpolate(self._x)
        return copy.x.array[self._dofs]

    def of(
        self, shape: PETSc.Vec, given: Mapping[str, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Each cell's K x and M x, (n_owned_cells, k) both. Collective.

        Args:
            shape: Displacement vector x, owned entries.
            given: Values of parameters that differ from their nominal value.
        """
        self._structure.update(given)
        self._put(shape)
        stiff, inertia = (fem.assemble_vector(form).array[self._dofs] for form in self._forms)
        return stiff, inertia

    def _put(self, shape: PETSc.Vec) -> None:
        self._x.x.array[: self._structure.n_local] = shape.array_r
        self._x.x.scatter_forward()
