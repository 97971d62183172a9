"""Kriging of joint parameters over their connection conditions, with its own uncertainty.

Gaussian processes of scikit-learn: anisotropic kernels, hyperparameters by maximum likelihood.
Outputs are positive, so it is their logarithms that are interpolated. Which kernel and which scale
of each input suit the data is not asked of the user nor of test points: all are fitted, and weighed
by stacking, the weights that make the leave-one-out predictions of the sample points likeliest
(Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13 (2018) 917). Machines 2022, section 3.2, has
one Kriging model with a chosen regression.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.database.joints import UNITS
from fenics_joints.errors import InputError
from fenics_joints.formatting import interval, quantity

_KERNELS = ("gaussian", "matern 5/2")
_SCALES = ("log", "linear")
#: Fewer points than this say nothing about a kernel.
_FEWEST = 5
#: Random starts of the likelihood's maximisation, besides the standard one.
_RESTARTS = 2
#: Distance from the convex hull, relative to the points' range, at which a point is still inside.
_ON_HULL = 1e-7
#: Processes of less weight are left out.
_LEAST_WEIGHT = 1e-3


@dataclass(frozen=True)
class Interpolation:
    """Interpolated values in the output's SI unit: arrays of shape (n,), or numbers for one point.

    Attributes:
        value: Median of the prediction.
        sd: Standard deviation.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        extrapolated: Whether the point lies outside the convex hull of the sample points.
    """

    value: np.ndarray | float
    sd: np.ndarray | float
    low: np.ndarray | float
    high: np.ndarray | float
    extrapolated: np.ndarray | bool

    def __repr__(self) -> str:
        outside = int(np.sum(self.extrapolated))
        return f"Interpolation({np.size(self.value)} points, {outside} extrapolated)"


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
class Member:
    """One Gaussian process of a weighted mean.

    Attributes:
        process: scikit-learn's, of ln y over the scaled inputs.
        kernel: Its kernel's name.
        scales: ``log`` or ``linear`` for each input that varies.
        weight: Its weight.
    """

    process: object
    kernel: str
    scales: tuple[str, ...]
    weight: float = 0.0


class Kriging:
    """A positive output over positive inputs, interpolated with uncertainty.

    Args:
        x: Sample points, shape (n, len(inputs)), above 0. A column of one value is no variable;
            predictions are then for that value only.
        y: Values there, shape (n,), above 0.
        inputs: Names of the columns.
        output: Name of the output.

    Attributes:
        members: The Gaussian processes that are averaged, the heaviest first.

    Raises:
        InputError: If values are not positive and finite, or are fewer than 5.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray, inputs: Sequence[str], output: str):
        from threadpoolctl import threadpool_limits

        self.inputs, self.output = tuple(inputs), str(output)
        self.x, self.y = _checked(x, y, self.inputs, self.output)
        self._varying = np.ptp(self.x, axis=0) > 0
        if not self._varying.any():
            raise InputError(f"{output}: all {len(y)} rows have the same {', '.join(inputs)}")
        z, members, scores = self._samples, [], []
        with threadpool_limits(1):  # the matrices are small: threads only get in each other's way
            for kernel, *scales in itertools.product(_KERNELS, *[_SCALES] * z.shape[1]):
                process = _fitted(kernel, _scaled(z, z, scales), self.y)
                residual, sd = _left_out(process, self.y)
                scores.append(-0.5 * (residual / sd) ** 2 - np.log(sd))
                members.append(Member(process, kernel, tuple(scales)))
        weights = _stacking(np.array(scores).T)
        self.members = tuple(
            replace(members[i], weight=float(weights[i]))
            for i in np.argsort(-weights)
            if weights[i] > 0
        )

    def __repr__(self) -> str:
        return f"Kriging({self.output} of {', '.join(self.inputs)}; {len(self.y)} points)"

    @property
    def _samples(self) -> np.ndarray:
        return self.x[:, self._varying]

    def predict(self, x: np.ndarray, *, extrapolate: bool = False) -> Interpolation:
        """Values at points.

        Args:
            x: The points, shape (n, len(inputs)), or one of shape (len(inputs),).
            extrapolate: Predict outside the sample points' convex hull too, and say where.

        Raises:
            InputError: If a point lies outside and ``extrapolate`` is false, or is not positive.
        """
        x = np.asarray(x, dtype=float)
        if x.ndim == 1:
            found = self.predict(x[None], extrapolate=extrapolate)
            return Interpolation(*(values[0].item() for values in vars(found).values()))
        if x.shape[1] != len(self.inputs) or not np.all(np.isfinite(x) & (x > 0)):
            raise InputError(
                f"{self.output}: expected points of {', '.join(self.inputs)}, numbers above 0"
            )
        same = np.all(np.isclose(x, self.x[0], rtol=1e-9, atol=0) | self._varying, axis=1)
        inside = same & _in_hull(x[:, self._varying], self._samples)
        if not extrapolate and not inside.all():
            raise InputError(self._outside(x[~inside][0]))
        z = x[:, self._varying]
        mean, variance = self._mixture(
            lambda m: m.process.predict(_scaled(z, self._samples, m.scales), return_std=True)
        )
        sd = np.sqrt(variance)
        with np.errstate(over="ignore"):  # far outside the data: as uncertain as infinity
            value = np.exp(mean)
            return Interpolation(
                value,
                value * np.sqrt(np.expm1(variance)),
                np.exp(mean - 1.96 * sd),
                np.exp(mean + 1.96 * sd),
                ~inside,
            )

    def leave_one_out(self) -> LeaveOneOut:
        """Predict every sample point from the others, hyperparameters and weights kept."""
        residual, variance = self._mixture(lambda m: _left_out(m.process, self.y))
        value = self.y * np.exp(-residual)
        return LeaveOneOut(value, value / self.y - 1, -residual / np.sqrt(variance))

    def in_words(self) -> str:
        """Which processes are averaged, with their weights."""
        names, parts = np.array(self.inputs)[self._varying], []
        for m in self.members:
            logs = [n for n, scale in zip(names, m.scales, strict=True) if scale == "log"]
            of = f"log of {' and '.join(logs)}" if logs else "no logarithm of inputs"
            parts.append(f"{m.weight:.0%} {m.kernel} kernel, {of}")
        return "; ".join(parts)

    def _mixture(self, predict: Callable) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of what the members predict of the logarithm.

        Args:
            predict: Means and standard deviations by a member.
        """
        weights = np.array([m.weight for m in self.members])[:, None]
        means, sds = (np.array(each) for each in zip(*map(predict, self.members), strict=True))
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


def _fitted(kernel: str, z: np.ndarray, y: np.ndarray):
    """A Gaussian process of ln y, its hyperparameters by maximum likelihood."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process import kernels as k

    lengths, bounds = np.ones(z.shape[1]), (0.05, 50.0)
    shape = k.RBF(lengths, bounds) if kernel == "gaussian" else k.Matern(lengths, bounds, nu=2.5)
    # Scatter of the data themselves: a contact radius steps with the mesh it was read from.
    total = k.ConstantKernel(1.0, (1e-3, 1e4)) * shape + k.WhiteKernel(1e-4, (1e-9, 0.1))
    process = GaussianProcessRegressor(
        total, n_restarts_optimizer=_RESTARTS, normalize_y=True, random_state=0
    )
    with warnings.catch_warnings():
        # A length at its bound is an input that does not matter, not a failure.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return process.fit(z, np.log(y))


def _left_out(process, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of ln y and predicted standard deviations, each sample from the others, with their
    mean as the prior mean (Rasmussen and Williams, Gaussian Processes, 2006, eqs. 5.10 to 5.12)."""
    y, inverse = np.log(y), np.linalg.inv(process.kernel_(process.X_train_))
    means = (y.sum() - y) / (len(y) - 1)
    diagonal = np.diag(inverse)
    residual = (inverse @ y - means * inverse.sum(axis=1)) / diagonal
    scale = y.std() if y.std() > 10 * np.finfo(float).eps else 1.0  # as scikit-learn scales them
    return residual, scale / np.sqrt(diagonal)


def _stacking(log_densities: np.ndarray) -> np.ndarray:
    """Weights that maximise the mean log of the weighted densities, shape (n, members)."""
    density = np.exp(log_densities - log_densities.max(axis=1, keepdims=True))
    weights = np.full(density.shape[1], 1 / density.shape[1])
    for _ in range(20000):  # expectation maximisation: each step raises the likelihood
        before, shares = weights, density * weights
        weights = (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)
        if np.abs(weights - before).max() < 1e-9:
            break
    weights[weights < _LEAST_WEIGHT] = 0.0
    return weights / weights.sum()


def _in_hull(points: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Whether points, (m, d), lie in the convex hull of samples, (n, d), which may be a line or a
    plane; shape (m,)."""
    from scipy.spatial import ConvexHull

    size = np.ptp(samples, axis=0)
    centre = samples.mean(axis=0)
    samples, points = (samples - centre) / size, (points - centre) / size
    _, singular, axes = np.linalg.svd(samples, full_matrices=True)
    rank = int(np.sum(singular > 1e-9 * singular[0]))
    own, asked = samples @ axes[:rank].T, points @ axes[:rank].T
    inside = np.all(np.abs(points @ axes[rank:].T) <= _ON_HULL, axis=1)
    low, high = own.min(axis=0) - _ON_HULL, own.max(axis=0) + _ON_HULL
    inside &= np.all((asked >= low) & (asked <= high), axis=1)
    if rank > 1:
        facets = ConvexHull(own).equations
        inside &= np.all(asked @ facets[:, :-1].T + facets[:, -1] <= _ON_HULL, axis=1)
    return inside
