"""Effects that show only in how frequencies and damping change with the level of a test.

The level is what the joint's motion is proportional to, in each mode with a factor of its own: an
amplitude, or a force as long as the damping does not change much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects.damping import has_damping
from fenics_joints.diagnosis.effects.effect import DESCRIPTION, Effect, Prior, Silent
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.measurements.data import TestData

__all__ = [
    "NAMES", "amplitude_effects", "friction", "gapping", "growing_damping", "iwan_loss_factor",
    "micro_slip", "relative_drop",
]  # fmt: skip

MICRO_SLIP = "micro-slip in the joint"
SOFTENING = "gapping without slip"
GROWING = "damping that grows without softening"
FRICTION = "friction in the joint that hides its softening"
NAMES = (MICRO_SLIP, FRICTION, SOFTENING, GROWING)

_FAMILY = "softening with the level"
#: Drop of the stiffness at the highest level: a tenth, within a factor of 4 either way.
_DROP = Prior("drop", 0.1, np.log(4.0), span=(1e-5, 20.0))
#: Segalman's chi of bolted joints: dissipation grows with the force to the power chi + 3, which was
#: measured as 2.2 to 2.9 (Segalman 2005; Smallwood, Gregory and Coleman 2000).
_CHI = Prior("chi", -0.4, 0.25, log=False, span=(-0.98, 0.0))
#: Exponent of an elastic drop: 1 where a gap opens, 2 for large deflections; less where rough faces
#: part.
_POWER = Prior("power", 1.0, 0.6, log=False, span=(0.1, 4.0))
#: A real interface dissipates more or less than the power law's, and a force level tells its motion
#: only roughly: some 30 %.
_LOSS = Prior("loss", 1.0, 0.3, span=(0.2, 5.0))
#: Loss factor of all of the structure at the highest level, within a factor of 4 either way; of
#: air, it grows with the velocity, and of material, with a power of the stress up to about 1.
_GROWN = Prior("eta", 0.004, np.log(4.0), span=(1e-7, 1.0))
_GROWTH = Prior("power", 1.0, 0.5, log=False, span=(0.05, 3.0))
#: Loss factor of a joint that slips, at the highest level: a joint with a tenth of a mode's energy
#: then adds 0.25 % of damping; within a factor of 4 either way. It grows with the level as the
#: dissipation of bolted joints does, which is by its power 2.2 to 3 and more; see `_CHI`.
_SLIPPED = Prior("eta", 0.05, np.log(4.0), span=(1e-6, 3.0))
#: What is left of a stiffness at least.
_LEFT = 0.05


def relative_drop(x: float) -> float:
    """The drop x of a stiffness, kept smoothly below all of it: within 2 % of x up to x = 0.5."""
    most = 1 - _LEFT
    y = x / most
    return most * y / (1 + y**4) ** 0.25


def iwan_loss_factor(drop: float, chi: float) -> float:
    """Loss factor of an Iwan joint whose secant stiffness has fallen by a share ``drop``.

    Sliders of unit stiffness with strengths distributed as R phi^chi (Segalman, J. Appl. Mech. 72,
    2005) give at the amplitude u, below macro-slip and with K the stiffness at rest, the backbone
    K u - R u^(chi + 2) / ((chi + 1) (chi + 2)), hence drop = R u^(chi + 1) / (K (chi + 1)
    (chi + 2)), and dissipate in a cycle D = 4 R u^(chi + 3) / ((chi + 2) (chi + 3)). The loss
    factor is D / (2 pi K (1 - drop) u^2 / 2).

    Args:
        drop: Relative drop of the secant stiffness, 0 to below 1.
        chi: Exponent of the distribution, -1 < chi <= 0.
    """
    return drop / (1 - drop) * 4 * (chi + 1) / (np.pi * (chi + 3))


def micro_slip(zones: Sequence[Zone], reference: float) -> Effect:
    """Micro-slip: the tangential stiffness falls by a power of the level, and damping grows.

    G (1 - s), s = drop (level / reference)^(1 + chi); the loss factor is `iwan_loss_factor` of it
    times ``loss``.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``drop`` holds.
    """
    slipping = [key for zone in zones for key in zone.parameters(zone.interface.slipping)]

    def drop(theta, level) -> float:
        return relative_drop(theta["drop"] * (level / reference) ** (1 + theta["chi"]))

    def apply(values, theta, level):
        for key in slipping:
            values[key] *= 1 - drop(theta, level)

    def loss(theta, level, hz):
        eta = theta["loss"] * iwan_loss_factor(drop(theta, level), theta["chi"])
        return dict.fromkeys(slipping, eta)

    words = "Parts of the interface slip before all of it does: it softens and damps with the level"
    return Effect(
        MICRO_SLIP, "joint", (_DROP, _CHI, _LOSS), apply, f"{words}.", True, _FAMILY,
        by_level=True, loss=loss,
    )  # fmt: skip


def gapping(zones: Sequence[Zone], reference: float) -> Effect:
    """Gapping, or any other elastic softening of the joint: no damping comes with it.

    E and G fall by s = drop (level / reference)^power.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``drop`` holds.
    """

    def apply(values, theta, level):
        left = 1 - relative_drop(theta["drop"] * (level / reference) ** theta["power"])
        for zone in zones:
            for key in zone.parameters():
                values[key] *= left

    words = "The joint softens with the level elastically: gaps open, or its geometry changes."
    return Effect(SOFTENING, "joint", (_DROP, _POWER), apply, words, True, _FAMILY, by_level=True)


def friction(zones: Sequence[Zone], reference: float) -> Effect:
    """Micro-slip whose softening something hides: the joint's damping grows, its stiffness stays.

    In an Iwan joint Masing's rule ties dissipation to softening, in a measured one it often does
    not: faces that touch further out as they rock, large rotations or a suspension stiffen while
    it slips, and between levels a structure drifts. On the Brake-Reuss beam the damping grows
    fourfold and more while the frequency falls by 0.3 % and comes back. The loss factor is
    ``eta`` (level / reference)^``power``; the frequency says nothing of it.

    Args:
        zones: Zones of the joint.
        reference: Level at which ``eta`` holds.
    """
    slipping = [key for zone in zones for key in zone.parameters(zone.interface.slipping)]

    def apply(values, theta, level):
        pass

    def loss(theta, level, hz):
        return dict.fromkeys(slipping, theta["eta"] * (level / reference) ** theta["power"])

    words = (
        "The interface slips in part, so that its damping grows with the level; what stiffens or "
        "drifts besides hides that it softens."
    )
    return Effect(
        FRICTION, "joint", (_SLIPPED, _GROWTH), apply, words, True, _FAMILY, by_level=True,
        loss=loss,
    )  # fmt: skip


def growing_damping(reference: float) -> Effect:
    """Damping of all of the structure that grows with the level, at unchanged stiffness.

    It says what is seen and not what dissipates: it has the prior odds of a description.

    Args:
        reference: Level at which its loss factor ``eta`` holds.
    """

    def apply(values, theta, level):
        pass

    def loss(theta, level, hz):
        return {"": theta["eta"] * (level / reference) ** theta["power"]}

    words = "Damping grows with the level and the stiffness stays: air, material, the suspension."
    return Effect(
        GROWING, "", (_GROWN, _GROWTH), apply, words, True, by_level=True, loss=loss,
        weight=DESCRIPTION,
    )  # fmt: skip


def amplitude_effects(
    data: TestData, zones: Sequence[Zone]
) -> tuple[tuple[Effect, ...], tuple[Silent, ...]]:
    """The effects that this test can speak of, and those it cannot, each with the reason.

    Args:
        data: The test.
        zones: The joint's zones.
    """
    if not data.by_level or len(data) < 2:
        what = "level" if data.by_level else f"{data.condition_name} and not by level"
        is_one = f"the test has one {what}" if data.by_level else f"the test is by {what}"
        reason = f"{is_one}; it needs the same modes at two or more levels of force or amplitude"
        return (), tuple(Silent(name, reason) for name in NAMES)
    reference, effects, silent = float(data.conditions[-1]), [], []
    if zones:
        effects = [micro_slip(zones, reference), gapping(zones, reference)]
    else:
        alone = (MICRO_SLIP, FRICTION, SOFTENING)
        silent = [Silent(name, "the model has no joint") for name in alone]
    if has_damping(data):
        effects += [friction(zones, reference)] if zones else []
        effects.append(growing_damping(reference))
    else:
        reason = "the test has no damping ratio of any mode at two or more levels"
        silent += [Silent(name, reason) for name in (*([FRICTION] if zones else []), GROWING)]
    return tuple(effects), tuple(silent)
