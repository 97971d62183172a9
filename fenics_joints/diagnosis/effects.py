"""Effects that a nominal model may lack, each with its parameters, prior and way into the model.

To add one, make an `Effect` and pass it to `fenics_joints.diagnosis.diagnose` beside those of
`fenics_joints.diagnosis.library`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.diagnosis.sensing import Sensing

__all__ = [
    "Effect", "Prior", "attached", "compliance", "lost_contact", "placed", "pressed_compliance",
    "relative_error", "two_zones",
]  # fmt: skip


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the test.

    Attributes:
        name: Name, unique in its effect.
        median: Median, in ``unit``.
        spread: One standard deviation: of the logarithm if ``log``, else in ``unit``.
        unit: SI unit.
        log: Log-normal (positive quantities) or normal.
        span: Hard limits (low, high) in ``unit``.
        scan: Number of values at which the evidence is integrated over this parameter, for one
            that acts in steps; 0 for one that acts smoothly.
    """

    name: str
    median: float
    spread: float
    unit: str = ""
    log: bool = True
    span: tuple[float, float] = (-np.inf, np.inf)
    scan: int = 0

    def value(self, z: float) -> float:
        """The parameter at ``z`` standard deviations from the median."""
        return self.median * np.exp(self.spread * z) if self.log else self.median + self.spread * z

    def standard(self, value: float) -> float:
        """Inverse of `value`; the limits may be infinite or, for ``log``, zero."""
        if not self.log:
            return (value - self.median) / self.spread
        if value <= 0:
            return -np.inf
        return np.log(value / self.median) / self.spread

    def limits(self, widest: float = 5.0) -> tuple[float, float]:
        """Limits of z."""
        low, high = (self.standard(v) for v in self.span)
        return max(low, -widest), min(high, widest)


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model may lack.

    Attributes:
        name: What it is, in an engineer's words.
        region: Where it acts.
        priors: Its parameters.
        apply: ``(values, theta, condition) -> None``: puts the effect with parameters ``theta``
            into the model's parameter values, in place. Effects can be put in one after another.
        describe: One sentence for the report.
        depends_on_condition: Whether it changes with the condition, a torque or a level.
        family: Effects of one family stand for each other and are never put in together.
        by_level: Whether its condition is the level of excitation or response, which is another in
            each mode; it is put in after all other effects.
        loss: ``(theta, condition, hz) -> {parameter: loss factor}``: what it dissipates at a
            frequency in the part of the structure whose stiffness is proportional to that parameter
            of the model, ``""`` being all of it; None if it dissipates nothing.
        weight: Prior odds relative to other effects: one of n places has 1/n.
        sensing: ``(sensing, theta) -> None``: for a cause in the test, what it changes of how the
            test reads the structure, in place.
    """

    name: str
    region: str
    priors: tuple[Prior, ...]
    apply: Callable[[dict[str, float], Mapping[str, float], float], None] | None
    describe: str = ""
    depends_on_condition: bool = False
    family: str = ""
    by_level: bool = False
    loss: Callable[[Mapping[str, float], float, float], dict[str, float]] | None = None
    weight: float = 1.0
    sensing: Callable[[Sensing, Mapping[str, float]], None] | None = None

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.name} ({self.region})" if self.region else self.name


#: Interface stiffness per area of clamped machined metal faces, Pa/m: 1e11 to 1e13 in the
#: literature, far less where the faces hardly touch; hence a factor of 30 either way.
_STIFFNESS = (1e12, np.log(30.0), (1e7, 1e16))
#: Exponent of K = alpha P^beta (seed 001, eqs. 22 and 23), P proportional to the torque.
_EXPONENT = (0.5, 0.3, (0.0, 1.5))


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
    """
    kinds = [kind for kind, on in (("n", normal), ("t", tangential)) if on]
    median, spread, span = _STIFFNESS
    priors = []
    for kind in kinds:
        priors.append(Prior(f"k_{kind}", median, spread, "Pa/m", True, span))
        if reference is not None:
            mean, sd, limits = _EXPONENT
            priors.append(Prior(f"beta_{kind}", mean, sd, "", False, limits))

    def apply(values, theta, condition):
        for kind in kinds:
            k = theta[f"k_{kind}"]
            if reference is not None:
                k = k * (condition / reference) ** theta[f"beta_{kind}"]
            for zone in zones:
                key = f"{zone}.{'E' if kind == 'n' else 'G'}"
                values[key] = 1 / (1 / values[key] + 1 / (k * thickness[zone]))

    torque = reference is not None
    return Effect(name, region, tuple(priors), apply, describe, torque, "joint compliance")


def two_zones(zones, thickness, reference, describe) -> Effect:
    """Compliance with stiffnesses of its own in every zone, and one exponent (the seed's model)."""
    median, spread, span = _STIFFNESS
    priors = [
        Prior(f"{zone}.k_{kind}", median, spread, "Pa/m", True, span)
        for zone in zones
        for kind in "nt"
    ]
    if reference is not None:
        mean, sd, limits = _EXPONENT
        priors.append(Prior("beta", mean, sd, "", False, limits))

    def apply(values, theta, condition):
        factor = 1.0 if reference is None else (condition / reference) ** theta["beta"]
        for zone in zones:
            for kind, key in (("n", f"{zone}.E"), ("t", f"{zone}.G")):
                k = theta[f"{zone}.k_{kind}"] * factor
                values[key] = 1 / (1 / values[key] + 1 / (k * thickness[zone]))

    name = "joint compliance graded from zone to zone"
    torque = reference is not None
    return Effect(name, "joint", tuple(priors), apply, describe, torque, "joint compliance")


#: Factor on the stiffness of a layer where the contact is lost: too soft to carry anything. And one
#: at which it is about halfway, as a thin layer that stiff gives way like the bodies do.
_LOST, _HALFWAY = 1e-9, 1e-3
_SCAN = 60
_POWER = np.log2(np.log(_LOST) / np.log(_HALFWAY))
#: Cut-off relative to the largest pressure: a tenth, within a factor of 3 either way (one standard
#: deviation). Rough faces carry shear from the first contact on, so it may be far lower; that it
#: be near the peak would leave hardly any contact.
_CUTOFF = (0.1, np.log(3.0))


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
            t = (1 + (theta["cutoff"] - a) / (b - a)) / 3 if b > a else 1.0
            lost = _smooth_step(t)
            factor = _LOST ** (lost**_POWER)
            values[f"{zone}.E"] *= factor
            values[f"{zone}.G"] *= factor

    # Something must stay in contact, or the bodies part.
    span = (1e-3 * largest, float(low[-1]))
    prior = Prior("cutoff", median * largest, spread, "Pa", True, span, scan=_SCAN)
    words = "The faces hold together only where the bolts press them hard enough."
    return Effect(
        "contact lost at low pressure", "joint", (prior,), apply, words, False, "joint compliance"
    )


def _smooth_step(t: float) -> float:
    """From 0 at 0 to 1 at 1, with a continuous slope."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3 - 2 * t)


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
    median, spread, span = _STIFFNESS
    mean, sd, limits = _EXPONENT
    priors = [Prior(f"k_{kind}", median, spread, "Pa/m", True, span) for kind in "nt"]
    priors.append(Prior("beta", mean, sd, "", False, limits))
    relative = np.asarray(pressure) / float(np.max(pressure))

    def apply(values, theta, condition):
        for zone, p in zip(zones, relative, strict=True):
            for kind, key in (("n", f"{zone}.E"), ("t", f"{zone}.G")):
                k = theta[f"k_{kind}"] * p ** theta["beta"] if p > 0 else 0.0
                floor = _LOST * values[key]
                values[key] = max(1 / (1 / values[key] + 1 / (k * thickness[zone] + floor)), floor)

    words = "The interface gives way, the more the less it is pressed."
    return Effect(
        "joint compliance that falls with the pressure", "joint", tuple(priors), apply, words,
        False, "joint compliance",
    )  # fmt: skip


def placed(name: str, key: str, shift: tuple[float, float]) -> Effect:
    """A known mass whose place is uncertain: its travel, normal about zero.

    Args:
        name: Name of the effect.
        key: Name of the mass.
        shift: Range of the travel, m: four standard deviations.
    """
    prior = Prior("travel", 0.0, (shift[1] - shift[0]) / 4, "m", False, shift)

    def apply(values, theta, condition):
        values[f"{key}.travel"] = theta["travel"]

    return Effect(name, key, (prior,), apply)


def relative_error(
    name: str, region: str, parameters: Sequence[str], spread: float, describe: str
) -> Effect:
    """A parameter off by a common factor, log-normal about 1.

    Args:
        name: Name of the effect.
        region: Where, for people.
        parameters: The model's parameters that share the factor.
        spread: Standard deviation of the factor's logarithm.
        describe: Sentence for the report.
    """

    def apply(values, theta, condition):
        for key in parameters:
            values[key] *= theta["factor"]

    prior = Prior("factor", 1.0, spread, "", True, (0.3, 3.0))
    return Effect(name, region, (prior,), apply, describe)


def attached(name: str, region: str, key: str, priors: Sequence[Prior], describe: str) -> Effect:
    """A mass or a spring that the nominal model leaves out.

    Args:
        name: Name of the effect.
        region: Where, for people.
        key: Name of the attachment; its parameters are ``KEY.<prior's name>``.
        priors: Its parameters; ``mass``, ``travel`` or ``stiffness``.
        describe: Sentence for the report.
    """

    def apply(values, theta, condition):
        for prior in priors:
            values[f"{key}.{prior.name}"] = theta[prior.name]

    return Effect(name, region, tuple(priors), apply, describe)
