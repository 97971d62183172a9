"""The sections of a case file about contacts and the bolts that press them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, model_validator

from fenics_joints.case.values import (
    Density,
    Direction,
    Length,
    Modulus,
    Poisson,
    Positive,
    Section,
    Share,
    Size,
    chosen,
    quantity,
)
from fenics_joints.preload import BeamBolt, PretensionSection, WasherForce
from fenics_joints.preload.threads import thread
from fenics_joints.preload.torque import motosh_force, nut_factor_force

_Force = quantity("N", 0, above=True)
_Torque = quantity("N*m", 0, above=True)


def known_thread(name: str) -> str:
    """The full name of a thread; raises InputError if there is none."""
    return thread(name).name


class ContactSection(Section):
    """``[contacts.NAME]``: two faces of different bodies; ``upper`` is the smaller or finer one.

    ``friction`` is Coulomb's coefficient; ``gap`` is beside that of the mesh, negative for an
    interference; ``bonded`` faces are glued.
    """

    lower: str
    upper: str
    friction: Share = 0.0
    gap: Length = 0.0
    bonded: bool = False


class _BoltSection(Section):
    """``[bolts.NAME]``: two faces pulled together by a force, or by a torque on a thread.

    A torque takes the ``thread`` and either ``friction``, one coefficient for thread and head
    (Motosh, Fronk et al. 2019, eq. 8), or a ``nut_factor`` (T = K d F).
    """

    lower: str
    upper: str
    force: _Force | None = None
    torque: _Torque | None = None
    thread: Annotated[str, AfterValidator(known_thread)] | None = None
    friction: Share | None = None
    nut_factor: Positive | None = None

    @model_validator(mode="after")
    def _one_way(self) -> _BoltSection:
        if (self.force is None) == (self.torque is None):
            raise ValueError("expected either force or torque")
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

    The diameter is that of the shank, by default the thread's. ``head_mass`` sits on each end.
    """

    kind: Literal["beam"]
    diameter: Size | None = None
    E: Modulus = 210e9
    nu: Poisson = 0.3
    rho: Density = 7850.0
    head_mass: quantity("kg", 0) = 0.0

    @model_validator(mode="after")
    def _has_diameter(self) -> BeamBoltSection:
        if self.diameter is None and self.thread is None:
            raise ValueError("a beam needs its diameter, or a thread that says it")
        return self

    def bolt(self, name: str) -> BeamBolt:
        """The bolt under its force."""
        shank = thread(self.thread).diameter if self.diameter is None else self.diameter
        return BeamBolt(
            name,
            self.lower,
            self.upper,
            self.preload(),
            shank,
            self.E,
            self.nu,
            self.rho,
            self.head_mass,
        )


class PretensionBoltSection(_BoltSection):
    """``kind = "section"``: a meshed bolt, cut through its shank; lower and upper are the cut's."""

    kind: Literal["section"]
    axis: Direction | None = None

    def bolt(self, name: str) -> PretensionSection:
        """The bolt under its force."""
        return PretensionSection(name, self.lower, self.upper, self.preload(), self.axis)


class WasherBoltSection(_BoltSection):
    """``kind = "washers"``: an even pressure on the faces under the washers."""

    kind: Literal["washers"]
    axis: Direction | None = None

    def bolt(self, name: str) -> WasherForce:
        """The bolt under its force."""
        return WasherForce(name, self.lower, self.upper, self.preload(), self.axis)


Bolt = chosen("kind", BeamBoltSection, PretensionBoltSection, WasherBoltSection)
