"""The transition-interface material of seed 000: its law, thickness as a number, and grading."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import ufl
from dolfinx import fem, mesh
from gathering import gathered
from mpi4py import MPI
from scipy.integrate import quad

from fenics_joints import forms
from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import check_mesh, dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ReducedStructure, reduce
from fenics_joints.structure import Parameter, Structure, part, transition
from fenics_joints.structure.laws import TRANSITION

COMM = MPI.COMM_WORLD
BODY = {"E": 1.3e11, "nu": 0.27, "rho": 7850.0}  # seed 000, section 4.2
TRUE = {"E": 1e10, "nu": 0.24, "h": 0.01}  # Table 6, row 1
N_MODES, ELASTIC = 12, slice(6, None)
SOLID = ("head_1", "neck_1", "neck_2", "head_2")
COARSE = {"element_size": 0.065}


# --- the law: a column of body, layer, body ------------------------------------------------------

LEVELS, N_BODY = np.array([0.0, 0.8, 1.0, 1.9]), 2
SIDE, H0, H = 0.7, 0.2, 0.55
E_B, NU_B = 7.0, 0.3
TURN = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]


class Column:
    """A square column of body, layer and body along a slanting axis."""

    def __init__(self, n_layer=1, cell=mesh.CellType.hexahedron, turn=TURN, n_side=2):
        counts = np.array([N_BODY, n_layer, N_BODY])
        n, ghosts = int(counts.sum()), mesh.GhostMode.shared_facet
        corners = [[0.0, 0.0, 0.0], [SIDE, SIDE, n]]
        self.msh = mesh.create_box(COMM, corners, [n_side, n_side, n], cell, ghost_mode=ghosts)
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
        u = fem.Function(self.V)
        u.interpolate(lambda x: self.turn @ function(self.turn.T @ x))
        owned = self.V.dofmap.index_map.size_local * 3
        return np.concatenate(COMM.allgather(u.x.array[:owned].copy()))

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
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_uniform_stress_passes_in_series(cell):
    """Tension with free sides, strain along the axis alone, shear: u = sum h_i / modulus_i.

    Unit stress leaves no force inside, and does the work A u on a layer H thick, meshed H0.
    """
    column = Column(cell=getattr(mesh.CellType, cell))
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


# --- the thickness as a number, beside meshes of that thickness ----------------------------------


def sandwich(h0=0.01, comm=COMM, rho="average", n_layer=1, E="E", **more):
    """Dumbbells with a layer h0 thick in the mesh; parameters E, nu, h of the layer and rho."""
    if rho == "average":
        rho = lambda x, p: forms.average_density(p["rho"], p["rho"])  # noqa: E731
    layer = transition("layer", "joint", E=E, nu="nu", h="h", meshed=h0, rho=rho)
    bodies = part("bodies", SOLID, **{**BODY, "rho": "rho"})
    parameters = [Parameter(name, value, log=name != "nu") for name, value in TRUE.items()]
    tagged = dumbbell(comm, layer=h0, n_layer=n_layer, **COARSE)
    return Structure(tagged, [bodies, layer], [*parameters, Parameter("rho", BODY["rho"])], **more)


def elastic_hz(model, given=None):
    modes = solve_modes(model, given, n_modes=N_MODES, tolerance=1e-10)
    assert modes.n_rigid == 6
    return modes.frequencies_hz[ELASTIC]


@pytest.mark.parallel
def test_thickness_is_a_remeshed_layer():
    """The matrices themselves are those of the thicker mesh, whose upper body has moved."""
    model = sandwich(0.01)
    for h in (0.005, 0.01, 0.02):
        remeshed = sandwich(h)
        for made, wanted in (
            (model.stiffness({"h": h}), remeshed.stiffness({"h": h})),
            (model.mass({"h": h}), remeshed.mass({"h": h})),
        ):
            size = wanted.norm()
            wanted.axpy(-1.0, made)
            assert wanted.norm() < 1e-12 * size
        assert model.total_mass({"h": h}) == pytest.approx(remeshed.total_mass({"h": h}))


def test_frequencies_and_their_slope_by_the_thickness():
    """At 5, 10 and 20 mm to 1e-8; the slope beside central differences over meshes to 1e-5."""
    model = sandwich(0.01, MPI.COMM_SELF)
    for h in (0.005, 0.02):
        wanted = elastic_hz(sandwich(h, MPI.COMM_SELF), {"h": h})
        assert elastic_hz(model, {"h": h}) == pytest.approx(wanted, rel=1e-8)
    h, step = 0.014, 1e-3
    modes = solve_modes(model, {"h": h}, n_modes=N_MODES, tolerance=1e-10)
    lam = [
        (2 * np.pi * elastic_hz(sandwich(g, MPI.COMM_SELF), {"h": g})) ** 2
        for g in (h * (1 - step), h * (1 + step))
    ]
    slope = (lam[1] - lam[0]) / (2 * h * step)
    index = list(range(6, N_MODES))
    found = modes.gradients(index)[:, list(model.parameters).index("h")]
    assert found == pytest.approx(slope, rel=1e-5)
    assert (np.abs(slope) * h > 1e-3 * modes.eigenvalues[index]).sum() >= 5


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["full", "reduced", "graded"])
def test_adjoint_derivatives(kind):
    """Halving a small step in any parameter quarters what the derivative leaves."""
    model = {
        "full": sandwich, "reduced": lambda: sandwich(rho=0.0),
        "graded": lambda: sandwich(n_layer=3, E=graded),
    }[kind]()  # fmt: skip
    if kind == "reduced":
        model = reduce(model, [{}, {"h": 0.02, "nu": 0.35}, {"E": 3e10}], N_MODES)
    at = {"h": 0.013, "E": 8e9, "nu": 0.26}
    modes = solve_modes(model, at, n_modes=N_MODES, tolerance=1e-10)
    elastic = np.arange(6, N_MODES - 1)
    gradients = modes.gradients(elastic)
    steps = {"h": 1e-3, "E": 1e9, "nu": 0.04, "rho": 500.0}
    for column, name in enumerate(model.parameters):
        remainder = []
        for step in (steps[name], steps[name] / 2):
            moved = {**at, name: at.get(name, BODY["rho"]) + step}
            values = solve_modes(model, moved, n_modes=N_MODES, tolerance=1e-10).eigenvalues
            change = values[elastic] - modes.eigenvalues[elastic]
            remainder.append(np.abs(change - step * gradients[:, column]))
        seen = remainder[1] > 1e-8 * modes.eigenvalues[elastic]
        assert seen.sum() >= 2, name
        assert np.all(np.log2(remainder[0][seen] / remainder[1][seen]) > 1.8), name


def test_terms_reproduce_the_assembled_matrices():
    """On vectors that were never modes."""
    model, rng = sandwich(comm=MPI.COMM_SELF, rho=2000.0), np.random.default_rng(3)
    vectors = [model.mass().createVecRight() for _ in range(4)]
    for x in vectors:
        x.array[:] = rng.standard_normal(x.local_size)
    small = ReducedStructure(model, vectors)
    given = {"h": 0.017, "E": 3e9, "nu": 0.1}
    for reduced, assembled in (
        (small.stiffness(given), small.projection.matrix(model.stiffness(given))),
        (small.mass(given), small.projection.matrix(model.mass(given))),
    ):
        assert reduced == pytest.approx(assembled, rel=1e-9, abs=1e-9 * np.abs(assembled).max())
    assert small.total_mass(given) == pytest.approx(model.total_mass(given))


def test_case_names_the_layer(tmp_path):
    """A case's NAME.h is the thickness, whatever the mesh's; wrong keys are named."""
    text = """
        mesh = { builder = "dumbbell", element_size = "65 mm", layer = "10 mm" }
        [parts.bodies]
        cells = ["head_1", "neck_1", "neck_2", "head_2"]
        E = "130 GPa"
        nu = 0.27
        rho = 7850
        [joints.layer]
        cells = "joint"
        law = "transition"
        E = "10 GPa"
        nu = 0.24
        h = "5 mm"
    """
    (tmp_path / "case.toml").write_text(text)
    model = build_structure(load_case(tmp_path), MPI.COMM_SELF)
    assert [n for n in model.parameters if n.startswith("layer")] == [
        "layer.E", "layer.nu", "layer.h",
    ]  # fmt: skip
    direct = sandwich(0.005, MPI.COMM_SELF, rho=0.0).stiffness({"h": 0.005})
    K = model.stiffness()
    assert K.norm() == pytest.approx(direct.norm(), rel=1e-12)
    (tmp_path / "case.toml").write_text(text.replace("nu = 0.24", 'G = "4 GPa"'))
    with pytest.raises(InputError, match="nu is missing, G is given: expected E, nu, h with law"):
        load_case(tmp_path)


def test_case_takes_the_average_density(tmp_path):
    """Of two unlike bodies it is the mean; of three it is not said whose, and a law cannot be."""
    text = """
        mesh = { builder = "dumbbell", element_size = "65 mm", layer = "10 mm" }
        parts.lower = { cells = ["neck_1", "head_1"], E = "130 GPa", nu = 0.27, rho = "7.85 t/m3" }
        parts.upper = { cells = ["head_2", "neck_2"], E = "70 GPa", nu = 0.33, rho = 2700 }
        [joints.layer]
        cells = "joint"
        law = "transition"
        E = "10 GPa"
        nu = 0.24
        h = "5 mm"
        rho = "average"
    """
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path)
    assert case.nominal()["layer.rho"] == pytest.approx(5275.0)
    model = build_structure(case, MPI.COMM_SELF)
    blocks = 0.24 * 0.18 * 0.09 + 0.12 * 0.063 * 0.04
    wanted = blocks * (7850 + 2700) + 5275 * 0.12 * 0.063 * 0.005
    assert model.total_mass() == pytest.approx(wanted)
    neck = 'parts.neck = { cells = "neck_2", E = "70 GPa", nu = 0.33, rho = 2000 }\n        parts.u'
    three = text.replace("parts.u", neck).replace('["head_2", "neck_2"]', '"head_2"')
    law = text.replace('"transition"', '"uncoupled"')
    for wrong, said in ((three, "expected two parts"), (law, 'or law = "transition"')):
        (tmp_path / "case.toml").write_text(wrong)
        with pytest.raises(InputError, match=said):
            load_case(tmp_path)


# --- density -------------------------------------------------------------------------------------


def test_average_density_makes_one_body_of_equal_ones():
    """A layer like the bodies, twice as thick as its mesh, is a longer neck; without mass it is
    lighter by the layer, and stiffer for its weight."""
    like = {"E": BODY["E"], "nu": BODY["nu"], "h": 0.02}
    tagged = dumbbell(MPI.COMM_SELF, layer=0.02, **COARSE)
    whole = Structure(tagged, [part("all", tuple(tagged.cell_names), **BODY)])
    average, without = sandwich(comm=MPI.COMM_SELF), sandwich(comm=MPI.COMM_SELF, rho=0.0)
    assert elastic_hz(average, like) == pytest.approx(elastic_hz(whole), rel=1e-8)
    layer = BODY["rho"] * 0.12 * 0.063 * 0.02
    assert average.total_mass(like) == pytest.approx(whole.total_mass())
    assert without.total_mass(like) == pytest.approx(whole.total_mass() - layer)
    assert np.all(elastic_hz(without, like) > elastic_hz(average, like) * (1 - 1e-9))
    assert forms.average_density(7850.0, 2700.0) == 5275.0


# --- grading -------------------------------------------------------------------------------------


def graded(x, p):
    """E of the dumbbells' layer, from the joint's at the middle to the bodies' at the faces."""
    place = forms.layer_position(x, ufl.as_vector([0.0, 0.0, 0.005]), ufl.unit_vector(2, 3), 0.01)
    return forms.transition_modulus(place, p["E"], BODY["E"], BODY["E"])


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


# --- meshes --------------------------------------------------------------------------------------

RINGS = {"rings": [(-0.03, 0.0), (0.03, 0.0)], "r_wai": 0.024, **COARSE}


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("holes", [False, True])
def test_rings_around_bolts(cell, holes):
    """Volumes of regular polygons, both bodies joined by the rings alone."""
    tagged = dumbbell(COMM, holes=holes, cell=cell, **RINGS)
    assert check_mesh(tagged).bodies == 1
    assert set(tagged.cell_names) == {*SOLID, "ring_1", "ring_2"}
    assert tagged.points["bolts"] == pytest.approx(
        np.array([[-0.03, 0, 0.657e-3 / 2], [0.03, 0, 0.657e-3 / 2]])
    )
    n = 16  # corners on each circle
    polygon = {r: n / 2 * np.sin(2 * np.pi / n) * r**2 for r in (0.00875, 0.024)}
    hole = 2 * polygon[0.00875] if holes else 0.0
    areas = {"head": (0.24 * 0.18 - hole) * 0.09, "neck": (0.12 * 0.063 - hole) * 0.04}
    wanted = {name: areas[name[:4]] for name in SOLID}
    ring = polygon[0.024] - polygon[0.00875]
    wanted |= {name: ring * 0.657e-3 for name in ("ring_1", "ring_2")}
    dx = ufl.Measure("dx", tagged.mesh, subdomain_data=tagged.cell_tags)
    ds = ufl.Measure("dS", tagged.mesh, subdomain_data=tagged.facet_tags)
    one = fem.Constant(tagged.mesh, 1.0)
    for name, volume in wanted.items():
        found = fem.assemble_scalar(fem.form(one * dx(tagged.cell_tag(name))))
        assert COMM.allreduce(found) == pytest.approx(volume, rel=1e-9)
    for name in ("joint_lower", "joint_upper"):
        found = fem.assemble_scalar(fem.form(one * ds(tagged.facet_tag(name))))
        assert COMM.allreduce(found) == pytest.approx(2 * ring, rel=1e-9)


def test_rings_are_parameters_of_their_own():
    """The adjoint tells the bolts apart, and says what each ring's h does."""
    rings = [
        transition(f"ring {i}", f"ring_{i}", E=2e9, nu=0.2, h=f"h{i}", meshed=0.657e-3)
        for i in (1, 2)
    ]
    parameters = [Parameter(f"h{i}", 0.657e-3) for i in (1, 2)]
    bodies = part("bodies", SOLID, **BODY)
    tagged = dumbbell(MPI.COMM_SELF, holes=True, **RINGS)
    model = Structure(tagged, [bodies, *rings], parameters, degree=1)
    at = {"h1": 0.7e-3, "h2": 0.4e-3}
    modes = solve_modes(model, at, n_modes=N_MODES, tolerance=1e-10)
    elastic = slice(6, N_MODES - 1)
    by_h1, by_h2 = modes.gradients(range(6, N_MODES - 1)).T
    assert np.all(np.abs(by_h1 - by_h2) > 0.05 * np.abs(by_h1))
    step = 1e-3 * at["h2"]
    lam = [
        solve_modes(model, {**at, "h2": at["h2"] + d}, n_modes=N_MODES, tolerance=1e-10).eigenvalues
        for d in (-step, step)
    ]
    assert by_h2 == pytest.approx((lam[1] - lam[0])[elastic] / (2 * step), rel=1e-3)


Q = {**TRUE, "rho": 0.0, "meshed": 0.01}


@pytest.mark.parametrize(
    ("make", "error", "said"),
    [
        (lambda: TRANSITION.check("a", Q | {"h": 0.0}), InputError, "a.h = 0 is out of range"),
        (lambda: TRANSITION.check("a", Q | {"nu": 0.5}), InputError, "a.nu = 0.5"),
        (lambda: transition("a", "b", E=1.0, nu=0.2, h=1.0, meshed="h"), InputError, "a.meshed"),
        (lambda: forms.transition_mass(1, 1, 1, thickness=1.0), InputError, "expected both"),
        (lambda: forms.transition_mass(1, 1, 1, thickness=-1.0, meshed=1.0), InputError, "-1.0 m"),
        (lambda: forms.transition_modulus(0.5, 1, 2, 2, through=0), InputError, "through = 0"),
        (lambda: forms.ring_pressure(0.01, 10.0, 0.005, 0.02), InputError, "force = 10 N"),
        (lambda: dumbbell(COMM, layer=0.0), MeshError, "layer is 0.0"),
        (lambda: dumbbell(COMM, neck=(0.3, 0.06, 0.04)), MeshError, "neck is"),
        (lambda: dumbbell(COMM, rings=[(0, 0)]), MeshError, "r_wai is None"),
        (lambda: dumbbell(COMM, rings=[(0.05, 0)], r_wai=0.02), MeshError, "within the neck"),
        (lambda: dumbbell(COMM, rings=[(-0.01, 0), (0.02, 0)], r_wai=0.02), MeshError, "distance"),
    ],
)
def test_mistakes_are_named(make, error, said):
    with pytest.raises(error, match=said):
        make()
