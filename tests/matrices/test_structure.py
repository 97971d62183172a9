"""Parts by matrices against meshes of the same parts, and against differences."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from matrix_parts import HIGH, LOW, box, lap_parts, lap_structure
from unlike_meshes import COMM, STEEL, lap, springs

from fenics_joints.errors import InputError
from fenics_joints.harmonic import solve_backbone
from fenics_joints.interfaces import reduce_layers, reduce_matrix_joints
from fenics_joints.joint_laws import Iwan, RichardAbbott
from fenics_joints.matrices import MatrixJoint, MatrixPart, MatrixStructure, NodeInterface
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.reduction.surrogate import tested_models as small_models
from fenics_joints.response import solve_frf
from fenics_joints.structure import (
    Damping,
    Parameter,
    PointMass,
    Sensors,
    Spring,
    Structure,
    Support,
    joint_law,
)
from fenics_joints.structure.sparse import as_columns

SAME, UNLIKE = ((20, 4, 2), (20, 4, 2)), ((10, 2, 1), (30, 6, 3))


@pytest.mark.parallel
@pytest.mark.parametrize(("low", "high"), [SAME, UNLIKE])
@pytest.mark.parametrize("k", [1e12, 1e10])
def test_modes_are_those_of_a_mesh_with_a_layer(low, high, k):
    mesh = solve_modes(springs(lap(low, high), 1, k, k), n_modes=14)
    found = solve_modes(lap_structure(low, high, k, k), n_modes=14)
    assert found.frequencies_hz[6:] == pytest.approx(mesh.frequencies_hz[6:], rel=5e-5)
    sensors = Sensors([[0.0, 0.0, 0.01], [0.05, 0.037, 0.01], [0.31, 0.011, 0.02]], [0, 0, 1])
    a, b = (modes.at(sensors)[:, 6:11] for modes in (found, mesh))
    # Beside nodes a linear field through the nearest ones.
    assert np.abs(np.abs(a) - np.abs(b)).max() < 0.02 * np.abs(b).max()


@pytest.mark.parallel
def test_masses_springs_and_supports_are_those_of_a_mesh():
    held = {
        "masses": [PointMass("bolt", 0.05, (0.16, 0.02, 0.01))],
        "springs": [Spring("ground", 1e6, (0.32, 0.0, 0.02), (0, 0, 1))],
    }
    plain = lap_structure(*UNLIKE)
    low = plain.parts[0]
    rows = low.rows[np.isclose(low.points[:, 0], 0), :3].ravel()
    found = lap_structure(*UNLIKE, supports=[("low", rows)], **held)
    tagged = lap(*UNLIKE, faces=[("end", 0, 0.0)])
    mesh = springs(tagged, 1, supports=[Support("end")], **held)
    a, b = (solve_modes(s, n_modes=8).frequencies_hz for s in (found, mesh))
    assert a == pytest.approx(b, rel=1e-3)  # the bolt is between nodes
    assert found.total_mass() == pytest.approx(plain.total_mass() + 0.05)
    volume = 2 * 0.2 * 0.04 * 0.01
    assert plain.total_mass() == pytest.approx(STEEL["rho"] * volume)


@pytest.mark.parallel
def test_derivatives_and_energies():
    s = lap_structure(*UNLIKE)
    modes = solve_modes(s, n_modes=10)
    slopes = s.pencil_gradients(modes.shapes, modes.eigenvalues)[6:]
    for i, (name, parameter) in enumerate(s.parameters.items()):
        step = 1e-4 * parameter.value
        high, low = (
            solve_modes(s, {name: parameter.value + sign * step}, n_modes=10).eigenvalues[6:]
            for sign in (1, -1)
        )
        assert slopes[:, i] == pytest.approx((high - low) / (2 * step), rel=2e-4, abs=1e-9)
    x = modes.vector(7)
    stiff, heavy = s.cell_energies(x, [x])
    assert stiff.sum() == pytest.approx(modes.eigenvalues[7], rel=1e-6)
    assert heavy.sum() == pytest.approx(1.0)


@pytest.mark.parallel
def test_reduced_models_are_exact_at_their_samples_and_know_their_error():
    s = lap_structure(*UNLIKE)
    soft = s.values({"k_n": 1e11, "k_t": 2e10, "steel.E": 1.9e11})
    reduced = reduce(s, [s.values(), soft], n_modes=14)
    for values in (s.values(), soft):
        full = solve_modes(s, values, n_modes=12).frequencies_hz[6:]
        assert solve_modes(reduced, values, n_modes=12).frequencies_hz[6:] == pytest.approx(full)
    sensors = Sensors([[0.0, 0.0, 0.01], [0.32, 0.0, 0.02], [0.2, 0.0, 0.0]], [0, 0, 1])
    free = small_models(s).free(
        s, s.values(), ["k_n", "k_t"], sensors=sensors, n_test=3, n_modes=14
    )
    x = np.random.default_rng(COMM.rank).normal(size=(s.n_local, 2))
    K, M = s.stiffness(soft | {"steel.E": 2e11}), s.mass()
    vectors = [K.createVecRight() for _ in range(2)]
    for vector, column in zip(vectors, x.T, strict=True):
        vector.array[:] = column
    wanted = as_columns([K * v - 3.0e6 * (M * v) for v in vectors])
    found = free.terms.residuals(x, np.full(2, 3.0e6), [{"k_n": 1e11, "k_t": 2e10}] * 2)
    assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_functions_with_a_lossy_joint():
    s, mesh = lap_structure(*SAME), springs(lap(*SAME), 1)
    at = {
        "frequencies_hz": np.linspace(100, 900, 5),
        "excitation": Sensors([[0.0, 0.0, 0.01]], [0, 0, 1]),
        "sensors": Sensors([[0.32, 0.0, 0.02]], [0, 0, 1]),
        "damping": Damping(hysteretic={"joint": 0.2}, structural=0.01),
    }
    a, b = (solve_frf(each, **at).values for each in (s, mesh))
    assert np.abs(a - b).max() < 2e-3 * np.abs(b).max()


def test_a_yielding_joint_as_in_a_mesh():
    """The same backbone from a layer of cells and from the jump between matrices."""
    k_n, k_t, places = 1e12, 1e11, {"sensors": {"tip": ([0.0, 0.0, 0.01], [0, 0, 1])}}
    mesh = springs(lap(*SAME), 1, k_n, k_t)
    thin = mesh.regions[1].properties["meshed"]
    laws = [{"joint": Iwan(RichardAbbott(k, 1e-3 * k, 2e4, 1.0), 20)} for k in (k_t * thin, k_t)]
    bound = {"n_modes": 14, "interface_modes": 30, **places}
    models = (
        reduce_layers(mesh, laws[0], **bound),
        reduce_matrix_joints(lap_structure(*SAME, k_n, k_t), laws[1], **bound),
    )
    curves = [solve_backbone(model, (1e-6, 3e-5), harmonics=3) for model in models]
    amplitudes = np.geomspace(2e-6, 2.5e-5, 5)
    for key, least in (("frequencies_hz", 0), ("damping_ratios", 1e-4)):
        a, b = (np.interp(amplitudes, c.amplitude(), getattr(c, key)) for c in curves)
        assert a == pytest.approx(b, rel=0.02 if least else 2e-4, abs=least)
    assert b.max() > 0.0025  # it yields


def test_a_law_of_ones_own_is_that_of_springs():
    @joint_law(k_n="Pa/m", k_t="Pa/m")
    def own(jump, normal, q):
        opening = ufl.dot(jump, normal)
        return q["k_n"] * opening * normal + q["k_t"] * (jump - opening * normal)

    a, b = (
        solve_modes(lap_structure(*UNLIKE, 1e11, 3e10, **more), n_modes=10).frequencies_hz[6:]
        for more in ({}, {"law": own})
    )
    assert a == pytest.approx(b, rel=1e-9)


def shell(name: str, z: float) -> MatrixPart:
    """Nodes with rotations on a plane, and any matrices."""
    x, y = np.meshgrid(np.linspace(0, 0.1, 6), np.linspace(0, 0.04, 3), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])
    dofs = np.column_stack([np.repeat(np.arange(x.size), 6), np.tile(range(6), x.size)])
    A = np.ones((len(dofs),) * 2)
    return MatrixPart(name, A, np.eye(len(dofs)), points, dofs)


def test_shells_apart_by_their_thickness_turn_together():
    low, high = shell("low", 0.0), shell("high", 0.006)
    faces = NodeInterface(low, range(18), high, range(18))
    rigid = np.vstack([low.rigid_motion(), high.rigid_motion()])
    assert np.abs(faces.jump @ rigid).max() < 1e-15
    assert faces.areas.sum() == pytest.approx(0.1 * 0.04)
    # Turned about y each by itself: the faces between slide by half of the distance each.
    turned = np.concatenate([np.zeros(108), high.rigid_motion([0.05, 0.02, 0.006])[:, 4]])
    slid = (faces.jump @ turned).reshape(-1, 3)
    assert slid[:, 0] == pytest.approx(-0.003)
    whole = MatrixJoint("j", faces, {"k_n": 1.0, "k_t": 1.0}).matrices()[1]
    assert turned @ whole @ turned == pytest.approx(0.004 * 0.003**2)


def test_what_does_not_touch_is_refused():
    low, high = lap_parts(*UNLIKE)
    top = np.flatnonzero(np.isclose(low.points[:, 2], 0.01))
    away = box("away", ([0, 0.1, 0.01], [0.2, 0.14, 0.02]), (10, 2, 1))
    with pytest.raises(InputError, match="do not overlap"):
        NodeInterface(low, top, away, np.flatnonzero(np.isclose(away.points[:, 2], 0.01)))
    raised = box("raised", ([0.12, 0, 0.013], [0.32, 0.04, 0.023]), (10, 2, 1))
    with pytest.raises(InputError, match="3 mm apart"):
        NodeInterface.between(low, raised)
    with pytest.raises(InputError, match="not on a flat face"):
        NodeInterface(low, range(len(low.points)), high, range(len(high.points)))
    with pytest.raises(InputError, match=r"sensor.*mm from the nearest node"):
        lap_structure(*UNLIKE).observe([], Sensors([[0.1, 0.5, 0.0]], [0, 0, 1]))
    with pytest.raises(InputError, match="not symmetric"):
        MatrixPart("p", np.triu(np.ones((3, 3))), np.eye(3), [[0, 0, 0]], [(0, 0), (0, 1), (0, 2)])
    assert LOW[1][2] == HIGH[0][2]


def test_a_hole_stays_open():
    """Triangles across a hole join nodes that share no element."""
    low, high = lap_parts((20, 4, 1), (20, 4, 1))
    gone = np.all(np.abs(low.points - [0.16, 0.02, 0.005]) < [0.011, 0.011, 1], axis=1)
    keep = ~gone[low.dofs[:, 0]]
    number = np.cumsum(~gone) - 1
    holed = MatrixPart(
        "holed",
        low.stiffness[keep][:, keep],
        low.mass[keep][:, keep],
        low.points[~gone],
        np.column_stack([number[low.dofs[keep, 0]], low.dofs[keep, 1]]),
    )
    assert NodeInterface.between(low, high).areas.sum() == pytest.approx(0.08 * 0.04)
    # Nine nodes less: of the sixteen cells of 10 mm around them the corners are half there, or all
    # or nothing where the processor's round-off cuts the squares of nodes the other way.
    open_area = 0.08 * 0.04 - NodeInterface.between(holed, high).areas.sum()
    assert open_area == pytest.approx(14e-4, abs=2e-4)


def test_it_is_a_structure_like_others():
    s = lap_structure(*UNLIKE)
    assert not isinstance(s, Structure)
    corners, moved = s.corner_motion(solve_modes(s, n_modes=7).shapes[:2])
    if COMM.rank == 0:
        assert corners.shape == moved.shape[1:] == (len(s.nodes), 8, 3)
    with pytest.raises(InputError, match="two parts or joints"):
        MatrixStructure([s.parts[0], s.parts[0]])
    with pytest.raises(InputError, match="expected one of"):
        s.region_stiffness("nothing")
    with pytest.raises(InputError, match="expected rows from 0"):
        lap_structure(*UNLIKE, supports=[("low", [-1])])
    assert isinstance(s.parameters["k_n"], Parameter)


def test_unlike_nodes_on_thin_plates():
    lower = box("lower", ([0, 0, 0], [0.2, 0.06, 0.004]), [8, 2, 1])
    upper = box("upper", ([0.14, 0, 0.004], [0.34, 0.06, 0.008]), [20, 4, 1])
    interface = NodeInterface.between(lower, upper)
    assert np.allclose(interface.normal, [0, 0, 1])
    assert interface.areas.sum() == pytest.approx(0.06 * 0.06, rel=0.07)


def test_a_sensor_moves_with_the_part_that_it_lies_on():
    lower = box("lower", ([0, 0, 0], [0.2, 0.06, 0.004]), [4, 1, 1])  # few nodes, far apart
    upper = box("upper", ([0.14, 0, 0.004], [0.34, 0.06, 0.008]), [20, 6, 1])
    joint = MatrixJoint("lap", NodeInterface.between(lower, upper), {"k_n": 1e12, "k_t": 1e12})
    structure = MatrixStructure([lower, upper], [joint])
    rows = structure.displacement([[0.175, 0.03, 0.0], [0.175, 0.03, 0.008]])
    split = len(lower.dofs)
    assert not rows[:3, split:].nnz and rows[:3, :split].nnz
    assert not rows[3:, :split].nnz and rows[3:, split:].nnz
