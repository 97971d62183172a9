"""Coordinates in which a model is straight, as far as its frequencies can say.

Specimens that move together by a step of the parameters' logarithms change their frequencies by
different amounts where the model is curved, which a small noise does not forgive. In coordinates

    u(x) = x - c + A(x - c, x - c) / 2,    A = W H,

with H the second derivatives of g at c and W a generalised inverse of its slope, they change by
the same amounts (but for third order, and for what no parameter can bring about).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_STEP, _NEWTON, _CLOSE = 1e-3, 5, 1e-10


def curvature(g: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Second derivatives of g, from (n, p) to (n, m), at x (p,): (m, p, p)."""
    p, step = len(x), _STEP * np.eye(len(x))
    pairs = [(i, j) for i in range(p) for j in range(i, p)]
    points = [x + a * step[i] + b * step[j] for i, j in pairs for a in (1, -1) for b in (1, -1)]
    found = g(np.array(points)).reshape(len(pairs), 4, -1)
    second = np.empty((found.shape[2], p, p))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, found, strict=True):
        second[:, i, j] = second[:, j, i] = (pp - pm - mp + mm) / (4 * _STEP**2)
    return np.nan_to_num(second)


class Straight:
    """The coordinates, and steps in them.

    Args:
        centre: c, (p,).
        bend: A, symmetric in its last two indices, (p, p, p); zero for steps of x itself.
    """

    def __init__(self, centre: np.ndarray, bend: np.ndarray):
        self.centre, self.bend = np.asarray(centre), np.asarray(bend)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """u at x, (..., p)."""
        off = x - self.centre
        return off + 0.5 * np.einsum("pij,...i,...j->...p", self.bend, off, off)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of u, (..., p, p)."""
        return np.eye(len(self.centre)) + np.einsum("pij,...j->...pi", self.bend, x - self.centre)

    def moved(self, x: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a step of u leads.

        Args:
            x: From where, (..., p).
            step: Of u; broadcast with x.

        Returns:
            There, (..., p); ln of the determinant of the change of ``there`` by x, (...); and
            whether the step exists and the same step back returns to x, (...). Where it does not,
            x itself stands for the place.
        """
        there = self._solved(x, self(x) + step)
        back = self._solved(there, self(there) - step)
        size = np.abs(step).max(axis=-1) + 1e-300
        good = np.abs(self(there) - self(x) - step).max(axis=-1) < _CLOSE * (1 + size)
        good &= np.abs(back - x).max(axis=-1) < 1e-6 * (size + np.abs(x - self.centre).max(axis=-1))
        here, far = np.linalg.det(self.slope(x)), np.linalg.det(self.slope(there))
        good &= (here > 0) & (far > 0)
        ratio = np.where(good, here, 1.0) / np.where(good, far, 1.0)
        return np.where(good[..., None], there, x), np.log(ratio), good

    def _solved(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x with u(x) given, by Newton's method from an x."""
        for _ in range(_NEWTON):
            slope = self.slope(x)
            # A fold of the coordinates: kept away from it, and refused by who asked.
            flat = np.abs(np.linalg.det(slope)) < 1e-6
            slope = np.where(flat[..., None, None], np.eye(len(self.centre)), slope)
            x = x + np.linalg.solve(slope, (u - self(x))[..., None])[..., 0]
        return x
