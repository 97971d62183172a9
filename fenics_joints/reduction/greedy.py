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
from fenics_joints.measurements.gap import pair_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.free_terms import FreeTerms
from fenics_joints.reduction.snapshots import SNAPSHOT, Snapshots
from fenics_joints.structure.points import Sensors

__all__ = ["GreedyModel"]

#: Least visibility of a mode that enters the basis, and modes beyond the test's.
_SEEN, _SPARE = 0.05, 3
#: Share of the largest energy below which a direction is left out of the basis.
_BASIS = 1e-9
#: Points whose residuals are formed together; deformations whose stiffness ratio is looked at.
_CHUNK, _DIRECTIONS = 32, 40


class GreedyModel:
    """A reduced model, and the full one it is made of. All calls are collective.

    Args:
        terms: The full model.
        sensors: What the test saw; None takes elastic modes in order.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes of the full model at a sample.
        shapes: Measured shapes at the sensors, to match modes to by MAC; the shapes at the start
            take their place where there are none.

    Attributes:
        nominal: Modes of the full model at the start.
        forward: Frequencies of the reduced model.
    """

    def __init__(
        self,
        terms: FreeTerms,
        *,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        shapes: np.ndarray | None = None,
    ):
        self.terms, self.sensors, self.n_test, self.n_modes = terms, sensors, n_test, n_modes
        self.start = {name: p.value for name, p in terms.parameters.items()}
        self.nominal = solve_modes(terms, self.start, n_modes=n_modes)
        pairing = pair_modes(self.nominal, n_test, sensors, reference=shapes)
        self.reference = pairing.shapes if shapes is None else shapes
        self._solver = None
        self._snapshots = Snapshots(terms)
        self.add([self.nominal])

    def solve(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model."""
        # A solver of its own: the start's keeps its factorisation, for the residuals.
        found = solve_modes(
            self.terms, values, n_modes=self.n_modes, solver=self._solver, tolerance=SNAPSHOT
        )
        self._solver = found.solver
        return found

    def log_f(self, modes: Modes) -> np.ndarray:
        """ln f of the test's modes, (n_test,); nan where they are not all there."""
        try:
            pairing = pair_modes(modes, self.n_test, self.sensors, reference=self.reference)
        except InputError:
            return np.full(self.n_test, np.nan)
        return np.log(modes.frequencies_hz[pairing.index])

    def add(self, modes: Sequence[Modes]) -> None:
        """Take modes of the full model into the basis."""
        for each in modes:
            index = np.arange(len(each))
            rigid, keep = index[: each.n_rigid] if each is self.nominal else [], index
            if self.sensors is not None:
                keep = index[each.visibility(self.sensors) > _SEEN]
            keep = keep[keep >= each.n_rigid]
            if self.sensors is not None:
                keep = keep[: self.n_test + _SPARE]
            self._snapshots.add(each, [*rigid, *keep])
        self.basis = self._snapshots.basis(_BASIS)
        model = self.terms.on(self.basis, self.sensors)
        enough = self.n_modes if self.sensors is None else 6 + 3 * self.n_test + _SPARE
        self.forward = Forward(
            model, self.sensors, self.n_test, min(enough, model.n_dofs), self.reference
        )
        self._softened = _Softened(model, self.start)

    def errors(self, points: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Estimated relative error of the worst frequency at each point, (n,).

        nan where the reduced model lacks a mode that the test saw.
        """
        return np.concatenate([
            self._errors(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)
        ])  # fmt: skip

    def _errors(self, points) -> np.ndarray:
        columns, eigenvalues, where = [], [], []
        for i, values in enumerate(points):
            modes = solve_modes(self.forward.model, values, n_modes=self.forward.n_modes)
            try:
                pairing = pair_modes(modes, self.n_test, self.sensors, reference=self.reference)
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
        squares = self.terms.sums(np.sum(R * self.nominal.solver.inverse(R), axis=0))
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
            q = region.values(start)
            here = np.tensordot(region.law.stiffness_terms(q), region.stiffness, axes=1)
            sizes, vectors = np.linalg.eigh(here)
            keep = np.flatnonzero(sizes > 1e-8 * sizes[-1])[-_DIRECTIONS:]
            white = vectors[:, keep] / np.sqrt(sizes[keep])
            self.regions.append((region, white.T @ region.stiffness @ white))

    def __call__(self, values: Mapping[str, float]) -> float:
        ratios = [1.0, *(values[name] / at for name, at in self.springs)]
        for region, terms in self.regions:
            theta = region.law.stiffness_terms(region.values(values))
            ratios.append(np.linalg.eigvalsh(np.tensordot(theta, terms, axes=1))[0])
        return max(float(min(ratios)), 1e-6)
