"""Checks of what is given to the builders."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from fenics_joints.errors import MeshError

__all__ = ["is_count", "is_positive", "requirement"]


def is_positive(value: float) -> bool:
    """Whether ``value`` is a finite number above 0."""
    return isinstance(value, int | float | np.number) and math.isfinite(value) and value > 0


def is_count(value: int) -> bool:
    """Whether ``value`` is a whole number of at least 1."""
    return isinstance(value, int | np.integer) and value >= 1


def requirement(builder: str) -> Callable[[bool, str, object, str], None]:
    """A function ``require(holds, name, value, expected)`` that raises in the builder's name."""

    def require(holds: bool, name: str, value: object, expected: str) -> None:
        if not holds:
            raise MeshError(f"{builder}: {name} is {value!r}, expected {expected}")

    return require
