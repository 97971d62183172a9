"""The nominal model of a case in zones, of solids or of beams."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mpi4py import MPI

from fenics_joints.beams import BeamStructure
from fenics_joints.case import Case, build_mesh, build_structure
from fenics_joints.case.build_beams import build_beams
from fenics_joints.case.build_matrices import build_matrices, read_matrices
from fenics_joints.case.build_matrices import layer_thickness as layer_thickness_of_matrices
from fenics_joints.case.dimensions import AsGiven, Dimensions
from fenics_joints.case.size import available_bytes, estimate
from fenics_joints.diagnosis.effects.sited import needed
from fenics_joints.diagnosis.model.of_forms import FormCase
from fenics_joints.diagnosis.model.of_structure import ScriptedCase
from fenics_joints.diagnosis.where.cells import (
    BeamElements,
    FormCells,
    MatrixCells,
    MeshCells,
    StructureCells,
)
from fenics_joints.diagnosis.zones.contacts import contact_zones
from fenics_joints.diagnosis.zones.joints import interface_zones, joint_zones
from fenics_joints.diagnosis.zones.laps import lap_as_one, lap_zones
from fenics_joints.diagnosis.zones.sites import Sites, sites_of
from fenics_joints.diagnosis.zones.zone import Zones, bonded_values, layer_thickness
from fenics_joints.errors import InputError
from fenics_joints.matrices import MatrixStructure
from fenics_joints.progress import Progress
from fenics_joints.structure import FormModel, Parameter, Sensors
from fenics_joints.structure.structure import Structure


@dataclass
class Subject:
    """The nominal model of a case.

    Attributes:
        case: The case, with a joint section for each zone.
        full: The model, with all that effects need as parameters.
        zones: Its joints in zones.
        baseline: Parameter values of the nominal model.
        cells: Its cells.
        dimensions: Which thicknesses and widths it can represent; None: all, as beams can.
        sites: Places of what the nominal model lacks.
    """

    case: Case
    full: Structure | BeamStructure | FormModel | MatrixStructure
    zones: Zones
    baseline: dict[str, float]
    cells: StructureCells
    dimensions: Dimensions | AsGiven | None
    sites: Sites = field(default_factory=Sites.none)


def mesh_ranks(case: Case, comm: MPI.Intracomm) -> MPI.Intracomm:
    """On which ranks a case's mesh is: each has all of it if the machines have the memory, so that
    no result depends on their number; otherwise, or if it is made already, all share it.
    Collective.

    Args:
        case: The case.
        comm: Communicator.
    """
    if isinstance(case, FormCase | ScriptedCase):
        return comm
    local = comm.Split_type(MPI.COMM_TYPE_SHARED)
    fits = local.size * estimate(case).bytes <= available_bytes()
    local.Free()
    return MPI.COMM_SELF if comm.allreduce(fits, op=MPI.LAND) else comm


def with_places(subject: Subject, sensors: Sensors | None) -> Subject:
    """The same with parameters for effects at a place, if the case asks for them. Collective.

    Args:
        subject: The nominal model.
        sensors: Of the test.
    """
    full, asked = subject.full, needed(subject.case)
    if not isinstance(full, Structure) or not asked:
        return subject
    sites, changes, values = sites_of(subject.case, full, subject.dimensions, sensors, asked)
    if not changes:
        return subject
    more = [Parameter(name, value, log=False) for name, value in values.items()]
    full = full.with_changes(changes, more)
    return replace(
        subject, full=full, baseline=subject.baseline | values, cells=MeshCells(full), sites=sites
    )


def subject_of(case: Case, comm: MPI.Intracomm, progress: Progress) -> Subject:
    """The nominal model of a case: solid bodies with their layers or their contact in zones, or
    beams with laps in zones. Collective.

    By default the beams of a lap are bonded; with ``[diagnose] joints = "given"`` it has the case's
    k1 and k2.

    Raises:
        InputError: If the case has joints of a law that a diagnosis cannot soften, a value is out
            of range, or a bolt is beside its joint.
    """
    if isinstance(case, FormCase):
        progress.step("building the model")
        return Subject(
            case, case.model, Zones(case), case.model.values(), FormCells(case.model), None
        )
    more = {"attached": True, "width": True, "elastic_supports": True}
    if case.mesh.origin == "matrices":
        progress.step("reading the matrices")
        return _of_matrices(case, comm, more)
    if case.mesh.origin == "beams":
        progress.step("building the model")
        zones = lap_zones(case)
        full = build_beams(zones.case, laps=zones.laps or None, **more)
    else:
        zones = _solid_zones(case, comm, progress)
        full = build_structure(zones.case, comm, law="uncoupled", tagged=zones.tagged, **more)
        zones = zones.with_thickness(layer_thickness(full))
    case, bonded = zones.case, bonded_values(zones.case)
    baseline = {name: bonded.get(name, p.value) for name, p in full.parameters.items()}
    if isinstance(full, Structure):
        dimensions = Dimensions(case, full, {zone.name: zone.joint for zone in zones.all})
        return Subject(case, full, zones, baseline, MeshCells(full), dimensions)
    if zones.laps and case.diagnose.joints == "bonded":
        baseline |= lap_as_one(case, zones, baseline)
    owners = {cell: name for name, part in case.parts.items() for cell in part.cells}
    parts = [owners[f"beam_{i + 1}"] for i in range(len(full.beams))]
    cells = BeamElements(full, comm, parts, [lap.zones for lap in zones.laps], zones.bolts)
    return Subject(case, full, zones, baseline, cells, None)


def _of_matrices(case: Case, comm: MPI.Intracomm, more: Mapping[str, bool]) -> Subject:
    """Parts by matrices, with their interfaces in zones. Collective."""
    zones, mesh = interface_zones(case, read_matrices(case, comm))
    full = build_matrices(zones.case, comm, mesh, **more)
    zones = zones.with_thickness(layer_thickness_of_matrices(zones.case))
    bonded = bonded_values(zones.case)
    baseline = {name: bonded.get(name, p.value) for name, p in full.parameters.items()}
    return Subject(zones.case, full, zones, baseline, MatrixCells(full), AsGiven(case))


def _solid_zones(case: Case, comm: MPI.Intracomm, progress: Progress) -> Zones:
    """Layers or the contact of solid bodies in zones. Collective."""
    for name, section in case.joints.items():
        if section.law == "transition":
            raise InputError(
                f"{case.path}: joints.{name}.law = 'transition': expected a layer with E and G in "
                "a diagnosis, such as law = 'isotropic'"
            )
    zones = Zones(case)
    if case.contacts:
        progress.step("contact under preload")
        zones = contact_zones(case, comm, case.diagnose.zones)
    progress.step("building the model")
    if not len(zones) and case.joints:
        zones = joint_zones(case, build_mesh(case, comm))
    return zones
