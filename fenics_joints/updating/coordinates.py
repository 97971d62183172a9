"""Coordinates of parameters in which a fit works: the logarithm, or the value over its size.

Where a layer's E is bounded by its G (E < 3 G in an isotropic one, nu < 0.5) and both are free, E's
coordinate is the logit of E / (3 G): a search cannot step over the limit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import expit, logit

from fenics_joints.errors import InputError, real
from fenics_joints.structure.components import Parameter

#: Largest logit of E over its limit: within 6e-6 of it, far beyond any test's accuracy.
_WIDEST = 12.0


class LogScale:
    """Coordinates x of the logarithms of parameters.

    Args:
        names: Names of the parameters.
        model: A full or reduced structure, for its laws.
    """

    def __init__(self, names: Sequence[str], model):
        self.names = list(names)
        #: (index of E, index of G, largest E / G) of each coupled pair.
        self.pairs = []
        for region in model.regions:
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


class Coordinates:
    """Coordinates x of parameters' values p.

    ``log`` parameters have those of `LogScale`, for which the limits of the joints' laws are no
    obstacle; the others p over the size of their start.

    Args:
        parameters: The parameters.
        start: Values at the start, by name.
        model: A full or reduced structure, for its laws.

    Raises:
        InputError: If a start is missing, not finite, or not positive for a ``log`` parameter; or
            if the parameters are none, or no parameters of the model.
    """

    def __init__(self, parameters: Sequence[Parameter], start: Mapping[str, float], model):
        self.parameters = tuple(parameters)
        self.names = tuple(p.name for p in parameters)
        if not self.names or len(set(self.names)) < len(self.names):
            raise InputError(f"parameters = {list(self.names)}: expected at least one, each once")
        for p in self.parameters:
            if p.name not in model.parameters:
                known = ", ".join(model.parameters)
                raise InputError(
                    f"parameter {p.name!r} is not the model's; expected one of {known}"
                )
            start_of = f"start of {p.name}"
            real(start_of, start.get(p.name), above=0.0 if p.log else -np.inf)
        self.log = np.array([p.log for p in self.parameters])
        self.scale = LogScale([p.name for p in self.parameters if p.log], model)
        sizes = np.array([abs(start[n]) or 1.0 for n in self.names])
        self.unit = np.where(self.log, 1.0, sizes)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Values of the parameters at coordinates ``x``, (p,)."""
        values = self.unit * x
        values[self.log] = np.exp(self.scale.logs(np.asarray(x)[self.log]))
        return values

    def inverse(self, values: np.ndarray) -> np.ndarray:
        """Coordinates of parameters with these values, (p,)."""
        x = np.asarray(values, dtype=float) / self.unit
        x[self.log] = self.scale.inverse(np.log(x[self.log]))
        return x

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of `values` by the coordinates, (p, p)."""
        values, slope = self.values(x), np.diag(self.unit)
        logs = np.flatnonzero(self.log)
        by_log = self.scale.slope(np.asarray(x)[self.log])
        slope[np.ix_(logs, logs)] = values[logs, None] * by_log
        return slope

    def at(self, condition: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and their derivative, the same at every condition."""
        return self.values(x), self.slope(x)

    def working(self, values: np.ndarray) -> np.ndarray:
        """Derivative of a value by its logarithm, or for the others by p over its size, (p,)."""
        return np.where(self.log, values, self.unit)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the coordinates."""
        low = np.array([p.lower for p in self.parameters]) / self.unit
        high = np.array([p.upper for p in self.parameters]) / self.unit
        logs = [p for p in self.parameters if p.log]
        low[self.log], high[self.log] = self.scale.bounds(logs)
        return low, high

    def mapping(self, values: np.ndarray) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, np.asarray(values, dtype=float).tolist(), strict=True))
