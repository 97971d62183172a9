"""Thin layers against closed forms, in oblique directions, on every cell and degree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.sparse.linalg as spla
import ufl
from dolfinx import default_scalar_type, fem, mesh
from form_bodies import (
    CELLS,
    DIMENSION,
    E_L,
    ELEMENTS,
    G_L,
    NU,
    E,
    H,
    box,
    cells_between,
    constant_state,
    element_of,
    gathered,
    interpolated,
    part_slope,
    rigid_modes,
    rotate,
    rotation,
    slope_across,
    tagged,
    total,
    values,
)

from fenics_joints import forms

LAWS = ["uncoupled", "isotropic", "constrained"]


def distort(msh):
    """Move the inner nodes, along the layer everywhere, and across it inside the parts."""
    x, last = msh.geometry.x, msh.geometry.dim - 1
    z = x[:, last].copy()
    bubble = np.prod(np.sin(np.pi * x[:, :last]), axis=1)
    x[:, 0] += 0.2 * bubble * np.cos(z)
    x[:, last] += 0.2 * bubble * np.where((abs(z - 0.5) < 0.1) | (abs(z - 1.5 - H) < 0.1), 1, 0)


@dataclass
class Layered:
    """Two unit blocks with a layer of thickness ``h`` between, turned by ``R``.

    All laws stand in one form, switched by constants, so that each element compiles once.
    """

    name: str
    h: float = H
    distorted: bool = False

    def __post_init__(self):
        cell = self.name.split("-")[0]
        d = DIMENSION[cell]
        self.msh = msh = box(cell, [2] * (d - 1) + [5], [1] * d)
        z = msh.geometry.x[:, d - 1]
        self.levels = np.array([0, 0.5, 1, 1 + self.h, 1.5 + self.h, 2 + self.h])
        z[:] = np.interp(z, np.linspace(0, 1, 6), self.levels)
        parts = [cells_between(msh, 0, 1), cells_between(msh, 1 + self.h, 2 + self.h)]
        tags = tagged(msh, d, [np.concatenate(parts), cells_between(msh, 1, 1 + self.h)])
        if self.distorted:
            distort(msh)
        self.d, self.R = d, rotation(d)
        rotate(msh, self.R)
        self.V = fem.functionspace(msh, element_of(self.name))
        self.form = fem.form(self.bilinear(ufl.Measure("dx", msh, subdomain_data=tags)))

    def bilinear(self, dx):
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        scalars = ("part", "layer", *LAWS)
        c = {k: fem.Constant(self.msh, default_scalar_type(1)) for k in scalars}
        n = fem.Constant(self.msh, self.R[:, -1].astype(default_scalar_type))
        self.constants = c
        a = forms.elasticity(u, v, E, NU, dx(0), normal=n, stretch=c["part"])
        s = c["layer"]
        a += c["uncoupled"] * forms.uncoupled_layer(u, v, n, E_L, G_L, dx(1), stretch=s)
        a += c["isotropic"] * forms.isotropic_layer(u, v, E_L, G_L, dx(1), normal=n, stretch=s)
        return a + c["constrained"] * forms.constrained_layer(u, v, n, E_L, G_L, dx(1), stretch=s)

    def matrix(self, law, *, layer=1.0, part=1.0):
        """Gathered stiffness with one layer law and the stretches of layer and parts."""
        for name in LAWS:
            self.constants[name].value = float(name == law)
        self.constants["layer"].value, self.constants["part"].value = layer, part
        return gathered(self.form)

    def local(self, x):
        """Coordinates, shape (d, n), in the frame whose last axis is the layer's normal."""
        return self.R.T @ x[: self.d]

    def ramps(self):
        """Columns that lift the upper block by one along each local axis and shear the layer."""

        def ramp(i):
            return lambda x: np.outer(self.R[:, i], np.clip((self.local(x)[-1] - 1) / self.h, 0, 1))

        return np.column_stack([interpolated(self.V, ramp(i)) for i in range(self.d)])

    def on_boundary(self):
        """True on the degrees of freedom of the outer surface."""
        fdim = self.d - 1
        self.msh.topology.create_connectivity(fdim, self.d)
        facets = mesh.exterior_facet_indices(self.msh.topology)
        mark = fem.Function(self.V)
        dofs = fem.locate_dofs_topological(self.V, fdim, facets)
        mark.x.array.reshape(-1, self.d)[dofs] = 1
        mark.x.scatter_forward()
        return values(mark) > 0.5


@cache
def layered(name, distorted=False):
    """A body that several tests share; none of them moves its mesh."""
    return Layered(name, distorted=distorted)


def layer_moduli(law):
    """(normal modulus, Lamé's lambda felt in the normal direction) of a layer law."""
    lmbda = G_L * (E_L - 2 * G_L) / (3 * G_L - E_L)
    return {
        "uncoupled": (E_L, 0.0),
        "constrained": (lmbda + 2 * G_L, 0.0),
        "isotropic": (lmbda + 2 * G_L, lmbda),
    }[law]


def patch_solution(body, law, stretch):
    """Displacement of the state that is constant in each part and in the (stretched) layer."""
    traction, in_plane, spin = constant_state(body.d)
    modulus, lmbda = layer_moduli(law)
    layer = slope_across(traction, np.trace(in_plane), modulus, lmbda, G_L)

    def displacement(x):
        local = body.local(x)
        inside = np.clip(local[-1] - 1, 0, body.h)
        local[-1] += (stretch - 1) * inside
        u = np.outer(part_slope(body.d), local[-1] - stretch * inside)
        u += np.outer(layer, stretch * inside) + spin @ local
        u[:-1] += in_plane @ local[:-1]
        return body.R @ u

    return interpolated(body.V, displacement)


@pytest.mark.parallel
@pytest.mark.parametrize("name", ELEMENTS)
def test_patch(name):
    """Piecewise constant stress through parts and oblique layer, on distorted cells: exact."""
    body = layered(name, distorted=True)
    fixed = body.on_boundary()
    assert 0 < np.count_nonzero(~fixed) < len(fixed)
    ramps = body.ramps()
    for law, stretch in [("uncoupled", 1), ("isotropic", 1), ("constrained", 1), ("isotropic", 3)]:
        K = body.matrix(law, layer=stretch)
        exact = patch_solution(body, law, stretch)
        u = np.where(fixed, exact, 0)
        u[~fixed] = spla.spsolve(K[~fixed][:, ~fixed].tocsc(), -(K @ u)[~fixed])
        assert abs(u - exact).max() < 1e-12 * abs(exact).max(), law
        # The force through the layer (unit area) is the traction; the ramps are tests for it.
        np.testing.assert_allclose(ramps.T @ K @ u, constant_state(body.d)[0], rtol=1e-11)


@pytest.mark.parallel
@pytest.mark.parametrize("name", ELEMENTS)
def test_rigid_body_modes(name):
    """The null space of a body with each layer law is the rigid motions and nothing else."""
    body = layered(name)
    rigid = rigid_modes(body.V)
    for law in LAWS:
        K = body.matrix(law).toarray()
        assert abs(K - K.T).max() < 1e-14 * abs(K).max()
        assert abs(K @ rigid).max() < 1e-13 * abs(K).max(), law
        eigenvalues = sla.eigvalsh(K)
        assert abs(eigenvalues[rigid.shape[1] - 1]) < 1e-13 * eigenvalues[-1]
        assert eigenvalues[rigid.shape[1]] > 1e-5 * eigenvalues[-1], law


@pytest.mark.parallel
@pytest.mark.parametrize("name", ELEMENTS)
def test_stretch_is_a_thicker_mesh(name):
    """Stretching by the form equals stretching the mesh, for parts and every layer law."""
    s = 1.7
    body, thick = layered(name, distorted=True), Layered(name, distorted=True)
    F = np.eye(body.d) + (s - 1) * np.outer(body.R[:, -1], body.R[:, -1])
    rotate(thick.msh, F)
    for law in LAWS:
        expected = thick.matrix(law)
        difference = abs(body.matrix(law, layer=s, part=s) - expected).max()
        assert difference < 1e-13 * abs(expected).max(), law


@pytest.mark.parallel
@pytest.mark.parametrize("name", ["tri-P1", "quad-S2", "tet-P2", "hex-P1"])
def test_layer_stiffness(name):
    """Relative motion of rigid blocks: E A/h normal, G A/h in shear, no coupling; A = 1."""
    body = layered(name)
    ramps = body.ramps()
    for law in LAWS:
        for stretch in (1.0, 0.4):
            k = np.append(np.full(body.d - 1, G_L), layer_moduli(law)[0]) / (stretch * H)
            stiffness = ramps.T @ body.matrix(law, layer=stretch) @ ramps
            np.testing.assert_allclose(stiffness, np.diag(k), atol=1e-12 * k[-1])


@pytest.mark.parametrize("cell", list(CELLS))
def test_isotropic_laws_with_lateral_freedom(cell):
    """A bar that may contract has stiffness E A/h, by (E, nu) and by (E, G); no stretch given."""
    d = DIMENSION[cell]
    msh = box(cell, [1] * d, [2.0, 1.0, 0.5][-d:])
    V = fem.functionspace(msh, ("Lagrange", 1, (d,)))
    u = fem.Function(V)
    nu = E_L / (2 * G_L) - 1
    # In plane strain the free contraction is nu/(1 - nu) and the modulus E/(1 - nu^2).
    contraction, modulus = (nu / (1 - nu), E_L / (1 - nu**2)) if d == 2 else (nu, E_L)
    u.interpolate(lambda x: np.vstack([-contraction * x[: d - 1], x[d - 1 : d]]))
    volume = 1.0 if d == 3 else 0.5
    for a in (forms.isotropic_layer(u, u, E_L, G_L), forms.elasticity(u, u, E_L, nu)):
        assert total(a, msh.comm) == pytest.approx(modulus * volume, rel=1e-13)
