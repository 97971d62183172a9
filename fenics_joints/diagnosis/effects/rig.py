"""Effects around the structure: what is attached to it and holds it, and how the test reads it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import FACTOR, Effect, Prior, in_series, relative_error
from fenics_joints.formatting import spaced
from fenics_joints.reduction.reduced import monomials

MISSCALED, MISPLACED = "sensor mis-scaled", "sensor misplaced"
SWAPPED, MISSED = "mode mis-pairing", "mode missed by the test"
#: Stiffness of a clamped face per area, Pa/m: that of an interface (1e11 to 1e13), less what the
#: ground gives way; hence a factor of 30 either way. "Clamped" ends have been seen to be off by
#: more than 10 % in frequency (Ritto et al.). [prior: as of clamped faces; Ritto et al.]
_SUPPORT = (1e12, np.log(30.0), "Pa/m", True, (1e6, 1e17))
#: Spread of a known mass or spring as a cause: a part forgotten on a scale, or a suspension whose
#: data sheet holds for another load. [prior: chosen]
MASS, SPRING = 0.3, 1.0
#: The same with its name and limits. [prior: chosen]
_MISJUDGED = {
    "mass": ("mass error", MASS, FACTOR),
    "stiffness": ("spring error", SPRING, (1e-2, 1e2)),
}
#: Gain of a sensor whose setting or mounting is wrong, about 1: calibrations hold to 1 to 3 %, so
#: this is a blunder's. [prior: chosen]
_GAIN = Prior("gain", 1.0, 0.3)
#: Place of a sensor that is wrong, relative to the length of the line of sensors: what is measured
#: with a tape is off by less, what is read off another line of a table by more. [prior: chosen]
_SHIFT = 0.03


# -- attached to it --------------------------------------------------------------------------------


def travel(shift: tuple[float, float]) -> Prior:
    """Where a mass is whose place is uncertain: normal about zero.

    Args:
        shift: Range of the travel, m: four standard deviations.
    """
    return Prior("travel", 0.0, (shift[1] - shift[0]) / 4, "m", False, shift)


def attached(name: str, region: str, key: str, priors: Sequence[Prior], describe: str) -> Effect:
    """A mass or a spring that the nominal model leaves out, or has at another place.

    Args:
        name: Name of the effect.
        region: Where, for people.
        key: Name of the attachment; its parameters are ``KEY.<prior's name>``.
        priors: Its parameters; ``mass``, ``travel`` or ``stiffness``.
        describe: Sentence for the report.
    """

    def apply(values, theta, condition):
        for prior in priors:
            values[f"{key}.{prior.name}"] = theta[prior.name]

    return Effect(name, region, tuple(priors), apply, describe)


def misjudged(name: str, key: str, weight: float) -> Effect:
    """A known mass, or a known spring such as a suspension, that is not what the model says.

    Args:
        name: Its name.
        key: ``mass`` or ``stiffness``.
        weight: Prior odds: one over the number of such.
    """
    what, spread, span = _MISJUDGED[key]
    words = f"The {key} of {spaced(name)} is not what the model says."
    return relative_error(
        what, spaced(name), [f"{name}.{key}"], spread, words, span=span, weight=weight
    )


def support_compliance(supports: Sequence[str], weight: float = 1.0) -> Effect:
    """Supports that give way: stiffness per area in series with the nominal, next to rigid one.

    Args:
        supports: Names of the supports; each has parameters ``NAME.k_n`` and ``NAME.k_t``.
        weight: Prior odds: one over the number of supports for one of them.
    """

    def apply(values, theta, condition):
        for support in supports:
            for key in ("k_n", "k_t"):
                in_series(values, f"{support}.{key}", theta[key])

    priors = tuple(Prior(key, *_SUPPORT) for key in ("k_n", "k_t"))
    labels = [spaced(support) for support in supports]
    name = "compliance of all supports" if len(labels) > 1 else f"{labels[0]} compliance"
    region = ", ".join(supports)
    words = "What is held as if rigid gives way: the clamp, or the ground under it."
    return Effect(name, region, priors, apply, words, family="boundary", weight=weight)


# -- in the test -----------------------------------------------------------------------------------


def misscaled_sensor(i: int, weight: float) -> Effect:
    """Sensor i (from 0) reads too much or too little, by a constant factor."""

    def read(sensing, theta):
        sensing.gains[i] *= theta["gain"]

    words = f"Sensor {i + 1} reads all modes by one factor too large or too small."
    return Effect(
        MISSCALED,
        f"sensor {i + 1}",
        (_GAIN,),
        None,
        words,
        family=MISSCALED,
        weight=weight,
        sensing=read,
    )


def misplaced_sensor(i: int, length: float, weight: float, ways: int = 1) -> Effect:
    """Sensor i (from 0) sits elsewhere than the case says: to first order along a line, on a face
    to third.

    Args:
        i: Which sensor.
        length: How far apart sensors are at most, m.
        weight: Prior odds: one over the number of sensors.
        ways: Directions in which it may: 1 along the line of sensors, 2 on its face
            (`fenics_joints.reduction.prediction.ways_of`).
    """
    names = ("shift", "shift across")[:ways]

    def read(sensing, theta):
        for way, name in enumerate(names):
            sensing.shifts[way, i] += theta[name]
        a, b = sensing.shifts[:2, i]
        sensing.shifts[2:, i] = monomials(a, b)

    sd = _SHIFT * length
    priors = tuple(Prior(name, 0.0, sd, "m", False) for name in names)
    where = "along the line of sensors" if ways == 1 else "on its face"
    words = f"Sensor {i + 1} sits elsewhere {where} than the case says."
    return Effect(
        MISPLACED,
        f"sensor {i + 1}",
        priors,
        None,
        words,
        family=MISPLACED,
        weight=weight,
        sensing=read,
    )


def missed_mode(j: int, names: Sequence[str]) -> Effect:
    """The test did not find the model's mode j (from 0): it and those above are the next ones.

    Args:
        j: The first that is another one.
        names: Names of all modes of the test.
    """

    def read(sensing, theta):
        sensing.order[sensing.order >= j] += 1

    words = f"The test's {names[j]} is the model's next one, and so on: it did not find that mode."
    return Effect(
        MISSED, names[j], (), None, words, family=SWAPPED, weight=1 / len(names), sensing=read
    )


def swapped_modes(j: int, names: Sequence[str]) -> Effect:
    """The test calls mode j (from 0) the next one, and that one mode j.

    Args:
        j: The first of the two.
        names: Names of all modes of the test.
    """

    def read(sensing, theta):
        sensing.order[[j, j + 1]] = sensing.order[[j + 1, j]]

    words = f"The test's {names[j]} is the model's {names[j + 1]}, and the other way round."
    return Effect(
        SWAPPED,
        f"{names[j]}, {names[j + 1]}",
        (),
        None,
        words,
        family=SWAPPED,
        weight=1 / (len(names) - 1),
        sensing=read,
    )
