"""Equations of harmonic balance, laws without memory, and several loads, by other routes."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI
from oscillators import (
    BAND,
    PUSH,
    SLIDE,
    STICK,
    TURN,
    Cubic,
    Jenkins,
    block,
    jenkins,
    oscillator,
    start_of,
)
from scipy.optimize import brentq, fsolve
from shooting import steady_run

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Balance, Load, solve_harmonic
from fenics_joints.harmonic.backbone import FreeMode, PhaseResonance
from fenics_joints.harmonic.balance import Loading
from fenics_joints.harmonic.frf import ConstantResponse, ForcedResponse
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.joint_laws import (
    BoucWen,
    CoulombStick,
    CubicSpring,
    ElasticFriction,
    Iwan,
    RateDamping,
    Segalman,
    UnilateralSpring,
    Valanis,
)

RANGE = (0.12, 0.3)


def slopes(function, z, step=1e-6):
    """Derivatives by central differences, one column for each entry of z."""
    ends = [[function(z + s * d) for s in (1, -1)] for d in step * np.eye(len(z))]
    return np.stack([(up - down) / (2 * step) for up, down in ends], axis=-1)


@pytest.mark.parametrize("kind", ["forced", "response", "mode", "phase"])
def test_jacobians_are_those_of_finite_differences(kind):
    """All problems, with preload, friction under varying pressure, and sliders."""
    model = block()
    balance = Balance(model, 3, 32, static=np.array([-1.0, 0.05, 0.0]))
    rng = np.random.default_rng(1)
    X = balance.rest + 0.3 * rng.standard_normal((3, 7))
    row = model.row("forces", "x")
    load = balance.load(row)
    problem, ends = {
        "forced": (ForcedResponse(balance, Loading({0: load, 2: 0.5 * load}), 1.0), [0.9]),
        "response": (ConstantResponse(balance, row, row, 0.4, 2, 1.0), [0.3, 0.9]),
        "mode": (FreeMode(balance, row, 1.1, np.eye(3)[1]), [0.9, 0.03, -0.2]),
        "phase": (PhaseResonance(balance, row, row, 1.1, np.eye(3)[1]), [0.9, 0.3, -0.2]),
    }[kind]
    z = np.append(X.reshape(-1), ends)
    J = problem.evaluate(z)[1]
    expected = slopes(lambda z: problem.evaluate(z, jacobian=False)[0], z, 1e-7)
    assert np.abs(J - expected).max() < 1e-6 * np.abs(J).max()


@pytest.mark.parametrize("law", [ElasticFriction(1.0, 0.2), Iwan(Segalman(0.3, 1.0, -0.5, 0.2))])
def test_jacobian_of_one_direction_of_slip_is_that_of_finite_differences(law):
    """Its reversals and switches move with the motion."""
    balance = Balance(oscillator(law, 0.03), 3, 32)
    X = 0.4 * np.random.default_rng(0).standard_normal((1, 7))
    J = balance.interface_force(X)[1]
    expected = slopes(lambda x: balance.interface_force(x[None])[0][0], X[0])
    assert np.abs(J - expected).max() < 1e-6 * np.abs(J).max()


def test_what_memory_held_before_has_no_hand_in_derivatives():
    """In two directions of slip, after room full of what is no number was given back."""
    balance = Balance(block(), 3, 128, static=np.array([-1.0, 0.05, 0.0]))
    X = balance.rest + 0.3 * np.random.default_rng(1).standard_normal((3, 7))
    before = balance.interface_force(X)[1]
    for size in range(256, 16384, 16):
        held = [np.full(size, np.nan) for _ in range(4)]
        del held
    assert np.array_equal(balance.interface_force(X)[1], before)


def test_contact_that_opens_is_integrated_exactly_in_one_direction_of_slip():
    """Beside sums over many samples, whose error falls with their number."""
    rows = np.eye(2)[None]
    friction = InterfacePoints(
        "joint", CoulombStick(3.0, 2.0, 0.3, 0.5), rows, np.ones(1), normal=True
    )
    model = InterfaceModel(np.eye(2), np.eye(2), (friction,), 0.03 * np.eye(2), {}, {})
    X = np.zeros((2, 7))
    X[0, [1, 4]], X[1, [1, 2]] = (0.2, 0.1), (0.1, 0.4)

    def harmonics(samples, exact):
        f = Balance(model, 3, samples).fourier
        values, kernel = friction.law.values(1), friction.kernel
        slopes = X[None] @ f.derivative.T
        return kernel.harmonic(X[None], slopes, f.synthesis, values, exact=exact).coefficients

    summed = harmonics(1 << 15, False)
    scale = np.abs(summed).max()
    assert np.abs(harmonics(128, True) - summed).max() < 2e-5 * scale
    assert np.abs(harmonics(128, False) - summed).max() > 1e-4 * scale  # that it can fail


def test_preload_is_in_equilibrium():
    """The static state's force balance by histories of stress; motion that fades leaves it."""
    model, load = block(), np.array([-1.0, 0.25, 0.0])
    u, _ = static_state(model, load)
    force = model.K @ u
    for p in model.interfaces:
        path = np.stack([0 * p.rows @ u, p.rows @ u], axis=1)
        stress = p.kernel.history(path, None, p.law.values(len(p)))[0]
        force += np.einsum("p,pdn,pd->n", p.weights, p.rows, stress[:, -1])
    assert np.allclose(force, load, rtol=1e-8)
    balance = Balance(model, 2, 64, static=load)
    still = np.zeros(balance.shape)
    still[:, 0] = u
    assert np.abs(balance.evaluate(still, 1.0)[0]).max() < 1e-9


@pytest.mark.parallel
def test_ranks_share_the_points():
    """Residual, Jacobian, branch and loops of all ranks are those of one."""
    load = np.array([-1.0, 0.05, 0.0])
    rng = np.random.default_rng(3)
    X, made = 0.3 * rng.standard_normal((3, 7)), []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        balance = Balance(block(), 3, 32, static=load, comm=comm)
        result = solve_harmonic(
            block(), "x", 0.3, (0.2, 0.27), harmonics=2, samples=32, static=load, comm=comm
        )
        loops = result.loops(result.peak.index)["floor"]
        made.append([*balance.evaluate(X, 1.0), loops.dissipation, result.peak.amplitude])
    for one, all_ in zip(*made, strict=True):
        assert np.allclose(one, all_, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": "pull"}, "no 'pull'"),
        ({"sensor": "wall"}, "no 'wall'"),
        ({"band": (3.0, 1.0)}, "band ="),
        ({"at": [0.1]}, "either band"),
        ({"samples": 8}, "samples = 8"),
        ({"static": np.ones(2)}, "static has shape"),
        ({"direction": "left"}, "direction = 'left'"),
    ],
)
def test_wrong_requests_are_named(change, message):
    given = {"force": "push", "amplitude": PUSH, "band": BAND, **change}
    with pytest.raises(InputError, match=message):
        solve_harmonic(jenkins(), **given)


@pytest.mark.parametrize(
    "law, normal, samples",
    [
        (ElasticFriction(1.0, 0.2), False, None),
        (Iwan(Segalman(0.3, 1.0, -0.5, 0.2)), False, None),
        (BoucWen(1.0, 0.1, 2.0, 1.0), False, 512),  # whose own steps are of second order
        (Valanis(1.0, 0.1, 4.0), False, 256),
        (CoulombStick(5.0, 1.0, 0.2, 1.0), True, None),
    ],
    ids=["jenkins", "segalman", "bouc_wen", "valanis", "coulomb"],
)
def test_peak_does_not_depend_on_the_direction_of_the_sweep(law, normal, samples):
    """At a flat top the amplitude says more than the frequency."""
    if not normal:
        model = oscillator(law, 0.03)
    else:  # a mass that is pressed on a spring beside
        one, rows = np.ones((1, 1)), np.array([[[0.0], [1.0]]])
        joint = InterfacePoints("joint", law, rows, np.ones(1), normal=True)
        model = InterfaceModel(one, one, (joint,), 0.03 * one, {"push": one[0]}, {"mass": one[0]})
    up, down = (
        solve_harmonic(model, "push", 0.15, RANGE, harmonics=5, samples=samples, direction=d).peak
        for d in ("up", "down")
    )
    assert up.frequency_hz == pytest.approx(down.frequency_hz, rel=1e-5)
    assert up.amplitude == pytest.approx(down.amplitude, rel=1e-6)


def test_loop_of_jenkins_has_its_area_and_a_sticking_one_none():
    """4 S (a - S / k) of Jenkins' loop, whatever the phase; exactly zero where nothing slides."""
    k, strength, a = 1.0, 0.2, 0.47
    balance = Balance(oscillator(ElasticFriction(k, strength), 0.0), 5)
    for phase in np.linspace(0, 2 * np.pi / 128, 7):
        X = np.zeros((1, 11))
        X[0, 1:3] = a * np.cos(phase), a * np.sin(phase)
        made = balance.stresses(X)["joint"]
        F = made.coefficients[0, 0]
        energy = np.pi * (F[2] * X[0, 1] - F[1] * X[0, 2])
        assert abs(energy) == pytest.approx(4 * strength * (a - strength / k), rel=1e-7)
    stuck = solve_harmonic(
        oscillator(ElasticFriction(k, 1e6), 0.03), "push", 0.15, at=[0.2, 0.22], harmonics=5
    )
    assert not stuck.dissipation()["joint"].any()


GAP, STOP_DAMPING, STOP_PUSH = 1.0, 0.03, 0.1
BOTH = RateDamping(c1=0.1, c3=0.2, strength=0.3, smoothing=0.5)
STOP_BAND = (0.5 / (2 * np.pi), 0.8 / (2 * np.pi))


def two_masses(k):
    """NLvib's example 03: two unit masses, the first with a stop of stiffness k."""
    K = np.array([[1.0, -1.0], [-1.0, 2.0]])
    law = UnilateralSpring(k, GAP) if k else CubicSpring(0.0, 0.0)
    stop = InterfacePoints("stop", law, np.array([[[1.0, 0.0]]]), np.ones(1))
    first, second = np.eye(2)
    return InterfaceModel(
        np.eye(2),
        K,
        (stop,),
        STOP_DAMPING * K,
        {"push": second},
        {"first": first, "second": second},
    )


def test_harmonics_of_a_stop_are_the_closed_form():
    """Of max(cos - cos c, 0): its mean, and its harmonics by products of cosines."""
    k, c, h = 3.0, 0.7, np.arange(2, 8)
    balance = Balance(oscillator(UnilateralSpring(stiffness=k, gap=2 * np.cos(c)), 0.1), 7)
    X = np.zeros(balance.shape)
    X[0, 1] = 2.0
    F = balance.interface_force(X)[0][0]
    mean = (np.sin(c) - c * np.cos(c)) / np.pi
    first = (c - np.sin(c) * np.cos(c)) / np.pi
    high = 2 * (np.sin(h * c) * np.cos(c) - h * np.cos(h * c) * np.sin(c))
    high /= np.pi * h * (h**2 - 1)
    expected = 2 * k * np.array([mean, first, *high])
    assert np.allclose(F[[0, *range(1, 15, 2)]], expected, rtol=0, atol=1e-9)
    assert np.abs(F[2::2]).max() < 1e-9


def test_a_touch_between_two_samples_is_seen():
    """A motion that is beyond the gap for a hundredth of a sample's step, and its Jacobian."""
    balance = Balance(oscillator(UnilateralSpring(stiffness=1.0, gap=1.0), 0.1), 2)
    step = 2 * np.pi / balance.fourier.samples
    c, X = 0.005 * step, np.zeros(balance.shape)
    X[0, 1:3] = np.array([np.cos(0.4 * step), np.sin(0.4 * step)]) / np.cos(c)
    F = balance.interface_force(X)[0][0]
    expected = (np.sin(c) - c * np.cos(c)) / (np.pi * np.cos(c))
    assert F[0] == pytest.approx(expected, rel=1e-3) and F[0] > 0


def linear_flow(k, omega):
    """State (x, v, cos, sin, 1) over time, in and out of contact, as matrices of its rate."""
    m = two_masses(k)
    found = []
    for touching in (False, True):
        K = m.K + np.diag([k * touching, 0.0])
        A = np.zeros((7, 7))
        A[:2, 2:4], A[2:4, :2], A[2:4, 2:4] = np.eye(2), -K, -m.C
        A[3, 4], A[2, 6] = STOP_PUSH, k * touching * GAP
        A[4, 5], A[5, 4] = -omega, omega
        found.append(A)
    return found


def crossing(A, state, longest):
    """When the first mass is at the stop."""
    return brentq(lambda t: (scipy.linalg.expm(t * A) @ state)[0] - GAP, 0.0, longest, xtol=1e-15)


def period_later(y, k, omega, samples=400):
    """The state a period later, exact between contacts, and the amplitude of the second mass."""
    flows = linear_flow(k, omega)
    step = 2 * np.pi / omega / samples
    steps = [scipy.linalg.expm(step * A) for A in flows]
    state, coefficient = np.concatenate([y, [1.0, 0.0, 1.0]]), 0.0
    for _ in range(samples):
        left, touching = step, bool(state[0] > GAP)
        after = steps[touching] @ state
        while (after[0] > GAP) != touching and left > 1e-13:
            t = crossing(flows[touching], state, left)
            state, left = scipy.linalg.expm(t * flows[touching]) @ state, left - t
            touching = not touching
            after = scipy.linalg.expm(left * flows[touching]) @ state
        state = after
        coefficient += state[1] * (state[4] - 1j * state[5]) * 2 / samples
    return state[:4], abs(coefficient)


def first_touch():
    """Angular frequency at which the linear motion reaches the stop."""
    linear = two_masses(0.0)

    def reach(omega):
        S = linear.K + 1j * omega * linear.C - omega**2 * linear.M
        return abs(np.linalg.solve(S, [0.0, STOP_PUSH])[0]) - GAP

    return brentq(reach, 0.63, 0.8)


@pytest.mark.parametrize("k", [1e4, pytest.param(1e8, marks=pytest.mark.slow)])
def test_stiff_stops_go_through_by_default(k):
    """With two folds, the second beyond that of a softer stop."""
    result = solve_harmonic(
        two_masses(k), "push", STOP_PUSH, STOP_BAND, harmonics=21, sensor="second", direction="down"
    )
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas)))) + 1
    assert len(turns) == 2
    assert result.omegas[turns[0]] == pytest.approx(first_touch(), rel=5e-4)
    assert 0.7570 < result.omegas[turns[1]] < 0.7575  # 0.7556 at k = 100


@pytest.mark.parametrize("k", [1.0, 100.0])
def test_a_stop_with_a_gap_goes_through_with_the_folds_of_the_physics(k):
    """NLvib's example 03 with what it asks for (k = 100, H = 21), by default.

    Two folds: where the stop is first met, and where the branch gives way, which is that of
    the motion by exact steps from contact to contact.
    """
    result = solve_harmonic(
        two_masses(k), "push", STOP_PUSH, STOP_BAND, harmonics=21, sensor="second", direction="down"
    )
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas)))) + 1
    assert len(turns) == 2 and len(result) < 150
    assert result.omegas[turns[0]] == pytest.approx(first_touch(), rel=5e-4)
    for i in (turns[1] - 3, turns[1], turns[1] + 3):
        omega, X = result.omegas[i], result.coefficients[i]
        start = start_of(X, omega)
        found, _, flag, words = fsolve(
            lambda y, w=omega: period_later(y, k, w)[0] - y, start, full_output=True
        )
        if i != turns[1]:
            assert flag == 1, words
        amplitude = period_later(found, k, omega)[1]
        assert result.amplitude()[i] == pytest.approx(amplitude, rel=2e-3)


def test_energy_of_cubic_damping_is_the_closed_form():
    """3 pi c3 w^3 a^4 / 4 in a cycle, and pi c1 w a^2 of the viscous part."""
    a, omega, c1, c3 = 0.7, 1.3, 0.1, 0.4
    balance = Balance(oscillator(RateDamping(c1, c3), 0.0), 3)
    X = np.zeros(balance.shape)
    X[0, 1] = a
    F = balance.interface_force(X, omega)[0][0]
    energy = -np.pi * a * F[2]
    expected = np.pi * c1 * omega * a**2 + 0.75 * np.pi * c3 * omega**3 * a**4
    assert energy == pytest.approx(expected, rel=1e-12)
    # sin^3 = (3 sin - sin 3) / 4.
    assert F[6] == pytest.approx(c3 * (omega * a) ** 3 / 4, rel=1e-12)


def test_jacobians_by_motion_and_frequency():
    """Against central differences."""
    balance = Balance(oscillator(BOTH, 0.05), 4)
    X, omega = np.random.default_rng(0).standard_normal(balance.shape), 1.1

    def residual(z):
        return balance.evaluate(z[:-1].reshape(X.shape), z[-1], jacobian=False)[0].ravel()

    J = [balance.evaluate(X, omega)[1], balance.by_omega(X, omega).ravel()]
    assert np.allclose(np.column_stack(J), slopes(residual, np.append(X, omega)), atol=1e-7)


def test_response_is_that_of_time_integration():
    """Viscous, cubic and smoothed friction together, off resonance and at it; and its energy."""
    model, frequency = oscillator(BOTH, 0.02), 1 / (2 * np.pi)
    result = solve_harmonic(model, "push", 1.0, at=[frequency], harmonics=9)
    run, steady = steady_run(model, result, {"push": np.cos}, periods=6)
    found = result.sensor_coefficients("mass")[0]
    assert np.abs(found[:7] - steady["mass"]).max() < 1e-3 * np.abs(steady["mass"]).max()
    viscous = 0.02 * np.pi * (np.arange(1, 10) ** 2 @ (found[1::2] ** 2 + found[2::2] ** 2))
    taken = result.dissipation()["joint"][0]
    assert taken + viscous == pytest.approx(result.force_work()[0], rel=1e-6)
    last = run.joint_work["joint"]
    assert last[-1] - last[-401] == pytest.approx(taken, rel=2e-3)


MORE = (Load("push", 0.3, 3, 0.4), Load("push", 0.1, 1, -1.1))


def test_loads_of_harmonics_and_phases_superpose():
    """The receptance at each harmonic times its load."""
    linear = oscillator(Cubic(k=0.0), 0.1)
    found = solve_harmonic(linear, "push", 0.2, at=[0.2], more=MORE)
    omega, c = found.omegas[0], found.sensor_coefficients("mass")[0]
    for h, force in ((1, 0.2 + 0.1 * np.exp(-1.1j)), (3, 0.3 * np.exp(0.4j))):
        x = force / (1 + 0.1j * h * omega - (h * omega) ** 2)
        assert c[2 * h - 1] - 1j * c[2 * h] == pytest.approx(x, rel=1e-9)
    with pytest.raises(InputError, match="load.harmonic = 7"):
        solve_harmonic(linear, "push", 0.2, at=[0.2], more=[Load("push", 1.0, 7)])


def test_what_loads_put_in_friction_and_damping_take():
    """Along a branch with sliding."""
    model = oscillator(Jenkins(k=STICK, s=SLIDE), 0.05)
    found = solve_harmonic(model, "push", 0.2, BAND, more=MORE)
    i, h = found.peak.index, np.arange(1, 6)
    X = found.coefficients[i, 0]
    viscous = 0.05 * found.omegas[i] * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    taken = found.dissipation([i])["joint"][0] + viscous
    assert found.force_work()[i] == pytest.approx(taken, rel=1e-6)


def test_loads_that_grow_with_the_frequency_follow_their_branch():
    """An unbalance on Duffing's spring, by one harmonic in closed form, through the fold."""
    m, c = 0.05, 0.05
    found = solve_harmonic(
        oscillator(Cubic(k=1.0), c), "push", m, BAND, power=2, harmonics=1, direction="up"
    )
    a, w2 = found.amplitude(), found.omegas**2
    left = ((1 - w2 + 0.75 * a**2) ** 2 + c**2 * w2) * a**2
    assert np.allclose(left, (m * w2) ** 2, rtol=1e-7)
    assert (np.diff(found.omegas) < 0).any()
    work = np.pi * c * found.omegas * a**2
    assert np.allclose(found.force_work(), work, rtol=1e-7)
    # Of a higher harmonic too, as of a base that moves so.
    linear = oscillator(Cubic(k=0.0), c)
    two = solve_harmonic(linear, "push", 0.1, at=[0.2], more=[Load("push", 0.3, 3, 0.4, 2)])
    omega, x = 3 * two.omegas[0], two.sensor_coefficients("mass")[0][5:7] @ [1, -1j]
    exact = 0.3 * omega**2 * np.exp(0.4j) / (1 + 1j * c * omega - omega**2)
    assert x == pytest.approx(exact, rel=1e-9)


def test_two_places_with_a_phase_between_them_are_those_of_time_integration():
    """Two masses on cubic springs, pushed a quarter of a cycle apart, the second at twice it."""
    one = np.eye(2)
    spring = InterfacePoints("spring", Cubic(k=0.4), one[0].reshape(1, 1, 2), np.ones(1))
    K = np.array([[2.0, -1.0], [-1.0, 2.0]])
    model = InterfaceModel(
        one, K, (spring,), 0.1 * K, {"a": one[0], "b": one[1]}, {"a": one[0], "b": one[1]}
    )
    w = 0.8
    more = [Load("b", 0.5, 1, np.pi / 2), Load("b", 0.4, 2, 0.3)]
    found = solve_harmonic(model, "a", 0.5, at=[w / TURN], harmonics=7, more=more)
    loads = {
        "a": lambda t: 0.5 * np.cos(w * t),
        "b": lambda t: 0.5 * np.cos(w * t + np.pi / 2) + 0.4 * np.cos(2 * w * t + 0.3),
    }
    _, steady = steady_run(model, found, loads, periods=9)
    for place in ("a", "b"):
        c = found.sensor_coefficients(place)[0][:7]
        assert np.abs(c - steady[place]).max() < 1e-3 * np.abs(steady[place]).max()
