"""Layers between faces whose meshes do not match, against exact states and matching meshes."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from layered_plates import Bond, Stick
from petsc4py import PETSc
from unlike_meshes import COMM, lap, springs, two_parts

from fenics_joints.errors import MeshError
from fenics_joints.interfaces import reduce_layers
from fenics_joints.meshes import check_mesh
from fenics_joints.meshes.tagged import extent
from fenics_joints.modal import solve_modes
from fenics_joints.preload import PreloadModel
from fenics_joints.reduction import reduce
from fenics_joints.structure import ElasticSupport, Parameter, PointMass, Sensors, Spring, Support
from fenics_joints.updating import Target, update

K_N, K_T = 3e10, 2e10


def stack(cell, low, high, width=1.0):
    """Blocks on one another, leaning, with names for both ends."""

    def lean(x):
        if x.shape[1] == 3:
            x[:, 0] += 0.3 * x[:, 1]

    n = len(low)
    blocks = [
        ([0.0] * (n - 1) + [-1.0], [1.0] * (n - 1) + [0.0], low),
        ([0.0] * n, [width] + [1.0] * (n - 1), high),
    ]
    return two_parts(cell, blocks, lean, [("bottom", n - 1, -1.0), ("top", n - 1, 1.0)])


@pytest.mark.survives
@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("cell", "low", "high"),
    [
        ("quadrilateral", (4, 2), (5, 2)),
        ("triangle", (4, 3), (7, 2)),
        ("hexahedron", (4, 2, 2), (3, 5, 2)),
        ("tetrahedron", (4, 2, 2), (3, 3, 2)),
    ],
)
def test_even_pressure_passes(cell, low, high, degree):
    """A column under even pressure: nothing is left but the loads on its ends."""
    tagged = stack(cell, low, high)
    gdim = tagged.mesh.geometry.dim
    up, E = np.eye(gdim)[-1], 2e11
    s = springs(tagged, degree, K_N, K_T, up, solid={"nu": 0.0})
    thin = extent(tagged, ["joint"], up)

    def exact(x):
        z = x[gdim - 1] + 0.5 * thin
        solid = np.minimum(z, 0) + np.maximum(z - thin, 0)
        return np.outer(up, solid / E + np.clip(z / thin, 0, 1) / K_N)

    u = fem.Function(s.V)
    u.interpolate(exact)
    K = s.stiffness()
    x = K.createVecRight()
    x.array[:] = np.where(s.held_dofs, 0.0, u.x.array)[: s.n_local]
    np.testing.assert_allclose(s.displacement(x).x.array, u.x.array, atol=1e-10 / K_N)
    residual = (K * x).array_r.copy()
    forces = []
    for name in ("bottom", "top"):
        facets = tagged.facet_tags.find(tagged.facet_tag(name))
        dofs = fem.locate_dofs_topological(s.V, gdim - 1, facets)
        dofs = dofs[dofs < s.n_local // gdim]
        forces.append(COMM.allreduce(residual.reshape(-1, gdim)[dofs].sum(axis=0)))
        residual.reshape(-1, gdim)[dofs] = 0.0
    assert np.abs(residual).max(initial=0.0) < 1e-9
    np.testing.assert_allclose(forces, [-up, up], atol=1e-9)


@pytest.mark.parametrize(("cell", "high"), [("hexahedron", (4, 3, 1)), ("tetrahedron", (5, 4, 1))])
def test_faces_that_overlap_in_part(cell, high):
    """The layer is as stiff as their common area, whichever facets the edge cuts."""
    tagged = two_parts(
        cell, [([0, 0, -1], [1, 1, 0], (3, 3, 1)), ([0.37, 0.23, 0], [1.37, 1.23, 1], high)]
    )
    s = springs(tagged, 1, K_N, K_T)
    u = fem.Function(s.V)
    motion = np.array([[3e-6], [2e-6], [1e-6]])
    cells = tagged.cell_tags.find(tagged.cell_tag("high"))
    u.interpolate(lambda x: np.tile(motion, x.shape[1]), cells)
    K = s.stiffness()
    x = K.createVecRight()
    x.array[:] = np.where(s.held_dofs, 0.0, u.x.array)[: s.n_local]
    area = 0.63 * 0.77
    energy = area * (13e-12 * K_T + 1e-12 * K_N)
    assert x.dot(K * x) == pytest.approx(energy, rel=1e-9)
    assert s.volumes()[-1] == pytest.approx(area * extent(tagged, ["joint"], (0, 0, 1)))
    assert f"counts as the {1e6 * area:.4g} mm2" in tagged.notes[0]


def test_curved_faces():
    """Tubes one in another under pressure: Lame's displacement, at second order."""
    inner, middle, outer, E, nu, k = 0.04, 0.06, 0.1, 2e11, 0.3, 1e13
    pressure = 1e7

    def radial(x):
        r, angle = x[:, 1].copy(), 0.5 * np.pi * x[:, 0]
        x[:] = np.column_stack([r * np.cos(angle), r * np.sin(angle)])

    def tube(a, b, r, p, q):
        """Radial displacement in plane strain under inner and outer pressure."""
        share = 1 / (b**2 - a**2)
        A, B = share * (a**2 * p - b**2 * q), share * a**2 * b**2 * (p - q)
        return (1 + nu) / E * (A * (1 - 2 * nu) * r + B / r)

    # The pressure between the tubes, from the jump of their displacements there.
    def opening(q):
        return tube(middle, outer, middle, q, 0) - tube(inner, middle, middle, pressure, q) + q / k

    q = -opening(0.0) / (opening(1.0) - opening(0.0))
    exact = tube(middle, outer, outer, q, 0)
    errors = []
    for n in (4, 8, 16):
        tagged = two_parts(
            "quadrilateral",
            [
                ([0, inner], [1, middle], (n, n // 2)),
                ([0, middle], [1, outer], (3 * n // 2, n // 2)),
            ],
            radial,
            [("bore", 1, inner), ("start", 0, 0.0), ("end", 0, 1.0)],
        )

        held = [Support("start", directions=(1,)), Support("end", directions=(0,))]
        s = springs(
            tagged, 1, k, 1e3, radially, meshed=thickness(tagged), solid={"nu": nu}, supports=held
        )
        v, out = ufl.TestFunction(s.V), ufl.FacetNormal(s.mesh)
        ds = ufl.Measure("ds", s.mesh, subdomain_data=tagged.facet_tags)
        load = fem_petsc.assemble_vector(
            fem.form(-pressure * ufl.dot(out, v) * ds(tagged.facet_tag("bore")))
        )
        load.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
        K = s.stiffness()
        f, x = K.createVecRight(), K.createVecRight()
        f.array[:] = s.free_loads(load.array_r[: s.n_local, None].copy())[:, 0]
        solver = PETSc.KSP().create(COMM)
        solver.setOperators(K), solver.setType("preonly"), solver.getPC().setType("lu")
        solver.getPC().setFactorSolverType("mumps")
        solver.solve(f, x)
        found = s.observe([x], Sensors([[0.0, outer]], [[0.0, 1.0]]))[0, 0]
        errors.append(abs(found / exact - 1))
    assert errors[2] < 2e-3
    assert np.log2(errors[0] / errors[2]) > 3.6, errors


def radially(x):
    return x / ufl.sqrt(ufl.dot(x, x))


def thickness(tagged) -> float:
    """Mean thickness of a curved layer, m: its area in the plane over its length."""
    s = springs(tagged, 1, normal=radially, meshed=1.0)
    return s.volumes()[-1] / (0.06 * np.pi / 2)


@pytest.mark.survives
@pytest.mark.parallel
def test_a_lap_of_unlike_meshes_is_that_of_like_ones():
    """Cells three times as large in one plate: frequencies differ by no more than the meshes' own
    error, and their slopes are those of differences."""
    coarse, fine = (10, 2, 1), (30, 6, 1)
    pairs = ((coarse, coarse), (coarse, fine), (fine, fine))
    found = [solve_modes(springs(lap(*pair)), n_modes=12) for pair in pairs]
    like, unlike, exact = (modes.frequencies_hz[6:] for modes in found)
    assert np.all(unlike <= like * (1 + 1e-9)) and np.all(unlike >= exact * (1 - 2e-3))
    modes = found[1]
    assert modes.n_rigid == 6
    assert modes.model.total_mass() == pytest.approx(2 * 0.2 * 0.04 * 0.01 * 7800, rel=1e-4)
    slopes = modes.gradients(range(6, 12))
    for i, name in enumerate(("k_n", "k_t")):
        ends = [solve_modes(modes.model, {name: k}, n_modes=12) for k in (0.999e12, 1.001e12)]
        difference = np.diff([end.eigenvalues[6:] for end in ends], axis=0)[0] / 0.002e12
        np.testing.assert_allclose(
            slopes[:, i], difference, rtol=1e-4, atol=1e-6 * difference.max()
        )


@pytest.mark.parallel
@pytest.mark.parametrize(("cell", "law"), [("hexahedron", Stick), ("tetrahedron", Bond)])
def test_a_law_as_stiff_as_the_springs_gives_the_linear_lap(cell, law):
    tagged = lap((8, 3, 1), (11, 2, 1), cell)
    s = springs(tagged, 1, 1e11, 1e11)
    thin = extent(tagged, ["joint"], (0, 0, 1))
    law = law(k=1e11 * thin) if law is Stick else law(k_n=1e11 * thin, k=1e11 * thin)
    exact = solve_modes(s, n_modes=12).frequencies_hz
    model = reduce_layers(s, {"joint": law}, n_modes=12, interface_modes=6)
    found = solve_modes(model, n_modes=12).frequencies_hz
    assert model.interfaces[0].weights.sum() == pytest.approx(0.08 * 0.04 * thin)
    np.testing.assert_allclose(found[6:], exact[6:], rtol=2e-3)


def test_stiffness_is_found_with_unlike_meshes():
    """From frequencies and shapes of a finer lap whose meshes match."""
    grid = [[x, y, z] for x, z in ((0.01, 0), (0.16, 0), (0.31, 0.02)) for y in (0, 0.04)]
    places = Sensors(grid * 2, [[0, 0, 1.0]] * len(grid) + [[0, 1.0, 0]] * len(grid))
    modes = solve_modes(springs(lap((30, 6, 1), (30, 6, 1)), 2, 3e10, 2e10), n_modes=10)
    shapes = modes.at(places)[:, 6:]
    target = Target(modes.frequencies_hz[6:], 1e-3, shapes, places, shape_sd=0.02)
    samples = [{"k_n": a, "k_t": b} for a in (1e10, 1e11) for b in (1e10, 1e11)]
    model = reduce(springs(lap((10, 2, 1), (30, 6, 1))), samples, 12)
    unknown = [Parameter(k, 6e10, "Pa/m", 5e9, 5e11) for k in ("k_n", "k_t")]
    found = update(model, unknown, target, {"k_n": 6e10, "k_t": 6e10})
    assert found.values == pytest.approx([3e10, 2e10], rel=0.03)


@pytest.mark.survives
@pytest.mark.parallel
def test_what_stands_on_an_unlike_lap_is_as_on_a_like_one():
    """A mass, a spring, a held vertex on the contact, a support of the whole lower face's
    springs, and a sensor at the end of the lap; full, reduced and iterative."""
    found = []
    for low, high in (((30, 6, 1), (30, 6, 1)), ((20, 4, 1), (30, 6, 1))):
        tagged = lap(low, high, faces=[("top", 2, 0.01)])
        s = springs(
            tagged,
            k_n=3e10,
            k_t=3e10,
            masses=[PointMass("m", 0.2, (0.14, 0.04, 0.015))],
            springs=[Spring("y", 1e7, (0.18, 0.0, 0.005), (0.0, 1.0, 0.0))],
            supports=[
                Support(points=[[0.12, 0.0, 0.01]], directions=(0,)),
                ElasticSupport("bed", "top", 1e9, 1e9),
            ],
        )
        modes = solve_modes(s, n_modes=8)
        places = Sensors([[0.2003, 0.01, 0.01], [0.16, 0.04, 0.02]], [[0, 0, 1.0]] * 2)
        found.append((modes.frequencies_hz, np.abs(modes.at(places)[0])))
        again = solve_modes(s, n_modes=6, method="iterative").frequencies_hz
        np.testing.assert_allclose(again, modes.frequencies_hz[:6], rtol=1e-6)
        small = solve_modes(reduce(s, [{}, {"k_t": 6e10}], 8), n_modes=8).frequencies_hz
        np.testing.assert_allclose(small, modes.frequencies_hz, rtol=1e-5)
    (like, there), (unlike, here) = found
    np.testing.assert_allclose(unlike, like, rtol=6e-3)
    np.testing.assert_allclose(here, there, rtol=0.03, atol=0.02 * there.max())


def test_faces_that_match_in_part_are_joined_as_a_whole():
    """Half of the lap's facets have vertices at the same places."""

    def graded(x):
        upper = np.arange(len(x)) >= 21 * 5 * 2
        far = upper & (x[:, 0] > 0.1601)
        x[far, 0] += 0.004 * np.sin(np.pi * (x[far, 0] - 0.16) / 0.16)

    tagged = lap((20, 4, 1), (20, 4, 1), change=graded)
    area = springs(tagged, 1).volumes()[-1] / extent(tagged, ["joint"], (0, 0, 1))
    assert len(tagged.ties) == 1 and area == pytest.approx(0.08 * 0.04, rel=1e-9)
    with pytest.raises(MeshError, match="bonded has .*whose meshes do not match"):
        lap((20, 4, 1), (20, 4, 1), change=graded, bonded=[("low", "high")])


def test_what_ties_cannot_do_is_said():
    tagged = lap((2, 1, 1), (3, 1, 1))
    with pytest.raises(MeshError, match="expected 1 or 2 with faces that are tied"):
        springs(tagged, 3)
    s = springs(tagged)
    assert s.finer() is None and s.coarser().degree == 1
    assert check_mesh(tagged).bodies == 1
    with pytest.raises(MeshError, match="faces that do not match"):
        PreloadModel(s, [])
    with pytest.raises(MeshError, match="a support holds joint_tied"):
        springs(tagged, supports=[Support("joint_tied")])
    with pytest.raises(MeshError, match="'joint_tied': is tied to a part"):
        springs(tagged, supports=[ElasticSupport("e", "joint_tied", 1.0, 1.0)]).stiffness()
