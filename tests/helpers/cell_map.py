"""Cells of three layers, for the tests of pages and pictures."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np


def cells() -> SimpleNamespace:
    """Two plates with a layer between them, one cell each in height."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(3), indexing="ij"))
    corner = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    blocks = []
    for low, high in ((0.0, 8.0), (8.0, 8.5), (8.5, 16.5)):
        block = 20.0 * corner[None] + 20.0 * np.stack([x, y, 0 * x], axis=1)[:, None]
        block[..., 2] = np.where(corner[None, :, 2] > 0, high, low)
        blocks.append(block)
    region = np.repeat([0, 1, 0], len(x))
    return SimpleNamespace(vertices=1e-3 * np.concatenate(blocks), region=region)
