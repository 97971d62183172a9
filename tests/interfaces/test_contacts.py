"""Contacts as springs and pairs at a reduced interface."""

from __future__ import annotations

import numpy as np
import pytest
from layered_plates import Bond, N, Stick, blocks, relative, sprung

from fenics_joints.harmonic import solve_harmonic
from fenics_joints.interfaces import loading_shapes, reduce_contacts, with_modal_damping
from fenics_joints.joint_laws import CoulombStick
from fenics_joints.modal import solve_modes
from fenics_joints.preload import OPEN, SLIP, WasherForce
from fenics_joints.preload.linear_joint import LinearJoint


@pytest.mark.parallel
@pytest.mark.parametrize("method", ["craig-bampton", "free-interface"])
def test_contacts_are_springs_where_their_laws_are(method):
    model, k_n, k = blocks(), 1e13, 1e11
    exact = solve_modes(sprung(model, k_n, k), n_modes=N)
    joint, law = LinearJoint(model), {"pads": Bond(k_n=k_n, k=k)}
    reduced = reduce_contacts(joint, law, method=method, n_modes=30)
    found = relative(solve_modes(reduced, n_modes=N), exact, 6)
    # Of free-interface modes the frequencies are the full model's; of fixed ones an upper bound.
    assert -1e-8 < found.min() and found.max() < (5e-3 if method == "craig-bampton" else 1e-8)
    # An uncoupled law keeps the pairs closed, as springs without end do.
    exact = solve_modes(sprung(model, 1e17, k), n_modes=N)
    reduced = reduce_contacts(joint, {"pads": Stick(k=k)}, method=method, n_modes=30)
    found = relative(solve_modes(reduced, n_modes=N), exact, 6)
    assert -1e-6 < found.min() and found.max() < (5e-3 if method == "craig-bampton" else 1e-6)


@pytest.mark.parallel
def test_open_pairs_are_no_part_of_an_uncoupled_interface():
    model = blocks(degree=1)
    middle = model.interfaces[0].points[:, 0]
    conditions = {"pads": np.where(np.abs(middle - 0.1) > 0.06, SLIP, OPEN)}
    exact = solve_modes(LinearJoint(model, conditions), n_modes=N)
    reduced = reduce_contacts(LinearJoint(model, conditions), {"pads": Stick(k=0.0)}, n_modes=20)
    modes = solve_modes(reduced, n_modes=N)
    assert len(reduced.interfaces[0]) == np.sum(conditions["pads"] == SLIP)
    n_rigid = modes.n_rigid
    assert n_rigid == exact.n_rigid == 9  # the pads slide: two ways and a turn more
    assert np.abs(relative(modes, exact, n_rigid)).max() < 1e-3


@pytest.mark.parallel
def test_a_bolt_presses_the_contact_it_is_a_force_of():
    """Static response to the bolt's force: the pressure over the area is the force."""
    model = blocks(bolts=[WasherForce("bolt", "bottom", "top", 100.0)])
    reduced = reduce_contacts(LinearJoint(model), {"pads": Bond(k_n=1e12, k=1e11)}, n_modes=12)
    K, M = reduced.stiffness_at_rest(), reduced.M
    x = np.linalg.solve(K + 1.0 * M, reduced.row("forces", "bolt"))
    points = reduced.interfaces[0]
    pressure = -1e12 * (points.rows[:, 0] @ x)
    assert points.weights @ pressure == pytest.approx(1.0, rel=1e-5)
    assert pressure == pytest.approx(np.full(len(points), 1 / 0.004), rel=0.05)


def gaping(model):
    """Friction on the blocks' contact, pressed in the middle and open at the ends."""
    along = (model.interfaces[0].points[:, 0] - 0.1) / 0.05
    pressure = np.where(np.abs(along) < 1, 2e6 * (1 - along**2) + 1e4, -5e5 * (np.abs(along) - 0.9))
    return CoulombStick(1e13, 8e12, 0.3, pressure[:, None])


@pytest.mark.parallel
def test_an_open_pair_has_no_stiffness_at_rest():
    """Not along the contact either: the modes at rest are those of the closed pairs' springs."""
    model = blocks(degree=1)
    law = gaping(model)
    closed = np.asarray(law.parameters["pressure"])[:, 0] > 0
    areas = model.interfaces[0].areas * closed
    springs = {"pads": np.column_stack([areas * 1e13, areas * 8e12])}
    exact = solve_modes(LinearJoint(model, springs=springs), n_modes=N)
    reduced = reduce_contacts(LinearJoint(model), {"pads": law}, method="free-interface", n_modes=N)
    assert np.abs(relative(solve_modes(reduced, n_modes=N), exact, 6)).max() < 1e-8


@pytest.mark.parallel
def test_shapes_of_a_load_do_for_all_interface_modes():
    """Response of a contact whose lips part and slip: a quarter of the unknowns."""
    model = blocks(degree=1)
    joint, laws = LinearJoint(model), {"pads": gaping(model)}
    end = {"end": ((0.2, 0.01, 0.01), (0.0, 0.0, 1.0))}

    def shapes(whole):
        i = 6  # the first bending
        shift, theta, X = whole.modes_at_rest()
        load = (1 / theta[i] - shift) * (whole.M @ X[:, i]) / np.sqrt(theta[i])
        at = 4e-6 * np.geomspace(0.01, 1.0, 8)
        return [*loading_shapes(whole, load, at), *loading_shapes(whole, -load, at)]

    ways = (
        {"n_modes": 40},
        {"n_modes": 12, "interface_modes": 12},
        {"n_modes": 12, "shapes": shapes, "interface_modes": 12},
    )
    found = []
    for options in ways:
        reduced = reduce_contacts(joint, laws, **options, forces=end, sensors=end)
        damped = with_modal_damping(reduced, 0.02)
        result = solve_harmonic(damped, "end", 2.0, at=[2100], harmonics=3, samples=64)
        found.append((reduced.n_dofs, result.amplitude()))
    (n, whole), (_, few), (m, known) = found
    assert m < 0.3 * n
    assert np.abs(known / whole - 1).max() < 0.005 < 0.5 * np.abs(few / whole - 1).min()
