"""Effects that are several of a kind at once, such as two loose bolts, beside the best of these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.equal import Known
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.leans import Leans
from fenics_joints.diagnosis.evidence.screen import near_best
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.progress import Progress

__all__ = ["Fits", "fit_several"]

#: The best of those with one fewer that more are put beside; how many get fitted; and how far (in
#: ln) one may be behind the best look.
_PARENTS, _MOST, _MARGIN = 4, 6, 8.0


class Fits(Protocol):
    """What fits hypotheses: `fenics_joints.diagnosis.search.Search`."""

    model: Prepared
    progress: Progress
    leans: Leans
    #: Says which effects are together what others are.
    met: Known

    def above(
        self, hypotheses: Sequence[Hypothesis], starts: Sequence, parents: Sequence[Fit]
    ) -> list[Fit]:
        """Fits of hypotheses that hold others, no worse than these but for an effect more."""

    def lowers(self, known: Sequence[Fit] = ()) -> list[np.ndarray]:
        """Factors of the test's covariance that a quick look takes, of some fits'."""

    def looked(
        self,
        hypotheses: Sequence[Hypothesis],
        starts: Sequence[np.ndarray],
        lowers: Sequence[np.ndarray],
    ) -> list[tuple[float, np.ndarray]]:
        """A quick look at each."""

    def fit_all(
        self, hypotheses: Sequence[Hypothesis], starts: Sequence | None = None, again: bool = False,
        places: bool = True,
    ) -> list[Fit]:  # fmt: skip
        """Fits of each."""

    def scores(self, fits: Sequence[Fit]) -> np.ndarray:
        """ln of the evidence times the prior odds of each."""

    def log_prior(self, hypotheses: Sequence[Hypothesis]) -> np.ndarray:
        """ln of each hypothesis' prior odds against none."""

    def narrow(self, effects: Sequence[Effect], share: float) -> None:
        """Let effects be of a share of the places that they were of."""

    def start(self, effects: Sequence[Effect], parent: Fit) -> np.ndarray:
        """A fit's parameters, with a zero for each of the effect that is added."""

    def lowest(self, f: Fit) -> dict[str, float]:
        """The model's parameter values of a fit at the lowest condition."""


def fit_several(search: Fits, singles: Sequence[Fit]) -> list[Fit]:
    """Fits of the effects that hold others (`Effect.holds`), two first, then three. Collective.

    Of n bolts n (n - 1) / 2 pairs may be loose, and each look costs a prediction: only those are
    looked at that hold one of the best of one fewer, and only the best looks are fitted.

    Args:
        search: Fits hypotheses; its model's effects are those that may be fitted.
        singles: Fits of the effects that stand alone.
    """
    level, found = {f.hypothesis.effects[0].key: f for f in singles}, []
    waiting = [e for e in search.model.effects if e.holds]
    while level and waiting:
        parents = _best(level, waiting)
        chosen = [e for e in waiting if e.holds & set(parents)]
        if not chosen:
            break
        fits = _fitted(search, chosen, parents)
        found += fits
        level = {f.hypothesis.effects[0].key: f for f in fits}
        waiting = [e for e in waiting if e not in chosen]
    return found


def _best(level: dict[str, Fit], waiting: Sequence[Effect]) -> dict[str, Fit]:
    held = frozenset().union(*(e.holds for e in waiting))
    order = sorted((f for key, f in level.items() if key in held), key=lambda f: -f.log_evidence)
    return {f.hypothesis.effects[0].key: f for f in order[:_PARENTS]}


def _fitted(search: Fits, effects: Sequence[Effect], parents: dict[str, Fit]) -> list[Fit]:
    model = search.model
    hypotheses = [model.hypothesis((effect,)) for effect in effects]
    # From where the best of its parts ended, whose parameters are its own.
    starts = [next(f.z for key, f in parents.items() if key in e.holds) for e in effects]
    search.progress.step("a quick look at several at once", len(effects))
    lower = model.evidence.lower()
    looks = search.looked(hypotheses, starts, [lower])
    near = near_best(np.array([value for value, _ in looks]), _MARGIN, _MOST)
    search.progress.step("fitting several at once", len(near))
    ways = [[looks[i][1], hypotheses[i].at(0.0)] for i in near]
    return search.fit_all([hypotheses[i] for i in near], ways)
