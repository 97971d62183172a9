"""How what sensors read bends from place to place on their faces, of the vectors of a basis.

A sensor that sits some centimetres from where it should reads more than a slope says. What it
reads at its own place and the slope there are known; the second and third derivatives are those of
the polynomial that comes nearest to the nodes of its face round about.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.structure import Sensors, Structure

#: How far nodes count, over the largest distance of two sensors: a third further than a sensor may
#: sit elsewhere (`fenics_joints.diagnosis.effects.rig.misplaced_sensor`), so that there are some.
_REACH = 0.2
#: Height of a node over a sensor's face, relative to its distance, up to which it is on that.
_FLAT = 0.25
#: Share of the largest moment of the nodes below which these say nothing of a bend.
_TOLD = 1e-3
#: Nodes of a face at most, of more some at all distances.
_MOST = 60
#: Powers of the distances along both ways, of two and three together.
_POWERS = tuple((order - k, k) for order in (2, 3) for k in range(order + 1))
#: How many these are.
N_BENDS = len(_POWERS)


def monomials(a, b) -> np.ndarray:
    """a^2, a b, b^2, a^3, a^2 b, a b^2, b^3, (7, ...).

    Args:
        a: Distances along the first way, m.
        b: Along the second, m.
    """
    return np.array([a**i * b**j for i, j in _POWERS])


def bends(
    structure: Structure,
    basis: Sequence[PETSc.Vec],
    sensors: Sensors,
    ways: np.ndarray,
    rows: np.ndarray,
    slopes: np.ndarray,
) -> np.ndarray:
    """Second and third derivatives as factors of `monomials`, 1/m2 and 1/m3, (7, n_sensors, n).
    Collective.

    Args:
        structure: The full model.
        basis: Vectors, owned entries.
        sensors: Where they stand.
        ways: Two directions on the face of each, (2, n_sensors, gdim).
        rows: What they read of each vector, (n_sensors, n).
        slopes: The same per metre along each way, (2, n_sensors, n).
    """
    gdim = structure.gdim
    points, normals = sensors.points[:, :gdim], sensors.directions[:, :gdim]
    reach = _REACH * np.max(np.linalg.norm(points[:, None] - points, axis=2), initial=0.0)
    nodes = [_round_about(structure, x, n, reach) for x, n in zip(points, normals, strict=True)]
    found = np.zeros((N_BENDS, len(points), len(basis)))
    at = np.vstack(nodes)
    if not len(at):
        return found
    of = np.repeat(np.arange(len(points)), [len(each) for each in nodes])
    read = structure.observe(basis, Sensors(at, normals[of]))
    for i, x in enumerate(points):
        off, own = at[of == i] - x, read[of == i]
        a, b = off @ ways[0, i], off @ ways[1, i]
        left = own - rows[i] - np.outer(a, slopes[0, i]) - np.outer(b, slopes[1, i])
        powers = monomials(a / reach, b / reach)
        weight = powers * (reach**2 / np.maximum(a**2 + b**2, 1e-300))
        moments = weight @ powers.T
        found[:, i] = np.linalg.pinv(moments, rcond=_TOLD, hermitian=True) @ (weight @ left)
    return found / np.array([reach ** (i + j) for i, j in _POWERS])[:, None, None]


def _round_about(structure: Structure, x: np.ndarray, normal: np.ndarray, reach: float):
    """Nodes of the mesh on the face of a point, the nearest ones, (k, gdim). Collective."""
    nodes = structure.mesh.geometry.x[:, : structure.gdim]
    off = nodes - x
    along = np.linalg.norm(off - np.outer(off @ normal, normal), axis=1)
    near = (along > 0) & (along <= reach) & (np.abs(off @ normal) <= _FLAT * along)
    every = np.vstack(structure.comm.allgather(nodes[near]))
    grain = 1e-6 * max(reach, 1e-300)
    every = every[np.unique(np.round(every / grain), axis=0, return_index=True)[1]]
    away = np.round(np.linalg.norm(every - x, axis=1) / grain)
    order = np.argsort(away, kind="stable")
    return every[order[:: max(-(-len(order) // _MOST), 1)]]
