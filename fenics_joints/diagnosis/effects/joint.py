"""Effects in joints: compliant interfaces, lost contact, loose bolts, and low preload.

All act on zones, whatever these are of: a zone knows how an interface of a stiffness k enters the
model's parameters (`fenics_joints.diagnosis.zones.zone.Zone.give_way`), and the table `PRIORS` has
the prior of k, and the names of the effects, for each kind of zones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb

import numpy as np

from fenics_joints.diagnosis.effects.effect import (
    RARE,
    Effect,
    Found,
    Prior,
    Setting,
    Silent,
    relative_error,
)
from fenics_joints.diagnosis.zones.zone import GIVEN_LAP, LAP, LAYER, Zone, ZoneInterface, Zones

#: Exponent of K = alpha P^beta (Tian et al. 2021, eqs. 22 and 23), P proportional to the torque.
#: [prior: Tian et al. 2021, eqs. 22 and 23; spread chosen]
EXPONENT = (0.5, 0.3, "", False, (0.0, 1.5))
#: Factor on the stiffness of a layer where the contact is lost: too soft to carry anything.
#: [numerical: chosen]
LOST = 1e-9
#: Radius to which a bolt presses, over that of its innermost ring: bodies spread its force in a
#: cone of 30 to 45 degrees (Shigley, Mechanical Engineering Design), from a head about as wide as
#: one body is thick; within a factor of 1.5 either way. [prior: Shigley; spread chosen]
_REACH = (2.0, np.log(1.5))
#: Its limits over the least and the largest distance of a zone, as the innermost must be pressed,
#: and beyond the last one all is the same; and the least radius of the innermost ring over that of
#: the last one, as one cell on the axis says nothing of the reach. [prior: chosen]
_LEAST, _MOST, _INNER = 1.05, 3.0, 0.2
#: Spread of the logarithm of a factor on the axial stiffness of a lap. [prior: chosen]
AXIAL = float(np.log(3.0))


@dataclass(frozen=True)
class InterfacePrior:
    """Prior of the stiffness of an interface, and names of the effects that it is a parameter of.

    Attributes:
        known: Median, spread, unit, whether log-normal, and limits of its prior.
        names: Name of the stiffness of a kind in all zones together, and in a group of them.
        exponents: Name of its exponent in the torque, likewise.
        family: Effects that stand for each other.
        alone: Names and descriptions of the effect on all zones together, by kinds.
        graded: Name and description of the effect on groups of zones: ``what`` gives way, ``how``.
        graded_kinds: The kinds for which that is looked for.
        at_one: Name of the effect at one place of a ``kind``, and its description.
        loose: Where a bolt does not press: the kind of the remaining interface, the prior of its
            stiffness, and the end of a sentence on it.
    """

    known: tuple
    names: tuple[str, str]
    exponents: tuple[str, str]
    family: str
    alone: Mapping[tuple[str, ...], tuple[str, str]]
    graded: tuple[str, str]
    graded_kinds: tuple[tuple[str, ...], ...]
    at_one: tuple[str, str]
    loose: tuple[ZoneInterface, Prior, str]


#: Stiffness per area of clamped machined metal faces: 1e11 to 1e13 in the literature, far less
#: where the faces hardly touch; hence a factor of 30 either way. [prior: measured interfaces,
#: literature]
_CLAMPED = (1e12, np.log(30.0), "Pa/m", True, (1e7, 1e16))
#: Of faces that rest on each other: a hundredth of clamped ones, within a factor of 10 either way.
#: [prior: chosen]
_RESTING = Prior("k", 1e10, np.log(10.0), "Pa/m", True, (1e6, 1e13))
#: In series with a lap as one piece: as stiff as it, the same spread as of clamped faces. [prior:
#: as of clamped faces]
_IN_LAP = (1.0, np.log(30.0), "", True, (1e-5, 1e6))
#: Share of a lap's stiffness that remains around a loose bolt: a tenth, within a factor of 3.
#: [prior: chosen]
_LEFT = Prior("left", 0.1, np.log(3.0), "", True, (0.0, 1.0))
#: Where the lap's own stiffness was given, identified elsewhere or taken from a like joint, a
#: factor on it, within a factor of 3. [prior: chosen]
_GIVEN = (1.0, np.log(3.0), "", True)
#: Prior odds of a law by pressure along the plane alone against one that is the same everywhere:
#: what no data tell apart has the plainer name. [prior: chosen]
_LESS_PLAIN = 0.5

_LAYER = InterfacePrior(
    known=_CLAMPED,
    names=("k_{kind}", "{group}.k_{kind}"),
    exponents=("beta_{kind}", "beta"),
    family="joint compliance",
    alone={
        ("n",): ("joint normal compliance", "The joint is compliant in its normal direction."),
        ("t",): (
            "joint tangential compliance",
            "The joint is compliant in its tangential direction.",
        ),
        ("n", "t"): (
            "joint normal and tangential compliance",
            "The joint is compliant in its normal and its tangential direction.",
        ),
    },
    graded=(
        "joint compliance graded {how}",
        "The joint is compliant, with another stiffness under the bolts than away from them.",
    ),
    graded_kinds=(("n", "t"),),
    at_one=("compliance at one {kind}", "The joint is more compliant at {place} than elsewhere."),
    loose=(
        LAYER,
        _RESTING,
        ": the faces around {them} only rest on each other. If all bolts were equally loose, this "
        "would be a compliance of the whole joint.",
    ),
)
_LAP = InterfacePrior(
    known=_IN_LAP,
    names=("{kind}", "{group}, {kind}"),
    exponents=("beta of {kind}", "beta of {kind}"),
    family="lap stiffness",
    alone={
        ("slap",): (
            "joint slap stiffness",
            "The normal stiffness of the lap, against opening and shear, differs from the model's.",
        ),
        ("slip",): (
            "joint slip stiffness",
            "The tangential stiffness of the lap, against sliding, differs from the model's.",
        ),
        ("slap", "slip"): (
            "joint slap and slip stiffness",
            "The normal and the tangential stiffness of the lap differ from the model's.",
        ),
    },
    graded=(
        "joint {what} stiffness graded {how}",
        "The stiffness of the lap varies along it: it differs {how}.",
    ),
    graded_kinds=(("slap",), ("slip",), ("slap", "slip")),
    at_one=(
        "joint stiffness at one {kind}",
        "{place} alone is softer or stiffer than in the model.",
    ),
    loose=(
        GIVEN_LAP,
        _LEFT,
        ", and the lap is softer around {them}. If all bolts were equally loose, this would be "
        "the stiffness of the whole joint.",
    ),
)
#: By kind of zones.
PRIORS = {LAYER.name: _LAYER, LAP.name: _LAP, GIVEN_LAP.name: replace(_LAP, known=_GIVEN)}


def interfaces(zones: Sequence[Zone], baseline: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Interfaces of the priors' median stiffness, by zone and by the parameter they act on.

    Args:
        zones: The zones.
        baseline: Parameter values of the nominal model.

    Returns:
        Values that put in series with the zones' own are the interface.
    """
    return {
        zone.name: {
            key: zone.amount(PRIORS[zone.interface.name].known[0], baseline[f"{zone.name}.{key}"])
            for key in zone.interface.keys.values()
        }
        for zone in zones
    }


def compliant(
    name: str,
    region: str,
    zones: Sequence[Zone] | Mapping[str, Sequence[Zone]],
    kinds: Sequence[str] | None = None,
    reference: float | None = None,
    describe: str = "",
    *,
    family: str | None = None,
    weight: float = 1.0,
) -> Effect:
    """Interfaces of stiffness k = k_ref (T / T_ref)^beta in zones that the model has too stiff.

    Args:
        name: Name of the effect.
        region: Where, for people.
        zones: The zones it acts in, all of one kind; or groups of them by name, each with a
            stiffness of its own.
        kinds: What gives way, of the interface's keys; all by default.
        reference: Torque at which k_ref holds; None when the test has one torque only, and the
            stiffness then does not depend on it.
        describe: Sentence for the report.
        family: Effects that it stands for; by default the kind's.
        weight: Prior odds relative to other effects.
    """
    in_groups = isinstance(zones, Mapping)
    groups = zones if in_groups else {"": zones}
    interface = next(iter(groups.values()))[0].interface
    law, kinds = PRIORS[interface.name], tuple(kinds or interface.keys)
    label, exponent = law.names[in_groups], law.exponents[in_groups]
    betas = {kind: exponent.format(kind=kind) for kind in kinds}
    priors = {}
    for group in groups:
        for kind in kinds:
            key = label.format(group=group, kind=kind)
            priors[key] = Prior(key, *law.known)
            if reference is not None and not in_groups:
                priors[betas[kind]] = Prior(betas[kind], *EXPONENT)
    if reference is not None:
        priors |= {beta: Prior(beta, *EXPONENT) for beta in betas.values()}

    def apply(values, theta, condition):
        for group, members in groups.items():
            for kind in kinds:
                k = theta[label.format(group=group, kind=kind)]
                if reference is not None:
                    k = k * (condition / reference) ** theta[betas[kind]]
                for zone in members:
                    zone.give_way(values, kind, k)

    own, by_torque = tuple(priors.values()), reference is not None
    family = law.family if family is None else family
    return Effect(name, region, own, apply, describe, by_torque, family, weight=weight)


def graded(
    groups: Mapping[str, Sequence[Zone]], kinds: Sequence[str], how: str, reference: float | None
) -> Effect:
    """Stiffnesses of their own in every group of zones (Tian et al. 2021).

    Args:
        groups: Zones of each group, by its name.
        kinds: See `compliant`.
        how: How the groups differ, in words.
        reference: See `compliant`.
    """
    law, what = PRIORS[next(iter(groups.values()))[0].interface.name], " and ".join(kinds)
    name, words = (text.format(what=what, how=how) for text in law.graded)
    return compliant(name, "joint", groups, kinds, reference, words, weight=RARE)


#: Spread of the logarithm of a property of a law of the user's own, as a cause, where it has no
#: bounds: within a factor of 3 either way. [prior: chosen]
OWN_SPREAD = float(np.log(3.0))


def own_law_errors(s: Setting) -> Found:
    """Properties of joint laws of the user's own that are not what the case says."""
    for name, section in s.case.joints.items():
        law = section.own_law
        for key, value in ({} if law is None else section.nominal()).items():
            if value == 0:
                yield Silent(f"{key} of {name}", "it is zero in the model; give its expected value")
                continue
            bounds = law.bounds.get(key, (0.0, np.sign(value) * np.inf))
            what = f"{key} of {name}"
            yield _own_error(what, what, name, f"{name}.{key}", value, bounds)


def parameter_errors(s: Setting) -> Found:
    """Parameters of a model by forms that are not what it says."""
    for name, parameter in s.parameters.items():
        if parameter.value == 0:
            yield Silent(
                f"error of {name}", "it is zero in the model, and a factor does not change it"
            )
            continue
        bounds = parameter.lower, parameter.upper
        yield _own_error(f"error of {name}", name, "", name, parameter.value, bounds)


def parameter_tolerances(spreads: Mapping[str, float]) -> tuple[Effect, ...]:
    """Parameters of a model by forms that are free within their tolerance."""
    return tuple(
        relative_error(f"{name}, within tolerance", "", [name], spread, "")
        for name, spread in spreads.items()
    )


def _own_error(title: str, what: str, region: str, name: str, value: float, bounds) -> Effect:
    """A parameter of the user's own that is off by a factor, within its bounds."""
    low, high = sorted(bound / value for bound in bounds)
    words, span = f"{what} differs from the model's.", (max(low, 0.0), high)
    return relative_error(title, region, [name], OWN_SPREAD, words, span=span)


# -- by pressure -----------------------------------------------------------------------------------


def pressed_compliance(zones: Sequence[Zone]) -> Effect:
    """Interface stiffness that grows with the pressure, k = k_ref (P / P_ref)^beta.

    Tian et al. 2021, eqs. 22 and 23; P_ref is the largest zone's. A zone without pressure is lost.

    Args:
        zones: Zones of the contact's layer; the middle of each one's pressures counts.
    """
    pressure = np.array([0.5 * sum(zone.pressure) for zone in zones])
    relative, kinds = pressure / float(np.max(pressure)), tuple(LAYER.keys)

    def apply(values, theta, condition):
        _press(values, theta, zones, relative, 1.0, kinds)

    name, words = "joint compliance", "The joint is compliant, more so where its pressure is low."
    return _falling(name, _pressed_priors(kinds), apply, words)


def _falling(name: str, priors, apply, words: str, by_torque=False, weight=1.0) -> Effect:
    """An effect of an interface that is stiffer where it is pressed more."""
    name = f"{name} that falls with the pressure"
    family = _LAYER.family
    return Effect(name, "joint", priors, apply, words, by_torque, family, weight=weight)


def _pressed_priors(kinds: Iterable[str]) -> tuple[Prior, ...]:
    springs = (Prior(f"k_{kind}", *_LAYER.known) for kind in kinds)
    return (*springs, Prior("beta", *EXPONENT))


def _press(values, theta, zones, relative, factor, kinds) -> None:
    """Put stiffnesses k_ref (factor p)^beta of zones at relative pressures p in series."""
    many = np.ndim(factor) or np.ndim(theta["beta"])
    p = relative[:, None] if many and relative.ndim == 1 else relative
    # Of no pressure the power could be endless.
    power = np.where(p > 0, np.where(p > 0, factor * p, 1.0) ** theta["beta"], 0.0)
    stiffness = [theta[f"k_{kind}"] * power for kind in kinds]
    for i, zone in enumerate(zones):
        for k, key in zip(stiffness, zone.parameters(kinds), strict=True):
            floor = LOST * values[key]
            amount = zone.amount(k[i], values[key]) + floor
            values[key] = np.maximum(1 / (1 / values[key] + 1 / amount), floor)


def bell_pressure(low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """Mean over rings of a pressure max(0, 1 - (r / R)^2), relative to that at the bolt.

    Args:
        low: Inner radius of each ring, m, (n,).
        high: Outer radius, m, (n,).
        radius: R, m; or many, (b,).

    Returns:
        Pressures, (n,) or (n, b), 0 to 1.
    """
    end = np.asarray(radius) ** 2
    a, b = (np.reshape(r, (-1, *(1 for _ in end.shape))).astype(float) ** 2 for r in (low, high))

    def integral(x):
        x = np.minimum(x, end)
        return x - x**2 / (2 * end)

    thin = b - a < 1e-6 * np.maximum(b, end)
    mean = (integral(b) - integral(a)) / np.where(thin, 1.0, b - a)
    return np.where(thin, np.maximum(1 - b / end, 0.0), np.maximum(mean, 0.0))


def distances(zones: Sequence[Zone]) -> np.ndarray:
    """Least and largest distance of each zone from its bolt, m, (2, n).

    Args:
        zones: Zones around bolts.
    """
    return np.array([zone.distance for zone in zones]).T


def reach(low: np.ndarray, high: np.ndarray, scan: int = 0) -> Prior:
    """How far from its axis a bolt presses, m.

    Args:
        low: Least distance of each zone from its bolt, m, (n,).
        high: Largest, m, (n,).
        scan: See `Prior`.
    """
    median, spread = _REACH
    # A ring of one cell stands on the axis itself: a distance of nought says nothing of its reach.
    inner = max(float(np.min(high)), _INNER * float(np.max(high)))
    # The innermost zone must be pressed, or nothing holds; beyond the last one all is the same.
    span = (_LEAST * float(np.min(low)), _MOST * float(np.max(high)))
    return Prior("radius", median * inner, spread, "m", True, span, scan)


def pressed_by_bolts(
    zones: Sequence[Zone], reference: float | None, kinds: Sequence[str] | None = None
) -> Effect:
    """Interface stiffness graded by a bell-shaped pressure about each bolt.

    k = k_ref (p T / T_ref)^beta with p of `bell_pressure`, whose radius is a parameter: k_ref is
    the stiffness at the bolt at the reference torque.

    Args:
        zones: Zones around bolts.
        reference: See `compliant`.
        kinds: ``("t",)`` where the interface gives way along its plane alone; both for None.
    """
    low, high = distances(zones)
    kinds = tuple(kinds or LAYER.keys)

    def apply(values, theta, condition):
        factor = 1.0 if reference is None else condition / reference
        pressure = bell_pressure(low, high, theta["radius"])
        _press(values, theta, zones, pressure, factor, kinds)

    name, words, weight = "joint compliance", "The joint is compliant", 1.0
    if tuple(LAYER.keys) != kinds:
        (name, words), weight = _LAYER.alone[kinds], _LESS_PLAIN
    words = f"{words.rstrip('.')}, more so the farther from the bolts."
    priors = (*_pressed_priors(kinds), reach(low, high))
    return _falling(name, priors, apply, words, reference is not None, weight)


STIFFER = "joint stiffer than given"
#: Of a part of it.
STIFFER_AT = "joint stiffer than given at one place"
#: Actual over given stiffness. A given stiffness comes from a like joint, a table or a handful of
#: decades in which measured interfaces lie: five times, within a factor of 5 either way. [prior:
#: chosen]
_FACTOR = Prior("factor", 5.0, np.log(5.0), "", True, (1.0, np.inf))


def stiffer_joint(
    name: str, region: str, zones: Sequence[Zone], reference: float | None, weight: float = 1.0
) -> Effect:
    """Zones whose given stiffness is too low, across and along alike: times a factor above one.

    A joint softer than given is an interface in series (`compliant`).

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
    words = "The joint is stiffer than the stiffness that the case gives."
    by_torque, family = reference is not None, PRIORS[zones[0].interface.name].family
    return Effect(name, region, priors, apply, words, by_torque, family, weight=weight)


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
    words = "The faces are in contact only where the bolts press them hard enough."
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
            # Where no torque of the test presses hard enough, a last bit of contact remains.
            far = far * np.sqrt(np.maximum(left, _LAST_CONTACT))
        lose(values, far)

    words, priors = "The faces are in contact only near the bolts.", [radius]
    if reference is not None:
        # The scan takes all other parameters for linear, which a cut-off is not.
        priors = [replace(radius, scan=0), Prior("cutoff", *_CUTOFF, "", True, (0.0, 0.9))]
        words = "The faces are in contact only near the bolts, farther out at higher torque."
    name, by_torque = "contact lost at low pressure", reference is not None
    return Effect(name, "joint", tuple(priors), apply, words, by_torque, _FAMILY)


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

    words = "The faces touch only near the bolts, at any torque: a recess, or uneven faces."
    return Effect(SMALLER, "joint", (radius,), apply, words, family="contact area")


def _beyond(zones: Sequence[Zone]) -> tuple[Callable[[dict[str, float], float], None], Prior]:
    """A function that removes the contact beyond a distance from the bolts, m, and the prior of
    that distance."""
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

    The stiffness that remains is the same at each. Of many bolts only those sets are solved for
    that hold one of the best single ones (`Effect.holds`).

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

    words += effect.format(them=them)
    rest = {"family": "bolt", "weight": weight, "holds": holds}
    return Effect(name, region, (prior,), apply, words, **rest)


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
    words = "The bolt preload is lower than in the baseline model, which makes the joint softer."
    return Effect(name, region, priors, apply, words, family="preload", weight=weight)


# -- which of them a case has ----------------------------------------------------------------------

#: Effects of layers that joint elements of beams cannot have.
_NOT_OF_LAPS = {
    "joint compliance that falls with the pressure": (
        "joint elements of beams have no pressure; a stiffness graded along the lap is tried"
    ),
    "contact lost at low pressure": (
        "joint elements include the stiffness of their beams, which no loss of contact takes"
    ),
}


def compliances(s: Setting) -> Found:
    """Compliance of joints: the same everywhere, by pressure, and at single places."""
    zones, reference = s.zones, s.reference
    if not len(zones):
        return
    law = PRIORS[zones.all[0].interface.name]
    for kinds, (name, words) in law.alone.items():
        yield compliant(name, "joint", zones.all, kinds, reference, words)
    if zones.by_pressure:
        yield pressed_compliance(zones.all)
        yield lost_contact(zones.all)
        return
    if 0 < len(zones.away) < len(zones):
        away = zones.pick(zones.away)
        where = ", ".join(dict.fromkeys(zone.joint for zone in away))
        words = "The joint is bonded under the bolts and compliant elsewhere."
        yield compliant("compliance away from the bolts only", where, away, None, reference, words)
    for kinds in law.graded_kinds:
        for how, named in zones.gradings.items():
            groups = {group: zones.pick(names) for group, names in named.items()}
            yield graded(groups, kinds, how, reference)
    yield from _by_distance(zones, reference) if zones.laps is None else _along_laps(zones)
    for kind, places in zones.places.items():
        for place, names in places.items():
            name, words = (text.format(kind=kind, place=place) for text in law.at_one)
            rest = {"family": "one place", "weight": 1 / len(places)}
            yield compliant(name, place, zones.pick(names), None, reference, words, **rest)
    if zones.laps is not None:
        yield from (Silent(name, reason) for name, reason in _NOT_OF_LAPS.items())


def _by_distance(zones: Zones, reference: float | None) -> Found:
    """Layers pressed by their bolts, where some are further from them than others."""
    around = [zone for zone in zones if zone.bolt]
    if len({zone.distance for zone in around}) > 1:
        yield pressed_by_bolts(around, reference)
        yield pressed_by_bolts(around, reference, ("t",))
        yield lost_beyond(around, reference)
        yield smaller_contact(around)


def _along_laps(zones: Zones) -> Found:
    """The axial stiffness of laps, which the model takes from the beams or the case."""
    along = {lap.name: lap.along for lap in zones.laps}
    where = ", ".join(along) if len(along) < 3 else "all laps"
    places = {where: list(along.values())}
    if len(along) > 1:
        places |= {name: [own] for name, own in along.items()}
    words = "The lap is axially softer or stiffer than the two beams side by side."
    for place, laps in places.items():
        keys = [f"{lap}.axial" for lap in laps]
        rest = {"span": (0.0, np.inf), "weight": 1.0 if place == where else 1 / len(along)}
        yield relative_error("joint axial stiffness", place, keys, AXIAL, words, **rest)


def stiffer_than_given(s: Setting) -> Found:
    """Layers stiffer than given: all of them, or only those near the bolts or away from them.

    The stiffness of laps may be wrong either way in other effects.
    """
    zones = s.zones
    if not len(zones) or zones.laps is not None:
        return
    if s.case.diagnose.joints == "bonded" or zones.by_pressure:
        reason = (
            "the baseline joint is bonded, and nothing is stiffer; "
            'with [diagnose] joints = "given" the baseline has the stiffness of the case'
        )
        yield Silent(STIFFER, reason)
        return
    near = tuple(name for name in zones.names if name not in zones.away)
    places = {"away from the bolts": zones.away, "near the bolts": near}
    places = {place: names for place, names in places.items() if 0 < len(names) < len(zones)}
    yield stiffer_joint(STIFFER, "joint", zones.all, s.reference)
    for place, names in places.items():
        weight = 1 / len(places)
        yield stiffer_joint(STIFFER_AT, place, zones.pick(names), s.reference, weight)


def bolts(s: Setting) -> Found:
    """Bolts that are loose, or press less than the nominal model says."""
    zones = s.zones
    if not len(zones) or zones.by_pressure:
        return  # a contact's layer stands for a preload that was solved for
    by_bolt = {name: zones.pick(own) for name, own in zones.by("bolt").items()}
    single = by_bolt if len(by_bolt) > 1 else {}
    weight = 1 / max(len(single), 1)
    yield from (loose_bolt(name, own, weight) for name, own in single.items())
    yield from loose_together(single)
    pressed = zones.all if zones.laps is None else sum(by_bolt.values(), ())
    if s.case.diagnose.joints == "bonded":
        what = "joint" if zones.laps is None else "lap"
        reason = (
            f"the baseline {what} is bonded, so its stiffness does not depend on the preload; "
            'with [diagnose] joints = "given" the baseline has the stiffness of the case'
        )
        yield Silent(LOW_PRELOAD, reason)
    elif not pressed:
        reason = "no lap has a bolt ([joints.NAME] bolted, or bolts)"
        yield Silent(LOW_PRELOAD, reason)
    else:
        yield low_preload("joint", pressed, LOW_PRELOAD)
        name = "preload of one bolt lower than nominal"
        yield from (low_preload(b, own, name, weight) for b, own in single.items())
