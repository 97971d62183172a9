"""Effects that show in damping, and in how frequencies change with the level of a test.

The level stands for the motion of the joint, to which it is proportional by a factor of each mode's
own: it is an amplitude, or a force as long as damping changes little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import RARE, Effect, Found, Prior, Setting, Silent
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.measurements.data import TestData

HYSTERETIC = "joint hysteretic damping"
VISCOUS = "joint viscous damping"
_DAMPING = "joint damping"
#: Why effects that show in damping alone are not looked for without usable damping ratios.
NO_RATIOS = "the test has no damping ratios of known accuracy ([test] damping, damping_noise)"
#: Loss factor of a joint's interface at small motion: 0.02, within a factor of 4 either way. With a
#: tenth of the strain energy in the joint it gives a damping ratio of 0.1 %; bolted structures of
#: metal have 0.05 to 0.5 %, most of it from their joints. [prior: damping ratios of bolted metal;
#: spread chosen]
_LOSS_FACTOR = (0.02, np.log(4.0), "", True, (0.0, 2.0))


def has_damping(data: TestData) -> bool:
    """Whether the damping of some mode was measured at two or more levels."""
    if not data.by_level or data.damping is None:
        return False
    return bool(np.any(np.sum(data.damping > 0, axis=0) > 1))


def has_ratios(data: TestData) -> bool:
    """Whether damping ratios are usable: their noise is stated, or they are of several levels."""
    stated = data.damping is not None and data.damping_noise is not None
    return has_damping(data) or bool(
        stated and not data.by_level and np.any(np.nan_to_num(data.damping) > 0)
    )


def hysteretic_damping(zones: Sequence[Zone]) -> Effect:
    """A loss factor of the joint, the same at all frequencies.

    Args:
        zones: Zones of the joint.
    """

    def loss(theta, condition, hz):
        return dict.fromkeys(_lossy(zones), theta["eta"])

    words = "The joint dissipates the same share of its energy in each cycle, at any frequency."
    return _damping(HYSTERETIC, "eta", loss, words)


def viscous_damping(zones: Sequence[Zone], hz_ref: float) -> Effect:
    """A loss factor of the joint proportional to the frequency, like that of an oil film.

    Args:
        zones: Zones of the joint.
        hz_ref: Frequency, Hz, at which ``eta_ref`` holds.
    """

    def loss(theta, condition, hz):
        return dict.fromkeys(_lossy(zones), theta["eta_ref"] * hz / hz_ref)

    words = "The loss factor of the joint grows with the frequency, like that of an oil film."
    return _damping(VISCOUS, "eta_ref", loss, words)


def _lossy(zones: Sequence[Zone]) -> list[str]:
    return [key for zone in zones for key in zone.parameters(zone.interface.damped)]


def _damping(name: str, parameter: str, loss, words: str) -> Effect:
    prior = Prior(parameter, *_LOSS_FACTOR)
    return Effect(name, "joint", (prior,), None, words, family=_DAMPING, loss=loss)


MICRO_SLIP = "micro-slip in the joint"
SOFTENING = "gapping without slip"
GROWING = "damping that grows without softening"
STIFFENING = "stiffening with the level"
NAMES = (MICRO_SLIP, SOFTENING, STIFFENING, GROWING)

_BY_LEVEL = "stiffness by the level"
#: Drop of the stiffness at the highest level: a tenth, within a factor of 4 either way. [prior:
#: chosen]
_DROP = Prior("drop", 0.1, np.log(4.0), span=(0.0, 20.0))
#: Segalman's chi of bolted joints: dissipation grows with the force to the power chi + 3, measured
#: as 2.2 to 2.9 (Segalman 2005; Smallwood, Gregory and Coleman 2000). [prior: Segalman 2005;
#: Smallwood, Gregory and Coleman 2000]
_CHI = Prior("chi", -0.4, 0.25, log=False, span=(-0.98, 0.0))
#: Power of the level with which stiffness drops elastically: 1 where a gap opens, 2 for large
#: deflections; less where rough faces part. [prior: 1 and 2 by mechanics, spread chosen]
_POWER = Prior("power", 1.0, 0.6, log=False, span=(0.1, np.inf))
#: Dissipation relative to an Iwan joint with the same drop of stiffness, within a factor of 3
#: either way: Masing's rule holds for sliders in parallel, but a real joint also slaps and rubs,
#: and its pressure changes with the amplitude; and a level of force fixes its motion only roughly.
#: [prior: Masing; spread chosen]
_LOSS = Prior("loss", 1.0, np.log(3.0), span=(0.02, 50.0))
#: Power of the level by which dissipation grows faster than in that Iwan joint. [prior: chosen]
_FASTER = Prior("faster", 0.0, 0.5, log=False, span=(-2.0, 2.0))
#: Relative rise of the joint's stiffness at the highest level, as large as a drop. It goes with the
#: square of the level, as any elastic stiffening of a symmetric structure does at first. [prior:
#: square by symmetry, size chosen]
_RISE = Prior("rise", 0.1, np.log(4.0), span=(0.0, 10.0))
#: Relative rise of the stiffness of a joint that also slips: a tenth of `_RISE`. [prior: chosen]
_RISE_BESIDE = replace(_RISE, median=0.01)
#: Loss factor of the whole structure at the highest level, from air and material, within a factor
#: of 4 either way. That of air grows with the velocity, that of a material with up to about the
#: first power of the stress. Joints dissipate most of the energy of a built-up structure (Ungar, J.
#: Sound Vib. 26, 1973): of a damping ratio of 0.3 % they leave some 0.05 %, a loss factor of 0.001.
#: [prior: Ungar 1973; spread chosen]
_GROWN = Prior("eta", 0.001, np.log(4.0), span=(0.0, 1.0))
#: Power of the level with which that loss factor grows. [prior: chosen]
_GROWTH = Prior("power", 1.0, 0.5, log=False, span=(0.05, 3.0))
#: Share of a stiffness that is left however large its drop. [numerical: chosen]
_LEFT = 0.05


def relative_drop(x: float) -> float:
    """A relative drop x of a stiffness, limited smoothly to below 1; within 2 % of x to x = 0.5."""
    most = 1 - _LEFT
    y = x / most
    return most * y / (1 + y**4) ** 0.25


def iwan_loss_factor(drop: float, chi: float) -> float:
    """Loss factor of an Iwan joint whose secant stiffness has fallen by a share ``drop``.

    Sliders of unit stiffness with strengths distributed as R phi^chi (Segalman, J. Appl. Mech. 72,
    2005) give at the amplitude u, below macro-slip and with the initial stiffness K, the backbone
    K u - R u^(chi + 2) / ((chi + 1) (chi + 2)), hence drop = R u^(chi + 1) / (K (chi + 1)
    (chi + 2)), and dissipate per cycle D = 4 R u^(chi + 3) / ((chi + 2) (chi + 3)). The loss
    factor is D / (2 pi K (1 - drop) u^2 / 2).

    Args:
        drop: Relative drop of the secant stiffness, 0 to below 1.
        chi: Exponent of the distribution, -1 < chi <= 0.
    """
    return drop / (1 - drop) * 4 * (chi + 1) / (np.pi * (chi + 3))


def micro_slip(zones: Sequence[Zone], reference: float) -> Effect:
    """Micro-slip: the tangential stiffness falls by a power of the level, and damping grows.

    With x = level / reference, G becomes G (1 - s) (1 + rise x^2), where s is the `relative_drop`
    of drop x^(1 + chi). All other stiffness of the joint has the factor 1 + rise x^2 alone: while
    the joint slips, parts that rock on each other touch further out, and large rotations and a
    suspension stiffen. The loss factor is `iwan_loss_factor` of s times ``loss`` x^``faster``: in
    an Iwan joint Masing's rule ties dissipation to softening, in a real joint they go together only
    roughly. A drift of the structure from level to level belongs to no law; see
    `fenics_joints.diagnosis.evidence.scales`.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``drop`` and ``rise`` hold.
    """
    slipping = [key for zone in zones for key in zone.parameters(zone.interface.slipping)]
    elastic = [key for zone in zones for key in zone.parameters()]

    def drop(theta, level) -> float:
        return relative_drop(theta["drop"] * (level / reference) ** (1 + theta["chi"]))

    def apply(values, theta, level):
        for key in elastic:
            values[key] *= 1 + theta["rise"] * (level / reference) ** 2
        for key in slipping:
            values[key] *= 1 - drop(theta, level)

    def loss(theta, level, hz):
        eta = theta["loss"] * (level / reference) ** theta["faster"]
        return dict.fromkeys(slipping, eta * iwan_loss_factor(drop(theta, level), theta["chi"]))

    words = (
        "Parts of the interface slip before the whole joint does: with the level, damping grows "
        "and stiffness falls, unless something else in the joint stiffens."
    )
    priors = (_DROP, _CHI, _LOSS, _FASTER, _RISE_BESIDE)
    return Effect(
        MICRO_SLIP, "joint", priors, apply, words, True, _BY_LEVEL, by_level=True, loss=loss
    )


def gapping(zones: Sequence[Zone], reference: float) -> Effect:
    """Gapping, or any other elastic softening of the joint, without damping.

    E and G fall by the `relative_drop` of drop (level / reference)^power.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``drop`` holds.
    """

    words = "The joint softens elastically with the level: gaps open, or its geometry changes."

    def factor(theta, x):
        return 1 - relative_drop(theta["drop"] * x ** theta["power"])

    return _elastic(SOFTENING, (_DROP, _POWER), zones, reference, factor, words)


def stiffening(zones: Sequence[Zone], reference: float) -> Effect:
    """Elastic stiffening with the square of the level, as in `micro_slip` but without slip.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``rise`` holds.
    """

    words = (
        "The joint stiffens with the level: more of the faces touch, rotations become large or "
        "the suspension stiffens. A drift from one level to the next has the same effect."
    )

    def factor(theta, x):
        return 1 + theta["rise"] * x**2

    return _elastic(STIFFENING, (_RISE,), zones, reference, factor, words)


def _elastic(name: str, priors, zones: Sequence[Zone], reference: float, factor, words) -> Effect:
    """Multiply all stiffness of the joint by ``factor(theta, level / reference)``."""
    keys = [key for zone in zones for key in zone.parameters()]

    def apply(values, theta, level):
        change = factor(theta, level / reference)
        for key in keys:
            values[key] *= change

    return Effect(name, "joint", priors, apply, words, True, _BY_LEVEL, by_level=True)


def growing_damping(reference: float) -> Effect:
    """Damping of the whole structure that grows with the level, at unchanged stiffness.

    It describes an observation, not a cause, and therefore has lower prior odds.

    Args:
        reference: Level at which its loss factor ``eta`` holds.
    """

    def loss(theta, level, hz):
        return {"": theta["eta"] * (level / reference) ** theta["power"]}

    words = "Damping grows with the level at constant stiffness: air, material or the suspension."
    return Effect(
        GROWING, "", (_GROWN, _GROWTH), None, words, True, by_level=True, loss=loss, weight=RARE
    )


def joint_damping(s: Setting) -> Found:
    """Hysteretic and viscous damping of the joint, which do not depend on the level."""
    if not len(s.zones):
        return
    if not has_ratios(s.data):
        yield from (Silent(name, NO_RATIOS) for name in (HYSTERETIC, VISCOUS))
        return
    yield hysteretic_damping(s.zones.all)
    yield viscous_damping(s.zones.all, float(np.exp(np.nanmean(np.log(s.data.frequencies_hz)))))


def amplitude_effects(s: Setting) -> Found:
    """Effects that change with the level of excitation or response."""
    data, zones = s.data, s.zones.all
    if not data.by_level or len(data) < 2:
        varies = f"varies the {data.condition_name}, not the level"
        reason = (
            f"the test {'has one level' if data.by_level else varies}; needed are the same modes "
            "at two or more levels of force or amplitude"
        )
        yield from (Silent(name, reason) for name in NAMES)
        return
    reference = float(data.conditions[-1])
    if zones:
        yield from (law(zones, reference) for law in (micro_slip, gapping, stiffening))
    else:
        of_joints = (MICRO_SLIP, SOFTENING, STIFFENING)
        yield from (Silent(name, "the model has no joint") for name in of_joints)
    if has_damping(data):
        yield growing_damping(reference)
    else:
        reason = "the test has no mode with damping ratios at two or more levels"
        yield Silent(GROWING, reason)
