"""Material properties as one cell-wise field, filled from the parameters.

The field has one value for each cell and property slot; what a slot means is the law's of the
cell's region (`structure.laws`). Parameters enter by name or through UFL, whose derivatives
give the chain rule from cells to parameters.
"""

from __future__ import annotations

from collections.abc import Mapping

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.structure.components import Parameter, Region


class PropertyField:
    """Property slots of every cell.

    Args:
        mesh: Mesh.
        regions: Each region with its local cells, ghosts included.
        parameters: Parameters by name.

    Attributes:
        q: The field, a DG-0 function of shape (n_slots,).
        space: Its space.
    """

    def __init__(self, mesh, regions, parameters: Mapping[str, Parameter]):
        self.mesh, self.regions, self.parameters = mesh, list(regions), parameters
        self.slots = max(len(region.law.properties) for region, _ in self.regions)
        cell = mesh.topology.cell_name()
        self.space = fem.functionspace(mesh, basix.ufl.element("DG", cell, 0, shape=(self.slots,)))
        self.q = fem.Function(self.space)
        # A slot that a law leaves out must not hold zero: 1/stretch is taken of it elsewhere.
        self.q.x.array[:] = 1.0
        self._dof = self.space.dofmap.list[:, 0]
        self._symbols = {
            name: ufl.variable(fem.Constant(mesh, float(p.value))) for name, p in parameters.items()
        }
        self._expressions: dict[tuple, fem.Expression | float] = {}

    def update(self, values: Mapping[str, float]) -> None:
        """Fill the field from the parameters' values.

        Raises:
            InputError: If a property is out of its law's range; on every rank.
        """
        self._set_symbols(values)
        table = self.q.x.array.reshape(-1, self.slots)
        for number, (region, cells) in enumerate(self.regions):
            q = {}
            for slot, key in enumerate(region.law.properties):
                q[key] = self._value(number, region, cells, key, values)
                table[self._dof[cells], slot] = q[key]
            self._check(region, q)

    def fill(self, number: int, q: Mapping[str, float]) -> None:
        """Put property values into a region's cells, unchecked."""
        region, cells = self.regions[number]
        table = self.q.x.array.reshape(-1, self.slots)
        for slot, key in enumerate(region.law.properties):
            table[self._dof[cells], slot] = q[key]

    def region_values(self, number: int, values: Mapping[str, float]) -> dict | None:
        """Property values of a region that are the same in all its cells; None if one varies."""
        region, _ = self.regions[number]
        if any(callable(region.properties[key]) for key in region.law.properties):
            return None
        return {
            key: self._value(number, region, None, key, values) for key in region.law.properties
        }

    def slopes(self, number: int, parameter: str, values: Mapping[str, float]) -> tuple | None:
        """Derivative of a region's properties by one parameter. Collective.

        Returns:
            This rank's cells of the region, ghosts included, (n,), and the derivatives, (n,
            n_slots); None if no property of the region depends on the parameter.
        """
        self._set_symbols(values)
        region, cells = self.regions[number]
        found, depends = np.zeros((len(cells), self.slots)), False
        for slot, key in enumerate(region.law.properties):
            prop = region.properties[key]
            if callable(prop):
                found[:, slot] = self._evaluate(number, region, key, cells, parameter)
                depends |= self.mesh.comm.allreduce(bool(np.any(found[:, slot])), op=MPI.LOR)
            elif prop == parameter:
                found[:, slot], depends = 1.0, True
        return (cells, found) if depends else None

    def means(self, number: int) -> dict[str, float]:
        """Mean over a region's cells of each property, as last updated. Collective."""
        region, cells = self.regions[number]
        cells = cells[cells < self.mesh.topology.index_map(self.mesh.topology.dim).size_local]
        rows = self.q.x.array.reshape(-1, self.slots)[self._dof[cells]]
        total = self.mesh.comm.allreduce(np.append(rows.sum(axis=0), len(cells)))
        return dict(zip(region.law.properties, total[:-1] / max(total[-1], 1), strict=False))

    def put(self, function: fem.Function, cells: np.ndarray, table: np.ndarray) -> None:
        """Put rows of all slots, (n, n_slots), into cells of a function over `space`."""
        function.x.array.reshape(-1, self.slots)[self._dof[cells]] = table

    def _check(self, region: Region, q) -> None:
        message = None
        try:
            if all(np.size(value) for value in q.values()):
                region.law.check(region.name, q)
        except InputError as error:
            message = str(error)
        # One rank's cells may be bad alone: all must raise, or the others wait for ever.
        if any(callable(region.properties[key]) for key in region.law.properties):
            messages = [m for m in self.mesh.comm.allgather(message) if m]
            message = messages[0] if messages else None
        if message:
            raise InputError(message)

    def _set_symbols(self, values: Mapping[str, float]) -> None:
        for name, symbol in self._symbols.items():
            symbol.ufl_operands[0].value = values[name]

    def _value(self, number, region, cells, key, values):
        prop = region.properties[key]
        if callable(prop):
            return self._evaluate(number, region, key, cells, None)
        return values[prop] if isinstance(prop, str) else float(prop)

    def _evaluate(self, number, region, key, cells, parameter):
        """A property of position, or its derivative by a parameter, at the cells' middles."""
        place = (number, key, parameter)
        if place not in self._expressions:
            x = ufl.SpatialCoordinate(self.mesh)
            expr = region.properties[key](x, self._symbols)
            if parameter is not None:
                expr = ufl.diff(expr, self._symbols[parameter])
                expr = ufl.algorithms.apply_derivatives.apply_derivatives(
                    ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(expr)
                )
            self._expressions[place] = (
                float(expr) if _is_number(expr) else fem.Expression(expr, self._middle())
            )
        expression = self._expressions[place]
        if isinstance(expression, float):
            return np.full(len(cells), expression)
        return expression.eval(self.mesh, cells).reshape(len(cells))

    def _middle(self) -> np.ndarray:
        cell = getattr(basix.CellType, self.mesh.topology.cell_name())
        return basix.geometry(cell).mean(axis=0, keepdims=True)

    def by_cell(self, array: np.ndarray) -> np.ndarray:
        """Rows of a vector over the space for the owned cells, shape (n_owned, n_slots)."""
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        return array.reshape(-1, self.slots)[self._dof[:owned]]

    def contract(self, cell_gradient: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Chain rule from the cells' properties to the parameters. Collective.

        Args:
            cell_gradient: Derivative by every property of every owned cell, (n_owned, n_slots).
            values: All parameters' values.

        Returns:
            Derivative by every parameter, shape (n_parameters,), equal on all ranks.
        """
        self._set_symbols(values)
        position = {name: i for i, name in enumerate(self.parameters)}
        gradient = np.zeros(len(position))
        for number, (region, cells) in enumerate(self.regions):
            cells = cells[cells < len(cell_gradient)]
            for slot, key in enumerate(region.law.properties):
                prop = region.properties[key]
                if isinstance(prop, str):
                    gradient[position[prop]] += cell_gradient[cells, slot].sum()
                elif callable(prop):
                    for name, i in position.items():
                        slope = self._evaluate(number, region, key, cells, name)
                        gradient[i] += slope @ cell_gradient[cells, slot]
        self.mesh.comm.Allreduce(MPI.IN_PLACE, gradient)
        return gradient


def _is_number(expr) -> bool:
    """Whether UFL found a number, as for the derivative of what is linear; zero is one."""
    return isinstance(expr, ufl.constantvalue.Zero | ufl.constantvalue.ScalarValue)
