"""A parametric reduced model of plain arrays: what a fit needs, on every rank, without a mesh."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import SHIFT_SHARE, dense_modes
from fenics_joints.reduction.affine import AffinePencil, RegionTerm
from fenics_joints.structure.components import Parameter
from fenics_joints.structure.laws import Law
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.rows import PlaceRows
from fenics_joints.structure.values import number, slopes

__all__ = ["ArrayModel"]

_DIFFERENCE = 1e-6
#: Sets of a law's values that are remembered.
_MOST = 20000


@dataclass(frozen=True)
class _Coefficients:
    """Numbers before the rows of the stacks, and their derivatives, (n_rows, n_parameters)."""

    theta: np.ndarray
    heavy: np.ndarray
    by_theta: np.ndarray
    by_heavy: np.ndarray


_NONE = np.zeros(0)


class _Changes(dict):
    """Derivatives of a law's terms by its properties, (stiffness, inertia), as they are asked for:
    of a beam's dozen properties few are parameters."""

    def __init__(self, law: Law, at: Mapping[str, float], stiff: bool):
        super().__init__()
        self.law, self.at, self.stiff = law, at, stiff

    def __missing__(self, key: str) -> tuple[np.ndarray, float]:
        stiff = slopes(self.law.stiffness_terms, self.at, key) if self.stiff else _NONE
        self[key] = stiff, slopes(self.law.inertia_terms, self.at, key)[0]
        return self[key]


class _Stacks:
    """Matrices of regions, springs and masses that stay, the upper triangles as rows.

    Attributes:
        stiffness: Terms of the stiffness, (n_terms, n (n + 1) / 2).
        inertia: Terms of the mass, likewise.
        whole: Both with whole matrices, (n_terms, n, n).
        rows: Where each region's terms are among the stiffness's.
    """

    def __init__(self, pencil: AffinePencil, n: int):
        self.pencil, self.n = pencil, n
        self.upper = np.triu_indices(n)
        self.fixed = [m for m in pencil.masses if not isinstance(m.travel, str)]
        stiffness = [t for r in pencil.regions for t in r.stiffness]
        ends = np.cumsum([0, *(len(r.stiffness) for r in pencil.regions)]).tolist()
        self.rows = {r.name: slice(*ends[i : i + 2]) for i, r in enumerate(pencil.regions)}
        stiffness += [s.share * np.outer(s.row, s.row) for s in pencil.springs]
        inertia = [r.inertia for r in pencil.regions]
        for mass in self.fixed:
            at, _ = mass(float(mass.travel))
            inertia.append(mass.share * at.T @ at)
        self.whole = np.array(stiffness), np.array(inertia)
        self.stiffness, self.inertia = (
            np.ascontiguousarray(a[:, self.upper[0], self.upper[1]]) for a in self.whole
        )
        self._known: dict[tuple, tuple] = {}

    def unpack(self, row: np.ndarray) -> np.ndarray:
        """A symmetric matrix from its upper triangle."""
        full = np.empty((self.n, self.n))
        full[self.upper] = row
        full.T[self.upper] = row
        return full

    def pack(self, shapes: np.ndarray) -> np.ndarray:
        """x x^T of every column, such that its product with a row of a stack is x^T A x."""
        i, j = self.upper
        squares = shapes[i] * shapes[j]
        squares[i != j] *= 2.0
        return squares.T

    def coefficients(self, values: Mapping[str, float], names: list[str]) -> _Coefficients:
        """See `_Coefficients`."""
        position = {name: i for i, name in enumerate(names)}
        theta, heavy = np.empty(len(self.stiffness)), np.empty(len(self.inertia))
        by_theta = np.zeros((len(theta), len(names)))
        by_heavy = np.zeros((len(heavy), len(names)))
        at = 0
        for number_, region in enumerate(self.pencil.regions):
            terms, inertia, changes = self._law(region, values)
            rows = slice(at, at + len(terms))
            theta[rows], heavy[number_] = terms, inertia
            for key, name in region.properties.items():
                if isinstance(name, str):
                    by_theta[rows, position[name]] += changes[key][0]
                    by_heavy[number_, position[name]] += changes[key][1]
            at += len(terms)
        tail = ((theta, by_theta, at, self.pencil.springs, "stiffness"),
                (heavy, by_heavy, len(self.pencil.regions), self.fixed, "mass"))  # fmt: skip
        for into, slope, first, items, key in tail:
            for row, item in enumerate(items, first):
                into[row] = number(getattr(item, key), values)
                if isinstance(getattr(item, key), str):
                    slope[row, position[getattr(item, key)]] = 1.0
        return _Coefficients(theta, heavy, by_theta, by_heavy)

    def _law(self, region, values) -> tuple[np.ndarray, float, dict]:
        """Terms of a region's law and their derivatives by its properties; remembered, since zones
        of a joint often share their values."""
        q = tuple(number(region.properties[key], values) for key in region.law.properties)
        known = self._known.get((region.law.name, q))
        if known is None:
            if len(self._known) > _MOST:
                self._known.clear()
            at = region.values(values)
            terms, inertia = region.law.stiffness_terms(at), region.law.inertia_terms(at)[0]
            changes = _Changes(region.law, at, len(terms) > 0)
            known = np.asarray(terms, dtype=float), float(inertia), changes
            self._known[region.law.name, q] = known
        return known


@dataclass(frozen=True)
class ArrayModel:
    """Takes the same calls as the reduced structure it was made from; see its `arrays`.

    Attributes:
        pencil: K(p) and M(p) on the basis.
        scale_hz: Dilation frequency, Hz, below which by far a mode is rigid.
        sensor_rows: What the sensors read of the basis, shape (n_sensors, n_dofs); None without.
        shift_rows: The same per metre that a sensor sits further along their line; or None.
        places: Displacement of the basis where forces and responses are asked for; or None.
        dampers: Matrices of dashpots by name, (n_dofs, n_dofs), which are in neither K nor M:
            ``Damping.viscous`` has the coefficient of each.
    """

    pencil: AffinePencil
    scale_hz: float
    sensor_rows: np.ndarray | None = None
    shift_rows: np.ndarray | None = None
    places: PlaceRows | None = None
    dampers: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return self.pencil.parameters

    @property
    def regions(self) -> Sequence[RegionTerm]:
        """Parts and joints, with their laws and properties."""
        return self.pencil.regions

    @cached_property
    def n_dofs(self) -> int:
        """Size of the basis."""
        return len(self.pencil.regions[0].inertia)

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values."""
        return self.pencil.values(given)

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced K(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[0]

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced M(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[1]

    def _matrices(self, given) -> tuple[np.ndarray, np.ndarray]:
        """(K, M); kept for the next call, since both are asked for one after the other."""
        values = self.values(given)
        key = tuple(values.values())
        last = self.__dict__.get("_last")
        if last is None or last[0] != key:
            last = key, self._assemble(values)
            self.__dict__["_last"] = last
        return last[1]

    def _assemble(self, values) -> tuple[np.ndarray, np.ndarray]:
        stacks, c = self._stacks, self._coefficients(values)
        K = stacks.unpack(c.theta @ stacks.stiffness)
        M = stacks.unpack(c.heavy @ stacks.inertia)
        rest_K, rest_M = self._rest.matrices(values)
        return K + rest_K, M + rest_M

    @cached_property
    def _stacks(self) -> _Stacks:
        """Everything that is a number times a matrix, as rows: one product instead of many sums."""
        return _Stacks(self.pencil, self.n_dofs)

    @cached_property
    def _rest(self) -> AffinePencil:
        """Masses that may move, and what depends on nothing."""
        moving = [m for m in self.pencil.masses if isinstance(m.travel, str)]
        return replace(self.pencil, regions=(), springs=(), masses=moving)

    def _coefficients(self, values) -> _Coefficients:
        """Numbers before the rows of the stacks, and their derivatives by the parameters."""
        key = tuple(values.values())
        last = self.__dict__.get("_last_coefficients")
        if last is None or last[0] != key:
            last = key, self._stacks.coefficients(values, list(self.parameters))
            self.__dict__["_last_coefficients"] = last
        return last[1]

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, shape (n_dofs, k).
            eigenvalues: lambda of each, shape (k,).
            given: Values of parameters that differ from their nominal value.
        """
        values, stacks = self.values(given), self._stacks
        c, lam = self._coefficients(values), np.asarray(eigenvalues, dtype=float)
        squares = stacks.pack(shapes)
        stiff, heavy = squares @ stacks.stiffness.T, squares @ stacks.inertia.T
        return (
            stiff @ c.by_theta - lam[:, None] * (heavy @ c.by_heavy)
            + self._rest.gradients(shapes, lam, values)
        )  # fmt: skip

    def pencil_products(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """(dK/dp - lambda dM/dp) x for every parameter, shape (k, n_parameters, n_dofs)."""
        values, stacks = self.values(given), self._stacks
        c, lam = self._coefficients(values), np.asarray(eigenvalues, dtype=float)
        n, k = shapes.shape
        stiff, heavy = (
            (full.reshape(-1, n) @ shapes).reshape(-1, n, k) for full in stacks.whole
        )
        total = np.tensordot(stiff, c.by_theta, axes=(0, 0))
        total -= lam[None, :, None] * np.tensordot(heavy, c.by_heavy, axes=(0, 0))
        total = total.transpose(1, 2, 0)
        moving = {p for m in self._rest.masses for p in (m.mass, m.travel)}
        for i, name in enumerate(self.parameters):
            if name in moving:
                step = _DIFFERENCE * max(abs(values[name]), 1e-3)
                up, down = (
                    self._rest.matrices({**values, name: values[name] + s})[1]
                    for s in (step, -step)
                )
                total[:, i] -= lam[:, None] * ((up - down) / (2 * step) @ shapes).T
        return total

    def shape_slopes(self, index, given=None) -> tuple[np.ndarray, np.ndarray]:
        """Mass-normalised shapes of some modes and their derivatives by every parameter.

        By expansion in all modes of the reduced model, which is exact on its basis (Fox and Kapoor,
        AIAA J. 6, 1968). Derivatives of modes of nearly equal frequency are large, and mean little.

        Args:
            index: Which modes, by ascending eigenvalue.
            given: Values of parameters that differ from their nominal value.

        Returns:
            Shapes, (n_dofs, k); derivatives, (n_dofs, k, n_parameters).
        """
        K, M = self._matrices(given)
        eigenvalues, vectors = dense_modes(K, M, SHIFT_SHARE * self.scale_hz, len(K))
        x, lam = vectors[:, index], eigenvalues[index]
        products = self.pencil_products(x, lam, given) @ vectors
        gap = lam[:, None] - eigenvalues[None, :]
        gap[np.arange(len(lam)), index] = np.inf
        weights = products / gap[:, None, :]
        own = self._mass_slopes(x, given)
        change = np.einsum("nj,kpj->nkp", vectors, weights, optimize=True)
        return x, change - 0.5 * x[:, :, None] * own[None]

    def _mass_slopes(self, x: np.ndarray, given) -> np.ndarray:
        """x^T dM/dp x, shape (k, n_parameters)."""
        values, k = self.values(given), x.shape[1]
        heavy = self._stacks.pack(x) @ self._stacks.inertia.T
        rest = self._rest.gradients(x, np.zeros(k), values)
        rest -= self._rest.gradients(x, np.ones(k), values)
        return heavy @ self._coefficients(values).by_heavy + rest

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """What a layer's own damping multiplies, shape (n_dofs, n_dofs).

        The stiffness of one part, joint or elastic support alone; or the matrix of a dashpot.
        """
        if name in self.dampers:
            return self.dampers[name]
        rows = self._stacks.rows[name]
        theta = self._coefficients(self.values(given)).theta[rows]
        return self._stacks.unpack(theta @ self._stacks.stiffness[rows])

    def slopes(
        self, given: Mapping[str, float] | None = None, apart: Sequence[str] = ()
    ) -> Iterator[tuple[int, str, str | None, np.ndarray]]:
        """dK/dp and dM/dp as matrices, of all parameters that change them.

        Args:
            given: Values of parameters that differ from their nominal value.
            apart: Regions whose share of dK/dp is wanted by itself; dashpots have none.

        Yields:
            Index of the parameter; ``"K"`` or ``"M"``; a name from ``apart``, or None for the sum
            of all others; the matrix, (n_dofs, n_dofs).
        """
        values, stacks = self.values(given), self._stacks
        c = self._coefficients(values)
        apart = [name for name in apart if name not in self.dampers]
        others = np.ones(len(c.theta), dtype=bool)
        for name in apart:
            others[stacks.rows[name]] = False
        groups = [("K", None, others, c.by_theta, stacks.stiffness)]
        groups += [("K", n, stacks.rows[n], c.by_theta, stacks.stiffness) for n in apart]
        groups += [("M", None, slice(None), c.by_heavy, stacks.inertia)]
        for kind, name, rows, by, stack in groups:
            own = by[rows]
            changed = np.flatnonzero(own.any(axis=0))
            if not len(changed):
                continue
            packed = own[:, changed].T @ stack[rows]
            for p, row in zip(changed.tolist(), packed, strict=True):
                yield p, kind, name, stacks.unpack(row)
        yield from self._moving_slopes(values)

    def _moving_slopes(self, values) -> Iterator[tuple[int, str, str | None, np.ndarray]]:
        """dM/dp by the masses that may move."""
        position = {name: i for i, name in enumerate(self.parameters)}
        for mass in self._rest.masses:
            at, slope = mass(number(mass.travel, values))
            if isinstance(mass.mass, str):
                yield position[mass.mass], "M", None, mass.share * at.T @ at
            moved = mass.share * number(mass.mass, values) * slope.T @ at
            yield position[mass.travel], "M", None, moved + moved.T

    def rows(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """What sensors read of the basis, and loads of one newton on it, (n_sensors, n_dofs).

        Raises:
            InputError: If one is not among the model's `places`.
        """
        return (self.places or PlaceRows()).at(sensors, what)

    def observe(self, shapes: np.ndarray, sensors: Sensors | None = None) -> np.ndarray:
        """Shapes at sensors, (n_sensors, n_shapes).

        Sensors that are not all among the model's `places` are taken for those that it was made
        with.
        """
        if sensors is not None and self.places is not None and self.places.has(sensors):
            return self.places.at(sensors) @ shapes
        if self.sensor_rows is None:
            raise InputError("sensors: expected a reduced model that was made with them.")
        return self.sensor_rows @ shapes

    def on(self, basis: np.ndarray) -> ArrayModel:
        """The same on fewer vectors, which are the columns of ``basis``, (n_dofs, k)."""
        sensors, shifts = (
            None if a is None else a @ basis for a in (self.sensor_rows, self.shift_rows)
        )
        places = self.places and self.places.on(basis)
        dampers = {name: basis.T @ D @ basis for name, D in self.dampers.items()}
        return ArrayModel(self.pencil.on(basis), self.scale_hz, sensors, shifts, places, dampers)

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg."""
        return self.pencil.total_mass(self.values(given))
