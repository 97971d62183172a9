"""Layers with laws of their own against the linear structure and the full model."""

from __future__ import annotations

import numpy as np
import pytest
from eigen_slopes import difference
from layered_plates import END, PLACES, TIP, Bond, G, N, Stick, blocks, plates, relative, sprung
from petsc4py import PETSc

from fenics_joints.interfaces import reduce_contacts, reduce_layers
from fenics_joints.modal import solve_modes
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.structure import Sensors


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("linear", "law"),
    [
        ("uncoupled", Stick(k=G)),
        ("constrained", Stick(k=G)),
        ("uncoupled", Bond(k_n=8e8, k=G)),
        # lambda + 2 mu of E = 8e8, G = 3e8: nu = 1/3, lambda = 2 G.
        ("constrained", Bond(k_n=4 * G, k=G)),
    ],
)
def test_a_law_as_stiff_as_the_layer_gives_the_linear_structure(linear, law):
    structure = plates(law=linear)
    exact = solve_modes(structure, n_modes=N)
    model = reduce_layers(structure, {"layer": law}, n_modes=N, interface_modes=4)
    modes = solve_modes(model, n_modes=N)
    assert modes.n_rigid == exact.n_rigid == 5
    # Two points along a cell of 40 mm and one through it see nearly all of the stress.
    found = relative(modes, exact, 5)
    assert (-1e-3 if law.coupled else -1e-4) < found.min() and found.max() < 1e-6
    assert model.total_mass() == pytest.approx(structure.total_mass(), rel=1e-12)
    # The points carry the layer's whole volume; without them nothing is unstable.
    points = model.interfaces[0]
    assert points.weights.sum() == pytest.approx(0.08 * 0.08 * 0.5e-3, rel=1e-12)
    assert np.linalg.eigvalsh(model.K).min() > -1e-9 * np.linalg.eigvalsh(model.K).max()


@pytest.mark.parallel
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 2), ("tetrahedron", 1)])
def test_a_softer_law_is_a_softer_layer_and_interface_modes_converge(cell, degree):
    """Basis at G, law at G / 10: the full model's frequencies at G / 10, which it never saw."""
    structure = plates(cell=cell, degree=degree)
    exact = solve_modes(structure, {"layer.G": 0.1 * G}, n_modes=11)
    worst = []
    for n in (2, 10, 32):
        law = {"layer": Stick(k=0.1 * G)}
        model = reduce_layers(structure, law, n_modes=30, interface_modes=n)
        worst.append(relative(solve_modes(model, n_modes=11), exact, 5).max())
    assert worst[0] > 4 * worst[1] > 16 * worst[2]
    assert worst[2] < 5e-4


def response(structure, given, omega, place):
    """Displacement at END of the full model under a unit force at a place."""
    K, M = structure.stiffness(given), structure.mass(given)
    K.axpy(-(omega**2), M)
    load, x = K.createVecs()
    gdim, (point, direction) = structure.gdim, place
    rows, imap = structure.rows(point), structure.V.dofmap.index_map
    for nodes, values in zip(rows.nodes, rows.values, strict=True):
        for i in range(gdim):
            numbers = imap.local_to_global(nodes) * gdim + i
            add = PETSc.InsertMode.ADD_VALUES
            load.setValues(numbers.astype(np.int32), values * direction[i], add)
    load.assemble()
    ksp = PETSc.KSP().create(structure.comm)
    ksp.setOperators(K)
    ksp.setType("preonly"), ksp.getPC().setType("lu"), ksp.getPC().setFactorSolverType("mumps")
    ksp.solve(load, x)
    found = structure.observe([x], Sensors([END[0]], [END[1]]))[0, 0]
    ksp.destroy(), K.destroy(), M.destroy()
    return found


@pytest.mark.parallel
def test_static_and_dynamic_response_are_the_full_models():
    """A clamped lap, its layer five times softer than the basis was made for."""
    structure, soft = plates(held=True), {"layer.G": 0.2 * G}
    law = {"layer": Stick(k=0.2 * G)}
    model = reduce_layers(structure, law, n_modes=30, interface_modes=40, **PLACES)
    first = solve_modes(model, n_modes=2).frequencies_hz
    for hertz, error in ((0.0, 2e-4), (0.5 * first[0], 2e-4), (np.mean(first), 3e-3)):
        omega = 2 * np.pi * hertz
        A = model.stiffness_at_rest() - omega**2 * model.M
        for name, place in (("tip", TIP), ("end", END)):
            x = np.linalg.solve(A, model.row("forces", name))
            exact = response(structure, soft, omega, place)
            assert model.row("sensors", "end") @ x == pytest.approx(exact, rel=error), name
    # At the basis' own stiffness what is static is exact, however few the modes.
    few = reduce_layers(structure, {"layer": Stick(k=G)}, n_modes=3, interface_modes=1, **PLACES)
    x = np.linalg.solve(few.stiffness_at_rest(), few.row("forces", "end"))
    exact = response(structure, {}, 0.0, END)
    assert few.row("sensors", "end") @ x == pytest.approx(exact, rel=1e-4)


def test_linear_parameters_live_on():
    """Moduli and the layer's stretch changed in the reduced model, and gradients by differences."""
    structure = plates()
    law = Stick(k=G)
    model = reduce_layers(structure, {"layer": law}, n_modes=30, interface_modes=12)
    given = {"E": 6.5e10, "layer.E": 5e8, "s": 1.3, "m": 0.03}
    exact = solve_modes(structure, given, n_modes=10)
    assert model.at(given).total_mass() == pytest.approx(structure.total_mass(given), rel=1e-12)
    modes, again = solve_modes(model.at(given), n_modes=10), solve_modes(model, given, n_modes=10)
    assert np.abs(relative(modes, exact, 5)).max() < 3e-3
    assert again.frequencies_hz == pytest.approx(modes.frequencies_hz, rel=1e-12)
    slopes = modes.gradients(range(5, 9))
    for i, (name, value) in enumerate(model.values(given).items()):
        exact = difference(model, given, name, slice(5, 9), 1e-4, n_modes=10)
        off = 1e-7 * modes.eigenvalues[8] / value
        assert slopes[:, i] == pytest.approx(exact, rel=1e-4, abs=off), name


@pytest.mark.parallel
def test_methods_agree_and_converge_with_interface_modes():
    """Basis at one stiffness, law ten times softer; all, then few interface modes."""
    model = blocks()
    joint, exact = LinearJoint(model), solve_modes(sprung(model, 1e17, 1e10), n_modes=12)
    for method in ("craig-bampton", "free-interface"):
        worst = []
        for n in (3, 16, 54):
            law = {"pads": Stick(k=1e11)}
            reduced = reduce_contacts(joint, law, method=method, n_modes=30, interface_modes=n)
            soft = reduced.with_laws(pads=Stick(k=1e10))
            worst.append(relative(solve_modes(soft, n_modes=12), exact, 6).max())
        assert worst[0] > 4 * worst[1] > 8 * worst[2]
        assert worst[1] < 5e-3 and worst[2] < 5e-4
