"""The ``[mesh]`` section of a case file: one class for each builder, and one for a file."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from mpi4py import MPI
from pydantic import BeforeValidator, Field, create_model, model_validator

from fenics_joints.case.cad import STEP_SUFFIXES, JoinedMesh, StepMesh
from fenics_joints.case.mesh_section import MeshSection
from fenics_joints.case.values import (
    Count,
    Positive,
    Section,
    Size,
    either,
    listed,
    named_by,
    quantity,
)
from fenics_joints.errors import MeshError
from fenics_joints.meshes import (
    CBeams,
    Dumbbell,
    EngravingMachine,
    HalfLapBeam,
    LapBeam,
    LapPlates,
    TaggedMesh,
    read_msh,
)
from fenics_joints.meshes.arguments import Builder, Demand
from fenics_joints.meshes.grow import Grown, RingPlaces
from fenics_joints.parallel import on_root


class BuilderMesh(MeshSection):
    """``[mesh]`` with a builder, whose arguments are fields, optional, beside ``builder``."""

    origin = "builder"
    degree: Literal[1, 2] = 2

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        raise NotImplementedError


class SolidMesh(BuilderMesh):
    """``[mesh]`` with one of the builders of `fenics_joints.meshes`; see `section_of`."""

    made_by: ClassVar[type[Builder]]

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
        __doc__=f"``builder = {builder.function!r}``: arguments of `{builder.__name__}`.",
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
        return quantity(demand.unit, *([0.0] if limited else []), above=above)
    if origin is Annotated:
        return Count if inside[0] is int else _written(inside[0])
    if origin in (typing.Union, types.UnionType):
        return _written(inside[0])
    if origin in (Sequence, tuple):
        return (list if origin is Sequence else tuple)[tuple(map(_written, inside))]
    return kind


_Sizes = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1)]
#: More than the 400 that `fenics_joints.beams` takes in all; it says so.
_Few = Annotated[int, Field(ge=1, le=1000, strict=True)]
_Counts = Annotated[list[_Few], BeforeValidator(listed), Field(min_length=1)]


class OffsetBeamsMesh(BuilderMesh):
    """``builder = "offset_beams"``: beams in a row, each lapped with the next, in place of a mesh.

    The beams are ``beam_1``, ``beam_2``, ..., the laps ``lap``, or ``lap_1``, ... if there are
    several, the ends ``left`` and ``right``; x starts at the left end, and z = 0 is where the beams
    touch. A single value of a list holds for all. ``elements`` are those of each beam outside its
    laps. With ``lap_zones``, of two beams, the lap is ``zone_1``, ``zone_2``, ... instead, of that
    many joint elements each, which together are the ``lap_elements``. With ``offset_mass = false``
    the mass is that of beams whose axis is the line of the nodes, as in Jalali et al. 2019: see
    `fenics_joints.beams.element`.
    """

    origin = "beams"
    builder: Literal["offset_beams"]
    lengths: _Sizes
    laps: Annotated[list[Size], BeforeValidator(listed)] = []
    width: _Sizes
    thickness: _Sizes
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


class FileMesh(JoinedMesh):
    """``[mesh]`` from a gmsh file with named physical groups.

    Without ``joint`` and ``[mesh.bolts]`` it is as the file has it, layers included. With ``gdim =
    2`` it is a section in plane strain, one metre deep; with a ``thickness`` it is the middle
    surface of a sheet, which is meshed in space.
    """

    scale: Size = 1.0
    gdim: Literal[2, 3] = 3
    thickness: Size | None = None

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
        rings = None
        if self.bolts is not None:
            given = self.bolts.arguments()
            rings = RingPlaces(
                np.atleast_1d(given["r_wai"]).tolist(),
                given["r_nei"] or 0.0,
                None if given["bolts"] is None else np.array(given["bolts"]),
                given["hole"],
            )
        return Grown(joint, self.layer, rings, self.bonded or (), self.between)

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


#: Classes of the builders, by name.
BUILDERS = named_by(
    "builder",
    (
        *map(section_of, (LapPlates, CBeams, LapBeam, HalfLapBeam, Dumbbell, EngravingMachine)),
        OffsetBeamsMesh,
    ),
)


def _kind(data: Any) -> type[Section] | None:
    if not isinstance(data, dict) or ("file" in data) == ("builder" in data):
        return None
    if "file" in data:
        return StepMesh if str(data["file"]).lower().endswith(STEP_SUFFIXES) else FileMesh
    name = data["builder"]
    return BUILDERS.get(name) if isinstance(name, str) else None


Mesh = either(
    _kind,
    (*BUILDERS.values(), FileMesh, StepMesh),
    key="builder",
    known=" ".join(BUILDERS),
    instead="file = 'NAME.msh' or 'NAME.step'",
)
