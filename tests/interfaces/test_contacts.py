"""Contacts as springs and pairs at a reduced interface."""

from __future__ import annotations

import numpy as np
import pytest
from layered_plates import Bond, N, Stick, blocks, relative, sprung

from fenics_joints.interfaces import reduce_contacts
from fenics_joints.modal import solve_modes
from fenics_joints.preload import (
    OPEN,
    SLIP,
    WasherForce,
)
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
