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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import evidence_about, whiten
from fenics_joints.diagnosis.evidence.point_mass import PointMassFound
from fenics_joints.diagnosis.evidence.signatures import LENGTHS

__all__ = ["Somewhere", "with_somewhere"]

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
    """A fit's residual with what is linear in its parameters and in the patches' changes.

    Args:
        found: The fit, of no effect.
        test: The test, with the scales that count.
        columns: What the patches' changes do to its entries, from `Signatures.columns`, which no
            scales change.
    """

    def __init__(self, found: Fit, test: Evidence, columns: Sequence[np.ndarray]):
        lower, used = test.lower(), test.fitted
        self.lower, self.z, signatures = lower, found.z, test.signatures
        self.free = ~found.hypothesis.at_limit(found.z)
        columns = [column[used] for column in columns]
        self.n_kinds, self.signatures = len(columns), signatures
        residual = (found.predicted - test.data)[used]
        white = whiten(lower, np.column_stack([residual, found.jacobian[used], *columns]))
        self.residual, self.slope = white[:, 0], white[:, 1:]

    def root(self, kind: tuple[float, float], size: float, length: float) -> np.ndarray:
        """From standard normal numbers to changes of the patches, (K P, K P)."""
        root = size * self.signatures.root(length)
        return block_diag(*(on * root for on in (*kind, kind[0])[: self.n_kinds]))

    def log_evidence(self, *prior) -> float:
        """ln of the evidence; see `root`."""
        slope, z = self._with(self.root(*prior))
        free = np.concatenate([self.free, np.ones(len(z) - len(self.free), dtype=bool)])
        return evidence_about(self.residual, slope, z, self.lower, free)

    def _with(self, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = len(self.z)
        slope = np.hstack([self.slope[:, :own], self.slope[:, own:] @ root])
        return slope, np.concatenate([self.z, np.zeros(root.shape[1])])


def _priors() -> Iterator[tuple[tuple, float]]:
    for kind, (size, b), length in product(_KINDS, _SIZES, LENGTHS):
        yield (kind, size, length), float(np.log(b / (len(_KINDS) * len(LENGTHS))))


def _scores(found: Fit, test: Evidence) -> list[float]:
    """ln of the evidence times the prior, for scales of the test and priors of the changes."""
    tried = [(None, 0.0)] if test.scales is None else test.scales.tried()
    scores, columns = [], test.signatures.columns(test)
    for scales, weight in tried:
        linear = _Linear(found, test.at(scales), columns)
        scores += [weight + more + linear.log_evidence(*prior) for prior, more in _priors()]
    return scores


def with_somewhere(found: Fit, test: Evidence) -> Fit:
    """A fit of an unknown cause with the evidence that it is somewhere, beside that it may do
    anything; as it is where the test has no signatures.

    Args:
        found: The fit of the hypothesis that something else is at work.
        test: The test.
    """
    if test.signatures is None:
        return found
    placed = float(logsumexp(_scores(found, test))) + np.log(_PLACED)
    both = float(np.logaddexp(found.log_evidence + np.log(1 - _PLACED), placed))
    return replace(found, log_evidence=both, placed=float(np.exp(placed - both)))
