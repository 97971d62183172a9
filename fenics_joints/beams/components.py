"""What a chain of lapped beams is made of. Wherever a value stands a parameter's name may stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np

from fenics_joints.errors import InputError, flag, items, real, reals, text, whole

Value = float | str


def _require(where: str, value, good: bool, expected: str) -> None:
    if not good:
        raise InputError(f"{where} = {value!r}: expected {expected}.")


def _is_number(value) -> bool:
    try:
        real("number", value)
    except InputError:
        return False
    return True


def _is_name(value) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _size(where: str, value) -> None:
    _require(where, value, _is_number(value) and value > 0, "a number > 0, m")


def _value(where: str, value, expected: str = "a number, or a parameter's name") -> None:
    # Whether a number is in its range, its law says when the matrices are made.
    _require(where, value, _is_name(value) or _is_number(value), expected)


def _count(where: str, value) -> None:
    whole(where, value)


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
        text("beam.name", self.name)
        for key in ("length", "breadth", "height"):
            _size(f"{self.name}.{key}", getattr(self, key))
        _count(f"{self.name}.n_elements", self.n_elements)
        for key in ("E", "nu", "rho", "stretch", "width"):
            _value(f"{self.name}.{key}", getattr(self, key))
        good = _is_number(self.shear) and self.shear > 0
        _require(f"{self.name}.shear", self.shear, good, "a number > 0")
        good = self.offset is None or _is_number(self.offset)
        _require(f"{self.name}.offset", self.offset, good, "a number, over the height, or None")


@dataclass(frozen=True)
class GenericJoint:
    """The lap of two beams, as generic joint elements (Jalali et al. 2019, eqs. 2 and 3).

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
        text("joint.name", self.name)
        _size(f"{self.name}.length", self.length)
        _value(f"{self.name}.axial", self.axial)
        if self.k_axial is not None:
            _value(f"{self.name}.k_axial", self.k_axial)
        _count(f"{self.name}.n_elements", self.n_elements)
        for key in ("k1", "k2", "c"):
            given = getattr(self, key)
            each = [] if isinstance(given, str | Real) or np.ndim(given) != 1 else list(given)
            if each and len(each) != self.n_elements:
                raise InputError(
                    f"{self.name}.{key} has {len(given)} values: expected one, or "
                    f"{self.n_elements}, one for each element."
                )
            for value in each or [given]:
                _value(f"{self.name}.{key}", value, "numbers, or parameters' names")

    def groups(self, key: str) -> list[tuple[str, Value, range]]:
        """Label, value and elements of each value of k1, k2 or c."""
        given = getattr(self, key)
        if isinstance(given, str | Real):
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
        text("mass.name", self.name)
        real(f"{self.name}.share", self.share, least=0)
        good = _is_number(self.radius) and self.radius >= 0
        _require(f"{self.name}.radius", self.radius, good, "a number >= 0, m")
        good = _is_name(self.mass) or (_is_number(self.mass) and self.mass >= 0)
        _require(f"{self.name}.mass", self.mass, good, "a number >= 0, kg, or a parameter's name")
        reals(f"{self.name}.point", self.point, (3,), "m")
        good = _is_name(self.travel) or _is_number(self.travel)
        _require(f"{self.name}.travel", self.travel, good, "a number, m, or a parameter's name")
        low, high = (0.0, 1.0)
        if self.range is not None:
            low, high = reals(f"{self.name}.range", self.range, (2,), "m")
        good = low < high
        _require(f"{self.name}.range", self.range, good, "two ascending numbers, m")


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
        motions = items("held.motions", self.motions, str, "x, z, turn")
        known = set(motions) <= {"x", "z", "turn"} and len(motions) > 0
        _require("held.motions", self.motions, known, "some of 'x', 'z' and 'turn'")
        _require("held.x", self.x, _is_number(self.x), "a number, m")


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

    def __post_init__(self):
        text("clamp.name", self.name)
        flag(f"{self.name}.last", self.last)
        for key in ("k_n", "k_t"):
            value = getattr(self, key)
            _value(f"{self.name}.{key}", value)
            _require(f"{self.name}.{key}", value, isinstance(value, str) or value >= 0, ">= 0")
