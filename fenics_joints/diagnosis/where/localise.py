"""Where the gap lies: by region, and cell by cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.diagnosis.effects.sensing import in_order
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.forward import Forward

__all__ = [
    "CellMap", "ZoneShare", "cell_map", "mean_residual", "zone_shares",
]  # fmt: skip

_STEPS = 12
#: What a test that calls modes by wrong names explains of a gap.
_TEST = "names of the modes"


@dataclass(frozen=True)
class ZoneShare:
    """Share of the measured gap that a region explains; all regions and the rest sum to 1."""

    region: str
    share: float


@dataclass(frozen=True, repr=False)
class CellMap:
    """Where stiffness would have to change to close the gap, cell by cell; on rank 0 only.

    Attributes:
        vertices: Corner coordinates of every cell, m, shape (n_cells, n_corners, 3).
        region: Index into ``regions`` of every cell, shape (n_cells,).
        regions: Names of the regions.
        density: Reduction of the squared gap per relative loss of stiffness and per volume, scaled
            to a largest magnitude of 1, shape (n_cells,); positive: the test wants it softer.
        side_view: Whether they are elements of beams, to be seen from the side.
    """

    vertices: np.ndarray
    region: np.ndarray
    regions: tuple[str, ...]
    density: np.ndarray
    side_view: bool = False

    def __repr__(self) -> str:
        return f"CellMap({len(self.region)} cells of {len(self.regions)} regions)"


def zone_shares(
    fit: Fit,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    merged: Mapping[str, str] | None = None,
) -> list[ZoneShare]:
    """Share of the measured gap that each region's parameters explain in a fitted hypothesis.

    The change of ln f from the baseline to the fit is split exactly among the parameters by
    integrating the sensitivities along the path between them (in logarithms where both ends are
    positive), and projected on the measured gap; what is left is "unexplained". ``merged`` names
    regions that count as one.
    """
    names = list(forward.model.parameters)
    changes = np.zeros((len(names), *evidence.log_f.shape))
    hypothesis, order = fit.hypothesis, None
    if hypothesis.senses:
        order = hypothesis.sensing(fit.z, forward.n_test, len(forward.sensors or ())).order

    def ordered(values):
        return in_order(forward, order, values)

    for row, condition in enumerate(evidence.conditions):
        end = hypothesis.values(fit.z, condition, baseline, row)
        changes[:, row, :] = _along_path(ordered, forward.n_test, names, baseline, end)
    start = np.array([forward(baseline)[0]] * len(evidence.conditions))
    gap = np.where(evidence.used, evidence.log_f - start, 0.0)
    size = np.sum(gap**2)
    by_region: dict[str, float] = {}
    if order is not None and np.any(order != np.arange(len(order))):
        by_region[_TEST] = float(np.sum((ordered(baseline)[0] - start) * gap) / size)
    for name, change in zip(names, changes, strict=True):
        region = name.rpartition(".")[0]
        region = (merged or {}).get(region, region)
        by_region[region] = by_region.get(region, 0.0) + float(np.sum(change * gap) / size)
    ordered = sorted(by_region.items(), key=lambda item: -abs(item[1]))
    shares = [ZoneShare(region, share) for region, share in ordered]
    return [*shares, ZoneShare("unexplained", 1.0 - sum(by_region.values()))]


def _along_path(forward, n_test: int, names, start, end) -> np.ndarray:
    """Contribution of every parameter to the change of ln f, shape (n_parameters, m)."""
    total = np.zeros((len(names), n_test))
    for step in range(_STEPS):
        before, middle, after = (
            np.array([_between(start, end, n, (step + s) / _STEPS) for n in names])
            for s in (0.0, 0.5, 1.0)
        )
        _, slope = forward(dict(zip(names, middle.tolist(), strict=True)))
        total += (slope * (after - before)).T
    exact = forward(end)[0] - forward(start)[0]
    # The midpoint rule's error goes to the parameters in proportion to what they moved.
    weight = np.abs(total) / np.maximum(np.sum(np.abs(total), axis=0), 1e-300)
    return total + weight * (exact - np.sum(total, axis=0))


def _between(start, end, name, t: float) -> float:
    a, b = start[name], end[name]
    if a == b:
        return a
    if a > 0 and b > 0:
        return float(a ** (1 - t) * b**t)
    return float((1 - t) * a + t * b)


def cell_map(
    cells: Cells,
    modes: Modes,
    pairing: Pairing,
    evidence: Evidence,
    nuisance: np.ndarray,
    merged: Mapping[str, str] | None = None,
) -> CellMap | None:
    """Where stiffness would have to change, from the adjoint sensitivities of the baseline.

    Args:
        cells: The full model's cells.
        modes: Its modes as the baseline.
        pairing: Which of them the test saw.
        evidence: The test; its mean residual over the conditions is used.
        nuisance: Derivatives of ln f by the nuisances, shape (m, k): what they can explain is
            taken out of the residual first.
        merged: Names of regions that count as one.

    Returns:
        The map on rank 0, None elsewhere. Collective.
    """
    residual = mean_residual(modes, pairing, evidence, nuisance)
    slopes = cells.slopes(modes, pairing.index)
    # By the logarithm of a cell's whole stiffness: all its moduli together.
    density = -sum(slopes[key] @ residual for key in cells.stiffness) / cells.volume
    gathered = cells.gather(cells.corners, cells.region, density)
    if gathered is None:
        return None
    corners, region, density = gathered
    names = [(merged or {}).get(name, name) for name in cells.regions]
    whole = tuple(dict.fromkeys(names))
    largest = np.max(np.abs(density))
    return CellMap(
        corners, np.array([whole.index(name) for name in names])[region], whole,
        density / largest if largest > 0 else density, cells.side_view,
    )  # fmt: skip


def mean_residual(
    modes: Modes, pairing: Pairing, evidence: Evidence, nuisance: np.ndarray
) -> np.ndarray:
    """Mean over the conditions of measured minus nominal ln f, less what nuisances look like, (m,).

    Args:
        modes: Modes as the baseline.
        pairing: Which of them the test saw.
        evidence: The test.
        nuisance: Derivatives of ln f by the nuisances, shape (m, k).
    """
    model_log_f = np.log(modes.frequencies_hz[pairing.index])
    count = evidence.used.sum(axis=0)
    total = np.where(evidence.used, evidence.log_f, 0.0).sum(axis=0)
    residual = np.where(count > 0, total / np.maximum(count, 1) - model_log_f, 0.0)
    if nuisance.shape[1] < len(residual):
        # Whitened, the nuisances could mimic all of a small residual; here only their shape counts.
        unit = np.linalg.norm(residual)
        basis, _ = np.linalg.qr(nuisance[:, :1])
        residual = residual - basis @ (basis.T @ residual)
        residual = residual * (unit / max(np.linalg.norm(residual), 1e-300))
    return residual
