"""Sections of a case file about a preload: contacts, bolts, and what acts on faces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from fenics_joints.case.usual import usual
from fenics_joints.case.values import (
    CaseSection,
    Density,
    Direction,
    Length,
    Modulus,
    Point,
    Poisson,
    Positive,
    Share,
    Size,
    chosen,
    nonzero,
    quantity,
)
from fenics_joints.errors import InputError
from fenics_joints.preload import (
    BeamBolt,
    Cylinder,
    Displacement,
    Obstacle,
    Plane,
    Pressure,
    PretensionSection,
    Sphere,
    Traction,
    WasherForce,
)
from fenics_joints.preload.threads import thread
from fenics_joints.preload.torque import motosh_force, nut_factor_force

_Force = quantity("N", 0, above=True)
_Torque = quantity("N*m", 0, above=True)


def known_thread(name: str) -> str:
    """The full name of a thread; raises InputError if there is none."""
    return thread(name).name


class ContactSection(CaseSection):
    """``[contacts.NAME]``: two faces of different bodies that may touch.

    Attributes:
        lower: Group of facets of one face.
        upper: The other face, the smaller or finer one.
        friction: Coulomb's coefficient.
        gap: Gap beside that of the mesh; negative for an interference.
        bonded: Whether the faces are glued.
    """

    lower: str
    upper: str
    friction: usual(Share, "friction") = 0.0
    gap: usual(Length, "gap") = 0.0
    bonded: bool = False


class _BoltSection(CaseSection):
    """``[bolts.NAME]``: two faces pulled together by a force, or by a torque on a thread.

    Attributes:
        kind: How the bolt is modelled.
        lower: Group of facets that the bolt presses.
        upper: The other group.
        force: Force of the bolt.
        torque: Tightening torque; needs the thread, and friction or nut_factor.
        thread: Such as "M10".
        friction: One coefficient for thread and head (Motosh; Fronk et al. 2019, eq. 8).
        nut_factor: K in T = K d F.
    """

    one_of = (("force", "torque"),)
    lower: str
    upper: str
    force: _Force | None = None
    torque: _Torque | None = None
    thread: Annotated[str, AfterValidator(known_thread)] | None = None
    friction: usual(Share, "friction") | None = None
    nut_factor: usual(Positive, "nut factor") | None = None

    @model_validator(mode="after")
    def _one_way(self) -> _BoltSection:
        ways = (self.friction is None, self.nut_factor is None)
        if self.torque is not None and (self.thread is None or sum(ways) != 1):
            raise ValueError(
                "torque needs the thread, such as thread = 'M10', and either friction or nut_factor"
            )
        if self.force is not None and not all(ways):
            raise ValueError("friction and nut_factor belong to a torque, but force is given")
        return self

    def preload(self) -> float:
        """Bolt force, N."""
        if self.force is not None:
            return self.force
        if self.nut_factor is not None:
            return nut_factor_force(self.torque, thread(self.thread).diameter, self.nut_factor)
        return motosh_force(self.torque, self.thread, self.friction, self.friction)


class BeamBoltSection(_BoltSection):
    """``kind = "beam"``: a beam between rigid spiders on the faces under the washers.

    Attributes:
        diameter: Of the shank; the thread's by default.
        E: Young's modulus.
        nu: Poisson's ratio.
        rho: Density.
        head_mass: Mass on each end.
    """

    kind: Literal["beam"]
    diameter: usual(Size, "diameter") | None = None
    E: usual(Modulus, "E") = 210e9
    nu: usual(Poisson, "nu") = 0.3
    rho: usual(Density, "rho") = 7850.0
    head_mass: quantity("kg", 0) = 0.0

    @model_validator(mode="after")
    def _has_diameter(self) -> BeamBoltSection:
        if self.diameter is None and self.thread is None:
            raise ValueError("a beam needs its diameter, or a thread that says it")
        return self

    def bolt(self, name: str) -> BeamBolt:
        """The bolt under its force."""
        shank = thread(self.thread).diameter if self.diameter is None else self.diameter
        own = (shank, self.E, self.nu, self.rho, self.head_mass)
        return BeamBolt(name, self.lower, self.upper, self.preload(), *own)


class _AxialBoltSection(_BoltSection):
    """A bolt whose force has a direction.

    Attributes:
        axis: Direction of the force; the faces' normal by default.
    """

    acts: ClassVar[type[PretensionSection | WasherForce]]

    axis: Direction | None = None

    def bolt(self, name: str) -> PretensionSection | WasherForce:
        """The bolt under its force."""
        return self.acts(name, self.lower, self.upper, self.preload(), self.axis)


class PretensionBoltSection(_AxialBoltSection):
    """``kind = "section"``: a meshed bolt, cut through its shank; lower and upper are the cut's."""

    acts = PretensionSection
    kind: Literal["section"]


class WasherBoltSection(_AxialBoltSection):
    """``kind = "washers"``: an even pressure on the faces under the washers."""

    acts = WasherForce
    kind: Literal["washers"]


Bolt = chosen("kind", BeamBoltSection, PretensionBoltSection, WasherBoltSection)


#: The tables of a case whose sections act on faces.
APPLIED = ("obstacles", "displacements", "loads")


def _one_given(value: list[float | None]) -> list[float | None]:
    if all(v is None for v in value):
        raise ValueError("expected at least one component that is a length, not 'free'")
    return value


def _other_than_zero(value: float) -> float:
    if value == 0:
        raise ValueError("expected a pressure other than zero")
    return value


_Lengths = Annotated[list[Length], Field(min_length=2, max_length=3)]
_ForceVector = Annotated[
    list[quantity("N")], Field(min_length=2, max_length=3), AfterValidator(nonzero)
]
_Pressure = Annotated[quantity("Pa"), AfterValidator(_other_than_zero)]
_Way = Annotated[
    list[quantity("m", word="free")], Field(min_length=2, max_length=3), AfterValidator(_one_given)
]


def _components(key: str, vector: Sequence | None, gdim: int) -> tuple | None:
    """A vector with a component for each dimension of the mesh."""
    if vector is None:
        return None
    if len(vector) != gdim:
        shown = ["free" if v is None else v for v in vector]
        raise InputError(f"{key} = {shown}: expected {gdim} components, as the mesh has dimensions")
    return tuple(vector)


def _in_mesh(key: str, vector: tuple[float, ...], gdim: int) -> tuple[float, ...]:
    """A place or direction in space as one of the mesh."""
    if any(vector[gdim:]):
        raise InputError(f"{key} = {list(vector)}: expected no z, as the mesh is plane")
    return vector[:gdim]


class _ObstacleSection(CaseSection):
    """``[obstacles.NAME]``: a face that may touch a rigid body.

    The body rests, is moved by its travel, or is pushed by a force as far as the structure gives
    way; it does not turn.

    Attributes:
        kind: Shape of the body.
        facets: Group of facets that may touch it.
        friction: Coulomb's coefficient.
        gap: Gap beside that of the mesh; negative for an interference.
        travel: By how much the body is moved.
        force: Force that pushes the body.
    """

    facets: str
    friction: usual(Share, "friction") = 0.0
    gap: usual(Length, "gap") = 0.0
    travel: usual(_Lengths, "travel") | None = None
    force: usual(_ForceVector, "face force") | None = None

    @model_validator(mode="after")
    def _one_way(self) -> _ObstacleSection:
        if self.travel is not None and self.force is not None:
            raise ValueError("expected travel, or force, or neither; both are given")
        return self

    @property
    def presses(self) -> bool:
        """Whether it does, not the bodies alone."""
        return self.force is not None or any(self.travel or ()) or self.gap < 0

    def shape(self, key: str, gdim: int) -> Plane | Sphere | Cylinder:
        """The rigid body, of a section ``key``, beside a mesh of so many dimensions."""
        raise NotImplementedError

    def obstacle(self, name: str, gdim: int) -> Obstacle:
        """The obstacle for a mesh of so many dimensions.

        Raises:
            InputError: If a vector has another number of components.
        """
        key = f"obstacles.{name}"
        return Obstacle(
            name,
            self.facets,
            self.shape(key, gdim),
            friction=self.friction,
            gap=self.gap,
            travel=_components(f"{key}.travel", self.travel, gdim),
            force=_components(f"{key}.force", self.force, gdim),
        )


class PlaneObstacle(_ObstacleSection):
    """``kind = "plane"``: a plane, solid behind it.

    Attributes:
        point: A point of the plane.
        normal: Its normal, towards the structure.
    """

    kind: Literal["plane"]
    point: Point
    normal: Direction

    def shape(self, key: str, gdim: int) -> Plane:
        """See `_ObstacleSection.shape`."""
        return Plane(
            _in_mesh(f"{key}.point", self.point, gdim), _in_mesh(f"{key}.normal", self.normal, gdim)
        )


class SphereObstacle(_ObstacleSection):
    """``kind = "sphere"``: a ball; on a plane mesh a disc.

    Attributes:
        centre: Its centre.
        radius: Its radius.
        inside: Whether the structure is inside it, in a cavity.
    """

    kind: Literal["sphere"]
    centre: Point
    radius: usual(Size, "length")
    inside: Annotated[bool, Field(strict=True)] = False

    def shape(self, key: str, gdim: int) -> Sphere:
        """See `_ObstacleSection.shape`."""
        return Sphere(_in_mesh(f"{key}.centre", self.centre, gdim), self.radius, self.inside)


class CylinderObstacle(_ObstacleSection):
    """``kind = "cylinder"``: a round pin without ends.

    Attributes:
        point: A point of its axis.
        axis: Direction of its axis.
        radius: Its radius.
        inside: Whether the structure is inside it, in a bore.
    """

    kind: Literal["cylinder"]
    point: Point
    axis: Direction
    radius: usual(Size, "length")
    inside: Annotated[bool, Field(strict=True)] = False

    def shape(self, key: str, gdim: int) -> Cylinder:
        """See `_ObstacleSection.shape`."""
        if gdim < 3:
            raise InputError(
                f"{key}.kind = 'cylinder': expected 'sphere', a disc, as the mesh is plane"
            )
        return Cylinder(self.point, self.axis, self.radius, self.inside)


ObstacleSection = chosen("kind", PlaneObstacle, SphereObstacle, CylinderObstacle)


class DisplacementSection(CaseSection):
    """``[displacements.NAME]``: a face that is moved as a whole, as by a grip.

    Vibration about that state leaves the face where it is.

    Attributes:
        facets: Group of facets.
        value: Displacement along each axis; "free" where the face is not held.
    """

    facets: str
    value: usual(_Way, "travel")

    def displacement(self, name: str, gdim: int) -> Displacement:
        """The displacement for a mesh of so many dimensions; InputError if it has others."""
        value = _components(f"displacements.{name}.value", self.value, gdim)
        return Displacement(name, self.facets, value)


class LoadSection(CaseSection):
    """``[loads.NAME]``: a force spread evenly over a face, or an even pressure on it.

    They keep their direction as the face moves. On a plane mesh forces are per metre of depth.

    Attributes:
        facets: Group of facets.
        force: The total force.
        pressure: The pressure.
    """

    one_of = (("force", "pressure"),)
    facets: str
    force: usual(_ForceVector, "face force") | None = None
    pressure: usual(_Pressure, "contact pressure") | None = None

    def load(self, name: str, gdim: int) -> Traction | Pressure:
        """The load on a mesh of so many dimensions; InputError if its force has others."""
        if self.pressure is not None:
            return Pressure(name, self.facets, self.pressure)
        return Traction(name, self.facets, _components(f"loads.{name}.force", self.force, gdim))
