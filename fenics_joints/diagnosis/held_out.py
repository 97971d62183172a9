"""Holds data out, chooses and fits without them, and measures how far the gap shrinks on them.

For each fold a forecast is stated before its data are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis.evidence.entries import DAMPING, FREQUENCY
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Found, Library
from fenics_joints.diagnosis.evidence.linear import LinearFit
from fenics_joints.diagnosis.evidence.linear_fits import moved, near_listed
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.shrinkage import Fold, Forecast, Interval, Shrinkage, shrink
from fenics_joints.diagnosis.thresholds import INTERVAL

#: Number of modes that the stated error of a model counts for, beside the fitted ones. [decision:
#: chosen]
_KNOWN = 1.0
#: Largest factor on the stated error of a model. [decision: chosen]
_MOST = 2.0


def predictive(
    refit: Fit, blind: Evidence, scored: np.ndarray, *, mended: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the scored entries given the fitted ones.

    With r = data - prediction of the fitted entries, G = S_sf S_ff^-1 and S the covariance of
    noise and discrepancy, the scored entries are prediction_s + G r + (J_s - G J_f) dz + e,
    dz ~ N(0, C) the posterior and e ~ N(0, S_ss - G S_fs): Gaussian regression about the model.

    Args:
        refit: A hypothesis fitted without the held-out data.
        blind: The test without them.
        scored: Which entries, shape (N,).
        mended: Whether the prediction is mended by what it leaves on the fitted entries; if not,
            G = 0, and a hypothesis that is off by much at all levels is off at those held out.
    """
    fitted = blind.fitted
    # The stated error of a model has to hold for held-out data, however little of it the fitted
    # data need.
    test = blind.at(refit.scales) if blind.drifts else blind
    total = test.full_covariance(refit.hypothesis.unknown)
    cross = total[np.ix_(scored, fitted)] * float(mended)
    gained = np.linalg.solve(total[np.ix_(fitted, fitted)], cross.T).T
    mean = refit.predicted[scored] + gained @ (blind.data[fitted] - refit.predicted[fitted])
    slope = refit.jacobian[scored] - gained @ refit.jacobian[fitted]
    covariance = total[np.ix_(scored, scored)] - gained @ cross.T
    covariance = covariance + slope @ refit.covariance @ slope.T
    return mean, 0.5 * (covariance + covariance.T)


def draws(
    refit: Fit, blind: Evidence, scored: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Values of the scored entries, drawn from what a hypothesis predicts, (count, k).

    As by `predictive`, but with the errors of the model and of its parameters scaled by what the
    fitted frequencies have of them (`share_of_stated`).

    Args:
        refit: See `predictive`.
        blind: Likewise.
        scored: Likewise.
        count: Number of draws.
        rng: Random numbers.
    """
    mean, covariance = predictive(refit, blind, scored)
    sd = np.nan_to_num(blind.noise_sd()[scored])
    values, vectors = np.linalg.eigh(covariance - np.diag(sd**2))
    rest = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = rng.standard_normal((2, count, len(mean)))
    error, e = normal[0] @ rest.T, blind.entries
    _, at = np.unique(e.mode[scored], return_inverse=True)
    common = (at[:, None] == at) / np.bincount(at)[at]
    # A mode that was fitted at other conditions errs only by what changes between conditions.
    common[np.isin(e.mode[scored], e.mode[blind.fitted & (e.kind == FREQUENCY)])] = 0.0
    shared = error @ common.T
    for part, between in ((shared, False), (error - shared, True)):
        square, known = share_of_stated(refit, blind, between)
        share = square * known / rng.chisquare(known, (count, 1)) if np.isfinite(known) else 1.0
        mean = mean + np.minimum(np.sqrt(share), _MOST) * part
    return mean + normal[1] * sd


def share_of_stated(refit: Fit, blind: Evidence, between: bool = False) -> tuple[float, float]:
    """Mean square of the fitted frequencies' residuals over their stated variance, and its degrees
    of freedom.

    One factor for all modes has an inverse chi-square prior about 1. It is of the modes' means over
    the conditions, or of what changes between these. It stays 1 for an unknown cause, and for tests
    by level, whose errors have scales of their own.

    Args:
        refit: The hypothesis fitted to a part of the test.
        blind: That part.
        between: Which of the two.
    """
    e = blind.entries
    used = np.flatnonzero(blind.fitted & (e.kind == FREQUENCY))
    if refit.hypothesis.unknown or blind.drifts:
        return 1.0, np.inf
    take = _over_conditions(e.mode[used], between)
    own = refit.hypothesis.own
    others = np.delete(np.arange(len(refit.z)), own)
    slope = refit.jacobian[np.ix_(used, others)]
    residual = take @ (blind.data[used] - refit.predicted[used] + slope @ refit.z[others])
    total = blind.full_covariance()[np.ix_(used, used)] + slope @ slope.T
    square = residual @ np.linalg.solve(take @ total @ take.T, residual)
    # Each of the effects' parameters may have taken one off.
    known = _KNOWN + max(len(take) - (own.stop - own.start), 0)
    return float((_KNOWN + square) / known), float(known)


def _over_conditions(modes: np.ndarray, between: bool) -> np.ndarray:
    """Matrix from entries, each of a mode, (n,), to the mean of every mode, (m, n); or to the
    difference from it of all but the first of a mode, (n - m, n)."""
    _, first, at = np.unique(modes, return_index=True, return_inverse=True)
    mean = (at == np.arange(len(first))[:, None]) / np.bincount(at)[:, None]
    return np.delete(np.eye(len(at)) - mean[at], first, axis=0) if between else mean


def held(evidence: Evidence, mask: np.ndarray, kinds: Sequence[int]) -> np.ndarray:
    """The held-out entries of some kinds that were measured, as a mask of shape (N,)."""
    e = evidence.entries
    there = (mask & evidence.used)[e.row, e.mode] & np.isfinite(evidence.data)
    return there & np.isin(e.kind, kinds)


def gains(
    causes: Mapping[str, Callable[[Fit], bool]],
    refits: Sequence[Fit],
    score: np.ndarray,
    blind: Evidence,
    data: np.ndarray,
    scored: np.ndarray,
) -> dict[str, float]:
    """ln of how much more probable held-out data are with each cause than without it, by its name.

    Both sides are mixtures of hypotheses, weighed without the data: those that hold the cause and
    those that do not, an unknown cause in neither. Residuals of the fitted data do not correct the
    predictions here. nan if one side has no hypotheses.

    Args:
        causes: Whether a hypothesis holds a cause, by the cause's name.
        refits: Hypotheses fitted without the held-out data.
        score: ln of their evidence and prior odds, (len(refits),).
        blind: The test without the held-out values.
        data: All of the test, shape (N,).
        scored: The held-out entries, shape (N,).
    """
    listed = [i for i, f in enumerate(refits) if causes and not f.hypothesis.unknown]
    logs = np.full(len(refits), -np.inf)
    for i in listed:
        mean, covariance = predictive(refits[i], blind, scored, mended=False)
        logs[i] = multivariate_normal.logpdf(data[scored], mean, covariance, allow_singular=True)
    found = dict.fromkeys(causes, float("nan"))
    for name, holds in causes.items():
        sides = [[i for i in listed if bool(holds(refits[i])) is side] for side in (True, False)]
        if all(sides):
            own, other = (logsumexp(score[i] - logsumexp(score[i]) + logs[i]) for i in sides)
            found[name] = float(own - other)
    return found


#: Least excess of S* over that of the best wrong effect, half of the last digit that is printed.
#: [decision: rounding]
_SHOWS = 0.005
#: Draws of a forecast, and of a bootstrap. [numerical: chosen]
_DRAWS = 2000
#: Seed of the random numbers. [numerical: any]
_SEED = 1
#: Nats behind the best of a fold up to which hypotheses are fitted anew without its data, and their
#: number at most. [numerical: chosen for time]
_HOPELESS, _FAIR = 6.0, 4
#: With this many modes or more the highest third of them is held out together. [decision: chosen]
_BAND = 4
#: Blocks in which conditions are held out, at most. [decision: chosen]
_BLOCKS = 3


def folds(
    conditions: np.ndarray,
    mode_names: Sequence[str],
    condition: tuple[str, str],
    measured: np.ndarray | None = None,
    names: Sequence[str] = (),
) -> list[tuple[str, np.ndarray]]:
    """Masks (n, m) of what to hold out: each mode in turn, the highest third of the modes together
    if there are four or more, and the conditions in blocks.

    Blocks are neighbours in the condition, so that the outer ones ask for extrapolation, as the
    top band does. They are of modes at several conditions: of ``measured``, (n, m), those with one
    are held out by mode alone. Rows that have a name of their own in ``names``, (n,), after a known
    change, are held out one by one, each with the others of its condition in.
    """
    n, m = len(conditions), len(mode_names)
    found = []
    if m > 1:
        for j, name in enumerate(mode_names):
            found.append((name if name.startswith("mode") else f"mode {name}", _columns(n, m, [j])))
    if m >= _BAND:
        top = range(m - int(np.ceil(m / 3)), m)
        name = f"top band, {mode_names[top[0]]} to {mode_names[-1]}"
        found.append((name, _columns(n, m, top)))
    there = np.ones((n, m), dtype=bool) if measured is None else np.asarray(measured, dtype=bool)
    several = there.sum(axis=0) > 1
    if not several.any():
        several[:] = True  # no mode has a trend
    named = np.array([bool(name) for name in names] or [False] * n)
    rows = np.flatnonzero(there[:, several].any(axis=1) & ~named)
    if len(rows) > 1:
        for block in np.array_split(rows, min(_BLOCKS, len(rows))):
            mask = np.zeros((n, m), dtype=bool)
            mask[np.ix_(block, several)] = True
            low, high = conditions[block[0]], conditions[block[-1]]
            span = f"{low:g}" if low == high else f"{low:g} to {high:g}"
            found.append((f"{condition[0]} {span} {condition[1]}".strip(), mask))
    for i in np.flatnonzero(named):
        found.append((names[i], (np.arange(n) == i)[:, None] & there))
    return found


def _columns(n, m, columns) -> np.ndarray:
    return np.tile(np.isin(np.arange(m), list(columns)), (n, 1))


def blinded(evidence: Evidence, held_out: np.ndarray) -> Evidence:
    """A test without the held-out values.

    Args:
        evidence: The test.
        held_out: Mask, shape (n, m); a mode's damping goes with its frequency, and its shape with
            that at the condition at which it was measured.
    """
    hidden = evidence.without(held_out)
    new = {"log_f": np.where(held_out, np.nan, evidence.log_f)}
    if evidence.log_damping is not None:
        new["log_damping"] = np.where(held_out, np.nan, evidence.log_damping)
    if evidence.shapes is not None:
        new["shapes"] = np.where(held_out[evidence.shape_row], np.nan, evidence.shapes)
    return replace(hidden, **new)


# -- before the data are looked at -----------------------------------------------------------------


def forecast(
    refits: Sequence[Fit],
    weights: np.ndarray,
    chosen: Fit,
    nominal: np.ndarray,
    blind: Evidence,
    scored: np.ndarray,
    noise: float,
    *,
    count: int = _DRAWS,
) -> Forecast:
    """How far the gap will shrink on held-out frequencies, stated without them.

    They are drawn from the mixture of the hypotheses' predictive distributions, and the nominal
    model and the chosen one are scored on the draws as they will be on the data.

    Args:
        refits: Hypotheses fitted without the held-out data.
        weights: Their probabilities.
        chosen: The one whose prediction will be scored.
        nominal: ln f of the nominal model at the scored entries, shape (k,); nan where it has none.
        blind: The test without the held-out values, from `blinded`.
        scored: Which entries will be scored, shape (N,); k of them.
        noise: E_noise of the fold.
        count: Number of draws.
    """
    rng = np.random.default_rng(_SEED)
    parts = []
    for refit, own in zip(refits, rng.multinomial(count, weights / np.sum(weights)), strict=True):
        if own:
            parts.append(draws(refit, blind, scored, own, rng))
    drawn = np.concatenate(parts)
    after = np.sqrt(np.mean(np.expm1(chosen.predicted[scored] - drawn) ** 2, axis=1))
    there = np.isfinite(nominal)
    before = (
        np.sqrt(np.mean(np.expm1(nominal - drawn)[:, there] ** 2, axis=1))
        if there.any()
        else np.nan
    )
    gained = shrink(before, after, noise)
    low, high = np.quantile(drawn, _ends(), axis=0)
    shares = {f.hypothesis.label: float(w) for f, w in zip(refits, weights, strict=True)}
    return Forecast(_interval(after), _interval(gained), low, high, shares)


def _noise_variance(chosen: Fit, evidence: Evidence, scored: np.ndarray) -> np.ndarray:
    """Least variance of each scored ln f, for any model, shape (k,).

    That of the measurement, and of the tightenings' scatter as far as the fit leaves it open: all
    of it at a torque that is held out.
    """
    e = evidence.entries
    variance = evidence.log_sd[e.row[scored], e.mode[scored]] ** 2
    place = chosen.hypothesis.places["tightenings"]
    slope = chosen.jacobian[scored, place]
    return variance + np.einsum("ij,jk,ik->i", slope, chosen.covariance[place, place], slope)


# -- choosing, fitting, opening --------------------------------------------------------------------


def _sums(squares: np.ndarray, rng=None, count: int = 1) -> np.ndarray:
    """Sums of squares over a fold's entries, and numbers of those that have one, (2, 4); or
    likewise over entries drawn with replacement, (2, count, 4).

    Args:
        squares: Of a fold's scored entries, (4, k): of relative errors of the nominal model, nan
            where it has no such mode, of the choice and of the placebo, and of the noise.
        rng: Draws the entries; None for all of them.
        count: Number of draws.
    """
    n = squares.shape[1]
    drawn = squares if rng is None else squares[:, rng.integers(n, size=(count, n))]
    return np.array([np.nansum(drawn, axis=-1).T, np.isfinite(drawn).sum(axis=-1).T])


def _sizes(sums: np.ndarray) -> tuple[np.ndarray, ...]:
    """E of the nominal model, the choice, the placebo and noise, from (2, ..., 4): that of the
    nominal model over the modes that it has, nan if it has none."""
    mean = np.divide(sums[0], sums[1], out=np.full(sums[0].shape, np.nan), where=sums[1] > 0)
    return tuple(np.moveaxis(np.sqrt(mean), -1, 0))


def _shrinks(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """S*, the placebo's, and the excess."""
    before, after, placebo, noise = _sizes(sums)
    own, wrong = shrink(before, after, noise), shrink(before, placebo, noise)
    return own, wrong, own - wrong


def cross_validate(
    candidates: Sequence[Fit],
    log_prior: Sequence[float],
    is_wrong: Callable[[Fit], bool],
    library: Library,
    masks: Sequence[tuple[str, np.ndarray]],
    *,
    causes: Mapping[str, Callable[[Fit], bool]] | None = None,
    always: Sequence[Fit] | None = None,
    not_nominal: np.ndarray | None = None,
    comm: MPI.Intracomm = MPI.COMM_SELF,
    progress: Callable[[], None] | None = None,
) -> Shrinkage:
    """Choose and fit anew without each fold, state what it will show, and open it.

    Args:
        candidates: Hypotheses, fitted to all data (their parameters are starting points only). One
            of an unknown cause is never chosen, having no prediction of its own, but widens the
            stated intervals by its weight.
        log_prior: ln of their prior probabilities.
        is_wrong: Whether a hypothesis counts as placebo.
        library: The library, of the whole test.
        masks: From `folds`.
        causes: Whether a hypothesis holds a cause, by the cause's name: of each is said what it
            gains on the held-out data (`Shrinkage.gains`).
        always: Those that are fitted anew in every fold, beside the best of each; all for None.
        not_nominal: Mask of the modes without a partner in the nominal model, (m,): held out like
            others, but without a part in its error; None for none.
        comm: Communicator whose ranks share out the folds; the call is collective.
        progress: Called after each fold.
    """
    evidence = library.evidence
    nominal = _nominal(library.forward, evidence, library.baseline)
    if not_nominal is not None:
        nominal = np.where(not_nominal[evidence.entries.mode], np.nan, nominal)
    causes = causes or {}

    def work(fold):
        name, mask = fold
        scored = held(evidence, mask, (FREQUENCY,))
        blind = blinded(evidence, mask)
        found = None
        if scored.any() and blind.used.any():
            known: dict[str, Found] = {}
            near = _near(candidates, log_prior, blind, always)
            refits = [
                moved(candidates[i], blind)
                or library.of(candidates[i].hypothesis, blind, known).fit
                for i in near
            ]
            score = np.array([f.log_evidence for f in refits]) + np.asarray(log_prior)[near]
            closed = _close(refits, score, is_wrong, nominal, blind, scored)
            shown = held(evidence, mask, (FREQUENCY, DAMPING))
            gained = gains(causes, refits, score, blind, evidence.data, shown)
            found = (*_open(name, closed, nominal, evidence, scored), gained)
        if progress:
            progress()
        return found

    opened = [f for f in library.shared(comm, masks, work) if f is not None]
    if not opened:
        return Shrinkage()
    return _pooled(*map(list, zip(*opened, strict=True)), int(evidence.used.sum()))


def _near(candidates: Sequence[Fit], log_prior, blind: Evidence, always) -> np.ndarray:
    """Indices of hypotheses that are fitted anew without a fold: the best by the remaining data,
    and ``always``.

    All data took part only in the choice of the sets of effects that were solved for at all.
    """
    if always is None:
        return np.arange(len(candidates))
    scores = np.asarray(log_prior) + [
        LinearFit.of(c, blind.at(c.scales)).released().log_evidence for c in candidates
    ]
    unknown = np.array([c.hypothesis.unknown for c in candidates])
    near = set(near_listed(scores, unknown, _HOPELESS, _FAIR).tolist())
    kept = {id(c) for c in always}
    return np.array([i for i, c in enumerate(candidates) if i in near or id(c) in kept])


def _nominal(forward, evidence: Evidence, baseline) -> np.ndarray:
    """What the nominal model predicts, shape (N,); nan but for frequencies."""
    predicted = np.full(len(evidence.data), np.nan)
    is_f = evidence.entries.kind == FREQUENCY
    plain = replace(evidence, log_damping=None, shapes=None, scalars=())
    bare = Hypothesis((), known=evidence.known)
    predicted[is_f] = ManyPredictions(bare, forward, plain, baseline).at(np.zeros(0))[0]
    return predicted


def _close(
    refits, score, is_wrong, nominal, blind, scored
) -> tuple[Fit, Fit | None, np.ndarray, Forecast]:
    """What is stated of a fold without its data: the choice, the placebo, the variance of noise,
    (k,), and the forecast."""
    weights = np.exp(score - logsumexp(score))
    known = np.array([not f.hypothesis.unknown for f in refits])
    wrong = np.array([is_wrong(f) for f in refits]) & known
    chosen = refits[int(np.argmax(np.where(known, score, -np.inf)))]
    noise = _noise_variance(chosen, blind, scored)
    # A hypothesis that predicts the same is no rival: these data cannot tell the two apart.
    for i in np.flatnonzero(wrong):
        change = np.expm1((refits[i].predicted - chosen.predicted)[scored])
        wrong[i] = refits[i] is chosen or np.mean(change**2) > np.mean(noise)
    placebo = refits[int(np.argmax(np.where(wrong, score, -np.inf)))] if wrong.any() else None
    stated = forecast(
        refits, weights, chosen, nominal[scored], blind, scored, float(np.sqrt(np.mean(noise)))
    )
    return chosen, placebo, noise, stated


def _open(name, closed, nominal, evidence, scored) -> tuple[Fold, np.ndarray]:
    """Compare what was stated with the held-out values."""
    chosen, rival, variance, stated = closed
    data = evidence.data[scored]
    predictions = (nominal, chosen.predicted, nominal if rival is None else rival.predicted)
    errors = np.array([np.expm1(p[scored] - data) ** 2 for p in predictions] + [variance])
    before, after, placebo, noise = map(float, _sizes(_sums(errors)))
    own, placebo_own, _ = map(float, _shrinks(_sums(errors)))
    resampled = _sums(errors, np.random.default_rng(_SEED), _DRAWS)
    fold = Fold(
        name=name,
        n=len(data),
        chosen=chosen.hypothesis.label,
        placebo_chosen="" if rival is None else rival.hypothesis.label,
        before=before,
        after=after,
        placebo=placebo,
        noise=noise,
        shrink=own,
        shrink_interval=_interval(_shrinks(resampled)[0]),
        placebo_shrink=placebo_own,
        predicted_after=stated.after,
        predicted_shrink=stated.shrink,
        covered=_inside(after, stated.after),
        better=after < stated.after[0],
        shrink_covered=own >= stated.shrink[0] if np.isfinite(own) else None,
        entries_covered=float(np.mean((stated.low <= data) & (data <= stated.high))),
        weights=stated.weights,
    )
    return fold, errors


def _pooled(opened: list[Fold], errors: list[np.ndarray], gains: list[dict], m) -> Shrinkage:
    """Folds of ``m`` different frequencies in all, each of which several folds may hold out."""
    total, n = sum(map(_sums, errors)), sum(e.shape[1] for e in errors)
    before, after, placebo, noise = map(float, _sizes(total))
    own, wrong, excess = map(float, _shrinks(total))
    own_90, wrong_90, excess_90 = map(_interval, _shrinks(_resampled(errors)))
    sized = [f for f in opened if f.shrink_covered is not None]
    entries = sum(f.entries_covered * f.n for f in opened) / sum(f.n for f in opened)
    return Shrinkage(
        before,
        after,
        placebo,
        noise,
        own,
        own_90,
        wrong,
        wrong_90,
        excess,
        excess_90,
        claimed=bool(excess_90[0] > _SHOWS),
        coverage=float(np.mean([f.held for f in opened])),
        better=float(np.mean([f.better for f in opened])),
        shrink_coverage=float(np.mean([f.shrink_covered for f in sized])) if sized else np.nan,
        entries_coverage=float(entries),
        folds=opened,
        gains={name: m / n * float(np.nansum([each[name] for each in gains])) for name in gains[0]},
    )


def _resampled(errors: Sequence[np.ndarray]) -> np.ndarray:
    """Folds drawn with replacement, and entries within each: sums and counts, (2, draws, 4)."""
    rng = np.random.default_rng(_SEED)
    sums = np.zeros((2, _DRAWS, 4))
    for chosen in rng.integers(len(errors), size=(len(errors), _DRAWS)):
        for i, error in enumerate(errors):
            rows = np.flatnonzero(chosen == i)
            sums[:, rows] += _sums(error, rng, len(rows))
    return sums


def _ends() -> Interval:
    return (1 - INTERVAL) / 2, (1 + INTERVAL) / 2


def _interval(values) -> Interval:
    """Interval of 90 %; draws in which nothing could shrink are left out."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return float("nan"), float("nan")
    low, high = np.quantile(values, _ends())
    return float(low), float(high)


def _inside(value: float, interval: Interval) -> bool:
    return bool(interval[0] <= value <= interval[1])
