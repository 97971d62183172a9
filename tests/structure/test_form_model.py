"""Two bilinear forms of one's own as a model."""

from __future__ import annotations

import basix.ufl
import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.forms import elasticity, mass
from fenics_joints.measurements import FRFTarget, Target
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.response import solve_frf
from fenics_joints.structure import Damping, FormModel, Sensors, Structure, Support, part
from fenics_joints.updating import update

SIZE, CELLS = (0.3, 0.06, 0.01), (12, 3, 1)


def beam(**more):
    """Forms of a clamped steel strip as a user writes them, and its constants."""
    mesh = box(MPI.COMM_WORLD, SIZE, CELLS).mesh
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    E, rho = fem.Constant(mesh, 210e9), fem.Constant(mesh, 7850.0)
    clamp = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), clamp, V)]
    lame = E * 0.3 / (1.3 * 0.4), E / 2.6

    def eps(w):
        return ufl.sym(ufl.grad(w))

    a = lame[0] * ufl.div(u) * ufl.div(v) * ufl.dx
    a += 2 * lame[1] * ufl.inner(eps(u), eps(v)) * ufl.dx
    return a, rho * ufl.dot(u, v) * ufl.dx, bcs, {"E": E, "rho": rho}


@pytest.mark.parallel
def test_modes_of_a_membrane_are_those_of_its_formula():
    """A scalar field: omega_mn = pi sqrt((m / a)^2 + (n / b)^2) with unit tension and mass."""
    a, b = 1.0, 0.7
    mesh = dolfinx.mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (a, b)], (16, 12))
    V = fem.functionspace(mesh, ("Lagrange", 3))
    w, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mesh.topology.create_connectivity(1, 2)
    rim = fem.locate_dofs_topological(V, 1, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    bcs = [fem.dirichletbc(0.0, rim, V)]
    stiff = ufl.dot(ufl.grad(w), ufl.grad(v)) * ufl.dx
    found = solve_modes(stiff, w * v * ufl.dx, bcs=bcs, n_modes=6)
    exact = sorted(np.hypot(m / a, n / b) / 2 for m in range(1, 5) for n in range(1, 5))[:6]
    assert found.frequencies_hz == pytest.approx(exact, rel=1e-5)
    assert found.n_rigid == 0 and found.shape(0).function_space.mesh is mesh


@pytest.mark.parallel
def test_derivatives_of_eigenvalues_are_those_by_differences():
    a, m, bcs, constants = beam()
    model = FormModel(a, m, bcs, constants)
    found = solve_modes(model, n_modes=4)
    slopes = found.gradients(range(4))
    for j, (name, value) in enumerate(model.values().items()):
        step = 1e-4 * value
        high, low = (
            solve_modes(model, {name: value + s}, n_modes=4).eigenvalues for s in (step, -step)
        )
        assert slopes[:, j] == pytest.approx((high - low) / (2 * step), rel=1e-5)
    # E scales all of K, and rho all of M.
    lam = found.eigenvalues
    assert slopes == pytest.approx(np.column_stack([lam / 210e9, -lam / 7850.0]), rel=1e-7)


@pytest.mark.parallel
def test_derivatives_by_the_cells_of_a_field_add_up_to_that_by_a_number():
    mesh = box(MPI.COMM_WORLD, SIZE, CELLS).mesh
    V, Q = (fem.functionspace(mesh, e) for e in (("Lagrange", 1, (3,)), ("DG", 0)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    E = fem.Function(Q, name="E")
    E.x.array[:] = 70e9
    model = FormModel(elasticity(u, v, E, 0.3, ufl.dx), mass(u, v, 2700.0, ufl.dx))
    found = solve_modes(model, n_modes=8)
    by_cell = model.coefficient_gradient(found.shapes[6], found.eigenvalues[6], E)
    owned = Q.dofmap.index_map.size_local
    total = mesh.comm.allreduce(by_cell.x.array[:owned].sum())
    assert found.n_rigid == 6
    assert total == pytest.approx(found.eigenvalues[6] / 70e9, rel=1e-8)


@pytest.mark.parallel
def test_a_model_by_forms_sees_and_moves_as_the_library_s():
    a, m, bcs, _ = beam()
    own = FormModel(a, m, bcs)
    body = part("strip", "body", E=210e9, nu=0.3, rho=7850.0)
    tagged = box(MPI.COMM_WORLD, SIZE, CELLS)
    theirs = Structure(tagged, [body], degree=1, supports=[Support("x_min")])
    at = Sensors([[0.3, 0.03, 0.01], [0.15, 0.06, 0.0]], [0.0, 0.0, 1.0])
    one, other = (solve_modes(x, n_modes=5) for x in (own, theirs))
    assert one.frequencies_hz == pytest.approx(other.frequencies_hz, rel=1e-7)
    assert np.abs(one.at(at)) == pytest.approx(np.abs(other.at(at)), rel=1e-4, abs=1e-5)
    assert own.total_mass() == pytest.approx(theirs.total_mass(), rel=1e-12)
    lines = {"frequencies_hz": np.linspace(20.0, 400.0, 5), "excitation": at, "sensors": at}
    one_frf, other_frf = (
        solve_frf(x, **lines, damping=Damping(structural=0.02), method="direct")
        for x in (own, theirs)
    )
    assert one_frf.values == pytest.approx(other_frf.values, rel=1e-6)
    work = own.comm.allreduce(own.loads(at).T @ np.column_stack([x.array_r for x in one.shapes]))
    assert work == pytest.approx(one.at(at), rel=1e-9, abs=1e-12)


@pytest.mark.parallel
def test_constants_of_the_forms_are_identified():
    a, m, bcs, constants = beam()
    model = FormModel(a, m, bcs, constants)
    truth = {"E": 190e9, "rho": 8200.0}
    hz = solve_modes(model, truth, n_modes=4).frequencies_hz
    at, lines = Sensors([[0.3, 0.03, 0.01]], [0.0, 0.0, 1.0]), np.array([15.0, 60.0])
    frf = solve_frf(model, truth, frequencies_hz=lines, excitation=at, sensors=at)
    target = Target(hz, frfs=FRFTarget(lines, frf.values, at, at))
    small = reduce(model, [{}, truth, {"E": 190e9}], n_modes=8)
    assert solve_modes(small, truth, n_modes=4).frequencies_hz == pytest.approx(hz, rel=1e-7)
    assert small.total_mass(truth) == pytest.approx(model.total_mass(truth), rel=1e-12)
    fast = update(small, list(model.parameters.values()), target, model.values())
    # The receptance lacks what the eight modes leave out.
    assert fast.values == pytest.approx(list(truth.values()), rel=3e-3)
    found = update(model, list(model.parameters.values()), target, model.values())
    assert found.values == pytest.approx(list(truth.values()), rel=1e-5)


@pytest.mark.parallel
def test_a_mixed_space_has_a_displacement():
    """Displacement and pressure: nearly incompressible by two fields as by one."""
    mesh = dolfinx.mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (1.0, 0.2)], (20, 4))
    two = basix.ufl.mixed_element(
        [
            basix.ufl.element("Lagrange", mesh.topology.cell_name(), 2, shape=(2,)),
            basix.ufl.element("DG", mesh.topology.cell_name(), 0),
        ]
    )
    W = fem.functionspace(mesh, two)
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    shear = 2e6 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    m = 1e3 * ufl.dot(u, v) * ufl.dx
    model = FormModel(shear + 1e6 * p * q * ufl.dx, m, displacement=0)
    found = solve_modes(model, n_modes=6)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    w, z = ufl.TrialFunction(V), ufl.TestFunction(V)
    alone = 2e6 * ufl.inner(ufl.sym(ufl.grad(w)), ufl.sym(ufl.grad(z))) * ufl.dx
    other = solve_modes(alone, 1e3 * ufl.dot(w, z) * ufl.dx, n_modes=6)
    assert found.frequencies_hz[3:] == pytest.approx(other.frequencies_hz[3:], rel=1e-7)
    at = Sensors([[1.0, 0.1], [0.5, 0.2]], [0.0, 1.0])
    assert np.abs(found.at(at))[:, 3] == pytest.approx(np.abs(other.at(at))[:, 3], rel=1e-5)


def test_what_is_no_model_is_refused_with_the_user_s_words():
    a, m, bcs, constants = beam()
    mesh = next(iter(constants.values())).ufl_domain()
    with pytest.raises(InputError, match="a = .*bilinear"):
        FormModel(1.0, m)
    square = FormModel(constants["E"] / 2e11 * a, m, bcs, constants)
    with pytest.raises(InputError, match="E: a or m is not linear in it"):
        reduce(square, [{}], n_modes=3)
    with pytest.raises(InputError, match="bcs: expected none beside a FormModel"):
        solve_modes(square, bcs=bcs)
    with pytest.raises(InputError, match="parameters..nu..*fem.Constant of a or m"):
        FormModel(a, m, bcs, {"nu": fem.Constant(mesh, 0.3)})
    test, trial = a.arguments()
    V = test.ufl_function_space()
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    lopsided = u[0].dx(0) * v[1] * ufl.dx
    with pytest.raises(InputError, match="a: expected a symmetric form"):
        solve_modes(a + 1e9 * lopsided, m, bcs=bcs)
