"""Effects of bolts: one that is loose, and preloads below the nominal ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior, in_series

__all__ = ["LOW_PRELOAD", "loose_bolt", "low_preload"]

LOW_PRELOAD = "preload lower than nominal"
#: What is left of the interface's stiffness without its bolt, Pa/m: faces that rest on each other,
#: a hundredth of clamped ones, within a factor of 10 either way.
_LEFT = (1e10, np.log(10.0), (1e6, 1e13))
#: Actual over nominal preload: half, within a factor of 2. A torque wrench alone scatters by 25 %
#: (VDI 2230), settling and a forgotten pass of tightening take more.
_PRELOAD = (0.5, np.log(2.0), (0.02, 2.0))
#: Exponent of K = alpha P^beta (seed 001, eqs. 22 and 23).
_EXPONENT = (0.5, 0.3, (0.0, 1.5))


def loose_bolt(
    region: str, zones: Sequence[str], thickness: Mapping[str, float], weight: float
) -> Effect:
    """One bolt that does not press: its zones keep a small stiffness k, at any torque.

    Args:
        region: The bolt.
        zones: The zones nearest to it.
        thickness: Layer thickness of each zone, m.
        weight: Prior odds: one over the number of bolts.
    """

    def apply(values, theta, condition):
        for zone in zones:
            for modulus in ("E", "G"):
                in_series(values, f"{zone}.{modulus}", theta["k"] * thickness[zone])

    median, spread, span = _LEFT
    words = (
        f"{region[:1].upper()}{region[1:]} is loose, or missing: the faces around it only rest on "
        "each other. All bolts equally loose are the joint's compliance as a whole."
    )
    prior = Prior("k", median, spread, "Pa/m", True, span)
    return Effect("loose bolt", region, (prior,), apply, words, family="bolt", weight=weight)


def low_preload(
    region: str,
    zones: Sequence[str],
    name: str,
    weight: float = 1.0,
    keys: Sequence[str] = ("E", "G"),
) -> Effect:
    """Preloads off by a common factor: the zones' stiffness times (actual / nominal)^beta.

    Only for a nominal joint with a stiffness of its own; see `Diagnose.joints` of the case.

    Args:
        region: The joint, or the bolt.
        zones: Zones that are pressed by it.
        name: Name of the effect.
        weight: Prior odds relative to other effects.
        keys: Parameters ``ZONE.KEY`` that it acts on.
    """

    def apply(values, theta, condition):
        factor = theta["preload"] ** theta["beta"]
        for zone in zones:
            for key in keys:
                values[f"{zone}.{key}"] *= factor

    median, spread, span = _PRELOAD
    mean, sd, limits = _EXPONENT
    priors = (
        Prior("preload", median, spread, "", True, span),
        Prior("beta", mean, sd, "", False, limits),
    )
    words = "The bolts press less than the nominal model says, and the interface is softer for it."
    return Effect(name, region, priors, apply, words, family="preload", weight=weight)
