"""Derivatives of eigenvalues by Taylor tests, and what they say of identifiability."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from eigen_slopes import assert_second_order
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import frequency_sensitivity, identifiability, solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, PointMass, Spring, Structure, joint, part

N_MODES = 12
#: Each kind of parameter, with its value and a step in which its curvature shows.
STEPS = {
    "plates.E": (69e9, 0.2 * 69e9),
    "plates.nu": (0.283, 0.05),
    "plates.rho": (2750.0, 500.0),
    "plates.thickness": (1.0, 0.1),
    "near.E": (8e8, 4e8),
    "near.G": (4e8, 2e8),
    "near.thickness": (1.0, 0.3),
    "away.E": (2e7, 1e7),
    "away.G": (1e7, 5e6),
    "tip.mass": (0.05, 0.02),
    "tip.travel": (0.013, 0.004),
    "cord.stiffness": (2e5, 1e5),
}


def build(law="uncoupled", comm=MPI.COMM_SELF):
    tagged = lap_plates(comm, element_size=0.02, n_thickness=1)
    own = {key: f"plates.{key}" for key in ("E", "nu", "rho")} | {"stretch": "plates.thickness"}
    plates = part("plates", ("plate_1", "plate_2"), **own)
    layers = [
        joint("near", "joint_near", law=law, E="near.E", G="near.G", stretch="near.thickness"),
        joint("away", "joint_away", law=law, E="away.E", G="away.G"),
    ]
    return Structure(
        tagged,
        [plates, *layers],
        [Parameter(name, value) for name, (value, _) in STEPS.items()],
        masses=[PointMass("tip", "tip.mass", (0.01, 0.03, 0.0), travel="tip.travel")],
        springs=[Spring("cord", "cord.stiffness", (0.01, 0.08, 0.004), (0.0, 0.6, 0.8))],
        degree=2,
    )


@pytest.fixture(scope="module")
def full():
    return build()


@pytest.fixture(scope="module")
def reduced(full):
    soft = {"near.E": 2e8, "near.G": 1e8, "away.E": 5e6, "away.G": 3e6}
    return reduce(full, [{}, soft], N_MODES, travel={"tip": (0.0, 0.04)})


def check_taylor(model, steps, **options):
    modes = solve_modes(model, n_modes=N_MODES)
    elastic = np.arange(modes.n_rigid, N_MODES - 1)
    options |= {"n_modes": N_MODES, "solver": modes.solver}
    assert_second_order(model, steps, elastic, modes=modes, **options)


def test_full_gradient(full):
    # Round-off moves the lowest eigenvalue by up to 1e-9 of it, as it does the rigid-body zeros.
    check_taylor(full, {name: step / 8 for name, (_, step) in STEPS.items()}, floor=3e-8)


def test_reduced_gradient(reduced):
    check_taylor(reduced, {name: step / 8 for name, (_, step) in STEPS.items()})


@pytest.mark.parametrize("law", ["isotropic", "constrained"])
def test_gradient_through_coupled_laws(law):
    """E and G of a layer that couples them, on the full model and on a reduced one."""
    model = build(law)
    small = reduce(model, [{}], N_MODES, travel={"tip": (0.0, 0.04)})
    for which in (model, small):
        check_taylor(which, {name: STEPS[name][1] / 192 for name in ("near.E", "near.G")})


def test_gradient_through_a_graded_joint():
    """Force, cone and law of the pressure are parameters of a modulus that varies in space."""
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1)
    centres, thickness = tagged.points["bolts"], 5e-4

    def modulus(share):
        def property_of(x, p):
            total = 0
            for centre in centres:
                r = forms.radius(x, ufl.as_vector(centre.tolist()), ufl.as_vector([0, 0, 1]))
                total = total + forms.pressure_cone(r, p["force"], 0.005, p["reach"])
            return share * forms.graded_modulus(total, p["alpha"], p["beta"], thickness, floor=1e6)

        return property_of

    layer = joint("layer", ("joint_near", "joint_away"), E=modulus(1.0), G=modulus(0.4))
    plates = part("plates", ("plate_1", "plate_2"), E=69e9, nu=0.283, rho=2750.0)
    values = {"force": 8e3, "reach": 0.04, "alpha": 1e8, "beta": 0.5}
    parameters = [Parameter(name, value) for name, value in values.items()]
    model = Structure(tagged, [plates, layer], parameters)
    check_taylor(model, {"force": 500.0, "alpha": 6.25e6, "beta": 0.0125, "reach": 2.5e-4})


@pytest.mark.parallel
def test_gradients_on_two_ranks_are_those_of_one():
    given = {"near.G": 3e8, "tip.travel": 0.017}
    both = [
        solve_modes(build(comm=c), given, n_modes=N_MODES) for c in (MPI.COMM_SELF, MPI.COMM_WORLD)
    ]
    alone, together = (frequency_sensitivity(m, range(5, N_MODES - 1)) for m in both)
    scale = np.array([value for value, _ in STEPS.values()])
    assert together * scale == pytest.approx(alone * scale, abs=1e-7)


def test_frequency_sensitivities_follow_scaling_laws(full):
    """Free body: all stiffness by a makes sqrt(a), all mass by a makes 1 / sqrt(a)."""
    bare = {"tip.mass": 1e-12, "cord.stiffness": 1e-9}
    modes = solve_modes(full, bare, n_modes=N_MODES)
    slope = frequency_sensitivity(modes, range(6, N_MODES - 1))
    names = list(full.parameters)
    values = full.values(bare)

    def total(*kinds):
        return sum(slope[:, names.index(n)] * values[n] for n in names if n.endswith(kinds))

    assert total(".E", ".G") == pytest.approx(0.5, abs=1e-6)
    assert total("plates.rho") == pytest.approx(-0.5, abs=1e-6)


def test_collinearity_index_by_hand():
    """Two unit columns at an angle: 1 / sqrt(1 - cos); scaling a column changes nothing."""
    for angle in (0.02, 0.5, np.pi / 2):
        columns = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)], [0.0, 0.0]])
        found = identifiability(columns * [1.0, 30.0], ["a", "b"])
        assert found.collinearity == pytest.approx(1 / np.sqrt(1 - np.cos(angle)), rel=1e-6)
        plain = identifiability(columns, ["a", "b"])
        assert plain.condition == pytest.approx(
            np.sqrt((1 + np.cos(angle)) / (1 - np.cos(angle))), rel=1e-6
        )
    least = identifiability(np.array([[1.0, 1.0], [0.0, 0.1]]), ["a", "b"])
    covariance = np.linalg.inv(np.array([[1.0, 1.0], [1.0, 1.01]]))
    assert least.sd == pytest.approx(np.sqrt(covariance.diagonal()))


def test_undetermined_parameters_are_named():
    """c is in no datum; a and b only as a sum; d is well known."""
    J = 50.0 * np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [2.0, 2.0, 0.0, 1.0]])
    found = identifiability(J, tuple("abcd"))
    assert found.undetermined == ("a", "b", "c")
    assert np.isinf(found.condition) and np.isinf(found.collinearity)
    assert np.all(np.isinf(found.sd[:3])) and found.sd[3] < 0.1
    fewer = identifiability(J[:1, [0, 3]], ("a", "d"))
    assert fewer.undetermined == ("d",)
    good = identifiability(J[:, [0, 3]], ("a", "d"))
    assert good.undetermined == () and good.condition < 10
