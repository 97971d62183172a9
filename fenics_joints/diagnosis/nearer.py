"""A look from nearer at where something is attached, where that may be what is wrong."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.effects.sited import sited_effects
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.several import Fits
from fenics_joints.diagnosis.zones.sites import HUNG, ON, points_about

__all__ = ["nearer"]

#: How far (in ln) behind the best one that is attached may be to be looked at from nearer, and how
#: much better than nothing it has to be.
_MARGIN, _WORTH = 8.0, 5.0
#: Looks at most, and how many in a row may gain less than this, in ln: a place between two points
#: may be better than any of those that are about them.
_LOOKS, _IN_VAIN, _GAIN = 6, 2, 1.0
#: Share of the way to the next place from which that counts too.
_BETWEEN = 0.25


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
    if scores.max() < max(none + _WORTH, max(known) - _MARGIN):
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
    now = best = first
    vain = 0
    for _ in range(_LOOKS):
        own = _places(max(now.fits, key=lambda f: search.scores([f])[0]))
        model = search.model
        points = points_about(model.case, model.full, now.points, own)
        if len(points) <= len(own):
            break
        share = now.share * len(own) / len(now.points)
        now = _look(search, now, points, share, near)
        vain = 0 if now.score > best.score + _GAIN else vain + 1
        if now.score > best.score:
            best = now
        if vain == _IN_VAIN:
            break
    if best is first:
        _put(search, now, first.points, first.share)
        return first
    every = _look(search, now, best.points, best.share)
    return replace(every, fits=(*every.fits, *best.fits))


def _look(search: Fits, before: _Look, points, share: float, near=None) -> _Look:
    """Fits at points, of all effects or of some."""
    effects = [e for e in _put(search, before, points, share) if near is None or e.key in near]
    fits = search.fit_all([search.model.hypothesis((e,)) for e in effects], again=True)
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
