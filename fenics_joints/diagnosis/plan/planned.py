"""The plan of a case: before any data, which causes its test could tell apart."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.case import Case
from fenics_joints.diagnosis.effects.effect import Effect, Silent
from fenics_joints.diagnosis.effects.odds import log_odds, log_odds_outside
from fenics_joints.diagnosis.effects.rig import MISSED
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.entries import KINDS
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.misattribution import confusion_matrix
from fenics_joints.diagnosis.evidence.of_test import evidence_of
from fenics_joints.diagnosis.model.prepared import Prepared, prepare
from fenics_joints.diagnosis.plan.added import measurement, rank, table
from fenics_joints.diagnosis.plan.candidates import Candidates
from fenics_joints.diagnosis.plan.groups import combination, groups
from fenics_joints.diagnosis.plan.result import Plan, PlannedClass, PlannedEffect
from fenics_joints.diagnosis.plan.sensors import few_sensors
from fenics_joints.diagnosis.plan.study import Signature, Study
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.formatting import number, quantity, spaced
from fenics_joints.measurements.data import TestData
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress

_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
#: Parameters of an effect that are named in words. [numerical: length of a sentence]
_NAMED = 4


def plan(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress | None = None,
    *,
    extra: Sequence[Effect] = (),
    keep: Path | None = None,
) -> Plan:
    """Which causes the planned test of a case could tell apart, and what to measure besides.

    Args:
        case: The case, with ``[test.planned]``, or a test whose layout is taken.
        comm: Communicator; the call is collective and gives the same answer on all ranks.
        progress: Told what is being done.
        extra: Effects of the user's own, beside the library's.
        keep: Folder in which the reduced model is kept; it is there already if a diagnosis kept it.

    Raises:
        InputError: If the case has no test, or its model too few modes.
        ConvergenceError: If modes do not converge.
    """
    started, progress = time.perf_counter(), progress or Progress(silent=True)
    layout = case.planned()
    with threadpool_limits(1):
        model = prepare(case, comm, progress, extra=extra, data=layout)
        # Several at once of what is looked at one by one.
        model.effects = tuple(e for e in model.effects if not e.holds)
        _without_missed_modes(model)
        model.reduce(progress, keep)
        model.data = _nominal(model, case)
        evidence = evidence_of(
            model.data,
            model.case.diagnose.discrepancy,
            scalars=model.evidence.scalars,
            mesh_error=model.evidence.mesh_error,
        )
        test = measurement(
            model.nuisances, model.scatter, model.data.mode_names, evidence, model.forward
        )
        model.effects, left = few_sensors(test, model.effects, model.baseline)
        model.silent = (*model.silent, *left)
        progress.step("signatures and distances", 2 * len(model.effects))
        study = Study(
            test,
            model.effects,
            model.baseline,
            beneath=_beneath(model),
            progress=progress.advance,
            comm=comm,
        )
        order, classes = _ordered(study)
        taken_for = _taken_for(model, evidence, progress)
        additions = []
        if classes or any(s.d / 2 < APART for s in study.expected):
            progress.step("looking for measurements that would help")
            offered = Candidates(model, evidence, test, study).all()
            progress.step("what they would tell apart", len(offered))
            additions = rank(study, offered, progress.advance)
    letters = {i: c.letter for c, members in classes for i in members}
    facts = {**model.surrogate.facts(), "seconds": time.perf_counter() - started}
    picked = np.ix_(order, [*order, len(order)])
    return Plan(
        title=case.title,
        condition=(layout.condition_name, layout.condition_unit),
        conditions=layout.conditions,
        mode_names=layout.mode_names,
        frequencies_hz=np.exp(model.forward(model.baseline)[0]),
        measured=_measured(evidence),
        noise=float(np.sqrt(np.mean(evidence.log_sd[evidence.used] ** 2))),
        discrepancy=evidence.discrepancy,
        effects=[_effect(study, i, letters.get(i, "")) for i in order],
        distances=table(study)[picked],
        taken_for=taken_for[np.ix_(order, [*order, len(order), len(order) + 1])],
        classes=[c for c, _ in classes],
        additions=[replace(a, distances=a.distances[picked]) for a in additions],
        silent=model.silent,
        model=facts,
    )


def _without_missed_modes(model: Prepared) -> None:
    """A plan takes the modes to be those that the model has."""
    missed = [e for e in model.effects if e.name == MISSED]
    if missed:
        model.effects = tuple(e for e in model.effects if e.name != MISSED)
        reason = "a plan takes the test to find the modes that the model has"
        model.silent = (*model.silent, Silent(MISSED, reason))


def _taken_for(model: Prepared, evidence: Evidence, progress: Progress) -> np.ndarray:
    """What each effect is taken for, see `Plan.taken_for`, in the order of the model's effects."""
    # What changes with the level does so in a joint that gives way: never alone.
    alone = [i for i, e in enumerate(model.effects) if not e.by_level]
    effects, n = [model.effects[i] for i in alone], len(model.effects)
    progress.step("simulating tests of each cause", len(effects))
    library = Library(
        model.forward,
        evidence,
        model.baseline,
        lambda some: model.hypothesis(tuple(some)),
        lean=True,
    )
    library.solve(effects, model.comm, progress.advance)
    outside = log_odds_outside(model.case.diagnose.outside)
    found = on_root(
        model.comm, lambda: confusion_matrix(library, effects, log_odds(effects), outside, evidence)
    )
    shares = np.zeros((n, n + 2))
    shares[[i for i in range(n) if i not in alone]] = np.nan
    shares[np.ix_(alone, [*alone, n, n + 1])] = model.comm.bcast(found)
    return shares


def _nominal(model: Prepared, case: Case) -> TestData:
    """The test's layout with the nominal model's predictions for values."""
    data = model.data
    hz = np.exp(model.forward(model.baseline)[0])
    there = np.isfinite(data.frequencies_hz)
    planned = case.test.planned
    shapes = data.shapes
    if planned is not None and planned.shapes:
        shapes = model.surrogate.pairing.shapes
    return replace(data, frequencies_hz=np.where(there, hz, np.nan), shapes=shapes)


def _measured(evidence) -> tuple[str, ...]:
    kinds = (
        ("frequencies", True),
        ("damping", evidence.log_damping is not None),
        ("shapes", evidence.shapes is not None),
    )
    single = dict.fromkeys(KINDS[scalar.kind] for scalar in evidence.scalars)
    return (*(name for name, there in kinds if there), *single)


def _beneath(model: Prepared) -> dict[str, dict[str, float]]:
    """Baselines of the effects of the level: a joint that gives way as is expected of one.

    Nothing slips in a joint that is as one with its bodies.
    """
    joint = next(
        (e for e in model.effects if e.family == "joint compliance" and not e.by_level), None
    )
    if joint is None:
        return {}
    values = dict(model.baseline)
    joint.apply(values, {p.name: p.median for p in joint.priors}, float(model.data.conditions[0]))
    return {e.key: values for e in model.effects if e.by_level}


def _ordered(study: Study) -> tuple[list[int], list[tuple[PlannedClass, list[int]]]]:
    """The effects, members of a class together and the unseen last; and the classes."""
    D = table(study)
    found = sorted(groups(D[:, :-1], D[:, -1] >= APART), key=lambda g: (-len(g), g))
    classes = []
    for number_, members in enumerate(g for g in found if len(g) > 1):
        some = [study.expected[i] for i in members]
        keys, telling = tuple(s.effect.key for s in some), _of_families(some)
        pair = combination([study.whitened(s) for s in telling])
        words = _in_words(telling, pair.factors)
        classes.append(
            (PlannedClass(_letter(number_), keys, pair.index, words, pair.left), members)
        )
    order = [i for g in found for i in g]
    order += [i for i in range(len(study.effects)) if i not in order]
    return order, classes


def _of_families(signatures: Sequence[Signature]) -> list[Signature]:
    """The longest of each family, if there are several: that two laws of one joint cancel when
    they say the same goes without saying."""
    best: dict[str, Signature] = {}
    for s in sorted(signatures, key=lambda s: -s.d):
        best.setdefault(s.effect.family or s.effect.key, s)
    return list(best.values()) if len(best) > 1 else list(signatures)


def _letter(i: int) -> str:
    """A to Z, then A2 to Z2, ..."""
    again = i // len(_LETTERS)
    return _LETTERS[i % len(_LETTERS)] + (str(again + 1) if again else "")


def _in_words(signatures: Sequence[Signature], factors: np.ndarray) -> str:
    """A combination of changes that cancel, without what hardly counts."""
    size = np.abs(factors)
    order = [i for i in np.argsort(-size, kind="stable") if size[i] >= NEGLIGIBLE]
    first = signatures[order[0]]
    words = f"{spaced(first.effect.key)} ({size_in_words(first)})"
    for i in order[1:]:
        sign = "+" if factors[i] > 0 else "\N{MINUS SIGN}"
        times = f"{number(abs(factors[i]), 2)} \N{MULTIPLICATION SIGN} "
        name = spaced(signatures[i].effect.key)
        words += f" {sign} {times}{name} ({size_in_words(signatures[i])})"
    return words


def size_in_words(signature: Signature) -> str:
    """The parameters of a signature, such as ``k_t = 1.00 TPa/m``."""
    pairs = zip(signature.effect.priors, signature.values.values(), strict=True)
    words = [f"{prior.name} = {quantity(value, prior.unit)}" for prior, value in pairs]
    more = [f"and {len(words) - _NAMED} more"] if len(words) > _NAMED + 1 else []
    return ", ".join([*words[: _NAMED if more else None], *more])


def _effect(study: Study, i: int, letter: str) -> PlannedEffect:
    effect, expected = study.effects[i], study.expected[i]
    distances = [s.d / 2 for s in study.sizes[i]]
    return PlannedEffect(
        effect.name,
        effect.region,
        effect.key,
        effect.describe,
        expected.values,
        {prior.name: prior.unit for prior in effect.priors},
        expected.d / 2,
        min(distances),
        max(distances),
        letter,
    )
