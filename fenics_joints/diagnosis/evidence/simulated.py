"""How often the library would explain a test that one of its causes made no better than this one.

A chi-square (`Fit.p_value`) knows nothing of choice: of many explanations the best fits better than
one that was named beforehand, so that of a few frequencies any test leaves little, and nothing is
ever odd. So tests of the same conditions, modes and sensors are simulated: a hypothesis of the
library by its probability, its parameters by their priors, errors of model and instrument as
stated. For each the most probable hypothesis is chosen anew, and what that leaves is counted. A
test whose cause is in the library is one of these as good as any, so the share of those that leave
as much is a conformal p-value (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World,
2005), as far as hypotheses are linear about their fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.screen import near_best, whitened

#: Simulated tests; a p-value is no less than one in so many, or than chi-square has it. [numerical:
#: p to 0.1 %]
_COUNT = 999
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
    left = _left([fits[i] for i in near], np.asarray(score)[near], evidence, count)

    def judged(f: Fit) -> Fit:
        if f.hypothesis.unknown:
            return f
        worse = int(np.sum(left >= f.square))
        rank = (1 + worse) / (1 + count)
        return replace(f, simulated=rank if worse else min(rank, f.p_value))

    return [judged(f) for f in fits]


def _left(fits: list[Fit], score: np.ndarray, evidence: Evidence, count: int) -> np.ndarray:
    """What the best of some hypotheses leaves of each simulated test, (count,), as `Fit.square`."""
    best = fits[int(np.argmax(score))]
    # Between levels errors are what the best calls for; of a model all that is stated.
    scales = evidence.scales
    if scales is not None:
        scales = best.scales if evidence.drifts else best.scales.stated
    test = evidence.at(scales)
    lower, rng = test.lower(), np.random.default_rng(0)
    lines = [_Line(f, s, test, lower) for f, s in zip(fits, score, strict=True)]
    counts = rng.multinomial(count, softmax(score))
    tests = np.hstack([line.drawn(n, rng) for line, n in zip(lines, counts, strict=True)])
    most, left = np.full(count, -np.inf), np.zeros(count)
    for line in lines:
        square = line.square(tests)
        better = (value := line.offset - 0.5 * square) > most
        most[better], left[better] = value[better], square[better]
    return left + (0.0 if scales is None else scales.squares)


class _Line:
    """A hypothesis linear about its fit, whitened; tests as their distance from the real one.

    Attributes:
        offset: What is to be added to minus half of a test's `square` for ln of the evidence times
            the prior odds, which is so of the real test.
    """

    def __init__(self, found: Fit, score: float, evidence: Evidence, lower: np.ndarray):
        self.residual, self.slope = whitened(found, evidence, lower)
        self.z = found.z
        self.free = ~found.hypothesis.at_limit(found.z)
        slope = self.slope[:, self.free]
        self.root = np.linalg.inv(np.linalg.cholesky(slope.T @ slope + np.eye(slope.shape[1])))
        self.offset = score + 0.5 * self.square(np.zeros((len(lower), 1)))[0]

    def square(self, tests: np.ndarray) -> np.ndarray:
        """Least |r|^2 + |z|^2 of each test, (n,); tests (k, n)."""
        residual = self.residual[:, None] - tests
        pull = self.slope[:, self.free].T @ residual + self.z[self.free][:, None]
        gain = np.sum((self.root @ pull) ** 2, axis=0)
        return np.sum(residual**2, axis=0) + self.z @ self.z - gain

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Tests that the hypothesis makes, (k, n)."""
        away = rng.standard_normal((len(self.z), n)) - self.z[:, None]
        errors = rng.standard_normal((len(self.residual), n))
        return self.residual[:, None] + self.slope[:, self.free] @ away[self.free] + errors
