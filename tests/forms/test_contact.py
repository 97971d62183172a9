"""Contact and friction laws by hand, and their residuals against energies and differences."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI
from scipy.integrate import trapezoid

from fenics_joints import forms

K_N, K_T, MU = 7.0, 3.0, 0.4


class Point:
    """One cell of volume 1, on which a law of constants has its value as an integral."""

    def __init__(self):
        self.mesh = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1, mesh.CellType.hexahedron)

    def constant(self, value):
        return fem.Constant(self.mesh, np.asarray(value, dtype=float))

    def value(self, expression):
        shape = expression.ufl_shape
        parts = [expression[i] for i in range(shape[0])] if shape else [expression]
        dx = ufl.dx(self.mesh)
        found = np.array([fem.assemble_scalar(fem.form(part * dx)) for part in parts])
        return found if shape else found[0]


def test_pressures_by_hand():
    """A closed gap presses, an open one does not; the multiplier holds on across a small one."""
    point = Point()
    for gap, penalty, augmented in ((-0.2, 1.4, 2.4), (0.1, 0.0, 0.3), (0.2, 0.0, 0.0)):
        g = point.constant(gap)
        assert point.value(forms.penalty_pressure(g, K_N)) == pytest.approx(penalty)
        found = point.value(forms.augmented_pressure(point.constant(1.0), g, K_N))
        assert found == pytest.approx(augmented)


def test_coulomb_traction_sticks_slides_and_is_gone_without_pressure():
    """Along the slip; k_t s up to mu p, and mu p beyond, whichever the direction."""
    point = Point()
    direction = np.array([2.0, -1.0, 2.0]) / 3
    slip, pressure = point.constant(np.zeros(3)), point.constant(0.0)
    law = forms.coulomb_traction(slip, pressure, MU, K_T)
    edge = MU * 1.5 / K_T
    for p, s in ((1.5, 0.0), (1.5, 0.99 * edge), (1.5, 5 * edge), (0.0, 1.0), (0.0, 0.0)):
        pressure.value, slip.value = p, s * direction
        expected = min(K_T * s, MU * p) * direction
        np.testing.assert_allclose(point.value(law), expected, atol=1e-15)


def test_cycle_of_slip_dissipates_what_a_jenkins_element_does():
    """4 mu p (s_max - mu p/k_t) over a full cycle, by the update of what has slid."""
    point = Point()
    p, s_max = 1.5, 0.7
    direction = np.array([0.0, 0.6, 0.8])
    slip, slid = point.constant(np.zeros(3)), point.constant(np.zeros(3))
    law = fem.form(
        ufl.dot(
            forms.coulomb_traction(slip - slid, point.constant(p), MU, K_T),
            ufl.as_vector(list(direction)),
        )
        * ufl.dx(point.mesh)
    )
    # From s_max down and up again; straight between the corners, which are among the steps.
    down = np.unique(np.append(np.linspace(-s_max, s_max, 8), s_max - 2 * MU * p / K_T))[::-1]
    path = np.concatenate([[0.0, MU * p / K_T], down, -down[1:]])
    tractions = []
    for s in path:
        slip.value = s * direction
        tractions.append(fem.assemble_scalar(law))
        slid.value = slip.value - tractions[-1] / K_T * direction
    cycle = slice(2, None)
    work = trapezoid(np.array(tractions)[cycle], path[cycle])
    assert work == pytest.approx(4 * MU * p * (s_max - MU * p / K_T), rel=1e-12)


def test_uzawa_ends_without_penetration():
    """A spring k pulls a block u0 below a floor: p tends to k u0, its error by k/(k + c) a step."""
    point = Point()
    k, depth, c = 2.0, 0.3, 5.0
    gap, multiplier = point.constant(0.0), point.constant(0.0)
    law = forms.augmented_pressure(multiplier, gap, c)
    errors = [k * depth]
    for _ in range(6):
        gap.value = (multiplier.value - k * depth) / (k + c)
        multiplier.value = point.value(law)
        errors.append(k * depth - multiplier.value)
    np.testing.assert_allclose(np.divide(errors[1:], errors[:-1]), k / (k + c), rtol=1e-9)


# --- on an interface -----------------------------------------------------------------------------


class Interface:
    """Two hexahedra, turned, that share a facet; discontinuous displacements of degree 1."""

    def __init__(self):
        self.mesh = mesh.create_box(
            MPI.COMM_SELF, [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]], [1, 1, 2], mesh.CellType.hexahedron
        )
        c, s = np.cos(0.7), np.sin(0.7)
        R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array(
            [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        )
        x = self.mesh.geometry.x
        x[:] = x @ R.T
        self.V = fem.functionspace(self.mesh, ("DG", 1, (3,)))
        self.u = fem.Function(self.V)
        self.normal = ufl.FacetNormal(self.mesh)("+")
        self.upward = R[:, 2]
        self.dS = ufl.dS(self.mesh, metadata={"quadrature_degree": 4})
        self.jump = self.u("-") - self.u("+")
        v = ufl.TestFunction(self.V)
        self.jump_v = v("-") - v("+")

    def residual(self, friction=True):
        gap = forms.contact_gap(self.jump, self.normal, 0.1)
        pressure = forms.penalty_pressure(gap, K_N)
        slip = forms.contact_slip(self.jump, self.normal)
        traction = forms.coulomb_traction(slip, pressure, MU, K_T) if friction else None
        return forms.contact_interface(self.jump_v, self.normal, pressure, traction, self.dS)

    def press(self, opening, slip, spread=0.01):
        """Move the upper cell by a rigid jump, and every node by a little more."""
        rng = np.random.default_rng(3)
        nodes = self.V.tabulate_dof_coordinates()
        cells = self.V.dofmap.list
        height = nodes[cells].mean(axis=1) @ self.upward
        upper = cells[np.argmax(height)]
        u = spread * rng.standard_normal((len(nodes), 3))
        along = np.cross(self.upward, [0.3, 0.5, 0.1])
        u[upper] += opening * self.upward + slip * along / np.linalg.norm(along)
        self.u.x.array[:] = u.ravel()


def matrix(form):
    """As a dense array."""
    A = assemble_matrix(form if isinstance(form, fem.Form) else fem.form(form))
    A.assemble()
    dense = A.convert("dense").getDenseArray().copy()
    A.destroy()
    return dense


def vector(form):
    return fem.assemble_vector(fem.form(form)).array.copy()


@pytest.mark.parametrize(
    ("opening", "slip"), [(-0.5, 0.05), (-0.5, 0.9), (0.3, 0.5)], ids=["stick", "slide", "open"]
)
def test_tangent_is_that_of_the_residual(opening, slip):
    """By central differences in a random direction; none of it where the sides are apart."""
    interface = Interface()
    interface.press(opening, slip)
    residual = fem.form(interface.residual())
    dense = matrix(ufl.derivative(interface.residual(), interface.u))
    u = interface.u.x.array.copy()
    w = np.random.default_rng(5).standard_normal(len(u))
    ends = []
    for step in (1e-6, -1e-6):
        interface.u.x.array[:] = u + step * w
        ends.append(fem.assemble_vector(residual).array.copy())
    difference = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(dense @ w, difference, atol=1e-8)
    if opening > 0:
        assert not dense.any()
    elif slip < 0.1:
        # Sticking and pressed all over, it is the linear spring interface.
        u_trial = ufl.TrialFunction(interface.V)
        spring = forms.spring_interface(
            u_trial("-") - u_trial("+"), interface.jump_v, interface.normal, K_N, K_T, interface.dS
        )
        np.testing.assert_allclose(dense, matrix(spring), atol=1e-13)
    else:
        assert np.abs(dense - dense.T).max() > 0.1  # friction follows the pressure


def test_tangent_is_finite_at_rest():
    """At zero slip, open or pressed or just touching, no derivative is infinite or undefined."""
    interface = Interface()
    form = fem.form(ufl.derivative(interface.residual(), interface.u))
    for opening in (0.0, -0.1, -0.5):
        interface.press(opening, 0.0, spread=0.0)
        assert np.all(np.isfinite(matrix(form)))


def test_frictionless_residual_is_the_gradient_of_the_energy():
    """Of 1/2 k_n max(0, -gap)^2, where the interface is open in part; it sums to the pressure."""
    interface = Interface()
    interface.press(-0.15, 0.2, spread=0.1)
    gap = forms.contact_gap(interface.jump, interface.normal, 0.1)
    energy = K_N / 2 * ufl.max_value(0.0, -gap) ** 2 * interface.dS
    found = vector(interface.residual(friction=False))
    np.testing.assert_allclose(found, vector(ufl.derivative(energy, interface.u)), atol=1e-14)
    is_open = ufl.conditional(ufl.gt(gap, 0.0), 1.0, 0.0)
    assert 0.1 < fem.assemble_scalar(fem.form(is_open * interface.dS)) < 0.9

    # Closed evenly by 0.4 over an area of 1: the upper side's internal force points down.
    interface.press(-0.5, 0.0, spread=0.0)
    nodal = vector(interface.residual(friction=False)).reshape(-1, 3)
    upper = interface.u.x.array.reshape(-1, 3) @ interface.upward < -0.25
    np.testing.assert_allclose(nodal[upper].sum(axis=0), -K_N * 0.4 * interface.upward, atol=1e-13)
    np.testing.assert_allclose(nodal.sum(axis=0), 0, atol=1e-13)
