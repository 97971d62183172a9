"""Rigid motions that nothing resists, and how a load and a motion are rid of them.

A free structure under static load has no equilibrium but with the forces of its own inertia
(inertia relief), and that one only up to a rigid motion. Of a periodic motion the mean place of a
free structure is open in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

#: Energy, over that of the same terms without their signs, below which round-off is all there is.
_ROUND_OFF = 100 * float(np.finfo(float).eps)
#: Strain of a motion, over the largest of any, below which it is none.
_STRAINLESS = 1e-6


@dataclass(frozen=True)
class FreeMotions:
    """Rigid motions without resistance.

    Attributes:
        shapes: M-orthonormal, this rank's rows, (n_local, k).
        inertia: M times them, (n_local, k).
        comm: Ranks that share the rows.
    """

    shapes: np.ndarray
    inertia: np.ndarray
    comm: MPI.Comm

    def __len__(self) -> int:
        return self.shapes.shape[1]

    def balance(self, load: PETSc.Vec) -> float:
        """Take off the load what would accelerate the structure as a rigid body. Collective.

        Returns:
            The norm of that, relative to the load's.
        """
        size = load.norm()
        if not len(self) or size == 0.0:
            return 0.0
        work = self.comm.allreduce(self.shapes.T @ load.array_r)
        taken = self.inertia @ work
        load.array[:] -= taken
        return float(np.sqrt(self.comm.allreduce(float(taken @ taken)))) / size

    def take_off(self, u: PETSc.Vec) -> None:
        """Move u as a rigid body so that its mean place and turn are none. Collective."""
        if len(self):
            u.array[:] -= self.shapes @ self.comm.allreduce(self.inertia.T @ u.array_r)

    def pins(self, start: int) -> np.ndarray:
        """Global rows, one for each motion, that hold the motions if they are held. Collective.

        Args:
            start: Number of this rank's first row.
        """
        rows, pins = self.shapes.copy(), []
        for _ in range(len(self)):
            size = np.einsum("ij,ij->i", rows, rows)
            best = int(np.argmax(size)) if len(size) else 0
            sizes = self.comm.allgather(float(size[best]) if len(size) else -1.0)
            rank = int(np.argmax(sizes))
            mine = (rows[best].copy(), best + start) if self.comm.rank == rank else None
            row, number = self.comm.bcast(mine, root=rank)
            pins.append(number)
            row = row / np.linalg.norm(row)
            rows -= np.outer(rows @ row, row)
        return np.array(pins, dtype=PETSc.IntType)


def no_motions(n_local: int, comm: MPI.Comm) -> FreeMotions:
    """Those of a structure that is held."""
    return FreeMotions(np.zeros((n_local, 0)), np.zeros((n_local, 0)), comm)


def unresisted(candidates: np.ndarray, terms, comm: MPI.Comm) -> np.ndarray:
    """What of a few motions costs no energy but round-off. Collective.

    Args:
        candidates: This rank's rows, (n_local, m).
        terms: Of each kind of stiffness: twice the energy of pairs of motions, (m, m), and of each
            motion with all signs positive, (m,).
        comm: Ranks that share the rows.

    Returns:
        Combinations of the candidates, (n_local, k).
    """
    resisted = np.zeros((candidates.shape[1],) * 2)
    for energy, positive in terms:
        size = np.sqrt(np.where(positive > 0, positive, 1.0))
        resisted += energy / np.outer(size, size)
    values, vectors = scipy.linalg.eigh(0.5 * (resisted + resisted.T))
    return candidates @ vectors[:, values < _ROUND_OFF]


def strainless(shapes: np.ndarray, strains: np.ndarray, largest: float) -> np.ndarray:
    """What of some motions strains no interface, M-orthonormal as they are.

    A joint that is open, or a spring that is weak, at rest resists nevertheless.

    Args:
        shapes: M-orthonormal motions, (n, m).
        strains: Their strains at all points, (q, m).
        largest: Norm of the strains of the motion of unit mass that has the most.
    """
    if not shapes.shape[1] or not strains.size:
        return shapes
    _, sizes, V = np.linalg.svd(strains, full_matrices=True)
    sizes = np.append(sizes, np.zeros(len(V) - len(sizes)))
    return shapes @ V[sizes <= _STRAINLESS * largest].T
