"""The ``[mesh]`` section of a case file: a class for each builder, and for files of either kind."""

from __future__ import annotations

import inspect
import math
import types
import typing
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from mpi4py import MPI
from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from fenics_joints.case.own_code import find, is_reference
from fenics_joints.case.preload import known_thread
from fenics_joints.case.usual import usual
from fenics_joints.case.values import (
    CaseSection,
    Count,
    Density,
    File,
    Length,
    Modulus,
    Number,
    Positive,
    Size,
    either,
    listed,
    named,
    named_by,
    quantity,
)
from fenics_joints.database import JointSurfaces, TorqueToForce, query, seed_database
from fenics_joints.errors import InputError, MeshError, raised
from fenics_joints.meshes import TaggedMesh, read_msh, read_step
from fenics_joints.meshes.arguments import CASE_BUILDERS, Builder, Demand
from fenics_joints.meshes.grow import Grown
from fenics_joints.parallel import on_root
from fenics_joints.preload.clearance import cone_radius
from fenics_joints.preload.threads import thread
from fenics_joints.preload.torque import nut_factor_force
from fenics_joints.units import to_si


class MeshSection(CaseSection):
    """``[mesh]``."""

    #: Where the structure is from: a builder, a file, a function of the user's own; or beams, or
    #: matrices, in place of a mesh.
    origin: ClassVar[Literal["builder", "file", "own", "beams", "matrices"]]
    #: Keys of parts and joints that its models do not have as parameters.
    lacks: ClassVar[frozenset[str]] = frozenset()

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh; ``folder`` is the case's. Collective.

        Raises:
            MeshError: If it cannot be built or read, or there is none.
            InputError: If an argument is out of range.
        """
        raise NotImplementedError

    @property
    def grows(self) -> bool:
        """Whether its layers are as thin as can be."""
        return False


STEP_SUFFIXES = (".step", ".stp", ".p21")
#: Least and largest hole of a thread as shares of its diameter: tapped, and coarse (ISO 273).
_HOLES = (0.8, 1.25)

_Space = Annotated[list[Length], Field(min_length=3, max_length=3)]
_Sizes = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1)]
_OneOrTwo = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1, max_length=2)]
_Pair = Annotated[list[str], Field(min_length=2, max_length=2)]


def _place(value: Any) -> str | int | list[float]:
    """A solid by its label, its number, or a point inside."""
    if isinstance(value, list) and len(value) == 3:
        return [to_si(item, "m") for item in value]
    if isinstance(value, str | int) and not isinstance(value, bool):
        return value
    raise ValueError("expected a label in the file, a number from 1, or a point inside")


def _points(value: Any) -> Any:
    """A list of points, also of a single one."""
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return value if nested else [value]


_Place = Annotated[Any, BeforeValidator(_place)]
_Points = Annotated[list[_Space], BeforeValidator(_points), Field(min_length=1)]


class BoltsSection(CaseSection):
    """``[mesh.bolts]``: rings of the transition layer around the bolts.

    Their outer radius is given; or it is the contact radius of the thread and the torque in plates
    of a thickness, from the database that comes with the package (Machines 2022, Table 2); or,
    without torque or with ``spread = "cone"``, that of a cone under the bolt's head
    (`fenics_joints.preload.clearance.cone_radius`).

    Attributes:
        r_wai: Outer radius of the rings, one or one for each.
        r_nei: Inner radius; that of the wider hole by default.
        at: Centres of the bolts; by default all pairs of holes that fit.
        hole: Diameter of the holes, or [low, high].
        thread: Such as "M12".
        torque: Tightening torque of one bolt (T = K d F).
        force: Force of one bolt, from which the joints' starting stiffness comes.
        spread: Where the outer radius is from.
        thickness: Thickness of the plates.
        nut_factor: K of the torque.
    """

    r_wai: _Sizes | None = None
    r_nei: Size | None = None
    at: _Points | None = None
    hole: _OneOrTwo | None = None
    thread: Annotated[str, AfterValidator(known_thread)] | None = None
    torque: quantity("N*m", 0, above=True) | None = None
    force: quantity("N", 0, above=True) | None = None
    spread: Literal["database", "cone"] | None = None
    thickness: Size | None = None
    nut_factor: Positive = 0.2

    @model_validator(mode="after")
    def _one_way(self) -> BoltsSection:
        if (self.r_wai is None) == (self.thickness is None):
            raise ValueError(
                "expected either r_wai, or thread, torque and thickness (or thread and thickness, "
                "for a cone under the head)"
            )
        if self.thread is None and (self.torque is not None or self.thickness is not None):
            key = "thickness" if self.torque is None else "torque"
            raise ValueError(f"{key} needs the thread, such as thread = 'M12'")
        if self.torque is not None and self.force is not None:
            raise ValueError("expected either force or torque, not both")
        if self.spread == "database" and self.torque is None and self.r_wai is None:
            raise ValueError("spread = 'database' needs the torque")
        return self

    def preload(self) -> float | None:
        """Force of one bolt, N; T = K d F."""
        if self.torque is None:
            return self.force
        return nut_factor_force(self.torque, thread(self.thread).diameter, self.nut_factor)

    def extent(self) -> tuple[list[float], str]:
        """Outer radius of the rings, m, one or one for each, and where it is from, in words.

        Raises:
            InputError: If the database has no answer.
        """
        if self.r_wai is not None:
            return self.r_wai, "as given"
        if self.torque is None or self.spread == "cone":
            words = f"a cone of 30 degrees under the head of {self.thread}, Shigley, after Osgood"
            head = thread(self.thread).width_across_flats / 2
            return [cone_radius(head, self.thickness)], words
        return [self.radius()], "contact radius from the package's database, Machines 2022, Table 2"

    def inner(self) -> float:
        """Inner radius of the rings, m, as far as it is known without the mesh."""
        if self.r_nei is not None:
            return self.r_nei
        if self.hole is not None:
            return max(self.hole) / 2
        return 0.0 if self.thread is None else thread(self.thread).hole_diameter / 2

    def arguments(self) -> dict[str, Any]:
        """Arguments of `fenics_joints.meshes.read_step`.

        Raises:
            InputError: If the database has no answer.
        """
        hole = None
        if self.hole is not None:
            hole = min(self.hole), max(self.hole)
        elif self.thread is not None:
            hole = tuple(share * thread(self.thread).diameter for share in _HOLES)
        radii, _ = self.extent()
        return {
            "r_wai": radii[0] if len(radii) == 1 else radii,
            "r_nei": self.r_nei,
            "bolts": self.at,
            "hole": hole,
        }

    def radius(self) -> float:
        """Contact radius of the thread and the torque, m, from the package's database."""
        try:
            with seed_database() as store:
                answer = query(
                    JointSurfaces.fit(store, outputs=["radius"]),
                    bolt=self.thread,
                    thickness=self.thickness,
                    torque=self.torque,
                    torque_to_force=TorqueToForce(self.nut_factor),
                )
        except InputError as error:
            raise InputError(f"mesh.bolts: {error}; expected r_wai, or spread = 'cone'") from error
        return answer.radius.value


class MeshFile(MeshSection):
    """``[mesh]`` with a file of parts that are to be joined where they touch.

    Attributes:
        file: The file.
        degree: Degree of the displacement.
        joint: "rings" at the bolts, a "layer" on all that touches, or "contact": separate parts.
        layer: Thickness of the layers; without it they are so thin that nothing is moved.
        bonded: Pairs of parts that are welded.
        between: Pairs of parts that get a layer; all that touch by default.
        bolts: Rings around the bolts.
    """

    origin = "file"
    file: File
    degree: Literal[1, 2] = 2
    joint: Literal["rings", "layer", "contact"] | None = None
    layer: Size | None = None
    bonded: list[_Pair] | None = None
    between: list[_Pair] | None = None
    bolts: BoltsSection | None = None

    @property
    def grows(self) -> bool:
        """See `MeshSection.grows`."""
        return self.layer is None and self.joint != "contact"

    @model_validator(mode="after")
    def _bolts_for_rings(self) -> MeshFile:
        rings = self.joint in (None, "rings")
        if self.joint == "rings" and self.bolts is None:
            raise ValueError("joint = 'rings' needs a section [mesh.bolts]")
        if self.bolts is not None and not rings:
            raise ValueError(f"[mesh.bolts] is given: expected joint = 'rings', not {self.joint!r}")
        return self


class WasherSection(CaseSection):
    """``[mesh.washers.NAME]``: a round face that a head or nut presses, around a hole.

    Attributes:
        at: Its centre, in a round hole of an outer flat face.
        radius: Its outer radius.
    """

    at: _Space
    radius: Size


class StepMesh(MeshFile):
    """``[mesh]`` with a STEP file.

    Attributes:
        size: Size of the largest cells.
        n_layer: Cells through a layer's thickness.
        ring_size: Size of the cells in the rings.
        circle: Edges of a circle.
        parts: Names of the solids, each by its label, its number in the file or a point inside.
        without: Solids that are left out, such as bolts and nuts.
        faces: Names of faces, each by points on it.
        washers: Names of round faces under heads and nuts.
    """

    size: Size
    n_layer: Count | None = None
    ring_size: Size | None = None
    circle: Annotated[int, Field(ge=6, le=10_000, strict=True)] | None = None
    parts: named(_Place) | None = None
    without: list[_Place] | None = None
    faces: named(_Points) | None = None
    washers: named(WasherSection) | None = None

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        given = self.model_dump(exclude={"file", "degree", "size", "bolts"}, exclude_none=True)
        given["joint"] = self.joint or ("layer" if self.bolts is None else "rings")
        given["washers"] = {name: (w.at, w.radius) for name, w in (self.washers or {}).items()}
        more = {} if self.bolts is None else comm.bcast(on_root(comm, self.bolts.arguments))
        return read_step(folder / self.file, comm, element_size=self.size, **given, **more)


class SolidMesh(MeshSection):
    """``[mesh]`` with one of the builders of `fenics_joints.meshes`; see `section_of`.

    Attributes:
        degree: Degree of the displacement.
    """

    origin = "builder"
    made_by: ClassVar[type[Builder]]
    degree: Literal[1, 2] = 2

    def made(self) -> Builder:
        """The builder with the arguments that the file gives."""
        given = self.model_dump(exclude={"builder", "degree"}, exclude_none=True)
        return self.made_by(**given)

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        return self.made().groups()

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        return self.made().build(comm)


class LappedMesh(SolidMesh):
    """``[mesh]`` with two bodies that touch, between which there may be a layer instead."""

    def with_layer(self, thickness: float) -> LappedMesh:
        """The same plan with a layer, ``joint``, that makes the two bodies one."""
        return self.model_copy(update={"layer": thickness, "bonded": None})


def section_of(builder: type[Builder]) -> type[SolidMesh]:
    """The section for a builder: its arguments, as people write them with units."""
    kinds = typing.get_type_hints(builder, include_extras=True)
    arguments = {f.name: (_written(kinds[f.name]) | None, None) for f in fields(builder)}
    section = create_model(
        f"{builder.__name__}Mesh",
        __module__=__name__,
        __doc__=inspect.cleandoc(builder.__doc__),
        __base__=LappedMesh if "bonded" in arguments else SolidMesh,
        builder=(Literal[builder.function], ...),
        **arguments,
    )
    section.made_by = builder
    globals()[section.__name__] = section  # by its name a case is sent from rank to rank
    return section


def _written(kind: Any) -> Any:
    """The type of an argument in a file."""
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated and inside[0] is float:
        demand: Demand = inside[1]
        limited, above = not demand.holds(-1.0), not demand.holds(0.0)
        own = quantity(demand.unit, *([0.0] if limited else []), above=above)
        return usual(own, "length") if limited and demand.unit == "m" else own
    if origin is Annotated:
        return Count if inside[0] is int else _written(inside[0])
    if origin in (typing.Union, types.UnionType):
        return _written(inside[0])
    if origin in (Sequence, tuple):
        return (list if origin is Sequence else tuple)[tuple(map(_written, inside))]
    return kind


_Lengths = usual(_Sizes, "length")
#: More than the 400 that `fenics_joints.beams` takes in all; it says so.
_Few = Annotated[int, Field(ge=1, le=1000, strict=True)]
_Counts = Annotated[list[_Few], BeforeValidator(listed), Field(min_length=1)]


class OffsetBeamsMesh(MeshSection):
    """``builder = "offset_beams"``: beams in a row, each lapped with the next, in place of a mesh.

    The beams are ``beam_1``, ``beam_2``, ..., the laps ``lap``, or ``lap_1``, ... if there are
    several, the ends ``left`` and ``right``; x starts at the left end, and z = 0 is where the beams
    touch. A single value of a list holds for all.

    Attributes:
        builder: Name of the builder.
        degree: Has no meaning here.
        lengths: Length of each beam, in a row.
        laps: Length of each lap.
        width: Width of each beam.
        thickness: Thickness of each beam.
        elements: Elements of each beam outside its laps.
        lap_elements: Joint elements of each lap.
        lap_zones: Joint elements of each zone of the one lap, then named zone_1, zone_2, ...
        shear: Shear factor of the section.
        offset_mass: If false, the mass is that of beams whose axis is the line of the nodes, as in
            Jalali et al. 2019; see `fenics_joints.beams.element`.
    """

    origin = "beams"
    builder: Literal["offset_beams"]
    degree: Literal[1, 2] = 2
    lengths: _Lengths
    laps: usual(Annotated[list[Size], BeforeValidator(listed)], "length") = []
    width: _Lengths
    thickness: _Lengths
    elements: _Counts
    lap_elements: _Counts = [5]
    lap_zones: _Counts | None = None
    shear: Positive = 1.2
    offset_mass: bool = True

    @model_validator(mode="after")
    def _one_for_each(self) -> OffsetBeamsMesh:
        n = len(self.lengths)
        if len(self.laps) not in ({1, n - 1} if n > 1 else {0}):
            raise ValueError(f"laps has {len(self.laps)} values: expected {n - 1} for {n} beams")
        numbers = {"width": n, "thickness": n, "elements": n, "lap_elements": n - 1}
        for key, most in numbers.items():
            found = len(getattr(self, key))
            if found not in (1, most):
                raise ValueError(f"{key} has {found} values: expected one, or {most}")
        zones = self.lap_zones
        if zones is not None and (n != 2 or sum(zones) != self.lap_elements[0]):
            expected = f"expected two beams, and zones of {self.lap_elements[0]} elements together"
            raise ValueError(f"lap_zones = {zones}: {expected}")
        return self

    def of(self, key: str) -> list:
        """A value of ``key`` for each beam, or lap."""
        n = len(self.lengths) - (key in ("laps", "lap_elements"))
        values = list(getattr(self, key))
        return values * n if len(values) == 1 else values

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the beams and laps, and of the ends."""
        beams = [f"beam_{i + 1}" for i in range(len(self.lengths))]
        laps = dict.fromkeys(cell for lap in self.lap_cells() for cell in lap)
        return [*beams, *laps], ["left", "right"]

    def lap_cells(self) -> list[list[str]]:
        """Name of each joint element of each lap."""
        laps = len(self.lengths) - 1
        if self.lap_zones is not None:
            return [[f"zone_{i + 1}" for i, n in enumerate(self.lap_zones) for _ in range(n)]]
        names = ["lap"] if laps == 1 else [f"lap_{i + 1}" for i in range(laps)]
        return [[lap] * n for lap, n in zip(names, self.of("lap_elements"), strict=True)]

    def volume(self, cells: Sequence[str]) -> float:
        """Volume of the beams among these groups, m3."""
        sizes = zip(self.of("lengths"), self.of("width"), self.of("thickness"), strict=True)
        return sum(math.prod(s) for i, s in enumerate(sizes) if f"beam_{i + 1}" in cells)

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """Refused: beams have no mesh.

        Raises:
            MeshError: Always.
        """
        raise MeshError(
            "builder = 'offset_beams' has no mesh of cells: expected another builder, or a file, "
            "for what this command does; modes, update and diagnose work on beams"
        )


class FileMesh(MeshFile):
    """``[mesh]`` from a gmsh file with named physical groups.

    Without ``joint`` and ``[mesh.bolts]`` it is as the file has it, layers included.

    Attributes:
        scale: Length of the file's unit.
        gdim: 2 for a plane mesh: a section in plane strain, one metre deep.
        thickness: Thickness of a sheet, whose middle surface a plane mesh is.
    """

    scale: Size = 1.0
    gdim: Literal[2, 3] = 3
    thickness: usual(Size, "length") | None = None

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        grown = comm.bcast(on_root(comm, self._grown))
        return read_msh(
            folder / self.file,
            comm,
            gdim=self.gdim,
            scale=self.scale,
            grown=grown,
            thickness=self.thickness,
        )

    @property
    def grows(self) -> bool:
        """See `MeshSection.grows`."""
        return super().grows and (self.joint is not None or self.bolts is not None)

    def _grown(self) -> Grown | None:
        """The layers that are to be grown, if any."""
        joint = self.joint or (None if self.bolts is None else "rings")
        if joint is None:
            return None
        return Grown(
            joint=joint,
            layer=self.layer,
            bonded=self.bonded or (),
            between=self.between,
            **({} if self.bolts is None else self.bolts.arguments()),
        )

    @model_validator(mode="after")
    def _sheet(self) -> FileMesh:
        if self.thickness is not None and self.gdim != 2:
            raise ValueError("thickness given: expected gdim = 2, as only a plane mesh has one")
        return self

    @model_validator(mode="after")
    def _something_to_grow(self) -> FileMesh:
        given = [k for k in ("layer", "bonded", "between") if getattr(self, k) is not None]
        if given and self.joint is None and self.bolts is None:
            raise ValueError(
                f"{', '.join(given)} given: expected joint = 'layer', 'rings' or 'contact' too"
            )
        return self


class PartMatrices(CaseSection):
    """``[mesh.matrices.NAME]``: the matrices of one part, which ``cells`` of a part name.

    Attributes:
        stiffness: K: ``.mtx`` of Matrix Market or Abaqus, ``.npz``, ``.mat``, CalculiX's ``.sti``,
            Nastran's ``.op4``, ``.op2`` or DMIG in ``.pch``, ANSYS' ``.full``.
        mass: M: likewise, CalculiX's ``.mas``.
        damping: Viscous damping, likewise.
        nodes: Table 'node, x, y, z', or CalculiX's or Abaqus' deck with its sets of nodes.
        dofs: Node and direction of each row: CalculiX's ``.dof``, or a table 'node, direction';
            where the matrices do not say it.
        names: Names of K, M (and the damping) in files of several matrices.
        thickness: Of a flat shell of CalculiX, which has several nodes through it.
        E: Young's modulus that the matrices were made with; the part's by default.
        rho: Density likewise.
    """

    stiffness: File
    mass: File
    damping: File | None = None
    nodes: File
    dofs: File | None = None
    names: Annotated[list[str], Field(min_length=2, max_length=3)] | None = None
    thickness: usual(Size, "length") | None = None
    E: usual(Modulus, "E") | None = None
    rho: usual(Density, "rho") | None = None

    @model_validator(mode="after")
    def _other_names(self) -> PartMatrices:
        if self.names is not None and len(set(self.names)) < len(self.names):
            raise ValueError(f"names = {self.names}: expected another name for each matrix")
        return self


class NodeSet(CaseSection):
    """``[mesh.nodes.NAME]``: nodes of a part, for joints and supports.

    Attributes:
        part: The part's matrices.
        set: A set of the part's deck.
        numbers: Numbers of the nodes, as the other code has them.
        box: Two corners of a box that holds them.
    """

    part: str
    set: str | None = None
    numbers: list[int] | None = None
    box: Annotated[list[_Space], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> NodeSet:
        if sum(each is not None for each in (self.set, self.numbers, self.box)) != 1:
            raise ValueError("expected one of set, numbers and box")
        return self


class MatrixInterface(CaseSection):
    """``[mesh.interfaces.NAME]``: where two parts touch, which ``cells`` of a joint name.

    Attributes:
        between: The matrices of the two parts.
        nodes: Sets of nodes of the two faces; by default the nodes at which the parts are nearest.
        area: Area, if it is known better than by triangles between the nodes.
    """

    between: _Pair
    nodes: _Pair | None = None
    area: quantity("m2", 0, above=True) | None = None


class MatricesMesh(MeshSection):
    """``[mesh]`` of parts by stiffness and mass matrices of another code.

    E and rho of a part are factors on its matrices, relative to the values that these were made
    with.

    Attributes:
        matrices: Files of each part.
        interfaces: Where parts touch.
        nodes: Sets of nodes.
        length_unit: Unit of length of the files.
        force_unit: Unit of force of the files; that of mass is force times s2 over length, as
            tonnes with N and mm.
        degree: Has no meaning here.
    """

    origin = "matrices"
    lacks = frozenset({"nu", "thickness", "width"})
    matrices: Annotated[named(PartMatrices), Field(min_length=1)]
    interfaces: named(MatrixInterface) = {}
    nodes: named(NodeSet) = {}
    length_unit: str = "m"
    force_unit: str = "N"
    degree: Literal[1, 2] = 1

    @model_validator(mode="after")
    def _known(self) -> MatricesMesh:
        for unit, kind in ((self.length_unit, "m"), (self.force_unit, "N")):
            try:
                to_si(f"1 {unit}", kind)
            except InputError as error:
                raise ValueError(str(error)) from None
        for key, each in self.interfaces.items():
            for part in each.between:
                if part not in self.matrices:
                    raise ValueError(
                        f"interfaces.{key}.between: {part!r}: expected two of "
                        f"{', '.join(self.matrices)}"
                    )
        return self

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """Refused: matrices have no mesh.

        Raises:
            MeshError: Always.
        """
        raise MeshError(
            "[mesh.matrices] has no mesh of cells: expected a builder or a file for what this "
            "command does; modes, update, bayes and diagnose work on matrices"
        )


_Numbers = bool | Number | list[Number] | list[list[Number]]


class OwnMesh(MeshSection):
    """``builder = "module:name"``: a function of your own that makes the mesh.

    Attributes:
        builder: It takes a communicator and the arguments, and returns a
            `fenics_joints.meshes.TaggedMesh` on all ranks.
        arguments: Its further arguments by name: numbers in SI units, or lists of them.
        degree: Degree of the displacement.
    """

    origin = "own"
    builder: str
    arguments: dict[str, _Numbers] = {}
    degree: Literal[1, 2] = 2

    @model_validator(mode="after")
    def _there(self) -> OwnMesh:
        self._function()
        return self

    def _function(self) -> types.FunctionType:
        return find(self.builder, types.FunctionType, "a function that returns a TaggedMesh")

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """See `MeshSection.build`."""
        try:
            made = self._function()(comm, **self.arguments)
        except Exception as error:  # whatever a function of somebody's own may raise
            raise MeshError(raised(f"mesh.builder: {self.builder}", error)) from error
        if not isinstance(made, TaggedMesh):
            raise MeshError(f"{self.builder}: returns {type(made).__name__}, expected a TaggedMesh")
        return made


#: Classes of the builders, by name.
BUILDERS = named_by("builder", (*map(section_of, CASE_BUILDERS.values()), OffsetBeamsMesh))


def _kind(data: Any) -> type[CaseSection] | None:
    if not isinstance(data, dict) or sum(k in data for k in ("file", "builder", "matrices")) != 1:
        return None
    if "matrices" in data:
        return MatricesMesh
    if "file" in data:
        return StepMesh if str(data["file"]).lower().endswith(STEP_SUFFIXES) else FileMesh
    name = data["builder"]
    if not isinstance(name, str):
        return None
    return BUILDERS.get(name) or (OwnMesh if is_reference(name) else None)


Mesh = either(
    _kind,
    (*BUILDERS.values(), OwnMesh, FileMesh, StepMesh, MatricesMesh),
    key="builder",
    known=" ".join(BUILDERS),
    instead="file = 'NAME.msh' or 'NAME.step'",
)
