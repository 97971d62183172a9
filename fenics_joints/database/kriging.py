"""Kriging of joint parameters over their connection conditions, with its own uncertainty.

Gaussian processes fitted by scikit-learn: anisotropic kernels, hyperparameters by maximum
likelihood from several starts. Outputs are positive, so it is their logarithms that are
interpolated. Which kernel, trend and scale of each input suit the data is not asked of the user nor
of test points: all are fitted, and weighed by stacking, the weights that make the leave-one-out
predictions of the sample points likeliest (Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13
(2018) 917). Machines 2022, section 3.2, has one Kriging model with a chosen regression.
"""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.database.hull import Hull
from fenics_joints.database.joints import UNITS
from fenics_joints.database.process import JITTER, Process
from fenics_joints.errors import InputError, located
from fenics_joints.files import json_digest, json_text, write_text
from fenics_joints.formatting import interval, quantity

#: What a saved fit says it is: raise the number when others are to be fitted anew.
FORMAT = _FORMAT, _VERSION = "fenics-joints kriging", 2
_KERNELS = ("gaussian", "matern 5/2")
_TRENDS = ("constant", "linear")
_SCALES = ("log", "linear")
#: Fewer points than this say nothing about a kernel.
_FEWEST = 5
_LEAST_WEIGHT = 1e-3


@dataclass(frozen=True)
class Interpolation:
    """Interpolated values with their uncertainty; arrays of shape (n,), in the output's unit.

    Attributes:
        value: Median of the prediction.
        sd: Standard deviation.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        inside: Whether the point lies in the convex hull of the sample points.
    """

    value: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    inside: np.ndarray

    def __repr__(self) -> str:
        return f"Interpolation({len(self.value)} points, {int(self.inside.sum())} inside)"


@dataclass(frozen=True)
class LeaveOneOut:
    """Each sample point predicted from all others; arrays of shape (n,).

    Attributes:
        value: Predicted, in the output's unit.
        error: Relative error of the prediction.
        standardised: Error of the logarithm over its predicted standard deviation; of a
            calibrated model their spread is 1.
    """

    value: np.ndarray
    error: np.ndarray
    standardised: np.ndarray

    def __repr__(self) -> str:
        return f"LeaveOneOut(mean error {100 * np.abs(self.error).mean():.2g} %)"


@dataclass(frozen=True)
class _Member:
    """One Gaussian process of the average: what is needed to make it again."""

    kernel: str
    trend: str
    scales: Sequence[str]
    theta: Sequence[float]
    weight: float


def _checksum(content: Mapping) -> str:
    return json_digest({key: value for key, value in content.items() if key != "checksum"})


class Kriging:
    """A positive output over positive inputs, interpolated with uncertainty.

    Use `fit` or `load`, not the constructor.
    """

    def __init__(self, inputs, output, x, y, members: Sequence[_Member], facets=None):
        self.inputs, self.output = tuple(inputs), str(output)
        self.x, self.y = x, y
        self.members = tuple(members)
        self._varying = np.ptp(x, axis=0) > 0
        self._hull = Hull(x[:, self._varying], facets)
        z, log_y = x[:, self._varying], np.log(y)
        self.processes = [
            Process(m.kernel, m.trend, m.theta, _scaled(z, z, m.scales), log_y)
            for m in self.members
        ]

    def __repr__(self) -> str:
        return f"Kriging({self.output} of {', '.join(self.inputs)}; {len(self.y)} points)"

    @classmethod
    def fit(
        cls, x: np.ndarray, y: np.ndarray, *, inputs: Sequence[str], output: str, restarts: int = 2
    ) -> Kriging:
        """Fit all candidate processes and weigh them by stacking.

        Args:
            x: Sample points, shape (n, len(inputs)), above 0. A column of one value is no
                variable; predictions are then for that value only.
            y: Values there, shape (n,), above 0.
            inputs: Names of the columns, for messages.
            output: Name of the output, for messages.
            restarts: Random starts of the likelihood's maximisation, besides the standard one.

        Raises:
            InputError: If values are not positive and finite, or are fewer than 5.
        """
        from threadpoolctl import threadpool_limits

        x, y = _checked(x, y, inputs, output)
        varying = np.ptp(x, axis=0) > 0
        if not varying.any():
            raise InputError(f"{output}: all {len(y)} rows have the same {', '.join(inputs)}")
        z, log_y = x[:, varying], np.log(y)
        candidates, scores = [], []
        with threadpool_limits(1):  # the matrices are small: threads only get in each other's way
            for kernel, trend in itertools.product(_KERNELS, _TRENDS):
                for scales in itertools.product(_SCALES, repeat=z.shape[1]):
                    process = _fitted(kernel, trend, _scaled(z, z, scales), log_y, restarts)
                    theta = tuple(map(float, process.kernel_.theta))
                    known = Process(kernel, trend, theta, _scaled(z, z, scales), log_y)
                    residual, sd = known.leave_one_out()
                    scores.append(-0.5 * (residual / sd) ** 2 - np.log(sd))
                    candidates.append((kernel, trend, scales, theta))
        weights = _stacking(np.array(scores).T)
        members = [_Member(*candidates[i], float(weights[i])) for i in np.flatnonzero(weights > 0)]
        return cls(inputs, output, x, y, sorted(members, key=lambda m: -m.weight))

    def predict(self, x: np.ndarray, *, extrapolate: bool = False) -> Interpolation:
        """Values at points, shape (n, len(inputs)).

        Args:
            x: The points.
            extrapolate: Predict outside the sample points' convex hull too; `inside` says where.

        Raises:
            InputError: If a point lies outside and ``extrapolate`` is false, or is not positive.
        """
        x = np.atleast_2d(np.asarray(x, dtype=float))
        if x.shape[1] != len(self.inputs) or not np.all(np.isfinite(x) & (x > 0)):
            raise InputError(
                f"{self.output}: expected points of {', '.join(self.inputs)}, numbers above 0"
            )
        same = np.all(np.isclose(x, self.x[0], rtol=1e-9, atol=0) | self._varying, axis=1)
        inside = same & self._hull.contains(x[:, self._varying])
        if not extrapolate and not inside.all():
            raise InputError(self._outside(x[~inside][0]))
        z, samples = x[:, self._varying], self.x[:, self._varying]
        mean, variance = self._mixture(
            lambda process, scales: process.predict(_scaled(z, samples, scales))
        )
        sd = np.sqrt(variance)
        with np.errstate(over="ignore"):  # far outside the data: as uncertain as infinity
            value = np.exp(mean)
            return Interpolation(
                value,
                value * np.sqrt(np.expm1(variance)),
                np.exp(mean - 1.96 * sd),
                np.exp(mean + 1.96 * sd),
                inside,
            )

    def leave_one_out(self) -> LeaveOneOut:
        """Predict every sample point from the others, hyperparameters and weights kept."""
        mean, variance = self._mixture(lambda process, scales: process.leave_one_out())
        value = np.exp(np.log(self.y) - mean)
        return LeaveOneOut(value, value / self.y - 1, -mean / np.sqrt(variance))

    def in_words(self) -> str:
        """Which processes are averaged, with their weights."""
        names = [n for n, varies in zip(self.inputs, self._varying, strict=True) if varies]
        parts = []
        for m in self.members:
            logs = [n for n, scale in zip(names, m.scales, strict=True) if scale == "log"]
            of = f"log of {' and '.join(logs)}" if logs else "no logarithm of inputs"
            parts.append(f"{m.weight:.0%} {m.kernel} kernel, {m.trend} trend, {of}")
        return "; ".join(parts)

    def save(self, path: str | Path) -> None:
        """Write as JSON: data, kernels and hyperparameters. Raises InputError if it cannot."""
        write_text(path, json_text(self.to_json()))

    @classmethod
    def load(cls, path: str | Path) -> Kriging:
        """Read what `save` wrote; predictions are the same.

        Raises:
            InputError: If the file cannot be read or holds something else.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read ({error}), expected saved Kriging") from error
        with located(path):
            return cls.from_json(content)

    def to_json(self) -> dict[str, object]:
        """The complete model for JSON, with a checksum."""
        content = {
            "format": _FORMAT,
            "version": _VERSION,
            "inputs": list(self.inputs),
            "output": self.output,
            "x": self.x.tolist(),
            "y": self.y.tolist(),
            "members": [vars(m) for m in self.members],
            "facets": self._hull.facets.tolist(),
        }
        return {**content, "checksum": _checksum(content)}

    @classmethod
    def from_json(cls, content: Mapping) -> Kriging:
        """The model of `to_json`; raises InputError if it is something else."""
        if not isinstance(content, Mapping) or content.get("format") != _FORMAT:
            raise InputError(f"is not {_FORMAT!r}")
        if content.get("version") != _VERSION:
            raise InputError(f"is version {content.get('version')!r}, expected {_VERSION}")
        try:
            x, y = _checked(content["x"], content["y"], content["inputs"], content["output"])
            members = [_Member(**member) for member in content["members"]]
            for m in members:
                known = m.kernel in _KERNELS and m.trend in _TRENDS and set(m.scales) <= {*_SCALES}
                if not known or not np.all(np.isfinite([*m.theta, m.weight])):
                    raise ValueError(f"{m} is no process")
            if content["checksum"] != _checksum(content):
                raise ValueError("its checksum does not match its content")
            return cls(content["inputs"], content["output"], x, y, members, content.get("facets"))
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"is incomplete or damaged ({error!r})") from error

    def _mixture(self, predict: Callable) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of what the processes predict of the logarithm.

        Args:
            predict: Means and standard deviations by a process and the scales of its inputs.
        """
        weights = np.array([m.weight for m in self.members])[:, None]
        each = [predict(p, m.scales) for p, m in zip(self.processes, self.members, strict=True)]
        means, sds = (np.array(a) for a in zip(*each, strict=True))
        mean = np.sum(weights * means, axis=0)
        return mean, np.sum(weights * (sds**2 + (means - mean) ** 2), axis=0)

    def _outside(self, point: np.ndarray) -> str:
        units = [UNITS.get(name, "") for name in self.inputs]
        said = ", ".join(
            f"{n} {quantity(v, u)}" for n, v, u in zip(self.inputs, point, units, strict=True)
        )
        box = ", ".join(
            f"{n} {interval(low, high, u)}" if high > low else f"{n} {quantity(low, u)} only"
            for n, u, low, high in zip(
                self.inputs, units, self.x.min(0), self.x.max(0), strict=True
            )
        )
        return (
            f"{self.output} at {said} would be extrapolated; expected a point among the data: "
            f"{box} (it is answered, and marked, if extrapolation is asked for)"
        )


def _checked(x, y, inputs, output) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.array(x, dtype=float), np.array(y, dtype=float)
    if x.ndim != 2 or x.shape != (y.size, len(inputs)) or y.ndim != 1:
        raise InputError(
            f"{output}: points {x.shape} and values {y.shape}, expected (n, {len(inputs)}) and (n,)"
        )
    if len(y) < _FEWEST:
        raise InputError(f"{output}: {len(y)} rows, expected at least {_FEWEST} to interpolate")
    if not (np.all(np.isfinite(x) & (x > 0)) and np.all(np.isfinite(y) & (y > 0))):
        raise InputError(f"{output}: expected finite numbers above 0 in every row")
    return x, y


def _scaled(z: np.ndarray, samples: np.ndarray, scales: Sequence[str]) -> np.ndarray:
    """Each input in its scale, with the samples' mean 0 and standard deviation 1."""
    logs = np.array([scale == "log" for scale in scales])
    z, samples = (np.where(logs, np.log(a), a) for a in (z, samples))
    return (z - samples.mean(axis=0)) / samples.std(axis=0)


def _kernel(kernel: str, trend: str, n: int):
    from sklearn.gaussian_process import kernels as k

    lengths, bounds = np.ones(n), (0.05, 50.0)
    if kernel == "gaussian":
        shape = k.RBF(lengths, bounds)
    else:
        shape = k.Matern(lengths, bounds, nu=2.5)
    total = k.ConstantKernel(1.0, (1e-3, 1e4)) * shape
    if trend == "linear":  # a linear trend with unknown coefficients is a linear kernel
        total += k.ConstantKernel(1.0, (1e-3, 1e4)) * k.DotProduct(1.0, (1e-3, 1e3))
    # Scatter of the data themselves: a contact radius steps with the mesh it was read from.
    return total + k.WhiteKernel(1e-4, (1e-9, 0.1))


def _fitted(kernel, trend, z, log_y, restarts):
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor

    process = GaussianProcessRegressor(
        _kernel(kernel, trend, z.shape[1]),
        alpha=JITTER,
        n_restarts_optimizer=restarts,
        normalize_y=True,
        random_state=0,
    )
    with warnings.catch_warnings():
        # A length at its bound is an input that does not matter, not a failure.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return process.fit(z, log_y)


def _stacking(log_densities: np.ndarray) -> np.ndarray:
    """Weights that maximise the mean log of the weighted densities, shape (n, candidates)."""
    density = np.exp(log_densities - log_densities.max(axis=1, keepdims=True))
    weights = np.full(density.shape[1], 1 / density.shape[1])
    for _ in range(20000):  # expectation maximisation: each step raises the likelihood
        shares = density * weights
        new = (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)
        done = np.abs(new - weights).max() < 1e-9
        weights = new
        if done:
            break
    weights[weights < _LEAST_WEIGHT] = 0.0
    return weights / math.fsum(weights)
