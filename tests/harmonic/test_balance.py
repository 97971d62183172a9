"""Equations of harmonic balance: Jacobians, static state, ranks, and what they refuse."""

import numpy as np
import pytest
from mpi4py import MPI
from oscillators import BAND, PUSH, block, jenkins

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Balance, solve_harmonic
from fenics_joints.harmonic.backbone import FreeMode, PhaseResonance
from fenics_joints.harmonic.constant_response import ConstantResponse
from fenics_joints.interfaces import static_state


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
    """All problems, with preload, friction under varying pressure, and sliders.

    The stress is integrated, not summed over samples: the derivative is the integral's, up to the
    quadrature of a motion with jumps of its slope.
    """
    from fenics_joints.harmonic.frf import ForcedResponse
    from fenics_joints.harmonic.loads import Loading

    model = block()
    balance = Balance(model, 3, 128, static=np.array([-1.0, 0.05, 0.0]))
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
    assert np.abs(J - finite_differences(problem, z)).max() < 2e-5 * np.abs(J).max()


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
            block(), "x", 0.3, (0.15, 0.3), harmonics=3, samples=64, static=load, comm=comm
        )
        loops = result.loops(result.peak.index)["floor"]
        made.append([*balance.evaluate(X, 1.0), loops.dissipation, result.peak.amplitude])
    for one, all_ in zip(*made, strict=True):
        assert np.allclose(one, all_, rtol=1e-6, atol=1e-9)


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
