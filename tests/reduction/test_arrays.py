"""The reduced model of plain arrays against the reduced structure that it is made of."""

from __future__ import annotations

import numpy as np
import pytest
from shape_slopes import shape_slopes

pytest.importorskip("dolfinx")

import scipy.linalg
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates
from fenics_joints.reduction import ArrayModel, read_array_model, reduce, write_array_model
from fenics_joints.structure import (
    ElasticSupport,
    Parameter,
    PointMass,
    Sensors,
    Spring,
    Structure,
    joint,
    part,
)

AXIS = np.array([1.0, 0.0, 0.0])
SENSORS = Sensors(np.array([[0.11, 0.03, 0.008], [0.31, 0.05, 0.016]]), [0.0, 0.0, 1.0])
NOMINAL = {
    "E": 7e10,
    "nu": 0.3,
    "rho": 2700.0,
    "s": 1.0,
    "layer.E": 5e9,
    "layer.G": 1e9,
    "tip.mass": 0.03,
    "tip.travel": 0.04,
    "nut.mass": 0.05,
    "cord.k": 2e4,
    "wall.k_n": 1e11,
    "wall.k_t": 3e10,
}
#: Far from what the basis was made at.
ELSEWHERE = NOMINAL | {
    "E": 5e10,
    "nu": 0.25,
    "s": 1.1,
    "layer.G": 2e8,
    "tip.mass": 0.1,
    "tip.travel": 0.07,
    "cord.k": 3e5,
    "wall.k_n": 2e10,
    "wall.k_t": 1e13,
}


def make(comm):
    """The reduced structure and its arrays; every kind of component, each with a parameter."""
    plates = part("plates", ("plate_1", "plate_2"), E="E", nu="nu", rho="rho", stretch="s")
    layer = joint("layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G")
    full = Structure(
        lap_plates(comm, element_size=0.04, n_thickness=1),
        [plates, layer],
        [Parameter(name, value, log=False) for name, value in NOMINAL.items()],
        masses=[
            PointMass("tip", "tip.mass", (0.21, 0.03, 0.0165), travel="tip.travel"),
            PointMass("nut", "nut.mass", (0.15, 0.02, 0.0), share=0.5),
        ],
        springs=[Spring("cord", "cord.k", (0.31, 0.0, 0.012), (0.0, 1.0, 0.0), share=0.5)],
        supports=[ElasticSupport("wall", "end_1", "wall.k_n", "wall.k_t")],
        degree=1,
    )
    small = reduce(full, [NOMINAL, ELSEWHERE], 8, travel={"tip": (0.0, 0.1)})
    rows = full.observe(small.basis, SENSORS)
    shifts = full.observe_slopes(small.basis, SENSORS, AXIS)
    return small, ArrayModel(small.pencil, small.scale_hz, rows, shifts[None])


@pytest.fixture(scope="module")
def both():
    return make(MPI.COMM_SELF)


def plain_sum(pencil, values):
    """K and M term by term."""
    K, M = (np.zeros((pencil.n, pencil.n)) for _ in range(2))
    for region in pencil.terms_by_law:
        q = region.values(values)
        for factor, term in zip(region.law.stiffness_terms(q), region.stiffness, strict=True):
            K += factor * term
        M += region.law.inertia_term(q) * region.inertia
    for mass in pencil.moving:
        at, _ = mass(values[mass.travel])
        M += mass.share * values[mass.mass] * at.T @ at
    return K, M


@pytest.mark.parallel
@pytest.mark.parametrize("comm", [MPI.COMM_WORLD], ids=["world"])
def test_matrices_and_derivatives_are_the_structures(comm):
    small, arrays = make(comm)
    assert arrays.n_dofs == small.n_dofs and list(arrays.parameters) == list(small.parameters)
    x = np.random.default_rng(1).standard_normal((small.n_dofs, 3))
    lam = np.array([1e4, 3e6, 2e8])
    for given in ({}, ELSEWHERE, {"layer.G": 4e8, "tip.travel": 0.01}):
        values = arrays.values(given)
        for model in (arrays, small):
            for got, expected in zip(
                (model.stiffness(given), model.mass(given)),
                plain_sum(arrays.pencil, values),
                strict=True,
            ):
                assert np.abs(got - expected).max() < 1e-12 * np.abs(expected).max()
        gradients = small.pencil_gradients(x, lam, given)
        scale = np.abs(gradients).max(axis=0)
        assert np.all(scale > 0)
        for i, name in enumerate(values):
            step = 1e-4 * max(values[name], 0.01)
            up, down = (
                plain_sum(arrays.pencil, {**values, name: values[name] + s}) for s in (step, -step)
            )
            K, M = ((a - b) / (2 * step) for a, b in zip(up, down, strict=True))
            change = np.sum(x * (K @ x), axis=0) - lam * np.sum(x * (M @ x), axis=0)
            assert gradients[:, i] == pytest.approx(change, rel=1e-5, abs=1e-6 * scale[i])
        assert arrays.total_mass(given) == pytest.approx(small.total_mass(given), rel=1e-12)
    assert np.array_equal(arrays.observe(x), small.observe(x, SENSORS))
    # The same on all ranks, to the last bit: what is fitted on one is fitted on all.
    everywhere = comm.allgather(arrays.stiffness(ELSEWHERE).tobytes())
    assert len(set(everywhere)) == 1


def modes_of(model, values):
    """Eigenvalues and mass-normalised vectors by LAPACK, of positive first component."""
    lam, x = scipy.linalg.eigh(model.stiffness(values), model.mass(values))
    return lam, x * np.sign(x[0])


def test_slopes_of_shapes_are_differences_of_shapes(both):
    _, model = both
    index = np.array([1, 2, 4])
    lam, exact = modes_of(model, ELSEWHERE)
    near = np.array([np.min(np.abs(np.delete(lam, i) / lam[i] - 1)) for i in index])
    assert near.min() > 0.05  # else the derivatives mean little
    x, slopes = shape_slopes(model, index, ELSEWHERE)
    signs = np.sign(x[0])
    assert x * signs == pytest.approx(exact[:, index], rel=1e-6, abs=1e-6 * np.abs(x).max())
    for j, name in enumerate(NOMINAL):
        step = 1e-5 * ELSEWHERE[name]
        up, down = (
            modes_of(model, ELSEWHERE | {name: ELSEWHERE[name] + s})[1][:, index]
            for s in (step, -step)
        )
        numeric = (up - down) / (2 * step)
        scale = np.abs(numeric).max(axis=0)
        error = np.abs(slopes[:, :, j] * signs - numeric).max(axis=0)
        # A vector's own round-off over the step bounds what a difference can show.
        assert np.all(error < 1e-3 * scale + 1e-9 * np.abs(x).max() / step), name


def test_a_file_gives_the_same_numbers_on_any_rank(both, tmp_path):
    """Elastic supports and moving masses too; a foreign or broken file is named."""
    _, model = both
    path = tmp_path / "model.h5"
    write_array_model(model, path)
    again = read_array_model(path)
    assert list(again.parameters) == list(model.parameters)
    for given in ({}, ELSEWHERE):
        assert np.array_equal(again.stiffness(given), model.stiffness(given))
        assert np.array_equal(again.mass(given), model.mass(given))
    assert np.array_equal(again.sensor_rows, model.sensor_rows)
    assert np.array_equal(again.shift_rows, model.shift_rows)
    slopes = [shape_slopes(m, [1, 2], ELSEWHERE)[1] for m in (model, again)]
    assert np.array_equal(*slopes)
    assert [p.name for p in tmp_path.iterdir()] == ["model.h5"]
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="model.h5: is damaged"):
        read_array_model(path)
    with pytest.raises(InputError, match="no such file"):
        read_array_model(tmp_path / "none.h5")
