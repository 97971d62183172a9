"""Effects of bolts: some that are loose, and preloads below the nominal ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.effects.joint import EXPONENT, PRIORS
from fenics_joints.diagnosis.zones.zone import Zone

LOW_PRELOAD = "preload lower than nominal"
#: Actual over nominal preload: half, within a factor of 2. A torque wrench alone scatters by 25 %
#: (VDI 2230), settling and a forgotten pass of tightening take more. [prior: VDI 2230; median
#: chosen]
_PRELOAD = Prior("preload", 0.5, np.log(2.0), "", True, (0.02, 2.0))


#: Several bolts that are loose at once, at most, and what they are called. [prior: chosen]
_TOGETHER = {2: "two loose bolts", 3: "three loose bolts"}
#: Prior odds of so many at once against one: what loosens one, a joint that was forgotten or
#: vibrates, often loosens its neighbour. [prior: chosen]
_ODDS = {2: 0.5, 3: 0.25}


def loose_bolt(region: str, zones: Sequence[Zone], weight: float) -> Effect:
    """One bolt that does not press: its zones keep a small stiffness, at any torque.

    Args:
        region: The bolt.
        zones: The zones nearest to it.
        weight: Prior odds: one over the number of bolts.
    """
    words = f"{region[:1].upper()}{region[1:]} is loose, or missing"
    return _loose("loose bolt", region, zones, words, weight)


def loose_together(bolts: Mapping[str, Sequence[Zone]]) -> tuple[Effect, ...]:
    """Every two and every three of several bolts loose at once, but never all of them.

    What is left where they do not press is the same at each. The search puts those first that hold
    what leads alone (`Effect.holds`), so that of many bolts few sets are fitted.

    Args:
        bolts: The zones nearest to each bolt, by its name.
    """
    found = []
    for count, name in _TOGETHER.items():
        weight = _ODDS[count] / max(comb(len(bolts), count), 1)
        for chosen in combinations(bolts, count) if count < len(bolts) else ():
            zones = [zone for bolt in chosen for zone in bolts[bolt]]
            region = ", ".join(chosen)
            words = f"{region[:1].upper()}{region[1:]} are loose, or missing"
            alone = _keys(chosen, count - 1)
            found.append(_loose(name, region, zones, words, weight, alone))
    return tuple(found)


def _keys(bolts: Sequence[str], count: int) -> frozenset[str]:
    """Keys of the effects of so many of these bolts."""
    name = _TOGETHER.get(count, "loose bolt")
    return frozenset(f"{name} ({', '.join(some)})" for some in combinations(bolts, count))


def _loose(name, region, zones, words, weight, holds=frozenset()) -> Effect:
    interface, prior, effect = PRIORS[zones[0].interface.name].loose
    zones = [replace(zone, interface=interface) for zone in zones]
    them = "them" if holds else "it"

    def apply(values, theta, condition):
        for zone in zones:
            for kind in zone.interface.keys:
                zone.give_way(values, kind, theta[prior.name])

    return Effect(
        name,
        region,
        (prior,),
        apply,
        words + effect.format(them=them),
        family="bolt",
        weight=weight,
        holds=holds,
    )


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
