"""How a specimen is built: all of it that differs from the drawing, as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

#: Pa/m at a bolt's highest pressure: far stiffer than the plates, as one with them.
BONDED = 1e15


@dataclass
class Joint:
    """The joint at the highest torque. Stiffness goes with the pressure p, relative to its peak.

    Attributes:
        k_n, k_t: Pa/m at p = 1, beside which the bonded joint acts in series; None: bonded.
        beta: Power of p, and of the torque.
        radius: Factor on the radius of the pads.
        loose: Numbers of bolts that press nothing.
        rest: Pa/m between faces round a loose bolt, which rest on each other.
        faces: Which interfaces have k_n and k_t; None: all.
        gasket: Pa/m normal and tangential over whole faces, in place of the pads; None: none.
        gasket_mass: kg/m2.
        shift: Of all pads, m, along x and y: holes in another place than drawn.
    """

    k_n: float | None = None
    k_t: float | None = None
    beta: float = 0.0
    radius: float = 1.0
    loose: list[int] = field(default_factory=list)
    rest: float = 0.0
    faces: list[int] | None = None
    gasket: tuple[float, float] | None = None
    gasket_mass: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)


@dataclass
class Build:
    """The specimen; factors are relative to the drawing.

    Attributes:
        E, G, rho, thickness, extent: By body; G with E as it is, extent along the body.
        rolled: By body, factor on the modulus along x or the body's axis against that across.
        patches: (centre, radius, factor on E, factor on rho): cells within.
        taper: By body, slope of the thickness over its length.
        bow: By body, rise of the middle along the axis over the ends, m, across it.
        oval: By body, share by which a section is longer one way and shorter the other.
        lean: By body, angle by which it leans, rad.
        heads: Factor on the mass of the bolts.
        masses: (place, kg), at a node of the surface.
        springs: (place, axis, N/m) to the ground.
        tuned: (place, kg, Hz): a mass on a spring, alike in all directions.
        lining: (body, kg, low, high): mass on all its outer faces between two shares of its axis.
        warm: By body, strain by which its middle is longer than its rim (shorter where negative): a
            stress that it has without load.
        joint: The joint.
    """

    E: dict[int, float] = field(default_factory=dict)
    G: dict[int, float] = field(default_factory=dict)
    rho: dict[int, float] = field(default_factory=dict)
    thickness: dict[int, float] = field(default_factory=dict)
    extent: dict[int, float] = field(default_factory=dict)
    rolled: dict[int, float] = field(default_factory=dict)
    patches: list[tuple] = field(default_factory=list)
    taper: dict[int, float] = field(default_factory=dict)
    bow: dict[int, float] = field(default_factory=dict)
    oval: dict[int, float] = field(default_factory=dict)
    lean: dict[int, float] = field(default_factory=dict)
    heads: float = 1.0
    masses: list[tuple] = field(default_factory=list)
    springs: list[tuple] = field(default_factory=list)
    tuned: list[tuple] = field(default_factory=list)
    lining: list[tuple] = field(default_factory=list)
    warm: dict[int, float] = field(default_factory=dict)
    joint: Joint = field(default_factory=Joint)
