"""The cut-off pressure of least objective, found by a few full solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from fenics_joints.errors import InputError
from fenics_joints.structure.sparse import product
from fenics_joints.updating.cutoff import (
    SPARE,
    CutoffModel,
    assign,
    elastic,
    elastic_shapes,
    misfit,
)


@dataclass(eq=False, repr=False)
class CutoffMinimum:
    """The least objective, found by full solutions alone.

    Attributes:
        step: Its step.
        cutoff: Its cut-off pressure, Pa.
        objective: Sum of relative frequency errors there.
        frequencies_hz: Elastic frequencies there, (n_elastic,).
        visited: Steps that were solved, in order.
        bound: No step has an objective below this; equal to ``objective`` when that is proved to
            be the least.
    """

    step: int
    cutoff: float
    objective: float
    frequencies_hz: np.ndarray
    visited: list[int]
    bound: float

    def __repr__(self) -> str:
        found = f"{self.cutoff:.4g} Pa, objective {self.objective:.4g}"
        return f"CutoffMinimum({found}, {len(self.visited)} solutions)"


def minimise(
    model: CutoffModel,
    measured_hz,
    *,
    max_solves: int = 15,
    progress: Callable[[int, float, float], None] | None = None,
) -> CutoffMinimum:
    """Find the cut-off of least objective with few full solutions. Collective.

    The frequencies fall monotonically with the cut-off. So between two solved steps each lies
    between its values there, which bounds the objective from below, and each is interpolated
    monotonically; the next step solved is the one of least interpolated objective among those that
    the bounds leave, until none is left or ``max_solves`` are done.

    Args:
        model: The model.
        measured_hz: Measured elastic frequencies, Hz, (n_elastic,), in the model's order in its
            stiffest state.
        max_solves: Most full solutions.
        progress: Told (solutions, cut-off, objective) after each.
    """
    measured = np.asarray(measured_hz, dtype=float)
    if measured.shape != (model.n_elastic,):
        raise InputError(f"measured_hz has shape {measured.shape}: expected ({model.n_elastic},).")
    n = len(model)
    solved: dict[int, np.ndarray] = {}
    visited: list[int] = []

    def error(step: int) -> float:
        return float(misfit(solved[step], measured))

    def solve(step: int) -> None:
        solved[step] = _followed(model, step, solved)
        visited.append(step)
        if progress is not None:
            progress(len(visited), model.cutoffs[step], error(step))

    if n < 2:
        raise InputError(f"the contact has {n} distinct pressure; expected at least 2.")
    for step in dict.fromkeys([0, (n - 1) // 3, 2 * (n - 1) // 3, n - 1]):
        solve(step)
    bound = -np.inf
    while True:
        least = min(map(error, solved))
        predicted, below = _predict(model.cutoffs, solved, measured)
        predicted[[*solved, *np.flatnonzero(below >= least)]] = np.inf
        step = int(np.argmin(predicted))
        bound = least if np.isinf(predicted[step]) else min(least, below.min())
        if np.isinf(predicted[step]) or len(visited) >= max_solves:
            break
        solve(step)
    best = min(solved, key=error)
    return CutoffMinimum(
        best, float(model.cutoffs[best]), error(best), solved[best], visited, float(bound)
    )


def _predict(cutoffs, solved, measured) -> tuple[np.ndarray, np.ndarray]:
    """Interpolated objective at every step, and a bound from below by monotonicity."""
    steps = sorted(solved)
    known = np.array([solved[k] for k in steps])
    curves = PchipInterpolator(cutoffs[steps], known)
    left = np.clip(np.searchsorted(steps, np.arange(len(cutoffs)), "right") - 1, 0, len(steps) - 2)
    high = np.maximum(known[left], known[left + 1]) / measured - 1
    low = np.minimum(known[left], known[left + 1]) / measured - 1
    off = np.maximum(0.0, np.maximum(low, -high))
    return misfit(curves(cutoffs), measured), off.sum(axis=1)


def _followed(model: CutoffModel, step: int, solved: Mapping[int, np.ndarray]) -> np.ndarray:
    """Elastic frequencies at a step, in the order of the stiffest state."""
    modes = model.solve(step)
    n = model.n_elastic + SPARE // 2
    frequencies = elastic(modes, n)
    if not solved:
        model.order = {step: np.arange(n)}
        return frequencies[: model.n_elastic]
    near = min(solved, key=lambda k: abs(k - step))
    A, B = (elastic_shapes(m, n) for m in (model.solve(near), modes))
    link = assign(model.joint.model.comm.allreduce(A.T @ product(model.mass, B)))
    model.order[step] = link[model.order[near]]
    return frequencies[model.order[step]][: model.n_elastic]
