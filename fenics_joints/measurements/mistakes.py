"""Mistakes in the tables of a test: copied modes, wrong units, columns and rows in another order,
sensors that are dead, flipped or exchanged. Some show in the test alone, most against a model.

A model's joints may be far off. So model and test may differ without a mistake: one is reported
only if undoing it, and nothing else, makes them agree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import ALIKE, Pairing, mac, partnered
from fenics_joints.measurements.measured_shapes import in_order

#: Frequency ratios from common slips, with the cause of each.
_SLIPS = {
    2 * math.pi: "rad/s and Hz",
    1000.0: "Hz and kHz, m and mm",
    10.0: "the decimal point",
    2.0: "a factor of two",
    60.0: "per minute and Hz",
    100.0: "the decimal point",
    math.sqrt(1000.0): "a modulus or a density a thousand times off",
    math.sqrt(10.0): "a modulus or a density ten times off",
}
#: How close a ratio is to a slip's; the joints may be off as well.
_NEAR = 0.1
#: Share of the misfit (root mean square of ln f, test to model) that may remain when a mistake is
#: undone, and the misfit below which no mistake is looked for.
_LEFT, _FITS = 1 / 3, 0.1
#: ln of the ratio from which a single mode is off.
_OUTLIER = math.log(1.4)
#: Factor by which no joint shifts the median frequency.
_LARGEST_SHIFT = 2.5
#: Share of the strain energy in joints from which they may cause such a shift.
_JOINTS = 0.5
#: Relative distance of equal frequencies, and MAC of equal shapes.
_EQUAL, _SAME = 1e-6, 0.99
#: ln of a jump that no joint makes at one torque and undoes at the next.
_JUMP = 0.1
#: Number of modes below which they fit anywhere.
_FEW = 4
#: Share of the usual motion below which a sensor is silent; and below which the model's motion is
#: too weak to tell whether the sensor is right.
_SILENT, _WEAK = 1e-3, 0.2
#: MAC from which a pair tells the right frequency.
_CLEARLY = 0.8
#: Misfit of shapes, 1 - MAC, below which no mistake is looked for; and numbers of sensors.
_POOR, _SENSORS = 0.05, range(6, 301)
#: Number of sensors up to which exchanges of two are tried; among more, two hardly matter.
_PAIRS = 40
#: Gain of a sensor, relative to the others, that no error of the model explains.
_GAIN = 6.0
#: Root of a sensor's signed COMAC with the model below which its direction is reversed.
_OTHER = -0.6


def mistakes_within(data: TestData) -> list[str]:
    """Likely mistakes in a test, from the test alone, in sentences.

    Args:
        data: The test.
    """
    return [*_copied(data), *_out_of_order(data), *_jumps(data), *_silent(data), *_equal(data)]


def _copied(data: TestData) -> list[str]:
    """Modes with the frequencies of another mode."""
    f = data.frequencies_hz
    near = np.abs(f[:, :, None] / f[:, None] - 1) < _EQUAL  # nan is not near
    apart = np.abs(f[:, :, None] / f[:, None] - 1) >= _EQUAL
    pairs = np.argwhere(np.tril(near.any(axis=0) & ~apart.any(axis=0), -1))
    return [
        f"test.frequencies: {data.mode_names[i]!r} repeats the frequencies of "
        f"{data.mode_names[j]!r}; expected each mode once: leave one out"
        for i, j in pairs
    ]


def _out_of_order(data: TestData) -> list[str]:
    """Frequencies that do not ascend, if modes are paired by order, without shapes."""
    if data.shapes is not None:
        return []
    for condition, f in zip(data.conditions, data.frequencies_hz, strict=True):
        there = np.flatnonzero(np.isfinite(f))
        for i, j in itertools.pairwise(there):
            if f[j] < (1 - _EQUAL) * f[i]:
                where = f" at {data.condition_name} {condition:g}" if len(data) > 1 else ""
                return [
                    f"test.frequencies: {data.mode_names[i]!r}, {f[i]:.6g} Hz, comes before "
                    f"{data.mode_names[j]!r}, {f[j]:.6g} Hz{where}; without shapes modes are "
                    "paired in the order of their columns: expected ascending frequencies"
                ]
    return []


def _jumps(data: TestData) -> list[str]:
    """Frequencies far above, or far below, those of both neighbouring conditions."""
    steps = np.diff(np.log(data.as_it_is.frequencies_hz), axis=0)
    alone = (steps[:-1] * steps[1:] < 0) & (np.minimum(abs(steps[:-1]), abs(steps[1:])) > _JUMP)
    return [
        f"test.frequencies: {data.mode_names[j]!r} is {data.frequencies_hz[i + 1, j]:.6g} Hz at "
        f"{data.condition_name} {data.conditions[i + 1]:g}, {data.frequencies_hz[i, j]:.6g} and "
        f"{data.frequencies_hz[i + 2, j]:.6g} Hz before and after; expected a value near these"
        for i, j in np.argwhere(alone)
    ]


def _silent(data: TestData) -> list[str]:
    """Sensors that read nothing in any mode."""
    if data.shapes is None:
        return []
    size = np.abs(data.shapes) / _sizes(data.shapes)
    still = np.isfinite(size).any(axis=1) & ~np.any(size > _SILENT, axis=1)
    return [
        f"test.shapes: {_sensor(data, s)} reads nothing in any mode; expected motion: leave its "
        "cells empty if it is dead"
        for s in np.flatnonzero(still)
    ]


def _equal(data: TestData) -> list[str]:
    """Measured shapes that are equal at enough sensors."""
    if data.shapes is None or len(data.shapes) < 3:
        return []
    f = data.frequencies_hz[data.shape_row]
    near = np.abs(f[:, None] / f - 1) < _NEAR  # few sensors may see distant modes alike
    match = _auto(data.shapes)
    same = np.tril((match > 1 - _EQUAL) | ((match > _SAME) & near), -1)
    return [
        f"test.shapes: {_listed(data, np.flatnonzero(same[:, j]))}: the same shape as "
        f"{data.mode_names[j]!r} (MAC {match[j, j + 1 :].max():.3g}); expected a different shape "
        "for each mode"
        for j in range(len(same))
        if same[:, j].any() and not same[j].any()
    ]


def mistakes_beside(
    data: TestData,
    row: int,
    model_hz: np.ndarray,
    visible: np.ndarray,
    at_sensors: np.ndarray | None = None,
    pairing: Pairing | None = None,
    of_joints: Callable[[int], float] = lambda count: 0.0,
) -> list[str]:
    """Likely mistakes in a test, compared with a model's modes, in sentences.

    Args:
        data: The test, m modes at n sensors.
        row: The condition that the model is for.
        model_hz: Frequencies of all modes of the model, Hz, (k,), ascending.
        visible: Index of the model's modes that the test could see, ascending.
        at_sensors: Shapes of all modes of the model at the sensors, (n, k); None without sensors.
        pairing: Pairs of test and model modes; None if the model has too few.
        of_joints: Function of n: median share of the strain energy that the joints have in the
            lowest n visible modes. It is d ln w^2 / d ln k: if it is high, joints alone may scale
            all frequencies.
    """
    f, seen_hz = data.frequencies_hz[row], model_hz[visible]
    kept, words = np.flatnonzero(np.isfinite(f)), []
    if not len(kept) or len(kept) > len(visible):
        return words if at_sensors is None else _few_sensors(data, at_sensors[:, visible])
    elastic = model_hz[model_hz > _SILENT * seen_hz[0]]
    shaped = data.shapes is not None and pairing is not None
    told = np.flatnonzero((pairing.mac >= ALIKE) & np.isfinite(f)) if shaped else kept[:0]
    if shaped:  # wrong order of the columns; or of the rows, if few shapes match
        place = np.argsort(np.argsort(f[kept]))
        ordered = at_sensors[:, visible[_aligned(f[kept], seen_hz)[1][place]]]
        words = _shifted_columns(data, kept, ordered)
        if not words and 2 * len(told) < len(kept):
            words = _rows(data, kept, ordered)
    if not words and shaped and 2 * len(told) >= len(kept):
        partners = model_hz[pairing.index]
        words = _exchanged(data, f, told, partners) or _wrong_factor(
            data,
            f,
            told,
            seen_hz,
            elastic,
            of_joints,
            lambda i, c: np.log(f[i] / c / partners[i]),
            lambda i: partners[[told[i]]] if pairing.mac[told[i]] > _CLEARLY else [],
        )
        words += _sensors(data, told, pairing.shapes)
    elif not words:
        words = _wrong_factor(
            data,
            f,
            kept,
            seen_hz,
            elastic,
            of_joints,
            lambda i, c: _aligned(f[i] / c, seen_hz if c == 1 else seen_hz[: len(i)])[0],
            lambda i: _candidates(np.delete(f[kept], i), seen_hz, i),
        )
    if pairing is not None:
        words += _unpartnered(data, f, model_hz, pairing, words)
    return words if at_sensors is None else words + _few_sensors(data, at_sensors[:, visible])


def _unpartnered(data: TestData, f: np.ndarray, model_hz, pairing: Pairing, words) -> list[str]:
    """Test modes that match no mode of the model and are not named in a note yet."""
    alone = [
        i
        for i in np.flatnonzero(~partnered(pairing, model_hz, f, data.shapes))
        if not any(repr(data.mode_names[i]) in line for line in words)
    ]
    return (
        [
            f"test.frequencies: modes without a partner in the model: {_listed(data, alone)}; "
            "expected a model mode of similar shape or frequency for each"
        ]
        if alone
        else []
    )


def _aligned(test_hz: np.ndarray, model_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|ln| of test over model frequencies, both ascending, where modes of the model may be skipped;
    and the index of the model's modes."""
    cost = np.abs(np.log(np.sort(test_hz))[:, None] - np.log(model_hz))
    index = in_order(cost)
    return cost[np.arange(len(index)), index], index


def _candidates(others_hz: np.ndarray, model_hz: np.ndarray, i: int) -> np.ndarray:
    """Frequencies of the model, Hz, between the partners of a test's other modes, for its i-th."""
    index = [-1, *_aligned(others_hz, model_hz)[1], len(model_hz)]
    return model_hz[index[i] + 1 : index[i + 1]]


def _wrong_factor(
    data: TestData,
    f: np.ndarray,
    kept: np.ndarray,
    seen_hz: np.ndarray,
    elastic: np.ndarray,
    of_joints,
    log_ratios,
    places,
) -> list[str]:
    """All frequencies off by the factor of a slip, or beyond any joint's effect; or one alone off.

    Args:
        data: The test.
        f: Its frequencies, Hz, (m,).
        kept: Index of the frequencies that are compared.
        seen_hz: Frequencies of the model's modes that the test could see, Hz.
        elastic: Frequencies of all elastic modes of the model, Hz.
        of_joints: See `mistakes_beside`.
        log_ratios: Function of index and factor: ln of f / factor / frequency of the partner.
        places: Function of i: frequencies that the i-th compared mode could have, Hz.
    """

    def misfit(index: np.ndarray, factor: float = 1.0) -> float:
        return float(np.sqrt(np.mean(log_ratios(index, factor) ** 2)))

    whole, count = misfit(kept), len(kept)
    if whole < _FITS:
        return []
    ratio = np.median(np.sort(f[kept]) / seen_hz[:count])
    best, what = min(_slips(), key=lambda slip: misfit(kept, slip[0]))
    by_slip = count > 2 and misfit(kept, best) < _LEFT * whole
    if (by_slip or abs(math.log(ratio)) > math.log(_LARGEST_SHIFT)) and of_joints(count) < _JOINTS:
        by = (
            f"all about {best:.3g} times the model's ({what}?)"
            if by_slip
            else f"{ratio:.3g} times the model's (median), more than joints explain"
        )
        return [
            f"test.frequencies: the {count} measured are {by}; expected about 1: check the unit "
            "of the table, and E, rho, masses and lengths of the model"
        ]
    if count < _FEW:
        return []
    left = np.array([misfit(np.delete(kept, i)) for i in range(count)])
    i = int(np.argmin(left))
    own = math.sqrt(max(count * whole**2 - (count - 1) * left[i] ** 2, 0.0))
    if own < _OUTLIER or left[i] > _LEFT * own or left[i] > 0.5 * np.sort(left)[1]:
        return []
    return _single_outlier(data, f, kept[i], places(i), elastic)


def _single_outlier(data: TestData, f: np.ndarray, i: int, places, model_hz) -> list[str]:
    """The only frequency without a partner, unless the model has an elastic mode near it."""
    meant = [
        (place, what)
        for place in places
        for slip, what in _slips()
        if abs(f[i] / place / slip - 1) < _NEAR
    ]
    expected = "expected modes of this structure only: leave it out"
    if meant:
        expected = "is it {:.4g} Hz ({})?".format(*meant[0])
    elif np.min(np.abs(f[i] / model_hz - 1)) < _NEAR:
        return []
    elif f[i] < 0.5 * model_hz[0]:
        expected = f"a rigid-body mode on the suspension, below {model_hz[0]:.4g} Hz? {expected}"
    return [
        f"test.frequencies: {data.mode_names[i]!r}, {f[i]:.6g} Hz, is the only one that fits no "
        f"mode of the model; {expected}"
    ]


def _slips() -> list[tuple[float, str]]:
    """Ratios of slips, up and down, with the cause of each."""
    return [(x, what) for slip, what in _SLIPS.items() for x in (slip, 1 / slip)]


def _exchanged(data: TestData, f: np.ndarray, told: np.ndarray, partners) -> list[str]:
    """Frequencies that are exchanged among the shapes."""
    log_f, log_g = np.log(f[told]), np.log(partners[told])
    there = np.sort(log_f)[np.argsort(np.argsort(log_g))]
    moves = there != log_f
    misfit, left = (
        np.sqrt(np.mean((x[moves] - log_g[moves]) ** 2)) if moves.any() else 0.0
        for x in (log_f, there)
    )
    moved = told[moves]
    if misfit < _FITS or left > _LEFT * misfit:
        return []
    return [
        f"test.shapes: the shapes of {_listed(data, moved)} fit one another's frequencies, by the "
        "model's modes; expected the columns of frequencies and shapes in the same order"
    ]


def _shifted_columns(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Columns of shapes that are shifted or reversed against those of the frequencies."""
    match, n = mac(data.shapes[:, kept], model), len(kept)
    tries = {f"{k} columns further left": np.roll(match, -k, axis=0) for k in range(1, n)}
    tries["in reverse order"] = match[::-1]
    found = _fitting(np.mean(np.diag(match)), {w: np.mean(np.diag(x)) for w, x in tries.items()})
    return [
        f"test.shapes: its columns fit the frequencies better {words}; expected the columns of "
        "frequencies and shapes in the same order"
        for words in found
        if n > 2
    ]


def _fitting(before: float, after: dict[str, float]) -> list[str]:
    """The change of the shapes, in words, that alone makes them fit, by MAC; or none."""
    words = max(after, key=after.get, default="")
    if not words or 1 - before < _POOR or 1 - after[words] > _LEFT * (1 - before):
        return []
    return [f"{words} (MAC {after[words]:.2f}, now {before:.2f})"]


def _scaled(data: TestData, kept: np.ndarray, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured and model shapes of some modes in one scale, 0 where not measured."""
    a, b = data.shapes[:, kept], model[:, kept] / _sizes(model[:, kept])
    a = np.nan_to_num(a / _sizes(a))
    b = np.where(np.isfinite(data.shapes[:, kept]), b, 0.0)
    # Square roots: a few wrong sensors hardly change the scale of the others.
    sign = np.sign(np.sum(np.sign(a * b) * np.sqrt(np.abs(a * b)), axis=0))
    return a * np.where(sign == 0, 1.0, sign), b


def _sensors(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Sensors that are silent, flipped or exchanged, by their signed COMAC (Lieven and Ewins,
    1988)."""
    if len(kept) < 3:
        return []
    a, b = _scaled(data, kept, model)
    ours, theirs = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    loud = np.flatnonzero((theirs > _WEAK * math.sqrt(len(kept))) & (ours > 0))
    own, gain = np.ones((2, len(a)))
    own[loud] = np.sum(a * b, axis=1)[loud] / (ours * theirs)[loud]
    gain[loud] = ours[loud] / theirs[loud] / np.median(ours[loud] / theirs[loud])
    odd = np.abs(np.log(gain)) > math.log(_GAIN)
    words = [
        f"test.shapes: {_sensor(data, s)} reads {gain[s]:.2g} times the model's motion there; "
        "expected about 1: is it dead, or its calibration wrong?"
        for s in np.flatnonzero(odd)
    ]
    words += [
        f"test.shapes: {_sensor(data, s)} moves against the model (correlation {own[s]:.2f}); "
        "expected about 1: is its direction reversed?"
        for s in np.flatnonzero(~odd & (own < _OTHER))
    ]
    return words or _rows(data, kept, model)


def _rows(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Rows of the table that fit other sensors of the model, or reversed ones."""
    shapes, n = data.shapes[:, kept], len(data.shapes)
    if n not in _SENSORS or len(kept) < 3:
        return []
    one = np.eye(n, dtype=bool)[..., None]
    tries = [
        {
            f"{step} rows further {way}": np.roll(shapes, step * sign, axis=0)
            for step in range(1, n // 2 + 1)
            for way, sign in (("down", 1), ("up", -1))
        },
        {"in reverse order": shapes[::-1]},
        {f"with {_sensor(data, s)} reversed": np.where(one[s], -shapes, shapes) for s in range(n)},
        {
            f"with all sensors along {np.round(way, 3).tolist()} reversed": np.where(
                np.all(data.sensors.directions == way, axis=1)[:, None], -shapes, shapes
            )
            for way in np.unique(data.sensors.directions, axis=0)
        },
        {
            f"with {_sensor(data, s)} and {_sensor(data, t)} exchanged": np.where(
                one[s], shapes[t], np.where(one[t], shapes[s], shapes)
            )
            for s, t in itertools.combinations(range(n), 2)
            if n <= _PAIRS
        },
        {f"without {_sensor(data, s)}": np.where(one[s], np.nan, shapes) for s in range(n)},
    ]
    before = _agreement(shapes, model)
    for changed in tries:
        for words in _fitting(before, {w: _agreement(x, model) for w, x in changed.items()}):
            return [
                f"test.shapes: its rows fit the model better {words}; expected a row for each "
                "point of test.sees, in its order and direction"
            ]
    return []


def _agreement(shapes: np.ndarray, model: np.ndarray) -> float:
    """Mean MAC of the measured shapes, each with its best-matching mode."""
    return float(mac(shapes, model).max(axis=1).mean())


def _few_sensors(data: TestData, model_shapes: np.ndarray) -> list[str]:
    """Sensors at which all modes look alike."""
    m = len(data.mode_names)
    seen = model_shapes[:, :m]
    if m < 2 or seen.shape[1] < 2 or np.min(_auto(seen)) < _SAME:
        return []
    n = len(data.sensors)
    return [
        f"test.sees: at {'its one sensor' if n == 1 else f'its {n} sensors'} all {m} modes have "
        "the same shape; expected as many sensors as modes, at places where the modes differ"
    ]


def _sizes(shapes: np.ndarray) -> np.ndarray:
    """Root mean square of each shape, (m,)."""
    found = np.sqrt(np.nanmean((shapes / np.nanmax(np.abs(shapes), axis=0)) ** 2, axis=0))
    return found * np.nanmax(np.abs(shapes), axis=0)


def _auto(shapes: np.ndarray) -> np.ndarray:
    """MAC of the shapes with one another, at the sensors where both are known."""
    return mac(shapes, np.nan_to_num(shapes))


def _sensor(data: TestData, s: int) -> str:
    return f"sensor {data.sensors.names[s] if data.sensors.names else s + 1}"


def _listed(data: TestData, index: Sequence[int]) -> str:
    return ", ".join(repr(data.mode_names[i]) for i in index)
