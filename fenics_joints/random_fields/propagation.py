"""From random parameters of joints to random frequencies: by samples, and by sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.random_fields.fields import FieldMap, RandomField

#: Step of xi for second derivatives; gradients are exact.
_STEP = 1e-3


@dataclass(frozen=True)
class Moments:
    """What random parameters do to frequencies.

    Attributes:
        mean: Hz, shape (m,).
        covariance: Hz^2, shape (m, m).
        samples: Frequencies, Hz, (n, m), of a propagation by samples; None otherwise.
        parameters: Parameter values of the samples, (n, n_names); None otherwise.
        names: Names of the random parameters.
    """

    mean: np.ndarray
    covariance: np.ndarray
    names: tuple[str, ...]
    samples: np.ndarray | None = None
    parameters: np.ndarray | None = None

    def __repr__(self) -> str:
        low, high = self.mean.min(), self.mean.max()
        return f"Moments({len(self.mean)} frequencies, means from {low:.4g} to {high:.4g} Hz)"

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations, Hz."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the frequencies."""
        return self.covariance / np.outer(self.sd, self.sd)


def propagate_samples(
    forward,
    fields: Sequence[RandomField],
    start: Mapping[str, float],
    n: int,
    *,
    seed: int = 0,
    correlation: np.ndarray | None = None,
) -> Moments:
    """Frequencies at independent samples of the fields.

    Args:
        forward: ``values -> (ln f, d ln f / d values)``, see `reduction.forward.Forward`.
        fields: The random fields.
        start: Values of all the model's parameters; of the random ones, the means.
        n: Number of samples.
        seed: Of the random numbers.
        correlation: Of the fields, (n_fields, n_fields); none by default.

    Raises:
        InputError: For a bad field, or a sample with a stiffness that is not positive.
    """
    if n < 2:
        raise InputError(f"n = {n}: expected at least 2 samples.")
    fields = FieldMap(fields, start, correlation)
    xi = np.random.default_rng(seed).standard_normal((n, fields.n_variables))
    samples, drawn = [], []
    for row in xi:
        values, _ = fields.values(row)
        samples.append(np.exp(forward(values)[0]))
        drawn.append([values[name] for name in fields.names])
    samples = np.array(samples)
    spread = np.atleast_2d(np.cov(samples, rowvar=False))
    return Moments(samples.mean(axis=0), spread, fields.names, samples, np.array(drawn))


def propagate_sensitivities(
    forward,
    fields: Sequence[RandomField],
    start: Mapping[str, float],
    *,
    order: int = 2,
    correlation: np.ndarray | None = None,
) -> Moments:
    """Mean and covariance of frequencies from their derivatives by the fields' variables.

    With g and H of f(xi) at 0: mean f + tr H / 2, covariance g g^T + tr(H H) / 2; the terms in H
    with ``order`` 2 alone. H is the central difference of exact gradients.

    Args:
        forward: See `propagate_samples`.
        fields: The random fields.
        start: Values of all the model's parameters; of the random ones, the means.
        order: 1 or 2.
        correlation: Of the fields.

    Raises:
        InputError: For a bad field or order.
    """
    if order not in (1, 2):
        raise InputError(f"order = {order}: expected 1 or 2.")
    fields = FieldMap(fields, start, correlation)
    n = fields.n_variables

    def gradient(xi):
        values, by_xi = fields.values(xi)
        log_f, by_values = forward(values)
        f = np.exp(log_f)
        return f, f[:, None] * (by_values[:, fields.columns] @ by_xi)

    mean, g = gradient(np.zeros(n))
    spread = g @ g.T
    if order == 2:
        hessian = np.empty((len(mean), n, n))
        for j, step in enumerate(_STEP * np.eye(n)):
            hessian[:, :, j] = (gradient(step)[1] - gradient(-step)[1]) / (2 * _STEP)
        hessian = 0.5 * (hessian + hessian.transpose(0, 2, 1))
        mean = mean + 0.5 * np.trace(hessian, axis1=1, axis2=2)
        spread = spread + 0.5 * np.einsum("aij,bij->ab", hessian, hessian)
    return Moments(mean, spread, fields.names)
