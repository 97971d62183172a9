"""Effects of bolts: one that is loose, and preloads below the nominal ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.effects.joint import EXPONENT
from fenics_joints.diagnosis.zones.zone import GIVEN_LAP, Zone

__all__ = ["LOW_PRELOAD", "loose_bolt", "low_preload"]

LOW_PRELOAD = "preload lower than nominal"
#: What is left without its bolt of the stiffness of an interface between layers, Pa/m: faces that
#: rest on each other, a hundredth of clamped ones, within a factor of 10 either way. And of that of
#: a lap, relative: a tenth, within a factor of 3.
_LEFT = Prior("k", 1e10, np.log(10.0), "Pa/m", True, (1e6, 1e13))
_LEFT_OF_LAP = Prior("left", 0.1, np.log(3.0), "", True, (1e-4, 1.0))
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
    start = f"{region[:1].upper()}{region[1:]} is loose, or missing"
    if zones[0].interface.per_area:
        prior = _LEFT
        words = (
            f"{start}: the faces around it only rest on each other. All bolts equally loose are "
            "the joint's compliance as a whole."
        )
    else:
        prior = _LEFT_OF_LAP
        zones = [replace(zone, interface=GIVEN_LAP) for zone in zones]
        words = (
            f"{start}, and the lap softer around it. All bolts equally loose are the joint's "
            "stiffness as a whole."
        )

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
