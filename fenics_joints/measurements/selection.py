"""Number of modes in measured functions: as many as stand out of the functions' noise.

Modes are added where the residual exceeds the noise, as long as the Bayesian information criterion
(Schwarz, Ann. Stat. 6, 1978) accepts their unknowns; what remains in the end is reported. Noise
jumps from line to line; a mode, or an error, is smooth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.measurements.poles import (
    FRFColumns,
    ModeFit,
    fit_modes,
    fitted,
    free_residues,
    rank_one,
    smooth,
)

#: Relative standard deviation of the damping above which a pole is noise.
_DOUBTFUL = 0.5
#: Ratio of residual to noise from which the residual is looked at; and by how many of its standard
#: deviations it has to exceed pure noise.
_ABOVE, _SURE = 1.5, 5.0
#: Damping of a trial mode, relative to that of the others, and damping if there are no others.
_DAMPING, _USUAL = (0.5, 1.0, 2.0), 0.01
#: How far outside the band, as a share of it, modes are still counted: their flanks are inside.
_OUTSIDE = 0.25
#: How far apart poles of one mode in different rows can be, in half-widths.
_DOUBLE = 3.0
#: Half-widths about a pole within which each row is fitted with its own pole.
_WIDE = 20.0
#: Failed places after which the search stops, lines per place, and number of notes.
_TRIES, _AROUND, _MOST_NOTES = 5, 10, 4


def select_modes(
    functions: FRFColumns, poles: np.ndarray, max_damping: float, names: Sequence[str]
) -> tuple[ModeFit | None, list[str]]:
    """The modes that the functions show, beginning with given ones; and what is doubtful.

    Args:
        functions: The functions.
        poles: rad/s, shape (m,); may be none.
        max_damping: Damping ratio above which a pole is no mode.
        names: Names of the responses.

    Returns:
        The fit, with modes a little outside the band, None if there is no mode; and notes.
    """
    fit = fit_modes(functions, poles) if len(poles) else None
    vain, tries = np.zeros(len(functions.f), dtype=bool), 0
    while tries < _TRIES:
        level, least = _level(functions, _rest(functions, fit))
        at = int(np.argmax(np.where(vain, 0.0, level)))
        if vain[at] or level[at] <= least:
            break
        more = _one_more(functions, fit, at)
        if _better(functions, fit, more, max_damping):
            fit = more
            continue
        tries += 1
        around = np.abs(functions.f - functions.f[at])
        vain |= around <= max(np.sort(around)[_AROUND], _USUAL * functions.f[at])
    if fit is not None:
        fit = _certain(functions, fit, max_damping)
    if fit is not None:
        fit = _without_doubles(functions, fit, max_damping)
    return _with_notes(functions, fit, names)


def _rest(functions: FRFColumns, fit: ModeFit | None) -> np.ndarray:
    return free_residues(functions, np.zeros(0))[0] if fit is None else fit.rest


def _certain(functions: FRFColumns, fit: ModeFit, max_damping: float) -> ModeFit | None:
    """The fit without poles that are no modes, the worst removed first.

    A pole with uncertain damping stays if it is worth its unknowns.
    """
    good = _is_mode(functions, fit, max_damping)
    doubt = fit.damping_sd / np.maximum(np.abs(fit.damping), 1e-300)
    doubt = np.where(good, doubt, np.inf)
    for r in np.argsort(-doubt):
        if doubt[r] < _DOUBTFUL:
            break
        kept = np.arange(len(doubt)) != r
        fewer = (
            fit_modes(functions, fit.poles[kept], fit.references[:, kept]) if kept.any() else None
        )
        if not good[r] or not _pays(functions, fewer, fit)[0]:
            return None if fewer is None else _certain(functions, fewer, max_damping)
    return fit


def _without_doubles(functions: FRFColumns, fit: ModeFit, max_damping: float) -> ModeFit:
    """The fit with one pole where several are one mode whose pole differs from row to row."""
    apart = np.abs(fit.poles[:, None] - fit.poles) + np.diag(np.full(len(fit.poles), np.inf))
    r = int(np.argmin(apart.min(axis=1) / np.abs(fit.poles.real)))
    if apart[r].min() > _DOUBLE * np.abs(fit.poles[r].real):
        return fit
    for one in (r, int(np.argmin(apart[r]))):
        kept = np.arange(len(fit.poles)) != one
        order = np.append(np.flatnonzero(kept), one)
        fewer = fit_modes(functions, fit.poles[kept], fit.references[:, kept])
        more = replace(fit, poles=fit.poles[order], damping_sd=fit.damping_sd[order])
        if not _better(functions, fewer, more, max_damping):
            return _without_doubles(functions, fewer, max_damping)
    return fit


def _is_mode(functions: FRFColumns, fit: ModeFit, max_damping: float) -> np.ndarray:
    damping, f = fit.damping, fit.frequencies_hz
    room = _OUTSIDE * np.ptp(functions.f)
    inside = (f >= functions.f[0] - room) & (f <= functions.f[-1] + room)
    return inside & (damping > 0) & (damping < max_damping)


def _noise(rest: np.ndarray) -> np.ndarray:
    """Size of the noise, a product of parts of lines and of functions, shape (n, K)."""
    rough = np.full(rest.shape, np.nan)
    rough[1:-1] = np.abs(np.diff(rest, 2, axis=0)) ** 2 / 6
    rough[[0, -1]] = rough[[1, -2]]
    over = np.ones((len(rest), 1))
    for _ in range(2):
        of_function = np.maximum((rough / over).mean(axis=0), 1e-300)
        over = smooth((rough / of_function).mean(axis=1, keepdims=True))
        over = np.maximum(over, 1e-6 * over.mean() + 1e-300)
    return np.sqrt(over * of_function)


def _level(functions: FRFColumns, rest: np.ndarray) -> tuple[np.ndarray, float]:
    """Residual over noise, shape (n,); and the level above which it is not noise.

    An analyser's windows correlate the noise of neighbouring lines; the noise level is that of
    most of the band.
    """
    ratio = (np.abs(rest) ** 2 / _floored(functions, _noise(rest)) ** 2).mean(axis=1)
    level = np.sqrt(smooth(ratio))
    level = level / max(1.0, float(np.median(level)))
    return level, max(_ABOVE, 1 + _SURE * 0.2 / np.sqrt(rest.shape[1]))


def _floored(functions: FRFColumns, noise: np.ndarray) -> np.ndarray:
    """The noise, at least 1e-5 of the measured values: no test is better."""
    return np.hypot(noise, 1e-5 * np.abs(functions.values))


def _one_more(functions: FRFColumns, fit: ModeFit | None, at: int) -> ModeFit:
    """The fit with one more mode near a line, which removes most of the residual there."""
    rest, f = _rest(functions, fit), functions.f
    damping = _USUAL if fit is None else float(np.median(fit.damping))
    near = np.unique(np.clip(at + np.arange(-6, 7, 2), 0, len(f) - 1))
    left = replace(functions, values=rest)
    noise, best = _noise(rest), (-np.inf, None, None)
    for z in damping * np.array(_DAMPING):
        for one in f[near]:
            pole = 2 * np.pi * one * (-z + 1j * np.sqrt(1 - z**2))
            after, residues = free_residues(left, np.array([pole]))
            gain = ((np.abs(rest) ** 2 - np.abs(after) ** 2) / noise**2).sum()
            if gain > best[0]:
                best = (gain, pole, residues)
    _, pole, residues = best
    reference = rank_one(functions, residues)
    if fit is None:
        return fit_modes(functions, np.array([pole]), reference)
    return fit_modes(functions, np.append(fit.poles, pole), np.hstack([fit.references, reference]))


def _better(functions: FRFColumns, fit: ModeFit | None, more: ModeFit, max_damping: float) -> bool:
    """Whether the last mode explains the residual of a fit without it.

    And explains it better than one pole per row, or one scale per function, would.
    """
    if not _is_mode(functions, more, max_damping)[-1]:
        return False
    n_rows, size = functions.n_rows, np.log(2 * functions.values.size)
    pays, misfit, price = _pays(functions, fit, more)
    if not pays:
        return False
    if fit is None:
        return True
    by_scales = misfit(_scaled(functions, fit)[0]) + size * 2 * fit.rest.shape[1]
    if misfit(more.rest) + price > by_scales:
        return False
    if n_rows == 1:
        return True
    pole = more.poles[-1]
    away = np.abs(2 * np.pi * functions.f - pole.imag) / np.abs(pole.real)
    lines = away <= max(6.0, np.sort(away)[min(_AROUND, len(away) - 1)])
    wide = np.flatnonzero(away <= max(_WIDE, np.sort(away)[min(6 * _AROUND, len(away) - 1)]))
    own = fit.rest.copy()
    part, near = _part(functions, fit, wide)
    if len(near.poles):
        own[wide] = _own_poles(part, near)[0]
    by_own = misfit(own, lines) + size * 2 * n_rows
    return misfit(more.rest, lines) + price <= by_own


def _scaled(functions: FRFColumns, fit: ModeFit) -> tuple[np.ndarray, np.ndarray]:
    """Residual with one scale per function, (n, K), and the scales, (K,)."""
    fitted = functions.values - fit.rest
    weight = 1 / _floored(functions, _noise(fit.rest)) ** 2
    above, below = ((weight * fitted.conj() * x).sum(axis=0) for x in (fit.rest, fitted))
    more = above / below
    return fit.rest - more * fitted, 1 + more


def _pays(
    functions: FRFColumns, fit: ModeFit | None, more: ModeFit
) -> tuple[bool, Callable[..., float], float]:
    """Whether one more mode is worth its unknowns; the residual's misfit, and their price."""
    rest, noise = _rest(functions, fit), _floored(functions, _noise(more.rest))
    level = np.sqrt(smooth((np.abs(more.rest) ** 2 / noise**2).mean(axis=1)))
    noise = noise * max(1.0, float(np.median(level)))
    price = np.log(2 * functions.values.size) * 2 * sum(functions.shape)

    def misfit(rest: np.ndarray, lines=slice(None)) -> float:
        return 2 * float((np.abs(rest[lines]) ** 2 / noise[lines] ** 2).sum())

    return misfit(rest) - misfit(more.rest) >= price, misfit, price


def _part(functions: FRFColumns, fit: ModeFit, lines: np.ndarray) -> tuple[FRFColumns, ModeFit]:
    """Some lines and the modes there; the fitted contributions of other modes are subtracted."""
    f = functions.f[lines]
    kept = (fit.frequencies_hz >= f[0]) & (fit.frequencies_hz <= f[-1])
    near = replace(
        fit,
        poles=fit.poles[kept],
        responses=fit.responses[:, kept],
        references=fit.references[:, kept],
        rest=fit.rest[lines],
    )
    part = replace(functions, f=f, values=functions.values[lines])
    return replace(part, values=near.rest + fitted(part, near)), near


def _own_poles(functions: FRFColumns, fit: ModeFit) -> tuple[np.ndarray, list[ModeFit]]:
    """Residual with one set of poles per row, (n, K), and the fits.

    A pole that leaves its peak, or is uncertain in a row, keeps its common value.
    """
    rest, fits = fit.rest.copy(), []
    for row in np.unique(functions.rows):
        own, room = functions.of_row(row), np.abs(fit.poles.real)
        for _ in range(len(room)):
            one = fit_modes(own, fit.poles, fit.references, fixed=True, room=room)
            left = np.abs(one.poles - fit.poles) > _DOUBLE * np.abs(fit.poles.real)
            if not left.any():
                break
            room = np.where(left, 1e-6 * room, room)
        rest[:, functions.rows == row] = one.rest
        fits.append(one)
    return rest, fits


# -- notes -----------------------------------------------------------------------------------------


def _with_notes(
    functions: FRFColumns, fit: ModeFit | None, names: Sequence[str]
) -> tuple[ModeFit | None, list[str]]:
    if fit is None:
        return None, []
    notes = []
    level, least = _level(functions, fit.rest)
    if (level > least).any():
        fit, notes = _other_scales(functions, fit, names)
    if functions.n_rows > 1 and (level > least).any() and not notes:
        fit, notes = _apart(functions, fit, names)
    level, least = _level(functions, fit.rest)
    parts = np.split(np.arange(len(level)), np.flatnonzero(np.diff(level > least)) + 1)
    parts = [part for part in parts if level[part[0]] > least]
    parts.sort(key=lambda part: -level[part].max())
    for part in parts[:_MOST_NOTES]:
        low, high = functions.f[part[[0, -1]]]
        notes.append(
            f"the residual at {low:.5g} to {high:.5g} Hz is {level[part].max():.3g} times the "
            "noise: a mode may be missing there, or the FRFs contradict each other"
        )
    if len(parts) > _MOST_NOTES:
        notes.append(f"the residual exceeds the noise in {len(parts) - _MOST_NOTES} more ranges")
    return fit, notes


def _explains(functions: FRFColumns, before: np.ndarray, after: np.ndarray, unknowns: int) -> bool:
    """Whether more unknowns are worth it and remove most of the residual."""
    noise = _floored(functions, _noise(after))
    size, less = (2 * ((np.abs(one) / noise) ** 2).sum() for one in (before, after))
    return size - less > max(np.log(2 * after.size) * unknowns, 0.5 * (size - 2 * after.size))


def _other_scales(
    functions: FRFColumns, fit: ModeFit, names: Sequence[str]
) -> tuple[ModeFit, list[str]]:
    rest, scales = _scaled(functions, fit)
    if not _explains(functions, fit.rest, rest, 2 * len(scales)):
        return fit, []
    k = int(np.argmax(np.abs(scales - 1)))
    note = (
        f"{names[functions.rows[k]]}: its FRF by force {functions.columns[k] + 1} is "
        f"{100 * np.abs(scales[k] - 1):.2g} % off the value that the other FRFs give: did the "
        "scale of a sensor or force change between FRFs?"
    )
    for _ in range(2):
        functions = replace(functions, values=functions.values / scales)
        fit = fit_modes(functions, fit.poles, fit.references)
        scales = _scaled(functions, fit)[1]
    return fit, [note]


def _apart(functions: FRFColumns, fit: ModeFit, names: Sequence[str]) -> tuple[ModeFit, list[str]]:
    """The fit with the mean of the rows' own poles, if separate poles fit better."""
    rest, fits = _own_poles(functions, fit)
    n_rows, m = functions.n_rows, len(fit.poles)
    if not _explains(functions, fit.rest, rest, 2 * m * (n_rows - 1)):
        return fit, []
    f, z = (np.array([getattr(one, key) for one in fits]) for key in ("frequencies_hz", "damping"))
    sd_f = np.array([one.frequencies_sd for one in fits])
    sd_z = np.array([one.damping_sd for one in fits])
    mean_f, scatter_f = _mean(f, sd_f)
    mean_z, scatter_z = _mean(z, sd_z)
    r = int(np.argmax(scatter_f / mean_f))
    known = sd_f[:, r] < 3 * np.median(sd_f[:, r])
    low, high = (pick(np.where(known, f[:, r], np.nan)) for pick in (np.nanargmin, np.nanargmax))
    note = (
        f"{mean_f[r]:.5g} Hz: poles differ from sensor to sensor, {f[low, r]:.5g} Hz at "
        f"{names[low]} and {f[high, r]:.5g} Hz at {names[high]}: does the accelerometer's mass "
        "shift it?"
    )
    fit = replace(
        fit,
        poles=2 * np.pi * mean_f * (-mean_z + 1j * np.sqrt(1 - mean_z**2)),
        rest=rest,
        responses=np.vstack([one.responses for one in fits]),
        frequencies_sd=np.hypot(fit.frequencies_sd, scatter_f),
        damping_sd=np.hypot(fit.damping_sd, scatter_z),
        residual=float(np.linalg.norm(rest) / np.linalg.norm(functions.values)),
    )
    return fit, [note]


def _mean(values: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean over rows, and the distance of the farthest well-known row from it.

    If the sensors' mass shifts a mode, no row may have the structure's own frequency: the mean is
    no better than the farthest row.
    """
    weight = 1 / np.maximum(sd, 1e-300) ** 2
    mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
    known = sd <= 3 * np.median(sd, axis=0)
    return mean, np.where(known, np.abs(values - mean), 0.0).max(axis=0)
