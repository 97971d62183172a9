"""Effects around the structure: attachments, supports, and errors of the test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.sections import AttachedMass
from fenics_joints.diagnosis.effects.damping import NO_RATIOS, has_ratios
from fenics_joints.diagnosis.effects.effect import (
    FACTOR,
    Effect,
    Found,
    Prior,
    Setting,
    Silent,
    in_series,
    relative_error,
)
from fenics_joints.diagnosis.zones.zone import bonded_values
from fenics_joints.formatting import spaced
from fenics_joints.reduction.prediction import ways_of
from fenics_joints.reduction.reduced import monomials

SUPPORTS = "damping of the supports"
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
#: Of what holds a structure: clamped metal has 0.01, wood, foam and rubber 0.05 to 0.3 (Beards,
#: Structural Vibration, 1996), and a foot that radiates into the ground as much; within a factor of
#: 4 either way. [prior: Beards 1996]
_HELD = Prior("eta", 0.05, np.log(4.0), "", True, (1e-4, 2.0))
#: Least relative spread of the mass or stiffness of an attachment. [numerical: chosen]
_EXACT = 1e-3


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
    words = f"The {key} of {spaced(name)} differs from the model's."
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
    words = "The support is compliant: the clamp, or the ground under it."
    return Effect(name, region, priors, apply, words, family="boundary", weight=weight)


def spring_damping(springs: Sequence[str], region: str, weight: float = 1.0) -> Effect:
    """A loss factor of the springs on which the structure stands or hangs.

    Args:
        springs: Their names; each has a parameter ``NAME.stiffness``.
        region: Where, for people.
        weight: Prior odds: one over the number of such places.
    """

    def loss(theta, condition, hz):
        return {f"{name}.stiffness": theta["eta"] for name in springs}

    words = "The suspension or support springs dissipate a share of their energy in each cycle."
    of_all = {"family": SUPPORTS, "loss": loss, "weight": weight, "beside": True}
    return Effect(SUPPORTS, region, (_HELD,), None, words, **of_all)


def support_damping(supports: Sequence[str], weight: float = 1.0) -> Effect:
    """Supports that give way and dissipate a share of what they store: one that is rigid does none.

    Args:
        supports: Their names; each has parameters ``NAME.k_n`` and ``NAME.k_t``.
        weight: Prior odds: one over the number of such places.
    """
    compliant = support_compliance(supports, weight)

    def loss(theta, condition, hz):
        return {f"{name}.{key}": theta["eta"] for name in supports for key in ("k_n", "k_t")}

    words = "The support is compliant and dissipates a share of its energy in each cycle."
    return replace(
        compliant,
        name=SUPPORTS,
        priors=(*compliant.priors, _HELD),
        describe=words,
        loss=loss,
        beside=True,
    )


def attachments(s: Setting) -> Found:
    """Attachments that the nominal model leaves out, except those of the test itself; errors of
    known masses and springs; compliance of supports."""
    case = s.case
    put_on = () if case.test is None else case.test.changed
    yield from (_attachment(case, name) for name in case.attached if name not in put_on)
    yield from (misjudged(name, "mass", 1 / len(case.masses)) for name in case.masses)
    yield from (misjudged(name, "stiffness", 1 / len(case.springs)) for name in case.springs)
    supports = elastic_supports(case)
    yield from (support_compliance([name], 1 / len(supports)) for name in supports)
    if len(supports) > 1:
        yield support_compliance(supports)


def damping_around(s: Setting) -> Found:
    """Damping by supports and springs to the ground."""
    supports, springs = elastic_supports(s.case), list(s.case.springs)
    if not (supports or springs):
        return
    if not has_ratios(s.data):
        yield Silent(SUPPORTS, NO_RATIOS)
        return
    places = [[name] for name in supports] + [supports] * (len(supports) > 1)
    weight = 1 / (len(places) + len(springs))
    yield from (support_damping(own, weight) for own in places)
    yield from (spring_damping([name], spaced(name), weight) for name in springs)


def elastic_supports(case: Case) -> list[str]:
    """Supports that are elastic in a case's nominal model: they have a stiffness."""
    known = bonded_values(case)
    return [name for name in case.supports if f"{name}.k_n" in known]


def _attachment(case: Case, name: str) -> Effect:
    """A mass or a spring that the nominal model leaves out."""
    section = case.attached[name]
    is_mass = isinstance(section, AttachedMass)
    key = "mass" if is_mass else "stiffness"
    value = section.nominal()[key]
    spread = case.tolerances().get(f"{name}.{key}", MASS if is_mass else SPRING)
    priors = [Prior(key, value, max(spread, _EXACT), "kg" if is_mass else "N/m")]
    if is_mass and section.shift() is not None:
        priors.append(travel(section.shift()))
    label = spaced(name)
    words = f"The {key} of the {label} acts on the structure; the baseline model leaves it out."
    return attached(f"{label} {key}", label, name, priors, words)


# -- in the test -----------------------------------------------------------------------------------


def _in_test(name, region, read, words, weight, priors=(), family=None) -> Effect:
    """An error of the test: ``read(sensing, theta)`` changes how it reads the structure."""
    family = family or name
    return Effect(name, region, priors, None, words, family=family, weight=weight, sensing=read)


def misscaled_sensor(i: int, weight: float) -> Effect:
    """Sensor i (from 0) reads too much or too little, by a constant factor."""

    def read(sensing, theta):
        sensing.gains[i] *= theta["gain"]

    words = f"Sensor {i + 1} reads all modes too large or too small by the same factor."
    return _in_test(MISSCALED, f"sensor {i + 1}", read, words, weight, (_GAIN,))


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
    words = f"Sensor {i + 1} is elsewhere {where} than the case says."
    return _in_test(MISPLACED, f"sensor {i + 1}", read, words, weight, priors)


def missed_mode(j: int, names: Sequence[str]) -> Effect:
    """The test did not find the model's mode j (from 0): it and those above are the next ones.

    Args:
        j: The first that is another one.
        names: Names of all modes of the test.
    """

    def read(sensing, theta):
        sensing.order[sensing.order >= j] += 1

    words = f"The test missed a mode: its {names[j]} is the model's next mode, and so on."
    return _in_test(MISSED, names[j], read, words, 1 / len(names), family=SWAPPED)


def swapped_modes(j: int, names: Sequence[str]) -> Effect:
    """The test calls mode j (from 0) the next one, and that one mode j.

    Args:
        j: The first of the two.
        names: Names of all modes of the test.
    """

    def read(sensing, theta):
        sensing.order[[j, j + 1]] = sensing.order[[j + 1, j]]

    words = f"The test's {names[j]} is the model's {names[j + 1]}, and vice versa."
    return _in_test(SWAPPED, f"{names[j]}, {names[j + 1]}", read, words, 1 / (len(names) - 1))


def errors_of_test(s: Setting) -> Found:
    """Modes taken for each other, and sensors that read wrongly or sit elsewhere."""
    data = s.data
    yield from (swapped_modes(j, data.mode_names) for j in range(len(data.mode_names) - 1))
    read, reason = np.zeros(0, dtype=int), None
    if data.shapes is None:
        reason = "the test has no mode shapes ([test] shapes); frequencies do not show it"
    else:
        read = np.flatnonzero(np.any(np.isfinite(data.shapes), axis=1))
        reason = "a single sensor measures no mode shape" if len(read) < 2 else None
    if reason is not None:
        yield from (Silent(name, reason) for name in (MISSCALED, MISPLACED))
        return
    points = data.sensors.points[read]
    length = float(np.max(np.linalg.norm(points[:, None] - points[None, :], axis=2)))
    yield from (misscaled_sensor(int(i), 1 / len(read)) for i in read)
    if length > 0:
        ways = len(ways_of(data.sensors, data.sensors.points.shape[1]))
        yield from (misplaced_sensor(int(i), length, 1 / len(read), ways) for i in read)


def missed_modes(s: Setting) -> Found:
    """Modes of beams that the test did not find, such as those along them.

    Of beams alone: their model has no torsion and no motion across the plane, and its modes along
    the beams hardly show in the plane, so that counting modes goes wrong easily.
    """
    data = s.data
    if s.zones.laps is None:
        return
    reasons = {
        "measured mode shapes identify the modes": data.shapes is not None,
        "the damping ratio of an additional mode is not predicted": has_ratios(data),
        "the test is by level, and its modes are tracked": data.by_level,
    }
    reason = next((reason for reason, applies in reasons.items() if applies), None)
    if reason is not None:
        yield Silent(MISSED, reason)
        return
    yield from (missed_mode(j, data.mode_names) for j in range(len(data.mode_names)))
