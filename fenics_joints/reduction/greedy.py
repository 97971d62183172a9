"""A reduced model for a prior: sampled where an estimate of its own error is largest.

The error of a reduced frequency follows from its residual, without a full solution: for an
M-normalised Ritz vector x with r = K x - lambda M x, to first order the eigenvalue is too high by
r^T (K - lambda M)^+ r, which for what the basis lacks, high modes, is nearly r^T A^-1 r with
A = K + sigma M (Saad, Numerical Methods for Large Eigenvalue Problems, 2011, section 3.2.3, the
residual in the norm of the inverse). A is factorised once, at the start; elsewhere its inverse is
at most 1 / alpha times that, where alpha is the least ratio of the stiffnesses of what varies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from petsc4py import PETSc
from scipy.linalg import block_diag

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.affine import (
    POINT_MASS,
    SPRING,
    AffinePencil,
    RegionTerm,
    mass_term,
    spring_term,
)
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import SNAPSHOT, Points, Snapshots
from fenics_joints.reduction.matched import MatchedModes
from fenics_joints.reduction.reduced import Projection
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.components import number
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.structure.sparse import product, without_zeros

_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


class FreeTerms:
    """A `fenics_joints.structure.model.Model` of few parameters, with sparse matrices. Collective.

    Args:
        structure: The full model.
        free: Names of the parameters that vary.
        given: Values of all parameters that differ from their nominal value; those of ``free`` are
            where the model is assembled.

    Attributes:
        parameters: The free ones, with their values here.
        given: All parameters' values.

    Raises:
        InputError: If a name is unknown, a region that varies is graded, or a mass travels.
    """

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = False, False

    def __init__(self, structure: Structure, free: Sequence[str], given: Mapping[str, float]):
        self.full, self.comm, self.given = structure, structure.comm, structure.values(given)
        unknown = [name for name in free if name not in self.given]
        if unknown or not free:
            raise InputError(f"free = {list(free)}: expected some of: {', '.join(self.given)}.")
        self.parameters = {
            name: replace(structure.parameters[name], value=self.given[name]) for name in free
        }
        self.elastic_supports = structure.elastic_supports
        self.scale_hz = structure.dilation_frequency(self.given)
        self._volumes = structure.volumes()
        self._regions = [
            i for i, r in enumerate(structure.regions) if self._vary(r.properties.values())
        ]
        self._supports = [
            i for i, s in enumerate(structure.elastic_supports) if self._vary(s.properties.values())
        ]
        self._springs = [s for s in structure.springs if self._vary((s.stiffness,))]
        self._masses = [m for m in structure.masses if self._vary((m.mass, m.travel))]
        for mass in self._masses:
            if self._vary((mass.travel,)):
                raise InputError(f"{mass.travel}: expected parameters that are not places.")
        self._terms = self._scalars()
        self._K, self._M = structure.stiffness(self.given), structure.mass(self.given)
        self._stiff, self._mix = self._stiff_terms()
        #: By their number among the scalars of mass, those that vary.
        self._heavy = self._heavy_terms()
        stiff, heavy = self._factors(self.given)
        self._add(self._K, self._stiff, -stiff)
        self._add(self._M, self._heavy.values(), -heavy)
        self._lean_M = without_zeros(self._M)

    def _vary(self, values) -> bool:
        return any(isinstance(v, str) and v in self.parameters for v in values)

    # -- terms ---------------------------------------------------------------------------------

    def _scalars(self) -> AffinePencil:
        """What varies, on no basis: for its scalars."""
        full, none, regions = self.full, np.zeros((0, 0)), []
        laws = [(full.regions[i], full.regions[i].law) for i in self._regions]
        laws += [(full.elastic_supports[i], ELASTIC_SUPPORT) for i in self._supports]
        for owner, law in laws:
            if any(callable(p) for p in owner.properties.values()):
                raise InputError(
                    f"{owner.name}: a graded joint cannot be reduced; expected uniform properties."
                )
            q = {
                key: value if self._vary((value,)) else number(value, self.given)
                for key, value in owner.properties.items()
            }
            stiff = np.zeros((len(law.samples), 0, 0))
            regions.append(RegionTerm(owner.name, law, q, stiff, none, 0.0))
        springs = dict.fromkeys(s.stiffness for s in self._springs)
        masses = dict.fromkeys(m.mass for m in self._masses)
        return AffinePencil(
            self.parameters,
            regions,
            [
                *(spring_term(f"spring {name}", name, 1.0, none.ravel()) for name in springs),
                *(mass_term(f"mass {name}", name, 0.0, 1.0, None, none[None]) for name in masses),
            ],
        )

    def _stiff_terms(self) -> tuple[list[PETSc.Mat], np.ndarray]:
        """Matrices at the laws' samples and at units, and how much of each the scalars take."""
        full, matrices, mix = self.full, [], []
        for i in self._regions:
            law = full.regions[i].law
            matrices += [full.law_matrix(i, 0, k) for k in range(len(law.samples))]
            mix.append(np.linalg.inv([law.stiffness_terms(q) for q in law.samples]))
        for i in self._supports:
            matrices += full.support_matrices(i)
        springs = [t.properties["stiffness"] for t in self._terms.points if t.law is SPRING]
        matrices += [self._unit_spring(name) for name in springs]
        mix.append(np.eye(2 * len(self._supports) + len(springs)))
        return matrices, block_diag(*mix)

    def _heavy_terms(self) -> dict[int, PETSc.Mat]:
        found, owners = {}, self._terms.terms_by_law
        moving = self._terms.scalar_slopes(self.given)[1].any(axis=1)
        for row in np.flatnonzero(moving).tolist():
            law = owners[row].law
            if law is POINT_MASS:
                found[row] = self._unit_mass(owners[row].properties["mass"])
                continue
            found[row] = self.full.law_matrix(self._regions[row], 1, 0)
            found[row].scale(1 / law.inertia_term(law.samples[0]))
        return found

    def _factors(self, values) -> tuple[np.ndarray, np.ndarray]:
        """Numbers before the matrices of stiffness and of mass, (n,); (n, b) of values (b,)."""
        theta, rho = self._terms.scalars(values)
        return self._mix.T @ theta, rho[list(self._heavy)]

    def _of_points(self, like: PETSc.Mat, blocks: Iterable[tuple]) -> PETSc.Mat:
        """A matrix of blocks, (3, 3), at points alone."""
        A = like.duplicate(copy=False)
        A.zeroEntries()
        for point, block in blocks:
            self.full.add_point(A, point, block)
        return A

    def _unit_spring(self, name: str) -> PETSc.Mat:
        own = [s for s in self._springs if s.stiffness == name]
        return self._of_points(
            self._K, ((s.point, s.share * np.outer(s.direction, s.direction)) for s in own)
        )

    def _unit_mass(self, name: str) -> PETSc.Mat:
        own = [m for m in self._masses if m.mass == name]
        return self._of_points(
            self._M, ((self.full.place(m, self.given), m.share * np.eye(3)) for m in own)
        )

    @staticmethod
    def _add(A: PETSc.Mat, matrices: Iterable[PETSc.Mat], numbers: np.ndarray) -> None:
        for c, matrix in zip(numbers.tolist(), matrices, strict=True):
            A.axpy(c, matrix, _SUBSET)

    # -- the calls of a structure --------------------------------------------------------------

    @property
    def n_dofs(self) -> int:
        """As the structure's."""
        return self.full.n_dofs

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values."""
        return self.full.values({**self.given, **(given or {})})

    def stiffness(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """K(p), N/m; the caller's to destroy."""
        K = self._K.copy()
        self._add(K, self._stiff, self._factors(self.values(given))[0])
        return K

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """M(p), kg; the caller's to destroy."""
        M = self._M.copy()
        self._add(M, self._heavy.values(), self._factors(self.values(given))[1])
        return M

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """Of the structure where it was assembled, Hz: a scale, which need not follow."""
        return self.scale_hz

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """See `Structure.observe`."""
        return self.full.observe(shapes, sensors)

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """See `Structure.pencil_gradients`; by the free parameters."""
        columns = [list(self.full.parameters).index(name) for name in self.parameters]
        return self.full.pencil_gradients(shapes, eigenvalues, self.values(given))[:, columns]

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg."""
        return self.full.total_mass(self.values(given))

    # -- projection and residuals ----------------------------------------------------------------

    def on(self, basis: list[PETSc.Vec], sensors: Sensors | None) -> ArrayModel:
        """The model on a basis, as plain arrays, with what sensors see. Collective."""
        on = Projection(self.full, basis)
        regions = [self._region_on(on, n, i) for n, i in enumerate(self._regions)]
        own = self._terms.regions[len(regions) :]
        regions += [
            on.support(i, term.properties) for i, term in zip(self._supports, own, strict=True)
        ]
        still = [replace(m, travel=number(m.travel, self.given)) for m in self._masses]
        moving = AffinePencil(
            self.parameters,
            regions,
            [*(on.spring(s) for s in self._springs), *(on.mass(m) for m in still)],
        )
        rest = self.total_mass() - float(moving.total_mass(moving.values()))
        fixed = on.matrix(self._K), on.matrix(self._M)
        pencil = replace(moving, fixed=fixed, fixed_mass=rest)
        return ArrayModel(pencil, self.scale_hz, *on.sensors(sensors))

    def _region_on(self, on: Projection, n: int, i: int) -> RegionTerm:
        region, inertia, volume, term = self.full.regions[i], None, 0.0, self._terms.regions[n]
        sampled = [on.matrix(A) for A in self._stiff[self._terms.rows[region.name]]]
        if n in self._heavy:
            inertia, volume = on.matrix(self._heavy[n]), self._volumes[i]
        return on.region(region, term.properties, sampled, inertia, volume)

    def residuals(
        self, X: np.ndarray, eigenvalues: np.ndarray, points: Sequence[Mapping[str, float]]
    ) -> np.ndarray:
        """(K(p) - lambda M(p)) x of many vectors, each at its own values. Collective.

        Args:
            X: This rank's rows of the vectors, (n_local, k).
            eigenvalues: lambda of each, (k,).
            points: Parameter values of each, length k.

        Returns:
            This rank's rows, (n_local, k).
        """
        values = [self.values(p) for p in points]
        table = {name: np.array([v[name] for v in values]) for name in self.parameters}
        stiff, heavy = self._factors(table)
        total = product(self._K, X) - product(self._lean_M, X) * eigenvalues
        for matrix, row in zip(self._stiff, stiff, strict=True):
            total += product(matrix, X) * row
        for matrix, row in zip(self._heavy.values(), heavy, strict=True):
            total -= product(matrix, X) * (row * eigenvalues)
        return total


#: Share of the largest energy below which a direction is left out of the basis.
_BASIS = 1e-9
#: Points whose residuals are formed together; deformations whose stiffness ratio is looked at.
_CHUNK, _DIRECTIONS = 32, 40


class GreedyModel(MatchedModes):
    """A reduced model in a few parameters, and the full one. All calls are collective.

    Args:
        full: The full model.
        start: Values of all its parameters.
        free: Names of those that vary.
        progress: Told of every solution of the full model.
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
        """See `MatchedModes.solve`."""
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
