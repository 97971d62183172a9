"""Fits every effect, every pair that could matter, and more together; and weighs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial

import numpy as np
from scipy.special import logsumexp

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.equal import Known
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.inference import fit, settled
from fenics_joints.diagnosis.evidence.leans import Leans
from fenics_joints.diagnosis.evidence.screen import near_listed, quick_evidence
from fenics_joints.diagnosis.evidence.unlisted import look_alike
from fenics_joints.diagnosis.kept_fits import KeptFits
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.nearer import nearer
from fenics_joints.diagnosis.several import fit_several
from fenics_joints.diagnosis.starts import starts_of
from fenics_joints.diagnosis.survey import survey
from fenics_joints.diagnosis.together import fit_together
from fenics_joints.diagnosis.verdict import MISFIT, NO_GAP, UNKNOWN
from fenics_joints.diagnosis.zones.sites import as_mass
from fenics_joints.parallel import spread
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import improve

__all__ = ["Search"]

#: Prior odds, against none, that some one effect is at work, shared out by the effects' weights,
#: beside which some come (`Effect.beside`), so that a larger library makes nothing less likely;
#: two at once have the product of their odds. And those of an unknown cause.
_ANY, _UNKNOWN = 1.5, 0.2
#: What an effect that is not there may cost a hypothesis, in ln, at most.
_OCCAM = 10.0
#: Nats by which "no gap" has to be better by a better model for effects that it left behind to be
#: fitted anew from there, or another fit worse for it to be fitted from the start as well.
_RAISED = 1.0
#: Relative change of the sum of squares at which a fit ends.
_TOLERANCE = 1e-4
#: Leading hypotheses that are checked on the full model, of one effect and in the end; the error
#: of a reduced frequency, relative to the discrepancy, above which the basis is enriched; and how
#: often it is looked at.
_LEADING_SINGLES, _LEADING, _REDUCED, _ROUNDS = 4, 2, 0.1, 4
#: Hypotheses this far (in ln) behind the best are not fitted again with a better model.
_AGAIN = 25.0


class Search:
    """The hypotheses of a diagnosis and their fits.

    Args:
        model: What is diagnosed, reduced.
        progress: Told what is being done.
        kept: Fits of an earlier run.
    """

    def __init__(self, model: Prepared, progress: Progress, kept: KeptFits):
        self.model, self.progress, self.kept = model, progress, kept
        common = [effect.weight for effect in model.effects if not effect.beside]
        total = sum(common or [effect.weight for effect in model.effects])
        self._odds = {e.key: np.log(_ANY * e.weight / total) for e in model.effects}
        self.met = Known(model.baseline, model.evidence.conditions)
        for effect in model.effects:
            self.met.same((effect,))
        self._leans: Leans | None = None

    def run(self) -> list[Fit]:
        """Nothing, the unknown, each effect, and what is promising of several. Collective."""
        model = self.model
        singles = [model.hypothesis((effect,)) for effect in model.effects if not effect.holds]
        plain = [
            model.hypothesis((), name=NO_GAP), model.hypothesis((), name=UNKNOWN, unknown=True),
        ]  # fmt: skip
        self.progress.step("fitting one effect at a time", len(singles) + 2)
        fits = self.fit_all(plain)
        new = [h for h in singles if not self._kept(h)]
        ways = starts_of(self, new, fits[0], self.lowers())
        known = dict(zip((h.label_of_keys for h in new), ways, strict=True))
        fits += self.above(
            singles, [known.get(h.label_of_keys, ()) for h in singles], [fits[0]] * len(singles)
        )
        fits = nearer(self, survey(self, fits))
        fits = self.checked(fits, _LEADING_SINGLES, quickly=True)
        several = fit_several(self, fits[2:])
        fits = fits + several
        if any(f is g for f in several for g in self._leading(fits, _LEADING_SINGLES)):
            fits = self.checked(fits, _LEADING_SINGLES, quickly=True)
        level = fits[2:]
        fitted = {f.hypothesis.effects[0].key for f in level}
        model.effects = tuple(e for e in model.effects if e.key in fitted)
        for size in range(2, model.case.diagnose.max_effects + 1):
            level = fit_together(self, level, fits, size)
            fits = fits + level
        return self.checked(fits, _LEADING)

    @property
    def leans(self) -> Leans:
        """What shows fits the way; of the reduced model as it is."""
        model = self.model
        if self._leans is None or not self._leans.are_of(model.forward):
            self._leans = Leans(model.forward, model.evidence, model.baseline, self._leans)
        return self._leans

    def looked(
        self,
        hypotheses: Sequence[Hypothesis],
        starts: Sequence[np.ndarray],
        lowers: Sequence[np.ndarray],
    ) -> list[tuple[float, np.ndarray]]:
        """A quick look at each, see `quick_evidence`. Collective.

        Args:
            hypotheses: The hypotheses.
            starts: A point z for each.
            lowers: Cholesky factors of covariances that the evidence may have; the best counts.
        """
        model = self.model

        def look(task):
            forward = self.leans.known(task[0]) or model.forward
            return quick_evidence(*task, forward, model.evidence, model.baseline, lowers)

        return spread(model.comm, list(zip(hypotheses, starts, strict=True)), look)

    # -- the reduced model's error ---------------------------------------------------------------

    def checked(self, fits: list[Fit], count: int, quickly: bool = False) -> list[Fit]:
        """Check leading fits on the full model; enrich the basis and fit again where needed.

        Anew, since a better model may put what leads elsewhere, until it holds or `_ROUNDS` are
        over; `model_error` is what is left.
        """
        surrogate, fits = self.model.surrogate, list(fits)
        limit = max(_REDUCED * self.model.evidence.discrepancy, 1e-4)

        def leading() -> list[dict[str, float]]:
            self.progress.step(surrogate.checking)
            return self._leading_values(fits, count)

        errors = improve(
            surrogate.quick if quickly else surrogate, leading, limit, _ROUNDS,
            after=lambda: self._fit_again(fits),
        )
        self.model_error = float(errors.max(initial=0.0))
        return fits

    def _fit_again(self, fits: list[Fit]) -> None:
        """Fit what leads with the better model, in place."""
        unknown = np.array([f.hypothesis.unknown for f in fits])
        near = list(near_listed(self.scores(fits), unknown, _AGAIN, len(fits)))
        near += [i for i, f in enumerate(fits) if f.hypothesis.name and i not in near]
        same = spread(
            self.model.comm, near, lambda i: self._settled(fits[i]), lambda f: f and _pack(f),
            lambda i, packed: packed and _unpack((fits[i].hypothesis,), packed),
        )  # fmt: skip
        lost = [i for i, f in zip(near, same, strict=True) if f is None]
        self.progress.step("fitting again with the better model", len(lost))
        before = _no_gap(fits)
        anew = dict(zip(lost, self._from_ends([fits[i] for i in lost]), strict=True))
        for i, f in zip(near, same, strict=True):
            fits[i] = anew.get(i, f)
        # The model before may have had no such modes: nothing is what each effect alone holds.
        none = _no_gap(fits)
        raised = none.log_evidence > before.log_evidence + _RAISED
        alone = [i for i, f in enumerate(fits) if len(f.hypothesis.effects) == 1]
        self._lift(fits, {i: none for i in alone if raised or i in lost})

    def _from_ends(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits by the better model from where those by the old one ended; from the start as well
        where they fell: where the old model was far off, the way on from its end may be shut."""
        hypotheses = [f.hypothesis for f in fits]
        anew = self.fit_all(hypotheses, [[f.z] for f in fits], again=True, places=False)
        shut = [i for i, f in enumerate(fits)
                if anew[i].log_evidence < f.log_evidence - _RAISED]  # fmt: skip
        starts = [[np.zeros(len(fits[i].z))] for i in shut]
        others = self.fit_all([hypotheses[i] for i in shut], starts, again=True)
        for i, f in zip(shut, others, strict=True):
            anew[i] = max(anew[i], f, key=lambda fit: fit.log_evidence)
        return anew

    def _settled(self, found: Fit) -> Fit | None:
        model = self.model
        return settled(found, model.forward, model.evidence, model.baseline, _TOLERANCE)

    def _leading_values(self, fits: Sequence[Fit], count: int) -> list[dict[str, float]]:
        """Parameters of the leading fits at the lowest condition, where joints are softest."""
        found: list[dict[str, float]] = []
        for f in self._leading(fits, len(fits)):
            values = self.lowest(f)
            if values not in found and len(found) < count:
                found.append(values)
        return found

    def lowest(self, f: Fit) -> dict[str, float]:
        """The model's parameter values of a fit at the lowest condition, where joints are softest.

        Args:
            f: The fit.
        """
        lowest = self.model.evidence.conditions[0]
        found = f.hypothesis.values(f.z, lowest, self.model.baseline, 0)
        return as_mass(found, self.model.baseline)

    def _leading(self, fits: Sequence[Fit], count: int) -> list[Fit]:
        """The most probable but for the unknown."""
        order, _ = self.ranked(fits)
        return [fits[i] for i in order if not fits[i].hypothesis.unknown][:count]

    # -- fits ----------------------------------------------------------------------------------

    def fit_all(
        self, hypotheses: Sequence[Hypothesis], starts: Sequence | None = None, again: bool = False,
        places: bool = True,
    ) -> list[Fit]:  # fmt: skip
        """Fit hypotheses, each from its starts, or from where an earlier run ended. Collective.

        Args:
            hypotheses: The hypotheses.
            starts: Points z for each; the prior's median by default.
            again: Whether the starts are better than what is kept.
            places: See `fit`.
        """
        starts = [()] * len(hypotheses) if starts is None else starts
        done: list[Fit] = []
        chunk = 8 * self.model.comm.size
        for first in range(0, len(hypotheses), chunk):
            tasks = list(zip(hypotheses, starts, strict=True))[first : first + chunk]
            if not again:
                tasks = [(h, self._kept(h) or start) for h, start in tasks]
            work = partial(self._fit_task, places=places)
            found = spread(self.model.comm, tasks, work, _pack, _unpack)
            self.kept.add({f.hypothesis.label_of_keys: f.z for f in found})
            done += found
            if self.model.comm.size > 1:
                self.progress.advance(len(found))
        return done

    def above(
        self, hypotheses: Sequence[Hypothesis], starts: Sequence, parents: Sequence[Fit]
    ) -> list[Fit]:
        """Fits of hypotheses that hold others: no worse than these but for an effect more, or the
        search has ended in another valley, and starts anew from where the other's ended.

        Args:
            hypotheses: The hypotheses.
            starts: Points z for each.
            parents: Fits of each without its last effect.
        """
        fits = self.fit_all(hypotheses, starts)
        self._lift(fits, dict(enumerate(parents)))
        return fits

    def _lift(self, fits: list[Fit], parents: Mapping[int, Fit]) -> None:
        """Fit those anew, in place, that are worse than what they hold: the search has ended in
        another valley.

        Args:
            fits: Fits.
            parents: Of some of them, by index, those of each without its last effect.
        """
        below = [
            i for i, parent in parents.items()
            if fits[i].log_evidence < parent.log_evidence - _OCCAM
        ]  # fmt: skip
        ways = [[self.start(fits[i].hypothesis.effects, parents[i])] for i in below]
        again = [fits[i].hypothesis for i in below]
        anew = self.fit_all(again, ways, again=True, places=False)
        for i, f in zip(below, anew, strict=True):
            fits[i] = max(f, fits[i], key=lambda fit: fit.log_evidence)

    def _kept(self, hypothesis: Hypothesis) -> list[np.ndarray]:
        return self.kept.start(hypothesis.label_of_keys, len(hypothesis.priors))

    def _fit_task(self, task, places: bool = True) -> Fit:
        hypothesis, starts = task
        model, alone = self.model, self.model.comm.size == 1
        forward, guide = self.leans.for_fit(hypothesis)
        return fit(
            hypothesis, forward, model.evidence, model.baseline, starts=starts,
            tolerance=_TOLERANCE, guide=guide, scanned=self.leans.scanned, places=places,
            progress=self.progress.advance if alone else None,
        )  # fmt: skip

    def lowers(self, known: Sequence[Fit] = ()) -> list[np.ndarray]:
        """Factors of the test's covariance: with scales as expected, and as the best of some fits
        has them, which may have taken for drift what another effect explains.

        Args:
            known: The fits.
        """
        evidence, found = self.model.evidence, [self.model.evidence]
        if len(known) and evidence.scales is not None:
            found.append(evidence.at(known[int(np.argmax(self.scores(known)))].scales))
        return [each.lower() for each in found]

    def start(self, effects: Sequence[Effect], parent: Fit) -> np.ndarray:
        """The parent's parameters, with a zero for each of the effect that is added."""
        own = parent.hypothesis.places
        first = min(place.start for place in own.values())
        tail = [
            parent.z[own[name]] if len(parent.hypothesis.shared[name]) else np.zeros(len(group))
            for name, group in self.model.hypothesis(effects).shared.items()
        ]
        return np.concatenate([parent.z[:first], np.zeros(len(effects[-1].priors)), *tail])

    # -- weights -------------------------------------------------------------------------------

    def narrow(self, effects: Sequence[Effect], share: float) -> None:
        """Let effects be of a share of the places that they were of, and have that of their odds.

        Args:
            effects: The effects.
            share: The share.
        """
        for effect in effects:
            self._odds[effect.key] += np.log(share)

    def log_prior(self, hypotheses: Sequence[Hypothesis]) -> np.ndarray:
        """ln of each hypothesis' prior odds against none."""
        return np.array(
            [
                np.log(_UNKNOWN) if h.unknown else sum(self._odds[e.key] for e in h.effects)
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

        Those that fail their own check count together for no more than an unknown cause: the best
        of wrong explanations is none. And what explains the test may be a look-alike
        (`fenics_joints.diagnosis.evidence.unlisted`).
        """
        score = self.scores(fits)
        unknown = max((s for s, f in zip(score, fits, strict=True) if f.hypothesis.unknown),
                      default=np.inf)  # fmt: skip
        known = np.array([not f.hypothesis.unknown for f in fits])
        failed = known & np.array([f.p_value < MISFIT for f in fits])
        if failed.any():
            # Among themselves they keep their odds.
            over = max(float(logsumexp(score[failed])) - unknown, 0.0)
            score = np.where(failed, score - over, score)
        found = np.exp(score - logsumexp(score))
        if known.all():
            return found
        leader = fits[int(np.argmax(np.where(known, score, -np.inf)))]
        found *= 1 - look_alike(leader.p_value)
        found[~known] += (1 - found.sum()) / np.sum(~known)
        return found

    def ranked(self, fits: Sequence[Fit]) -> tuple[np.ndarray, np.ndarray]:
        """Which is the most probable, the next and so on, and their probabilities in that order.

        Where all are so far behind an unknown cause that their probabilities underflow, they stand
        in the order of their evidence.
        """
        found = self.probabilities(fits)
        order = np.lexsort((-self.scores(fits), -found))
        return order, found[order]


def _no_gap(fits: Sequence[Fit]) -> Fit:
    return next(f for f in fits if f.hypothesis.name == NO_GAP)


def _pack(found: Fit) -> dict:
    """A fit without its hypothesis, which holds functions."""
    return {f.name: getattr(found, f.name) for f in fields(found) if f.name != "hypothesis"}


def _unpack(task, packed: dict) -> Fit:
    return Fit(hypothesis=task[0], **packed)

