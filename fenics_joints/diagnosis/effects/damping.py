"""Effects that show in damping at rest; what the material and the suspension dissipate is free in
every hypothesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.measurements.data import TestData

HYSTERETIC = "joint hysteretic damping"
VISCOUS = "joint viscous damping"
SUPPORTS = "damping of the supports"
_FAMILY = "joint damping"
#: Loss factor of a joint's interface at small motion: 0.02, within a factor of 4 either way. With a
#: tenth of the strain energy in the joint that is a damping ratio of 0.1 %, and bolted structures
#: of metal have 0.05 to 0.5 %, most of it from their joints. [prior: damping ratios of bolted
#: metal; spread chosen]
_LOSS = (0.02, np.log(4.0), "", True, (0.0, 2.0))
#: Of what holds a structure: clamped metal has 0.01, wood, foam and rubber 0.05 to 0.3 (Beards,
#: Structural Vibration, 1996), and a foot that radiates into the ground as much; within a factor of
#: 4 either way. [prior: Beards 1996]
_HELD = Prior("eta", 0.05, np.log(4.0), "", True, (1e-4, 2.0))


def has_damping(data: TestData) -> bool:
    """Whether the damping of some mode was measured at two or more levels."""
    if not data.by_level or data.damping is None:
        return False
    return bool(np.any(np.sum(data.damping > 0, axis=0) > 1))


def has_ratios(data: TestData) -> bool:
    """Whether a test's damping ratios count: it says how good they are, or has several levels."""
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

    words = "The joint dissipates a share of what it stores in a cycle, at any frequency."
    return _damping(HYSTERETIC, "eta", loss, words)


def viscous_damping(zones: Sequence[Zone], hz_ref: float) -> Effect:
    """A loss factor of the joint proportional to the frequency, as of a film of oil.

    Args:
        zones: Zones of the joint.
        hz_ref: Frequency, Hz, at which ``eta_ref`` holds.
    """

    def loss(theta, condition, hz):
        return dict.fromkeys(_lossy(zones), theta["eta_ref"] * hz / hz_ref)

    words = "The joint dissipates in proportion to the frequency, as a film of oil does."
    return _damping(VISCOUS, "eta_ref", loss, words)


def spring_damping(springs: Sequence[str], region: str, weight: float = 1.0) -> Effect:
    """A loss factor of the springs on which the structure stands or hangs.

    Args:
        springs: Their names; each has a parameter ``NAME.stiffness``.
        region: Where, for people.
        weight: Prior odds: one over the number of such places.
    """

    def loss(theta, condition, hz):
        return {f"{name}.stiffness": theta["eta"] for name in springs}

    words = "What the structure hangs or stands on dissipates a share of what it stores in a cycle."
    return Effect(
        SUPPORTS,
        region,
        (_HELD,),
        None,
        words,
        family=SUPPORTS,
        loss=loss,
        weight=weight,
        beside=True,
    )


def support_damping(supports: Sequence[str], gives_way: Effect) -> Effect:
    """Supports that give way and dissipate a share of what they store: one that is rigid does none.

    Args:
        supports: Their names; each has parameters ``NAME.k_n`` and ``NAME.k_t``.
        gives_way: Their compliance (`rig.support_compliance`).
    """

    def loss(theta, condition, hz):
        return {f"{name}.{key}": theta["eta"] for name in supports for key in ("k_n", "k_t")}

    words = "What holds the structure gives way, and dissipates a share of what it stores."
    return replace(
        gives_way,
        name=SUPPORTS,
        priors=(*gives_way.priors, _HELD),
        describe=words,
        loss=loss,
        beside=True,
    )


def _lossy(zones: Sequence[Zone]) -> list[str]:
    return [key for zone in zones for key in zone.parameters(zone.interface.damped)]


def _damping(name: str, parameter: str, loss, words: str) -> Effect:
    prior = Prior(parameter, *_LOSS)
    return Effect(name, "joint", (prior,), None, words, family=_FAMILY, loss=loss)
