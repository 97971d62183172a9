"""Steps of Markov chains: Metropolis-Hastings, and emcee's ensembles.

A `Walk` holds several chains and advances them together, since the model solves for many points at
a time; its state can be saved and restored. A chain depends on its number and the seed alone, not
on the other chains of its walk, so that chains may be spread over ranks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

#: Acceptance that the scale of the steps is led to, in a few dimensions (Roberts and Rosenthal,
#: Stat. Sci. 16, 2001).
_ACCEPT = 0.3
#: Share of steps as wide as the starts, which lead from one maximum to another; chosen.
_WIDE = 0.1
#: Steps of the burn-in between new covariances, and before the first one; chosen.
_RENEW, _FIRST = 100, 200


def generator(seed: int, chain: int) -> np.random.Generator:
    """Random numbers of one chain."""
    return np.random.default_rng(np.random.SeedSequence([seed, 2, chain]))


class Walk:
    """Chains, each with its own random numbers, whose state can be saved and restored.

    Args:
        rngs: One for each chain.

    Attributes:
        keys: Names of the arrays with a row for each chain that it goes on from.
    """

    keys: tuple[str, ...] = ("x", "lp")

    def __init__(self, rngs: Sequence[np.random.Generator]):
        self.rngs = list(rngs)

    def states(self) -> list[dict]:
        """The state of each chain, for JSON."""
        return [
            {"rng": rng.bit_generator.state}
            | {key: np.asarray(getattr(self, key)[i]).tolist() for key in self.keys}
            for i, rng in enumerate(self.rngs)
        ]

    def restore(self, states: Sequence[Mapping]) -> None:
        """Go on from what `states` returned."""
        for key in self.keys:
            setattr(self, key, np.array([state[key] for state in states], dtype=float))
        self.rngs = [np.random.default_rng() for _ in states]
        for rng, state in zip(self.rngs, states, strict=True):
            rng.bit_generator.state = state["rng"]


class RandomWalk(Walk):
    """Metropolis's steps about the last point; the steps' covariance is learnt in the burn-in.

    Learning stops with the burn-in (Haario, Saksman and Tamminen, Bernoulli 7, 2001), so that what
    is kept is a Markov chain.

    Args:
        log_density: From points (n, d) to (n,).
        points: Where the chains begin, (n_chains, d).
        covariance: A first guess of the posterior's, wider rather than narrower, (d, d).
        rngs: One for each chain.
        burn_in: Steps with learning.
        states: What earlier walks' `states` returned, to go on from; None to begin.
    """

    label = "Metropolis-Hastings, random walk"
    keys = ("x", "lp", "root", "mean", "moment", "log_scale")

    def __init__(
        self,
        log_density: Callable[[np.ndarray], np.ndarray],
        points: np.ndarray,
        covariance: np.ndarray,
        rngs: Sequence[np.random.Generator],
        burn_in: int,
        states: Sequence[Mapping] | None = None,
    ):
        super().__init__(rngs)
        self.log_density, self.burn_in = log_density, burn_in
        n, d = np.shape(points)
        self.wide = np.linalg.cholesky(covariance)
        if states is None:
            self.x = np.array(points, dtype=float)
            self.lp = log_density(self.x) if n else np.empty(0)
            self.root = np.repeat(self.wide[None], n, axis=0)
            self.mean, self.moment = self.x.copy(), np.zeros((n, d, d))
            self.log_scale, self.t = np.full(n, np.log(2.38 / np.sqrt(d))), 0
            return
        self.restore(states)
        self.t = int(states[0]["t"]) if len(states) else 0

    def states(self) -> list[dict]:
        """What each chain goes on from, for JSON."""
        return [state | {"t": self.t} for state in super().states()]

    def advance(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Move all chains.

        Returns:
            Points, (n_chains, n, d); their ln density, (n_chains, n); shares of accepted proposals,
            (n_chains,).
        """
        count, d = self.x.shape
        points, lps = np.empty((count, n, d)), np.empty((count, n))
        accepted = np.zeros(count)
        if not count:
            return points, lps, accepted
        steps = np.array([rng.standard_normal((n, d)) for rng in self.rngs])
        chances = np.array([rng.random((n, 2)) for rng in self.rngs])
        with np.errstate(divide="ignore"):
            logs = np.log(chances[:, :, 0])
        wide = chances[:, :, 1] < _WIDE
        for i in range(n):
            narrow = np.exp(self.log_scale)[:, None, None] * self.root
            root = np.where(wide[:, i, None, None], self.wide, narrow)
            proposed = self.x + np.einsum("cij,cj->ci", root, steps[:, i])
            lp = self.log_density(proposed)
            taken = logs[:, i] < lp - self.lp
            self.x = np.where(taken[:, None], proposed, self.x)
            self.lp = np.where(taken, lp, self.lp)
            if self.t < self.burn_in:
                self._learn(taken, wide[:, i])
            self.t += 1
            accepted += taken
            points[:, i], lps[:, i] = self.x, self.lp
        return points, lps, accepted / n

    def _learn(self, taken: np.ndarray, wide: np.ndarray) -> None:
        t, d = self.t, self.x.shape[1]
        rate = min(1.0, 5.0 / (t + 1) ** 0.6)
        self.log_scale += np.where(wide, 0.0, rate * (taken - _ACCEPT))
        # Early points are forgotten: the weight of a point is that of the last half of the steps.
        weight = 2.0 / (t + 2)
        off = self.x - self.mean
        self.mean = self.mean + weight * off
        self.moment = (1 - weight) * (self.moment + weight * off[:, :, None] * off[:, None, :])
        if t >= _FIRST and t % _RENEW == 0:
            spread = np.einsum("cii->c", self.moment) / d
            floor = 1e-10 * spread[:, None, None] * np.eye(d) + 1e-300 * np.eye(d)
            self.root = np.linalg.cholesky(self.moment + floor)


class Independence(Walk):
    """The paper's steps: every point is drawn from the prior, wherever the chain is.

    All proposals are known before the first step, so that the model solves for them together.

    Args:
        log_likelihood: From points (n, d) to (n,).
        draw: Gives n points of the prior, (n, d), from a generator.
        points: Where the chains begin, (n_chains, d).
        rngs: One for each chain.
        states: See `RandomWalk`.
    """

    label = "Metropolis-Hastings, proposals from the prior"

    def __init__(self, log_likelihood, draw, points, rngs, states=None):
        super().__init__(rngs)
        self.log_likelihood, self.draw = log_likelihood, draw
        if states is not None:
            self.restore(states)
            return
        self.x = np.array(points, dtype=float)
        self.lp = log_likelihood(self.x) if len(self.x) else np.empty(0)

    def advance(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `RandomWalk.advance`; the ln density is that of the likelihood alone."""
        count, d = self.x.shape
        points, lps = np.empty((count, n, d)), np.empty((count, n))
        accepted = np.zeros(count)
        for c, rng in enumerate(self.rngs):
            proposed = self.draw(n, rng)
            found = self.log_likelihood(proposed)
            with np.errstate(divide="ignore"):
                logs = np.log(rng.random(n))
            for i in range(n):
                if logs[i] < found[i] - self.lp[c]:
                    self.x[c], self.lp[c] = proposed[i], found[i]
                    accepted[c] += 1
                points[c, i], lps[c, i] = self.x[c], self.lp[c]
        return points, lps, accepted / n


class Ensembles:
    """Ensembles of walkers by emcee (Foreman-Mackey et al., PASP 125, 2013), with its moves of
    differential evolution: a third of the autocorrelation of the usual stretches.

    Each chain is an ensemble of its own.

    Args:
        log_density: From points (n, d) to (n,).
        points: Where the walkers begin, (n_chains, n_walkers, d).
        rngs: One for each chain.
        states: See `RandomWalk`.
    """

    label = "emcee, differential evolution of ensembles"

    def __init__(self, log_density, points, rngs, states=None):
        import emcee

        self.samplers, self.now = [], []
        for i, (start, rng) in enumerate(zip(points, rngs, strict=True)):
            moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
            sampler = emcee.EnsembleSampler(*start.shape, log_density, vectorize=True, moves=moves)
            if states is None:
                random = np.random.RandomState(rng.integers(2**32)).get_state()
                state = emcee.State(start, random_state=random)
            else:
                kind, keys, *rest = states[i]["rng"]
                random = (kind, np.array(keys, dtype=np.uint32), *rest)
                state = emcee.State(
                    np.array(states[i]["x"]), np.array(states[i]["lp"]), random_state=random
                )
            self.samplers.append(sampler)
            self.now.append(state)

    def states(self) -> list[dict]:
        """See `RandomWalk.states`."""
        return [
            {
                "x": state.coords.tolist(),
                "lp": np.asarray(state.log_prob).tolist(),
                "rng": [
                    state.random_state[0],
                    state.random_state[1].tolist(),
                    *state.random_state[2:],
                ],
            }
            for state in self.now
        ]

    def advance(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `RandomWalk.advance`; the walkers of all ensembles, one after the other."""
        points, lps, accepted = [], [], []
        for i, sampler in enumerate(self.samplers):
            sampler.reset()
            self.now[i] = sampler.run_mcmc(self.now[i], n, skip_initial_state_check=True)
            points.append(np.swapaxes(sampler.get_chain(), 0, 1))
            lps.append(sampler.get_log_prob().T)
            accepted.append(sampler.acceptance_fraction)
        if not points:
            return np.empty((0, n, 0)), np.empty((0, n)), np.empty(0)
        return np.concatenate(points), np.concatenate(lps), np.concatenate(accepted)
