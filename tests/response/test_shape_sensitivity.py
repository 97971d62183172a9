"""Derivatives of mode shapes against finite differences, of single modes and of equal pairs."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from moving_plates import PLACES, VALUES, plates
from mpi4py import MPI
from shape_slopes import shape_slopes

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements import mac
from fenics_joints.meshes import box, in_patches
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.response import (
    clusters,
    mac_gradients,
    shape_gradients,
    span_gradients,
    split_modes,
)
from fenics_joints.structure import Parameter, PointMass, Sensors, Spring, Structure, Support, part

# -- free plates with a layer, a mass that moves and a spring: no mode near another ---------------

LINE = np.concatenate([np.linspace(0.01, 0.12, 12), np.linspace(0.2, 0.31, 12)])
MANY = Sensors(
    np.column_stack([LINE, 0.02 + 0 * LINE, np.where(LINE < 0.16, 0.004, 0.012)]), [0.0, 0.3, 1.0]
)
WANTED = [7, 9, 6]


def shapes_at(model, given, sensors, like):
    """Shapes of the wanted modes with the sign that they had."""
    found = solve_modes(model, given, n_modes=14, tolerance=1e-10).at(sensors)[:, WANTED]
    return found * np.sign(np.sum(found * like, axis=0))


def differences(model, sensors, like):
    """Central differences of the shapes by every parameter."""
    slopes = []
    for name, value in VALUES.items():
        step = 2e-2 if name == "cord" else 2e-4  # soft: round-off is more of a smaller change
        up, down = (shapes_at(model, {name: value * (1 + h)}, sensors, like) for h in (step, -step))
        slopes.append((up - down) / (2 * step * value))
    return np.stack(slopes, axis=-1)


@pytest.mark.parametrize("sensors", [PLACES, MANY], ids=["adjoint", "forward"])
def test_single_modes_of_the_full_and_of_the_reduced_model(sensors):
    model = plates()
    modes = solve_modes(model, n_modes=14, tolerance=1e-10)
    found = shape_gradients(modes, WANTED, sensors)
    expected = differences(model, sensors, modes.at(sensors)[:, WANTED])
    scale = np.abs(expected).max(axis=(0, 1))
    assert np.all(scale > 0)
    assert np.all(np.abs(found - expected).max(axis=(0, 1)) < 2e-5 * scale)
    # The reduced model on its basis, arrays alone too, where a sum over all modes is exact.
    small = reduce(model, [{}], 30, travel={"tip": (0.0, 0.01)})
    arrays = small.arrays(sensors)
    own, same = (
        shape_gradients(solve_modes(m, n_modes=12), WANTED, sensors) for m in (small, arrays)
    )
    size = np.abs(own).max(axis=(0, 1))
    assert np.all(np.abs(same - own).max(axis=(0, 1)) < 1e-8 * size)
    shapes, slopes = shape_slopes(arrays, WANTED)
    rows = arrays.loads(sensors).T
    sign = np.sign(
        np.sum((rows @ shapes) * solve_modes(small, n_modes=12).at(sensors)[:, WANTED], axis=0)
    )
    summed = np.einsum("sn,nmp->smp", rows, slopes) * sign[:, None]
    assert np.all(np.abs(own - summed).max(axis=(0, 1)) < 1e-6 * size)


def test_derivatives_leave_a_remainder_of_second_order():
    model = plates()
    modes = solve_modes(model, n_modes=14, tolerance=1e-10)
    start, direction = modes.at(MANY)[:, WANTED], np.array([3, -2, 2, 5, -6, 3, 4, 7]) / 10
    values = np.array(list(VALUES.values()))
    change = shape_gradients(modes, WANTED, MANY) @ (direction * values)
    reference = start[:, ::-1] + start
    at, slope = mac_gradients(modes, WANTED, MANY, reference)
    assert at == pytest.approx(np.diag(mac(reference, start)), rel=1e-9)
    off, off_mac = [], []
    for h in (4e-3, 2e-3):
        given = dict(zip(VALUES, values * (1 + h * direction), strict=True))
        moved = shapes_at(model, given, MANY, start)
        off.append(np.linalg.norm(moved - start - h * change))
        off_mac.append(np.diag(mac(reference, moved)) - at - h * slope @ (direction * values))
    assert off[0] / off[1] == pytest.approx(4.0, abs=0.1)
    assert off_mac[0] / off_mac[1] == pytest.approx(4.0, abs=0.2)


# -- a clamped beam with a square section: bending in pairs ---------------------------------------

SIDE, LENGTH = 0.02, 0.2
BEAM = {"E": 2e11, "nu": 0.3, "rho": 7800.0, "prop": 1e5, "nut": 0.02}
TIP = Sensors(
    np.array([[LENGTH, 0.0, 0.0], [LENGTH / 2, 0.0, 0.01], [LENGTH, 0.02, 0.01]]),
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.1, 0.5, 0.7]]),
)
PAIR = [0, 1]
#: E keeps the pair together; spring and mass part it, each along its own direction.
PARTING = {"E": 2e10, "prop": 8e4, "nut": 0.002}


def beam(comm=MPI.COMM_SELF):
    """With springs across in both directions at the tip the pair stays one; one may change."""
    middle = (LENGTH, SIDE / 2, SIDE / 2)
    return Structure(
        box(comm, (LENGTH, SIDE, SIDE), (5, 2, 2)),
        [part("beam", "body", E="E", nu="nu", rho="rho")],
        [Parameter(name, value) for name, value in BEAM.items()],
        masses=[PointMass("nut", "nut", middle)],
        springs=[
            Spring("one", "prop", middle, (0.0, 0.6, 0.8)),
            Spring("other", BEAM["prop"], middle, (0.0, -0.8, 0.6)),
        ],
        supports=[Support("x_min")],
    )


def pair_at(model, given=None):
    modes = solve_modes(model, given, n_modes=10, tolerance=1e-10)
    return modes, modes.at(TIP)[:, PAIR]


def along(t, direction):
    return {name: BEAM[name] + t * d for name, d in direction.items()}


def test_an_equal_pair_as_a_span():
    model = beam()
    modes, _ = pair_at(model)
    lam = modes.eigenvalues
    assert abs(lam[1] / lam[0] - 1) < 1e-8
    assert [c.tolist() for c in clusters(modes)][0] == PAIR
    span, slopes = span_gradients(modes, PAIR, TIP)
    reference = np.array([[1.0, 0.3], [0.4, -0.2], [0.1, 0.9]])
    at, by = mac_gradients(modes, PAIR, TIP, reference)
    change = np.array([PARTING.get(name, 0.0) for name in BEAM])
    off, off_mac = [], []
    for t in (0.02, 0.01):
        other, Y = pair_at(model, along(t, PARTING))
        assert other.eigenvalues[1] / other.eigenvalues[0] - 1 > 1e-5
        off.append(np.linalg.norm(Y @ Y.T - span - t * slopes @ change))
        Q = np.linalg.qr(Y)[0]
        best = np.sum((Q.T @ reference) ** 2, axis=0) / np.sum(reference**2, axis=0)
        off_mac.append(np.linalg.norm(best - at - t * by @ change))
    assert off[0] / off[1] == pytest.approx(4.0, abs=0.2)
    assert off_mac[0] / off_mac[1] == pytest.approx(4.0, abs=0.2)
    # What a single shape's formula, 1 / (difference of eigenvalues), makes of it.
    with pytest.raises(InputError, match=r"with the modes \[1\]"):
        span_gradients(modes, [0], TIP)
    wild = shape_gradients(modes, PAIR, TIP, close=0.0)
    assert np.abs(wild).max() > 1e3 * np.abs(shape_gradients(modes, PAIR, TIP)).max()


def test_the_basis_is_the_one_that_turns_the_least():
    """Rotated onto the start by the polar decomposition of X^T M X(p), M at the start."""
    model = reduce(beam(), [{}, along(1.0, PARTING)], 20)
    modes = solve_modes(model, n_modes=10)
    X, M = modes.shapes[:, PAIR], model.mass()
    slopes = shape_gradients(modes, PAIR, TIP)
    rows, t = model.loads(TIP).T, 2e-4
    turned = []
    for step in (t, -t):
        Y = solve_modes(model, along(step, PARTING), n_modes=10).shapes[:, PAIR]
        turned.append(rows @ Y @ scipy.linalg.polar(X.T @ M @ Y)[0].T)
    expected = (turned[0] - turned[1]) / (2 * t)
    change = np.array([PARTING.get(name, 0.0) for name in BEAM])
    assert slopes @ change == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_an_equal_pair_that_parts(kind):
    """Single shapes along one direction, where the eigenvalues' derivatives tell them apart."""
    model = beam()
    if kind == "reduced":
        model = reduce(model, [{}, along(1.0, PARTING)], 20).arrays(TIP)
    modes, _ = pair_at(model)
    found = split_modes(modes, PAIR, TIP, PARTING)
    t = 1e-2
    lam, shapes = [], []
    for step in (t, -t):
        other, Y = pair_at(model, along(step, PARTING))
        # Behind the crossing the modes have changed places.
        order = [0, 1] if step > 0 else [1, 0]
        lam.append(other.eigenvalues[PAIR][order])
        Y = Y[:, order]
        shapes.append(Y * np.sign(np.sum(Y * found.shapes, axis=0)))
    assert found.eigenvalue_slopes == pytest.approx((lam[0] - lam[1]) / (2 * t), rel=1e-4)
    assert found.shapes == pytest.approx(0.5 * (shapes[0] + shapes[1]), rel=1e-3, abs=1e-4)
    expected = (shapes[0] - shapes[1]) / (2 * t)
    assert found.slopes == pytest.approx(expected, abs=2e-3 * np.abs(expected).max())


def test_mistakes_are_named():
    model = beam()
    modes, Y = pair_at(model)
    for make, message in (
        (lambda: shape_gradients(modes, [10], TIP), "modes from 0 to 9"),
        (lambda: mac_gradients(modes, PAIR, TIP, Y[:, :1]), r"expected \(3, 2\)"),
        (lambda: split_modes(modes, PAIR, TIP, {"bolt": 1.0}), "bolt"),
        (lambda: split_modes(modes, PAIR, TIP, {"E": 0.0}), "at least one change"),
    ):
        with pytest.raises(InputError, match=message):
            make()
    for kind in (model, reduce(model, [{}], 20)):
        few = solve_modes(kind, n_modes=1)
        with pytest.raises(ConvergenceError, match="more modes"):
            shape_gradients(few, [0], TIP)
    solve_modes(model, {"E": 1e11}, n_modes=10, solver=modes.solver)
    with pytest.raises(InputError, match="same values"):
        shape_gradients(modes, PAIR, TIP)


@pytest.mark.parallel
def test_two_ranks_agree():
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        modes = solve_modes(plates(comm), n_modes=14, tolerance=1e-10)
        single = [
            shape_gradients(modes, WANTED, sensors)
            * np.sign(modes.at(sensors)[0, WANTED])[None, :, None]
            for sensors in (PLACES, MANY)
        ]
        modes, _ = pair_at(beam(comm))
        parted = split_modes(modes, PAIR, TIP, PARTING)
        sign = np.sign(parted.shapes[0])
        found.append([*single, span_gradients(modes, PAIR, TIP)[1], parted.slopes * sign])
    for alone, together in zip(*found, strict=True):
        assert together == pytest.approx(alone, rel=1e-4, abs=1e-5 * np.abs(alone).max())


# -- a modulus for each patch ----------------------------------------------------------------------


def patched(comm):
    """A free plate of forty patches, one cell each, with moduli that differ and one density."""
    lengths, across = np.array([0.32, 0.2]), np.array([8, 5])
    mesh, names = in_patches(
        box(comm, (*lengths, 0.01), (*across, 1)),
        "body",
        lambda x: np.floor(x[:, :2] / lengths * across).astype(int) @ [1, 8],
    )
    moduli = 7e10 * np.exp(0.2 * np.random.default_rng(8).standard_normal(len(names)))
    return Structure(
        mesh,
        [part(name, name, E=f"{name}.E", nu=0.3, rho="rho") for name in names],
        [
            *(Parameter(f"{n}.E", E, "Pa") for n, E in zip(names, moduli.tolist(), strict=True)),
            Parameter("rho", 2700.0, "kg/m3"),
        ],
    )


@pytest.mark.parallel
def test_by_the_modulus_of_each_patch():
    """Eigenvalues and shapes beside differences, and beside one rank's: patches that have no node
    in common are rows of one matrix, on one rank or on several."""
    model, wanted = patched(MPI.COMM_WORLD), np.arange(6, 12)
    places = Sensors([[0.01, 0.02, 0.01], [0.13, 0.19, 0.01], [0.3, 0.08, 0.01]], [0.1, 0.2, 1.0])

    def solved(model, given=None):
        modes = solve_modes(model, given, n_modes=14, tolerance=1e-10)
        return modes, modes.at(places)[:, wanted]

    modes, shapes = solved(model)
    found = modes.gradients(wanted), shape_gradients(modes, wanted, places)
    alone, same = solved(patched(MPI.COMM_SELF))
    sign = np.sign(np.sum(same * shapes, axis=0))
    assert found[0] == pytest.approx(alone.gradients(wanted), rel=1e-6)
    expected = shape_gradients(alone, wanted, places) * sign[:, None]
    assert np.abs(found[1] - expected).max() < 1e-6 * np.abs(expected).max()
    names, values = list(model.parameters), model.values()
    for p in [*np.random.default_rng(5).choice(40, 3, replace=False).tolist(), 40]:
        step = 1e-3 * values[names[p]]
        (up, high), (down, low) = (
            solved(model, {names[p]: values[names[p]] + s}) for s in (step, -step)
        )
        slopes = (up.eigenvalues - down.eigenvalues)[wanted] / (2 * step)
        assert found[0][:, p] == pytest.approx(slopes, rel=1e-4)
        high, low = (at * np.sign(np.sum(at * shapes, axis=0)) for at in (high, low))
        slopes = (high - low) / (2 * step)
        assert np.abs(found[1][..., p] - slopes).max() < 1e-4 * np.abs(slopes).max()
