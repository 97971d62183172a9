"""Backbones from stepped or slowly swept sines, at constant response or at constant force.

At a steady sine the first harmonic of a mode obeys F / X = k(a) - m w^2 + i w c(a), a = |X|: the
describing function. Where a is held constant over the sweep, k and c are numbers and the response
is that of a linear oscillator (Karaagacli and Ozguven, Mech. Syst. Signal Process. 149, 2021).
Other modes add a constant r to X / F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fenics_joints.errors import InputError, located, reals
from fenics_joints.measurements.amplitude.backbone import RESPONSES, MeasuredBackbone
from fenics_joints.measurements.least_squares import LeastSquares
from fenics_joints.response.units import KINDS as TIMES

#: Residuals beyond this many deviations count by their size, no longer by its square.
_OUTLIER = 3.0
#: Largest correlation of neighbouring residuals that a deviation is widened for.
_CORRELATED = 0.8
#: Fewer points than this say nothing of other modes.
_FOR_REST = 10


@dataclass(frozen=True, eq=False)
class OscillatorFit:
    """Natural frequencies and damping ratios at the amplitudes of the basis.

    Attributes:
        frequencies_hz, frequencies_sd: Hz, (L,).
        damping, damping_sd: Ratios, (L,).
        scatter: Root mean square of the relative residuals.
    """

    frequencies_hz: np.ndarray
    frequencies_sd: np.ndarray
    damping: np.ndarray
    damping_sd: np.ndarray
    scatter: float


def fit_oscillator(
    omega: np.ndarray, receptance: np.ndarray, basis: np.ndarray, *, phase: bool
) -> OscillatorFit:
    """Fit k(a), c(a) and m to responses, by least squares of relative errors, outliers damped.

    Args:
        omega: Angular frequencies, rad/s, (n,), one sweep after another.
        receptance: Displacement over force, m/N, complex, (n,); its size alone without ``phase``.
        basis: Shares of L amplitudes, at which k and c are unknown, in each point's, (n, L).
        phase: Whether the phase is known.

    Raises:
        InputError: If there are fewer data than unknowns, or no resonance in them.
    """
    unknowns = 2 * basis.shape[1] + 1
    if (1 + phase) * len(omega) < unknowns + 2:
        raise InputError(
            f"{len(omega)} points near the resonance for {unknowns} unknowns; expected more of them"
        )
    line = _Line(omega, receptance, basis, phase)
    fit = LeastSquares(line.residual)
    found = fit.solve(line.start, 500, x_scale=line.scale)
    scale = 1.4826 * float(np.median(np.abs(found.fun)))
    if scale > 0:
        loss = {"loss": "soft_l1", "f_scale": _OUTLIER * scale}
        found = fit.solve(found.x, 500, x_scale=line.scale, **loss)
    return line.result(found.x, found.jac, line.residual(found.x))


class _Line:
    """The equations in units of the largest response and its frequency."""

    def __init__(self, omega, receptance, basis, phase: bool):
        top = int(np.argmax(np.abs(receptance)))
        self.omega, self.basis, self.phase = omega[top], basis, phase
        self.u, self.h = omega / omega[top], receptance / np.abs(receptance[top])
        self.L = basis.shape[1]
        self.has_rest = len(omega) >= _FOR_REST
        self.start = self._from_phase() if phase else self._from_size()
        small = np.full(self.L, 0.1)
        self.scale = np.concatenate([small, small, [0.1 * abs(self.start[2 * self.L])]])
        if self.has_rest:
            self.start, self.scale = np.append(self.start, 0.0), np.append(self.scale, 0.01)

    def _from_phase(self) -> np.ndarray:
        """1 / h is linear in k, c and m; the sign of h and of time follow from m > 0, c > 0."""
        w = np.abs(self.h)
        stiff = np.column_stack([self.basis, 1 - self.u**2]) * w[:, None]
        damped = self.basis * (self.u * w)[:, None]
        z = w / self.h
        k = np.linalg.lstsq(stiff, z.real, rcond=None)[0]
        c = np.linalg.lstsq(damped, z.imag, rcond=None)[0]
        if k[-1] < 0:
            self.h, k, c = -self.h, -k, -c
        if np.sum(c) < 0:
            self.h, c = self.h.conj(), -c
        return np.concatenate([k[:-1], np.maximum(c, 0.05), k[-1:]])

    def _from_size(self) -> np.ndarray:
        """1 / h^2 is quadratic in u^2."""
        x, y = 1 - self.u**2, 1 / np.abs(self.h) ** 2
        bend = np.polyfit(x, y, 2, w=np.abs(self.h) ** 2)[0]
        if not bend > 0:
            raise InputError("the response has no peak; expected points on both sides of it")
        return np.concatenate([np.zeros(self.L), np.ones(self.L), [np.sqrt(bend)]])

    def residual(self, p: np.ndarray) -> np.ndarray:
        L, u = self.L, self.u
        z = self.basis @ p[:L] + p[2 * L] * (1 - u**2) + 1j * u * (self.basis @ p[L : 2 * L])
        made = 1 / z + (p[-1] if self.has_rest else 0.0)
        size = np.abs(self.h)
        if not self.phase:
            return np.abs(made) / size - 1
        r = (made - self.h) / size
        return np.column_stack([r.real, r.imag]).ravel()

    def result(self, p, jacobian, residual) -> OscillatorFit:
        L, m = self.L, p[2 * self.L]
        k, c = p[:L], np.abs(p[L : 2 * L])
        if not (m > 0 and np.all(1 + k / m > 0)):
            raise InputError("no oscillator fits the response; expected one mode across its peak")
        root = np.sqrt(1 + k / m)
        covariance = covariance_of(jacobian, residual, 1 + self.phase)
        # d ln f and d zeta by k, c and m.
        ln_f, zeta = np.zeros((L, len(p))), np.zeros((L, len(p)))
        i = np.arange(L)
        ln_f[i, i] = 0.5 / (m + k)
        ln_f[:, 2 * L] = -0.5 * k / (m * (m + k))
        damping = c / (2 * m * root)
        zeta[i, i] = -damping * 0.5 / (m + k)
        zeta[i, L + i] = 1 / (2 * m * root)
        zeta[:, 2 * L] = damping * (-1 / m + 0.5 * k / (m * (m + k)))
        f = self.omega * root / (2 * np.pi)
        return OscillatorFit(
            f,
            f * _deviations(ln_f, covariance),
            damping,
            _deviations(zeta, covariance),
            float(np.sqrt(np.mean(residual**2))),
        )


def _deviations(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("lp,pq,lq->l", rows, covariance, rows))


def covariance_of(jacobian: np.ndarray, residual: np.ndarray, columns: int = 1) -> np.ndarray:
    """Covariance of a least-squares fit from what it leaves, (p, p).

    Wider where neighbouring residuals go together, as where the model's form is wrong, by
    (1 + rho) / (1 - rho); and by Student's t, so that 1.96 deviations are 95 % with few data too.

    Args:
        jacobian: d residual / d parameters, (n, p).
        residual: (n,), in the order of the measurement.
        columns: Residuals to a point, one behind the other.
    """
    free = max(len(residual) - jacobian.shape[1], 1)
    each = residual.reshape(-1, columns)
    power = float(np.sum(each**2))
    rho = float(np.sum(each[1:] * each[:-1])) / power if power else 0.0
    rho = min(max(rho, 0.0), _CORRELATED)
    wider = (student.ppf(0.975, free) / 1.96) ** 2 * (1 + rho) / (1 - rho)
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    return inverse * (power / free) * wider


# -- backbones -------------------------------------------------------------------------------------


#: Points whose response per force is below this share of the largest are other modes' as well.
_FLANK = 0.2
#: Amplitudes at which k and c are unknown are at most this factor apart; the lowest is this share
#: of the lowest sweep's largest.
_APART, _LOWEST = 1.7, 0.35
#: Points for each such amplitude at least, and how well one is known at most that is kept.
_POINTS, _POOR_HZ, _POOR_DAMPING = 4, 0.02, 0.5
#: Kinds of functions by that of the response.
_FUNCTION = dict(zip(("displacement", "velocity", "acceleration"), TIMES, strict=True))


@dataclass(frozen=True, eq=False)
class SineSweep:
    """One sweep across a resonance.

    Attributes:
        level: What was held: amplitude of the response, in SI units, or of the force, N.
        frequencies_hz: Hz, (n,).
        functions: Response over force, in SI units, complex with their phase, or sizes, (n,).
        forces: Amplitudes of the force, N, (n,).
    """

    level: float
    frequencies_hz: np.ndarray
    functions: np.ndarray
    forces: np.ndarray

    def __post_init__(self):
        f = reals("frequencies_hz", self.frequencies_hz, (None,), "Hz", above=0)
        h = np.asarray(self.functions)
        forces = np.broadcast_to(np.asarray(self.forces, dtype=float), f.shape)
        if h.shape != f.shape or not (np.isfinite(h).all() and np.all(np.abs(h) > 0)):
            raise InputError("functions: expected a number that is not zero for each frequency.")
        if not np.all(forces > 0):
            raise InputError("forces: expected amplitudes above 0 N.")
        if len(np.unique(f)) < 3:
            raise InputError(f"{len(np.unique(f))} different frequencies; expected three or more")
        for key, value in (("frequencies_hz", f), ("functions", h), ("forces", forces)):
            object.__setattr__(self, key, value)

    @property
    def has_phase(self) -> bool:
        """Whether the functions are complex."""
        return np.iscomplexobj(self.functions)

    def near(self, band: tuple[float, float] | None) -> SineSweep:
        """The points near the resonance, and in a band, Hz."""
        size = np.abs(self.functions) / self.frequencies_hz**2
        low, high = band or (0.0, np.inf)
        inside = (self.frequencies_hz >= low) & (self.frequencies_hz <= high)
        if not inside.any():
            raise InputError(f"no point is in the band of {low:g} to {high:g} Hz")
        kept = inside & (size >= _FLANK * size[inside].max())
        return SineSweep(
            self.level, self.frequencies_hz[kept], self.functions[kept], self.forces[kept]
        )

    def receptance(self, response: str) -> tuple[np.ndarray, np.ndarray]:
        """(angular frequencies, displacement over force)."""
        omega = 2 * np.pi * self.frequencies_hz
        times = TIMES[_FUNCTION[response]]
        factor = (1j * omega) ** times if self.has_phase else omega**times
        return omega, self.functions / factor


def from_constant_response(
    sweeps: Sequence[SineSweep], response: str, band: tuple[float, float] | None = None
) -> MeasuredBackbone:
    """One point of the backbone from each sweep, that of the linear oscillator it shows.

    Args:
        sweeps: One for each level of the response.
        response: ``displacement``, ``velocity`` or ``acceleration``.
        band: Frequencies to take, Hz.

    Raises:
        InputError: Names the level whose sweep shows no resonance.
    """
    found, notes = [], []
    for sweep in sweeps:
        words = f"level {sweep.level:g} {RESPONSES[response]}"
        with located(words):
            near = sweep.near(band)
            omega, receptance = near.receptance(response)
            top = int(np.argmax(np.abs(receptance)))
            if omega[top] in (omega.min(), omega.max()):
                raise InputError(
                    f"its response per force is largest at the end of the sweep, "
                    f"{omega[top] / (2 * np.pi):.6g} Hz; expected points on both sides of the peak"
                )
            ones = np.ones((len(omega), 1))
            found.append(fit_oscillator(omega, receptance, ones, phase=near.has_phase))
        if found[-1].scatter > 0.1:
            notes.append(
                f"{words}: one oscillator leaves a residual of {100 * found[-1].scatter:.0f} %"
            )
    levels = np.array([sweep.level for sweep in sweeps])
    arrays = {
        key: np.array([getattr(one, key)[0] for one in found])
        for key in ("frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    wrong = arrays["damping"] * _not_held(levels, arrays["frequencies_hz"], response)
    arrays["damping"] = arrays["damping"] + wrong
    arrays["damping_sd"] = np.hypot(arrays["damping_sd"], 0.5 * wrong)
    return _backbone(response, levels, arrays, "constant response", notes)


def _not_held(levels: np.ndarray, hz: np.ndarray, response: str) -> np.ndarray:
    """By how much damping is off where acceleration or velocity is held and stiffness depends on
    displacement, relative.

    At a held w^n a, a falls along the sweep, so that k(a) turns the slope of k - m w^2 as a modal
    mass larger by the share n d ln w0 / d ln a would, and zeta = c / (2 m w0).
    """
    times = TIMES[_FUNCTION[response]]
    if not times or len(np.unique(levels)) < 2:
        return np.zeros(len(levels))
    x, first = np.unique(np.log(levels / hz**times), return_index=True)
    slope = np.gradient(np.log(hz[first]), x)
    return times * np.interp(np.log(levels / hz**times), x, slope)


def from_constant_force(
    sweeps: Sequence[SineSweep], response: str, band: tuple[float, float] | None = None
) -> MeasuredBackbone:
    """The backbone that all sweeps share, where each point has an amplitude of its own.

    k(a) and c(a) are piecewise linear in ln a; the modal mass comes from the two sides of the peak,
    where the same amplitude is met at two frequencies. Folds and jumps do not matter. The points'
    errors are not independent: they share the mass.

    Args:
        sweeps: One for each level of the force, or branch of it.
        response: ``displacement``, ``velocity`` or ``acceleration``.
        band: Frequencies to take, Hz.

    Raises:
        InputError: If they hold too few points, or no resonance.
    """
    near = [sweep.near(band) for sweep in sweeps]
    phase = all(sweep.has_phase for sweep in near)
    if not phase:
        near = [SineSweep(s.level, s.frequencies_hz, np.abs(s.functions), s.forces) for s in near]
    omega, receptance = (
        np.concatenate(parts) for parts in zip(*(s.receptance(response) for s in near), strict=True)
    )
    motion = [np.abs(s.receptance(response)[1]) * s.forces for s in near]
    x = np.log(np.concatenate(motion))
    knots = _supported(x, _knots([float(np.log(a.max())) for a in motion], len(x)))
    fit = fit_oscillator(omega, receptance, _hats(x, knots), phase=phase)
    poor = (fit.frequencies_sd > _POOR_HZ * fit.frequencies_hz) | ~(
        fit.damping_sd < _POOR_DAMPING * fit.damping
    )
    notes = []
    if poor.all():
        raise InputError(
            "the sweeps do not determine frequency and damping at any amplitude; expected more "
            "points near the peaks" + ("" if phase else ", or the phase")
        )
    if poor.any():
        lost = ", ".join(f"{a:.3g} m" for a in np.exp(knots[poor]))
        notes.append(f"frequency and damping are not determined at {lost}, and left out")
    if fit.scatter > 0.1:
        notes.append(f"the residual of one mode with one backbone is {100 * fit.scatter:.0f} %")
    w = 2 * np.pi * fit.frequencies_hz
    amplitudes = np.exp(knots) * w ** TIMES[_FUNCTION[response]]
    arrays = {
        key: getattr(fit, key)[~poor]
        for key in ("frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    return _backbone(response, amplitudes[~poor], arrays, "constant force", notes)


def _backbone(response, amplitudes, arrays, kind, notes) -> MeasuredBackbone:
    # Data without any noise leave nothing, to which no deviation can be given.
    for key in ("frequencies", "damping"):
        value = arrays["frequencies_hz" if key == "frequencies" else key]
        arrays[f"{key}_sd"] = np.maximum(arrays[f"{key}_sd"], 1e-9 * value)
    return MeasuredBackbone(
        response, np.asarray(amplitudes), **arrays, kind=kind, notes=tuple(notes)
    )


def _knots(tops: list[float], n: int) -> np.ndarray:
    """ln of the amplitudes at which k and c are unknown: the sweeps' largest, and between."""
    tops = np.unique(np.round(tops, 6))
    ends = [tops[0] + np.log(_LOWEST)]
    for top in tops:
        if top - ends[-1] > 0.5 * np.log(_APART) or len(ends) == 1:
            ends.append(top)
    ends[-1] = tops[-1]
    most, apart = max(n // _POINTS, 2), np.log(_APART)
    while True:
        parts = np.maximum(1, np.ceil(np.diff(ends) / apart - 1e-9).astype(int))
        if parts.sum() + 1 <= most or np.all(parts == 1):
            break
        apart *= 1.2
    spans = zip(ends[:-1], ends[1:], parts, strict=True)
    pieces = [np.linspace(low, high, k, endpoint=False) for low, high, k in spans]
    return np.append(np.concatenate(pieces), ends[-1])


def _supported(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """The knots that have points about them; there are none in a jump."""
    while len(knots) > 2:
        weight = _hats(x, knots).sum(axis=0)
        if weight.min() >= 0.5 * _POINTS:
            break
        knots = np.delete(knots, int(np.argmin(weight)))
    return knots


def _hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Values of the piecewise linear basis, (n, L); constant beyond the knots."""
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(len(knots))])
