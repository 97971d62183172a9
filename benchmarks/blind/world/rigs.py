"""The three structures of the blind check: their sizes, bolts, sensors and tests, as built."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Box:
    """A block of a body: two opposite corners, m. Body 0 lies below z = 0, body 1 above."""

    body: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class Bolt:
    """Where a bolt is in the plan, m, and its label in the diagnosed case."""

    label: str
    x: float
    y: float


@dataclass(frozen=True)
class Rig:
    """A structure and its tests.

    Attributes:
        name: Name, also of the nominal case.
        boxes: The blocks it is made of.
        parts: Names of the two bodies in the nominal case.
        outer: Height of the outer faces above the interface, m.
        E: Young's modulus of the bodies, Pa.
        nu: Their Poisson ratio.
        rho: Their density, kg/m3.
        bolts: The bolts.
        head: Diameter and height of heads and nuts, m.
        head_mass: Mass of one of them, with its share of the shank beyond what it displaces, kg.
        bolt_diameter: Nominal, m.
        hole: Diameter of the holes that the interface misses, m; 0 for none.
        sensors: Places (x, y, body) on the outer faces; all measure z.
        n_modes: Modes of a test.
        torques: N m.
        clamped: Whether x = 0 is held.
        accelerometer: Place (x, y, body) of the known one; its mass, kg.
        size: Element size, m.
        search: Eigenpairs computed per state.
    """

    name: str
    boxes: tuple[Box, ...]
    parts: tuple[str, str]
    outer: float
    E: float
    nu: float
    rho: float
    bolts: tuple[Bolt, ...]
    head: tuple[float, float]
    head_mass: float
    bolt_diameter: float
    hole: float
    sensors: tuple[tuple[float, float, int], ...]
    n_modes: int
    torques: tuple[float, ...]
    clamped: bool
    accelerometer: tuple[tuple[float, float, int], float]
    size: float
    search: int

    @property
    def length(self) -> float:
        return max(box.high[0] for box in self.boxes)

    @property
    def middle(self) -> float:
        """y of the middle line, m."""
        box = self.boxes[0]
        return (box.low[1] + box.high[1]) / 2


def _line(xs, y, split) -> tuple[tuple[float, float, int], ...]:
    return tuple((x, y, int(x > split)) for x in xs)


_LAP_PLATES = Rig(
    name="lap_plates",
    boxes=(
        Box(0, (0.0, 0.0, -0.008), (0.2, 0.08, 0.0)),
        Box(1, (0.12, 0.0, 0.0), (0.32, 0.08, 0.008)),
    ),
    parts=("plate_1", "plate_2"),
    outer=0.008,
    E=69e9,
    nu=69 / (2 * 26.9) - 1,
    rho=2750.0,
    bolts=(
        Bolt("1", 0.14, 0.02),
        Bolt("2", 0.14, 0.06),
        Bolt("3", 0.18, 0.02),
        Bolt("4", 0.18, 0.06),
    ),
    head=(0.016, 0.0064),
    head_mass=0.018,
    bolt_diameter=0.010,
    hole=0.0,
    sensors=_line(
        (0.01, 0.035, 0.06, 0.085, 0.11, 0.135, 0.16, 0.185, 0.21, 0.235, 0.26, 0.285, 0.31),
        0.04,
        0.119,
    ),
    n_modes=5,
    torques=(4.0, 8.0, 16.0, 24.0),
    clamped=False,
    accelerometer=((0.03, 0.04, 0), 0.010),
    size=0.009,
    search=22,
)

_L, _PAD = 0.508, 0.0497
_C_BEAM = Rig(
    name="c_beam",
    boxes=(
        Box(0, (0.0, -0.0159, -0.0127), (_PAD, 0.0159, 0.0)),
        Box(0, (_PAD, -0.0159, -0.0127), (_L - _PAD, 0.0159, -0.00305)),
        Box(0, (_L - _PAD, -0.0159, -0.0127), (_L, 0.0159, 0.0)),
        Box(1, (0.0, -0.0159, 0.0), (_PAD, 0.0159, 0.0127)),
        Box(1, (_PAD, -0.0159, 0.00305), (_L - _PAD, 0.0159, 0.0127)),
        Box(1, (_L - _PAD, -0.0159, 0.0), (_L, 0.0159, 0.0127)),
    ),
    parts=("beam_1", "beam_2"),
    outer=0.0127,
    E=194e9,
    nu=0.29,
    rho=8000.0,
    bolts=(Bolt("1", _PAD / 2, 0.0), Bolt("2", _L - _PAD / 2, 0.0)),
    head=(0.0145, 0.006),
    head_mass=0.010,
    bolt_diameter=0.00794,
    hole=0.00843,
    sensors=tuple(
        (x, 0.0, body)
        for body in (0, 1)
        for x in (0.006, 0.07, 0.13, 0.19, 0.254, 0.318, 0.378, 0.438, 0.502)
    ),
    n_modes=6,
    torques=(6.0, 12.0, 18.0, 25.0),
    clamped=False,
    accelerometer=((0.254, 0.0, 1), 0.020),
    size=0.0095,
    search=20,
)

_LAP_BEAM = Rig(
    name="lap_beam",
    boxes=(
        Box(0, (0.0, -0.0127, -0.006), (0.235, 0.0127, 0.0)),
        Box(1, (0.185, -0.0127, 0.0), (0.42, 0.0127, 0.006)),
    ),
    parts=("beam_1", "beam_2"),
    outer=0.006,
    E=207e9,
    nu=0.3,
    rho=7800.0,
    bolts=(Bolt("1", 0.21, 0.0),),
    head=(0.010, 0.004),
    head_mass=0.004,
    bolt_diameter=0.006,
    hole=0.0,
    sensors=_line((0.03, 0.06, 0.1, 0.14, 0.175, 0.245, 0.28, 0.315, 0.35, 0.385, 0.412), 0.0, 0.2),
    n_modes=6,
    torques=(2.0, 4.0, 6.0, 10.0),
    clamped=True,
    accelerometer=((0.412, 0.0, 1), 0.003),
    size=0.007,
    search=16,
)

RIGS = {rig.name: rig for rig in (_LAP_PLATES, _C_BEAM, _LAP_BEAM)}
