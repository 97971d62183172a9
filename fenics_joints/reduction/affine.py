"""Reduced matrices as exact sums over the parameters' scalars; nothing here knows of a mesh.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), those of springs and point masses in their number. What
the sums need are projections on a basis, which are plain arrays. They are formed at one set of
parameter values, or at many together (`AffinePencil.assemble`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg.blas import daxpy

from fenics_joints.structure.changes import CHANGES
from fenics_joints.structure.components import Parameter, number, parameter_values, slopes
from fenics_joints.structure.laws import Law

#: Number of sums up to which each is formed from the reference; of more, one product of matrices is
#: faster. Chosen by timing; results agree to round-off.
_FEW = 12
#: Ratio of a factor of the reference to the one wanted above which its round-off would show.
_MAGNITUDES = 1e6
#: Unwanted rows between two wanted ones that are read along with them: chosen, for speed alone.
_GAP = 4

#: Random values at which scalars are compared: rational functions that are in proportion at all of
#: them are in proportion everywhere.
_SAMPLES = 6
#: Relative difference below which scalars are in proportion: round-off of a few operations.
_ROUND_OFF = 1e-11
#: Relative range of the random values: chosen; any range would do.
_APART = 0.15


class Stack:
    """Symmetric matrices whose weighted sums are wanted.

    Attributes:
        whole: The matrices, (n_terms, n, n).
        reference: Factors and upper triangle of the sum that `sum_near` starts from, or None.
    """

    def __init__(self, matrices: Sequence[np.ndarray], n: int):
        self.n, self.whole = n, np.array(matrices, dtype=float).reshape(len(matrices), n, n)
        self.reference: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def _indices(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(self.n)

    @cached_property
    def _upper(self) -> np.ndarray:
        """The upper triangles as rows, (n_terms, n (n + 1) / 2): half the work for one sum."""
        i, j = self._indices
        return np.ascontiguousarray(self.whole[:, i, j])

    @cached_property
    def _twice(self) -> np.ndarray:
        """How often each entry of an upper triangle is in the matrix."""
        i, j = self._indices
        return np.where(i == j, 1.0, 2.0)

    def sum(self, factors: np.ndarray, rows=slice(None)) -> np.ndarray:
        """The sum of factors times matrices, (n, n); of factors (n_terms, b) all b, (b, n, n).

        Args:
            factors: Of each matrix.
            rows: Which of the matrices.
        """
        if factors.ndim == 1:
            return self._unpacked(factors @ self._upper[rows])
        flat = self.whole[rows].reshape(len(factors), self.n**2)
        return (factors.T @ flat).reshape(-1, self.n, self.n)

    def sum_near(self, factors: np.ndarray) -> np.ndarray:
        """`sum` of all matrices, from the sum of `set_reference` where there is one."""
        if self.reference is None or (factors.ndim > 1 and factors.shape[1] > _FEW):
            return self.sum(factors)
        if factors.ndim == 1:
            return self._unpacked(self._near(factors))
        return np.array([self._unpacked(self._near(column)) for column in factors.T])

    def _near(self, factors: np.ndarray) -> np.ndarray:
        """Upper triangle of the sum of all. Mostly few factors differ from the reference's, and
        reading the matrices takes the time."""
        first, total = self.reference
        change = factors - first
        moved = np.flatnonzero(change)
        # Where a large term nearly vanishes, the reference's round-off would show.
        lost = np.abs(first[moved]) > _MAGNITUDES * np.abs(factors[moved])
        if len(moved) > len(factors) // 2 or np.any(lost & (factors[moved] != 0.0)):
            return factors @ self._upper
        total = total.copy()
        for i in moved:
            daxpy(self._upper[i], total, a=change[i])
        return total

    def set_reference(self, factors: np.ndarray) -> None:
        """Keep the sum at these factors for `sum_near`.

        The caller names it, so that round-off does not depend on which sum was asked for first.
        """
        self.reference = factors.copy(), factors @ self._upper

    def _unpacked(self, row: np.ndarray) -> np.ndarray:
        full = np.empty((self.n, self.n))
        full[self._indices] = row
        full.T[self._indices] = row
        return full

    def pack(self, shapes: np.ndarray) -> np.ndarray:
        """x x^T of every column of the shapes, for `squares` of this stack or one of its size."""
        i, j = self._indices
        packed = shapes[i] * shapes[j]
        packed *= self._twice[:, None]
        return packed.T

    def squares(self, packed: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """x^T A x of every packed vector and every matrix, (k, n_terms).

        Args:
            packed: From `pack`.
            wanted: Which matrices, (n_terms,), bool; entries of others are arbitrary. None for all.
        """
        if wanted is None:
            return packed @ self._upper.T
        found, used = np.zeros((len(packed), len(self.whole))), np.flatnonzero(wanted)
        for run in np.split(used, np.flatnonzero(np.diff(used) > _GAP) + 1) if len(used) else ():
            rows = slice(run[0], run[-1] + 1)  # a view: rows that are picked would be copied
            found[:, rows] = packed @ self._upper[rows].T
        return found


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

    def at(self, values: Values) -> LawScalars:
        """Its law's scalars."""
        return LawScalars(self.law, self.values(values))

    def differs(self, a: Values, b: Values) -> bool:
        """Whether any of its properties differs between two sets of values."""
        names = [name for name in self.properties.values() if isinstance(name, str)]
        return any(a[n] is not b[n] and not np.array_equal(a[n], b[n]) for n in names)


def _any(where: str, q: Mapping[str, object]) -> None:
    """Accept all values: the component was checked when it was made."""


#: A grounding spring and a point mass as laws of one property each.
SPRING = Law(
    "grounding spring",
    ("stiffness",),
    None,
    lambda q: np.array([q["stiffness"]]),
    ({"stiffness": 1.0},),
    _any,
    inertia_term=lambda q: 0.0 * q["stiffness"],
)
POINT_MASS = Law(
    "point mass",
    ("mass",),
    None,
    lambda q: np.zeros((0, *np.shape(q["mass"]))),
    (),
    _any,
    inertia_term=lambda q: q["mass"],
)
#: A constant of forms, in which both matrices are linear.
CONSTANT = Law(
    "constant",
    ("value",),
    None,
    lambda q: np.array([q["value"]]),
    ({"value": 1.0},),
    _any,
    inertia_term=lambda q: q["value"],
)


def spring_term(name: str, stiffness: float | str, share: float, row: np.ndarray) -> RegionTerm:
    """A grounding spring on the basis: ``row``, (n,), gives its elongation."""
    own = share * np.outer(row, row)
    return RegionTerm(name, SPRING, {"stiffness": stiffness}, own[None], 0.0 * own, 0.0)


@dataclass(frozen=True)
class TravellingMass:
    """A point mass whose place is a parameter, in which M is not affine.

    Attributes:
        name: Its name.
        mass: Mass, kg, or a parameter's name.
        travel: Name of the parameter that is the distance travelled, m.
        share: Share of the mass at this point.
        stations: Travels at which the rows are known, m, (k,).
        rows: Displacement of the basis there, (k, gdim, n); a spline in between.
    """

    name: str
    mass: float | str
    travel: str
    share: float
    stations: np.ndarray
    rows: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "_spline", CubicSpline(self.stations, self.rows))

    def __call__(self, travel: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The basis at the mass and its slope by the travel, each (gdim, n); (b, gdim, n) of
        travels (b,)."""
        return self._spline(travel), self._spline(travel, 1)

    def at(self, travel: float) -> RegionTerm:
        """The same mass fixed at one place."""
        return mass_term(self.name, self.mass, travel, self.share, None, self(travel)[0][None])


def mass_term(
    name: str, mass: float | str, travel: float | str, share: float, stations, rows: np.ndarray
) -> RegionTerm | TravellingMass:
    """A point mass on the basis, see `TravellingMass`; one that stays has one station."""
    if isinstance(travel, str):
        return TravellingMass(name, mass, travel, share, stations, rows)
    own = share * rows[0].T @ rows[0]
    return RegionTerm(name, POINT_MASS, {"mass": mass}, np.zeros((0, *own.shape)), own, share)


@dataclass
class LawScalars:
    """A law's scalars at values of its properties, and their derivatives.

    Each is computed when it is asked for: few of a beam's dozen properties are parameters.
    """

    law: Law
    q: Mapping[str, float | np.ndarray]

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
        stiff = slopes(self.law.stiffness_terms, self.q, key) if len(self.theta) else self.theta
        return stiff, float(slopes(self.law.inertia_term, self.q, key))


#: Sets of values whose derivatives are kept: chosen, for speed alone.
_NEXT = 64


def _same(kept: Sequence, values: Sequence) -> bool:
    """Whether these are equal numbers, or the very same arrays."""
    return len(kept) == len(values) and all(
        a is b or (type(a) is type(b) is float and a == b)
        for a, b in zip(kept, values, strict=True)
    )


@dataclass(frozen=True)
class AffinePencil:
    """K(p) = sum theta_i(p) K_i and M(p) = sum rho_i(p) M_i on a basis.

    `assemble` gives both at one set of values or at many, `gradients` and `slopes` derivatives by
    the parameters, `mapped` both in other unknowns, `restrict` both with some parameters fixed.

    Attributes:
        parameters: Parameters by name.
        regions: Parts and joints with uniform properties.
        points: Grounding springs and point masses, by `spring_term` and `mass_term`.
        fixed: (K, M) that depend on no parameter; None for none.
        fixed_mass: Their mass, kg, in `total_mass`.
    """

    parameters: Mapping[str, Parameter]
    regions: Sequence[RegionTerm]
    points: Sequence[RegionTerm | TravellingMass] = ()
    fixed: tuple[np.ndarray, np.ndarray] | None = None
    fixed_mass: float = 0.0

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """See `parameter_values`."""
        return parameter_values(self.parameters, given)

    @cached_property
    def n(self) -> int:
        """Size of the basis."""
        sized = [t.inertia for t in self.terms_by_law] + [m.rows for m in self.moving]
        sized += self.fixed or ()
        return sized[0].shape[-1]

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Where each region's terms are among those of the stiffness."""
        return {r.name: rows for r, rows in zip(self.regions, self._spans, strict=False)}

    @cached_property
    def _spans(self) -> list[slice]:
        """Where the terms of each of `terms_by_law` are among those of the stiffness."""
        ends = np.cumsum([0, *(len(t.stiffness) for t in self.terms_by_law)]).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    @property
    def terms_by_law(self) -> list[RegionTerm]:
        """Terms in which K and M are affine: regions, then springs and masses that do not move."""
        return [*self.regions, *(p for p in self.points if isinstance(p, RegionTerm))]

    @cached_property
    def moving(self) -> list[TravellingMass]:
        """Masses whose place is a parameter."""
        return [p for p in self.points if isinstance(p, TravellingMass)]

    @cached_property
    def travellers(self) -> tuple[str, ...]:
        """Names of these masses' parameters."""
        named = (name for m in self.moving for name in (m.mass, m.travel))
        return tuple(dict.fromkeys(name for name in named if isinstance(name, str)))

    @cached_property
    def _stiffness(self) -> Stack:
        stack = Stack([t for term in self.terms_by_law for t in term.stiffness], self.n)
        self._hold({"stiffness": stack.whole[self.rows[r.name]]} for r in self.regions)
        return stack

    @cached_property
    def _inertia(self) -> Stack:
        stack = Stack([term.inertia for term in self.terms_by_law], self.n)
        self._hold({"inertia": own} for own in stack.whole)
        return stack

    def _hold(self, own: Iterable[Mapping[str, np.ndarray]]) -> None:
        """Make the regions' arrays views of a stack, so that a model holds them once."""
        held = [replace(r, **arrays) for r, arrays in zip(self.regions, own, strict=False)]
        object.__setattr__(self, "regions", held)

    @property
    def terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrices before the scalars in K and in M, each (n_terms, n, n)."""
        return self._stiffness.whole, self._inertia.whole

    def travelling(self, values: Values) -> list[tuple[np.ndarray, np.ndarray]]:
        """Mass, kg, and displacement of the basis, (gdim, n), of every mass that moves; of values
        (b,) each (b,) and (b, gdim, n)."""
        return [
            (np.asarray(m.share * number(m.mass, values)), m(values[m.travel])[0])
            for m in self.moving
        ]

    # -- scalars ---------------------------------------------------------------------------------

    def _at_laws(self, values: Values) -> list[LawScalars]:
        """Scalars of every term; kept for the next call, since K, M and derivatives need them."""
        last = self.__dict__.get("_last_laws")
        key = list(values.values())  # held, so that no other array can take the place of one
        if last is not None and _same(last[0], key):
            return last[1]
        found = [term.at(values) for term in self.terms_by_law]
        self.__dict__["_last_laws"] = key, found
        return found

    def scalars(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """Numbers before the terms of K and of M, each (n_terms,) or (n_terms, b)."""
        at, shape = self._at_laws(values), np.shape(next(iter(values.values()), 0.0))
        theta = np.concatenate([np.zeros((0, *shape)), *(each.theta for each in at)])
        return theta, np.reshape([each.rho for each in at], (len(at), *shape))

    def change(self, low: Values, high: Values) -> tuple[np.ndarray, np.ndarray]:
        """`scalars` at the high values minus those at the low ones, of arrays (b,) each."""
        shape = np.shape(next(iter(high.values())))
        theta, rho = (np.zeros((len(s.whole), *shape)) for s in (self._stiffness, self._inertia))
        for i, term in enumerate(self.terms_by_law):
            if term.differs(low, high):
                below, above = term.at(low), term.at(high)
                theta[self._spans[i]] = above.theta - below.theta
                rho[i] = above.rho - below.rho
        return theta, rho

    def scalar_slopes(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `scalars`, each (n_terms, n_parameters).

        Kept for the last sets of values: where each mode sees a model of its own, calls alternate
        between these.
        """
        key = tuple(values.values())
        if key not in self._slopes:
            if len(self._slopes) >= _NEXT:
                del self._slopes[next(iter(self._slopes))]
            self._slopes[key] = self._new_slopes(values)
        return self._slopes[key]

    @cached_property
    def _slopes(self) -> dict[tuple, tuple[np.ndarray, np.ndarray]]:
        return {}

    def _new_slopes(self, values) -> tuple[np.ndarray, np.ndarray]:
        position = {name: i for i, name in enumerate(self.parameters)}
        by_theta, by_rho = (
            np.zeros((len(s.whole), len(position))) for s in (self._stiffness, self._inertia)
        )
        for i, (term, at) in enumerate(zip(self.terms_by_law, self._at_laws(values), strict=True)):
            for key, name in term.properties.items():
                if isinstance(name, str):
                    stiff, heavy = at.slopes(key)
                    by_theta[self._spans[i], position[name]] += stiff
                    by_rho[i, position[name]] += heavy
        return by_theta, by_rho

    def _moved(self, values) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Derivatives by the masses that move: index of the parameter, and A and B, (gdim, n), with
        dM/dp = A^T B + B^T A."""
        position = {name: i for i, name in enumerate(self.parameters)}
        for mass in self.moving:
            at, slope = mass(values[mass.travel])
            if isinstance(mass.mass, str):
                yield position[mass.mass], 0.5 * mass.share * at, at
            yield position[mass.travel], mass.share * number(mass.mass, values) * slope, at

    # -- sums ------------------------------------------------------------------------------------

    def set_reference(self, values: Values) -> None:
        """Form later sums as corrections of the sum at these values: most scalars rarely differ.

        Args:
            values: All parameters' values.
        """
        theta, rho = self.scalars(values)
        self._stiffness.set_reference(theta)
        self._inertia.set_reference(rho)
        self.__dict__["_reference"] = dict(values)

    @property
    def reference(self) -> Mapping[str, float] | None:
        """The values of `set_reference`, or None."""
        return self.__dict__.get("_reference")

    def assemble(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """(K, M) at all parameters' values, each (n, n); (b, n, n) of values of shape (b,) each."""
        theta, rho = self.scalars(values)
        K, M = self._stiffness.sum_near(theta), self._inertia.sum_near(rho)
        for weight, at in self.travelling(values):
            M += weight[..., None, None] * (np.swapaxes(at, -1, -2) @ at)
        if self.fixed is not None:
            K, M = K + self.fixed[0], M + self.fixed[1]
        return K, M

    def region_stiffness(self, name: str, values: Mapping[str, float]) -> np.ndarray:
        """Stiffness of one region alone, (n, n)."""
        region = next(r for r in self.regions if r.name == name)
        return self._stiffness.sum(region.at(values).theta, self.rows[name])

    def total_mass(self, values: Values) -> float | np.ndarray:
        """Mass, kg, of regions, point masses and the fixed part; (b,) of values of shape (b,)."""
        rho = self.scalars(values)[1]
        moving = sum(m.share * number(m.mass, values) for m in self.moving)
        return self.fixed_mass + np.array([t.volume for t in self.terms_by_law]) @ rho + moving

    # -- derivatives -----------------------------------------------------------------------------

    def gradients(self, shapes: np.ndarray, eigenvalues, values) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, (n, k).
            eigenvalues: lambda of each, (k,).
            values: All parameters' values.
        """
        packed, lam = self._stiffness.pack(shapes), np.asarray(eigenvalues, dtype=float)
        stiff = self._stiffness.squares(packed) @ self.scalar_slopes(values)[0]
        return stiff - lam[:, None] * self._mass_gradients(packed, shapes, values)

    def squares(
        self, shapes: np.ndarray, stiff: np.ndarray | None = None, heavy: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """x^T A x of every column, (n, k), and every matrix in K and in M, each (k, n_terms); which
        of them are wanted, (n_terms,) bool, see `Stack.squares`."""
        packed = self._stiffness.pack(shapes)
        return self._stiffness.squares(packed, stiff), self._inertia.squares(packed, heavy)

    def _mass_gradients(self, packed, shapes, values) -> np.ndarray:
        total = self._inertia.squares(packed) @ self.scalar_slopes(values)[1]
        for p, A, B in self._moved(values):
            total[:, p] += 2 * np.sum((A @ shapes) * (B @ shapes), axis=0)
        return total

    def slopes(
        self, values: Mapping[str, float], apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, np.ndarray]]:
        """dK/dp and dM/dp as matrices, of all parameters that change them.

        Args:
            values: All parameters' values.
            apart: Regions whose share of dK/dp is yielded separately.

        Yields:
            Index of the parameter; ``"K"`` or ``"M"``; a name from ``apart``, or None for the sum
            of all others; the matrix, (n, n).
        """
        by_theta, by_rho = self.scalar_slopes(values)
        others = np.ones(len(by_theta), dtype=bool)
        for name in apart:
            others[self.rows[name]] = False
        groups = [("K", None, others, by_theta, self._stiffness)]
        groups += [("K", name, self.rows[name], by_theta, self._stiffness) for name in apart]
        groups += [("M", None, slice(None), by_rho, self._inertia)]
        for kind, name, rows, by, stack in groups:
            for p in np.flatnonzero(by[rows].any(axis=0)).tolist():
                yield p, kind, name, stack.sum(by[rows, p], rows)
        for p, A, B in self._moved(values):
            yield p, "M", None, A.T @ B + B.T @ A

    def mapped(self, matrix: Callable, rows: Callable) -> AffinePencil:
        """The same pencil in other unknowns.

        Args:
            matrix: Transforms matrices, (..., n, n), to these.
            rows: Transforms rows, (..., n), to these.
        """

        def term(t):
            if isinstance(t, TravellingMass):
                return replace(t, rows=rows(t.rows))
            return replace(t, stiffness=matrix(t.stiffness), inertia=matrix(t.inertia))

        return replace(
            self,
            regions=list(map(term, self.regions)),
            points=list(map(term, self.points)),
            fixed=self.fixed and tuple(map(matrix, self.fixed)),
        )

    def restrict(
        self, free: Collection[str], values: Values, only: Collection[str] | None = None
    ) -> AffinePencil:
        """The same pencil with some parameters fixed, in fewer terms.

        With most parameters fixed, most scalars are constant, and others are in proportion, such as
        those of one layer's modulus: their matrices are summed once.

        Args:
            free: Names of the parameters that may change.
            values: Values of all parameters.
            only: Terms that name none of these, and `structure.changes`, are kept as they are.
                None to look at all terms.
        """
        zero = np.zeros((self.n, self.n))
        K, M = (np.array(A) for A in self.fixed or (zero, zero))
        mass, kept = self.fixed_mass, {"regions": [], "points": []}
        for which, terms in kept.items():
            for term in getattr(self, which):
                if isinstance(term, TravellingMass):
                    if term.travel in free:
                        own = term.mass if term.mass in free else number(term.mass, values)
                        terms.append(replace(term, mass=own))
                        continue
                    term = term.at(number(term.travel, values))
                named = set(term.properties.values())
                if only is not None and (term.law in CHANGES or not named & set(only)):
                    terms.append(term)
                    continue
                own, stiff, heavy, weight = _split(term, free, values)
                K, M, mass = K + stiff, M + heavy, mass + weight
                terms += [] if own is None else [own]
        return replace(self, **kept, fixed=(K, M), fixed_mass=mass)


def _split(region: RegionTerm, free, values):
    """The varying rest of a part or joint, or None; its fixed stiffness, inertia and mass, kg."""
    law, q = region.law, region.values(values)
    named = {key: name for key, name in region.properties.items() if name in free}
    properties = {k: v if v in free else q.get(k, v) for k, v in region.properties.items()}
    if named and law in CHANGES:  # zero at most values of a place, but not at all
        return replace(region, properties=properties), 0.0, 0.0, 0.0
    chance = np.random.default_rng(1)
    factors = {name: 1 + _APART * chance.random(_SAMPLES) for name in dict.fromkeys(named.values())}
    # Zero times any factor is zero: such a property is compared at values about one.
    many = {k: np.full(_SAMPLES, v) for k, v in q.items()}
    many |= {k: (q[k] or 1.0) * factors[name] for k, name in named.items()}
    theta = np.reshape(law.stiffness_terms(many), (-1, _SAMPLES)).astype(float)
    rho = np.broadcast_to(law.inertia_term(many), _SAMPLES)
    stands = np.all(np.abs(np.diff(theta)) <= _ROUND_OFF * np.abs(theta[:, 1:]), axis=1)
    now = np.asarray(law.stiffness_terms(q), dtype=float)
    stiff = np.tensordot(np.where(stands, now, 0.0), region.stiffness, axes=1)
    heavy, weight, volume, inertia = 0.0, 0.0, region.volume, region.inertia
    if np.ptp(rho) <= _ROUND_OFF * np.max(np.abs(rho)):
        here = float(law.inertia_term(q))
        heavy, weight = here * inertia, here * volume
        volume, inertia = 0.0, np.zeros_like(inertia)
    groups = _groups(theta, np.flatnonzero(~stands))
    if not groups and not volume and not np.any(inertia):
        return None, stiff, heavy, weight
    sums = [np.tensordot(shares, region.stiffness[rows], axes=1) for rows, shares in groups]
    own = replace(
        region,
        law=of_few(law, [rows[0] for rows, _ in groups]),
        inertia=inertia,
        volume=volume,
        stiffness=np.reshape(sums, (len(sums), *inertia.shape)),
        properties=properties,
    )
    return own, stiff, heavy, weight


def _groups(theta: np.ndarray, rows: Sequence[int]) -> list[tuple[list[int], list[float]]]:
    """Groups of rows in proportion, with each row's multiple of its group's first."""
    found: list[tuple[list[int], list[float]]] = []
    for i in rows:
        for members, shares in found:
            first = theta[members[0]]
            share = (theta[i] @ first) / (first @ first)
            if np.all(np.abs(theta[i] - share * first) <= _ROUND_OFF * np.abs(theta[i])):
                members.append(int(i))
                shares.append(float(share))
                break
        else:
            found.append(([int(i)], [1.0]))
    return found


def of_few(law: Law, rows: Sequence[int]) -> Law:
    """The law with some of its scalars, by index."""
    name = f"{law.name} {list(rows)}"  # by which a pencil remembers them
    return replace(law, name=name, stiffness_terms=partial(_some, law, list(rows)))


def _some(law: Law, rows: list[int], q) -> np.ndarray:
    return np.asarray(law.stiffness_terms(q))[rows]
