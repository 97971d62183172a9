"""Vectors that hold modes from samples of a structure's parameters, each to its own energy.

A proper orthogonal decomposition in the energy of one sample leaves out what is small there: beside
a joint that is stiff in it, modes with a soft joint are nearly all opening and slip, and what they
bend of the parts is lost. Here a mode is held as well as the energy of its own sample asks for: by
Rayleigh's principle a frequency is off by half the share of the energy that the basis lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.modes import SHIFT_SHARE, Modes
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.snapshots import dense_columns, project
from fenics_joints.structure.sparse import vectors_like

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
        if just_solved:
            known = None if self.known is None else blocks[0] - shift * blocks[1]
            gram = project(modes.solver.shifted, Z, known)
        else:
            K, M = modes.model.stiffness(given), modes.model.mass(given)
            gram = project(K, Z, blocks[0]) - shift * project(M, Z, blocks[1])
            K.destroy(), M.destroy()
        size = np.sqrt(np.diag(gram))
        combine = _lacking(gram / np.outer(size, size), n, self.share) / size[:, None]
        self.vectors += vectors_like(new[0], (Z.getDenseArray() @ combine).T)
        Z.destroy()


def _lacking(gram: np.ndarray, n: int, share: float) -> np.ndarray:
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


def condensed(
    forward: Forward, samples: Points, keep: Callable[[Modes], np.ndarray], share: float
) -> np.ndarray:
    """Vectors that hold the modes of a model at samples, each to its own energy, (n_dofs, k).

    As `SampledBasis`, of a model of plain arrays. Orthonormal in the energy of the first sample.

    Args:
        forward: Of the model.
        samples: Parameter values; where the model lacks what the test saw they are passed over.
        keep: Which modes are held, by index.
        share: Share of a mode's energy, in its own sample, that may be lacking.
    """
    model = forward.model
    shift = (2 * np.pi * SHIFT_SHARE * model.scale_hz) ** 2
    basis = np.zeros((model.n_dofs, 0))
    for values in samples:
        try:
            modes, _ = forward.solve(values)
        except (InputError, ConvergenceError):
            continue
        Z, n = np.hstack([basis, modes.shapes[:, keep(modes)]]), basis.shape[1]
        gram = Z.T @ (model.stiffness(values) @ Z + shift * (model.mass(values) @ Z))
        size = np.sqrt(np.diag(gram))
        combine = _lacking(gram / np.outer(size, size), n, share) / size[:, None]
        basis = np.hstack([basis, Z @ combine])
    if not basis.shape[1]:
        return np.eye(model.n_dofs)
    energy = model.stiffness(samples[0]) + shift * model.mass(samples[0])
    values, turn = scipy.linalg.eigh(basis.T @ energy @ basis)
    kept = values > 1e-12 * values[-1]
    return basis @ (turn[:, kept] / np.sqrt(values[kept]))
