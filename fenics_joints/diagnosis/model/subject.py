"""What a diagnosis asks of the structure that it looks at, and how solid bodies answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_mesh, build_structure
from fenics_joints.case.mesh import OffsetBeamsMesh
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.where.constitutive import ConstitutiveError, constitutive_error
from fenics_joints.diagnosis.where.localise import CellMap, cell_map, merge_regions
from fenics_joints.diagnosis.where.patches import PatchMap, patch_tests, patches
from fenics_joints.diagnosis.zones.contacts import contact_zones
from fenics_joints.diagnosis.zones.joints import joint_zones
from fenics_joints.diagnosis.zones.nominal import bonded_values, layer_thickness
from fenics_joints.diagnosis.zones.zone import Zones
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.progress import Progress
from fenics_joints.structure.structure import Structure

__all__ = ["SolidSubject", "Subject", "subject_of"]


class Subject(Protocol):
    """The nominal model of a case, its joints in zones, and what can be said of places in it.

    Attributes:
        case: The case, with a joint section for each zone.
        full: The model, with all that effects need as parameters.
        zones: Its joints in zones.
        baseline: Parameter values of the nominal model.
    """

    case: Case
    full: object
    zones: Zones
    baseline: dict[str, float]

    def cell_map(
        self, modes: Modes, pairing: Pairing, evidence: Evidence, nuisance: np.ndarray
    ) -> CellMap | None:
        """See `localise.cell_map`; None but on rank 0. Collective."""

    def patches(
        self, modes: Modes, pairing: Pairing, evidence: Evidence, residual: np.ndarray,
        nuisance: np.ndarray | None, n: int, *, soft: tuple[Modes, Pairing] | None,
        by_torque: bool,
    ) -> PatchMap:  # fmt: skip
        """See `patches.patch_tests`. Collective."""

    def constitutive(self, data: TestData, row: int, n: int) -> ConstitutiveError | None:
        """See `constitutive.constitutive_error`; None where it cannot be had. Collective."""


@dataclass
class SolidSubject:
    """Solid bodies on a mesh of cells; see `Subject`."""

    case: Case
    full: Structure
    zones: Zones
    baseline: dict[str, float]

    def cell_map(self, modes, pairing, evidence, nuisance) -> CellMap | None:
        found = cell_map(self.full, modes, pairing, evidence, nuisance)
        return None if found is None else merge_regions(found, self.zones.shown)

    def patches(
        self, modes, pairing, evidence, residual, nuisance, n, *, soft, by_torque
    ) -> PatchMap:
        return patch_tests(
            self.full, modes, pairing, evidence, residual, nuisance, n,
            soft=soft, by_torque=by_torque, merged=self.zones.shown,
        )  # fmt: skip

    def constitutive(self, data: TestData, row: int, n: int) -> ConstitutiveError | None:
        there = np.isfinite(data.frequencies_hz[row])
        return constitutive_error(
            self.full, self.baseline, data.shapes[:, there], data.frequencies_hz[row][there],
            data.sensors, split=patches(self.full, n, self.zones.shown), noise=data.shape_noise,
        )  # fmt: skip


def subject_of(case: Case, comm: MPI.Intracomm, progress: Progress) -> Subject:
    """The nominal model of a case in zones. Collective.

    Raises:
        InputError: If the case has joints of a law that a diagnosis cannot soften.
    """
    if isinstance(case.mesh, OffsetBeamsMesh):
        from fenics_joints.diagnosis.model.beam_subject import beam_subject

        progress.step("building the model")
        return beam_subject(case, comm)
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
    full = build_structure(
        zones.case, comm, law="uncoupled", attached=True, width=True, elastic_supports=True,
        tagged=zones.tagged,
    )  # fmt: skip
    bonded = bonded_values(zones.case)
    baseline = {name: bonded.get(name, p.value) for name, p in full.parameters.items()}
    return SolidSubject(
        zones.case, full, zones.with_thickness(layer_thickness(full)), baseline
    )
