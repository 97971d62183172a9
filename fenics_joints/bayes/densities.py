"""ln of densities in closed form: chains ask for a few points at a time, very often.

scipy's own checks of its arguments take a hundred times as long as the formula.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import betaln, gammaln, log_ndtr, xlog1py, xlogy


def _norm(z):
    return -0.5 * z**2 - 0.5 * np.log(2 * np.pi)


def _lognorm(z, s):
    logs = np.log(z)
    return _norm(logs / s) - np.log(s) - logs


def _truncnorm(z, a, b):
    # The mass between a and b, from the side where it is not lost in round-off.
    low, high = (log_ndtr(a), log_ndtr(b)) if a < 0 else (log_ndtr(-b), log_ndtr(-a))
    return _norm(z) - (high + np.log1p(-np.exp(low - high)))


def _weibull(z, c):
    return np.log(c) + xlogy(c - 1, z) - z**c


#: ln of the standard density on its support, by scipy's name, and the support.
_CLOSED: dict[str, tuple[Callable, Callable]] = {
    "norm": (_norm, lambda: (-np.inf, np.inf)),
    "lognorm": (_lognorm, lambda s: (np.finfo(float).tiny, np.inf)),
    "uniform": (lambda z: np.zeros_like(z), lambda: (0.0, 1.0)),
    "loguniform": (lambda z, a, b: -np.log(z) - np.log(np.log(b / a)), lambda a, b: (a, b)),
    "truncnorm": (_truncnorm, lambda a, b: (a, b)),
    "gamma": (lambda z, a: xlogy(a - 1, z) - z - gammaln(a), lambda a: (0.0, np.inf)),
    "weibull_min": (_weibull, lambda c: (0.0, np.inf)),
    "beta": (
        lambda z, a, b: xlogy(a - 1, z) + xlog1py(b - 1, -z) - betaln(a, b),
        lambda a, b: (0.0, 1.0),
    ),
    "gumbel_r": (lambda z: -z - np.exp(-z), lambda: (-np.inf, np.inf)),
    "gumbel_l": (lambda z: z - np.exp(z), lambda: (-np.inf, np.inf)),
    "logistic": (
        lambda z: -np.abs(z) - 2 * np.log1p(np.exp(-np.abs(z))),
        lambda: (-np.inf, np.inf),
    ),
}
_CLOSED["reciprocal"] = _CLOSED["loguniform"]


def log_pdf(frozen) -> Callable[[np.ndarray], np.ndarray]:
    """ln of a frozen distribution's density at (n,); its own `logpdf` where none is known here.

    Args:
        frozen: A frozen continuous distribution of scipy.
    """
    known = _CLOSED.get(getattr(frozen.dist, "name", ""))
    if known is None or not set(frozen.kwds) <= {"loc", "scale"}:
        return frozen.logpdf
    function, support = known
    args, n = list(frozen.args), frozen.dist.numargs
    shapes, rest = args[:n], args[n:]
    if len(shapes) < n:
        return frozen.logpdf
    loc = float(rest[0] if rest else frozen.kwds.get("loc", 0.0))
    scale = float(rest[1] if len(rest) > 1 else frozen.kwds.get("scale", 1.0))
    low, high = support(*shapes)
    constant = -np.log(scale)

    def closed(x: np.ndarray) -> np.ndarray:
        z = (x - loc) / scale
        inside = (z >= low) & (z <= high)
        if inside.all():
            return function(z, *shapes) + constant
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return np.where(inside, function(z, *shapes) + constant, -np.inf)

    return closed
