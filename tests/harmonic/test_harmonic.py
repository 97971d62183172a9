"""Harmonic balance against closed forms, time integration, and itself by other ways."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, minimize_scalar
from scipy.special import ellipk

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic import (
    Balance,
    Settings,
    solve_backbone,
    solve_constant_response,
    solve_harmonic,
    stable,
)
from fenics_joints.harmonic.backbone import FreeMode, PhaseResonance
from fenics_joints.harmonic.constant_response import ConstantResponse
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.joint_laws import CoulombStick, Iwan, JointLaw, Segalman
from fenics_joints.transient import solve_transient, steady_harmonics

BAND = (0.5 / (2 * np.pi), 3 / (2 * np.pi))
CUBIC, FORCE, DAMPING = 1.0, 0.05, 0.02  # of the Duffing oscillator
STICK, SLIDE, PUSH, VISCOUS = 1.0, 0.2, 0.2, 0.05  # of the Jenkins oscillator


class Cubic(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * slip[0] ** 3]), None


class Jenkins(JointLaw):
    def state_size(self, n_slip):
        return n_slip

    def element(self, normal, slip, state, p):
        trial = p["k"] * (slip[0] - state[0])
        slides = ufl.gt(abs(trial), p["s"])
        traction = ufl.conditional(slides, p["s"] * ufl.sign(trial), trial)
        new = ufl.conditional(slides, slip[0] - traction / p["k"], state[0])
        return 0, ufl.as_vector([traction]), ufl.as_vector([new])


def oscillator(law, c):
    """Unit mass on a unit spring, and the law beside it."""
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", law, one[None], np.ones(1))
    return InterfaceModel(one, one, (joint,), c * one, {"push": one[0]}, {"mass": one[0]})


def duffing():
    return oscillator(Cubic(k=CUBIC), DAMPING)


def jenkins(k=STICK, s=SLIDE):
    return oscillator(Jenkins(k=k, s=s), VISCOUS)


def block(pressure=0.0, n_points=5, seed=0):
    """A body of three directions on a spread of frictional points, and sliders beside them."""
    rng = np.random.default_rng(seed)
    rows = np.tile(np.eye(3), (n_points, 1, 1)) + 0.1 * rng.standard_normal((n_points, 3, 3))
    friction = CoulombStick(3.0, 2.0, 0.3, pressure)
    iwan = Iwan(Segalman(0.5, 2.0, -0.5, 1.0), 6)
    joints = (
        InterfacePoints("floor", friction, rows, np.full(n_points, 1 / n_points), normal=True),
        InterfacePoints("wall", iwan, rows[:2, 1:], np.array([0.4, 0.7])),
    )
    K = np.array([[1.0, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]])
    axes = np.eye(3)
    return InterfaceModel(
        np.diag([1.0, 1.2, 0.8]), K, joints, 0.03 * K, {"x": axes[1], "z": axes[0]},
        {"x": axes[1], "y": axes[2], "z": axes[0]},
    )  # fmt: skip


def finite_differences(problem, z, step=1e-7):
    columns = []
    for i in range(len(z)):
        d = np.zeros(len(z))
        d[i] = step
        up, down = (problem.evaluate(z + s * d, jacobian=False)[0] for s in (1, -1))
        columns.append((up - down) / (2 * step))
    return np.array(columns).T


# -- the equations ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["forced", "response", "mode", "phase"])
def test_jacobians_are_those_of_finite_differences(kind):
    """All problems, with preload, friction under varying pressure, and sliders."""
    from fenics_joints.harmonic.frf import ForcedResponse

    model = block()
    balance = Balance(model, 3, 32, static=np.array([-1.0, 0.05, 0.0]))
    rng = np.random.default_rng(1)
    X = balance.mean[:, None] * (np.arange(7) == 0) + 0.3 * rng.standard_normal((3, 7))
    row = model.row("forces", "x")
    problem, ends = {
        "forced": (ForcedResponse(balance, balance.load(row), 1.0), [0.9]),
        "response": (ConstantResponse(balance, row, row, 0.4, 2, 1.0), [0.3, 0.9]),
        "mode": (FreeMode(balance, row, 1.1, np.eye(3)[1]), [0.9, 0.03, -0.2]),
        "phase": (PhaseResonance(balance, row, row, 1.1, np.eye(3)[1]), [0.9, 0.3, -0.2]),
    }[kind]
    z = np.append(X.reshape(-1), ends)
    J = problem.evaluate(z)[1]
    assert np.abs(J - finite_differences(problem, z)).max() < 1e-6 * np.abs(J).max()


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


# -- Duffing ---------------------------------------------------------------------------------------


def duffing_amplitude(omega, start):
    """Amplitude of the periodic motion through shooting, by integration to 1e-11."""

    def flow(state, dense=False):
        def rate(t, y):
            return [y[1], FORCE * np.cos(omega * t) - DAMPING * y[1] - y[0] - CUBIC * y[0] ** 3]

        period = 2 * np.pi / omega
        return solve_ivp(
            rate, (0, period), state, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=dense
        )

    def gap(state):
        return flow(state).y[:, -1] - state

    found = fsolve(gap, start, xtol=1e-11)
    orbit = flow(found, dense=True).sol
    times = np.linspace(0, 2 * np.pi / omega, 20001)
    return np.abs(orbit(times)[0]).max()


def test_duffing_peak_is_that_of_time_integration():
    """Past the first turning point; also the amplitudes of the lower branch, and stability."""
    result = solve_harmonic(duffing(), "push", FORCE, BAND, harmonics=9, measure="peak")
    peak, omega = result.peak, 2 * np.pi * result.peak.frequency_hz

    def at(omega):
        i = int(np.argmin(np.abs(result.omegas[: peak.index + 1] - omega)))
        X = result.coefficients[i, 0]
        h = np.arange(1, 10)
        return duffing_amplitude(omega, [X[0] + X[1::2].sum(), result.omegas[i] * (h @ X[2::2])])

    assert peak.amplitude == pytest.approx(at(omega), rel=1e-5)
    assert at(0.999 * omega) < peak.amplitude
    # Two turning points; Hill's method finds the branch between them unstable, and only that.
    steps = np.diff(result.omegas)
    back = np.flatnonzero(steps < 0)
    assert len(back) > 5 and np.all(np.diff(back) == 1)
    held = stable(result)
    assert not held[back[2:-1]].any()
    assert held[: back[0]].all() and held[back[-1] + 3 :].all()


def test_duffing_mode_is_the_closed_form():
    """The exact period, by elliptic integral; mass-proportional damping does not bend it."""
    result = solve_backbone(duffing(), (0.01, 2.0), harmonics=11)
    a = result.amplitude(measure="peak")
    modulus = CUBIC * a**2 / (2 * (1 + CUBIC * a**2))
    exact = np.pi * np.sqrt(1 + CUBIC * a**2) / (2 * ellipk(modulus))
    assert np.allclose(2 * np.pi * result.frequencies_hz, exact, rtol=1e-8)
    # c = 2 zeta omega, the whole of the damping.
    assert np.allclose(result.damping_ratios, DAMPING / (2 * exact), rtol=1e-7)
    one = solve_backbone(duffing(), (0.01, 2.0), harmonics=1)
    closed = np.sqrt(1 + 0.75 * CUBIC * one.amplitude() ** 2)
    assert np.allclose(2 * np.pi * one.frequencies_hz, closed, rtol=1e-9)


def test_a_direction_with_next_to_no_mass_is_no_obstacle():
    """As reduced bases have them."""
    model, one = duffing(), solve_backbone(duffing(), (0.01, 2.0), harmonics=3)
    joint = replace(model.interfaces[0], rows=np.array([[[1.0, 0.0]]]))
    K, C, row = np.eye(2), DAMPING * np.diag([1.0, 0.0]), np.array([1.0, 0.0])
    light = InterfaceModel(np.diag([1.0, 1e-16]), K, (joint,), C, {"push": row}, {"mass": row})
    two = solve_backbone(light, (0.01, 2.0), harmonics=3)
    assert two.frequencies_hz[-1] == pytest.approx(one.frequencies_hz[-1], rel=1e-9)


def test_duffing_converges_with_harmonics():
    """Every second harmonic brings more than a decade."""
    peaks = [
        solve_harmonic(duffing(), "push", FORCE, BAND, harmonics=h, measure="peak").peak.amplitude
        for h in (1, 3, 5, 11)
    ]
    errors = np.abs(np.array(peaks[:-1]) / peaks[-1] - 1)
    assert np.all(errors[1:] < 0.1 * errors[:-1])


# -- Jenkins ---------------------------------------------------------------------------------------


def jenkins_amplitude(omega, periods=25):
    """Half of peak to peak once steady, sticking and sliding integrated between their events."""

    def rate(t, y, mode):
        traction = STICK * (y[0] - y[2]) if mode == 0 else mode * SLIDE
        acceleration = PUSH * np.cos(omega * t) - VISCOUS * y[1] - y[0] - traction
        return [y[1], acceleration, 0.0 if mode == 0 else y[1]]

    def event(mode):
        def sliding_begins(t, y, _):
            return SLIDE - abs(STICK * (y[0] - y[2]))

        def sliding_ends(t, y, _):
            return mode * y[1]

        made = sliding_begins if mode == 0 else sliding_ends
        made.terminal, made.direction = True, -1
        return made

    t, y, mode, end = 0.0, np.zeros(3), 0, periods * 2 * np.pi / omega
    extremes = [0.0, 0.0]
    while t < end:
        run = solve_ivp(
            rate, (t, end), y, method="DOP853", rtol=1e-10, atol=1e-11, args=(mode,),
            events=event(mode), dense_output=True,
        )  # fmt: skip
        late = np.linspace(max(t, end - 2 * np.pi / omega), run.t[-1], 2000)
        if run.t[-1] > end - 2 * np.pi / omega:
            x = run.sol(late)[0]
            extremes = [min(extremes[0], x.min()), max(extremes[1], x.max())]
        t, y = run.t[-1], run.y[:, -1].copy()
        mode = int(np.sign(y[0] - y[2])) if mode == 0 else 0
        if mode == 0:  # just inside, so that the next event is not this one
            y[2] = y[0] - np.sign(y[0] - y[2]) * SLIDE / STICK * (1 - 1e-12)
    return 0.5 * (extremes[1] - extremes[0])


def test_jenkins_peak_is_that_of_time_integration():
    """Within 0.1 %, with the samples of default."""
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=9, measure="peak")
    omega = 2 * np.pi * result.peak.frequency_hz
    there = jenkins_amplitude(omega)
    assert result.peak.amplitude == pytest.approx(there, rel=1e-3)
    assert max(jenkins_amplitude(f * omega) for f in (0.97, 1.03)) < 1.0005 * there


def jenkins_first_harmonic(amplitude):
    """In-phase and quadrature force of a Jenkins element in sinusoidal motion."""
    slip = SLIDE / STICK
    if amplitude <= slip:
        return STICK * amplitude, 0.0
    angle = np.arccos(1 - 2 * slip / amplitude)
    quadrature = 4 * SLIDE * (amplitude - slip) / (np.pi * amplitude)
    return STICK * amplitude / np.pi * (angle - 0.5 * np.sin(2 * angle)), quadrature


def test_jenkins_of_one_harmonic_is_the_closed_form():
    """Peak of the describing function's response, and force at constant response."""

    def force(amplitude, omega):
        elastic, friction = jenkins_first_harmonic(amplitude)
        along = (1 - omega**2) * amplitude + elastic
        return np.hypot(along, VISCOUS * omega * amplitude + friction)

    def least(amplitude):
        return minimize_scalar(lambda w: force(amplitude, w), (0.9, 1.4), tol=1e-10).fun - PUSH

    exact = brentq(least, 0.25, 2.0, xtol=1e-12)
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=1, samples=4096)
    assert result.peak.amplitude == pytest.approx(exact, rel=2e-6)
    held = solve_constant_response(jenkins(), "push", "mass", 0.5, BAND, harmonics=1, samples=4096)
    assert np.allclose(held.amplitude(), 0.5, rtol=1e-9)
    expected = [force(0.5, omega) for omega in held.omegas]
    assert np.allclose(held.force_amplitudes, expected, rtol=2e-6)


def test_jenkins_converges_with_samples():
    """The square of the step: reversals are missed by that much."""
    at, samples = [0.17], np.array([32, 64, 128, 256, 512])
    found = [
        solve_harmonic(jenkins(), "push", PUSH, at=at, harmonics=3, samples=int(n)).amplitude()[0]
        for n in (*samples, 8192)
    ]
    errors = np.abs(np.array(found[:-1]) / found[-1] - 1)
    slope = np.polyfit(np.log(samples), np.log(errors), 1)[0]
    assert -3.0 < slope < -1.6 and errors[2] < 1e-3


def test_energy_of_loops_is_the_work_of_the_force():
    """Friction and viscous damping take what the force puts in; the loops are closed."""
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, samples=256)
    i = result.peak.index
    loops = result.loops(i)["joint"]
    strain, stress = loops.strain[0, :, 0], loops.stress[0, :, 0]
    # The loop's area by the polygon of its samples.
    area = 0.5 * np.sum(stress * (np.roll(strain, -1) - np.roll(strain, 1)))
    X, h = result.coefficients[i, 0], np.arange(1, 6)
    viscous = VISCOUS * result.omegas[i] * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    assert result.closure(i) < 1e-12
    assert area == pytest.approx(loops.energy, rel=1e-3)
    assert loops.energy + viscous == pytest.approx(result.force_work()[i], rel=1e-6)
    assert loops.slip_amplitude[0] == pytest.approx(result.amplitude(measure="peak")[i], rel=1e-3)


# -- modes, levels ---------------------------------------------------------------------------------


def test_iwan_damping_grows_by_segalmans_power():
    """Dissipation per cycle of the mode goes with amplitude to the 3 + chi."""
    chi, strength, stiffness = -0.4, 1.0, 1.0
    backbone = Segalman(strength, stiffness, chi, 0.5)
    low, high = 0.003 * backbone.reference, 0.1 * backbone.reference
    law = Iwan(backbone, 40, amplitudes=(0.3 * low, 3 * high))
    mode = solve_backbone(oscillator(law, 0.0), (low, high), samples=256)
    a, work = mode.amplitude(measure="peak"), mode.dissipation()["joint"]
    assert np.polyfit(np.log(a), np.log(work), 1)[0] == pytest.approx(3 + chi, abs=0.02)
    # zeta is that work over 4 pi times the energy, and Masing's loop has it in closed form.
    energy = 0.5 * (2 * np.pi * mode.frequencies_hz * mode.modal_amplitudes) ** 2
    assert np.allclose(mode.damping_ratios, work / (4 * np.pi * energy), rtol=1e-2)
    assert np.abs(np.mean(work / backbone.dissipation(a)) - 1) < 0.01
    assert mode.frequencies_hz[0] > mode.frequencies_hz[-1]  # softening


def test_modes_and_responses_agree_at_the_peak():
    """EPMC, phase resonance, constant force and constant response, each by its own equations."""
    given = dict(harmonics=5, samples=512)
    peak = solve_harmonic(jenkins(), "push", PUSH, BAND, **given).peak
    span = (0.5 * peak.amplitude, 2 * peak.amplitude)
    mode = solve_backbone(jenkins(), span, **given)
    phase = solve_backbone(jenkins(), span, force="push", **given)
    held = solve_constant_response(jenkins(), "push", "mass", peak.amplitude, BAND, **given)
    # Both ways to the same curve: the least force of this response is the force of this peak.
    assert held.force_amplitudes[held.peak.index] == pytest.approx(PUSH, rel=2e-4)
    assert held.peak.frequency_hz == pytest.approx(peak.frequency_hz, rel=5e-3)
    for found in (mode, phase):
        order = np.argsort(found.amplitude())
        a = found.amplitude()[order]
        omega = 2 * np.pi * np.interp(peak.amplitude, a, found.frequencies_hz[order])
        zeta = np.interp(peak.amplitude, a, found.damping_ratios[order])
        # The force that this mode takes at resonance; it is heavily damped, so a per cent.
        assert 2 * zeta * omega**2 * peak.amplitude == pytest.approx(PUSH, rel=0.01)
        assert omega == pytest.approx(2 * np.pi * peak.frequency_hz, rel=0.01)


# -- preload, friction under varying pressure ------------------------------------------------------


def test_preloaded_friction_is_that_of_time_integration():
    """Static harmonic, opening and sliding together, against generalised alpha in small steps."""
    model, load = block(), np.array([-1.0, 0.0, 0.0])
    frequency = 0.23
    result = solve_harmonic(
        model, "x", 0.3, at=[frequency], harmonics=9, samples=512, static=load, cycles=4
    )
    assert max(v[0] for v in result.dissipation().values()) > 0.01
    # Time integration knows forces only: the preload is brought in by the state of rest.
    pressed = replace(model, forces={**model.forces, "static": load})
    history = steady(pressed, frequency)
    for sensor in ("x", "y", "z"):
        c = result.sensor_coefficients(sensor)[0]
        scale = np.abs(history["x"][1:]).max()
        assert np.abs(c[:7] - history[sensor]).max() < 1e-3 * scale


def steady(model, frequency, periods=60, steps=300):
    u, states = static_state(model, model.forces["static"])
    omega = 2 * np.pi * frequency

    def push(t):
        return 0.3 * np.cos(omega * t)

    def rest(t):
        return 1.0

    run = solve_transient(
        model, step=1 / frequency / steps, n_steps=periods * steps,
        loads={"x": push, "static": rest},
        initial=(u, np.zeros(3), None),
    )  # fmt: skip
    return {
        key: steady_harmonics(run.times, run.displacements[key], frequency, 3)
        for key in model.sensors
    }


# -- ranks, files, errors --------------------------------------------------------------------------


@pytest.mark.parallel
def test_ranks_share_the_points():
    """Residual, Jacobian, branch and loops of all ranks are those of one."""
    load = np.array([-1.0, 0.05, 0.0])
    rng = np.random.default_rng(3)
    X, made = 0.3 * rng.standard_normal((3, 7)), []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        balance = Balance(block(), 3, 32, static=load, comm=comm)
        result = solve_harmonic(
            block(), "x", 0.3, (0.15, 0.3), harmonics=3, samples=64, static=load, comm=comm
        )
        loops = result.loops(result.peak.index)["floor"]
        made.append([*balance.evaluate(X, 1.0), loops.dissipation, result.peak.amplitude])
    for one, all_ in zip(*made, strict=True):
        assert np.allclose(one, all_, rtol=1e-6, atol=1e-9)


def test_a_branch_is_taken_up_again(tmp_path):
    """A run that ran out of points goes on from its file to the same curve."""
    file, given = tmp_path / "branch.npz", dict(harmonics=3, samples=64)
    whole = solve_harmonic(jenkins(), "push", PUSH, BAND, **given)
    few = Settings(max_points=15)
    with pytest.raises(ConvergenceError, match="max_points") as stopped:
        solve_harmonic(jenkins(), "push", PUSH, BAND, checkpoint=file, settings=few, **given)
    assert len(stopped.value.branch) == 15
    seen = []

    class Told:
        def step(self, text, total=None):
            seen.append(text)

        def advance(self, n=1, note=""):
            seen.append(note)

    again = solve_harmonic(
        jenkins(), "push", PUSH, BAND, checkpoint=file, resume=True, progress=Told(), **given
    )
    assert len(seen) < len(whole) - 10 and seen[-1].endswith("Hz")
    assert np.allclose(again.frequencies_hz, whole.frequencies_hz, rtol=1e-6)
    assert np.allclose(again.coefficients, whole.coefficients, rtol=1e-5, atol=1e-7)
    with pytest.raises(InputError, match="holds a branch of"):
        solve_harmonic(jenkins(), "push", 0.1, BAND, checkpoint=file, resume=True, **given)
    file.write_bytes(b"no branch")
    with pytest.raises(InputError, match="not a branch"):
        solve_harmonic(jenkins(), "push", PUSH, BAND, checkpoint=file, resume=True, **given)


def test_prescribed_frequencies_and_derivatives():
    """Points of the branch, from warm starts too; derivatives against solving again."""
    branch = solve_harmonic(jenkins(), "push", PUSH, BAND)
    at = branch.frequencies_hz[[30, 10, 20]]
    found = solve_harmonic(jenkins(), "push", PUSH, at=at)
    assert np.allclose(found.coefficients, branch.coefficients[[30, 10, 20]], atol=1e-7)
    warm = solve_harmonic(jenkins(), "push", PUSH, at=at, initial=found)
    assert warm.iterations.max() == 1
    values, step = {"k": STICK, "s": SLIDE}, 1e-4

    def change(v):
        return jenkins(v["k"], v["s"])

    gradient = found.by_parameters(change, values).amplitude("mass", "acceleration")
    for j, key in enumerate(values):
        models = [change({**values, key: values[key] * (1 + s * step)}) for s in (1, -1)]
        up, down = (
            solve_harmonic(model, "push", PUSH, at=at).amplitude("mass", "acceleration")
            for model in models
        )
        expected = (up - down) / (2 * step * values[key])
        assert np.allclose(gradient[:, j], expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_derivatives_go_through_the_preload():
    """The state that friction remembers of it changes with the parameters too."""
    base, load = block(), np.array([-1.0, 0.05, 0.0])
    values, step, at = {"normal": 3.0, "friction": 0.3, "stiffness": 1.0}, 1e-5, [0.2, 0.23, 0.28]

    base.stiffness_at_rest()  # compiles the laws; those changed from them are of the same form

    def change(v):
        law = base.interfaces[0].law.with_values(
            normal_stiffness=v["normal"], friction=v["friction"]
        )
        return replace(base.with_laws(floor=law), K=v["stiffness"] * base.K)

    def solve(v, initial=None):
        exact = Settings(tolerance=1e-9)
        return solve_harmonic(
            change(v), "x", 0.3, at=at, static=load, settings=exact, harmonics=3, samples=64,
            initial=initial,
        )  # fmt: skip

    found = solve(values)
    gradient = found.by_parameters(change, values).amplitude("x")
    for j, key in enumerate(values):
        up, down = (
            solve({**values, key: values[key] * (1 + s * step)}, found).amplitude() for s in (1, -1)
        )
        assert np.allclose(gradient[:, j], (up - down) / (2 * step * values[key]), rtol=1e-4)


def test_results_for_people(tmp_path):
    """JSON holds what the result says."""
    import json

    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=1)
    result.write_json(tmp_path / "frf.json")
    read = json.loads((tmp_path / "frf.json").read_text())
    assert read["peaks"][0]["frequency_hz"] == result.peak.frequency_hz
    assert np.allclose(read["sensors"]["mass"]["amplitude_m"], result.amplitude("mass"))
    assert np.allclose(
        result.frf("mass", "acceleration"), -(result.omegas**2) * result.frf("mass"), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"amplitude": -1.0}, "amplitude = -1.0"),
        ({"force": "pull"}, "no 'pull'"),
        ({"sensor": "wall"}, "no 'wall'"),
        ({"band": (3.0, 1.0)}, "band ="),
        ({"at": [0.1]}, "either band"),
        ({"harmonics": 0}, "harmonics = 0"),
        ({"samples": 8}, "samples = 8"),
        ({"static": np.ones(2)}, "static has shape"),
        ({"measure": "rms"}, "measure = 'rms'"),
        ({"direction": "left"}, "direction = 'left'"),
        ({"cycles": 0}, "cycles = 0"),
    ],
)
def test_wrong_requests_are_named(change, message):
    given = {"force": "push", "amplitude": PUSH, "band": BAND, **change}
    with pytest.raises(InputError, match=message):
        solve_harmonic(jenkins(), **given)
