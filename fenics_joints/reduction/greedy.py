"""A reduced model for a prior, sampled where an estimate of its own error is largest.

The error of a reduced frequency follows from its residual, without a full solution. For an
M-normalised Ritz vector x with r = K x - lambda M x, to first order the eigenvalue is too high by
r^T (K - lambda M)^+ r. For the high modes that the basis lacks this is nearly r^T A^-1 r with
A = K + sigma M (Saad, Numerical Methods for Large Eigenvalue Problems, 2011, section 3.2.3, the
residual in the norm of the inverse). A is factorised once, at the start; elsewhere its inverse is
at most 1 / alpha times that, where alpha is the least ratio of the stiffnesses of what varies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import singledispatch

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel, freeze
from fenics_joints.reduction.basis import SNAPSHOT, Points, Snapshots
from fenics_joints.reduction.matched import MatchedModes
from fenics_joints.reduction.reduced import Projection, is_graded
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.components import slopes
from fenics_joints.structure.sparse import MatrixForm, RowForm, as_columns, product


class FreePencil:
    """K(p) and M(p) of a structure as functions of few of its parameters. Collective.

    Both are their values at ``given`` plus changes of the components that name these parameters.

    Args:
        structure: The full model.
        free: Names of the parameters that vary.
        given: Values of all parameters, or of those that differ from their nominal value.

    Attributes:
        given: All parameters' values.
        K: Stiffness there.
        M: Mass there.
        terms: K(p) and M(p) on the basis of the last call of `on`.

    Raises:
        InputError: If a name is unknown, a region that varies is graded, or a place varies.
    """

    def __init__(self, structure: Structure, free: Sequence[str], given: Mapping[str, float]):
        self.full, self.free, self.given = structure, list(free), structure.values(given)
        unknown = [name for name in free if name not in self.given]
        if unknown or not free:
            raise InputError(f"free = {list(free)}: expected some of: {', '.join(self.given)}.")
        for mass in structure.masses:
            if self._varies(mass.travel):
                raise InputError(f"{mass.travel}: expected parameters that are not places.")
        self.K, self.M = structure.stiffness(self.given), structure.mass(self.given)
        #: Of each term that has stiffness its scalars' shares in matrices, and these.
        self._stiff: list[tuple[np.ndarray, list[MatrixForm | RowForm]]] = []
        #: Of each term what its mass multiplies; None where that does not vary.
        self._heavy: list[MatrixForm | RowForm | None] = []
        self._take_regions()
        self._take_points()

    def _varies(self, *values: object) -> bool:
        return any(isinstance(v, str) and v in self.free for v in values)

    def _take_regions(self) -> None:
        """Matrices of parts and joints at their laws' samples, and of supports at units."""
        full = self.full
        for i, region in enumerate(full.regions):
            if not self._varies(*region.properties.values()):
                continue
            if is_graded(region):
                raise InputError(
                    f"{region.name}: a graded joint cannot be reduced; expected uniform properties."
                )
            law, samples = region.law, region.law.samples
            shares = np.linalg.inv([law.stiffness_terms(q) for q in samples]).T
            stiff = [MatrixForm(full.law_matrix(i, 0, k), True) for k in range(len(samples))]
            self._stiff.append((shares, stiff))
            q = full.field.region_values(i, self.given)
            named = [key for key, name in region.properties.items() if self._varies(name)]
            self._heavy.append(None)
            if any(slopes(law.inertia_term, q, key) for key in named):
                heavy = full.law_matrix(i, 1, 0)
                heavy.scale(1 / law.inertia_term(samples[0]))
                self._heavy[-1] = MatrixForm(heavy, True)
        for i, support in enumerate(full.elastic_supports):
            if self._varies(*support.properties.values()):
                self._stiff.append((np.eye(2), [MatrixForm(A) for A in full.support_matrices(i)]))
                self._heavy.append(None)

    def _take_points(self) -> None:
        """Rows of springs and point masses."""
        full = self.full
        for spring in full.springs:
            if self._varies(spring.stiffness):
                at = full.loads(Sensors(spring.point, spring.direction))
                self._stiff.append((np.eye(1), [RowForm(at, at, spring.share, full.comm)]))
                self._heavy.append(None)
        for mass in full.masses:
            if self._varies(mass.mass):
                at, _ = full.mass_rows(mass, self.given)
                self._heavy.append(RowForm(at, at, mass.share, full.comm))

    def on(self, basis: list[PETSc.Vec], sensors: Sensors | None) -> ArrayModel:
        """The model on a basis, as plain arrays, with what sensors see. Collective.

        It has all of the structure's parameters, of which those that do not vary change nothing.
        """
        on = Projection(self.full, basis)
        pencil = on.pencil(free=self.free, given=self.given)
        K, M = pencil.assemble(self.given)
        self.terms = replace(
            pencil,
            fixed=(on.matrix(self.K) - K, on.matrix(self.M) - M),
            fixed_mass=self.full.total_mass(self.given) - float(pencil.total_mass(self.given)),
        )
        scale_hz = self.full.dilation_frequency(self.given)
        return ArrayModel(self.terms, scale_hz, *on.sensors(sensors))

    def residuals(
        self, X: np.ndarray, eigenvalues: np.ndarray, points: Sequence[Mapping[str, float]]
    ) -> np.ndarray:
        """(K(p) - lambda M(p)) x of many vectors, each at its own values, after `on`. Collective.

        Args:
            X: This rank's rows of the vectors, (n_local, k).
            eigenvalues: lambda of each, (k,).
            points: Values of the parameters that vary of each, length k.

        Returns:
            This rank's rows, (n_local, k).
        """
        here = {name: np.full(len(points), value) for name, value in self.given.items()}
        there = here | {name: np.array([p[name] for p in points]) for name in self.free}
        stiff, heavy = self.terms.change(here, there)
        total = product(self.K, X) - product(self.M, X) * eigenvalues
        for shares, forms in self._stiff:
            rows, stiff = np.split(stiff, [len(forms)])
            for form, row in zip(forms, shares @ rows, strict=True):
                total += (form @ X) * row
        for form, row in zip(self._heavy, heavy, strict=True):
            if form is not None:
                total -= (form @ X) * (row * eigenvalues)
        return total


@singledispatch
def free_pencil(full, free: Sequence[str], given: Mapping[str, float]) -> FreePencil:
    """K(p) and M(p) of a structure in some of its parameters. Collective."""
    return FreePencil(full, free, given)


#: Share of the largest energy below which a direction is left out of the basis: chosen.
_BASIS = 1e-9
#: Points whose residuals are formed together: chosen, for memory.
_CHUNK = 32
#: Deformations of a layer whose stiffness ratio is found: chosen.
_DIRECTIONS = 40


class GreedyModel(MatchedModes):
    """A reduced model in a few parameters, and the full one. All calls are collective.

    Args:
        full: The full model.
        start: Values of all its parameters.
        free: Names of those that vary.
        progress: Advanced at every solution of the full model.
        given: See `MatchedModes`.
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
        self.terms = free_pencil(full, free, start)
        self.progress = progress or Progress(silent=True)
        self.progress.step("reduced model: the start")
        super().__init__(full, self.terms.given, **given)
        # The start's solver keeps its factorisation for the residuals: take another one.
        self._solver = None
        self._snapshots = Snapshots(full)
        self._add(self.nominal, np.arange(self.nominal.n_rigid))
        self._build()

    def solve(self, values: Mapping[str, float]) -> Modes:
        """See `MatchedModes.solve`."""
        if not self.is_solved(values):
            self.progress.advance()
        return super().solve(self.terms.given | dict(values))

    def is_solved(self, values: Mapping[str, float]) -> bool:
        """See `MatchedModes.is_solved`."""
        return super().is_solved(self.terms.given | dict(values))

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
        whole, given = self.terms.on(self.basis, self.sensors), self.terms.given
        model = freeze(whole, self.terms.free, given)
        self.forward, self._softened = self._forward(model), _Softened(whole, given)
        self.forward.n_modes = min(self.forward.n_modes, model.n_dofs)

    def errors(self, points: Points) -> np.ndarray:
        """Estimated relative error of the worst frequency at each point, (n,).

        nan where the reduced model lacks a mode that the test saw.
        """
        return np.concatenate(
            [self._errors(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
        )

    def _errors(self, points) -> np.ndarray:
        shapes, eigenvalues, where = [], [], []
        for i, values in enumerate(points):
            modes = solve_modes(self.forward.model, values, n_modes=self.forward.n_modes)
            try:
                pairing = self.forward.paired(modes)
            except InputError:
                continue
            shapes.append(modes.shapes[:, pairing.index])
            eigenvalues.append(modes.eigenvalues[pairing.index])
            where += [i] * self.n_test
        found = np.full(len(points), np.nan)
        if not where:
            return found
        lam = np.concatenate(eigenvalues)
        R = self.terms.residuals(
            as_columns(self.basis) @ np.hstack(shapes), lam, [points[i] for i in where]
        )
        squares = self.full.comm.allreduce(np.sum(R * self.nominal.solver.inverse(R), axis=0))
        worst = np.max((squares / (2 * lam)).reshape(-1, self.n_test), axis=1)
        for i, error in zip(where[:: self.n_test], worst, strict=True):
            found[i] = error / self._softened(self.terms.given | dict(points[i]))
        return found


class _Softened:
    """Least ratio of the varying regions' stiffness to that at the start, at most 1.

    A layer's ratio is the least over its deformations, of which the basis's stiffest are taken.
    """

    def __init__(self, model: ArrayModel, start: Mapping[str, float]):
        self.regions = []
        for region in model.pencil.terms_by_law:
            if not len(region.stiffness):
                continue
            theta = region.law.stiffness_terms(region.values(start))
            sizes, vectors = np.linalg.eigh(np.tensordot(theta, region.stiffness, axes=1))
            keep = np.flatnonzero(sizes > 1e-8 * sizes[-1])[-_DIRECTIONS:]
            white = vectors[:, keep] / np.sqrt(sizes[keep])
            self.regions.append((region, white.T @ region.stiffness @ white))

    def __call__(self, values: Mapping[str, float]) -> float:
        ratios = [1.0]
        for region, terms in self.regions:
            theta = region.law.stiffness_terms(region.values(values))
            ratios.append(np.linalg.eigvalsh(np.tensordot(theta, terms, axes=1))[0])
        return max(float(min(ratios)), 1e-6)
