"""Reduced matrices as exact sums over the parameters' scalars; nothing here knows of a mesh.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), those of springs and point masses in their number. What
the sums need are projections on a basis, which are plain arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_joints.structure.components import Parameter
from fenics_joints.structure.laws import Law
from fenics_joints.structure.values import number, parameter_values, slopes

__all__ = ["AffinePencil", "MassTerm", "RegionTerm", "SpringTerm"]

@dataclass(frozen=True)
class RegionTerm:
    """A part or joint on the basis.

    Attributes:
        name: Its name.
        law: Its law.
        properties: Numbers or names of parameters; all uniform.
        stiffness: Projections of the law's stiffness terms, (n_terms, n, n).
        inertia: Projection of the mass at a unit of the law's inertia term, (n, n).
        volume: Volume as meshed, m3.
    """

    name: str
    law: Law
    properties: Mapping[str, float | str]
    stiffness: np.ndarray
    inertia: np.ndarray
    volume: float

    def values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Property values, checked.

        Raises:
            InputError: If the law refuses them.
        """
        q = {key: number(self.properties[key], values) for key in self.law.properties}
        self.law.check(self.name, q)
        return q


@dataclass(frozen=True)
class SpringTerm:
    """A grounding spring on the basis: ``row``, (n,), gives its elongation."""

    name: str
    stiffness: float | str
    share: float
    row: np.ndarray


@dataclass(frozen=True)
class MassTerm:
    """A point mass on the basis.

    Attributes:
        name: Its name.
        mass: Mass, kg, or a parameter's name.
        travel: Distance travelled, m, or a parameter's name.
        share: Share of the mass at this point.
        stations: Travels at which the rows are known, m, (k,); one for a mass that stays.
        rows: Displacement of the basis there, (k, gdim, n); a spline in between.
    """

    name: str
    mass: float | str
    travel: float | str
    share: float
    stations: np.ndarray
    rows: np.ndarray

    def __post_init__(self):
        spline = CubicSpline(self.stations, self.rows) if len(self.stations) > 1 else None
        object.__setattr__(self, "_spline", spline)

    def __call__(self, travel: float) -> tuple[np.ndarray, np.ndarray]:
        """The basis at the mass and its slope by the travel, each (gdim, n)."""
        if self._spline is None:
            return self.rows[0], np.zeros_like(self.rows[0])
        return self._spline(travel), self._spline(travel, 1)


@dataclass(frozen=True)
class AffinePencil:
    """K(p) and M(p) on a basis.

    Attributes:
        parameters: Parameters by name.
        regions: Parts and joints with uniform properties.
        springs: Grounding springs.
        masses: Point masses.
        fixed: (K, M) that depend on no parameter; None for none.
        fixed_mass: Their mass, kg, in `total_mass`.
    """

    parameters: Mapping[str, Parameter]
    regions: Sequence[RegionTerm]
    springs: Sequence[SpringTerm] = ()
    masses: Sequence[MassTerm] = ()
    fixed: tuple[np.ndarray, np.ndarray] | None = None
    fixed_mass: float = 0.0

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """See `parameter_values`."""
        return parameter_values(self.parameters, given)

    def matrices(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(K, M) at all parameters' values, each (n, n)."""
        K, M = 0.0, 0.0
        if self.fixed is not None:
            K, M = K + self.fixed[0], M + self.fixed[1]
        for region in self.regions:
            q = region.values(values)
            K = K + np.tensordot(region.law.stiffness_terms(q), region.stiffness, axes=1)
            M = M + region.law.inertia_terms(q)[0] * region.inertia
        for spring in self.springs:
            k = spring.share * number(spring.stiffness, values)
            K = K + k * np.outer(spring.row, spring.row)
        for mass in self.masses:
            at, _ = mass(number(mass.travel, values))
            M = M + mass.share * number(mass.mass, values) * (at.T @ at)
        return K, M

    def on(self, basis: np.ndarray) -> AffinePencil:
        """The same on fewer vectors, which are the columns of ``basis``, (n, k)."""
        regions = [
            replace(
                r, stiffness=basis.T @ r.stiffness @ basis, inertia=basis.T @ r.inertia @ basis
            )
            for r in self.regions
        ]
        fixed = self.fixed and tuple(basis.T @ A @ basis for A in self.fixed)
        springs = [replace(s, row=s.row @ basis) for s in self.springs]
        masses = [replace(m, rows=m.rows @ basis) for m in self.masses]
        return replace(self, regions=regions, springs=springs, masses=masses, fixed=fixed)

    def gradients(self, shapes: np.ndarray, eigenvalues, values) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, (n, k).
            eigenvalues: lambda of each, (k,).
            values: All parameters' values.
        """
        eigenvalues = np.asarray(eigenvalues, dtype=float)
        position = {name: i for i, name in enumerate(self.parameters)}
        gradient = np.zeros((len(eigenvalues), len(position)))
        for region in self.regions:
            self._region_gradient(gradient, position, region, shapes, eigenvalues, values)
        for spring in self.springs:
            if isinstance(spring.stiffness, str):
                change = spring.share * (spring.row @ shapes) ** 2
                gradient[:, position[spring.stiffness]] += change
        for mass in self.masses:
            if not isinstance(mass.mass, str) and not isinstance(mass.travel, str):
                continue
            at, slope = mass(number(mass.travel, values))
            u = at @ shapes
            if isinstance(mass.mass, str):
                gradient[:, position[mass.mass]] -= eigenvalues * mass.share * np.sum(u**2, axis=0)
            if isinstance(mass.travel, str):
                m = mass.share * number(mass.mass, values)
                moved = np.sum(u * (slope @ shapes), axis=0)
                gradient[:, position[mass.travel]] -= 2 * eigenvalues * m * moved
        return gradient

    @staticmethod
    def _region_gradient(gradient, position, region, shapes, eigenvalues, values) -> None:
        named = {key: p for key, p in region.properties.items() if isinstance(p, str)}
        if not named:
            return
        q = region.values(values)
        stiff = np.sum((region.stiffness @ shapes) * shapes, axis=1)
        heavy = np.sum((region.inertia @ shapes) * shapes, axis=0)
        for key, name in named.items():
            d_stiff = slopes(region.law.stiffness_terms, q, key)
            d_heavy = slopes(region.law.inertia_terms, q, key)[0]
            gradient[:, position[name]] += d_stiff @ stiff - eigenvalues * d_heavy * heavy

    def total_mass(self, values: Mapping[str, float]) -> float:
        """Mass, kg, of regions, point masses and what is fixed."""
        total = self.fixed_mass
        total += sum(m.share * number(m.mass, values) for m in self.masses)
        for region in self.regions:
            total += region.law.inertia_terms(region.values(values))[0] * region.volume
        return float(total)
