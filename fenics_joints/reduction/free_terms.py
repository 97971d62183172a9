"""A structure of which a few parameters vary: K(p) and M(p) as sums of matrices assembled once.

Sampling asks for hundreds of full solutions and thousands of residuals in which only a joint's
moduli differ. Here they cost sums of sparse matrices, and a projection on a basis costs products
with the terms that vary instead of an assembly of every part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.reduction.affine import AffinePencil, RegionTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.projection import Projection
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.sparse import without_zeros
from fenics_joints.structure.structure import Structure
from fenics_joints.structure.values import number, slopes

__all__ = ["FreeTerms"]

_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


@dataclass(frozen=True, eq=False)
class _Terms:
    """Matrices, and the numbers before them at all parameters' values."""

    matrices: list[PETSc.Mat]
    numbers: Callable[[Mapping[str, float]], np.ndarray]


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
        self.full, self.given = structure, structure.values(given)
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
            i for i, s in enumerate(structure.elastic_supports) if self._vary((s.k_n, s.k_t))
        ]
        self._springs = [s for s in structure.springs if self._vary((s.stiffness,))]
        self._masses = [m for m in structure.masses if self._vary((m.mass, m.travel))]
        for mass in self._masses:
            if self._vary((mass.travel,)):
                raise InputError(f"{mass.travel}: expected parameters that are not places.")
        self._K, self._M = structure.stiffness(self.given), structure.mass(self.given)
        #: Mass of a region at a unit of its law's inertia, where it varies.
        self._inertia: dict[int, PETSc.Mat] = {}
        self._stiff, self._heavy = self._stiff_terms(), self._heavy_terms()
        for rest, terms in ((self._K, self._stiff), (self._M, self._heavy)):
            self._add(rest, terms, self.given, -1.0)
        self._lean_M = without_zeros(self._M)

    def _vary(self, values) -> bool:
        return any(isinstance(v, str) and v in self.parameters for v in values)

    # -- terms ---------------------------------------------------------------------------------

    def _stiff_terms(self) -> list[_Terms]:
        full = self.full
        found = [self._region_terms(i) for i in self._regions]
        for i in self._supports:
            support = full.elastic_supports[i]
            found.append(_Terms(
                list(full.support_matrices(i)),
                lambda v, s=support: np.array([number(s.k_n, v), number(s.k_t, v)]),
            ))  # fmt: skip
        for name in {s.stiffness for s in self._springs}:
            unit = self._difference(self._K, full.stiffness, name)
            found.append(_Terms([unit], lambda v, name=name: np.array([v[name]])))
        return found

    def _region_terms(self, i: int) -> _Terms:
        """The region's stiffness at its law's samples, and how much of each a value takes."""
        region, law = self.full.regions[i], self.full.regions[i].law
        if any(callable(p) for p in region.properties.values()):
            raise InputError(
                f"{region.name}: a graded joint cannot be reduced; expected uniform properties."
            )
        matrices = [self._held(self.full.region_matrices(i, q)[0]) for q in law.samples]
        inverse = np.linalg.inv([law.stiffness_terms(q) for q in law.samples])

        def numbers(values):
            return law.stiffness_terms(self._properties(i, values)) @ inverse

        return _Terms(matrices, numbers)

    def _heavy_terms(self) -> list[_Terms]:
        found = []
        for i in self._regions:
            law = self.full.regions[i].law
            if not self._heavy_varies(i):
                continue
            matrix = self._held(self.full.region_matrices(i, law.samples[0])[1])
            matrix.scale(1 / law.inertia_terms(law.samples[0])[0])
            self._inertia[i] = matrix

            def numbers(values, i=i, law=law):
                return law.inertia_terms(self._properties(i, values))[:1]

            found.append(_Terms([matrix], numbers))
        for name in {m.mass for m in self._masses}:
            unit = self._difference(self._M, self.full.mass, name)
            found.append(_Terms([unit], lambda v, name=name: np.array([v[name]])))
        return found

    def _heavy_varies(self, i: int) -> bool:
        """Whether the region's mass depends on what is free."""
        region, q = self.full.regions[i], self._properties(i, self.given)
        return any(
            np.any(slopes(region.law.inertia_terms, q, key))
            for key, value in region.properties.items()
            if self._vary((value,))
        )

    def _properties(self, i: int, values) -> dict[str, float]:
        region = self.full.regions[i]
        q = {key: number(region.properties[key], values) for key in region.law.properties}
        region.law.check(region.name, q)
        return q

    def _held(self, A: PETSc.Mat) -> PETSc.Mat:
        """A copy without what the supports hold."""
        copy = A.copy()
        for bc in self.full.bcs:
            copy.zeroRowsColumnsLocal(bc.dof_indices()[0], diag=0.0)
        return copy

    def _difference(self, here: PETSc.Mat, assemble, name: str) -> PETSc.Mat:
        """The matrix of a unit of a parameter that one is linear in."""
        step = abs(self.given[name]) or 1.0
        there = assemble({**self.given, name: self.given[name] + step})
        there.axpy(-1.0, here, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        there.scale(1 / step)
        return there

    @staticmethod
    def _add(A: PETSc.Mat, terms: list[_Terms], values, sign: float = 1.0) -> None:
        for term in terms:
            for c, matrix in zip(term.numbers(values), term.matrices, strict=True):
                A.axpy(sign * float(c), matrix, _SUBSET)

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
        self._add(K, self._stiff, self.values(given))
        return K

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """M(p), kg; the caller's to destroy."""
        M = self._M.copy()
        self._add(M, self._heavy, self.values(given))
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
        for i in self._supports:
            support = self.full.elastic_supports[i]
            named = self._named({"k_n": support.k_n, "k_t": support.k_t})
            regions.append(on.support(i, named))
        still = [replace(m, travel=number(m.travel, self.given)) for m in self._masses]
        moving = AffinePencil(
            self.parameters, regions, [on.spring(s) for s in self._springs],
            [on.mass(m) for m in still],
        )  # fmt: skip
        rest = self.total_mass() - float(moving.total_mass(moving.values()))
        fixed = on.matrix(self._K), on.matrix(self._M)
        pencil = replace(moving, fixed=fixed, fixed_mass=rest)
        return ArrayModel(pencil, self.scale_hz, *on.sensors(sensors))

    def _region_on(self, on: Projection, n: int, i: int) -> RegionTerm:
        region, inertia, volume = self.full.regions[i], None, 0.0
        sampled = [on.matrix(A) for A in self._stiff[n].matrices]
        if i in self._inertia:
            inertia, volume = on.matrix(self._inertia[i]), self._volumes[i]
        return on.region(region, self._named(region.properties), sampled, inertia, volume)

    def _named(self, properties: Mapping[str, float | str]) -> dict[str, float | str]:
        """Numbers in place of the names that do not vary."""
        return {
            k: v if self._vary((v,)) else number(v, self.given) for k, v in properties.items()
        }

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
        dense = PETSc.Mat().createDense(
            (self._K.getSizes()[0], (None, X.shape[1])), comm=self._K.comm
        )
        dense.setUp()
        dense.getDenseArray()[:] = X
        dense.assemble()
        values = [self.values(p) for p in points]
        total = _times(self._K, dense) - _times(self._lean_M, dense) * eigenvalues
        for terms, factor in ((self._stiff, np.ones_like(eigenvalues)),
                              (self._heavy, -eigenvalues)):  # fmt: skip
            for term in terms:
                c = np.array([term.numbers(v) for v in values]) * factor[:, None]
                for matrix, column in zip(term.matrices, c.T, strict=True):
                    total += _times(matrix, dense) * column
        dense.destroy()
        return total

    def sums(self, local: np.ndarray) -> np.ndarray:
        """A number of each rank summed over all. Collective."""
        return self._K.comm.tompi4py().allreduce(local, op=MPI.SUM)


def _times(A: PETSc.Mat, X: PETSc.Mat) -> np.ndarray:
    product = A.matMult(X)
    found = product.getDenseArray().copy()
    product.destroy()
    return found
