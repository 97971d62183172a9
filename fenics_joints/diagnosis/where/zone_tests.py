"""Where the gap lies: tests of zones against chance, and what of the misfit lies along each axis.

The residual of the nominal model is r = data - prediction. If nothing but noise, the error that
any model has, and nuisances within their tolerance are at work, then r ~ N(0, C) with
C = Sigma + N N^T, N being the derivatives by the nuisances in prior standard deviations. With
C = L L^T everything is whitened: r~ = L^-1 r, S~ = L^-1 S. Nuisances are so projected out as far
as their prior lets them move and no further: an infinitely wide prior would be the orthogonal
projector of Basseville and Nikiforov (CDC 2005), which would give a tolerance of one per cent the
same freedom as an unknown modulus.

A zone's statistic t = r~^T S~ (S~^T S~)^-1 S~^T r~ is chi-square with rank(S~) degrees of freedom
under any turning of its columns. The minmax statistic (Doehler, Mevel and Zhang, Annu. Rev. Control
42, 2016, 244) is the same with the other zones projected out of the zone's columns, flatly: it
stays chi-square whatever the others do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.entries import KINDS
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.where.spans import outside, visible_part
from fenics_joints.errors import InputError

__all__ = ["Attribution", "ZoneTest", "attribution", "holm", "whitened", "zone_tests"]

#: Whitened length, in standard deviations of the data, that a change of the expected size must have
#: for it to be tested at all: less costs a degree of freedom and can gain nothing.
_VISIBLE = 0.1
#: Cosine of the angle to the other zones' span from which on a zone is not told from them.
_ALIKE = 0.98


@dataclass(frozen=True)
class ZoneTest:
    """Whether the test speaks of a change in a zone.

    Attributes:
        zone: Name of the zone.
        dof: Degrees of freedom of ``statistic``; 0 for a zone that the test does not see.
        statistic: Part of the squared whitened residual that a change in this zone alone could
            explain.
        p: Probability of as much by chance.
        p_adjusted: The same by Holm's step-down procedure for the number of zones tested.
        share: ``statistic`` as a share of the whole squared whitened residual, 0 to 1.
        rest_p: Probability that chance leaves as much unexplained as a change in this zone alone
            does; small where it cannot be the only one.
        visibility: Length, in standard deviations of the data, of the largest response to a
            change of its parameters by the expected size (the sensitivities' columns).
        change: The change that explains most, in columns of the sensitivities, (k,); none in a
            direction that is not seen.
        minmax: The statistic with the other zones projected out, all but ``alike``.
        minmax_dof: Its degrees of freedom.
        minmax_p: Its p.
        minmax_p_adjusted: The same by Holm.
        separable: Whether some change in this zone could not be made by the others.
        alike: Zones that it cannot be told from where it is not; a pair each alone, else jointly.
    """

    zone: str
    dof: int
    statistic: float
    p: float
    p_adjusted: float
    share: float
    rest_p: float
    visibility: float
    change: tuple[float, ...]
    minmax: float
    minmax_dof: int
    minmax_p: float
    minmax_p_adjusted: float
    separable: bool
    alike: tuple[str, ...] = ()


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

    Raises:
        InputError: If an array has another number of rows.
    """
    used = np.ravel(evidence.fitted)
    for array in (*arrays, *(() if nuisance is None else (nuisance,))):
        if len(array) != len(used):
            raise InputError(f"{len(array)} rows: expected {len(used)}, one for each datum.")
    lower = np.linalg.cholesky(_covariance(evidence, nuisance))
    return [whiten(lower, np.asarray(a)[used]) for a in arrays]


def _covariance(evidence: Evidence, nuisance: np.ndarray | None) -> np.ndarray:
    covariance = evidence.covariance()
    if nuisance is not None and nuisance.size:
        used = np.asarray(nuisance)[np.ravel(evidence.fitted)]
        covariance = covariance + used @ used.T
    return covariance


def holm(p: Sequence[float]) -> np.ndarray:
    """P-values adjusted for their number so that any false alarm keeps its level.

    Step-down: the i-th smallest (from 0) times n - i, made non-decreasing and at most 1 (Holm,
    Scand. J. Statist. 6, 1979); it holds under any dependence.
    """
    p = np.asarray(p, dtype=float)
    order = np.argsort(p, kind="stable")
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return adjusted


# -- zones -----------------------------------------------------------------------------------


def zone_tests(
    residual: np.ndarray,
    sensitivities: Mapping[str, np.ndarray],
    nuisance: np.ndarray | None,
    evidence: Evidence,
    *,
    visible: float = _VISIBLE,
) -> list[ZoneTest]:
    """Test every zone for a change, alone and with the others free.

    Args:
        residual: Data minus the nominal model's prediction, (N,); entries that are not fitted are
            not looked at.
        sensitivities: For each zone the change of the prediction by a change of the expected size
            of each of its parameters, (N, k).
        nuisance: Derivatives by the nuisances in prior standard deviations, (N, p), or None.
        evidence: The test.
        visible: Visibility below which a combination of a zone's parameters is not tested, nor a
            zone that has no other.

    Returns:
        A test for each zone, in the order of ``sensitivities``.

    Raises:
        InputError: If shapes do not agree.
    """
    if not sensitivities:
        return []
    r, *columns = whitened(evidence, nuisance, residual, *sensitivities.values())
    zones = dict(zip(sensitivities, columns, strict=True))
    parts = {zone: visible_part(S, visible) for zone, S in zones.items()}
    bases = {zone: U for zone, (U, _, _) in parts.items() if U.shape[1]}
    alone = {zone: _score(r, Q) for zone, Q in bases.items()}
    apart = {zone: _others_out(r, zone, bases) for zone in bases}
    adjusted = dict(zip(bases, holm([p for _, _, p in alone.values()]), strict=True))
    stepped = dict(zip(bases, holm([p for _, _, p, _ in apart.values()]), strict=True))
    found = []
    for zone in zones:
        U, lengths, turn = parts[zone]
        change = turn.T @ (U.T @ r / lengths)
        t, dof, p = alone.get(zone, (0.0, 0, 1.0))
        least, least_dof, least_p, alike = apart.get(zone, (0.0, 0, 1.0, ()))
        found.append(
            ZoneTest(
                zone, dof, t, p,
                p_adjusted=float(adjusted.get(zone, 1.0)),
                share=float(t / max(r @ r, 1e-300)),
                rest_p=float(chi2.sf(max(r @ r - t, 0.0), len(r) - dof)) if len(r) > dof else 1.0,
                visibility=float(np.linalg.norm(zones[zone], 2)) if zones[zone].size else 0.0,
                change=tuple(float(c) for c in change),
                minmax=least, minmax_dof=least_dof, minmax_p=least_p,
                minmax_p_adjusted=float(stepped.get(zone, 1.0)),
                separable=zone in bases and not alike,
                alike=alike,
            )
        )  # fmt: skip
    return found


def _score(r: np.ndarray, Q: np.ndarray) -> tuple[float, int, float]:
    """Statistic, degrees of freedom and p on an orthonormal basis."""
    t, dof = float(np.sum((Q.T @ r) ** 2)), Q.shape[1]
    return t, dof, float(chi2.sf(t, dof)) if dof else 1.0


def _others_out(r, zone: str, bases: Mapping[str, np.ndarray]):
    """Minmax statistic, degrees of freedom, p, and the zones that could not be projected out.

    Where the others span (nearly) all that the zone can do, the fewest of them that do so, found
    one by one, stay in: the statistic then speaks of the zone and these together.
    """
    Q, alike = bases[zone], []
    while True:
        others = [name for name in bases if name != zone and name not in alike]
        left, sines = outside(Q, [bases[name] for name in others])
        kept = left[:, sines > np.sqrt(1 - _ALIKE**2)]
        if kept.shape[1] or not others:
            return *_score(r, kept), tuple(alike)
        alike += _mimics(Q, {name: bases[name] for name in others})


def _mimics(Q: np.ndarray, others: Mapping[str, np.ndarray]) -> list[str]:
    """Fewest zones, chosen greedily, whose span holds that of Q up to the limit of likeness."""
    chosen: list[str] = []
    while len(chosen) < len(others):
        rest = [name for name in others if name not in chosen]
        left = {
            name: outside(Q, [others[c] for c in (*chosen, name)])[1] for name in rest
        }
        # Rounded, so that the first of those that are alike by symmetry is chosen on any machine.
        best = min(rest, key=lambda name: round(float(np.sum(left[name] ** 2)), 5))
        chosen.append(best)
        if np.all(left[best] <= np.sqrt(1 - _ALIKE**2)):
            break
    return chosen


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

    Raises:
        InputError: If ``by`` is none of these.
    """
    if by != "kind" and evidence.scalars and len(residual) == len(evidence.data):
        evidence = replace(evidence, scalars=())
        residual = residual[: len(evidence.data)]
        nuisance = None if nuisance is None else nuisance[: len(residual)]
    used = np.ravel(evidence.fitted)
    if len(residual) != len(used):
        raise InputError(f"residual: {len(residual)} rows: expected {len(used)}.")
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
    if by == "band":
        hz = np.exp(np.nanmean(evidence.log_f, axis=0))
        low = float(np.nanmin(hz))
        octave = np.floor(np.log2(np.where(np.isfinite(hz), hz, low) / low) + 1e-9).astype(int)
        edges = low * 2.0 ** np.arange(max(octave) + 2)
        pairs = zip(edges[:-1], edges[1:], strict=True)
        return octave[mode], [f"{a:.4g} to {b:.4g} Hz" for a, b in pairs]
    raise InputError(f"by = {by!r}: expected 'mode', 'band', 'condition' or 'kind'.")
