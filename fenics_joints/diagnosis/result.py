"""The result of a diagnosis: where the error lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, field
from textwrap import shorten

import numpy as np

import fenics_joints
from fenics_joints.diagnosis.effects.effect import Silent
from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown
from fenics_joints.diagnosis.evidence.misattribution import Misattribution
from fenics_joints.diagnosis.evidence.scales import BETWEEN, ERRORS, WITH_FUNCTIONS, Kind, Scales
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.where.score_tests import ZoneShare
from fenics_joints.errors import member
from fenics_joints.files import dataframe, plain
from fenics_joints.formatting import html_table, percent, probability
from fenics_joints.measurements.gap import Gap


@dataclass(frozen=True)
class EffectResult:
    """One effect of the library, over all hypotheses that hold it.

    Attributes:
        name: The effect.
        region: Where it acts.
        probability: Probability that it is at work, 0 to 1: the sum over hypotheses with it.
        class_name: Class of effects that this test cannot distinguish; else its own name.
        detectable: Whether this test could detect it at its expected size.
        describe: What it means.
        odds: Its prior odds relative to other effects; 0 for what is none.
    """

    name: str
    region: str
    probability: float
    class_name: str
    detectable: bool
    describe: str = ""
    odds: float = 0.0

    @property
    def key(self) -> str:
        """Unique name, as hypotheses have it: ``name (region)``."""
        return f"{self.name} ({self.region})" if self.region else self.name


@dataclass(frozen=True, repr=False)
class HypothesisResult:
    """A set of effects that together were fitted to the test; these exclude one another.

    Attributes:
        label: Names of the effects, ``no gap`` or ``none of these``.
        effects: Keys of the effects.
        probability: Posterior probability; all hypotheses sum to 1.
        log_evidence: ln of the marginal likelihood.
        gap: Root mean square relative error after the fit.
        p_value: Probability of a misfit this large if it were right; small means it is not.
        parameters: Rows with effect, name, value, low, high, unit, nuisance, prior_sigmas.
        at_bound: Parameters at a limit of their range.
    """

    label: str
    effects: tuple[str, ...]
    probability: float
    log_evidence: float
    gap: float
    p_value: float
    parameters: list[dict] = field(default_factory=list)
    at_bound: tuple[str, ...] = ()

    def __repr__(self) -> str:
        label = shorten(self.label, 60)
        return f"HypothesisResult({label}: {self.probability:.1%}, error {self.gap:.2%})"


@dataclass(frozen=True)
class Separation:
    """A measurement that would distinguish the members of a class.

    Attributes:
        class_name: The class.
        members: Names of its effects.
        measurement: What to measure.
        distance: Expected separation D in standard deviations, at most: as if neither were fitted
            anew to what would be measured; 2.33 is 1 % confusion.
    """

    class_name: str
    members: tuple[str, ...]
    measurement: str
    distance: float


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The whole answer.

    Attributes:
        title: The case's title.
        verdict: ``cause`` (confirmed on held-out data), ``likely`` (a cause that they do not
            confirm), ``no gap``, ``unknown`` or ``ambiguous``.
        summary: The verdict in one or two plain sentences.
        condition: Name and unit of the conditions, such as ("torque", "N·m").
        before: Error of the baseline model.
        after: Error of the leading hypothesis, fitted to all data.
        noise: Root mean square of the measurement's own standard deviation: the least error.
        heldout_before: Error of the baseline model on held-out data.
        heldout_after: Error on held-out data, selection and fitting done without them.
        placebo_after: The same for the placebo, the best alternative explanation without the cause.
        placebo: Its label.
        validation: Error before and after on data that were never fitted; None without such.
        where: Share of chi-square by region, most probable first, ``unexplained`` last.
        effects: Effects, most probable first; ``no gap`` and ``none of these`` among them.
        hypotheses: Hypotheses, most probable first.
        separations: How to split classes that this test leaves together.
        model_error: Largest relative frequency error of the reduced model against the full one.
        model: Facts on the model: dofs, basis, samples, seconds.
        silent: Effects that were left out, with the reason.
        by_level: Whether the condition is a level of force or amplitude.
        location: Score tests of regions, zones and patches, and the misfit along modes, frequencies
            and conditions.
        shrinkage: How far the gap shrinks on held-out data, with what was stated before.
        joints: What the comparison starts from: joints ``bonded``, as one with the parts, or
            ``given``, as the case has them; empty if the model has none.
        scales: The standard deviations that are inferred from the data, by the leading hypothesis.
        damping: Measured and, by the leading hypothesis, predicted damping ratios, each of shape
            (n, m); None if damping was not used.
        somewhere: Whether an unknown cause is a change of stiffness or mass somewhere; None where
            that was not looked at.
        misattribution: How often, in simulated tests, a cause outside the library is taken for one
            of it; None where that was not looked at.
        at_once: p-value of the fit with all effects of the library at once; None
            where the best few explain the test.
        without_partner: Names of the test's modes that match none of the model's, with or without
            an effect; they are left out of everything.
        row_names: Names of the conditions that are after a known change, ``""`` for the others;
            empty without such.
    """

    title: str
    verdict: str
    summary: str
    condition: tuple[str, str]
    before: Gap
    after: Gap
    noise: float
    heldout_before: float
    heldout_after: float
    placebo_after: float
    placebo: str
    validation: tuple[Gap, Gap] | None
    where: list[ZoneShare]
    effects: list[EffectResult]
    hypotheses: list[HypothesisResult]
    separations: list[Separation]
    model_error: float
    model: dict
    silent: tuple[Silent, ...] = ()
    by_level: bool = False
    joints: str = ""
    damping: tuple[np.ndarray, np.ndarray] | None = None
    scales: Scales | None = None
    location: Location | None = None
    shrinkage: Shrinkage | None = None
    somewhere: LocalisedUnknown | None = None
    misattribution: Misattribution | None = None
    row_names: tuple[str, ...] = ()
    at_once: float | None = None
    without_partner: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        rows = [(e.name, e.region, probability(e.probability)) for e in self.effects[:8]]
        gap = f"error {percent(self.before.rms)} to {percent(self.after.rms)}"
        held = f"held out {percent(self.heldout_before)} to {percent(self.heldout_after)}"
        caption = f"{self.title}: {self.verdict}; {gap}, {held}"
        return html_table(caption, ("effect", "region", "probability"), rows)

    def __repr__(self) -> str:
        gap = f"error {self.before.rms:.2%} to {self.after.rms:.2%}"
        lead = next((h.label for h in self.hypotheses), "")
        return f"Diagnosis({self.verdict}: {shorten(lead, 40)}; {gap}; {len(self.effects)} effects)"

    @property
    def between(self) -> tuple[float, ...] | None:
        """Of a test by level, standard deviations of what changes between levels and the leading
        hypothesis does not explain, of ln f and, if it was used, of ln damping."""
        return self._scales_of(BETWEEN)

    @property
    def of_stated(self) -> tuple[float, ...] | None:
        """Of other tests, how much of the stated error of any such model the leading hypothesis
        has, of ln f and, if there are some, of shapes."""
        there = self._scales_of(WITH_FUNCTIONS)
        return self._scales_of(ERRORS) if there is None else (there[0], *there[2:])

    @property
    def of_functions(self) -> float | None:
        """How much of the stated errors of measured functions it has; None without."""
        there = self._scales_of(WITH_FUNCTIONS)
        return None if there is None else there[1]

    def _scales_of(self, kind: Kind) -> tuple[float, ...] | None:
        there = self.scales is not None and self.scales.kind == kind
        return self.scales.values if there else None

    def to_dataframe(self, of: str = "effects"):
        """The effects, or the fitted parameters of every hypothesis, as a ``pandas.DataFrame``.

        Args:
            of: ``effects``: rows with name, region, probability (0 to 1, of all hypotheses with
                the effect), class (effects that this test cannot tell apart), detectable and odds
                (before the test), the most probable first. ``parameters``: rows with hypothesis,
                its probability, and effect, name, value, low, high (a standard deviation either
                way), unit, nuisance and prior_sigmas, the most probable hypothesis first.

        Raises:
            InputError: If ``of`` is something else, or pandas is not installed.
        """
        member("of", of, ("effects", "parameters"))
        rows = [_effect(e) for e in self.effects]
        if of == "parameters":
            rows = [
                {"hypothesis": h.label, "probability": h.probability, **row}
                for h in self.hypotheses
                for row in h.parameters
            ]
        return dataframe({key: [row[key] for row in rows] for key in (rows[0] if rows else ())})

    def table(self, of: str = "effects"):
        """Deprecated: `to_dataframe` under its first name."""
        warnings.warn("Diagnosis.table is now to_dataframe", DeprecationWarning, stacklevel=2)
        return self.to_dataframe(of)

    @property
    def classes(self) -> list[tuple[str, float, tuple[EffectResult, ...]]]:
        """Name, probability and effects of each class, the most probable first.

        The probability of a class is that of all hypotheses that hold one of its effects: since two
        of them may be in one hypothesis, it is not the sum over the effects.
        """
        members: dict[str, list[EffectResult]] = {}
        for effect in self.effects:
            members.setdefault(effect.class_name, []).append(effect)
        rows = []
        for name, effects in members.items():
            keys = {e.key for e in effects}
            p = sum(h.probability for h in self.hypotheses if keys & {*h.effects, h.label})
            p = min(max([p, *(e.probability for e in effects)]), 1.0)
            rows.append((name, p, tuple(effects)))
        return sorted(rows, key=lambda row: -row[1])

    def to_json(self) -> dict:
        """The documented keys of ``diagnose --json``."""
        held_out = ("heldout_before", "heldout_after", "placebo_after", "placebo", "noise")
        of_gap = {key: getattr(self, key) for key in held_out}
        out = {
            "version": fenics_joints.__version__,
            "title": self.title,
            "verdict": self.verdict,
            "summary": self.summary,
            "start": {"joints": self.joints, "gap": self.before.rms},
            "gap": {"before": self.before.rms, "after": self.after.rms, **of_gap},
            "where": [asdict(share) for share in self.where],
            "classes": [
                {"name": name, "effects": [e.key for e in effects], "probability": p}
                for name, p, effects in self.classes
            ],
            "effects": [_effect(e) for e in self.effects],
            "hypotheses": [asdict(h) for h in self.hypotheses],
            "silent": [asdict(s) for s in self.silent],
            "separations": [_renamed(s, "class_name") for s in self.separations],
            "folds": [asdict(fold) for fold in self.shrinkage.folds] if self.shrinkage else [],
            "conditions": {
                "name": self.condition[0],
                "unit": self.condition[1],
                "values": self.before.conditions,
                **({"after_change": self.row_names} if any(self.row_names) else {}),
            },
            "modes": self.before.mode_names,
            "modes_without_partner": list(self.without_partner),
            "frequencies_hz": _frequencies(self.before, self.after),
            "model": {**self.model, "frequency_error": self.model_error},
        }
        for key in ("location", "shrinkage"):
            if getattr(self, key) is not None:
                out[key] = getattr(self, key).to_json()
        if self.at_once is not None:
            out["at_once"] = self.at_once
        if self.misattribution is not None:
            out["outside"] = asdict(self.misattribution)
        if self.somewhere is not None:
            out["somewhere"] = asdict(self.somewhere)
        if self.damping is not None:
            out["damping"] = dict(zip(("test", "after"), self.damping, strict=True))
        if self.between is not None:
            out["between_levels"] = dict(zip(("frequency", "damping"), self.between, strict=False))
        if self.of_stated is not None:
            out["of_stated_error"] = dict(zip(("frequency", "shape"), self.of_stated, strict=False))
        if self.of_functions is not None:
            out["of_stated_error"]["function"] = self.of_functions
        if self.validation is not None:
            before, after = self.validation
            out["validation"] = {
                "conditions": before.conditions,
                "gap_before": before.rms,
                "gap_after": after.rms,
                "frequencies_hz": _frequencies(before, after),
            }
        return plain(out)


def _effect(e: EffectResult) -> dict:
    return _renamed(e, "class_name", "describe")


def _renamed(result: EffectResult | Separation, name: str, *without: str) -> dict:
    """Its attributes without some, and with one renamed to "class" as in the JSON."""
    return {
        "class" if key == name else key: value
        for key, value in asdict(result).items()
        if key not in without
    }


def _frequencies(before: Gap, after: Gap) -> dict[str, np.ndarray]:
    return {"test": before.test_hz, "before": before.model_hz, "after": after.model_hz}
