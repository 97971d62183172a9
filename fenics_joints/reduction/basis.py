"""Bases from samples of a structure's parameters: orthonormal vectors, and their residuals.

A proper orthogonal decomposition in the energy of one sample drops motions with little energy
there. Where the joint is stiff in that sample, modes of a soft joint are nearly all opening and
slip, and the bending of the parts in them is lost. A `SampledBasis` measures each mode by the
energy of its own sample: by Rayleigh's principle a frequency is off by half the share of the energy
that the basis lacks.

A model whose error is too large somewhere is extended by the points at which it is worst: the weak
greedy algorithm of reduced bases (Binev et al., SIAM J. Math. Anal. 43, 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure.sparse import as_columns, project, vectors_like
from fenics_joints.structure.structure import Structure

#: Parameter values.
Points = Sequence[Mapping[str, float]]


class SmallModel(Protocol):
    """A model that knows its error and can be extended; an exact one has neither."""

    def errors(self, points: Points) -> np.ndarray:
        """Error at points, (n,), equal on all ranks; nan where it is not defined. Collective."""

    def extend(self, points: Points) -> None:
        """Take in the exact solutions at points. Collective."""


def weak_greedy(
    model: SmallModel,
    points: Callable[[], Points],
    limit: float,
    rounds: int,
    *,
    most: int | None = None,
    least: float = 0.0,
    after: Callable[[], None] | None = None,
) -> np.ndarray:
    """Extend a model where it is worst, until it is good enough. Collective.

    Args:
        model: The model.
        points: Gives the points of a round, such as the optima of fits to the model.
        limit: Error that is good enough.
        rounds: How often the error is found; after the last time nothing is added.
        most: How many points of a round are added at most; all by default.
        least: Share of the limit below which a point is not worth adding.
        after: Called after each extension.

    Returns:
        The errors at the last points, (n,).
    """
    for left in reversed(range(rounds)):
        at = points()
        # A point at which the model lacks the test's modes says nothing of the others.
        errors = np.nan_to_num(model.errors(at))
        if not left or errors.max(initial=0.0) <= limit:
            break
        worst = np.argsort(errors)[::-1][:most]
        model.extend([at[i] for i in worst if errors[i] > least * limit])
        if after is not None:
            after()
    return errors


#: Tolerance of modes that span a basis; their own error matters by its square.
SNAPSHOT = 1e-4
#: Share of the largest energy below which a direction among the rigid-body modes is round-off.
_RIGID = 1e-10


class Snapshots:
    """Modes and further vectors at samples of the parameters, of which a basis is made.

    Args:
        structure: The full model.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self._rigid: list[PETSc.Vec] = []
        self._others: list[PETSc.Vec] = []
        self._first: Mapping[str, float] | None = None

    def add(
        self, modes: Modes, keep: Iterable[int] | None = None, more: np.ndarray | None = None
    ) -> None:
        """Take modes in.

        Args:
            modes: Modes of the structure.
            keep: Which of them, by index; all by default.
            more: This rank's rows of further vectors, (n_local, k).
        """
        self._first = modes.given if self._first is None else self._first
        for i in range(len(modes)) if keep is None else keep:
            (self._rigid if i < modes.n_rigid else self._others).append(modes.shapes[int(i)])
        if more is not None:
            self._others += vectors_like(modes.shapes[0], more.T)

    def basis(self, tolerance: float) -> list[PETSc.Vec]:
        """Orthonormal vectors that span all of them. Collective.

        Args:
            tolerance: Directions with less than this share of the largest energy are left out.

        Raises:
            InputError: Without any.
        """
        if not self._rigid and not self._others:
            raise InputError("samples: expected at least one set of parameter values.")
        full, given, whole = self.structure, self._first, []
        # Truncated rigid motions would no longer be rigid. They are the same in all samples, except
        # that soft springs may mix them.
        if self._rigid:
            whole = orthonormal(full, self._rigid, given, _RIGID, only_mass=True)
        if not self._others:
            return whole
        return orthonormal(full, [*whole, *self._others], given, tolerance, len(whole))


def orthonormal(
    structure: Structure,
    snapshots: list[PETSc.Vec],
    given: Mapping[str, float] | None,
    tolerance: float,
    whole: int = 0,
    only_mass: bool = False,
    known: ArrayModel | None = None,
) -> list[PETSc.Vec]:
    """Snapshots made orthonormal in the energy of one sample, without the dependent ones.

    The first ``whole`` of them are kept, and the others made orthogonal to them. Collective.

    Args:
        structure: The structure.
        snapshots: The vectors.
        given: The sample.
        tolerance: Directions with less than this share of the largest energy are left out.
        whole: See above.
        only_mass: Whether the energy is that of the mass alone.
        known: The structure on the first ``whole``, which are then left as they are; None to make
            them orthonormal too.
    """
    # The energy of a nearly rigid support would hide how the snapshots differ elsewhere.
    soft = [k for s in structure.elastic_supports for k in (s.k_n, s.k_t) if isinstance(k, str)]
    given = {**(given or {}), **dict.fromkeys(soft, 0.0)}
    K, M = structure.stiffness(given), structure.mass(given)
    Z = as_columns(snapshots)
    blocks = (None, None) if known is None else (known.stiffness(given), known.mass(given))
    stiff, heavy = project(K, Z, blocks[0]), project(M, Z, blocks[1])
    K.destroy(), M.destroy()
    scale = np.trace(stiff) / np.trace(heavy)
    # Rigid motions have no strain energy but round-off, which may be negative: use their mass.
    gram = heavy if only_mass else stiff + scale * heavy
    norms = np.sqrt(np.diag(gram))
    gram = gram / np.outer(norms, norms)
    first, rest = slice(0, whole), slice(whole, None)
    onto = np.linalg.solve(gram[first, first], gram[first, rest])
    values, vectors = np.linalg.eigh(gram[rest, rest] - gram[rest, first] @ onto)
    # New vectors may all be small beside the first: the sum of all energies is their number.
    keep = values > tolerance * (values[-1] if known is None else len(gram))
    rest_vectors = vectors[:, keep] / np.sqrt(values[keep])
    combine = np.zeros((len(gram), whole + int(keep.sum())))
    combine[first, first] = np.linalg.inv(np.linalg.cholesky(gram[first, first])).T
    combine[first, rest], combine[rest, rest] = -onto @ rest_vectors, rest_vectors
    combine /= norms[:, None]
    left = 0 if known is None else whole
    made = vectors_like(snapshots[0], (Z @ combine[:, left:]).T)
    return [*snapshots[:left], *made]


#: Share of the largest energy below which a combination of the vectors is round-off.
_NOISE = 1e-12


class SampledBasis:
    """A basis that grows by the residuals of each sample's modes. All calls are collective.

    Args:
        share: Share of a mode's energy, in its own sample, that may be lacking.
        vectors: The first vectors of the basis.
        known: The structure projected on these vectors, if known: then adding costs much less.

    Attributes:
        vectors: The basis; independent, but not orthonormal.
    """

    def __init__(
        self, share: float, vectors: Sequence[PETSc.Vec] = (), known: ArrayModel | None = None
    ):
        self.share, self.known = share, known
        self.vectors = list(vectors)

    def add(self, modes: Modes, keep: Iterable[int]) -> None:
        """Take modes of the full model in, those with an index in ``keep``."""
        self.take(modes.shapes[0], self.lacked(modes, keep))

    def take(self, like: PETSc.Vec, rows: np.ndarray) -> None:
        """Take vectors in, given by this rank's rows, (k, n_local), laid out like one."""
        self.vectors += vectors_like(like, rows)

    def lacked(self, modes: Modes, keep: Iterable[int], just_solved: bool = False) -> np.ndarray:
        """What the basis lacks of modes, this rank's rows, (k, n_local).

        Args:
            modes: Modes of the full model.
            keep: Which of them, by index.
            just_solved: Whether their solver has solved nothing since: it has the matrices then.
        """
        n, new = len(self.vectors), [modes.shapes[int(i)] for i in keep]
        if not new:
            return np.empty((0, modes.shapes[0].getLocalSize()))
        Z = as_columns([*self.vectors, *new])
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
        combine = residual_directions(gram / np.outer(size, size), n, self.share) / size[:, None]
        return (Z @ combine).T


def residual_directions(gram: np.ndarray, n: int, share: float) -> np.ndarray:
    """Combinations of unit energy, as columns, that span what the first n vectors lack of the rest.

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


def pod(
    model: ArrayModel, snapshots: np.ndarray, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Vectors that hold most of the snapshots' energy, best first.

    Args:
        model: The model that the snapshots are of.
        snapshots: As columns, shape (n_dofs, n).
        weights: Of the snapshots, shape (n,); equal by default.

    Returns:
        Vectors orthonormal in the energy of K + omega^2 M at nominal values, (n_dofs, k), and their
        singular values, (k,).
    """
    K, M = model.stiffness(), model.mass()
    upper = np.linalg.cholesky(K + np.trace(K) / np.trace(M) * M).T
    energetic = upper @ snapshots
    energetic *= (1.0 if weights is None else weights) / np.linalg.norm(energetic, axis=0)
    left, sizes, _ = np.linalg.svd(energetic, full_matrices=False)
    return np.linalg.solve(upper, left), sizes
