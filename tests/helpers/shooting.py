"""Motions of oscillators whose springs are powers of their stretch, by integration in time."""

from __future__ import annotations

import numpy as np
from oscillators import TURN, Cubic, Square, start_of
from scipy.integrate import solve_ivp

from fenics_joints.joint_laws import CubicSpring
from fenics_joints.transient import solve_transient, steady_harmonics

#: Name of the stiffness, and the power of the stretch.
POWERS = {Cubic: ("k", 3), CubicSpring: ("k3", 3), Square: ("k", 2)}


def motion(model, push: float, omega: float, states, periods: float = 1, **options):
    """`solve_ivp`'s motion under a cosine at "push", from displacements and velocities (2 n, ...).

    Columns of the states are motions of their own, which are integrated together.
    """
    n, inverse = model.n_dofs, np.linalg.inv(model.M)
    springs = []
    for p in model.interfaces:
        key, power = POWERS[type(p.law)]
        springs.append((p.rows[0, 0], float(p.law.parameters[key]), power))

    def rate(t, y):
        u, v = y.reshape(2, n, -1)
        force = push * np.cos(omega * t) * model.forces["push"][:, None]
        force = force - model.C @ v - model.K @ u
        for row, k, power in springs:
            force = force - k * np.outer(row, (row @ u) ** power)
        return np.concatenate([v, inverse @ force]).ravel()

    given = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11} | options
    return solve_ivp(rate, (0, periods * TURN / omega), np.ravel(states), **given)


def later(model, push: float, omega: float, states, periods: float = 1, **options):
    """The states so many periods of the force later."""
    made = motion(model, push, omega, states, periods, **options)
    return made.y[:, -1].reshape(np.shape(states))


def shot_multipliers(model, push: float, omega: float, state) -> np.ndarray:
    """Floquet multipliers of the periodic motion near a state, by shooting."""
    size, h = len(state), 1e-5
    for _ in range(3):
        beside = state[:, None] + h * np.hstack([np.eye(size), -np.eye(size), np.zeros((size, 1))])
        ends = later(model, push, omega, beside)
        W = (ends[:, :size] - ends[:, size:-1]) / (2 * h)
        # The null direction of a branch point is not that of the start's error.
        miss = ends[:, -1] - state
        state = state + np.linalg.lstsq(np.eye(size) - W, miss, rcond=1e-3)[0]
    return np.linalg.eigvals(W)


def slider_motion(force, times, stiffness: float, strength: float, damping: float) -> np.ndarray:
    """Displacement of a unit mass on a unit spring with a slider beside it, which starts at rest.

    A sequence of smooth motions between changes of stick and slip.
    """
    t, y, slips, found = 0.0, np.zeros(3), 0, np.zeros(len(times))  # y: motion, velocity, slider

    def rate(t, y):
        pull = slips * strength if slips else stiffness * (y[0] - y[2])
        return [y[1], force(t) - damping * y[1] - y[0] - pull, y[1] if slips else 0.0]

    def change(t, y):
        return y[1] * slips if slips else strength - stiffness * abs(y[0] - y[2])

    change.terminal, change.direction = True, -1
    exact = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-11, "dense_output": True}
    while t < times[-1]:
        run = solve_ivp(rate, (t, times[-1]), y, events=change, **exact)
        inside = (times >= t) & (times <= run.t[-1])
        if inside.any():
            found[inside] = run.sol(times[inside])[0]
        t, y = run.t[-1], run.y[:, -1]
        stretch = np.sign(y[0] - y[2])
        if slips:  # sticks, just inside, so that the next change is not this one
            y[2] = y[0] - stretch * strength / stiffness * (1 - 1e-12)
        slips = 0 if slips else int(stretch)
    return found


def steady_run(model, result, loads, periods: int, steps: int = 400):
    """A run of `solve_transient`, and by sensor the harmonics of its last period.

    It starts from the motion that harmonic balance found, so that it is steady soon; what is off
    in that motion is left behind.
    """
    (X, *_), (omega, *_) = result.coefficients, result.omegas
    start = (*np.split(start_of(X, omega), 2), None)
    given = {"step": TURN / omega / steps, "n_steps": periods * steps, "initial": start}
    run = solve_transient(model, loads=loads, **given)
    return run, {
        key: steady_harmonics(run.times, u, omega / TURN, 3) for key, u in run.displacements.items()
    }
