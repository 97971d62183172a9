"""Updating at all conditions of a test, each from its neighbour's result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from fenics_joints.errors import ConvergenceError
from fenics_joints.measurements.target import Target
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.fit import update
from fenics_joints.updating.result import Update


def update_all(
    model,
    parameters: Sequence[Parameter],
    targets: Sequence[Target],
    start: Mapping[str, float],
    first: Mapping[int, Update],
    *,
    follow: bool = True,
    regularisation: float | None = None,
    n_modes: int | None = None,
    done: Callable[[], None] = lambda: None,
) -> dict[int, Update]:
    """Fit all conditions, each started from its neighbour, from one that is known outwards.

    Args:
        model: As for `update`.
        parameters: What is identified.
        targets: The data at each condition.
        start: Values at the start, about which the regularisation holds the parameters.
        first: Number of the known condition, and what was found there.
        follow: Whether modes are paired by the neighbour's shapes, in place of the targets'.
        regularisation: As for `update`.
        n_modes: As for `update`.
        done: Called after each condition.

    Returns:
        What was found at each condition, ascending; those where the fit does not converge are left
        out.
    """
    ((at, known),) = first.items()
    found = {at: known}
    for rows in (range(at + 1, len(targets)), range(at - 1, -1, -1)):
        last = known
        for row in rows:
            target = targets[row]
            if follow and last.prediction.shapes is not None:
                target = replace(target, shapes=last.prediction.shapes)
            try:
                last = found[row] = update(
                    model,
                    parameters,
                    target,
                    {**start, **last.mapping()},
                    centre=start,
                    regularisation=regularisation,
                    n_modes=n_modes,
                    elsewhere=False,
                )
            except ConvergenceError:
                pass  # the next starts from the last that did
            done()
    return dict(sorted(found.items()))
