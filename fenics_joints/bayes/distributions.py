"""A distribution for one measured frequency over equal specimens (Jalali et al. 2019, eq. 7).

Candidates are fitted by maximum likelihood; the one with the least AICc is taken;
and whether it fits at all is tested with the Anderson-Darling distance, whose p-value comes from
fits to data that the distribution itself makes (a table's would take its parameters for known).
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fenics_joints.errors import InputError

#: Samples that give a p-value, more of them where it is below the last number; chosen.
_TRIALS, _MORE, _LOOK = 199, 1999, 0.02
#: p-values below which a distribution is doubted, and refused; convention.
WARN, REFUSE = 0.05, 0.001
#: Least number of frequencies for a distribution.
FEWEST = 5
#: The paper names a Beta without its interval: the data's, widened by its own range on either side.
_WIDER = 1.0
#: Parameters that are fitted, where they are not two: the Beta's interval counts too.
_COUNT = {"beta": 4}


def _lognormal(x):
    logs = np.log(x)
    return stats.lognorm(logs.std(), scale=np.exp(logs.mean()))


def _weibull(x):
    # ln of a Weibull variable is a Gumbel one of minima: well-scaled where the shape is 1000.
    loc, scale = stats.gumbel_l.fit(np.log(x))
    return stats.weibull_min(1 / scale, scale=np.exp(loc))


def _gamma(x):
    # Around the mean with the digamma equation by scipy; shapes of 1e5 start it far away.
    shape, _, scale = stats.gamma.fit(x, (x.mean() / x.std()) ** 2, floc=0)
    return stats.gamma(shape, scale=scale)


def _interval(x):
    """Lower end and width of a Beta's interval."""
    return x.min() - _WIDER * np.ptp(x), (1 + 2 * _WIDER) * np.ptp(x)


def _beta(x):
    low, width = _interval(x)
    a, b, _, _ = stats.beta.fit((x - low) / width, floc=0, fscale=1)
    return stats.beta(a, b, low, width)


#: Families with two numbers that scipy fits as they are.
_SCIPY = {
    "normal": stats.norm,
    "gumbel": stats.gumbel_r,
    "gumbel_min": stats.gumbel_l,
    "logistic": stats.logistic,
}


def _as_it_is(family: str) -> Callable:
    return lambda x: _SCIPY[family](*_SCIPY[family].fit(x))


#: Families by name: from data to a frozen distribution of scipy with the greatest likelihood.
FAMILIES: dict[str, Callable] = {
    "normal": _as_it_is("normal"),
    "lognormal": _lognormal,
    "weibull": _weibull,
    "beta": _beta,
    "gamma": _gamma,
    "gumbel": _as_it_is("gumbel"),
    "gumbel_min": _as_it_is("gumbel_min"),
    "logistic": _as_it_is("logistic"),
}


@dataclass(frozen=True, eq=False)
class Fitted:
    """A distribution of one frequency.

    Attributes:
        family: A key of `FAMILIES`.
        frozen: The distribution, of scipy; Hz.
        p_value: Of the Anderson-Darling distance.
        n: Number of specimens.
    """

    family: str
    frozen: object
    p_value: float
    n: int

    def __repr__(self) -> str:
        return f"Fitted({self.family}, {self.n} specimens, p = {self.p_value:.3f})"

    @property
    def doubtful(self) -> bool:
        """Whether the data are unlikely to be of this distribution."""
        return self.p_value < WARN

    def words(self, name: str) -> str:
        """What was found, in a sentence."""
        mean, sd = float(self.frozen.mean()), float(self.frozen.std())
        text = f"{name}: {self.family}, mean {mean:.2f} Hz, s.d. {sd:.3f} Hz, "
        text += f"p = {self.p_value:.3f}"
        return f"{text}: the distribution fits badly" if self.doubtful else text


def fit(x: np.ndarray, families: Sequence[str]) -> dict[str, object]:
    """Families by name with the greatest likelihood; those that cannot be fitted are left out."""
    found = {}
    for family in families:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                frozen = FAMILIES[family](x)
                finite = np.all(np.isfinite(frozen.logpdf(x)))
            except (ValueError, RuntimeError, FloatingPointError, stats.FitError):
                continue
        if finite:
            found[family] = frozen
    return found


def choose(
    name: str,
    frequencies_hz: np.ndarray,
    families: Sequence[str] | None = None,
    *,
    seed: int = 0,
    accept_misfit: bool = False,
) -> Fitted:
    """The family of the least AICc for a mode's frequency over specimens.

    Args:
        name: Of the mode, for messages.
        frequencies_hz: Shape (n,); nan where a specimen's was not measured.
        families: Keys of `FAMILIES`; all by default.
        seed: Of the samples that give the p-value.
        accept_misfit: Take a distribution that does not fit all the same.

    Raises:
        InputError: For fewer than five values, values that are not positive or all equal, an
            unknown family; or if no family fits: p below 0.001.
    """
    families = list(FAMILIES) if families is None else list(families)
    for family in families:
        if family not in FAMILIES:
            raise InputError(f"distribution {family!r}: expected some of: {', '.join(FAMILIES)}.")
    x = checked_frequencies(name, frequencies_hz)
    found = fit(x, families)
    if not found:
        raise InputError(f"{name}: none of {', '.join(families)} can be fitted to the frequencies.")
    n = len(x)
    aicc = {f: _aicc(float(np.sum(d.logpdf(x))), _COUNT.get(f, 2), n) for f, d in found.items()}
    best = min(aicc, key=aicc.get)
    p = _p_value(best, x, np.random.default_rng(seed))
    if p < REFUSE and not accept_misfit:
        raise InputError(
            f"{name}: no distribution fits its {n} frequencies; the best, {best}, has p = "
            f"{p:.4f}: expected data of one kind. Look for outliers, or for specimens of two kinds."
        )
    return Fitted(best, found[best], p, n)


def _aicc(log_likelihood: float, k: int, n: int) -> float:
    """Akaike's criterion for small samples; infinite for as many parameters as data."""
    extra = 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else np.inf
    return 2 * k + extra - 2 * log_likelihood


def checked_frequencies(name: str, frequencies_hz: np.ndarray) -> np.ndarray:
    """Those of a mode that were measured, Hz; InputError, in its name, for what gives no fit."""
    x = np.asarray(frequencies_hz, dtype=float)
    x = x[~np.isnan(x)]
    if len(x) < FEWEST:
        raise InputError(
            f"{name}: {len(x)} measured frequencies: expected at least {FEWEST} for a distribution"
        )
    if not np.all(np.isfinite(x) & (x > 0)):
        raise InputError(f"{name}: expected positive frequencies, Hz; the least is {x.min():g}.")
    if not np.ptp(x) > 1e-9 * x.mean():
        raise InputError(f"{name}: all frequencies are {x[0]:g} Hz: expected some scatter.")
    return x


def _p_value(family: str, x: np.ndarray, rng: np.random.Generator) -> float:
    """Share of fits to the family's own samples whose Anderson-Darling distance is no less."""
    tested, data, given = _as_tested(family, x)
    # scipy changes the name of this argument from 1.15 on.
    keywords = inspect.signature(stats.goodness_of_fit).parameters
    random = {"rng" if "rng" in keywords else "random_state": rng}
    for trials in (_TRIALS, _MORE):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = stats.goodness_of_fit(
                tested, data, **given, statistic="ad", n_mc_samples=trials, **random
            )
        if found.pvalue > _LOOK:
            break
    return float(found.pvalue)


def _as_tested(family: str, x: np.ndarray):
    """A family of scipy, the data, and what is known or guessed of its numbers.

    The distance is the same for a variable and its logarithm, which is fitted more surely.
    """
    if family in ("lognormal", "weibull"):
        return {"lognormal": stats.norm, "weibull": stats.gumbel_l}[family], np.log(x), {}
    if family == "beta":
        low, width = _interval(x)
        return stats.beta, (x - low) / width, {"known_params": {"loc": 0.0, "scale": 1.0}}
    if family == "gamma":
        guess = {"a": (x.mean() / x.std()) ** 2, "scale": x.var() / x.mean()}
        return stats.gamma, x, {"known_params": {"loc": 0.0}, "guessed_params": guess}
    return _SCIPY[family], x, {}


# -- densities without checks ----------------------------------------------------------------------


def _log_lognorm(z, s):
    """`scipy.stats.lognorm._logpdf` without its search for zeros, which takes most of its time."""
    logs = np.log(z)
    return -logs * (0.5 * logs / s**2 + 1) - np.log(np.sqrt(2 * np.pi) * s)  # -inf at 0


def log_pdf(frozen) -> Callable[[np.ndarray], np.ndarray]:
    """ln of a frozen distribution's density at (n,), by the formula that scipy evaluates.

    Args:
        frozen: A frozen continuous distribution of scipy.
    """
    family, (low, high) = frozen.dist, frozen.support()
    args, n = list(frozen.args), frozen.dist.numargs
    if len(args) < n or not set(frozen.kwds) <= {"loc", "scale"}:  # shapes by name
        return frozen.logpdf
    placed = dict(zip(("loc", "scale"), args[n:], strict=False)) | frozen.kwds
    loc, scale = placed.get("loc", 0.0), placed.get("scale", 1.0)
    shapes, constant = [np.asarray(shape, dtype=float) for shape in args[:n]], np.log(scale)
    formula = _log_lognorm if family.name == "lognorm" else family._logpdf

    def without_checks(x: np.ndarray) -> np.ndarray:
        inside = (x >= low) & (x <= high)
        if inside.all():
            return formula((x - loc) / scale, *shapes) - constant
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return np.where(inside, formula((x - loc) / scale, *shapes) - constant, -np.inf)

    return without_checks
