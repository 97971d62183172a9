"""What is known of parameters before the test: a density for each, on the search's coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten

import numpy as np
from scipy import stats
from scipy.special import log_expit

from fenics_joints.bayes.distributions import log_pdf
from fenics_joints.errors import InputError
from fenics_joints.formatting import interval
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.coordinates import LogScale

#: What each kind of density needs, in this order. ``log_sd`` has no unit, the rest the parameter's.
KINDS: dict[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "lognormal": ("median", "log_sd"),
    "loguniform": ("low", "high"),
    "truncated_normal": ("mean", "sd", "low", "high"),
    "gamma": ("mean", "sd"),
}
_SPREADS = ("sd", "log_sd")
#: What people call scipy's densities.
_CALLED = {
    "norm": "normal",
    "lognorm": "lognormal",
    "truncnorm": "truncated normal",
    "loguniform": "log-uniform",
    "reciprocal": "log-uniform",
}


def density(name: str, kind: str, numbers: Mapping[str, float]):
    """A density of scipy.

    Args:
        name: Of the parameter, for messages.
        kind: A key of `KINDS`.
        numbers: What `KINDS` says that it needs, SI.

    Raises:
        InputError: If the kind or a number is not usable.
    """
    if kind not in KINDS:
        raise InputError(f"prior of {name}: kind = {kind!r}: expected one of: {', '.join(KINDS)}.")
    need = KINDS[kind]
    if set(numbers) != set(need):
        given = ", ".join(numbers) or "nothing"
        raise InputError(f"prior of {name}: {given}: expected {', '.join(need)} for {kind!r}.")
    for key, value in numbers.items():
        if not np.isfinite(value) or (key in _SPREADS and not value > 0):
            more = " above 0" if key in _SPREADS else ""
            raise InputError(f"prior of {name}: {key} = {value}: expected a finite number{more}.")
    _check_range(name, kind, numbers)
    if kind == "normal":
        return stats.norm(numbers["mean"], numbers["sd"])
    if kind == "uniform":
        return stats.uniform(numbers["low"], numbers["high"] - numbers["low"])
    if kind == "lognormal":
        return stats.lognorm(numbers["log_sd"], scale=numbers["median"])
    if kind == "loguniform":
        return stats.loguniform(numbers["low"], numbers["high"])
    if kind == "gamma":
        shape = (numbers["mean"] / numbers["sd"]) ** 2
        return stats.gamma(shape, scale=numbers["mean"] / shape)
    mean, sd = numbers["mean"], numbers["sd"]
    low, high = ((numbers[key] - mean) / sd for key in ("low", "high"))
    return stats.truncnorm(low, high, mean, sd)


def _check_range(name: str, kind: str, numbers: Mapping[str, float]) -> None:
    if "low" in numbers and not 0 <= numbers["low"] < numbers["high"]:
        found = f"low = {numbers['low']:g}, high = {numbers['high']:g}"
        raise InputError(f"prior of {name}: {found}: expected 0 <= low < high.")
    positive = {"lognormal": "median", "loguniform": "low", "gamma": "mean", "normal": "mean"}
    key = positive.get(kind)
    if key is not None and not numbers[key] > 0:
        raise InputError(f"prior of {name}: {key} = {numbers[key]:g}: expected a positive number.")
    if kind == "normal" and numbers["sd"] > numbers["mean"] / 2:
        raise InputError(
            f"prior of {name}: sd = {numbers['sd']:g} of a mean of {numbers['mean']:g} gives "
            "negative values a share of more than 2 %: expected a truncated_normal or a lognormal."
        )


def default_density(parameter: Parameter, start: float, log_sd: float):
    """A lognormal about the starting value, as the regularisation of `update` has it."""
    return density(parameter.name, "lognormal", {"median": start, "log_sd": log_sd})


@dataclass(frozen=True, eq=False)
class PriorDensity:
    """Independent densities of positive parameters, on coordinates x in which all are allowed.

    Attributes:
        parameters: What is identified; values outside of their bounds have no density.
        densities: One frozen distribution of scipy for each, of the value itself, SI.
        scale: Coordinates; logarithms, and what keeps E below its limit where a law has one.
    """

    parameters: tuple[Parameter, ...]
    densities: tuple
    scale: LogScale

    def __post_init__(self):
        if not self.parameters or len(self.parameters) != len(self.densities):
            raise InputError("prior: expected one density for each of one or more parameters.")
        for p, d in zip(self.parameters, self.densities, strict=True):
            share = d.cdf(p.upper) - d.cdf(max(p.lower, 0.0))
            if not share > 1e-3:
                raise InputError(
                    f"prior of {p.name}: has {share:.1g} of its probability between the bounds "
                    f"{p.lower:g} and {p.upper:g}; expected a density that lies there."
                )
        object.__setattr__(self, "_logs", [log_pdf(d) for d in self.densities])

    def __repr__(self) -> str:
        return f"PriorDensity({shorten(', '.join(self.names), 80)})"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def size(self) -> int:
        """Number of the parameters."""
        return len(self.parameters)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Parameters at coordinates (n, d): SI, (n, d)."""
        return np.exp(self.scale.logs(np.asarray(x, dtype=float).T).T)

    def coordinates(self, values: np.ndarray) -> np.ndarray:
        """Coordinates of parameters (n, d)."""
        return self.scale.inverse(np.log(np.asarray(values, dtype=float)).T).T

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """ln of the density of x at (n, d), up to a constant: (n,); -inf where none is."""
        x = np.atleast_2d(np.asarray(x, dtype=float))
        logs = self.scale.logs(x.T)
        values = np.exp(logs)
        # dp / dx: p itself for a logarithm, and the logit's slope for a coupled E.
        total = np.sum(logs, axis=0)
        for E, _, _ in self.scale.pairs:
            total += log_expit(-x[:, E])
        for p, density_of, row in zip(self.parameters, self._logs, values, strict=True):
            total += np.where((row >= p.lower) & (row <= p.upper), density_of(row), -np.inf)
        return np.where(np.isnan(total), -np.inf, total)

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws that bounds and laws allow, coordinates (n, d).

        Raises:
            InputError: If hardly any draw is allowed.
        """
        found = np.empty((0, self.size))
        for _ in range(100):
            draws = np.array([d.rvs(max(n, 64), random_state=rng) for d in self.densities]).T
            found = np.vstack([found, draws[self._allowed(draws)]])
            if len(found) >= n:
                return self.coordinates(found[:n])
        raise InputError(
            f"prior of {', '.join(self.names)}: hardly any draw is within the bounds and the laws' "
            "limits; expected densities that lie there."
        )

    def _allowed(self, values: np.ndarray) -> np.ndarray:
        low, high = np.array([(max(p.lower, 0.0), p.upper) for p in self.parameters]).T
        good = np.all((values > 0) & (values >= low) & (values <= high), axis=1)
        for E, G, limit in self.scale.pairs:
            good &= values[:, E] < limit * values[:, G]
        return good

    def describe(self) -> Sequence[str]:
        """Each density in words, with the range that holds 95 % of what its bounds leave."""
        words = []
        for p, d in zip(self.parameters, self.densities, strict=True):
            first, last = d.cdf(max(p.lower, 0.0)), d.cdf(p.upper)
            low, high = d.ppf(first + np.array([0.025, 0.975]) * (last - first))
            kind = _CALLED.get(d.dist.name, d.dist.name)
            words.append(f"{p.name}: {kind}, 95 % in {interval(low, high, p.unit)}")
        return words

    def exactly(self) -> list[str]:
        """Each density to the last digit, for fingerprints."""
        return [f"{d.dist.name} {d.args} {sorted(d.kwds.items())}" for d in self.densities]
