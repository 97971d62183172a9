"""Nonlinear joints against others' numbers, second part: shocks, beams, tracked responses.

As a script it prints the rows anew (``env PYTHONPATH=tests/helpers python3 FILE``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import ufl
from checks_page import Case, hold, rows, show
from oscillators import TURN, absorber, escape, oscillator
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fenics_joints.harmonic import (
    Balance,
    find_bifurcations,
    solve_backbone,
    solve_harmonic,
    track_folds,
    track_resonance,
)
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import (
    CubicSpring,
    ElasticFriction,
    JointLaw,
    RateDamping,
    UnilateralSpring,
)
from fenics_joints.transient import solve_transient

NLVIB, TMD, ASTER = "NLvib", "tmdsimpy", "Code_Aster"


def mass_on_spring(m: float, k: float, law) -> InterfaceModel:
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", law, one[None], np.ones(1))
    return InterfaceModel(m * one, k * one, (joint,), None, {"push": one[0]}, {"mass": one[0]})


# -- Code_Aster's SDND tests -----------------------------------------------------------------------


@cache
def shock():
    """SDND101: 100 kg on 1e4 N/m, with 1 m/s against a stop of 1e6 N/m that it touches."""
    model = mass_on_spring(100.0, 1e4, UnilateralSpring(1e6, 0.0))
    step = 2e-5
    found = solve_transient(
        model, step=step, n_steps=1700, initial=(np.zeros(1), np.ones(1), None), sensors=["mass"]
    )
    x = found.displacements["mass"]
    left = int(np.flatnonzero(x > 0)[-1])
    away = found.times[left] + step * x[left] / (x[left] - x[left + 1])
    return 1e6 * float(x.max()), float(away)


STOP = {"k": 10.0, "K": 50.0, "e": 0.01}  # SDND122: 1 kg, spring, wall, gap


def stop_frequency(energy: float) -> float:
    """SDND122's closed form, Hz; its impact lasts from and to the wall, at both speeds alike."""
    k, K, e = STOP.values()
    free = 2 / np.sqrt(k) * np.arccos(-e * np.sqrt(k / (2 * energy)))
    # About the place where both springs rest, k e beyond which is the way in.
    middle, omega = K * e / (k + K), np.sqrt(k + K)
    speed = np.sqrt(2 * energy - k * e**2)
    pressed = 2 / omega * np.arctan2(speed / omega, e - middle)
    return float(1 / (free + pressed))


def stop_mode(low: float, high: float) -> tuple[float, float]:
    """Energy, J, and frequency, Hz, of the highest point of the mode with the wall."""
    k, K, e = STOP.values()
    law = UnilateralSpring(K, e)
    found = solve_backbone(mass_on_spring(1.0, k, law), (low, high), harmonics=25)
    X, omega = found.coefficients[-1, 0], TURN * found.frequencies_hz[-1]
    h = np.arange(1, len(X) // 2 + 1)
    x, v = X[0] + X[1::2].sum(), omega * h @ X[2::2]
    energy = 0.5 * v**2 + 0.5 * k * x**2 + 0.5 * K * max(x - e, 0) ** 2
    return float(energy), float(omega / TURN)


@cache
def pad():
    """SDND100: a pad on a spring, let go 0.85 mm away, on dry ground of 1 N: its turns, m."""
    model = mass_on_spring(1.0, 1e4, ElasticFriction(1e7, 1.0))
    # The ground yields by a ten-thousandth of a millimetre: at the start it is drawn.
    found = solve_transient(
        model,
        step=2e-5,
        n_steps=8000,
        initial=(np.array([8.5e-4]), np.zeros(1), None),
        sensors=["mass"],
    )
    x = found.displacements["mass"]
    turns = x[1:-1][np.diff(np.sign(np.diff(x))) != 0]
    return float(turns[0]), float(np.mean(x[-500:]))


# -- NLvib -----------------------------------------------------------------------------------------


def beam(n_nodes=20, spring=6e9) -> InterfaceModel:
    """Example 09: a clamped Euler-Bernoulli beam with a cubic spring at its tip."""
    length, h, E, rho = 0.7, 0.014, 2.05e11, 7800.0
    le, EI, rhoA = length / (n_nodes - 1), E * h**4 / 12, rho * h**2
    stiff = (
        EI
        / le**3
        * np.array(
            [
                [12, 6 * le, -12, 6 * le],
                [6 * le, 4 * le**2, -6 * le, 2 * le**2],
                [-12, -6 * le, 12, -6 * le],
                [6 * le, 2 * le**2, -6 * le, 4 * le**2],
            ]
        )
    )
    mass = (
        rhoA
        * le
        / 420
        * np.array(
            [
                [156, 22 * le, 54, -13 * le],
                [22 * le, 4 * le**2, 13 * le, -3 * le**2],
                [54, 13 * le, 156, -22 * le],
                [-13 * le, -3 * le**2, -22 * le, 4 * le**2],
            ]
        )
    )
    K, M = np.zeros((2, 2 * n_nodes, 2 * n_nodes))
    for i in range(n_nodes - 1):
        part = slice(2 * i, 2 * i + 4)
        K[part, part] += stiff
        M[part, part] += mass
    K, M = K[2:, 2:], M[2:, 2:]
    tip = np.eye(len(K))[-2]
    joint = InterfacePoints("tip", CubicSpring(0.0, spring), tip[None, None], np.ones(1))
    return InterfaceModel(M, K, (joint,), None, {"tip": tip}, {"tip": tip})


def beam_linear() -> float:
    length, h = 0.7, 0.014
    return float(1.875104069**2 / TURN / length**2 * np.sqrt(2.05e11 * h**2 / 12 / 7800.0))


def beam_mode() -> float:
    found = solve_backbone(beam(), (1e-8, 1e-7), harmonics=1, sensor="tip")
    return float(found.frequencies_hz[-1])


def rubbing_free() -> float:
    """Example 05's mode at large amplitude, where friction is as nothing."""
    axes, M = np.eye(2), np.diag([0.02, 1.0])
    K = np.array([[40.0, -40.0], [-40.0, 640.0]])
    law = RateDamping(strength=5.0, smoothing=0.05)
    joint = InterfacePoints("rub", law, axes[0].reshape(1, 1, 2), np.ones(1))
    model = InterfaceModel(M, K, (joint,), None, {}, {"second": axes[1]})
    found = solve_backbone(model, (100.0, 1000.0), harmonics=5, sensor="second")
    return float(TURN * found.frequencies_hz[-1])


def free_mode() -> float:
    K, light = np.array([[40.0, -40.0], [-40.0, 640.0]]), np.diag([0.02**-0.5, 1.0])
    return float(np.sqrt(np.linalg.eigvalsh(light @ K @ light)[0]))


def absorber_shot() -> float:
    """Example 02 by shooting, as there: rms of the first mass at 1.05 rad/s and 0.11 N."""
    model, omega = absorber(), 1.05
    joints = [(p.rows[0, 0], float(p.law.parameters["k3"])) for p in model.interfaces]
    inverse = np.linalg.inv(model.M)

    def rate(t, y):
        u, v = y[:2], y[2:]
        spring = sum(k * (r @ u) ** 3 * r for r, k in joints)
        load = 0.11 * np.cos(omega * t) * model.forces["push"]
        return [*v, *(inverse @ (load - model.C @ v - model.K @ u - spring))]

    T = TURN / omega
    long = solve_ivp(rate, (0, 150 * T), np.zeros(4), method="DOP853", rtol=1e-9, atol=1e-11)
    last = solve_ivp(
        rate,
        (0, T),
        long.y[:, -1],
        method="DOP853",
        rtol=1e-9,
        atol=1e-11,
        t_eval=np.linspace(0, T, 2001)[:-1],
    )
    return float(np.sqrt(np.mean(last.y[0] ** 2)))


def absorber_rms() -> float:
    found = solve_harmonic(absorber(), "push", 0.11, at=[1.05 / TURN], harmonics=7)
    return float(np.linalg.norm(found.coefficients[0, 0, 1:]) / np.sqrt(2))


# -- tmdsimpy --------------------------------------------------------------------------------------


class Quintic(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * slip[0] ** 5]), None


def quintic(harmonic: int) -> float:
    balance = Balance(oscillator(Quintic(k=3.0), 0.01), 5)
    X = np.zeros(balance.shape)
    X[0, 1] = 1.2
    return float(balance.interface_force(X, 1.0)[0][0, 2 * harmonic - 1])


def third_phase() -> float:
    """Of the third harmonic behind what the first excites it with, rad."""
    model = oscillator(CubicSpring(0.0, 1.0), 0.01)
    result = solve_harmonic(model, "push", 0.3, (0.3 / TURN, 0.45 / TURN), harmonics=5)
    X = track_resonance(result, 3, (0.3, 0.4)).coefficients[-1, 0]
    first, third = (np.angle(X[k] - 1j * X[k + 1]) for k in (1, 5))
    return float((np.pi + 3 * first - third) % TURN)


# -- bifurcations ----------------------------------------------------------------------------------


@cache
def cusp():
    model = oscillator(CubicSpring(0.0, 1.0), 0.1)
    result = solve_harmonic(model, "push", 0.3, (0.7 / TURN, 3 / TURN), harmonics=1)
    fold = next(b for b in find_bifurcations(result).bifurcations if b.kind == "fold")
    (turn,) = track_folds(result, fold, (0.01, 0.4), direction="down").turns
    return TURN * turn.frequency_hz, turn.force


CUSP = (np.sqrt(3) * 0.1 + np.sqrt(3 * 0.01 + 4)) / 2


@cache
def escape_branch():
    """Down to the resonance from above: another motion is beside it."""
    band = (0.65 / TURN, 0.9 / TURN)
    return solve_harmonic(escape(), "push", 0.06, band, harmonics=11, direction="down")


def escape_shot() -> float:
    """Frequency at which a multiplier of the escape oscillator is -1, by shooting."""

    def last(omega: float, y: np.ndarray):
        def rate(t, y):
            x, v, W = y[0], y[1], y[2:].reshape(2, 2)
            A = np.array([[0.0, 1.0], [2 * x - 1, -0.1]])
            return [v, 0.06 * np.cos(omega * t) - 0.1 * v - x + x**2, *(A @ W).ravel()]

        start = np.concatenate([y, np.eye(2).ravel()])
        made = solve_ivp(rate, (0, TURN / omega), start, method="DOP853", rtol=1e-10, atol=1e-12)
        return made.y[:2, -1], made.y[2:, -1].reshape(2, 2)

    branch = escape_branch()
    i = int(np.argmin(np.abs(branch.omegas - 0.702)))
    X, h = branch.coefficients[i, 0], np.arange(1, 12)
    y = np.array([X[0] + X[1::2].sum(), branch.omegas[i] * h @ X[2::2]])

    def crossing(omega: float) -> float:
        nonlocal y
        for _ in range(6):
            end, W = last(omega, y)
            y = y + np.linalg.solve(np.eye(2) - W, end - y)
        return float(np.linalg.eigvals(W).real.min() + 1)

    return float(brentq(crossing, 0.7, 0.703, xtol=1e-9))


def escape_doubling() -> float:
    found = find_bifurcations(escape_branch(), tolerance=1e-6)
    return TURN * found.bifurcations[0].frequency_hz


CASES = [
    Case(
        "mass against a stop, largest force, N",
        f"{ASTER} SDND101",
        lambda: 1e6 / np.sqrt(1.01e6 / 100),
        lambda: shock()[0],
        1e-4,
    ),
    Case(
        "the same, it leaves after, s",
        f"{ASTER} SDND101",
        lambda: np.pi / np.sqrt(1.01e6 / 100),
        lambda: shock()[1],
        1e-3,
    ),
    Case(
        "mode of a mass with a wall at a gap, Hz",
        f"{ASTER} SDND122",
        lambda: stop_frequency(stop_mode(0.005, 0.015)[0]),
        lambda: stop_mode(0.005, 0.015)[1],
        1e-4,
    ),
    Case(
        "the same at a higher energy, Hz",
        f"{ASTER} SDND122",
        lambda: stop_frequency(stop_mode(0.005, 0.03)[0]),
        lambda: stop_mode(0.005, 0.03)[1],
        1e-4,
    ),
    Case(
        "pad let go on dry ground, first turn, m",
        f"{ASTER} SDND100",
        lambda: -6.5e-4,
        lambda: pad()[0],
        5e-3,
    ),
    Case("the same, where it stops, m", f"{ASTER} SDND100", lambda: 5e-5, lambda: pad()[1], 0.05),
    Case(
        "absorber at 0.11 N and 1.05 rad/s, rms by shooting",
        f"{NLVIB} 02",
        absorber_shot,
        absorber_rms,
        1e-6,
    ),
    Case("tanh friction, mode at 1,000: free, rad/s", f"{NLVIB} 05", free_mode, rubbing_free, 1e-4),
    Case(
        "beam with a cubic spring, mode at 1e-7 m, Hz", f"{NLVIB} 09", beam_linear, beam_mode, 1e-5
    ),
    Case(
        "quintic spring k = 3 at 1.2, first harmonic 10/16 k a^5",
        f"{TMD} quintic_stiffness",
        lambda: 10 / 16 * 3 * 1.2**5,
        lambda: quintic(1),
        1e-12,
    ),
    Case(
        "the same, third harmonic 5/16 k a^5",
        f"{TMD} quintic_stiffness",
        lambda: 5 / 16 * 3 * 1.2**5,
        lambda: quintic(3),
        1e-12,
    ),
    Case(
        "Duffing, third harmonic behind its excitation, rad",
        f"{TMD} vprnm",
        lambda: np.pi / 2,
        third_phase,
        1e-6,
    ),
    Case(
        "Duffing's cusp by one harmonic, c = 0.1, rad/s",
        "closed form",
        lambda: CUSP,
        lambda: cusp()[0],
        1e-6,
    ),
    Case(
        "the same, force, N",
        "closed form",
        lambda: 0.2 * CUSP * np.sqrt(8 * np.sqrt(3) * 0.1 * CUSP / 27),
        lambda: cusp()[1],
        1e-6,
    ),
    Case(
        "escape from a well, period doubles at, rad/s",
        "shooting, Thompson 1989",
        escape_shot,
        escape_doubling,
        1e-4,
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_the_number_is_theirs_and_the_pages(case):
    hold(case)


def test_the_page_has_every_case():
    assert {case.name for case in CASES} <= set(rows())


if __name__ == "__main__":
    show(CASES)
