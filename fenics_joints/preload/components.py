"""What presses parts together: contacts between their faces, rigid obstacles, bolts and loads.

Plain data; `fenics_joints.preload.model` turns it into equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import (
    InputError,
    direction,
    flag,
    items,
    real,
    reals,
    text,
    wanted,
    whole,
)

Gap = float | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Contact:
    """Two faces of different bodies that may touch.

    Where their vertices coincide they are paired; where their meshes differ, each vertex of the
    upper face meets an average of the lower one (`fenics_joints.preload.mortar`).

    Attributes:
        name: Unique name.
        lower: Facet group of one body; the normal points out of it.
        upper: Facet group of the other body; of meshes that differ, the smaller or finer face.
        friction: Coulomb's coefficient; 0 for none, infinity for faces that never slide while
            they touch.
        gap: Initial gap, m, beyond that of the mesh: a number or a function of positions, shape
            (n, gdim), that returns shape (n,). Negative for an interference fit.
        bonded: Whether the faces are glued: neither sliding nor opening.
        tolerance: Farthest distance, m, between two vertices that are one pair; by default a
            thousandth of the shortest edge. A larger one pairs faces across a meshed gap. Where
            meshes differ, the farthest distance of two facets, by default half a facet's size.
    """

    name: str
    lower: str
    upper: str
    friction: float = 0.0
    gap: Gap = 0.0
    bonded: bool = False
    tolerance: float | None = None

    def __post_init__(self):
        _check_faces(self, "contact")
        flag(f"{self.name}.bonded", self.bonded)
        _check_touch(self)
        if self.tolerance is not None:
            real(f"{self.name}.tolerance", self.tolerance, "m", above=0)


@dataclass(frozen=True)
class Obstacle:
    """A face that may touch a body that does not give way: at rest, moved, or pushed by a force.

    The obstacle does not turn; one that is pushed moves along its force alone. Contact is that of
    small displacements: each vertex meets the tangent plane of the obstacle's nearest point.

    Attributes:
        name: Unique name of the contact, and of the factor of ``travel`` or ``force``.
        facets: Facet group of the body; those that look away from the obstacle are left out.
        shape: `Plane`, `Sphere` or `Cylinder` of `fenics_joints.preload`, or a function such as
            they are.
        friction: Coulomb's coefficient; 0 for none, infinity for none slides while it touches.
        gap: Gap, m, beyond the distance, see `Contact`.
        travel: Displacement of the obstacle, m, (gdim,), at a factor of one; None for none.
        force: Force that pushes the obstacle instead, N (in plane strain N per metre of depth),
            (gdim,): how far it goes is found.
    """

    name: str
    facets: str
    shape: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    friction: float = 0.0
    gap: Gap = 0.0
    travel: tuple[float, ...] | None = None
    force: tuple[float, ...] | None = None

    def __post_init__(self):
        text("obstacle.name", self.name)
        text(f"{self.name}.facets", self.facets)
        if not callable(self.shape):
            raise wanted(
                f"{self.name}.shape",
                self.shape,
                "a Plane, a Sphere, a Cylinder or a function of positions",
            )
        _check_touch(self)
        if self.travel is not None:
            reals(f"{self.name}.travel", self.travel, (None,), "m")
        if self.force is not None:
            if self.travel is not None:
                raise InputError(f"{self.name}: travel and force are given; expected one of them.")
            direction(f"{self.name}.force", self.force)

    @property
    def rests(self) -> bool:
        """Whether it stays where it is."""
        return self.travel is None and self.force is None


def _check_touch(contact: Contact | Obstacle) -> None:
    if not isinstance(contact.friction, float) or contact.friction != np.inf:
        real(f"{contact.name}.friction", contact.friction, least=0, most=100)
    if not callable(contact.gap):
        real(f"{contact.name}.gap", contact.gap, "m")


@dataclass(frozen=True)
class _BoltBase:
    """What all bolts have: a name, two faces and the force between them."""

    name: str
    lower: str
    upper: str
    force: float

    def __post_init__(self):
        _check_faces(self, "bolt")
        real(f"{self.name}.force", self.force, "N", least=0)
        axis = getattr(self, "axis", None)
        if axis is not None:
            direction(f"{self.name}.axis", axis)


def _check_faces(pair: Contact | _BoltBase, what: str) -> None:
    text(f"{what}.name", pair.name)
    text(f"{pair.name}.lower", pair.lower)
    text(f"{pair.name}.upper", pair.upper)
    if pair.lower == pair.upper:
        raise InputError(
            f"{pair.name}: lower and upper are both {pair.lower!r}; expected two faces."
        )


@dataclass(frozen=True)
class WasherForce(_BoltBase):
    """A bolt as two opposed forces, spread evenly over the faces under its washers.

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group pressed along ``axis``.
        upper: Facet group pressed against ``axis``.
        force: Bolt force, N.
        axis: Direction of the bolt's axis, from ``lower`` to ``upper``, shape (gdim,); by default
            the last direction of space.
    """

    axis: tuple[float, ...] | None = None


@dataclass(frozen=True)
class PretensionSection(_BoltBase):
    """A solid bolt, cut through its shank: the force is given and the shortening solved for.

    The two faces of the cut stay flat and parallel and move apart by the shortening along the
    axis (the overlap of the shortened halves).

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group on the lower half's side of the cut.
        upper: Facet group on the upper half's side, vertex to vertex with ``lower``.
        force: Bolt force, N.
        axis: Direction of the bolt's axis, shape (gdim,); by default the last direction of space.
    """

    axis: tuple[float, ...] | None = None


@dataclass(frozen=True)
class BeamBolt(_BoltBase):
    """A bolt as a beam between rigid spiders under its washers (Fronk et al. 2019, section 3.2).

    In the preload the force is given, so the beam resists bending, shear and twist alone; about
    that state it is a whole beam with its mass.

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group that the lower spider holds.
        upper: Facet group that the upper spider holds.
        force: Bolt force, N.
        diameter: Diameter of the shank, m.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        head_mass: Mass, kg, of what sits on each end (head or nut, washer), at the spider's centre.
        n_elements: Elements along the beam.
    """

    diameter: float
    E: float = 210e9
    nu: float = 0.3
    rho: float = 7850.0
    head_mass: float = 0.0
    n_elements: int = 25

    def __post_init__(self):
        super().__post_init__()
        name = self.name
        real(f"{name}.diameter", self.diameter, "m", above=0)
        real(f"{name}.E", self.E, "Pa", above=0)
        if not -1 < real(f"{name}.nu", self.nu) < 0.5:
            raise wanted(f"{name}.nu", self.nu, "-1 < nu < 0.5")
        real(f"{name}.rho", self.rho, "kg/m3", least=0)
        real(f"{name}.head_mass", self.head_mass, "kg", least=0)
        whole(f"{name}.n_elements", self.n_elements)


@dataclass(frozen=True)
class Traction:
    """A load spread evenly over a face.

    Attributes:
        name: Unique name.
        facets: Facet group.
        force: Total force, N (in plane strain N per metre of depth), shape (gdim,).
        profile: Optional function of positions, shape (n, gdim) to (n,), that the load follows
            instead of being even; its integral is scaled to the force.
    """

    name: str
    facets: str
    force: tuple[float, ...]
    profile: Callable[[np.ndarray], np.ndarray] | None = None

    def __post_init__(self):
        text("load.name", self.name)
        text(f"{self.name}.facets", self.facets)
        if len(reals(f"{self.name}.force", self.force, (None,), "N")) not in (2, 3):
            raise wanted(f"{self.name}.force", self.force, "2 or 3 components, N")
        if self.profile is not None and not callable(self.profile):
            raise wanted(f"{self.name}.profile", self.profile, "a function of positions")


@dataclass(frozen=True)
class Pressure:
    """An even pressure on a face, along its normal before it is deformed.

    Attributes:
        name: Unique name; also that of its factor, of which 1 is ``pressure``.
        facets: Facet group.
        pressure: Pressure, Pa; positive presses on the body.
    """

    name: str
    facets: str
    pressure: float

    def __post_init__(self):
        text("load.name", self.name)
        text(f"{self.name}.facets", self.facets)
        real(f"{self.name}.pressure", self.pressure, "Pa")


@dataclass(frozen=True)
class Displacement:
    """A face all of which is moved by the same given way, as a grip or a punch glued to it does.

    Attributes:
        name: Unique name; also that of its factor, of which 1 is ``value``.
        facets: Facet group.
        value: Displacement, m, (gdim,); None in directions in which the face stays free.
    """

    name: str
    facets: str
    value: tuple[float | None, ...]

    def __post_init__(self):
        text("displacement.name", self.name)
        text(f"{self.name}.facets", self.facets)
        what = f"{self.name}.value"
        given = [
            v
            for v in items(what, self.value, (float, int, type(None)), "numbers, m, or None")
            if v is not None
        ]
        if len(self.value) not in (2, 3) or not given:
            raise wanted(what, self.value, "2 or 3 components, m, not all of them None")
        reals(what, given, (None,), "m")

    @property
    def directions(self) -> tuple[int, ...]:
        """Axes along which the face is moved."""
        return tuple(i for i, v in enumerate(self.value) if v is not None)


# -- obstacles: functions from positions, (n, gdim), to distances, m, (n,), negative inside, and
# outward unit normals there, (n, gdim) ---------------------------------------------------------


@dataclass(frozen=True)
class Plane:
    """A plane, solid behind it.

    Attributes:
        point: A point of it, m, (gdim,).
        normal: Its normal, away from the solid, (gdim,).
    """

    point: tuple[float, ...]
    normal: tuple[float, ...]

    def __post_init__(self):
        reals("plane.point", self.point, (None,), "m")
        direction("plane.normal", self.normal)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal = np.asarray(self.normal, dtype=float)
        normal = normal / np.linalg.norm(normal)
        return (x - np.asarray(self.point)) @ normal, np.broadcast_to(normal, x.shape).copy()


@dataclass(frozen=True)
class Sphere:
    """A ball; in two dimensions a disc, and with ``inside`` the hole of one.

    Attributes:
        centre: Its centre, m, (gdim,).
        radius: Its radius, m.
        inside: Whether the body lies within the sphere, which is a cavity.
    """

    centre: tuple[float, ...]
    radius: float
    inside: bool = False

    def __post_init__(self):
        reals("sphere.centre", self.centre, (None,), "m")
        real("sphere.radius", self.radius, "m", above=0)
        flag("sphere.inside", self.inside)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _round(x - np.asarray(self.centre, dtype=float), self.radius, self.inside)


@dataclass(frozen=True)
class Cylinder:
    """A round pin without ends, in three dimensions, and with ``inside`` the bore of one.

    Attributes:
        point: A point of its axis, m, (3,).
        axis: Direction of its axis, (3,).
        radius: Its radius, m.
        inside: Whether the body lies within the cylinder, which is a bore.
    """

    point: tuple[float, ...]
    axis: tuple[float, ...]
    radius: float
    inside: bool = False

    def __post_init__(self):
        reals("cylinder.point", self.point, (3,), "m")
        direction("cylinder.axis", self.axis)
        real("cylinder.radius", self.radius, "m", above=0)
        flag("cylinder.inside", self.inside)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        axis = np.asarray(self.axis, dtype=float)
        axis = axis / np.linalg.norm(axis)
        arm = x - np.asarray(self.point, dtype=float)
        return _round(arm - np.outer(arm @ axis, axis), self.radius, self.inside)


def _round(arm: np.ndarray, radius: float, inside: bool) -> tuple[np.ndarray, np.ndarray]:
    """Distances and normals from what lies at a radius from the arms' start."""
    length = np.linalg.norm(arm, axis=1)
    normal = arm / np.where(length > 0, length, 1.0)[:, None]
    return (radius - length, -normal) if inside else (length - radius, normal)
