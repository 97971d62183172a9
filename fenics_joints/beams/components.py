"""Components of lapped beams. A `Value` is a number, or the name of a parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np

from fenics_joints.errors import InputError, flag, items, real, reals, text, wanted, whole

Value = float | str


def _value(where: str, value: object, unit: str = "", **bounds: float) -> None:
    """Accept only a number or a parameter's name."""
    # Physical ranges are checked by the laws, when the matrices are made.
    text(where, value) if isinstance(value, str) else real(where, value, unit, **bounds)


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
        offset: Height of the neutral axis above the line of the nodes, relative to ``height``; None
            for 0.5 in the first, third, ... beam of a chain and -0.5 in the others.
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
            real(f"{self.name}.{key}", getattr(self, key), "m", above=0)
        whole(f"{self.name}.n_elements", self.n_elements)
        for key in ("E", "nu", "rho", "stretch", "width"):
            _value(f"{self.name}.{key}", getattr(self, key))
        real(f"{self.name}.shear", self.shear, above=0)
        if self.offset is not None:
            real(f"{self.name}.offset", self.offset)


@dataclass(frozen=True)
class GenericJoint:
    """The lap of two beams, as generic joint elements (Jalali et al. 2019, eqs. 2 and 3).

    k1, k2 and c may be sequences with a value for each element: a field of parameters.

    Attributes:
        name: Its name.
        length: Length of the lap, m.
        n_elements: Number of joint elements.
        k1: Stiffness of slap, N m.
        k2: Stiffness of slip, N m.
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
        real(f"{self.name}.length", self.length, "m", above=0)
        whole(f"{self.name}.n_elements", self.n_elements)
        _value(f"{self.name}.axial", self.axial)
        if self.k_axial is not None:
            _value(f"{self.name}.k_axial", self.k_axial)
        for key in ("k1", "k2", "c"):
            given = getattr(self, key)
            each = [] if isinstance(given, str | Real) or np.ndim(given) != 1 else list(given)
            if each and len(each) != self.n_elements:
                raise InputError(
                    f"{self.name}.{key} has {len(given)} values: expected one, or "
                    f"{self.n_elements}, one for each element."
                )
            for value in each or [given]:
                _value(f"{self.name}.{key}", value)

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
        travel: Distance of the mass from ``point`` along x, m.
        range: Least and largest travel, m; needed if the travel is a parameter.
        share: Share of ``mass`` that sits at this point, if it is spread over several.
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
        real(f"{self.name}.radius", self.radius, "m", least=0)
        _value(f"{self.name}.mass", self.mass, "kg", least=0)
        reals(f"{self.name}.point", self.point, (3,), "m")
        _value(f"{self.name}.travel", self.travel, "m")
        if self.range is not None:
            low, high = reals(f"{self.name}.range", self.range, (2,), "m")
            if not low < high:
                raise wanted(f"{self.name}.range", self.range, "two ascending numbers, m")


@dataclass(frozen=True)
class Held:
    """A node that cannot move, in some directions or at all.

    Attributes:
        x: Position along the beams, m; a node.
        motions: What is held: some of ``"x"``, ``"z"`` and ``"turn"`` (rotation); all by default.
    """

    x: float
    motions: tuple[str, ...] = ("x", "z", "turn")

    def __post_init__(self):
        motions = items("held.motions", self.motions, str, "x, z, turn")
        if not motions or not set(motions) <= {"x", "z", "turn"}:
            raise wanted("held.motions", self.motions, "some of 'x', 'z' and 'turn'")
        real("held.x", self.x, "m")


@dataclass(frozen=True)
class Clamp:
    """An elastic clamp: springs spread over an end face, where `Held` would make it rigid.

    Attributes:
        name: Its name.
        last: True for the right end of the last beam, False for the left end of the first.
        k_n: Stiffness per area along the beam, Pa/m; it also resists rotation of the face.
        k_t: Stiffness per area across the beam, Pa/m.
    """

    name: str
    last: bool
    k_n: Value
    k_t: Value

    def __post_init__(self):
        text("clamp.name", self.name)
        flag(f"{self.name}.last", self.last)
        for key in ("k_n", "k_t"):
            _value(f"{self.name}.{key}", getattr(self, key), "Pa/m", least=0)
