"""The evidence of the hypotheses that count, from draws in place of Laplace's approximation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.sampled import (
    Sampled,
    importance_evidence,
    nested_evidence,
)
from fenics_joints.diagnosis.search import Search
from fenics_joints.errors import ConvergenceError
from fenics_joints.parallel import spread

__all__ = ["Resampled", "sample"]

#: How far (in ln) behind the best a hypothesis may be whose evidence is sampled: further ones have
#: no share that shows, even if Laplace is off by some nats. And how many are sampled at most.
_MARGIN, _COUNT = 8.0, 40
#: Parameters of a hypothesis' effects up to which its evidence is sampled: seven take ten times as
#: many points as four.
_MOST = 6
#: Effective sample size from which importance sampling is taken to have found its way; and from
#: which it is better than Laplace.
_FOUND, _LEAST = 50.0, 20.0


@dataclass(frozen=True)
class Resampled:
    """Fits with the sampled evidence put in.

    Attributes:
        fits: In the order in which they were given.
        sampled: What was sampled, by the label of the hypothesis' keys.
        laplace: The evidence of these by Laplace.
    """

    fits: list[Fit]
    sampled: dict[str, Sampled] = field(default_factory=dict)
    laplace: dict[str, float] = field(default_factory=dict)


def sample(search: Search, fits: Sequence[Fit], nested: int) -> Resampled:
    """The evidence of all hypotheses that are not hopeless anew. Collective.

    By importance sampling; where that does not find its way, of the first few by nested sampling.

    Args:
        search: What fitted them.
        fits: All that were fitted.
        nested: How many of the leading may take nested sampling; 0 for no sampling at all.
    """
    model, found = search.model, Resampled(list(fits))
    chosen = _leading(search, fits) if nested else []
    if not chosen:
        return found
    search.progress.step("sampling the evidence of what leads", len(chosen))
    arguments = model.forward, model.evidence, model.baseline

    def work(task: tuple[int, int]) -> Sampled | None:
        place, i = task
        drawn = importance_evidence(fits[i], *arguments)
        if drawn.n_eff < _FOUND and place < nested:
            try:
                drawn = nested_evidence(fits[i], *arguments)
            except ConvergenceError:
                pass
        search.progress.advance()
        return drawn if drawn.n_eff >= _LEAST else None  # Laplace's evidence stays

    for i, drawn in zip(
        chosen, spread(model.comm, list(enumerate(chosen)), work), strict=True
    ):
        if drawn is not None:
            label = fits[i].hypothesis.label_of_keys
            found.sampled[label], found.laplace[label] = drawn, fits[i].log_evidence
            found.fits[i] = replace(fits[i], log_evidence=drawn.log_evidence)
    return found


def _leading(search: Search, fits: Sequence[Fit]) -> list[int]:
    """Those that count, best first."""
    scores = search.scores(fits)
    order = np.argsort(-scores, kind="stable")
    near = [i for i in order if scores[i] > scores[order[0]] - _MARGIN]
    return [i for i in near if 0 < _size(fits[i]) <= _MOST][:_COUNT]


def _size(found: Fit) -> int:
    """Number of parameters of a hypothesis' effects."""
    return sum(len(effect.priors) for effect in found.hypothesis.effects)
