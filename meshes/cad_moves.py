"""How far the solids of an assembly move, so that contacts close, and then open by a layer.

All lengths are in millimetres; see `fenics_joints.meshes.cad_shapes`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_shapes import TOUCH, Contact, Solids


def bodies(solids: Solids, bonded: Sequence[tuple[int, int]]) -> np.ndarray:
    """Body of each solid, shape (n_solids,): bonded solids are one."""
    group = np.arange(len(solids.names))
    for a, b in bonded:
        group[group == group[b]] = group[a]
    return np.unique(group, return_inverse=True)[1]


def closing(solids: Solids, contacts: Sequence[Contact]) -> np.ndarray:
    """Moves of the solids, shape (n_solids, 3), that bring the faces of contacts together.

    The first of the solids that hang together stays.

    Raises:
        MeshError: No moves close all of them.
    """
    steps = [(c.lower, c.upper, c.normal, -c.gap) for c in contacts]
    place = _placed(len(solids.names), steps)
    for c in contacts:
        left = (place[c.upper] - place[c.lower]) @ c.normal + c.gap
        if abs(left) > TOUCH:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{solids.path}: {a!r} and {b!r} are {c.gap:.6g} mm apart and cannot be "
                "brought together without opening others; expected gaps that close, or none"
            )
    return place


def opening(
    solids: Solids, body: np.ndarray, contacts: Sequence[Contact], layer: float
) -> np.ndarray:
    """Moves of the bodies, shape (n_bodies, 3), that open contacts by a layer's thickness.

    The body of the first solid stays.

    Raises:
        MeshError: A contact is within one body, or no moves open all of them along their normals.
    """
    for c in contacts:
        if body[c.lower] == body[c.upper]:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{solids.path}: {a!r} and {b!r} are joined by a layer and bonded, by bonded = "
                "... or through other solids; expected one of the two"
            )
    steps = [(body[c.lower], body[c.upper], c.normal, layer) for c in contacts]
    place = _placed(int(body.max()) + 1, steps)
    for c in contacts:
        miss = place[body[c.upper]] - place[body[c.lower]] - layer * c.normal
        if np.linalg.norm(miss) > 1e-6 * layer:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{solids.path}: {a!r} and {b!r} cannot be moved {layer:g} mm apart along "
                "the normal of each face that has a joint, as they or others are joined on faces "
                "of other directions too; expected joints that close no loop of such faces"
            )
    return place


def _placed(n: int, steps) -> np.ndarray:
    """Places, shape (n, 3), whose differences along normals are given, from 0 for each first.

    Args:
        n: Number of places.
        steps: For each step: from, to, unit normal, and length along it.
    """
    ways: dict[tuple[int, int], list] = {}
    for a, b, normal, length in steps:
        turn = 1 if a < b else -1
        ways.setdefault((min(a, b), max(a, b)), []).append((turn * normal, length))
    between = {
        pair: np.linalg.lstsq(
            np.array([n for n, _ in found]), np.array([length for _, length in found]), rcond=1e-9
        )[0]
        for pair, found in ways.items()
    }
    place, known = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    for start in range(n):
        queue = [] if known[start] else [start]
        known[start] = True
        while queue:
            here = queue.pop(0)
            for (a, b), step in between.items():
                other, sign = (b, 1) if a == here else (a, -1)
                if here in (a, b) and not known[other]:
                    place[other], known[other] = place[here] + sign * step, True
                    queue.append(other)
    return place
