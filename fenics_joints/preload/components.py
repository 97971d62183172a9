"""Contacts between faces, rigid obstacles, bolts and loads.

Plain data; `fenics_joints.preload.model` turns it into equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Annotated, get_args, get_type_hints

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


def _friction(key: str, value: object) -> None:
    if not isinstance(value, float) or value != np.inf:
        real(key, value, least=0, most=100)


def _gap(key: str, value: object) -> None:
    if not callable(value):
        real(key, value, "m")


def _function(key: str, value: object, expected: str = "a function of positions") -> None:
    if not callable(value):
        raise wanted(key, value, expected)


def _poisson(key: str, value: object) -> None:
    if not -1 < real(key, value) < 0.5:
        raise wanted(key, value, "-1 < nu < 0.5")


def _force(key: str, value: object) -> None:
    if len(reals(key, value, (None,), "N")) not in (2, 3):
        raise wanted(key, value, "2 or 3 components, N")


def _some_lengths(key: str, value: object) -> None:
    found = items(key, value, (float, int, type(None)), "numbers, m, or None")
    given = [v for v in found if v is not None]
    if len(found) not in (2, 3) or not given:
        raise wanted(key, value, "2 or 3 components, m, not all of them None")
    reals(key, given, (None,), "m")


#: Types of arguments, with the function of a key and a value that refuses others.
Name = Annotated[str, text]
Flag = Annotated[bool, flag]
Friction = Annotated[float, _friction]
Gap = Annotated[float | Callable[[np.ndarray], np.ndarray], _gap]
Length = Annotated[float, partial(real, unit="m", above=0)]
Vector = Annotated[tuple[float, ...], partial(reals, shape=(None,), unit="m")]
Direction = Annotated[tuple[float, ...], direction]
Shape = Annotated[
    Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    partial(_function, expected="a Plane, a Sphere, a Cylinder or a function of positions"),
]


class _Checked:
    """Arguments that are checked as their types are annotated; InputError names the first wrong."""

    def __post_init__(self) -> None:
        own = type(self).__name__.lower()
        kinds = get_type_hints(type(self), include_extras=True)
        for field in fields(self):
            value, kind = getattr(self, field.name), kinds[field.name]
            options = get_args(kind)
            if type(None) in options:
                kind = options[0]
                if value is None:
                    continue
            name = own if field.name == "name" else getattr(self, "name", own)
            kind.__metadata__[0](f"{name}.{field.name}", value)


@dataclass(frozen=True)
class _Faces(_Checked):
    """A name, and two faces."""

    name: Name
    lower: Name
    upper: Name

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lower == self.upper:
            raise InputError(
                f"{self.name}: lower and upper are both {self.lower!r}; expected two faces."
            )


@dataclass(frozen=True)
class Contact(_Faces):
    """Two faces of different bodies that may touch.

    Where their vertices coincide they are paired; where their meshes differ, each vertex of the
    upper face meets an average of the lower one (`fenics_joints.meshes.mortar`).

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

    friction: Friction = 0.0
    gap: Gap = 0.0
    bonded: Flag = False
    tolerance: Length | None = None


@dataclass(frozen=True)
class Obstacle(_Checked):
    """A face that may touch a body that does not give way: at rest, moved, or pushed by a force.

    The obstacle does not turn; one that is pushed moves along its force alone. Contact is that of
    small displacements: each vertex meets the tangent plane of the obstacle's nearest point.

    Attributes:
        name: Unique name of the contact, and of the factor of ``travel`` or ``force``.
        facets: Facet group of the body; those that look away from the obstacle are left out.
        shape: `Plane`, `Sphere` or `Cylinder` of `fenics_joints.preload`, or a function like
            these.
        friction: Coulomb's coefficient; 0 for none, infinity for no sliding while it touches.
        gap: Gap, m, beyond the distance, see `Contact`.
        travel: Displacement of the obstacle, m, (gdim,), at a factor of one; None for none.
        force: Force that pushes the obstacle instead, N (in plane strain N per metre of depth),
            (gdim,): how far it goes is found.
    """

    name: Name
    facets: Name
    shape: Shape
    friction: Friction = 0.0
    gap: Gap = 0.0
    travel: Vector | None = None
    force: Direction | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.travel is not None and self.force is not None:
            raise InputError(f"{self.name}: travel and force are given; expected one of them.")

    @property
    def rests(self) -> bool:
        """Whether it stays where it is."""
        return self.travel is None and self.force is None


@dataclass(frozen=True)
class _BoltBase(_Faces):
    """A bolt: a name, two faces and the force between them."""

    force: Annotated[float, partial(real, unit="N", least=0)]


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

    axis: Direction | None = None


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

    axis: Direction | None = None


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

    diameter: Length
    E: Annotated[float, partial(real, unit="Pa", above=0)] = 210e9
    nu: Annotated[float, _poisson] = 0.3
    rho: Annotated[float, partial(real, unit="kg/m3", least=0)] = 7850.0
    head_mass: Annotated[float, partial(real, unit="kg", least=0)] = 0.0
    n_elements: Annotated[int, whole] = 25


@dataclass(frozen=True)
class Traction(_Checked):
    """A load spread evenly over a face.

    Attributes:
        name: Unique name.
        facets: Facet group.
        force: Total force, N (in plane strain N per metre of depth), shape (gdim,).
        profile: Optional function of positions, shape (n, gdim) to (n,), that the load follows
            instead of being even; its integral is scaled to the force.
    """

    name: Name
    facets: Name
    force: Annotated[tuple[float, ...], _force]
    profile: Annotated[Callable[[np.ndarray], np.ndarray], _function] | None = None


@dataclass(frozen=True)
class Pressure(_Checked):
    """An even pressure on a face, along its normal before it is deformed.

    Attributes:
        name: Unique name; also that of its factor, of which 1 is ``pressure``.
        facets: Facet group.
        pressure: Pressure, Pa; positive presses on the body.
    """

    name: Name
    facets: Name
    pressure: Annotated[float, partial(real, unit="Pa")]


@dataclass(frozen=True)
class Displacement(_Checked):
    """A face that is moved as a whole by a given displacement, as by a grip or punch glued to it.

    Attributes:
        name: Unique name; also that of its factor, of which 1 is ``value``.
        facets: Facet group.
        value: Displacement, m, (gdim,); None in directions in which the face stays free.
    """

    name: Name
    facets: Name
    value: Annotated[tuple[float | None, ...], _some_lengths]

    @property
    def directions(self) -> tuple[int, ...]:
        """Axes along which the face is moved."""
        return tuple(i for i, v in enumerate(self.value) if v is not None)


# -- obstacles: functions from positions, (n, gdim), to distances, m, (n,), negative inside, and
# outward unit normals there, (n, gdim) ---------------------------------------------------------


@dataclass(frozen=True)
class Plane(_Checked):
    """A plane, solid behind it.

    Attributes:
        point: A point of it, m, (gdim,).
        normal: Its normal, away from the solid, (gdim,).
    """

    point: Vector
    normal: Direction

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal = np.asarray(self.normal, dtype=float)
        normal = normal / np.linalg.norm(normal)
        return (x - np.asarray(self.point)) @ normal, np.broadcast_to(normal, x.shape).copy()


@dataclass(frozen=True)
class Sphere(_Checked):
    """A ball; in two dimensions a disc, and with ``inside`` the hole of one.

    Attributes:
        centre: Its centre, m, (gdim,).
        radius: Its radius, m.
        inside: Whether the body lies within the sphere, which is a cavity.
    """

    centre: Vector
    radius: Length
    inside: Flag = False

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _round(x - np.asarray(self.centre, dtype=float), self.radius, self.inside)


@dataclass(frozen=True)
class Cylinder(_Checked):
    """A round pin without ends, in three dimensions, and with ``inside`` the bore of one.

    Attributes:
        point: A point of its axis, m, (3,).
        axis: Direction of its axis, (3,).
        radius: Its radius, m.
        inside: Whether the body lies within the cylinder, which is a bore.
    """

    point: Annotated[tuple[float, ...], partial(reals, shape=(3,), unit="m")]
    axis: Direction
    radius: Length
    inside: Flag = False

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
