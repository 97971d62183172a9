"""Everything that a diagnosis says of where the gap lies, before it asks for the cause."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from fenics_joints.diagnosis.effects.joint import interfaces
from fenics_joints.diagnosis.effects.library import by_preload
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.where.constitutive import ConstitutiveError, constitutive_error
from fenics_joints.diagnosis.where.patches import PatchMap, patch_tests, patches
from fenics_joints.diagnosis.where.zone_sensitivity import zone_sensitivities
from fenics_joints.diagnosis.where.zone_tests import Attribution, ZoneTest, attribution, zone_tests

__all__ = ["AXES", "Location", "locate_gap"]

#: Axes along which the misfit is attributed; by condition only where there are several.
AXES = ("mode", "band", "condition", "kind")


@dataclass(frozen=True, repr=False)
class Location:
    """Where the nominal model fails, tested against noise and tolerances.

    Attributes:
        regions: A test for each part, mass, spring, support and whole joint.
        zones: A test for each zone of the joints beside the same parts; empty where no joint has
            several zones.
        attribution: What each mode, band, condition and kind of data adds to the misfit.
        patches: Tests of patches of the mesh and the cells to draw them on; None if not asked for.
        constitutive: Error in the constitutive relation; None without measured shapes.
        misfit: Squared whitened residual of the nominal model.
        n_data: Number of fitted data: its expected value.
    """

    regions: tuple[ZoneTest, ...]
    zones: tuple[ZoneTest, ...]
    attribution: tuple[Attribution, ...]
    patches: PatchMap | None
    constitutive: ConstitutiveError | None
    misfit: float
    n_data: int

    def __repr__(self) -> str:
        return f"Location({len(self.regions)} regions, misfit {self.misfit:.1f} of {self.n_data})"

    def to_json(self) -> dict:
        """Plain numbers, texts and lists."""
        return {
            "misfit": self.misfit,
            "n_data": self.n_data,
            "regions": [asdict(test) for test in self.regions],
            "zones": [asdict(test) for test in self.zones],
            "attribution": [asdict(part) for part in self.attribution],
            "patches": None if self.patches is None else self.patches.to_json(),
            "constitutive": None if self.constitutive is None else self.constitutive.to_json(),
        }


def locate_gap(model: Prepared, *, n_patches: int = 12) -> Location:
    """Test where the nominal model of a case fails. Collective; after `Prepared.reduce`.

    Args:
        model: The case with its reduced model.
        n_patches: Patches of each region of the mesh; 0 for none of them, and no error in the
            constitutive relation.
    """
    evidence, baseline, forward = model.evidence, model.baseline, model.forward
    none = model.hypothesis(())
    predicted, nuisance = ManyPredictions(none, forward, evidence, baseline).at(none.at(0.0))
    residual = evidence.data - predicted
    torque = by_preload(model.data)

    def tests(groups: dict[str, list[str]]) -> tuple[ZoneTest, ...]:
        sensitivities = zone_sensitivities(
            forward, evidence, baseline, groups, interfaces=interfaces(model.zones, model.baseline),
            by_torque=torque,
        )  # fmt: skip
        return tuple(zone_tests(residual, sensitivities, nuisance, evidence))

    whole, split = _groups(model)
    names = list(model.data.mode_names)
    several = len(evidence.conditions) > 1
    parts = [
        part for by in AXES if by != "condition" or several
        for part in attribution(residual, evidence, by, nuisance=nuisance, names=names)
    ]  # fmt: skip
    by_mode = [part for part in parts if part.by == "mode"]
    nominal, pairing = model.surrogate.nominal, model.surrogate.pairing
    mapped = patch_tests(
        model.cells, nominal, pairing, evidence, residual, nuisance, n_patches,
        soft=model.yielding(), by_torque=torque, merged=model.zones.shown,
    ) if n_patches else None  # fmt: skip
    return Location(
        tests(whole), tests(split) if len(split) > len(whole) else (), tuple(parts), mapped,
        _constitutive(model, n_patches), sum(part.chi2 for part in by_mode),
        sum(part.expected for part in by_mode),
    )  # fmt: skip


def _groups(model: Prepared) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """The model's components by name, joints whole; and the same by zones."""
    shown = model.zones.shown
    components = dict.fromkeys(name.rpartition(".")[0] for name in model.baseline)
    whole: dict[str, list[str]] = {}
    for name in components:
        whole.setdefault(shown.get(name, name), []).append(name)
    return whole, {name: [name] for name in components}


def _constitutive(model: Prepared, n_patches: int) -> ConstitutiveError | None:
    data, row, shapes = model.data, model.evidence.shape_row, model.evidence.shapes
    if shapes is None or data.sensors is None or not n_patches:
        return None
    there = np.isfinite(data.frequencies_hz[row])
    if not there.any():
        return None
    hz = np.exp(model.evidence.log_f[row][there])
    return constitutive_error(
        model.cells, model.baseline, shapes[:, there], hz, data.sensors,
        split=patches(model.cells, n_patches, model.zones.shown),
        noise=data.shape_noise,
    )  # fmt: skip
