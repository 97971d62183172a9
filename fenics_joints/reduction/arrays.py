"""A parametric reduced model of plain arrays for fits, on every rank, without a mesh."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fenics_joints.errors import InputError, items, wanted
from fenics_joints.modal.modes import SHIFT_SHARE, dense_modes
from fenics_joints.reduction.affine import AffinePencil, RegionTerm
from fenics_joints.structure import Damping, Parameter, Sensors
from fenics_joints.structure.points import PlaceRows


@dataclass(eq=False, repr=False)
class ArrayModel:
    """K(p) and M(p) as sums of arrays; fulfils `fenics_joints.structure.model.Damped`.

    Attributes:
        pencil: K(p) and M(p) on the basis.
        scale_hz: Dilation frequency, Hz, below which by far a mode is rigid.
        sensor_rows: Readings of the sensors for each vector of the basis, (n_sensors, n_dofs), or
            None.
        shift_rows: Derivatives of the sensors' readings by their positions along the directions of
            `fenics_joints.reduction.prediction.ways_of`, (n_ways, n_sensors, n_dofs); with two
            directions followed by the `shape_curvature`, (9, n_sensors, n_dofs) in all. Or None.
        places: Displacement of the basis at forces and sensors of FRFs; or None.
        dampers: Matrices of dashpots by name, (n_dofs, n_dofs), which are in neither K nor M:
            ``Damping.viscous`` has the coefficient of each.
        hung: Of an attached oscillator the name of the parameter that is its mass, and its own
            displacement, (gdim, n_dofs); None without one.
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
        """All parameters' values, for derivatives."""
        return self.values(given)

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced K(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[0]

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Reduced M(p), shape (n_dofs, n_dofs)."""
        return self._matrices(given)[1]

    def _matrices(self, given) -> tuple[np.ndarray, np.ndarray]:
        """(K, M); kept for the next call, which mostly asks for the other of the two."""
        values = self.values(given)
        key = tuple(values.values())
        last = self.__dict__.get("_last")
        if last is None or last[0] != key:
            last = self.__dict__["_last"] = key, self._assemble(values)
        return last[1]

    def _assemble(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        return self.pencil.assemble(values)

    def pencil_gradients(self, shapes: np.ndarray, eigenvalues, given=None) -> np.ndarray:
        """Derivatives of x^T (K - lambda M) x by every parameter, shape (k, n_parameters).

        Args:
            shapes: Vectors x as columns, shape (n_dofs, k).
            eigenvalues: lambda of each, shape (k,).
            given: Values of parameters that differ from their nominal value.
        """
        return self.pencil.gradients(shapes, eigenvalues, self.values_of_slopes(given))

    def all_modes(self, given: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues, (n_dofs,), and M-normalised vectors of all modes; kept for the next call."""
        K, M = self._matrices(given)
        last = self.__dict__.get("_last_modes")
        if last is None or last[0] is not K:
            found = dense_modes(K, M, SHIFT_SHARE * self.scale_hz, len(K))
            last = self.__dict__["_last_modes"] = K, found
        return last[1]

    def region_stiffness(self, name: str, given: Mapping[str, float] | None = None) -> np.ndarray:
        """Matrix before a layer's own damping, (n_dofs, n_dofs).

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
            apart: Regions whose share of dK/dp is yielded separately; dashpots have none.

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

    def mapped(self, matrix: Callable, rows: Callable) -> ArrayModel:
        """The same model in other unknowns; see `AffinePencil.mapped`."""
        read = {key: getattr(self, key) for key in ("sensor_rows", "shift_rows")}
        return ArrayModel(
            self.pencil.mapped(matrix, rows),
            self.scale_hz,
            **{key: None if a is None else rows(a) for key, a in read.items()},
            places=self.places and replace(self.places, rows=rows(self.places.rows)),
            dampers={name: matrix(D) for name, D in self.dampers.items()},
            hung=self.hung and (self.hung[0], rows(self.hung[1])),
        )

    def on(self, basis: np.ndarray) -> ArrayModel:
        """The model projected on the columns of ``basis``, (n_dofs, k)."""
        return self.mapped(lambda A: basis.T @ A @ basis, lambda rows: rows @ basis)

    def hung_share(self, shapes: np.ndarray, values: Mapping[str, float]) -> np.ndarray | float:
        """Share of mass-normalised shapes' kinetic energy that is in the attached oscillator.

        Args:
            shapes: As columns, (n_dofs, k), or many such, (b, n_dofs, k).
            values: All parameters' values; of many (b,) each.

        Returns:
            (k,) or (b, k); 0 without an oscillator, or where its mass is fixed.
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


def freeze(
    model: ArrayModel, free: Sequence[str], given: Mapping[str, float] | None = None
) -> ArrayModel:
    """The same model with fewer parameters, in fewer terms.

    Args:
        model: A model of plain arrays.
        free: Names of the parameters that it keeps, one at least.
        given: Values of parameters that differ from their nominal value: fixed parameters keep
            them, and they become the nominal values of the others.

    Raises:
        InputError: If a name is unknown.
    """
    if not isinstance(model, ArrayModel):
        raise wanted("model", model, "an ArrayModel")
    values, free = model.values(given), list(items("free", free, str, "names of parameters"))
    if not free or len(set(free)) < len(free) or not set(free) <= set(values):
        raise InputError(f"free = {free}: expected some of: {', '.join(values)}.")
    parameters = {name: replace(model.parameters[name], value=values[name]) for name in free}
    pencil = replace(model.pencil.restrict(free, values), parameters=parameters)
    return replace(model, pencil=pencil)


def trimmed(model: ArrayModel, still: Collection[str], given: Mapping[str, float]) -> ArrayModel:
    """The same model with the same parameters, some of which must not be changed: matrices that
    only these set apart are summed.

    Args:
        model: A model of plain arrays.
        still: Names of the parameters that keep their values.
        given: Their values, and any of the others'.
    """
    free = frozenset(model.parameters) - set(still)
    return replace(model, pencil=model.pencil.restrict(free, model.values(given), still))
