"""FRFs of reduced models: against a dense solution, the full structure, and on two ranks."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes import dumbbell, lap_plates
from fenics_joints.reduction import checked_frf_model, frf_basis, frf_error, reduce
from fenics_joints.response import solve_complex_modes, solve_frf
from fenics_joints.structure import (
    Damping,
    ElasticSupport,
    Parameter,
    PointMass,
    Sensors,
    Spring,
    Structure,
    joint,
    part,
    transition,
)

# -- lap plates with every kind of component ------------------------------------------------------

VALUES = {
    "E": 7e10,
    "nu": 0.3,
    "rho": 2700.0,
    "layer.E": 5e9,
    "layer.G": 1e9,
    "tip.mass": 0.03,
    "tip.travel": 0.04,
    "nut.mass": 0.05,
    "cord.k": 2e4,
    "wall.k_n": 1e11,
    "wall.k_t": 3e10,
    "eta": 0.03,
    "tau": 4e-6,
    "alpha": 5.0,
    "loss": 0.01,
    "zeta": 0.02,
}
ELSEWHERE = VALUES | {"E": 5e10, "layer.G": 2e8, "tip.travel": 0.07, "cord.k": 3e5}
FORCE = Sensors(np.array([[0.31, 0.05, 0.016]]), [0.0, 0.6, 0.8])
PLACES = Sensors(
    np.array([[0.11, 0.03, 0.008], [0.31, 0.05, 0.016], [0.2, 0.02, 0.01]]),
    np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.5, 0.5, 0.1]]),
)
LAYERS = Damping(
    structural="loss",
    rayleigh=("alpha", 1e-7),
    hysteretic={"layer": "eta"},
    viscous={"wall": "tau"},
)
EVENLY = Damping(structural="loss", rayleigh=("alpha", 1e-7))
#: Without what is viscous in the layers.
LOSSY = Damping(structural="loss", rayleigh=("alpha", 0.0), hysteretic={"layer": "eta"})
MODAL = Damping(modal=(0.01, "zeta"))
KINDS = [EVENLY, LAYERS, LOSSY, MODAL]
#: The parameters that each of them names.
NAMED = [["alpha", "loss"], ["alpha", "loss", "eta", "tau"], ["alpha", "loss", "eta"], ["zeta"]]
LINES = np.linspace(60.0, 1500.0, 9)


def plates(comm=MPI.COMM_SELF, E="E"):
    return Structure(
        lap_plates(comm, element_size=0.04, n_thickness=1),
        [
            part("plates", ("plate_1", "plate_2"), E=E, nu="nu", rho="rho"),
            joint("layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G"),
        ],
        [Parameter(name, value) for name, value in VALUES.items()],
        masses=[
            PointMass("tip", "tip.mass", (0.21, 0.03, 0.0165), travel="tip.travel"),
            PointMass("nut", "nut.mass", (0.15, 0.02, 0.0), share=0.5),
        ],
        springs=[Spring("cord", "cord.k", (0.31, 0.0, 0.012), (0.0, 1.0, 0.0), share=0.5)],
        supports=[ElasticSupport("wall", "end_1", "wall.k_n", "wall.k_t")],
        degree=1,
    )


@pytest.fixture(scope="module")
def small():
    return reduce(plates(), [VALUES, ELSEWHERE], 8, travel={"tip": (0.0, 0.1)})


def response(model, given=None, **changes):
    settings = {
        "frequencies_hz": LINES,
        "excitation": FORCE,
        "sensors": PLACES,
        "damping": LAYERS,
        "gradients": True,
    } | changes
    return solve_frf(model, given, **settings)


def matrices_by_hand(model, given, damping):
    """Complex stiffness, viscous damping and mass, from the reduced matrices."""
    values = model.values(given)
    K, M, d = model.stiffness(given), model.mass(given), damping.at(values)
    whole, C = K * (1 + 1j * d.structural), d.rayleigh[0] * M + d.rayleigh[1] * K
    for name, names in (("layer", ("layer.E", "layer.G")), ("wall", ("wall.k_n", "wall.k_t"))):
        # A layer's stiffness is what is gone with its moduli.
        half = model.stiffness({**values, **{n: 0.5 * values[n] for n in names}})
        whole = whole + 2j * d.hysteretic.get(name, 0.0) * (K - half)
        C = C + 2 * d.viscous.get(name, 0.0) * (K - half)
    if damping is MODAL:
        lam, phi = scipy.linalg.eigh(K, M)
        zeta = np.where(np.arange(len(lam)) == 0, 0.01, values["zeta"])
        heavy = M @ phi
        C = C + (heavy * (2 * zeta * np.sqrt(lam))) @ heavy.T
    return whole, C, M


def by_hand(model, given, damping):
    """Accelerance, (n_f, n_sensors, n_excitations)."""
    K, C, M = matrices_by_hand(model, given, damping)
    w = 2 * np.pi * LINES[:, None, None]
    b, c = model.loads(FORCE).T, model.loads(PLACES).T
    return -(w**2) * (c @ np.linalg.solve(K + 1j * w * C - w**2 * M, b.T.astype(complex)))


@pytest.mark.parametrize("damping", KINDS, ids=["even", "layers", "lossy", "modal"])
def test_values_and_derivatives_of_every_parameter(small, damping):
    arrays = small.arrays(FORCE, PLACES)
    given = {"layer.G": 4e8, "tip.travel": 0.02}
    found = response(arrays, given, damping=damping, kind="accelerance")
    exact = by_hand(small, given, damping)
    size = np.abs(exact).max()
    assert np.abs(found.values - exact).max() < 1e-9 * size
    assert found.unit == "m/s2/N"
    same = response(small, given, damping=damping, kind="accelerance")
    assert np.abs(same.gradients - found.gradients).max(axis=(0, 1, 2)) == pytest.approx(
        0.0, abs=1e-9 * np.abs(found.gradients).max()
    )
    named = [n for n in VALUES if n not in ("eta", "tau", "alpha", "loss", "zeta")]
    named += NAMED[KINDS.index(damping)]
    for i, name in enumerate(VALUES):
        slope = found.gradients[..., i]
        if name not in named:
            assert not slope.any()
            continue
        value = small.values(given)[name]
        h = 1e-5 * value
        up, down = (by_hand(small, {**given, name: value + d}, damping) for d in (h, -h))
        expected = (up - down) / (2 * h)
        assert np.abs(slope - expected).max() < 3e-5 * np.abs(expected).max(), name
        assert np.abs(expected).max() > 0


def test_what_a_reduced_model_cannot_do_is_said(small):
    arrays = small.arrays(FORCE)
    with pytest.raises(InputError, match=r"sensor at .* one of the 1 places"):
        response(arrays)
    with pytest.raises(InputError, match="one of the 0 places"):
        response(small.arrays())
    with pytest.raises(InputError, match="excitation at .* outside the mesh"):
        response(small, excitation=Sensors([[9.0, 0.0, 0.0]], [0.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="not a dict"):
        response({})
    graded = reduce(
        plates(E=lambda x, p: p["E"] * (1 + x[0])), [VALUES], 4, travel={"tip": (0.0, 0.1)}
    )
    assert np.isfinite(response(graded, gradients=False).values).all()
    for refused in (lambda: response(graded), lambda: graded.arrays(FORCE)):
        with pytest.raises(InputError, match=r"plates: .* graded"):
            refused()


# -- complex modes of reduced models --------------------------------------------------------------


def roots_by_hand(model, given, damping, count=5):
    """|s| / 2 pi and damping ratios from a state matrix."""
    K, C, M = matrices_by_hand(model, given, damping)
    below = -np.linalg.solve(M, np.hstack([K, C]))
    s = np.linalg.eigvals(np.vstack([np.eye(len(K), 2 * len(K), len(K)), below]))
    s = s[s.imag > 0]
    s = s[np.argsort(np.abs(s))][:count]
    return np.array([np.abs(s) / (2 * np.pi), -s.real / np.abs(s)])


@pytest.mark.parametrize("damping", KINDS, ids=["even", "layers", "lossy", "modal"])
def test_complex_modes_and_their_derivatives(small, damping):
    given = {"layer.G": 4e8, "tip.travel": 0.02}
    model = small.arrays(FORCE, PLACES)
    found = solve_complex_modes(model, given, damping=damping, n_modes=5, gradients=True)
    expected = roots_by_hand(small, given, damping)
    assert found.frequencies_hz == pytest.approx(expected[0], rel=1e-7)
    assert found.damping_ratios == pytest.approx(expected[1], rel=1e-5)
    assert found.residuals.max() < 1e-7
    at = found.at(PLACES)
    assert at == pytest.approx(small.observe(found.shapes, PLACES), abs=1e-9 * np.abs(at).max())
    for i, name in enumerate(VALUES):
        value = small.values(given)[name]
        h = 1e-4 * value
        up, down = (roots_by_hand(small, {**given, name: value + d}, damping) for d in (h, -h))
        for mine, slope, scale in zip(
            found.gradients(), (up - down) / (2 * h), expected / value, strict=True
        ):
            assert np.abs(mine[:, i] - slope).max() < 3e-5 * scale.max(), name
    # Every damping parameter that is named has an effect on the ratios.
    by = dict(zip(VALUES, np.abs(found.gradients()[1]).max(axis=0), strict=True))
    assert all(by[name] > 0 for name in NAMED[KINDS.index(damping)])


@pytest.mark.parametrize("damping", [EVENLY, MODAL], ids=["even", "modal"])
def test_damping_ratios_of_the_full_model_leave_a_remainder_of_second_order(damping):
    """Along stiffness and damping parameters together."""
    model, names = plates(), ["E", "layer.G", "cord.k", "alpha", "loss", "zeta"]
    direction = np.array([0.5, -0.7, 0.6, 0.8, -0.4, 0.5])
    start = solve_complex_modes(model, damping=damping, n_modes=5, gradients=True)
    columns = [list(VALUES).index(name) for name in names]
    values = np.array([VALUES[name] for name in names])
    slope = start.gradients()[1][:, columns] @ (values * direction)
    off = []
    for h in (4e-2, 2e-2):
        given = dict(zip(names, values * (1 + h * direction), strict=True))
        moved = solve_complex_modes(model, given, damping=damping, n_modes=5).damping_ratios
        off.append(np.linalg.norm(moved - start.damping_ratios - h * slope))
    if damping is MODAL:  # linear in zeta, and independent of all others
        assert max(off) < 1e-9
    else:
        assert off[0] / off[1] == pytest.approx(4.0, abs=0.3)


# -- dumbbells: bases that hold over wide ranges --------------------------------------------------

BODIES = ("head_1", "neck_1", "neck_2", "head_2")
HIT = Sensors(np.array([[0.12, 0.09, -0.13]]), [0.0, 0.0, 1.0])
HEADS = Sensors(
    np.array([[0.12, 0.09, -0.13], [0.12, -0.09, 0.14], [-0.12, 0.09, 0.14]]), [0.0, 0.0, 1.0]
)
BAND = np.linspace(200.0, 3000.0, 15)
LOSS = Damping(structural=0.01)


def dumbbells(comm=MPI.COMM_SELF):
    layer = transition("joint", "joint", E="E", nu="nu", h="h", meshed=0.01, rho=7850.0)
    return Structure(
        dumbbell(comm, layer=0.01, element_size=0.07),
        [part("bodies", BODIES, E=1.3e11, nu=0.27, rho=7850.0), layer],
        [Parameter("E", 1e10), Parameter("nu", 0.24), Parameter("h", 0.01)],
    )


def corner(E, h, nu):
    return {"E": 1.5e10 * 5.0**E, "h": 0.012 * 2.5**h, "nu": 0.25 + 0.15 * nu}


CORNERS = [corner(E, h, nu) for E, h, nu in ((-1, -1, 1), (1, -1, -1), (-1, 1, -1), (1, 1, 1))]
INSIDE = [corner(*c) for c in ((0.4, 0.5, -0.3), (-0.5, 0.3, 0.6), (0.2, -0.7, 0.1))]
SETTINGS = {"frequencies_hz": BAND, "excitation": HIT, "sensors": HEADS, "damping": LOSS}


def test_residual_vectors_and_the_check_over_wide_ranges():
    """E over a factor of 25, h over 6; antiresonances of a point receptance among the lines."""
    model = dumbbells()
    bare = reduce(model, CORNERS, 14)
    basis = frf_basis(model, CORNERS, n_modes=14, **SETTINGS)
    first, error = (frf_error(r, model, INSIDE, lines=4, **SETTINGS) for r in (bare, basis))
    assert np.median(first.relative) > 0.02
    assert np.median(error.relative) < np.median(first.relative) / 40
    # Against the direct solution, called by itself.
    exact = solve_frf(model, INSIDE[1], **SETTINGS | {"frequencies_hz": error.frequencies_hz})
    found = solve_frf(basis, INSIDE[1], **SETTINGS | {"frequencies_hz": error.frequencies_hz})
    assert error.relative[1] == pytest.approx(np.abs(found.values / exact.values - 1), rel=1e-6)
    ask = {"n_modes": 14, "lines": 4, **SETTINGS}
    checked = checked_frf_model(model, CORNERS, INSIDE, error=1e-3, **ask)
    assert checked.error.worst <= 1e-3 < checked.history[0][1]
    assert checked.history[0] == (basis.n_dofs, pytest.approx(error.worst, rel=1e-3))
    same = frf_error(checked.arrays, model, INSIDE, lines=4, **SETTINGS)
    assert same.worst == pytest.approx(checked.error.worst, rel=1e-2)
    with pytest.raises(ConvergenceError, match="at the worst of 3 points"):
        checked_frf_model(model, CORNERS[:1], INSIDE, error=1e-9, rounds=1, **ask | {"lines": 1})


@pytest.mark.parallel
def test_two_ranks_make_the_same_model():
    alone, together = (
        frf_basis(dumbbells(comm), CORNERS[:2], n_modes=12, **SETTINGS).arrays(HIT, HEADS)
        for comm in (MPI.COMM_SELF, MPI.COMM_WORLD)
    )
    ours, theirs = (
        solve_frf(model, CORNERS[0], gradients=True, **SETTINGS) for model in (alone, together)
    )
    assert np.abs(ours.values - theirs.values).max() < 1e-5 * np.abs(ours.values).max()
    scale = np.abs(ours.gradients).max(axis=(0, 1, 2))
    assert np.all(np.abs(ours.gradients - theirs.gradients).max(axis=(0, 1, 2)) < 1e-4 * scale)
