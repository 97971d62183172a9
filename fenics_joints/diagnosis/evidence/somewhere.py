"""An unknown cause as a change of stiffness and mass somewhere.

What no effect of the library is has mostly a place all the same: a lining, a filling, a hole, a
part of another material. So ln of the stiffness and of the mass of every patch of the structure are
random before the test: Gaussian, smooth over a length and of a size that are not known. All that is
measured is linear in them (`fenics_joints.diagnosis.evidence.signatures`), so that the evidence is
in closed form at each length and size, and is summed over these. Unlike a covariance that lets
every mode do as it likes, it knows that what moves one mode turns others, and that one place moves
them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import marginal, whiten
from fenics_joints.diagnosis.evidence.point_mass import PointMassFound
from fenics_joints.diagnosis.evidence.signatures import LENGTHS

#: Standard deviations of ln E and ln rho of a patch, relative to those that signatures are of, each
#: with its prior probability. [decision: chosen]
_SIZES = ((1 / 3, 0.25), (1.0, 0.5), (3.0, 0.25))
#: Whether stiffness changes, and mass: either, or both. [decision: all there are]
_KINDS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
#: Prior probability that an unknown cause is one of this kind, and none that may do anything.
#: [decision: indifference]
_PLACED = 0.5


@dataclass(frozen=True)
class Somewhere:
    """An unknown cause that has a place; `fenics_joints.diagnosis.location` says where.

    Attributes:
        probability: That the unknown cause is of this kind, if there is one.
        point: The one point mass that explains the test best; None if none does.
    """

    probability: float
    point: PointMassFound | None = None


class _Linear:
    """Residuals with what is linear in a fit's parameters and in the patches' changes.

    Args:
        residual: Predictions less data where all parameters but those at a limit are 0, of t tests,
            (k, t).
        slope: Derivatives by the parameters that are not at a limit, (k, p).
        test: Has the metric.
        columns: What the patches' changes do to its entries, from `Signatures.columns`, which no
            scales change.
    """

    def __init__(
        self, residual: np.ndarray, slope: np.ndarray, test: Evidence, columns: Sequence[np.ndarray]
    ):
        lower, t, own = test.lower(), residual.shape[1], slope.shape[1]
        columns = [column[test.fitted] for column in columns]
        white = whiten(lower, np.column_stack([residual, slope, *columns]))
        self.residual, self.slope, self.patches = np.split(white, [t, t + own], axis=1)
        self.n_kinds, self.signatures = len(columns), test.signatures
        self.constant = np.sum(np.log(np.diag(lower))) + 0.5 * len(lower) * np.log(2 * np.pi)

    def log_evidence(self, kind: tuple[float, float], size: float, length: float) -> np.ndarray:
        """ln of the evidence of each test, (t,), for a prior of the changes."""
        root = size * self.signatures.root(length)
        root = block_diag(*(on * root for on in (*kind, kind[0])[: self.n_kinds]))
        slope = np.hstack([self.slope, self.patches @ root])
        return marginal(self.residual, slope) - self.constant


def _placed(residual: np.ndarray, slope: np.ndarray, test: Evidence, tried) -> np.ndarray:
    """ln of the evidence of each test, (t,), if the unknown cause is somewhere; see `_Linear`, and
    `Scales.tried` for the scales that are tried."""
    scores, columns = [], test.signatures.columns(test)
    for scales, weight in tried:
        linear = _Linear(residual, slope, test.at(scales), columns)
        for kind, (size, b), length in product(_KINDS, _SIZES, LENGTHS):
            more = np.log(b / (len(_KINDS) * len(LENGTHS)))
            scores.append(weight + more + linear.log_evidence(kind, size, length))
    return logsumexp(scores, axis=0)


def with_somewhere(found: Fit, test: Evidence) -> Fit:
    """A fit of an unknown cause with the evidence that it is somewhere, beside that it may do
    anything; as it is where the test has no signatures.

    Args:
        found: The fit of the hypothesis that something else is at work.
        test: The test.
    """
    if test.signatures is None:
        return found
    used, free = test.fitted, ~found.hypothesis.at_limit(found.z)
    slope, residual = found.jacobian[used], (found.predicted - test.data)[used]
    residual = residual - slope[:, free] @ found.z[free]
    tried = [(None, 0.0)] if test.scales is None else test.scales.tried()
    placed = float(_placed(residual[:, None], slope[:, free], test, tried)[0]) + np.log(_PLACED)
    placed -= 0.5 * float(found.z[~free] @ found.z[~free])
    both = float(np.logaddexp(found.log_evidence + np.log(1 - _PLACED), placed))
    return replace(found, log_evidence=both, placed=float(np.exp(placed - both)))


def unknown_evidence(
    predicted: np.ndarray, slope: np.ndarray, data: np.ndarray, test: Evidence
) -> np.ndarray:
    """ln of the evidence of an unknown cause for other data of a test's entries, (t,).

    Args:
        predicted: By the nominal model, (k,).
        slope: Derivatives by what is uncertain in any case, (k, p).
        data: The data, (t, k).
        test: The test, whose scales are taken.
    """
    lower = test.lower(unknown=True)
    white = whiten(lower, np.column_stack([predicted[:, None] - data.T, slope]))
    residual, wide = white[:, : len(data)], white[:, len(data) :]
    anything = marginal(residual, wide) - np.sum(np.log(np.diag(lower)))
    anything -= 0.5 * len(lower) * np.log(2 * np.pi)
    if test.signatures is None:
        return anything
    placed = _placed(predicted[:, None] - data.T, slope, test, [(None, 0.0)])
    return np.logaddexp(anything + np.log(1 - _PLACED), placed + np.log(_PLACED))
