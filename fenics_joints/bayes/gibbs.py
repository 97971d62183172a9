"""Gibbs sampling of the hierarchical model, for several chains (or sets of data) at a time.

x_s ~ N(mu, Sigma),  y_s = g(x_s) + b + e_s,  e_s ~ N(0, tau^2),  b ~ N(0, discrepancy^2)

mu has any prior. The scatter's standard deviations have half-t priors and its correlations even
ones (Huang and Wand, Bayesian Anal. 8, 2013, with nu = 2); tau a half-Cauchy one (Gelman, Bayesian
Anal. 1, 2006), or it is known. All steps but those of x and mu are exact draws; x is proposed from
the model's linearisation and accepted by the model itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.bayes.walks import Walk

#: Degrees of freedom of the scatter's prior, which makes its correlations even (Huang and Wand).
_NU = 2.0
#: Standard deviation of the linearisation's proposals, in its own; share of steps about the last
#: point. Chosen for mixing: neither changes the posterior.
_WIDER, _WALKS = 1.2, 0.3
#: Share of steps of the mean that stay near, and their correlation with the mean before them;
#: likewise.
_NEARS, _NEAR = 0.25, 0.85


@dataclass(frozen=True, eq=False)
class Level:
    """What the sampler needs to know.

    Attributes:
        log_prior: ln prior of mu, from (n, p) to (n,).
        model: g, from (n, p) to (n, m); nan where it cannot be.
        centre: Point of the linearisation, (p,).
        slope: Derivative of g there, (m, p).
        at_centre: g there, (m,).
        middle, spread: Mean and standard deviation of mu's prior, (p,): for proposals alone.
        scatter: Scale of the half-t priors of the scatter.
        noise: Scale of tau's half-Cauchy prior, or tau itself.
        known: Whether it is tau itself.
        discrepancy: Standard deviation of b; 0 for none.
        bend: Second derivative of g at the centre, (m, p, p): for proposals alone.
    """

    log_prior: Callable[[np.ndarray], np.ndarray]
    model: Callable[[np.ndarray], np.ndarray]
    centre: np.ndarray
    slope: np.ndarray
    at_centre: np.ndarray
    middle: np.ndarray
    spread: np.ndarray
    scatter: float
    noise: float
    known: bool
    discrepancy: float
    bend: np.ndarray | None = None

    @cached_property
    def straight(self) -> Straight:
        """Coordinates in which common steps of the specimens are taken."""
        p = len(self.centre)
        if self.bend is None or not self.discrepancy:
            return Straight(self.centre, np.zeros((p, p, p)))
        # Parameters that the frequencies say little of are not bent for them.
        square = self.slope.T @ self.slope + np.diag((self.discrepancy / self.spread) ** 2)
        inverse = np.linalg.solve(square, self.slope.T)
        return Straight(self.centre, np.einsum("pm,mij->pij", inverse, self.bend))


class Gibbs(Walk):
    """Chains of (mu, Sigma, tau, b), and of the specimens' x inside.

    Args:
        level: The model.
        data: ln f of the specimens, (n_chains, S, m); nan where not measured.
        rngs: One for each chain.
        states: What `states` returned, to go on from; None to begin.
    """

    label = "Gibbs, with Metropolis steps for the specimens"
    keys = ("x", "g", "mu", "sigma", "aux", "tau2", "b")

    def __init__(
        self,
        level: Level,
        data: np.ndarray,
        rngs: Sequence[np.random.Generator],
        states: Sequence[Mapping] | None = None,
    ):
        super().__init__(rngs)
        self.level = level
        self.there = np.isfinite(data)
        self.y = np.where(self.there, data, 0.0)
        self.upper = np.triu_indices(level.slope.shape[1])
        self.accepted = np.zeros(len(data))
        if states is not None:
            self.restore(states)
        elif len(data):
            self._begin()

    def _begin(self) -> None:
        """Specimens near where the linearised model has them, spread by chance."""
        level, (n, S, m), p = self.level, self.y.shape, self.level.slope.shape[1]
        square = level.slope.T @ level.slope
        ridge = square + 1e-8 * np.trace(square) * np.eye(p)
        off = np.where(self.there, self.y - level.at_centre, 0.0)
        guess = np.linalg.solve(ridge, level.slope.T @ off.reshape(-1, m).T).T.reshape(n, S, p)
        guess = np.clip(guess, -3 * level.scatter, 3 * level.scatter)
        spread = guess.std(axis=1, keepdims=True) + 1e-3 * level.scatter
        self.x = level.centre + guess + 0.5 * spread * self._normal(S, p)
        self.g = self._model(self.x)
        bad = ~np.all(np.isfinite(self.g), axis=2)
        self.x[bad] = level.centre
        self.g = np.where(bad[:, :, None], level.at_centre, self.g)
        self.mu = self.x.mean(axis=1)
        off = self.x - self.mu[:, None]
        floor = (1e-2 * level.scatter) ** 2 * np.eye(p)
        self.sigma = np.einsum("csp,csq->cpq", off, off) / S + floor
        self.aux = np.full((n, p), level.scatter**2)
        self.tau2 = np.full(n, level.noise**2)
        self.b = np.zeros((n, m))

    def advance(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Move all chains.

        Returns:
            (mu, upper triangle of Sigma, tau, b) by row, (n_chains, n, q); ln of the likelihood
            given the specimens' x, (n_chains, n); accepted shares of the specimens' steps.
        """
        m, p = self.level.slope.shape
        q = p + len(self.upper[0]) + 1 + m
        points, lps = np.empty((len(self.y), n, q)), np.empty((len(self.y), n))
        self.accepted[:] = 0.0
        if len(self.y):
            for i in range(n):
                self.sweep()
                upper = self.sigma[:, self.upper[0], self.upper[1]]
                tau = np.sqrt(self.tau2)[:, None]
                points[:, i] = np.concatenate([self.mu, upper, tau, self.b], axis=1)
                lps[:, i] = self._fits(self.g, self.b).sum(axis=1)
        return points, lps, self.accepted / n

    def sweep(self) -> None:
        """One step of everything."""
        self._specimens()
        if self.level.discrepancy:
            self._bias()
            self._shift()
        self._mean()
        self._scatter()
        if not self.level.known:
            self._noise()

    # -- random numbers ----------------------------------------------------------------------

    def _normal(self, *shape) -> np.ndarray:
        return np.array([rng.standard_normal(shape) for rng in self.rngs])

    def _even(self, *shape) -> np.ndarray:
        return np.array([rng.random(shape) for rng in self.rngs])

    def _gamma(self, shape: np.ndarray) -> np.ndarray:
        """Gamma variables of scale 1, one for each entry of (n_chains, ...)."""
        return np.array([rng.standard_gamma(s) for rng, s in zip(self.rngs, shape, strict=True)])

    # -- steps -------------------------------------------------------------------------------

    def _model(self, x: np.ndarray) -> np.ndarray:
        n, S, p = x.shape
        return self.level.model(x.reshape(-1, p)).reshape(n, S, -1)

    def _fits(self, g: np.ndarray, b: np.ndarray) -> np.ndarray:
        """ln of each specimen's likelihood, (n_chains, S)."""
        off = np.where(self.there, self.y - g - b[:, None], 0.0)
        count = self.there.sum(axis=2)
        total = -0.5 * np.sum(off**2, axis=2) / self.tau2[:, None]
        total -= 0.5 * count * np.log(2 * np.pi * self.tau2)[:, None]
        return np.where(np.isfinite(total), total, -np.inf)

    def _specimens(self) -> None:
        level, (S, p) = self.level, self.x.shape[1:]
        precision = np.linalg.inv(self.sigma)
        weight = self.there / self.tau2[:, None, None]
        information = precision[:, None] + np.einsum(
            "csm,mp,mq->cspq", weight, level.slope, level.slope, optimize=True
        )
        target = self.y - self.b[:, None] - level.at_centre + level.slope @ level.centre
        pull = np.einsum("cpq,cq->cp", precision, self.mu)[:, None]
        pull = pull + np.einsum("csm,mp->csp", weight * target, level.slope)
        centre = np.linalg.solve(information, pull[..., None])[..., 0]
        # x = centre + L^-T z has the covariance information^-1.
        lower = np.linalg.cholesky(information)
        draw = np.linalg.solve(np.swapaxes(lower, 2, 3), self._normal(S, p)[..., None])[..., 0]
        walks = self._even() < _WALKS
        step = 2.38 / np.sqrt(p) * draw
        proposed = np.where(walks[:, None, None], self.x + step, centre + _WIDER * draw)
        g = self._model(proposed)

        def weigh(x, fits):
            """ln target less ln proposal, which is symmetric for a walk."""
            off = x - self.mu[:, None]
            total = fits - 0.5 * np.einsum("csp,cpq,csq->cs", off, precision, off)
            from_centre = x - centre
            own = np.einsum("csp,cspq,csq->cs", from_centre, information, from_centre)
            return total + np.where(walks[:, None], 0.0, 0.5 * own / _WIDER**2)

        now = weigh(self.x, self._fits(self.g, self.b))
        then = weigh(proposed, self._fits(g, self.b))
        taken = np.log(self._even(S)) < then - now
        self.x = np.where(taken[..., None], proposed, self.x)
        self.g = np.where(taken[..., None], g, self.g)
        self.accepted += taken.mean(axis=1)

    def _bias(self) -> None:
        off = np.where(self.there, self.y - self.g, 0.0).sum(axis=1) / self.tau2[:, None]
        count = self.there.sum(axis=1) / self.tau2[:, None]
        precision = count + 1 / self.level.discrepancy**2
        self.b = off / precision + self._normal(off.shape[1]) / np.sqrt(precision)

    def _shift(self) -> None:
        """Move all x and mu by one step and b by the opposite change of the frequencies, which the
        data leave open.

        The step is one of `straight`. b takes the change of the specimens' mean frequencies by the
        model itself, so that the likelihood hardly changes. The step is drawn as if it did not
        change at all and the prior were normal. Some steps stay near, since far ones are refused
        where this is less true.
        """
        level, p, straight = self.level, self.x.shape[2], self.level.straight
        hold = 1 / level.spread**2
        information = level.slope.T @ level.slope / level.discrepancy**2 + np.diag(hold)
        root = np.linalg.inv(np.linalg.cholesky(information)).T
        near = np.where(self._even() < _NEARS, _NEAR, 0.0)[:, None]
        target = straight(level.middle)

        def middle(mu, b):
            pull = b @ level.slope / level.discrepancy**2 + hold * (target - straight(mu))
            return (1 - near) * np.linalg.solve(information, pull.T).T

        def density(x, mu, g, b):
            off, prior = x - mu[:, None], level.log_prior(mu)
            prior = prior - 0.5 * np.sum(b**2, axis=1) / level.discrepancy**2
            prior = prior - 0.5 * np.einsum("csp,cpq,csq->c", off, precision, off)
            return prior + self._fits(g, b).sum(axis=1)

        def proposal(off):
            return -0.5 * np.einsum("cp,pq,cq->c", off, information, off) / (1 - near[:, 0] ** 2)

        precision = np.linalg.inv(self.sigma)
        there = middle(self.mu, self.b)
        step = there + np.sqrt(1 - near**2) * (self._normal(p) @ root.T)
        every = np.concatenate([self.mu[:, None], self.x], axis=1)
        every, volume, good = straight.moved(every, step[:, None])
        mu, x = every[:, 0], every[:, 1:]
        g = self._model(x)
        b = self.b - (g - self.g).mean(axis=1)
        gain = density(x, mu, g, b) - density(self.x, self.mu, self.g, self.b)
        gain += proposal(-step - middle(mu, b)) - proposal(step - there) + volume.sum(axis=1)
        taken = (np.log(self._even()) < gain) & good.all(axis=1)
        self.mu, self.b = (np.where(taken[:, None], a, o) for a, o in ((mu, self.mu), (b, self.b)))
        self.x, self.g = (
            np.where(taken[:, None, None], a, o) for a, o in ((x, self.x), (g, self.g))
        )

    def _mean(self) -> None:
        """From what the specimens say, accepted by the prior."""
        S, p = self.x.shape[1:]
        root = np.linalg.cholesky(self.sigma / S)
        middle = self.x.mean(axis=1)
        proposed = middle + np.einsum("cpq,cq->cp", root, self._normal(p))
        gain = self.level.log_prior(proposed) - self.level.log_prior(self.mu)
        taken = np.log(self._even()) < gain
        self.mu = np.where(taken[:, None], proposed, self.mu)

    def _scatter(self) -> None:
        n, S, p = self.x.shape
        off = self.x - self.mu[:, None]
        sums = np.einsum("csp,csq->cpq", off, off)
        sums += 2 * _NU * (1 / self.aux)[:, :, None] * np.eye(p)
        freedom = _NU + p - 1 + S
        # Bartlett: the inverse of Sigma is L A (L A)^T with L L^T the inverse of the sums.
        lower = np.linalg.cholesky(np.linalg.inv(sums))
        chi2 = 2 * self._gamma(np.tile((freedom - np.arange(p)) / 2, (n, 1)))
        bartlett = np.tril(self._normal(p, p), -1) + np.sqrt(chi2)[:, :, None] * np.eye(p)
        root = lower @ bartlett
        inverse = root @ np.swapaxes(root, 1, 2)
        self.sigma = np.linalg.inv(inverse)
        self.sigma = 0.5 * (self.sigma + np.swapaxes(self.sigma, 1, 2))
        rate = _NU * np.einsum("cpp->cp", inverse) + 1 / self.level.scatter**2
        self.aux = rate / self._gamma(np.full((n, p), (_NU + p) / 2))

    def _noise(self) -> None:
        off = np.where(self.there, self.y - self.g - self.b[:, None], 0.0)
        squares, count = np.sum(off**2, axis=(1, 2)), self.there.sum(axis=(1, 2))
        aux = (1 / self.tau2 + 1 / self.level.noise**2) / self._gamma(np.ones(len(self.y)))
        self.tau2 = (0.5 * squares + 1 / aux) / self._gamma((1 + count) / 2)


# -- coordinates in which the model is nearly linear -----------------------------------------------


#: Step of second derivatives; Newton steps for an inverse, and its accuracy. Chosen: a step whose
#: inverse is not found is refused.
_STEP, _NEWTON, _CLOSE = 1e-3, 5, 1e-10


def curvature(g: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Second derivatives of g, from (n, p) to (n, m), at x (p,): (m, p, p)."""
    p, step = len(x), _STEP * np.eye(len(x))
    pairs = [(i, j) for i in range(p) for j in range(i, p)]
    points = [x + a * step[i] + b * step[j] for i, j in pairs for a in (1, -1) for b in (1, -1)]
    found = g(np.array(points)).reshape(len(pairs), 4, -1)
    second = np.empty((found.shape[2], p, p))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, found, strict=True):
        second[:, i, j] = second[:, j, i] = (pp - pm - mp + mm) / (4 * _STEP**2)
    return np.nan_to_num(second)


class Straight:
    """The coordinates, and steps in them.

    Args:
        centre: c, (p,).
        bend: A, symmetric in its last two indices, (p, p, p); zero for steps of x itself.
    """

    def __init__(self, centre: np.ndarray, bend: np.ndarray):
        self.centre, self.bend = np.asarray(centre), np.asarray(bend)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """u at x, (..., p)."""
        off = x - self.centre
        return off + 0.5 * np.einsum("pij,...i,...j->...p", self.bend, off, off)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of u, (..., p, p)."""
        return np.eye(len(self.centre)) + np.einsum("pij,...j->...pi", self.bend, x - self.centre)

    def moved(self, x: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a step of u leads.

        Args:
            x: From where, (..., p).
            step: Of u; broadcast with x.

        Returns:
            There, (..., p); ln of the determinant of the change of ``there`` by x, (...); and
            whether the step exists and the same step back returns to x, (...). Where it does not,
            x itself stands for the place.
        """
        there = self._solved(x, self(x) + step)
        back = self._solved(there, self(there) - step)
        size = np.abs(step).max(axis=-1) + 1e-300
        good = np.abs(self(there) - self(x) - step).max(axis=-1) < _CLOSE * (1 + size)
        good &= np.abs(back - x).max(axis=-1) < 1e-6 * (size + np.abs(x - self.centre).max(axis=-1))
        here, far = np.linalg.det(self.slope(x)), np.linalg.det(self.slope(there))
        good &= (here > 0) & (far > 0)
        ratio = np.where(good, here, 1.0) / np.where(good, far, 1.0)
        return np.where(good[..., None], there, x), np.log(ratio), good

    def _solved(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x with u(x) given, by Newton's method from an x."""
        for _ in range(_NEWTON):
            slope = self.slope(x)
            # A fold of the coordinates: kept away from it, and refused by who asked.
            flat = np.abs(np.linalg.det(slope)) < 1e-6
            slope = np.where(flat[..., None, None], np.eye(len(self.centre)), slope)
            x = x + np.linalg.solve(slope, (u - self(x))[..., None])[..., 0]
        return x
