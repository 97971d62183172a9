"""Sections of a case file: the structure, its damping, and what a diagnosis may assume."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import fmean
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from fenics_joints.case.own_code import find, find_all
from fenics_joints.case.usual import usual
from fenics_joints.case.values import (
    AXES,
    CaseSection,
    Damper,
    Density,
    Direction,
    Inertia,
    Length,
    Mass,
    ModeCount,
    Modulus,
    Names,
    PerArea,
    Point,
    Poisson,
    Positive,
    Share,
    Size,
    Stiffness,
    Turning,
    Written,
    ascending,
    check_values,
    chosen,
    in_si,
    listed,
    one_of_or_own,
    quantity,
    tolerance_and_bounds,
)
from fenics_joints.meshes.arguments import ONE_BOLT
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.laws import LAYER_LAWS, Law

PartTolerance, PartBounds = tolerance_and_bounds(
    "Part", E=Modulus, nu=Poisson, rho=Density, thickness=Positive, width=Positive
)


#: Keys that a joint must have and may have, by its law; others are refused.
_JOINT_KEYS = {
    "transition": (("E", "nu", "h"), ("meshed", "rho")),
    "springs": ((), ("k_n", "k_t", "meshed", "pressure", "roughness")),
    "generic": (("k1", "k2"), ("c", "k_axial")),
}
_LAYER_KEYS = ("E", "G"), ("rho",)


class PartSection(CaseSection):
    """``[parts.NAME]``: cells of a solid material, with E and one of G and nu.

    Attributes:
        cells: Groups of cells of the mesh.
        E: Young's modulus.
        G: Shear modulus, instead of nu.
        nu: Poisson's ratio.
        rho: Density.
        mass: Weighed mass of the part, which check and diagnose compare with the model's.
        normal: Direction of the thickness; measured for a part of a mesh file unless given.
        across: Direction of the width; y by default, or z if the normal is y.
        tolerance: Relative standard deviations of the values.
        bounds: Ranges of the values, [low, high].
    """

    one_of = (("G", "nu"),)
    cells: Names
    E: usual(Modulus, "E")
    G: usual(Modulus, "G") | None = None
    nu: usual(Poisson, "nu") | None = None
    rho: usual(Density, "rho")
    mass: Mass | None = None
    normal: Direction = (0.0, 0.0, 1.0)
    across: Direction | None = None
    tolerance: PartTolerance = PartTolerance()
    bounds: PartBounds = PartBounds()

    @model_validator(mode="after")
    def _compressible(self) -> PartSection:
        if not -1 < self.nominal()["nu"] < 0.5:
            raise ValueError(
                f"E = {self.E:g} Pa and G = {self.G:g} Pa give nu = {self.nominal()['nu']:g}; "
                "expected E < 3 G, so that nu < 0.5"
            )
        return self

    @model_validator(mode="after")
    def _across_the_normal(self) -> PartSection:
        if self.across is not None and _parallel(self.across, self.normal):
            raise ValueError(
                f"across = {list(self.across)}: expected a direction that is not parallel to "
                f"normal = {list(self.normal)}"
            )
        return self

    def nominal(self, width: bool = False) -> dict[str, float]:
        """Value of each parameter; thickness (and width, if asked for) relative to the mesh's."""
        nu = self.E / (2 * self.G) - 1 if self.nu is None else self.nu
        values = {"E": self.E, "nu": nu, "rho": self.rho, "thickness": 1.0}
        return values | ({"width": 1.0} if width else {})

    def widens(self) -> tuple[float, ...]:
        """Direction of the width."""
        if self.across is not None:
            return self.across
        y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        return z if _parallel(y, self.normal) else y


JointTolerance, JointBounds = tolerance_and_bounds(
    "Joint",
    **dict.fromkeys(("E", "G"), Modulus),
    **dict.fromkeys(("k_n", "k_t"), PerArea),
    **dict.fromkeys(("k1", "k2"), Turning),
    nu=Poisson,
    h=Size,
    rho=Density,
    thickness=Positive,
    k_axial=Stiffness,
    c=Damper,
)


class JointSection(CaseSection):
    """``[joints.NAME]``: a thin layer of cells, or a lap of beams.

    Its values depend on the law: E and G of a layer as thick as in the mesh; E, nu and h of
    a ``transition`` layer (Machines 2022); k_n and k_t of ``springs``, or pressure and roughness
    from which they are computed (`fenics_joints.case.starting`); k1, k2 and c of a ``generic`` lap
    of beams (Jalali et al. 2019).

    Attributes:
        cells: Groups of cells; patterns such as "ring_*" with law "transition" or "springs".
        law: How the layer deforms; a law of your own is named as "module:name".
        values: Values of such a law's properties, by name.
        E: Modulus across the layer.
        G: Shear modulus of the layer.
        nu: Poisson's ratio of a transition layer.
        h: Thickness of a transition layer.
        meshed: Thickness of the layer in the mesh; measured by default.
        k_n: Stiffness per area across the layer.
        k_t: Stiffness per area along the layer.
        pressure: Pressure between the faces; by default that of the bolts of [mesh.bolts].
        roughness: Ra of the faces, 1.6 um by default.
        rho: Density; "average" is the mean of the two parts; of a transition layer 0 by default.
        k1: Slap stiffness of each joint element.
        k2: Slip stiffness of each joint element.
        k_axial: Axial stiffness of each joint element; that of the beams by default.
        c: Slip damping of each joint element.
        bolted: Whether the layer lies under bolts.
        bolts: Points on the axes of its bolts, around which a diagnosis makes zones; by default
            those of the mesh.
        normal: Normal of the layer; that of springs is measured unless given.
        tolerance: Relative standard deviations of the values.
        bounds: Ranges of the values, [low, high].
    """

    cells: Names
    law: one_of_or_own(*LAYER_LAWS, *_JOINT_KEYS) = "uncoupled"
    values: dict[str, Written] = {}
    E: usual(Modulus, "layer") | None = None
    G: usual(Modulus, "layer") | None = None
    nu: usual(Poisson, "nu") | None = None
    h: usual(Size, "h") | None = None
    meshed: usual(Size, "h") | None = None
    k_n: usual(PerArea, "per length") | None = None
    k_t: usual(PerArea, "per length") | None = None
    pressure: usual(Modulus, "contact pressure") | None = None
    roughness: usual(Size, "roughness") | None = None
    rho: usual(quantity("kg/m3", 0, above=True, word="average", meaning="average"), "rho") = None
    k1: usual(Turning, "turning") | None = None
    k2: usual(Turning, "turning") | None = None
    k_axial: usual(Stiffness, "axial") | None = None
    c: usual(Damper, "damper") | None = None
    bolted: bool = False
    bolts: Annotated[list[Point], Field(min_length=1)] | None = None
    normal: Direction = (0.0, 0.0, 1.0)
    tolerance: JointTolerance = JointTolerance()
    bounds: JointBounds = JointBounds()

    @model_validator(mode="after")
    def _definite(self) -> JointSection:
        if self.rho == "average" and self.law != "transition":
            raise ValueError('rho = "average": expected a density, or law = "transition"')
        own, more = _JOINT_KEYS.get(self.law, _LAYER_KEYS)
        if self.own_law is not None:
            own, more = (), ("meshed", "values")
            check_values(self.values, self.own_law.units, self.law)
        allowed = {"cells", "law", "bolted", "bolts", "normal", "tolerance", "bounds", *own, *more}
        missing = [key for key in own if getattr(self, key) is None]
        given = [key for key in self.model_fields_set if getattr(self, key) is not None]
        extra = sorted(set(given) - allowed)
        if missing or extra:
            wrong = [f"{key} is missing" for key in missing] + [f"{key} is given" for key in extra]
            expected = ", ".join(own) or "values"
            raise ValueError(f"{', '.join(wrong)}: expected {expected} with law = '{self.law}'")
        if self.law == "springs":
            self._one_start()
        if self.law in ("isotropic", "constrained") and not self.E < 3 * self.G:
            raise ValueError(
                f"E = {self.E:g} Pa and G = {self.G:g} Pa: expected E < 3 G with law = "
                f"'{self.law}' (nu < 0.5)"
            )
        return self

    def _one_start(self) -> None:
        given = [key for key in ("k_n", "k_t") if getattr(self, key) is not None]
        more = [key for key in ("pressure", "roughness") if getattr(self, key) is not None]
        if len(given) == 1 or (given and more):
            raise ValueError(
                f"{', '.join(given + more)} given: expected k_n and k_t; or pressure and "
                "roughness, from which they are computed; or neither, with [mesh.bolts]"
            )

    @model_validator(mode="after")
    def _bolts_apart(self) -> JointSection:
        for i, bolt in enumerate(self.bolts or []):
            if any(math.dist(bolt, other) < ONE_BOLT for other in self.bolts[:i]):
                raise ValueError(
                    f"bolts[{i}] = {list(bolt)} m is there already: expected each bolt once, "
                    f"{1e3 * ONE_BOLT:g} mm or more from the others"
                )
        return self

    @property
    def own_law(self) -> Law | None:
        """The law that the file names as module:name; None for one of the suite's."""
        if self.law in (*LAYER_LAWS, *_JOINT_KEYS):
            return None
        return find(self.law, Law, "a law by fenics_joints.structure.joint_law")

    @property
    def is_measured(self) -> bool:
        """Whether its thickness and normal are measured in the mesh."""
        return self.law == "springs" or self.own_law is not None

    @property
    def is_patterned(self) -> bool:
        """Whether its cells may be patterns."""
        return self.law == "transition" or self.is_measured

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; a density only if the file gives one."""
        if self.own_law is not None:
            return in_si(self.values, self.own_law.units)
        rho = {} if self.rho is None else {"rho": self.rho}
        if self.law == "transition":
            return {"E": self.E, "nu": self.nu, **rho, "h": self.h}
        if self.law == "springs":
            return {"k_n": self.k_n, "k_t": self.k_t}
        if self.law == "generic":
            axial = {} if self.k_axial is None else {"k_axial": self.k_axial}
            return {"k1": self.k1, "k2": self.k2, **axial, "c": self.c or 0.0}
        return {"E": self.E, "G": self.G, **rho, "thickness": 1.0}


class PointsSection(CaseSection):
    """What sections of masses and springs at points have in common.

    Attributes:
        points: Where it is: one point or more.
        tolerance: Relative standard deviation of its value.
    """

    points: Annotated[list[Point], Field(min_length=1)]
    tolerance: Share | None = None

    def labelled(self, name: str) -> list[tuple[str, tuple[float, ...]]]:
        """Each point, m, with a label: the section's name, numbered where there are several."""
        if len(self.points) == 1:
            return [(name, self.points[0])]
        return [(f"{name}[{i}]", point) for i, point in enumerate(self.points)]


class MassSection(PointsSection):
    """``[masses.NAME]``: a total mass in equal shares at points.

    A point in an empty bolt hole passes its share to the ring around the hole.

    Attributes:
        mass: The total.
        inertia: Rotary inertia of each point, on beams.
        travel: Range of the first point's coordinate, if its position is unknown; the other points
            move with it.
        along: Axis of the travel.
    """

    mass: usual(Mass, "mass")
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
        """Range of the travel relative to the first point, m; None without one."""
        if self.travel is None:
            return None
        start = self.points[0][AXES.index(self.along)]
        return self.travel[0] - start, self.travel[1] - start


class SpringSection(PointsSection):
    """``[springs.NAME]``: equal springs to the ground at points.

    Attributes:
        direction: Direction of each spring.
        stiffness: Stiffness of each spring.
    """

    direction: Direction
    stiffness: usual(Stiffness, "stiffness")

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; the stiffness is that of one spring."""
        return {"stiffness": self.stiffness}


class AttachedMass(MassSection):
    """``[attached.NAME]`` with ``kind = "mass"``: on the structure, not in the nominal model.

    Attributes:
        kind: What it is.
    """

    kind: Literal["mass"]

    def nominal(self) -> dict[str, float]:
        """Value of each parameter in the case; the travel is not one of them."""
        return {"mass": self.mass}

    def absent(self) -> dict[str, float]:
        """Value of each parameter when the mass is not there."""
        return {"mass": 0.0} | ({} if self.travel is None else {"travel": 0.0})


class AttachedSpring(SpringSection):
    """``[attached.NAME]`` with ``kind = "spring"``: on the structure, not in the nominal model.

    Attributes:
        kind: What it is.
    """

    kind: Literal["spring"]

    def absent(self) -> dict[str, float]:
        """Value of each parameter when the springs are not there."""
        return {"stiffness": 0.0}


Attached = chosen("kind", AttachedMass, AttachedSpring)


class SupportSection(CaseSection):
    """``[supports.NAME]``: facets or points that cannot move in some directions.

    Attributes:
        facets: Group of facets.
        directions: Directions in which facets or points are held.
        points: Name of a group of points or lines of a .msh file, or positions, whose nearest
            vertices are held.
    """

    one_of = (("facets", "points"),)
    facets: str | None = None
    directions: list[Literal["x", "y", "z"]] = Field(["x", "y", "z"], min_length=1)
    points: str | Annotated[list[Point], Field(min_length=1)] | None = None

    @property
    def holds_all(self) -> bool:
        """Whether it holds facets in all directions."""
        return self.facets is not None and set(self.directions) == set(AXES)


class Diagnose(CaseSection):
    """``[diagnose]``: what `fenics-joints diagnose` may assume.

    Attributes:
        n_modes: Number of modes that are computed of each model.
        discrepancy: Relative error of frequencies that even the right model has.
        shape_discrepancy: Error of a shape's components that even the right model has, relative to
            their root mean square.
        preload_scatter: Relative scatter of the bolts' forces.
        max_effects: Most causes that a gap may have at once.
        effects: Which causes are looked for; by default all that the case can have, which "all"
            stands for. "module:name" is one of your own.
        zones: Number of zones of equal pressure of a contact.
        mesh: Keys of [mesh] that differ in the diagnosis, such as larger elements.
        samples: Least number of full models that the reduced model is trained on.
        joints: Whether the nominal model is bonded where the joints are, or has their given
            stiffness.
        nested: Without effect; kept for case files of earlier versions, which sampled evidence.
        patches: Number of patches of each region in which the gap is looked for; 0 for no map.
        mesh_error: Whether the discretisation error of each frequency is estimated and subtracted;
            part of it stays as uncertainty.
        rare: Whether causes that occur in few structures are looked for too.
        outside: Prior probability that the cause is not in the library.
        frfs: Whether measured frequency response functions are used beside the modes.
    """

    n_modes: ModeCount = 20
    discrepancy: usual(Share, "discrepancy") = 0.01
    shape_discrepancy: Share = 0.05
    preload_scatter: Share = 0.2
    max_effects: Annotated[int, Field(ge=1, le=3, strict=True)] = 2
    effects: list[str] | None = None
    zones: Annotated[int, Field(ge=3, le=40, strict=True)] = 12
    mesh: dict[str, Any] = {}
    samples: Annotated[int, Field(ge=4, le=10_000, strict=True)] = 16
    joints: Literal["bonded", "given"] = "bonded"
    nested: Annotated[int, Field(ge=0, le=50, strict=True)] = 6
    patches: Annotated[int, Field(ge=0, le=200, strict=True)] = 12
    mesh_error: Annotated[bool, Field(strict=True)] = True
    rare: Annotated[bool, Field(strict=True)] = False
    outside: Annotated[float, Field(ge=0.001, le=0.9, strict=True)] = 0.25
    frfs: Annotated[bool, Field(strict=True)] = True

    @model_validator(mode="after")
    def _effects_there(self) -> Diagnose:
        find_all(self.effects or ())
        return self


def _parallel(a, b) -> bool:
    """Whether two vectors in space are parallel, to within 0.08 degrees."""
    cosine = sum(x * y for x, y in zip(a, b, strict=True)) / (math.hypot(*a) * math.hypot(*b))
    return abs(cosine) > 1 - 1e-6


def with_average_densities(
    joints: Mapping[str, JointSection], parts: Mapping[str, PartSection]
) -> dict[str, JointSection]:
    """The joints with ``rho = "average"`` as a number, kg/m3.

    Machines 2022, section 2, end: the layer's density is zero or the average of the two bodies'.

    Raises:
        ValueError: If there are more than two parts, and their densities differ.
    """
    densities, found = [part.rho for part in parts.values()], dict(joints)
    for name, joint in joints.items():
        if joint.rho != "average":
            continue
        if len(densities) != 2 and len(set(densities)) > 1:
            raise ValueError(
                f'joints.{name}.rho = "average": expected two parts, or parts of one density, so '
                "that it is clear which to average; else give the density as a number"
            )
        found[name] = joint.model_copy(update={"rho": fmean(densities)})
    return found


Ratio = quantity("", 0, 1)
Rate = quantity("1/s", 0)
Time = quantity("s", 0)
Relaxation = quantity("s", 0, above=True)
_Ratios = Annotated[list[Ratio], BeforeValidator(listed), Field(min_length=1)]


class DampingSection(CaseSection):
    """``[damping]``: linear damping of the model; see `fenics_joints.structure.damping.Damping`.

    Each value above 0 is a parameter, which an update may fit: ``damping.ratio`` of ``modal`` (or
    ``damping.ratio_1``, ``damping.ratio_2``, ... of a list), ``damping.alpha`` and
    ``damping.beta`` of ``rayleigh``, ``damping.loss_factor`` of ``structural``,
    ``NAME.loss_factor`` of ``hysteretic`` and ``NAME.relaxation`` of ``viscous``, where NAME is a
    part or joint.

    Attributes:
        modal: Damping ratio of all modes, or of each.
        rayleigh: Factors of mass and stiffness, alpha and beta.
        structural: Loss factor of the whole structure.
        viscous: Relaxation time by part or joint.
        hysteretic: Loss factor by part or joint.
    """

    modal: usual(_Ratios, "damping ratio") | None = None
    rayleigh: tuple[usual(Rate, "alpha"), usual(Time, "beta")] = (0.0, 0.0)
    structural: usual(Share, "loss factor") = 0.0
    viscous: dict[str, usual(Relaxation, "relaxation")] = {}
    hysteretic: dict[str, usual(Positive, "loss factor")] = {}

    @model_validator(mode="after")
    def _some(self) -> DampingSection:
        if not self.nominal():
            raise ValueError(
                "expected some damping: modal, rayleigh, structural, viscous or hysteretic above 0"
            )
        return self

    def _ratios(self) -> dict[str, float]:
        """Modal damping ratios by the names of their parameters."""
        ratios = self.modal or [0.0]
        names = ["ratio"] if len(ratios) == 1 else [f"ratio_{i + 1}" for i in range(len(ratios))]
        return dict(zip(names, ratios, strict=True))

    def nominal(self) -> dict[str, float]:
        """Value of each parameter above 0, SI, by its name."""
        own = self._ratios()
        own |= dict(zip(("alpha", "beta"), self.rayleigh, strict=True))
        own["loss_factor"] = self.structural
        values = {f"damping.{key}": value for key, value in own.items()}
        values |= {f"{name}.loss_factor": value for name, value in self.hysteretic.items()}
        values |= {f"{name}.relaxation": value for name, value in self.viscous.items()}
        return {name: value for name, value in values.items() if value > 0}

    def damping(self) -> Damping:
        """The damping, with the names of its parameters in place of values above 0."""
        there = self.nominal()

        def named(name: str) -> float | str:
            return name if name in there else 0.0

        return Damping(
            modal=tuple(named(f"damping.{key}") for key in self._ratios()),
            rayleigh=(named("damping.alpha"), named("damping.beta")),
            structural=named("damping.loss_factor"),
            viscous={name: f"{name}.relaxation" for name in self.viscous},
            hysteretic={name: f"{name}.loss_factor" for name in self.hysteretic},
        )
