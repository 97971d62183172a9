"""Poles that fit measured functions best, and how well the functions know them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["PoleFit", "fit_poles"]

_STEPS = 30


@dataclass(frozen=True, eq=False)
class PoleFit:
    """Poles of functions H_k = (i w)^q (sum_r A_kr / (i w - p_r) + conj. + U_k - L_k / w^2).

    Attributes:
        poles: rad/s, shape (m,).
        frequencies_sd: Hz, shape (m,).
        damping_sd: Of the ratios, shape (m,).
        covariance: Of all real parts and then all imaginary parts of the poles, shape (2 m, 2 m).
        residues: Of the receptance, A_kr, shape (n_functions, m).
        residues_sd: Standard deviation of their real or imaginary part at given poles, the same.
        residues_slopes: How they follow those parts of the poles, shape (n_functions, m, 2 m).
        residual: Root mean square of measured minus fitted, relative to measured.
    """

    poles: np.ndarray
    frequencies_sd: np.ndarray
    damping_sd: np.ndarray
    covariance: np.ndarray
    residues: np.ndarray
    residues_sd: np.ndarray
    residues_slopes: np.ndarray
    residual: float

    def __repr__(self) -> str:
        return f"PoleFit({len(self.poles)} poles, residual {self.residual:.2g})"

    @property
    def frequencies_hz(self) -> np.ndarray:
        """|p| / 2 pi."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> np.ndarray:
        """-Re p / |p|."""
        return -self.poles.real / np.abs(self.poles)

    def draws(self, n: int, seed: int = 0) -> np.ndarray:
        """Residues as they might be as well, shape (n, n_functions, m)."""
        rng = np.random.default_rng(seed)
        values, vectors = np.linalg.eigh(self.covariance)
        parts = rng.normal(size=(n, len(values))) * np.sqrt(np.maximum(values, 0)) @ vectors.T
        shape = (n, *self.residues.shape)
        own = self.residues_sd * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
        return self.residues + own + np.einsum("krp,np->nkr", self.residues_slopes, parts)


def fit_poles(f: np.ndarray, measured: np.ndarray, start: np.ndarray, power: int) -> PoleFit:
    """Non-linear least squares on functions, started at poles nearby.

    Residues and the residuals of modes out of the band are linear in the functions and are
    projected out (variable projection; Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973); each
    function has the weight of its own misfit.

    Args:
        f: Hz, shape (n,).
        measured: Functions, shape (n_functions, n).
        start: Poles, rad/s, shape (m,).
        power: 0 for receptances, 1 for mobilities, 2 for accelerances.
    """
    y = np.hstack([measured.real, measured.imag]).T
    # Tiny against any noise, so that data without noise have a weight too.
    least = 1e-10 * np.sqrt((y**2).mean(axis=0))
    poles = np.array(start, dtype=complex)
    state = _Linear(f, y, poles, power)
    for _ in range(_STEPS):
        sigma = np.hypot(state.sigma, least)
        step = _step(state, sigma)
        before = ((state.rest / sigma) ** 2).sum()
        for _ in range(8):
            trial = _Linear(f, y, poles + step, power)
            if ((trial.rest / sigma) ** 2).sum() <= before:
                break
            step = step / 2
        else:
            break
        state, poles = trial, poles + step
        if np.abs(step / poles).max() < 1e-10:
            break
    return _result(state, np.hypot(state.sigma, least), measured)


class _Linear:
    """The linear least squares at fixed poles."""

    def __init__(self, f, y, poles, power):
        s, self.poles = 2j * np.pi * f[:, None], poles
        self.factor = s**power
        self.one, self.two = self.factor / (s - poles), self.factor / (s - poles.conj())
        rest = [self.factor * np.ones_like(s), self.factor / s**2]
        columns = [self.one + self.two, 1j * (self.one - self.two), *rest, *(1j * c for c in rest)]
        basis = np.hstack(columns)
        basis = np.vstack([basis.real, basis.imag])
        self.scale = np.linalg.norm(basis, axis=0)
        self.Q, self.R = np.linalg.qr(basis / self.scale)
        self.x = np.linalg.solve(self.R, self.Q.T @ y) / self.scale[:, None]
        self.rest = y - self.Q @ (self.Q.T @ y)
        self.s = s
        m = len(poles)
        self.free = max(len(y) - basis.shape[1] - 2 * m / y.shape[1], 1)
        #: Standard deviation of a real or imaginary part of each function's values.
        self.sigma = np.sqrt((self.rest**2).sum(axis=0) / self.free)
        self.residues = (self.x[:m] + 1j * self.x[m : 2 * m]).T

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Change of each function by Re p and Im p at the best residues, and that of these.

        Shapes (n_functions, 2 n, 2 m) and (n_functions, m, 2 m).
        """
        a = self.residues[:, None, :]
        one, two = (
            a * (self.one / (self.s - self.poles)),
            a.conj() * (self.two / (self.s - self.poles.conj())),
        )
        slopes = np.concatenate([one + two, 1j * (one - two)], axis=2)
        slopes = np.concatenate([slopes.real, slopes.imag], axis=1)
        within = self.Q.T @ slopes
        follow = -np.linalg.solve(self.R, within) / self.scale[:, None]
        m = len(self.poles)
        return slopes - self.Q @ within, follow[:, :m] + 1j * follow[:, m : 2 * m]


def _information(slopes: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    weighted = slopes / sigma[:, None, None]
    return np.einsum("kna,knb->ab", weighted, weighted)


def _step(state: _Linear, sigma: np.ndarray) -> np.ndarray:
    slopes, _ = state.slopes()
    gradient = np.einsum("kna,nk->a", slopes, state.rest / sigma**2)
    matrix = _information(slopes, sigma)
    size = np.sqrt(np.diag(matrix))
    size[size == 0] = 1.0
    delta = np.linalg.lstsq(matrix / np.outer(size, size), gradient / size, rcond=1e-12)[0] / size
    m = len(state.poles)
    step = delta[:m] + 1j * delta[m:]
    # No further than half a damping, so that a pole stays on its side and at its peak.
    most = 0.5 * np.abs(state.poles.real)
    return step / max(1.0, float((np.abs(step) / most).max()))


def _result(state: _Linear, sigma: np.ndarray, measured: np.ndarray) -> PoleFit:
    poles, m, n = state.poles, len(state.poles), measured.shape[1]
    colour = _colour(state.rest.reshape(2, n, -1))
    slopes, follow = state.slopes()
    covariance = np.linalg.pinv(_information(slopes, sigma * colour), hermitian=True)
    size = np.abs(poles)
    # Of |p| and -Re p / |p| by Re p and Im p.
    by_re, by_im = poles.real / size, poles.imag / size
    slope_f = np.stack([by_re, by_im]) / (2 * np.pi)
    slope_z = np.stack([-(poles.imag**2), poles.real * poles.imag]) / size**3
    pairs = [covariance[np.ix_([r, m + r], [r, m + r])] for r in range(m)]
    inverse = np.linalg.inv(state.R)
    linear = np.sqrt((inverse**2).sum(axis=1)) / state.scale
    residues_sd = np.outer(
        sigma * colour, np.sqrt(0.5 * (linear[:m] ** 2 + linear[m : 2 * m] ** 2))
    )
    return PoleFit(
        poles,
        np.sqrt([slope_f[:, r] @ pairs[r] @ slope_f[:, r] for r in range(m)]),
        np.sqrt([slope_z[:, r] @ pairs[r] @ slope_z[:, r] for r in range(m)]),
        covariance,
        state.residues,
        residues_sd,
        follow,
        float(np.linalg.norm(state.rest) / np.linalg.norm(measured)),
    )


def _colour(rest: np.ndarray) -> np.ndarray:
    """How many times larger deviations are than for white residuals, of each function.

    By their correlation c from line to line: sqrt((1 + c) / (1 - c)), not below 1.
    """
    power = (rest**2).sum(axis=(0, 1))
    c = (rest[:, 1:] * rest[:, :-1]).sum(axis=(0, 1)) / np.where(power > 0, power, 1.0)
    c = np.clip(c, 0.0, 1 - 2 / rest.shape[1])
    return np.sqrt((1 + c) / (1 - c))
