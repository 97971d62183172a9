"""Vectors that hold modes from samples of a structure's parameters, each to its own energy.

A proper orthogonal decomposition in the energy of one sample leaves out what is small there: beside
a joint that is stiff in it, modes with a soft joint are nearly all opening and slip, and what they
bend of the parts is lost. Here a mode is held as well as the energy of its own sample asks for: by
Rayleigh's principle a frequency is off by half the share of the energy that the basis lacks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.snapshots import dense_columns, project
from fenics_joints.structure.sparse import vectors_like

__all__ = ["SampledBasis", "lacking"]

#: Share of the largest energy below which a combination of the vectors is round-off.
_NOISE = 1e-12


class SampledBasis:
    """A basis that grows by what it lacks of each sample's modes. All calls are collective.

    Args:
        share: Share of a mode's energy, in its own sample, that may be lacking.
        vectors: What it starts from.
        known: The structure on these, if it is known: what is added costs much less.

    Attributes:
        vectors: The basis; independent, but not orthonormal.
    """

    def __init__(
        self, share: float, vectors: Sequence[PETSc.Vec] = (), known: ArrayModel | None = None
    ):
        self.share, self.known = share, known
        self.vectors = list(vectors)

    def add(self, modes: Modes, keep: Iterable[int], just_solved: bool = False) -> None:
        """Take modes in.

        Args:
            modes: Modes of the full model.
            keep: Which of them, by index.
            just_solved: Whether their solver has solved nothing since: it has the matrices then.
        """
        new = [modes.shapes[int(i)] for i in keep]
        if not new:
            return
        Z, n = dense_columns([*self.vectors, *new]), len(self.vectors)
        given, shift, blocks = modes.given, modes.solver.shift, (None, None)
        if self.known is not None:
            blocks = self.known.stiffness(given), self.known.mass(given)
        if just_solved and self.known is None:
            gram = project(modes.solver.shifted, Z)
        else:
            K, M = modes.model.stiffness(given), modes.model.mass(given)
            gram = project(K, Z, blocks[0]) - shift * project(M, Z, blocks[1])
            K.destroy(), M.destroy()
        size = np.sqrt(np.diag(gram))
        combine = lacking(gram / np.outer(size, size), n, self.share) / size[:, None]
        self.vectors += vectors_like(new[0], (Z.getDenseArray() @ combine).T)
        Z.destroy()


def lacking(gram: np.ndarray, n: int, share: float) -> np.ndarray:
    """Combinations of unit energy, as columns, of what the first n vectors lack of the others.

    Args:
        gram: Energies of vectors of unit energy, (n + k, n + k).
        n: Number of vectors in the basis.
        share: See `SampledBasis`.
    """
    values, vectors = np.linalg.eigh(gram[:n, :n])
    keep = values > _NOISE * values.max(initial=0.0)
    half = vectors[:, keep] / np.sqrt(values[keep])
    onto = half.T @ gram[:n, n:]
    left, turn = np.linalg.eigh(gram[n:, n:] - onto.T @ onto)
    turn = turn[:, left > share] / np.sqrt(left[left > share])
    return np.vstack([-half @ (onto @ turn), turn])
