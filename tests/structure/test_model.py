"""The contract of models, of all kinds of them: what it promises, found by other routes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI

from fenics_joints.beams import Beam, BeamStructure, GenericJoint, LumpedMass
from fenics_joints.diagnosis.plan.added import loaded
from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates, stacked_blocks
from fenics_joints.modal import frequency_sensitivity, solve_modes
from fenics_joints.preload import Contact, PreloadModel
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.reduction.reduced import reduce
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
)
from fenics_joints.structure.model import Damped, Model, Pictured

VALUES = {"plates.E": 69e9, "plates.rho": 2750.0, "layer.E": 8e8, "layer.G": 3e8}
VALUES |= {"tip.mass": 0.03, "tip.travel": 0.007}
MOUNT = {"cord.k": 2e5, "wall.k_n": 3e10, "wall.k_t": 2e9}
POINTS = np.array(
    [[0.013, 0.031, 0.008], [0.151, 0.017, 0.0165], [0.307, 0.071, 0.012], [0.05, 0.062, 0.0]]
)
UP = Sensors(POINTS, [0.0, 0.0, 1.0])


def solid(mount=(), **mounted) -> Structure:
    plates = part("plates", ("plate_1", "plate_2"), E="plates.E", nu=0.283, rho="plates.rho")
    layer = joint("layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G")
    return Structure(
        lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1),
        [plates, layer],
        [Parameter(name, value) for name, value in {**VALUES, **dict(mount)}.items()],
        masses=[PointMass("tip", "tip.mass", (0.012, 0.033, 0.0), travel="tip.travel")],
        degree=1,
        **mounted,
    )


def mounted() -> Structure:
    return solid(
        MOUNT,
        springs=[Spring("cord", "cord.k", (0.151, 0.017, 0.0165), (0.0, 0.6, 0.8))],
        supports=[ElasticSupport("wall", "end_1", "wall.k_n", "wall.k_t")],
    )


def beams() -> BeamStructure:
    steel = {"E": "E", "nu": 0.3, "rho": "rho"}
    laps = [Beam(name, 0.2, 0.08, 0.01, 6, **steel) for name in ("upper", "lower")]
    lap = GenericJoint("lap", 0.05, 2, k1="k1", k2="k2", c="c")
    values = {"E": 2e11, "rho": 7850.0, "k1": 1.8e3, "k2": 4e4, "c": 0.2, "m": 0.02}
    return BeamStructure(
        laps,
        [lap],
        [Parameter(name, value) for name, value in values.items()],
        masses=[LumpedMass("bolt", "m", (0.18, 0.0, 0.0), 0.01)],
    )


def reduced():
    return reduce(solid(), [{}, {"layer.G": 5e7}], 14, travel={"tip": (0.0, 0.02)})


def contact() -> LinearJoint:
    x, y, z = np.linspace(0.0, 0.2, 9), np.linspace(0.0, 0.02, 3), np.linspace(0.0, 0.01, 2)
    mesh = stacked_blocks(MPI.COMM_SELF, lower=(x, y, -z[::-1]), upper=z)
    parts = [part("bars", ("lower", "upper"), E="E", nu=0.29, rho="rho")]
    structure = Structure(mesh, parts, [Parameter("E", 2e11), Parameter("rho", 8e3)], degree=1)
    pads = Contact("pads", "interface_lower", "interface_upper", friction=0.3)
    return LinearJoint(PreloadModel(structure, [pads]))


KINDS = {
    "solid": solid,
    "beams": beams,
    "reduced": reduced,
    "arrays": lambda: reduced().arrays(UP),
    "mounted": mounted,
    "mounted, reduced": lambda: reduce(mounted(), [{}], 20, travel={"tip": (0.0, 0.02)}),
    "contact": contact,
    "loaded": lambda: loaded(
        beams().arrays(sensors("loaded", None)), beams().displacement_rows(POINTS[:1])[0], 0.01
    ),
}
WITH_LAYERS = ("solid", "beams", "reduced", "arrays")
WITH_PICTURES = ("solid", "beams", "contact")


@cache
def made(kind: str) -> Model:
    return KINDS[kind]()


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    return request.param


@pytest.fixture
def model(kind) -> Model:
    return made(kind)


def dense(A) -> np.ndarray:
    if isinstance(A, np.ndarray):
        return A
    copy = A.convert("dense")
    return np.array(copy.getDenseArray())


def columns(shapes) -> np.ndarray:
    return shapes if isinstance(shapes, np.ndarray) else np.array([x.array_r for x in shapes]).T


def matrices(model, given=None) -> tuple[np.ndarray, np.ndarray]:
    return dense(model.stiffness(given)), dense(model.mass(given))


def slopes(model, name, X) -> np.ndarray:
    """Central differences of K X and M X by a parameter."""
    value = model.values()[name]
    up, down = (
        np.array([A @ X for A in matrices(model, {name: value * (1 + t)})]) for t in (1e-4, -1e-4)
    )
    return (up - down) / (2e-4 * value)


def sensors(kind: str, model: Model) -> Sensors:
    """All along z, not on one line."""
    points = POINTS
    if kind in ("beams", "loaded"):
        points = POINTS * [1.0, 0.0, 0.0]
    elif kind == "contact":
        points = model.structure.mesh.geometry.x[::7]
    return Sensors(points, [0.0, 0.0, 1.0])


def test_matrices(kind, model):
    """Also: a model is what the protocols of its kind ask for."""
    assert isinstance(model, Model) and len(repr(model)) < 200
    assert isinstance(model, Damped) or kind not in WITH_LAYERS
    assert isinstance(model, Pictured) or kind not in WITH_PICTURES
    K, M = matrices(model)
    assert model.is_dense == isinstance(model.stiffness(), np.ndarray)
    assert K.shape == M.shape == (model.n_dofs, model.n_dofs)
    for A in (K, M):
        assert A == pytest.approx(A.T, abs=1e-12 * np.abs(A).max())
        lowest = scipy.linalg.eigvalsh(A, subset_by_index=[0, 0])
        assert lowest > -1e-10 * np.abs(A).max()
    assert model.parameters.keys() <= model.values().keys()
    with pytest.raises(InputError, match="does not exist"):
        model.values({"no such": 1.0})


def test_frequencies_are_those_of_dense_matrices(kind, model):
    modes = solve_modes(model, n_modes=9)
    K, M = matrices(model)
    shift = (2 * np.pi * 40.0) ** 2
    exact = 1 / scipy.linalg.eigh(M, K + shift * M, eigvals_only=True)[::-1][:9] - shift
    elastic = slice(modes.n_rigid, None)
    assert modes.n_rigid in ((0,) if kind.startswith("mounted") else (3, 6))
    assert modes.eigenvalues[elastic] == pytest.approx(exact[elastic], rel=1e-8)
    X = columns(modes.shapes)
    assert X.T @ M @ X == pytest.approx(np.eye(9), abs=1e-6)


def test_gradients_are_differences(kind, model):
    modes = solve_modes(model, n_modes=9)
    index = np.arange(modes.n_rigid, 9)
    found, X = modes.gradients(index), columns(modes.shapes)[:, index]
    for p, name in enumerate(model.parameters):
        by_K, by_M = np.sum(X * slopes(model, name, X), axis=1)
        expected = by_K - modes.eigenvalues[index] * by_M
        scale = modes.eigenvalues[index] / model.values()[name]
        # Round-off of the difference counts more in the low modes of a mounted body.
        off = 1e-5 if kind.startswith("mounted") else 1e-6
        assert found[:, p] / scale == pytest.approx(expected / scale, abs=off)
    by_frequency = found / (2 * modes.eigenvalues[index, None])
    assert frequency_sensitivity(modes, index) == pytest.approx(by_frequency, rel=1e-12)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("mounted")])
def test_sensors_see_a_free_body_move_as_one(kind, model):
    """Rigid-body modes hold the unit translation, whose modal mass is that of the body."""
    modes = solve_modes(model, n_modes=9)
    rigid = modes.at(sensors(kind, model))[:, : modes.n_rigid]
    weights = np.linalg.lstsq(rigid, np.ones(len(rigid)), rcond=1e-6)[0]
    assert rigid @ weights == pytest.approx(np.ones(len(rigid)), abs=1e-6)
    # Motions along z have no mass in common with those in the plane, which the sensors miss.
    assert weights @ weights == pytest.approx(model.total_mass(), rel=1e-6)


@pytest.mark.parametrize("kind", WITH_LAYERS)
def test_layers_sum_up_and_move_with_the_parameters(kind, model):
    K, M = matrices(model)
    parts = [dense(model.region_stiffness(name)) for name in model.layers]
    assert sum(parts) == pytest.approx(K, abs=1e-9 * np.abs(K).max())
    X = np.random.default_rng(1).standard_normal((model.n_dofs, 3))
    apart = model.layers[-1]
    found = {"K": np.zeros((len(model.parameters), *X.shape)), apart: 0.0}
    found["M"] = found["K"].copy()
    for p, what, name, form in model.slopes(apart=[apart]):
        assert name in (None, apart)
        found[what][p] += form @ X
    for p, name in enumerate(model.parameters):
        for what, A, expected in zip("KM", (K, M), slopes(model, name, X), strict=True):
            off = 1e-6 * max(np.abs(expected).max(), 1e-9 * np.abs(A @ X).max())
            assert found[what][p] == pytest.approx(expected, abs=off)


@pytest.mark.parametrize("kind", WITH_LAYERS)
def test_loads_are_what_sensors_read(kind, model):
    places, modes = sensors(kind, model), solve_modes(model, n_modes=9)
    read = model.loads(places).T @ columns(modes.shapes)
    assert modes.at(places) == pytest.approx(read, abs=1e-9 * np.abs(read).max())
    damping = model.resolved(Damping(structural=1e-3))
    damping.check(model.parameters, model.layers, model.dampers)


@pytest.mark.parametrize("kind", WITH_PICTURES)
def test_pictures_move_as_sensors_read(kind, model):
    modes = solve_modes(model, n_modes=9)
    corners, motions = model.corner_motion([modes.vector(i) for i in range(9)])
    assert motions.shape == (9, *corners.shape)
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    assert high - low == pytest.approx(model.size_m, rel=1e-9)
    at = corners[0, 0] if kind != "beams" else corners[0, 0] * [1, 0, 1]
    read = modes.at(Sensors([at], [0.0, 0.0, 1.0]))[0]
    assert motions[:, 0, 0, 2] == pytest.approx(read, abs=1e-9 * np.abs(read).max())
    assert all(ring.name for ring in model.rings())
