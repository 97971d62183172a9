"""Single numbers that were measured besides modes, and their predictions by a hypothesis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.evidence.entries import (
    ANTIRESONANCE,
    FUNCTION,
    MASS,
    STIFFNESS,
    UNKNOWN,
)
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.diagnosis.thresholds import STEP
from fenics_joints.reduction.receptances import About, Antiresonances, Receptances, StaticModel
from fenics_joints.structure.model import Model

if TYPE_CHECKING:
    from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
    from fenics_joints.diagnosis.evidence.signatures import Signatures

Values = Mapping[str, np.ndarray]


#: Of a motion, at a circular frequency, with parameter values: x^T K x and omega^2 x^T M x of each
#: patch, (2, P).
Energies = Callable[[object, float, Mapping[str, float]], np.ndarray]


@dataclass(frozen=True, eq=False, kw_only=True)
class Observation(ABC):
    """A positive number that was measured, of whose logarithm the model predicts another.

    Attributes:
        kind: Kind of entry (`fenics_joints.diagnosis.evidence.entries`).
        unknown: Standard deviation of its logarithm by an unknown cause.
        name: What was measured.
        measured: The number, in its SI unit.
        sd: Relative standard deviation: of the instrument, of any such model, and of what is left
            of the mesh's error.
        row: The test's row at which it was measured; None if it does not depend on that.
        index: Its index among those of its model.
        mesh: How much too high, in ln of it, the mesh makes it.
        common: Errors of the model or the test that it has in common with others: change of its
            logarithm by one standard deviation of each such error, by the error's name.
        patches: Change of its logarithm by the stiffness and by the mass of each patch, (2, P);
            None where no unknown cause has a place.
    """

    kind: ClassVar[int]
    unknown: ClassVar[float] = UNKNOWN
    name: str
    measured: float
    sd: float
    row: int | None = None
    index: int = 0
    mesh: float = 0.0
    common: Mapping[Hashable, float] = field(default_factory=dict)
    patches: np.ndarray | None = None

    @abstractmethod
    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's, without its mesh's error; (b,) of parameter values (b,), nan where the
        model has none."""

    @abstractmethod
    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """Its derivatives along p directions at b points, (b, p).

        Args:
            values: Parameter values at the points, each (b,).
            low: Those a little less along the directions, (p * b,): all of one, then of the next.
            high: Likewise a little more.
            width: How far these are apart.
        """

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """Derivatives by ln of the stiffness and of the mass of each patch, (2, P). Collective."""
        raise NotImplementedError

    def by_patch(self, patches: Signatures) -> np.ndarray:
        """Its change by the expected one of each patch's stiffness and mass, (2, P)."""
        return np.zeros((2, len(patches.names))) if self.patches is None else self.patches


def reach(measured: Sequence[Observation], hypothesis: Hypothesis) -> list[int]:
    """Indices of a hypothesis' parameters that may change some of them."""
    rows = {scalar.row for scalar in measured} - {None}
    return [
        j
        for j in range(len(hypothesis.priors))
        if j < hypothesis.own.stop or any(hypothesis.acts(j, row, None) for row in rows)
    ]


def scalars_at(
    measured: Sequence[Observation],
    hypothesis: Hypothesis,
    z: np.ndarray,
    by: Sequence[int],
    at: Callable[[np.ndarray, int | None], Values],
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of measured numbers by a hypothesis at many points, (b, k), and derivatives by
    some of z, (b, k, len(by)); nan where the model lacks one, such as an antiresonance.

    Args:
        measured: The numbers.
        hypothesis: The hypothesis.
        z: Points, (b, d).
        by: Which of z.
        at: Parameter values at points, (n, d), at a row: each (n,).
    """
    found = np.zeros((len(z), len(measured)))
    slope = np.zeros((len(z), len(measured), len(by)))
    matter = set(reach(measured, hypothesis))
    own = [k for k, j in enumerate(by) if j in matter] if measured else []
    steps = np.zeros((len(own), 1, z.shape[1]))
    steps[range(len(own)), 0, [by[k] for k in own]] = STEP
    low, high = ((z + side * steps).reshape(len(own) * len(z), z.shape[1]) for side in (-1, 1))
    for row in dict.fromkeys(scalar.row for scalar in measured):
        values = at(z, row)
        ends = (at(low, row), at(high, row)) if own else None
        for i, scalar in enumerate(measured):
            if scalar.row == row:
                found[:, i] = scalar.log_value(values)
                if own:
                    slope[:, i, own] = scalar.log_slopes(values, *ends, 2 * STEP)
    return found, slope


@dataclass(frozen=True, eq=False, kw_only=True)
class Antiresonance(Observation):
    """A frequency, Hz, at which a point stands still under a force there.

    Attributes:
        zeros: Has all antiresonances of the point.
    """

    zeros: Antiresonances
    kind: ClassVar[int] = ANTIRESONANCE

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """ln of the model's, Hz, without its mesh's error, (b,) of values (b,); nan where the model
        has it no more."""
        return self.zeros.at(values).log_f[:, self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `Observation`."""
        return self.zeros.slopes(values, low, high, width)[:, self.index]

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """As of any frequency; see `Observation`."""
        x, square = self.zeros.shape(self.index, values)
        return np.array([[0.5], [-0.5]]) * energies(x, np.sqrt(square), values) / square


@dataclass(frozen=True, eq=False, kw_only=True)
class StaticStiffness(Observation):
    """Force over displacement, N/m.

    Attributes:
        model: Has the compliance of all that were measured.
    """

    model: StaticModel
    kind: ClassVar[int] = STIFFNESS
    unknown: ClassVar[float] = 2 * UNKNOWN  # as the square of a frequency

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's, N/m, without its mesh's error; (b,) of values (b,)."""
        return -self.model.log_compliance(values)[..., self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `Observation`."""
        return -self.model.log_slopes(self.index, values, low, high, width)

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """With the response u to the force, u^T dK u over u^T K u; see `Observation`."""
        stiff, _ = energies(self.model.response(values, self.index), 0.0, values)
        return np.array([stiff / stiff.sum(), 0.0 * stiff])


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionLine(Observation):
    """The model's receptance over the measured one, minus one: a logarithm to first order.

    Its real part is the error of the magnitude and its imaginary part that of the phase, rad.
    Unlike a logarithm it has a sign, and stays finite where the model has an antiresonance.
    ``measured`` is one, and ``sd`` is relative to the function.

    Attributes:
        functions: Has all lines.
        over: The measured receptance, m/N.
        phase: Whether this is the phase's.
        unknown: What an unknown cause may do to it, one standard deviation.
    """

    functions: Receptances
    over: complex
    phase: bool
    unknown: float
    kind: ClassVar[int] = FUNCTION

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """The model's error, (b,) of values (b,); nan where it lacks a mode of the test."""
        return self._part(self.functions.at(values)[:, self.index] / self.over - 1.0)

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `Observation`."""
        return self._part(
            self.functions.slopes(values, low, high, width)[:, self.index] / self.over
        )

    def _part(self, off: np.ndarray) -> np.ndarray:
        return off.imag if self.phase else off.real

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """-x^T dZ y over the function, with the resonances put back. A patch has no
        phase; see `Observation`."""
        about = self.functions.about(values)
        pulls = about.pulls(energies, values)
        if self.phase:
            return 0.0 * pulls[0]
        found = np.einsum("k,kwp->wp", about.by_pole[self.index], pulls)
        return (found + self._of_motions(about, energies, values)) / about.value[self.index]

    def _of_motions(self, about: About, energies: Energies, values) -> np.ndarray:
        """-x^T dZ y of the two motions, which are one at a driving point."""
        i, omega = self.index, float(about.omega[self.index])
        x, y = (motion[:, i] for motion in about.motions)
        in_full = self.functions.basis.in_full
        both = energies(in_full(0.5 * (x + y)), omega, values)
        if np.any(x != y):
            both = both - energies(in_full(0.5 * (x - y)), omega, values)
        stiff, mass = both
        return np.array([-stiff, mass])


WHOLE = "the whole structure"
#: What a part's mass is proportional to, and what a point mass is.
_SIZES, _POINT = ("rho", "thickness", "width"), "mass"


@dataclass(frozen=True, eq=False, kw_only=True)
class MassMeasurement(Observation):
    """A mass from a scale, kg, and what the model has for it.

    Attributes:
        parts: Nominal mass, kg, of each part that was weighed with it, by name.
        nominal: Values of the parts' parameters at these.
        points: Parameters of the point masses that were, each a mass, kg.
        fixed: What depends on no parameter, kg.
    """

    kind: ClassVar[int] = MASS
    parts: Mapping[str, float]
    nominal: Mapping[str, float]
    points: tuple[str, ...] = ()
    fixed: float = 0.0

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's mass, kg; (b,) of values (b,)."""
        total = self.fixed + sum(values[key] for key in self.points)
        for part, mass in self.parts.items():
            for key in _keys(part, self.nominal):
                mass = mass * values[key] / self.nominal[key]
            total += mass
        return np.log(total)

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `Observation`."""
        count = len(next(iter(values.values())))
        found = (self.log_value(high) - self.log_value(low)) / width
        return np.broadcast_to(found, len(next(iter(low.values())))).reshape(-1, count).T

    def by_patch(self, patches: Signatures) -> np.ndarray:
        """See `Observation`."""
        found, region = np.zeros((2, len(patches.names))), np.array(patches.region)
        for part, kg in self.parts.items():
            own = region == part
            if own.any():
                share = patches.volume[own] / patches.volume[own].sum()
                found[1, own] = patches.expected[1] * kg / self.measured * share
        return found


def _keys(part: str, values: Mapping[str, float]) -> list[str]:
    return [key for size in _SIZES if (key := f"{part}.{size}") in values]


def case_masses(
    case: Case, model: Model, baseline: Mapping[str, float]
) -> tuple[MassMeasurement, ...]:
    """What a case says was weighed: ``[test] mass`` of the whole, and ``[parts.NAME] mass``.

    What is ``[attached]`` is taken not to have been on the scale. Collective.

    Args:
        case: The case.
        model: Its nominal model.
        baseline: That model's parameter values.
    """
    kg = {name: part.mass for name, part in case.parts.items() if part.mass is not None}
    if case.test is None or (case.test.mass is None and not kg):
        return ()
    whole = on_a_scale(case, model, baseline)
    found = [] if case.test.mass is None else [replace(whole, measured=case.test.mass)]
    for name, m in kg.items():
        own = {name: whole.parts[name]}
        found.append(replace(whole, name=name, measured=m, parts=own, points=(), fixed=0.0))
    return tuple(found)


def on_a_scale(case: Case, model: Model, baseline: Mapping[str, float]) -> MassMeasurement:
    """The whole structure as a scale would find it were the nominal model right. Collective.

    Args:
        case: The case, with a test.
        model: Its nominal model.
        baseline: That model's parameter values.
    """
    total = model.total_mass(baseline)
    parts = {name: _part_mass(model, baseline, name, total) for name in case.parts}
    points = tuple(f"{name}.{_POINT}" for name in case.masses)
    return MassMeasurement(
        name=WHOLE,
        measured=total,
        sd=case.test.mass_noise,
        parts=parts,
        nominal={key: baseline[key] for name in parts for key in _keys(name, baseline)},
        points=points,
        fixed=total - sum(parts.values()) - sum(baseline[key] for key in points),
    )


def _part_mass(model: Model, baseline: Mapping[str, float], part: str, total: float) -> float:
    """kg; the total is linear in the part's density."""
    key = f"{part}.rho"
    return 2.0 * (total - model.total_mass({**baseline, key: 0.5 * baseline[key]}))
