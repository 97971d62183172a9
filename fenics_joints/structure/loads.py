"""Places of forces and sensors by name, and the loads that stand for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure
from fenics_joints.structure.values import number

#: Position, m, and direction of each place, by name; a force without a position (None) is that of a
#: base that accelerates along the direction.
Places = Mapping[str, tuple[Sequence[float] | None, Sequence[float]]]


def place_loads(
    structure: Structure, what: str, given: Places | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Places by name, checked, and the load of one newton at each. Collective.

    Args:
        structure: The structure.
        what: What the places are, for messages: ``"forces"`` or ``"sensors"``.
        given: Position, m, and direction, of any length, of each place.

    Returns:
        Position and unit direction by name, (2, gdim), None for a base, and this rank's rows of the
        loads, N, of a base N per m/s2, (n_local, m). Held degrees of freedom bear none.

    Raises:
        InputError: If a place has no position and direction in so many coordinates, or is outside
            the mesh.
    """
    gdim = structure.gdim
    found, loads = {}, [np.zeros((structure.n_local, 0))]
    for name, place in (given or {}).items():
        if what == "forces" and _is_base(place):
            direction = _place(gdim, what, name, (np.zeros(gdim), place[1]))[1]
            found[name] = None
            loads.append(base_load(structure, direction)[:, None])
        else:
            found[name] = _place(gdim, what, name, place)
            point, direction = found[name]
            loads.append(structure.loads(Sensors(point[None], direction[None]), what[:-1]))
    return found, np.hstack(loads)


def base_load(structure: Structure, direction: np.ndarray) -> np.ndarray:
    """This rank's rows of the load of a base that accelerates, N per m/s2, (n_local,). Collective.

    Of motion relative to the base: minus the mass times a rigid translation, held places included.

    Args:
        structure: The structure.
        direction: Unit direction, (gdim,).
    """
    values = structure.update(None)
    way = fem.Constant(structure.mesh, np.asarray(direction, dtype=PETSc.ScalarType))
    form = fem.form(structure.inertia_form(way, ufl.TestFunction(structure.V)))
    v = fem_petsc.assemble_vector(form)
    v.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
    load = -v.array_r[: structure.n_local].copy()
    v.destroy()
    load[structure.held_dofs[: structure.n_local]] = 0.0
    for mass in structure.masses:
        row = structure.unit_loads(structure.rows(structure.place(mass, values)), direction[None])
        load -= number(mass.mass, values) * mass.share * row[:, 0]
    return load


def _is_base(place) -> bool:
    """Whether a place is a base: a direction without a position."""
    try:
        return len(place) == 2 and place[0] is None
    except TypeError:
        return False


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
