"""The library of a diagnosis: predictions all over the priors of its effects, and evidence.

What is solved for depends on the model and its effects, not on the data: folds without some of the
data, other scales of errors, and one more effect beside others ask for little more than algebra.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from scipy.stats import norm

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.cells import (
    CellPosterior,
    PriorCells,
    prior_cells,
    sampled_evidence,
    total,
    weigh,
)
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import left_by_stated, whiten
from fenics_joints.diagnosis.evidence.localised_unknown import with_localised_unknown
from fenics_joints.diagnosis.evidence.predictor import HypothesisPredictor, Make
from fenics_joints.diagnosis.evidence.scales import Scales
from fenics_joints.errors import InputError
from fenics_joints.parallel import Result, Task, spread
from fenics_joints.reduction.prediction import ModalPrediction

#: Cells of one hypothesis that are solved for together, and in all at most; nats by which those
#: that are not solved for have to be behind. [numerical: chosen for time]
_AT_A_TIME, _MOST, _BEHIND = 4, 8, 2.0
#: Nats below an unknown cause at which no more cells of a hypothesis are solved for. [numerical:
#: e^-50 is nothing]
_HOPELESS = 50.0
#: Gauss-Newton steps of a cell at most; shares of a step that are tried; the least gain of a step,
#: in nats; the largest distance of a cell's point from its mean, in its own standard deviations.
#: [numerical: chosen]
_STEPS, _SHARES, _GAIN, _FAR = 8, (1.0, 0.4, 0.15), 0.02, 4.0
#: Largest difference in ln Z between one cell and many at which one serves. [numerical: chosen]
_MOVED = 0.1
#: When one cell, linear about its most probable point, serves: the largest error of its cost one
#: posterior standard deviation away; and no other cell, of those whose evidence is within so many
#: nats of it, may be so much more probable about its own point. [numerical: chosen]
_BENT, _UNTOLD, _MORE = 0.3, 3.0, 0.5
#: Cells of a hypothesis that a further effect is combined with, and how far they may be behind the
#: best, in nats. [numerical: chosen for time]
_PARENTS, _PARENTS_WITHIN = 6, 5.0
#: Cells that are screened at a time. [numerical: chosen for memory]
_CHUNK = 512
#: How often a basis is checked where its hypothesis leads, and the error of the squared misfit
#: there that is allowed. [numerical: chosen; 0.25 nats of ln Z]
_LOOKED, _OFF = 3, 0.5
#: Solved points of a hypothesis that are remembered; distance from a cell, in its widths, within
#: which it may start from them. [numerical: chosen for memory]
_REMEMBERED, _SAME_CELL = 64, 2.0


#: Points, (n, p), predictions, (n, N), and their derivatives, (n, N, p).
Solved = tuple[np.ndarray, ...]


def _same(result):
    return result


def _second(_, packed):
    return packed


@dataclass(frozen=True)
class States:
    """What the model predicts at the cells of one effect's prior, all else at its median.

    Attributes:
        mean: Means of the cells, (n, d).
        width: Their standard deviations, (n, d).
        log_share: ln of their shares, (n,).
        data: Predictions, (n, N).
        slopes: Derivatives by the effect's own parameters, (n, N, d).
        others: Derivatives by all parameters of the hypothesis at its medians, (N, p).
    """

    mean: np.ndarray
    width: np.ndarray
    log_share: np.ndarray
    data: np.ndarray
    slopes: np.ndarray
    others: np.ndarray


@dataclass(frozen=True)
class Found:
    """A hypothesis weighed by a test.

    Attributes:
        fit: The fit.
        cells: The cells that were solved for; their shares of the prior include all others'.
        log_evidence: ln of each one's evidence, at the most probable scales, (n,).
        peak: The whole prior as one cell, linear about the most probable point.
    """

    fit: Fit
    cells: PriorCells
    log_evidence: np.ndarray
    peak: PriorCells


class Library(HypothesisPredictor):
    """Predictions all over the priors of effects, and the evidence from them.

    The arguments are those of `HypothesisPredictor`.
    """

    def __init__(self, forward, evidence: Evidence, baseline, make: Make, lean: bool = False):
        super().__init__(forward, evidence, baseline, make, lean)
        #: ln of the evidence of the best of "no gap" and an unknown cause, once these are weighed.
        self.floor = -np.inf
        self._states: dict[str, States] = {}
        self._nothing: tuple[np.ndarray, np.ndarray] | None = None
        #: Points, predictions and derivatives that were solved for, by hypothesis: those that all
        #: ranks know, and those of the task that is at work.
        self._solved: dict[str, Solved] = {}
        self._new: dict[str, Solved] = {}

    # -- states --------------------------------------------------------------------------------

    def states(self, effect: Effect) -> States:
        """Predictions at the cells of an effect's prior, remembered."""
        if effect.key not in self._states:
            h = self.make((effect,))
            mean, width, share = prior_cells(effect.priors)
            z = np.zeros((len(mean), len(h.priors)))
            z[:, h.own] = mean
            data, slopes = self.predict(h, z.clip(*h.limits.T), range(h.own.start, h.own.stop))
            others = self.predict(h, np.zeros((1, len(h.priors))), range(len(h.priors)))[1][0]
            self._states[effect.key] = States(mean, width, share, data, slopes, others)
        return self._states[effect.key]

    def expected(self, effect: Effect, size: float) -> np.ndarray:
        """Predictions with an effect at a size, (N,), linear about the nearest of its cells.

        Args:
            effect: The effect.
            size: Of all its parameters, in standard deviations of their priors.
        """
        states, stepped = self.states(effect), [prior.scan for prior in effect.priors]
        away = size - states.mean
        i = int(np.argmin(np.sum(away**2, axis=1)))
        return states.data[i] + states.slopes[i] @ np.where(stepped, 0.0, away[i])

    def solve(
        self, effects: Sequence[Effect], comm: MPI.Intracomm, advance: Callable[[], None]
    ) -> None:
        """`states` of effects, the same on all ranks. Collective.

        Args:
            effects: The effects, shared out among the ranks.
            comm: Communicator.
            advance: Called once for each of a rank's effects.
        """

        def work(effect: Effect) -> tuple[States, bool]:
            advance()
            return self.states(effect), self._is_smooth(effect)

        for effect, found in zip(effects, spread(comm, effects, work), strict=True):
            self._states[effect.key], self._smooth[effect.key] = found

    def shared(
        self,
        comm: MPI.Intracomm,
        tasks: Sequence[Task],
        work: Callable[[Task], Result],
        pack: Callable[[Result], object] = _same,
        unpack: Callable[[Task, object], Result] = _second,
    ) -> list[Result]:
        """`fenics_joints.parallel.spread` of work with this library, whose results do not depend
        on the rank: each task starts from what all ranks know. Collective.

        Args:
            comm: See there.
            tasks: See there.
            work: See there.
            pack: See there.
            unpack: See there.
        """
        lacking, solved = self._lacking, self._solved

        def one(task: Task):
            self._lacking, self._solved, self._new = dict(lacking), dict(solved), {}
            result = work(task)
            more = {key: z for key, z in self._lacking.items() if z is not lacking.get(key)}
            return result, more, self._new

        found = spread(
            comm,
            tasks,
            one,
            lambda all_: (pack(all_[0]), *all_[1:]),
            lambda task, all_: (unpack(task, all_[0]), *all_[1:]),
        )
        self._lacking, self._solved, self._new = lacking, solved, {}
        for _, more, new in found:
            lacking.update(more)
            for key in more:  # what was solved for on the basis before
                solved.pop(key, None)
            for key, points in new.items():
                solved[key] = _with_points(solved.get(key), points)
        return [result for result, _, _ in found]

    def with_forward(self, forward) -> Library:
        """The same for a better model; states stay, since they only say which cells to solve for.

        Args:
            forward: The better model's.
        """
        found = Library(forward, self.evidence, self.baseline, self.make, self.lean)
        found._states, found._smooth, found.floor = self._states, self._smooth, self.floor
        # Of this model on all ranks, whether they have asked for it by now or not.
        found._changes, found._nothing = self._changes, self.nothing
        return found

    def renewed(self, found: Found, test: Evidence) -> Found:
        """Weigh a hypothesis again by this model, starting from a slightly worse one's result.

        Args:
            found: That result.
            test: The test.
        """
        h, at = found.fit.hypothesis, test.at(found.fit.scales)

        def own(cells: PriorCells) -> PriorCells:
            # The other model's slopes will do: evidence feels their error to second order.
            data = self.predict(h, cells.at)[0]
            self._remember(h, cells.at, data, cells.slopes)
            return self.reconverged(h, replace(cells, data=data), at)

        def weighed() -> Found:
            if found.cells is found.peak:
                peak = own(found.peak)
                return self.summary(h, peak, test, peak)
            # The peak of the other model may be none by this one; it is remembered as a start.
            own(found.peak)
            return self.summary(h, own(found.cells), test)

        return self._held(h, test, weighed)

    def _cells(self, h: Hypothesis, states: States, index) -> PriorCells:
        """Some of an effect's cells, with all other parameters linear about their medians."""
        n, p = len(index), len(h.priors)
        mean, width = np.zeros((n, p)), np.ones((n, p))
        mean[:, h.own], width[:, h.own] = states.mean[index], states.width[index]
        slopes = np.tile(np.nan_to_num(states.others), (n, 1, 1))
        slopes[:, :, h.own] = states.slopes[index]
        at = mean.clip(*h.limits.T)
        return PriorCells(mean, width, states.log_share[index], at, states.data[index], slopes)

    # -- evidence ------------------------------------------------------------------------------

    def single(self, h: Hypothesis, test: Evidence) -> Found:
        """Weigh a hypothesis of one effect, or none.

        Args:
            h: The hypothesis.
            test: The test, or a part of it.
        """
        return self._refined(h, *self._screen(h, test), test, test)

    def promises(self, h: Hypothesis, test: Evidence) -> float:
        """ln of the evidence of a hypothesis of one effect, by algebra alone.

        Args:
            h: The hypothesis.
            test: The test.
        """
        return total(self._screen(h, test)[1])

    def glance(self, h: Hypothesis, test: Evidence) -> Found:
        """Weigh a hypothesis of one effect that is far from the data, by algebra alone.

        Args:
            h: The hypothesis.
            test: The test.
        """
        make, screened = self._screen(h, test)
        best = make(np.array([int(np.argmax(screened))]))
        share = best.log_share + total(screened) - np.max(screened)
        return self.summary(h, replace(best, log_share=share), test, _as_whole(best))

    def _screen(self, h: Hypothesis, test: Evidence):
        """A function that makes some of a hypothesis' cells, and ln of the evidence of each, as
        far as they are linear about their means, (n,)."""
        if not h.effects:
            p = len(h.priors)
            z = np.zeros((1, p))
            data, slopes = self.predict(h, z, range(p))
            cells = PriorCells(z, np.ones((1, p)), np.zeros(1), z.copy(), data, slopes)
            return (lambda index: cells[index]), np.zeros(1)
        states, lower = self.states(h.effects[0]), test.lower(h.unknown)

        def make(index) -> PriorCells:
            return self._cells(h, states, index)

        n = len(states.mean)
        screened = [
            weigh(make(index), test.data, test.fitted, lower, h.limits).log_evidence
            for index in np.array_split(np.arange(n), -(-n // _CHUNK))
        ]
        return make, np.concatenate(screened)

    def beside(self, h: Hypothesis, parent: Found, test: Evidence) -> tuple[PriorCells, np.ndarray]:
        """Cells of a hypothesis' last effect combined with those of its other effects, changes of
        the prediction added, and ln of the evidence of each.

        Args:
            h: The hypothesis.
            parent: The hypothesis without the last effect, weighed.
            test: The test, at the scales by which it is weighed.
        """
        effect, old = h.effects[-1], parent.fit.hypothesis
        states, alone = self.states(effect), self.make((effect,))
        nominal = self.nominal
        share = parent.log_evidence - total(parent.log_evidence)
        top = np.argsort(-share, kind="stable")[:_PARENTS]
        top = top[share[top] > share[top[0]] - _PARENTS_WITHIN]
        n, m, p = len(top), len(states.mean), len(h.priors)
        i, j = np.repeat(top, m), np.tile(np.arange(m), n)
        mean, width, at = np.zeros((n * m, p)), np.ones((n * m, p)), np.zeros((n * m, p))
        slopes = np.zeros((n * m, len(self.evidence.data), p))
        last = h.own_of[effect.key]
        for name, place in _places(alone).items():
            if name in _places(h):
                slopes[:, :, _places(h)[name]] = states.others[:, place]
        for name, place in _places(old).items():
            to = _places(h)[name]
            mean[:, to] = parent.cells.mean[i][:, place]
            width[:, to] = parent.cells.width[i][:, place]
            at[:, to] = parent.cells.at[i][:, place]
            slopes[:, :, to] = parent.cells.slopes[i][:, :, place]
        mean[:, last] = states.mean[j]
        at[:, last] = states.mean[j].clip(*h.limits[last].T)
        width[:, last] = states.width[j]
        slopes[:, :, last] = states.slopes[j]
        data = parent.cells.data[i] + states.data[j] - nominal
        # Cells of the parent that are left out are taken to gain as much as the others.
        log_share = parent.cells.log_share[i] + states.log_share[j] - total(share[top])
        cells = PriorCells(mean, width, log_share, at, data, slopes)
        found = weigh(cells, test.data, test.fitted, test.lower(h.unknown), h.limits)
        return cells, found.log_evidence

    def promised(
        self, parent: Found, effects: Sequence[Effect], test: Evidence
    ) -> dict[str, float]:
        """ln of the evidence of a parent with each of some effects besides, by its key.

        Changes of the prediction are added, and all of the parent's parameters are linear about its
        best cell: algebra alone, which chooses the few sets of effects that are solved for.

        Args:
            parent: A hypothesis, weighed.
            effects: The effects.
            test: The test.
        """
        best = int(np.argmax(parent.log_evidence))
        cell, used = parent.cells[[best]], test.fitted
        lower = test.at(parent.fit.scales).lower()
        slopes = cell.slopes[0][used] * cell.width[0]
        about = cell.data[0] + cell.slopes[0] @ (cell.mean[0] - cell.at[0])
        wide = np.linalg.cholesky(lower @ lower.T + slopes @ slopes.T)
        spread = total(parent.log_evidence) - parent.log_evidence[best] + cell.log_share[0]
        found = {}
        for effect in effects:
            states = self.states(effect)
            data = about + states.data - self.nominal
            zero = np.zeros_like(states.mean)
            limits = np.array([prior.limits() for prior in effect.priors]).reshape(-1, 2)
            at = states.mean.clip(*limits.T) - states.mean
            alone = PriorCells(zero, states.width, states.log_share, at, data, states.slopes)
            free = np.tile([-np.inf, np.inf], (states.mean.shape[1], 1))
            values = weigh(alone, test.data, used, wide, free).log_evidence
            found[effect.key] = total(values) + spread + parent.fit.widening
        return found

    @property
    def nominal(self) -> np.ndarray:
        """What the nominal model predicts, (N,)."""
        return self.nothing[0]

    @property
    def nothing(self) -> tuple[np.ndarray, np.ndarray]:
        """What the nominal model predicts, (N,), and its derivatives by the parameters that are
        uncertain in any case, (N, p)."""
        if self._nothing is None:
            h = self.make(())
            p = len(h.priors)
            data, slopes = self.predict(h, np.zeros((1, p)), range(p))
            self._nothing = data[0], slopes[0]
        return self._nothing

    def add_effect(self, h: Hypothesis, parent: Found, test: Evidence) -> Found:
        """Weigh a hypothesis of several effects.

        Args:
            h: The hypothesis.
            parent: The same without the last effect, weighed.
            test: The test, or a part of it.
        """
        scales = None
        while True:
            at = test.at(parent.fit.scales if scales is None else scales)
            cells, screened = self.beside(h, parent, at)
            found = self._refined(h, cells.__getitem__, screened, test, at)
            # With both effects the data may ask for much smaller errors.
            if scales is not None or not test.drifts or found.fit.scales == at.scales:
                return found
            scales = found.fit.scales

    def of(self, h: Hypothesis, test: Evidence, known: dict[str, Found] | None = None) -> Found:
        """Weigh a hypothesis by a part of a test, without any use of the rest.

        Args:
            h: The hypothesis.
            test: The part.
            known: Others that were weighed by it, by their keys; grows.
        """
        known = {} if known is None else known
        key = h.label_of_keys
        if key not in known and len(h.effects) < 2:
            known[key] = self.single(h, test)
        elif key not in known:
            parent = self.of(self.make(h.effects[:-1]), test, known)
            known[key] = self.add_effect(h, parent, test)
        return known[key]

    def _held(self, h: Hypothesis, test: Evidence, weighed: Callable[[], Found]) -> Found:
        """A hypothesis weighed on a basis that holds for its most probable point: the basis takes
        in modes that it lacks there, and the hypothesis is weighed again."""
        for left in reversed(range(_LOOKED)):
            found = weighed()
            hopeless = found.fit.log_evidence < self.floor - _HOPELESS
            if not left or not self.lean or hopeless:
                break
            right = replace(found.peak, data=self.on_whole_model(h, found.peak.at))
            lower = test.at(found.fit.scales).lower(h.unknown)
            off = _costs(right, test, lower) - _costs(found.peak, test, lower)
            if not np.abs(off[0]) > _OFF:  # nan: neither has such modes
                break
            self.enrich(h, found.peak.at)
            for points in (self._solved, self._new):
                points.pop(h.label_of_keys, None)
        return found

    def _refined(
        self, h: Hypothesis, make, screened: np.ndarray, test: Evidence, at: Evidence
    ) -> Found:
        return self._held(h, test, lambda: self._on_basis(h, make, screened, test, at))

    def _on_basis(
        self, h: Hypothesis, make, screened: np.ndarray, test: Evidence, at: Evidence
    ) -> Found:
        screened = screened.copy()
        order = np.argsort(-screened, kind="stable")
        order = order[np.isfinite(screened[order])]
        if not len(order):
            order = np.arange(1)
        whole = self._whole(h, make(order[:1]), at)
        if not self._is_bent(h, whole, at):
            # Is there a cell that the model linear about this point misses?
            alone = weigh(whole, test.data, test.fitted, at.lower(h.unknown), h.limits)
            near = order[screened[order] > alone.log_evidence[0] - _UNTOLD]
            if not np.any(self._about(h, make(near), whole, at)[2] > _MORE):
                return self.summary(h, whole, test, whole)
        done, cells, best = 0, None, None

        def about(index: np.ndarray) -> tuple[PriorCells, np.ndarray]:
            own = make(index)
            return (own, screened[index]) if best is None else self._about(h, own, best, at)[:2]

        while True:
            index = order[done : done + _AT_A_TIME]
            own = self.reconverged(h, about(index)[0], at)
            cells = own if cells is None else cells.joined(own)
            exact = self._weighed(h, cells, test)[0]
            leads = int(np.argmax(exact)) >= done
            done += len(index)
            if leads and done < len(order):
                best, left = cells[[int(np.argmax(exact))]], order[done:]
                for chunk in np.array_split(order, -(-len(order) // _CHUNK)):
                    screened[chunk] = about(chunk)[1]
                order[done:] = left[np.argsort(-screened[left], kind="stable")]
            rest = screened[order[done:]]
            hopeless = exact.max() < self.floor - _HOPELESS
            if not len(rest) or done >= _MOST or hopeless or rest[0] < exact.max() - _BEHIND:
                break
        if len(rest):
            # The others count by the screen, whose error is taken to be that of the last ones that
            # were solved for.
            last = np.arange(max(done - 2 * _AT_A_TIME, 0), done)
            off = total(exact[last]) - total(screened[order[last]])
            rest = np.minimum(rest + off, exact.max())
            more = np.logaddexp(0.0, total(rest) - total(exact))
            cells = replace(cells, log_share=cells.log_share + more)
        return self.summary(h, cells, test)

    def _is_bent(self, h: Hypothesis, whole: PriorCells, test: Evidence) -> bool:
        """Whether the model deviates from linear one posterior standard deviation away along any of
        the effects' parameters."""
        own, lower = np.arange(h.own.start, h.own.stop), test.lower(h.unknown)
        if not len(own):
            return False
        post = weigh(whole, test.data, test.fitted, lower, h.limits)
        columns = post.covariance[0][own]
        step = columns / np.sqrt(columns[np.arange(len(own)), own])[:, None]
        at = np.concatenate([post.z + step, post.z - step]).clip(*h.limits.T)
        both = whole[np.zeros(len(at), dtype=int)]
        linear = both.data + ((at - both.at)[:, None] @ both.slopes.transpose(0, 2, 1))[:, 0]
        costs = [
            _costs(replace(both, at=at, data=data), test, lower)
            for data in (linear, self.predict(h, at)[0])
        ]
        with np.errstate(invalid="ignore"):
            return not np.all(np.abs(costs[1] - costs[0]) < _BENT)

    def _about(
        self, h: Hypothesis, cells: PriorCells, best: PriorCells, test: Evidence
    ) -> tuple[PriorCells, np.ndarray, np.ndarray]:
        """Cells, ln of the evidence of each, and how much larger it is if they are linear about
        their own points and not about the best one's.

        Those that are more probable about the best one's point are linear about that, since a model
        that is bent within a cell may mislead it. Not so where a parameter that acts in steps has
        another value there.
        """
        n = len(cells)
        there = {f: np.repeat(getattr(best, f), n, axis=0) for f in ("at", "data", "slopes")}
        both = cells.joined(replace(cells, **there))
        found = weigh(both, test.data, test.fitted, test.lower(h.unknown), h.limits)
        stepped = [j for j, (_, prior) in enumerate(h.priors) if prior.scan]
        same = np.all(cells.mean[:, stepped] == best.mean[:, stepped], axis=1)
        own, there = np.split(found.log_evidence, 2)
        there = np.where(same, there, -np.inf)
        index = np.arange(n) + n * (there > own)
        return both[index], found.log_evidence[index], own - there

    def reconverged(self, h: Hypothesis, cells: PriorCells, test: Evidence) -> PriorCells:
        """Cells linear about their own posterior means, by Gauss-Newton steps.

        Each starts from a point at which the hypothesis was solved before, if that is better than
        its own, so that other data or a finer cell ask for few solutions.

        Args:
            h: The hypothesis.
            cells: The cells.
            test: The test.
        """
        lower, own = test.lower(h.unknown), h.own
        low, high = h.limits.T
        arrays = {name: getattr(cells, name).copy() for name in ("at", "data", "slopes")}
        cells = replace(cells, **arrays)
        exact = np.zeros(len(cells), dtype=bool)
        now = self._recalled(h, cells, test, lower, exact)
        active = np.ones(len(cells), dtype=bool)
        for _ in range(_STEPS):
            i = np.flatnonzero(active)
            if not len(i):
                break
            part = cells[i]
            post = weigh(part, test.data, test.fitted, lower, h.limits)
            small = (now[i] - post.square < 2 * _GAIN) & exact[i]
            active[i[small]] = False
            i, part, target = i[~small], part[~small], post.z[~small]
            if not len(i):
                break
            far = _FAR * part.width[:, own]
            away = np.clip(target[:, own] - part.mean[:, own], -far, far)
            target[:, own] = part.mean[:, own] + away
            step = np.clip(target, low + 1e-6, high - 1e-6) - part.at
            better, new = np.zeros(len(i), dtype=bool), ~exact[i]
            # At last its own point, unless the model was solved there.
            for share in (*_SHARES, 0.0):
                k = np.flatnonzero(~better if share else ~better & new)
                if not len(k):
                    continue
                at = part.at[k] + share * step[k]
                data, slopes = self.predict(h, at, range(at.shape[1]))
                self._remember(h, at, data, slopes)
                costs = _costs(replace(part[k], at=at, data=data), test, lower)
                good = costs < now[i[k]] - 1e-9 if share else np.ones(len(k), dtype=bool)
                better[k[good]], j = share > 0, i[k[good]]
                now[j] = costs[good]
                for name, value in (("at", at), ("data", data), ("slopes", slopes)):
                    arrays[name][j] = value[good]
            exact[i], active[i[~better & ~new]] = True, False
        return cells

    def _remember(self, h: Hypothesis, at, data, slopes) -> None:
        key, good = h.label_of_keys, np.isfinite(data).all(1)
        self._new[key] = _with_points(self._new.get(key), (at[good], data[good], slopes[good]))

    def _recalled(self, h, cells: PriorCells, test: Evidence, lower, exact) -> np.ndarray:
        """Costs of cells, (n,), after each took the best of the remembered points if it gains."""
        now = _costs(cells, test, lower)
        known = [points.get(h.label_of_keys) for points in (self._solved, self._new)]
        known = [points for points in known if points is not None]
        if not known:
            return now
        at, data, slopes = map(np.concatenate, zip(*known, strict=True))
        white = whiten(lower, (data - test.data)[:, test.fitted].T)
        width = np.where(cells.width > 0, cells.width, 1.0)
        away = (at - cells.mean[:, None]) / width[:, None]
        costs = np.sum(white**2, axis=0) + np.sum(away**2, axis=2)
        # Otherwise all cells would end where the first one did.
        costs[np.max(np.abs(away[:, :, h.own]), axis=2, initial=0.0) > _SAME_CELL] = np.inf
        best = np.argmin(costs, axis=1)
        least = costs[np.arange(len(cells)), best]
        i = np.flatnonzero((least <= now) & np.isfinite(least))
        cells.at[i], cells.data[i], cells.slopes[i] = at[best[i]], data[best[i]], slopes[best[i]]
        exact[i] = True
        return np.minimum(least, now)

    def _weighed(
        self, h: Hypothesis, cells: PriorCells, test: Evidence
    ) -> tuple[np.ndarray, float, Scales | None, CellPosterior]:
        """ln of each cell's evidence over all scales, (n,), that of all cells, the most probable
        scales, and the cells' posterior at these."""

        def at(scales) -> CellPosterior:
            lower = test.at(scales).lower(h.unknown)
            return weigh(cells, test.data, test.fitted, lower, h.limits)

        if test.scales is None:
            post = at(None)
            return post.log_evidence, total(post.log_evidence), None, post
        tried = test.scales.tried()
        posts = {scales: at(scales) for scales, _ in tried}
        each = np.array([posts[scales].log_evidence + weight for scales, weight in tried])
        sums = [total(row) for row in each]
        best = tried[int(np.argmax(sums))][0]
        return np.logaddexp.reduce(each, axis=0), total(np.array(sums)), best, posts[best]

    def _whole(self, h: Hypothesis, cell: PriorCells, test: Evidence) -> PriorCells:
        """The whole prior as one cell, linear about its most probable point."""
        return self.reconverged(h, _as_whole(cell), test)

    def summary(
        self, h: Hypothesis, cells: PriorCells, test: Evidence, peak: PriorCells | None = None
    ) -> Found:
        """A hypothesis' fit from its cells.

        Args:
            h: The hypothesis.
            cells: Cells that count.
            test: The test.
            peak: The most probable point; sought for None.
        """
        _, log_z, scales, post = self._weighed(h, cells, test)
        if not np.isfinite(log_z):
            raise InputError(f"{h.label}: the evidence is not finite; check the data.")
        used = test.fitted
        lower = test.at(scales).lower(h.unknown)
        if peak is None:
            cost = _costs(_as_whole(cells), test.at(scales), lower)
            peak = self._whole(h, cells[[int(np.argmin(cost))]], test.at(scales))
        # If the model is linear, the whole prior as one cell is exact, a sum of cells only nearly.
        whole = self._weighed(h, peak, test)[1]
        straight = abs(whole - log_z) < _MOVED
        log_z = whole if straight else log_z
        z, predicted, slopes = peak.at[0], peak.data[0], peak.slopes[0]
        if straight:
            post = weigh(peak, test.data, used, lower, h.limits)
        weight = np.exp(post.log_evidence - total(post.log_evidence))
        away = post.z - weight @ post.z
        covariance = np.einsum("n,npq->pq", weight, post.covariance)
        covariance += np.einsum("n,np,nq->pq", weight, away, away)
        residual = whiten(lower, (predicted - test.data)[used])
        found = Fit(
            h,
            z,
            covariance,
            predicted,
            self.evidence.shape,
            slopes,
            log_z,
            float(residual @ residual),
            int(used.sum()),
            scales,
            log_z - total(post.log_evidence),
        )
        found = replace(found, stated=left_by_stated(found, test))
        if h.unknown:
            found = with_localised_unknown(found, test)
        if straight:
            return Found(found, peak, post.log_evidence, peak)
        return Found(found, cells, post.log_evidence, peak)

    def sampled(self, found: Found, test: Evidence) -> Found:
        """The same with its evidence by importance sampling of the effects' own parameters from the
        posteriors of its cells; all others are integrated in closed form at each draw.

        Args:
            found: The hypothesis, weighed.
            test: The test.
        """
        h, fit, used = found.fit.hypothesis, found.fit, test.fitted
        own, (low, high) = np.arange(h.own.start, h.own.stop), h.limits.T
        stepped = any(prior.scan for _, prior in h.priors)  # cells that are left out are far away
        alone = found.cells is found.peak
        if stepped or (alone and not self._is_bent(h, found.peak, test.at(fit.scales))):
            return found
        lower = test.at(fit.scales).lower(h.unknown)
        post = weigh(found.cells, test.data, used, lower, h.limits)
        inner = post.covariance[:, own[:, None], own]
        # Conditional means of the others, given these.
        follow = np.linalg.solve(inner, post.covariance[:, own]).transpose(0, 2, 1)
        width = np.ones(len(low))
        width[own] = 0.0
        others = np.flatnonzero(width)

        def log_density(drawn: np.ndarray, which: np.ndarray) -> np.ndarray:
            log_p = np.full(len(drawn), -np.inf)
            away = drawn - post.z[which][:, own]
            z = post.z[which] + np.einsum("npd,nd->np", follow[which], away)
            inside = np.all((drawn > low[own]) & (drawn < high[own]), axis=1)
            at = z[inside].clip(*h.limits.T)
            data, by_others = self.predict(h, at, others)
            slopes = np.zeros((*data.shape, len(low)))
            slopes[:, :, others] = by_others
            mean = np.where(width > 0, 0.0, at)
            cells = PriorCells(
                mean, np.tile(width, (len(at), 1)), np.zeros(len(at)), at, data, slopes
            )
            log_p[inside] = weigh(cells, test.data, used, lower, h.limits).log_evidence
            return log_p + np.sum(norm.logpdf(drawn), axis=1)

        before = total(post.log_evidence)
        if not np.isfinite(before):
            return found
        share = np.exp(post.log_evidence - before)
        value = sampled_evidence(post.z[:, own], inner, share, log_density)
        if value is None:
            return found
        more = value - before
        fit = replace(fit, log_evidence=fit.log_evidence + more, widening=fit.widening + more)
        return replace(found, fit=fit)


def _with_points(known: Solved | None, more: Solved) -> Solved:
    """Points that are known and more of them, the last `_REMEMBERED`."""
    pairs = [more] if known is None else [known, more]
    return tuple(np.concatenate(parts)[-_REMEMBERED:] for parts in zip(*pairs, strict=True))


def _as_whole(cells: PriorCells) -> PriorCells:
    """The whole prior instead of each cell, linear about the same point."""
    mean, width = np.zeros_like(cells.mean), np.ones_like(cells.width)
    return replace(cells, mean=mean, width=width, log_share=np.zeros(len(cells)))


def _costs(cells: PriorCells, test: Evidence, lower: np.ndarray) -> np.ndarray:
    """Squared whitened residuals and distances from the cells' means at their points, (n,)."""
    used, found = test.fitted, np.full(len(cells), np.inf)
    residual = (cells.data - test.data)[:, used]
    good = np.isfinite(residual).all(1)
    if good.any():
        white = whiten(lower, residual[good].T)
        away = (cells.at - cells.mean) / np.where(cells.width > 0, cells.width, 1.0)
        found[good] = np.sum(white**2, axis=0) + np.sum(away[good] ** 2, axis=1)
    return found


def fit(
    hypothesis: Hypothesis, forward: ModalPrediction, evidence: Evidence, baseline: dict[str, float]
) -> Fit:
    """Most probable parameters of a hypothesis, and its evidence.

    Args:
        hypothesis: The hypothesis.
        forward: Predicts frequencies: of a reduced model, or a `PointwiseForward` of your own.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """

    def make(effects: Sequence[Effect]) -> Hypothesis:
        return replace(hypothesis, effects=tuple(effects), name="", unknown=False)

    library = Library(forward, evidence, baseline, make)
    return library.sampled(library.of(hypothesis, evidence), evidence).fit


def _places(h: Hypothesis) -> dict[str, slice]:
    """Where groups of parameters stand in z, by name: tolerances, each effect, shared ones."""
    found = {"tolerances": slice(0, h.own.start), **h.own_of}
    return found | {name: place for name, place in h.places.items() if place.stop > place.start}
