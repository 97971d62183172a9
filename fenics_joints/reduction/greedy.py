"""A reduced model for a prior: sampled where an estimate of its own error is largest.

The error of a reduced frequency follows from its residual, without a full solution: for an
M-normalised Ritz vector x with r = K x - lambda M x, to first order the eigenvalue is too high by
r^T (K - lambda M)^+ r, which for what the basis lacks, high modes, is nearly r^T A^-1 r with
A = K + sigma M (Saad, Numerical Methods for Large Eigenvalue Problems, 2011, section 3.2.3, the
residual in the norm of the inverse). A is factorised once, at the start; elsewhere its inverse is
at most 1 / alpha times that, where alpha is the least ratio of the stiffnesses of what varies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.free_terms import FreeTerms
from fenics_joints.reduction.seen import SeenModes
from fenics_joints.reduction.snapshots import SNAPSHOT, Snapshots
from fenics_joints.structure.structure import Structure

#: Share of the largest energy below which a direction is left out of the basis.
_BASIS = 1e-9
#: Points whose residuals are formed together; deformations whose stiffness ratio is looked at.
_CHUNK, _DIRECTIONS = 32, 40


class GreedyModel(SeenModes):
    """A reduced model in a few parameters, and the full one. All calls are collective.

    Args:
        full: The full model.
        start: Values of all its parameters.
        free: Names of those that vary.
        progress: Told of every solution of the full model.
        given: See `SeenModes`.
    """

    tolerance = SNAPSHOT

    def __init__(
        self,
        full: Structure,
        start: Mapping[str, float],
        free: Sequence[str],
        *,
        progress: Progress | None = None,
        **given,
    ):
        self.terms = FreeTerms(full, free, start)
        self.start = {name: p.value for name, p in self.terms.parameters.items()}
        self.progress = progress or Progress(silent=True)
        self.progress.step("reduced model: the start")
        super().__init__(self.terms, self.start, **given)
        # A solver of its own: the start's keeps its factorisation, for the residuals.
        self._solver = None
        self._snapshots = Snapshots(self.terms)
        self._add(self.nominal, np.arange(self.nominal.n_rigid))
        self._build()

    def solve(self, values: Mapping[str, float]) -> Modes:
        """See `SeenModes.solve`."""
        if not self.is_solved(values):
            self.progress.advance()
        return super().solve(values)

    def extend(self, points: Points) -> None:
        """Take modes of the full model into the basis."""
        new = [values for values in points if not self.is_solved(values)]
        if new:
            self.progress.step("reduced model: sampling the prior", len(new))
        for values in points:
            self._add(self.solve(values))
        self._solved.clear()
        self._build()

    def _add(self, modes: Modes, rigid: Sequence[int] = ()) -> None:
        self._snapshots.add(modes, [*rigid, *self._seen(modes)])

    def _build(self) -> None:
        self.basis = self._snapshots.basis(_BASIS)
        model = self.terms.on(self.basis, self.sensors)
        self.forward, self._softened = self._forward(model), _Softened(model, self.start)
        self.forward.n_modes = min(self.forward.n_modes, model.n_dofs)

    def errors(self, points: Points) -> np.ndarray:
        """Estimated relative error of the worst frequency at each point, (n,).

        nan where the reduced model lacks a mode that the test saw.
        """
        return np.concatenate(
            [self._errors(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
        )

    def _errors(self, points) -> np.ndarray:
        columns, eigenvalues, where = [], [], []
        for i, values in enumerate(points):
            modes = solve_modes(self.forward.model, values, n_modes=self.forward.n_modes)
            try:
                pairing = self.forward.paired(modes)
            except InputError:
                continue
            columns.append(modes.shapes[:, pairing.index])
            eigenvalues.append(modes.eigenvalues[pairing.index])
            where += [i] * self.n_test
        found = np.full(len(points), np.nan)
        if not where:
            return found
        lam = np.concatenate(eigenvalues)
        Z = np.array([vector.array_r for vector in self.basis]).T
        R = self.terms.residuals(Z @ np.hstack(columns), lam, [points[i] for i in where])
        squares = self.terms.comm.allreduce(np.sum(R * self.nominal.solver.inverse(R), axis=0))
        worst = np.max((squares / (2 * lam)).reshape(-1, self.n_test), axis=1)
        for i, error in zip(where[:: self.n_test], worst, strict=True):
            found[i] = error / self._softened(points[i])
        return found


class _Softened:
    """Least ratio of the stiffness of what varies at given values to that at the start, at most 1.

    A layer's ratio is that of its least favourable strain, looked for among the basis's stiffest
    deformations of it.
    """

    def __init__(self, model: ArrayModel, start: Mapping[str, float]):
        self.springs = [(s.stiffness, start[s.stiffness]) for s in model.pencil.springs]
        self.regions = []
        for region in model.pencil.regions:
            sizes, vectors = np.linalg.eigh(model.region_stiffness(region.name, start))
            keep = np.flatnonzero(sizes > 1e-8 * sizes[-1])[-_DIRECTIONS:]
            white = vectors[:, keep] / np.sqrt(sizes[keep])
            self.regions.append((region, white.T @ region.stiffness @ white))

    def __call__(self, values: Mapping[str, float]) -> float:
        ratios = [1.0, *(values[name] / at for name, at in self.springs)]
        for region, terms in self.regions:
            theta = region.law.stiffness_terms(region.values(values))
            ratios.append(np.linalg.eigvalsh(np.tensordot(theta, terms, axes=1))[0])
        return max(float(min(ratios)), 1e-6)
