"""Coordinates for positive parameters in which every point is allowed by the joints' laws.

Mostly the logarithm. Where a layer's E is bounded by its G (E < 3 G in an isotropic one, nu < 0.5)
and both are free, E's coordinate is the logit of E / (3 G): a search cannot step over the limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import expit, logit

from fenics_joints.structure.components import Parameter

__all__ = ["LogScale"]

_WIDEST = 12.0


class LogScale:
    """Coordinates x of the logarithms of parameters.

    Args:
        names: Names of the parameters.
        model: A full or reduced structure, for its laws.
    """

    def __init__(self, names: Sequence[str], model):
        self.names = list(names)
        regions = getattr(model, "full", model).regions
        #: (index of E, index of G, largest E / G) of each coupled pair.
        self.pairs = []
        for region in regions:
            limit, E, G = region.law.ratio_limit, *(region.properties.get(k) for k in "EG")
            if limit is not None and E in self.names and G in self.names:
                self.pairs.append((self.names.index(E), self.names.index(G), limit))

    def logs(self, x: np.ndarray) -> np.ndarray:
        """Logarithms of the parameters at coordinates ``x``, shape (p,)."""
        logs = np.array(x, dtype=float)
        for E, G, limit in self.pairs:
            logs[E] = np.log(limit * expit(x[E])) + x[G]
        return logs

    def inverse(self, logs: np.ndarray) -> np.ndarray:
        """Coordinates of parameters with these logarithms; just inside where they are outside."""
        x = np.array(logs, dtype=float)
        for E, G, limit in self.pairs:
            x[E] = logit(np.clip(np.exp(logs[E] - logs[G]) / limit, 1e-4, 1 - 1e-4))
        return x

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of `logs`, shape (p, p)."""
        slope = np.eye(len(x))
        for E, G, _ in self.pairs:
            slope[E, E], slope[E, G] = expit(-x[E]), 1.0
        return slope

    def bounds(self, parameters: Sequence[Parameter]) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the coordinates; those of a coupled E are the law's alone."""
        low = np.log([max(p.lower, 1e-300) for p in parameters])
        high = np.log([p.upper for p in parameters])
        for E, _, _ in self.pairs:
            low[E], high[E] = -_WIDEST, _WIDEST
        return low, high
