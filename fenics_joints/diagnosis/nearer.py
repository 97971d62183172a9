"""A look from nearer at where something is, where that may be what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.effects.sited import LOCAL_LOSS, sited_effects
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.problem import Problem
from fenics_joints.diagnosis.several import Fits
from fenics_joints.diagnosis.zones.sites import (
    ON,
    Sites,
    attached_about,
    cells_of,
    lost_about,
)
from fenics_joints.structure.changes import Change, LocalLoss, PlacedPoint, PlacedResonator

__all__ = ["nearer"]

#: How far (in ln) behind the best an effect at a place may be to be looked at from nearer, or which
#: share of what it gains over nothing; and how much that has to be.
_MARGIN, _SHARE, _WORTH = 8.0, 0.25, 5.0
#: Squared misfit per datum below which the test is explained so much better than its errors ask
#: for that the place refutes nothing.
_EXPLAINED = 0.3
#: Places all over the structure from which fits start anew.
_TRIED = 12
#: Further looks at most, and how many in a row may gain less than this, in ln: a place between two
#: others may be better than any of those that are about them.
_LOOKS, _IN_VAIN, _GAIN = 8, 3, 1.0
#: Share of the way to the next place from which that counts too.
_BETWEEN = 0.25
_SCORE = attrgetter("score")


@dataclass(frozen=True)
class _Kind:
    """Effects that share their places.

    Attributes:
        holds: Whether an effect is one.
        changes: What they change of the structure.
        about: Places about some: `attached_about`.
        start: Places all over the structure that are looked at from nearer.
    """

    holds: Callable[[Effect], bool]
    changes: tuple[type, ...]
    about: Callable
    start: int

    def of(self, found: Fit) -> Effect | None:
        """The effect of a fit that is one."""
        return next((e for e in found.hypothesis.effects if self.holds(e)), None)


_KINDS = (
    _Kind(lambda e: e.family == ON, (PlacedPoint, PlacedResonator), attached_about, 5),
    _Kind(lambda e: e.name == LOCAL_LOSS, (LocalLoss,), lost_about, 2),
)


def nearer(search: Fits, fits: list[Fit]) -> list[Fit]:
    """Fit what may be attached at a point, or what may have lost stiffness in a patch, again, at
    places all about where it was found, and about where it is then, if that is among the best.
    Collective.

    All over a structure such places are far apart, and one between them explains a good test badly:
    what is right then seems to be refuted.

    Args:
        search: Fits hypotheses.
        fits: Of nothing, the unknown, and each effect alone.
    """
    for kind in _KINDS:
        found = {f.hypothesis.label_of_keys: f for f in _nearer(search, fits, kind)}
        fits = [found.get(f.hypothesis.label_of_keys, f) for f in fits]
    return fits


def _nearer(search: Fits, fits: list[Fit], kind: _Kind) -> tuple[Fit, ...]:
    own = tuple(f for f in fits if kind.of(f) is not None)
    if not own:
        return ()
    scores = search.scores(own)
    none, *known = search.scores([f for f in fits if not f.hypothesis.unknown])
    leader, top = own[int(np.argmax(scores))], scores.max()
    margin = max(_MARGIN, _SHARE * (top - none))
    if top < max(none + _WORTH, max(known) - margin):
        return ()
    if leader.misfit < _EXPLAINED * leader.n_data:
        return ()
    search.progress.step(f"looking from nearer at where {kind.of(leader).name} is")
    near = {kind.of(f).key for f, s in zip(own, scores, strict=True) if s > top - _MARGIN}
    model = search.model
    changes = [c for c in model.full.changes if isinstance(c, kind.changes)]
    return _Looks(search, kind, near).best(_Look(model.sites, changes, own, float(top))).fits


@dataclass(frozen=True)
class _Look:
    """Fits of effects at some places.

    Attributes:
        sites: The places.
        changes: What may change of the structure there.
        fits: Of some effects.
        score: ln of the best one's evidence times its odds.
        share: Of the first places that these stand for.
    """

    sites: Sites
    changes: list[Change]
    fits: tuple[Fit, ...]
    score: float
    share: float = 1.0


class _Looks:
    """Looks at effects of a kind.

    Args:
        search: Fits hypotheses.
        kind: The kind.
        near: Keys of the effects that count.
    """

    def __init__(self, search: Fits, kind: _Kind, near: Collection[str]):
        self.search, self.kind, self.near = search, kind, near
        self.cells = cells_of(search.model.case, search.model.full)
        self.now: _Look | None = None

    def best(self, first: _Look) -> _Look:
        """The best of some looks, with fits of all effects at its places.

        Args:
            first: Places all over the structure.
        """
        self.now = first
        looks = [self._about(first, own) for own in self._cells(first)]
        waiting = [look for look in looks if look is not None]
        best, vain = max([first, *waiting], key=_SCORE), 0
        for _ in range(_LOOKS):
            if not waiting or vain == _IN_VAIN:
                break
            # What is about the best place is looked at first, but another may get better yet.
            before = waiting.pop(int(np.argmax([look.score for look in waiting])))
            look = self._about(before, self._places(self._leader(before)))
            vain += 1
            if look is not None:
                waiting.append(look)
                vain = 0 if look.score > best.score + _GAIN else vain
                best = max(best, look, key=_SCORE)
        return self._restored(best)

    def _leader(self, look: _Look) -> Fit:
        return max(look.fits, key=lambda f: self.search.scores([f])[0])

    def _cells(self, first: _Look) -> list[list[int]]:
        """Places that are worth it to look from nearer, the best first: where the fits end from the
        best point at each."""
        search, model = self.search, self.search.model
        found = [f for f in first.fits if self.kind.of(f).key in self.near]
        for h in [f.hypothesis for f in found]:
            forward, guide = search.leans.for_fit(h)
            problem = Problem(
                h, guide or forward, model.evidence, model.baseline, model.evidence.lower(),
                scanned=search.leans.scanned, role="guide" if guide else "whole",
            )  # fmt: skip
            scanned = [j for j, (_, p) in enumerate(h.priors) if p.scan]
            place = next(j for j in scanned if h.priors[j][1].even)
            starts = [[z] for z in problem.at_each(scanned, place)[:_TRIED]]
            found += search.fit_all([h] * len(starts), starts, again=True, places=False)
        cells: list[list[int]] = []
        for i in np.argsort(-search.scores(found), kind="stable"):
            own = self._places(found[i])
            if not set(own) & {i for cell in cells for i in cell}:
                cells.append(own)
        return cells[: self.kind.start]

    def _places(self, found: Fit) -> list[int]:
        """The place of a fit, or the two that it is between."""
        effect = self.kind.of(found)
        at = next(
            prior.value(z) for (of, prior), z in zip(found.hypothesis.priors, found.z, strict=True)
            if of is effect and prior.name == "place"
        )  # fmt: skip
        low = int(np.clip(np.floor(at), 0, len(effect.places) - 1))
        beyond = at - low
        two = (low, beyond < 1 - _BETWEEN), (low + 1, beyond > _BETWEEN)
        return [i for i, near in two if near]

    def _about(self, before: _Look, own: list[int]) -> _Look | None:
        """Fits of the effects that count at places about some of those of an earlier look; None
        where there are no others."""
        search, model = self.search, self.search.model
        found = self.kind.about(self.cells, before.sites, before.changes, own)
        if found is None:
            return None
        sites, changes, share = found
        self._put(_Look(sites, self._all(before, changes), (), 0.0, before.share * share))
        effects = [e for e in model.effects if e.key in self.near]
        fits = search.fit_all([model.hypothesis((e,)) for e in effects], again=True)
        self.now = replace(self.now, fits=tuple(fits), score=float(search.scores(fits).max()))
        return self.now

    @staticmethod
    def _all(before: _Look, changes: list[Change]) -> list[Change]:
        new = {c.name: c for c in changes}
        return [new.get(c.name, c) for c in before.changes]

    def _put(self, look: _Look) -> None:
        """Let the model have the places of a look. Collective."""
        model, kind = self.search.model, self.kind
        was = {c.name: c for c in self.now.changes}
        model.surrogate.exchange([c for c in look.changes if c is not was[c.name]])
        model.sites = look.sites
        mass = model.full.total_mass(model.baseline)
        made, _ = sited_effects(model.case, model.data.as_it_is, model.sites, mass)
        there = {e.key: e for e in made if kind.holds(e)}
        model.effects = tuple(
            replace(e, priors=new.priors, apply=new.apply, places=new.places)
            if (new := there.get(e.key)) else e for e in model.effects
        )  # fmt: skip
        effects = [e for e in model.effects if e.key in there]
        self.search.narrow(effects, look.share / self.now.share)
        self.now = look

    def _restored(self, best: _Look) -> _Look:
        """The best look with its places put back, and fits of the other effects there."""
        if best is not self.now:
            self._put(best)
        search, model = self.search, self.search.model
        known = {f.hypothesis.label_of_keys: f.z for f in best.fits}
        alone = [model.hypothesis((e,)) for e in model.effects if self.kind.holds(e)]
        some = [h for h in alone if h.label_of_keys in known]
        rest = [h for h in alone if h.label_of_keys not in known]
        starts = [[known[h.label_of_keys]] for h in some]
        fits = search.fit_all(some, starts, again=True, places=False)
        return replace(best, fits=(*fits, *search.fit_all(rest, again=True)))
