"""How often a cause is taken for another one, by simulated tests.

A hole can look like a softer part, a cable like an added mass: then an effect of the library fits
although the cause is outside the library. How often that happens depends on the structure, the
sensors, the noise and the error of the model. So tests of the same layout are simulated, each with
one effect of the library as its cause, parameters by their priors, errors as stated. That effect is
then taken out of the library, with all others of its name or on the same part, joint or attachment.
The rate of misattribution is the probability that the remaining effects get together, alone or in
pairs, against the nominal model and an unknown cause. Many effects explain a small gap and few a
large one, so that the rate is a function of the gap (logistic in its logarithm).

Effects that are named wrongly fit worse than right causes, whose p-values are uniform. The density
of their p-values is taken to be a p^(a-1), with a from the simulated tests (Sellke, Bayarri and
Berger, The American Statistician 55, 2001).

With every effect in the library, the same tests give the confusion matrix of causes, and show how
many answers of 70 to 90 % probability are right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.special import expit, logit, logsumexp, softmax
from scipy.stats import chi2
from sklearn.linear_model import LogisticRegression

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.cells import STEEPEST
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.linear import log_constant, marginal, whiten
from fenics_joints.diagnosis.evidence.localised_unknown import unknown_evidence
from fenics_joints.diagnosis.thresholds import MISFIT
from fenics_joints.parallel import spread

#: Simulated tests; effects of each that are solved for, and Gauss-Newton steps of these.
#: [numerical: the rate to 0.05]
_TESTS, _RIVALS, _STEPS = 100, 3, 2
#: The least exponent, for p-values of a few tests may all be small; the least gap, in nats.
#: [numerical: chosen]
_LEAST, _LEAST_GAP = 0.1, 1.0
#: Probability of some effect, against none, below which a simulated test shows no gap and does not
#: count. [numerical: the rate to 1e-3]
_NOT_SEEN = 1e-3
#: Simulated tests of each cause for the confusion matrix, and of all causes for the count of right
#: answers. [numerical: a share to 0.08]
_EACH, _COUNTED = 40, 300
#: Probabilities of the answers that are counted. [decision: convention: about 80 %]
SAID = (0.7, 0.9)


@dataclass(frozen=True)
class Misattribution:
    """How often causes outside the library are taken for effects of it, by simulated tests.

    Attributes:
        rate: Share of the simulated tests whose cause, taken out of the library, is taken for
            other effects.
        intercept: Of the log odds of that, at a gap of 1 nat.
        slope: Of these by ln of the gap, in nats of ln evidence.
        largest: ln of the largest gap of a simulated test.
        exponent: That of the density of p-values of what is named, 0 to 1.
        tests: Number of simulated tests that were looked at.
        prior: Probability of a cause outside the library, before the test.
        answers: Number of answers given as `SAID`, with the cause in the library.
        right: How many of these were right.
    """

    rate: float
    intercept: float
    slope: float
    largest: float
    exponent: float
    tests: int
    prior: float
    answers: int = 0
    right: int = 0

    @classmethod
    def of(
        cls, gap: np.ndarray, named: np.ndarray, log_p: np.ndarray, other: np.ndarray, prior: float
    ) -> Misattribution:
        """From simulated tests whose cause was taken out of the library.

        Args:
            gap: ln of the evidence of the best effect over that of the nominal model, (n,).
            named: How often effects are named in its place: a number of tests, (n,).
            log_p: ln of the p-value of these, times that number, (n,).
            other: How often none is, (n,).
            prior: Probability of a cause outside the library, before the test.
        """
        x = np.log(np.maximum(gap, _LEAST_GAP))
        rate = (named.sum() + 0.5) / (named.sum() + other.sum() + 1)
        intercept, slope = float(logit(rate)), 0.0
        if named.sum() > 0 and other.sum() > 0:
            label = np.repeat([1, 0], len(x))
            by_gap = LogisticRegression(tol=1e-8).fit(
                np.tile(x, 2)[:, None], label, sample_weight=np.concatenate([named, other])
            )
            intercept, slope = float(by_gap.intercept_[0]), float(by_gap.coef_[0, 0])
        exponent = (named.sum() + 1) / (1 - log_p.sum())
        return cls(
            float(rate),
            intercept,
            slope,
            float(x.max(initial=0.0)),
            float(np.clip(exponent, _LEAST, 1.0)),
            len(x),
            prior,
        )

    def rate_at(self, gap: float) -> float:
        """Probability that a cause outside the library is taken for effects of it.

        Args:
            gap: ln of the evidence of these over that of the nominal model.
        """
        x = min(np.log(max(gap, _LEAST_GAP)), self.largest)
        return float(expit(self.intercept + self.slope * x))

    def outside(self, gap: float, p_value: float) -> float:
        """Probability that the cause is outside the library although effects of it are named.

        Args:
            gap: See `rate_at`.
            p_value: Of what is named, see `Fit.p_value`.
        """
        p = min(max(p_value, 1e-300), 1.0)
        density = np.log(self.exponent) + (self.exponent - 1) * np.log(p)
        return float(expit(logit(self.prior) + np.log(self.rate_at(gap)) + density))


class _Point(NamedTuple):
    """The most probable point of an effect's cell, about which the prediction is linear.

    Attributes:
        log_evidence: ln of the cell's evidence times `prior`, but for the data's constant.
        square: Squared whitened residual and distance from the prior.
        prior: ln of the cell's share of the prior times the effect's odds.
        effect: Which of the effects.
        residual: Prediction less data at the cell's mean, whitened, (k, 1); None without a point.
        slope: Derivatives by the parameters, whitened and by their prior widths, (k, p).
    """

    log_evidence: float = -np.inf
    square: float = np.inf
    prior: float = -np.inf
    effect: int = -1
    residual: np.ndarray | None = None
    slope: np.ndarray | None = None


class _Cells:
    """Cells of effects' priors, whitened, each linear in its effect's own parameters.

    Args:
        effect: Which effect a cell is of, (n,).
        away: Predictions at the means of the cells less the nominal model's, (n, k).
        own: Derivatives by the own parameters in standard deviations of the cells, (n, k, d).
        log_share: ln of the shares of the cells; -inf where the model lacks modes, (n,).
    """

    def __init__(self, effect, away: np.ndarray, own: np.ndarray, log_share: np.ndarray):
        self.effect, self.away, self.own, self.log_share = effect, away, own, log_share
        transposed = own.transpose(0, 2, 1)
        self._inner = transposed @ own
        self._pull = transposed @ away[:, :, None]
        self._square = np.sum(away**2, axis=1)
        n, k, d = own.shape
        self._flat = own.transpose(1, 0, 2).reshape(k, n * d)

    @classmethod
    def joined(cls, effects: Sequence[_WhitenedEffect]) -> _Cells:
        """Those of effects that have equally many parameters."""
        names = "effect", "away", "own", "log_share"
        return cls(*(np.concatenate([getattr(e.cells, name) for e in effects]) for name in names))

    def beside(self, residual: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln of the evidence of each cell together with a linear prediction, but for the data's
        constant, and the least |r|^2 + |u|^2, for each of t tests: (n, t) each.

        Args:
            residual: That prediction less the tests' data, whitened, (k, t).
            slope: Its derivatives by its parameters, (k, p).
        """
        n, _, d = self.own.shape
        hessian = slope.T @ slope + np.eye(slope.shape[1])
        down = whiten(np.linalg.cholesky(hessian), slope.T)
        low, low_away = down @ residual, self.away @ down.T
        low_own = (down @ self._flat).reshape(len(down), n, d).transpose(1, 2, 0)
        pull = (self._flat.T @ residual).reshape(n, d, low.shape[1]) + self._pull
        pull -= low_own @ (low + low_away[:, :, None])
        # One is added last, so that it hides what a difference of large numbers loses.
        inner = self._inner - low_own @ low_own.transpose(0, 2, 1) + np.eye(d)
        square = np.sum(residual**2, axis=0) - np.sum(low**2, axis=0)
        square = square + 2 * (self.away @ residual - low_away @ low)
        square += (self._square - np.sum(low_away**2, axis=1))[:, None]
        square -= np.sum(pull * np.linalg.solve(inner, pull), axis=1)
        constant = self.log_share - 0.5 * np.linalg.slogdet(inner)[1]
        constant -= 0.5 * np.linalg.slogdet(hessian)[1]
        return constant[:, None] - 0.5 * square, square


class _WhitenedEffect:
    """An effect's cells, with all parameters but its own linear about their medians.

    Attributes:
        hypothesis: That of the effect.
        free: Which of its parameters are not the effect's own.
        nuisances: Derivatives by these, whitened, (k, p).
        cells: The cells.
    """

    def __init__(self, number: int, effect: Effect, library: Library, test: Evidence):
        states, used, lower = library.states(effect), test.fitted, test.lower()
        self.number, self.hypothesis = number, library.make((effect,))
        self.free = np.ones(len(self.hypothesis.priors), dtype=bool)
        self.free[self.hypothesis.own] = False
        self.mean = states.mean
        self.width = np.broadcast_to(states.width, states.mean.shape)
        own = states.slopes[:, used] * self.width[:, None]
        n, k, d = own.shape
        away = states.data[:, used] - library.nominal[used]
        nuisances = states.others[used][:, self.free]
        there = np.isfinite(away).all(1) & np.isfinite(own).all((1, 2))
        flat = np.column_stack([nuisances, away.T, own.transpose(1, 0, 2).reshape(k, n * d)])
        white = whiten(lower, np.nan_to_num(flat))
        first = nuisances.shape[1]
        self.nuisances, away, own = np.split(white, [first, first + n], axis=1)
        own = own.reshape(k, n, d).transpose(1, 0, 2)
        there &= np.all(np.abs(own) < STEEPEST, axis=(1, 2))
        own = np.where(there[:, None, None], own, 0.0)
        log_share = np.where(there, states.log_share, -np.inf)
        self.cells = _Cells(np.full(n, number), away.T, own, log_share)

    def reconverged(
        self,
        library: Library,
        test: Evidence,
        cell: np.ndarray,
        residual: np.ndarray,
        data: np.ndarray,
        log_odds: float,
    ) -> list[_Point]:
        """Most probable points of cells, each in a test of its own, by Gauss-Newton steps.

        Args:
            library: Predicts.
            test: Has the metric.
            cell: Which cells, (n,).
            residual: Of the nominal model, whitened, (k, n).
            data: The tests' data, (n, k).
            log_odds: ln of its prior odds.
        """
        prior = self.cells.log_share[cell] + log_odds
        h, lower, used = self.hypothesis, test.lower(), test.fitted
        n, k, p = len(cell), len(lower), len(h.priors)
        mean, width = np.zeros((n, p)), np.ones((n, p))
        mean[:, h.own], width[:, h.own] = self.mean[cell], self.width[cell]
        r, slope = residual.T + self.cells.away[cell], np.zeros((n, k, p))
        slope[:, :, self.free], slope[:, :, h.own] = self.nuisances, self.cells.own[cell]
        u, best = np.zeros((n, p)), [_Point()] * n
        for _ in range(_STEPS):
            transposed = slope.transpose(0, 2, 1)
            pull = (transposed @ r[:, :, None])[:, :, 0] + u
            step = np.linalg.solve(transposed @ slope + np.eye(p), pull[:, :, None])[:, :, 0]
            z = (mean + width * (u - step)).clip(*h.limits.T)
            u = (z - mean) / np.where(width > 0, width, 1.0)
            found, slopes = library.predict(h, z, range(p))
            r = whiten(lower, (found[:, used] - data).T).T
            flat = slopes[:, used].transpose(1, 0, 2).reshape(k, n * p)
            slope = whiten(lower, flat).reshape(k, n, p).transpose(1, 0, 2) * width[:, None]
            for i in np.flatnonzero(np.isfinite(r).all(1) & np.isfinite(slope).all((1, 2))):
                log_det = np.linalg.slogdet(slope[i].T @ slope[i] + np.eye(p))[1]
                value = prior[i] - 0.5 * (r[i] @ r[i] + u[i] @ u[i] + log_det)
                if value > best[i].log_evidence:
                    square, at_mean = float(r[i] @ r[i] + z[i] @ z[i]), r[i] - slope[i] @ u[i]
                    best[i] = _Point(
                        value, square, prior[i], self.number, at_mean[:, None], slope[i]
                    )
            r, slope = np.nan_to_num(r), np.nan_to_num(slope)
        return best


def simulate(
    library: Library,
    effects: Sequence[Effect],
    log_odds: Mapping[str, float],
    prior: float,
    log_unknown: float,
    test: Evidence,
    comm: MPI.Intracomm = MPI.COMM_SELF,
) -> Misattribution:
    """How often a cause outside the library is taken for effects of the library. Collective.

    Args:
        library: Has the states of the effects.
        effects: All that are weighed.
        log_odds: ln of their prior odds against none, by key.
        prior: Probability of a cause outside the library, before the test.
        log_unknown: ln of the prior odds of an unknown cause against none.
        test: The test.
        comm: Ranks that share the solutions out.
    """
    changed = {e.key: _changed(e, library, test) for e in effects}
    acting = [i for i, e in enumerate(effects) if changed[e.key]]
    odds = np.array([log_odds[e.key] for e in effects])
    rng = np.random.default_rng(0)

    def drawn_tests(n: int) -> tuple[np.ndarray, np.ndarray]:
        counts = rng.multinomial(n, softmax(odds[acting])) if acting else []
        return _tests([effects[i] for i in acting], counts, library, test, rng)

    # Ranks of other processors, whose round-off differs, need the same tests.
    data, drawn = comm.bcast(drawn_tests(_TESTS))
    cause, count = [effects[acting[i]] for i in drawn], len(data)
    own = [_WhitenedEffect(i, e, library, test) for i, e in enumerate(effects)]
    scored = comm.bcast(_scored(library, own, odds, log_unknown, data, test))
    residual, score, leading, none, unknown = scored
    rest, k = np.logaddexp(none, unknown), len(residual)
    # As the gap of a real test is: by the best hypothesis' evidence, without its odds.
    gap = np.max(score - odds[:, None], axis=0, initial=-np.inf) - none
    visible = expit(logsumexp(score, axis=0) - none) if own else np.zeros(count)
    others = np.array(
        [
            [e.name != c.name and not changed[e.key] & changed[c.key] for c in cause]
            for e in effects
        ],
        dtype=bool,
    ).reshape(score.shape)
    seen = visible > _NOT_SEEN
    others &= seen
    near = np.argsort(np.where(others, -score, np.inf), axis=0, kind="stable")[:_RIVALS]
    points: list[list[_Point]] = [[] for _ in range(count)]
    rivals = [(i, np.flatnonzero(np.any(near == i, axis=0) & others[i])) for i in np.unique(near)]
    rivals = [(i, tests) for i, tests in rivals if len(tests)]

    def reconverged(rival: tuple[int, np.ndarray]) -> list[_Point]:
        i, tests = rival
        return own[i].reconverged(
            library, test, leading[i, tests], residual[:, tests], data[tests], odds[i]
        )

    for (_, tests), found in zip(rivals, library.shared(comm, rivals, reconverged), strict=True):
        for t, point in zip(tests, found, strict=True):
            points[t].append(point)

    by_size: dict[int, list[_WhitenedEffect]] = {}
    for each in own:
        by_size.setdefault(each.cells.own.shape[2], []).append(each)
    stacks = [_Cells.joined(by_size[size]) for size in sorted(by_size)]
    families = [e.family or e.key for e in effects]
    together = np.array([[a != b for b in families] for a in families], dtype=bool)

    def explanations(t) -> np.ndarray:
        """ln of the evidence times odds of each effect and of each two, the first solved for and
        the second by algebra, and their least |r|^2 + |u|^2: (2, n)."""
        found = [np.array([[p.log_evidence, p.square] for p in points[t]]).reshape(-1, 2).T]
        for first in points[t]:
            allowed = others[:, t] & together[first.effect]
            for stack in stacks if first.residual is not None else ():
                value, square = (x[:, 0] for x in stack.beside(first.residual, first.slope))
                value += first.prior + odds[stack.effect]
                found.append(np.array([value, square])[:, allowed[stack.effect]])
        return np.concatenate(found, axis=1)

    # Probabilities and not counts, so that no digit of a solver moves the rate by a whole test.
    named, log_p = np.zeros(count), np.zeros(count)
    tests = np.flatnonzero(np.any(others, axis=0))
    for t, (log_evidence, square) in zip(tests, spread(comm, tests, explanations), strict=True):
        p = np.maximum(chi2.sf(square, k), 1e-300)
        share = np.exp(log_evidence - np.logaddexp(logsumexp(log_evidence), rest[t]))
        share *= visible[t] * p / (p + MISFIT)
        named[t], log_p[t] = share.sum(), share @ np.log(p)
    found = Misattribution.of(gap[seen], named[seen], log_p[seen], (visible - named)[seen], prior)
    data, drawn = drawn_tests(_COUNTED)
    acted = [own[i] for i in acting]
    score = _scored(library, acted, odds[acting], log_unknown, data, test)[1]
    count, right = answers(score, drawn)
    return comm.bcast(replace(found, answers=count, right=right))


def confusion_matrix(
    library: Library,
    effects: Sequence[Effect],
    log_odds: Mapping[str, float],
    log_unknown: float,
    test: Evidence,
) -> np.ndarray:
    """What each effect is taken for, if it is the cause: mean probabilities, (n, n + 2).

    Args:
        library: Has the states of the effects.
        effects: All that are weighed, n of them.
        log_odds: ln of their prior odds against none, by key.
        log_unknown: ln of the prior odds of an unknown cause against none.
        test: The test's layout and errors.

    Returns:
        A row for the effect at work; the last two columns are "no gap" and an unknown cause. nan
        where the model lacks modes at all simulated sizes.
    """
    counts, rng = [_EACH] * len(effects), np.random.default_rng(0)
    data, cause = _tests(effects, counts, library, test, rng)
    own = [_WhitenedEffect(i, e, library, test) for i, e in enumerate(effects)]
    odds = np.array([log_odds[e.key] for e in effects])
    _, score, _, none, unknown = _scored(library, own, odds, log_unknown, data, test)
    p = softmax(np.vstack([score, none, unknown]), axis=0)
    return np.array(
        [
            p[:, cause == i].mean(axis=1) if np.any(cause == i) else np.full(len(p), np.nan)
            for i in range(len(effects))
        ]
    ).reshape(len(effects), len(effects) + 2)


def _scored(
    library: Library,
    effects: Sequence[_WhitenedEffect],
    odds: np.ndarray,
    log_unknown: float,
    data: np.ndarray,
    test: Evidence,
) -> tuple[np.ndarray, ...]:
    """Evidence of what may explain simulated tests, but for the constant that all have in common.

    Returns:
        The nominal model less the data, whitened, (k, t); ln of the evidence of each effect times
        its odds, (n, t); which of its cells has most of that, (n, t); ln of the evidence of the
        nominal model, (t,), and of an unknown cause, times its odds, (t,).
    """
    lower, used, count = test.lower(), test.fitted, len(data)
    nominal, slope = library.nothing
    white = whiten(lower, np.column_stack([nominal[used, None] - data.T, slope[used]]))
    residual = white[:, :count]
    unknown = log_unknown + unknown_evidence(nominal[used], slope[used], data, test)
    unknown += log_constant(lower)
    score, leading = np.full((len(effects), count), -np.inf), np.zeros((len(effects), count), int)
    for i, each in enumerate(effects):
        value = each.cells.beside(residual, each.nuisances)[0]
        score[i], leading[i] = odds[i] + logsumexp(value, axis=0), np.argmax(value, axis=0)
    return residual, score, leading, marginal(residual, white[:, count:]), unknown


def answers(score: np.ndarray, cause: np.ndarray) -> tuple[int, int]:
    """How many effects are given `SAID` of probability in tests, and how often it is the cause.

    Args:
        score: ln of the evidence times the odds of each effect, (n, t).
        cause: Which of them is at work, (t,).
    """
    if not score.size:
        return 0, 0
    p, (low, high) = softmax(score, axis=0), SAID
    effect, test = np.nonzero((p >= low) & (p <= high))
    return len(effect), int(np.sum(cause[test] == effect))


def _changed(effect: Effect, library: Library, test: Evidence) -> set[str]:
    """Parts, joints and attachments that an effect acts on."""
    names = effect.touches(library.baseline, test.conditions)
    return {name.partition(".")[0] for name in names}


def _tests(
    effects: Sequence[Effect],
    counts: Sequence[int],
    library: Library,
    test: Evidence,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Simulated data of the entries that are fitted, (t, k), and which effect made each, (t,)."""
    used, lower = test.fitted, test.lower()
    data, cause = [np.zeros((0, len(lower)))], [np.zeros(0, dtype=int)]
    for i, n in enumerate(counts):
        if n:
            h = library.make((effects[i],))
            z = rng.standard_normal((n, len(h.priors))).clip(*h.limits.T)
            found = library.predict(h, z)[0][:, used]
            data.append(found[np.isfinite(found).all(1)])
            cause.append(np.full(len(data[-1]), i))
    found = np.concatenate(data)
    noise = (lower @ rng.standard_normal(found.T.shape)).T
    return found + noise, np.concatenate(cause)
