"""Specimens that differ, and a mean that is not known: two levels instead of one.

Each specimen has parameters of its own, which scatter about the structure's,

    x_s ~ N(mu, Sigma),    ln f_s = g(x_s) + b + e_s,    e_s ~ N(0, tau^2 I),

with x the logarithms of the parameters (`updating.coordinates.LogScale`). Sigma is the scatter
of the specimens, which more of them do not make smaller; the posterior of mu is the lack of
knowledge, which they do. The frequencies of one specimen correlate, because they share x_s; the
product of one distribution per frequency (Jalali et al. 2019, eq. 8) cannot say that. b, if there
is any, is how far the model itself is off, the same for all specimens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.gibbs import Gibbs, Level, curvature
from fenics_joints.bayes.likelihood import checked_specimens
from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.bayes.samplers import Settings, Task, grow
from fenics_joints.bayes.walks import generator
from fenics_joints.errors import InputError, flag, real
from fenics_joints.measurements.least_squares import LeastSquares

#: Least number of specimens: fewer do not tell scatter from noise.
_FEWEST = 5


@dataclass(frozen=True, eq=False)
class Specimens:
    """What was measured on nominally equal specimens, and what is assumed of it.

    Attributes:
        mode_names: Names of the modes, m of them.
        frequencies_hz: Shape (S, m); nan where not measured.
        noise: Relative standard deviation of a measured frequency: itself if ``noise_known``, else
            the scale of a half-Cauchy prior.
        noise_known: Whether the noise is given and not found.
        scatter: Scale of the half-t priors of the parameters' relative scatter.
        discrepancy: Relative error that frequencies of the best model may have; 0 for none.

    Raises:
        InputError: For fewer than five specimens, frequencies that are not positive, or scales
            that are not.
    """

    mode_names: tuple[str, ...]
    frequencies_hz: np.ndarray
    noise: float = 1e-3
    noise_known: bool = False
    scatter: float = 0.1
    discrepancy: float = 0.0

    def __post_init__(self):
        table = checked_specimens(self.mode_names, self.frequencies_hz)
        if len(table) < _FEWEST or np.any(np.all(np.isnan(table), axis=0)):
            raise InputError(
                f"frequencies of {len(table)} specimens: expected at least {_FEWEST}, and some for "
                "each mode."
            )
        for key in ("noise", "scatter"):
            if not 0 < real(key, getattr(self, key)) < 1:
                raise InputError(f"{key} = {getattr(self, key)}: expected from above 0 to below 1.")
        flag("noise_known", self.noise_known)
        if not 0 <= real("discrepancy", self.discrepancy) < 1:
            raise InputError(f"discrepancy = {self.discrepancy}: expected from 0 to below 1.")
        object.__setattr__(self, "frequencies_hz", table)

    def __repr__(self) -> str:
        return f"Specimens({len(self.frequencies_hz)} of {len(self.mode_names)} modes)"


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Chains of the two-level model.

    The quantities are: each parameter's median over specimens, SI; its ``scatter``, the standard
    deviation of its logarithm; their ``correlation``; the ``noise``; and each mode's ``offset``,
    relative, if the model may have a discrepancy.

    Attributes:
        chains: Draws of all quantities.
        prior: Of the parameters.
        specimens: The data.
    """

    chains: Chains
    prior: PriorDensity
    specimens: Specimens

    def __repr__(self) -> str:
        return f"Hierarchy({self.prior!r}, {self.specimens!r}, {self.chains!r})"

    def new_specimens(self, n_sets: int, size: int, seed: int = 0):
        """Parameters of new specimens, and what else comes to their frequencies.

        Args:
            n_sets: Sets, each of one draw of the posterior.
            size: Specimens of a set.
            seed: Of the draws.

        Returns:
            Values, SI, (n_sets, size, d); offsets of the modes, (n_sets, m); noise, (n_sets,).

        Raises:
            ConvergenceError: If the chains did not converge.
        """
        rng, draws = np.random.default_rng([seed, 3]), self.chains.draws()
        rows = draws[rng.choice(len(draws), n_sets)]
        mu, sigma, tau, b = _unpacked(rows, self.prior, self.specimens)
        p = self.prior.size
        root, steps = np.linalg.cholesky(sigma), rng.standard_normal((n_sets, size, p))
        x = mu[:, None] + np.einsum("npq,nsq->nsp", root, steps)
        return self.prior.values(x.reshape(-1, p)).reshape(n_sets, size, p), b, tau

    def replicate(
        self, model: Callable[[np.ndarray], np.ndarray], n_sets: int = 200, seed: int = 0
    ) -> np.ndarray:
        """ln f of new sets of as many specimens, (n_sets, S, m), drawn from the posterior.

        Args:
            model: From values (n, d) to ln f, (n, m).
            n_sets: Number of sets.
            seed: Of the draws.

        Raises:
            ConvergenceError: If the chains did not converge.
        """
        S, rng = len(self.specimens.frequencies_hz), np.random.default_rng([seed, 8])
        values, b, tau = self.new_specimens(n_sets, S, seed)
        log_f = model(values.reshape(-1, self.prior.size)).reshape(n_sets, S, -1)
        return log_f + b[:, None] + tau[:, None, None] * rng.standard_normal(log_f.shape)


def sample_hierarchy(
    specimens: Specimens,
    prior: PriorDensity,
    model: Callable[[np.ndarray], np.ndarray],
    settings: Settings,
    comm: MPI.Intracomm = MPI.COMM_SELF,
    *,
    keep: Path | None = None,
    told: Callable[[float], None] | None = None,
) -> Hierarchy:
    """Draw from the posterior of the two-level model. Collective.

    Args:
        specimens: The data.
        prior: Of the parameters' medians over specimens.
        model: From values (n, d) to ln f, (n, m); nan where the model lacks a mode.
        settings: Samples, burn-in, chains and seed; the sampler is Gibbs's whatever it says.
        comm: Ranks that share the chains.
        keep: See `fenics_joints.bayes.samplers.sample`.
        told: See there.

    Raises:
        InputError: If the model cannot be brought near the data, or the file is of another task.
    """

    def g(x):
        return model(prior.values(x))

    draws = prior.sample(64 * prior.size, np.random.default_rng([settings.seed, 4]))
    centre = _nearest(specimens, prior, g, draws)
    level = Level(
        prior.log_density,
        g,
        centre,
        _slope(g, centre),
        g(centre[None])[0],
        draws.mean(axis=0),
        draws.std(axis=0),
        specimens.scatter,
        specimens.noise,
        specimens.noise_known,
        specimens.discrepancy,
        curvature(g, centre) if specimens.discrepancy else None,
    )
    data = np.log(specimens.frequencies_hz)
    names = _names(prior.names, specimens)

    def walk(mine, states, burn_in):
        rngs = [generator(settings.seed, c) for c in mine]
        return Gibbs(level, np.repeat(data[None], len(rngs), axis=0), rngs, states)

    def values(points):
        flat = _packed(points.reshape(-1, points.shape[2]), prior, specimens)
        return flat.reshape(*points.shape[:2], -1)

    marks = {
        "prior": np.append(draws[:4], prior.log_density(draws[:4])),
        "model": g(draws[:4]),
        "data": np.append(
            data, [specimens.noise, specimens.noise_known, specimens.scatter, specimens.discrepancy]
        ),
    }
    task = Task(
        names,
        walk,
        values,
        marks,
        Gibbs.label,
        1,
        settings.samples,
        settings.burn_in,
        len(data) * (2 if specimens.discrepancy else 1),
    )
    return Hierarchy(grow(task, settings, comm, keep=keep, told=told), prior, specimens)


# -- quantities ------------------------------------------------------------------------------------


def _names(parameters: Sequence[str], specimens: Specimens) -> tuple[str, ...]:
    names = [*parameters, *(f"scatter {n}" for n in parameters)]
    names += [f"correlation {a}, {b}" for a, b in combinations(parameters, 2)]
    names += [] if specimens.noise_known else ["noise"]
    names += [f"offset {mode}" for mode in specimens.mode_names] if specimens.discrepancy else []
    return tuple(names)


def _slopes(prior: PriorDensity, mu: np.ndarray) -> np.ndarray:
    """Derivatives of the logarithms by the coordinates, (n, d, d)."""
    if not prior.scale.pairs:
        return np.broadcast_to(np.eye(prior.size), (len(mu), prior.size, prior.size))
    return np.array([prior.scale.slope(row) for row in mu])


def _packed(points: np.ndarray, prior: PriorDensity, specimens: Specimens) -> np.ndarray:
    """From the sampler's numbers, (n, q), to the quantities."""
    p = prior.size
    upper = np.triu_indices(p)
    mu, rest = points[:, :p], points[:, p + len(upper[0]) :]
    sigma = np.empty((len(points), p, p))
    sigma[:, upper[0], upper[1]] = sigma[:, upper[1], upper[0]] = points[:, p : p + len(upper[0])]
    turn = _slopes(prior, mu)
    sigma = turn @ sigma @ np.swapaxes(turn, 1, 2)
    sd = np.sqrt(np.einsum("npp->np", sigma))
    pairs = [sigma[:, a, b] / (sd[:, a] * sd[:, b]) for a, b in combinations(range(p), 2)]
    parts = [prior.values(mu), sd, *(pair[:, None] for pair in pairs)]
    parts += [] if specimens.noise_known else [rest[:, :1]]
    parts += [rest[:, 1:]] if specimens.discrepancy else []
    return np.concatenate(parts, axis=1)


def _unpacked(rows: np.ndarray, prior: PriorDensity, specimens: Specimens):
    """The inverse of `_packed`: mu, Sigma, tau and b."""
    p, n, m = prior.size, len(rows), len(specimens.mode_names)
    mu, sd = prior.coordinates(rows[:, :p]), rows[:, p : 2 * p]
    correlation, at = np.tile(np.eye(p), (n, 1, 1)), 2 * p
    for a, b in combinations(range(p), 2):
        correlation[:, a, b] = correlation[:, b, a] = rows[:, at]
        at += 1
    back = np.linalg.inv(_slopes(prior, mu))
    sigma = back @ (correlation * sd[:, :, None] * sd[:, None, :]) @ np.swapaxes(back, 1, 2)
    tau = np.full(n, specimens.noise)
    if not specimens.noise_known:
        tau, at = rows[:, at], at + 1
    offset = rows[:, at : at + m] if specimens.discrepancy else np.zeros((n, m))
    return mu, sigma, tau, offset


# -- where the model is linearised -----------------------------------------------------------------


def _nearest(specimens: Specimens, prior: PriorDensity, g, draws: np.ndarray) -> np.ndarray:
    """Coordinates at which the model is nearest to the mean of the specimens."""
    log_f = np.nanmean(np.log(specimens.frequencies_hz), axis=0)
    sd = np.nanstd(np.log(specimens.frequencies_hz), axis=0) + specimens.noise
    middle, spread = draws.mean(axis=0), draws.std(axis=0)

    def off(x: np.ndarray) -> np.ndarray:
        return np.nan_to_num((g(x) - log_f) / sd, nan=1e3)

    def hold(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A weak hold where the frequencies say nothing."""
        return 0.05 * (x - middle) / spread, np.diag(0.05 / spread)

    squares = np.sum(off(draws) ** 2, axis=1) + np.sum(hold(draws)[0] ** 2, axis=1)
    best = draws[np.argmin(squares)]
    if not np.all(np.isfinite(g(best[None]))):
        raise InputError(
            f"prior of {', '.join(prior.names)}: the model has the test's modes at none of "
            f"{len(draws)} draws; expected a prior about a model that has them."
        )
    fit = LeastSquares(lambda x: off(x[None])[0], lambda x: _slope(off, x), hold)
    return fit.solve(best, x_scale=spread).x


def _slope(g: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Derivative of g, from (n, p) to (n, m), at x (p,): (m, p)."""
    step = 1e-5 * np.eye(len(x))
    return ((g(x + step) - g(x - step)) / 2e-5).T
