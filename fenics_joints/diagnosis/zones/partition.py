"""Compact patches of cells by k-means, the same on any number of ranks."""

from __future__ import annotations

import numpy as np

#: Sweeps of Lloyd's algorithm; the patches need to be compact, not optimal. [numerical: chosen]
_SWEEPS = 8
#: Coordinates are rounded to this share of the structure's size: ties by symmetry are then broken
#: by order, and the same way on any number of ranks. [numerical: round-off]
_GRAIN = 1e-7


def partition(middles, volumes, groups, labels, shown, n: int):
    """Cells in compact patches.

    Args:
        middles: Middles of the cells, m, (n_cells, 3).
        volumes: Their volumes, m3, (n_cells,).
        groups: Group of each, (n_cells,): no patch has cells of two.
        labels: Region of each group.
        shown: Name of the region that it is shown as; patches are numbered by it.
        n: Patches of each region, in proportion to the groups' volumes.

    Returns:
        Patch of each cell; names, regions, middles and volumes of the patches.
    """
    size = np.ptp(middles, axis=0).max() or 1.0
    places = np.round(middles / size / _GRAIN) * _GRAIN
    weights = np.round(volumes / volumes.max() / _GRAIN) * _GRAIN
    order = np.lexsort((*places.T, groups))
    number, regions = np.empty(len(groups), dtype=int), []
    own = np.bincount(groups, volumes, minlength=len(labels))
    whole = {name: sum(own[g] for g, x in enumerate(shown) if x == name) for name in shown}
    titles: list[str] = []
    for g, name in enumerate(labels):
        cells = order[groups[order] == g]
        k = min(max(int(round(n * own[g] / whole[shown[g]])), 1), len(cells))
        inside = _lloyd(places[cells], weights[cells], k)
        number[cells] = len(regions) + inside
        count = inside.max(initial=-1) + 1
        regions += [name] * count
        titles += [shown[g]] * count
    volume = np.bincount(number, volumes)
    middle = np.array([np.bincount(number, volumes * x) for x in middles.T]).T / volume[:, None]
    counts: dict[str, int] = {}
    names = []
    for name in titles:
        counts[name] = counts.get(name, 0) + 1
        names.append(f"{name} {counts[name]}")
    return number, tuple(names), tuple(regions), middle, volume


def _lloyd(x: np.ndarray, weights: np.ndarray, k: int) -> np.ndarray:
    """Cluster of each point, (n,), numbered by place; empty clusters vanish."""
    if len(x) == 0:
        return np.zeros(0, dtype=int)
    centres = x[[int(np.argmax(_squares(x, x.mean(axis=0)[None])[:, 0]))]]
    while len(centres) < k:
        far = int(np.argmax(np.round(_squares(x, centres).min(axis=1), 12)))
        centres = np.vstack([centres, x[far]])
    for _ in range(_SWEEPS):
        own = _nearest(x, centres)
        used = np.unique(own)
        centres = np.array(
            [np.average(x[own == c], axis=0, weights=weights[own == c]) for c in used]
        )
    own = _nearest(x, centres)
    used, own = np.unique(own, return_inverse=True)
    rank = np.empty(len(used), dtype=int)
    rank[np.lexsort(np.round(centres[used], 6).T[::-1])] = np.arange(len(used))
    return rank[own]


def _squares(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    return np.sum((x[:, None] - centres[None]) ** 2, axis=2)


def _nearest(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    # Rounded, so that a cell midway between two goes to the first on any machine.
    return np.argmin(np.round(_squares(x, centres), 12), axis=1)
