"""Equations of harmonic balance: Jacobians, static state, ranks, and what they refuse."""

import numpy as np
import pytest
from mpi4py import MPI
from oscillators import BAND, PUSH, block, jenkins, oscillator

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Balance, solve_harmonic
from fenics_joints.harmonic.backbone import FreeMode, PhaseResonance
from fenics_joints.harmonic.frf import ConstantResponse
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.joint_laws import BoucWen, CoulombStick, ElasticFriction, Iwan, Segalman, Valanis

RANGE = (0.12, 0.3)


def finite_differences(problem, z, step=1e-7):
    columns = []
    for i in range(len(z)):
        d = np.zeros(len(z))
        d[i] = step
        up, down = (problem.evaluate(z + s * d, jacobian=False)[0] for s in (1, -1))
        columns.append((up - down) / (2 * step))
    return np.array(columns).T


@pytest.mark.parametrize("kind", ["forced", "response", "mode", "phase"])
def test_jacobians_are_those_of_finite_differences(kind):
    """All problems, with preload, friction under varying pressure, and sliders."""
    from fenics_joints.harmonic.balance import Loading
    from fenics_joints.harmonic.frf import ForcedResponse

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
    assert np.abs(J - finite_differences(problem, z)).max() < 1e-6 * np.abs(J).max()


@pytest.mark.parametrize("law", [ElasticFriction(1.0, 0.2), Iwan(Segalman(0.3, 1.0, -0.5, 0.2))])
def test_jacobian_of_one_direction_of_slip_is_that_of_finite_differences(law):
    """Its reversals and switches move with the motion."""
    balance = Balance(oscillator(law, 0.03), 3, 32)
    X = 0.4 * np.random.default_rng(0).standard_normal((1, 7))
    J, h = balance.interface_force(X)[1], 1e-6 * np.eye(7)[:, None]
    ends = [[balance.interface_force(X + s * dX)[0][0] for dX in h] for s in (1, -1)]
    assert np.abs(J - (np.array(ends[0]) - ends[1]).T / 2e-6).max() < 1e-6 * np.abs(J).max()


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
