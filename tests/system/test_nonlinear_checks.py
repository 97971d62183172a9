"""Nonlinear joints against others' numbers: the cases of docs/nonlinear_checks.md.

As a script it prints the rows anew (``env PYTHONPATH=tests/helpers python3 FILE``).
"""

from __future__ import annotations

import numpy as np
import pytest
from checks_page import Case, hold, rows, show
from scipy.integrate import quad
from scipy.special import ellipk

from fenics_joints.harmonic import Balance, solve_backbone, solve_harmonic, solve_static_backbone
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.joint_laws import (
    CoulombStick,
    CubicSpring,
    ElasticFriction,
    Gap,
    Iwan,
    LawKernel,
    RateDamping,
    Segalman,
    UnilateralSpring,
)

TURN = 2 * np.pi
NLVIB, TMD = "NLvib", "tmdsimpy"


def one_mass(law, c=0.01, k=1.0) -> InterfaceModel:
    """Unit mass on a spring k, a damper c, and a law."""
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", law, one[None], np.ones(1))
    return InterfaceModel(one, k * one, (joint,), c * one, {"push": one[0]}, {"mass": one[0]})


def two_masses(law, M, K, at=1, c=0.0) -> InterfaceModel:
    """Two masses with a law to the ground at one of them, and damping c M."""
    axes, M = np.eye(2), np.diag(M).astype(float)
    joint = InterfacePoints("joint", law, axes[at].reshape(1, 1, 2), np.ones(1))
    names = {"first": axes[0], "second": axes[1]}
    return InterfaceModel(M, np.array(K, float), (joint,), c * M, names, names)


def force(law, a, harmonic, samples=1024, omega=1.0) -> np.ndarray:
    """Cosine and sine of a law's force on a cosine of amplitude a."""
    balance = Balance(one_mass(law), 5, samples=samples)
    X = np.zeros(balance.shape)
    X[0, 1] = a
    return balance.interface_force(X, omega)[0][0, 2 * harmonic - 1 : 2 * harmonic + 1]


def mode(model, a, harmonics=1, sensor=None, samples=None, what="omega") -> float:
    """Frequency, rad/s, or damping of a mode near an amplitude."""
    found = solve_backbone(model, (0.5 * a, a), harmonics=harmonics, sensor=sensor, samples=samples)
    return float(TURN * found.frequencies_hz[-1] if what == "omega" else found.damping_ratios[-1])


# -- NLvib's examples ------------------------------------------------------------------------------

MU, KAPPA, GAMMA, P = 0.05, 1.0, 0.1, 0.18  # damping, stiffness, cubic stiffness, force


def duffing_omega(a: float, sign: int) -> float:
    """Example 01's frequency by one harmonic."""
    root = P**2 / a**2 + MU**4 / 4 - MU**2 - 0.75 * MU**2 * GAMMA * a**2
    return float(np.sqrt(1 - MU**2 / 2 + 0.75 * GAMMA * a**2 + sign * np.sqrt(root)))


def duffing_peak() -> float:
    """Where the root above vanishes."""
    return float(np.sqrt(np.roots([0.75 * MU**2 * GAMMA, MU**2 - MU**4 / 4, -(P**2)]).max()))


def duffing_response(omega: float) -> float:
    model = one_mass(CubicSpring(0.0, GAMMA), MU)
    return float(solve_harmonic(model, "push", P, at=[omega / TURN], harmonics=1).amplitude()[0])


def duffing_largest() -> float:
    model = one_mass(CubicSpring(0.0, GAMMA), MU)
    band = (0.5 / TURN, 1.6 / TURN)
    return solve_harmonic(model, "push", P, band, harmonics=1).peak.amplitude


def rubbing(a: float) -> float:
    """Example 05's mode: tanh friction on a light mass beside a heavy one."""
    law = RateDamping(strength=5.0, smoothing=0.05)
    model = two_masses(law, [0.02, 1.0], [[40.0, -40.0], [-40.0, 640.0]], at=0)
    found = solve_backbone(model, (min(1e-3, 0.5 * a), a), harmonics=9, sensor="second")
    return float(TURN * found.frequencies_hz[-1])


def in_phase(a: float) -> float:
    """Example 04's first mode, by one harmonic."""
    model = two_masses(CubicSpring(0.0, 0.5), [1, 1], [[2.0, -1.0], [-1.0, 2.0]], at=0)
    return mode(model, a, sensor="second")


# -- tmdsimpy's tests and examples -----------------------------------------------------------------

IWAN = Segalman(F_S=3.0, K_T=2.0, chi=-0.1, beta=0.1)


def iwan_limit() -> float:
    """phi_max of Segalman's joint."""
    share = IWAN.beta + (IWAN.chi + 1) / (IWAN.chi + 2)
    return IWAN.F_S * (1 + IWAN.beta) / (IWAN.K_T * share)


def iwan_backbone(x: float) -> float:
    """Its force by the integral over sliders, R phi^chi and the rest at phi_max."""
    top, chi = iwan_limit(), IWAN.chi
    R = IWAN.F_S * (chi + 1) / (top ** (chi + 2) * (IWAN.beta + (chi + 1) / (chi + 2)))
    S = IWAN.F_S * IWAN.beta / (top * (IWAN.beta + (chi + 1) / (chi + 2)))
    below = quad(lambda y: R * y ** (chi + 1), 0, x)[0]
    return below + x * (quad(lambda y: R * y**chi, x, top)[0] + S)


def iwan_force(x: float) -> float:
    law = Iwan(IWAN, 100)
    kernel = LawKernel.of(law, 1, False)
    return float(kernel.step(np.array([[x]]), None, law.values(1))[0][0, 0])


def stop_force(k: float, gap: float, x: float) -> float:
    law = UnilateralSpring(k, gap)
    kernel = LawKernel.of(law, 1, False)
    return float(kernel.step(np.array([[x]]), None, law.values(1))[0][0, 0])


def rubbing_block(friction=0.85) -> InterfaceModel:
    """The 2-D elastic dry friction of its example: tangential and normal directions."""
    rows = np.array([[[0.0, -1.0], [1.0, 0.0]]])  # opening, slip
    joint = InterfacePoints("contact", CoulombStick(21.0, 5.0, friction), rows, np.ones(1), True)
    axes = np.eye(2)
    names = {"slip": axes[0], "press": axes[1]}
    return InterfaceModel(axes, np.diag([12.0, 21.0]), (joint,), None, names, names)


def pressed_down() -> float:
    return float(static_state(rubbing_block(), np.array([0.0, 100.0]))[0][1])


def stuck_frequency() -> float:
    found = solve_backbone(
        rubbing_block(), (1e-4, 2e-4), static=np.array([0.0, 100.0]), sensor="slip", harmonics=1
    )
    return float(TURN * found.frequencies_hz[-1])


JENKINS = ElasticFriction(0.25, 0.2)


def jenkins_harmonic(a: float) -> np.ndarray:
    """First harmonic of a spring with a slider."""
    r = 0.2 / (0.25 * a)
    turn = np.arccos(1 - 2 * r)
    return np.array([0.25 * a / np.pi * (turn - 0.5 * np.sin(2 * turn)), 4 * 0.2 * (1 - r) / np.pi])


# -- closed forms ----------------------------------------------------------------------------------


def duffing_period(a: float) -> float:
    """Exact frequency of x'' + x + x^3."""
    return float(np.pi * np.sqrt(1 + a**2) / (2 * ellipk(a**2 / (2 * (1 + a**2)))))


def duffing_mode(a: float) -> float:
    found = solve_backbone(one_mass(CubicSpring(0.0, 1.0), 0.0), (1e-3, a), harmonics=15)
    exact = duffing_period(float(found.amplitude(measure="peak")[-1]))
    return float(TURN * found.frequencies_hz[-1]) / exact


SMALL = (0.01 * iwan_limit(), 0.2 * iwan_limit())


def static_iwan(what: str) -> float:
    """Quasi-static mode of a mass on a spring and an Iwan joint, over its closed form."""
    law = Iwan(IWAN, 60, amplitudes=(0.3 * SMALL[0], 3 * SMALL[1]))
    found = solve_static_backbone(one_mass(law, 0.0), SMALL)
    a = found.amplitude()[-1]
    if what == "omega":
        return float(TURN * found.frequencies_hz[-1] / np.sqrt(1 + IWAN.secant(a)))
    exact = IWAN.dissipation(found.amplitude())
    return float(np.mean(found.energies / exact))


CASES = [
    Case(
        "Duffing, P = 0.18, upper frequency of amplitude 1",
        f"{NLVIB} 01",
        lambda: 1.0,
        lambda: duffing_response(duffing_omega(1.0, 1)),
        1e-6,
    ),
    Case(
        "the same, lower frequency of amplitude 1",
        f"{NLVIB} 01",
        lambda: 1.0,
        lambda: duffing_response(duffing_omega(1.0, -1)),
        1e-6,
    ),
    Case(
        "the same, lower frequency of amplitude 2",
        f"{NLVIB} 01",
        lambda: 2.0,
        lambda: duffing_response(duffing_omega(2.0, -1)),
        1e-6,
    ),
    Case("the same, largest amplitude", f"{NLVIB} 01", duffing_peak, duffing_largest, 1e-5),
    Case(
        "two masses, cubic spring, first mode at 0.01, rad/s",
        f"{NLVIB} 04",
        lambda: 1.0,
        lambda: in_phase(0.01),
        1e-4,
    ),
    Case(
        "the same at 1,000: the mass at the spring held, rad/s",
        f"{NLVIB} 04",
        lambda: np.sqrt(2.0),
        lambda: in_phase(1000.0),
        5e-3,
    ),
    Case(
        "tanh friction, mode at 0.001: stuck, rad/s",
        f"{NLVIB} 05",
        lambda: np.sqrt(640.0),
        lambda: rubbing(1e-3),
        5e-3,
    ),
    Case(
        "cubic damping, first harmonic 3/4 c (w a)^3",
        f"{TMD} cubic_damping",
        lambda: 0.75 * 0.7 * (1.3 * 0.9) ** 3,
        lambda: -force(RateDamping(0.0, 0.7), 0.9, 1, omega=1.3)[1],
        1e-9,
    ),
    Case(
        "the same, third harmonic 1/4 c (w a)^3",
        f"{TMD} cubic_damping",
        lambda: 0.25 * 0.7 * (1.3 * 0.9) ** 3,
        lambda: force(RateDamping(0.0, 0.7), 0.9, 3, omega=1.3)[1],
        1e-9,
    ),
    Case(
        "unilateral spring k = 1, offset 0.3, at 1.3",
        f"{TMD} unilateral_spring",
        lambda: 1.0,
        lambda: stop_force(1.0, 0.3, 1.3),
        1e-12,
    ),
    Case(
        "unilateral spring k = 3, offset 0.3, at 1.3",
        f"{TMD} unilateral_spring",
        lambda: 3.0,
        lambda: stop_force(3.0, 0.3, 1.3),
        1e-12,
    ),
    Case(
        "four-parameter Iwan, all sliding, first harmonic 4 F/pi",
        f"{TMD} iwan4",
        lambda: 12 / np.pi,
        lambda: -force(Iwan(IWAN, 24), 1e6, 1, 4096)[1],
        1e-3,
    ),
    Case(
        "the same, third harmonic 4 F/(3 pi)",
        f"{TMD} iwan4",
        lambda: 4 / np.pi,
        lambda: abs(force(Iwan(IWAN, 24), 1e6, 3, 4096)[1]),
        2e-3,
    ),
    Case(
        "the same, force at half of phi_max",
        f"{TMD} iwan4",
        lambda: iwan_backbone(0.5 * iwan_limit()),
        lambda: iwan_force(0.5 * iwan_limit()),
        1e-3,
    ),
    Case(
        "Jenkins k = 0.25, F = 0.2, in phase at 1.5",
        f"{TMD} jenkins",
        lambda: jenkins_harmonic(1.5)[0],
        lambda: force(JENKINS, 1.5, 1, 4096)[0],
        1e-4,
    ),
    Case(
        "the same, out of phase",
        f"{TMD} jenkins",
        lambda: jenkins_harmonic(1.5)[1],
        lambda: -force(JENKINS, 1.5, 1, 4096)[1],
        1e-4,
    ),
    Case(
        "EPMC, Duffing, H = 1, amplitude 2, rad/s",
        f"{TMD} epmc",
        lambda: 2.0,
        lambda: mode(one_mass(CubicSpring(0.0, 1.0)), 2.0),
        1e-8,
    ),
    Case(
        "the same, damping ratio",
        f"{TMD} epmc",
        lambda: 0.01 / 4.0,
        lambda: mode(one_mass(CubicSpring(0.0, 1.0)), 2.0, what="zeta"),
        1e-8,
    ),
    Case(
        "EPMC, cubic damping 0.03, amplitude 1, damping ratio",
        f"{TMD} epmc",
        lambda: (0.01 + 0.75 * 0.03) / 2,
        lambda: mode(one_mass(RateDamping(0.0, 0.03)), 1.0, what="zeta"),
        1e-8,
    ),
    Case(
        "EPMC, Jenkins stuck, rad/s",
        f"{TMD} epmc",
        lambda: np.sqrt(1.25),
        lambda: mode(one_mass(JENKINS), 0.1),
        1e-8,
    ),
    Case(
        "EPMC, Jenkins sliding at 1,000, rad/s",
        f"{TMD} epmc",
        lambda: 1.0,
        lambda: mode(one_mass(JENKINS), 1000.0, samples=512),
        1e-3,
    ),
    Case(
        "EPMC, two masses and a cubic spring at 1,000, rad/s",
        f"{TMD} epmc",
        lambda: np.sqrt(2.0),
        lambda: mode(
            two_masses(CubicSpring(0.0, 0.5), [1, 1], [[2, -1], [-1, 2]]), 1000.0, sensor="first"
        ),
        5e-3,
    ),
    Case(
        "elastic dry friction in 2-D, static press, m",
        f"{TMD} 2dof_eldry_fric",
        lambda: 100 / 42,
        pressed_down,
        1e-9,
    ),
    Case(
        "the same, mode while it sticks, rad/s",
        f"{TMD} 2dof_eldry_fric",
        lambda: np.sqrt(17.0),
        stuck_frequency,
        1e-6,
    ),
    Case(
        "Duffing's exact period at 2, ours over it, H = 15",
        "elliptic integral",
        lambda: 1.0,
        lambda: duffing_mode(2.0),
        1e-8,
    ),
    Case(
        "Duffing's exact period at 100, ours over it, H = 15",
        "elliptic integral",
        lambda: 1.0,
        lambda: duffing_mode(100.0),
        1e-7,
    ),
    Case(
        "gap of 0.4 in a motion of 1.1, stiffness over k",
        "Gelb and Vander Velde 1968",
        lambda: 1 - 2 / np.pi * (np.arcsin(4 / 11) + 4 / 11 * np.sqrt(1 - (4 / 11) ** 2)),
        lambda: force(Gap(3.0, 0.4), 1.1, 1)[0] / 3.3,
        1e-9,
    ),
    Case(
        "quasi-static mode on an Iwan joint, frequency over the secant's",
        "Segalman 2005",
        lambda: 1.0,
        lambda: static_iwan("omega"),
        1e-3,
    ),
    Case(
        "the same, energy over Masing's, mean of the amplitudes",
        "Segalman 2005",
        lambda: 1.0,
        lambda: static_iwan("energy"),
        5e-3,
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
