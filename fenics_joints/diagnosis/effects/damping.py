"""Effects that show in damping at rest; what the material and the suspension dissipate is free in
every hypothesis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.measurements.data import TestData

__all__ = [
    "HYSTERETIC", "VISCOUS", "has_damping", "has_ratios", "hysteretic_damping", "viscous_damping",
]  # fmt: skip

HYSTERETIC = "joint hysteretic damping"
VISCOUS = "joint viscous damping"
_FAMILY = "joint damping"
#: Loss factor of a joint's interface at small motion: 0.02, within a factor of 4 either way. With a
#: tenth of the strain energy in the joint that is a damping ratio of 0.1 %, and bolted structures
#: of metal have 0.05 to 0.5 %, most of it from their joints.
_LOSS = (0.02, np.log(4.0), "", True, (1e-5, 2.0))


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


def _lossy(zones: Sequence[Zone]) -> list[str]:
    return [key for zone in zones for key in zone.parameters(zone.interface.damped)]


def _damping(name: str, parameter: str, loss, words: str) -> Effect:
    prior = Prior(parameter, *_LOSS)
    return Effect(name, "joint", (prior,), None, words, family=_FAMILY, loss=loss)
