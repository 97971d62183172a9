"""The case file: a structure, its test, and what to do with them, in one validated TOML file.

`load_case` is the way in. Every message names the file, the key, the value and what was expected,
and all errors that can be found together are reported together.
"""

from __future__ import annotations

import difflib
import math
import re
import sys
import types
import typing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    model_validator,
)

from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData, read_test_data
from fenics_joints.units import to_si

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from fenics_joints.points import Sensors

__all__ = ["Case", "load_case"]

_NAME = r"[A-Za-z][A-Za-z0-9_-]*"
_AXES = ("x", "y", "z")


# -- values ----------------------------------------------------------------------------------------


def _quantity(unit: str, least: float = -math.inf, most: float = math.inf, above: bool = False):
    """A float in SI ``unit`` from text with a unit; within limits, or above the lower one."""

    def read(value: Any) -> float:
        number = to_si(value, unit)
        if not (number > least if above else number >= least) or number > most:
            low = f"{'above' if above else 'at least'} {least:g} {unit}".rstrip()
            high = f" and at most {most:g} {unit}".rstrip() if most < math.inf else ""
            raise ValueError(f"expected {low}{high}")
        return number

    return Annotated[float, BeforeValidator(read)]


def _listed(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _padded(vector: list[float]) -> tuple[float, ...]:
    return tuple(vector) + (0.0,) * (3 - len(vector))


def _nonzero(vector: list[float]) -> list[float]:
    if not any(vector) or not all(math.isfinite(c) for c in vector):
        raise ValueError("expected a finite vector that is not zero")
    return vector


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    return pair


Length = _quantity("m")
Size = _quantity("m", 0, above=True)
Gap = _quantity("m", 0)
Modulus = _quantity("Pa", 0, above=True)
Density = _quantity("kg/m3", 0, above=True)
Mass = _quantity("kg", 0, above=True)
Stiffness = _quantity("N/m", 0, above=True)
Spacing = _quantity("Hz", 0)
Positive = _quantity("", 0, above=True)
Share = _quantity("", 0)
Poisson = _quantity("", -0.999, 0.4999)
Point = Annotated[list[Length], Field(min_length=2, max_length=3), AfterValidator(_padded)]
Direction = Annotated[
    list[float],
    Field(min_length=2, max_length=3),
    AfterValidator(_nonzero),
    AfterValidator(_padded),
]
Names = Annotated[list[str], BeforeValidator(_listed), Field(min_length=1)]
Count = Annotated[int, Field(ge=1, strict=True)]


def _range(kind):
    return Annotated[tuple[kind, kind], AfterValidator(_ascending)]


# -- sections --------------------------------------------------------------------------------------


class Section(BaseModel):
    """A table of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class LapPlatesMesh(Section):
    """``[mesh]`` with a builder; the arguments are those of `fenics_joints.meshes.lap_plates`."""

    builder: Literal["lap_plates"]
    length: Size | None = None
    width: Size | None = None
    thickness: Size | None = None
    lap: Size | None = None
    layer: Gap | None = None
    element_size: Size | None = None
    n_length: Count | None = None
    n_width: Count | None = None
    n_thickness: Count | None = None
    bolts: list[tuple[Length, Length]] | None = None
    zone: Gap | None = None
    hole_diameter: Size | None = None
    washer_diameter: Size | None = None
    cell: Literal["hexahedron", "tetrahedron"] | None = None
    degree: Literal[1, 2] = 2

    def arguments(self) -> dict[str, Any]:
        """The builder's arguments that the file gives."""
        return self.model_dump(exclude={"builder", "degree"}, exclude_none=True)


class FileMesh(Section):
    """``[mesh]`` from a gmsh file with named physical groups."""

    file: str
    scale: Size = 1.0
    gdim: Literal[2, 3] = 3
    degree: Literal[1, 2] = 2


def _mesh_kind(data: Any) -> str | None:
    if isinstance(data, dict) and ("file" in data) != ("builder" in data):
        return "<FileMesh>" if "file" in data else "<LapPlatesMesh>"
    return None


Mesh = Annotated[
    Annotated[LapPlatesMesh, Tag("<LapPlatesMesh>")] | Annotated[FileMesh, Tag("<FileMesh>")],
    Discriminator(_mesh_kind),
]


class PartTolerance(Section):
    """How well a part is known: relative standard deviations."""

    E: Share | None = None
    nu: Share | None = None
    rho: Share | None = None
    thickness: Share | None = None


class PartBounds(Section):
    """Bounds of a part's parameters; the thickness as actual over nominal."""

    E: _range(Modulus) | None = None
    nu: _range(Poisson) | None = None
    rho: _range(Density) | None = None
    thickness: _range(Positive) | None = None


class Part(Section):
    """``[parts.NAME]``: cells of a solid material, with E and one of G and nu."""

    cells: Names
    E: Modulus
    G: Modulus | None = None
    nu: Poisson | None = None
    rho: Density
    normal: Direction = (0.0, 0.0, 1.0)
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

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; the thickness is relative to the mesh's."""
        nu = self.E / (2 * self.G) - 1 if self.nu is None else self.nu
        return {"E": self.E, "nu": nu, "rho": self.rho, "thickness": 1.0}


class JointTolerance(Section):
    """How well a joint is known: relative standard deviations."""

    E: Share | None = None
    G: Share | None = None
    rho: Share | None = None
    thickness: Share | None = None


class JointBounds(Section):
    """Bounds of a joint's parameters."""

    E: _range(Modulus) | None = None
    G: _range(Modulus) | None = None
    rho: _range(Density) | None = None
    thickness: _range(Positive) | None = None


class Joint(Section):
    """``[joints.NAME]``: a thin layer of cells."""

    cells: Names
    law: Literal["isotropic", "uncoupled", "constrained"] = "uncoupled"
    E: Modulus
    G: Modulus
    rho: Density | None = None
    normal: Direction = (0.0, 0.0, 1.0)
    tolerance: JointTolerance = JointTolerance()
    bounds: JointBounds = JointBounds()

    @model_validator(mode="after")
    def _definite(self) -> Joint:
        if self.law != "uncoupled" and not self.E < 3 * self.G:
            raise ValueError(
                f"E = {self.E:g} Pa and G = {self.G:g} Pa: expected E < 3 G with law = "
                f"'{self.law}' (nu < 0.5)"
            )
        return self

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; a density only if the file gives one."""
        rho = {} if self.rho is None else {"rho": self.rho}
        return {"E": self.E, "G": self.G, **rho, "thickness": 1.0}


class PointsSection(Section):
    """Something at points."""

    points: Annotated[list[Point], Field(min_length=1)]
    tolerance: Share | None = None


class MassSection(PointsSection):
    """``[masses.NAME]``: a total mass in equal shares at points."""

    mass: Mass

    def nominal(self) -> dict[str, float]:
        """Value of each parameter."""
        return {"mass": self.mass}


class SpringSection(PointsSection):
    """``[springs.NAME]``: equal springs to the ground at points."""

    direction: Direction
    stiffness: Stiffness

    def nominal(self) -> dict[str, float]:
        """Value of each parameter; the stiffness is that of each spring."""
        return {"stiffness": self.stiffness}


class AttachedMass(MassSection):
    """``[attached.NAME]`` with ``kind = "mass"``: there, but not in the nominal model.

    ``travel`` is where the first point may sit along ``along``; the others move with it.
    """

    kind: Literal["mass"]
    travel: _range(Length) | None = None
    along: Literal["x", "y", "z"] = "x"

    @model_validator(mode="after")
    def _starts_inside(self) -> AttachedMass:
        if self.travel is not None:
            start = self.points[0][_AXES.index(self.along)]
            if not self.travel[0] <= start <= self.travel[1]:
                raise ValueError(
                    f"travel = {list(self.travel)} m: expected a range that holds the first "
                    f"point's {self.along} = {start:g} m"
                )
        return self

    def shift(self) -> tuple[float, float] | None:
        """Range of the distance from the first point, m."""
        if self.travel is None:
            return None
        start = self.points[0][_AXES.index(self.along)]
        return self.travel[0] - start, self.travel[1] - start

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
    at: dict[Literal["x", "y", "z"], Annotated[list[Length], BeforeValidator(_listed)]] = {}
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
        return list(zip(*(at.get(axis, [0.0] * n) for axis in _AXES), strict=True))

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


class Test(Section):
    """``[test]``: the measured data and how good it is."""

    __test__ = False

    frequencies: str
    damping: str | None = None
    condition: str | None = None
    modes: Names | None = None
    resolution: Annotated[list[Spacing], BeforeValidator(_listed)] = [0.0]
    noise: Annotated[list[Share], BeforeValidator(_listed)] = [0.0]
    sees: Sees | None = None
    validation: ValidationTest | None = None


class Update(Section):
    """``[update]``: what `fenics-joints update` fits."""

    at: float | None = None
    parameters: Names
    start: dict[str, float | str] = {}
    hold_out: list[float] = []


class Diagnose(Section):
    """``[diagnose]``: what `fenics-joints diagnose` may assume."""

    n_modes: Count = 20
    discrepancy: Share = 0.0
    max_effects: Count = 2


def _names(table: Any) -> Any:
    for name in table if isinstance(table, dict) else ():
        if not re.fullmatch(_NAME, name):
            raise ValueError(
                f"the name {name!r} is not usable: expected letters, digits, _ and -, "
                "starting with a letter"
            )
    return table


def _table(kind):
    return Annotated[dict[str, kind], BeforeValidator(_names)]


class Case(Section):
    """A whole case; make one with `load_case`.

    Attributes:
        title: Title for people.
        mesh: Where the mesh comes from.
        parts: Solid parts by name.
        joints: Thin layers by name.
        masses: Known masses, by name.
        springs: Known springs to the ground, by name.
        supports: Held facets, by name.
        attached: Masses and springs that are there, but not in the nominal model, by name.
        test: The test, or None.
        update: What to update, or None.
        diagnose: What a diagnosis may assume.
    """

    title: str = ""
    mesh: Mesh
    parts: Annotated[_table(Part), Field(min_length=1)]
    joints: _table(Joint) = {}
    masses: _table(MassSection) = {}
    springs: _table(SpringSection) = {}
    supports: _table(SupportSection) = {}
    attached: _table(Attached) = {}
    test: Test | None = None
    update: Update | None = None
    diagnose: Diagnose = Diagnose()

    _path: Path = PrivateAttr(Path("case.toml"))
    _measured: TestData | None = PrivateAttr(None)
    _validation: TestData | None = PrivateAttr(None)
    _start: dict[str, float] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """The case file."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder that the files named in the case stand in."""
        return self._path.parent

    def measurements(self) -> TestData:
        """The measured data.

        Raises:
            InputError: If the case has no test.
        """
        if self._measured is None:
            raise InputError(f"{self._path}: test is missing, expected a section [test]")
        return self._measured

    def validation(self) -> TestData | None:
        """The data that is never fitted, or None."""
        return self._validation

    def sensors(self) -> Sensors | None:
        """Where and how the test saw the structure, or None if the case does not say."""
        if self.test is None or self.test.sees is None:
            return None
        from fenics_joints.points import Sensors

        return Sensors(self.test.sees.points(), self.test.sees.directions())

    def start(self) -> dict[str, float]:
        """Values at which updating starts, SI, by parameter; those in ``update.start``."""
        return dict(self._start)

    def nominal(self, attached: bool = False) -> dict[str, float]:
        """Value of every parameter of the model, SI, by name (``near.E``), in order.

        Args:
            attached: Whether to add those of ``[attached]``, at zero: not there.
        """
        sections = {**self.parts, **self.joints, **self.masses, **self.springs}
        values = {name: section.nominal() for name, section in sections.items()}
        if attached:
            values |= {name: section.absent() for name, section in self.attached.items()}
        return {f"{name}.{key}": v for name, own in values.items() for key, v in own.items()}

    def tolerances(self) -> dict[str, float]:
        """Relative standard deviations that the case gives, by parameter.

        For what is in ``[attached]`` they are relative to the mass or stiffness in the case.
        """
        found = {}
        for name, section in {**self.parts, **self.joints}.items():
            given = section.tolerance.model_dump(exclude_none=True)
            found |= {f"{name}.{key}": value for key, value in given.items()}
        for name, section in {**self.masses, **self.springs, **self.attached}.items():
            key = next(iter(section.nominal()))
            if section.tolerance is not None:
                found[f"{name}.{key}"] = section.tolerance
        return found


# -- reading ---------------------------------------------------------------------------------------


def load_case(path: str | Path) -> Case:
    """Read and check a case and its measured data. Needs no MPI.

    Args:
        path: The case file, or a folder with a ``case.toml``.

    Raises:
        InputError: Names the file and, for each error, the key, the value and what was expected.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "case.toml"
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a case file or a folder with case.toml")
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from error
    try:
        case = Case.model_validate(raw)
    except ValidationError as error:
        raise _error(path, [_describe(e) for e in error.errors()]) from None
    case._path = path
    errors = [*_check_names(case), *_check_mesh(case), *_read_tests(case)]
    errors += _check_update(case) if case.update else []
    if errors:
        raise _error(path, errors)
    return case


def _error(path: Path, errors: list[str]) -> InputError:
    if len(errors) == 1:
        return InputError(f"{path}: {errors[0]}")
    return InputError("\n  ".join([f"{path}: {len(errors)} errors:", *errors]))


def _said(key: str, value: Any, expected: str) -> str:
    shown = repr(value)
    return f"{key} = {shown if len(shown) <= 80 else shown[:77] + '...'}: {expected}"


def _describe(error: dict[str, Any]) -> str:
    """One line for one of pydantic's errors."""
    loc = error["loc"]
    key = _dotted(loc)
    kind, value, ctx = error["type"], error["input"], error.get("ctx", {})
    if kind == "missing":
        return f"{key} is missing: expected it in {_place(loc)}"
    if kind == "extra_forbidden":
        return _said(key, value, f"unknown key{_did_you_mean(str(loc[-1]), _fields(loc[:-1]))}")
    if kind == "union_tag_not_found":
        expected = "kind = 'mass' or 'spring'"
        if loc[0] == "mesh":
            expected = "either builder = 'lap_plates' or file = 'NAME.msh'"
        return _said(key, value, f"expected {expected}")
    if kind == "value_error":
        text = str(ctx["error"])
        # Of a section as a whole the message itself names the values.
        return f"{key}: {text}" if isinstance(value, dict) else _said(key, value, text)
    if kind == "literal_error":
        hint = difflib.get_close_matches(str(value), ctx["expected"].replace("'", "").split(), 1)
        mean = f"; did you mean {hint[0].rstrip(',')!r}?" if hint else ""
        return _said(key, value, f"expected {ctx['expected']}{mean}")
    return _said(key, value, f"expected {_plain(error['msg'])}")


def _plain(message: str) -> str:
    for start in ("Input should be ", "Input should have ", "Value should have "):
        message = message.removeprefix(start)
    return message.removeprefix("a valid ").replace("a valid ", "")


def _dotted(loc: tuple) -> str:
    key = ""
    for item in loc:
        if isinstance(item, int):
            key += f"[{item}]"
        elif not item.startswith("<") and item != "[key]":
            key += f".{item}" if key else item
    return key or "the file"


def _place(loc: tuple) -> str:
    section = _dotted(loc[:-1])
    return f"[{section}]" if len(loc) > 1 else "the file"


def _did_you_mean(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, 1, 0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ";"
    return f"{hint} Expected one of: {', '.join(known)}" if known else ""


def _fields(loc: tuple) -> list[str]:
    """Keys of the section at a place in the file."""
    kinds = [Case]
    for item in loc:
        kinds = [option for kind in kinds for option in _inside(kind, item)]
    found = []
    for kind in kinds:
        fields = kind.model_fields.items() if hasattr(kind, "model_fields") else ()
        found += [field.alias or name for name, field in fields]
    return found


def _inside(kind: Any, item: str | int) -> list[Any]:
    """What types the value under ``item`` of a value of type ``kind`` may have."""
    if isinstance(item, str) and item.startswith("<"):
        return [kind] if getattr(kind, "__name__", "") == item[1:-1] else []
    if hasattr(kind, "model_fields"):
        field = kind.model_fields.get(item)
        return _options(field.annotation) if field else []
    if typing.get_origin(kind) in (dict, list, tuple):
        return _options(typing.get_args(kind)[-1])
    return []


def _options(kind: Any) -> list[Any]:
    """A type without its annotations, or the members of a union."""
    origin = typing.get_origin(kind)
    if origin is Annotated:
        return _options(typing.get_args(kind)[0])
    if origin in (typing.Union, types.UnionType):
        return [option for member in typing.get_args(kind) for option in _options(member)]
    return [kind]


# -- checks across sections ------------------------------------------------------------------------


def _check_names(case: Case) -> list[str]:
    seen: dict[str, str] = {}
    errors = []
    for table in ("parts", "joints", "masses", "springs", "attached"):
        for name in getattr(case, table):
            if name in seen:
                errors.append(f"{table}.{name}: the name is used by {seen[name]}; expected another")
            seen[name] = f"{table}.{name}"
    for table in ("parts", "joints"):
        for name, section in getattr(case, table).items():
            errors += _check_bounds(f"{table}.{name}", section)
    return errors


def _check_bounds(key: str, section: Part | Joint) -> list[str]:
    values = section.nominal()
    return [
        _said(f"{key}.bounds.{name}", list(pair), f"expected a range that holds {values[name]:g}")
        for name, pair in section.bounds.model_dump(exclude_none=True).items()
        if name in values and not pair[0] <= values[name] <= pair[1]
    ]


def _check_mesh(case: Case) -> list[str]:
    """Names of cells and facets against the builder's; a file's are checked when it is read."""
    if isinstance(case.mesh, FileMesh):
        file = case.folder / case.mesh.file
        missing = _said("mesh.file", case.mesh.file, f"no such file, expected a mesh at {file}")
        return [] if file.is_file() else [missing]
    from fenics_joints.meshes.lap_plates import CELL_NAMES, FACET_NAMES

    return unknown_groups(case, CELL_NAMES, FACET_NAMES)


def unknown_groups(case: Case, cells: typing.Iterable[str], facets: typing.Iterable[str]):
    """A line for each group that the case names and the mesh does not have.

    Args:
        case: The case.
        cells: Names of the mesh's groups of cells.
        facets: Names of the mesh's groups of facets.
    """
    cells, facets = list(cells), list(facets)
    named = [
        (f"{table}.{name}.cells", cell, cells)
        for table in ("parts", "joints")
        for name, section in getattr(case, table).items()
        for cell in section.cells
    ] + [(f"supports.{name}.facets", s.facets, facets) for name, s in case.supports.items()]
    return [
        _said(key, name, f"is not in the mesh{_did_you_mean(name, there)}")
        for key, name, there in named
        if name not in there
    ]


def _read_tests(case: Case) -> list[str]:
    test = case.test
    if test is None:
        return []
    errors = []
    sources = [("test", test)] + ([("test.validation", test.validation)] if test.validation else [])
    for key, source in sources:
        try:
            data = _read_test(case, key, source)
        except InputError as error:
            errors.append(f"{key}: {error}")
            continue
        if key == "test":
            case._measured = data
        else:
            case._validation = data
    measured, validation = case._measured, case._validation
    if measured and validation and measured.condition_unit != validation.condition_unit:
        errors.append(
            f"test.validation: {test.condition} is in {validation.condition_unit!r}, "
            f"expected {measured.condition_unit!r} as in test.frequencies"
        )
    return errors


def _read_test(case: Case, key: str, source: Test | ValidationTest) -> TestData:
    test = case.test
    files = {}
    for name in ("frequencies", "damping"):
        file = getattr(source, name)
        files[name] = None if file is None else case.folder / file
        if file is not None and not files[name].is_file():
            raise InputError(
                _said(name, file, f"no such file, expected CSV or TOML at {files[name]}")
            )
    modes = test.modes
    if modes is None and key != "test" and case._measured is not None:
        modes = case._measured.mode_names
    data = read_test_data(
        files["frequencies"], condition=test.condition, modes=modes, damping=files["damping"]
    )
    n = len(data.mode_names)
    per_mode = {}
    for name in ("resolution", "noise"):
        values = getattr(test, name)
        if len(values) not in (1, n):
            raise InputError(
                _said(name, values, f"expected one value, or {n}: one for each of the modes")
            )
        per_mode[name] = values[0] if len(values) == 1 else values
    return replace(
        data,
        resolution_hz=per_mode["resolution"],
        noise=per_mode["noise"],
        sensors=case.sensors(),
    )


def _check_update(case: Case) -> list[str]:
    update, measured = case.update, case._measured
    errors = []
    units = {"E": "Pa", "G": "Pa", "rho": "kg/m3", "mass": "kg", "stiffness": "N/m"}
    known = case.nominal()
    for i, name in enumerate(update.parameters):
        if name not in known:
            key = f"update.parameters[{i}]"
            errors.append(_said(key, name, f"no such parameter{_did_you_mean(name, list(known))}"))
    for name, value in update.start.items():
        key = f"update.start.{name}"
        if name not in update.parameters:
            hint = _did_you_mean(name, update.parameters)
            errors.append(_said(key, value, f"is not in update.parameters{hint}"))
            continue
        try:
            case._start[name] = to_si(value, units.get(name.rpartition(".")[2], ""))
        except InputError as error:
            errors.append(_said(key, value, str(error)))
    if measured is None:
        return errors
    given = [] if update.at is None else [("update.at", update.at)]
    given += [(f"update.hold_out[{i}]", c) for i, c in enumerate(update.hold_out)]
    for key, condition in given:
        try:
            measured.row(condition)
        except InputError as error:
            errors.append(_said(key, condition, str(error)))
    if not errors and not len(measured.without(update.hold_out)):
        expected = f"expected some {measured.condition_name} left to fit"
        errors.append(_said("update.hold_out", update.hold_out, expected))
    return errors
