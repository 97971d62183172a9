"""Places of forces and sensors by name, and the loads that stand for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

__all__ = ["Places", "place_loads"]

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
    if not found:
        return found, np.zeros((structure.n_local, 0))
    points, directions = np.array(list(found.values())).transpose(1, 0, 2)
    return found, structure.loads(Sensors(points, directions), what[:-1])


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
