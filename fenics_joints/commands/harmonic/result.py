"""What the ``harmonic`` command found."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.case.harmonic import identifiable
from fenics_joints.commands.harmonic.model import SENSOR, HarmonicModel
from fenics_joints.commands.harmonic.stability import LevelStability
from fenics_joints.formatting import percent, quantity
from fenics_joints.harmonic import (
    CurvePrediction,
    HarmonicResult,
    IdentificationResult,
    NonlinearMode,
    StaticBackbone,
    slider_ranges,
)
from fenics_joints.measurements.curves import UNITS, MeasuredCurves

#: What became of a backbone that was not followed to the highest amplitude.
_ENDS = {
    "stands still": "ends where the frequency falls to zero: the springs give way",
    "came back": "turns back and ends at its lowest amplitude",
    "short of it": "ends within a step of a bound, where no further solution was found",
}


@dataclass(frozen=True)
class LevelFacts:
    """What is said of one level.

    Attributes:
        level: Amplitude of the force, N, or of the base's motion, m/s2 or m.
        frequency_hz: Of the highest response, Hz.
        amplitude: The highest response, in SI units of the case's kind.
        displacement: The same as a displacement, m.
        damping_ratio: Work of the force per cycle there over 4 pi times the kinetic energy.
        joint_energy: Energy per cycle that each joint takes there, J, by name.
        turning_points: How often the branch turns back in frequency.
        closure: How far the loops there are from closed, relative.
        measured_hz: Frequency of the highest measured response, Hz; None without.
        measured: The highest measured response; None without.
    """

    level: float
    frequency_hz: float
    amplitude: float
    displacement: float
    damping_ratio: float
    joint_energy: dict[str, float]
    turning_points: int
    closure: float
    measured_hz: float | None = None
    measured: float | None = None

    def to_json(self) -> dict:
        """See `HarmonicReport.to_json`."""
        return {
            "level_n": self.level,
            "peak_hz": self.frequency_hz,
            "peak": self.amplitude,
            "peak_displacement_m": self.displacement,
            "damping_ratio": self.damping_ratio,
            "joint_energy_j": self.joint_energy,
            "turning_points": self.turning_points,
            "closure": self.closure,
            "measured_peak_hz": self.measured_hz,
            "measured_peak": self.measured,
        }


@dataclass(frozen=True, eq=False)
class HarmonicReport:
    """What the ``harmonic`` command found.

    Attributes:
        case: The case.
        built: The reduced model.
        responses: One for each level, in ascending order of the levels.
        facts: Likewise.
        backbone: Frequency and damping over amplitude, or None.
        curves: What was measured, or None.
        seconds: Time of the responses, s.
        rank: Rank of this process: pictures are rank 0's.
        identified: Parameters from the curve of one level, by each method; the responses are those
            of the last.
        predictions: What that model makes of every measured curve.
        static_backbone: Frequency and damping over amplitude from static loads, or None.
        stability: Of the responses at each level, if the case asks for bifurcations.
    """

    case: Case
    built: HarmonicModel
    responses: tuple[HarmonicResult, ...]
    facts: tuple[LevelFacts, ...]
    backbone: NonlinearMode | None
    curves: MeasuredCurves | None
    seconds: float
    rank: int
    identified: tuple[IdentificationResult, ...] = ()
    predictions: tuple[CurvePrediction, ...] = ()
    static_backbone: StaticBackbone | None = None
    stability: tuple[LevelStability, ...] = ()

    def __repr__(self) -> str:
        unit, facts = self.level_unit, self.facts[:4]
        peaks = ", ".join(f"{f.level:g} {unit}: {f.frequency_hz:.4g} Hz" for f in facts)
        return f"HarmonicReport({self.case.name!r}, {len(self.facts)} levels, {peaks})"

    @property
    def kind(self) -> str:
        """``displacement``, ``velocity`` or ``acceleration``."""
        return self.case.harmonic.response

    @property
    def unit(self) -> str:
        """Unit of the responses, as people write it."""
        return UNITS[self.kind].replace("s2", "s²")

    @property
    def level_unit(self) -> str:
        """SI unit of the levels: N, or that of a base's motion."""
        return self.case.harmonic.level_unit

    @property
    def drive(self) -> str:
        """What the levels are amplitudes of."""
        base = self.case.harmonic.base
        return "force" if base is None else f"base {base.motion}"

    @property
    def title(self) -> str:
        """What the structure responds to."""
        if self.case.harmonic.base is None:
            return "sinusoidal forces"
        return "a base that shakes, relative to it"

    @property
    def relative(self) -> str:
        """What a response is relative to, for an axis."""
        return "" if self.case.harmonic.base is None else " relative to the base"

    def parameter_rows(self, found: IdentificationResult) -> list[tuple[str, str, str, str]]:
        """Name, start, value and standard deviation of the parameters found, in words."""
        known = identifiable(self.case.nonlinear)
        return [
            (
                name,
                quantity(found.start[name], known[name][1], 4),
                quantity(value, known[name][1], 4),
                percent(found.sd[name], 1) if found.sd[name] < 1 else "open",
            )
            for name, value in found.values.items()
        ]

    @property
    def fitted_levels(self) -> set[float]:
        """Levels of force whose curves the parameters are from."""
        return {found.level for found in self.identified if len(found.frequencies_hz)}

    def mode_rows(self) -> list[tuple[float, list[tuple[float, float] | None]]]:
        """Displacements of the levels' peaks, m, and at each frequency, Hz, and damping of the mode
        by `mode_methods`; None where one does not reach."""
        found = [b for b in (self.backbone, self.static_backbone) if b is not None]
        return [(f.displacement, [_at(b, f.displacement) for b in found]) for f in self.facts]

    @property
    def mode_methods(self) -> list[str]:
        """How the mode's frequency and damping were found."""
        static = f"quasi-static, {self.case.harmonic.quasi_static}"
        pairs = (self.backbone, "periodic (EPMC)"), (self.static_backbone, static)
        return [words for found, words in pairs if found is not None]

    @property
    def backbone_note(self) -> str | None:
        """What to know of a backbone that does not reach the amplitude that it was to."""
        if self.backbone is None or self.backbone.end == "reached":
            return None
        top = quantity(float(np.max(self.backbone.amplitude(SENSOR))), "m")
        return f"the backbone {_ENDS[self.backbone.end]}; its highest amplitude is {top}"

    @cached_property
    def slider_notes(self) -> list[str]:
        """Joints whose sliders are for other amplitudes than the levels' peaks met."""
        return [
            f"at {quantity(f.level, self.level_unit)}, {found.note}"
            for f, response in zip(self.facts, self.responses, strict=True)
            for found in slider_ranges(response)
            if found.note
        ]

    def _level(self, facts: LevelFacts) -> dict:
        made = facts.to_json()
        level = made.pop("level_n")
        return {"level_n" if self.level_unit == "N" else "level": level, **made}

    def to_json(self) -> dict[str, object]:
        """What ``--json`` writes.

        Keys: ``version``, ``title``, ``dofs``, ``basis``, ``interface_points``,
        ``frequencies_at_rest_hz``, ``level_unit``, ``response``, ``levels`` (each with the facts of
        `LevelFacts`, of a base ``level`` instead of ``level_n``, and its ``branch``), ``backbone``,
        ``static_backbone``, ``stability`` (of each level, see `LevelStability.to_json`),
        ``identified``, ``predictions`` and ``notes``.
        """
        model = self.built.model
        return {
            "version": fenics_joints.__version__,
            "title": self.case.title,
            "dofs": self.built.n_dofs,
            "basis": model.n_dofs,
            "interface_points": {points.name: len(points) for points in model.interfaces},
            "frequencies_at_rest_hz": self.built.frequencies_hz.tolist(),
            "level_unit": self.level_unit,
            "response": {"kind": self.kind, "unit": UNITS[self.kind]},
            "levels": [
                {**self._level(facts), "branch": response.to_dict()}
                for facts, response in zip(self.facts, self.responses, strict=True)
            ],
            "backbone": None if self.backbone is None else self.backbone.to_dict(),
            "static_backbone": self.static_backbone and self.static_backbone.to_dict(),
            "stability": [found.to_json() for found in self.stability],
            "identified": [found.to_dict() for found in self.identified],
            "predictions": [made.to_dict() for made in self.predictions],
            "notes": [*self.slider_notes, *(n for s in self.stability for n in s.notes)],
        }


def _at(found: NonlinearMode | StaticBackbone, displacement: float) -> tuple[float, float] | None:
    """Frequency, Hz, and damping ratio of a mode at a displacement, or None out of its range."""
    a = found.amplitude()
    if not a.min() <= displacement <= a.max():
        return None
    order, x = np.argsort(a), np.log(displacement)
    columns = (found.frequencies_hz, found.damping_ratios)
    return tuple(float(np.interp(x, np.log(a[order]), y[order])) for y in columns)
