"""Contact pressure under each bolt: unilateral contact of the two bodies, by an active set."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from scipy import sparse

from .eigen import solver
from .whole import Build, Interface, Whole

__all__ = ["CACHE", "pressures"]

#: Outside version control; safe to delete.
CACHE = Path(__file__).resolve().parent.parent / "cache"
_PENALTY, _STICK = 1e14, 1e12
_MOST = 60


def pressures(whole: Whole) -> np.ndarray:
    """Pressure at the interface's points per newton of each bolt, Pa/N, (n_bolts, n).

    Each bolt alone; those of several bolts add, which is exact where their contacts do not meet.
    Without friction, but held along the interface by weak springs.
    """
    rig = whole.rig
    key = repr((rig, whole.n_dofs, whole.points.round(9).tobytes(), _PENALTY)).encode()
    file = CACHE / f"pressure_{rig.name}_{hashlib.sha256(key).hexdigest()[:12]}.npz"
    if file.is_file():
        return np.load(file)["pressure"]
    build = Build()
    whole.shape(build)
    k, m = whole.matrices(build)
    interface = whole.interface(build)
    found = [_contact(whole, k, m, interface, bolt) for bolt in rig.bolts]
    CACHE.mkdir(exist_ok=True)
    np.savez_compressed(file, pressure=np.array(found))
    return np.array(found)


def _contact(whole: Whole, k, m, interface: Interface, bolt) -> np.ndarray:
    """Pressure of one bolt with a force of 1 N."""
    force = _force(whole, bolt)
    nothing = np.zeros(len(interface.weights))
    # Springs that hold what nothing else does, too weak to carry anything of the force.
    held = k + 1e-3 * (2 * np.pi) ** 2 * m + interface.stiffness(nothing, nothing + _STICK * 1e-6)
    away = np.hypot(*(interface.points - [bolt.x, bolt.y]).T)
    closed = away < 2.5 * whole.rig.outer
    for _ in range(_MOST):
        u = solver(held + interface.stiffness(_PENALTY * closed, nothing))(force)
        gap = interface.opening[2] @ u
        now = gap < 0
        if np.array_equal(now, closed):
            break
        closed = now
    pressure = np.where(closed, -_PENALTY * gap, 0.0)
    carried = float(pressure @ interface.weights)
    if not 0.97 < carried < 1.03:
        raise RuntimeError(f"{whole.rig.name}: the interface carries {carried:.3f} N of 1 N")
    return pressure


def _force(whole: Whole, bolt) -> np.ndarray:
    """1 N on the outer end of the head and of the nut, towards each other."""
    from .surfaces import quadrature, rows

    total = np.zeros(whole.n_dofs)
    radius = whole.rig.head[0] / 2
    for number, (body, start) in enumerate(zip(whole.bodies, whole.starts, strict=True)):
        sign = (-1, 1)[number]
        corners, nodes = body.face(sign * whole.rig.outer)
        away = np.hypot(*(corners.mean(axis=1) - [bolt.x, bolt.y]).T)
        face = corners[away < radius], nodes[away < radius]
        points, weights = quadrature(face[0])
        row = rows(face, points, body.n_dofs // 3, start, whole.n_dofs)[2]
        total -= sign * (sparse.csr_matrix(weights / weights.sum()) @ row).toarray().ravel()
    return total
