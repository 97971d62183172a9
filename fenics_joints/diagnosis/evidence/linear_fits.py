"""Fits taken as linear about their parameters: of other data, of simulated tests, of all effects.

*Of other data.* A fold's fit is the whole test's, moved by a linear step if that step is small.

*Of simulated tests.* A chi-square (`Fit.p_value`) ignores that an explanation was chosen: the best
of many fits better than one named beforehand, so that few frequencies never seem badly explained.
So tests of the same conditions, modes and sensors are simulated: a hypothesis of the library by its
probability, its parameters by their priors, errors of model and instrument as stated. For each the
most probable hypothesis is chosen anew, and the misfit that it leaves is compared with that of the
measured test. If the cause is in the library, the measured test is a draw of the same kind, so that
the share of simulated tests with a larger misfit is a p-value (conformal: Vovk, Gammerman and
Shafer, Algorithmic Learning in a Random World, 2005), as far as hypotheses are linear about their
fits. Beyond the largest few of them it falls exponentially, as the tail of a sum of squares nearly
does.

*Of all effects.* Could all effects of the library at once explain a test that no few of them do?
The best explanation gets the slopes of all other effects beside its own. Its least |r|^2 + |z|^2 is
then chi-square where effects are linear about their fits: what no combination of the library
explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import LinearFit, left_by_stated, log_evidence
from fenics_joints.diagnosis.evidence.localised_unknown import with_localised_unknown
from fenics_joints.diagnosis.evidence.scales import marginalise_scales


def near_best(values: np.ndarray, margin: float, most: int) -> np.ndarray:
    """Indices of the values within a margin of the largest, at most so many, best first."""
    order = np.argsort(-values, kind="stable")
    return order[values[order] > values[order[0]] - margin][:most] if len(order) else order


def near_listed(values: np.ndarray, unknown: np.ndarray, margin: float, most: int) -> np.ndarray:
    """As `near_best`; where nothing but an unknown cause is near, the best of the others, too.

    Args:
        values: Of each.
        unknown: Which are an unknown cause, bool.
        margin: Of the largest, and of the largest of the others.
        most: Number of each at most.
    """
    near, listed = near_best(values, margin, most), np.flatnonzero(~unknown)
    if not unknown[near].all():
        return near
    return np.concatenate([near, listed[near_best(values[listed], margin, most)]])


#: Gain, in nats, and step, in prior standard deviations, up to which a fit to a part of the data is
#: linear about that to all of them: what is bent in between is a small part of that gain.
#: [numerical: chosen]
_NEAR, _STRIDE = 0.3, 0.5


def moved(found: Fit, evidence: Evidence) -> Fit | None:
    """A fit moved to other data of the same test by a linear step; None if the step is too large.

    Args:
        found: The fit, to all data.
        evidence: A part of them.
    """
    h = found.hypothesis
    if evidence.drifts or any(p.scan for _, p in h.priors) or not len(found.z):
        return None
    near = _moved_at(found, evidence.at(found.scales))
    if near is None:
        return None
    if evidence.scales is not None:
        tried = evidence.scales.tried()
        best, over = marginalise_scales(
            tried, lambda at: LinearFit.of(near, evidence.at(at)).log_evidence
        )
        if best != near.scales:
            near = _moved_at(found, evidence.at(best))
        if near is None:
            return None
        more, stated = over(near.scales), left_by_stated(near, evidence)
        log_z = near.log_evidence + more
        near = replace(near, log_evidence=log_z, widening=more, stated=stated)
    return with_localised_unknown(near, evidence) if h.unknown else near


def _moved_at(found: Fit, evidence: Evidence) -> Fit | None:
    """`moved` with the test's scales as they are."""
    h, linear = found.hypothesis, LinearFit.of(found, evidence)
    slope = linear.slope
    hessian = slope.T @ slope + np.eye(len(found.z))
    pull = slope.T @ linear.residual + found.z
    step = -np.linalg.solve(hessian, pull)
    z = found.z + step
    if h.at_limit(z).any() or -0.5 * pull @ step > _NEAR or np.max(np.abs(step)) > _STRIDE:
        return None
    left = linear.residual + slope @ step
    return replace(
        found,
        z=z,
        covariance=np.linalg.inv(hessian),
        predicted=found.predicted + found.jacobian @ step,
        log_evidence=log_evidence(left @ left + z @ z, slope, linear.lower),
        misfit=float(left @ left),
        n_data=len(left),
        scales=evidence.scales,
    )


#: Simulated tests, and the share of them beyond which an exponential tail is fitted. [numerical: p
#: to 0.008 of 0.5, to 0.0015 of 0.01]
_COUNT, _TAIL = 4000, 0.05
#: Hypotheses that compete for each, those that are the most probable for the real one. [numerical:
#: chosen for time]
_MOST = 100


def with_simulated(
    fits: Sequence[Fit], score: np.ndarray, evidence: Evidence, *, count: int = _COUNT
) -> list[Fit]:
    """Fits of the library with p-values from simulated tests in place of chi-square's.

    Args:
        fits: All hypotheses, the unknown among them.
        score: ln of the evidence times the prior odds of each.
        evidence: The test.
        count: Number of simulated tests.
    """
    listed = np.flatnonzero([not f.hypothesis.unknown for f in fits])
    near = listed[near_best(np.asarray(score)[listed], np.inf, _MOST)]
    if not len(near) or not evidence.fitted.any():
        return list(fits)
    # Of two that are as probable as each other, round-off would say which comes first.
    near = sorted(near, key=lambda i: fits[i].hypothesis.label_of_keys)
    left, of_scales = _left([fits[i] for i in near], np.asarray(score)[near], evidence, count)
    edge = np.quantile(left, 1 - _TAIL)
    excess = np.mean(left[left > edge] - edge)

    def share(square: float) -> float:
        """Of simulated tests with a larger misfit."""
        if square < edge:
            return float(np.mean(left >= square))
        return float(_TAIL * np.exp(-(square - edge) / excess))

    return [
        f if f.hypothesis.unknown else replace(f, simulated=share(f.square - of_scales))
        for f in fits
    ]


def _left(
    fits: list[Fit], score: np.ndarray, evidence: Evidence, count: int
) -> tuple[np.ndarray, float]:
    """Misfit of the best of some hypotheses for each simulated test, (count,); `Fit.square` has the
    second number besides, which is of scales and the same for all."""
    best = fits[int(np.argmax(score))]
    # Errors between levels as the best hypothesis has them; of a model, all of the stated error.
    scales = evidence.scales
    if scales is not None:
        scales = best.scales if evidence.drifts else best.scales.stated
    test = evidence.at(scales)
    lines = [LinearFit.of(f, test, test.lower()) for f in fits]
    tests = _drawn(lines, softmax(score), count)
    most, left = np.full(count, -np.inf), np.zeros(count)
    for line, own in zip(lines, score, strict=True):
        square = line.squares(-tests)
        value = own + 0.5 * (line.square - square)
        better = value > most
        most[better], left[better] = value[better], square[better]
    return left, 0.0 if scales is None else scales.squares


def _drawn(lines: Sequence[LinearFit], probability: np.ndarray, count: int) -> np.ndarray:
    """Tests that hypotheses make, each as often as it is probable: differences from the real one,
    whitened, (k, count).

    No random number depends on the probabilities, so that round-off moves a few tests at most from
    one hypothesis to another and leaves all others as they are.
    """
    rng = np.random.default_rng(0)
    quantile = (rng.permutation(count) + 0.5) / count
    cause = np.searchsorted(np.cumsum(probability)[:-1], quantile)
    found = rng.standard_normal((len(lines[0].residual), count))
    parameters = rng.standard_normal((max(len(line.z) for line in lines), count))
    for i in np.unique(cause):
        line, own = lines[i], cause == i
        away = parameters[: len(line.z), own] - line.z[:, None]
        found[:, own] += line.residual[:, None] + line.slope[:, line.free] @ away[line.free]
    return found


def all_at_once(fits: Sequence[Fit], leader: Fit, evidence: Evidence) -> float:
    """Probability of a misfit as large as all effects at once would leave, if these were at work.

    Args:
        fits: Fits of hypotheses, those of one effect among them.
        leader: The best explanation, to which the effects that it does not hold are added.
        evidence: The test.
    """
    # As for `Fit.square`: of errors that are stated at most all that is stated is there.
    scales = leader.scales
    if scales is not None and not evidence.drifts:
        scales = scales.stated
    test = evidence.at(scales)
    held = {effect.key for effect in leader.hypothesis.effects}
    others = [
        LinearFit.of(f, test, test.lower()).slope[:, f.hypothesis.own]
        for f in fits
        if not f.hypothesis.unknown
        and len(f.hypothesis.effects) == 1
        and f.hypothesis.effects[0].key not in held
    ]
    all_ = LinearFit.of(leader, test, test.lower()).beside(*others)
    of_scales = 0.0 if scales is None else scales.squares
    return float(chi2.sf(all_.square + of_scales, len(all_.residual)))
