"""The structures of the second world, as drawn: solids, bolts, torques, materials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi, sin


@dataclass(frozen=True)
class Body:
    """A part: its name, how it is drawn, and its material as the drawing says.

    Attributes:
        name: As in the nominal case.
        draw: Takes gmsh's ``occ`` and returns the tag of one volume; lengths in m.
        E, nu, rho: Pa, 1, kg/m3.
        normal: Axis along which it is thin (0, 1, 2), for an error of its thickness; None if it
            has no such.
        axis: Axis along which it is long.
        hollow: Whether it holds a cavity that could be filled.
    """

    name: str
    draw: Callable
    E: float = 70e9
    nu: float = 0.33
    rho: float = 2700.0
    normal: int | None = None
    axis: int = 0
    hollow: bool = False


@dataclass(frozen=True)
class Interface:
    """Where two bodies touch, on a plane across an axis.

    Attributes:
        bodies: Numbers of the two.
        axis: The plane's normal.
        bolts: Centres, m.
    """

    bodies: tuple[int, int]
    axis: int
    bolts: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Rig:
    """A structure and its tests.

    Attributes:
        name: Name, also of the nominal case.
        bodies: Its parts.
        interfaces: Where they touch.
        thread: Of the bolts.
        pad: Radius at which the pressure of a bolt ends: a cone of 30 degrees under its head, m.
        force: Of a bolt at the highest torque, N.
        head_mass: Of one bolt with nut and washers beyond what its holes take away, kg.
        torques: N m.
        size, fine: Of the cells, and of those round the bolts, m.
        mass: kg, about.
        spare: Solids that are not in the drawing: a rib each, one body with it.
        extra: Where a bolt pattern may be shifted to, m.
    """

    name: str
    bodies: tuple[Body, ...]
    interfaces: tuple[Interface, ...]
    thread: str
    pad: float
    head_mass: float
    torques: tuple[float, ...]
    size: float
    fine: float

    @property
    def bolts(self) -> list[tuple[float, float, float]]:
        """All centres, one interface after the other."""
        return [bolt for face in self.interfaces for bolt in face.bolts]


def _box(occ, low, high) -> int:
    return occ.addBox(*low, *(b - a for a, b in zip(low, high, strict=True)))


def _one(occ, whole, more=(), less=()) -> int:
    if more:
        found, _ = occ.fuse([(3, whole)], [(3, tag) for tag in more])
        (_, whole), *rest = found
        assert not rest
    if less:
        found, _ = occ.cut([(3, whole)], [(3, tag) for tag in less])
        (_, whole), *rest = found
        assert not rest
    return whole


# -- a T of two square tubes -----------------------------------------------------------------------


def _chord(occ) -> int:
    outer = _box(occ, (-0.22, -0.03, -0.06), (0.28, 0.03, 0.0))
    return _one(occ, outer, less=[_box(occ, (-0.22, -0.024, -0.054), (0.28, 0.024, -0.006))])


def _stem(occ) -> int:
    foot = _box(occ, (-0.06, -0.03, 0.0), (0.06, 0.03, 0.010))
    tube = _box(occ, (-0.025, -0.02, 0.010), (0.025, 0.02, 0.36))
    bore = _box(occ, (-0.020, -0.015, 0.010), (0.020, 0.015, 0.36))
    return _one(occ, foot, more=[_one(occ, tube, less=[bore])])


_T = Rig(
    "t_tubes",
    (Body("chord", _chord, hollow=True), Body("stem", _stem, axis=2, hollow=True)),
    (Interface((0, 1), 2, tuple((x, y, 0.0) for x in (-0.045, 0.045) for y in (-0.015, 0.015))),),
    thread="M8",
    pad=0.0115,
    head_mass=0.016,
    torques=(6.0, 12.0, 20.0),
    size=0.014,
    fine=0.0045,
)

# -- two flanged pipes, each with a fin ------------------------------------------------------------


def _pipe(occ, length: float, fin: tuple[float, float]) -> int:
    """From z = 0 with the flange there; ``length`` may be negative."""
    way = 1 if length > 0 else -1
    flange = occ.addCylinder(0, 0, 0, 0, 0, way * 0.012, 0.062)
    tube = occ.addCylinder(0, 0, 0, 0, 0, length, 0.040)
    low, high = sorted((way * 0.012, 0.75 * length))
    rib = _box(occ, (0.03, -0.004, low), (fin[0], 0.004, high))
    occ.rotate([(3, rib)], 0, 0, 0, 0, 0, 1, fin[1])
    bore = occ.addCylinder(0, 0, -0.01 * way, 0, 0, length + 0.02 * way, 0.034)
    return _one(occ, flange, more=[tube, rib], less=[bore])


_PIPE = Rig(
    "flanged_pipe",
    (
        Body(
            "lower",
            lambda occ: _pipe(occ, -0.17, (0.062, 0.0)),
            205e9,
            0.29,
            7850.0,
            axis=2,
            hollow=True,
        ),
        Body(
            "upper",
            lambda occ: _pipe(occ, 0.13, (0.055, 0.0)),
            205e9,
            0.29,
            7850.0,
            axis=2,
            hollow=True,
        ),
    ),
    (
        Interface(
            (0, 1),
            2,
            tuple((0.050 * cos(pi / 3 * i), 0.050 * sin(pi / 3 * i), 0.0) for i in range(6)),
        ),
    ),
    thread="M8",
    pad=0.0110,
    head_mass=0.016,
    torques=(6.0, 12.0, 20.0),
    size=0.009,
    fine=0.005,
)

# -- a box of four plates with sixteen screws ------------------------------------------------------

_X = (-0.095, -0.035, 0.035, 0.095)


def _plate(low, high):
    return lambda occ: _box(occ, low, high)


def _row(y: float, z: float) -> tuple[tuple[float, float, float], ...]:
    return tuple((x, y, z) for x in _X)


_BOX = Rig(
    "screw_box",
    (
        Body("base", _plate((-0.12, -0.08, 0.0), (0.12, 0.08, 0.008)), normal=2),
        Body("left", _plate((-0.12, 0.064, 0.008), (0.12, 0.08, 0.075)), normal=1),
        Body("right", _plate((-0.12, -0.08, 0.008), (0.12, -0.064, 0.075)), normal=1),
        Body("lid", _plate((-0.12, -0.08, 0.075), (0.12, 0.08, 0.081)), normal=2),
    ),
    (
        Interface((0, 1), 2, _row(0.072, 0.008)),
        Interface((0, 2), 2, _row(-0.072, 0.008)),
        Interface((1, 3), 2, _row(0.072, 0.075)),
        Interface((2, 3), 2, _row(-0.072, 0.075)),
    ),
    thread="M5",
    pad=0.0075,
    head_mass=0.004,
    torques=(1.5, 3.0, 5.0),
    size=0.014,
    fine=0.0045,
)

# -- a bracket with a rib on a plate ---------------------------------------------------------------


def _angle(occ) -> int:
    foot = _box(occ, (-0.050, -0.055, 0.0), (0.075, 0.055, 0.010))
    wall = _box(occ, (-0.050, -0.055, 0.010), (-0.036, 0.055, 0.210))
    rib = _box(occ, (-0.036, -0.006, 0.010), (0.010, 0.006, 0.130))
    return _one(occ, foot, more=[wall, rib])


_BRACKET = Rig(
    "bracket",
    (
        Body("plate", _plate((-0.14, -0.09, -0.012), (0.16, 0.08, 0.0)), 205e9, 0.29, 7850.0),
        Body("bracket", _angle, axis=2),
    ),
    (Interface((0, 1), 2, tuple((x, y, 0.0) for x in (-0.018, 0.055) for y in (-0.035, 0.035))),),
    thread="M8",
    pad=0.0115,
    head_mass=0.016,
    torques=(6.0, 12.0, 20.0),
    size=0.012,
    fine=0.0045,
)

RIGS = {rig.name: rig for rig in (_T, _PIPE, _BOX, _BRACKET)}


def draw_bodies(occ, rig: Rig) -> list[int]:
    """Volumes of a rig's bodies, in their order."""
    return [body.draw(occ) for body in rig.bodies]
