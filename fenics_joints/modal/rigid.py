"""Positions of a displacement's nodes, and rigid motions there."""

from __future__ import annotations

import numpy as np


def rigid_motions(points: np.ndarray, axisymmetric: bool = False) -> np.ndarray:
    """Rigid motions at points, (n_motions, n, gdim): translations, then rotations about 0.

    Args:
        points: Positions, (n, gdim); give them relative to a centre for a good condition.
        axisymmetric: Whether x is a radius and y the axis, along which alone the body can move.
    """
    n, gdim = points.shape
    if axisymmetric:
        return np.broadcast_to([0.0, 1.0], (1, n, 2)).copy()
    shifts = [np.broadcast_to(e, (n, gdim)) for e in np.eye(gdim)]
    if gdim == 2:
        turns = [np.column_stack([-points[:, 1], points[:, 0]])]
    else:
        turns = [np.cross(e, points) for e in np.eye(3)]
    return np.array(shifts + turns)
