"""Components of structures: parameters, parts, joints, supports, springs and point masses.

Plain data; `structure.structure` turns it into matrices. Wherever a number stands, the name of
a parameter may stand instead; a material property may also be a function of position,
``(x, p) -> UFL`` with ``x`` the spatial coordinate and ``p`` the parameters' symbols by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fenics_joints.errors import (
    MOST,
    InputError,
    direction,
    flag,
    items,
    mapping,
    member,
    real,
    reals,
    text,
    wanted,
    whole,
)
from fenics_joints.structure.laws import (
    ELASTIC_SUPPORT,
    LAYER_LAWS,
    SOLID,
    SPRINGS,
    TRANSITION,
    WIDE_SOLID,
    Law,
)

Value = float | str
Property = float | str | Callable


@dataclass(frozen=True)
class Parameter:
    """A named scalar of the model.

    Attributes:
        name: Unique name, such as ``joint.near.E``.
        value: Nominal value in SI units.
        unit: SI unit, for people.
        lower: Lower bound, inclusive.
        upper: Upper bound, inclusive.
        log: Whether updating works on its logarithm (stiffnesses, masses) or on the value itself.
    """

    name: str
    value: float
    unit: str = ""
    lower: float = -np.inf
    upper: float = np.inf
    log: bool = True

    def __post_init__(self):
        text("parameter.name", self.name)
        real(f"parameter {self.name}", self.value)
        if not isinstance(self.unit, str):
            raise wanted(f"parameter {self.name}.unit", self.unit, "a text")
        flag(f"parameter {self.name}.log", self.log)
        for key in ("lower", "upper"):
            bound = getattr(self, key)
            if not isinstance(bound, float | np.floating) or not np.isinf(bound):
                real(f"parameter {self.name}.{key}", bound)
        if not self.lower <= self.value <= self.upper:
            raise InputError(
                f"parameter {self.name} = {self.value:g} {self.unit}: expected a value within its "
                f"bounds [{self.lower:g}, {self.upper:g}]."
            )
        if self.log and self.value <= 0:
            raise InputError(
                f"parameter {self.name} = {self.value:g}: expected a positive value, since it is "
                "updated by its logarithm; give log = false for one that may be zero or negative."
            )


@dataclass(frozen=True)
class Region:
    """Cells with one material law; make one with `part`, `joint`, `interface` or
    `transition`.

    Attributes:
        name: Name in messages and in reports.
        cells: Names of the mesh's cell groups.
        law: Material law.
        properties: A value for each of the law's properties.
        normal: Unit normal of the layer, for a curved one as a function of position,
            ``x -> UFL``; or direction in which a part's thickness stretches.
        across: Direction in which a part's width stretches, at right angles to ``normal``; None
            where the law has no width.
    """

    name: str
    cells: tuple[str, ...]
    law: Law
    properties: Mapping[str, Property]
    normal: tuple[float, ...] | Callable = (0.0, 0.0, 1.0)
    across: tuple[float, ...] | None = None

    def __post_init__(self):
        text("region.name", self.name)
        if not self.cells or not all(_cell_names(self.name, self.cells)):
            raise wanted(f"{self.name}.cells", self.cells, "names of cell groups")
        for key in self.law.properties:
            if key not in self.properties:
                raise InputError(
                    f"{self.name}.{key} is missing: expected {', '.join(self.law.properties)}."
                )
            if not callable(self.properties[key]):
                _value(f"{self.name}.{key}", self.properties[key])
        if not any(isinstance(v, str) or callable(v) for v in self.properties.values()):
            self.law.check(self.name, self.properties)

    @property
    def is_joint(self) -> bool:
        return self.law.is_joint


def _value(key: str, value: object, unit: str = "", **bounds: float) -> None:
    """Accept only the name of a parameter or a number within its bounds."""
    if isinstance(value, str):
        text(key, value)
    else:
        real(key, value, unit, **bounds)


def _cell_names(name: str, cells: object) -> tuple[str, ...]:
    return (cells,) if isinstance(cells, str) else items(f"{name}.cells", cells, str, "cell groups")


def part(
    name: str,
    cells: str | tuple[str, ...],
    *,
    E: Property,
    nu: Property,
    rho: Property,
    stretch: Property = 1.0,
    normal=(0.0, 0.0, 1.0),
    width: Property = 1.0,
    across=(0.0, 1.0, 0.0),
) -> Region:
    """A solid, isotropic part.

    A width other than the number 1 doubles the terms of a reduced model. Springs, masses and
    supports keep their places whatever the thickness and the width.

    Args:
        name: Name of the part.
        cells: Name or names of cell groups.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        stretch: Actual over meshed thickness along ``normal``.
        normal: Direction of the thickness, shape (gdim,).
        width: Actual over meshed width along ``across``.
        across: Direction of the width; its component along ``normal`` is left out.

    Raises:
        InputError: If a width is given along the normal.
    """
    cells = _cell_names(name, cells)
    properties = {"E": E, "nu": nu, "rho": rho, "stretch": stretch}
    normal = direction(f"{name}.normal", normal)
    if isinstance(width, int | float) and not isinstance(width, bool) and width == 1:
        direction(f"{name}.across", across)
        return Region(name, cells, SOLID, properties, normal)
    across = _at_right_angles(across, normal, name)
    return Region(name, cells, WIDE_SOLID, properties | {"width": width}, normal, across)


def _at_right_angles(across, normal, name) -> tuple[float, ...]:
    n, a = np.asarray(normal), np.asarray(direction(f"{name}.across", across))
    if n.shape == a.shape:
        rest = a - (a @ n) * n
        length = float(np.linalg.norm(rest))
        if length > 1e-3:
            return tuple((rest / length).tolist())
    raise InputError(
        f"{name}.across = {list(across)}: expected a vector of {len(n)} components that is not "
        f"parallel to the normal {list(normal)}."
    )


def _normal(name: str, normal) -> tuple[float, ...] | Callable:
    """A layer's unit normal, or the function that gives it."""
    return normal if callable(normal) else direction(f"{name}.normal", normal)


def joint(
    name: str,
    cells: str | tuple[str, ...],
    *,
    E: Property,
    G: Property,
    law: str = "uncoupled",
    rho: Property = 0.0,
    stretch: Property = 1.0,
    normal=(0.0, 0.0, 1.0),
) -> Region:
    """A joint interface as a thin layer of cells.

    Args:
        name: Name of the joint or of one of its zones.
        cells: Name or names of cell groups.
        E: Normal (``uncoupled``) or Young's modulus, Pa.
        G: Tangential or shear modulus, Pa.
        law: ``uncoupled`` (Tian et al. 2021, eq. 5), ``isotropic`` (eqs. 6, 7) or ``constrained``
            (eq. 8).
        rho: Density, kg/m3; zero as in the paper unless given.
        stretch: Actual over meshed layer thickness.
        normal: Normal of the layer, shape (gdim,); of a curved one the unit normal as a function of
            position, ``x -> UFL``.

    Raises:
        InputError: If the law's name is unknown.
    """
    member(f"{name}.law", law, LAYER_LAWS)
    cells = _cell_names(name, cells)
    properties = {"E": E, "G": G, "rho": rho, "stretch": stretch}
    return Region(name, cells, LAYER_LAWS[law], properties, _normal(name, normal))


def transition(
    name: str,
    cells: str | tuple[str, ...],
    *,
    E: Property,
    nu: Property,
    h: Property,
    meshed: float,
    rho: Property = 0.0,
    normal=(0.0, 0.0, 1.0),
) -> Region:
    """A joint as a ring of transition-interface material, whose thickness h is a parameter.

    The bodies on both sides move apart with h: see `fenics_joints.forms.transition_layer` for when
    that is exact. Springs, masses, supports and sensors move with them; their places are given in
    the mesh. Graded properties are functions of position such as
    ``lambda x, p: transition_modulus(layer_position(x, ...), p["ring.E"], ...)``, taken at the
    middle of each cell: then the mesh needs several cells through the layer.

    Args:
        name: Name of the joint.
        cells: Name or names of cell groups: one ring, or all rings of one bolt pattern.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        h: Thickness, m.
        meshed: Thickness of the layer in the mesh, m.
        rho: Density, kg/m3: zero, or `fenics_joints.forms.average_density` of the bodies'; with
            ``lambda x, p: average_density(p["a.rho"], p["b.rho"])`` it follows theirs.
        normal: Normal of the layer, shape (gdim,); of a curved one the unit normal as a function of
            position, ``x -> UFL``.

    Raises:
        InputError: If ``meshed`` is not a thickness.
    """
    meshed = real(f"{name}.meshed", meshed, "m, the mesh's thickness", above=0)
    cells = _cell_names(name, cells)
    properties = {"E": E, "nu": nu, "rho": rho, "h": h, "meshed": meshed}
    return Region(name, cells, TRANSITION, properties, _normal(name, normal))


def interface(
    name: str,
    cells: str | tuple[str, ...],
    *,
    meshed: float | None = None,
    normal=(0.0, 0.0, 1.0),
    law: Law = SPRINGS,
    **properties: Property,
) -> Region:
    """A joint by its stiffness per area, without mass: springs between two faces.

    The mesh has a layer of cells there, however thin, as `fenics_joints.meshes` grows one: nothing
    but its rotation by the parts' depends on the thickness (`fenics_joints.forms.thin_layer`).

    Args:
        name: Name of the joint or of one of its zones.
        cells: Name or names of cell groups.
        meshed: Thickness of the layer in the mesh, m; a law of strains needs none.
        normal: Normal of the layer, shape (gdim,); of a curved one the unit normal as a function of
            position, ``x -> UFL``.
        law: Springs, or a law by `fenics_joints.structure.joint_law`.
        properties: Those of the law: of springs ``k_n``, the stiffness along the normal, and
            ``k_t``, that in the plane, Pa/m.

    Raises:
        InputError: If ``meshed`` is not a thickness, or a property is missing or unknown.
    """
    if not isinstance(law, Law) or not law.is_joint:
        raise wanted(f"{name}.law", law, "a law by fenics_joints.structure.joint_law")
    own = [key for key in law.properties if key not in ("rho", "meshed")]
    for key in properties:
        if key not in own:
            raise InputError(f"{name}.{key}: unknown property, expected {', '.join(own)}.")
    properties |= {"rho": 0.0}
    if "meshed" in law.properties:
        properties["meshed"] = real(f"{name}.meshed", meshed, "m, the mesh's thickness", above=0)
    way = _normal(name, normal)
    # A normal that varies is known by the mesh alone: an own law's sign is not checked then.
    law = law if law.along is None or callable(way) else law.along(law, way)
    return Region(name, _cell_names(name, cells), law, properties, way)


@dataclass(frozen=True)
class PointMass:
    """A mass at a point that need not be a node.

    Attributes:
        name: Name in reports.
        mass: Mass, kg, or a parameter's name.
        point: Position, m, shape (3,).
        direction: With ``travel``: direction of any length in which the mass may move; kept as a
            unit vector.
        travel: Distance from ``point`` along ``direction``, m, or a parameter's name.
        share: Share of ``mass`` that is at this point, when several points have one parameter.

    Raises:
        InputError: If a number is not finite, the mass negative or the direction zero.
    """

    name: str
    mass: Value
    point: tuple[float, float, float]
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    travel: Value = 0.0
    share: float = 1.0

    def __post_init__(self):
        text("mass.name", self.name)
        _value(f"{self.name}.mass", self.mass, "kg", least=0)
        _value(f"{self.name}.travel", self.travel, "m")
        _stand(self)


@dataclass(frozen=True)
class Spring:
    """A grounding spring at a point, such as a suspension cord.

    Attributes:
        name: Name in reports.
        stiffness: Stiffness, N/m, or a parameter's name.
        point: Position, m, shape (3,).
        direction: Direction of any length in which the spring acts; kept as a unit vector.
        share: Share of ``stiffness`` that is at this point, when several have one parameter.

    Raises:
        InputError: If a number is not finite, the stiffness negative or the direction zero.
    """

    name: str
    stiffness: Value
    point: tuple[float, float, float]
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    share: float = 1.0

    def __post_init__(self):
        text("spring.name", self.name)
        _value(f"{self.name}.stiffness", self.stiffness, "N/m", least=0)
        _stand(self)


def _stand(component: PointMass | Spring) -> None:
    """Check where a component stands, and make its direction a unit vector."""
    name = component.name
    point = reals(f"{name}.point", component.point, (None,), "m")
    if len(point) not in (2, 3):
        raise wanted(f"{name}.point", component.point, "2 or 3 coordinates, m")
    way = direction(f"{name}.direction", component.direction, (len(point),))
    real(f"{name}.share", component.share, least=0)
    object.__setattr__(component, "direction", way)


@dataclass(frozen=True)
class Support:
    """Facets, lines or points that cannot move; either ``facets`` or ``points``.

    Attributes:
        facets: Name of a facet group.
        directions: Held directions; all of them by default.
        points: Name of the mesh's points or line, or positions, m, (n, gdim), of which the nearest
            vertices are held, and edges between two of them. A finer mesh gives way more beneath
            a point, without end.
    """

    facets: str = ""
    directions: tuple[int, ...] = field(default=(0, 1, 2))
    points: str | ArrayLike = ""

    def __post_init__(self):
        if not isinstance(self.points, str):
            reals("support.points", self.points, None, "m")
        elif bool(self.facets) == bool(self.points):
            raise wanted("support", (self.facets, self.points), "either facets or points")
        else:
            text("support.facets", self.facets or self.points)
        key = f"{self.facets or 'points'}.directions"
        for i, way in enumerate(items(key, self.directions, object, "0, 1, 2")):
            whole(f"{key}[{i}]", way, 0, 2)


@dataclass(frozen=True)
class ElasticSupport:
    """Facets on springs to the ground that are spread evenly over them.

    Attributes:
        name: Name in messages and reports.
        facets: Name of a group of facets on the surface.
        k_n: Stiffness along the facets' normal, Pa/m, or a parameter's name.
        k_t: Stiffness in their plane, Pa/m, or a parameter's name.
    """

    name: str
    facets: str
    k_n: Value
    k_t: Value

    def __post_init__(self):
        text("elastic support.name", self.name)
        text(f"{self.name}.facets", self.facets)
        for key, value in self.properties.items():
            _value(f"{self.name}.{key}", value, "Pa/m")
        given = {k: v for k, v in self.properties.items() if not isinstance(v, str)}
        ELASTIC_SUPPORT.check(self.name, given)

    @property
    def properties(self) -> Mapping[str, Value]:
        """Those of `structure.laws.ELASTIC_SUPPORT`."""
        return {"k_n": self.k_n, "k_t": self.k_t}


#: Imaginary step of derivatives: its error is of the order of its square, far below round-off.
_COMPLEX_STEP = 1e-30


def by_name(parameters: Iterable[Parameter]) -> dict[str, Parameter]:
    """Parameters by name, in order.

    Raises:
        InputError: If a name is there twice.
    """
    known: dict[str, Parameter] = {}
    for parameter in parameters:
        if parameter.name in known:
            raise InputError(f"parameter {parameter.name} is given twice; expected once.")
        known[parameter.name] = parameter
    return known


def parameter_values(
    parameters: Mapping[str, Parameter], given: Mapping[str, float] | None
) -> dict[str, float]:
    """All parameters' values: the nominal ones, with ``given`` put in.

    Raises:
        InputError: If ``given`` names an unknown parameter or has a value that is not finite.
    """
    values = {name: p.value for name, p in parameters.items()}
    for name, value in mapping("given", given, "values by the names of parameters").items():
        if name not in values:
            raise InputError(
                f"parameter {name!r} does not exist; expected one of: {', '.join(values)}."
            )
        # A fit comes here a hundred thousand times: plain numbers skip the full check.
        plain = isinstance(value, float) and -MOST <= value <= MOST
        values[name] = float(value) if plain else real(f"parameter {name}", value)
    return values


def number(value: float | str, values: Mapping[str, float]) -> float:
    """A component's number: itself, or the value of the parameter that it names."""
    return values[value] if isinstance(value, str) else float(value)


def slopes(function, q: Mapping[str, float], key: str) -> np.ndarray:
    """Derivative of ``function(q)`` by one property, by a complex step: exact to round-off."""
    step = {k: complex(value) for k, value in q.items()}
    step[key] += 1j * _COMPLEX_STEP
    return np.imag(function(step)) / _COMPLEX_STEP
