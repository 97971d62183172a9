"""Prior odds, against none, of effects and of a cause outside the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect

#: Prior odds, against none, that some one effect is at work, shared out by the effects' weights,
#: beside which some come (`Effect.beside`), so that a larger library makes nothing less likely;
#: two at once have the product of their odds. [decision: chosen]
_ANY = 1.5


def log_odds(effects: Sequence[Effect]) -> dict[str, float]:
    """ln of the prior odds of each effect of a library against none, by its key."""
    common = [effect.weight for effect in effects if not effect.beside]
    total = sum(common or [effect.weight for effect in effects])
    return {e.key: float(np.log(_ANY * e.weight / total)) for e in effects}


def log_odds_outside(probability: float) -> float:
    """ln of the prior odds against none of a cause outside the library.

    Args:
        probability: That it, and not an effect of the library, is the cause.
    """
    return float(np.log(_ANY * probability / (1 - probability)))
