"""Linear joint laws of a user's own against the suite's, which say the same in another way."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, Structure, interface, joint, joint_law, part


@joint_law(k_n="Pa/m", ratio="")
def by_ratio(jump, normal, q):
    """Springs whose tangential stiffness is not linear in the properties."""
    opening = ufl.dot(jump, normal)
    k_t = q["k_n"] * ufl.sqrt(q["ratio"] ** 2) / (1 + q["ratio"])
    return q["k_n"] * opening * normal + k_t * (jump - opening * normal)


@joint_law("strain", E="Pa", nu="")
def isotropic(eps, normal, q):
    lmbda = q["E"] * q["nu"] / (1 + q["nu"]) / (1 - 2 * q["nu"])
    return q["E"] / (1 + q["nu"]) * eps + lmbda * ufl.tr(eps) * ufl.Identity(len(normal))


def plates(lap, *parameters: Parameter) -> Structure:
    """Lapped plates with a joint, ``cells -> Region``."""
    tagged = lap_plates(MPI.COMM_WORLD, element_size=0.02)
    metal = part("plates", ("plate_1", "plate_2"), E=69e9, nu=0.33, rho=2750)
    return Structure(tagged, [metal, lap(("joint_near", "joint_away"))], parameters)


K, R = Parameter("k", 1e12, "Pa/m"), Parameter("r", 2.0)


@pytest.mark.parallel
def test_jump_and_strain_are_those_of_the_suite():
    own = plates(lambda c: interface("lap", c, law=by_ratio, meshed=5e-4, k_n="k", ratio="r"), K, R)
    springs = plates(lambda c: interface("lap", c, meshed=5e-4, k_n=1e12, k_t=2e12 / 3))
    one, other = (solve_modes(m, n_modes=10).frequencies_hz[6:] for m in (own, springs))
    assert one == pytest.approx(other, rel=1e-9)
    own = plates(lambda c: interface("lap", c, law=isotropic, E=5e8, nu=0.25))
    layer = plates(lambda c: joint("lap", c, E=5e8, G=2e8, law="isotropic"))
    one, other = (solve_modes(m, n_modes=10).frequencies_hz[6:] for m in (own, layer))
    assert one == pytest.approx(other, rel=1e-9)


@pytest.mark.parallel
def test_derivatives_and_reduced_models_follow_a_law_that_is_not_linear_in_its_properties():
    own = plates(lambda c: interface("lap", c, law=by_ratio, meshed=5e-4, k_n="k", ratio="r"), K, R)
    modes = solve_modes(own, n_modes=8)
    springs = plates(
        lambda c: interface("lap", c, meshed=5e-4, k_n="k_n", k_t="k_t"),
        Parameter("k_n", 1e12),
        Parameter("k_t", 2e12 / 3),
    )
    by_n, by_t = solve_modes(springs, n_modes=8).gradients([6, 7]).T
    # k_t = k r / (1 + r) with k = 1e12, r = 2.
    chain = np.column_stack([by_n + by_t * 2 / 3, by_t * 1e12 / 9])
    assert modes.gradients([6, 7]) == pytest.approx(chain, rel=1e-6)
    soft = {"k": 1e11, "r": 0.5}
    small = reduce(own, [{}, soft, {"r": 0.5}, {"k": 1e11}], n_modes=10)
    assert solve_modes(small, soft, n_modes=8).frequencies_hz[6:] == pytest.approx(
        solve_modes(own, soft, n_modes=8).frequencies_hz[6:], rel=1e-8
    )


@joint_law(k_t="Pa/m")
def fixed_opening(jump, normal, q):
    opening = ufl.dot(jump, normal)
    return 1e12 * opening * normal + q["k_t"] * (jump - opening * normal)


@joint_law(k="Pa/m")
def saturating(jump, normal, q):
    return q["k"] / (1 + q["k"] / 5e11) * jump


def test_constants_in_si_units_are_in_the_sum():
    """Numbers of the size that metal has, which values about one would not show."""
    q = {"k_t": 4e11, "meshed": 1.0}
    weights, samples = fixed_opening.stiffness_terms(q), fixed_opening.samples
    assert sum(weights) == pytest.approx(1.0)  # of the constant 1e12
    assert weights @ [s["k_t"] for s in samples] == pytest.approx(4e11, rel=1e-9)
    at = saturating.stiffness_terms({"k": np.array([1e6, 1e12]), "meshed": 1.0})
    own = [s["k"] / (1 + s["k"] / 5e11) for s in saturating.samples]
    assert own @ at == pytest.approx([1e6 / (1 + 2e-6), 1e12 / 3], rel=1e-9)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda j, n, q: q["k"] * ufl.dot(j, j) * n, "linear in the motion"),
        (lambda j, n, q: q["k"] * j[0] * ufl.as_vector([0, 1, 0]), "expected a symmetric law"),
        (lambda j, n, q: q["stiffness"] * j, "KeyError: 'stiffness'"),
        (lambda j, n, q: 0 * q["k"] * j, "other than zero"),
        (lambda j, n, q: q["k"] * ufl.max_value(ufl.dot(j, n), 0) * n, "linear in the motion"),
        (lambda j, n, q: ufl.min_value(q["k"], 5e11) * j, "MinValue of the properties"),
    ],
)
def test_what_is_no_linear_law_is_refused(law, words):
    with pytest.raises(InputError, match=words):
        joint_law(k="Pa/m")(law)
    with pytest.raises(InputError, match="joint_law"):
        joint_law(k=3.0)


def test_properties_that_feed_energy_in_are_refused():
    with pytest.raises(InputError, match=r"lap: k_n = -1e\+12, ratio = 2: expected values for"):
        interface("lap", "joint", law=by_ratio, meshed=1e-3, k_n=-1e12, ratio=2.0)
    with pytest.raises(InputError, match="lap.k_t: unknown property, expected k_n, ratio"):
        interface("lap", "joint", law=by_ratio, meshed=1e-3, k_n=1e12, k_t=2.0)
