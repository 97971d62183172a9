"""Types of what stands in a case file: numbers with units, points, lists, tables with names."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from fenics_joints.units import to_si

__all__ = [
    "AXES", "Count", "Damper", "Density", "Direction", "Gap", "Inertia", "Length", "Mass",
    "Modulus", "Names", "Point", "Poisson", "Positive", "Section", "Share", "Size", "Spacing",
    "Stiffness", "Turning", "ascending", "listed", "named", "quantity",
]  # fmt: skip

_NAME = r"[A-Za-z][A-Za-z0-9_-]*"
AXES = ("x", "y", "z")


def quantity(unit: str, least: float = -math.inf, most: float = math.inf, above: bool = False):
    """The type of a float in SI ``unit`` from text; within limits, or above the lower one."""

    def read(value: Any) -> float:
        number = to_si(value, unit)
        if not (number > least if above else number >= least) or number > most:
            low = f"{'above' if above else 'at least'} {least:g} {unit}".rstrip()
            high = f" and at most {most:g} {unit}".rstrip() if most < math.inf else ""
            raise ValueError(f"expected {low}{high}")
        return number

    return Annotated[float, BeforeValidator(read)]


def listed(value: Any) -> Any:
    """A list, also of a single value."""
    return value if isinstance(value, list) else [value]


def _padded(vector: list[float]) -> tuple[float, ...]:
    return tuple(vector) + (0.0,) * (3 - len(vector))


def _nonzero(vector: list[float]) -> list[float]:
    if not any(vector) or not all(math.isfinite(c) for c in vector):
        raise ValueError("expected a finite vector that is not zero")
    return vector


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    return pair


Length = quantity("m")
Size = quantity("m", 0, above=True)
Gap = quantity("m", 0)
Modulus = quantity("Pa", 0, above=True)
Density = quantity("kg/m3", 0, above=True)
Mass = quantity("kg", 0, above=True)
Stiffness = quantity("N/m", 0, above=True)
Turning = quantity("N*m", 0, above=True)
Damper = quantity("N*m*s", 0)
Inertia = quantity("kg*m2", 0)
Spacing = quantity("Hz", 0)
Positive = quantity("", 0, above=True)
Share = quantity("", 0)
Poisson = quantity("", -0.999, 0.4999)
Point = Annotated[list[Length], Field(min_length=2, max_length=3), AfterValidator(_padded)]
Direction = Annotated[
    list[float],
    Field(min_length=2, max_length=3),
    AfterValidator(_nonzero),
    AfterValidator(_padded),
]
Names = Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
Count = Annotated[int, Field(ge=1, strict=True)]


def ascending(kind):
    """The type of a pair [low, high] of a kind of number."""
    return Annotated[tuple[kind, kind], AfterValidator(_ascending)]


class Section(BaseModel):
    """A table of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


def _names(table: Any) -> Any:
    for name in table if isinstance(table, dict) else ():
        if not re.fullmatch(_NAME, name):
            raise ValueError(
                f"the name {name!r} is not usable: expected letters, digits, _ and -, "
                "starting with a letter"
            )
    return table


def named(kind):
    """A table of sections with names of their own, such as ``[parts.NAME]``."""
    return Annotated[dict[str, kind], BeforeValidator(_names)]
