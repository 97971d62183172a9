"""Compact patches of a structure's cells, the signatures of changes in them, and the map of the
gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.diagnosis.where.cells import StructureCells
from fenics_joints.diagnosis.where.score_tests import LEVEL, ScoreTest
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure import Sensors
from fenics_joints.structure.grids import cell_grid, pyvista

#: Patches of each region. [decision: chosen]
PATCHES = 12


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


@dataclass(frozen=True, repr=False)
class PatchMap:
    """The map of where the gap lies: patches with their tests, and the cells to draw them on.

    Attributes:
        tests: A test for each patch.
        middle: Centre of each patch, m, (P, 3).
        volume: Volume of each patch, m3, (P,).
        bolts: Positions of the bolts, m, (n_bolts, 3).
        level: Family-wise p below which a patch explains more than chance.
        vertices: Corners of all cells, m, (n_cells, n_corners, 3); None but on rank 0.
        patch: Patch of all cells, (n_cells,); None but on rank 0.
        side_view: Whether they are elements of beams, to be seen from the side.
    """

    tests: tuple[ScoreTest, ...]
    middle: np.ndarray
    volume: np.ndarray
    bolts: np.ndarray
    level: float = LEVEL
    vertices: np.ndarray | None = None
    patch: np.ndarray | None = None
    side_view: bool = False

    def __repr__(self) -> str:
        return f"PatchMap({len(self.tests)} patches, {self.significant.sum()} significant)"

    @property
    def region(self) -> tuple[str, ...]:
        """Name of the region of each patch, (P,)."""
        return tuple(test.region for test in self.tests)

    @property
    def share(self) -> np.ndarray:
        """Share of the squared whitened misfit that a change of each patch alone explains, (P,)."""
        return np.array([test.share for test in self.tests])

    @property
    def signed_share(self) -> np.ndarray:
        """The same, above zero where the patch is softer or heavier than in the model, and below
        where it is stiffer or lighter, (P,)."""
        return self.share * np.where(np.array([test.log_f for test in self.tests]) > 0, -1.0, 1.0)

    @property
    def significant(self) -> np.ndarray:
        """Which patches explain more than chance, all places considered, (P,)."""
        return np.array([test.significant for test in self.tests], dtype=bool)

    @property
    def seen(self) -> np.ndarray:
        """Which patches the test sees at all, (P,)."""
        return np.array([test.dof > 0 for test in self.tests], dtype=bool)

    @property
    def sufficient(self) -> np.ndarray:
        """Which of them leave no more unexplained than chance would: each could be all, (P,)."""
        return np.array([test.sufficient for test in self.tests], dtype=bool)

    def to_pyvista(self):
        """The cells for pyvista, with the number of their ``patch``, the ``share`` that it
        explains, ``signed_share``, and whether it is ``significant``, ``sufficient`` and ``seen``.

        Raises:
            InputError: If pyvista is not installed, or the cells are on another rank.
        """
        pyvista()
        if self.vertices is None:
            raise InputError("vertices is None: expected the map of rank 0.")
        names = ("share", "signed_share", "significant", "sufficient", "seen")
        values = {name: getattr(self, name)[self.patch] for name in names}
        corners = np.asarray(self.vertices, dtype=float)
        tdim = 3 if (np.ptp(corners.reshape(-1, 3), axis=0) > 0).all() else 2
        return cell_grid(corners, tdim, cells={"patch": self.patch, **values})

    def to_json(self) -> dict:
        """The tests with places and volumes; not the cells."""
        rows = zip(self.tests, self.middle, self.volume, strict=True)
        return {
            "level": self.level,
            "bolts": self.bolts.tolist(),
            "patches": [
                asdict(test) | {"middle": m.tolist(), "volume": float(v)} for test, m, v in rows
            ],
        }


def patches(
    cells: StructureCells, n: int = PATCHES, merged: Mapping[str, str] | None = None
) -> Patches:
    """Split every region of a structure into ``n`` compact patches. Collective.

    Groups of a region (two plates of one material) are split each by itself, into numbers in
    proportion to their volumes; k-means from far-off starting cells does it, on one rank.

    Args:
        cells: The structure's cells.
        n: Patches of each region; fewer where it has fewer cells.
        merged: Names of regions that share their ``n``, such as the zones of a joint.
    """
    gathered = cells.gather(cells.corners.mean(axis=1), cells.volume, cells.group)
    number, rest = None, None
    if gathered is not None:
        middles, volumes, group = gathered
        shown = [(merged or {}).get(name, name) for name in cells.groups]
        number, *rest = partition(middles, volumes, group, cells.groups, shown, n)
    return Patches(cells.scatter(number), *cells.comm.bcast(rest))


#: How near two eigenvalues may be, relative to them, before what turns their shapes into one
#: another is bounded: a change of the expected size turns them all the way. [decision: chosen]
_CLOSE = 0.03


def signatures(
    cells: StructureCells,
    modes: Modes,
    pairing: Pairing,
    evidence: Evidence,
    split: Patches,
    sensors: Sensors | None,
    soft: tuple[Modes, Pairing] | None = None,
) -> Signatures:
    """Signatures of the patches, to first order. Collective.

    With K_p and M_p the parts of a patch, of mode i

    d ln f = (x_i^T K_p x_i - lambda_i x_i^T M_p x_i) / (2 lambda_i) and
    d x_i = sum over k of x_k (x_k^T K_p x_i - lambda_i x_k^T M_p x_i) / (lambda_i - lambda_k)

    by ln of its stiffness and of its mass (Fox and Kapoor, AIAA J. 6, 1968), the sum over the modes
    at hand, rigid ones among them. A patch of a joint is taken where all joints give way, and by
    twice the compliance.

    Args:
        cells: The full model's cells.
        modes: Its modes at the baseline.
        pairing: Which of them the test saw.
        evidence: The test.
        split: The patches.
        sensors: Of the shapes; None without shapes.
        soft: Modes with all joints giving way, and which of them the test saw; None without joints.
    """
    of_joint = np.array([region in cells.joints for region in split.region], dtype=bool)
    log_f, shapes = _by_patch(cells, modes, pairing, evidence, split, sensors)
    expected = np.array([EXPECTED["E"], EXPECTED["rho"]])
    log_f = log_f * expected
    shapes = None if shapes is None else shapes * expected
    if of_joint.any() and soft is not None:
        yielding, turning = _by_patch(cells, *soft, evidence, split, sensors)
        mass_stays = np.array([-1.0, 0.0])
        log_f[:, of_joint] = yielding[:, of_joint] * mass_stays
        if shapes is not None:
            shapes[:, :, of_joint] = turning[:, :, of_joint] * mass_stays
    return Signatures(
        split.names,
        split.region,
        split.middle,
        split.volume,
        of_joint,
        log_f,
        shapes,
        (EXPECTED["E"], EXPECTED["rho"]),
    )


def _by_patch(cells, modes, pairing, evidence, split, sensors):
    """Derivatives of ln f, (m, P, 2), and of the scaled shapes, (n_s, m, P, 2) or None, by ln of
    the stiffness and the mass of each patch."""
    lam, count = modes.eigenvalues, len(split)
    seen = None if evidence.shapes is None else modes.at(sensors)
    log_f, shapes = [], []
    for i, crossed in zip(pairing.index, cells.crossed(modes, pairing.index), strict=True):
        stiff, mass = (cells.sums(split.number, by_cell, count) for by_cell in crossed)
        pulls = np.stack([stiff, -lam[i] * mass], axis=-1)  # (P, M, 2)
        log_f.append(pulls[:, i] / (2 * lam[i]))
        if seen is not None:
            apart = lam[i] - lam
            turns = apart / (apart**2 + (_CLOSE * lam[i]) ** 2)
            turns[i] = 0.0
            shapes.append(np.einsum("sk,k,pkw->spw", seen, turns, pulls))
    if seen is None:
        return np.array(log_f), None
    at = seen[:, pairing.index]
    return np.array(log_f), _scaled(evidence.shapes, at, np.stack(shapes, axis=1))


def _scaled(measured: np.ndarray, at: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes of shapes, (n_s, m, P, 2), as the measured ones are scaled, (n_s, m), without their
    part along the shape, which has no scale of its own."""
    there = np.isfinite(measured)
    y, x = np.where(there, measured, 0.0), np.where(there, at, 0.0)
    change = np.where(there[:, :, None, None], change, 0.0)
    square = np.maximum(np.sum(x**2, axis=0), 1e-300)
    scale = np.sum(x * y, axis=0) / square
    along = np.einsum("sm,smpw->mpw", x, change) / square[:, None, None]
    return scale[None, :, None, None] * (change - x[:, :, None, None] * along[None])
