"""Where the gap lies: tests of regions, zones and patches, before any cause is looked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from fenics_joints.diagnosis.effects.effect import by_preload
from fenics_joints.diagnosis.effects.joint import interfaces
from fenics_joints.diagnosis.effects.sited import CABLE_MASS
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.evidence.signatures import LENGTHS
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.where.patches import PATCHES, Patches, PatchMap, patches
from fenics_joints.diagnosis.where.score_tests import (
    LEVEL,
    Attribution,
    Place,
    ScoreTest,
    ZoneShare,
    attribution,
    score_tests,
    shares,
)
from fenics_joints.diagnosis.where.zone_sensitivity import zone_sensitivities
from fenics_joints.diagnosis.zones.sites import HUNG, ON

#: Lengths over which a change about a patch falls, over the structure's size: those of an unknown
#: cause but for the largest, which is a whole region. [decision: those of an unknown cause]
_LENGTHS = LENGTHS[:-1]
#: Axes along which the misfit is attributed; by condition only where there are several.
AXES = ("mode", "band", "condition", "kind")
#: Nats by which mirror images of a place may differ. [numerical: reduced models on one and on two
#: ranks differ by 0.02]
_SAME = 0.1


@dataclass(frozen=True, repr=False)
class Location:
    """Where the nominal model fails, tested against noise and tolerances.

    All regions, zones and patches are one family of score tests. Before the test all regions are
    equally probable, and each is as probable as all its zones, or all its patches, together.

    Attributes:
        regions: A test for each part, mass, spring, support and whole joint.
        zones: A test for each zone of joints that have several.
        patches: The map: tests of changes about patches of the cells, each over the length that is
            most probable, and the cells; None if not asked for.
        shares: Share of the misfit by region, see `shares`.
        attribution: What each mode, band, condition and kind of data adds to the misfit.
        misfit: Squared whitened residual of the nominal model.
        n_data: Number of fitted data: its expected value.
    """

    regions: tuple[ScoreTest, ...]
    zones: tuple[ScoreTest, ...]
    patches: PatchMap | None
    shares: tuple[ZoneShare, ...]
    attribution: tuple[Attribution, ...]
    misfit: float
    n_data: int

    def __repr__(self) -> str:
        return f"Location({len(self.regions)} regions, misfit {self.misfit:.1f} of {self.n_data})"

    @property
    def ranked(self) -> tuple[ScoreTest, ...]:
        """Places that explain more than chance, the most probable first.

        Those that differ by round-off only, as mirror images do, stand in the order of the model.
        """
        patches = () if self.patches is None else self.patches.tests
        places = (*self.regions, *self.zones, *patches)
        telling = [(i, t) for i, t in enumerate(places) if t.significant and t.log_odds > 0]
        telling.sort(key=lambda it: -it[1].log_odds)
        first, groups = np.inf, []
        for i, test in telling:
            first = test.log_odds if first - test.log_odds > _SAME else first
            groups.append((-first, i, test))
        return tuple(test for _, _, test in sorted(groups, key=lambda g: g[:2]))

    def middle(self, test: ScoreTest) -> tuple[float, ...] | None:
        """Centre of a patch, m; None of a place that is none."""
        if self.patches is None or test not in self.patches.tests:
            return None
        return tuple(self.patches.middle[self.patches.tests.index(test)].tolist())

    def to_json(self) -> dict:
        """Plain numbers, texts and lists."""
        first = self.ranked[0] if self.ranked else None
        return {
            "misfit": self.misfit,
            "n_data": self.n_data,
            "level": LEVEL,
            "most_probable": None if first is None else first.zone,
            "regions": [asdict(test) for test in self.regions],
            "zones": [asdict(test) for test in self.zones],
            "attribution": [asdict(part) for part in self.attribution],
            "patches": None if self.patches is None else self.patches.to_json(),
        }


def locate_gap(model: Prepared, *, n_patches: int = PATCHES) -> Location:
    """Test where the nominal model of a case fails. Collective; after `Prepared.reduce`.

    Args:
        model: The case with its reduced model.
        n_patches: Patches of each region of the mesh; 0 for no map.
    """
    evidence, baseline, forward = model.evidence, model.baseline, model.forward
    none = model.hypothesis(())
    predicted, nuisance = ManyPredictions(none, forward, evidence, baseline).at(none.at(0.0))
    residual = evidence.data - predicted
    whole, zones = _regions(model)
    regions, finer = list(_places(model, whole)), list(_places(model, zones))
    split, found = None, []
    if n_patches:
        split = patches(model.cells, n_patches, model.zones.shown)
        found = list(_patches(model, split))
    places = [*regions, *finer, *found]
    tests = score_tests(residual, places, nuisance, evidence)
    ends = len(regions), len(regions) + len(finer)
    names, several = list(model.data.mode_names), len(evidence.conditions) > 1
    parts = [
        part
        for by in AXES
        if by != "condition" or several
        for part in attribution(residual, evidence, by, nuisance=nuisance, names=names)
    ]
    by_mode = [part for part in parts if part.by == "mode"]
    return Location(
        tuple(tests[: ends[0]]),
        tuple(tests[ends[0] : ends[1]]),
        None if split is None else _map(model, split, tests[ends[1] :]),
        tuple(shares(residual, places, nuisance, evidence)),
        tuple(parts),
        sum(part.chi2 for part in by_mode),
        sum(part.expected for part in by_mode),
    )


def _regions(model: Prepared) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Components of the model by region, with whole joints, without those that the test itself
    changed or that only rare effects use; and the zones of joints that have several."""
    shown = model.zones.shown
    changed = () if model.case.test is None else model.case.test.changed
    aside = {*changed, ON, HUNG}
    whole: dict[str, list[str]] = {}
    for name in dict.fromkeys(name.rpartition(".")[0] for name in model.baseline):
        if name not in aside:
            whole.setdefault(shown.get(name, name), []).append(name)
    several = [names for names in whole.values() if len(names) > 1]
    return whole, {name: [name] for names in several for name in names}


def _places(model: Prepared, groups: Mapping[str, list[str]]) -> Iterator[Place]:
    """Regions or zones, with the changes of all data that the reduced model predicts for them."""
    soft, shown = interfaces(model.zones, model.baseline), model.zones.shown
    expected = CABLE_MASS[0] * model.full.total_mass(model.baseline)
    without = [name for name in model.case.attached if model.baseline.get(f"{name}.mass") == 0.0]
    added = dict.fromkeys(without, expected)
    columns = zone_sensitivities(
        model.forward,
        model.evidence,
        model.baseline,
        groups,
        interfaces=soft,
        by_torque=by_preload(model.data),
        added=added,
        own={
            name: [f"{name}.{key}" for key in section.nominal()]
            for name, section in model.case.joints.items()
            if section.own_law is not None
        },
    )
    regions = [shown.get(zone, zone) for zone in columns]
    for region, (zone, by_parameter) in zip(regions, columns.items(), strict=True):
        first = groups[zone][0]
        kind = "joint" if first in soft or first in model.case.joints else ""
        if not kind and {f"{first}.E", f"{first}.rho"} <= model.baseline.keys():
            kind = "part"
        yield Place(zone, region, kind, by_parameter, 1 / regions.count(region))


def _patches(model: Prepared, split: Patches) -> Iterator[Place]:
    """Patches of cells, with changes that decrease with the distance from them, one length after
    the other; by the signatures of an unknown cause."""
    evidence, there = model.evidence, model.evidence.signatures
    if there is None or there.names != split.names:
        evidence = model.with_signatures(split)
    signs, columns = evidence.signatures, evidence.patch_columns()
    regions = [model.zones.shown.get(region, region) for region in split.region]
    for length in _LENGTHS:
        alike = signs.alike(length)
        about = np.stack([column @ alike for column in columns], axis=-1)
        for p, (name, region) in enumerate(zip(split.names, regions, strict=True)):
            of_joint, own = signs.of_joint[p], about[:, p]
            own = own[:, np.any(own != 0, axis=0)] if of_joint else own[:, :2]
            odds = 1 / (len(_LENGTHS) * regions.count(region))
            yield Place(name, region, "joint" if of_joint else "part", own, odds)


def _map(model: Prepared, split: Patches, tests: Sequence[ScoreTest]) -> PatchMap:
    """The test of each patch over its most probable length, with the cells to draw them on.
    Collective."""
    cells, n = model.cells, len(split)
    best = [max(tests[p::n], key=lambda test: test.log_evidence) for p in range(n)]
    drawn = cells.gather(cells.corners, split.number) or (None, None)
    return PatchMap(
        tuple(best),
        split.middle,
        split.volume,
        cells.bolts,
        LEVEL,
        *drawn,
        side_view=cells.side_view,
    )
