"""A parametric reduced model of plain arrays: what a fit needs, on every rank, without a mesh."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from fenics_joints.errors import InputError, items, wanted
from fenics_joints.modal.modes import SHIFT_SHARE, dense_modes
from fenics_joints.reduction.affine import AffinePencil, MassTerm, RegionTerm
from fenics_joints.structure import Damping, Parameter, Sensors
from fenics_joints.structure.changes import CHANGES
from fenics_joints.structure.components import number
from fenics_joints.structure.laws import Law
from fenics_joints.structure.points import PlaceRows


@dataclass(eq=False, repr=False)
class ArrayModel:
    """K(p) and M(p) as sums of arrays; fulfils `fenics_joints.structure.model.Damped`.

    Attributes:
        pencil: K(p) and M(p) on the basis.
        scale_hz: Dilation frequency, Hz, below which by far a mode is rigid.
        sensor_rows: What the sensors read of the basis, shape (n_sensors, n_dofs); None without.
        shift_rows: The same per metre that a sensor sits further along each way that it may be off
            (`fenics_joints.reduction.prediction.ways_of`), (n_ways, n_sensors, n_dofs), and of two
            the `bends`, (9, n_sensors, n_dofs) in all; or None.
        places: Displacement of the basis where forces and responses are asked for; or None.
        dampers: Matrices of dashpots by name, (n_dofs, n_dofs), which are in neither K nor M:
            ``Damping.viscous`` has the coefficient of each.
        hung: Name of the parameter that is the mass of what hangs on the structure, and its own
            displacement, (gdim, n_dofs); None where nothing does.
    """

    pencil: AffinePencil
    scale_hz: float
    sensor_rows: np.ndarray | None = None
    shift_rows: np.ndarray | None = None
    places: PlaceRows | None = None
    dampers: Mapping[str, np.ndarray] = field(default_factory=dict)
    hung: tuple[str, np.ndarray] | None = None

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = True, False

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return self.pencil.parameters

    @property
    def regions(self) -> Sequence[RegionTerm]:
        """Parts and joints, with their laws and properties."""
        return self.pencil.regions

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of `regions`."""
        return tuple(region.name for region in self.regions)

    @cached_property
    def n_dofs(self) -> int:
        """Size of the basis."""
        return self.pencil.n

    def values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values."""
        return self.pencil.values(given)

    def values_of_slopes(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """All parameters' values, where derivatives are asked for."""
        return self.values(given)

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
            last = self.__dict__["_last"] = key, self._assemble(values)
        return last[1]

    def _assemble(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        return self.pencil.matrices(values)

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, shape (n_dofs, k).
            eigenvalues: lambda of each, shape (k,).
            given: Values of parameters that differ from their nominal value.
        """
        return self.pencil.gradients(shapes, eigenvalues, self.values_of_slopes(given))

    def pencil_products(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """(dK/dp - lambda dM/dp) x for every parameter, shape (k, n_parameters, n_dofs)."""
        stiff, heavy = self.pencil.products(shapes, self.values_of_slopes(given))
        return (stiff - np.asarray(eigenvalues)[:, None] * heavy).transpose(1, 2, 0)

    def all_modes(self, given: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues, (n_dofs,), and M-normalised vectors of all modes; kept for the next call,
        which may ask for more of them."""
        K, M = self._matrices(given)
        last = self.__dict__.get("_last_modes")
        if last is None or last[0] is not K:
            found = dense_modes(K, M, SHIFT_SHARE * self.scale_hz, len(K))
            last = self.__dict__["_last_modes"] = K, found
        return last[1]

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """What a layer's own damping multiplies, shape (n_dofs, n_dofs).

        The stiffness of one part, joint or elastic support alone; or the matrix of a dashpot.
        """
        if name in self.dampers:
            return self.dampers[name]
        return self.pencil.region_stiffness(name, self.values(given))

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
        apart = [name for name in apart if name not in self.dampers]
        return self.pencil.slopes(self.values_of_slopes(given), apart)

    def resolved(self, damping: Damping) -> Damping:
        """A damping by names of `layers`, which are those that a user knows."""
        return damping

    def loads(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Loads of one newton on the basis, and what sensors read of it, (n_dofs, n_sensors).

        Raises:
            InputError: If one is not among the model's `places`.
        """
        return (self.places or PlaceRows()).at(sensors, what).T

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
        hung = self.hung and (self.hung[0], self.hung[1] @ basis)
        pencil = self.pencil.on(basis)
        return ArrayModel(pencil, self.scale_hz, sensors, shifts, places, dampers, hung)

    def hung_share(self, shapes: np.ndarray, values: Mapping[str, float]) -> np.ndarray | float:
        """Share of mass-normalised shapes' kinetic energy that is in what hangs on the structure.

        Args:
            shapes: As columns, (n_dofs, k), or many such, (b, n_dofs, k).
            values: All parameters' values; of many (b,) each.

        Returns:
            (k,) or (b, k); 0 where nothing hangs, or what does stands still.
        """
        if self.hung is None or self.hung[0] not in values:
            return 0.0
        mass = np.asarray(values[self.hung[0]])
        return mass[..., None] * np.sum((self.hung[1] @ shapes) ** 2, axis=-2)

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg."""
        return self.pencil.total_mass(self.values(given))

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """`scale_hz`, which does not follow the parameters."""
        return self.scale_hz

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({len(self.regions)} parts and joints, "
            f"{len(self.parameters)} parameters, {self.n_dofs} DOFs)"
        )


#: Values at which scalars are compared: what is in proportion at all of them, to round-off, is so
#: everywhere, for they are rational functions and the values are any. How far they are apart.
_SAMPLES, _ROUND_OFF, _APART = 6, 1e-11, 0.15


def freeze(
    model: ArrayModel, free: Sequence[str], given: Mapping[str, float] | None = None
) -> ArrayModel:
    """The same model with fewer parameters, in fewer terms.

    Args:
        model: A model of plain arrays.
        free: Names of the parameters that it keeps, one at least.
        given: Values of parameters that differ from their nominal value; those that stand still
            have them, and they are the nominal ones of the others.

    Raises:
        InputError: If a name is unknown.
    """
    if not isinstance(model, ArrayModel):
        raise wanted("model", model, "an ArrayModel")
    values, free = model.values(given), list(items("free", free, str, "names of parameters"))
    if not free or len(set(free)) < len(free) or not set(free) <= set(values):
        raise InputError(f"free = {free}: expected some of: {', '.join(values)}.")
    pencil, n = model.pencil, model.n_dofs
    K, M = (np.array(A) for A in pencil.fixed or (np.zeros((n, n)), np.zeros((n, n))))
    mass, regions = pencil.fixed_mass, []
    for region in pencil.regions:
        kept, stiff, heavy, weight = _split(region, free, values)
        K, M, mass = K + stiff, M + heavy, mass + weight
        regions += [] if kept is None else [kept]
    springs = [s for s in pencil.springs if s.stiffness in free]
    for spring in pencil.springs:
        if spring.stiffness not in free:
            k = number(spring.stiffness, values) * spring.share
            K += k * np.outer(spring.row, spring.row)
    moving = [
        replace(m, mass=m.mass if m.mass in free else number(m.mass, values))
        for m in pencil.masses
        if m.travel in free
    ]
    still = [m for m in pencil.masses if m.travel not in free]
    for point in (m for m in still if m.mass not in free):
        at = point(number(point.travel, values))[0]
        share = number(point.mass, values) * point.share
        M, mass = M + share * at.T @ at, mass + share
    names = dict.fromkeys(m.mass for m in still if m.mass in free)
    together = [_together([m for m in still if m.mass == name], values) for name in names]
    parameters = {name: replace(model.parameters[name], value=values[name]) for name in free}
    return replace(
        model, pencil=AffinePencil(parameters, regions, springs, [*together, *moving], (K, M), mass)
    )


def trimmed(model: ArrayModel, still: Collection[str], given: Mapping[str, float]) -> ArrayModel:
    """The same model, with the same parameters, in which some stand still: what of a part or joint
    they alone set apart is one term.

    Args:
        model: A model of plain arrays.
        still: Names of the parameters that keep their values.
        given: These values, and any of the others.
    """
    values, pencil = model.values(given), model.pencil
    free, changes = frozenset(pencil.parameters) - set(still), {law.name for law in CHANGES}
    n = model.n_dofs
    K, M = (np.array(A) for A in pencil.fixed or (np.zeros((n, n)), np.zeros((n, n))))
    mass, regions = pencil.fixed_mass, []
    for region in pencil.regions:
        if region.law.name in changes or not set(region.properties.values()) & set(still):
            regions.append(region)
            continue
        kept, stiff, heavy, weight = _split(region, free, values)
        K, M, mass = K + stiff, M + heavy, mass + weight
        regions += [] if kept is None else [kept]
    return replace(model, pencil=replace(pencil, regions=regions, fixed=(K, M), fixed_mass=mass))


def _split(region: RegionTerm, free, values):
    """What is left of a part or joint, or None; and its stiffness, inertia and mass, kg, that stand
    still."""
    law, q = region.law, region.values(values)
    named = {key: name for key, name in region.properties.items() if name in free}
    properties = {k: v if v in free else q.get(k, v) for k, v in region.properties.items()}
    if named and law in CHANGES:  # nought at most values of a place, and not at all
        return replace(region, properties=properties), 0.0, 0.0, 0.0
    chance = np.random.default_rng(1)
    factors = {name: 1 + _APART * chance.random(_SAMPLES) for name in dict.fromkeys(named.values())}
    # Of what is nought all multiples are: it is compared at others.
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
    """Rows in proportion, and each one's multiple of the first."""
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


def _together(masses: Sequence[MassTerm], values) -> MassTerm:
    """Masses that stay and are one parameter's, as one: their displacements below each other."""
    share = sum(m.share for m in masses)
    rows = [np.sqrt(m.share / share) * m(number(m.travel, values))[0] for m in masses]
    return MassTerm(masses[0].name, masses[0].mass, 0.0, share, np.zeros(1), np.vstack(rows)[None])
