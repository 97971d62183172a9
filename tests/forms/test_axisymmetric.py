"""Bodies of revolution against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse.linalg as spla
import ufl
from dolfinx import fem, mesh
from eigen_slopes import assert_same
from form_bodies import assembled_vector, box, gathered, tagged
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ReducedStructure
from fenics_joints.structure import Parameter, PointMass, Structure, Support, joint, part

E, NU, RHO = 7.0, 0.3, 2.3
A, B, HEIGHT = 0.5, 2.0, 0.8


def half_section(inner, outer, height, n, cell="quad", comm=MPI.COMM_SELF):
    """Rectangle inner < r < outer, 0 < z < height, with its four sides named."""
    msh = box(cell, n, [outer - inner, height], comm)
    msh.geometry.x[:, 0] += inner
    sides = ((0, inner), (0, outer), (1, 0.0), (1, height))
    found = [
        mesh.locate_entities_boundary(msh, 1, lambda x, i=i, c=c: np.isclose(x[i], c))
        for i, c in sides
    ]
    count = msh.topology.index_map(2)
    cells = tagged(msh, 2, [[], np.arange(count.size_local + count.num_ghosts)])
    names = {"inner": 1, "outer": 2, "bottom": 3, "top": 4}
    return TaggedMesh(msh, cells, tagged(msh, 1, [[], *found]), {"body": 1}, names)


def solved(body, tractions, held=(("bottom", 1),), degree=2):
    """Displacement of a body of revolution under pressures by the name of the face."""
    V = fem.functionspace(body.mesh, ("Lagrange", degree, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    r = ufl.SpatialCoordinate(body.mesh)[0]
    ds = ufl.Measure("ds", body.mesh, subdomain_data=body.facet_tags)
    load = sum(
        -p * forms.circumference(r) * ufl.dot(ufl.FacetNormal(body.mesh), v) * ds(tag)
        for tag, p in ((body.facet_tag(name), p) for name, p in tractions.items())
    )
    free = np.ones((V.dofmap.index_map.size_local, 2), dtype=bool)
    for name, i in held:
        facets = body.facet_tags.find(body.facet_tag(name))
        free[fem.locate_dofs_topological(V, 1, facets), i] = False
    free = free.ravel()
    K = gathered(forms.axisymmetric_elasticity(u, v, E, NU, radius=r))
    solution = fem.Function(V)
    solution.x.array[free] = spla.spsolve(K[free][:, free].tocsc(), assembled_vector(load)[free])
    return solution


def at_nodes(u):
    """Nodes' r and z, and the displacement, each of shape (n, 2)."""
    return u.function_space.tabulate_dof_coordinates()[:, :2], u.x.array.reshape(-1, 2)


def test_thick_cylinder_converges_to_lame():
    """Inner and outer pressure with free ends, u_z held at the bottom: Lamé's solution.

    u_r = ((1 - nu) (pa a^2 - pb b^2) r + (1 + nu) (pa - pb) a^2 b^2 / r)/(E (b^2 - a^2)), and the
    ends contract evenly by -2 nu (pa a^2 - pb b^2)/(E (b^2 - a^2)).
    """
    pa, pb = 1.3, 0.4
    errors = []
    sizes = (4, 8, 16)
    for n in sizes:
        body = half_section(A, B, HEIGHT, [n, 2])
        x, u = at_nodes(solved(body, {"inner": pa, "outer": pb}))
        r, mean = x[:, 0], pa * A**2 - pb * B**2
        exact = (1 - NU) * mean * r + (1 + NU) * (pa - pb) * A**2 * B**2 / r
        axial = -2 * NU * mean * x[:, 1]
        exact = np.column_stack([exact, axial]) / (E * (B**2 - A**2))
        errors.append(np.abs(u - exact).max())
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 2.7, errors
    assert errors[-1] < 1e-3


@pytest.mark.parametrize(("cell", "degree"), [("tri", 1), ("quad", 1), ("tri", 2)])
@pytest.mark.parametrize("inner", [0.0, A])
def test_hydrostatic_and_uniaxial_stress_are_exact(cell, degree, inner):
    """u = -p (1 - 2 nu)/E (r, z), and u = t/E (-nu r, z), with the axis in the mesh and without."""
    body = half_section(inner, B, HEIGHT, [3, 2], cell)
    axis = (("inner", 0),) if inner == 0 else ()
    held = (("bottom", 1), *axis)
    squeeze = {"outer": 2.1, "top": 2.1} | ({} if axis else {"inner": 2.1})
    x, u = at_nodes(solved(body, squeeze, held, degree))
    np.testing.assert_allclose(u, -2.1 * (1 - 2 * NU) / E * x, atol=1e-12)
    x, u = at_nodes(solved(body, {"top": -2.1}, held, degree))
    np.testing.assert_allclose(u, 2.1 / E * x * [-NU, 1], atol=1e-12)


def tube(parameters=(), inner=A, height=HEIGHT, masses=(), **changes):
    body = part("tube", "body", **({"E": E, "nu": NU, "rho": RHO} | changes))
    section = half_section(inner, B, height, [3, 2])
    return Structure(section, [body], parameters, masses=masses, axisymmetric=True)


def test_volume_mass_and_breathing_of_the_whole_ring():
    """rho pi (b^2 - a^2) h; the field (r, z - h/2) has the stiffness 9 K V, K the bulk modulus."""
    model = tube()
    volume = np.pi * (B**2 - A**2) * HEIGHT
    assert model.volumes() == pytest.approx([volume], rel=1e-12)
    assert model.total_mass() == pytest.approx(RHO * volume, rel=1e-12)
    moment = RHO * np.pi * HEIGHT * ((B**4 - A**4) / 2 + (B**2 - A**2) * HEIGHT**2 / 12)
    stiffness = 9 * E / (3 * (1 - 2 * NU)) * volume
    expected = np.sqrt(stiffness / moment) / (2 * np.pi)
    assert model.dilation_frequency() == pytest.approx(expected, rel=1e-12)


def test_stretch_along_the_axis_is_a_longer_mesh():
    """K and M of the stretched tube, also by its parametric terms, are those of a longer one."""
    model = tube(parameters=[Parameter("s", 1.0)], stretch="s", normal=(0.0, 1.0))
    longer = tube(height=1.7 * HEIGHT)
    K, M = model.stiffness({"s": 1.7}), model.mass({"s": 1.7})
    assert_same(K, longer.stiffness(), 1e-12)
    assert_same(M, longer.mass(), 1e-12)
    rng = np.random.default_rng(0)
    shapes = []
    for _ in range(2):
        shapes.append(K.createVecRight())
        shapes[-1].array = rng.standard_normal(shapes[-1].local_size)
    small = ReducedStructure(model, shapes)
    assert small.total_mass({"s": 1.7}) == pytest.approx(longer.total_mass(), rel=1e-12)


@pytest.mark.parallel
def test_long_rod_has_the_frequencies_of_a_bar():
    """One rigid mode, then n c/(2 l) with c^2 = E/rho, less Love's (n pi nu r)^2/(4 l^2)."""
    length, radius = 2.0, 0.05
    rod = half_section(0.0, radius, length, [1, 24], comm=MPI.COMM_WORLD)
    body = part("rod", "body", E=2.1e11, nu=NU, rho=7800.0)
    model = Structure(rod, [body], supports=[Support("inner", (0,))], axisymmetric=True)
    modes = solve_modes(model, n_modes=4)
    assert modes.n_rigid == 1
    n = np.arange(1, 4)
    love = 1 - (n * np.pi * NU * radius / length) ** 2 / 4
    bar = n * np.sqrt(2.1e11 / 7800.0) / (2 * length) * love
    np.testing.assert_allclose(modes.frequencies_hz[1:], bar, rtol=2e-5)


def test_a_mass_on_the_circle_is_added_once():
    """A mass m moves with a rigid translation along the axis as m, and gives the gradient."""
    model = tube([Parameter("m", 0.3)], masses=[PointMass("ring", "m", (B, HEIGHT, 0.0))])
    M = model.mass()
    lift = M.createVecRight()
    lift.array[1::2] = 1.0
    assert lift.dot(M * lift) == pytest.approx(model.total_mass(), rel=1e-12)
    assert model.pencil_gradients([lift], [2.0])[0] == pytest.approx([-2.0])


def test_what_has_no_axisymmetric_form_is_refused():
    """Layers, stretches off the axis, negative radii."""
    layer = joint("seal", "body", E=1.0, G=1.0, normal=(0.0, 1.0))
    with pytest.raises(InputError, match="seal: a thin layer is not available"):
        Structure(half_section(A, B, HEIGHT, [1, 1]), [layer], axisymmetric=True)
    with pytest.raises(InputError, match=r"tube\.normal.*expected the axis"):
        tube(stretch=2.0)
    with pytest.raises(MeshError, match=r"r = x\[0\] >= 0"):
        tube(inner=-0.1)
