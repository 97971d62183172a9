"""The sections of a case file as data, with their units and limits.

Each class is a table of the file and says in its docstring which. `case.case` puts them
together and checks them against one another.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    model_validator,
)

from fenics_joints.units import to_si

__all__ = [
    "AXES",
    "Attached",
    "AttachedMass",
    "AttachedSpring",
    "CutoffUpdate",
    "Diagnose",
    "FRFSection",
    "Held",
    "Joint",
    "MassSection",
    "Part",
    "PlannedTest",
    "Section",
    "SpringSection",
    "SupportSection",
    "Test",
    "Update",
    "ValidationTest",
    "ascending",
    "listed",
    "named",
    "quantity",
]

_NAME = r"[A-Za-z][A-Za-z0-9_-]*"
AXES = ("x", "y", "z")


# -- values ----------------------------------------------------------------------------------------


def quantity(unit: str, least: float = -math.inf, most: float = math.inf, above: bool = False):
    """The type of a float in SI ``unit`` from text; within limits, or above the lower one."""

    def read(value: Any) -> float:
        number = to_si(value, unit)
        if not (number > least if above else number >= least) or number > most:
            low = f"{'above' if above else 'at least'} {least:g} {unit}".rstrip()
            high = f" and at most {most:g} {unit}".rstrip() if most < math.inf else ""
            raise ValueError(f"expected {low}{high}")
        return number

    return Annotated[float, BeforeValidator(read)]


def listed(value: Any) -> Any:
    """A list, also of a single value."""
    return value if isinstance(value, list) else [value]


def _padded(vector: list[float]) -> tuple[float, ...]:
    return tuple(vector) + (0.0,) * (3 - len(vector))


def _nonzero(vector: list[float]) -> list[float]:
    if not any(vector) or not all(math.isfinite(c) for c in vector):
        raise ValueError("expected a finite vector that is not zero")
    return vector


def _parallel(a, b) -> bool:
    """Whether two vectors in space span less than a thousandth of a right angle, about."""
    cosine = sum(x * y for x, y in zip(a, b, strict=True)) / (math.hypot(*a) * math.hypot(*b))
    return abs(cosine) > 1 - 1e-6


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    return pair


Length = quantity("m")
Size = quantity("m", 0, above=True)
Gap = quantity("m", 0)
Modulus = quantity("Pa", 0, above=True)
Density = quantity("kg/m3", 0, above=True)
Mass = quantity("kg", 0, above=True)
Stiffness = quantity("N/m", 0, above=True)
Turning = quantity("N*m", 0, above=True)
Damper = quantity("N*m*s", 0)
Inertia = quantity("kg*m2", 0)
Spacing = quantity("Hz", 0)
Positive = quantity("", 0, above=True)
Share = quantity("", 0)
Poisson = quantity("", -0.999, 0.4999)
Point = Annotated[list[Length], Field(min_length=2, max_length=3), AfterValidator(_padded)]
Direction = Annotated[
    list[float],
    Field(min_length=2, max_length=3),
    AfterValidator(_nonzero),
    AfterValidator(_padded),
]
Names = Annotated[list[str], BeforeValidator(listed), Field(min_length=1)]
Count = Annotated[int, Field(ge=1, strict=True)]


def ascending(kind):
    """The type of a pair [low, high] of a kind of number."""
    return Annotated[tuple[kind, kind], AfterValidator(_ascending)]


# -- sections --------------------------------------------------------------------------------------


class Section(BaseModel):
    """A table of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class PartTolerance(Section):
    """How well a part is known: relative standard deviations."""

    E: Share | None = None
    nu: Share | None = None
    rho: Share | None = None
    thickness: Share | None = None
    width: Share | None = None


class PartBounds(Section):
    """Bounds of a part's parameters; thickness and width as actual over nominal."""

    E: ascending(Modulus) | None = None
    nu: ascending(Poisson) | None = None
    rho: ascending(Density) | None = None
    thickness: ascending(Positive) | None = None
    width: ascending(Positive) | None = None


class Part(Section):
    """``[parts.NAME]``: cells of a solid material, with E and one of G and nu.

    Its thickness is along ``normal`` and its width along ``across``: y, or z if the normal is y.
    """

    cells: Names
    E: Modulus
    G: Modulus | None = None
    nu: Poisson | None = None
    rho: Density
    normal: Direction = (0.0, 0.0, 1.0)
    across: Direction | None = None
    tolerance: PartTolerance = PartTolerance()
    bounds: PartBounds = PartBounds()

    @model_validator(mode="after")
    def _one_of_G_and_nu(self) -> Part:
        if (self.G is None) == (self.nu is None):
            raise ValueError("expected E and either G or nu")
        if not -1 < self.nominal()["nu"] < 0.5:
            raise ValueError(
                f"E = {self.E:g} Pa and G = {self.G:g} Pa give nu = {self.nominal()['nu']:g}; "
                "expected E < 3 G, so that nu < 0.5"
            )
        return self

    @model_validator(mode="after")
    def _across_the_normal(self) -> Part:
        if self.across is not None and _parallel(self.across, self.normal):
            raise ValueError(
                f"across = {list(self.across)}: expected a direction that is not parallel to "
                f"normal = {list(self.normal)}"
            )
        return self

    def nominal(self, width: bool = False) -> dict[str, float]:
        """Value of each parameter; thickness, and width if asked for, relative to the mesh's."""
        nu = self.E / (2 * self.G) - 1 if self.nu is None else self.nu
        values = {"E": self.E, "nu": nu, "rho": self.rho, "thickness": 1.0}
        return values | ({"width": 1.0} if width else {})

    def widens(self) -> tuple[float, ...]:
        """Direction of the width."""
        if self.across is not None:
            return self.across
        y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        return z if _parallel(y, self.normal) else y


class JointTolerance(Section):
    """How well a joint is known: relative standard deviations."""

    E: Share | None = None
    G: Share | None = None
    nu: Share | None = None
    h: Share | None = None
    rho: Share | None = None
    thickness: Share | None = None
    k1: Share | None = None
    k2: Share | None = None
    k_axial: Share | None = None
    c: Share | None = None


class JointBounds(Section):
    """Bounds of a joint's parameters."""

    E: ascending(Modulus) | None = None
    G: ascending(Modulus) | None = None
    nu: ascending(Poisson) | None = None
    h: ascending(Size) | None = None
    rho: ascending(Density) | None = None
    thickness: ascending(Positive) | None = None
    k1: ascending(Turning) | None = None
    k2: ascending(Turning) | None = None
    k_axial: ascending(Stiffness) | None = None
    c: ascending(Damper) | None = None


#: What a joint must have by its law, and what it may have; all else is refused.
_JOINT_KEYS = {
    "transition": (("E", "nu", "h"), ("meshed", "rho")),
    "generic": (("k1", "k2"), ("c", "k_axial")),
}
_LAYER_KEYS = ("E", "G"), ("rho",)


class Joint(Section):
    """``[joints.NAME]``: a thin layer of cells; ``bolted`` says that it lies under bolts.

    ``bolts`` are points on the axes of the bolts through it or beside it; by default those that the
    mesh's builder knows. A diagnosis splits the joint into zones around them.

    With ``law = "transition"`` (seed 000) it has E, nu and its thickness ``h`` in place of G; the
    mesh's is ``meshed``, by default measured between the faces of each of its rings, and ``cells``
    may be a pattern such as ``ring_*``: rings with one set of parameters. Its density is zero
    without ``rho``; with ``rho = "average"`` it is that of the bodies, see `case_densities`.

    With ``law = "generic"`` (seed 002) it is a lap of beams (``builder = "offset_beams"``) with the
    stiffness of slap ``k1`` and of slip ``k2`` of each joint element, N m, the damping of slip
    ``c``, N m s, and, if it is not the beams' own, the axial stiffness ``k_axial``, N/m.
    """

    cells: Names
    law: Literal["isotropic", "uncoupled", "constrained", "transition", "generic"] = "uncoupled"
    E: Modulus | None = None
    G: Modulus | None = None
    nu: Poisson | None = None
    h: Size | None = None
    meshed: Size | None = None
    rho: Density | None = None
    k1: Turning | None = None
    k2: Turning | None = None
    k_axial: Stiffness | None = None
    c: Damper | None = None
    bolted: bool = False
    bolts: Annotated[list[Point], Field(min_length=1)] | None = None
    normal: Direction = (0.0, 0.0, 1.0)
    tolerance: JointTolerance = JointTolerance()
    bounds: JointBounds = JointBounds()

    @model_validator(mode="after")
    def _definite(self) -> Joint:
        own, more = _JOINT_KEYS.get(self.law, _LAYER_KEYS)
        allowed = {"cells", "law", "bolted", "bolts", "normal", "tolerance", "bounds", *own, *more}
        missing = [key for key in own if getattr(self, key) is None]
        given = [key for key in self.model_fields_set if getattr(self, key) is not None]
        extra = sorted(set(given) - allowed)
        if missing or extra:
            wrong = [f"{key} is missing" for key in missing] + [f"{key} is given" for key in extra]
            expected = ", ".join(own)
            raise ValueError(f"{', '.join(wrong)}: expected {expected} with law = '{self.law}'")
        if self.law in ("isotropic", "constrained") and not self.E < 3 * self.G:
            raise ValueError(
                f"E = {self.E:g} Pa and G = {self.G:g} Pa: expected E < 3 G with law = "
                f"'{self.law}' (nu < 0.5)"
            )
        return self

    @model_validator(mode="after")
    def _bolts_apart(self) -> Joint:
        for i, bolt in enumerate(self.bolts or []):
            if bolt in self.bolts[:i]:
                raise ValueError(
                    f"bolts[{i}] = {list(bolt)} m is there already: expected each bolt once"
                )
        return self

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; a density only if the file gives one."""
        rho = {} if self.rho is None else {"rho": self.rho}
        if self.law == "transition":
            return {"E": self.E, "nu": self.nu, **rho, "h": self.h}
        if self.law == "generic":
            axial = {} if self.k_axial is None else {"k_axial": self.k_axial}
            return {"k1": self.k1, "k2": self.k2, **axial, "c": self.c or 0.0}
        return {"E": self.E, "G": self.G, **rho, "thickness": 1.0}


class PointsSection(Section):
    """Something at points."""

    points: Annotated[list[Point], Field(min_length=1)]
    tolerance: Share | None = None


class MassSection(PointsSection):
    """``[masses.NAME]``: a total mass in equal shares at points.

    ``travel`` is where the first point may sit along ``along``; the others move with it. On beams
    (``builder = "offset_beams"``) each point may have a rotary ``inertia``.
    """

    mass: Mass
    inertia: Inertia | None = None
    travel: ascending(Length) | None = None
    along: Literal["x", "y", "z"] = "x"

    @model_validator(mode="after")
    def _starts_inside(self) -> MassSection:
        if self.travel is not None:
            start = self.points[0][AXES.index(self.along)]
            if not self.travel[0] <= start <= self.travel[1]:
                raise ValueError(
                    f"travel = {list(self.travel)} m: expected a range that holds the first "
                    f"point's {self.along} = {start:g} m"
                )
        return self

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; the travel is the distance from the points in the case."""
        return {"mass": self.mass} | ({} if self.travel is None else {"travel": 0.0})

    def shift(self) -> tuple[float, float] | None:
        """Range of the distance from the first point, m."""
        if self.travel is None:
            return None
        start = self.points[0][AXES.index(self.along)]
        return self.travel[0] - start, self.travel[1] - start


class SpringSection(PointsSection):
    """``[springs.NAME]``: equal springs to the ground at points."""

    direction: Direction
    stiffness: Stiffness

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; the stiffness is that of each spring."""
        return {"stiffness": self.stiffness}


class AttachedMass(MassSection):
    """``[attached.NAME]`` with ``kind = "mass"``: there, but not in the nominal model."""

    kind: Literal["mass"]

    def nominal(self) -> dict[str, float]:
        """Value of each parameter in the case; where it sits is not one of them."""
        return {"mass": self.mass}

    def absent(self) -> dict[str, float]:
        """Value of each parameter when the mass is not there."""
        return {"mass": 0.0} | ({} if self.travel is None else {"travel": 0.0})


class AttachedSpring(SpringSection):
    """``[attached.NAME]`` with ``kind = "spring"``: there, but not in the nominal model."""

    kind: Literal["spring"]

    def absent(self) -> dict[str, float]:
        """Value of each parameter when the springs are not there."""
        return {"stiffness": 0.0}


def _attached_kind(data: Any) -> str | None:
    kind = data.get("kind") if isinstance(data, dict) else None
    kinds = {"mass": "<AttachedMass>", "spring": "<AttachedSpring>"}
    return kinds.get(kind) if isinstance(kind, str) else None


Attached = Annotated[
    Annotated[AttachedMass, Tag("<AttachedMass>")]
    | Annotated[AttachedSpring, Tag("<AttachedSpring>")],
    Discriminator(_attached_kind),
]


class SupportSection(Section):
    """``[supports.NAME]``: facets that cannot move in some directions."""

    facets: str
    directions: list[Literal["x", "y", "z"]] = Field(["x", "y", "z"], min_length=1)


class LineOfSensors(Section):
    """``[test.sees]`` with sensors along an axis."""

    along: Literal["x", "y", "z"]
    positions: Annotated[list[Length], Field(min_length=1)]
    at: dict[Literal["x", "y", "z"], Annotated[list[Length], BeforeValidator(listed)]] = {}
    direction: Direction

    @model_validator(mode="after")
    def _one_for_each(self) -> LineOfSensors:
        for axis, values in self.at.items():
            if len(values) not in (1, len(self.positions)):
                raise ValueError(
                    f"at.{axis} has {len(values)} values: expected one, or {len(self.positions)}, "
                    "one for each position"
                )
        return self

    def points(self) -> list[tuple[float, ...]]:
        """Positions, m, each of shape (3,)."""
        n = len(self.positions)
        at = {axis: values * (n if len(values) == 1 else 1) for axis, values in self.at.items()}
        at[self.along] = self.positions
        return list(zip(*(at.get(axis, [0.0] * n) for axis in AXES), strict=True))

    def directions(self) -> list[tuple[float, ...]]:
        """A direction for each point."""
        return [self.direction] * len(self.positions)


class ListOfSensors(Section):
    """``[test.sees]`` with sensors anywhere, in one direction or each in its own."""

    at_points: Annotated[list[Point], Field(min_length=1, alias="points")]
    direction: Direction | None = None
    each: Annotated[list[Direction] | None, Field(alias="directions")] = None

    @model_validator(mode="after")
    def _one_for_each(self) -> ListOfSensors:
        if (self.direction is None) == (self.each is None):
            raise ValueError("expected either direction or directions")
        if self.each is not None and len(self.each) != len(self.at_points):
            raise ValueError(f"expected {len(self.at_points)} directions, one for each point")
        return self

    def points(self) -> list[tuple[float, ...]]:
        """Positions, m, each of shape (3,)."""
        return self.at_points

    def directions(self) -> list[tuple[float, ...]]:
        """A direction for each point."""
        return self.each or [self.direction] * len(self.at_points)


def _sensors_kind(data: Any) -> str:
    many = isinstance(data, dict) and "points" in data
    return "<ListOfSensors>" if many else "<LineOfSensors>"


Sees = Annotated[
    Annotated[LineOfSensors, Tag("<LineOfSensors>")]
    | Annotated[ListOfSensors, Tag("<ListOfSensors>")],
    Discriminator(_sensors_kind),
]


class ValidationTest(Section):
    """``[test.validation]``: data that is never fitted."""

    frequencies: str
    damping: str | None = None


#: The head of a column, such as ``torque [N·m]``: a name and a unit.
_COLUMN = r"\s*([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?\s*"


class FRFSection(Section):
    """``[test.frfs]``: measured frequency response functions, or ``frfs`` with a list of files.

    ``kind``, ``units``, ``length_unit``, ``points`` (by node), ``directions`` (by node) and
    ``keys`` are for what the files do not say: see `measurements.files.read_frfs`. ``at`` is
    the condition at which they were measured, the last one by default. ``noise`` is their relative
    standard deviation, 5 % by default; with ``averages``, their number, it comes from the measured
    coherence instead.
    """

    class Identify(Section):
        """``[test.frfs.identify]``: modes from the functions, in place of ``frequencies``.

        ``near`` is about where they are, one for each mode; by default what is stable.
        """

        near: list[quantity("Hz", 0, above=True)] | None = None
        order: Count = 30
        max_damping: Positive = 0.1

    files: Names
    kind: Literal["receptance", "mobility", "accelerance"] | None = None
    units: str | None = None
    length_unit: str | None = None
    points: dict[str, Point] = {}
    directions: dict[str, Direction] = {}
    keys: dict[str, str] = {}
    band: ascending(Spacing) | None = None
    at: float | None = None
    noise: Positive | None = None
    averages: Annotated[int, Field(ge=2, strict=True)] | None = None
    identify: Identify | None = None

    @model_validator(mode="after")
    def _one_of_noise_and_averages(self) -> FRFSection:
        if self.noise is not None and self.averages is not None:
            raise ValueError("expected either noise or averages, which gives it by the coherence")
        return self


def _frf_files(value: Any) -> Any:
    return {"files": value} if isinstance(value, list | str) else value


class PlannedTest(Section):
    """``[test.planned]``: a test that has not been made, for ``diagnose --plan``.

    ``condition`` is written as the head of a column, ``"torque [N·m]"``, and ``modes`` are names,
    or how many of the lowest that the sensors see.
    """

    condition: str | None = None
    conditions: Annotated[list[float], BeforeValidator(listed), Field(min_length=1)] = [1.0]
    modes: Count | Names
    damping: bool = False
    shapes: bool = False

    @model_validator(mode="after")
    def _clear(self) -> PlannedTest:
        if self.condition is not None and not re.fullmatch(_COLUMN, self.condition):
            raise ValueError(f"condition = {self.condition!r}: expected 'NAME [UNIT]'")
        if self.condition is None and len(self.conditions) > 1:
            raise ValueError("expected condition too, such as 'torque [N·m]'")
        if len(set(self.conditions)) != len(self.conditions):
            raise ValueError(f"conditions = {self.conditions}: expected each value once")
        if not all(math.isfinite(c) for c in self.conditions):
            raise ValueError(f"conditions = {self.conditions}: expected finite numbers")
        if len(set(self.names())) != len(self.names()):
            raise ValueError(f"modes = {self.modes}: expected each name once")
        return self

    def names(self) -> tuple[str, ...]:
        """Names of the modes."""
        if isinstance(self.modes, int):
            return tuple(f"mode {i + 1}" for i in range(self.modes))
        return tuple(self.modes)

    def head(self) -> tuple[str, str]:
        """Name and unit of the condition."""
        if self.condition is None:
            return "row", ""
        name, unit = re.fullmatch(_COLUMN, self.condition).groups()
        return name, (unit or "").strip()


class Test(Section):
    """``[test]``: the measured data and how good it is.

    ``noise`` and ``damping_noise`` are relative standard deviations of frequencies and damping
    ratios (10 % unless given),
    ``shape_noise`` that of a component of a shape, relative to the shape's root mean square, and
    ``shapes_at`` the condition at which shapes were measured, the last one by default. A test that
    has not been made yet has a section ``planned`` in place of ``frequencies``.
    """

    __test__ = False

    frequencies: str | None = None
    damping: str | None = None
    shapes: str | None = None
    condition: str | None = None
    modes: Names | None = None
    resolution: Annotated[list[Spacing], BeforeValidator(listed)] = [0.0]
    noise: Annotated[list[Share], BeforeValidator(listed)] = [0.0]
    damping_noise: quantity("", 0, above=True) | None = None
    shape_noise: quantity("", 0, above=True) = 0.05
    shapes_at: float | None = None
    frfs: Annotated[FRFSection, BeforeValidator(_frf_files)] | None = None
    sees: Sees | None = None
    validation: ValidationTest | None = None
    planned: PlannedTest | None = None

    @model_validator(mode="after")
    def _measured_or_planned(self) -> Test:
        if self.frequencies is None and self.planned is None and self.frfs is None:
            raise ValueError("expected frequencies, frfs, or a section [test.planned]")
        if (
            self.frequencies is not None
            and self.frfs is not None
            and self.frfs.identify is not None
        ):
            raise ValueError("frfs.identify: expected it only without frequencies")
        for key in ("damping", "shapes", "validation"):
            if self.frequencies is None and getattr(self, key) is not None:
                raise ValueError(f"{key}: expected frequencies too")
        if self.planned is not None and self.planned.shapes and self.sees is None:
            raise ValueError("planned.shapes: expected a section [test.sees] too")
        return self


class Published(Section):
    """``[update.published]``: somebody's values and frequencies, to show beside one's own."""

    source: str = ""
    parameters: dict[str, float | str] = {}
    frequencies: list[quantity("Hz", 0, above=True)] = []


class CutoffUpdate(Section):
    """``[update.cutoff]``: the pressure below which a contact is lost (seed 004).

    ``calibrate`` first fits one parameter to one mode of the stuck model, which the contact hardly
    moves: ``calibrate = { parameter = "beams.E", mode = "mode 10" }``.
    """

    class Calibrate(Section):
        """``[update.cutoff.calibrate]``."""

        parameter: str
        mode: str

    scheme: Literal["two", "three", "both"] = "both"
    contacts: Names | None = None
    calibrate: Calibrate | None = None
    max_solves: Annotated[int, Field(ge=5, strict=True)] = 15


def _lines(value: Any) -> Any:
    if isinstance(value, list):
        return [_line_hz(v) for v in value]
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError("expected a whole number of lines from 1 on, or a list of frequencies")
    return value


def _line_hz(value: Any) -> float:
    hertz = to_si(value, "Hz")
    if not hertz > 0:
        raise ValueError("expected frequencies above 0 Hz")
    return hertz


class Held(Section):
    """``[update.held]``: what no fit sees and the updated model must predict.

    ``modes`` by name, with the functions' lines around them, or ``"each"``: every mode in turn,
    predicted by a fit to all else; ``bands`` of frequency of the functions, and ``responses`` by
    name.
    """

    modes: Names | None = None
    bands: Annotated[list[ascending(Spacing)], Field(min_length=1)] | None = None
    responses: Names | None = None


class Update(Section):
    """``[update]``: what `fenics-joints update` fits: ``parameters``, or the ``cutoff``.

    ``regularisation`` is the standard deviation of the logarithm of every parameter about its
    starting value: it holds what the data leave open, and is 2.3 (a factor of 10) by default.

    ``data`` says what is fitted: any of ``"frequencies"``, ``"shapes"``, ``"damping"`` (ratios) and
    ``"frfs"``; by default what there is, functions only with a section ``[damping]``, and ratios
    only where a number of ``[damping]`` or the c of a lap is among ``parameters``, but none that
    were identified from functions which are fitted themselves. ``method`` is ``"log"`` (logarithms
    of functions at frequencies relative to the resonances) or ``"weighted"`` (seed 000, eqs. 15 to
    20), whose steps ``step_limit`` limits, relative to each value; the seed does not. ``lines`` are
    the lines of the functions that are fitted: how many, spread over flanks and antiresonances, or
    which.
    """

    at: float | None = None
    parameters: Names = []
    start: dict[str, float | str] = {}
    hold_out: list[float] = []
    regularisation: Positive = 2.3
    published: Published | None = None
    cutoff: CutoffUpdate | None = None
    data: Annotated[
        list[Literal["frequencies", "shapes", "damping", "frfs"]], BeforeValidator(listed),
        Field(min_length=1),
    ] | None = None
    method: Literal["log", "weighted"] | None = None
    step_limit: Positive | None = None
    lines: Annotated[int | list[float], BeforeValidator(_lines)] | None = None
    held: Held | None = None

    @model_validator(mode="after")
    def _one_of_parameters_and_cutoff(self) -> Update:
        if bool(self.parameters) == (self.cutoff is not None):
            raise ValueError("expected either parameters or a section [update.cutoff]")
        return self

    def combined_keys(self) -> list[str]:
        """Keys that the file gives and only a fit to several kinds of data has."""
        return [k for k in ("data", "method", "lines", "held") if getattr(self, k) is not None]


class Diagnose(Section):
    """``[diagnose]``: what `fenics-joints diagnose` may assume.

    ``discrepancy`` is the relative error of frequencies that any model of the structure has, and
    ``shape_discrepancy`` that of a shape's components, relative to its root mean square.
    ``zones`` is the number of zones of equal pressure that a contact is split into, and ``mesh``
    what its mesh has otherwise than ``[mesh]``, such as larger elements: a diagnosis solves many
    models. ``nested`` is the number of leading hypotheses whose evidence is sampled, and
    ``patches`` that of patches of each region in which the gap is looked for; 0 for neither these
    nor the error in the constitutive relation, which cost solutions of the full model.
    ``joints`` says what the nominal model has where the joints are: ``bonded`` parts, so that
    nothing of the joints is assumed; or the stiffness ``given`` by ``[joints]``, of which a
    diagnosis can then say that the preload is below the nominal one.
    """

    n_modes: Count = 20
    discrepancy: Share = 0.01
    shape_discrepancy: Share = 0.05
    preload_scatter: Share = 0.2
    max_effects: Annotated[int, Field(ge=1, le=3, strict=True)] = 2
    effects: list[str] | None = None
    zones: Annotated[int, Field(ge=3, le=40, strict=True)] = 12
    mesh: dict[str, Any] = {}
    samples: Annotated[int, Field(ge=4, strict=True)] = 16
    joints: Literal["bonded", "given"] = "bonded"
    nested: Annotated[int, Field(ge=0, le=50, strict=True)] = 6
    patches: Annotated[int, Field(ge=0, le=200, strict=True)] = 12


def _names(table: Any) -> Any:
    for name in table if isinstance(table, dict) else ():
        if not re.fullmatch(_NAME, name):
            raise ValueError(
                f"the name {name!r} is not usable: expected letters, digits, _ and -, "
                "starting with a letter"
            )
    return table


def named(kind):
    """A table of sections with names of their own, such as ``[parts.NAME]``."""
    return Annotated[dict[str, kind], BeforeValidator(_names)]
