"""Weighs every effect, every pair that could matter, and more together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np
from scipy.special import logsumexp

from fenics_joints.diagnosis.effects.effect import Effect, log_odds, log_odds_outside
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Found, Library
from fenics_joints.diagnosis.evidence.linear_fits import near_best
from fenics_joints.diagnosis.evidence.merging import KnownEffects
from fenics_joints.diagnosis.evidence.misattribution import Misattribution, simulate
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.thresholds import MISFIT
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN
from fenics_joints.diagnosis.zones.sites import ON, without_attached
from fenics_joints.parallel import spread
from fenics_joints.progress import Progress
from fenics_joints.reduction.basis import weak_greedy

#: Leading hypotheses that are checked on the full model: after the single effects, and at the end.
#: [numerical: chosen for time]
_LEADING_SINGLES, _LEADING = 4, 2
#: Error of a reduced frequency above which the basis is enriched, relative to the discrepancy and
#: at least; and how often that is checked. [numerical: as `NEGLIGIBLE`; chosen for time]
_REDUCED, _LEAST, _ROUNDS = 0.1, 1e-4, 4
#: How far behind the best hypotheses may be, in nats, and be weighed again by a better model, or by
#: sampling; number of those that are sampled. [numerical: e^-10 and e^-5 are little; chosen for
#: time]
_AGAIN, _SAMPLED, _SAMPLES = 10.0, 5.0, 8
#: Hypotheses to which another effect is added; sets of effects that are solved for, and how far
#: behind the best the screen may find these, in nats. [numerical: chosen for time]
_PARENTS, _SETS, _MARGIN = 12, 24, 8.0
#: Effects that are weighed first. Others are weighed by algebra alone if their evidence falls short
#: of the largest possible one by so many times what the best of the first does, and so many nats
#: more. [numerical: chosen for time]
_FIRST, _FAR_OFF, _AT_LEAST = 4, 3.0, 50.0
#: Effects, such as single loose bolts, of which sets of one more are solved for: only the best.
#: [numerical: chosen for time]
_PARTS = 4


class Search:
    """The hypotheses of a diagnosis and what the test says of them.

    Args:
        model: What is diagnosed, reduced.
        progress: Told what is being done.
    """

    def __init__(self, model: Prepared, progress: Progress):
        self.model, self.progress = model, progress
        self._odds = log_odds(model.effects)
        #: ln of the prior odds of a cause outside the library against none.
        self.log_unknown = log_odds_outside(model.case.diagnose.outside)
        #: How often such a cause is taken for one in the library; None before `run`.
        self.misattribution: Misattribution | None = None
        self.met = KnownEffects(model.baseline, model.evidence.conditions)
        for effect in model.effects:
            self.met.same((effect,))
        self.library = Library(
            model.forward, model.evidence, model.baseline, self._hypothesis, lean=True
        )

    def _hypothesis(self, effects: Sequence[Effect]) -> Hypothesis:
        return self.model.hypothesis(tuple(effects))

    def run(self) -> list[Fit]:
        """Weigh no effect, an unknown cause, each effect, and promising sets of several.
        Collective."""
        model = self.model
        plain = [
            model.hypothesis((), name=NO_GAP),
            model.hypothesis((), name=UNKNOWN, unknown=True),
        ]
        alone = [effect for effect in model.effects if not effect.holds]
        self.progress.step("solving each effect across its prior", len(alone))
        self.library.solve(alone, model.comm, self.progress.advance)
        self.progress.step("evidence of single effects", len(alone) + 2)
        found = self._all([(h, None) for h in plain])
        self.library.floor = max(f.fit.log_evidence for f in found)
        found += self._singles([self._hypothesis((e,)) for e in alone], found[0])
        self.misattribution = self._simulate(alone)
        level = found[2:]
        waiting = [effect for effect in model.effects if effect.holds]
        while waiting:
            parts = frozenset().union(*(e.holds for e in waiting))
            parents = self._near([f for f in level if f.fit.hypothesis.effects[0].key in parts])
            parents = parents[:_PARTS]
            keys = {f.fit.hypothesis.effects[0].key for f in parents}
            own = [e for e in waiting if e.holds & keys]
            if not own:
                break
            waiting = [e for e in waiting if e not in own]
            self.progress.step("evidence of several effects of one kind", len(own))
            self.library.solve(own, model.comm, self.progress.advance)
            level = self._singles([self._hypothesis((e,)) for e in own], found[0])
            found += level
        found = self._checked(found, _LEADING_SINGLES, quickly=True)
        singles = found[2:]
        model.effects = tuple(
            e for e in model.effects if e.key in {f.fit.hypothesis.effects[0].key for f in singles}
        )
        level = singles
        for size in range(2, model.case.diagnose.max_effects + 1):
            level = self._add_effects(level, singles, found, size)
            found += level
        found = self._checked(found, _LEADING)
        return [f.fit for f in self._sampled(found)]

    def _simulate(self, alone: Sequence[Effect]) -> Misattribution:
        """How often a cause outside the library is taken for one in it. Collective."""
        self.progress.step("simulating tests with a cause outside the library")
        model, test = self.model, self.model.evidence
        if model.not_nominal is not None:
            # Which of the model's modes they are differs from effect to effect.
            test = test.without(np.broadcast_to(model.not_nominal, test.shape))
        outside, comm = model.case.diagnose.outside, model.comm
        return simulate(self.library, alone, self._odds, outside, self.log_unknown, test, comm)

    # -- evidence ------------------------------------------------------------------------------

    def _all(self, tasks: Sequence[tuple[Hypothesis, Found | None]]) -> list[Found]:
        """Weigh hypotheses: each of one effect, or of a parent's effects and one more.
        Collective."""
        library, test = self.library, self.model.evidence

        def work(task):
            self.progress.advance()
            h, parent = task
            return (
                library.single(h, test) if parent is None else library.add_effect(h, parent, test)
            )

        return library.shared(self.model.comm, tasks, work, _pack, _unpack)

    def _singles(self, hypotheses: Sequence[Hypothesis], nothing: Found) -> list[Found]:
        """Weigh each effect; those that are far behind by algebra alone. Collective."""
        comm, library, test = self.model.comm, self.library, self.model.evidence
        looks = np.array(spread(comm, hypotheses, lambda h: library.promises(h, test)))
        order = np.argsort(-looks - self.log_prior(hypotheses), kind="stable")
        first = order[:_FIRST]
        found = dict(zip(first, self._all([(hypotheses[i], None) for i in first]), strict=True))
        best = max(f.fit.log_evidence for f in (nothing, *found.values()))
        # No prediction could have more.
        most = max(-0.5 * np.linalg.slogdet(2 * np.pi * test.covariance())[1], best)
        least = most - _FAR_OFF * (most - best) - _AT_LEAST
        near = [i for i in order[_FIRST:] if looks[i] > least]
        found |= dict(zip(near, self._all([(hypotheses[i], None) for i in near]), strict=True))
        return [found.get(i) or library.glance(h, test) for i, h in enumerate(hypotheses)]

    def _near(self, found: Sequence[Found]) -> list[Found]:
        """Hypotheses by their probability, the best first."""
        scores = self.scores([f.fit for f in found])
        return [found[i] for i in np.argsort(-scores, kind="stable")]

    def _leading(self, found: Sequence[Found], nats: float) -> list[int]:
        """Indices of hypotheses of the library so near the best of them, the best first."""
        scores = self.scores([f.fit for f in found])
        listed = [i for i, f in enumerate(found) if not f.fit.hypothesis.unknown]
        listed.sort(key=lambda i: -scores[i])
        return [i for i in listed if scores[i] > scores[listed[0]] - nats]

    def _add_effects(
        self, level: Sequence[Found], singles: Sequence[Found], known: Sequence[Found], size: int
    ) -> list[Found]:
        """Sets of effects that are promising. Collective."""
        library, test = self.library, self.model.evidence
        parents = self._near(level)[: _PARENTS if size == 2 else 3]
        effects = [f.fit.hypothesis.effects[0] for f in singles]
        self.progress.step(f"screening sets of {size} effects", len(parents))

        def work(parent):
            self.progress.advance()
            return library.promised(parent, effects, test)

        sets: dict[frozenset[str], tuple[float, Hypothesis, Found]] = {}
        for parent, looks in zip(parents, spread(self.model.comm, parents, work), strict=True):
            for effect in effects:
                own = (*parent.fit.hypothesis.effects, effect)
                keys = frozenset(e.key for e in own)
                if not _compatible(own) or (keys not in sets and self._is_another(own)):
                    continue
                h = self._hypothesis(own)
                score = looks[effect.key] + float(self.log_prior([h])[0])
                if keys not in sets or score > sets[keys][0]:
                    sets[keys] = score, h, parent
        if not sets:
            return []
        best = np.max(self.scores([f.fit for f in known if not f.fit.hypothesis.unknown]))
        options = list(sets.values())
        scores = np.array([score for score, _, _ in options])
        order, found = near_best(scores, np.inf, _SETS), []
        self.progress.step(f"evidence of sets of {size} effects", len(order))
        while len(order) and scores[order[0]] > best - _MARGIN:
            some, order = order[:_FIRST], order[_FIRST:]
            found += self._all([options[i][1:] for i in some if scores[i] > best - _MARGIN])
            best = max(best, *self.scores([f.fit for f in found]))
        return found

    def _is_another(self, effects: tuple[Effect, ...]) -> bool:
        """Whether a set of effects does the same to the model as another one."""
        same = self.met.same(effects)
        return same is not None and {e.key for e in same} != {e.key for e in effects}

    def _sampled(self, found: list[Found]) -> list[Found]:
        """The same with the evidence of the leading hypotheses by sampling, if there are several.
        Collective."""
        near = self._leading(found, _SAMPLED)[:_SAMPLES]
        scores = self.scores([f.fit for f in found])
        if np.sum(scores > scores[near[0]] - _SAMPLED) < 2:
            return found
        self.progress.step("evidence of the best hypotheses by sampling", len(near))
        return self._again(found, near, lambda f: self.library.sampled(f, self.model.evidence))

    def _again(
        self, found: Sequence[Found], near: Sequence[int], work: Callable[[Found], Found]
    ) -> list[Found]:
        """The same with some of them weighed again. Collective."""

        def one(f: Found) -> Found:
            self.progress.advance()
            return work(f)

        better = self.library.shared(
            self.model.comm,
            [found[i] for i in near],
            one,
            _pack,
            lambda f, packed: _unpack((f.fit.hypothesis, None), packed),
        )
        new = dict(zip(near, better, strict=True))
        return [new.get(i, f) for i, f in enumerate(found)]

    # -- the reduced model's error ---------------------------------------------------------------

    def _checked(self, found: list[Found], count: int, quickly: bool = False) -> list[Found]:
        """Check leading hypotheses on the full model; enrich the basis and weigh again where
        needed, until it holds or `_ROUNDS` are over; `model_error` is what is left."""
        surrogate, found = self.model.surrogate, list(found)
        limit = max(_REDUCED * self.model.evidence.discrepancy, _LEAST)

        def near() -> list[Fit]:
            return [found[i].fit for i in self._leading(found, _AGAIN)]

        def leading() -> list[dict[str, float]]:
            self.progress.step(surrogate.checking)
            values: list[dict[str, float]] = []
            for fit in near():
                at = self.lowest(fit)
                if at not in values and len(values) < count:
                    values.append(at)
            return values

        def again() -> None:
            self.library = self.library.with_forward(self.model.forward)
            found[:] = self._renewed(found)

        better = [f for f in near() if f.log_evidence > found[0].fit.log_evidence]
        if any(e.family == ON for f in better for e in f.hypothesis.effects) and surrogate.bend():
            again()
        errors = weak_greedy(
            surrogate.quick if quickly else surrogate, leading, limit, _ROUNDS, after=again
        )
        self.model_error = float(errors.max(initial=0.0))
        return found

    def _renewed(self, found: Sequence[Found]) -> list[Found]:
        """What is near the best weighed again, by the better model. Collective."""
        leading = self._leading(found, _AGAIN)
        named = [i for i, f in enumerate(found) if f.fit.hypothesis.name]
        near = sorted({*leading, *named})
        self.progress.step("evidence with the improved model", len(near))
        return self._again(found, near, lambda f: self.library.renewed(f, self.model.evidence))

    def lowest(self, f: Fit) -> dict[str, float]:
        """The model's parameter values of a fit at the lowest condition, where joints are softest.

        Args:
            f: The fit.
        """
        lowest = self.model.evidence.conditions[0]
        values = f.hypothesis.values(f.z, lowest, self.model.baseline, 0)
        return without_attached(values, self.model.baseline)

    # -- weights -------------------------------------------------------------------------------

    def log_prior(self, hypotheses: Sequence[Hypothesis]) -> np.ndarray:
        """ln of each hypothesis' prior odds against none."""
        return np.array(
            [
                self.log_unknown if h.unknown else sum(self._odds[e.key] for e in h.effects)
                for h in hypotheses
            ]
        )

    def scores(self, fits: Sequence[Fit]) -> np.ndarray:
        """ln of the evidence times the prior odds of each."""
        return np.array([f.log_evidence for f in fits]) + self.log_prior(
            [f.hypothesis for f in fits]
        )

    def probabilities(self, fits: Sequence[Fit]) -> np.ndarray:
        """Posterior probability of each of the fitted hypotheses.

        Hypotheses whose own p-value is too small count together for no more than an unknown cause:
        the best of wrong explanations is still wrong. And an explanation may be named in place of a
        cause outside the library (`fenics_joints.diagnosis.evidence.misattribution`).
        """
        score = self.scores(fits)
        unknown = max(
            (s for s, f in zip(score, fits, strict=True) if f.hypothesis.unknown), default=np.inf
        )
        known = np.array([not f.hypothesis.unknown for f in fits])
        failed = known & np.array([f.p_value < MISFIT for f in fits])
        if failed.any():
            # Among each other they keep their odds.
            over = max(float(logsumexp(score[failed])) - unknown, 0.0)
            score = np.where(failed, score - over, score)
        found = np.exp(score - logsumexp(score))
        named = known & np.array([bool(f.hypothesis.effects) for f in fits])
        if known.all() or not named.any() or self.misattribution is None:
            return found
        leader = fits[int(np.argmax(np.where(named, score, -np.inf)))]
        nothing = next(f for f in fits if f.hypothesis.name == NO_GAP)
        gap = leader.log_evidence - nothing.log_evidence
        found[named] *= 1 - self.misattribution.outside(gap, leader.p_value)
        found[~known] += (1 - found.sum()) / np.sum(~known)
        return found

    def ranked(self, fits: Sequence[Fit]) -> tuple[np.ndarray, np.ndarray]:
        """Indices of hypotheses, the most probable first, and their probabilities in that order.

        Those so far behind an unknown cause that their probabilities underflow stand in the order
        of their evidence.
        """
        found = self.probabilities(fits)
        order = np.lexsort((-self.scores(fits), -found))
        return order, found[order]


def _compatible(effects: Sequence[Effect]) -> bool:
    """Whether effects can be at work together, none in place of another."""
    families = [e.family or e.key for e in effects]
    keys = [e.key for e in effects]
    if len(set(families)) < len(families) or len(set(keys)) < len(keys):
        return False
    return not any(a.never_with & {b.name for b in effects if b is not a} for a in effects)


def _pack(found: Found) -> tuple:
    """Without its hypothesis, which holds functions."""
    own = found.fit
    fit = {f.name: getattr(own, f.name) for f in fields(own) if f.name != "hypothesis"}
    return fit, None if found.cells is found.peak else found.cells, found.log_evidence, found.peak


def _unpack(task, packed: tuple) -> Found:
    fit, cells, log_evidence, peak = packed
    found = Fit(hypothesis=task[0], **fit)
    return Found(found, peak if cells is None else cells, log_evidence, peak)
