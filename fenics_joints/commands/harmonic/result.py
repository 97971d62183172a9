"""The result of the ``harmonic`` command."""

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
from fenics_joints.report.document import Cell

#: Why a backbone was not followed to the highest amplitude.
_ENDS = {
    "stands still": "ends where the frequency falls to zero: the joint yields",
    "came back": "turns back and ends at its lowest amplitude",
    "short of it": "ends within a step of a bound, where no further solution was found",
}


@dataclass(frozen=True)
class LevelFacts:
    """Facts on one level; the names are those in the JSON file.

    Attributes:
        level: Amplitude of the force, N, or of the base's motion, m/s2 or m.
        peak_hz: Of the highest response, Hz.
        peak: The highest response, in SI units of the case's kind.
        peak_displacement_m: The same as a displacement, m.
        damping_ratio: Work of the force per cycle there over 4 pi times the kinetic energy.
        joint_energy_j: Energy per cycle that each joint takes there, J, by name.
        turning_points: How often the branch turns back in frequency.
        closure: How far the loops there are from closed, relative.
        measured_peak_hz: Frequency of the highest measured response, Hz; None without.
        measured_peak: The highest measured response; None without.
    """

    level: float
    peak_hz: float
    peak: float
    peak_displacement_m: float
    damping_ratio: float
    joint_energy_j: dict[str, float]
    turning_points: int
    closure: float
    measured_peak_hz: float | None = None
    measured_peak: float | None = None


@dataclass(frozen=True, eq=False)
class HarmonicReport:
    """The result of the ``harmonic`` command.

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
        peaks = ", ".join(f"{f.level:g} {unit}: {f.peak_hz:.4g} Hz" for f in facts)
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
        """The quantity whose amplitudes the levels are."""
        base = self.case.harmonic.base
        return "force" if base is None else f"base {base.motion}"

    @property
    def title(self) -> str:
        """The excitation, for a title."""
        if self.case.harmonic.base is None:
            return "sinusoidal forces"
        return "a base that shakes, relative to it"

    @property
    def relative(self) -> str:
        """Words on an axis of responses that are relative to a base."""
        return "" if self.case.harmonic.base is None else " relative to the base"

    def parameter_records(self, found: IdentificationResult) -> list[dict]:
        """Parameters found by a method, each with the numbers of the whole identification."""
        known = identifiable(self.case.nonlinear)
        keys = ("method", "start_objective", "objective", "evaluations", "solutions")
        common = {key: getattr(found, key) for key in keys}
        rows = []
        for name, value in found.values.items():
            numbers = {"start": found.start[name], "value": value}
            cells = {k: Cell(quantity(v, known[name][1], 4), value=v) for k, v in numbers.items()}
            sd = Cell(percent(found.sd[name], 1) if found.sd[name] < 1 else "open")
            rows.append({"parameter": name, **cells, "sd": sd, **common})
        return rows

    @property
    def fitted_levels(self) -> set[float]:
        """Levels of force whose curves the parameters are from."""
        return {found.level for found in self.identified if len(found.frequencies_hz)}

    def mode_records(self) -> list[dict]:
        """The mode's frequency and damping at the displacements of the levels' peaks, of periodic
        motion and from static loads; None where one does not reach."""
        both = {"periodic": self.backbone, "static": self.static_backbone}
        rows = []
        for f in self.facts:
            row = {"displacement_m": f.peak_displacement_m}
            for name, found in both.items():
                if found is not None:
                    row |= _at(found, f.peak_displacement_m, name)
            rows.append(row)
        return rows

    @property
    def backbone_note(self) -> str | None:
        """Why the backbone does not reach the highest amplitude; None if it does."""
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

    def record(self, facts: LevelFacts) -> dict[str, object]:
        """The facts on a level as in the JSON file."""
        made = dict(vars(facts))
        return {"level_n" if self.level_unit == "N" else "level": made.pop("level"), **made}

    def to_json(self) -> dict[str, object]:
        """The content of ``--json``.

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
                {**self.record(facts), "branch": response.to_dict()}
                for facts, response in zip(self.facts, self.responses, strict=True)
            ],
            "backbone": None if self.backbone is None else self.backbone.to_dict(),
            "static_backbone": self.static_backbone and self.static_backbone.to_dict(),
            "stability": [found.to_json() for found in self.stability],
            "identified": [found.to_dict() for found in self.identified],
            "predictions": [made.to_dict() for made in self.predictions],
            "notes": [*self.slider_notes, *(n for s in self.stability for n in s.notes)],
        }


def _at(found: NonlinearMode | StaticBackbone, displacement: float, name: str) -> dict:
    """Frequency, Hz, and damping ratio of a mode at a displacement, or None out of its range."""
    a = found.amplitude()
    columns = {f"{name}_hz": found.frequencies_hz, f"{name}_damping": found.damping_ratios}
    if not a.min() <= displacement <= a.max():
        return dict.fromkeys(columns)
    order, x = np.argsort(a), np.log(displacement)
    return {k: float(np.interp(x, np.log(a[order]), y[order])) for k, y in columns.items()}
