"""The diagnosis from a case to its answer: where, which, how far."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from scipy.special import logsumexp
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from fenics_joints.build import build_structure
from fenics_joints.case import Case
from fenics_joints.diagnosis.classes import classes, detectable
from fenics_joints.diagnosis.contact_zones import contact_zones
from fenics_joints.diagnosis.effects import Effect
from fenics_joints.diagnosis.inference import Fit, Hypothesis, evidence_of, fit
from fenics_joints.diagnosis.library import (
    bonded_values,
    by_preload,
    case_effects,
    case_nuisances,
    layer_thickness,
    sample_ranges,
)
from fenics_joints.diagnosis.localise import cell_map, merge_regions, zone_shares
from fenics_joints.diagnosis.prediction import Prediction
from fenics_joints.diagnosis.result import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.diagnosis.separation import best_measurement
from fenics_joints.diagnosis.shrinkage import cross_validate, folds
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN, decide
from fenics_joints.errors import InputError
from fenics_joints.gap import Gap
from fenics_joints.measurements import TestData
from fenics_joints.progress import Progress
from fenics_joints.surrogate import Surrogate, crossing_names

__all__ = ["diagnose"]

#: Prior odds of each further effect in a hypothesis, and of an unknown cause.
_ODDS = 0.2
#: Singles that further effects are put beside, by evidence; and how many of them must be of
#: another family than the best, so that the placebo has a fair chance too.
_LEADERS, _OTHERS = 3, 1
#: A hypothesis this far (in ln) behind the best on all data is not refitted in the folds.
_HOPELESS = 15.0
#: Error of a reduced frequency, relative to the discrepancy, above which the basis is enriched.
_REDUCED = 0.05


def diagnose(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress | None = None,
    *,
    extra: Sequence[Effect] = (),
    data: TestData | None = None,
) -> Diagnosis:
    """Where the model of a case is wrong, which effect causes it, how far the gap shrinks.

    Args:
        case: The case.
        comm: Communicator; the call is collective and gives the same answer on all ranks.
        progress: Told what is being done.
        extra: Effects of the user's own, beside the library's.
        data: The test, if not the case's.

    Raises:
        InputError: If the case has no test, or its model too few modes.
        ConvergenceError: If modes do not converge.
    """
    return _Run(case, comm, progress or Progress(silent=True), tuple(extra), data).answer()


@dataclass
class _Run:
    """What the steps of a diagnosis hand to one another."""

    case: Case
    comm: MPI.Intracomm
    progress: Progress
    extra: tuple[Effect, ...]
    data: TestData | None
    started: float = field(default_factory=time.perf_counter)

    def answer(self) -> Diagnosis:
        # Matrices of this size are too small for a second BLAS thread to be worth waking; a second
        # MPI rank is.
        with threadpool_limits(1):
            self._prepare()
            self._reduce()
            return self._report(self._verify(self._fit_all()))

    # -- the model ---------------------------------------------------------------------------

    def _prepare(self) -> None:
        self.zones = None
        self.case = self.case.diagnosed()
        if self.case.contacts:
            self.progress.step("contact under preload")
            self.zones = contact_zones(self.case, self.comm, self.case.diagnose.zones)
            self.case = self.zones.case
        case = self.case
        self.progress.step("building the model")
        self.data = case.measurements() if self.data is None else self.data
        self.sensors = self.data.sensors
        tagged = None if self.zones is None else self.zones.tagged
        self.full = build_structure(
            case, self.comm, law="uncoupled", attached=True, tagged=tagged
        )
        self.baseline = bonded_values(case)
        self.thickness = layer_thickness(self.full)
        effects, self.silent = case_effects(case, self.data, self.thickness, self.zones)
        self.effects = (*effects, *self.extra)
        self.nuisances = case_nuisances(case)
        self.scatter = case.diagnose.preload_scatter if by_preload(self.data) else 0.0
        self.n_test = len(self.data.mode_names)
        self.evidence = evidence_of(self.data, case.diagnose.discrepancy)
        if not self.evidence.used.any():
            raise InputError(f"{case.path}: test.frequencies: all entries are missing.")

    def _reduce(self) -> None:
        samples = self._samples(self.case.diagnose.samples)
        self.samples = len(samples)
        self.progress.step("reduced model: sampling the parameters", len(samples))
        n = self.case.diagnose.n_modes
        self.surrogate = Surrogate(
            self.full, samples, self.baseline, sensors=self.sensors, n_test=self.n_test,
            n_modes=n, shapes=self.data.shapes, travel=self._travel(), progress=self.progress,
        )  # fmt: skip
        self.forward = self.surrogate.forward

    def _travel(self) -> dict:
        pointed = {**self.case.masses, **self.case.attached}
        moving = {
            name: section.shift()
            for name, section in pointed.items()
            if getattr(section, "travel", None) is not None
        }
        return {
            mass.name: moving[owner]
            for mass in self.full.masses
            if (owner := str(mass.travel).removesuffix(".travel")) in moving
        }

    def _samples(self, count: int) -> list[dict[str, float]]:
        """The baseline, some parameters at the ends of their ranges, and a Sobol sequence."""
        ranges = sample_ranges(self.case, {} if self.zones else self.thickness)
        samples = [self.baseline]
        for name in ranges:
            if name.endswith(".thickness"):
                # A section turns by its thickness times the slope of the plate: modes of one
                # thickness cannot bend another without shear, and it would seem far too stiff.
                samples += [{**self.baseline, name: end} for end in ranges[name][:2]]
            if name.endswith(".travel"):
                # A mass at an edge bends it locally: a basis from inner places would miss that.
                mass = name.replace(".travel", ".mass")
                for end in (0.0, 1.0):
                    samples.append(self._sample(ranges, {name: end, mass: 1.0}))
        unit = qmc.Sobol(len(ranges), seed=1).random_base2(int(np.ceil(np.log2(count))))[:count]
        places = [dict(zip(ranges, row, strict=True)) for row in unit]
        samples += [self._sample(ranges, place) for place in places]
        return samples if self.zones is None else self._contact_samples(samples)

    def _contact_samples(self, samples: list[dict[str, float]]) -> list[dict[str, float]]:
        """Samples with the contact's effects in them, as its zones do not vary one by one.

        The cut-off stands between every two zones once; the other effects of the joint take turns,
        at places of their priors, in the samples that are there.
        """
        own = [e for e in self.effects if e.family == "joint compliance"]
        lost = next((e for e in own if [p.name for p in e.priors] == ["cutoff"]), None)
        others = [e for e in own if e is not lost]
        most = max((len(e.priors) for e in others), default=1)
        enough = int(np.ceil(np.log2(len(samples))))
        places = 3 * qmc.Sobol(most, seed=2).random_base2(enough) - 1.5
        found = [samples[0]]
        for i, values in enumerate(samples[1:]):
            values = dict(values)
            if others and i % 4:
                effect = others[i % len(others)]
                theta = {
                    p.name: p.value(float(np.clip(z, *p.limits())))
                    for p, z in zip(effect.priors, places[i], strict=False)
                }
                effect.apply(values, theta, self.data.conditions[0])
            found.append(values)
        for level in self.zones.low[1:] if lost is not None else ():
            values = dict(self.baseline)
            lost.apply(values, {"cutoff": float(level)}, self.data.conditions[0])
            found.append(values)
        return found

    def _sample(self, ranges: dict, place: dict[str, float]) -> dict[str, float]:
        """Values at a place in the unit cube of the ranges; in their middle where not given."""
        values = dict(self.baseline)
        for name, (low, high, log) in ranges.items():
            u = place.get(name, 0.5)
            values[name] = float(low ** (1 - u) * high**u if log else low + u * (high - low))
        return values

    # -- the fits ----------------------------------------------------------------------------

    def _hypothesis(self, effects: Sequence[Effect], **kwargs) -> Hypothesis:
        conditions = tuple(float(c) for c in self.evidence.conditions)
        return Hypothesis(
            tuple(effects), self.nuisances, scatter=self.scatter, conditions=conditions,
            modes=tuple(self.data.mode_names), damped=self.evidence.log_damping is not None,
            **kwargs,
        )  # fmt: skip

    def _fit(self, hypothesis: Hypothesis, starts=()) -> Fit:
        return fit(
            hypothesis, self.forward, self.evidence, self.baseline,
            starts=starts, progress=self.progress.advance,
        )  # fmt: skip

    def _fit_all(self) -> list[Fit]:
        self.progress.step("fitting one effect at a time", len(self.effects) + 2)
        none = self._fit(self._hypothesis((), name=NO_GAP))
        unknown = self._fit(self._hypothesis((), name=UNKNOWN, unknown=True))
        singles = [self._fit(self._hypothesis((effect,))) for effect in self.effects]
        level, fits = singles, [none, unknown, *singles]
        for size in range(2, self.case.diagnose.max_effects + 1):
            level = self._extend(level, size)
            fits += level
        return fits

    def _extend(self, level: list[Fit], size: int) -> list[Fit]:
        """The best of a level with one more effect each."""
        ordered = sorted(level, key=lambda f: -f.log_evidence)
        if not ordered:
            return []
        best = {e.family or e.key for e in ordered[0].hypothesis.effects}
        others = [
            f for f in ordered[_LEADERS:]
            if not best & {e.family or e.key for e in f.hypothesis.effects}
        ]  # fmt: skip
        todo, known = [], set()
        for parent in (*ordered[:_LEADERS], *others[:_OTHERS]):
            for effect in self.effects:
                chosen = (*parent.hypothesis.effects, effect)
                families = [e.family or e.key for e in chosen]
                keys = frozenset(e.key for e in chosen)
                if len(set(families)) == len(families) and keys not in known:
                    known.add(keys)
                    todo.append((chosen, parent))
        self.progress.step(f"fitting {size} effects at a time", len(todo))
        return [self._fit(self._hypothesis(chosen), [self._start(chosen, p)]) for chosen, p in todo]

    def _start(self, effects: Sequence[Effect], parent: Fit) -> np.ndarray:
        """The parent's parameters, with a zero for each of the effect that is added."""
        own = parent.hypothesis.places
        first = min(place.start for place in own.values())
        tail = [
            parent.z[own[name]] if len(parent.hypothesis.shared[name]) else np.zeros(len(group))
            for name, group in self._hypothesis(effects).shared.items()
        ]
        return np.concatenate([parent.z[:first], np.zeros(len(effects[-1].priors)), *tail])

    def _log_prior(self, fits: Sequence[Fit]) -> np.ndarray:
        """Logarithm of each hypothesis' prior weight: the same odds for each of its effects."""
        sizes = [1 if f.hypothesis.unknown else len(f.hypothesis.effects) for f in fits]
        return np.array([n * np.log(_ODDS) for n in sizes])

    def _probabilities(self, fits: Sequence[Fit]) -> np.ndarray:
        score = np.array([f.log_evidence for f in fits]) + self._log_prior(fits)
        return np.exp(score - logsumexp(score))

    # -- the reduced model's error -------------------------------------------------------------

    def _verify(self, fits: list[Fit]) -> list[Fit]:
        """Check the leading fits on the full model; enrich the basis and fit again where needed."""
        limit = max(_REDUCED * self.evidence.discrepancy, 1e-4)
        for _ in range(2):
            self.progress.step("checking the reduced model against the full one")
            self.model_error, modes = self.surrogate.error(self._leading_values(fits))
            if self.model_error <= limit:
                return fits
            self.surrogate.refine(modes)
            self.progress.step("fitting again with the better model", len(fits))
            fits = [self._fit(f.hypothesis, [f.z]) for f in fits]
        self.model_error, _ = self.surrogate.error(self._leading_values(fits))
        return fits

    def _leading_values(self, fits: Sequence[Fit]) -> list[dict[str, float]]:
        """Parameters of the two leading fits at the lowest and the highest condition."""
        leading = [fits[i] for i in np.argsort(-self._probabilities(fits))[:2]]
        conditions = self.evidence.conditions
        rows = sorted({0, len(conditions) - 1})
        return [
            f.hypothesis.values(f.z, conditions[row], self.baseline, row)
            for f in leading
            for row in rows
        ]

    # -- the answer --------------------------------------------------------------------------

    def _report(self, fits: list[Fit]) -> Diagnosis:
        probability = self._probabilities(fits)
        order = np.argsort(-probability)
        fits, probability = [fits[i] for i in order], probability[order]
        grouped = classes(fits, probability, self.evidence)
        leader = self._leader(fits)
        effects = self._effects(fits, probability, grouped, leader)
        verdict, summary = decide(fits, probability, effects, leader, self._gap(leader.log_f))
        shrink = self._shrink(fits, leader, grouped)
        self.progress.step("localising the gap")
        where = zone_shares(leader, self.forward, self.evidence, self.baseline, self._regions())
        cells = self._cells()
        before = self._gap(np.array([self.forward(self.baseline)[0]] * len(self.data)))
        return Diagnosis(
            title=self.case.title,
            verdict=verdict,
            summary=summary,
            condition=(self.data.condition_name, self.data.condition_unit),
            before=before,
            after=self._gap(leader.log_f),
            noise=float(np.sqrt(np.nanmean(self.data.log_sd()[self.evidence.used] ** 2))),
            heldout_before=shrink.before,
            heldout_after=shrink.after,
            placebo_after=shrink.placebo,
            placebo=self._placebo_label(fits, leader, grouped),
            folds=shrink.rows,
            validation=self._validation(leader),
            where=where,
            effects=effects,
            hypotheses=self._hypotheses(fits, probability),
            separations=self._separations(fits, probability, grouped, leader),
            cells=cells,
            model_error=self.model_error,
            silent=self.silent,
            by_level=self.data.by_level,
            damping=self._damping(leader),
            model={
                "dofs": self.full.n_dofs,
                "basis": self.surrogate.model.n_dofs,
                "samples": self.samples,
                "reduced_solutions": self.forward.calls,
                "crossing_modes": crossing_names(self.surrogate, self.data.mode_names),
                "seconds": time.perf_counter() - self.started,
            },
        )

    def _regions(self) -> dict[str, str]:
        """Regions that are shown as one: the zones of a contact."""
        return {} if self.zones is None else dict.fromkeys(self.zones.names, self.zones.contact)

    def _leader(self, fits: Sequence[Fit]) -> Fit:
        """The best hypothesis that says what the gap is made of; "no gap" if that is the best."""
        if fits[0].hypothesis.unknown:
            return next(f for f in fits if not f.hypothesis.unknown)
        return fits[0]

    def _gap(self, log_f: np.ndarray) -> Gap:
        data = self.data
        return Gap(data.conditions, data.mode_names, data.frequencies_hz, np.exp(log_f))

    def _damping(self, leader: Fit) -> tuple[np.ndarray, np.ndarray] | None:
        if leader.log_damping is None:
            return None
        return self.data.damping, np.exp(leader.log_damping)

    def _hypotheses(self, fits, probability) -> list[HypothesisResult]:
        return [
            HypothesisResult(
                f.hypothesis.label,
                tuple(e.key for e in f.hypothesis.effects),
                float(p),
                f.log_evidence,
                self._gap(f.log_f).rms,
                f.p_value,
                f.hypothesis.table(f.z, f.covariance),
                f.at_bound,
            )
            for f, p in zip(fits, probability, strict=True)
        ]

    def _beneath(self, effect: Effect, leader: Fit) -> dict[str, float]:
        """The model that an effect is looked for in: the nominal one, but for an effect of the
        level the leader without such, for nothing slips in a joint that is as one."""
        if not effect.by_level:
            return self.baseline
        lowest = float(self.evidence.conditions[0])
        return leader.hypothesis.still(leader.z, lowest, self.baseline)

    def _effects(self, fits, probability, grouped, leader) -> list[EffectResult]:
        found = []
        for effect in self.effects:
            inside = [effect in f.hypothesis.effects for f in fits]
            base = self._beneath(effect, leader)
            seen = detectable(effect, self.forward, self.evidence, base, self.nuisances)
            total = float(np.sum(probability[inside]))
            found.append(
                EffectResult(
                    effect.name, effect.region, total, grouped[effect.key], seen, effect.describe
                )
            )
        for label, words in (
            (NO_GAP, "The nominal model, within tolerance, explains the test."),
            (UNKNOWN, "Something that is not in the library."),
        ):
            p = sum(p for f, p in zip(fits, probability, strict=True) if f.hypothesis.name == label)
            found.append(EffectResult(label, "", float(p), label, True, words))
        return sorted(found, key=lambda e: -e.probability)

    def _is_wrong(self, fits: Sequence[Fit], leader: Fit, grouped: dict[str, str]):
        """A hypothesis is a placebo if it has nothing of the leader's main cause.

        The main cause is the class of effects without which the evidence falls most.
        """

        def holds(f: Fit, effect: Effect) -> bool:
            return any(
                grouped[e.key] == grouped[effect.key] or (e.family and e.family == effect.family)
                for e in f.hypothesis.effects
            )

        known = [f for f in fits if not f.hypothesis.unknown]
        main = min(
            leader.hypothesis.effects,
            key=lambda e: max((f.log_evidence for f in known if not holds(f, e)), default=-np.inf),
            default=None,
        )
        if main is None:
            return lambda f: bool(f.hypothesis.effects)
        return lambda f: bool(f.hypothesis.effects) and not holds(f, main)

    def _placebo_label(self, fits, leader, grouped) -> str:
        wrong = self._is_wrong(fits, leader, grouped)
        return next((f.hypothesis.label for f in fits if wrong(f)), "")

    def _shrink(self, fits: Sequence[Fit], leader: Fit, grouped):
        best = max(f.log_evidence for f in fits)
        wrong = self._is_wrong(fits, leader, grouped)
        wrongs = [f for f in fits if wrong(f)]
        fair = [
            f for f in fits
            if not f.hypothesis.unknown and not wrong(f) and best - f.log_evidence < _HOPELESS
        ] + wrongs[:4]  # fmt: skip
        masks = folds(
            self.data.conditions, self.data.mode_names,
            (self.data.condition_name, self.data.condition_unit),
        )  # fmt: skip
        self.progress.step("holding data out, choosing and fitting anew", len(masks))
        return cross_validate(
            fair or [leader], self._log_prior(fair or [leader]), wrong, self.forward,
            self.evidence, self.baseline, masks, progress=self.progress.advance,
        )  # fmt: skip

    def _validation(self, leader: Fit) -> tuple[Gap, Gap] | None:
        data = self.case.validation()
        if data is None:
            return None
        gaps = []
        before = np.array([self.forward(self.baseline)[0]] * len(data))
        after = np.array(
            [
                Prediction(leader.hypothesis, self.forward, leader.z, c, self.baseline).log_f
                for c in data.conditions
            ]
        )
        for log_f in (before, after):
            gaps.append(Gap(data.conditions, data.mode_names, data.frequencies_hz, np.exp(log_f)))
        return gaps[0], gaps[1]

    def _cells(self):
        names = list(self.full.parameters)
        _, slope = self.forward(self.baseline)
        columns = [
            slope[:, names.index(f"{part}.{key}")] * self.baseline[f"{part}.{key}"]
            for part in self.case.parts
            for key in ("E", "rho", "thickness")
        ]
        found = cell_map(
            self.full, self.surrogate.nominal, self.surrogate.pairing, self.evidence,
            np.array(columns).T,
        )  # fmt: skip
        return None if found is None else merge_regions(found, self._regions())

    def _separations(self, fits, probability, grouped, leader) -> list:
        """For each class with several likely members: what would split the leading two."""
        self.progress.step("looking for measurements that would split what this test cannot")
        found = []
        for name in dict.fromkeys(grouped[e.key] for e in leader.hypothesis.effects):
            members = {e.key: e.name for e in self.effects if grouped[e.key] == name}
            if len(members) < 2:
                continue
            mine = next(e.key for e in leader.hypothesis.effects if e.key in members)
            rival = self._rival(fits, leader, mine, members)
            if rival is None:
                continue
            found.append(
                best_measurement(
                    name, list(members.values()), leader, rival, self.surrogate, self.baseline,
                    (self.data.condition_name, self.data.condition_unit),
                    float(np.max(self.data.noise)) or 1e-3, self.evidence.discrepancy,
                )
            )  # fmt: skip
        return found

    @staticmethod
    def _rival(fits, leader, mine, members) -> Fit | None:
        """The best hypothesis that has another member in place of the leader's."""
        rest = {e.key for e in leader.hypothesis.effects} - {mine}
        for f in fits:
            keys = {e.key for e in f.hypothesis.effects}
            others = keys - rest
            if rest <= keys and len(others) == 1 and others <= set(members) - {mine}:
                return f
        return None

