"""Strains of a layer against a published table."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from form_bodies import box
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.errors import InputError

# Tian et al. 2021, Table 1: dN/dx, dN/dy, dN/dz of the eight nodes at a Gauss point, 1 x 1 x 0.1.
# Row 3, column 3 is printed -1.16667. In its 5 x 5 x 0.1 block the first two columns are a fifth of
# these.
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
    """Strains of a thin hexahedron, one node moved at a time, are the paper's Table 1."""
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


def test_normals_are_ufl_or_numbers():
    """Numbers of any length are a direction, the same as a unit vector of UFL; zero is none."""
    msh = box("hex", [1, 1, 1], np.ones(3), MPI.COMM_SELF)
    u = fem.Function(fem.functionspace(msh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: np.array([x[0] * x[2], x[1] ** 2, x[2] - x[0]]))

    def energy(normal):
        form = forms.uncoupled_layer(u, u, normal, 3.0, 2.0, stretch=1.5)
        return fem.assemble_scalar(fem.form(form))

    exact = energy(ufl.as_vector((0.6, 0.0, 0.8)))
    for normal in ((0.6, 0.0, 0.8), [6, 0, 8], np.array([0.3, 0, 0.4])):
        assert np.isclose(energy(normal), exact, rtol=1e-12)
    for normal in ((0, 0, 0), (0, 1), "z", None, (0, np.nan, 1)):
        with pytest.raises(InputError, match="normal"):
            energy(normal)
