"""What a vibration test measured: frequencies and damping by mode and by test condition."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import InputError, items, measured, real, reals, wanted
from fenics_joints.structure.points import Sensors
from fenics_joints.units import factor_to_si

#: Units of a level of excitation or response; g by itself, since Pint's g is a gram.
_LEVELS, _GRAVITY = ("N", "m", "m/s", "m/s2"), ("g", "gn", "g_n")
#: Words of a condition that is a preload whatever its unit.
_PRELOADS = re.compile(r"torque|preload|tension|clamp", re.IGNORECASE)
#: Relative standard deviation of damping ratios of a test that does not say it: assumed.
_DAMPING_NOISE = 0.1
#: Relative distance below which two values of a condition are the same: a torque or a preload is
#: known to a thousandth at best, so that nothing depends on it within a factor of a hundred.
_ONE_CONDITION = 1e-6


@dataclass(frozen=True, eq=False)
class TestData:
    """Measured modes under several conditions, such as the bolts' torques.

    Attributes:
        conditions: Value of the condition of each row, in its own unit, shape (n,); increasing.
        frequencies_hz: Natural frequencies, Hz, shape (n, m); nan where not measured.
        mode_names: Names of the modes, m of them.
        condition_name: What the condition is, such as ``torque``.
        condition_unit: Its unit, as written in the data.
        damping: Damping ratios (not per cent), shape (n, m), nan where not measured; or None.
        resolution_hz: Spacing of the analyser's lines, Hz, shape (m,); 0 where it does not matter.
        noise: Relative standard deviation of a frequency, shape (m,).
        sensors: Where and in which direction the test measured, or None if unknown.
        shapes: Measured mode shapes at the sensors, in any scale, shape (n_sensors, m), nan where
            a sensor was missing; or None.
        damping_noise: Relative standard deviation of a damping ratio; None if the test does not
            say it.
        shape_noise: Standard deviation of a shape's component, relative to its root mean square.
        shapes_at: The condition that the shapes were measured at; the last by default.
        notes: What is doubtful in its files, in sentences.
        known: Values of the model's parameters after a known change of the structure, by row; empty
            for rows of the structure as it is. The changed rows come last, at conditions of other
            rows. Without any change an empty tuple.
        row_names: Names of the changed rows, ``""`` for the others; as many as ``known``.
    """

    #: Not a test, whatever pytest thinks of the name.
    __test__ = False

    conditions: np.ndarray
    frequencies_hz: np.ndarray
    mode_names: tuple[str, ...]
    condition_name: str = "condition"
    condition_unit: str = ""
    damping: np.ndarray | None = None
    resolution_hz: np.ndarray | float = 0.0
    noise: np.ndarray | float = 0.0
    sensors: Sensors | None = None
    shapes: np.ndarray | None = None
    damping_noise: float | None = None
    shape_noise: float = 0.05
    shapes_at: float | None = None
    notes: tuple[str, ...] = ()
    known: tuple[Mapping[str, float], ...] = ()
    row_names: tuple[str, ...] = ()

    def __post_init__(self):
        conditions = np.atleast_1d(reals("conditions", self.conditions))
        names = items("mode_names", self.mode_names, str, "names of modes")
        if conditions.ndim != 1 or len(set(names)) < len(names):
            raise InputError(
                f"conditions of shape {conditions.shape}, mode_names = {names}: expected a list of "
                "conditions, and each name once."
            )
        self._check_rest()
        if len(self.known) not in (0, len(conditions)) or len(self.known) != len(self.row_names):
            raise InputError(
                f"known, row_names: expected as many as rows, {len(conditions)}, or none."
            )
        shape = (len(conditions), len(names))
        arrays = {"conditions": conditions, "mode_names": names}
        tables = {"frequencies_hz": "above 0"}
        tables |= {} if self.damping is None else {"damping": "of at least 0"}
        for key, least in tables.items():
            arrays[key] = np.atleast_2d(measured(key, getattr(self, key)))
            if np.any(arrays[key] < 0) or (key != "damping" and np.any(arrays[key] == 0)):
                raise InputError(f"{key}: expected numbers {least}, nan where not measured.")
            if arrays[key].shape != shape:
                raise InputError(
                    f"{key} has shape {arrays[key].shape}: expected {shape}, one row for each "
                    "condition and one column for each mode."
                )
        for key in ("resolution_hz", "noise"):
            value = reals(key, getattr(self, key), least=0.0)
            if value.ndim and value.shape != shape[1:]:
                raise InputError(
                    f"{key} has {value.size} values: expected one for all modes or {shape[1]}, "
                    "one for each."
                )
            arrays[key] = np.broadcast_to(value, shape[1:]).copy()
        if self.shapes is not None:
            arrays["shapes"] = self._checked_shapes()
        for key, value in arrays.items():
            object.__setattr__(self, key, value)

    def _check_rest(self) -> None:
        """Check the attributes that are not arrays."""
        real("shape_noise", self.shape_noise, least=0.0)
        if self.damping_noise is not None:
            real("damping_noise", self.damping_noise, least=0.0)
        if self.sensors is not None and not isinstance(self.sensors, Sensors):
            raise wanted("sensors", self.sensors, "Sensors, or None")
        for key in ("condition_name", "condition_unit"):
            if not isinstance(getattr(self, key), str):
                raise wanted(key, getattr(self, key), "a text")

    @classmethod
    def of_modes(
        cls,
        frequencies_hz: np.ndarray,
        names: Sequence[str] | None = None,
        condition: float = 1.0,
        condition_name: str = "row",
        **more: object,
    ) -> TestData:
        """A test of modes at one condition.

        Args:
            frequencies_hz: Hz, (m,).
            names: Of the modes; ``mode 1`` and so on by default.
            condition: Value of the condition.
            condition_name: What the condition is.
            more: Other attributes.

        Raises:
            InputError: If there are other than as many names as modes.
        """
        m = len(frequencies_hz)
        names = tuple(names or (f"mode {i + 1}" for i in range(m)))
        if len(names) != m:
            hertz = ", ".join(f"{f:.5g}" for f in frequencies_hz)
            raise InputError(f"{len(names)} modes are named: expected {m}, those at {hertz} Hz")
        return cls([condition], frequencies_hz[None], names, condition_name, **more)

    def __repr__(self) -> str:
        shapes = "" if self.shapes is None else f", shapes at {len(self.sensors)} sensors"
        where = f"{len(self)} values of {self.condition_name}"
        return f"TestData({len(self.mode_names)} modes at {where}{shapes})"

    def _checked_shapes(self) -> np.ndarray:
        shapes = np.atleast_2d(measured("shapes", self.shapes))
        if self.sensors is None:
            raise InputError("shapes: expected sensors too, to say where they were measured.")
        expected = (len(self.sensors), len(self.mode_names))
        if shapes.shape != expected:
            raise InputError(
                f"shapes have shape {shapes.shape}: expected {expected}, one row for each sensor "
                "and one column for each mode."
            )
        if np.any(np.isinf(shapes)) or not np.all(np.nansum(shapes**2, axis=0) > 0):
            raise InputError(
                "shapes: expected finite values, empty cells for sensors that were missing, and no "
                "mode of zeros."
            )
        if self.shapes_at is not None:
            self.row(self.shapes_at)
        return shapes

    @property
    def shape_row(self) -> int:
        """Row of the condition that the shapes were measured at."""
        return len(self) - 1 if self.shapes_at is None else self.row(self.shapes_at)

    @property
    def damping_sd(self) -> float:
        """Relative standard deviation of a damping ratio: 10 % if the test does not say it."""
        return _DAMPING_NOISE if self.damping_noise is None else self.damping_noise

    def __len__(self) -> int:
        return len(self.conditions)

    @property
    def by_level(self) -> bool:
        """Whether the condition is a level of force or amplitude, and not a torque or preload.

        The unit decides: that of a force, a length, a velocity or an acceleration (also g) is a
        level's, unless the name speaks of a torque, preload, tension or clamping.
        """
        unit = self.condition_unit
        if not unit or _PRELOADS.search(self.condition_name):
            return False
        return unit in _GRAVITY or any(_measures(unit, level) for level in _LEVELS)

    def log_sd(self) -> np.ndarray:
        """Standard deviation of ln f, shape (n, m).

        The noise, and the rounding to the analyser's lines: an error that is even over a line
        spacing d has the standard deviation d / sqrt(12).
        """
        rounding = self.resolution_hz / math.sqrt(12) / self.frequencies_hz
        return np.sqrt(self.noise**2 + rounding**2)

    def row(self, condition: float | None) -> int:
        """Row of a condition, None for the last one.

        Raises:
            InputError: If it was not measured; names what there is.
        """
        if condition is None:
            return len(self) - 1
        found = np.flatnonzero(np.isclose(self.conditions, condition, rtol=1e-9, atol=0))
        if not len(found):
            there = ", ".join(f"{c:g}" for c in self.conditions)
            raise InputError(
                f"{self.condition_name} = {condition:g} was not measured: expected one of {there} "
                f"{self.condition_unit}".rstrip()
            )
        return int(found[0])

    def select(self, conditions: Iterable[float]) -> TestData:
        """The rows of these conditions, in the order given; raises InputError for one not there."""
        return self._rows([self.row(c) for c in conditions])

    def without(self, conditions: Iterable[float]) -> TestData:
        """All rows but those of these conditions; raises InputError for one not there."""
        out = {self.row(c) for c in conditions}
        return self._rows([i for i in range(len(self)) if i not in out])

    def first_modes(self, n: int) -> TestData:
        """The first n modes alone."""
        return self.with_modes(range(n))

    def with_modes(self, kept: Iterable[int]) -> TestData:
        """Some of the modes alone, by index."""
        kept = [i for i in kept if i < len(self.mode_names)]
        cut = {
            key: None if getattr(self, key) is None else getattr(self, key)[..., kept]
            for key in ("frequencies_hz", "damping", "resolution_hz", "noise", "shapes")
        }
        return replace(self, mode_names=tuple(self.mode_names[i] for i in kept), **cut)

    def without_modes(self, out: Iterable[int]) -> TestData:
        """The data without some modes, by index. Without shapes, modes are paired by order, so the
        places of the removed modes stay, without values."""
        out = sorted(set(out))
        if self.shapes is not None:
            return self.with_modes(i for i in range(len(self.mode_names)) if i not in out)
        gone = {}
        for key in ("frequencies_hz", "damping"):
            if getattr(self, key) is not None:
                gone[key] = getattr(self, key).copy()
                gone[key][:, out] = np.nan
        return replace(self, **gone)

    @property
    def as_it_is(self) -> TestData:
        """The rows without a known change."""
        if not any(self.known):
            return self
        plain = replace(self, known=(), row_names=())
        return plain._rows([i for i, known in enumerate(self.known) if not known])

    def again(
        self,
        name: str,
        frequencies_hz: np.ndarray,
        known: Mapping[str, float],
        condition: float | None = None,
    ) -> TestData:
        """The same with one more row, measured after a known change of the structure.

        Args:
            name: Of the row.
            frequencies_hz: Hz, (m,); nan where not measured.
            known: Values that parameters of the model had then.
            condition: One of those that were measured; the last by default.

        Raises:
            InputError: If that was not measured, or this is a test by level.
        """
        if self.by_level or self.damping is not None:
            raise InputError(
                f"{name}: a test after a change goes with frequencies by torque or preload, "
                "without damping; expected no levels and no damping."
            )
        at = self.as_it_is.row(condition)
        before = self.known or ({},) * len(self)
        return replace(
            self,
            conditions=np.append(self.conditions, self.conditions[at]),
            frequencies_hz=np.vstack([self.frequencies_hz, frequencies_hz]),
            shapes_at=float(self.conditions[self.shape_row]) if self.shapes is not None else None,
            known=(*before, dict(known)),
            row_names=(*(self.row_names or ("",) * len(self)), name),
        )

    def _rows(self, rows: Sequence[int]) -> TestData:
        rows = np.asarray(rows, dtype=int)
        damping = None if self.damping is None else self.damping[rows]
        kept = self.shapes is not None and self.shape_row in rows
        return replace(
            self,
            shapes=self.shapes if kept else None,
            shapes_at=float(self.conditions[self.shape_row]) if kept else None,
            conditions=self.conditions[rows],
            known=tuple(self.known[i] for i in rows) if self.known else (),
            row_names=tuple(self.row_names[i] for i in rows) if self.known else (),
            frequencies_hz=self.frequencies_hz[rows].reshape(len(rows), len(self.mode_names)),
            damping=damping,
        )


def _measures(unit: str, kind: str) -> bool:
    try:
        factor_to_si(unit, kind)
    except InputError:
        return False
    return True


def same_conditions(conditions: Iterable[float]) -> str | None:
    """What is wrong with conditions that are not distinct, in words; None if they are.

    Two that differ by less than a millionth are one condition, rounded or copied.
    """
    values = np.sort(np.asarray(list(conditions), dtype=float))
    size = np.maximum(np.abs(values[1:]), np.abs(values[:-1]))
    near = np.flatnonzero(np.diff(values) <= _ONE_CONDITION * size)
    if not len(near):
        return None
    a, b = float(values[near[0]]), float(values[near[0] + 1])
    if a == b:
        return f"{a:g} is there twice, expected each value once"
    return f"{a!r} and {b!r} are one within {_ONE_CONDITION:g} of it, expected each value once"
