"""Places of forces and sensors by name, and the loads that stand for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

__all__ = ["Places", "place_loads", "unit_loads"]

#: Position, m, and direction of each place, by name.
Places = Mapping[str, tuple[Sequence[float], Sequence[float]]]


def place_loads(
    structure: Structure, what: str, given: Places | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Places by name, checked, and the load of one newton at each. Collective.

    Args:
        structure: The structure.
        what: What the places are, for messages: ``"forces"`` or ``"sensors"``.
        given: Position, m, and direction, of any length, of each place.

    Returns:
        Position and unit direction by name, (2, gdim), and this rank's rows of the loads, N,
        (n_local, m). Held degrees of freedom bear none.

    Raises:
        InputError: If a place has no position and direction in so many coordinates, or is outside
            the mesh.
    """
    gdim = structure.gdim
    found = {name: _place(gdim, what, name, place) for name, place in (given or {}).items()}
    n_local = structure.V.dofmap.index_map.size_local * gdim
    if not found:
        return found, np.zeros((n_local, 0))
    points, directions = np.array(list(found.values())).transpose(1, 0, 2)
    rows = structure.rows(points, what[:-1])
    return found, unit_loads(structure, rows, directions)


def _place(gdim: int, what: str, name: str, place) -> np.ndarray:
    """Position and unit direction, (2, gdim)."""
    try:
        point, direction = (np.asarray(part, dtype=float)[:gdim] for part in place)
        one = Sensors(point, direction)
    except (IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"{what}[{name!r}] = {place}: expected (position, direction), each of {gdim} "
            f"numbers, the direction not zero."
        ) from error
    if point.shape != (gdim,):
        raise InputError(f"{what}[{name!r}] = {place}: expected {gdim} coordinates, in metres.")
    return np.array([one.points[0], one.directions[0]])


def unit_loads(structure: Structure, rows, directions: np.ndarray) -> np.ndarray:
    """This rank's rows of the loads, N, (n_local, n), of one newton along each direction.

    Args:
        structure: The structure.
        rows: Its `rows` at the n points.
        directions: Unit directions, (n, gdim). Held degrees of freedom bear no load.
    """
    imap, gdim = structure.V.dofmap.index_map, structure.gdim
    held = np.zeros((imap.size_local + imap.num_ghosts) * gdim, dtype=bool)
    for bc in structure.bcs:
        held[bc.dof_indices()[0]] = True
    loads = np.zeros((imap.size_local * gdim, len(directions)))
    for column, direction in enumerate(directions):
        v = PETSc.Vec().createMPI((imap.size_local * gdim, None), comm=structure.comm)
        for at in np.flatnonzero(rows.index == column):
            dofs = rows.nodes[at][:, None] * gdim + np.arange(gdim)
            value = np.where(held[dofs], 0.0, np.outer(rows.values[at], direction))
            blocks = imap.local_to_global(rows.nodes[at])
            numbers = (blocks[:, None] * gdim + np.arange(gdim)).astype(PETSc.IntType)
            v.setValues(numbers.ravel(), value.ravel(), PETSc.InsertMode.ADD_VALUES)
        v.assemble()
        loads[:, column] = v.array_r
        v.destroy()
    return loads
