"""One mode fitted to measured responses, its stiffness and damping functions of the amplitude.

At a steady sine the first harmonic of a mode obeys F / X = k(a) - m w^2 + i w c(a), a = |X|: the
describing function. Where a is held constant over the sweep, k and c are numbers and the response
is that of a linear oscillator (Karaagacli and Ozguven, Mech. Syst. Signal Process. 149, 2021).
Other modes add a constant r to X / F.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from fenics_joints.errors import InputError

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
    found = least_squares(line.residual, line.start, x_scale=line.scale, max_nfev=500)
    scale = 1.4826 * float(np.median(np.abs(found.fun)))
    if scale > 0:
        found = least_squares(
            line.residual,
            found.x,
            x_scale=line.scale,
            max_nfev=500,
            loss="soft_l1",
            f_scale=_OUTLIER * scale,
        )
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
