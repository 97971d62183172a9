"""Measured frequency response functions: a matrix over frequency, in SI units.

They come from files by `fenics_joints.measurements.files.read_frfs`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.signal import find_peaks

from fenics_joints.errors import InputError, items, measured
from fenics_joints.response.units import KINDS, MOTION, checked_kind
from fenics_joints.structure.points import Sensors

#: How far two points may be apart, relative to the extent of all, to be one.
_SAME_POINT = 1e-6
#: Relative standard deviation of functions whose test says none; and the least that follows from
#: coherence: a coherence of 1 is no perfect test.
_NOISE, _LEAST = 0.05, 1e-3


@dataclass(frozen=True, eq=False)
class MeasuredFRFs:
    """Frequency response functions H(f) of motions by forces, with exp(+i 2 pi f t).

    Attributes:
        frequencies_hz: Hz, shape (n,), ascending.
        values: SI units, shape (n, n_responses, n_references); nan where a pair was not measured.
        kind: ``receptance`` (m/N), ``mobility`` (m/s/N) or ``accelerance`` (m/s2/N).
        response_points: m, shape (n_responses, 3).
        response_directions: Unit vectors, shape (n_responses, 3).
        reference_points: Where the forces were, m, shape (n_references, 3).
        reference_directions: Unit vectors, shape (n_references, 3).
        response_names: Such as ``12:+z``; numbered by default.
        reference_names: The same of the references.
        coherence: Shape of ``values``, nan where not measured; or None.
        sources: Files that they were read from.
        notes: What the files hold that was not used, in words.
    """

    frequencies_hz: np.ndarray
    values: np.ndarray
    kind: str
    response_points: np.ndarray
    response_directions: np.ndarray
    reference_points: np.ndarray
    reference_directions: np.ndarray
    response_names: tuple[str, ...] = ()
    reference_names: tuple[str, ...] = ()
    coherence: np.ndarray | None = None
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        checked_kind(self.kind)
        f = _ascending(self.frequencies_hz)
        values = measured("values", self.values, "iufc").astype(complex)
        if values.ndim != 3 or len(values) != len(f) or 0 in values.shape:
            raise InputError(
                f"values have shape {values.shape}: expected ({len(f)}, n_responses, n_references)"
            )
        missing = np.isnan(values)
        bad = missing.any(axis=0) & ~missing.all(axis=0) | np.isinf(values).any(axis=0)
        if bad.any():
            i, j = np.argwhere(bad)[0]
            raise InputError(f"values of response {i}, reference {j}: expected finite numbers")
        arrays = {"frequencies_hz": f, "values": values}
        for side, n in (("response", values.shape[1]), ("reference", values.shape[2])):
            arrays |= self._checked_side(side, n)
        if self.coherence is not None:
            arrays["coherence"] = _checked_coherence(self.coherence, values.shape)
        for key, value in arrays.items():
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        low, high = self.frequencies_hz[[0, -1]]
        count = f"{int(self.measured.sum())} FRFs, {self.kind}"
        return f"MeasuredFRFs({count}, {low:g} to {high:g} Hz in {len(self)} lines)"

    def _checked_side(self, side: str, n: int) -> dict[str, object]:
        points = measured(f"{side}_points", getattr(self, f"{side}_points"))
        directions = measured(f"{side}_directions", getattr(self, f"{side}_directions"))
        names = items(f"{side}_names", getattr(self, f"{side}_names"), str, "names")
        names = names or tuple(f"{side} {i + 1}" for i in range(n))
        for key, array in (("points", points), ("directions", directions)):
            if array.shape != (n, 3) or not np.isfinite(array).all():
                raise InputError(
                    f"{side}_{key} have shape {array.shape}: expected ({n}, 3) finite numbers"
                )
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        if not (length > 0).all():
            raise InputError(f"{side}_directions: expected vectors that are not zero")
        if len(names) != n or len(set(names)) != n:
            raise InputError(f"{side}_names = {names}: expected {n} names, each once")
        return {
            f"{side}_points": points,
            f"{side}_directions": directions / length,
            f"{side}_names": names,
        }

    # -- what there is -----------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.frequencies_hz)

    def __str__(self) -> str:
        """What there is and how good it is, in a few lines."""
        f, shape = self.frequencies_hz, self.measured.shape
        return "\n".join(
            [
                f"{int(self.measured.sum())} FRFs, {self.kind} in {self.unit}: {shape[0]} "
                f"responses, {shape[1]} references, {f[0]:g} to {f[-1]:g} Hz in {len(f)} lines",
                self.reciprocity_words(),
                self.coherence_words(),
                *self.notes,
            ]
        )

    @property
    def unit(self) -> str:
        """SI unit of the values."""
        return f"{MOTION[self.kind]}/N"

    @property
    def measured(self) -> np.ndarray:
        """Which pairs were measured, shape (n_responses, n_references), bool."""
        return ~np.isnan(self.values[0])

    def sensors(self) -> Sensors:
        """The responses as the suite's sensors."""
        return Sensors(self.response_points, self.response_directions)

    def driving_points(self) -> list[tuple[int, int, int]]:
        """(response, reference, sign) of each measured pair at one point along one line.

        The sign is -1 where the two directions oppose each other.
        """
        there = self.measured
        return [pair for pair in self.same_dofs() if there[pair[:2]]]

    def same_dofs(self) -> list[tuple[int, int, int]]:
        """The same for all pairs, measured or not."""
        points = np.vstack([self.response_points, self.reference_points])
        extent = float(np.ptp(points, axis=0).max()) or 1.0
        apart = np.linalg.norm(self.response_points[:, None] - self.reference_points, axis=2)
        cosine = self.response_directions @ self.reference_directions.T
        same = (apart <= _SAME_POINT * extent) & (np.abs(cosine) >= 1 - 1e-6)
        return [(int(i), int(j), 1 if cosine[i, j] > 0 else -1) for i, j in np.argwhere(same)]

    # -- parts and forms of it ---------------------------------------------------------------------

    def converted(self, kind: str) -> MeasuredFRFs:
        """The same functions as another kind: each derivative by time is a factor i 2 pi f.

        A line at 0 Hz is left out where it would have to be divided by zero.

        Raises:
            InputError: If there is no such kind.
        """
        steps = KINDS[checked_kind(kind)] - KINDS[self.kind]
        kept = self if steps >= 0 else self._lines(self.frequencies_hz > 0)
        factor = (2j * np.pi * kept.frequencies_hz) ** steps
        return replace(kept, kind=kind, values=kept.values * factor[:, None, None])

    def band(self, low: float, high: float) -> MeasuredFRFs:
        """The lines from ``low`` to ``high``, Hz, both included.

        Raises:
            InputError: If there is none.
        """
        lines = self.lines_in([(low, high)])
        if not lines.any():
            raise InputError(
                f"band = [{low:g}, {high:g}] Hz: expected one with measured lines, which go from "
                f"{self.frequencies_hz[0]:g} to {self.frequencies_hz[-1]:g} Hz"
            )
        return self._lines(lines)

    def lines_in(self, bands: Iterable[tuple[float, float]]) -> np.ndarray:
        """Which lines lie in one of the bands, pairs (low, high) in Hz; shape (n,), bool."""
        f = self.frequencies_hz[:, None]
        low, high = np.reshape(list(bands), (-1, 2)).T
        return np.any((f >= low) & (f <= high), axis=1)

    def _part(self, part: Callable[[np.ndarray], np.ndarray], **changes) -> MeasuredFRFs:
        """With a part of the values, and the same of their coherence."""
        coherence = None if self.coherence is None else part(self.coherence)
        return replace(self, values=part(self.values), coherence=coherence, **changes)

    def _lines(self, lines: np.ndarray) -> MeasuredFRFs:
        return self._part(lambda a: a[lines], frequencies_hz=self.frequencies_hz[lines])

    def reciprocal(self) -> MeasuredFRFs:
        """Forces for responses, as is the same to a linear structure (Maxwell's reciprocity)."""
        sides = {
            f"{one}_{key}": getattr(self, f"{other}_{key}")
            for one, other in (("response", "reference"), ("reference", "response"))
            for key in ("points", "directions", "names")
        }
        return self._part(lambda a: a.swapaxes(1, 2), **sides)

    def select(
        self, responses: Sequence[str] | None = None, references: Sequence[str] | None = None
    ) -> MeasuredFRFs:
        """The functions of some responses and references by name, in the order given.

        Raises:
            InputError: For a name that there is not.
        """
        rows = _indices(responses, self.response_names, "response")
        columns = _indices(references, self.reference_names, "reference")
        return self._part(
            lambda a: a[:, rows][:, :, columns],
            response_points=self.response_points[rows],
            response_directions=self.response_directions[rows],
            response_names=tuple(self.response_names[i] for i in rows),
            reference_points=self.reference_points[columns],
            reference_directions=self.reference_directions[columns],
            reference_names=tuple(self.reference_names[j] for j in columns),
        )

    # -- how good it is ----------------------------------------------------------------------------

    def reciprocity(self) -> dict[tuple[str, str], float]:
        """Defects of Maxwell's reciprocity, H_ij = H_ji, of all pairs that were measured both ways.

        Root mean square over frequency of H_ij - H_ji, relative to that of their mean, by the names
        of the degrees of freedom i and j.
        """
        there, found = self.measured, {}
        at: dict[int, tuple[int, int]] = {}  # reference -> (response at the same place, sign)
        for i, j, sign in self.same_dofs():
            at.setdefault(j, (i, sign))
        for a, b in combinations(sorted(at), 2):
            (i, si), (j, sj) = at[a], at[b]
            if there[i, b] and there[j, a]:
                one, other = si * self.values[:, i, b], sj * self.values[:, j, a]
                mean = max(np.linalg.norm(one + other) / 2, np.finfo(float).tiny)
                names = self.reference_names[a], self.reference_names[b]
                found[names] = float(np.linalg.norm(one - other) / mean)
        return found

    def reciprocity_words(self) -> str:
        """The median of the defects of reciprocity, and the largest."""
        found = self.reciprocity()
        if not found:
            return "reciprocity: no pair was measured both ways"
        (i, j), most = max(found.items(), key=lambda item: item[1])
        return (
            f"reciprocity: {len(found)} pairs, defect {np.median([*found.values()]):.2g} in the "
            f"median, {most:.2g} at worst ({i} and {j})"
        )

    def coherence_words(self, limit: float = 0.8) -> str:
        """Median of the coherence, and the share of lines where it is below ``limit``."""
        if self.coherence is None:
            return "coherence: not measured"
        gamma = self.coherence[:, ~np.isnan(self.coherence).all(axis=0)]
        poor = 100 * (gamma < limit).mean(axis=0)
        return (
            f"coherence: {np.median(gamma):.3g} in the median, below {limit:g} at "
            f"{poor.mean():.2g} % of the lines, at {poor.max():.2g} % of the worst function"
        )

    def relative_sd(self, averages: int) -> np.ndarray:
        """Standard deviation of |H|, relative to it, and of its phase, rad; shape of ``values``.

        sqrt((1 - c) / (2 c n)) with coherence c and n independent averages: the random error of
        an H1 estimate (Bendat and Piersol, Random Data, 4th ed., eq. 9.90).

        Raises:
            InputError: If no coherence was measured, or the averages are fewer than two.
        """
        if self.coherence is None:
            raise InputError("coherence is missing: expected it in the files, to know the noise")
        if averages < 2:
            # One average has the coherence 1 whatever the noise.
            raise InputError(f"averages = {averages}: expected 2 or more")
        gamma = np.clip(self.coherence, 1e-12, 1.0)
        return np.sqrt((1 - gamma) / (2 * gamma * averages))

    def stated_sd(self, noise: float | None, averages: int | None) -> np.ndarray:
        """`relative_sd` where averages are given, at least 0.1 %, 1 where it is not known; else the
        noise, 5 % unless given; shape of ``values``.

        Raises:
            InputError: See `relative_sd`.
        """
        if averages is None:
            return np.full(self.values.shape, _NOISE if noise is None else noise)
        return np.maximum(np.nan_to_num(self.relative_sd(averages), nan=1.0), _LEAST)


def _ascending(frequencies) -> np.ndarray:
    f = measured("frequencies_hz", frequencies)
    if f.ndim != 1 or not len(f) or not np.isfinite(f).all() or f[0] < 0 or (np.diff(f) <= 0).any():
        raise InputError(
            "frequencies_hz: expected a list of finite frequencies from 0 Hz on, each above the "
            "one before"
        )
    return f


def _checked_coherence(coherence, shape) -> np.ndarray:
    gamma = measured("coherence", coherence)
    if gamma.shape != shape:
        raise InputError(f"coherence has shape {gamma.shape}: expected {shape}, that of the values")
    if np.isinf(gamma).any() or (gamma < -1e-6).any() or (gamma > 1 + 1e-6).any():
        raise InputError(
            f"coherence goes from {np.nanmin(gamma):g} to {np.nanmax(gamma):g}: expected 0 to 1"
        )
    return np.clip(gamma, 0.0, 1.0)


def _indices(wanted: Sequence[str] | None, names: tuple[str, ...], what: str) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    for name in wanted:
        if name not in names:
            there = ", ".join(names)
            raise InputError(f"{what} {name!r} was not measured; expected one of {there}")
    return [names.index(name) for name in wanted]


# -- lines that say most ---------------------------------------------------------------------------


#: Share of the lines that is spread evenly over ln f, so that no part of the band is left out.
_EVEN = 0.3
#: A resonance stands out by this in the sum of |H|^2: 6 dB.
_PROMINENCE = np.log(4.0)


def choose_lines(
    frequencies_hz: np.ndarray,
    values: np.ndarray,
    n: int,
    *,
    relative_sd: float | np.ndarray = 0.0,
    allowed: np.ndarray | None = None,
    peaks: bool = True,
) -> np.ndarray:
    """Lines at equal steps along the curve of all ln H: dense on flanks and at antiresonances.

    A step's length is the root mean square over the functions of the change of the complex ln H,
    less what noise alone would make of it; a share of the steps is even in ln f.

    Args:
        frequencies_hz: Lines, Hz, above 0 where allowed, shape (n_f,).
        values: Functions, shape (n_f, n_responses, n_references); nan where not measured.
        n: How many lines; all allowed ones if there are fewer.
        relative_sd: Relative standard deviation, a number or of the values' shape.
        allowed: Which lines may be taken, shape (n_f,), bool; all above 0 Hz by default.
        peaks: Whether lines within the half-power width of a resonance may be taken. They measure
            the damping more than anything else: not if that is not to be found.

    Returns:
        Indices of the lines, ascending.

    Raises:
        InputError: If no line is allowed.
    """
    f = np.asarray(frequencies_hz, dtype=float)
    there = f > 0 if allowed is None else np.asarray(allowed, dtype=bool) & (f > 0)
    if not peaks:
        off = there & ~near_peaks(values)
        there = off if off.any() else there
    index = np.flatnonzero(there)
    if not len(index):
        raise InputError("lines: expected measured lines above 0 Hz that are not held out")
    if len(index) <= n:
        return index
    along = _length(values[index], np.broadcast_to(relative_sd, values.shape)[index])
    even = np.log(f[index] / f[index[0]])
    place = (1 - _EVEN) * along / (along[-1] or 1.0) + _EVEN * even / even[-1]
    return index[_spread(place, n)]


def _length(values: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Length of the curve of all ln H up to each line."""
    used = np.isfinite(values[0])
    log_h = np.log(np.where(values == 0, np.finfo(float).tiny, values))[:, used]
    sd = sd[:, used]
    step = np.abs(np.exp(1j * np.diff(log_h.imag, axis=0)) - 1) ** 2
    step += np.diff(log_h.real, axis=0) ** 2
    noise = 2 * (sd[1:] ** 2 + sd[:-1] ** 2)
    size = np.sqrt(np.mean(np.maximum(step - noise, 0.0), axis=1))
    return np.concatenate([[0.0], np.cumsum(size)])


def _spread(place: np.ndarray, n: int) -> np.ndarray:
    """n different indices about evenly spaced in an ascending quantity."""
    for count in range(n, len(place) + 1):
        at = np.unique(np.searchsorted(place, np.linspace(0, place[-1], count)))
        if len(at) >= n:
            break
    else:
        at = np.arange(len(place))
    drop = np.linspace(0, len(at) - 1, n).round().astype(int)
    return np.minimum(at[drop], len(place) - 1)


def near_peaks(values: np.ndarray) -> np.ndarray:
    """Which lines lie within the half-power width of a resonance, shape (n_f,), bool.

    Args:
        values: Functions, shape (n_f, n_responses, n_references); nan where not measured.
    """
    energy = np.nansum(np.abs(values) ** 2, axis=(1, 2))
    near = np.zeros(len(energy), dtype=bool)
    positive = np.maximum(energy, np.finfo(float).tiny)
    tops, _ = find_peaks(np.log(positive), prominence=_PROMINENCE)
    for top in tops:
        low = high = int(top)
        while low > 0 and energy[low - 1] > 0.5 * energy[top]:
            low -= 1
        while high < len(energy) - 1 and energy[high + 1] > 0.5 * energy[top]:
            high += 1
        near[low : high + 1] = True
    return near
