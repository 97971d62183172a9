"""Frequency responses and complex modes against closed forms, each other, and on two ranks."""

from __future__ import annotations

from dataclasses import replace

import dolfinx.mesh
import moving_plates
import numpy as np
import pytest
import scipy.linalg
from moving_plates import PLACES
from mpi4py import MPI
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, eigs

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.response import solve_complex_modes, solve_frf
from fenics_joints.structure import (
    Damping,
    ElasticSupport,
    Parameter,
    Sensors,
    Structure,
    Support,
    joint,
    part,
)

SIDE, BLOCK = 0.02, 0.1
AREA = SIDE**2
SLIDING = [Support(face, (1, 2)) for face in ("y_min", "y_max", "z_min", "z_max")]


def corners(x):
    """The four corners of a section: equal forces there are an even traction, at degree 1."""
    points = [[x, y, z] for y in (0.0, SIDE) for z in (0.0, SIDE)]
    return Sensors(np.array(points), np.array([1.0, 0.0, 0.0]))


def evenly(frf):
    """Response of a section to an even traction of 1 N in all, (n_f,), and derivatives."""
    slopes = None if frf.slopes is None else frf.gradients.mean(axis=(1, 2))
    return frf.values.mean(axis=(1, 2)), slopes


# -- two blocks, one on a wall's springs, a thin layer between: a chain of bars by hand ---------

CHAIN = {"rho": 7800.0, "layer.E": 2.5e9, "wall.k": 2.5e10, "layer.eta": 0.06, "wall.tau": 8e-6}
CHAIN_DAMPING = Damping(
    rayleigh=(20.0, 0.0), hysteretic={"layer": "layer.eta"}, viscous={"wall": "wall.tau"}
)


def chain(comm=MPI.COMM_SELF):
    tagged = box(comm, (3 * BLOCK, SIDE, SIDE), (3, 1, 1))
    mesh, tdim = tagged.mesh, tagged.mesh.topology.dim
    cells = np.arange(len(tagged.cell_tags.values), dtype=np.int32)
    x = dolfinx.mesh.compute_midpoints(mesh, tdim, cells)[:, 0]
    tags = dolfinx.mesh.meshtags(mesh, tdim, cells, 1 + np.int32(x / BLOCK))
    names = {"first": 1, "layer": 2, "second": 3}
    return Structure(
        replace(tagged, cell_tags=tags, cell_names=names),
        [
            part("blocks", ("first", "second"), E=2e11, nu=0.0, rho="rho"),
            joint("layer", "layer", E="layer.E", G=1e9, normal=(1.0, 0.0, 0.0)),
        ],
        [Parameter(name, value) for name, value in CHAIN.items()],
        supports=[*SLIDING, ElasticSupport("wall", "x_min", "wall.k", 0.0)],
        degree=1,
    )


def chain_matrices(p):
    """K, C and M of three linear bar elements; the middle one is the massless layer."""
    stiff, heavy = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([[2.0, 1.0], [1.0, 2.0]])
    moduli = 2e11, p["layer.E"] * (1 + 1j * p["layer.eta"]), 2e11
    K, M = np.zeros((4, 4), dtype=complex), np.zeros((4, 4))
    for i, (E, rho) in enumerate(zip(moduli, (p["rho"], 0.0, p["rho"]), strict=True)):
        K[i : i + 2, i : i + 2] += E * AREA / BLOCK * stiff
        M[i : i + 2, i : i + 2] += rho * AREA * BLOCK / 6 * heavy
    ground = np.diag([p["wall.k"] * AREA, 0.0, 0.0, 0.0])
    return K + ground, p["wall.tau"] * ground + 20.0 * M, M


def chain_receptance(p, lines):
    K, C, M = chain_matrices(p)
    s = 2j * np.pi * lines[:, None, None]
    return np.linalg.inv(K + s * C + s**2 * M)[:, 3, 3]


def central(function, p, name):
    """Derivative of a function of values by differences."""
    h = 1e-4 * p[name]
    return (function({**p, name: p[name] + h}) - function({**p, name: p[name] - h})) / (2 * h)


@pytest.mark.parametrize("method", ["direct", "modal"])
def test_chain_and_the_derivatives_of_its_response(method):
    lines = np.array([60.0, 380.0, 900.0, 1430.0, 2100.0])
    model, place = chain(), corners(3 * BLOCK)
    frf = solve_frf(
        model,
        frequencies_hz=lines,
        excitation=place,
        sensors=place,
        damping=CHAIN_DAMPING,
        method=method,
        n_modes=2,
        gradients=True,
    )
    values, slopes = evenly(frf)
    assert values == pytest.approx(chain_receptance(CHAIN, lines), rel=1e-7)
    for i, name in enumerate(CHAIN):
        expected = central(lambda p: chain_receptance(p, lines), CHAIN, name)
        assert slopes[:, i] == pytest.approx(expected, rel=1e-6), name


@pytest.mark.parametrize("tau", [8e-6, 2e-4])
def test_complex_modes_of_a_chain(tau):
    """Layer hysteretic and wall viscous: eigenvalues of a small state matrix."""
    model, given = chain(), {"wall.tau": tau}
    found = solve_complex_modes(model, given, damping=CHAIN_DAMPING, n_modes=2, gradients=True)

    def exact(p):
        K, C, M = chain_matrices(p)
        state = np.block(
            [[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]]
        )
        s = np.linalg.eigvals(state)
        s = s[s.imag > 0]
        s = s[np.argsort(np.abs(s))][:2]
        return np.array([np.abs(s) / (2 * np.pi), -s.real / np.abs(s)])

    p = CHAIN | given
    expected = exact(p)
    assert found.frequencies_hz == pytest.approx(expected[0], rel=1e-9)
    assert found.damping_ratios == pytest.approx(expected[1], rel=1e-8)
    for i, (name, value) in enumerate(p.items()):
        slope, scale = central(exact, p, name), expected / value
        for mine, theirs, size in zip(found.gradients(), slope, scale, strict=True):
            assert np.abs(mine[:, i] - theirs) == pytest.approx(0.0, abs=1e-6 * size.max()), name


def test_rod_with_a_loss_factor():
    """A wave in a clamped rod: H = tan(k L) / (E A k), k = w sqrt(rho / E), complex E."""
    length, n, eta = 0.5, 100, 0.02
    model = Structure(
        box(MPI.COMM_SELF, (length, SIDE, SIDE), (n, 1, 1)),
        [part("rod", "body", E=2e11, nu=0.0, rho=7800.0)],
        supports=[Support("x_min"), *SLIDING],
        degree=1,
    )
    lines = np.array([300.0, 2500.0, 2600.0, 6000.0])  # a resonance is at 2532 Hz
    place = corners(length)
    frf = solve_frf(
        model,
        frequencies_hz=lines,
        excitation=place,
        sensors=place,
        damping=Damping(structural=eta),
        kind="accelerance",
    )
    E, w = 2e11 * (1 + 1j * eta), 2 * np.pi * lines
    k = w * np.sqrt(7800.0 / E)
    expected = -(w**2) * np.tan(k * length) / (E * AREA * k)
    # The mesh's error is (k l / n)^2 / 24, and more of it near the resonance.
    assert evenly(frf)[0] == pytest.approx(expected, rel=2e-3)
    mobility = frf.to("mobility")
    assert mobility.values * (2j * np.pi * lines)[:, None, None] == pytest.approx(frf.values)
    assert mobility.to("accelerance").values == pytest.approx(frf.values, rel=1e-12)


# -- free lap plates ------------------------------------------------------------------------------

VALUES = moving_plates.VALUES | {"eta": 0.03, "tau": 4e-6, "zeta": 0.01}
LAYER = Damping(hysteretic={"layer": "eta"}, viscous={"layer": "tau"}, rayleigh=(4.0, 0.0))
LINES = np.array([140.0, 410.0, 900.0])


def graded(x, p):
    return p["layer.E"] * (1 + 20 * x[1])


def plates(comm=MPI.COMM_SELF, cord=True):
    return moving_plates.plates(comm, VALUES, graded, cord)


def response(model, given=None, **changes):
    settings = {
        "frequencies_hz": LINES,
        "excitation": PLACES,
        "sensors": PLACES,
        "damping": LAYER,
    } | changes
    return solve_frf(model, given, **settings)


def test_modes_with_residual_vectors_against_the_direct_solution():
    model = plates(cord=False)
    direct = response(model, gradients=True)
    assert direct.values == pytest.approx(direct.values.transpose(0, 2, 1), rel=1e-8)
    modal = response(model, method="modal", gradients=True)
    size = np.abs(direct.values)
    assert np.abs(modal.values - direct.values).max() < 1e-6 * size.max()
    assert modal.error == pytest.approx(np.abs(modal.values - direct.values) / size, abs=3e-9)
    scale = np.abs(direct.gradients).max(axis=(0, 1, 2))
    off = np.abs(modal.gradients - direct.gradients).max(axis=(0, 1, 2))
    assert np.all(off <= 1e-4 * scale)
    assert modal.modal.modes.n_rigid == 6
    # Without residual vectors the same modes miss much more, rigid-body modes or not.
    few, count = modal.modal, len(modal.modal.modes)
    at = few.project(model.loads(PLACES))[:count]
    cut = replace(
        few,
        basis=few.basis[:, :count],
        stiff=few.stiff[:count],
        heavy=few.heavy[:count],
        parts={name: A[:count, :count] for name, A in few.parts.items()},
    )
    bare = cut.response(LINES, at, at)
    assert (np.abs(bare.values - direct.values) / size).max() > 1e-2
    assert modal.error.max() < 1e-4


@pytest.mark.parametrize(
    "changes", [{}, {"method": "modal", "check": 0, "damping": Damping(modal=(0.02, "zeta"))}]
)
def test_derivatives_leave_a_remainder_of_second_order(changes):
    """Of all parameters: laws, graded and not, masses and their place, springs and damping."""
    model = plates()
    start = response(model, gradients=True, **changes)
    direction = np.array([0.3, -0.2, 0.25, 0.5, -0.6, 0.3, 0.4, 0.7, 0.5, -0.4, 0.6])
    names, values = list(VALUES), np.array(list(VALUES.values()))
    change = start.gradients @ (direction * values)
    assert np.all(np.abs(start.gradients).max(axis=(0, 1, 2))[:8] > 0)
    remainders = []
    for h in (2e-3, 1e-3):
        given = dict(zip(names, values * (1 + h * direction), strict=True))
        moved = response(model, given, **changes).values
        remainders.append(np.linalg.norm(moved - start.values - h * change))
    assert remainders[0] / remainders[1] == pytest.approx(4.0, abs=0.15)


def test_complex_modes_of_free_plates():
    model = plates(cord=False)
    modes = solve_modes(model, n_modes=12)
    alpha, beta = 3.0, 2e-6
    found = solve_complex_modes(model, damping=Damping(rayleigh=(alpha, beta)), n_modes=12)
    w = 2 * np.pi * modes.frequencies_hz[6:]
    assert found.frequencies_hz == pytest.approx(modes.frequencies_hz[6:], rel=1e-7)
    assert found.damping_ratios == pytest.approx(alpha / (2 * w) + beta * w / 2, rel=1e-6)
    # A layer so viscous that the modes are truly complex: ARPACK in the state space (x, s x).
    damping = Damping(viscous={"layer": 1e-4}, rayleigh=(alpha, 0.0))
    found = solve_complex_modes(model, damping=damping, n_modes=10)
    matrices = model.stiffness(), model.mass(), model.region_stiffness("layer", None)
    K, M, layer = (csr_matrix(A.getValuesCSR()[::-1], shape=A.getSize()) for A in matrices)
    C, near = alpha * M + 1e-4 * layer, 1j * w[:3].mean()
    factor = scipy.linalg.lu_factor((K + near * C + near**2 * M).toarray())

    def inverse(state):
        x, y = np.split(state, 2)
        moved = -scipy.linalg.lu_solve(factor, M @ y + C @ x + near * (M @ x))
        return np.concatenate([moved, x + near * moved])

    value, state = eigs(LinearOperator((2 * len(factor[1]),) * 2, inverse, dtype=complex), 3)
    s = near + 1 / value
    s, x = s[np.argsort(np.abs(s))], state[: len(factor[1]), np.argsort(np.abs(s))]
    # Residuals of 1e-5 are promised, whose square is an eigenvalue's error.
    assert found.residuals.max() < 1e-5
    assert found.eigenvalues[:3] == pytest.approx(s, rel=1e-8)
    x = x * np.sqrt(2 * s / np.sum(x * (C @ x + 2 * s * (M @ x)), axis=0))
    at, expected = found.at(PLACES)[:, :3], model.loads(PLACES).T @ x
    sign = np.sign(np.real(np.sum(at * expected.conj(), axis=0)))
    assert at * sign == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    assert np.abs(np.angle(expected**2)).max() > 0.02


@pytest.mark.parallel
def test_two_ranks_agree():
    alone, together = (
        response(plates(comm), gradients=True) for comm in (MPI.COMM_SELF, MPI.COMM_WORLD)
    )
    modal = response(plates(MPI.COMM_WORLD), method="modal", gradients=True)
    size, slope = np.abs(alone.values).max(), np.abs(alone.gradients).max(axis=(0, 1, 2))
    assert together.values == pytest.approx(alone.values, abs=1e-8 * size)
    assert modal.values == pytest.approx(alone.values, abs=1e-6 * size)
    assert np.all(np.abs(together.gradients - alone.gradients) <= 1e-6 * slope)
    assert np.all(np.abs(modal.gradients - alone.gradients) <= 1e-4 * slope)
    both = [
        solve_complex_modes(plates(comm), damping=LAYER, n_modes=10)
        for comm in (MPI.COMM_SELF, MPI.COMM_WORLD)
    ]
    # The layer's round-off is some 1e-8 of the lowest.
    assert both[1].eigenvalues == pytest.approx(both[0].eigenvalues, rel=1e-7)


def test_bad_input_is_named():
    model, place = chain(), corners(3 * BLOCK)
    common = {"frequencies_hz": [100.0], "excitation": place, "sensors": place}
    for changes, message in (
        ({"frequencies_hz": [0.0]}, "above 0"),
        ({"kind": "dynamic"}, "accelerance"),
        ({"method": "both"}, "one of: direct, modal"),
        ({"damping": Damping(modal=0.01)}, 'method = "modal"'),
        ({"damping": Damping(viscous={"bolt": 1e-5})}, "bolt"),
        ({"damping": Damping(structural="loss")}, "loss"),
        ({"sensors": corners(1.0)}, "outside the mesh"),
        ({"modes": solve_modes(model, {"rho": 3e3}, n_modes=2), "method": "modal"}, "same values"),
    ):
        with pytest.raises(InputError, match=message):
            solve_frf(model, **(common | changes))


def test_rigid_body_modes_alone_have_no_complex_modes():
    with pytest.raises(InputError, match="n_modes = 6: expected more than the 6 rigid-body modes"):
        solve_complex_modes(plates(cord=False), damping=LAYER, n_modes=6)


@pytest.mark.parametrize("method", ["direct", "modal"])
def test_a_free_body_near_0_hz(method):
    """Accelerance there is the rigid body's; K has it to round-off, 1e-4 of ``w^2 M`` at 1 Hz."""
    model = plates(cord=False)
    frf = response(
        model, frequencies_hz=[1.0, 2.0], kind="accelerance", damping=None, method=method
    )
    rigid = solve_modes(model, n_modes=8).at(PLACES)[:, :6]
    assert frf.values[0] == pytest.approx(rigid @ rigid.T, rel=1e-3)


def test_a_resonance_without_damping_is_an_error():
    model, place = chain(), corners(3 * BLOCK)
    lines = solve_modes(model, n_modes=1).frequencies_hz
    with pytest.raises(ConvergenceError, match="resonance"):
        solve_frf(model, frequencies_hz=lines, excitation=place, sensors=place)
