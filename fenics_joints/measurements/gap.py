"""Pairs of test and model modes, and how far apart their frequencies are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from fenics_joints.errors import InputError, capable, measured, real, wanted, whole
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.points import Sensors

#: Why a measured mode may have no partner, for messages.
UNLIKE = (
    "does the model lack a component, or are the sensors' places and directions wrong "
    "([test.sees])?"
)
#: MAC below which the order of the modes says more than their shapes; and the MAC that one place in
#: the order is worth then.
ALIKE, _PLACE = 0.5, 0.2
#: MAC that a factor of e in frequency is worth: at few sensors a mode of thirty times the frequency
#: may look the same.
_FAR = 0.1
#: |ln| of a ratio of frequencies from which they are of different modes, or a joint is far off.
_ELSEWHERE = 0.4
#: MAC below which the shapes contradict a pair whose frequencies agree.
CONTRADICTED = 0.2
#: Least number of sensors for MAC: at one sensor all shapes are alike, at two half of them.
_SPEAKING = 3
#: MAC from which shapes make a pair although the frequencies disagree, and the largest |ln| of
#: their ratio then.
_CLEARLY, _FARTHEST = 0.8, 1.0
#: Visibility (see `Modes.visibility`) from which a test is taken to see a mode; and the lower one
#: for a mode that a measured shape clearly matches, and no other mode.
VISIBLE, FAINT = 0.3, 0.05


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Modal assurance criterion between two sets of shapes (Allemang and Brown, 1982).

    Args:
        a: Shapes at the sensors, shape (n_sensors, n_a); nan where a sensor was missing.
        b: Shapes at the same sensors, shape (n_sensors, n_b).

    Returns:
        Values from 0 to 1, shape (n_a, n_b); 0 for a shape that the sensors do not see at all.

    Raises:
        InputError: If these are no numbers, or not of the same sensors.
    """
    a, b = measured("a", a, "iufc"), measured("b", b, "iufc")
    if a.ndim != 2 or b.ndim != 2 or len(a) != len(b):
        raise InputError(
            f"shapes a and b have shapes {a.shape} and {b.shape}: expected a column for each "
            "shape, and as many rows, one for each sensor"
        )
    there = np.isfinite(a)
    a, b = _scaled(np.where(there, a, 0.0)), _scaled(b)
    cross = np.abs(np.conj(a).T @ b) ** 2
    norms = np.sum(np.abs(a) ** 2, axis=0)[:, None] * (there.T.astype(float) @ np.abs(b) ** 2)
    return np.divide(cross, norms, out=np.zeros_like(cross), where=norms > 0)


def _scaled(shapes: np.ndarray) -> np.ndarray:
    """Columns by their largest entries: squares neither overflow nor vanish, whatever the unit."""
    most = np.abs(shapes).max(axis=0, initial=0.0)
    return shapes / np.where(most > 0, most, 1.0)


class TooFewModes(InputError):
    """A model has fewer modes that the test could see than the test has.

    Attributes:
        partnered: Test modes that could have a partner, ascending, by index.
    """

    def __init__(self, message: str, partnered: Sequence[int] = ()):
        super().__init__(message)
        self.partnered = tuple(int(i) for i in partnered)


@dataclass(frozen=True)
class Pairing:
    """Which model mode belongs to which test mode.

    Attributes:
        index: Index of the model mode of each test mode, shape (n_test,).
        visible: All model modes that the test could see, without rigid-body modes; and fainter
            modes that a measured shape matches.
        shapes: The paired model shapes at the sensors, shape (n_sensors, n_test); None without.
        mac: MAC of each pair with what it was matched to; None when matched by order alone.
        crossing: Pairs of test modes that a MAC match puts in another order than the frequency.
    """

    index: np.ndarray
    visible: np.ndarray
    shapes: np.ndarray | None = None
    mac: np.ndarray | None = None
    crossing: tuple[tuple[int, int], ...] = field(default=())

    def __repr__(self) -> str:
        how = "order" if self.mac is None else f"MAC of at least {self.mac.min():.2f}"
        return f"Pairing({len(self.index)} of {len(self.visible)} modes by {how})"


def check_sight(n_test: int, sensors: Sensors | None, threshold: float) -> None:
    """Refuse what cannot say which modes a test saw; arguments of `pair_modes`.

    Raises:
        InputError: Names the argument.
    """
    whole("n_test", n_test)
    real("threshold", threshold, least=0.0, most=1.0)
    if sensors is not None and not isinstance(sensors, Sensors):
        raise wanted("sensors", sensors, "Sensors, or None")


def pair_modes(
    modes: Modes,
    n_test: int,
    sensors: Sensors | None = None,
    *,
    reference: np.ndarray | None = None,
    threshold: float = VISIBLE,
) -> Pairing:
    """Pair the test's modes with the model's.

    Without sensors all elastic modes count as seen and are taken in order. With sensors only the
    modes that move where and as they measure are candidates. With reference shapes (measured, or a
    near model's paired shapes) candidates are matched by MAC: modes that cross are followed, and of
    those that look alike at the sensors the one whose frequency is nearer to that of its place in
    the order counts. Test modes without a match are compared with modes that the sensors see only
    faintly, such as modes that move mainly across the sensors' directions. Test modes that still
    have no match, as after a large change of a joint, are paired by order with the remaining modes:
    the best of poor matches may have several times the frequency. `partnered` says which pairs are
    real.

    Args:
        modes: The model's modes.
        n_test: Number of test modes, the lowest that the test could see.
        sensors: Where and in which direction the test measured.
        reference: Shapes at the sensors to match, shape (n_sensors, n_test); nan in the column of a
            mode that cannot be recognised: it gets one that the others leave.
        threshold: Least visibility, see `Modes.visibility`.

    Raises:
        TooFewModes: If the model has too few modes that the test could see.
        InputError: If an argument is not what it should be.
    """
    capable("modes", modes, ("visibility", "at", "n_rigid"), "modes, as solve_modes gives them")
    check_sight(n_test, sensors, threshold)
    if reference is not None and sensors is None:
        raise InputError("reference: expected sensors too, to say where its shapes are.")
    elastic = np.arange(modes.n_rigid, len(modes))
    if sensors is None:
        _check_enough(elastic, n_test, modes)
        return Pairing(elastic[:n_test], elastic)
    seen = modes.visibility(sensors)[elastic]
    visible, at_sensors = elastic[seen > threshold], modes.at(sensors)
    if reference is None:
        _check_enough(visible, n_test, modes)
        return Pairing(visible[:n_test], visible, at_sensors[:, visible[:n_test]])
    candidates = elastic[seen > min(threshold, FAINT)]
    clear, shapes = np.isin(candidates, visible), at_sensors[:, candidates]
    match = mac(reference, shapes)
    _check_enough(visible, n_test, modes, match[:, clear])
    columns = assigned(match, modes.frequencies_hz[candidates], clear)
    told = match.any(axis=1)
    crossing = tuple(
        (i, i + 1)
        for i in range(n_test - 1)
        if columns[i] > columns[i + 1] and told[i] and told[i + 1]
    )
    agreement, clear[columns] = match[np.arange(n_test), columns], True
    index = candidates[columns]
    return Pairing(index, candidates[clear], shapes[:, columns], agreement, crossing)


def partnered(
    pairing: Pairing,
    model_hz: np.ndarray,
    test_hz: np.ndarray,
    shapes: np.ndarray | None = None,
    *,
    least: float = CONTRADICTED,
) -> np.ndarray:
    """Mask of the test modes that have a partner in a model, (m,), by similarity alone.

    A MAC of 0.8 or more makes a pair, up to a factor of e in frequency: further away some mode
    resembles any shape. Frequencies that agree make a pair unless the shapes contradict it by a MAC
    below ``least``. Frequencies agree within a factor of exp(0.4), 1.5, after removal of a factor
    common to all modes, as from a wrong modulus or unit. Without shapes, or with fewer than three
    sensors, frequencies alone decide.

    Args:
        pairing: From `pair_modes`.
        model_hz: Frequencies of all modes of the model, Hz.
        test_hz: Measured frequencies, Hz, (m,); nan where missing, which contradicts no pair.
        shapes: The measured shapes that were matched, (n_sensors, m); None where modes were paired
            by order, or by shapes of another model.
        least: MAC below which shapes contradict a pair: more than 0.2 in a search over many models,
            some of which resemble any shape by chance.
    """
    slip = np.log(model_hz[pairing.index] / test_hz)
    alike = None if pairing.mac is None or shapes is None else pairing.mac >= _CLEARLY
    # Of modes without a partner the slip says nothing.
    own = slip if alike is None or not np.isfinite(slip[alike]).any() else slip[alike]
    common = np.nanmedian(own) if np.isfinite(own).any() else 0.0
    agrees = ~(np.abs(slip - common) > _ELSEWHERE)
    if alike is None:
        return agrees
    speaks = np.isfinite(shapes).sum(axis=0) >= _SPEAKING
    alike &= ~(np.abs(slip - common) > _FARTHEST)
    contradicted = pairing.mac < least
    return np.where(speaks, alike | agrees & ~contradicted, agrees)


def same_modes(
    modes: Modes, sensors: Sensors | None, shapes: np.ndarray | None, frequencies: np.ndarray
) -> np.ndarray:
    """Modes of a model that correspond to given modes of another, by index, (m,).

    Where several modes look alike to the test, two models may take different ones for the test's.

    Args:
        modes: The model's modes.
        sensors: Where shapes are compared; None takes elastic modes in order.
        shapes: The other model's at the sensors, (n_sensors, m).
        frequencies: The other model's, Hz, (m,).
    """
    elastic = np.arange(modes.n_rigid, len(modes))
    if sensors is None:
        return elastic[: len(frequencies)]
    match = mac(shapes, modes.at(sensors)[:, elastic])
    return elastic[nearest(match, modes.frequencies_hz[elastic], frequencies)]


def nearest(match: np.ndarray, candidates: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Column assigned to each row of MAC values, (m,), for modes of two models that differ little.

    Args:
        match: MAC of modes with candidates, shape (m, n).
        candidates: Frequencies of the candidates, in any unit, (n,).
        frequencies: Those of the modes, (m,).
    """
    return linear_sum_assignment(-likeness(match, candidates, frequencies))[1]


def largest_difference(
    ours: Modes, own: Pairing, theirs: Modes, other: Pairing, sensors: Sensors | None
) -> float:
    """Largest difference of ln f between two models, of all modes that either takes for the test's.

    Corresponding modes are compared, see `same_modes`. A mode that one model lacks has no similar
    one there and shows as a large difference.

    Args:
        ours: Modes of the one model.
        own: Which of them the test's are.
        theirs: Those of the other.
        other: Which of them the test's are.
        sensors: Where the test measured; None where modes are paired by order.
    """
    off = []
    for modes, pairing, beside in ((ours, own, theirs), (theirs, other, ours)):
        hz = modes.frequencies_hz[pairing.index]
        index = same_modes(beside, sensors, pairing.shapes, hz)
        off.append(np.abs(np.log(hz / beside.frequencies_hz[index])).max())
    return float(max(off))


def skipped(measured_hz: np.ndarray, seen_hz: np.ndarray) -> int:
    """How many of a model's lowest modes a test seems to lack, if modes are paired by order alone.

    Joints and tolerances shift all frequencies in one direction, or a little. If the measured ones
    fit the model's only after some of its lowest are skipped, the test lacks these.

    Args:
        measured_hz: Frequencies of the test's modes, ascending, (m,).
        seen_hz: All of the model's that the test could see, ascending, (n,), n >= m.
    """
    m = len(measured_hz)
    far = [
        np.mean(np.abs(np.log(measured_hz / seen_hz[k : k + m])))
        for k in range(len(seen_hz) - m + 1)
    ]
    best = int(np.argmin(far))
    return best if far[0] > _ELSEWHERE and far[best] < far[0] / 2 else 0


def likeness(match: np.ndarray, frequencies: np.ndarray, places: np.ndarray) -> np.ndarray:
    """MAC less a penalty for a frequency far from that of the mode of the same place in the order.

    Args:
        match: MAC of test modes with candidates, shape (..., m, n).
        frequencies: Of the candidates, in any unit, (..., n).
        places: Those of the candidates that each test mode would be by order alone, (..., m).
    """
    log_f, at = (np.log(np.maximum(f, np.finfo(float).tiny)) for f in (frequencies, places))
    return match - _FAR * np.abs(log_f[..., None, :] - at[..., :, None])


def assigned(match: np.ndarray, frequencies: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Column of each row of MAC values, (m,): the most alike, by order where none is like.

    Args:
        match: MAC of test modes with candidates, shape (m, n); a row of 0 for one that cannot be
            recognised: it gets what the others leave.
        frequencies: Of the candidates, ascending, (n,).
        clear: Mask of the modes that the test sees clearly, (n,), at least m; other modes are used
            only for rows that match none of the clear modes.
    """
    told, seen = match.any(axis=1), np.flatnonzero(clear)
    if not told.all():
        return with_untold(assigned(match[told], frequencies, clear), told, seen)
    alike = likeness(match, frequencies, frequencies[seen[: len(match)]])
    columns = seen[linear_sum_assignment(-alike[:, seen])[1]]
    unlike = match[np.arange(len(columns)), columns] < ALIKE
    if not unlike.any():
        return columns
    faint = np.flatnonzero(~clear)
    rows = np.flatnonzero(unlike & (match[:, faint] >= _CLEARLY).any(axis=1))
    if len(rows):
        # Every pair without a clear match costs more than any clear match.
        worth = np.where(match >= _CLEARLY, alike, alike - len(match))[np.ix_(rows, faint)]
        for i, j in zip(*linear_sum_assignment(-worth), strict=True):
            if match[rows[i], faint[j]] >= _CLEARLY:
                columns[rows[i]], unlike[rows[i]] = faint[j], False
    return _by_order_where_unlike(match, columns, unlike, seen)


def with_untold(columns: np.ndarray, told: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Columns of all rows, (m,); rows that cannot be recognised get the first ones left over.

    Args:
        columns: Of the rows that are recognised, (k,).
        told: Which rows are recognised, mask (m,).
        seen: All columns, ascending, (n,), n >= m.
    """
    found = np.empty(len(told), dtype=int)
    found[told] = columns
    found[~told] = np.setdiff1d(seen, columns)[: np.sum(~told)]
    return found


def _by_order_where_unlike(
    match: np.ndarray, columns: np.ndarray, unlike: np.ndarray, seen: np.ndarray
) -> np.ndarray:
    """The columns of an assignment, with poor matches chosen again by order and MAC together.

    Args:
        match: MAC, shape (m, n).
        columns: The assignment, (m,).
        unlike: Mask of the poor matches, (m,).
        seen: Columns of clearly seen modes, ascending, among which the order counts.
    """
    if not unlike.any():
        return columns
    free = np.setdiff1d(seen, columns[~unlike])
    place = []
    for i in np.flatnonzero(unlike):
        # As far behind the next one below that is matched as in the test: the model may have more.
        below = np.flatnonzero(~unlike[:i])
        last = below[-1] if len(below) else -1
        behind = np.searchsorted(seen, columns[last], side="right") - 1 if len(below) else -1
        place.append(behind + i - last)
    cost = _PLACE * np.abs(np.searchsorted(seen, free) - np.array(place)[:, None])
    cost = cost - match[np.ix_(unlike, free)]
    found = columns.copy()
    found[unlike] = free[linear_sum_assignment(cost)[1]]
    return found


def _check_enough(candidates, n_test: int, modes: Modes, match: np.ndarray | None = None) -> None:
    if len(candidates) < n_test:
        top, partnered = modes.frequencies_hz[-1], np.arange(len(candidates))
        if match is not None:
            partnered, _ = linear_sum_assignment(-match)
        raise TooFewModes(
            f"n_modes = {len(modes)}: the model has {len(candidates)} modes below {top:.0f} Hz "
            f"visible to the test; expected at least {n_test}. Compute more modes.",
            partnered,
        )


def rms(relative: np.ndarray) -> float:
    """Root mean square of relative errors; missing (nan) entries are left out."""
    return float(np.sqrt(np.nanmean(np.asarray(relative) ** 2)))


@dataclass(frozen=True)
class Gap:
    """How far a model is from a test, by condition (torque) and mode.

    Attributes:
        conditions: Torque or other condition of each row, shape (n,).
        mode_names: Name of each column, length m.
        test_hz: Measured frequencies, Hz, shape (n, m); nan where missing.
        model_hz: Model frequencies, Hz, shape (n, m).
    """

    conditions: np.ndarray
    mode_names: Sequence[str]
    test_hz: np.ndarray
    model_hz: np.ndarray

    def __repr__(self) -> str:
        rows, columns = self.test_hz.shape
        return f"Gap({100 * self.rms:.3g} % over {rows} conditions of {columns} modes)"

    @property
    def relative(self) -> np.ndarray:
        """Model over test minus one, shape (n, m)."""
        return self.model_hz / self.test_hz - 1.0

    @property
    def rms(self) -> float:
        """The gap: root mean square relative error over all conditions and modes."""
        return rms(self.relative)

    def by_mode(self) -> np.ndarray:
        """Root mean square relative error of each mode, shape (m,)."""
        return np.sqrt(np.nanmean(self.relative**2, axis=0))

    def by_condition(self) -> np.ndarray:
        """Root mean square relative error at each condition, shape (n,)."""
        return np.sqrt(np.nanmean(self.relative**2, axis=1))
