"""Modes of a structure from its measured frequency response functions.

Poles are estimated by the least-squares complex frequency method (LSCF) of sdypy-EMA over rising
orders of the model. Those that stay are the modes; they are refined by non-linear least squares on
the functions, which takes away the bias that the method has under noise, and gives a covariance.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import InputError, real, reals, wanted, whole
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.poles import PoleFit, fit_poles
from fenics_joints.measurements.shapes import ShapeFit
from fenics_joints.response.units import KINDS

__all__ = ["IdentifiedModes", "Poles", "identify_modes"]

#: Part of the band that is put before it when it is moved to begin near 0 Hz.
_MARGIN = 0.1
#: Relative changes of frequency and damping from order to order within which a pole is stable.
_STABLE_F, _STABLE_DAMPING = 2e-3, 0.1
#: Part of the orders in which a pole must be stable to be taken for a mode.
_STAYS = 0.4
#: Draws of the residues, from which the shapes' deviations are known to 9 %.
_DRAWS = 64
#: Standard deviation of the damping, relative, above which a pole that nobody asked for is noise.
_DOUBTFUL = 0.5

#: Phase collinearity below which a mode is doubtful.
_MIXED = 0.8


@dataclass(frozen=True, eq=False)
class Poles:
    """What a stabilisation diagram shows: poles of models of rising order, n of them in all.

    Attributes:
        order: Number of modes of the model, shape (n,).
        frequencies_hz: Shape (n,).
        damping: Ratios, shape (n,).
        stable_frequency: Whether a model of one mode less has that frequency, within 0.2 %, (n,).
        stable: Whether it has that damping too, within 10 %, shape (n,).
    """

    order: np.ndarray
    frequencies_hz: np.ndarray
    damping: np.ndarray
    stable_frequency: np.ndarray
    stable: np.ndarray

    def __repr__(self) -> str:
        return f"Poles({len(self.order)} of orders up to {max(self.order, default=0)})"


@dataclass(frozen=True, eq=False)
class IdentifiedModes:
    """Modes identified from measured functions, m of them, with their standard deviations.

    The deviations are those that the residual of the fit allows, coloured as it is over frequency;
    how a test repeats itself from day to day is not in them.

    Attributes:
        frequencies_hz: Undamped natural frequencies |pole| / 2 pi, shape (m,), ascending.
        damping: Ratios, shape (m,).
        frequencies_sd: Hz, shape (m,).
        damping_sd: Shape (m,).
        shapes: Real shapes at the responses of ``frfs``, shape (n_responses, m); mass-normalised,
            1/sqrt(kg), where a driving point was measured, or else of largest component 1.
        shapes_sd: Of a component, in its unit, shape (n_responses, m).
        complex_shapes: The same shapes as identified, turned to be as real as they can.
        phase_collinearity: 1 for a real mode, towards 0 for a complex one, shape (m,).
        mass_normalised: Whether the scale of the shapes is that of the modal mass.
        scatter: Standard deviation of the stable poles' frequency over the orders, relative, and
            that of their damping, relative, shape (m, 2).
        residual: Root mean square of measured minus fitted, relative to measured.
        poles: All poles of all orders.
        frfs: The functions, in the band; forces and responses may be exchanged.
    """

    frequencies_hz: np.ndarray
    damping: np.ndarray
    frequencies_sd: np.ndarray
    damping_sd: np.ndarray
    shapes: np.ndarray
    shapes_sd: np.ndarray
    complex_shapes: np.ndarray
    phase_collinearity: np.ndarray
    mass_normalised: bool
    scatter: np.ndarray
    residual: float
    poles: Poles
    frfs: MeasuredFRFs

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return f"IdentifiedModes({len(self.damping)} modes, {low:.4g} to {high:.4g} Hz)"

    def __str__(self) -> str:
        rows = [
            f"  {f:10.3f} Hz +- {sf:.2g} Hz   {100 * z:7.3f} % +- {100 * sz:.2g} %   {c:.3f}"
            for f, sf, z, sz, c in zip(
                self.frequencies_hz, self.frequencies_sd, self.damping, self.damping_sd,
                self.phase_collinearity, strict=True,
            )
        ]  # fmt: skip
        head = f"{len(rows)} modes, residual {100 * self.residual:.2g} %"
        doubts = [
            f"{self.frequencies_hz[i]:.6g} Hz: far from a real shape; two close modes may be in it"
            for i in np.flatnonzero(self.phase_collinearity < _MIXED)
        ]
        return "\n".join([head, "   frequency, damping ratio, phase collinearity", *rows, *doubts])

    def test_data(
        self,
        names: Sequence[str] | None = None,
        condition: float = 1.0,
        condition_name: str = "row",
        condition_unit: str = "",
        noise: Sequence[float] | float = 0.0,
    ) -> TestData:
        """The modes as a test of one condition, for updating and diagnosis. Needs DOLFINx.

        Args:
            names: Of the modes; ``mode 1`` and so on by default.
            condition: Such as the torque.
            condition_name: What it is.
            condition_unit: Its unit.
            noise: Relative standard deviation of a frequency from test to test, of all or each
                mode, which the fit cannot know; it is added to that of the fit, in squares.

        Raises:
            InputError: If the names do not fit.
        """
        m = len(self.frequencies_hz)
        names = tuple(names or (f"mode {i + 1}" for i in range(m)))
        if len(names) != m:
            raise InputError(f"names = {list(names)}: expected {m}, one for each mode")
        rms = np.sqrt(np.nanmean(self.shapes**2, axis=0))
        return TestData(
            [condition], self.frequencies_hz[None], names, condition_name, condition_unit,
            damping=self.damping[None],
            noise=np.hypot(self.frequencies_sd / self.frequencies_hz, noise),
            sensors=self.frfs.sensors(), shapes=self.shapes,
            damping_noise=float(np.sqrt(np.mean((self.damping_sd / self.damping) ** 2))),
            shape_noise=float(np.sqrt(np.nanmean((self.shapes_sd / rms) ** 2))),
        )  # fmt: skip


def identify_modes(
    frfs: MeasuredFRFs,
    *,
    near: Sequence[float] | None = None,
    band: tuple[float, float] | None = None,
    order: int = 30,
    max_damping: float = 0.1,
) -> IdentifiedModes:
    """Identify the modes in a band.

    Where forces stood at more places than sensors, as with a roving hammer, the shapes are those at
    the forces, by reciprocity (H_ij = H_ji): ``frfs`` of the result has the two exchanged.

    Args:
        frfs: Measured functions; evenly spaced lines.
        near: About where the frequencies are, Hz, one for each mode; by default the modes are the
            poles that are stable in many orders.
        band: Hz, that of the data by default.
        order: Highest number of modes of a model; a few times that of the modes in the band.
        max_damping: Ratio above which a pole is none of a mode.

    Raises:
        InputError: If sdypy-EMA is missing, the lines are unevenly spaced or too few, or no pole
            is stable or none near an asked frequency.
    """
    if not isinstance(frfs, MeasuredFRFs):
        raise wanted("frfs", frfs, "MeasuredFRFs, as read_frfs gives them")
    whole("order", order, 2)
    real("max_damping", max_damping, above=0.0, most=1.0)
    if near is not None and not len(reals("near", near, (None,), "Hz", above=0.0)):
        raise wanted("near", near, "the frequency of a mode at least, or None")
    low, high = (0.0, np.inf) if band is None else reals("band", band, (2,), "Hz", least=0.0)
    data = frfs.band(max(low, np.nextafter(0.0, 1.0)), high)
    if data.values.shape[2] > data.values.shape[1]:
        data = _exchanged(data)
    measured = data.values[:, data.measured].T
    if not measured.any(axis=1).all():
        i, j = np.argwhere(data.measured)[np.argmin(measured.any(axis=1))]
        raise InputError(
            f"the function of {data.response_names[i]} by {data.reference_names[j]} is zero in the "
            "band; expected a measured one"
        )
    orders = _lscf(data, measured, order)
    poles = _diagram(orders, data, max_damping)
    groups = _groups(poles, order)
    groups = groups if near is None else _nearest(groups, poles, near, order)
    if not groups:
        raise InputError(
            f"no pole is stable between {data.frequencies_hz[0]:g} and {data.frequencies_hz[-1]:g} "
            f"Hz in models of up to {order} modes, damped below {max_damping:g}; expected another "
            "band, order or max_damping, or better data"
        )
    start = np.array([_pole(*_median(poles, group)) for group in groups])
    fit = fit_poles(data.frequencies_hz, measured, start, KINDS[data.kind])
    if near is None:
        groups, fit = _without_doubtful(groups, fit, data, measured)
    return _modes(data, measured, fit, poles, groups)


def _exchanged(data: MeasuredFRFs) -> MeasuredFRFs:
    """Forces for responses, as is the same to a linear structure (Maxwell's reciprocity)."""
    sides = {
        f"{one}_{key}": getattr(data, f"{other}_{key}")
        for one, other in (("response", "reference"), ("reference", "response"))
        for key in ("points", "directions", "names")
    }
    coherence = None if data.coherence is None else data.coherence.swapaxes(1, 2)
    return replace(data, values=data.values.swapaxes(1, 2), coherence=coherence, **sides)


# -- poles -----------------------------------------------------------------------------------------


def _lscf(data: MeasuredFRFs, measured: np.ndarray, order: int) -> list[np.ndarray]:
    """Poles, rad/s, of models of 1 to ``order`` modes.

    The band is moved to begin near 0 Hz: a model with real coefficients is badly conditioned in a
    narrow band far up, and the functions of a band are rational wherever it is put.
    """
    f = data.frequencies_hz
    if len(f) < 4 * order:
        raise InputError(
            f"order = {order}: expected at most {len(f) // 4}, a quarter of the {len(f)} lines in "
            "the band"
        )
    step = (f[-1] - f[0]) / (len(f) - 1)
    if np.abs(np.diff(f) - step).max() > 0.02 * step + 2e-5 * f[-1]:
        raise InputError("frequencies_hz: expected evenly spaced lines for the identification")
    before = int(_MARGIN * len(f)) + 1
    # The model leaves the last line out.
    moved = np.zeros((len(measured), before + len(f) + 1), dtype=complex)
    moved[:, before:-1] = measured / np.linalg.norm(measured, axis=1, keepdims=True)
    grid = step * np.arange(moved.shape[1])
    model = _ema().Model(
        moved, grid, lower=grid[before], upper=grid[-1], pol_order_high=int(order),
        frf_form=data.kind,
    )  # fmt: skip
    model.get_poles(method="lscf", show_progress=False)
    offset = 2j * np.pi * (f[0] - grid[before])
    return [np.asarray(p)[np.imag(p) > 0] + offset for p in model.all_poles]


def _ema():
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from sdypy import EMA
    except ImportError as error:
        raise InputError(
            "modal identification needs sdypy-EMA, which is not installed; expected "
            "pip install 'fenics-joints[frf]'"
        ) from error
    return EMA


def _diagram(orders: list[np.ndarray], data: MeasuredFRFs, max_damping: float) -> Poles:
    columns, before = [], np.zeros(0, dtype=complex)
    low, high = data.frequencies_hz[[0, -1]]
    for i, poles in enumerate(orders):
        f, damping = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
        kept = (f >= low) & (f <= high) & (damping > 0) & (damping < max_damping)
        f, damping = f[kept], damping[kept]
        f_old, damping_old = np.abs(before) / (2 * np.pi), -before.real / np.abs(before)
        close = np.abs(f[:, None] - f_old) < _STABLE_F * f[:, None]
        alike = np.abs(damping[:, None] - damping_old) < _STABLE_DAMPING * damping[:, None]
        columns.append((np.full(len(f), i + 1), f, damping, close.any(1), (close & alike).any(1)))
        before = poles[kept]
    return Poles(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _groups(poles: Poles, order: int) -> list[np.ndarray]:
    """Indices of the stable poles of each mode: one a little away from the next begins another.

    So do two that stand beside each other in many orders, however close.
    """
    index = np.flatnonzero(poles.stable)
    index = index[np.argsort(poles.frequencies_hz[index])]
    if not len(index):
        return []
    f = poles.frequencies_hz[index]
    parts = np.split(index, np.flatnonzero(np.diff(f) > _STABLE_F * f[1:]) + 1)
    least = max(3, _STAYS * order)
    return [
        mode
        for part in parts
        if len(np.unique(poles.order[part])) >= least
        for mode in _apart(part, poles.order[part], least)
    ]


def _apart(part: np.ndarray, orders: np.ndarray, least: float) -> list[np.ndarray]:
    """Poles of ascending frequency as the modes that they are in at least so many orders."""
    count = np.bincount(orders)
    for n in range(int(count.max()), 1, -1):
        if (count == n).sum() >= least:
            rows = [part[orders == o] for o in np.flatnonzero(count == n)]
            return list(np.array(rows).T)
    return [part]


def _nearest(groups, poles: Poles, near: Sequence[float], order: int) -> list[np.ndarray]:
    found = []
    at = np.array([_median(poles, group)[0] for group in groups])
    for f in near:
        i = int(np.argmin(np.abs(at - f))) if len(at) else -1
        if i < 0 or abs(at[i] - f) > 0.05 * f or any(groups[i] is g for g in found):
            there = ", ".join(f"{x:.5g}" for x in at) or "none"
            raise InputError(
                f"near = {f:g} Hz: expected a stable pole of its own within 5 %; in models of up "
                f"to {order} modes they are at {there} Hz"
            )
        found.append(groups[i])
    return sorted(found, key=lambda group: _median(poles, group)[0])


def _median(poles: Poles, group: np.ndarray) -> tuple[float, float]:
    return float(np.median(poles.frequencies_hz[group])), float(np.median(poles.damping[group]))


def _pole(f: float, damping: float) -> complex:
    return 2 * np.pi * f * (-damping + 1j * np.sqrt(1 - damping**2))


def _without_doubtful(groups, fit: PoleFit, data: MeasuredFRFs, measured: np.ndarray):
    """Leave out poles of which the data do not know the damping, and fit the others again."""
    sure = fit.damping_sd < _DOUBTFUL * fit.damping
    if sure.all():
        return groups, fit
    if not sure.any():
        raise InputError(
            "no pole has a damping that the data determine; expected another band, or better data"
        )
    groups = [group for group, kept in zip(groups, sure, strict=True) if kept]
    return groups, fit_poles(data.frequencies_hz, measured, fit.poles[sure], KINDS[data.kind])


# -- shapes ----------------------------------------------------------------------------------------


def _modes(data, measured, fit: PoleFit, poles: Poles, groups) -> IdentifiedModes:
    order = np.argsort(fit.frequencies_hz)
    found = [ShapeFit(data, fit, r) for r in order]
    shapes = np.column_stack([shape.value for shape in found])
    normalised = all(shape.scale > 0 for shape in found)
    scale = np.array([shape.scale for shape in found])
    if not normalised:
        scale = 1 / np.nanmax(np.abs(shapes.real), axis=0)
    draws = fit.draws(_DRAWS)
    spread = np.column_stack([
        shape.spread(draws[:, :, r], normalised) for shape, r in zip(found, order, strict=True)
    ])  # fmt: skip
    rows = ~np.isnan(shapes[:, 0])
    real, imag = shapes.real[rows], shapes.imag[rows]
    xx, yy, xy = (real**2).sum(0), (imag**2).sum(0), (real * imag).sum(0)
    scatter = np.array([
        (np.std(poles.frequencies_hz[g]) / f, np.std(poles.damping[g]) / z)
        for g, f, z in zip(groups, fit.frequencies_hz, fit.damping, strict=True)
    ])  # fmt: skip
    return IdentifiedModes(
        fit.frequencies_hz[order], fit.damping[order], fit.frequencies_sd[order],
        fit.damping_sd[order], scale * shapes.real, spread, scale * shapes,
        ((xx - yy) ** 2 + 4 * xy**2) / (xx + yy) ** 2, normalised, scatter[order],
        fit.residual, poles, data,
    )  # fmt: skip
