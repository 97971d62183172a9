"""A Gaussian process with known hyperparameters, for answers that need not wait for scikit-learn.

That one finds the hyperparameters, and takes a second to import.

Rasmussen and Williams, Gaussian Processes (2006), algorithm 2.1 and eqs. 5.10 to 5.12.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Added to the variance of every sample, so that its matrix has a Cholesky factor.
JITTER = 1e-10


class Process:
    """Kernels ``c k(a, b) + c' (s² + a·b) + noise``, the second with a linear trend only.

    Args:
        kernel: ``gaussian`` or ``matern 5/2``, for k.
        trend: ``constant`` or ``linear``.
        theta: Logarithms of c, of the lengths of k by input, of c' and s, of the noise.
        z: Sample points, shape (n, d).
        y: Values there, shape (n,); their mean is the prior mean, their spread its scale.

    Attributes:
        covariance: Of the samples, noise included, over the scale squared; shape (n, n).
    """

    def __init__(
        self, kernel: str, trend: str, theta: Sequence[float], z: np.ndarray, y: np.ndarray
    ):
        self._kernel, self._z, self._y = kernel, z, y
        c, *rest = np.exp(np.asarray(theta, dtype=float))
        self._c, self._lengths, rest = c, np.array(rest[: z.shape[1]]), rest[z.shape[1] :]
        *linear, self._noise = rest
        if len(linear) != (2 if trend == "linear" else 0):
            raise ValueError(f"{len(theta)} hyperparameters of {z.shape[1]} inputs, {trend} trend")
        self._linear = (linear[0], linear[1] ** 2) if linear else (0.0, 0.0)
        self._scale = y.std() if y.std() > 10 * np.finfo(float).eps else 1.0
        self.covariance = self._covariance(z, z) + self._noise * np.eye(len(y))
        self._factor = np.linalg.cholesky(self.covariance + JITTER * np.eye(len(y)))
        self._weights = np.linalg.solve(self._factor, (y - y.mean()) / self._scale)

    def predict(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and standard deviations, the noise included, at points of shape (m, d)."""
        across = np.linalg.solve(self._factor, self._covariance(self._z, z))
        factor, offset = self._linear
        own = self._c + factor * (offset + np.sum(z * z, axis=1)) + self._noise
        variance = np.maximum(own - np.sum(across**2, axis=0), 0.0)
        mean = self._y.mean() + self._scale * (self._weights @ across)
        return mean, self._scale * np.sqrt(variance)

    def leave_one_out(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and predicted standard deviations, each sample from the others.

        With the mean of the others as the prior mean.
        """
        y, n = self._y, len(self._y)
        inverse = np.linalg.inv(self.covariance)
        means = (y.sum() - y) / (n - 1)
        diagonal = np.diag(inverse)
        residual = (inverse @ y - means * inverse.sum(axis=1)) / diagonal
        return residual, self._scale / np.sqrt(diagonal)

    def _covariance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Between points, without the noise; shape (len(a), len(b))."""
        apart = (a[:, None] - b[None]) / self._lengths
        squared = np.sum(apart**2, axis=2)
        if self._kernel == "gaussian":
            shape = np.exp(-0.5 * squared)
        else:
            r = np.sqrt(5 * squared)
            shape = (1 + r + r**2 / 3) * np.exp(-r)
        factor, offset = self._linear
        return self._c * shape + factor * (offset + a @ b.T)
