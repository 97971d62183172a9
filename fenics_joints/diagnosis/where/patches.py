"""Compact patches of a structure's cells, and the map of where the gap lies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.score_tests import LEVEL, ScoreTest
from fenics_joints.diagnosis.zones.partition import partition
from fenics_joints.errors import InputError
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


def patches(cells: Cells, n: int = PATCHES, merged: Mapping[str, str] | None = None) -> Patches:
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
