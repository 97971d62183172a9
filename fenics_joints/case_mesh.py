"""The ``[mesh]`` section of a case file: one class for each builder, and one for a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Tag

from fenics_joints.case_cad import STEP_SUFFIXES, MeshFile, StepMesh
from fenics_joints.case_sections import Count, Gap, Length, Section, Size

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
    | Annotated[EngravingMachineMesh, Tag("<EngravingMachineMesh>")]
    | Annotated[FileMesh, Tag("<FileMesh>")]
    | Annotated[StepMesh, Tag("<StepMesh>")],
    Discriminator(_mesh_kind),
]
