"""Effects in joints: what their interfaces give way, everywhere or at a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect, Prior, in_series

__all__ = [
    "bell_pressure", "compliance", "graded_compliance", "lost_beyond", "lost_contact",
    "pressed_by_bolts", "pressed_compliance",
]  # fmt: skip

_FAMILY = "joint compliance"
#: Interface stiffness per area of clamped machined metal faces, Pa/m: 1e11 to 1e13 in the
#: literature, far less where the faces hardly touch; hence a factor of 30 either way.
_STIFFNESS = (1e12, np.log(30.0), (1e7, 1e16))
#: Exponent of K = alpha P^beta (seed 001, eqs. 22 and 23), P proportional to the torque.
_EXPONENT = (0.5, 0.3, (0.0, 1.5))
#: Factor on the stiffness of a layer where the contact is lost: too soft to carry anything. And one
#: at which it is about halfway, as a thin layer that stiff gives way like the bodies do.
_LOST, _HALFWAY = 1e-9, 1e-3
_SCAN = 60
_POWER = np.log2(np.log(_LOST) / np.log(_HALFWAY))
#: Prior odds of a law that describes a distribution of stiffness without a physical reason for it.
_DESCRIPTION = 0.25
#: Share of the reach squared that stays in contact at any torque, or the bodies part.
_LAST_CONTACT = 0.05
#: Cut-off relative to the largest pressure: a tenth, within a factor of 3 either way (one standard
#: deviation). Rough faces carry shear from the first contact on, so it may be far lower; that it
#: be near the peak would leave hardly any contact.
_CUTOFF = (0.1, np.log(3.0))
#: Radius to which a bolt presses, over that of its innermost ring: bodies spread its force in a
#: cone of 30 to 45 degrees (Shigley, Mechanical Engineering Design), from a head about as wide as
#: one body is thick; within a factor of 1.5 either way.
_REACH = (2.0, np.log(1.5))


def compliance(
    name: str,
    region: str,
    zones: Sequence[str],
    thickness: Mapping[str, float],
    *,
    normal: bool,
    tangential: bool,
    reference: float | None,
    describe: str,
    family: str = _FAMILY,
    weight: float = 1.0,
) -> Effect:
    """Interface compliance k = k_ref (T / T_ref)^beta, in series with what the model has.

    Args:
        name: Name of the effect.
        region: Where, for people.
        zones: Joint zones it acts in; each has parameters ``ZONE.E`` and ``ZONE.G``.
        thickness: Layer thickness of each zone, m.
        normal: Whether it acts normal to the interface.
        tangential: Whether it acts along it.
        reference: Torque at which k_ref holds; None when the test has one torque only, and the
            stiffness then does not depend on it.
        describe: Sentence for the report.
        family: Effects that it stands for.
        weight: Prior odds relative to other effects.
    """
    kinds = [kind for kind, on in (("n", normal), ("t", tangential)) if on]
    median, spread, span = _STIFFNESS
    priors = []
    for kind in kinds:
        priors.append(Prior(f"k_{kind}", median, spread, "Pa/m", True, span))
        if reference is not None:
            priors.append(_exponent(f"beta_{kind}"))

    def apply(values, theta, condition):
        for kind in kinds:
            k = theta[f"k_{kind}"]
            if reference is not None:
                k = k * (condition / reference) ** theta[f"beta_{kind}"]
            for zone in zones:
                in_series(values, f"{zone}.{_MODULUS[kind]}", k * thickness[zone])

    torque = reference is not None
    return Effect(name, region, tuple(priors), apply, describe, torque, family, weight=weight)


_MODULUS = {"n": "E", "t": "G"}


def _exponent(name: str) -> Prior:
    mean, sd, limits = _EXPONENT
    return Prior(name, mean, sd, "", False, limits)


def _stiffnesses(prefix: str = "") -> list[Prior]:
    median, spread, span = _STIFFNESS
    return [Prior(f"{prefix}k_{kind}", median, spread, "Pa/m", True, span) for kind in "nt"]


def graded_compliance(
    groups: Mapping[str, Sequence[str]],
    thickness: Mapping[str, float],
    reference: float | None,
    describe: str,
) -> Effect:
    """Compliance with stiffnesses of its own in every group of zones, and one exponent (seed 001).

    Args:
        groups: Zones of each group, by its name.
        thickness: Layer thickness of each zone, m.
        reference: As in `compliance`.
        describe: Sentence for the report.
    """
    priors = [prior for group in groups for prior in _stiffnesses(f"{group}.")]
    if reference is not None:
        priors.append(_exponent("beta"))

    def apply(values, theta, condition):
        factor = 1.0 if reference is None else (condition / reference) ** theta["beta"]
        for group, zones in groups.items():
            for kind, modulus in _MODULUS.items():
                k = theta[f"{group}.k_{kind}"] * factor
                for zone in zones:
                    in_series(values, f"{zone}.{modulus}", k * thickness[zone])

    name = "joint compliance graded from zone to zone"
    torque = reference is not None
    return Effect(
        name, "joint", tuple(priors), apply, describe, torque, _FAMILY, weight=_DESCRIPTION
    )


# -- by pressure -----------------------------------------------------------------------------------


def pressed_compliance(
    zones: Sequence[str], pressure: np.ndarray, thickness: Mapping[str, float]
) -> Effect:
    """Interface stiffness that grows with the pressure, k = k_ref (P / P_ref)^beta.

    Seed 001, eqs. 22 and 23; P_ref is the largest zone's. A zone without pressure is lost.

    Args:
        zones: Zones of the contact's layer.
        pressure: Pressure of each zone, Pa, (n,).
        thickness: Layer thickness of each zone, m.
    """
    relative = np.asarray(pressure) / float(np.max(pressure))

    def apply(values, theta, condition):
        _press(values, theta, zones, relative, 1.0, thickness)

    words = "The interface gives way, the more the less it is pressed."
    return Effect(
        "joint compliance that falls with the pressure", "joint",
        (*_stiffnesses(), _exponent("beta")), apply, words, False, _FAMILY,
    )  # fmt: skip


def _press(values, theta, zones, relative, factor, thickness) -> None:
    """Put stiffnesses k_ref (factor p)^beta of zones at relative pressures p in series."""
    for zone, p in zip(zones, relative, strict=True):
        for kind, modulus in _MODULUS.items():
            key = f"{zone}.{modulus}"
            k = theta[f"k_{kind}"] * (factor * p) ** theta["beta"] if p > 0 else 0.0
            floor = _LOST * values[key]
            values[key] = max(1 / (1 / values[key] + 1 / (k * thickness[zone] + floor)), floor)


def bell_pressure(low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """Mean over rings of a pressure max(0, 1 - (r / R)^2), relative to that at the bolt.

    Args:
        low: Inner radius of each ring, m, (n,).
        high: Outer radius, m, (n,).
        radius: R, m.

    Returns:
        Pressures, (n,), 0 to 1.
    """
    end = radius**2
    a, b = np.asarray(low, dtype=float) ** 2, np.asarray(high, dtype=float) ** 2

    def integral(x):
        x = np.minimum(x, end)
        return x - x**2 / (2 * end)

    thin = b - a < 1e-6 * np.maximum(b, end)
    mean = (integral(b) - integral(a)) / np.where(thin, 1.0, b - a)
    return np.where(thin, np.maximum(1 - b / end, 0.0), np.maximum(mean, 0.0))


def _reach(low: np.ndarray, high: np.ndarray, scan: int = 0) -> Prior:
    """How far from its axis a bolt presses."""
    median, spread = _REACH
    # A ring of one cell stands on the axis itself: a distance of nought says nothing of its reach.
    inner = max(float(np.min(high)), 0.2 * float(np.max(high)))
    # The innermost zone must be pressed, or nothing holds; beyond the last one all is the same.
    span = (1.05 * float(np.min(low)), 3.0 * float(np.max(high)))
    return Prior("radius", median * inner, spread, "m", True, span, scan)


def pressed_by_bolts(
    zones: Sequence[str],
    distance: np.ndarray,
    thickness: Mapping[str, float],
    reference: float | None,
) -> Effect:
    """Interface stiffness graded by a bell-shaped pressure about each bolt.

    k = k_ref (p T / T_ref)^beta with p of `bell_pressure`, whose radius is a parameter: k_ref is
    the stiffness at the bolt at the reference torque.

    Args:
        zones: Zones around bolts.
        distance: Least and largest distance of each zone from its bolt's axis, m, (n, 2).
        thickness: Layer thickness of each zone, m.
        reference: As in `compliance`.
    """
    low, high = np.asarray(distance, dtype=float).T

    def apply(values, theta, condition):
        factor = 1.0 if reference is None else condition / reference
        pressure = bell_pressure(low, high, theta["radius"])
        _press(values, theta, zones, pressure, factor, thickness)

    words = "The interface gives way, the more the further from the bolts that press it."
    return Effect(
        "joint compliance that falls with the pressure", "joint",
        (*_stiffnesses(), _exponent("beta"), _reach(low, high)), apply, words,
        reference is not None, _FAMILY,
    )  # fmt: skip


# -- contact lost ----------------------------------------------------------------------------------


def lost_contact(zones: Sequence[str], low: np.ndarray, high: np.ndarray) -> Effect:
    """Contact lost where its pressure is below a cut-off (seed 004, eqs. 4 and 5).

    As the cut-off passes through the pressures of a zone the logarithm of its stiffness falls
    smoothly to that of next to nothing.

    Args:
        zones: Zones of the contact's layer, by ascending pressure.
        low: Least pressure of each zone, Pa, (n,).
        high: Largest pressure of each zone, Pa, (n,); zero for one that is open.
    """
    largest = float(high[-1])
    median, spread = _CUTOFF

    def apply(values, theta, condition):
        for zone, a, b in zip(zones, low, high, strict=True):
            # Over thrice its range, so that neighbours overlap and no cut-off is without slope.
            _lose(values, zone, (1 + (theta["cutoff"] - a) / (b - a)) / 3 if b > a else 1.0)

    # Something must stay in contact, or the bodies part.
    span = (1e-3 * largest, float(low[-1]))
    prior = Prior("cutoff", median * largest, spread, "Pa", True, span, scan=_SCAN)
    words = "The faces hold together only where the bolts press them hard enough."
    return Effect("contact lost at low pressure", "joint", (prior,), apply, words, False, _FAMILY)


def lost_beyond(
    zones: Sequence[str], distance: np.ndarray, reference: float | None = None
) -> Effect:
    """Contact lost beyond a distance from the bolts, ring by ring as in `lost_contact`.

    Under a bell of pressure p = P (T / T_ref) (1 - (r / R)^2) contact is lost where p falls below
    a cut-off c P, so that the contact grows with the torque: r^2 = R^2 (1 - c T_ref / T). At one
    torque only, the distance itself is the parameter.

    Args:
        zones: Zones around bolts.
        distance: Least and largest distance of each zone from its bolt's axis, m, (n, 2).
        reference: Torque at which the cut-off is c; None when the test has one torque only.
    """
    low, high = np.asarray(distance, dtype=float).T
    middle = 0.5 * (low + high)
    # Of a ring one cell wide too, as its cells are no points.
    width = np.maximum(high - low, 0.1 * np.max(high))

    def apply(values, theta, condition):
        radius = theta["radius"]
        if reference is not None:
            left = 1 - theta["cutoff"] * reference / condition
            # What no torque of the test presses hard enough keeps a last bit of contact.
            radius *= np.sqrt(max(left, _LAST_CONTACT))
        for zone, m, w in zip(zones, middle, width, strict=True):
            _lose(values, zone, 0.5 + (m - radius) / (3 * w))

    words = "The faces hold together only near the bolts."
    # The scan takes all other parameters for linear, which a cut-off is not.
    priors = [_reach(low, high, scan=_SCAN if reference is None else 0)]
    if reference is not None:
        priors.append(Prior("cutoff", *_CUTOFF, "", True, (1e-4, 0.9)))
        words = "The faces hold together only near the bolts, further out at higher torque."
    return Effect(
        "contact lost at low pressure", "joint", tuple(priors), apply, words,
        reference is not None, _FAMILY,
    )  # fmt: skip


def _lose(values: dict[str, float], zone: str, t: float) -> None:
    """Take a zone's stiffness: none of it at t = 0, all at t = 1."""
    factor = _LOST ** (_smooth_step(t) ** _POWER)
    values[f"{zone}.E"] *= factor
    values[f"{zone}.G"] *= factor


def _smooth_step(t: float) -> float:
    """From 0 at 0 to 1 at 1, with a continuous slope."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3 - 2 * t)
