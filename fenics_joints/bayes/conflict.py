"""Before sampling: can the prior's values have made the data at all?"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import norm

from fenics_joints.bayes.priors import Prior
from fenics_joints.errors import InputError
from fenics_joints.least_squares import LeastSquares

#: How far into its tails a prior is searched and where its edge begins; how far off a frequency may
#: be there; all in standard deviations. Draws that the search starts from.
_TAIL, _EDGE, _FAR, _DRAWS = 4.0, 3.5, 6.0, 64
#: What stands for a mode that the model lacks, in standard deviations.
_LACKS = 1e3


def check_prior(
    prior: Prior,
    frequencies: Callable[[np.ndarray], np.ndarray],
    mode_names: Sequence[str],
    log_f: np.ndarray,
    sd: np.ndarray,
) -> list[str]:
    """Refuse a prior that excludes the data; warn of a model that cannot have them.

    Args:
        prior: Of the parameters.
        frequencies: From values (n, d) to ln f, (n, m).
        mode_names: Names of the modes, m of them.
        log_f: Measured, (m,); nan where not measured.
        sd: Standard deviation of ln f about the model's that is allowed for, (m,).

    Returns:
        Modes that the model cannot have, in words, where that is not for the prior's edges.

    Raises:
        InputError: If the values that come nearest to the data, yet not near, are at a prior's
            edge.
    """
    there = np.isfinite(log_f) & np.isfinite(sd)

    def residuals(values: np.ndarray) -> np.ndarray:
        off = (frequencies(values)[:, there] - log_f[there]) / sd[there]
        return np.nan_to_num(off, nan=_LACKS)

    def allowed(z: np.ndarray) -> np.ndarray:
        """Values at normal scores of the prior."""
        shares = norm.cdf(z)
        values = np.array([d.ppf(p) for d, p in zip(prior.densities, shares, strict=True)])
        low, high = np.array([(max(p.lower, 0.0), p.upper) for p in prior.parameters]).T
        return np.clip(values, np.maximum(low, 1e-12 * np.abs(values)), high)

    draws = prior.values(prior.sample(_DRAWS, np.random.default_rng(10)))
    best = draws[np.argmin(np.sum(residuals(draws) ** 2, axis=1))]
    shares = [d.cdf(v) for d, v in zip(prior.densities, best, strict=True)]
    fit = LeastSquares(lambda z: residuals(allowed(z)[None])[0], bounds=(-_TAIL, _TAIL))
    z = fit.solve(np.clip(norm.ppf(shares), -_EDGE, _EDGE), 60, diff_step=1e-4).x
    off = residuals(allowed(z)[None])[0]
    if np.abs(off).max() <= _FAR:
        return []
    names = [name for name, is_there in zip(mode_names, there, strict=True) if is_there]
    said = [
        f"{name} no nearer to its measured frequency than "
        f"{100 * abs(np.expm1(miss * s)):.2g} %, {abs(miss):.0f} standard deviations of noise, "
        "scatter and discrepancy"
        for name, miss, s in zip(names, off, sd[there], strict=True)
        if abs(miss) > _FAR
    ]
    edge = [name for name, score in zip(prior.names, z, strict=True) if abs(score) > _EDGE]
    if edge:
        raise InputError(
            f"prior of {', '.join(edge)}: excludes the data: up to its tails it brings {said[0]}. "
            "Expected a prior that reaches the values which have these frequencies."
        )
    return [f"the model brings {line}: give it a discrepancy, or better it" for line in said]
