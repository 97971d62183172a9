"""The transition layer's law: a column of three, grading, pressure along a radius."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import ufl
from dolfinx import fem, mesh
from form_bodies import box, gathered, interpolated
from mpi4py import MPI
from scipy.integrate import quad

from fenics_joints import forms

COMM = MPI.COMM_WORLD

LEVELS, N_BODY = np.array([0.0, 0.8, 1.0, 1.9]), 2
SIDE, H0, H = 0.7, 0.2, 0.55
E_B, NU_B = 7.0, 0.3
TURN = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]


class Column:
    """A square column of body, layer and body along a slanting axis."""

    def __init__(self, n_layer=1, cell="hex", turn=TURN, n_side=2):
        counts = np.array([N_BODY, n_layer, N_BODY])
        n = int(counts.sum())
        self.msh = box(cell, [n_side, n_side, n], [SIDE, SIDE, n])
        x = self.msh.geometry.x
        x[:, 2] = np.interp(x[:, 2], np.append(0, np.cumsum(counts)), LEVELS)
        x[:] = x @ turn.T
        self.turn, self.normal = turn, ufl.as_vector(turn[:, 2].tolist())
        self.middle = ufl.as_vector((turn[:, 2] * (LEVELS[1] + H0 / 2)).tolist())
        tol = 1e-9

        def inside(x):
            z = turn[:, 2] @ x
            return (z > LEVELS[1] - tol) & (z < LEVELS[2] + tol)

        imap = self.msh.topology.index_map(3)
        marks = np.zeros(imap.size_local + imap.num_ghosts, dtype=np.int32)
        marks[mesh.locate_entities(self.msh, 3, inside)] = 1
        tags = mesh.meshtags(self.msh, 3, np.arange(len(marks), dtype=np.int32), marks)
        self.dx = ufl.Measure("dx", self.msh, subdomain_data=tags)
        name = self.msh.topology.cell_name()
        family = "S" if name == "hexahedron" else "Lagrange"
        self.V = fem.functionspace(self.msh, basix.ufl.element(family, name, 2, shape=(3,)))

    def stiffness(self, E, mu, h, degree=4):
        """Matrix with the layer h thick, the same on every rank."""
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        dx = self.dx(1, metadata={"quadrature_degree": degree})
        c = [fem.Constant(self.msh, float(q)) for q in (E_B, NU_B, h, H0)]
        a = forms.elasticity(u, v, *c[:2], self.dx(0))
        more = {"normal": self.normal, "thickness": c[2], "meshed": c[3]}
        a += forms.transition_layer(u, v, E, mu, dx, **more)
        return gathered(a)

    def field(self, function):
        """DOFs of a displacement along the own axes, (3, n), given at places in them."""
        return interpolated(self.V, lambda x: self.turn @ function(self.turn.T @ x))

    def places(self):
        """Places of the DOFs' blocks in own axes, (n, 3): the DOFs of a linear field."""
        return self.field(lambda x: x).reshape(-1, 3) @ self.turn

    def constant(self, value):
        return fem.Constant(self.msh, float(value))


def moduli(E, nu):
    """Shear and oedometric modulus."""
    return E / 2 / (1 + nu), E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))


def ramp(z, body, layer):
    """Piecewise linear displacement with a slope in the bodies and one in the meshed layer."""
    return body * (z - np.clip(z - LEVELS[1], 0, H0)) + layer * np.clip(z - LEVELS[1], 0, H0)


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hex", "tet"])
def test_uniform_stress_passes_in_series(cell):
    """Tension with free sides, strain along the axis alone, shear: u = sum h_i / modulus_i.

    Unit stress leaves no force inside, and does the work A u on a layer H thick, meshed H0.
    """
    column = Column(cell=cell)
    E, body = 0.8, LEVELS[-1] - H0
    x, tol = column.places(), 1e-9
    inside = (x[:, 2] > tol) & (x[:, 2] < LEVELS[-1] - tol)
    deep = inside & np.all((x[:, :2] > tol) & (x[:, :2] < SIDE - tol), axis=1)
    (G_b, M_b), (G, M) = moduli(E_B, NU_B), moduli(E, 0.35)
    # With equal nu / E the bodies and the layer want the same lateral strain.
    states = {
        "tension": (NU_B * E / E_B, E_B, E, inside),
        "along": (0.35, M_b, M, deep),
        "shear": (0.35, G_b, G, deep),
    }
    for state, (mu, m_b, m, free) in states.items():

        def motion(x, state=state, m_b=m_b, m=m):
            w, lateral = ramp(x[2], 1 / m_b, H / H0 / m), 0 * x[:2]
            if state == "shear":
                return np.array([w, *lateral])
            return np.array([*(-NU_B / E_B * x[:2] if state == "tension" else lateral), w])

        u = column.field(motion)
        force = column.stiffness(column.constant(E), column.constant(mu), H) @ u
        assert np.abs(force.reshape(-1, 3)[free]).max() < 1e-11 * np.abs(force).max()
        # The lower end is at rest, so that only the upper end's work counts; sides do none.
        assert u @ force == pytest.approx(SIDE**2 * (body / m_b + H / m), rel=1e-11)


def squeeze(column, E, mu, degree):
    """Work of a unit displacement of the upper end, the sides held: k = A / compliance."""
    K, x = column.stiffness(E, mu, H, degree).tocsc(), column.places()
    ends = (x[:, 2] < 1e-9) | (x[:, 2] > LEVELS[-1] - 1e-9)
    own = column.field(lambda x: np.array([0 * x[0], 0 * x[0], x[2] / LEVELS[-1]]))
    # In own axes, where the motion is along the axis alone.
    turn = sp.kron(sp.eye(len(x)), sp.csr_matrix(column.turn)).tocsr()
    K, u = (turn.T @ K @ turn).tocsr(), turn.T @ own
    free = np.zeros(u.shape, dtype=bool)
    free[2::3] = ~ends
    u[free] = spla.spsolve(K[free][:, free].tocsc(), -K[free][:, ~free] @ u[~free])
    return u @ (K @ u)


def test_graded_layer_is_the_limit_of_slices():
    """1/k = sum of h_i / M_i: E and mu from the joint's to two bodies', sides held.

    The graded form comes to the closed integral; slices of uniform E and mu come to it too, with
    the square of their thickness.
    """
    bodies, E, mu, through = (7.0, 11.0), 0.8, 0.2, 2
    lower, upper, mus = *bodies, (0.3, 0.25)

    def modulus(z):
        w, side = abs(z) ** through, int(z >= 0)
        nu = (1 - w) * mu + w * mus[side]
        return moduli(E ** (1 - w) * bodies[side] ** w, nu)[1]

    inside = H / 2 * quad(lambda z: 1 / modulus(z), -1, 1, points=[0], epsabs=1e-12)[0]
    exact = SIDE**2 / (inside + (LEVELS[-1] - H0) / moduli(E_B, NU_B)[1])
    smooth, sliced = [], []
    for n in (2, 4, 8):
        column = Column(n, turn=np.eye(3), n_side=1)
        x = ufl.SpatialCoordinate(column.msh)
        z = forms.layer_position(x, column.middle, column.normal, H0)
        law = (
            forms.transition_modulus(z, E, lower, upper, through=through),
            forms.transition_poisson(z, mu, *mus, through=through),
        )
        slices = [fem.Function(fem.functionspace(column.msh, ("DG", 0))) for _ in law]
        middle = np.full((1, 3), 0.5)
        cells = np.arange(len(slices[0].x.array), dtype=np.int32)
        for f, expression in zip(slices, law, strict=True):
            f.x.array[:] = fem.Expression(expression, middle).eval(column.msh, cells).ravel()
        smooth.append(squeeze(column, *law, 8) / exact - 1)
        sliced.append(squeeze(column, *slices, 2) / exact - 1)
    smooth, sliced = np.abs(smooth), np.abs(sliced)
    # Quadratic cells: the fourth order in the energy.
    assert np.log2(sliced[1] / sliced[2]) == pytest.approx(2, abs=0.2)
    assert np.log2(smooth[1] / smooth[2]) == pytest.approx(4, abs=0.3)
    assert smooth[2] < 2e-4


@pytest.mark.parallel
def test_pressure_along_the_radius():
    """It carries the bolt's force and ends at P_lim; E in proportion to it has E_j as its mean."""
    r_nei, r_wai, force = 0.00875, 0.024, 25e3
    msh = mesh.create_interval(COMM, 400, [r_nei, r_wai])
    (r,), dx = ufl.SpatialCoordinate(msh), ufl.dx(metadata={"quadrature_degree": 4})

    def ring(f):
        return COMM.allreduce(fem.assemble_scalar(fem.form(2 * np.pi * r * f * dx)))

    area = np.pi * (r_wai**2 - r_nei**2)
    pressure = forms.ring_pressure(r, force, r_nei, r_wai)
    assert ring(pressure) == pytest.approx(force, rel=1e-8)
    load = pressure / (force / area)
    assert ring(forms.transition_modulus(0.0, 1.5e9, 7e10, 7e10, load=load)) == pytest.approx(
        1.5e9 * area, rel=1e-8
    )
    # At the faces the body's own, whatever the pressure.
    faces = forms.transition_modulus(-1.0, 1.5e9, 7e10, 9e10, load=load)
    assert ring(faces) == pytest.approx(7e10 * area, rel=1e-8)
    edge = lambda at: float(forms.ring_pressure(ufl.as_ufl(at), force, r_nei, r_wai))  # noqa: E731
    assert edge(r_wai) == pytest.approx(1e6) and edge(r_wai * 1.01) == 0.0 == edge(0.5 * r_nei)
    assert edge(r_nei) > 1e6
