"""Nonlinear joints against others' numbers: the cases of docs/nonlinear_checks.md.

As a script it prints the rows anew (``env PYTHONPATH=tests/helpers python3 FILE``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import ufl
from oscillators import TURN, absorber, escape, oscillator
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

from fenics_joints.harmonic import (
    Balance,
    find_bifurcations,
    solve_backbone,
    solve_harmonic,
    solve_static_backbone,
    track_folds,
    track_resonance,
)
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.joint_laws import (
    CoulombStick,
    CubicSpring,
    ElasticFriction,
    GapSpring,
    Iwan,
    JointLaw,
    LawKernel,
    RateDamping,
    Segalman,
    UnilateralSpring,
)
from fenics_joints.transient import solve_transient

NLVIB, TMD, ASTER = "NLvib", "tmdsimpy", "Code_Aster"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "nonlinear_checks.md"


@dataclass(frozen=True)
class Case:
    """One row of the page: whose and what, their number and ours, and how near they have to be."""

    source: str
    name: str
    near: float
    numbers: Callable[[], tuple[float, float]]


CASES: list[Case] = []


def case(source: str, name: str, near: float):
    """Make a row of a function that returns their number and ours."""
    return lambda numbers: CASES.append(Case(source, name, near, numbers))


def rows() -> dict[str, list[str]]:
    """Cells of the page's table by case."""
    lines = [
        line.strip("| ").split(" | ")
        for line in PAGE.read_text("utf-8").splitlines()
        if line.startswith("| ")
    ]
    return {cells[0].strip(): [c.strip() for c in cells] for cells in lines if len(cells) == 4}


# -- models ----------------------------------------------------------------------------------------


def two_masses(law, M, K, at=1, c=0.0) -> InterfaceModel:
    """Two masses with a law to the ground at one of them, and damping c M."""
    axes, M = np.eye(2), np.diag(M).astype(float)
    joint = InterfacePoints("joint", law, axes[at].reshape(1, 1, 2), np.ones(1))
    names = {"first": axes[0], "second": axes[1]}
    return InterfaceModel(M, np.array(K, float), (joint,), c * M, names, names)


def mass_on_spring(m: float, k: float, law) -> InterfaceModel:
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", law, one[None], np.ones(1))
    return InterfaceModel(m * one, k * one, (joint,), None, {"push": one[0]}, {"mass": one[0]})


def force(law, a, harmonic, samples=1024, omega=1.0) -> np.ndarray:
    """Cosine and sine of a law's force on a cosine of amplitude a."""
    balance = Balance(oscillator(law, 0.01), 5, samples=samples)
    X = np.zeros(balance.shape)
    X[0, 1] = a
    return balance.interface_force(X, omega)[0][0, 2 * harmonic - 1 : 2 * harmonic + 1]


def force_at(law, x: float) -> float:
    """A law's force at a displacement from rest."""
    kernel = LawKernel.of(law, 1, False)
    return float(kernel.step(np.array([[x]]), None, law.values(1))[0][0, 0])


def mode(model, a, what="omega", **options) -> float:
    """Frequency, rad/s, or damping of a mode near an amplitude, by one harmonic."""
    found = solve_backbone(model, (0.5 * a, a), harmonics=1, **options)
    return float(TURN * found.frequencies_hz[-1] if what == "omega" else found.damping_ratios[-1])


# -- NLvib's examples ------------------------------------------------------------------------------

MU, GAMMA, P = 0.05, 0.1, 0.18  # damping, cubic stiffness and force of example 01


def duffing(a: float, sign: int) -> float:
    """Amplitude at the frequency that the closed form of example 01 has for an amplitude."""
    root = P**2 / a**2 + MU**4 / 4 - MU**2 - 0.75 * MU**2 * GAMMA * a**2
    omega = np.sqrt(1 - MU**2 / 2 + 0.75 * GAMMA * a**2 + sign * np.sqrt(root))
    model = oscillator(CubicSpring(0.0, GAMMA), MU)
    return solve_harmonic(model, "push", P, at=[omega / TURN], harmonics=1).amplitude()[0]


@case(f"{NLVIB} 01", "Duffing, P = 0.18, upper frequency of amplitude 1", 1e-6)
def _():
    return 1.0, duffing(1.0, 1)


@case(f"{NLVIB} 01", "the same, lower frequency of amplitude 1", 1e-6)
def _():
    return 1.0, duffing(1.0, -1)


@case(f"{NLVIB} 01", "the same, lower frequency of amplitude 2", 1e-6)
def _():
    return 2.0, duffing(2.0, -1)


@case(f"{NLVIB} 01", "the same, largest amplitude", 1e-5)
def _():
    # Where the root of `duffing` vanishes.
    peak = np.sqrt(np.roots([0.75 * MU**2 * GAMMA, MU**2 - MU**4 / 4, -(P**2)]).max())
    model, band = oscillator(CubicSpring(0.0, GAMMA), MU), (0.5 / TURN, 1.6 / TURN)
    return peak, solve_harmonic(model, "push", P, band, harmonics=1).peak.amplitude


@case(f"{NLVIB} 02", "absorber at 0.11 N and 1.05 rad/s, rms by shooting", 1e-6)
def _():
    model, omega = absorber(), 1.05
    joints = [(p.rows[0, 0], float(p.law.parameters["k3"])) for p in model.interfaces]
    inverse = np.linalg.inv(model.M)

    def rate(t, y):
        u, v = y[:2], y[2:]
        spring = sum(k * (r @ u) ** 3 * r for r, k in joints)
        load = 0.11 * np.cos(omega * t) * model.forces["push"]
        return [*v, *(inverse @ (load - model.C @ v - model.K @ u - spring))]

    T, options = TURN / omega, {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11}
    steady = solve_ivp(rate, (0, 150 * T), np.zeros(4), **options).y[:, -1]
    times = np.linspace(0, T, 2001)[:-1]
    last = solve_ivp(rate, (0, T), steady, t_eval=times, **options)
    found = solve_harmonic(model, "push", 0.11, at=[omega / TURN], harmonics=7)
    ours = np.linalg.norm(found.coefficients[0, 0, 1:]) / np.sqrt(2)
    return np.sqrt(np.mean(last.y[0] ** 2)), ours


def in_phase(a: float) -> float:
    """Example 04's first mode, by one harmonic."""
    model = two_masses(CubicSpring(0.0, 0.5), [1, 1], [[2.0, -1.0], [-1.0, 2.0]], at=0)
    return mode(model, a, sensor="second")


@case(f"{NLVIB} 04", "two masses, cubic spring, first mode at 0.01, rad/s", 1e-4)
def _():
    return 1.0, in_phase(0.01)


@case(f"{NLVIB} 04", "the same at 1,000: the mass at the spring held, rad/s", 5e-3)
def _():
    return np.sqrt(2.0), in_phase(1000.0)


RUBBED = np.array([[40.0, -40.0], [-40.0, 640.0]])


def rubbing(low: float, high: float, harmonics: int) -> float:
    """Example 05's mode: tanh friction on a light mass beside a heavy one."""
    model = two_masses(RateDamping(strength=5.0, smoothing=0.05), [0.02, 1.0], RUBBED, at=0)
    found = solve_backbone(model, (low, high), harmonics=harmonics, sensor="second")
    return TURN * found.frequencies_hz[-1]


@case(f"{NLVIB} 05", "tanh friction, mode at 0.001: stuck, rad/s", 5e-3)
def _():
    return np.sqrt(640.0), rubbing(0.5e-3, 1e-3, 9)


@case(f"{NLVIB} 05", "tanh friction, mode at 1,000: free, rad/s", 1e-4)
def _():
    light = np.diag([0.02**-0.5, 1.0])
    return np.sqrt(np.linalg.eigvalsh(light @ RUBBED @ light)[0]), rubbing(100.0, 1000.0, 5)


@case(f"{NLVIB} 09", "beam with a cubic spring, mode at 1e-7 m, Hz", 1e-5)
def _():
    length, h, E, rho, n_nodes = 0.7, 0.014, 2.05e11, 7800.0, 20
    a = length / (n_nodes - 1)
    bending = [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
    inertia = [[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]
    turns = np.diag([1.0, a, 1.0, a])
    K, M = np.zeros((2, 2 * n_nodes, 2 * n_nodes))
    for i in range(n_nodes - 1):
        own = slice(2 * i, 2 * i + 4)
        K[own, own] += E * h**4 / 12 / a**3 * turns @ bending @ turns
        M[own, own] += rho * h**2 * a / 420 * turns @ inertia @ turns
    K, M = K[2:, 2:], M[2:, 2:]  # clamped
    tip = np.eye(len(K))[-2]
    joint = InterfacePoints("tip", CubicSpring(0.0, 6e9), tip[None, None], np.ones(1))
    model = InterfaceModel(M, K, (joint,), None, {"tip": tip}, {"tip": tip})
    found = solve_backbone(model, (1e-8, 1e-7), harmonics=1, sensor="tip")
    closed = 1.875104069**2 / TURN / length**2 * np.sqrt(E * h**2 / 12 / rho)
    return closed, found.frequencies_hz[-1]


# -- tmdsimpy's tests and examples -----------------------------------------------------------------


@case(f"{TMD} cubic_damping", "cubic damping, first harmonic 3/4 c (w a)^3", 1e-9)
def _():
    return 0.75 * 0.7 * (1.3 * 0.9) ** 3, -force(RateDamping(0.0, 0.7), 0.9, 1, omega=1.3)[1]


@case(f"{TMD} cubic_damping", "the same, third harmonic 1/4 c (w a)^3", 1e-9)
def _():
    return 0.25 * 0.7 * (1.3 * 0.9) ** 3, force(RateDamping(0.0, 0.7), 0.9, 3, omega=1.3)[1]


class Quintic(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * slip[0] ** 5]), None


@case(f"{TMD} quintic_stiffness", "quintic spring k = 3 at 1.2, first harmonic 10/16 k a^5", 1e-12)
def _():
    return 10 / 16 * 3 * 1.2**5, force(Quintic(k=3.0), 1.2, 1, None)[0]


@case(f"{TMD} quintic_stiffness", "the same, third harmonic 5/16 k a^5", 1e-12)
def _():
    return 5 / 16 * 3 * 1.2**5, force(Quintic(k=3.0), 1.2, 3, None)[0]


@case(f"{TMD} unilateral_spring", "unilateral spring k = 1, offset 0.3, at 1.3", 1e-12)
def _():
    return 1.0, force_at(UnilateralSpring(1.0, 0.3), 1.3)


@case(f"{TMD} unilateral_spring", "unilateral spring k = 3, offset 0.3, at 1.3", 1e-12)
def _():
    return 3.0, force_at(UnilateralSpring(3.0, 0.3), 1.3)


IWAN = Segalman(F_S=3.0, K_T=2.0, chi=-0.1, beta=0.1)
SHARE = IWAN.beta + (IWAN.chi + 1) / (IWAN.chi + 2)
LIMIT = IWAN.F_S * (1 + IWAN.beta) / (IWAN.K_T * SHARE)  # phi_max


@case(f"{TMD} iwan4", "four-parameter Iwan, all sliding, first harmonic 4 F/pi", 1e-3)
def _():
    return 12 / np.pi, -force(Iwan(IWAN, 24), 1e6, 1, 4096)[1]


@case(f"{TMD} iwan4", "the same, third harmonic 4 F/(3 pi)", 2e-3)
def _():
    return 4 / np.pi, abs(force(Iwan(IWAN, 24), 1e6, 3, 4096)[1])


@case(f"{TMD} iwan4", "the same, force at half of phi_max", 1e-3)
def _():
    # The integral over sliders, R phi^chi, and the rest at phi_max.
    x, chi = 0.5 * LIMIT, IWAN.chi
    R = IWAN.F_S * (chi + 1) / (LIMIT ** (chi + 2) * SHARE)
    below = quad(lambda y: R * y ** (chi + 1), 0, x)[0]
    above = quad(lambda y: R * y**chi, x, LIMIT)[0] + IWAN.F_S * IWAN.beta / (LIMIT * SHARE)
    return below + x * above, force_at(Iwan(IWAN, 100), x)


JENKINS = ElasticFriction(0.25, 0.2)
#: What slides of a motion of 1.5, and the angle at which it begins to.
SLID = 0.2 / (0.25 * 1.5)
ANGLE = np.arccos(1 - 2 * SLID)


@case(f"{TMD} jenkins", "Jenkins k = 0.25, F = 0.2, in phase at 1.5", 1e-4)
def _():
    closed = 0.25 * 1.5 / np.pi * (ANGLE - 0.5 * np.sin(2 * ANGLE))
    return closed, force(JENKINS, 1.5, 1, 4096)[0]


@case(f"{TMD} jenkins", "the same, out of phase", 1e-4)
def _():
    return 4 * 0.2 * (1 - SLID) / np.pi, -force(JENKINS, 1.5, 1, 4096)[1]


@case(f"{TMD} epmc", "EPMC, Duffing, H = 1, amplitude 2, rad/s", 1e-8)
def _():
    return 2.0, mode(oscillator(CubicSpring(0.0, 1.0), 0.01), 2.0)


@case(f"{TMD} epmc", "the same, damping ratio", 1e-8)
def _():
    return 0.01 / 4.0, mode(oscillator(CubicSpring(0.0, 1.0), 0.01), 2.0, what="zeta")


@case(f"{TMD} epmc", "EPMC, cubic damping 0.03, amplitude 1, damping ratio", 1e-8)
def _():
    model = oscillator(RateDamping(0.0, 0.03), 0.01)
    return (0.01 + 0.75 * 0.03) / 2, mode(model, 1.0, what="zeta")


@case(f"{TMD} epmc", "EPMC, Jenkins stuck, rad/s", 1e-8)
def _():
    return np.sqrt(1.25), mode(oscillator(JENKINS, 0.01), 0.1)


@case(f"{TMD} epmc", "EPMC, Jenkins sliding at 1,000, rad/s", 1e-3)
def _():
    return 1.0, mode(oscillator(JENKINS, 0.01), 1000.0, samples=512)


@case(f"{TMD} epmc", "EPMC, two masses and a cubic spring at 1,000, rad/s", 5e-3)
def _():
    model = two_masses(CubicSpring(0.0, 0.5), [1, 1], [[2, -1], [-1, 2]])
    return np.sqrt(2.0), mode(model, 1000.0, sensor="first")


@case(f"{TMD} vprnm", "Duffing, third harmonic behind its excitation, rad", 1e-6)
def _():
    model = oscillator(CubicSpring(0.0, 1.0), 0.01)
    result = solve_harmonic(model, "push", 0.3, (0.3 / TURN, 0.45 / TURN), harmonics=5)
    X = track_resonance(result, 3, (0.3, 0.4)).coefficients[-1, 0]
    first, third = (np.angle(X[k] - 1j * X[k + 1]) for k in (1, 5))
    return np.pi / 2, (np.pi + 3 * first - third) % TURN


def rubbing_block() -> InterfaceModel:
    """The 2-D elastic dry friction of its example: tangential and normal directions."""
    directions = np.array([[[0.0, -1.0], [1.0, 0.0]]])  # opening, slip
    law, axes = CoulombStick(21.0, 5.0, 0.85), np.eye(2)
    joint = InterfacePoints("contact", law, directions, np.ones(1), True)
    names = {"slip": axes[0], "press": axes[1]}
    return InterfaceModel(axes, np.diag([12.0, 21.0]), (joint,), None, names, names)


PRESS = np.array([0.0, 100.0])


@case(f"{TMD} 2dof_eldry_fric", "elastic dry friction in 2-D, static press, m", 1e-9)
def _():
    return 100 / 42, static_state(rubbing_block(), PRESS)[0][1]


@case(f"{TMD} 2dof_eldry_fric", "the same, mode while it sticks, rad/s", 1e-6)
def _():
    found = mode(rubbing_block(), 2e-4, sensor="slip", static=PRESS)
    return np.sqrt(17.0), found


# -- Code_Aster's SDND tests -----------------------------------------------------------------------


@cache
def shock() -> tuple[float, float]:
    """SDND101: 100 kg on 1e4 N/m, with 1 m/s against a stop of 1e6 N/m that it touches."""
    model, step = mass_on_spring(100.0, 1e4, UnilateralSpring(1e6, 0.0)), 2e-5
    start = np.zeros(1), np.ones(1), None
    found = solve_transient(model, step=step, n_steps=1700, initial=start, sensors=["mass"])
    x = found.displacements["mass"]
    left = int(np.flatnonzero(x > 0)[-1])
    away = found.times[left] + step * x[left] / (x[left] - x[left + 1])
    return 1e6 * float(x.max()), float(away)


@case(f"{ASTER} SDND101", "mass against a stop, largest force, N", 1e-4)
def _():
    return 1e6 / np.sqrt(1.01e6 / 100), shock()[0]


@case(f"{ASTER} SDND101", "the same, it leaves after, s", 1e-3)
def _():
    return np.pi / np.sqrt(1.01e6 / 100), shock()[1]


def stop_mode(low: float, high: float) -> tuple[float, float]:
    """SDND122, 1 kg on a spring with a wall at a gap: its frequency in closed form and ours, Hz."""
    k, K, e = 10.0, 50.0, 0.01
    found = solve_backbone(
        mass_on_spring(1.0, k, UnilateralSpring(K, e)), (low, high), harmonics=25
    )
    X, hz = found.coefficients[-1, 0], found.frequencies_hz[-1]
    h = np.arange(1, len(X) // 2 + 1)
    x, v = X[0] + X[1::2].sum(), TURN * hz * h @ X[2::2]
    energy = 0.5 * v**2 + 0.5 * k * x**2 + 0.5 * K * max(x - e, 0) ** 2
    # The impact lasts from and to the wall, at both speeds alike, about the place where both
    # springs rest.
    free = 2 / np.sqrt(k) * np.arccos(-e * np.sqrt(k / (2 * energy)))
    middle, omega = K * e / (k + K), np.sqrt(k + K)
    speed = np.sqrt(2 * energy - k * e**2)
    pressed = 2 / omega * np.arctan2(speed / omega, e - middle)
    return 1 / (free + pressed), hz


@case(f"{ASTER} SDND122", "mode of a mass with a wall at a gap, Hz", 1e-4)
def _():
    return stop_mode(0.005, 0.015)


@case(f"{ASTER} SDND122", "the same at a higher energy, Hz", 1e-4)
def _():
    return stop_mode(0.005, 0.03)


@cache
def pad() -> np.ndarray:
    """SDND100: a pad on a spring, let go 0.85 mm away, on dry ground of 1 N: its motion, m."""
    model = mass_on_spring(1.0, 1e4, ElasticFriction(1e7, 1.0))
    # The ground yields by a ten-thousandth of a millimetre: at the start it is drawn.
    start = np.array([8.5e-4]), np.zeros(1), None
    found = solve_transient(model, step=2e-5, n_steps=8000, initial=start, sensors=["mass"])
    return found.displacements["mass"]


@case(f"{ASTER} SDND100", "pad let go on dry ground, first turn, m", 5e-3)
def _():
    x = pad()
    return -6.5e-4, x[1:-1][np.diff(np.sign(np.diff(x))) != 0][0]


@case(f"{ASTER} SDND100", "the same, where it stops, m", 0.05)
def _():
    return 5e-5, np.mean(pad()[-500:])


# -- closed forms and shooting ---------------------------------------------------------------------


def duffing_mode(a: float) -> float:
    """Frequency of x'' + x + x^3 over the exact one."""
    found = solve_backbone(oscillator(CubicSpring(0.0, 1.0), 0.0), (1e-3, a), harmonics=15)
    a = float(found.amplitude(measure="peak")[-1])
    exact = np.pi * np.sqrt(1 + a**2) / (2 * ellipk(a**2 / (2 * (1 + a**2))))
    return TURN * found.frequencies_hz[-1] / exact


@case("elliptic integral", "Duffing's exact period at 2, ours over it, H = 15", 1e-8)
def _():
    return 1.0, duffing_mode(2.0)


@case("elliptic integral", "Duffing's exact period at 100, ours over it, H = 15", 1e-7)
def _():
    return 1.0, duffing_mode(100.0)


@case("Gelb and Vander Velde 1968", "gap of 0.4 in a motion of 1.1, stiffness over k", 1e-9)
def _():
    r = 4 / 11
    closed = 1 - 2 / np.pi * (np.arcsin(r) + r * np.sqrt(1 - r**2))
    return closed, force(GapSpring(3.0, 0.4), 1.1, 1)[0] / 3.3


@cache
def static_iwan():
    """Quasi-static modes of a mass on a spring and an Iwan joint."""
    low, high = 0.01 * LIMIT, 0.2 * LIMIT
    law = Iwan(IWAN, 60, amplitudes=(0.3 * low, 3 * high))
    return solve_static_backbone(oscillator(law, 0.0), (low, high))


@case("Segalman 2005", "quasi-static mode on an Iwan joint, frequency over the secant's", 1e-3)
def _():
    found = static_iwan()
    secant = IWAN.secant(found.amplitude()[-1])
    return 1.0, TURN * found.frequencies_hz[-1] / np.sqrt(1 + secant)


@case("Segalman 2005", "the same, energy over Masing's, mean of the amplitudes", 5e-3)
def _():
    found = static_iwan()
    return 1.0, np.mean(found.energies / IWAN.dissipation(found.amplitude()))


@cache
def cusp():
    model = oscillator(CubicSpring(0.0, 1.0), 0.1)
    result = solve_harmonic(model, "push", 0.3, (0.7 / TURN, 3 / TURN), harmonics=1)
    fold = next(b for b in find_bifurcations(result).bifurcations if b.kind == "fold")
    (turn,) = track_folds(result, fold, (0.01, 0.4), direction="down").turns
    return TURN * turn.frequency_hz, turn.force


CUSP = (np.sqrt(3) * 0.1 + np.sqrt(3 * 0.01 + 4)) / 2


@case("closed form", "Duffing's cusp by one harmonic, c = 0.1, rad/s", 1e-6)
def _():
    return CUSP, cusp()[0]


@case("closed form", "the same, force, N", 1e-6)
def _():
    return 0.2 * CUSP * np.sqrt(8 * np.sqrt(3) * 0.1 * CUSP / 27), cusp()[1]


@case("shooting, Thompson 1989", "escape from a well, period doubles at, rad/s", 1e-4)
def _():
    # Down to the resonance from above: another motion is beside it.
    band = (0.65 / TURN, 0.9 / TURN)
    branch = solve_harmonic(escape(), "push", 0.06, band, harmonics=11, direction="down")
    found = find_bifurcations(branch, tolerance=1e-6)
    return escape_by_shooting(branch), TURN * found.bifurcations[0].frequency_hz


def escape_by_shooting(branch) -> float:
    """Frequency at which a multiplier of the escape oscillator is -1, from a response near it."""

    def period(omega: float, y: np.ndarray):
        def rate(t, y):
            x, v, W = y[0], y[1], y[2:].reshape(2, 2)
            A = np.array([[0.0, 1.0], [2 * x - 1, -0.1]])
            return [v, 0.06 * np.cos(omega * t) - 0.1 * v - x + x**2, *(A @ W).ravel()]

        start = np.concatenate([y, np.eye(2).ravel()])
        made = solve_ivp(rate, (0, TURN / omega), start, method="DOP853", rtol=1e-10, atol=1e-12)
        return made.y[:2, -1], made.y[2:, -1].reshape(2, 2)

    i = int(np.argmin(np.abs(branch.omegas - 0.702)))
    X, h = branch.coefficients[i, 0], np.arange(1, 12)
    y = np.array([X[0] + X[1::2].sum(), branch.omegas[i] * h @ X[2::2]])

    def crossing(omega: float) -> float:
        nonlocal y
        for _ in range(6):
            end, W = period(omega, y)
            y = y + np.linalg.solve(np.eye(2) - W, end - y)
        return float(np.linalg.eigvals(W).real.min() + 1)

    return float(brentq(crossing, 0.7, 0.703, xtol=1e-9))


@pytest.mark.slow
@pytest.mark.parametrize("row", CASES, ids=lambda row: row.name)
def test_the_number_is_theirs_and_the_pages(row):
    theirs, ours = map(float, row.numbers())
    assert ours == pytest.approx(theirs, rel=row.near)
    _, source, told, found = rows()[row.name]
    assert source == row.source
    assert float(told) == pytest.approx(theirs, rel=1e-5)
    assert float(found) == pytest.approx(ours, rel=max(1e-5, 0.1 * row.near))


def test_the_page_has_every_case():
    assert {row.name for row in CASES} == set(rows()) - {"case"}


if __name__ == "__main__":
    for row in CASES:
        numbers = " | ".join(f"{float(number):.7g}" for number in row.numbers())
        print(f"| {row.name} | {row.source} | {numbers} |", flush=True)
