"""Effects that a nominal model may lack, each with its parameters, prior and way into the model.

The library (`diagnosis.effects.library`) holds the effects of any bolted structure. An effect of
your own is a function that changes the model's parameter values, with priors of its parameters::

    from fenics_joints.diagnosis import Effect, Prior

    def delaminate(values, theta, condition):
        values["lid.E"] *= 1 - theta["lost"]

    delaminated = Effect(
        "delaminated lid", "lid",
        (Prior("lost", median=0.1, spread=0.7, span=(0.0, 0.9)),),
        delaminate, describe="Layers of the lid have come apart.",
    )

It goes in with ``diagnose(case, comm, extra=[delaminated])``, or ``diagnose(structure, test,
extra=[delaminated])``. The parameters of a case's model are listed by
`fenics_joints.case.parameters.parameters`, and a prior is log-normal unless it says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.special import ndtr, ndtri

from fenics_joints.case import Case
from fenics_joints.case.dimensions import Dimensions
from fenics_joints.diagnosis.zones.sites import Sites
from fenics_joints.diagnosis.zones.zone import Zones
from fenics_joints.errors import flag, real, text, whole
from fenics_joints.measurements.data import TestData
from fenics_joints.reduction.reduced import N_BENDS
from fenics_joints.structure import Parameter


@dataclass
class Sensing:
    """How the test reads the structure; an effect in the test changes it in place.

    Attributes:
        order: The model's mode whose frequency and damping stand in each of the test's columns,
            shape (m,); m itself stands for the mode after the m modes of the test.
        gains: Reading over true motion of each sensor, shape (n_s,).
        shifts: How far each sensor sits from where the case has it, m, along each of its ways
            (`fenics_joints.reduction.prediction.ways_of`), and their `monomials`, m2 and m3: what
            `ArrayModel.shift_rows` are multiplied by, shape (9, n_s). Where there is one way, the
            first row counts.
    """

    order: np.ndarray
    gains: np.ndarray
    shifts: np.ndarray

    @classmethod
    def true(cls, n_modes: int, n_sensors: int) -> Sensing:
        """A test without errors."""
        return cls(np.arange(n_modes), np.ones(n_sensors), np.zeros((2 + N_BENDS, n_sensors)))


#: Prior odds of an effect that few structures have, or of a law without a physical reason, against
#: one that any structure has, such as a modulus that is not quite the data
#: sheet's. [prior: chosen]
RARE = 0.25
#: Standard deviations of its prior beyond which no parameter is looked for. [numerical: 6e-7 of a
#: normal prior are beyond]
WIDEST = 5.0
#: Limits of a factor on a property. [prior: chosen]
FACTOR = (0.3, 3.0)


@dataclass(frozen=True)
class Prior:
    """Distribution of a parameter before the test.

    Attributes:
        name: Name, unique in its effect.
        median: Median, in ``unit``.
        spread: One standard deviation: of the logarithm if ``log``, else in ``unit``.
        unit: SI unit.
        log: Log-normal (positive quantities) or normal.
        span: Hard limits (low, high) in ``unit``.
        scan: Number of values at which the evidence is integrated over this parameter, for one
            that acts in steps or in many places; 0 for one that acts smoothly.
        also: Further values at which the prior has a cell, beside those of `scan`.
        even: Whether all values of ``span`` are equally likely, as for a place; median and spread
            are then those of the uniform distribution.
    """

    name: str
    median: float
    spread: float
    unit: str = ""
    log: bool = True
    span: tuple[float, float] = (-np.inf, np.inf)
    scan: int = 0
    even: bool = False
    also: tuple[float, ...] = ()

    def __post_init__(self):
        text("prior.name", self.name)
        flag(f"prior {self.name}.log", self.log)
        bounds = {"above": 0.0} if self.log else {}
        real(f"prior {self.name}.median", self.median, self.unit, **bounds)
        real(f"prior {self.name}.spread", self.spread, above=0)
        whole(f"prior {self.name}.scan", self.scan, 0)

    def value(self, z: float) -> float:
        """The parameter at ``z`` standard deviations from the median."""
        if self.even:
            return self.span[0] + (self.span[1] - self.span[0]) * ndtr(z)
        return self.median * np.exp(self.spread * z) if self.log else self.median + self.spread * z

    def standard(self, value: float) -> float:
        """Inverse of `value`; the limits may be infinite or, for ``log``, zero."""
        if self.even:
            return float(ndtri((value - self.span[0]) / (self.span[1] - self.span[0])))
        if not self.log:
            return (value - self.median) / self.spread
        if value <= 0:
            return -np.inf
        return np.log(value / self.median) / self.spread

    def tried(self) -> np.ndarray:
        """Values of z at which the prior has cells: `scan` equally probable ones, and those of
        `also` within the limits."""
        low, high = self.limits()
        also = [z for z in map(self.standard, self.also) if low <= z <= high]
        return np.array([*ndtri((np.arange(self.scan) + 0.5) / max(self.scan, 1)), *also])

    def limits(self, widest: float = WIDEST) -> tuple[float, float]:
        """Limits of z."""
        low, high = (self.standard(v) for v in self.span)
        return max(low, -widest), min(high, widest)


def place_prior(name: str, count: int, scan: int) -> Prior:
    """Which of several places, 0 to count - 1, each as likely.

    Args:
        name: Name of the parameter.
        count: Number of places, two at least.
        scan: See `Prior`.
    """
    last = count - 1.0
    return Prior(name, last / 2, last / 12**0.5, "", False, (0.0, last), scan, True)


@dataclass(frozen=True, repr=False)
class Effect:
    """A physical effect that a model may lack.

    Attributes:
        name: What it is, in an engineer's words.
        region: Where it acts.
        priors: Its parameters.
        apply: ``(values, theta, condition) -> None``: puts the effect with parameters ``theta``
            into the model's parameter values, in place. Effects can be put in one after another.
            None for one that leaves the model as it is.
        describe: One sentence for the report.
        depends_on_condition: Whether it changes with the condition, a torque or a level.
        family: Effects of one family stand for each other and are never put in together.
        by_level: Whether its condition is the level of excitation or response, which is another in
            each mode; it is put in after all other effects.
        loss: ``(theta, condition, hz) -> {parameter: loss factor}``: what it dissipates at a
            frequency in the part of the structure whose stiffness is proportional to that parameter
            of the model, ``""`` being all of it; None if it dissipates nothing.
        weight: Prior odds relative to other effects: one of n places has 1/n.
        drifts: Whether it changes from one condition to the next by their order, which no
            tightening scatters.
        sensing: ``(sensing, theta) -> None``: for a cause in the test, what it changes of how the
            test reads the structure, in place.
        holds: Keys of effects that are a part of it, such as each bolt of several that are loose:
            it is looked at only beside the best of these; empty for one that stands alone.
        never_with: Names of effects that the model cannot have together with it.
        where: ``(theta) -> words``: where it is; None for one without a ``place``.
        beside: If true, its prior odds are not normalised with the library's, so that it makes no
            other effect less likely.
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
    drifts: bool = False
    holds: frozenset[str] = frozenset()
    never_with: frozenset[str] = frozenset()
    where: Callable[[Mapping[str, float]], str] | None = None
    beside: bool = False

    def __repr__(self) -> str:
        return f"Effect({self.key}: {', '.join(prior.name for prior in self.priors[:6])})"

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.name} ({self.region})" if self.region else self.name

    def touches(self, baseline: Mapping[str, float], conditions: Iterable[float]) -> frozenset[str]:
        """Names of the model's parameters that it changes in some condition, its own parameters one
        standard deviation from their medians either way."""
        if self.apply is None:
            return frozenset()
        names: set[str] = set()
        for z, condition in product((-1.0, 1.0), conditions):
            values = dict(baseline)
            theta = {p.name: p.value(float(np.clip(z, *p.limits()))) for p in self.priors}
            self.apply(values, theta, float(condition))
            names |= {name for name, value in values.items() if value != baseline[name]}
        return frozenset(names)


@dataclass(frozen=True)
class Silent:
    """An effect of the library that this test can say nothing about.

    Attributes:
        effect: Its name.
        reason: Why, and what it would need.
    """

    effect: str
    reason: str


@dataclass(frozen=True)
class Setting:
    """A case and its test, for which effects are looked for.

    Attributes:
        case: The case, with a joint for each zone.
        data: The test.
        zones: Its joints in zones.
        dimensions: Which thicknesses and widths the model can represent; None: all.
        sites: Places where something may be that the nominal model has nothing of.
        mass: Of the structure, kg.
        parameters: Parameters of a model by forms that may be wrong, by name.
    """

    case: Case
    data: TestData
    zones: Zones
    dimensions: Dimensions | None = None
    sites: Sites = field(default_factory=Sites.none)
    mass: float = 1.0
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @property
    def reference(self) -> float | None:
        """Torque at which stiffnesses of joints hold; None if the test has one torque or none."""
        return float(self.data.conditions[-1]) if by_preload(self.data) else None


#: Effects of the library for a `Setting`, and names of effects that the test can say nothing about.
Found = Iterator[Effect | Silent]


def by_preload(data: TestData) -> bool:
    """Whether the test has several torques (or other preloads), by which joints may stiffen."""
    return len(data) > 1 and bool(np.all(data.conditions > 0)) and not data.by_level


def in_series(values: dict[str, float], key: str, stiffness: float) -> None:
    """Put a spring in series with a stiffness of the model, in the same unit, in place."""
    values[key] = 1 / (1 / values[key] + 1 / stiffness)


def relative_error(
    name: str,
    region: str,
    parameters: Sequence[str],
    spread: float,
    describe: str,
    *,
    span: tuple[float, float] = FACTOR,
    weight: float = 1.0,
) -> Effect:
    """Parameters off by a common factor, log-normal about 1.

    Args:
        name: Name of the effect.
        region: Where, for people.
        parameters: The model's parameters that share the factor.
        spread: Standard deviation of the factor's logarithm.
        describe: Sentence for the report.
        span: Limits of the factor.
        weight: Prior odds relative to other effects.
    """

    def apply(values, theta, condition):
        for key in parameters:
            values[key] *= theta["factor"]

    prior = Prior("factor", 1.0, spread, "", True, span)
    return Effect(name, region, (prior,), apply, describe, weight=weight)


#: Prior odds, against none, that some one effect is at work, shared out by the effects' weights,
#: beside which some come (`Effect.beside`), so that a larger library makes nothing less likely;
#: two at once have the product of their odds. [decision: chosen]
_ANY = 1.5


def log_odds(effects: Sequence[Effect]) -> dict[str, float]:
    """ln of the prior odds of each effect of a library against none, by its key."""
    common = [effect.weight for effect in effects if not effect.beside]
    total = sum(common or [effect.weight for effect in effects])
    return {e.key: float(np.log(_ANY * e.weight / total)) for e in effects}


def log_odds_outside(probability: float) -> float:
    """ln of the prior odds against none of a cause outside the library.

    Args:
        probability: That it, and not an effect of the library, is the cause.
    """
    return float(np.log(_ANY * probability / (1 - probability)))
