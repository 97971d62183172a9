"""Differences between a prediction and a target, in standard deviations, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.measurements.target import Target
from fenics_joints.updating.equations import real_rows
from fenics_joints.updating.prediction import Prediction

#: Largest relative standard deviation to which those of frequencies are widened: the usual error of
#: a finite element model. Frequencies are few, and a fit that need not meet them would follow the
#: prior alone.
_MODEL = 0.01
#: Standard deviations by which a model is taken to miss a frequency that is left out; chosen.
_MISSED = 3.0


@dataclass(frozen=True, eq=False)
class Widths:
    """Factors by which standard deviations are widened to what a fit leaves, 1 or more.

    Attributes:
        frequencies: Of all frequencies.
        shapes: Of each shape that is data, in their order.
        damping: Of all damping ratios.
        without: Modes that are left out, by their number from 0: their partners change.
    """

    frequencies: float = 1.0
    shapes: tuple[float, ...] = ()
    damping: float = 1.0
    without: tuple[int, ...] = ()

    @property
    def factors(self) -> np.ndarray:
        """All of them, in the order of the residuals."""
        return np.array([self.frequencies, *self.shapes, self.damping])

    def change(self, other: Widths) -> float:
        """Largest change of a factor's logarithm."""
        return float(np.abs(np.log(self.factors / other.factors)).max())


class Residuals:
    """Residuals of ln f, of shapes, of ln zeta, of Re ln H and of Im ln H, model less test.

    A shape's are those of the test's shape, of root mean square 1, less the multiple of the model's
    that is nearest. The phase is that of H_model / H_test, from -pi to pi: nothing is unwrapped.

    Args:
        target: The data.

    Attributes:
        count: Number of independent data: a shape has one less than it has components.
        widths: Factors of the standard deviations of frequencies, shapes and damping ratios.
    """

    def __init__(self, target: Target):
        self.target = target
        self.f_used = np.isfinite(target.frequencies_hz)
        self.zeta_used = np.isfinite(target.damping_ratios)
        self.frf_sd = None if target.frfs is None else target.frfs.relative_sd
        self.modes: list[tuple[int, np.ndarray, np.ndarray]] = []
        if "shapes" in target.kinds:
            for i in np.flatnonzero(np.isfinite(target.shape_sd)):
                there = np.isfinite(target.shapes[:, i])
                shape = target.shapes[there, i]
                self.modes.append((int(i), there, shape / np.sqrt(np.mean(shape**2))))
        frfs = 0 if target.frfs is None else 2 * int(target.frfs.used.sum())
        shapes = sum(len(shape) - 1 for _, _, shape in self.modes)
        self.widths = Widths(shapes=(1.0,) * len(self.modes))
        self.count = int(self.f_used.sum() + self.zeta_used.sum()) + shapes + frfs

    def values(self, found: Prediction, *, widened: bool = True) -> np.ndarray:
        """The residuals, (r,); in the data's own standard deviations unless ``widened``."""
        values = np.concatenate([part[0] for part in self._parts(found)])
        return values / self._factors(len(values)) if widened else values

    def chi2(self, found: Prediction) -> tuple[float, int]:
        """Sum of squares in the data's own standard deviations, and how many independent data it
        has; modes that are left out do not count."""
        values = self.values(found, widened=False)
        counted = np.isfinite(self._factors(len(values)))
        shapes = sum(i in self.widths.without for i, _, _ in self.modes)
        return float(np.sum(values[counted] ** 2)), self.count - int(np.sum(~counted)) + shapes

    def slopes(self, found: Prediction) -> np.ndarray:
        """Their derivatives by the parameters' values, (r, p)."""
        slopes = np.concatenate([part[1] for part in self._parts(found)])
        return slopes / self._factors(len(slopes))[:, None]

    def _modes(self) -> list[np.ndarray]:
        """The mode of each residual, for each part but those of FRFs."""
        parts = [np.flatnonzero(self.f_used)] * bool(self.f_used.any())
        parts += [np.full(len(shape), i) for i, _, shape in self.modes]
        return parts + [np.flatnonzero(self.zeta_used)] * bool(self.zeta_used.any())

    def _factors(self, count: int) -> np.ndarray:
        """What each residual is divided by, (count,)."""
        widths = [self.widths.frequencies] * bool(self.f_used.any())
        widths += [*self.widths.shapes, *[self.widths.damping] * bool(self.zeta_used.any())]
        factors, at = np.ones(count), 0
        for width, modes in zip(widths, self._modes(), strict=True):
            left_out = np.isin(modes, self.widths.without)
            factors[at : at + len(modes)] = np.where(left_out, np.inf, width)
            at += len(modes)
        return factors

    def left(self, found: Prediction, slopes: np.ndarray | None = None) -> Widths:
        """The widths that what is left has, s^2 = chi^2 / (n - p) of each kind and shape; of
        frequencies as far as a model's usual error.

        Args:
            found: What the model says.
            slopes: Derivatives of the residuals, as they are widened now, and of a prior, by the
                coordinates, (r, k), from which p is counted; None for p = 0.
        """
        values, parts, at, widths = self.values(found, widened=False), self._modes(), 0, []
        taken = np.zeros(len(values))
        if slopes is not None:
            left, s, _ = np.linalg.svd(slopes, full_matrices=False)
            taken = np.sum(left[: len(taken), s > 1e-10 * s[0]] ** 2, axis=1)
        for modes in parts:
            here = at + np.flatnonzero(~np.isin(modes, self.widths.without))
            free = max(len(here) - float(taken[here].sum()), 1.0)
            widths.append(max(1.0, float(np.sqrt(np.sum(values[here] ** 2) / free))))
            at += len(modes)
        first, last = int(self.f_used.any()), int(self.f_used.any()) + len(self.modes)
        if first:
            usual = float(np.median(self.target.log_sd[self.f_used]))
            widths[0] = min(widths[0], max(1.0, _MODEL / usual))
        return Widths(
            widths[0] if first else 1.0,
            tuple(widths[first:last]),
            widths[last] if self.zeta_used.any() else 1.0,
            self.widths.without,
        )

    def volume(self) -> float:
        """What the logarithm of a density loses by the widths, and by modes that are left out."""
        widths = self._factors(sum(map(len, self._modes())))
        return float(np.sum(np.log(widths[np.isfinite(widths)]))) + self.lost(self.widths)

    def lost(self, widths: Widths) -> float:
        """What it loses by modes that are left out: as much as by a model that misses them, a
        frequency by three standard deviations and a shape altogether."""
        lost = 0.0
        for i in widths.without:
            lost += 0.5 * _MISSED**2 * (int(self.f_used[i]) + int(self.zeta_used[i]))
            sizes = [len(shape) for j, _, shape in self.modes if j == i]
            lost += sum(sizes) * (0.5 - np.log(min(self.target.shape_sd[i], 1.0))) if sizes else 0.0
        return float(lost)

    def _parts(self, found: Prediction):
        target, used = self.target, self.f_used
        if used.any():
            slip = np.log(found.frequencies_hz[used] / target.frequencies_hz[used])
            sd = target.log_sd[used]
            yield slip / sd, found.frequency_slopes[used] / sd[:, None]
        for mode in self.modes:
            yield self._shape(found, *mode)
        used = self.zeta_used
        if used.any():
            zeta, sd = found.damping_ratios[used], target.damping_log_sd[used]
            slopes = found.damping_slopes[used] / zeta[:, None]
            yield np.log(zeta / target.damping_ratios[used]) / sd, slopes / sd[:, None]
        if target.frfs is not None:
            there = target.frfs.used
            sd, values = self.frf_sd[there], found.frfs[there]
            ratio = np.log(values / target.frfs.values[there]) / sd
            slopes = found.frf_slopes[there] / (values * sd)[:, None]
            yield ratio.real, slopes.real
            yield ratio.imag, slopes.imag

    def _shape(self, found: Prediction, i: int, there, shape) -> tuple[np.ndarray, np.ndarray]:
        """t - a x with a = (x t) / (x x), and its derivative, over the standard deviation."""
        x, slopes = found.shapes[there, i], found.shape_slopes[there, i]
        size = x @ x
        a = x @ shape / size
        by_a = (shape - 2 * a * x) @ slopes / size
        sd = self.target.shape_sd[i]
        return (a * x - shape) / sd, (x[:, None] * by_a + a * slopes) / sd

    # -- moved lines ---------------------------------------------------------------------------

    def weaken(self, sd: float) -> None:
        """Give the FRFs this relative standard deviation beside that of their noise."""
        self.frf_sd = np.hypot(self.target.frfs.relative_sd, sd)

    def inflate(self, found: Prediction, moves: np.ndarray) -> None:
        """Add to the FRFs' noise what errors of the test's frequencies do through moved lines."""
        by_line = np.abs(found.frf_by_line / found.frfs)
        sd = np.where(self.f_used, self.target.log_sd, 0.0)
        moved = np.sqrt((moves**2) @ sd**2)[:, None, None]
        self.frf_sd = np.hypot(self.target.frfs.relative_sd, by_line * moved)

    def noise(self, found: Prediction, moves: np.ndarray) -> np.ndarray:
        """Residuals per standard deviation of each datum, (r, number of data), with moved lines.

        One of the frequencies changes its own residual and, through the lines, those of the FRFs.
        """
        sizes = [len(part[0]) for part in self._parts(found)]
        noise = np.eye(sum(sizes))
        there, n = self.target.frfs.used, int(self.f_used.sum())
        own = (self.target.frfs.relative_sd / self.frf_sd)[there]
        rows = np.arange(len(noise) - 2 * len(own), len(noise))
        noise[rows, rows] = np.tile(own, 2)
        # The model's line is that of the test by the slip, so that an error of ln f_test enters
        # through it with the sign of its own residual.
        change = found.frf_by_line[..., None] * moves[:, None, None, :]
        change = change / (found.frfs * self.frf_sd)[..., None]
        change = change[there][:, self.f_used] * self.target.log_sd[self.f_used]
        noise[rows[: len(own)], :n], noise[rows[len(own) :], :n] = change.real, change.imag
        return noise


def relative_errors(target: Target, found: Prediction) -> tuple[np.ndarray, tuple[float, float]]:
    """Frequencies, model over test less 1, (m,); and the FRFs' relative errors: median, largest."""
    frequencies = np.full(len(target), np.nan)
    if len(target):
        frequencies = found.frequencies_hz / target.frequencies_hz - 1.0
    if target.frfs is None:
        return frequencies, (np.nan, np.nan)
    there = target.frfs.used
    off = np.abs(found.frfs[there] / target.frfs.values[there] - 1.0)
    return frequencies, (float(np.median(off)), float(off.max()))


def raw_rows(target: Target, found: Prediction, how: str) -> tuple[np.ndarray, np.ndarray, int]:
    """A and b of Machines 2022, eqs. 16 and 17, and how many rows are frequencies."""
    used = np.isfinite(target.frequencies_hz)
    f = found.frequencies_hz[used]
    rows = [(f[:, None] * found.frequency_slopes[used], target.frequencies_hz[used] - f)]
    if target.frfs is not None:
        there = target.frfs.used
        rows.append(
            real_rows(found.frf_slopes[there], target.frfs.values[there], found.frfs[there], how)
        )
    A, b = (np.concatenate([r[i] for r in rows]) for i in range(2))
    return A, b, int(used.sum())


def row_sd(target: Target, found: Prediction, how: str) -> np.ndarray:
    """Standard deviations of b."""
    used = np.isfinite(target.frequencies_hz)
    parts = [target.frequencies_hz[used] * target.log_sd[used]]
    if target.frfs is not None:
        there = target.frfs.used
        sd = (target.frfs.relative_sd * np.abs(target.frfs.values))[there]
        parts += [sd, sd] if how == "parts" else [sd]
    return np.concatenate(parts)
