"""What faces and curves of a drawing are, also where the file has them as splines.

CAD programs write mirrored, imported and healed bodies with splines in the place of planes and
circles. Lengths are in millimetres.
"""

from __future__ import annotations

import numpy as np

#: Distances below this are those of round-off in CAD.
TOUCH = 1e-3
_SPLINES = ("BSpline surface", "Bezier surface", "BSpline", "Bezier")
#: Points along each parameter at which a spline is looked at.
_LOOK = (np.arange(7) + 0.5) / 7


def is_flat(model, face: int) -> bool:
    """Whether a face is a plane, or a spline that is one within `TOUCH`."""
    kind = model.getType(2, face)
    if kind not in _SPLINES:
        return kind == "Plane"
    points = surface_points(model, face)
    least = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return float(np.ptp(points @ least)) < TOUCH


def surface_points(model, face: int) -> np.ndarray:
    """Points of a face's surface over the rectangle of its parameters, (n, 3)."""
    low, high = (np.array(ends) for ends in model.getParametrizationBounds(2, face))
    uv = [(low + (high - low) * [s, t]).tolist() for s in _LOOK for t in _LOOK]
    return np.reshape(model.getValue(2, face, np.ravel(uv).tolist()), (-1, 3))


def circle_of(model, curve: int) -> tuple[np.ndarray, float] | None:
    """Centre, (3,), and radius of the circle on which a curve lies within `TOUCH`, or None."""
    kind = model.getType(1, curve)
    if kind != "Circle" and kind not in _SPLINES:
        return None
    (low,), (high,) = model.getParametrizationBounds(1, curve)
    at = (low + (high - low) * np.array([0.1, 0.4, 0.7])).tolist()
    a, b, c = np.array(model.getValue(1, curve, at)).reshape(3, 3)
    u, v = b - a, c - a
    w = np.cross(u, v)
    if np.linalg.norm(w) <= 1e-9 * max(u @ u, v @ v):
        return None  # straight
    centre = a + np.cross((u @ u) * v - (v @ v) * u, w) / (2 * (w @ w))
    radius = float(np.linalg.norm(a - centre))
    if kind != "Circle":
        along = (low + (high - low) * _LOOK).tolist()
        points = np.reshape(model.getValue(1, curve, along), (-1, 3)) - centre
        off = np.abs(np.linalg.norm(points, axis=1) - radius)
        if max(off.max(), np.abs(points @ w).max() / np.sqrt(w @ w)) > TOUCH:
            return None
    return centre, radius
