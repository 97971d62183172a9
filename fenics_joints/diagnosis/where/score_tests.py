"""Where the gap lies: a score test of each place, and the misfit along each axis of the test.

The residual of the nominal model is r = data - prediction. If nothing but noise, the error that
any model has, and nuisances within their tolerance are at work, then r ~ N(0, C) with
C = Sigma + N N^T, N being the derivatives by the nuisances in prior standard deviations. With
C = L L^T everything is whitened: r~ = L^-1 r, S~ = L^-1 S. Nuisances are so projected out as far
as their prior lets them move and no further: an infinitely wide prior would be the orthogonal
projector of Basseville and Nikiforov (CDC 2005), which would give a tolerance of one per cent the
same freedom as an unknown modulus.

Let x be changes at one place, a region, a zone of a joint or a patch of cells, in units of their
expected size, and S the derivatives of the data by them. The score is the derivative of the log
evidence of the nominal hypothesis, U = S~^T r~, and F = S~^T S~ is its variance (Fisher's
information). Rao's statistic t = U^T F^-1 U is chi-square with rank(S~) degrees of freedom without
a change, under any turning of the columns (Rao, Proc. Camb. Phil. Soc. 44, 1948, 50). With the
prior x ~ N(0, I) the place's log evidence, above that of no change anywhere, is

    1/2 U^T (I + F)^-1 U - 1/2 ln det(I + F),

with the mean (I + F)^-1 U of x and the covariance (I + F)^-1. Places are compared by it, so that
one which needs changes far beyond what is expected does not come first by its fit alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.entries import FREQUENCY, KINDS
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE

#: Family-wise p below which a place explains more than chance. [decision: convention]
LEVEL = 0.05


@dataclass(frozen=True, repr=False)
class Place:
    """Changes of the data by changes at one place.

    Attributes:
        zone: Its name.
        region: Name of the region that it is, or is in.
        kind: ``part``, ``joint``, or empty for masses, springs and supports.
        columns: Change of the data by a change of the expected size of each parameter, (N, k).
        odds: Its prior odds: 1 of a region, which its zones or patches share.
    """

    zone: str
    region: str
    kind: str
    columns: np.ndarray
    odds: float = 1.0


@dataclass(frozen=True)
class ScoreTest:
    """Whether the test speaks of a change at one place.

    Attributes:
        zone: Name of the place.
        region: Name of the region that it is, or is in.
        kind: ``part``, ``joint``, or empty for masses, springs and supports.
        odds: Prior odds, those of a whole region being 1.
        dof: Degrees of freedom of ``statistic``; 0 for a place that the test does not see.
        statistic: Part of the squared whitened residual that a change here alone could explain.
        p: Probability of as much by chance.
        p_adjusted: The same by Holm's step-down procedure for all places tested, by their odds.
        share: ``statistic`` as a share of the whole squared whitened residual, 0 to 1.
        rest_p: Probability that chance leaves as much unexplained as a change here alone does;
            small where it cannot be the only one.
        log_evidence: ln of the evidence of a change of the expected size here, above that of none.
        change: Most probable change by parameter, in units of its expected size, (k,).
        change_sd: Its standard deviation, (k,).
        log_f: What the change does to ln f on the mean over the data; below zero where the place
            is softer or heavier than in the model.
    """

    zone: str
    region: str
    kind: str
    odds: float
    dof: int
    statistic: float
    p: float
    p_adjusted: float
    share: float
    rest_p: float
    log_evidence: float
    change: tuple[float, ...]
    change_sd: tuple[float, ...]
    log_f: float

    @property
    def log_odds(self) -> float:
        """ln of the odds of a change here over those of none, in units of a region's prior odds."""
        return self.log_evidence + float(np.log(self.odds))

    @property
    def way(self) -> str:
        """Which way it differs from the model, in words."""
        return "stiffer or lighter" if self.log_f > 0 else "softer or heavier"

    @property
    def significant(self) -> bool:
        """Whether it explains more than chance, all places considered."""
        return self.p_adjusted < LEVEL

    @property
    def sufficient(self) -> bool:
        """Whether it does, and leaves no more unexplained than chance would."""
        return self.significant and self.rest_p >= LEVEL


@dataclass(frozen=True)
class ZoneShare:
    """Share of the misfit that a region explains; all regions and the rest sum to 1."""

    region: str
    share: float


@dataclass(frozen=True)
class Attribution:
    """The part of the squared whitened residual that one group of data adds.

    Attributes:
        by: The axis.
        label: The group.
        chi2: What it adds, given the groups before it; all groups sum to the whole.
        expected: What it would add by chance: its number of entries.
        p: Probability of as much by chance.
    """

    by: str
    label: str
    chi2: float
    expected: int
    p: float


def whitened(
    evidence: Evidence, nuisance: np.ndarray | None, *arrays: np.ndarray
) -> list[np.ndarray]:
    """Fitted rows of arrays in standard deviations of the data under the nominal model.

    Args:
        evidence: The test.
        nuisance: Derivatives of all N data by the nuisances in prior standard deviations, (N, p).
        arrays: Of shape (N,) or (N, k).
    """
    used = np.ravel(evidence.fitted)
    lower = np.linalg.cholesky(_covariance(evidence, nuisance))
    return [whiten(lower, np.asarray(a)[used]) for a in arrays]


def _covariance(evidence: Evidence, nuisance: np.ndarray | None) -> np.ndarray:
    covariance = evidence.covariance()
    if nuisance is not None and nuisance.size:
        used = np.asarray(nuisance)[np.ravel(evidence.fitted)]
        covariance = covariance + used @ used.T
    return covariance


def holm(p: Sequence[float], weight: Sequence[float] | None = None) -> np.ndarray:
    """P-values adjusted for their number so that any false alarm keeps its level.

    Step-down: in ascending order of p over its weight, that times the sum of the weights from
    there on, made non-decreasing and at most 1 (Holm, Scand. J. Statist. 6, 1979); it holds under
    any dependence, with any weights that are fixed before the data.
    """
    p = np.asarray(p, dtype=float)
    weight = np.ones(len(p)) if weight is None else np.asarray(weight, dtype=float)
    order = np.argsort(p / weight, kind="stable")
    left = np.cumsum(weight[order][::-1])[::-1]
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate((p / weight)[order] * left), 1.0)
    return adjusted


# -- places ----------------------------------------------------------------------------------


def score_tests(
    residual: np.ndarray, places: Sequence[Place], nuisance: np.ndarray | None, evidence: Evidence
) -> list[ScoreTest]:
    """Test every place for a change there alone.

    Args:
        residual: Data minus the nominal model's prediction, (N,); entries that are not fitted are
            not looked at.
        places: What changes at each do.
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p), or None.
        evidence: The test.

    Returns:
        A test for each place, in their order.
    """
    r, *columns = whitened(evidence, nuisance, residual, *(place.columns for place in places))
    total, tests = float(r @ r), []
    of_f = np.asarray(evidence.entries.kind) == FREQUENCY
    for place, S in zip(places, columns, strict=True):
        Q = _visible_span(S)
        t, dof = float(np.sum((Q.T @ r) ** 2)), Q.shape[1]
        gain, mean, sd = _local_evidence(r, S)
        tests.append(
            ScoreTest(
                place.zone,
                place.region,
                place.kind,
                place.odds,
                dof,
                t,
                p=float(chi2.sf(t, dof)) if dof else 1.0,
                p_adjusted=1.0,
                share=t / max(total, 1e-300),
                rest_p=float(chi2.sf(max(total - t, 0.0), len(r) - dof)) if len(r) > dof else 1.0,
                log_evidence=gain,
                change=tuple(mean.tolist()),
                change_sd=tuple(sd.tolist()),
                log_f=float(np.mean((place.columns @ mean)[of_f])),
            )
        )
    seen = [i for i, test in enumerate(tests) if test.dof]
    p, odds = ([getattr(tests[i], key) for i in seen] for key in ("p", "odds"))
    for i, adjusted in zip(seen, holm(p, odds), strict=True):
        tests[i] = replace(tests[i], p_adjusted=float(adjusted))
    return tests


def shares(
    residual: np.ndarray, places: Sequence[Place], nuisance: np.ndarray | None, evidence: Evidence
) -> list[ZoneShare]:
    """Split the misfit among regions: the region of the most probable place takes the part that a
    change there explains, then the next one its part of the rest, as long as the evidence grows.

    Args:
        residual: See `score_tests`.
        places: The places.
        nuisance: See `score_tests`.
        evidence: The test.

    Returns:
        Regions in that order, then those that explain nothing more, and ``unexplained`` last.
    """
    r, *columns = whitened(evidence, nuisance, residual, *(place.columns for place in places))
    left = list(zip(places, columns, strict=True))
    total, found = max(float(r @ r), 1e-300), []
    while left:
        odds = [_local_evidence(r, S)[0] + np.log(place.odds) for place, S in left]
        if max(odds) <= 0:
            break
        best, S = left[int(np.argmax(odds))]
        Q = _visible_span(S)
        found.append(ZoneShare(best.region, float(np.sum((Q.T @ r) ** 2)) / total))
        r = r - Q @ (Q.T @ r)
        left = [(p, S - Q @ (Q.T @ S)) for p, S in left if p.region != best.region]
    found += [ZoneShare(name, 0.0) for name in dict.fromkeys(p.region for p, _ in left)]
    return [*found, ZoneShare("unexplained", float(r @ r) / total)]


def _visible_span(S: np.ndarray) -> np.ndarray:
    """Orthonormal directions of the data in which the test sees changes, (N, r); two parameters
    that do nearly the same are one, since their difference is not seen."""
    if not S.size:
        return np.zeros((len(S), 0))
    # LAPACK's gesdd does not always converge where columns are the same but for round-off.
    U, s, _ = scipy.linalg.svd(S, full_matrices=False, lapack_driver="gesvd")
    return U[:, s > max(NEGLIGIBLE, 1e-9 * s[0], 1e-300)]


def _local_evidence(r: np.ndarray, S: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """ln of the evidence of a change above that of none, and its mean and standard deviation."""
    score, precision = S.T @ r, np.eye(S.shape[1]) + S.T @ S
    covariance = np.linalg.inv(precision)
    mean = covariance @ score
    gain = 0.5 * (score @ mean - np.linalg.slogdet(precision)[1])
    return float(gain), mean, np.sqrt(np.diag(covariance))


# -- along the axes of the test --------------------------------------------------------------


def attribution(
    residual: np.ndarray,
    evidence: Evidence,
    by: str = "mode",
    *,
    nuisance: np.ndarray | None = None,
    names: Sequence[str] | None = None,
) -> list[Attribution]:
    """How much each mode, band, condition or kind of data adds to the misfit.

    r^T C^-1 r is split exactly: the data are put in the order of the axis, C = L L^T, and the
    squares of L^-1 r are summed by group. Each sum is what the group adds given those before it,
    is chi-square with as many degrees of freedom as it has data, and is independent of the others.

    Args:
        residual: Data minus the nominal model's prediction, (N,).
        evidence: The test.
        by: ``"mode"``, ``"band"`` (octaves from the lowest frequency), ``"condition"`` (torque or
            level, ascending) or ``"kind"`` (`KINDS`); single numbers, as masses, are of no
            mode and no condition.
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p).
        names: Names of the modes.
    """
    if by != "kind" and evidence.scalars and len(residual) == len(evidence.data):
        evidence = replace(evidence, scalars=())
        residual = residual[: len(evidence.data)]
        nuisance = None if nuisance is None else nuisance[: len(residual)]
    used = np.ravel(evidence.fitted)
    group, labels = _groups(evidence, by, names)
    group = group[used]
    order = np.argsort(group, kind="stable")
    lower = np.linalg.cholesky(_covariance(evidence, nuisance)[np.ix_(order, order)])
    white = whiten(lower, np.asarray(residual)[used][order])
    found = []
    for g in np.unique(group):
        own = white[group[order] == g]
        total, n = float(own @ own), len(own)
        found.append(Attribution(by, labels[g], total, n, float(chi2.sf(total, n))))
    return found


def _groups(evidence: Evidence, by: str, names) -> tuple[np.ndarray, list[str]]:
    """Group of every datum, (N,), and the groups' labels, in the order of the axis."""
    entries = evidence.entries
    mode, row, kind = (np.asarray(a) for a in (entries.mode, entries.row, entries.kind))
    n_modes = evidence.log_f.shape[1]
    if by == "mode":
        return mode, list(names or (f"mode {j + 1}" for j in range(n_modes)))
    if by == "kind":
        return kind, list(KINDS)
    if by == "condition":
        values, rank = np.unique(evidence.conditions, return_inverse=True)
        return rank[row], [f"{value:g}" for value in values]
    hz = np.exp(np.nanmean(evidence.log_f, axis=0))
    low = float(np.nanmin(hz))
    octave = np.floor(np.log2(np.where(np.isfinite(hz), hz, low) / low) + 1e-9).astype(int)
    edges = low * 2.0 ** np.arange(max(octave) + 2)
    pairs = zip(edges[:-1], edges[1:], strict=True)
    return octave[mode], [f"{a:.4g} to {b:.4g} Hz" for a, b in pairs]
