"""The transition layer of Machines 2022 in a structure: thickness as a number, density, grading."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from eigen_slopes import assert_same, assert_second_order, assert_terms_reproduce, difference
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError
from fenics_joints.meshes import dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, Structure, part, transition
from fenics_joints.structure.laws import TRANSITION

COMM = MPI.COMM_WORLD
BODY = {"E": 1.3e11, "nu": 0.27, "rho": 7850.0}  # Machines 2022, section 4.2
TRUE = {"E": 1e10, "nu": 0.24, "h": 0.01}  # Table 6, row 1
N_MODES, ELASTIC = 12, slice(6, None)
SOLID = ("head_1", "neck_1", "neck_2", "head_2")
COARSE = {"element_size": 0.065}


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
        assert_same(model.stiffness({"h": h}), remeshed.stiffness({"h": h}), 1e-12)
        assert_same(model.mass({"h": h}), remeshed.mass({"h": h}), 1e-12)
        assert model.total_mass({"h": h}) == pytest.approx(remeshed.total_mass({"h": h}))


def test_frequencies_and_their_slope_by_the_thickness():
    """At 20 mm to 1e-8; the slope beside central differences over meshes to 1e-5."""
    model, h = sandwich(0.01, MPI.COMM_SELF), 0.02
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
        "full": sandwich,
        "reduced": lambda: sandwich(rho=0.0),
        "graded": lambda: sandwich(n_layer=3, E=graded),
    }[kind]()
    if kind == "reduced":
        model = reduce(model, [{}, {"h": 0.02, "nu": 0.35}, {"E": 3e10}], N_MODES)
    at = {"h": 0.013, "E": 8e9, "nu": 0.26}
    steps = {"h": 1e-3, "E": 1e9, "nu": 0.04, "rho": 500.0}
    bounds = {"least": 2, "floor": 1e-8, "order": 1.8}
    options = {"n_modes": N_MODES, "tolerance": 1e-10}
    assert_second_order(model, steps, np.arange(6, N_MODES - 1), at, **bounds, **options)


def test_terms_reproduce_the_assembled_matrices():
    model = sandwich(comm=MPI.COMM_SELF, rho=2000.0)
    assert_terms_reproduce(model, model, [{"h": 0.017, "E": 3e9, "nu": 0.1}], 4)


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
        f"layer.{key}" for key in ("E", "nu", "h")
    ]
    direct = sandwich(0.005, MPI.COMM_SELF, rho=0.0).stiffness({"h": 0.005})
    K = model.stiffness()
    assert K.norm() == pytest.approx(direct.norm(), rel=1e-12)
    (tmp_path / "case.toml").write_text(text.replace("nu = 0.24", 'G = "4 GPa"'))
    with pytest.raises(InputError, match="nu is missing, G is given: expected E, nu, h with law"):
        load_case(tmp_path)


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


def graded(x, p):
    """E of the dumbbells' layer, from the joint's at the middle to the bodies' at the faces."""
    place = forms.layer_position(x, ufl.as_vector([0.0, 0.0, 0.005]), ufl.unit_vector(2, 3), 0.01)
    return forms.transition_modulus(place, p["E"], BODY["E"], BODY["E"])


def test_rings_are_parameters_of_their_own():
    """The adjoint tells the bolts apart, and says what each ring's h does."""
    rings = [
        transition(f"ring {i}", f"ring_{i}", E=2e9, nu=0.2, h=f"h{i}", meshed=0.657e-3)
        for i in (1, 2)
    ]
    parameters = [Parameter(f"h{i}", 0.657e-3) for i in (1, 2)]
    bolts = {"rings": [(-0.03, 0.0), (0.03, 0.0)], "r_wai": 0.024, "holes": True}
    tagged = dumbbell(MPI.COMM_SELF, **bolts, **COARSE)
    model = Structure(tagged, [part("bodies", SOLID, **BODY), *rings], parameters, degree=1)
    at = {"h1": 0.7e-3, "h2": 0.4e-3}
    modes = solve_modes(model, at, n_modes=N_MODES, tolerance=1e-10)
    elastic = slice(6, N_MODES - 1)
    by_h1, by_h2 = modes.gradients(range(6, N_MODES - 1)).T
    assert np.all(np.abs(by_h1 - by_h2) > 0.05 * np.abs(by_h1))
    exact = difference(model, at, "h2", elastic, 1e-3, n_modes=N_MODES, tolerance=1e-10)
    assert by_h2 == pytest.approx(exact, rel=1e-3)


def test_mistakes_are_named():
    for wrong, said in (({"h": 0.0}, "a.h = 0 is out of range"), ({"nu": 0.5}, "a.nu = 0.5")):
        with pytest.raises(InputError, match=said):
            TRANSITION.check("a", {**TRUE, "rho": 0.0, "meshed": 0.01} | wrong)
    with pytest.raises(InputError, match="a.meshed"):
        transition("a", "b", E=1.0, nu=0.2, h=1.0, meshed="h")
