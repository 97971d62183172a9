"""Nested sampling of a posterior, by nautilus (Lange, MNRAS 525, 2023): importance nested sampling
from regions that neural networks bound."""

from __future__ import annotations

import numpy as np
from nautilus import Sampler

from fenics_joints.diagnosis.evidence.importance import Draws
from fenics_joints.diagnosis.evidence.marginal import Marginal
from fenics_joints.errors import ConvergenceError

__all__ = ["draw"]

_BATCH = 100
#: Few points and smooth posteriors: a small network bounds them as well and is taught faster.
_NETWORK = {"hidden_layer_sizes": (32, 16)}


def draw(problem: Marginal, n_live: int, n_effective: int, seed: int) -> Draws:
    """Points of the posterior and the evidence.

    Args:
        problem: The likelihood and the prior, of two parameters or more.
        n_live: Live points.
        n_effective: Effective sample size to end at.
        seed: Of the random numbers.

    Raises:
        ConvergenceError: If the sampler does not end.
    """
    sampler = Sampler(
        problem.from_unit, problem.log_likelihood, n_dim=problem.n_effects, n_live=n_live,
        n_batch=_BATCH, n_networks=1, neural_network_kwargs=_NETWORK, vectorized=True,
        pass_dict=False, seed=seed,
    )  # fmt: skip
    if not sampler.run(n_eff=n_effective, n_like_max=200 * n_live * (1 + problem.n_effects)):
        label = problem.hypothesis.label
        raise ConvergenceError(
            f"{label}: nested sampling did not end", f"{problem.calls} likelihoods"
        )
    points, log_weights, _ = sampler.posterior()
    weights = np.exp(log_weights - log_weights.max())
    n_eff = float(sampler.n_eff)
    return Draws(points, weights / weights.sum(), float(sampler.log_z), n_eff, n_eff**-0.5)
