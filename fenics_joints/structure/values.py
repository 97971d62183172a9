"""Values of parameters: by name, put in for a component's number, and slopes by them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fenics_joints.errors import MOST, InputError, mapping, real
from fenics_joints.structure.components import Parameter

_COMPLEX_STEP = 1e-30


def by_name(parameters: Iterable[Parameter]) -> dict[str, Parameter]:
    """Parameters by name, in order.

    Raises:
        InputError: If a name is there twice.
    """
    known: dict[str, Parameter] = {}
    for parameter in parameters:
        if parameter.name in known:
            raise InputError(f"parameter {parameter.name} is given twice; expected once.")
        known[parameter.name] = parameter
    return known


def parameter_values(
    parameters: Mapping[str, Parameter], given: Mapping[str, float] | None
) -> dict[str, float]:
    """All parameters' values: the nominal ones, with ``given`` put in.

    Raises:
        InputError: If ``given`` names an unknown parameter or has a value that is not finite.
    """
    values = {name: p.value for name, p in parameters.items()}
    for name, value in mapping("given", given, "values by the names of parameters").items():
        if name not in values:
            raise InputError(
                f"parameter {name!r} does not exist; expected one of: {', '.join(values)}."
            )
        # A fit asks a hundred thousand times: what is plainly a number is not looked at twice.
        plain = isinstance(value, float) and -MOST <= value <= MOST
        values[name] = float(value) if plain else real(f"parameter {name}", value)
    return values


def number(value: float | str, values: Mapping[str, float]) -> float:
    """A component's number: itself, or the value of the parameter that it names."""
    return values[value] if isinstance(value, str) else float(value)


def slopes(function, q: Mapping[str, float], key: str) -> np.ndarray:
    """Derivative of ``function(q)`` by one property, by a complex step: exact to round-off."""
    step = {k: complex(value) for k, value in q.items()}
    step[key] += 1j * _COMPLEX_STEP
    return np.imag(function(step)) / _COMPLEX_STEP
