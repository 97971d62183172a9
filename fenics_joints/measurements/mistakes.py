"""Mistakes in the tables of a test: copied modes, other units, columns and rows in another order,
sensors that are dead, flipped or exchanged. Some show in the test alone, most beside a model.

A model may be off by much where its joints are. So a mistake is not said because model and test
differ, but because undoing it, and nothing else, would make them agree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import ALIKE, Pairing, mac, partnered
from fenics_joints.measurements.measured_shapes import in_order

__all__ = ["mistakes_beside", "mistakes_within"]

#: Ratios of frequencies that slips make, with what makes them.
_SLIPS = {
    2 * math.pi: "rad/s and Hz", 1000.0: "Hz and kHz, m and mm", 10.0: "the decimal point",
    2.0: "a factor of two", 60.0: "per minute and Hz", 100.0: "the decimal point",
    math.sqrt(1000.0): "a modulus or a density a thousand times off",
    math.sqrt(10.0): "a modulus or a density ten times off",
}  # fmt: skip
#: How near a ratio comes to a slip's, for a joint may be off as well.
_NEAR = 0.1
#: What undoing a mistake leaves of the misfit (root mean square of ln f, test to model), and below
#: which misfit none is looked for.
_LEFT, _FITS = 1 / 3, 0.1
#: ln of a ratio by which a mode is off alone.
_ALONE = math.log(1.4)
#: No joint makes the middle one of all frequencies so many times too high or low.
_FAR = 2.5
#: Share of the strain energy in joints from which on they may be what makes them so.
_JOINTS = 0.5
#: Relative distance of two frequencies that are one, and MAC of two shapes that are.
_ONE, _SAME = 1e-6, 0.99
#: ln of a jump that no joint makes at one torque and takes back at the next.
_JUMP = 0.1
#: So few modes go into any place.
_FEW = 4
#: Share of the usual motion below which a sensor is silent; and of a model's, below which it does
#: not say whether that is right.
_SILENT, _WEAK = 1e-3, 0.2
#: MAC of a pair that tells what its frequency should be.
_CLEARLY = 0.8
#: Misfit of shapes, 1 - MAC, below which none is looked for; and how many sensors it takes.
_POOR, _SENSORS = 0.05, range(6, 301)
#: Sensors up to which each pair is exchanged for a try; among more, two hardly lower a MAC.
_PAIRS = 40
#: Gain of a sensor, to the usual one, that no model's error makes.
_GAIN = 6.0
#: Signed COMAC (its root) of a sensor with the model below which it is the other way round.
_OTHER = -0.6


def mistakes_within(data: TestData) -> list[str]:
    """What is unlikely in a test by itself, in sentences.

    Args:
        data: The test.
    """
    return [*_copied(data), *_out_of_order(data), *_jumps(data), *_silent(data), *_alike(data)]


def _copied(data: TestData) -> list[str]:
    """Modes with the frequencies of another one."""
    f = data.frequencies_hz
    near = np.abs(f[:, :, None] / f[:, None] - 1) < _ONE  # not of what was not measured
    apart = np.abs(f[:, :, None] / f[:, None] - 1) >= _ONE
    pairs = np.argwhere(np.tril(near.any(axis=0) & ~apart.any(axis=0), -1))
    return [
        f"test.frequencies: {data.mode_names[i]!r} has the frequencies of {data.mode_names[j]!r}; "
        "expected each mode once: leave one out"
        for i, j in pairs
    ]


def _out_of_order(data: TestData) -> list[str]:
    """Modes without shapes that do not ascend, and are paired in their order."""
    if data.shapes is not None:
        return []
    for condition, f in zip(data.conditions, data.frequencies_hz, strict=True):
        there = np.flatnonzero(np.isfinite(f))
        for i, j in itertools.pairwise(there):
            if f[j] < (1 - _ONE) * f[i]:
                where = f" at {data.condition_name} {condition:g}" if len(data) > 1 else ""
                return [
                    f"test.frequencies: {data.mode_names[i]!r}, {f[i]:.6g} Hz, stands before "
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
        f"{data.frequencies_hz[i + 2, j]:.6g} Hz before and after it; expected one near these"
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


def _alike(data: TestData) -> list[str]:
    """Measured shapes of which sensors enough say that they are one."""
    if data.shapes is None or len(data.shapes) < 3:
        return []
    f = data.frequencies_hz[data.shape_row]
    near = np.abs(f[:, None] / f - 1) < _NEAR  # far ones may look alike to few sensors
    match = _auto(data.shapes)
    same = np.tril((match > 1 - _ONE) | ((match > _SAME) & near), -1)
    return [
        f"test.shapes: the shapes of {_listed(data, np.flatnonzero(same[:, j]))} are that of "
        f"{data.mode_names[j]!r} (MAC {match[j, j + 1 :].max():.3g}); expected a shape of its own "
        "for each mode"
        for j in range(len(same)) if same[:, j].any() and not same[j].any()
    ]  # fmt: skip


def mistakes_beside(
    data: TestData, row: int, model_hz: np.ndarray, visible: np.ndarray,
    at_sensors: np.ndarray | None = None, pairing: Pairing | None = None,
    of_joints: Callable[[int], float] = lambda count: 0.0,
) -> list[str]:
    """What is unlikely in a test beside a model's modes, in sentences.

    Args:
        data: The test, m modes at n sensors.
        row: The condition that the model is for.
        model_hz: Frequencies of all modes of the model, Hz, (k,), ascending.
        visible: Those that the test could see, by index, ascending.
        at_sensors: Shapes of all modes of the model at the sensors, (n, k); None without sensors.
        pairing: Which of them the test's are; None where the model has too few.
        of_joints: Gives the joints' share of the strain energy of so many of the visible modes, the
            lowest, of the middle one. It is d ln w^2 / d ln k: where it is most of it, joints alone
            may be what scales all frequencies.
    """  # fmt: skip
    f, seen_hz = data.frequencies_hz[row], model_hz[visible]
    kept, words = np.flatnonzero(np.isfinite(f)), []
    if not len(kept) or len(kept) > len(visible):
        return words if at_sensors is None else _few_sensors(data, at_sensors[:, visible])
    elastic = model_hz[model_hz > _SILENT * seen_hz[0]]
    shaped = data.shapes is not None and pairing is not None
    told = np.flatnonzero((pairing.mac >= ALIKE) & np.isfinite(f)) if shaped else kept[:0]
    if shaped:  # is it the order of the columns, or of the rows where shapes do not speak?
        place = np.argsort(np.argsort(f[kept]))
        ordered = at_sensors[:, visible[_aligned(f[kept], seen_hz)[1][place]]]
        words = _turned(data, kept, ordered)
        if not words and 2 * len(told) < len(kept):
            words = _rows(data, kept, ordered)
    if not words and shaped and 2 * len(told) >= len(kept):
        partners = model_hz[pairing.index]
        words = _exchanged(data, f, told, partners) or _off(
            data, f, told, seen_hz, elastic, of_joints,
            lambda i, c: np.log(f[i] / c / partners[i]),
            lambda i: partners[[told[i]]] if pairing.mac[told[i]] > _CLEARLY else [],
        )  # fmt: skip
        words += _sensors(data, told, pairing.shapes)
    elif not words:
        words = _off(
            data, f, kept, seen_hz, elastic, of_joints, lambda i, c: _aligned(
                f[i] / c, seen_hz if c == 1 else seen_hz[: len(i)]
            )[0],
            lambda i: _free(np.delete(f[kept], i), seen_hz, i),
        )  # fmt: skip
    if pairing is not None:
        words += _unpartnered(data, f, model_hz, pairing, words)
    return words if at_sensors is None else words + _few_sensors(data, at_sensors[:, visible])


def _unpartnered(data: TestData, f: np.ndarray, model_hz, pairing: Pairing, words) -> list[str]:
    """Modes that are like none of the model's, but those that are named already."""
    alone = [
        i for i in np.flatnonzero(~partnered(pairing, model_hz, f, data.shapes))
        if not any(repr(data.mode_names[i]) in line for line in words)
    ]  # fmt: skip
    return [
        f"test.frequencies: without a partner among the model's modes: {_listed(data, alone)}; "
        "expected a mode of like shape, or of like frequency, for each"
    ] if alone else []  # fmt: skip


def _aligned(test_hz: np.ndarray, model_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln of frequencies over those of a model's modes in the same order, some of which may be
    passed over, and which these are; both of the frequencies in ascending order."""
    cost = np.abs(np.log(np.sort(test_hz))[:, None] - np.log(model_hz))
    index = in_order(cost)
    return cost[np.arange(len(index)), index], index


def _free(others_hz: np.ndarray, model_hz: np.ndarray, i: int) -> np.ndarray:
    """Modes of a model that could be the i-th of a test whose others are these, Hz."""
    index = [-1, *_aligned(others_hz, model_hz)[1], len(model_hz)]
    return model_hz[index[i] + 1 : index[i + 1]]


def _off(
    data: TestData, f: np.ndarray, kept: np.ndarray, seen_hz: np.ndarray, elastic: np.ndarray,
    of_joints, log_ratios, places,
) -> list[str]:
    """All frequencies off by one factor, that of a slip or one beyond any joint, or one alone.

    Args:
        data: The test.
        f: Its frequencies, Hz, (m,).
        kept: Those that are compared, by index.
        seen_hz: Those of the model that the test could see, Hz.
        elastic: Those of all its elastic modes, Hz.
        of_joints: See `mistakes_beside`.
        log_ratios: Gives ln of some of the frequencies, over a factor, to their partners'.
        places: Gives frequencies that the i-th of those kept could have, Hz.
    """  # fmt: skip

    def misfit(index: np.ndarray, factor: float = 1.0) -> float:
        return float(np.sqrt(np.mean(log_ratios(index, factor) ** 2)))

    whole, count = misfit(kept), len(kept)
    if whole < _FITS:
        return []
    ratio = np.median(np.sort(f[kept]) / seen_hz[:count])
    best, what = min(_both_ways(), key=lambda slip: misfit(kept, slip[0]))
    by_slip = count > 2 and misfit(kept, best) < _LEFT * whole
    if (by_slip or abs(math.log(ratio)) > math.log(_FAR)) and of_joints(count) < _JOINTS:
        by = f"all about {best:.3g} times the model's ({what}?)" if by_slip else \
            f"{ratio:.3g} times the model's in the middle, more than joints explain"  # fmt: skip
        return [
            f"test.frequencies: the {count} measured are {by}; expected about 1: look at the unit "
            "of the table, and at E, rho, masses and lengths of the model"
        ]
    if count < _FEW:
        return []
    left = np.array([misfit(np.delete(kept, i)) for i in range(count)])
    i = int(np.argmin(left))
    own = math.sqrt(max(count * whole**2 - (count - 1) * left[i] ** 2, 0.0))
    if own < _ALONE or left[i] > _LEFT * own or left[i] > 0.5 * np.sort(left)[1]:
        return []
    return _one_off(data, f, kept[i], places(i), elastic)


def _one_off(data: TestData, f: np.ndarray, i: int, places, model_hz) -> list[str]:
    """A frequency that alone has no partner; unless the model has a mode near it, after all."""
    meant = [(place, what) for place in places for slip, what in _both_ways()
             if abs(f[i] / place / slip - 1) < _NEAR]  # fmt: skip
    expected = "expected modes of this structure: leave it out"
    if meant:
        expected = "is it {:.4g} Hz ({})?".format(*meant[0])
    elif np.min(np.abs(f[i] / model_hz - 1)) < _NEAR:
        return []
    elif f[i] < 0.5 * model_hz[0]:
        expected = f"a rigid motion on its suspension, below {model_hz[0]:.4g} Hz? {expected}"
    return [
        f"test.frequencies: {data.mode_names[i]!r}, {f[i]:.6g} Hz, fits no mode of the model, as "
        f"all others do; {expected}"
    ]


def _both_ways() -> list[tuple[float, str]]:
    """Ratios of slips, up and down, with what makes them."""
    return [(x, what) for slip, what in _SLIPS.items() for x in (slip, 1 / slip)]


def _exchanged(data: TestData, f: np.ndarray, told: np.ndarray, partners) -> list[str]:
    """Frequencies that belong to one another's shapes."""
    log_f, log_g = np.log(f[told]), np.log(partners[told])
    there = np.sort(log_f)[np.argsort(np.argsort(log_g))]
    moves = there != log_f
    misfit, left = (np.sqrt(np.mean((x[moves] - log_g[moves]) ** 2)) if moves.any() else 0.0
                    for x in (log_f, there))  # fmt: skip
    moved = told[moves]
    if misfit < _FITS or left > _LEFT * misfit:
        return []
    return [
        f"test.shapes: the shapes of {_listed(data, moved)} are like modes of the model whose "
        "frequencies are those measured of one another; expected the columns of frequencies and "
        "shapes in one order"
    ]


def _turned(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Columns of shapes that are a whole number of places beside those of the frequencies."""
    match, n = mac(data.shapes[:, kept], model), len(kept)
    tries = {f"{k} columns further left": np.roll(match, -k, axis=0) for k in range(1, n)}
    tries["in reverse order"] = match[::-1]
    found = _better(np.mean(np.diag(match)), {w: np.mean(np.diag(x)) for w, x in tries.items()})
    return [
        f"test.shapes: its columns fit the frequencies better {words}; expected the columns of "
        "frequencies and shapes in one order"
        for words in found if n > 2
    ]  # fmt: skip


def _better(before: float, after: dict[str, float]) -> list[str]:
    """In words which change of the shapes, and nothing else, makes them fit, by their MAC."""
    words = max(after, key=after.get, default="")
    if not words or 1 - before < _POOR or 1 - after[words] > _LEFT * (1 - before):
        return []
    return [f"{words} (MAC {after[words]:.2f}, now {before:.2f})"]


def _scaled(data: TestData, kept: np.ndarray, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured shapes of some modes, 0 where not measured, and the model's in their scale."""
    a, b = data.shapes[:, kept], model[:, kept] / _sizes(model[:, kept])
    a = np.nan_to_num(a / _sizes(a))
    b = np.where(np.isfinite(data.shapes[:, kept]), b, 0.0)
    # About the scale of most sensors, whatever the few wrong ones do to it.
    sign = np.sign(np.sum(np.sign(a * b) * np.sqrt(np.abs(a * b)), axis=0))
    return a * np.where(sign == 0, 1.0, sign), b


def _sensors(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Sensors that are silent, flipped or another one, by their signed COMAC (Lieven and Ewins,
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
        f"test.shapes: {_sensor(data, s)} reads {gain[s]:.2g} times what the model has there; "
        "expected about 1: is it dead, or its calibration another one?"
        for s in np.flatnonzero(odd)
    ]
    words += [
        f"test.shapes: {_sensor(data, s)} moves against the model (correlation {own[s]:.2f}); "
        "expected about 1: is its direction the other way round?"
        for s in np.flatnonzero(~odd & (own < _OTHER))
    ]
    return words or _rows(data, kept, model)


def _rows(data: TestData, kept: np.ndarray, model: np.ndarray) -> list[str]:
    """Rows of the table that are like those of the model's other sensors."""
    shapes, n = data.shapes[:, kept], len(data.shapes)
    if n not in _SENSORS or len(kept) < 3:
        return []
    one = np.eye(n, dtype=bool)[..., None]
    tries = [
        {f"{step} rows further {way}": np.roll(shapes, step * sign, axis=0)
         for step in range(1, n // 2 + 1) for way, sign in (("down", 1), ("up", -1))},
        {"in reverse order": shapes[::-1]},
        {f"with {_sensor(data, s)} the other way round": np.where(one[s], -shapes, shapes)
         for s in range(n)},
        {f"with all sensors along {np.round(way, 3).tolist()} the other way round":
         np.where(np.all(data.sensors.directions == way, axis=1)[:, None], -shapes, shapes)
         for way in np.unique(data.sensors.directions, axis=0)},
        {f"with {_sensor(data, s)} and {_sensor(data, t)} exchanged":
         np.where(one[s], shapes[t], np.where(one[t], shapes[s], shapes))
         for s, t in itertools.combinations(range(n), 2) if n <= _PAIRS},
        {f"without {_sensor(data, s)}": np.where(one[s], np.nan, shapes) for s in range(n)},
    ]  # fmt: skip
    before = _agreement(shapes, model)
    for changed in tries:
        for words in _better(before, {w: _agreement(x, model) for w, x in changed.items()}):
            return [
                f"test.shapes: its rows fit the model better {words}; expected a row for each "
                "point of test.sees, in its order and direction"
            ]
    return []


def _agreement(shapes: np.ndarray, model: np.ndarray) -> float:
    """Mean MAC of each measured shape with the mode that it is most like."""
    return float(mac(shapes, model).max(axis=1).mean())


def _few_sensors(data: TestData, model_shapes: np.ndarray) -> list[str]:
    """Sensors to which all modes look alike."""
    m = len(data.mode_names)
    seen = model_shapes[:, :m]
    if m < 2 or seen.shape[1] < 2 or np.min(_auto(seen)) < _SAME:
        return []
    n = len(data.sensors)
    return [
        f"test.sees: to {'its one sensor' if n == 1 else f'its {n} sensors'} all {m} modes look "
        "alike; expected places at which they differ, as many as modes"
    ]


def _sizes(shapes: np.ndarray) -> np.ndarray:
    """Root mean square of each shape, (m,), that of zeros 1."""
    found = np.sqrt(np.nanmean((shapes / np.nanmax(np.abs(shapes), axis=0)) ** 2, axis=0))
    return found * np.nanmax(np.abs(shapes), axis=0)


def _auto(shapes: np.ndarray) -> np.ndarray:
    """MAC of shapes with one another, at the sensors that both have."""
    return mac(shapes, np.nan_to_num(shapes))


def _sensor(data: TestData, s: int) -> str:
    return f"sensor {data.sensors.names[s] if data.sensors.names else s + 1}"


def _listed(data: TestData, index: Sequence[int]) -> str:
    return ", ".join(repr(data.mode_names[i]) for i in index)
