"""Where the gap lies, finer than the model's regions: compact patches of its cells, each tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED, EXPONENT, trend
from fenics_joints.diagnosis.where.zone_tests import ZoneTest, zone_tests
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.grids import cell_grid, pyvista

__all__ = ["PatchMap", "Patches", "patch_columns", "patch_tests", "patches"]


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        return f"Patches({len(self)} of {len(set(self.region))} regions)"

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def none(cls, n_owned: int) -> Patches:
        """No patches of this rank's cells."""
        return cls(np.zeros(n_owned, dtype=int), (), (), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        return f"PatchMap({len(self.tests)} patches, {self.significant.sum()} significant)"

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

    def to_pyvista(self):
        """The cells for pyvista, with the number of their ``patch``, the ``share`` that it
        explains, and whether it is ``significant``, ``sufficient`` and ``seen``.

        Raises:
            InputError: If pyvista is not installed, or the cells are on another rank.
        """
        pyvista()
        if self.vertices is None:
            raise InputError("vertices is None: expected the map of rank 0.")
        names = ("share", "significant", "sufficient", "seen")
        values = {name: getattr(self, name)[self.patch] for name in names}
        corners = np.asarray(self.vertices, dtype=float)
        tdim = 3 if (np.ptp(corners.reshape(-1, 3), axis=0) > 0).all() else 2
        return cell_grid(corners, tdim, cells={"patch": self.patch, **values})

    def to_json(self) -> dict:
        """The tests with places and volumes; not the cells."""
        rows = zip(self.tests, self.region, self.middle, self.volume, strict=True)
        return {
            "level": self.level,
            "bolts": self.bolts.tolist(),
            "patches": [
                asdict(test) | {"region": region, "middle": m.tolist(), "volume": float(v)}
                for test, region, m, v in rows
            ],
        }


# -- partition -------------------------------------------------------------------------------


def patches(cells: Cells, n: int = 12, merged: Mapping[str, str] | None = None) -> Patches:
    """Split every region of a structure into ``n`` compact patches. Collective.

    Groups of a region (two plates of one material) are split each by itself, into numbers in
    proportion to their volumes; k-means from far-off starting cells does it, on one rank.

    Args:
        cells: The structure's cells.
        n: Patches of each region; fewer where it has fewer cells.
        merged: Names of regions that share their ``n``, such as the zones of a joint.

    Raises:
        InputError: If ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"n = {n}: expected at least 1 patch of each region.")
    gathered = cells.gather(cells.corners.mean(axis=1), cells.volume, cells.group)
    number, rest = None, None
    if gathered is not None:
        middles, volumes, group = gathered
        shown = [(merged or {}).get(name, name) for name in cells.groups]
        number, *rest = partition(middles, volumes, group, cells.groups, shown, n)
    return Patches(cells.scatter(number), *cells.comm.bcast(rest))


# -- tests -----------------------------------------------------------------------------------


def patch_tests(
    cells: Cells,
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
    part's patch by ln E and ln rho; of a joint's by its two compliances where all joints give way
    (see `zone_sensitivities`), and with ``by_torque`` by their slope in the torque's logarithm.
    Shapes and damping are left out, whose derivatives by cells would cost a solution each.

    Args:
        cells: The full model's cells.
        modes: Its modes at the baseline.
        pairing: Which of them the test saw.
        evidence: The test.
        residual: Data minus the baseline's prediction, (N,).
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p), or None.
        n: Patches of each region.
        soft: Modes with all joints giving way, at the values of `zone_sensitivity.given_way`, and
            which of them the test saw; None for a structure without joints.
        by_torque: Whether the conditions are torques.
        merged: Names of regions that share their ``n``, such as the zones of a joint.
        level: Adjusted p below which a patch counts as significant.

    Returns:
        The tests on every rank; the cells to draw on rank 0 only.
    """
    split = patches(cells, n, merged)
    columns = patch_columns(cells, modes, pairing, split, soft)
    frequencies = replace(evidence, log_damping=None, shapes=None, scalars=())
    count, mode = frequencies.data.size, frequencies.entries.mode
    slope = []
    if by_torque and len(evidence.conditions) > 1:
        slope = EXPONENT * trend(frequencies)
    sensitivities = {}
    for name, region, column in zip(split.names, split.region, columns, strict=True):
        S = column[mode]
        if len(slope) and region in cells.joints:
            S = np.hstack([S, slope[:, None] * S])
        sensitivities[name] = S
    nuisance = None if nuisance is None else nuisance[:count]
    tests = zone_tests(residual[:count], sensitivities, nuisance, frequencies)
    drawn = cells.gather(cells.corners, split.number) or (None, None)
    return PatchMap(
        tuple(tests), split.region, split.middle, split.volume, cells.bolts, level, *drawn,
        side_view=cells.side_view,
    )  # fmt: skip


def patch_columns(
    cells: Cells,
    modes: Modes,
    pairing: Pairing,
    split: Patches,
    soft: tuple[Modes, Pairing] | None = None,
) -> np.ndarray:
    """Change of ln f by an expected change in each patch, (P, m, 2); see `patch_tests`.

    Collective.
    """

    def by_patch(modes: Modes, pairing: Pairing) -> dict[str, np.ndarray]:
        slopes = cells.slopes(modes, pairing.index)
        return {key: cells.sums(split.number, by, len(split)) for key, by in slopes.items()}

    at_baseline = by_patch(modes, pairing)
    found = np.stack([EXPECTED[key] * at_baseline[key] for key in ("E", "rho")], axis=-1)
    of_joints = np.array([region in cells.joints for region in split.region], dtype=bool)
    if of_joints.any():
        if soft is None:
            raise InputError("soft: expected the modes with all joints giving way.")
        yielding = by_patch(*soft)
        # There the interface has nearly all the compliance, and this is twice as much of it.
        pairs = np.stack([-yielding[key] for key in cells.joint_keys], axis=-1)
        found[of_joints] = pairs[of_joints]
    return found
