"""Reduced matrices as exact sums over the parameters' scalars; nothing here knows of a mesh.

The stiffness and mass of every region with uniform properties are linear in a few scalars
(`structure.laws.Law.stiffness_terms`), those of springs and point masses in their number. What
the sums need are projections on a basis, which are plain arrays. They are formed at one set of
parameter values, or at many together (`AffinePencil.matrices`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg.blas import daxpy

from fenics_joints.structure.components import Parameter, number, parameter_values, slopes
from fenics_joints.structure.laws import Law

#: Matrices whose products with vectors are held at a time.
_READ = 32
#: Sums that are formed one after the other from a near one; how many times larger a factor may have
#: been there; and rows between two that are wanted which are read along with them.
_FEW, _MAGNITUDES, _GAP = 12, 1e6, 4


class Stack:
    """Matrices of which a sum is made.

    Attributes:
        whole: The matrices, (n_terms, n, n).
    """

    def __init__(self, matrices: Sequence[np.ndarray], n: int):
        self.n, self.whole = n, np.array(matrices, dtype=float).reshape(len(matrices), n, n)
        self.about: tuple[np.ndarray, np.ndarray] | None = None

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
            whole = len(factors) == len(self.whole)
            return self._unpacked(self._near(factors) if whole else factors @ self._upper[rows])
        if self.about and len(factors) == len(self.whole) and factors.shape[1] <= _FEW:
            return np.array([self._unpacked(self._near(column)) for column in factors.T])
        flat = self.whole[rows].reshape(len(factors), self.n**2)
        return (factors.T @ flat).reshape(-1, self.n, self.n)

    def _near(self, factors: np.ndarray) -> np.ndarray:
        """The upper triangle of the sum of all, from the one that is known, if any: mostly few
        factors differ, and to read the matrices is the work."""
        if self.about is None:
            return factors @ self._upper
        first, total = self.about
        change = factors - first
        moved = np.flatnonzero(change)
        # Round-off of what is known must not show in what is left of it.
        lost = np.abs(first[moved]) > _MAGNITUDES * np.abs(factors[moved])
        if len(moved) > len(factors) // 2 or np.any(lost & (factors[moved] != 0.0)):
            return factors @ self._upper
        total = total.copy()
        for i in moved:
            daxpy(self._upper[i], total, a=change[i])
        return total

    def settle(self, factors: np.ndarray) -> None:
        """Know a sum, from which others are formed: it must not be what happened to be asked for
        first, or round-off would hang on that."""
        self.about = factors.copy(), factors @ self._upper

    def sums(self, factors: np.ndarray, rows) -> Iterator[np.ndarray]:
        """`sum` of every column of the factors, one after the other."""
        yield from map(self._unpacked, factors.T @ self._upper[rows])

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
            wanted: Which matrices, (n_terms,), bool; of others it is 0, or not. None for all.
        """
        if wanted is None:
            return packed @ self._upper.T
        found, used = np.zeros((len(packed), len(self.whole))), np.flatnonzero(wanted)
        for run in np.split(used, np.flatnonzero(np.diff(used) > _GAP) + 1) if len(used) else ():
            rows = slice(run[0], run[-1] + 1)  # a view: rows that are picked would be copied
            found[:, rows] = packed @ self._upper[rows].T
        return found

    def times(self, shapes: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """A x of every column, A being each of some sums of factors times matrices, (n, k, p).

        Args:
            shapes: The columns, (n, k).
            factors: Of each matrix in each sum, (n_terms, p).
        """
        found = np.zeros((*shapes.shape, factors.shape[1]))
        # To read the matrices is most of the work: those in none of the sums are let be.
        used = np.flatnonzero(factors.any(axis=1))
        for first in range(0, len(used), _READ):
            rows = used[first : first + _READ]
            columns = np.array([self.whole[i] @ shapes for i in rows]).reshape(len(rows), -1)
            found += (columns.T @ factors[rows]).reshape(found.shape)
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


#: Sets of a law's values that are remembered.
_MOST = 20000
#: Sets of values at which derivatives are remembered.
_NEXT = 64


def _same_arrays(kept, values) -> bool:
    """Whether these are the very arrays that were kept in a list."""
    if not isinstance(kept, list) or len(kept) != len(values):
        return False
    return all(a is b for a, b in zip(kept, values, strict=True))


def _column(numbers: Sequence[float | str], values: Values) -> np.ndarray:
    """Components' numbers, (n,); (n, b) of values of shape (b,)."""
    shape = np.shape(next(iter(values.values()), 0.0))
    found = [number(value, values) for value in numbers]
    if shape:
        found = [np.broadcast_to(value, shape) for value in found]
    return np.reshape(found, (len(found), *shape))


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

    @cached_property
    def n(self) -> int:
        """Size of the basis."""
        sized = [
            *(r.inertia for r in self.regions),
            *(self.fixed or ()),
            *(s.row for s in self.springs),
            *(m.rows for m in self.masses),
        ]
        return sized[0].shape[-1]

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Where each region's terms are among those of the stiffness."""
        ends = np.cumsum([0, *(len(r.stiffness) for r in self.regions)]).tolist()
        return {r.name: slice(*ends[i : i + 2]) for i, r in enumerate(self.regions)}

    @cached_property
    def _still(self) -> list[MassTerm]:
        return [m for m in self.masses if not isinstance(m.travel, str)]

    @cached_property
    def _moving(self) -> list[MassTerm]:
        return [m for m in self.masses if isinstance(m.travel, str)]

    @cached_property
    def travellers(self) -> tuple[str, ...]:
        """Parameters of the masses that move."""
        named = (name for m in self._moving for name in (m.mass, m.travel))
        return tuple(dict.fromkeys(name for name in named if isinstance(name, str)))

    @cached_property
    def _stiffness(self) -> Stack:
        """Terms of regions, then of springs."""
        terms = [t for r in self.regions for t in r.stiffness]
        springs = [s.share * np.outer(s.row, s.row) for s in self.springs]
        stack = Stack([*terms, *springs], self.n)
        self._hold({"stiffness": stack.whole[self.rows[r.name]]} for r in self.regions)
        return stack

    @cached_property
    def _inertia(self) -> Stack:
        """Terms of regions, then of masses that stay."""
        at = [m(float(m.travel))[0] for m in self._still]
        still = [m.share * rows.T @ rows for m, rows in zip(self._still, at, strict=True)]
        stack = Stack([*(r.inertia for r in self.regions), *still], self.n)
        self._hold({"inertia": own} for own in stack.whole)
        return stack

    def _hold(self, own: Iterable[Mapping[str, np.ndarray]]) -> None:
        """Let the regions look into a stack that has copies of their arrays, which then can go:
        they are most of a model."""
        held = [replace(r, **arrays) for r, arrays in zip(self.regions, own, strict=False)]
        object.__setattr__(self, "regions", held)

    @property
    def terms(self) -> tuple[np.ndarray, np.ndarray]:
        """What the scalars multiply in K and in M, each (n_terms, n, n)."""
        return self._stiffness.whole, self._inertia.whole

    def travelling(self, values: Values) -> list[tuple[np.ndarray, np.ndarray]]:
        """Mass, kg, and displacement of the basis, (gdim, n), of every mass that moves; of values
        (b,) each (b,) and (b, gdim, n)."""
        return [
            (np.asarray(m.share * number(m.mass, values)), m(values[m.travel])[0])
            for m in self._moving
        ]

    # -- scalars ---------------------------------------------------------------------------------

    @cached_property
    def _known(self) -> dict[tuple, AtLaw]:
        return {}

    def _at_law(self, region: RegionTerm, values: Values) -> AtLaw:
        """Remembered where values are numbers, since zones of a joint often share them."""
        if values and np.ndim(next(iter(values.values()))):
            return AtLaw(region.law, region.values(values))
        q = tuple(number(region.properties[key], values) for key in region.law.properties)
        key = region.law.name, q
        if key not in self._known:
            if len(self._known) > _MOST:
                self._known.clear()
            self._known[key] = AtLaw(region.law, region.values(values))
        return self._known[key]

    def _at_laws(self, values: Values) -> list[AtLaw]:
        """Of every region; kept for the next call, since K, M and what changes them all ask."""
        last = self.__dict__.get("_last_laws")
        if np.ndim(next(iter(values.values()), 0.0)):
            if last is not None and _same_arrays(last[0], values.values()):
                return last[1]
            key = list(values.values())  # held, so that no other array can take the place of one
        else:
            key = tuple(values.values())
            if last is not None and last[0] == key:
                return last[1]
        found = [self._at_law(region, values) for region in self.regions]
        self.__dict__["_last_laws"] = key, found
        return found

    def scalars(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """Numbers before the terms of K and of M, each (n_terms,) or (n_terms, b).

        Those of regions, then of springs, and of masses that stay.
        """
        at = self._at_laws(values)
        springs = _column([s.stiffness for s in self.springs], values)
        return np.concatenate([*(each.theta for each in at), springs]), self._rho(at, values)

    def change(self, low: Values, high: Values) -> tuple[np.ndarray, np.ndarray]:
        """`scalars` at the high less those at the low values, of arrays (b,) each; only of regions
        in which something differs."""
        shape = np.shape(next(iter(high.values())))
        theta, rho = (np.zeros((len(s.whole), *shape)) for s in (self._stiffness, self._inertia))
        for i, region in enumerate(self.regions):
            if region.differs(low, high):
                below, above = self._at_law(region, low), self._at_law(region, high)
                theta[self.rows[region.name]] = above.theta - below.theta
                rho[i] = above.rho - below.rho
        for row, spring in enumerate(self.springs, len(theta) - len(self.springs)):
            theta[row] = number(spring.stiffness, high) - number(spring.stiffness, low)
        for row, mass in enumerate(self._still, len(self.regions)):
            rho[row] = number(mass.mass, high) - number(mass.mass, low)
        return theta, rho

    def _rho(self, at: Sequence[AtLaw], values: Values) -> np.ndarray:
        still = _column([m.mass for m in self._still], values)
        return np.concatenate([np.array([each.rho for each in at]), still]) if at else still

    def scalar_slopes(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `scalars`, each (n_terms, n_parameters); kept for the next calls: where
        each mode sees a model of its own, one after the other asks, and asks again."""
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
        end = 0
        for i, (region, at) in enumerate(zip(self.regions, self._at_laws(values), strict=True)):
            end += len(region.stiffness)
            for key, name in region.properties.items():
                if isinstance(name, str):
                    stiff, heavy = at.slopes(key)
                    by_theta[end - len(region.stiffness) : end, position[name]] += stiff
                    by_rho[i, position[name]] += heavy
        for row, spring in enumerate(self.springs, end):
            if isinstance(spring.stiffness, str):
                by_theta[row, position[spring.stiffness]] = 1.0
        for row, mass in enumerate(self._still, len(self.regions)):
            if isinstance(mass.mass, str):
                by_rho[row, position[mass.mass]] = 1.0
        return by_theta, by_rho

    def _moved(self, values) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Index of a parameter, and A and B, (gdim, n), for dM/dp = A^T B + B^T A of what moves."""
        position = {name: i for i, name in enumerate(self.parameters)}
        for mass in self._moving:
            at, slope = mass(values[mass.travel])
            if isinstance(mass.mass, str):
                yield position[mass.mass], 0.5 * mass.share * at, at
            yield position[mass.travel], mass.share * number(mass.mass, values) * slope, at

    # -- sums ------------------------------------------------------------------------------------

    def settle(self, values: Values) -> None:
        """Form sums at other values from those at these, of which most scalars are mostly the same.

        Args:
            values: All parameters' values.
        """
        theta, rho = self.scalars(values)
        self._stiffness.settle(theta)
        self._inertia.settle(rho)
        self.__dict__["_settled"] = dict(values)

    @property
    def settled(self) -> Mapping[str, float] | None:
        """The values of `settle`, or None."""
        return self.__dict__.get("_settled")

    def matrices(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """(K, M) at all parameters' values, each (n, n); (b, n, n) of values of shape (b,) each."""
        theta, rho = self.scalars(values)
        K, M = self._stiffness.sum(theta), self._inertia.sum(rho)
        for weight, at in self.travelling(values):
            M += weight[..., None, None] * (np.swapaxes(at, -1, -2) @ at)
        if self.fixed is not None:
            K, M = K + self.fixed[0], M + self.fixed[1]
        return K, M

    def region_stiffness(self, name: str, values: Mapping[str, float]) -> np.ndarray:
        """Stiffness of one region alone, (n, n)."""
        region = next(r for r in self.regions if r.name == name)
        return self._stiffness.sum(self._at_law(region, values).theta, self.rows[name])

    def total_mass(self, values: Values) -> float | np.ndarray:
        """Mass, kg, of regions, point masses and what is fixed; (b,) of values of shape (b,)."""
        sizes = [*(r.volume for r in self.regions), *(m.share for m in self._still)]
        rho = self._rho(self._at_laws(values), values)
        moving = sum(m.share * number(m.mass, values) for m in self._moving)
        return self.fixed_mass + np.array(sizes) @ rho + moving

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

    def products(self, shapes: np.ndarray, values) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of K x and of M x by every parameter, each (n, k, n_parameters).

        Args:
            shapes: Vectors x as columns, (n, k).
            values: All parameters' values.
        """
        by_theta, by_rho = self.scalar_slopes(values)
        stiff, heavy = self._stiffness.times(shapes, by_theta), self._inertia.times(shapes, by_rho)
        for p, A, B in self._moved(values):
            heavy[:, :, p] += A.T @ (B @ shapes) + B.T @ (A @ shapes)
        return stiff, heavy

    def slopes(
        self, values: Mapping[str, float], apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, np.ndarray]]:
        """dK/dp and dM/dp as matrices, of all parameters that change them.

        Args:
            values: All parameters' values.
            apart: Regions whose share of dK/dp is wanted by itself.

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
            changed = np.flatnonzero(by[rows].any(axis=0))
            for p, matrix in zip(
                changed.tolist(), stack.sums(by[rows][:, changed], rows), strict=True
            ):
                yield p, kind, name, matrix
        for p, A, B in self._moved(values):
            yield p, "M", None, A.T @ B + B.T @ A

    def on(self, basis: np.ndarray) -> AffinePencil:
        """The same on fewer vectors, which are the columns of ``basis``, (n, k)."""
        regions = [
            replace(r, stiffness=basis.T @ r.stiffness @ basis, inertia=basis.T @ r.inertia @ basis)
            for r in self.regions
        ]
        fixed = self.fixed and tuple(basis.T @ A @ basis for A in self.fixed)
        springs = [replace(s, row=s.row @ basis) for s in self.springs]
        masses = [replace(m, rows=m.rows @ basis) for m in self.masses]
        return replace(self, regions=regions, springs=springs, masses=masses, fixed=fixed)
