"""Sections of a case file about nonlinear joints and their response to sinusoidal forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from fenics_joints.case_messages import did_you_mean, said
from fenics_joints.case_sections import (
    Count,
    Direction,
    Modulus,
    Point,
    Positive,
    Section,
    Share,
    Size,
    ascending,
    listed,
    quantity,
)

if TYPE_CHECKING:
    from fenics_joints.case import Case
    from fenics_joints.joint_laws import JointLaw

__all__ = [
    "CoulombSection", "HarmonicSection", "IdentifySection", "NonlinearSection", "Place",
    "check_harmonic", "identifiable",
]  # fmt: skip

Force = quantity("N", 0, above=True)
Frequency = quantity("Hz", 0, above=True)
PerLength = quantity("Pa/m", 0, above=True)
Shape = quantity("", -0.99, 0)


class Hysteretic(Section):
    """A backbone with Masing's rule, as parallel sliders.

    ``thickness`` is that of the layer whose strain the moduli belong to, where the joint is a
    contact of no thickness of its own: its slip over the thickness is the strain.
    """

    sliders: Annotated[int, Field(ge=1, le=200, strict=True)] = 10
    thickness: Size | None = None

    def _law(self, backbone) -> JointLaw:
        from fenics_joints.joint_laws import Iwan

        return Iwan(backbone, n_sliders=self.sliders)


class RichardAbbottSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "richard_abbott"`` (seed 003, eq. 4)."""

    units: ClassVar = {"E_e": "Pa", "E_p": "Pa", "S_y": "Pa", "n": ""}

    law: Literal["richard_abbott"]
    E_e: Modulus | None = None
    E_p: quantity("Pa", 0)
    S_y: Modulus
    n: Positive

    def make(self, G: float | None) -> JointLaw:
        """The law; ``G``, Pa, is the modulus of the joint, for one that gives none here."""
        from fenics_joints.joint_laws import RichardAbbott

        return self._law(RichardAbbott(self.E_e or G, self.E_p, self.S_y, self.n))

    def needs_modulus(self) -> bool:
        """Whether the elastic modulus must come from the joint."""
        return self.E_e is None


class SegalmanSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "segalman"``: the four-parameter Iwan model."""

    units: ClassVar = {"F_S": "Pa", "K_T": "Pa", "chi": "", "beta": ""}

    law: Literal["segalman"]
    F_S: Modulus
    K_T: Modulus | None = None
    chi: Shape
    beta: quantity("", 0)

    def make(self, G: float | None) -> JointLaw:
        """The law; ``G``, Pa, is the modulus of the joint, for one that gives none here."""
        from fenics_joints.joint_laws import Segalman

        return self._law(Segalman(self.F_S, self.K_T or G, self.chi, self.beta))

    def needs_modulus(self) -> bool:
        """Whether the elastic modulus must come from the joint."""
        return self.K_T is None


class BilinearSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "bilinear"``: one slider beside a spring."""

    units: ClassVar = {"E_e": "Pa", "E_p": "Pa", "S_y": "Pa"}

    law: Literal["bilinear"]
    E_e: Modulus | None = None
    E_p: quantity("Pa", 0)
    S_y: Modulus

    def make(self, G: float | None) -> JointLaw:
        """The law; ``G``, Pa, is the modulus of the joint, for one that gives none here."""
        from fenics_joints.joint_laws import Bilinear

        return self._law(Bilinear(self.E_e or G, self.E_p, self.S_y))

    def needs_modulus(self) -> bool:
        """Whether the elastic modulus must come from the joint."""
        return self.E_e is None


class CoulombSection(Section):
    """``[nonlinear.NAME]`` with ``law = "coulomb"``: elastic stick and friction on a contact.

    The pressure is that of the bolts' preload, and changes with the opening.
    """

    units: ClassVar = {
        "normal_stiffness": "Pa/m", "tangential_stiffness": "Pa/m", "friction": "",
    }  # fmt: skip

    law: Literal["coulomb"]
    normal_stiffness: PerLength
    tangential_stiffness: PerLength
    friction: Positive

    def needs_modulus(self) -> bool:
        """Whether an elastic modulus must come from the joint: never."""
        return False


def _kind(data: Any) -> str | None:
    kinds = {
        "richard_abbott": "<RichardAbbottSection>",
        "segalman": "<SegalmanSection>",
        "bilinear": "<BilinearSection>",
        "coulomb": "<CoulombSection>",
    }
    law = data.get("law") if isinstance(data, dict) else None
    return kinds.get(law) if isinstance(law, str) else None


NonlinearSection = Annotated[
    Annotated[RichardAbbottSection, Tag("<RichardAbbottSection>")]
    | Annotated[SegalmanSection, Tag("<SegalmanSection>")]
    | Annotated[BilinearSection, Tag("<BilinearSection>")]
    | Annotated[CoulombSection, Tag("<CoulombSection>")],
    Discriminator(_kind),
]


class Place(Section):
    """Where and how a force acts or a sensor measures."""

    point: Point
    direction: Direction


class IdentifySection(Section):
    """``[harmonic.identify]``: parameters of the laws from the curves of one level.

    The objective is the seed's eq. 6, or with ``method = "gradient"`` its squares.
    """

    level: Force
    parameters: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
    start: dict[str, float | str] = {}
    method: Literal["direct", "gradient", "both"] = "both"
    points: Annotated[int, Field(ge=3, strict=True)] = 9


class HarmonicSection(Section):
    """``[harmonic]``: what `fenics-joints harmonic` computes.

    ``levels`` are amplitudes of the force; ``damping`` the ratios of the modes at rest, the last
    one for all further modes; ``measured`` a table with the columns ``level``, ``frequency`` and
    ``amplitude``, of the ``response`` at the sensor.
    """

    force: Place
    sensor: Place
    levels: Annotated[list[Force], BeforeValidator(listed), Field(min_length=1)]
    band: ascending(Frequency)
    damping: Annotated[list[Share], BeforeValidator(listed), Field(min_length=1)]
    response: Literal["displacement", "velocity", "acceleration"] = "acceleration"
    measured: str | None = None
    backbone: bool = True
    harmonics: Annotated[int, Field(ge=1, le=51, strict=True)] = 5
    samples: Annotated[int, Field(ge=8, strict=True)] = 128
    modes: Count = 12
    interface_modes: Annotated[int, Field(ge=0, strict=True)] = 12
    identify: IdentifySection | None = None

    @model_validator(mode="after")
    def _enough_samples(self) -> HarmonicSection:
        if self.samples < 4 * self.harmonics:
            raise ValueError(
                f"samples = {self.samples}: expected at least {4 * self.harmonics}, four for each "
                "harmonic"
            )
        if self.identify is not None and self.identify.level not in self.levels:
            raise ValueError(
                f"identify.level = {self.identify.level:g} N: expected one of the levels"
            )
        return self


# -- checks ----------------------------------------------------------------------------------------


def check_harmonic(case: Case) -> list[str]:
    """What is wrong with a case's nonlinear joints and their response, a line each."""
    errors = []
    for name, section in case.nonlinear.items():
        errors += _check_nonlinear(case, name, section)
    if case.harmonic is None:
        return errors
    if not case.nonlinear:
        errors.append("harmonic: expected a nonlinear joint, in a section [nonlinear.NAME]")
    identify = case.harmonic.identify
    known = identifiable(case)
    for i, name in enumerate(identify.parameters if identify else ()):
        if name not in known:
            key = f"harmonic.identify.parameters[{i}]"
            errors.append(said(key, name, f"no such parameter{did_you_mean(name, list(known))}"))
    for name in identify.start if identify else ():
        if name not in identify.parameters:
            hint = did_you_mean(name, identify.parameters)
            key = f"harmonic.identify.start.{name}"
            value = identify.start[name]
            errors.append(said(key, value, f"is not in identify.parameters{hint}"))
    if identify is not None and case.harmonic.measured is None:
        errors.append("harmonic.identify: expected measured curves, harmonic.measured = 'FILE.csv'")
    return errors


def _check_nonlinear(case: Case, name: str, section) -> list[str]:
    key = f"nonlinear.{name}"
    if name in case.contacts:
        if section.needs_modulus():
            return [f"{key}: expected an elastic modulus, since a contact has none of its own"]
        if not isinstance(section, CoulombSection) and section.thickness is None:
            return [f"{key}.thickness: expected that of the layer whose strain is slip / thickness"]
        return []
    if name not in case.joints:
        known = did_you_mean(name, [*case.joints, *case.contacts])
        return [f"{key}: no joint or contact has that name{known}"]
    if isinstance(section, CoulombSection):
        return [said(f"{key}.law", "coulomb", "expected a contact of that name, not a layer")]
    if section.thickness is not None:
        return [said(f"{key}.thickness", section.thickness, "a layer has its own; expected none")]
    return []


def identifiable(case: Case) -> dict[str, tuple[float, str]]:
    """Value and unit of every number of the nonlinear laws, by NAME.KEY."""
    found = {}
    for name, section in case.nonlinear.items():
        for key, unit in section.units.items():
            value = getattr(section, key)
            if value is not None:
                found[f"{name}.{key}"] = (value, unit)
    return found
