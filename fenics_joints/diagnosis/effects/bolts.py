"""Effects of bolts: one that is loose, and preloads below the nominal ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.effects.joint import EXPONENT, PRIORS
from fenics_joints.diagnosis.zones.zone import Zone

__all__ = ["LOW_PRELOAD", "loose_bolt", "low_preload"]

LOW_PRELOAD = "preload lower than nominal"
#: Actual over nominal preload: half, within a factor of 2. A torque wrench alone scatters by 25 %
#: (VDI 2230), settling and a forgotten pass of tightening take more.
_PRELOAD = Prior("preload", 0.5, np.log(2.0), "", True, (0.02, 2.0))


def loose_bolt(region: str, zones: Sequence[Zone], weight: float) -> Effect:
    """One bolt that does not press: its zones keep a small stiffness, at any torque.

    Args:
        region: The bolt.
        zones: The zones nearest to it.
        weight: Prior odds: one over the number of bolts.
    """
    interface, prior, effect = PRIORS[zones[0].interface.name].loose
    zones = [replace(zone, interface=interface) for zone in zones]
    words = f"{region[:1].upper()}{region[1:]} is loose, or missing{effect}"

    def apply(values, theta, condition):
        for zone in zones:
            for kind in zone.interface.keys:
                zone.give_way(values, kind, theta[prior.name])

    return Effect("loose bolt", region, (prior,), apply, words, family="bolt", weight=weight)


def low_preload(region: str, zones: Sequence[Zone], name: str, weight: float = 1.0) -> Effect:
    """Preloads off by a common factor: the zones' stiffness times (actual / nominal)^beta.

    Only for a nominal joint with a stiffness of its own; see `Diagnose.joints` of the case.

    Args:
        region: The joint, or the bolt.
        zones: Zones that are pressed by it.
        name: Name of the effect.
        weight: Prior odds relative to other effects.
    """

    def apply(values, theta, condition):
        factor = theta["preload"] ** theta["beta"]
        for zone in zones:
            for key in zone.parameters():
                values[key] *= factor

    priors = (_PRELOAD, Prior("beta", *EXPONENT))
    words = "The bolts press less than the nominal model says, and the interface is softer for it."
    return Effect(name, region, priors, apply, words, family="preload", weight=weight)
