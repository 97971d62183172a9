"""Lapped beams as a diagnosis asks of them; see `fenics_joints.diagnosis.model.subject.Subject`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI

from fenics_joints.beams import BeamStructure
from fenics_joints.beams.boxes import BeamCells
from fenics_joints.beams.cells import JOINT_KEYS, log_slopes
from fenics_joints.case import Case
from fenics_joints.case.build_beams import build_beams
from fenics_joints.diagnosis.where.beam_constitutive import beam_constitutive_error
from fenics_joints.diagnosis.where.constitutive import ConstitutiveError
from fenics_joints.diagnosis.where.localise import CellMap, mean_residual
from fenics_joints.diagnosis.where.patches import Patches, PatchMap, split_tests
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.diagnosis.zones.laps import lap_as_one, lap_zones
from fenics_joints.diagnosis.zones.nominal import bonded_values
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.diagnosis.zones.zone import Zones
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes

__all__ = ["BeamSubject", "beam_subject"]

_JOINT = ("k1", "k2")


@dataclass
class BeamSubject:
    """Beams, which are small, exact and the same on every rank; see `Subject`."""

    case: Case
    comm: MPI.Intracomm
    full: BeamStructure
    zones: Zones
    baseline: dict[str, float]

    @cached_property
    def cells(self) -> BeamCells:
        """Elements as boxes."""
        return self.full.cells

    @cached_property
    def labels(self) -> list[str]:
        """Part, or zone of a lap, of each cell."""
        owners = {cell: name for name, part in self.case.parts.items() for cell in part.cells}
        firsts = {s.joint: s.first for s in self.full.layout.stretches if s.joint is not None}
        return [
            owners[f"beam_{beam + 1}"] if beam >= 0
            else self.zones.laps[lap].zones[element - firsts[lap]]
            for beam, lap, element in zip(
                self.cells.beam, self.cells.lap, self.cells.element, strict=True
            )
        ]  # fmt: skip

    def cell_map(
        self, modes: Modes, pairing: Pairing, evidence, nuisance: np.ndarray
    ) -> CellMap | None:
        """Where stiffness would have to change, from the sensitivities of the baseline."""
        residual = mean_residual(modes, pairing, evidence, nuisance)
        slopes = log_slopes(self.full, self.cells, modes, pairing.index)
        total = -sum(slopes[key] @ residual for key in ("E", *JOINT_KEYS)) / self.cells.volume
        if self.comm.rank != 0:
            return None
        shown = [self.zones.shown.get(label, label) for label in self.labels]
        names = tuple(dict.fromkeys(shown))
        region = np.array([names.index(label) for label in shown])
        largest = float(np.max(np.abs(total)))
        density = total / largest if largest > 0 else total
        return CellMap(self.cells.vertices, region, names, density, side_view=True)

    def split(self, n: int) -> Patches:
        """Stretches of elements: of each beam by itself, and zones of each lap."""
        labels = self.labels
        pairs = list(zip(labels, self.cells.beam.tolist(), strict=True))
        groups = list(dict.fromkeys(pairs))
        group = np.array([groups.index(pair) for pair in pairs])
        names = [label for label, _ in groups]
        shown = [self.zones.shown.get(name, name) for name in names]
        middles = self.cells.vertices.mean(axis=1)
        return Patches(*partition(middles, self.cells.volume, group, names, shown, n))

    def patches(
        self, modes, pairing, evidence, residual, nuisance, n, *, soft, by_torque
    ) -> PatchMap:
        """Tests of stretches of the beams, by E and density, and of zones, by k1 and k2."""
        split = self.split(n)
        sums = self._sums(split, modes, pairing)
        yielding = sums if soft is None else self._sums(split, *soft)
        joints = set(self.zones.names)
        of_parts = np.stack([EXPECTED[key] * sums[key] for key in ("E", "rho")], axis=-1)
        of_joints = np.stack([-yielding[key] for key in _JOINT], axis=-1)
        columns = {name: of_joints if name in joints else of_parts for name in split.region}
        tests = split_tests(split, columns, joints, evidence, residual, nuisance, by_torque)
        there = self.comm.rank == 0
        return PatchMap(
            tuple(tests), split.region, split.middle, split.volume, self.zones.bolts,
            vertices=self.cells.vertices if there else None,
            patch=split.number if there else None, side_view=True,
        )  # fmt: skip

    def _sums(self, split: Patches, modes: Modes, pairing: Pairing) -> dict[str, np.ndarray]:
        """Derivatives of ln f by ln of each property of each patch, (P, m)."""
        slopes = log_slopes(self.full, self.cells, modes, pairing.index)
        found = {}
        for key, by_cell in slopes.items():
            found[key] = np.zeros((len(split), by_cell.shape[1]))
            np.add.at(found[key], split.number, by_cell)
        return found

    def constitutive(self, data: TestData, row: int, n: int) -> ConstitutiveError:
        """The error by parts and zones, and by the patches that are tested."""
        there = np.isfinite(data.frequencies_hz[row])
        return beam_constitutive_error(
            self.full, self.cells, self.labels, self.baseline, data.shapes[:, there],
            data.frequencies_hz[row][there], data.sensors, self.split(n), noise=data.shape_noise,
        )  # fmt: skip


def beam_subject(case: Case, comm: MPI.Intracomm) -> BeamSubject:
    """The nominal beams of a case, laps in zones.

    By default each lap is as one piece; with ``[diagnose] joints = "given"`` it has the k1 and k2
    of the case.

    Raises:
        InputError: For a value that is out of range, or a bolt beside its lap.
    """
    zones = lap_zones(case)
    full = build_beams(
        zones.case, attached=True, width=True, elastic_supports=True, laps=zones.laps or None,
    )
    known = bonded_values(zones.case)
    baseline = {name: known.get(name, p.value) for name, p in full.parameters.items()}
    if zones.laps and case.diagnose.joints == "bonded":
        baseline |= lap_as_one(zones.case, zones, baseline)
    return BeamSubject(zones.case, comm, full, zones, baseline)
