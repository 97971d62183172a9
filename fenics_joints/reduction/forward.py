"""Frequencies and shapes of the modes that a test saw, from any model of its structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from fenics_joints.errors import InputError, capable, measured, whole
from fenics_joints.measurements.gap import VISIBLE, Pairing, check_sight, pair_modes
from fenics_joints.modal import Modes, frequency_sensitivity, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.structure.points import Sensors

#: Modes looked through for the test's, at most, as a multiple of the usual number.
_SEARCHED = 4
#: Sensors that are so much nearer to a line than it is long stand in one; and a line that is so
#: nearly normal to a face shows no way along it.
_STRAIGHT, _STEEP = 1e-3, 0.1
#: Parameter sets whose frequencies are remembered.
_MOST = 4000
#: Modes beyond those that the test saw, so that none is missed when modes change places.
SPARE = 3


class Slopes:
    """Derivatives of ln f by all parameters, (m, n_parameters), which are formed when they are
    asked for.

    Args:
        modes: Modes of a model of plain arrays.
        index: Which of them.
    """

    def __init__(self, modes: Modes, index: np.ndarray):
        self._model, self._given = modes.model, dict(modes.given)
        self._x, self._lam = modes.shapes[:, index], modes.eigenvalues[index]

    @cached_property
    def _whole(self) -> np.ndarray:
        found = self._model.pencil_gradients(self._x, self._lam, self._given)
        return found / (2 * self._lam)[:, None]

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.array(self._whole, dtype=dtype) if copy else np.asarray(self._whole, dtype=dtype)

    def __getitem__(self, key) -> np.ndarray:
        return self._whole[key]

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n_parameters)."""
        return len(self._lam), len(self._model.parameters)


class Forward:
    """Frequencies of the modes that the test saw, and their derivatives, at parameter values.

    Args:
        model: A reduced (or full) structure.
        sensors: What the test saw; None takes elastic modes in order.
        n_test: Number of test modes.
        n_modes: Number of model modes to compute.
        reference: Shapes of the test's modes at the sensors, measured or of a near model; modes
            are matched to them by MAC.
        threshold: Least visibility of a mode that the test saw.

    Raises:
        InputError: If an argument is not what it should be.

    Attributes:
        further: Forward of one mode more, where the test may have missed one; None where not.
        batches: Whether it has ``many``, for many parameter values at a time.
    """

    batches = False

    def __init__(
        self,
        model,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        reference: np.ndarray | None = None,
        threshold: float = VISIBLE,
    ):
        capable("model", model, ("parameters", "n_dofs"), "a model, whole or reduced")
        check_sight(n_test, sensors, threshold)
        whole("n_modes", n_modes)
        if reference is not None and sensors is not None:
            reference = measured("reference", reference)
            if reference.shape != (len(sensors), n_test):
                raise InputError(
                    f"reference has shape {reference.shape}: expected ({len(sensors)}, {n_test}), "
                    "a row for each sensor and a column for each mode."
                )
        self.model, self.sensors, self.n_test, self.n_modes = model, sensors, n_test, n_modes
        self.reference, self.threshold = reference, threshold
        self.further: Forward | None = None
        self._cache: dict[tuple, tuple] = {}
        self.calls = 0

    def __call__(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(ln f, d ln f / d values) of the test's modes, shapes (m,) and (m, n_parameters)."""
        key = tuple(values[name] for name in self.model.parameters)
        if key not in self._cache:
            if len(self._cache) > _MOST:
                self._cache.clear()
            modes, pairing = self.solve(values)
            log_f = np.log(modes.frequencies_hz[pairing.index])
            self._cache[key] = log_f, self._slopes(modes, pairing.index)
            self.calls += 1
        return self._cache[key]

    @property
    def mass(self) -> np.ndarray:
        """The model's nominal mass, (n_dofs, n_dofs), in which modes are compared."""
        last = self.__dict__.get("_mass")
        if last is None or last[0] is not self.model:
            last = self.__dict__["_mass"] = self.model, self.model.mass()
        return last[1]

    def _slopes(self, modes: Modes, index: np.ndarray) -> np.ndarray | Slopes:
        lazy = isinstance(self.model, ArrayModel)
        return Slopes(modes, index) if lazy else frequency_sensitivity(modes, index)

    def log_f_at(self, wanted: Sequence[Mapping[str, float]]) -> np.ndarray:
        """ln f at all these values, shape (len(wanted), m); nan where the model has too few modes
        that the test could see, and beyond the laws' limits.

        Args:
            wanted: Parameter values.
        """
        return np.array([self._or_nan(values) for values in wanted])

    def _or_nan(self, values) -> np.ndarray:
        try:
            return self(values)[0]
        except (InputError, np.linalg.LinAlgError):
            return np.full(self.n_test, np.nan)

    def solve(self, values):
        """Modes and their pairing; more modes where a soft joint puts others between the test's."""
        # From the start each time: what was asked before, or on which rank, must not matter.
        count = min(self.n_modes, self.model.n_dofs)
        while True:
            modes = solve_modes(self.model, values, n_modes=count)
            try:
                pairing = self.paired(modes)
            except InputError:
                if count >= min(_SEARCHED * self.n_modes, self.model.n_dofs):
                    raise
                count = min(count + self.n_test + SPARE, self.model.n_dofs)
                continue
            return modes, pairing

    def paired(self, modes: Modes) -> Pairing:
        """Which modes of such a model the test's are."""
        return pair_modes(
            modes, self.n_test, self.sensors, reference=self.reference, threshold=self.threshold
        )

    def of(self, model, n_modes: int | None = None) -> Forward:
        """The same of another model of the structure.

        Args:
            model: The model.
            n_modes: Number of its modes to compute; by default as many.
        """
        count = self.n_modes if n_modes is None else n_modes
        return Forward(model, self.sensors, self.n_test, count, self.reference, self.threshold)

    def pairing(self, values: Mapping[str, float]) -> Pairing:
        """Which of the model's modes the test's are."""
        return self.solve(values)[1]

    def track(self, values: Mapping[str, float]) -> None:
        """Match modes to those at these values from now on."""
        if self.sensors is not None:
            self.reference = self.solve(values)[1].shapes
            self.forget()

    def forget(self) -> None:
        """Drop what was computed, after the model has changed."""
        self._cache.clear()


def line_of(points: np.ndarray) -> np.ndarray:
    """Direction in which points extend furthest, (gdim,); the first axis for a single point."""
    spread = points - points.mean(axis=0)
    if not np.any(spread):
        return np.eye(points.shape[1])[0]
    line = np.linalg.svd(spread)[2][0]
    return line * np.sign(line[np.argmax(np.abs(line))])


def ways_of(sensors: Sensors, gdim: int) -> np.ndarray:
    """Directions in which each sensor may sit elsewhere, (n_ways, n_sensors, gdim).

    Along the line of sensors where they stand in one, or in the plane; else along the face that
    each measures normal to: as near to the longest extent of all as that goes, and across.
    """
    points = np.asarray(sensors.points)[:, :gdim]
    line = line_of(points)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if gdim < 3 or len(spread) < 2 or spread[1] < _STRAIGHT * spread[0]:
        return np.tile(line, (1, len(points), 1))
    normals, along = np.asarray(sensors.directions), np.empty((len(points), 3))
    for i, n in enumerate(normals):
        rest = np.eye(3) - np.outer(n, n)
        own = rest @ line
        if np.linalg.norm(own) < _STEEP:
            own = rest[int(np.argmin(np.abs(n)))]
        along[i] = own / np.linalg.norm(own)
    return np.stack([along, np.cross(normals, along)])
