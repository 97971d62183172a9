"""A structure with nonlinear interfaces under a static load: the preload before it vibrates."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.interfaces.model import InterfaceModel

__all__ = ["static_state"]

_HALVINGS = 12


def static_state(
    model: InterfaceModel,
    load: np.ndarray,
    *,
    steps: int = 1,
    tolerance: float = 1e-10,
    max_iterations: int = 40,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Equilibrium under a load that grows from zero in equal steps, by Newton's method.

    Args:
        model: The model.
        load: Static load, N, (n,).
        steps: Load steps; friction remembers the path.
        tolerance: Residual relative to the load.
        max_iterations: Newton iterations per step.

    Returns:
        (displacements (n,), states of each interface (P, E, m) by its name).

    Raises:
        InputError: If the load has the wrong size.
        ConvergenceError: If a step does not converge.
    """
    load = np.asarray(load, dtype=float)
    if load.shape != (model.n_dofs,):
        raise InputError(f"static has shape {load.shape}: expected ({model.n_dofs},).")
    u, states = np.zeros(model.n_dofs), {points.name: None for points in model.interfaces}
    for i in range(1, steps + 1):
        u, states = _solve(model, load * i / steps, u, states, tolerance, max_iterations)
    return u, states


def _forces(model: InterfaceModel, u: np.ndarray, states: dict):
    """Internal force (n,), tangent stiffness (n, n), new states."""
    force, K, new = model.K @ u, np.array(model.K, dtype=float), {}
    for p in model.interfaces:
        values = p.law.values(len(p))
        stress, new[p.name], tangent = p.kernel.step(p.rows @ u, states[p.name], values)
        n = model.n_dofs
        weighted = (p.weights[:, None, None] * p.rows).reshape(-1, n)
        force += weighted.T @ stress.reshape(-1)
        K += weighted.T @ (tangent @ p.rows).reshape(-1, n)
    return force, K, new


def _solve(model, load, u, states, tolerance, max_iterations):
    scale = max(float(np.linalg.norm(load)), np.finfo(float).tiny)
    force, K, new = _forces(model, u, states)
    for _ in range(max_iterations):
        error = np.linalg.norm(force - load)
        if error <= tolerance * scale:
            return u, new
        try:
            move = scipy.linalg.solve(K, load - force, check_finite=False)
        except scipy.linalg.LinAlgError as failure:
            raise ConvergenceError("static load: the stiffness is singular", str(failure)) from None
        for halving in range(_HALVINGS):
            trial = u + move * 0.5**halving
            force, K, new = _forces(model, trial, states)
            if np.linalg.norm(force - load) < error:
                break
        u = trial
    raise ConvergenceError(
        f"static load: no equilibrium after {max_iterations} Newton iterations (residual "
        f"{error / scale:.2g} of the load); try more load steps"
    )
