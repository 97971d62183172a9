"""A look with the full model at every kind of effect, whether it leads or not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.several import Fits
from fenics_joints.errors import InputError

__all__ = ["survey"]

#: Error of the reduced model, relative to the discrepancy, from which it is enriched.
_ASTRAY = 1.0


def survey(search: Fits, fits: list[Fit]) -> list[Fit]:
    """Check the best fit of each kind of effect of which the reduced model has few samples, and fit
    those again of which it was far off. Collective.

    A reduced model is too stiff where it was not sampled: a loose bolt may be a fifth off in
    frequency, and what is right then seems hopeless and is never among those that lead.

    Args:
        search: Fits hypotheses.
        fits: Of nothing, the unknown, and each effect alone.
    """
    model, best = search.model, {}
    rare = model.rare() if model.surrogate.n_samples else set()
    for f in fits[2:]:
        name = f.hypothesis.effects[0].name
        if name in rare and f.log_evidence >= best.setdefault(name, f).log_evidence:
            best[name] = f
    if not best:
        return fits
    search.progress.step("checking each kind of effect on the full model")
    points = {name: search.lowest(f) for name, f in best.items()}
    errors = dict(zip(points, _errors(search, list(points.values())), strict=True))
    astray = [name for name in points if errors[name] > _ASTRAY * model.evidence.discrepancy]
    if not astray:
        return fits
    model.surrogate.extend([points[name] for name in astray])
    again = [i for i, f in enumerate(fits[2:], 2) if f.hypothesis.effects[0].name in astray]
    search.progress.step("fitting again with the better model", len(again))
    # Where the old model was far off, the way on from its end may be shut.
    starts = [[fits[i].z, np.zeros(len(fits[i].z))] for i in again]
    anew = search.fit_all([fits[i].hypothesis for i in again], starts, again=True)
    found = dict(zip(again, anew, strict=True))
    return [found.get(i, f) for i, f in enumerate(fits)]


def _errors(search: Fits, points: Sequence[dict[str, float]]) -> list[float]:
    """Of the reduced model at each point; 0 where a mode that the test saw is gone."""
    errors = search.model.surrogate.quick.errors
    try:
        return errors(points).tolist()
    except InputError:
        pass
    found = []
    for point in points:
        try:
            found += errors([point]).tolist()
        except InputError:
            found.append(0.0)
    return found
