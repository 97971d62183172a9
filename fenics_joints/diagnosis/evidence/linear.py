"""Whitened residuals, and the evidence of what is linear in parameters z ~ N(0, I)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular


def whiten(lower: np.ndarray, array: np.ndarray) -> np.ndarray:
    """Rows, (k,) or (k, n), in standard deviations; ``lower`` factors their covariance."""
    return solve_triangular(lower, array, lower=True, check_finite=False)


def marginal(residual: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """ln of the marginal likelihood but for the data's constant, of residuals (k, t), whitened,
    with parameters z ~ N(0, I) about 0: (t,).

    Args:
        residual: At z = 0.
        slope: Derivatives by z, whitened, (k, p).
    """
    hessian, pull = slope.T @ slope + np.eye(slope.shape[1]), slope.T @ residual
    gain = np.sum(pull * np.linalg.solve(hessian, pull), axis=0)
    return 0.5 * (gain - np.sum(residual**2, axis=0) - np.linalg.slogdet(hessian)[1])


def log_evidence(square: float, hessian: np.ndarray, lower: np.ndarray) -> float:
    """ln of the marginal likelihood: ln N(r; 0, Sigma) - |z|^2 / 2 - ln det(H) / 2 at the maximum.

    Args:
        square: |r|^2 + |z|^2 there, r whitened.
        hessian: H = J^T J + I of the whitened slopes J, (d, d).
        lower: Cholesky factor of Sigma, (k, k).
    """
    constant = np.sum(np.log(np.diag(lower))) + 0.5 * len(lower) * np.log(2 * np.pi)
    return float(-0.5 * square - 0.5 * np.linalg.slogdet(hessian)[1] - constant)


def evidence_about(
    residual: np.ndarray,
    slope: np.ndarray,
    z: np.ndarray,
    lower: np.ndarray,
    free: np.ndarray | None = None,
) -> float:
    """ln of the marginal likelihood of what is linear about a point that need not be its best.

    Args:
        residual: Prediction less data there, whitened, (k,).
        slope: Its derivatives by z, (k, d).
        z: The point, (d,).
        lower: Cholesky factor of the covariance, (k, k).
        free: Which of z may move, (d,), bool: those at a limit may not. None for all.
    """
    return log_evidence(*least_square(residual, slope, z, free), lower)


def least_square(
    residual: np.ndarray, slope: np.ndarray, z: np.ndarray, free: np.ndarray | None = None
) -> tuple[float, np.ndarray]:
    """Least |r|^2 + |z|^2 of what is linear about a point, and its Hessian, (d, d); arguments as of
    `evidence_about`."""
    hessian, pull = slope.T @ slope + np.eye(len(z)), slope.T @ residual + z
    free = np.ones(len(z), dtype=bool) if free is None else free
    gain = pull[free] @ np.linalg.solve(hessian[np.ix_(free, free)], pull[free])
    return float(residual @ residual + z @ z - gain), hessian
