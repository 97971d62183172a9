"""What a model is updated on: frequencies, shapes, damping ratios and FRFs, in any mix."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import InputError, measured, wanted
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.response.units import checked_kind
from fenics_joints.structure.points import Sensors

#: The kinds of data, in the order of their residuals.
DATA = ("frequencies", "shapes", "damping", "frfs")


@dataclass(frozen=True, eq=False)
class FRFTarget:
    """Measured FRFs at some lines, with their noise.

    The noise of a value H is H sd (a + i b), with a and b of standard deviation 1: that of |H|
    relative to it and that of its phase, rad, are both ``relative_sd``.

    Attributes:
        frequencies_hz: Lines, Hz, above 0, (n_f,).
        values: SI units, complex, with exp(+i w t), (n_f, n_sensors, n_excitations); nan where a
            pair was not measured.
        sensors: Where and in which direction the response was measured.
        excitation: Where and in which direction the forces acted.
        kind: ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
        relative_sd: Relative standard deviation, a number or of the shape of ``values``, or one
            that can be spread to it.

    Raises:
        InputError: For a shape, line, value or standard deviation that cannot be.
    """

    frequencies_hz: np.ndarray
    values: np.ndarray
    sensors: Sensors
    excitation: Sensors
    kind: str = "receptance"
    relative_sd: float | np.ndarray = 0.02

    def __post_init__(self):
        checked_kind(self.kind)
        lines = np.atleast_1d(measured("frfs.frequencies_hz", self.frequencies_hz))
        values = measured("frfs.values", self.values, "iufc").astype(complex)
        for key in ("sensors", "excitation"):
            if not isinstance(getattr(self, key), Sensors):
                raise wanted(f"frfs.{key}", getattr(self, key), "Sensors")
        expected = len(lines), len(self.sensors), len(self.excitation)
        if values.shape != expected:
            raise InputError(f"frfs.values have shape {values.shape}: expected {expected}")
        if not len(lines) or not np.all((lines > 0) & np.isfinite(lines)):
            raise InputError("frfs.frequencies_hz: expected lines above 0 Hz, finite")
        used = np.isfinite(values)
        if not used.any() or np.any(values[used] == 0):
            raise InputError("frfs.values: expected numbers other than 0, nan where not measured")
        sd = measured("relative_sd", self.relative_sd)
        try:
            sd = np.broadcast_to(sd, values.shape).copy()
        except ValueError as error:
            raise InputError(
                f"frfs.relative_sd has shape {sd.shape}: expected a number or {values.shape}"
            ) from error
        if not np.all((sd > 0) & np.isfinite(sd) | ~used):
            raise InputError("frfs: expected standard deviations above 0 where there are values")
        for key, value in (("frequencies_hz", lines), ("values", values), ("relative_sd", sd)):
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        lines, responses, forces = self.values.shape
        return f"FRFTarget({self.kind}, {lines} lines, {responses} x {forces} functions)"

    @classmethod
    def from_measured(
        cls, frfs: MeasuredFRFs, lines: Sequence[int], relative_sd: float | np.ndarray = 0.02
    ) -> FRFTarget:
        """The FRFs of a test at some of its lines.

        Args:
            frfs: The functions; see `fenics_joints.measurements.read_frfs`.
            lines: Indices of the lines, such as `measurements.frfs.choose_lines` gives.
            relative_sd: Relative standard deviation, a number or of the shape of the functions'
                values, such as `MeasuredFRFs.stated_sd` gives.
        """
        sd = np.broadcast_to(relative_sd, frfs.values.shape)[lines]
        force = Sensors(frfs.reference_points, frfs.reference_directions)
        hz, values = frfs.frequencies_hz[lines], frfs.values[lines]
        return cls(hz, values, frfs.sensors(), force, frfs.kind, sd)

    @property
    def used(self) -> np.ndarray:
        """Which values were measured, bool, the values' shape."""
        return np.isfinite(self.values)


@dataclass(frozen=True, eq=False)
class Target:
    """Data of a test that a model is updated on; at least one kind of them.

    Attributes:
        frequencies_hz: Natural frequencies of the test's modes, Hz, (m,); nan where missing.
        log_sd: Standard deviation of their logarithms, a number or (m,).
        shapes: Real shapes at ``shape_sensors``, of any scale, (n_s, m); nan where missing. Model
            modes are paired to the test's by MAC with them; without, in order.
        shape_sensors: Where they were measured. Without shapes: whose sight says which of the
            model's modes the test could see.
        shape_sd: Standard deviation of a shape's components, relative to their root mean square, a
            number or (m,). None, or nan for a mode: the shapes pair modes and are no data.
        damping_ratios: Of the test's modes, (m,); nan where missing.
        damping_log_sd: Standard deviation of their logarithms, a number or (m,).
        frfs: The FRFs.

    Raises:
        InputError: If shapes or numbers do not fit, or there are no data.
    """

    frequencies_hz: np.ndarray | None = None
    log_sd: float | np.ndarray = 1e-3
    shapes: np.ndarray | None = None
    shape_sensors: Sensors | None = None
    shape_sd: float | np.ndarray | None = None
    damping_ratios: np.ndarray | None = None
    damping_log_sd: float | np.ndarray = 0.1
    frfs: FRFTarget | None = None

    def __post_init__(self):
        if self.frfs is not None and not isinstance(self.frfs, FRFTarget):
            raise wanted("frfs", self.frfs, "an FRFTarget, or None")
        m = self._count()
        for key, sd in (("frequencies_hz", "log_sd"), ("damping_ratios", "damping_log_sd")):
            value = getattr(self, key)
            value = np.full(m, np.nan) if value is None else measured(key, value)
            if value.shape != (m,) or np.any(value <= 0) or np.isinf(value).any():
                raise InputError(f"{key}: expected {m} numbers above 0, nan where missing")
            object.__setattr__(self, key, value)
            object.__setattr__(self, sd, self._deviations(sd, m))
        if self.shapes is not None:
            self._check_shapes(m)
        if not self.kinds:
            raise InputError("expected data: frequencies, shapes with shape_sd, damping or FRFs")

    def _count(self) -> int:
        given = (self.frequencies_hz, self.damping_ratios, self.shapes)
        arrays = [measured("data", a, "iufc") for a in given if a is not None]
        sizes = [a.shape[-1] for a in arrays if a.ndim]
        return sizes[0] if sizes else 0

    def _deviations(self, key: str, m: int) -> np.ndarray:
        sd = measured(key, getattr(self, key))
        if sd.shape not in ((), (m,)) or not np.all((sd > 0) & np.isfinite(sd)):
            raise InputError(f"{key}: expected one number above 0, or {m}")
        return np.broadcast_to(sd, m).copy()

    def _check_shapes(self, m: int) -> None:
        shapes = np.asarray(self.shapes)
        if np.iscomplexobj(shapes):
            raise InputError(
                "shapes are complex: expected real ones, such as their real parts "
                "after a turn that makes the imaginary ones least"
            )
        shapes = shapes.astype(float)
        if self.shape_sensors is None:
            raise InputError("shape_sensors is missing: expected it with shapes")
        expected = len(self.shape_sensors), m
        if shapes.shape != expected or not np.all(np.nansum(shapes**2, axis=0) > 0):
            raise InputError(
                f"shapes: expected {expected[0]} x {expected[1]} numbers, in no column all zero"
            )
        object.__setattr__(self, "shapes", shapes)
        sd = measured("shape_sd", np.nan if self.shape_sd is None else self.shape_sd)
        if sd.shape not in ((), (m,)) or np.any(sd <= 0) or np.isinf(sd).any():
            raise InputError(f"shape_sd: expected one number above 0, {m} of them, or None")
        object.__setattr__(self, "shape_sd", np.broadcast_to(sd, m).copy())

    def __repr__(self) -> str:
        return f"Target({len(self)} modes: {', '.join(self.kinds)})"

    def __len__(self) -> int:
        """Number of the test's modes."""
        return len(self.frequencies_hz)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Which of `DATA` there are."""
        there = (
            np.isfinite(self.frequencies_hz).any(),
            self.shapes is not None and np.isfinite(self.shape_sd).any(),
            np.isfinite(self.damping_ratios).any(),
            self.frfs is not None,
        )
        return tuple(kind for kind, is_there in zip(DATA, there, strict=True) if is_there)

    def only(self, *kinds: str) -> Target:
        """The same with some kinds of data alone; shapes still pair the modes.

        Raises:
            InputError: For an unknown kind, or one that there is not.
        """
        for kind in kinds:
            if kind not in self.kinds:
                raise InputError(f"data {kind!r}: expected among {', '.join(self.kinds)}")
        none = np.full(len(self), np.nan)
        return replace(
            self,
            frequencies_hz=self.frequencies_hz if "frequencies" in kinds else none,
            shape_sd=self.shape_sd if "shapes" in kinds else None,
            damping_ratios=self.damping_ratios if "damping" in kinds else none,
            frfs=self.frfs if "frfs" in kinds else None,
        )

    def without_modes(self, modes: Iterable[int]) -> Target:
        """The same with some of the test's modes held out: their frequencies and damping ratios are
        missing; their shapes still pair modes and are no data."""
        held = np.zeros(len(self), dtype=bool)
        held[list(modes)] = True
        shape_sd = None if self.shapes is None else np.where(held, np.nan, self.shape_sd)
        return replace(
            self,
            frequencies_hz=np.where(held, np.nan, self.frequencies_hz),
            damping_ratios=np.where(held, np.nan, self.damping_ratios),
            shape_sd=shape_sd,
        )
