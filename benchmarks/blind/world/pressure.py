"""Contact pressure under each bolt: unilateral contact of the two bodies, by an active set."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .eigen import solver
from .kept import keep, kept
from .surfaces import quadrature, rows
from .whole import Build, Interface, Whole

_PENALTY, _STICK = 1e14, 1e12
#: N of 1 N that the interface may carry otherwise, and iterations at most.
_ASTRAY, _MOST = 0.03, 60


def pressures(whole: Whole) -> np.ndarray:
    """Pressure at the interface's points per newton of each bolt, Pa/N, (n_bolts, n).

    Each bolt alone; those of several bolts add, which is exact where their contacts do not meet.
    Without friction, but held along the interface by weak springs.
    """
    rig = whole.rig
    file = kept("pressure", whole, repr((_PENALTY, _STICK)).encode())
    if file.is_file():
        with np.load(file) as data:
            return data["pressure"]
    build = Build()
    whole.shape(build)
    k, m = whole.matrices(build)
    interface = whole.interface(build)
    found = np.array([_contact(whole, k, m, interface, bolt) for bolt in rig.bolts])
    keep(file, pressure=found)
    return found


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
    else:
        raise RuntimeError(f"{whole.rig.name}: the contact at bolt {bolt.label} does not settle")
    pressure = np.where(closed, -_PENALTY * gap, 0.0)
    carried = float(pressure @ interface.weights)
    if abs(carried - 1) > _ASTRAY:
        raise RuntimeError(f"{whole.rig.name}: the interface carries {carried:.3f} N of 1 N")
    return pressure


def _force(whole: Whole, bolt) -> np.ndarray:
    """1 N on the outer end of the head and of the nut, towards each other."""
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
