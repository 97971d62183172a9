"""Springs between faces: patch, null space, cells that are not connected."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import scipy.linalg as sla
import ufl
from dolfinx import default_scalar_type, fem, mesh
from form_bodies import (
    CELLS,
    DIMENSION,
    ELEMENTS,
    NU,
    E,
    assembled_vector,
    box,
    cells_between,
    constant_state,
    element_of,
    gathered,
    part_slope,
    rotate,
    rotation,
    tagged,
    values,
)
from mpi4py import MPI

from fenics_joints import forms

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
