"""Contact that is lost, or that the model has too much of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.effects.joint import LOST, PRIORS, distances, reach
from fenics_joints.diagnosis.zones.zone import LAYER, Zone

SMALLER = "contact area smaller than modelled"
_FAMILY = PRIORS[LAYER.name].family
#: Factor on a layer's stiffness at which it is about halfway to `LOST`, as a thin layer that stiff
#: gives way like the bodies do. [numerical: chosen]
_HALFWAY = 1e-3
#: Cut-offs at which the evidence is integrated. [numerical: chosen]
_SCAN = 60
_POWER = np.log2(np.log(LOST) / np.log(_HALFWAY))
#: Least width of a ring over the largest radius, as its cells are no points. [numerical: chosen]
_RING = 0.1
#: Share of the reach squared that stays in contact at any torque, or the bodies part. [numerical:
#: chosen]
_LAST_CONTACT = 0.05
#: Cut-off relative to the largest pressure: a tenth, within a factor of 3 either way (one standard
#: deviation). Rough faces carry shear from the first contact on, so it may be far lower; that it
#: be near the peak would leave hardly any contact. [prior: chosen]
_CUTOFF = (0.1, np.log(3.0))


def lost_contact(zones: Sequence[Zone]) -> Effect:
    """Contact lost where its pressure is below a cut-off (Fronk et al. 2019, eqs. 4 and 5).

    As the cut-off passes through the pressures of a zone the logarithm of its stiffness falls
    smoothly to that of next to nothing.

    Args:
        zones: Zones of the contact's layer, by ascending pressure; one that is open has none.
    """
    low, largest = zones[-1].pressure
    median, spread = _CUTOFF

    def apply(values, theta, condition):
        for zone in zones:
            a, b = zone.pressure
            # Over thrice its range, so that neighbours overlap and no cut-off is without slope.
            _lose(values, zone, (1 + (theta["cutoff"] - a) / (b - a)) / 3 if b > a else 1.0)

    # Something must stay in contact, or the bodies part.
    span = (1e-3 * largest, low)
    prior = Prior("cutoff", median * largest, spread, "Pa", True, span, scan=_SCAN)
    words = "The faces hold together only where the bolts press them hard enough."
    return Effect("contact lost at low pressure", "joint", (prior,), apply, words, False, _FAMILY)


def lost_beyond(zones: Sequence[Zone], reference: float | None = None) -> Effect:
    """Contact lost beyond a distance from the bolts, ring by ring as in `lost_contact`.

    Under a bell of pressure p = P (T / T_ref) (1 - (r / R)^2) contact is lost where p falls below
    a cut-off c P, so that the contact grows with the torque: r^2 = R^2 (1 - c T_ref / T). At one
    torque only, the distance itself is the parameter.

    Args:
        zones: Zones around bolts.
        reference: Torque at which the cut-off is c; None when the test has one torque only.
    """
    lose, radius = _beyond(zones)

    def apply(values, theta, condition):
        far = theta["radius"]
        if reference is not None:
            left = 1 - theta["cutoff"] * reference / condition
            # What no torque of the test presses hard enough keeps a last bit of contact.
            far = far * np.sqrt(np.maximum(left, _LAST_CONTACT))
        lose(values, far)

    words, priors = "The faces hold together only near the bolts.", [radius]
    if reference is not None:
        # The scan takes all other parameters for linear, which a cut-off is not.
        priors = [replace(radius, scan=0), Prior("cutoff", *_CUTOFF, "", True, (0.0, 0.9))]
        words = "The faces hold together only near the bolts, further out at higher torque."
    return Effect(
        "contact lost at low pressure",
        "joint",
        tuple(priors),
        apply,
        words,
        reference is not None,
        _FAMILY,
    )


def smaller_contact(zones: Sequence[Zone]) -> Effect:
    """Faces that touch up to a distance from the bolts only, at any torque: they are not flat, have
    a recess or a washer between them.

    Within it they may give way besides, so that its family is its own.

    Args:
        zones: Zones around bolts.
    """
    lose, radius = _beyond(zones)

    def apply(values, theta, condition):
        lose(values, theta["radius"])

    words = "The faces touch near the bolts only, whatever the torque: a recess, or not flat."
    return Effect(SMALLER, "joint", (radius,), apply, words, family="contact area")


def _beyond(zones: Sequence[Zone]) -> tuple[Callable[[dict[str, float], float], None], Prior]:
    """What takes the contact beyond a distance from the bolts, m, and that distance's prior."""
    low, high = distances(zones)
    middle = 0.5 * (low + high)
    width = np.maximum(high - low, _RING * np.max(high))

    def lose(values, radius):
        for zone, m, w in zip(zones, middle, width, strict=True):
            _lose(values, zone, 0.5 + (m - radius) / (3 * w))

    return lose, reach(low, high, scan=_SCAN)


def _lose(values: dict[str, float], zone: Zone, t: float) -> None:
    """Take a zone's stiffness: none of it at t = 0, all at t = 1."""
    factor = LOST ** (_smooth_step(t) ** _POWER)
    for key in zone.parameters():
        values[key] *= factor


def _smooth_step(t: float) -> float:
    """From 0 at 0 to 1 at 1, with a continuous slope."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)
