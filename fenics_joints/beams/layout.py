"""Nodes and elements of a chain of lapped beams, and displacements between the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.beams.components import Beam, GenericJoint, Held
from fenics_joints.beams.element import bending_number, shape_functions
from fenics_joints.errors import InputError

#: Elements in all, at most: the matrices are dense, and there are many.
_MOST = 400
#: Two places are the same if they are nearer than this share of the whole length.
_SAME = 1e-9
_MOTIONS = ("x", "z", "turn")


@dataclass(frozen=True)
class Stretch:
    """Elements of equal length: of one beam, or of a lap.

    Attributes:
        name: Name of the beam or joint.
        beams: Indices of the beams there.
        joint: Index of the joint, or None.
        first: First element.
        n: Number of elements.
        length: Length of an element, m.
    """

    name: str
    beams: tuple[int, ...]
    joint: int | None
    first: int
    n: int
    length: float

    @property
    def elements(self) -> range:
        """Their numbers."""
        return range(self.first, self.first + self.n)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the degrees of freedom are.

    Attributes:
        x: Positions of the nodes, m, ascending, shape (n_nodes,).
        stretches: Beams and laps in order along x.
        free: Degrees of freedom that are not held, of u, w, theta node by node.
        phi: Nominal phi of each element, for what lies between the nodes.
    """

    x: np.ndarray
    stretches: tuple[Stretch, ...]
    free: np.ndarray
    phi: np.ndarray

    def at_nodes(self, vectors: np.ndarray) -> np.ndarray:
        """u, w and theta at the nodes, (n_nodes, 3, m), of vectors (n_dofs, m)."""
        whole = np.zeros((3 * len(self.x), vectors.shape[1]))
        whole[self.free] = vectors
        return whole.reshape(len(self.x), 3, -1)

    def assemble(self, matrices: np.ndarray, elements: Sequence[int]) -> np.ndarray:
        """Matrices of an element, (m, 6, 6), summed over elements; (m, n_dofs, n_dofs)."""
        total = np.zeros((len(matrices), 3 * len(self.x), 3 * len(self.x)))
        for e in elements:
            at = slice(3 * e, 3 * e + 6)
            total[:, at, at] += matrices
        return total[:, self.free[:, None], self.free]

    def rows(self, point: Sequence[float], what: str = "point") -> tuple[np.ndarray, np.ndarray]:
        """Rows of the motion at a point and of its slope by x.

        Args:
            point: x and z, the height above the reference line, m, as (x, y, z) or (x, z).
            what: What stands there, for the message.

        Returns:
            Two arrays (3, n_dofs): displacement along x, along z, and rotation.

        Raises:
            InputError: If x is beside the beams.
        """
        x, z = float(point[0]), float(point[-1])
        low, high = self.x[0], self.x[-1]
        near = _SAME * (high - low)
        if not low - near <= x <= high + near:
            raise InputError(
                f"{what} at {[float(c) for c in point]} m is outside the structure: expected x "
                f"from {low:g} to {high:g} m."
            )
        e = int(np.clip(np.searchsorted(self.x, x + near) - 1, 0, len(self.x) - 2))
        length = self.x[e + 1] - self.x[e]
        local = shape_functions(np.clip((x - self.x[e]) / length, 0, 1), length, self.phi[e])
        whole = np.zeros((2, 3, 3 * len(self.x)))
        whole[:, :, 3 * e : 3 * e + 6] = local
        whole[:, 0] -= z * whole[:, 2]
        return tuple(whole[:, :, self.free])


def lay_out(
    beams: Sequence[Beam],
    joints: Sequence[GenericJoint],
    held: Sequence[Held],
    phis: Sequence[tuple[float, float]],
) -> Layout:
    """Nodes of beams in a row, each lapped with the next one.

    Args:
        beams: The beams.
        joints: Their laps, one fewer.
        held: What cannot move.
        phis: Nominal (nu, height) of each beam.

    Raises:
        InputError: If a beam is no longer than its laps, or a support is not at a node.
    """
    if len(beams) < 1 or len(joints) != len(beams) - 1:
        raise InputError(
            f"{len(beams)} beams with {len(joints)} joints: expected one joint between each beam "
            "and the next."
        )
    n_elements = sum(item.n_elements for item in (*beams, *joints))
    if n_elements > _MOST:
        raise InputError(
            f"the beams and laps have {n_elements} elements: expected at most {_MOST} in all, "
            "since their matrices are dense; fifty already give many modes."
        )
    x, stretches, phi = [0.0], [], []

    def add(name, which, joint, n, length):
        stretches.append(Stretch(name, which, joint, len(x) - 1, n, length / n))
        x.extend(x[-1] + length / n * np.arange(1, n + 1))
        nu, height = phis[which[0]]
        phi.extend([bending_number(nu, height, length / n, beams[which[0]].shear)] * n)

    for i, beam in enumerate(beams):
        laps = [joints[j].length for j in (i - 1, i) if 0 <= j < len(joints)]
        alone = beam.length - sum(laps)
        if not alone > _SAME * beam.length:
            raise InputError(
                f"{beam.name}.length = {beam.length:g} m: expected more than the sum of its laps, "
                f"{sum(laps):g} m."
            )
        add(beam.name, (i,), None, beam.n_elements, alone)
        if i < len(joints):
            add(joints[i].name, (i, i + 1), i, joints[i].n_elements, joints[i].length)
    x = np.array(x)
    return Layout(x, tuple(stretches), _free(x, held), np.array(phi))


def _free(x: np.ndarray, held: Sequence[Held]) -> np.ndarray:
    free = np.ones((len(x), 3), dtype=bool)
    for place in held:
        node = int(np.argmin(np.abs(x - place.x)))
        if abs(x[node] - place.x) > 1e-6 * x[-1]:
            raise InputError(
                f"held.x = {place.x:g} m: expected a node of the beams; the nearest one is at "
                f"{x[node]:g} m."
            )
        free[node, [_MOTIONS.index(m) for m in place.motions]] = False
    return np.flatnonzero(free.ravel())
