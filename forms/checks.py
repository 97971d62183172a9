"""What is given to the forms: numbers are checked, UFL cannot be."""

from __future__ import annotations

import numpy as np
import ufl
from ufl.core.expr import Expr

from fenics_joints.errors import direction, real, reals


def check(key: str, value, unit: str = "", **bounds: float) -> None:
    """Refuse numbers that are not finite or out of range, and what is neither a number nor UFL.

    Args:
        key: Name of the argument.
        value: UFL, which passes; a number or an array; of complex ones the real part counts.
        unit: For the message.
        **bounds: ``least``, ``most`` and ``above``, as of `fenics_joints.errors.real`.

    Raises:
        InputError: If a number is out of range, or the value is None or a text.
    """
    if isinstance(value, Expr):
        return
    value = np.real(value) if np.iscomplexobj(value) else value
    if isinstance(value, np.ndarray):
        reals(key, value, None, unit, **bounds)
    else:
        real(key, value, unit, **bounds)


def unit_vector(key: str, value, gdim: int):
    """A direction as a unit vector of UFL.

    Args:
        key: Name of the argument.
        value: UFL, which passes; or ``gdim`` numbers, of any length but zero.
        gdim: Number of components.

    Raises:
        InputError: If the numbers are not a direction.
    """
    return value if isinstance(value, Expr) else ufl.as_vector(direction(key, value, (gdim,)))
