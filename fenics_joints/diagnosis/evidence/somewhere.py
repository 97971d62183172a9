"""An unknown cause as a change of stiffness and mass somewhere, and what a test says of where.

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
from fenics_joints.diagnosis.evidence.linear import evidence_about, least_square, whiten
from fenics_joints.diagnosis.evidence.point_mass import PointMassFound
from fenics_joints.diagnosis.evidence.scales import Scales

__all__ = ["Patch", "Somewhere", "changes", "with_somewhere"]

#: Standard deviations of ln E and ln rho of a patch, relative to those that signatures are of, and
#: over how much of the structure's size changes are alike; each with its prior probability.
_SIZES = ((1 / 3, 0.25), (1.0, 0.5), (3.0, 0.25))
_LENGTHS = ((0.05, 1 / 3), (0.2, 1 / 3), (1.0, 1 / 3))
#: Whether stiffness changes, and mass: either, or both.
_KINDS = (((1.0, 0.0), 1 / 3), ((0.0, 1.0), 1 / 3), ((1.0, 1.0), 1 / 3))
#: Prior probability that an unknown cause is one of this kind, and none that may do anything.
_PLACED = 0.5


@dataclass(frozen=True)
class Patch:
    """What a test says of a patch if the unknown cause is somewhere.

    Attributes:
        name: The patch's.
        region: Its region.
        middle: Its centre, m.
        of_joint: Whether it is of a joint.
        stiffness: Mean of the change of ln E; of a joint that of ln of its stiffness where all
            joints give way, of which only the sign means much.
        stiffness_sd: Its standard deviation.
        mass: Mean of the change of ln rho.
        mass_sd: Its standard deviation.
    """

    name: str
    region: str
    middle: tuple[float, ...]
    of_joint: bool
    stiffness: float
    stiffness_sd: float
    mass: float
    mass_sd: float


@dataclass(frozen=True)
class Somewhere:
    """An unknown cause that has a place.

    Attributes:
        probability: That the unknown cause is of this kind, if there is one.
        patches: Every patch, those first whose change is surest.
        point: The one point mass that explains the test best; None if none does.
        looked_for: Whether the diagnosis also looked for effects at any place, such as a mass.
    """

    probability: float
    patches: tuple[Patch, ...]
    point: PointMassFound | None = None
    looked_for: bool = False


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

    def posterior(self, *prior) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the patches' changes, (K P,); see `root`."""
        root = self.root(*prior)
        slope, z = self._with(root)
        _, hessian = least_square(self.residual, slope, z)
        own = slice(len(self.z), None)
        covariance = np.linalg.inv(hessian)
        mean = -covariance @ (slope.T @ self.residual + z)
        inside = root @ covariance[own, own] @ root.T
        return root @ mean[own], np.sqrt(np.maximum(np.diag(inside), 0.0))

    def _with(self, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = len(self.z)
        slope = np.hstack([self.slope[:, :own], self.slope[:, own:] @ root])
        return slope, np.concatenate([self.z, np.zeros(root.shape[1])])


def _priors() -> Iterator[tuple[tuple, float]]:
    for (kind, a), (size, b), (length, c) in product(_KINDS, _SIZES, _LENGTHS):
        yield (kind, size, length), float(np.log(a * b * c))


def _scores(found: Fit, test: Evidence) -> dict[tuple[Scales | None, tuple], float]:
    """ln of the evidence times the prior, by scales of the test and prior of the changes."""
    tried = [(None, 0.0)] if test.scales is None else test.scales.tried()
    scores, columns = {}, test.signatures.columns(test)
    for scales, weight in tried:
        linear = _Linear(found, test.at(scales), columns)
        for prior, more in _priors():
            scores[scales, prior] = weight + more + linear.log_evidence(*prior)
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
    placed = float(logsumexp(list(_scores(found, test).values()))) + np.log(_PLACED)
    both = float(np.logaddexp(found.log_evidence + np.log(1 - _PLACED), placed))
    return replace(found, log_evidence=both, placed=float(np.exp(placed - both)))


def changes(found: Fit, test: Evidence) -> Somewhere | None:
    """Where an unknown cause would be, and what it would change; None where that was not looked at.

    At the length, the size and the kind of change that are most probable.

    Args:
        found: The fit of the hypothesis that something else is at work.
        test: The test.
    """
    if test.signatures is None or found.placed is None:
        return None
    scores = _scores(found, test)
    scales, prior = max(scores, key=lambda key: scores[key])
    linear = _Linear(found, test.at(scales), test.signatures.columns(test))
    mean, sd = (part.reshape(linear.n_kinds, -1) for part in linear.posterior(*prior))
    signatures = test.signatures
    expected = np.array(signatures.expected)[:, None] * np.ones(len(signatures.names))
    expected[0, signatures.of_joint] = -1.0  # twice the compliance
    mean, sd = mean[:2] * expected, sd[:2] * np.abs(expected)
    rows = zip(
        signatures.names, signatures.region, signatures.middle.tolist(),
        signatures.of_joint.tolist(), *(mean[0], sd[0], mean[1], sd[1]), strict=True,
    )  # fmt: skip
    patches = [
        Patch(name, region, tuple(x), of_joint, *map(float, sizes))
        for name, region, x, of_joint, *sizes in rows
    ]
    surest = np.max(np.abs(mean) / np.maximum(sd, 1e-300), axis=0)
    order = np.argsort(-surest, kind="stable")
    return Somewhere(float(found.placed), tuple(patches[i] for i in order))
