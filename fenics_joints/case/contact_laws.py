"""Sections of a case file about laws of contacts, by openings and slips instead of strains."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from fenics_joints.case.values import Modulus, Positive, Section, quantity
from fenics_joints.joint_laws import CoulombStick, ElasticFriction, Gap, JointLaw

if TYPE_CHECKING:
    from fenics_joints.preload import ContactState


PerLength = quantity("Pa/m", 0, above=True)
Length = quantity("m", 0)


class ContactSection(Section):
    """A law of a contact's pairs; it asks for no elastic modulus."""

    #: Numbers of the law with their units, named as its parameters.
    units: ClassVar[dict[str, str]]
    #: Whether it bears on the opening, and takes the pressure of the bolts' preload.
    presses: ClassVar[bool] = False

    @abstractmethod
    def contact_law(self, state: ContactState | None) -> JointLaw:
        """The law, about a preload state, or without one."""

    def needs_modulus(self) -> bool:
        """Whether an elastic modulus must come from the joint: never."""
        return False

    def pressure(self, state: ContactState | None) -> np.ndarray | float:
        """Pressure at rest, Pa, (P, 1); where a pair is open minus what would close it."""
        if state is None:
            return -self.normal_stiffness * self.gap
        # By its status: the gap of a closed pair is zero but for round-off.
        away = -self.normal_stiffness * np.maximum(state.gap, 0.0)
        return np.where(state.closed, state.pressure, away)[:, None]


class CoulombSection(ContactSection):
    """``[nonlinear.NAME]`` with ``law = "coulomb"``: elastic stick and friction on a contact.

    Elastic dry friction under a normal load that varies, in a plane or in space. The pressure is
    that of the bolts' preload, and changes with the opening; without bolts there is none at rest,
    and a ``gap``.
    """

    units: ClassVar = {"normal_stiffness": "Pa/m", "tangential_stiffness": "Pa/m", "friction": ""}
    presses: ClassVar = True

    law: Literal["coulomb"]
    normal_stiffness: PerLength
    tangential_stiffness: PerLength
    friction: Positive
    gap: Length = 0.0

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactSection`."""
        return CoulombStick(
            self.normal_stiffness, self.tangential_stiffness, self.friction, self.pressure(state)
        )


class UnilateralSection(ContactSection):
    """``[nonlinear.NAME]`` with ``law = "unilateral"``: a contact that presses, without friction.

    Pressure and ``gap`` as of ``coulomb``.
    """

    units: ClassVar = {"normal_stiffness": "Pa/m"}
    presses: ClassVar = True

    law: Literal["unilateral"]
    normal_stiffness: PerLength
    gap: Length = 0.0

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactSection`."""
        k = self.normal_stiffness
        return CoulombStick(k, k, 0.0, self.pressure(state))


class ElasticFrictionSection(ContactSection):
    """``[nonlinear.NAME]`` with ``law = "elastic_friction"``: sticks, and slides at a ``strength``.

    Jenkins' element all over a closed contact: the normal load does not change.
    """

    units: ClassVar = {"stiffness": "Pa/m", "strength": "Pa"}

    law: Literal["elastic_friction"]
    stiffness: PerLength
    strength: Modulus

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactSection`."""
        return ElasticFriction(self.stiffness, self.strength)


class GapSection(ContactSection):
    """``[nonlinear.NAME]`` with ``law = "gap"``: slips freely up to a ``gap`` to all sides.

    As a bolt in its hole; beyond, a spring stops it.
    """

    units: ClassVar = {"stiffness": "Pa/m", "gap": "m"}

    law: Literal["gap"]
    stiffness: PerLength
    gap: Length

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactSection`."""
        return Gap(self.stiffness, self.gap)
