"""Regions, springs and point masses on a basis: the terms of which K(p) and M(p) are sums."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_joints.structure.laws import Law
from fenics_joints.structure.values import number, slopes

#: A parameter's values: a number, or one for each of many sets of values, (b,).
Values = Mapping[str, float | np.ndarray]


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

    def values(self, values: Values) -> dict[str, float | np.ndarray]:
        """Property values, checked; arrays where the parameters' are.

        Raises:
            InputError: If the law refuses them.
        """
        shape = np.shape(next(iter(values.values()), 0.0))
        q = {key: number(self.properties[key], values) for key in self.law.properties}
        if shape:
            q = {k: v if np.shape(v) == shape else np.full(shape, v) for k, v in q.items()}
        self.law.check(self.name, q)
        return q

    def differs(self, a: Values, b: Values) -> bool:
        """Whether any of its properties is another at other values."""
        names = [name for name in self.properties.values() if isinstance(name, str)]
        return any(_differ(a[name], b[name]) for name in names)


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

    def __call__(self, travel: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The basis at the mass and its slope by the travel, each (gdim, n); (b, gdim, n) of
        travels (b,)."""
        if self._spline is None:
            return self.rows[0], np.zeros_like(self.rows[0])
        return self._spline(travel), self._spline(travel, 1)


@dataclass
class AtLaw:
    """A law's scalars at values of its properties, and their derivatives, as they are asked for: of
    a beam's dozen properties few are parameters."""

    law: Law
    q: Mapping[str, float | np.ndarray]
    known: dict[str, tuple[np.ndarray, float]] = field(default_factory=dict)

    @cached_property
    def theta(self) -> np.ndarray:
        """Of the stiffness, (n_terms,) or (n_terms, b)."""
        return np.asarray(self.law.stiffness_terms(self.q), dtype=float)

    @cached_property
    def rho(self) -> float | np.ndarray:
        """Of the mass."""
        return self.law.inertia_term(self.q)

    def slopes(self, key: str) -> tuple[np.ndarray, float]:
        """Derivatives of the stiffness's and the mass's scalars by a property."""
        if key not in self.known:
            stiff = slopes(self.law.stiffness_terms, self.q, key) if len(self.theta) else self.theta
            self.known[key] = stiff, float(slopes(self.law.inertia_term, self.q, key))
        return self.known[key]


def _differ(a, b) -> bool:
    return a is not b and not np.array_equal(a, b)
