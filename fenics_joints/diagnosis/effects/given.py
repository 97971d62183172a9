"""Effects in joints with a stiffness of their own: stiffer than given, and touching less."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.effects.joint import EXPONENT, PRIORS
from fenics_joints.diagnosis.zones.zone import Zone

STIFFER = "joint stiffer than given"
#: Of a part of it.
STIFFER_AT = "joint stiffer than given at one place"
#: Actual over given stiffness. What is given comes from a like joint, a table or a handful of
#: decades in which measured interfaces lie: five times, within a factor of 5 either way. [prior:
#: chosen]
_FACTOR = Prior("factor", 5.0, np.log(5.0), "", True, (1.0, np.inf))


def stiffer_joint(
    name: str, region: str, zones: Sequence[Zone], reference: float | None, weight: float = 1.0
) -> Effect:
    """Zones whose given stiffness is too low, across and along alike: times a factor above one.

    Softer ones are what an interface in series makes (`joint.gives_way`), which no joint stiffer
    than given is.

    Args:
        name: `STIFFER`, or `STIFFER_AT` of some zones.
        region: Where, for people.
        zones: The zones, of layers.
        reference: Torque at which the factor holds, which grows with a power of it; None when the
            test has one torque only.
        weight: Prior odds relative to other effects.
    """
    keys = [key for zone in zones for key in zone.parameters()]

    def apply(values, theta, condition):
        factor = theta["factor"]
        if reference is not None:
            factor = factor * (condition / reference) ** theta["beta"]
        for key in keys:
            values[key] *= factor

    priors = (_FACTOR,) if reference is None else (_FACTOR, Prior("beta", *EXPONENT))
    words = "The faces hold together better than the stiffness that the model was given."
    return Effect(
        name,
        region,
        priors,
        apply,
        words,
        reference is not None,
        PRIORS[zones[0].interface.name].family,
        weight=weight,
    )
