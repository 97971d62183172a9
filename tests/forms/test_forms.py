"""The forms against closed forms, in oblique directions, on every cell and degree supported.

Matrices are gathered to every rank and handled with numpy and scipy, so that nothing of the
suite's own solvers is needed and a run on several ranks meets the same closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import basix.ufl
import numpy as np
import pytest
import scipy.linalg as sla
import scipy.optimize as so
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem.petsc import assemble_matrix
from dolfinx.la import InsertMode
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.errors import InputError

CELLS = {
    "tri": mesh.CellType.triangle,
    "quad": mesh.CellType.quadrilateral,
    "tet": mesh.CellType.tetrahedron,
    "hex": mesh.CellType.hexahedron,
}
ELEMENTS = ["tri-P1", "tri-P2", "quad-P1", "quad-P2", "quad-S2"]
ELEMENTS += ["tet-P1", "tet-P2", "hex-P1", "hex-P2", "hex-S2"]
DIMENSION = {"tri": 2, "quad": 2, "tet": 3, "hex": 3}
LAWS = ["uncoupled", "isotropic", "constrained"]

# Moduli of order one keep round-off readable: E, nu of the parts; E, G, thickness of the layer.
E, NU, E_L, G_L, H = 7.0, 0.3, 0.8, 0.35, 0.2


# --- gathering -----------------------------------------------------------------------------------


def gathered(form):
    """Sparse matrix of a bilinear form, the same on every rank."""
    matrix = assemble_matrix(form if isinstance(form, fem.Form) else fem.form(form))
    matrix.assemble()
    comm, shape = matrix.getComm().tompi4py(), matrix.getLocalSize()
    indptr, indices, data = matrix.getValuesCSR()
    columns = matrix.getSize()[1]
    rows = comm.allgather(sp.csr_matrix((data, indices, indptr), shape=(shape[0], columns)))
    matrix.destroy()
    return sp.vstack(rows).tocsr()


def values(function):
    """Degrees of freedom of a function, in the order of `gathered`, the same on every rank."""
    V = function.function_space
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    return np.concatenate(V.mesh.comm.allgather(function.x.array[:owned].copy()))


def assembled_vector(form):
    """Vector of a linear form, the same on every rank."""
    V = form.arguments()[0].ufl_function_space()
    b = fem.assemble_vector(fem.form(form))
    b.scatter_reverse(InsertMode.add)
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    return np.concatenate(V.mesh.comm.allgather(b.array[:owned].copy()))


def total(form, comm):
    """Value of a functional over all ranks."""
    return comm.allreduce(fem.assemble_scalar(fem.form(form)), op=MPI.SUM)


def interpolated(V, f):
    """Degrees of freedom of the interpolant of ``f(x)``, x of shape (3, n)."""
    u = fem.Function(V)
    u.interpolate(f)
    return values(u)


def rigid_modes(V):
    """Rigid translations and rotations about the origin, one column each, orthonormal."""
    d = V.mesh.geometry.dim
    fields = [lambda x, i=i: np.eye(d)[i][:, None] * np.ones(x.shape[1]) for i in range(d)]
    for i in range(d):
        for j in range(i):
            spin = np.zeros((d, d))
            spin[i, j], spin[j, i] = 1, -1
            fields.append(lambda x, spin=spin: spin @ x[: len(spin)])
    return sla.orth(np.column_stack([interpolated(V, f) for f in fields]))


# --- meshes --------------------------------------------------------------------------------------


def element_of(name):
    """Vector element of a name as in ELEMENTS."""
    cell, (family, degree) = name.split("-")[0], name.split("-")[1]
    return basix.ufl.element(family, CELLS[cell].name, int(degree), shape=(DIMENSION[cell],))


def box(cell, n, lengths, comm=MPI.COMM_WORLD):
    """Structured mesh of a box from the origin, ghosted for forms over interior facets."""
    corners = [np.zeros(len(n)), np.asarray(lengths, dtype=float)]
    create = mesh.create_rectangle if len(n) == 2 else mesh.create_box
    return create(comm, corners, n, CELLS[cell], ghost_mode=mesh.GhostMode.shared_facet)


def rotation(d):
    """An oblique rotation, so that no axis is the layer's normal."""
    if d == 2:
        c, s = np.cos(0.7), np.sin(0.7)
        return np.array([[c, -s], [s, c]])
    return sla.expm(np.array([[0, -0.5, 0.9], [0.5, 0, -0.3], [-0.9, 0.3, 0]]))


def rotate(msh, R):
    """Turn the mesh about the origin."""
    d = len(R)
    msh.geometry.x[:, :d] = msh.geometry.x[:, :d] @ R.T


def cells_between(msh, low, high):
    """Local cells whose vertices all have their last coordinate in [low, high]."""
    last, tol = msh.geometry.dim - 1, 1e-10
    return mesh.locate_entities(
        msh,
        msh.topology.dim,
        lambda x: (x[last] > low - tol) & (x[last] < high + tol),
    )


def tagged(msh, dim, groups):
    """MeshTags with the value k on the entities ``groups[k]``."""
    entities = np.concatenate(groups).astype(np.int32)
    marks = np.concatenate([np.full(len(g), k, np.int32) for k, g in enumerate(groups)])
    order = np.argsort(entities)
    return mesh.meshtags(msh, dim, entities[order], marks[order])


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
    constants: dict = field(default_factory=dict)

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


# --- constant states -----------------------------------------------------------------------------


def layer_moduli(law):
    """(normal modulus, Lamé's lambda felt in the normal direction) of a layer law."""
    lmbda = G_L * (E_L - 2 * G_L) / (3 * G_L - E_L)
    return {
        "uncoupled": (E_L, 0.0),
        "constrained": (lmbda + 2 * G_L, 0.0),
        "isotropic": (lmbda + 2 * G_L, lmbda),
    }[law]


def constant_state(d):
    """Traction on the layer's plane, in-plane strain and spin, all in the local frame."""
    traction = np.array([0.3, -0.2, 0.5])[-d:]
    in_plane = np.array([[0.2, 0.1], [0.1, -0.3]])[: d - 1, : d - 1]
    spin = np.array([[0, 0.2, -0.4], [-0.2, 0, 0.3], [0.4, -0.3, 0]])[-d:, -d:]
    return traction, in_plane, spin


def slope_across(traction, trace, modulus, lmbda, shear):
    """Change of displacement per length across a slab that carries ``traction``."""
    return np.append(traction[:-1] / shear, (traction[-1] - lmbda * trace) / modulus)


def part_slope(d):
    traction, in_plane, _ = constant_state(d)
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    return slope_across(traction, np.trace(in_plane), lmbda + 2 * mu, lmbda, mu)


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
    body = Layered(name, distorted=True)
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
    body = Layered(name)
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
    body, thick = Layered(name, distorted=True), Layered(name, distorted=True)
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
    body = Layered(name)
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


# --- spring interface ----------------------------------------------------------------------------

K_N, K_T = 3.0, 1.1


def two_blocks(name):
    """Unit blocks that touch at height 1, turned; a function each; stiffness and space.

    Both functions live on the whole mesh and are continuous, so either side's restriction is
    the trace; rows outside a function's own block stay empty.
    """
    cell = name.split("-")[0]
    d = DIMENSION[cell]
    msh = box(cell, [2] * (d - 1) + [2], [1] * (d - 1) + [2])
    tags = tagged(msh, d, [cells_between(msh, 0, 1), cells_between(msh, 1, 2)])
    z = d - 1
    facets = mesh.locate_entities(msh, d - 1, lambda x: abs(x[z] - 1) < 1e-10)
    sides = [
        mesh.locate_entities_boundary(msh, d - 1, lambda x: x[z] < 1 + 1e-10),
        mesh.locate_entities_boundary(msh, d - 1, lambda x: x[z] > 1 - 1e-10),
    ]
    dx = ufl.Measure("dx", msh, subdomain_data=tags)
    dS = ufl.Measure("dS", msh, subdomain_data=tagged(msh, d - 1, [facets]))
    ds = ufl.Measure("ds", msh, subdomain_data=tagged(msh, d - 1, sides))
    R = rotation(d)
    rotate(msh, R)
    e = element_of(name)
    W = fem.functionspace(msh, basix.ufl.mixed_element([e, e]))
    (u1, u2), (v1, v2) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    a = forms.elasticity(u1, v1, E, NU, dx(0)) + forms.elasticity(u2, v2, E, NU, dx(1))
    normal = ufl.FacetNormal(msh)("+")
    a += forms.spring_interface(u1("+") - u2("+"), v1("+") - v2("+"), normal, K_N, K_T, dS(0))
    return W, a, ds, R


def interpolated_pair(W, f1, f2):
    u = fem.Function(W)
    u.sub(0).interpolate(f1)
    u.sub(1).interpolate(f2)
    return values(u)


@pytest.mark.parallel
@pytest.mark.parametrize("name", ELEMENTS)
def test_spring_interface_patch_and_null_space(name):
    """Constant stress across an oblique zero-thickness interface, and rigid motions, exactly."""
    W, a, ds, R = two_blocks(name)
    d = len(R)
    K = gathered(a)
    used = np.asarray(abs(K).sum(axis=1)).ravel() > 0
    traction, in_plane, spin = constant_state(d)
    gradient = spin.copy()
    gradient[:-1, :-1] += in_plane
    gradient[:, -1] += part_slope(d)
    jump = traction / np.append(np.full(d - 1, K_T), K_N)
    exact = interpolated_pair(
        W,
        lambda x: R @ gradient @ R.T @ x[:d],
        lambda x: R @ (gradient @ R.T @ x[:d] + jump[:, None]),
    )
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    eps = (gradient + gradient.T) / 2
    stress = R @ (lmbda * np.trace(eps) * np.eye(d) + 2 * mu * eps) @ R.T
    surface = fem.Constant(W.mesh, stress.astype(default_scalar_type)) * ufl.FacetNormal(W.mesh)
    v1, v2 = ufl.TestFunctions(W)
    load = assembled_vector(ufl.dot(surface, v1) * ds(0) + ufl.dot(surface, v2) * ds(1))
    assert abs(K @ exact - load)[used].max() < 1e-13 * abs(K).max() * abs(exact).max()

    eigenvalues = sla.eigvalsh(K[used][:, used].toarray())
    rigid = d * (d + 1) // 2
    assert abs(eigenvalues[rigid - 1]) < 1e-13 * eigenvalues[-1]
    assert eigenvalues[rigid] > 1e-5 * eigenvalues[-1]


@pytest.mark.parallel
@pytest.mark.smoke
@pytest.mark.parametrize("cell", list(CELLS))
def test_spring_interface_between_discontinuous_cells(cell):
    """One side moved rigidly in a DG space: A (k_t I + (k_n - k_t) n n^T), the same serially."""
    d = DIMENSION[cell]

    def stiffness(comm):
        msh = box(cell, [2] * d, [1.0] * d, comm)
        # Facets lie on the diagonal plane x = y of simplices; else on x = 1/2.
        simplex = cell in ("tri", "tet")
        a, offset = np.array([1.0, -1.0 if simplex else 0.0, 0.0]), 0.0 if simplex else 0.5
        side = tagged(msh, d, [mesh.locate_entities(msh, d, lambda x: a @ x > offset - 1e-10)])
        R = rotation(d)
        rotate(msh, R)
        V = fem.functionspace(msh, ("DG", 0, (d,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        n = ufl.FacetNormal(msh)("+")
        K = gathered(forms.spring_interface(ufl.jump(u), ufl.jump(v), n, K_N, K_T, ufl.dS))
        moved = []
        for i in range(d):
            w = fem.Function(V)
            w.x.array.reshape(-1, d)[side.find(0), i] = 1
            moved.append(values(w))
        area = np.linalg.norm(a)
        normal = R @ a[:d] / area
        expected = area * (K_T * np.eye(d) + (K_N - K_T) * np.outer(normal, normal))
        return np.array(moved) @ K @ np.array(moved).T, expected

    distributed, expected = stiffness(MPI.COMM_WORLD)
    serial, _ = stiffness(MPI.COMM_SELF)
    np.testing.assert_allclose(distributed, expected, atol=1e-13)
    np.testing.assert_allclose(distributed, serial, atol=1e-13)


# --- beams ---------------------------------------------------------------------------------------


def cantilever_deflection(name, n, length=2.0):
    """Work-conjugate tip deflection of a deep cantilever (depth 1) under unit end load.

    Loaded on its whole surface by the tractions of Timoshenko and Goodier, Theory of Elasticity,
    art. 21 (end load at x = 0), so that the end conditions leave no singularity.
    """
    cell = name.split("-")[0]
    d = DIMENSION[cell]
    lengths, counts = [length, 1.0, 0.25], [int(n * length), n, 1]
    msh = box(cell, counts[:d], lengths[:d])
    V = fem.functionspace(msh, element_of(name))
    nu = NU if d == 2 else 0.0
    K = gathered(forms.elasticity(ufl.TrialFunction(V), ufl.TestFunction(V), E, nu))
    x = ufl.SpatialCoordinate(msh)
    y = x[1] - 0.5
    bending, shear = -12 * x[0] * y, -6 * (0.25 - y**2)
    rows = [[0.0] * d for _ in range(d)]
    rows[0][0], rows[0][1], rows[1][0] = bending, shear, shear
    f = assembled_vector(
        ufl.dot(ufl.as_matrix(rows) * ufl.FacetNormal(msh), ufl.TestFunction(V)) * ufl.ds
    )
    Z = sp.csr_matrix(rigid_modes(V))
    system = sp.bmat([[K, Z], [Z.T, None]]).tocsc()
    u = spla.spsolve(system, np.append(f, np.zeros(Z.shape[1])))[: len(f)]
    return f @ u / (1.0 if d == 2 else lengths[2])


RATES = {
    "tri-P1": (8, 16, 32),
    "quad-P1": (4, 8, 16),
    "tri-P2": (4, 8, 16),
    "quad-P2": (2, 4, 8),
    "quad-S2": (2, 4, 8),
    "tet-P2": (4, 8),
    "hex-P1": (4, 8, 16),
    "hex-S2": (1, 2, 4),
}


@pytest.mark.parallel
@pytest.mark.parametrize("name", RATES)
def test_cantilever_converges_to_timoshenko(name):
    """P L^3/(3 E I) + P L/(k G A), k = 5/6: order 2 p in the deflection, and from below."""
    nu = NU if DIMENSION[name.split("-")[0]] == 2 else 0.0
    L, inertia = 2.0, 1 / 12
    exact = L**3 / (3 * E / (1 - nu**2) * inertia) + L / (5 / 6 * E / (2 * (1 + nu)))
    errors = np.array([1 - cantilever_deflection(name, n) / exact for n in RATES[name]])
    order = -np.polyfit(np.log(RATES[name]), np.log(errors), 1)[0]
    assert order > 2 * int(name[-1]) - 0.1, (order, errors)
    assert errors[-1] < 0.02


def diaphragm_frequencies(n, length, rho):
    """First bending frequencies, rad/s, of a beam with sliding ends held across; depth 1."""
    msh = box("quad", [int(n * length), n], [length, 1.0])
    V = fem.functionspace(msh, element_of("quad-S2"))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    K, M = gathered(forms.elasticity(u, v, E, NU)), gathered(forms.mass(u, v, rho))
    ends = mesh.locate_entities_boundary(msh, 1, lambda x: (x[0] < 1e-10) | (x[0] > length - 1e-10))
    mark = fem.Function(V)
    mark.x.array.reshape(-1, 2)[fem.locate_dofs_topological(V, 1, ends), 1] = 1
    mark.x.scatter_forward()
    free = values(mark) < 0.5
    K, M = K[free][:, free].toarray(), M[free][:, free].toarray()
    return np.sqrt(sla.eigh(K, M, subset_by_index=[0, 2], eigvals_only=True)[1:])


def timoshenko_frequencies(k, stiffness, G, rho):
    """Lower root of Timoshenko's frequency equation of a supported beam of unit depth.

    Kaneko's shear coefficient (J. Phys. D 8, 1975), 5 (1 + nu)/(6 + 5 nu), for plane strain.
    """
    shear = (k * k * stiffness) / (5 / (6 - NU) * G)
    b = 1 + k * k / 12 + shear / 12
    return np.sqrt(
        stiffness * k**4 / 12 * 2 / (b + np.sqrt(b * b - 4 * shear / 12 * k * k / 12)) / rho
    )


def rayleigh_lamb_frequency(k, guess, rho):
    """Lowest flexural frequency of an elastic layer of unit depth at wave number ``k``.

    Antisymmetric Rayleigh-Lamb equation (Graff, Wave Motion in Elastic Solids, ch. 8).
    """
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))

    def residual(w):
        p2, q2 = k * k - w * w * rho / (lmbda + 2 * mu), k * k - w * w * rho / mu
        p, q = np.sqrt(p2), np.sqrt(q2)
        return 4 * k * k * p * q * np.tanh(q / 2) - (k * k + q2) ** 2 * np.tanh(p / 2)

    return so.brentq(residual, 0.9 * guess, 1.1 * guess, xtol=1e-14, rtol=1e-13)


def test_bending_frequencies():
    """Stiffness and mass against the exact frequencies (order 2 p), and those near Timoshenko's."""
    rho, length = 2.3, 10.0
    k = np.pi * np.arange(1, 3) / length
    beam = timoshenko_frequencies(k, E / (1 - NU**2), E / (2 * (1 + NU)), rho)
    exact = np.array([rayleigh_lamb_frequency(*pair, rho) for pair in zip(k, beam, strict=True)])
    np.testing.assert_allclose(beam, exact, rtol=1e-4)
    sizes = (1, 2, 4)
    errors = [diaphragm_frequencies(n, length, rho)[0] / exact[0] - 1 for n in sizes]
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 3.9, errors
    np.testing.assert_allclose(diaphragm_frequencies(4, length, rho), exact, rtol=1e-4)


# --- mass ----------------------------------------------------------------------------------------


@pytest.mark.parallel
@pytest.mark.smoke
@pytest.mark.parametrize("name", ["tri-P1", "quad-S2", "tet-P2", "hex-S2"])
def test_mass(name):
    """Total mass and moment of inertia of a stretched box; an attached mass is all there."""
    cell = name.split("-")[0]
    d = DIMENSION[cell]
    rho, m, stretch, sides = 2.75, 0.02, 1.5, np.array([2.0, 1.0, 0.5])[:d]
    msh = box(cell, [2] * d, sides)
    V = fem.functionspace(msh, element_of(name))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    top = mesh.locate_entities_boundary(msh, d - 1, lambda x: x[0] > sides[0] - 1e-10)
    ds = ufl.Measure("ds", msh, subdomain_data=tagged(msh, d - 1, [top]))
    body = gathered(forms.mass(u, v, rho, stretch=stretch))
    patch = gathered(forms.attached_mass(u, v, m, np.prod(sides[1:]), ds(0)))
    ones = interpolated(V, lambda x: np.ones((d, x.shape[1])))
    turn = interpolated(V, lambda x: np.vstack([-x[1], x[0], 0 * x[0]])[:d])
    volume = np.prod(sides)
    inertia = rho * stretch * volume * (sides[0] ** 2 + sides[1] ** 2) / 3
    assert ones @ body @ ones == pytest.approx(d * rho * stretch * volume, rel=1e-13)
    assert turn @ body @ turn == pytest.approx(inertia, rel=1e-13)
    assert ones @ patch @ ones == pytest.approx(d * m, rel=1e-13)
    assert turn @ patch @ turn == pytest.approx(m * (sides[0] ** 2 + sides[1] ** 2 / 3), rel=1e-13)


# --- pressure and graded layer -------------------------------------------------------------------

FORCE, R_HOLE, R_HEAD = 21e3, 5e-3, 9e-3


@pytest.mark.parallel
@pytest.mark.parametrize("open_hole", [False, True])
def test_pressure_cone_carries_the_bolt_force(open_hole):
    """The pressure over the plane sums to the force; radially to round-off, in the plane by size.

    The radial mesh has nodes at the kinks, so that its quadrature is exact.
    """
    r_m = forms.contact_radius(R_HEAD, 8e-3, np.pi / 6)
    assert float(r_m) == pytest.approx(R_HEAD + 8e-3 * np.tan(np.pi / 6))
    radii = np.array([0.0, R_HOLE, float(r_m), 2 * float(r_m)])
    line = mesh.create_interval(MPI.COMM_WORLD, 9, [0.0, 9.0])
    line.geometry.x[:, 0] = np.interp(line.geometry.x[:, 0], [0, 3, 6, 9], radii)
    r = ufl.SpatialCoordinate(line)[0]
    P = forms.pressure_cone(r, FORCE, R_HOLE, r_m, open_hole=open_hole)
    dx = ufl.dx(metadata={"quadrature_degree": 4})
    assert total(P * 2 * np.pi * r * dx, line.comm) == pytest.approx(FORCE, rel=1e-12)

    # A turned plane in space, its bolt off the nodes; `radius` measures along the plane.
    R, centre = rotation(3), np.array([0.031, 0.027, 0.4])
    plane = box("hex", [40, 40, 1], [0.06, 0.06, 0.01])
    rotate(plane, R)
    x = ufl.SpatialCoordinate(plane)
    r = forms.radius(x, ufl.as_vector(R @ centre), ufl.as_vector(R[:, 2]))
    P = forms.pressure_cone(r, FORCE, R_HOLE, r_m, open_hole=open_hole)
    force = total(P / 0.01 * ufl.dx(metadata={"quadrature_degree": 4}), plane.comm)
    assert force == pytest.approx(FORCE, rel=3e-3)


def test_graded_modulus_at_hole_rim_and_beyond():
    """E = alpha P_max^beta h at the hole, falling to the floor at and beyond r_m (eqs. 22, 24)."""
    r_m, alpha, beta, h, floor = 14e-3, 2.2e8, 0.6, 2e-4, 1e5
    line = mesh.create_unit_interval(MPI.COMM_SELF, 1)
    r = fem.Constant(line, default_scalar_type(0))

    def modulus(radius):
        r.value = radius
        P = forms.pressure_cone(r, FORCE, R_HOLE, r_m)
        return total(forms.graded_modulus(P, alpha, beta, h, floor) * ufl.dx(line), line.comm)

    peak = 3 * FORCE / (np.pi * (r_m**2 + r_m * R_HOLE + R_HOLE**2))
    full = alpha * peak**beta * h
    assert modulus(0.0) == pytest.approx(full + floor, rel=1e-12)
    assert modulus(R_HOLE) == pytest.approx(full + floor, rel=1e-12)
    middle = (R_HOLE + r_m) / 2
    assert modulus(middle) == pytest.approx(full * 0.5**beta + floor, rel=1e-12)
    assert modulus(r_m) == modulus(2 * r_m) == floor


def test_graded_modulus_derivatives():
    """Derivatives to alpha and beta by UFL pass a Taylor test, with P = 0 in the domain."""
    line = mesh.create_unit_interval(MPI.COMM_WORLD, 16)
    r = 0.03 * ufl.SpatialCoordinate(line)[0]
    P = forms.pressure_cone(r, FORCE, R_HOLE, 14e-3)
    alpha, beta = (fem.Constant(line, default_scalar_type(c)) for c in (2.2e8, 0.6))
    var = {"alpha": ufl.variable(alpha), "beta": ufl.variable(beta)}
    modulus = forms.graded_modulus(P, var["alpha"], var["beta"], 2e-4)
    dx = ufl.dx(metadata={"quadrature_degree": 6})
    functional = fem.form(modulus * dx)
    comm = line.comm

    def J():
        return comm.allreduce(fem.assemble_scalar(functional), op=MPI.SUM)

    base = J()
    by_alpha, by_beta = (total(ufl.diff(modulus, var[k]) * dx, comm) for k in ("alpha", "beta"))
    # Linear in alpha: J = alpha dJ/dalpha.
    assert by_alpha * 2.2e8 == pytest.approx(base, rel=1e-13)
    steps = 0.01 * 0.5 ** np.arange(4)
    remainders = []
    for step in steps:
        beta.value = 0.6 + step
        remainders.append(abs(J() - base - step * by_beta))
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] == pytest.approx(2, abs=0.1)
    beyond = ufl.conditional(ufl.gt(r, 14e-3), ufl.diff(modulus, var["beta"]), 0.0)
    assert total(beyond * dx, comm) == 0.0


# --- constants and the seed's table --------------------------------------------------------------


def test_lame_parameters_from_both_pairs_agree():
    """Eq. 7 with ``3G - E``; the printed ``E - 3G`` would make lambda negative."""
    nu = np.array([-0.4, 0.0, 0.283, 0.49])
    G = E / (2 * (1 + nu))
    by_nu = np.array([forms.lame_parameters(E, x) for x in nu])
    by_moduli = np.array([forms.lame_from_moduli(E, x) for x in G])
    np.testing.assert_allclose(by_moduli, by_nu, rtol=1e-12, atol=1e-15)
    assert by_nu[2, 0] > 0 > G[2] * (E - 2 * G[2]) / (E - 3 * G[2])


# Seed 001, Table 1: dN/dx, dN/dy, dN/dz of the eight nodes at a Gauss point, 1 x 1 x 0.1. Row 3,
# column 3 is printed -1.16667. In its 5 x 5 x 0.1 block the first two columns are a fifth of these.
TABLE_1 = np.array(
    [
        [-0.16667, -0.62201, -1.66667],
        [0.16667, -0.16667, -0.44658],
        [0.62201, 0.16667, -1.66667],
        [-0.62201, 0.62201, -6.22008],
        [-0.04466, -0.16667, 1.66667],
        [0.04466, -0.04466, 0.44658],
        [0.16667, 0.04466, 1.66667],
        [-0.16667, 0.16667, 6.22008],
    ]
)
CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)


@pytest.mark.parametrize("size", [1.0, 5.0])
def test_layer_strain_against_table_1(size):
    """Strains of a thin hexahedron, one node moved at a time, are the seed's Table 1."""
    sides = np.array([size, size, 0.1])
    msh = box("hex", [1, 1, 1], sides, MPI.COMM_SELF)
    V = fem.functionspace(msh, ("Lagrange", 1, (3,)))
    u = fem.Function(V)
    eps_n, gamma = forms.layer_strain(forms.stretched_gradient(u), ufl.as_vector([0, 0, 1]))
    gauss = (1 + np.array([-1, 1, -1]) / np.sqrt(3)) / 2
    strains = fem.Expression(ufl.as_vector([eps_n, *gamma]), gauss[None])
    x = V.tabulate_dof_coordinates()
    for corner, row in zip(CORNERS, TABLE_1 / [size, size, 1], strict=True):
        node = np.argmin(np.linalg.norm(x - corner * sides, axis=1))
        for axis in range(3):
            u.x.array[:] = 0
            u.x.array[3 * node + axis] = 1
            expected = np.zeros(4)
            if axis == 2:
                expected[:3] = row[2], row[0], row[1]
            else:
                expected[1 + axis] = row[2]
            found = strains.eval(msh, np.array([0], np.int32)).ravel()
            np.testing.assert_allclose(found, expected, atol=6e-6)


def test_bad_input_is_named():
    """Values outside their range are refused with the key, the value and the range."""
    msh = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    u = fem.Function(fem.functionspace(msh, ("Lagrange", 1, (2,))))
    with pytest.raises(InputError, match=r"nu = 0\.5.*-1 < nu < 0\.5"):
        forms.elasticity(u, u, 1.0, 0.5)
    with pytest.raises(InputError, match=r"E = 3\.0.*G = 1\.0.*0 < E < 3 G"):
        forms.isotropic_layer(u, u, 3.0, 1.0)
    with pytest.raises(InputError, match="stretch.*normal"):
        forms.elasticity(u, u, 1.0, 0.3, stretch=2.0)
    with pytest.raises(InputError, match=r"r_contact = 0\.005.*r_hole = 0\.005"):
        forms.pressure_cone(0.0, FORCE, R_HOLE, R_HOLE)
