"""Which small models serve the fits of a kind of structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch

from fenics_joints.reduction.combined import CombinedModel
from fenics_joints.reduction.greedy import GreedyModel
from fenics_joints.reduction.seen import SeenModes
from fenics_joints.reduction.surrogate import Surrogate


@dataclass(frozen=True)
class SmallModels:
    """Makers of small models that know their errors, see `fenics_joints.reduction.adaptive`.

    Attributes:
        seen: For the modes that a test saw, see `Surrogate`.
        free: For these in a few parameters, see `GreedyModel`.
        combined: For data of several kinds, see `CombinedModel`.
        exact: Whether they are as good as the full model, and need neither samples nor files.
    """

    seen: Callable[..., SeenModes]
    free: Callable[..., SeenModes]
    combined: Callable[..., CombinedModel]
    exact: bool = False


@singledispatch
def tested_models(full) -> SmallModels:
    """The small models of a structure; those of solids are reduced on samples of parameters."""
    return SmallModels(Surrogate, GreedyModel, CombinedModel)
