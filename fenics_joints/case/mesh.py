"""The ``[mesh]`` section of a case file: one class for each builder, and one for a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from fenics_joints.case.cad import STEP_SUFFIXES, MeshFile, StepMesh
from fenics_joints.case.values import Count, Gap, Length, Positive, Section, Size, listed
from fenics_joints.errors import MeshError

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_joints.meshes import TaggedMesh

__all__ = [
    "BUILDERS",
    "BuilderMesh",
    "CBeamsMesh",
    "DumbbellMesh",
    "EngravingMachineMesh",
    "FileMesh",
    "LapBeamMesh",
    "LapPlatesMesh",
    "Mesh",
    "OffsetBeamsMesh",
    "MeshFile",
    "StepMesh",
]


class BuilderMesh(Section):
    """``[mesh]`` with a builder. A further builder is one more class, named in `BUILDERS`.

    The fields of such a class are the builder's arguments, optional, beside ``builder``.
    """

    degree: Literal[1, 2] = 2

    def arguments(self) -> dict[str, Any]:
        """The builder's arguments that the file gives."""
        return self.model_dump(exclude={"builder", "degree"}, exclude_none=True)

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        raise NotImplementedError

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        raise NotImplementedError


class LapPlatesMesh(BuilderMesh):
    """``builder = "lap_plates"``: arguments of `fenics_joints.meshes.lap_plates`."""

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

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        from fenics_joints.meshes.lap_plates import CELL_NAMES, FACET_NAMES

        return list(CELL_NAMES), list(FACET_NAMES)

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        from fenics_joints.meshes import lap_plates

        return lap_plates(comm, **self.arguments())


class CBeamsMesh(BuilderMesh):
    """``builder = "c_beams"``: arguments of `fenics_joints.meshes.c_beams`."""

    builder: Literal["c_beams"]
    length: Size | None = None
    width: Size | None = None
    thickness: Size | None = None
    pad_thickness: Size | None = None
    pad_length: Size | None = None
    hole_diameter: Size | None = None
    washer_diameter: Size | None = None
    zone: Size | None = None
    element_size: Size | None = None
    radial_size: Size | None = None
    middle_size: Size | None = None
    n_thickness: tuple[Count, Count] | None = None
    layer: Gap | None = None
    bonded: bool | None = None
    cell: Literal["hexahedron", "tetrahedron"] | None = None

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        cells, faces = ["beam_1", "beam_2"], ["holes"]
        faces += [f"washer_{i}_{side}" for i in (1, 2) for side in ("lower", "upper")]
        if self.layer:
            return [*cells, "joint"], [*faces, "joint_lower", "joint_upper"]
        if self.bonded:
            return cells, [*faces, "interface"]
        return cells, [*faces, "interface_lower", "interface_upper"]

    def with_layer(self, thickness: float) -> CBeamsMesh:
        """The same plan with a layer, ``joint``, that makes the two beams one."""
        return self.model_copy(update={"layer": thickness, "bonded": None})

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        from fenics_joints.meshes import c_beams

        return c_beams(comm, **self.arguments())


class LapBeamMesh(BuilderMesh):
    """``builder = "lap_beam"``: arguments of `fenics_joints.meshes.lap_beam`."""

    builder: Literal["lap_beam"]
    length: Size | None = None
    width: Size | None = None
    thickness: Size | None = None
    lap: Size | None = None
    washer: Gap | None = None
    layer: Gap | None = None
    root: Gap | None = None
    bonded: bool | None = None
    n_length: Count | None = None
    n_lap: Count | None = None
    n_width: Count | None = None
    n_thickness: Count | None = None
    cell: Literal["hexahedron", "tetrahedron"] | None = None

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        cells, faces = ["beam_1", "beam_2"], ["clamp", "tip"]
        cells += ["root"] if self.root else []
        if self.washer is None or self.washer > 0:
            faces += ["washer_lower", "washer_upper"]
        if self.layer:
            return [*cells, "joint"], [*faces, "joint_lower", "joint_upper"]
        if self.bonded:
            return cells, [*faces, "interface"]
        return cells, [*faces, "interface_lower", "interface_upper"]

    def with_layer(self, thickness: float) -> LapBeamMesh:
        """The same plan with a layer, ``joint``, that makes the two beams one."""
        return self.model_copy(update={"layer": thickness, "bonded": None})

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        from fenics_joints.meshes import lap_beam

        return lap_beam(comm, **self.arguments())


class DumbbellMesh(BuilderMesh):
    """``builder = "dumbbell"``: arguments of `fenics_joints.meshes.dumbbell`."""

    builder: Literal["dumbbell"]
    head: tuple[Size, Size, Size] | None = None
    neck: tuple[Size, Size, Size] | None = None
    layer: Size | None = None
    element_size: Size | None = None
    n_layer: Count | None = None
    rings: list[tuple[Length, Length]] | None = None
    r_nei: Size | None = None
    r_wai: Size | None = None
    zone: Size | None = None
    holes: bool | None = None
    cell: Literal["hexahedron", "tetrahedron"] | None = None

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        from fenics_joints.meshes.dumbbell import BODIES, FACET_NAMES

        joints = [f"ring_{i + 1}" for i in range(len(self.rings or ()))] or ["joint"]
        return [*BODIES, *joints], list(FACET_NAMES)

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        from fenics_joints.meshes import dumbbell

        return dumbbell(comm, **self.arguments())


_Sizes = Annotated[list[Size], BeforeValidator(listed), Field(min_length=1)]
_Counts = Annotated[list[Count], BeforeValidator(listed), Field(min_length=1)]


class OffsetBeamsMesh(BuilderMesh):
    """``builder = "offset_beams"``: beams in a row, each lapped with the next, in place of a mesh.

    The beams are ``beam_1``, ``beam_2``, ..., the laps ``lap``, or ``lap_1``, ... if there are
    several, the ends ``left`` and ``right``; x starts at the left end, and z = 0 is where the beams
    touch. A single value of a list holds for all. ``elements`` are those of each beam outside its
    laps. With ``lap_zones``, of two beams, the lap is ``zone_1``, ``zone_2``, ... instead, of that
    many joint elements each, which together are the ``lap_elements``. With ``offset_mass = false``
    the mass is that of beams whose axis is the line of the nodes, as in seed 002: see
    `fenics_joints.beams.element`.
    """

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

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """Refused: beams have no mesh.

        Raises:
            MeshError: Always.
        """
        raise MeshError(
            "builder = 'offset_beams' has no mesh of cells: expected another builder, or a file, "
            "for what this command does; modes, update and diagnose work on beams"
        )


class EngravingMachineMesh(BuilderMesh):
    """``builder = "engraving_machine"``: arguments of `fenics_joints.meshes.engraving_machine`."""

    builder: Literal["engraving_machine"]
    bed: tuple[Size, Size, Size] | None = None
    column: Size | None = None
    arm: tuple[Size, Size] | None = None
    wall: Size | None = None
    flange: Size | None = None
    gusset: Size | None = None
    ribs: Count | None = None
    bolts: tuple[Count, Count] | None = None
    layer: Size | None = None
    r_nei: Size | None = None
    r_wai: Size | None = None
    zone: Size | None = None
    element_size: Size | None = None
    n_layer: Count | None = None
    cell: Literal["hexahedron", "tetrahedron"] | None = None

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the cells' and of the facets' groups."""
        from fenics_joints.meshes.engraving_machine import BODIES, FACET_NAMES, number_of_bolts

        rings = number_of_bolts(**self.model_dump(include={"bolts"}, exclude_none=True))
        return [*BODIES, *(f"ring_{i + 1}" for i in range(rings))], list(FACET_NAMES)

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective."""
        from fenics_joints.meshes import engraving_machine

        return engraving_machine(comm, **self.arguments())


class FileMesh(MeshFile):
    """``[mesh]`` from a gmsh file with named physical groups."""

    scale: Size = 1.0
    gdim: Literal[2, 3] = 3

    def read(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh; ``folder`` is the case's. Collective."""
        from fenics_joints.meshes import read_msh

        return read_msh(folder / self.file, comm, gdim=self.gdim, scale=self.scale)


#: Classes of the builders, by name.
BUILDERS = {
    "lap_plates": LapPlatesMesh, "c_beams": CBeamsMesh, "lap_beam": LapBeamMesh,
    "dumbbell": DumbbellMesh, "engraving_machine": EngravingMachineMesh,
    "offset_beams": OffsetBeamsMesh,
}  # fmt: skip


def _mesh_kind(data: Any) -> str | None:
    if not isinstance(data, dict) or ("file" in data) == ("builder" in data):
        return None
    if "file" in data:
        step = str(data["file"]).lower().endswith(STEP_SUFFIXES)
        return "<StepMesh>" if step else "<FileMesh>"
    name = data["builder"]
    return f"<{BUILDERS[name].__name__}>" if isinstance(name, str) and name in BUILDERS else None


Mesh = Annotated[
    Annotated[LapPlatesMesh, Tag("<LapPlatesMesh>")]
    | Annotated[CBeamsMesh, Tag("<CBeamsMesh>")]
    | Annotated[LapBeamMesh, Tag("<LapBeamMesh>")]
    | Annotated[DumbbellMesh, Tag("<DumbbellMesh>")]
    | Annotated[OffsetBeamsMesh, Tag("<OffsetBeamsMesh>")]
    | Annotated[EngravingMachineMesh, Tag("<EngravingMachineMesh>")]
    | Annotated[FileMesh, Tag("<FileMesh>")]
    | Annotated[StepMesh, Tag("<StepMesh>")],
    Discriminator(_mesh_kind),
]
