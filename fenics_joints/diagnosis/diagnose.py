"""The diagnosis from a case, or a structure and its test, to its answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.case import Case, test_notes
from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.classes import classes, confusable_effects, detectable
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear_fits import all_at_once, with_simulated
from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown, point_mass
from fenics_joints.diagnosis.evidence.merging import merge_indistinguishable
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions, at_conditions
from fenics_joints.diagnosis.held_out import cross_validate, folds
from fenics_joints.diagnosis.location import locate_gap
from fenics_joints.diagnosis.model.of_forms import form_case
from fenics_joints.diagnosis.model.of_structure import case_of
from fenics_joints.diagnosis.model.prepared import Prepared, prepare
from fenics_joints.diagnosis.result import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.diagnosis.search import Search
from fenics_joints.diagnosis.separation import separations
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.thresholds import MISFIT
from fenics_joints.diagnosis.verdict import (
    NAMED,
    NO_GAP,
    UNKNOWN,
    after_held_out,
    class_probabilities,
    confirm,
    decide,
    doubtful,
    is_wrong,
    several_causes,
    sure_classes,
    with_strangers,
)
from fenics_joints.errors import InputError, items
from fenics_joints.files import writable_folder
from fenics_joints.machine.memory import give_back
from fenics_joints.matrices import MatrixStructure
from fenics_joints.measurements import Gap, TestData
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.reduction.matched import places_all_over
from fenics_joints.structure import FormModel, Structure

#: Number of the best wrong hypotheses that stand against the cause in every fold. [decision:
#: chosen]
_WRONG = 2
#: Number of places at which an unmodelled point mass is sought. [numerical: chosen]
_PLACES = 240
#: What a diagnosis does, in order.
_STAGES = (
    "reduce the model, or read it from --keep",
    "compute the probability of each effect, alone and with others",
    "repeat the choice and the fit with data held out",
    "locate the error, and find the most useful further measurements",
)


def diagnose(
    model: Structure | MatrixStructure | FormModel | Case,
    of: TestData | MPI.Intracomm,
    /,
    progress: Progress | None = None,
    *,
    effects: Sequence[Effect | str] | None = None,
    extra: Sequence[Effect] = (),
    data: TestData | None = None,
    keep: Path | None = None,
    **options: Any,
) -> Diagnosis:
    """Where a nominal model is wrong, which effect causes it, how far the gap shrinks. Collective.

    ``diagnose(structure, test, progress=None, effects=None, ...)`` takes a model and its test from
    a script. The diagnosis builds its own model of what the structure is made of, by default with
    the joints bonded, with parameters ``NAME.KEY``: E, nu, rho, thickness and width (actual over
    meshed) of parts, E and G of joints (across and along their plane), mass and stiffness of what
    stands at points, k_n and k_t of held facets. The names are the structure's own: of regions,
    elastic supports and held facets, and of masses and springs, which their parameter names where
    they have one, without ``.mass`` or ``.stiffness``. Of a part whose ``stretch`` is no parameter
    and whose ``normal`` is the default the thickness is where the mesh is thinnest.

    ``diagnose(matrix_structure, test, ...)`` does the same with a
    `fenics_joints.matrices.MatrixStructure`: E and rho of its parts scale their matrices, and what
    needs a mesh is listed as not looked for.

    ``diagnose(form_model, test, ...)`` takes a `fenics_joints.structure.FormModel` whose forms are
    linear in its parameters. Each of them may be wrong but for those with ``tolerances``, which are
    by the parameters' names. Options are ``title`` and keys of ``[diagnose]``; nothing is kept.

    ``diagnose(case, comm, progress=None, extra=(), data=None, keep=None)`` takes a
    `fenics_joints.case.Case` and a communicator, with the case's test unless ``data`` is given.

    Args:
        model: The nominal model, a structure on a mesh in space or in plane strain, or one by
            forms; or a case.
        of: Of a model what was measured, (n, m) frequencies at n conditions, such as torques;
            of a case the communicator.
        progress: Told what is being done.
        effects: All that is weighed: names choose effects of the library, effects are your own.
            None for all of the library that apply to this structure and test.
        extra: Effects of your own, beside these.
        data: Of a case, the test in place of its own.
        keep: Folder in which the reduced model is kept, so that another test of the same model
            costs less; None to keep nothing.
        options: Of a structure, what a case says in its sections. ``bolts``: points on the axes of
            the bolts through a joint, m, (n, 3), by the joint's name; by default the mesh's points
            ``bolts``. Without any the joint is one zone, and the notes say that no loose bolt is
            looked for. ``bolted``: names of the joints that lie under bolts, where others lie away
            from them. ``tolerances``: relative standard deviations of what is known, by parameter,
            such as ``{"plate.E": 0.01}``; of others those of handbooks. ``attached``: what is there
            and not in the nominal model, such as sensors, by name: the keys of ``[attached.NAME]``
            in a case file. ``title``: for people. Keys of ``[diagnose]`` in a case file with its
            defaults: n_modes, discrepancy, shape_discrepancy, preload_scatter, max_effects,
            samples, joints, patches, mesh_error, rare, outside. And of ``[test]``: mass,
            mass_noise, stiffness, antiresonances.

    Raises:
        InputError: If something of the structure or an option is not usable, or the model has too
            few modes, or the folder cannot be written to. Of a case: if it has no test.
        ConvergenceError: If modes do not converge.
    """
    if isinstance(model, Case):
        if effects is not None or options:
            key = next(iter(options), "effects")
            raise InputError(f"{key}: is for a model; expected it in the sections of the case.")
        case, comm = model, of
    elif data is not None:
        raise InputError("data: is for a case; the test of a structure is the second argument.")
    else:
        chosen = None
        if effects is not None:
            given = items("effects", effects, (Effect, str), "an Effect, the name of one")
            extra = (*(each for each in given if isinstance(each, Effect)), *extra)
            chosen = [each for each in given if isinstance(each, str)]
            if not given:
                raise InputError("effects = []: expected one at least, or None for all that apply.")
        describe = form_case if isinstance(model, FormModel) else case_of
        case = describe(model, of, effects=chosen, **options)
        comm, data = model.comm, of
    progress = progress or Progress(silent=True)
    started = time.perf_counter()
    progress.outline(_STAGES)
    progress.stage(_STAGES[0])
    # Matrices of this size are too small for a second BLAS thread to be worth waking; a second
    # MPI rank is.
    with threadpool_limits(1):
        model = prepare(case, comm, progress, extra=extra, data=data)
        if not model.evidence.used.any():
            raise InputError(f"{case.path}: test.frequencies: all entries are missing.")
        folder = None if keep is None else Path(keep)
        if folder is not None:
            on_root(comm, lambda: writable_folder(folder, "--keep"))
        model.reduce(progress, folder)
        model.place_unknown()
        model.find_sites()
        model.effects = merge_indistinguishable(
            model.effects, model.forward, model.evidence, model.baseline, comm
        )
        found = _Answer(case, model, progress, started).diagnosis()
    give_back()
    return found


class _Answer:
    """A diagnosis on its way from the evidence to the answer."""

    def __init__(self, case: Case, model: Prepared, progress: Progress, started: float):
        self.given, self.model, self.progress, self.started = case, model, progress, started
        self.search = Search(model, progress)
        self.comm, self.case, self.data = model.comm, model.case, model.data
        self.evidence, self.baseline = model.evidence, model.baseline

    def diagnosis(self) -> Diagnosis:
        """Weigh all effects, hold data out, locate the gap. Collective."""
        self.progress.stage(_STAGES[1])
        fits = self.search.run()
        fits = with_simulated(fits, self.search.scores(fits), self.evidence)
        order, probability = self.search.ranked(fits)
        fits = [fits[i] for i in order]
        alike = confusable_effects(fits, probability, self.evidence)
        grouped = classes(fits, probability, alike)
        # The best explanation of the gap; "no gap" if that is the best hypothesis.
        leader = next(f for f in fits if not f.hypothesis.unknown)
        after = self._gap(self.data, leader.log_f)
        seen = self._detectable(leader)
        effects = self._effects(fits, probability, grouped, seen)
        at_once = all_at_once(fits, leader, self.evidence) if leader.p_value < MISFIT else None
        verdict, summary = decide(fits, probability, effects, leader, after, at_once)
        conditions = self.evidence.conditions
        touched = {e.key: e.touches(self.baseline, conditions) for e in self.model.effects}
        wrong, causes = is_wrong(fits, leader, touched, alike), {}
        if verdict in NAMED:
            causes = several_causes(fits, probability, effects, grouped, alike)
        self.progress.stage(_STAGES[2])
        shrink = self._shrink(fits, wrong, causes)
        if verdict in NAMED:
            other = float(probability[[f.hypothesis.unknown for f in fits]].sum())
            sure = sure_classes(class_probabilities(fits, probability, effects), other)
            keys = {key for key, name in grouped.items() if name in sure}
            fits, probability = after_held_out(fits, probability, keys, shrink)
            effects = self._effects(fits, probability, grouped, seen)
            verdict, summary = decide(
                fits, probability, effects, leader, after, at_once, doubtful(effects, shrink)
            )
        verdict, summary = confirm(verdict, summary, shrink)
        verdict, summary = with_strangers(verdict, summary, self.model.without_partner)
        ratios = leader.log_damping
        self.progress.stage(_STAGES[3])
        self.progress.step("locating the error")
        plain = replace(self.model, evidence=self.evidence.as_it_is, data=self.data.as_it_is)
        location = locate_gap(plain, n_patches=self.given.diagnose.patches)
        self.progress.step("looking for measurements that distinguish confusable effects")
        split, unsplit = separations(self.model, fits, grouped, leader)
        return Diagnosis(
            title=self.case.title,
            verdict=verdict,
            summary=summary,
            condition=self.model.condition,
            before=self._gap(self.data, self.model.nominal_log_f()),
            after=after,
            noise=float(np.sqrt(np.nanmean(self.data.log_sd()[self.evidence.used] ** 2))),
            heldout_before=shrink.before,
            heldout_after=shrink.after,
            placebo_after=shrink.placebo,
            placebo=next((f.hypothesis.label for f in fits if wrong(f)), ""),
            validation=self._validation(leader),
            where=list(location.shares),
            effects=effects,
            hypotheses=self._hypotheses(fits, probability),
            separations=split,
            model_error=self.search.model_error,
            silent=self.model.silent,
            by_level=self.data.by_level,
            joints=self.given.diagnose.joints if len(self.model.zones) else "",
            damping=None if ratios is None else (self.data.damping, np.exp(ratios)),
            scales=leader.scales,
            location=location,
            shrinkage=shrink,
            at_once=at_once,
            misattribution=self.search.misattribution,
            somewhere=self._somewhere(next(f for f in fits if f.hypothesis.unknown)),
            row_names=self.data.row_names,
            without_partner=self.model.without_partner,
            model={
                **self.model.surrogate.facts(),
                "crossing_modes": self.model.surrogate.crossing_names(self.data.mode_names),
                "mesh_error": self.model.mesh_error(),
                "order": self.model.order_note(),
                "notes": list(
                    dict.fromkeys(
                        [
                            *test_notes(self.case, self.model.full),
                            *self.data.notes,
                            *self.model.mesh_notes(),
                            *self.model.notes,
                            *unsplit,
                        ]
                    )
                ),
                "seconds": time.perf_counter() - self.started,
            },
        )

    def _hypotheses(self, fits, probability) -> list[HypothesisResult]:
        return [
            HypothesisResult(
                f.hypothesis.label,
                tuple(e.key for e in f.hypothesis.effects),
                float(p),
                f.log_evidence,
                self._gap(self.data, f.log_f).rms,
                f.p_value,
                f.hypothesis.table(f.z, f.covariance),
                f.at_bound,
            )
            for f, p in zip(fits, probability, strict=True)
        ]

    def _detectable(self, leader: Fit) -> dict[str, bool]:
        """Whether this test could see each effect at its expected size, by key."""
        model, library = self.model, self.search.library
        found = detectable(
            [e for e in model.effects if not e.by_level],
            library.expected,
            library.nominal,
            self.evidence,
        )
        slipping = [e for e in model.effects if e.by_level]
        if slipping:
            # In the leader without effects of the level: a bonded joint does not slip.
            lowest = float(self.evidence.conditions[0])
            beneath = leader.hypothesis.still(leader.z, lowest, self.baseline)

            def expected(effect: Effect | None, size: float) -> np.ndarray:
                h = model.hypothesis(() if effect is None else (effect,))
                many = ManyPredictions(h, model.forward, self.evidence, beneath)
                return many.at(h.at(size), slopes=False)[0]

            found |= detectable(slipping, expected, expected(None, 0.0), self.evidence)
        return found

    def _effects(self, fits, probability, grouped, seen) -> list[EffectResult]:
        found, places = [], []
        for effect in self.model.effects:
            inside = [effect in f.hypothesis.effects for f in fits]
            total = float(np.sum(probability[inside]))
            places.append(inside.index(True))
            found.append(
                EffectResult(
                    effect.name,
                    effect.region,
                    total,
                    grouped[effect.key],
                    seen[effect.key],
                    _described(effect, fits[inside.index(True)]),
                    effect.weight,
                )
            )
        for label, words in (
            (NO_GAP, "The baseline model explains the test within its tolerances."),
            (UNKNOWN, "A cause that is not in the library."),
        ):
            named = [f.hypothesis.name == label for f in fits]
            places.append(named.index(True))
            p = float(np.sum(probability[named]))
            found.append(EffectResult(label, "", p, label, True, words))
        # Of effects without any probability, the one in the better hypothesis comes first.
        order = np.lexsort((places, [-e.probability for e in found]))
        return [found[i] for i in order]

    def _shrink(self, fits: Sequence[Fit], wrong: Callable[[Fit], bool], causes) -> Shrinkage:
        masks = folds(
            self.data.conditions,
            self.data.mode_names,
            self.model.condition,
            measured=np.isfinite(self.data.frequencies_hz),
            names=self.data.row_names,
        )
        without = [
            next((f for f in fits if not f.hypothesis.unknown and not holds(f)), None)
            for holds in causes.values()
        ]
        always = [f for f in fits if wrong(f)][:_WRONG] + [f for f in without if f is not None]
        self.progress.step("holding data out, choosing and fitting again", len(masks))
        return cross_validate(
            fits,
            self.search.log_prior([f.hypothesis for f in fits]),
            wrong,
            self.search.library,
            masks,
            causes=causes,
            always=always,
            not_nominal=self.model.not_nominal,
            comm=self.comm,
            progress=self.progress.advance,
        )

    def _gap(self, data: TestData, log_f: Sequence[np.ndarray]) -> Gap:
        """Gap of a test against ln f of the model at its conditions, less the mesh's error."""
        hz = np.exp(self.evidence.off_mesh(np.asarray(log_f)))
        return Gap(data.conditions, data.mode_names, data.frequencies_hz, hz)

    def _validation(self, leader: Fit) -> tuple[Gap, Gap] | None:
        data = self.given.validation()
        if data is None:
            return None
        data = self.model.without_lost(data)
        # Of a row that no known change preceded.
        before = [self.model.nominal_log_f()[self.evidence.as_row[0]]] * len(data)
        after = at_conditions(
            leader.hypothesis,
            self.model.forward,
            leader.z,
            data.conditions,
            self.baseline,
            self.evidence.shape[1],
        )[0]
        return self._gap(data, before), self._gap(data, after)

    def _somewhere(self, unknown: Fit) -> LocalisedUnknown | None:
        """How probably an unknown cause has a place, and the point mass that explains it best."""
        seen, full, point = self.model.surrogate, self.model.full, None
        if unknown.placed is None:
            return None
        if full.is_meshed:
            points = np.unique(places_all_over(full, _PLACES).points, axis=0)
            point = point_mass(
                unknown,
                self.evidence,
                seen.nominal,
                seen.pairing,
                self.data.sensors,
                points,
                full.total_mass(self.baseline),
            )
        return LocalisedUnknown(float(unknown.placed), point)


def _described(effect: Effect, best: Fit) -> str:
    """The description of an effect, with its place in the best explanation that holds it."""
    found = [
        row["at"]
        for row in best.hypothesis.table(best.z, best.covariance)
        if row["effect"] == effect.key and row.get("at")
    ]
    return f"{effect.describe} Most probably at {found[0]}." if found else effect.describe
