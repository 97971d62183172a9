"""Small models that serve a fit: they answer for a full model, know how far off they are, and grow.

Where the error is too large the model is extended by the points at which it is worst, and looked at
again: the weak greedy algorithm of reduced bases (Binev et al., SIAM J. Math. Anal. 43, 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

#: Parameter values.
Points = Sequence[Mapping[str, float]]


class SmallModel(Protocol):
    """A tested model: one that knows its error. Exact ones have none, and nothing to extend."""

    def errors(self, points: Points) -> np.ndarray:
        """Error at points, (n,), equal on all ranks; nan where it is not defined. Collective."""

    def extend(self, points: Points) -> None:
        """Become better at points. Collective."""


def improve(
    model: SmallModel,
    points: Callable[[], Points],
    limit: float,
    rounds: int,
    *,
    most: int | None = None,
    least: float = 0.0,
    after: Callable[[], None] | None = None,
) -> np.ndarray:
    """Extend a model where it is worst, until it is good enough. Collective.

    Args:
        model: The model.
        points: Gives those of a round, such as what a fit to the model of that round finds.
        limit: Error that is good enough.
        rounds: How often the error is looked at; after the last time nothing is added.
        most: How many points of a round are added at most; all by default.
        least: Share of the limit below which a point is not worth adding.
        after: Called after each extension.

    Returns:
        The errors at the last points, (n,).
    """
    for left in reversed(range(rounds)):
        at = points()
        # A point without what was asked for says nothing of those that have it.
        errors = np.nan_to_num(model.errors(at))
        if not left or errors.max(initial=0.0) <= limit:
            break
        worst = np.argsort(errors)[::-1][:most]
        model.extend([at[i] for i in worst if errors[i] > least * limit])
        if after is not None:
            after()
    return errors
