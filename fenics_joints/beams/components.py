"""What a chain of lapped beams is made of. Wherever a value stands a parameter's name may stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError

__all__ = ["Beam", "Clamp", "GenericJoint", "Held", "LumpedMass"]

Value = float | str


def _require(where: str, value, good: bool, expected: str) -> None:
    if not good:
        raise InputError(f"{where} = {value!r}: expected {expected}.")


def _size(where: str, value) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    _require(where, value, number and 0 < value < np.inf, "a number > 0, m")


def _count(where: str, value) -> None:
    integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    _require(where, value, integer and value >= 1, "a whole number of at least 1")


@dataclass(frozen=True)
class Beam:
    """A straight beam of rectangular section.

    Attributes:
        name: Its name.
        length: Whole length, m, laps included.
        breadth: Breadth of the section, m.
        height: Height of the section, m.
        n_elements: Elements outside the laps.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        stretch: Actual over nominal height.
        width: Actual over nominal breadth.
        shear: Shear area coefficient; 1.2 for a rectangle.
        offset: Height of the neutral axis above the line of the nodes, over the height; None for a
            half above that of the first, third, ... beam of a chain and below that of the others.
    """

    name: str
    length: float
    breadth: float
    height: float
    n_elements: int
    E: Value
    nu: Value
    rho: Value
    stretch: Value = 1.0
    width: Value = 1.0
    shear: float = 1.2
    offset: float | None = None

    def __post_init__(self):
        for key in ("length", "breadth", "height"):
            _size(f"{self.name}.{key}", getattr(self, key))
        _count(f"{self.name}.n_elements", self.n_elements)


@dataclass(frozen=True)
class GenericJoint:
    """The lap of two beams, as generic joint elements (seed 002, eqs. 2 and 3).

    A sequence in place of a value has one for each element: the joint's parameters as a field.

    Attributes:
        name: Its name.
        length: Length of the lap, m.
        n_elements: Number of joint elements.
        k1: Slap, N m.
        k2: Slip, N m.
        c: Damping of slip, N m s.
        k_axial: Axial stiffness of each element, N/m; None for that of the two beams.
        axial: Actual over nominal axial stiffness.
    """

    name: str
    length: float
    n_elements: int
    k1: Value | Sequence[Value]
    k2: Value | Sequence[Value]
    c: Value | Sequence[Value] = 0.0
    k_axial: Value | None = None
    axial: Value = 1.0

    def __post_init__(self):
        _size(f"{self.name}.length", self.length)
        _count(f"{self.name}.n_elements", self.n_elements)
        for key in ("k1", "k2", "c"):
            given = getattr(self, key)
            if not isinstance(given, str | float | int) and len(given) != self.n_elements:
                raise InputError(
                    f"{self.name}.{key} has {len(given)} values: expected one, or "
                    f"{self.n_elements}, one for each element."
                )

    def groups(self, key: str) -> list[tuple[str, Value, range]]:
        """Label, value and elements of each value of k1, k2 or c."""
        given = getattr(self, key)
        if isinstance(given, str | float | int):
            return [(self.name, given, range(self.n_elements))]
        return [(f"{self.name}[{i}]", v, range(i, i + 1)) for i, v in enumerate(given)]


@dataclass(frozen=True)
class LumpedMass:
    """A bolt with its nut, or an accelerometer: a mass with rotary inertia.

    Attributes:
        name: Its name.
        mass: Mass, kg.
        point: Position, m: x along the beams, y ignored, z above the reference line.
        radius: Radius of gyration about its centre, m: the square root of inertia over mass.
        travel: Distance from ``point`` along x, m.
        range: Least and largest travel, m; needed where the travel is a parameter.
        share: Share of ``mass`` that is at this point.
    """

    name: str
    mass: Value
    point: tuple[float, float, float]
    radius: float = 0.0
    travel: Value = 0.0
    range: tuple[float, float] | None = None
    share: float = 1.0

    def __post_init__(self):
        good = isinstance(self.radius, int | float) and 0 <= self.radius < np.inf
        _require(f"{self.name}.radius", self.radius, good, "a number >= 0, m")


@dataclass(frozen=True)
class Held:
    """A place that cannot move.

    Attributes:
        x: Position along the beams, m; a node.
        motions: Of ``"x"``, ``"z"`` and ``"turn"`` those that are held; all of them by default.
    """

    x: float
    motions: tuple[str, ...] = ("x", "z", "turn")

    def __post_init__(self):
        known = set(self.motions) <= {"x", "z", "turn"} and len(self.motions) > 0
        _require("held.motions", self.motions, known, "some of 'x', 'z' and 'turn'")


@dataclass(frozen=True)
class Clamp:
    """An end face that is held by springs spread over it, instead of not moving at all.

    Attributes:
        name: Its name.
        last: Whether it is the last beam's right end, else the first one's left end.
        k_n: Stiffness per area along the beam, Pa/m; it also holds the face from turning.
        k_t: Stiffness per area across it, Pa/m.
    """

    name: str
    last: bool
    k_n: Value
    k_t: Value
