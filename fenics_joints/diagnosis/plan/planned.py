"""The plan of a case: before any data, which causes its test could tell apart."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from string import ascii_uppercase

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

import fenics_joints
from fenics_joints.case import Case
from fenics_joints.diagnosis.effects.effect import Effect, Silent, log_odds, log_odds_outside
from fenics_joints.diagnosis.effects.rig import MISSED
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.entries import KINDS
from fenics_joints.diagnosis.evidence.evidence import Evidence, evidence_of
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.misattribution import confusion_matrix
from fenics_joints.diagnosis.model.prepared import Prepared, prepare
from fenics_joints.diagnosis.plan.added import Addition, Candidates, measured_by, rank
from fenics_joints.diagnosis.plan.study import (
    Signature,
    Study,
    combination,
    few_sensors,
    groups,
    middle,
)
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.files import plain
from fenics_joints.formatting import number, quantity, spaced
from fenics_joints.measurements.data import TestData
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress

#: Names that a sentence holds at most. [numerical: length of a sentence]
_LISTED = 6


@dataclass(frozen=True)
class PlannedEffect:
    """An effect as the planned test would see it.

    Attributes:
        name: The effect.
        region: Where it acts.
        key: Its unique name.
        describe: What it means.
        size: Its expected size: value of each parameter, SI, by name.
        units: Their units.
        distance: D from "no gap" at that size.
        distance_least: The same at the size, of the prior's median and one standard deviation
            either way, that shows least.
        distance_most: At the one that shows most.
        letter: Class of effects that the test would not tell apart; empty for an effect alone.
    """

    name: str
    region: str
    key: str
    describe: str
    size: dict[str, float]
    units: dict[str, str]
    distance: float
    distance_least: float
    distance_most: float
    letter: str = ""

    @property
    def seen(self) -> bool:
        """Whether the test would see it at its expected size."""
        return self.distance >= APART


@dataclass(frozen=True)
class PlannedClass:
    """Effects that the planned test would not tell apart.

    Attributes:
        letter: A, B, ...
        members: Keys of the effects.
        collinearity: Collinearity index of their signatures; above 20 no size would help.
        combination: The changes that cancel best, in words.
        left: What they leave of the prediction's change, standard deviations.
    """

    letter: str
    members: tuple[str, ...]
    collinearity: float
    combination: str
    left: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The answer before any data.

    Attributes:
        title: The case's title.
        condition: Name and unit of the conditions.
        conditions: Their values, (n,).
        mode_names: Names of the modes.
        frequencies_hz: Those of the nominal model, (m,).
        measured: What the test measures: frequencies, damping, shapes.
        noise: Root mean square of the standard deviation of ln f from noise and resolution.
        discrepancy: That of the error of any model.
        effects: The effects, members of a class together, those not seen last.
        distances: D of the row's effect from what the column's can make, (n, n + 1); the last
            column is "no gap".
        taken_for: Mean probability that each effect of the column gets in tests that are simulated
            with the row's at work, of any size that is probable, (n, n + 2); the last columns are
            "no gap" and a cause outside the library. nan where none could be simulated.
        classes: Classes of several effects.
        additions: What further measurements would add, the most telling first.
        silent: Effects that such a test says nothing about.
        model: Facts on the model.
    """

    title: str
    condition: tuple[str, str]
    conditions: np.ndarray
    mode_names: tuple[str, ...]
    frequencies_hz: np.ndarray
    measured: tuple[str, ...]
    noise: float
    discrepancy: float
    effects: list[PlannedEffect]
    distances: np.ndarray
    taken_for: np.ndarray
    classes: list[PlannedClass]
    additions: list[Addition]
    silent: tuple[Silent, ...]
    model: dict

    def __repr__(self) -> str:
        return f"Plan({self.title!r}: {len(self.effects)} causes, {self.n_apart} apart)"

    @property
    def unseen(self) -> list[PlannedEffect]:
        """Effects too small for the test at their expected size."""
        return [e for e in self.effects if not e.seen]

    @property
    def alone(self) -> list[PlannedEffect]:
        """Effects that the test would tell from every other."""
        return [e for e in self.effects if e.seen and not e.letter]

    @property
    def n_apart(self) -> int:
        """How many causes or classes of causes the test would tell apart."""
        return len(self.alone) + len(self.classes)

    def sentences(self) -> tuple[str, str, str]:
        """How many causes it can tell apart; which it cannot; what to measure next."""
        return self._how_many(), self._which_not(), self._what_next()

    def _how_many(self) -> str:
        n, seen = len(self.effects), sum(e.seen for e in self.effects)
        if not seen:
            return f"This test could detect none of the {n} possible causes."
        which = f"all {n}" if seen == n else f"{seen} of {n}"
        see = f"This test could detect {which} possible causes"
        if seen == 1:
            return f"{see}."
        if self.n_apart == 1:
            return f"{see}, but could distinguish none of them from all others."
        if not self.classes:
            return f"{see}, and distinguish all of them."
        single = f"{_count(len(self.alone), 'single cause')} and " if self.alone else ""
        groups = _count(len(self.classes), "group")
        return f"{see}, and distinguish {self.n_apart}: {single}{groups} of causes."

    def _which_not(self) -> str:
        said = []
        if self.classes:
            groups = "; ".join(self._listed(c.members) for c in self.classes)
            said.append(f"It could not distinguish {groups}")
        if self.unseen:
            few = self._listed([e.key for e in self.unseen])
            said.append(f"{'it' if said else 'It'} could not detect {few} at the expected size")
        if not said:
            return "It could detect every cause and distinguish each from every other."
        return f"{', and '.join(said)}."

    def _listed(self, keys: Sequence[str]) -> str:
        """Effects in words, those that differ by their region alone under one name."""
        by_name: dict[str, list[str]] = {}
        for e in self.effects:
            if e.key in keys:
                by_name.setdefault(e.name, []).append(e.region)
        often = [e.name for e in self.effects]
        words = [
            f"{name} ({', '.join(regions)})" if often.count(name) > 1 else name
            for name, regions in by_name.items()
        ]
        if len(words) > _LISTED:
            words = [*words[: _LISTED - 1], f"{len(words) - _LISTED + 1} others"]
        return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"

    def _what_next(self) -> str:
        if not (self.classes or self.unseen):
            return "No further measurement is needed."
        best = self.additions[0] if self.additions else None
        if best is None or best.largest_gain < NEGLIGIBLE:
            return "None of the further measurements that were tried would help."
        seen = sum(e.seen for e in self.effects)
        if best.apart > self.n_apart:
            more = f", {best.seen} detected" if best.seen > seen else ""
            return f"Measure next: {best.measurement}. Then {best.apart} are distinguished{more}."
        if best.seen > seen:
            return f"Measure next: {best.measurement}. Then {best.seen - seen} more are detected."
        return (
            "No single further measurement would distinguish more. The most useful is "
            f"{best.measurement}: on average it increases D of the undecided pairs by "
            f"{best.mean_gain:.2f}."
        )

    def to_json(self) -> dict:
        """The documented keys of ``diagnose --plan --json``."""
        keys = [e.key for e in self.effects]
        others = [*keys, "no gap"]
        outcomes = [*others, "none of these"]
        distances, shares = self.distances.tolist(), self.taken_for.tolist()
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.title,
                "summary": " ".join(self.sentences()),
                "apart": self.n_apart,
                "conditions": {
                    "name": self.condition[0],
                    "unit": self.condition[1],
                    "values": self.conditions,
                },
                "modes": self.mode_names,
                "frequencies_hz": self.frequencies_hz,
                "measured": self.measured,
                "noise": self.noise,
                "discrepancy": self.discrepancy,
                "effects": [
                    asdict(e) | {"seen": e.seen, "class": e.letter or None} for e in self.effects
                ],
                "distance": {
                    key: dict(zip(others, row, strict=True))
                    for key, row in zip(keys, distances, strict=True)
                },
                "confusion": {
                    key: None if np.isnan(row).any() else dict(zip(outcomes, row, strict=True))
                    for key, row in zip(keys, shares, strict=True)
                },
                "classes": [asdict(c) | {"class": c.letter} for c in self.classes],
                "additions": [asdict(a) for a in self.additions],
                "silent": [{"effect": s.effect, "reason": s.reason} for s in self.silent],
                "model": self.model,
            }
        )


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


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
        # Effects that stand for several others at once are left out: each of these is in the plan.
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
        test = measured_by(model, evidence)
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
            progress.step("looking for useful further measurements")
            offered = Candidates(model, evidence, study).all()
            progress.step("evaluating further measurements", len(offered))
            additions = rank(study, offered, progress.advance)
    letters = {key: c.letter for c in classes for key in c.members}
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
        effects=[_effect(sizes, letters) for sizes in (study.sizes[i] for i in order)],
        distances=study.table[picked],
        taken_for=taken_for[np.ix_(order, [*order, len(order), len(order) + 1])],
        classes=classes,
        additions=additions,
        silent=model.silent,
        model={**model.surrogate.facts(), "seconds": time.perf_counter() - started},
    )


def _without_missed_modes(model: Prepared) -> None:
    """A plan takes the modes to be those that the model has."""
    missed = [e for e in model.effects if e.name == MISSED]
    if missed:
        model.effects = tuple(e for e in model.effects if e.name != MISSED)
        reason = "a plan assumes that the test finds all modes of the model"
        model.silent = (*model.silent, Silent(MISSED, reason))


def _taken_for(model: Prepared, evidence: Evidence, progress: Progress) -> np.ndarray:
    """What each effect is taken for, see `Plan.taken_for`, in the order of the model's effects."""
    # An effect of the level acts in a compliant joint only, so never alone.
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


def _measured(evidence: Evidence) -> tuple[str, ...]:
    found = ["frequencies"]
    if evidence.log_damping is not None:
        found.append("damping")
    if evidence.shapes is not None:
        found.append("shapes")
    return (*found, *dict.fromkeys(KINDS[scalar.kind] for scalar in evidence.scalars))


def _beneath(model: Prepared) -> dict[str, dict[str, float]]:
    """Baselines of the effects of the level: a joint that is as compliant as is expected of one,
    since nothing slips in a bonded joint."""
    joint = next(
        (e for e in model.effects if e.family == "joint compliance" and not e.by_level), None
    )
    if joint is None:
        return {}
    values = dict(model.baseline)
    joint.apply(values, {p.name: p.median for p in joint.priors}, float(model.data.conditions[0]))
    return {e.key: values for e in model.effects if e.by_level}


def _ordered(study: Study) -> tuple[list[int], list[PlannedClass]]:
    """The effects, members of a class together and the unseen last; and the classes."""
    D = study.table
    found = sorted(groups(D[:, :-1], D[:, -1] >= APART), key=lambda g: (-len(g), g))
    classes = []
    for members in found:
        if len(members) > 1:
            some = [study.expected[i] for i in members]
            keys, telling = tuple(s.effect.key for s in some), _of_families(some)
            pair = combination([study.whitened(s) for s in telling])
            words = _combined(telling, pair.factors)
            letter = _letter(len(classes))
            classes.append(PlannedClass(letter, keys, pair.index, words, pair.left))
    order = [i for g in found for i in g]
    return order + [i for i in range(len(study.effects)) if i not in order], classes


def _of_families(signatures: Sequence[Signature]) -> list[Signature]:
    """The longest of each family, if there are several: that two laws of one joint cancel when
    they say the same goes without saying."""
    best: dict[str, Signature] = {}
    for s in sorted(signatures, key=lambda s: -s.d):
        best.setdefault(s.effect.family or s.effect.key, s)
    return list(best.values()) if len(best) > 1 else list(signatures)


def _letter(i: int) -> str:
    """A to Z, then A2 to Z2, ..."""
    again, i = divmod(i, len(ascii_uppercase))
    return ascii_uppercase[i] + (str(again + 1) if again else "")


def _combined(signatures: Sequence[Signature], factors: np.ndarray) -> str:
    """A combination of changes that cancel in words, without what hardly counts."""
    size = np.abs(factors)
    words = ""
    for i in np.argsort(-size, kind="stable"):
        s = signatures[i]
        if size[i] < NEGLIGIBLE:
            break
        if words:
            sign = "+" if factors[i] > 0 else "\N{MINUS SIGN}"
            words += f" {sign} {number(size[i], 2)} \N{MULTIPLICATION SIGN} "
        words += f"{spaced(s.effect.key)} ({size_in_words(s)})"
    return words


def size_in_words(signature: Signature) -> str:
    """The parameters of a signature, such as ``k_t = 1.00 TPa/m``."""
    pairs = zip(signature.effect.priors, signature.values.values(), strict=True)
    words = [f"{prior.name} = {quantity(value, prior.unit)}" for prior, value in pairs]
    more = [f"and {len(words) - _NAMED} more"] if len(words) > _NAMED + 1 else []
    return ", ".join([*words[: _NAMED if more else None], *more])


def _effect(sizes: Sequence[Signature], letters: Mapping[str, str]) -> PlannedEffect:
    """An effect by its signatures at several sizes, the expected one among them."""
    expected = middle(sizes)
    effect, distances = expected.effect, [s.d / 2 for s in sizes]
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
        letters.get(effect.key, ""),
    )
