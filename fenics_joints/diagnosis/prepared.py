"""What a diagnosis works on: the model of a case, its effects, its test and a reduced model."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.stats import qmc

from fenics_joints import __version__
from fenics_joints.build import build_mesh, build_structure
from fenics_joints.case import Case
from fenics_joints.case_mesh import OffsetBeamsMesh
from fenics_joints.diagnosis.contact_zones import ContactZones, contact_zones
from fenics_joints.diagnosis.effects import Effect
from fenics_joints.diagnosis.evidence import Evidence, evidence_of
from fenics_joints.diagnosis.hypothesis import Hypothesis
from fenics_joints.diagnosis.joint_zones import JointZones, joint_zones
from fenics_joints.diagnosis.library import (
    bonded_values,
    by_preload,
    case_effects,
    case_nuisances,
    layer_thickness,
    sample_ranges,
    sample_values,
)
from fenics_joints.diagnosis.result import Silent
from fenics_joints.diagnosis.user_effects import for_zones
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.progress import Progress
from fenics_joints.structure import Structure
from fenics_joints.surrogate import Forward, Surrogate

__all__ = ["Prepared", "prepare"]


@dataclass
class Prepared:
    """A case ready to be diagnosed.

    Attributes:
        case: The case, its joints or its contact in zones.
        comm: Communicator.
        data: The test.
        zones: The zones; None without joints.
        full: The full model, with all that effects need as parameters.
        baseline: Its parameter values as the nominal model.
        thickness: Layer thickness of each zone, m.
        effects: The effects that the case can hold.
        silent: Those that its test cannot speak of.
        nuisances: What is uncertain in any case.
        scatter: Standard deviation of ln(preload / torque).
        evidence: The test as the inference sees it.
        surrogate: The reduced model; None until `reduce`.
        n_samples: Number of samples it was made from.
    """

    case: Case
    comm: MPI.Intracomm
    data: TestData
    zones: ContactZones | JointZones | None
    full: Structure
    baseline: dict[str, float]
    thickness: dict[str, float]
    effects: tuple[Effect, ...]
    silent: tuple[Silent, ...]
    nuisances: tuple[Effect, ...]
    scatter: float
    evidence: Evidence
    surrogate: Surrogate | None = None
    n_samples: int = 0

    @property
    def forward(self) -> Forward:
        """Frequencies and shapes from the reduced model."""
        return self.surrogate.forward

    @property
    def condition(self) -> tuple[str, str]:
        """Name and unit of the conditions."""
        return self.data.condition_name, self.data.condition_unit

    def hypothesis(self, effects: Sequence[Effect], **kwargs) -> Hypothesis:
        """These effects, with what is uncertain in any case."""
        return Hypothesis(
            tuple(effects), self.nuisances, scatter=self.scatter,
            conditions=tuple(float(c) for c in self.evidence.conditions),
            modes=tuple(self.data.mode_names), damped=self.evidence.log_damping is not None,
            **kwargs,
        )  # fmt: skip

    def region_names(self) -> dict[str, str]:
        """What each zone of a joint or contact is called where zones are shown as one."""
        if isinstance(self.zones, ContactZones):
            return dict.fromkeys(self.zones.names, self.zones.contact)
        if isinstance(self.zones, JointZones):
            return dict(zip(self.zones.names, self.zones.joint, strict=True))
        return {}

    def reduce(self, progress: Progress, keep: Path | None = None) -> None:
        """Make the reduced model, or read it from a folder if it is kept there. Collective.

        Args:
            progress: Told after each sample.
            keep: Folder of the reduced models, named by a hash of all that makes them.
        """
        samples = self._samples(self.case.diagnose.samples)
        self.n_samples = len(samples)
        file = None if keep is None else Path(keep) / f"model-{self._fingerprint(samples)}.h5"
        progress.step("reduced model: sampling the parameters", len(samples))
        self.surrogate = Surrogate(
            self.full, samples, self.baseline, sensors=self.data.sensors,
            n_test=len(self.data.mode_names), n_modes=self.case.diagnose.n_modes,
            shapes=self.data.shapes, travel=self._travel(), keep=file, progress=progress,
        )  # fmt: skip

    def _fingerprint(self, samples: Sequence[dict[str, float]]) -> str:
        """Names a reduced model by everything that it depends on."""
        tables = ("mesh", "parts", "joints", "contacts", "bolts", "masses", "springs", "supports")
        said = self.case.model_dump(mode="json", include={*tables, "attached"}, warnings=False)
        sensors = self.data.sensors
        seen = [] if sensors is None else [sensors.points.tolist(), sensors.directions.tolist()]
        cells = self.full.mesh.topology.index_map(self.full.mesh.topology.dim).size_global
        sizes = [f"{volume:.6e}" for volume in self.full.volumes()]
        content = [
            __version__, said, samples, seen, len(self.data.mode_names),
            self.case.diagnose.n_modes, cells, self.full.n_dofs, sizes,
        ]  # fmt: skip
        text = json.dumps(content, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _travel(self) -> dict:
        pointed = {**self.case.masses, **self.case.attached}
        moving = {
            name: section.shift()
            for name, section in pointed.items()
            if getattr(section, "travel", None) is not None
        }
        return {
            mass.name: moving[owner]
            for mass in self.full.masses
            if (owner := str(mass.travel).removesuffix(".travel")) in moving
        }

    def _samples(self, count: int) -> list[dict[str, float]]:
        """The baseline, some parameters at the ends of their ranges, a Sobol sequence of those that
        are no joint's, and every effect at places of its prior."""
        ranges = sample_ranges(self.case, {})
        samples = [self.baseline]
        for name in ranges:
            if name.endswith(".thickness"):
                # A section turns by its thickness times the slope of the plate: modes of one
                # thickness cannot bend another without shear, and it would seem far too stiff.
                samples += [{**self.baseline, name: end} for end in ranges[name][:2]]
            if name.endswith(".travel"):
                # A mass at an edge bends it locally: a basis from inner places would miss that.
                mass = name.replace(".travel", ".mass")
                for end in (0.0, 1.0):
                    samples.append(self._sample(ranges, {name: end, mass: 1.0}))
        unit = qmc.Sobol(len(ranges), seed=1).random_base2(int(np.ceil(np.log2(count))))[:count]
        places = [dict(zip(ranges, row, strict=True)) for row in unit]
        samples += [self._sample(ranges, place) for place in places]
        conditions = self.evidence.conditions
        samples += sample_values(self.effects, self.baseline, conditions, count, 2, ranges)
        return samples if not isinstance(self.zones, ContactZones) else self._cutoffs(samples)

    def _cutoffs(self, samples: list[dict[str, float]]) -> list[dict[str, float]]:
        """The same and the cut-off between every two zones of a contact once."""
        lost = next((e for e in self.effects if [p.name for p in e.priors] == ["cutoff"]), None)
        found = list(samples)
        for level in self.zones.low[1:] if lost is not None else ():
            values = dict(self.baseline)
            lost.apply(values, {"cutoff": float(level)}, self.data.conditions[0])
            found.append(values)
        return found

    def _sample(self, ranges: dict, place: dict[str, float]) -> dict[str, float]:
        """Values at a place in the unit cube of the ranges; in their middle where not given."""
        values = dict(self.baseline)
        for name, (low, high, log) in ranges.items():
            u = place.get(name, 0.5)
            values[name] = float(low ** (1 - u) * high**u if log else low + u * (high - low))
        return values


def prepare(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    extra: Sequence[Effect] = (),
    data: TestData | None = None,
) -> Prepared:
    """The full model of a case in zones, with effects and evidence; `Prepared.reduce` comes next.

    Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        extra: Effects of the user's own, beside the library's.
        data: The test, if not the case's.

    Raises:
        InputError: If the case has no test, or names effects that do not exist.
    """
    case = case.diagnosed()
    if isinstance(case.mesh, OffsetBeamsMesh):
        raise InputError(
            f"{case.path}: mesh.builder = 'offset_beams': a diagnosis needs a mesh of cells, whose "
            "zones it can search; modes and update work on beams"
        )
    for name, section in case.joints.items():
        if section.law == "transition":
            raise InputError(
                f"{case.path}: joints.{name}.law = 'transition': expected a layer with E and G in "
                "a diagnosis, such as law = 'isotropic'"
            )
    data = case.measurements() if data is None else data
    zones = None
    if case.contacts:
        progress.step("contact under preload")
        zones = contact_zones(case, comm, case.diagnose.zones)
    progress.step("building the model")
    if zones is None and case.joints:
        zones = joint_zones(case, build_mesh(case, comm))
    case = case if zones is None else zones.case
    full = build_structure(
        case, comm, law="uncoupled", attached=True, width=True, elastic_supports=True,
        tagged=None if zones is None else zones.tagged,
    )  # fmt: skip
    thickness, bonded = layer_thickness(full), bonded_values(case)
    baseline = {name: bonded.get(name, p.value) for name, p in full.parameters.items()}
    effects, silent = case_effects(case, data, thickness, zones)
    extra = [for_zones(effect, _zones_of_joints(zones)) for effect in extra]
    return Prepared(
        case, comm, data, zones, full, baseline, thickness, (*effects, *extra), silent,
        case_nuisances(case), case.diagnose.preload_scatter if by_preload(data) else 0.0,
        evidence_of(data, case.diagnose.discrepancy, case.diagnose.shape_discrepancy),
    )  # fmt: skip


def _zones_of_joints(zones: ContactZones | JointZones | None) -> dict[str, tuple[str, ...]]:
    """Names of the zones that each joint or contact of the case is in."""
    if isinstance(zones, ContactZones):
        return {zones.contact: zones.names}
    found: dict[str, tuple[str, ...]] = {}
    for joint, name in zip(zones.joint, zones.names, strict=True) if zones is not None else ():
        found[joint] = (*found.get(joint, ()), name)
    return found
