"""Where the gap lies, finer than the model's regions: compact patches of its cells, each tested."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.diagnosis.effects.joint import interfaces
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED, EXPONENT, trend
from fenics_joints.diagnosis.where.zone_tests import ZoneTest, zone_tests
from fenics_joints.diagnosis.zones.nominal import layer_thickness
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.structure import Structure

__all__ = [
    "PatchMap", "Patches", "patch_tests", "patches", "per_property", "split_tests",
]  # fmt: skip

#: Points of a mesh that are axes of bolts.
_BOLTS = ("bolts", "bolt")


@dataclass(frozen=True)
class Patches:
    """A partition of a structure's cells; the same on any number of ranks but for ``number``.

    Attributes:
        number: Patch of every cell that this rank owns, (n_owned,).
        names: Name of each patch, ``REGION 1`` and so on, (P,).
        region: Name of the region of each patch, (P,).
        middle: Centre of volume of each patch, m, (P, 3).
        volume: Volume as meshed of each patch, m3, (P,).
    """

    number: np.ndarray
    names: tuple[str, ...]
    region: tuple[str, ...]
    middle: np.ndarray
    volume: np.ndarray

    def __len__(self) -> int:
        return len(self.names)

    def sums(self, structure: Structure, by_cell: np.ndarray) -> np.ndarray:
        """Sum over each patch of values of this rank's cells, (n_owned,) to (P,). Collective."""
        local = np.bincount(self.number, by_cell, minlength=len(self))
        return structure.comm.allreduce(local)


@dataclass(frozen=True)
class PatchMap:
    """Patches with their tests, and the cells to draw them on.

    Attributes:
        tests: A test for each patch.
        region: Name of the region of each patch, (P,).
        middle: Centre of each patch, m, (P, 3).
        volume: Volume of each patch, m3, (P,).
        bolts: Positions of the bolts, m, (n_bolts, 3).
        level: Adjusted p below which a patch counts as significant.
        vertices: Corners of all cells, m, (n_cells, n_corners, 3); None but on rank 0.
        patch: Patch of all cells, (n_cells,); None but on rank 0.
        side_view: Whether they are elements of beams, to be seen from the side.
    """

    tests: tuple[ZoneTest, ...]
    region: tuple[str, ...]
    middle: np.ndarray
    volume: np.ndarray
    bolts: np.ndarray
    level: float = 0.05
    vertices: np.ndarray | None = None
    patch: np.ndarray | None = None
    side_view: bool = False

    @property
    def share(self) -> np.ndarray:
        """Share of the squared whitened misfit that a change of each patch alone explains, (P,)."""
        return np.array([test.share for test in self.tests])

    @property
    def significant(self) -> np.ndarray:
        """Which patches explain more than chance, all of them considered, (P,)."""
        return np.array([test.p_adjusted < self.level for test in self.tests], dtype=bool)

    @property
    def seen(self) -> np.ndarray:
        """Which patches the test sees at all, (P,)."""
        return np.array([test.dof > 0 for test in self.tests], dtype=bool)

    @property
    def sufficient(self) -> np.ndarray:
        """Which of them leave no more unexplained than chance would: each could be all, (P,)."""
        rest = np.array([test.rest_p for test in self.tests])
        return self.significant & (rest >= self.level)

    def to_json(self) -> dict:
        """The tests with places and volumes; not the cells."""
        rows = zip(self.tests, self.region, self.middle, self.volume, strict=True)
        return {
            "level": self.level,
            "bolts": self.bolts.tolist(),
            "patches": [
                test.to_json() | {"region": region, "middle": m.tolist(), "volume": float(v)}
                for test, region, m, v in rows
            ],
        }


# -- partition -------------------------------------------------------------------------------


def patches(
    structure: Structure, n: int = 12, merged: Mapping[str, str] | None = None
) -> Patches:
    """Split every region of a structure into ``n`` compact patches. Collective.

    Cell groups of a region (two plates of one material) are split each by itself, into numbers in
    proportion to their volumes; k-means from far-off starting cells does it, on one rank.

    Args:
        structure: The structure.
        n: Patches of each region; fewer where it has fewer cells.
        merged: Names of regions that share their ``n``, such as the zones of a joint.

    Raises:
        InputError: If ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"n = {n}: expected at least 1 patch of each region.")
    comm = structure.comm
    group, labels = _groups(structure)
    corners = structure.mesh.geometry.x[geometry_dofmap(structure.mesh)[: len(group)]]
    parts = comm.gather((corners.mean(axis=1), structure.cell_volumes(), group), root=0)
    made = None
    if comm.rank == 0:
        middles, volumes, groups = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        shown = [(merged or {}).get(name, name) for name in labels]
        found = partition(middles, volumes, groups, labels, shown, n)
        ends = np.cumsum([len(part[2]) for part in parts])[:-1]
        made = [(numbers, *found[1:]) for numbers in np.split(found[0], ends)]
    return Patches(*comm.scatter(made, root=0))


def _groups(structure: Structure) -> tuple[np.ndarray, list[str]]:
    """Cell group of each owned cell, and the region of each group."""
    owned = structure.mesh.topology.index_map(structure.mesh.topology.dim).size_local
    group, labels = np.zeros(owned, dtype=int), []
    for region in structure.regions:
        for name in region.cells:
            cells = structure.tagged.cell_tags.find(structure.tagged.cell_tag(name))
            group[cells[cells < owned]] = len(labels)
            labels.append(region.name)
    return group, labels


# -- tests -----------------------------------------------------------------------------------


def per_property(structure: Structure, gradient: np.ndarray, key: str) -> np.ndarray:
    """Derivative by the logarithm of a property of each owned cell, 0 where it has none.

    Args:
        structure: The structure, its property field as `Structure.cell_gradient` left it.
        gradient: From `Structure.cell_gradient`, (n_owned, n_slots).
        key: Name of the property, such as ``"E"``.

    Returns:
        Shape (n_owned,).
    """
    q = structure.field.by_cell(structure.field.q.x.array)
    out = np.zeros(len(gradient))
    for region, cells in structure.field.regions:
        if key in region.law.properties:
            slot = region.law.properties.index(key)
            cells = cells[cells < len(gradient)]
            out[cells] = gradient[cells, slot] * q[cells, slot]
    return out


def patch_tests(
    structure: Structure,
    modes: Modes,
    pairing: Pairing,
    evidence: Evidence,
    residual: np.ndarray,
    nuisance: np.ndarray | None,
    n: int = 12,
    *,
    soft: tuple[Modes, Pairing] | None = None,
    by_torque: bool = False,
    merged: Mapping[str, str] | None = None,
    level: float = 0.05,
) -> PatchMap:
    """Test every patch for a change of stiffness or mass by the frequencies. Collective.

    The sensitivities are adjoint, one assembly for each mode whatever the number of patches: of a
    part's patch by ln E and ln rho; of a joint's by its two compliances, and with ``by_torque`` by
    their slope in the torque's logarithm. A joint's are taken where all joints give way, if
    ``soft`` has the modes there (see `zone_sensitivities`); else at the baseline, scaled to an
    interface of the prior's median stiffness, which for a bonded one is far from what it will do.
    Shapes and damping are left out, whose derivatives by cells would cost a solution each.

    Args:
        structure: The full model.
        modes: Its modes at the baseline.
        pairing: Which of them the test saw.
        evidence: The test.
        residual: Data minus the baseline's prediction, (N,).
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p), or None.
        n: Patches of each region.
        soft: Modes with all joints giving way, at the values of `zone_sensitivity.interfaces`,
            and which of them the test saw.
        by_torque: Whether the conditions are torques.
        merged: Names of regions that share their ``n``, such as the zones of a joint.
        level: Adjusted p below which a patch counts as significant.

    Returns:
        The tests on every rank; the cells to draw on rank 0 only.
    """
    split = patches(structure, n, merged)
    columns = patch_columns(structure, modes, pairing, split, soft)
    joints = {region.name for region in structure.regions if region.is_joint}
    tests = split_tests(split, columns, joints, evidence, residual, nuisance, by_torque)
    vertices, patch = _gathered(structure, split)
    return PatchMap(
        tuple(tests), split.region, split.middle, split.volume, _bolts(structure), level,
        vertices, patch,
    )  # fmt: skip


def split_tests(
    split: Patches,
    columns: Mapping[str, np.ndarray],
    joints: Container[str],
    evidence: Evidence,
    residual: np.ndarray,
    nuisance: np.ndarray | None,
    by_torque: bool,
) -> list[ZoneTest]:
    """Tests of patches by the frequencies, from what an expected change in each does to them.

    Args:
        split: The patches.
        columns: Change of ln f, (P, m, k) by the name of the patches' region.
        joints: Names of the regions that are joints.
        evidence: The test.
        residual: Data minus the baseline's prediction, (N,).
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p), or None.
        by_torque: Whether the conditions are torques.
    """
    frequencies = replace(evidence, log_damping=None, shapes=None)
    count = frequencies.data.size
    mode, slope = frequencies.entries.mode, []
    if by_torque and len(evidence.conditions) > 1:
        slope = EXPONENT * trend(frequencies)
    sensitivities = {}
    for p, name in enumerate(split.names):
        S = columns[split.region[p]][p][mode]
        if len(slope) and split.region[p] in joints:
            S = np.hstack([S, slope[:, None] * S])
        sensitivities[name] = S
    nuisance = None if nuisance is None else nuisance[:count]
    return zone_tests(residual[:count], sensitivities, nuisance, frequencies)


def patch_columns(structure, modes, pairing, split: Patches, soft=None) -> dict[str, np.ndarray]:
    """Change of ln f by an expected change in each patch: (P, m, 2) for each region's name."""
    by_key = _by_property(structure, modes, pairing, split)
    yielding = by_key if soft is None else _by_property(structure, *soft, split)
    thickness, found = layer_thickness(structure), {}
    values = structure.values(modes.given)
    for number, region in enumerate(structure.regions):
        if not region.is_joint:
            pairs = [EXPECTED[key] * by_key[key] for key in ("E", "rho")]
        elif soft is not None:
            # There the interface has nearly all the compliance, and this is twice as much of it.
            pairs = [-yielding[key] for key in ("E", "G")]
        else:
            q = structure.field.region_values(number, values) or {}
            sizes = _given_way(q, region.name, thickness)
            pairs = [size * by_key[key] for key, size in zip(("E", "G"), sizes, strict=True)]
        found[region.name] = np.stack(pairs, axis=-1)
    return found


def _by_property(structure, modes: Modes, pairing: Pairing, split: Patches) -> dict:
    """Derivative of ln f by ln of each property of each patch, (P, m)."""
    tables = {key: np.zeros((len(split), len(pairing.index))) for key in ("E", "G", "rho")}
    for j, index in enumerate(pairing.index):
        lam = modes.eigenvalues[index]
        gradient = structure.cell_gradient(modes.shape(int(index)), lam, modes.given) / (2 * lam)
        for key, table in tables.items():
            table[:, j] = split.sums(structure, per_property(structure, gradient, key))
    return tables


def _given_way(q: Mapping, name: str, thickness) -> tuple[float, float]:
    """Change of ln E and ln G by an interface of the expected stiffness, to first order."""
    zone = Zone(name, thickness=thickness[name])
    soft = interfaces([zone], dict.fromkeys(zone.parameters(), 0.0))[name].values()
    # A graded layer has no one modulus: there the direction counts, as it does in the tests.
    return tuple(-q.get(key, k) / k for key, k in zip(("E", "G"), soft, strict=True))


def _bolts(structure: Structure) -> np.ndarray:
    found = [structure.tagged.points[key] for key in _BOLTS if key in structure.tagged.points]
    if not found:
        return np.zeros((0, 3))
    points = np.atleast_2d(found[0])
    return np.hstack([points, np.zeros((len(points), 3 - points.shape[1]))])


def _gathered(structure: Structure, split: Patches):
    """Corners and patch of all cells on rank 0, (None, None) elsewhere."""
    corners = structure.mesh.geometry.x[geometry_dofmap(structure.mesh)[: len(split.number)]]
    parts = structure.comm.gather((corners, split.number), root=0)
    if structure.comm.rank != 0:
        return None, None
    vertices, patch = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return vertices, patch
