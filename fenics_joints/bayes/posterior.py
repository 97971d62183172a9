"""The posterior density: prior times likelihood of frequencies (Jalali et al. 2019, eq. 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.errors import InputError

#: Draws of the prior for each parameter, and the effective number of draws for each chain, among
#: which the starts are drawn; chosen.
_DRAWS, _SPREAD = 256, 4


@dataclass(frozen=True, eq=False)
class Posterior:
    """ln of a density at many points.

    Attributes:
        prior: Of the parameters.
        frequencies: Model: from values (n, d) to ln f (n, m), nan where it lacks a mode.
        likelihood: From ln f (n, m) to ln of the likelihood, (n,).
    """

    prior: PriorDensity
    frequencies: Callable[[np.ndarray], np.ndarray]
    likelihood: Callable[[np.ndarray], np.ndarray]

    def __repr__(self) -> str:
        return f"Posterior({type(self.likelihood).__name__} of {self.prior!r})"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.prior.names

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        """At coordinates (n, d): (n,)."""
        log_f = self.frequencies(self.prior.values(x))
        there = np.all(np.isfinite(log_f), axis=1)
        found = self.likelihood(np.where(there[:, None], log_f, 0.0))
        return np.where(there, found, -np.inf)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """ln of the density of x, up to a constant: (n,); -inf where there is none."""
        x = np.atleast_2d(x)
        total = self.prior.log_density(x)
        inside = np.isfinite(total)
        if inside.any():
            total[inside] += self.log_likelihood(x[inside])
        return total

    def starts(self, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Starting points for chains, spread over all that is likely, not at its maximum alone.

        Draws of the prior, taken by their likelihood to a power that leaves several for each
        point: a flattened posterior.

        Returns:
            Coordinates, (n, d), spread wider than the posterior; and the covariance, (d, d), of the
            flattened posterior.

        Raises:
            InputError: If no draw of the prior has a likelihood.
        """
        rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
        x = self.prior.sample(_DRAWS * self.prior.size, rng)
        log_l = self.log_likelihood(x)
        if not np.isfinite(log_l).any():
            raise InputError(
                f"prior of {', '.join(self.names)}: none of {len(x)} draws can have made the "
                "measured frequencies; expected a wider prior, or other data."
            )
        weights = _tempered(log_l, min(_SPREAD * n, 0.5 * np.isfinite(log_l).sum()))
        mean = weights @ x
        spread = (x - mean).T @ (weights[:, None] * (x - mean))
        floor = 1e-12 * np.eye(len(spread)) + 1e-6 * np.diag(np.diag(spread))
        picked = rng.choice(len(x), size=n, p=weights, replace=np.count_nonzero(weights) < n)
        # A tenth of the spread more: no two chains begin at one point.
        moved = x[picked] + 0.1 * rng.standard_normal((n, len(mean))) * np.sqrt(np.diag(spread))
        inside = np.isfinite(self(moved))
        return np.where(inside[:, None], moved, x[picked]), spread + floor


def _tempered(log_l: np.ndarray, n_effective: float) -> np.ndarray:
    """Weights proportional to the likelihood to the power at which so many draws count."""
    finite = np.where(np.isfinite(log_l), log_l - log_l.max(), -np.inf)

    def weights(power: float) -> np.ndarray:
        logs = np.where(
            np.isfinite(finite), power * np.where(np.isfinite(finite), finite, 0.0), -np.inf
        )
        return np.exp(logs - logsumexp(logs))

    def surplus(power: float) -> float:
        return 1 / np.sum(weights(power) ** 2) - n_effective

    return weights(1.0 if surplus(1.0) >= 0 else brentq(surplus, 0.0, 1.0))
