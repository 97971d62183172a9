"""A look from nearer at where something is attached, where that may be what is wrong."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.effects.sited import sited_effects
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.problem import Problem
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.several import Fits
from fenics_joints.diagnosis.zones.sites import HUNG, ON, points_about

__all__ = ["nearer"]

#: How far (in ln) behind the best one that is attached may be to be looked at from nearer, and how
#: much better than nothing it has to be.
_MARGIN, _WORTH = 8.0, 5.0
#: Squared misfit per datum below which the test is explained better than its errors ask for, so
#: that the place refutes nothing.
_EXPLAINED = 0.5
#: Places all over the structure that are looked at from nearer.
_FROM = 5
#: Further looks at most, and how many in a row may gain less than this, in ln: a place between two
#: points may be better than any of those that are about them.
_LOOKS, _IN_VAIN, _GAIN = 8, 3, 1.0
#: Share of the way to the next place from which that counts too.
_BETWEEN = 0.25
_SCORE = attrgetter("score")


def nearer(search: Fits, fits: list[Fit]) -> list[Fit]:
    """Fit what may be attached at a point again, at points all about where it was found, and about
    where it is then, if that is among the best. Collective.

    All over a structure such points are far apart, and one between them explains a good test badly:
    what is right then seems to be refuted.

    Args:
        search: Fits hypotheses.
        fits: Of nothing, the unknown, and each effect alone.
    """
    put_on = [f for f in fits if _of(f) is not None]
    if not put_on:
        return fits
    scores = search.scores(put_on)
    none, *known = search.scores([f for f in fits if not f.hypothesis.unknown])
    leader = put_on[int(np.argmax(scores))]
    rivals = max(none + _WORTH, max(known) - _MARGIN)
    if scores.max() < rivals or leader.misfit < _EXPLAINED * leader.n_data:
        return fits
    search.progress.step("looking from nearer at where something is attached")
    near = {_of(f).key for f, s in zip(put_on, scores, strict=True) if s > scores.max() - _MARGIN}
    look = _best_look(search, _Look(search.model.sites.points, tuple(put_on), scores.max()), near)
    found = {f.hypothesis.label_of_keys: f for f in look.fits}
    return [found.get(f.hypothesis.label_of_keys, f) for f in fits]


@dataclass(frozen=True)
class _Look:
    """Fits of what may be attached.

    Attributes:
        points: Where, m, (P, 3).
        fits: Of some effects.
        score: ln of the best one's evidence times its odds.
        share: Of the structure that the points are of.
    """

    points: np.ndarray
    fits: tuple[Fit, ...]
    score: float
    share: float = 1.0


def _best_look(search: Fits, first: _Look, near: Collection[str]) -> _Look:
    """The best of some looks, with fits of all effects at its points.

    Args:
        search: Fits hypotheses.
        first: Points all over the structure.
        near: Keys of the effects that count.
    """
    now, waiting = first, []
    for own in _cells(search, first, near):
        found = _look(search, now, first, own, near)
        if found is not None:
            now = found
            waiting.append(found)
    best, vain = max([first, *waiting], key=_SCORE), 0
    for _ in range(_LOOKS):
        if not waiting or vain == _IN_VAIN:
            break
        # What is about the best place is looked at first, but another may get better yet.
        before = waiting.pop(int(np.argmax([look.score for look in waiting])))
        own = _places(max(before.fits, key=lambda f: search.scores([f])[0]))
        found = _look(search, now, before, own, near)
        vain += 1
        if found is not None:
            now = found
            waiting.append(found)
            vain = 0 if found.score > best.score + _GAIN else vain
            best = max(best, found, key=_SCORE)
    return _restored(search, now, best)


def _cells(search: Fits, first: _Look, near: Collection[str]) -> list[list[int]]:
    """Places that are worth it to look from nearer, the best first: where the fits end from the
    best point at each."""
    model, found = search.model, [f for f in first.fits if _of(f).key in near]
    for h in [f.hypothesis for f in found]:
        forward, guide = search.leans.for_fit(h)
        evidence = model.evidence
        problem = Problem(h, guide or forward, evidence, model.baseline, evidence.lower())
        scanned = [j for j, (_, p) in enumerate(h.priors) if p.scan]
        starts = problem.at_each(scanned, next(j for j in scanned if h.priors[j][1].even))
        found += search.fit_all([h] * len(starts), [[z] for z in starts], again=True, places=False)
    cells: list[list[int]] = []
    for i in np.argsort(-search.scores(found), kind="stable"):
        own = _places(found[i])
        if not set(own) & {i for cell in cells for i in cell}:
            cells.append(own)
    return cells[:_FROM]


def _restored(search: Fits, now: _Look, best: _Look) -> _Look:
    """The best look with its points put back, and fits of the other effects there."""
    effects = _put(search, now, best.points, best.share)
    known = {f.hypothesis.label_of_keys: f.z for f in best.fits}
    alone = [search.model.hypothesis((e,)) for e in effects]
    some = [h for h in alone if h.label_of_keys in known]
    rest = [h for h in alone if h.label_of_keys not in known]
    fits = search.fit_all(
        some, [[known[h.label_of_keys]] for h in some], again=True, places=False
    )
    return replace(best, fits=(*fits, *search.fit_all(rest, again=True)))


def _look(
    search: Fits, now: _Look, before: _Look, own: list[int], near: Collection[str]
) -> _Look | None:
    """Fits of some effects at points about some of those of an earlier look; None where no others
    are.

    Args:
        search: Fits hypotheses.
        now: Where the points are.
        before: The earlier look.
        own: Which of its points.
        near: Keys of the effects.
    """
    model = search.model
    points = points_about(model.case, model.full, before.points, own)
    if len(points) <= len(own):
        return None
    share = before.share * len(own) / len(before.points)
    effects = [e for e in _put(search, now, points, share) if e.key in near]
    fits = search.fit_all([model.hypothesis((e,)) for e in effects], again=True)
    return _Look(points, tuple(fits), float(search.scores(fits).max()), share)


def _put(search: Fits, before: _Look, points: np.ndarray, share: float) -> list[Effect]:
    """Put the points where something may be attached elsewhere; the effects of that. Collective."""
    effects = _moved(search.model, points)
    search.narrow(effects, share / before.share)
    return effects


def _moved(model: Prepared, points: np.ndarray) -> list[Effect]:
    places = {f"{what} {i}": x for what in (ON, HUNG) for i, x in enumerate(points.tolist())}
    model.surrogate.move_points(places)
    model.sites = replace(model.sites, points=points)
    mass = model.full.total_mass(model.baseline)
    made, _ = sited_effects(model.case, model.data.as_it_is, model.sites, mass)
    there = {e.key: e for e in made if e.family == ON}
    model.effects = tuple(
        replace(e, priors=new.priors, apply=new.apply, places=new.places)
        if (new := there.get(e.key)) else e for e in model.effects
    )  # fmt: skip
    return [e for e in model.effects if e.key in there]


def _of(found: Fit) -> Effect | None:
    """What is attached at a point, in a fit."""
    return next((e for e in found.hypothesis.effects if e.family == ON), None)


def _places(found: Fit) -> list[int]:
    """The place of a fit, or the two that it is between."""
    effect = _of(found)
    at = next(
        prior.value(z) for (of, prior), z in zip(found.hypothesis.priors, found.z, strict=True)
        if of is effect and prior.name == "place"
    )  # fmt: skip
    low = int(np.clip(np.floor(at), 0, len(effect.places) - 1))
    beyond = at - low
    return [i for i, near in ((low, beyond < 1 - _BETWEEN), (low + 1, beyond > _BETWEEN)) if near]
