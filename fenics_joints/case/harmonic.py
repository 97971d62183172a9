"""Sections of a case file about nonlinear joints and contacts, and their response to forces."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fenics_joints.case.own_code import find
from fenics_joints.case.usual import usual
from fenics_joints.case.values import (
    CaseSection,
    Direction,
    File,
    ModeCount,
    Modulus,
    Point,
    Positive,
    Share,
    Size,
    Written,
    ascending,
    chosen,
    in_si,
    listed,
    quantity,
)
from fenics_joints.errors import InputError
from fenics_joints.joint_laws import (
    Backbone,
    Bilinear,
    CoulombStick,
    ElasticFriction,
    GapSpring,
    Iwan,
    IwanLayer,
    JointLaw,
    RichardAbbott,
    Segalman,
)
from fenics_joints.units import to_si

if TYPE_CHECKING:
    from fenics_joints.preload import ContactState


PerLength = usual(quantity("Pa/m", 0, above=True), "per length")
Stress = usual(Modulus, "stress")
Length = quantity("m", 0)


class ContactLawSection(CaseSection):
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


class CoulombSection(ContactLawSection):
    """``[nonlinear.NAME]`` with ``law = "coulomb"``: elastic stick and friction on a contact.

    Elastic dry friction under a normal load that varies, in a plane or in space. The pressure is
    that of the bolts' preload, and changes with the opening; without bolts there is none at rest.

    Attributes:
        law: Which law it is.
        normal_stiffness: Stiffness per area against closing.
        tangential_stiffness: Stiffness per area against slip.
        friction: Coulomb's coefficient.
        gap: Gap at rest, of a contact without a preload.
    """

    units: ClassVar = {"normal_stiffness": "Pa/m", "tangential_stiffness": "Pa/m", "friction": ""}
    presses: ClassVar = True

    law: Literal["coulomb"]
    normal_stiffness: PerLength
    tangential_stiffness: PerLength
    friction: usual(Positive, "friction")
    gap: Length = 0.0

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactLawSection`."""
        return CoulombStick(
            self.normal_stiffness, self.tangential_stiffness, self.friction, self.pressure(state)
        )


class UnilateralSection(ContactLawSection):
    """``[nonlinear.NAME]`` with ``law = "unilateral"``: a contact that presses, without friction.

    Attributes:
        law: Which law it is.
        normal_stiffness: Stiffness per area against closing.
        gap: Gap at rest, of a contact without a preload.
    """

    units: ClassVar = {"normal_stiffness": "Pa/m"}
    presses: ClassVar = True

    law: Literal["unilateral"]
    normal_stiffness: PerLength
    gap: Length = 0.0

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactLawSection`."""
        k = self.normal_stiffness
        return CoulombStick(k, k, 0.0, self.pressure(state))


class ElasticFrictionSection(ContactLawSection):
    """``[nonlinear.NAME]`` with ``law = "elastic_friction"``: Jenkins' element all over a closed
    contact.

    Attributes:
        law: Which law it is.
        stiffness: Stiffness per area against slip.
        strength: Shear stress at which it slides; the normal load does not change.
    """

    units: ClassVar = {"stiffness": "Pa/m", "strength": "Pa"}

    law: Literal["elastic_friction"]
    stiffness: PerLength
    strength: Stress

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactLawSection`."""
        return ElasticFriction(self.stiffness, self.strength)


class GapSection(ContactLawSection):
    """``[nonlinear.NAME]`` with ``law = "gap"``: free slip in all directions up to a stop.

    Attributes:
        law: Which law it is.
        stiffness: Stiffness per area of the stop.
        gap: Slip at which it stops, as of a bolt in its hole.
    """

    units: ClassVar = {"stiffness": "Pa/m", "gap": "m"}

    law: Literal["gap"]
    stiffness: PerLength
    gap: Length

    def contact_law(self, state: ContactState | None) -> JointLaw:
        """See `ContactLawSection`."""
        return GapSpring(self.stiffness, self.gap)


Force = quantity("N", 0, above=True)
Frequency = quantity("Hz", 0, above=True)
Shape = quantity("", -0.99, 10)
_Ratios = Annotated[list[Share], BeforeValidator(listed), Field(min_length=1)]
#: Unit of the levels of a base's motion.
_LEVEL_UNITS = {"acceleration": "m/s2", "displacement": "m"}


class Hysteretic(CaseSection):
    """A backbone with Masing's rule, as parallel sliders.

    Attributes:
        law: Which law it is.
        stress: What yields: the shear of the interface (the paper's c55 and c66), or the equivalent
            stress of tension and shear together, of a layer.
        sliders: How many sliders.
        thickness: Thickness of the layer whose strain the moduli belong to, if it is not the meshed
            one; a contact has none.
        amplitudes: Least and largest strain, or slip of a contact in m, for which the sliders are
            placed; by default 0.1 and 2 times the strain at the knee, or the responses' strains.
        E_e: Modulus at rest; the joint's by default.
        E_p: Modulus after yield.
        S_y: Yield stress.
    """

    #: The law's curve, its arguments with their units, and which is its modulus at rest.
    curve: ClassVar[type[Backbone]]
    units: ClassVar[dict[str, str]]
    stiffness: ClassVar[str]

    stress: Literal["shear", "equivalent"] = "shear"
    sliders: Annotated[int, Field(ge=1, le=200, strict=True)] = 24
    thickness: Size | None = None
    amplitudes: ascending(quantity("", 0, above=True)) | None = None

    def make(self, E: float | None, G: float | None, meshed: float) -> JointLaw:
        """The law.

        Args:
            E: Normal modulus of the joint, Pa; None for a contact.
            G: Its shear modulus, Pa; None for a contact.
            meshed: Thickness of the layer as meshed, m; 1 for a contact, whose strain is its slip.
        """
        ratio = 1.0 if self.thickness is None else self.thickness / meshed
        if self.stress == "shear":
            backbone = self.backbone(None if G is None else G * ratio)
            return Iwan(backbone, self.sliders, thickness=ratio, amplitudes=self.amplitudes)
        backbone = self.backbone(E * ratio)
        return IwanLayer(
            backbone, G * ratio, self.sliders, thickness=ratio, amplitudes=self.amplitudes
        )

    def backbone(self, modulus: float | None) -> Backbone:
        """The curve; ``modulus``, Pa, is that of the joint, for one that gives none here."""
        own = {key: getattr(self, key) for key in self.units}
        return self.curve(**own | {self.stiffness: own[self.stiffness] or modulus})

    def needs_modulus(self) -> bool:
        """Whether moduli must come from the joint."""
        return getattr(self, self.stiffness) is None or self.stress == "equivalent"


class RichardAbbottSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "richard_abbott"`` (Iranzad and Ahmadian 2012, eq. 4).

    Attributes:
        n: Sharpness of the knee.
    """

    curve: ClassVar = RichardAbbott
    stiffness: ClassVar = "E_e"
    units: ClassVar = {"E_e": "Pa", "E_p": "Pa", "S_y": "Pa", "n": ""}

    law: Literal["richard_abbott"]
    E_e: Stress | None = None
    E_p: usual(quantity("Pa", 0), "stress")
    S_y: Stress
    n: Positive


class SegalmanSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "segalman"``: the four-parameter Iwan model.

    Attributes:
        F_S: Stress of macroslip.
        K_T: Modulus at rest; the joint's by default.
        chi: Exponent of microslip.
        beta: Stiffness lost at macroslip over the stiffness lost before.
    """

    curve: ClassVar = Segalman
    stiffness: ClassVar = "K_T"
    units: ClassVar = {"F_S": "Pa", "K_T": "Pa", "chi": "", "beta": ""}

    law: Literal["segalman"]
    F_S: Stress
    K_T: Stress | None = None
    chi: Shape
    beta: quantity("", 0)


class BilinearSection(Hysteretic):
    """``[nonlinear.NAME]`` with ``law = "bilinear"``: one slider beside a spring."""

    curve: ClassVar = Bilinear
    stiffness: ClassVar = "E_e"
    units: ClassVar = {"E_e": "Pa", "E_p": "Pa", "S_y": "Pa"}

    law: Literal["bilinear"]
    E_e: Stress | None = None
    E_p: usual(quantity("Pa", 0), "stress")
    S_y: Stress


class OwnLawSection(CaseSection):
    """``[nonlinear.NAME]`` with ``law = "module:name"``: a joint law of your own, on a layer.

    Attributes:
        law: A subclass of `fenics_joints.joint_laws.JointLaw`.
        values: What its constructor takes, by name: numbers in SI units, or with a unit if the
            class has ``units``, a unit by name.
    """

    law: str
    values: dict[str, Written] = {}

    @model_validator(mode="after")
    def _can_be_made(self) -> OwnLawSection:
        self.make(None, None, 1.0)
        return self

    @property
    def units(self) -> dict[str, str]:
        """Units of the values, ``""`` where the class gives none."""
        units = getattr(self._class, "units", {})
        return {key: units.get(key, "") for key in self.values}

    @property
    def _class(self) -> type[JointLaw]:
        what = "a subclass of fenics_joints.joint_laws.JointLaw"
        found = find(self.law, type, what)
        if not issubclass(found, JointLaw):
            raise ValueError(f"{self.law}: expected {what}")
        return found

    def numbers(self) -> dict[str, float]:
        """The values in SI units."""
        return in_si(self.values, self.units)

    def make(self, E: float | None, G: float | None, meshed: float) -> JointLaw:
        """The law; it has its own moduli, see `Hysteretic.make`."""
        try:
            return self._class(**self.numbers())
        except TypeError as error:
            raise ValueError(f"values: {error}") from None

    def needs_modulus(self) -> bool:
        """Whether moduli must come from the joint: never."""
        return False


NonlinearSection = chosen(
    "law",
    RichardAbbottSection,
    SegalmanSection,
    BilinearSection,
    CoulombSection,
    UnilateralSection,
    ElasticFrictionSection,
    GapSection,
    own=OwnLawSection,
)


class DirectedPoint(CaseSection):
    """Where and along what a force acts or a sensor measures.

    Attributes:
        point: The place.
        direction: The direction.
    """

    point: Point
    direction: Direction


class BaseSection(CaseSection):
    """``[harmonic.base]``: the base that holds the supports moves, instead of a force.

    Attributes:
        direction: Direction of the motion.
        motion: What the levels are amplitudes of; responses are relative to the base.
    """

    direction: Direction
    motion: Literal["acceleration", "displacement"] = "acceleration"


class HarmonicLoad(CaseSection):
    """``[[harmonic.loads]]``: a further force beside the first one or the base.

    Attributes:
        point: The place.
        direction: The direction.
        share: Its amplitude as a share of the level.
        harmonic: Of which harmonic it is.
        phase_degrees: By how much it comes earlier than the first force or the base.
    """

    point: Point
    direction: Direction
    share: quantity("", -1e6, 1e6) = 1.0
    harmonic: Annotated[int, Field(ge=1, le=51, strict=True)] = 1
    phase_degrees: quantity("", -360, 360) = 0.0


class IdentifySection(CaseSection):
    """``[harmonic.identify]``: the laws' numbers from one level's curve, or a mode's amplitude.

    Attributes:
        level: Level of the curve in harmonic.measured; without it, or with a mode, the data are
            frequency and damping over amplitude.
        mode: Mode of [test.amplitude], or of a test by level.
        parameters: Names of the numbers to find.
        start: Where to start from; the case's own numbers by default.
        method: Objective of the paper's eq. 6 ("direct"), its squares ("gradient"), or both.
        points: Number of points of the curve.
        loops: Table of loops of force against response, which enter beside the curve.
        noise: Relative standard deviation of the data.
        rest: Relative standard deviation of the model's frequency at rest, 1 % by default.
        rest_damping: That of its damping at rest; by default the lowest damping measured.
    """

    level: Force | None = None
    mode: str | None = None
    parameters: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
    start: dict[str, Written] = {}
    method: Literal["direct", "gradient", "both"] | None = None
    points: Annotated[int, Field(ge=3, le=1000, strict=True)] = 9
    loops: File | None = None
    noise: Share = 0.01
    rest: Share | None = None
    rest_damping: Share | None = None

    @property
    def by_amplitude(self) -> bool:
        """Whether a mode over its amplitude is among the data."""
        return self.level is None or self.mode is not None

    @property
    def methods(self) -> tuple[str, ...]:
        """The searches: both unless the case says it, of a mode over its amplitude by gradient."""
        if self.method is None:
            return ("gradient",) if self.by_amplitude else ("direct", "gradient")
        return ("direct", "gradient") if self.method == "both" else (self.method,)

    def values(self, nonlinear: Mapping[str, NonlinearSection]) -> dict[str, float]:
        """Values, SI, that the identification starts from, by parameter.

        Args:
            nonlinear: The laws of the case, by their name.
        """
        known = identifiable(nonlinear)
        given = {name: to_si(value, known[name][1]) for name, value in self.start.items()}
        return {name: given.get(name, known[name][0]) for name in self.parameters}


class HarmonicSection(CaseSection):
    """``[harmonic]``: what `fenics-joints harmonic` computes.

    Attributes:
        force: Where the force acts.
        base: A base that moves, instead of the force.
        loads: Further forces.
        sensor: Where the response is measured.
        levels: Amplitudes of the force, or of the base's motion.
        band: Frequencies, [low, high].
        damping: Damping ratios of the modes at rest, the last one for all further modes.
        response: What the sensor measures.
        measured: Table with the columns level, frequency and amplitude.
        backbone: Whether the backbone is computed.
        quasi_static: Whether the mode over its amplitude comes from static loads too, of the
            reduced or of the full model.
        bifurcations: Whether to find where the responses' stability changes, or to follow the
            motions that begin there too.
        harmonics: How many harmonics.
        samples: Samples of a period, four for each harmonic at least.
        modes: How many modes of the reduced model.
        interface_modes: How many modes of the joints under static load; by default none of layers
            and 12 of contacts.
        identify: What to identify.
    """

    one_of = (("force", "base"),)
    force: DirectedPoint | None = None
    base: BaseSection | None = None
    loads: list[HarmonicLoad] = []
    sensor: DirectedPoint
    levels: Annotated[list[Force], BeforeValidator(listed), Field(min_length=1)]
    band: usual(ascending(Frequency), "frequency")
    damping: usual(_Ratios, "damping ratio")
    response: Literal["displacement", "velocity", "acceleration"] = "acceleration"
    measured: File | None = None
    backbone: bool = True
    quasi_static: Literal["no", "reduced", "full"] = "no"
    bifurcations: Literal["no", "find", "follow"] = "no"
    harmonics: Annotated[int, Field(ge=1, le=51, strict=True)] = 5
    samples: Annotated[int, Field(ge=8, le=65_536, strict=True)] = 128
    modes: ModeCount = 12
    interface_modes: Annotated[int, Field(ge=0, le=10_000, strict=True)] | None = None
    identify: IdentifySection | None = None

    @model_validator(mode="before")
    @classmethod
    def _levels(cls, data: Any) -> Any:
        """Levels of a base in its own unit, as bare numbers."""
        base = data.get("base") if isinstance(data, dict) else None
        if not isinstance(base, dict) or "levels" not in data:
            return data
        unit = _LEVEL_UNITS.get(base.get("motion", "acceleration"), "m/s2")
        try:
            levels = [to_si(level, unit) for level in listed(data["levels"])]
        except InputError as error:
            raise ValueError(f"levels of a base: {error}") from error
        return {**data, "levels": levels}

    @model_validator(mode="after")
    def _one_excitation(self) -> HarmonicSection:
        if self.measured is not None and (self.base is not None or self.loads):
            raise ValueError("measured: expected one force alone, without a base or further loads")
        for load in self.loads:
            if load.harmonic > self.harmonics:
                raise ValueError(
                    f"loads: harmonic = {load.harmonic}: expected at most {self.harmonics}, the "
                    "case's harmonics"
                )
        return self

    @property
    def level_unit(self) -> str:
        """SI unit of the levels."""
        return "N" if self.base is None else _LEVEL_UNITS[self.base.motion]

    @model_validator(mode="after")
    def _enough_samples(self) -> HarmonicSection:
        if self.samples < 4 * self.harmonics:
            raise ValueError(
                f"samples = {self.samples}: expected at least {4 * self.harmonics}, four for each "
                "harmonic"
            )
        level = None if self.identify is None else self.identify.level
        if level is not None and level not in self.levels:
            raise ValueError(f"identify.level = {level:g} N: expected one of the levels")
        return self


def identifiable(nonlinear: Mapping[str, NonlinearSection]) -> dict[str, tuple[float, str]]:
    """Value and unit of every number of the nonlinear laws, by NAME.KEY."""
    found = {}
    for name, section in nonlinear.items():
        own = section.numbers() if isinstance(section, OwnLawSection) else vars(section)
        for key, unit in section.units.items():
            value = own[key]
            if value is not None:
                found[f"{name}.{key}"] = (value, unit)
    return found
