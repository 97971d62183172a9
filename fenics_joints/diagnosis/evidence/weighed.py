"""What was put on a scale: masses split a density from a modulus where frequencies cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.evidence.covariance import UNKNOWN
from fenics_joints.diagnosis.evidence.entries import MASS
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.structure.model import Model

WHOLE = "the whole structure"
#: What a part's mass is proportional to, and what a point mass is.
_SIZES, _POINT = ("rho", "thickness", "width"), "mass"


@dataclass(frozen=True)
class Weighed:
    """A mass from a scale, and what the model has for it: a `scalars.Scalar`.

    Attributes:
        name: The part's, or `WHOLE`.
        kg: What the scale said.
        sd: Its relative standard deviation, with what the mesh leaves out of the volume.
        parts: Nominal mass, kg, of each part that was weighed with it, by name.
        nominal: Values of the parts' parameters at these.
        points: Parameters of the point masses that were, each a mass, kg.
        fixed: What depends on no parameter, kg.
    """

    name: str
    kg: float
    sd: float
    parts: Mapping[str, float]
    nominal: Mapping[str, float]
    points: tuple[str, ...] = ()
    fixed: float = 0.0
    kind: ClassVar[int] = MASS
    row: ClassVar[int | None] = None
    unknown: ClassVar[float] = UNKNOWN
    common: ClassVar[Mapping] = {}

    @property
    def measured(self) -> float:
        """What the scale said, kg."""
        return self.kg

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """See `scalars.Scalar`."""
        found, region = np.zeros(len(patches.names)), np.array(patches.region)
        for part, kg in self.parts.items():
            own = region == part
            if own.any():
                share = patches.volume[own] / patches.volume[own].sum()
                found[own] = patches.expected[1] * kg / self.kg * share
        return 0.0 * found, found

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        count = len(next(iter(values.values())))
        found = (self.log_value(high) - self.log_value(low)) / width
        return np.broadcast_to(found, len(next(iter(low.values())))).reshape(-1, count).T

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's mass, kg; (b,) of values (b,).

        Args:
            values: Its parameter values.
        """
        total = self.fixed + sum(values[key] for key in self.points)
        for part, mass in self.parts.items():
            for key in _keys(part, self.nominal):
                mass = mass * values[key] / self.nominal[key]
            total += mass
        return np.log(total)


def _keys(part: str, values: Mapping[str, float]) -> list[str]:
    return [key for size in _SIZES if (key := f"{part}.{size}") in values]


def case_weighed(case: Case, model: Model, baseline: Mapping[str, float]) -> tuple[Weighed, ...]:
    """What a case says was weighed: ``[test] mass`` of the whole, and ``[parts.NAME] mass``.

    What is ``[attached]`` is taken not to have been on the scale. Collective.

    Args:
        case: The case.
        model: Its nominal model.
        baseline: That model's parameter values.
    """
    whole = None if case.test is None else case.test.mass
    kg = {name: part.mass for name, part in case.parts.items() if part.mass is not None}
    if case.test is None or (whole is None and not kg):
        return ()
    of_whole = on_a_scale(case, model, baseline)
    found = [] if whole is None else [replace(of_whole, kg=whole)]
    return (
        *found,
        *(
            replace(
                of_whole, name=name, kg=m, parts={name: of_whole.parts[name]}, points=(), fixed=0.0
            )
            for name, m in kg.items()
        ),
    )


def on_a_scale(case: Case, model: Model, baseline: Mapping[str, float]) -> Weighed:
    """The whole structure as a scale would find it were the nominal model right. Collective.

    Args:
        case: The case, with a test.
        model: Its nominal model.
        baseline: That model's parameter values.
    """
    total = model.total_mass(baseline)
    parts = {name: _part_mass(model, baseline, name, total) for name in case.parts}
    nominal = {key: baseline[key] for name in parts for key in _keys(name, baseline)}
    points = tuple(f"{name}.{_POINT}" for name in case.masses)
    rest = total - sum(parts.values()) - sum(baseline[key] for key in points)
    return Weighed(WHOLE, total, case.test.mass_noise, parts, nominal, points, rest)


def _part_mass(model: Model, baseline: Mapping[str, float], part: str, total: float) -> float:
    """kg; the total is linear in the part's density."""
    key = f"{part}.rho"
    return 2.0 * (total - model.total_mass({**baseline, key: 0.5 * baseline[key]}))
