"""Frequency response functions from time records of forces and responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal
from numpy.typing import ArrayLike

from fenics_joints.errors import InputError, member, real, reals

ESTIMATORS = ("H1", "H2", "Hv")
#: How blocks are cut and weighted: Hann's window for random excitation, none for periodic one, and
#: a block from each hit of a hammer.
WINDOWS = ("hann", "rectangular", "hammer")
#: Share of the largest force from which a hammer has hit, and of a block before the hit.
_HIT, _BEFORE = 0.1, 0.02
#: Share of the largest force of a hit from which a second pulse in the same block is a double hit.
_DOUBLE = 0.1
#: Share of a force's largest power below which a line has none: round-off, and lines of a periodic
#: force that are not excited.
_SILENT = 1e-9
#: Numbers in a record at most, chosen for memory.
MOST = 500_000_000


@dataclass(frozen=True)
class TimeSettings:
    """How functions are made of time records.

    Attributes:
        block: Length of a block, s; None for a tenth of the record, or for a hammer up to the next
            hit.
        overlap: Share by which blocks overlap, from 0 to below 1; of a hammer none.
        window: ``hann``, ``rectangular`` or ``hammer``.
        estimator: ``H1`` (noise on the responses), ``H2`` (noise on the force) or ``Hv`` (on both).
        exponential: Time, s, in which an exponential window on force and response falls to 1/e;
            None for none. It adds damping, see ``exponential_window`` of `identify_modes`.
    """

    block: float | None = None
    overlap: float = 0.5
    window: str = "hann"
    estimator: str = "H1"
    exponential: float | None = None

    def __post_init__(self):
        member("window", self.window, WINDOWS)
        member("estimator", self.estimator, ESTIMATORS)
        real("overlap", self.overlap, least=0)
        if not self.overlap < 1:
            raise InputError(f"overlap = {self.overlap:g}: expected less than 1")
        for key in ("block", "exponential"):
            if getattr(self, key) is not None:
                real(key, getattr(self, key), "s", above=0)


@dataclass(frozen=True, eq=False)
class TimeFRFs:
    """Functions from time records.

    Attributes:
        frequencies_hz: Lines, Hz, (n,), the first above 0.
        values: Response over force, in the units of the records, (n, n_responses, n_forces).
        coherence: Of one force the ordinary, of several the multiple one, (n, n_responses).
        averages: Number of averages.
        notes: What was found, in sentences.
    """

    frequencies_hz: np.ndarray
    values: np.ndarray
    coherence: np.ndarray
    averages: int
    notes: tuple[str, ...]


def sampling_rate(times: np.ndarray) -> float:
    """Samples in a second, Hz, of times in equal steps, s.

    Raises:
        InputError: If the steps are not equal.
    """
    steps = np.diff(times)
    if len(steps) < 8 or not np.all(steps > 0):
        raise InputError("time: expected ascending times, s")
    mean = (times[-1] - times[0]) / len(steps)
    if np.abs(steps - mean).max() > 0.01 * mean:
        raise InputError("time: expected equal steps; resample the records")
    return float(1 / mean)


def frfs_from_time(
    rate: float, forces: ArrayLike, responses: ArrayLike, settings: TimeSettings | None = None
) -> TimeFRFs:
    """Functions from forces and responses that were recorded together.

    Averages of auto- and cross-spectra over blocks (Bendat and Piersol, Random Data, 4th ed., ch. 6
    and 7; Hv: Rocklin, Crowley and Vold, Proc. 3rd IMAC, 1985). Several forces are taken together,
    H = S_xf S_ff^-1.

    Args:
        rate: Samples in a second, Hz.
        forces: (n,) or (n, n_forces).
        responses: (n,) or (n, n_responses).
        settings: How; by default Hann's window, ten blocks of half overlap, H1.

    Raises:
        InputError: If records do not fit, are not finite, are too short, or forces are not
            independent.
    """
    s = TimeSettings() if settings is None else settings
    real("rate", rate, "Hz", above=0)
    f, x = (_columns(name, given) for name, given in (("forces", forces), ("responses", responses)))
    if len(f) != len(x):
        raise InputError(f"forces have {len(f)} samples, responses {len(x)}: expected as many")
    if s.estimator != "H1" and f.shape[1] > 1:
        raise InputError(f"estimator = {s.estimator}: expected H1 of {f.shape[1]} forces")
    starts, size, notes = _blocks(rate, f, s)
    weight = scipy.signal.get_window("hann", size) if s.window == "hann" else np.ones(size)
    if s.exponential is not None:
        weight = weight * np.exp(-np.arange(size) / (rate * s.exponential))
    lines = np.fft.rfftfreq(size, 1 / rate)[1:]
    sff = np.zeros((len(lines), f.shape[1], f.shape[1]), complex)
    sxf = np.zeros((len(lines), x.shape[1], f.shape[1]), complex)
    sxx = np.zeros((len(lines), x.shape[1]))
    # What a channel shows at rest: a pulse has a mean of its own.
    rest = np.median if s.window == "hammer" else np.mean
    for start in starts:
        blocks = [each[start : start + size] for each in (f, x)]
        F, X = (
            np.fft.rfft((own - rest(own, axis=0)) * weight[:, None], axis=0)[1:] for own in blocks
        )
        sff += F[:, :, None] * F[:, None].conj()
        sxf += X[:, :, None] * F[:, None].conj()
        sxx += np.abs(X) ** 2
    power = np.einsum("nff->nf", sff).real
    there = np.all(power > _SILENT * power.max(axis=0), axis=1)
    if there.sum() < 8:
        raise InputError("forces: expected force at 8 lines or more")
    if not there.all():
        notes.append(f"{int((~there).sum())} of {len(lines)} lines have no force: left out")
        lines, sff, sxf, sxx = (each[there] for each in (lines, sff, sxf, sxx))
    values, coherence = _estimated(s.estimator, sff, sxf, sxx)
    step = rate / size
    found = (
        f"{f.shape[1]} forces, {x.shape[1]} responses, {len(starts)} averages by {s.estimator}, "
        f"{lines[0]:.4g} to {lines[-1]:.4g} Hz at {step:.4g} Hz"
    )
    return TimeFRFs(lines, values, coherence, len(starts), (found, *notes))


def _columns(name: str, given: ArrayLike) -> np.ndarray:
    found = reals(name, given)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or 0 in found.shape or found.size > MOST:
        raise InputError(f"{name} have shape {found.shape}: expected (n_samples, n_channels)")
    return found


def _blocks(rate: float, f: np.ndarray, s: TimeSettings) -> tuple[list[int], int, list[str]]:
    """First sample of each block, their length, and notes."""
    n = len(f)
    if s.window == "hammer":
        return _hits(rate, f, s)
    size = int(round(rate * s.block)) if s.block is not None else max(2 * n // 11, 1)
    if not 8 <= size <= n:
        raise InputError(
            f"block = {size / rate:.4g} s: expected 8 samples or more, and at most the record, "
            f"{n / rate:.4g} s"
        )
    step = max(1, int(round(size * (1 - s.overlap))))
    starts = list(range(0, n - size + 1, step))
    if len(starts) < max(2, f.shape[1] + 1):
        raise InputError(
            f"the record holds {len(starts)} blocks of {size / rate:.4g} s: expected "
            f"{max(2, f.shape[1] + 1)} or more for coherence; a shorter block"
        )
    return starts, size, []


def _hits(rate: float, f: np.ndarray, s: TimeSettings) -> tuple[list[int], int, list[str]]:
    """Blocks from a little before each hit of a hammer; those that hit twice are left out."""
    if f.shape[1] != 1:
        raise InputError("window = 'hammer': expected one force in a record")
    force = np.abs(f[:, 0] - np.median(f[:, 0]))
    above = np.flatnonzero(force > _HIT * force.max())
    if not len(above):
        raise InputError("the force is zero: expected hits of a hammer")
    size = None if s.block is None else int(round(rate * s.block))
    gap = len(force) // 200 if size is None else size // 2
    hits = above[np.concatenate([[True], np.diff(above) > max(gap, 2)])]
    if size is None:
        ends = np.append(hits[1:], len(force))
        size = int((ends - hits).min())
    before = int(_BEFORE * size)
    good, double = [], 0
    for hit in hits - before:
        if hit < 0 or hit + size > len(force):
            continue
        part = force[hit : hit + size]
        peak = int(part.argmax())
        width = max(int(0.01 * size), 4)
        if part[peak + 2 * width :].max(initial=0.0) > _DOUBLE * part[peak]:
            double += 1
            continue
        good.append(int(hit))
    if not good:
        raise InputError(f"no hit has a block of {size / rate:.4g} s: expected a shorter block")
    notes = [f"{double} double hits were left out"] if double else []
    return good, size, notes


def _estimated(how: str, sff, sxf, sxx) -> tuple[np.ndarray, np.ndarray]:
    if sff.shape[1] == 1:
        ff, xf = np.real(sff[:, 0, 0])[:, None], sxf[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = xf / ff, sxx / xf.conj()
            coherence = np.abs(xf) ** 2 / (ff * sxx)
            sides = {"H1": first, "H2": second, "Hv": np.sqrt(first * second)}
            values = np.abs(sides[how]) * np.exp(1j * np.angle(first))
        if not np.isfinite(values).all():
            raise InputError(f"estimator = {how}: a response is zero at some lines: expected H1")
        return values[:, :, None], np.clip(np.nan_to_num(coherence), 0.0, 1.0)
    if np.any(np.linalg.cond(sff) > 1e10):
        raise InputError("the forces are not independent of each other: expected them uncorrelated")
    values = np.linalg.solve(sff.transpose(0, 2, 1), sxf.transpose(0, 2, 1)).transpose(0, 2, 1)
    explained = np.real(np.einsum("nrf,nrf->nr", values, sxf.conj()))
    return values, np.clip(explained / sxx, 0.0, 1.0)
