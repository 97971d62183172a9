"""Damping ratios of a test's modes: those of the complex modes that real ones become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from fenics_joints.modal.modes import Modes
from fenics_joints.response.complex_modes import solve_complex_modes
from fenics_joints.structure import Damped, Damping


def damping_ratios(
    model: Damped,
    given: Mapping[str, float] | None,
    damping: Damping,
    modes: Modes,
    index: Sequence[int],
    *,
    gradients: bool = False,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Damping ratios of some modes with the model's damping, Jalali et al. 2019, eq. 9. Collective.

    Damping changes the order of the modes, so that each real mode is given the complex one that has
    most of it; no two the same.

    Args:
        model: The model.
        given: Values of parameters that differ from their nominal value.
        damping: The damping.
        modes: The undamped modes at these values, of a `Structure` with a solver that has solved
            nothing else since; as many complex ones are found.
        index: Which of them, m.
        gradients: Whether derivatives are wanted.

    Returns:
        Ratios, (m,), and their derivatives by all of the model's parameters, (m, n_parameters).

    Raises:
        InputError: If a value is out of range.
        ConvergenceError: If modes were not found, or too many are overdamped.
    """
    found = solve_complex_modes(
        model, given, damping=damping, n_modes=len(modes), gradients=gradients, modes=modes
    )
    own = linear_sum_assignment(-found.shares[np.asarray(index)])[1]
    return found.damping_ratios[own], found.gradients()[1][own] if gradients else None
