"""Structures as assembled matrices, against closed forms and meshes of another make."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from dolfinx import fem
from mpi4py import MPI
from numpy.polynomial import legendre

from fenics_joints.errors import InputError, MeshError
from fenics_joints.forms import lame_parameters
from fenics_joints.meshes import box, lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, PointMass, Spring, Structure, Support, joint, part

E, NU, RHO = 69e9, 0.283, 2750.0
PLATES = ("plate_1", "plate_2")
LAYERS = ("joint_near", "joint_away")


def solid(**changes):
    return part("plates", PLATES, **({"E": E, "nu": NU, "rho": RHO} | changes))


def beam(length, thickness, n, *, nu=0.0, stretch=1.0, supports=(), comm=MPI.COMM_SELF):
    """A slim box of steel, width 50 mm, n elements along it and one across."""
    tagged = box(comm, (length, 0.05, thickness), (n, 1, 1))
    body = part("beam", "body", E=2e11, nu=nu, rho=7800.0, stretch=stretch)
    return Structure(tagged, [body], supports=supports)


def timoshenko_hz(length, thickness, n_terms=14):
    """First frequency of a cantilever by Ritz with polynomials: shear factor 5/6, nu = 0."""
    x, weight = legendre.leggauss(2 * n_terms)
    x, weight = length * (x + 1) / 2, weight * length / 2
    powers = np.arange(1, n_terms + 1)
    value = (x[:, None] / length) ** powers
    slope = powers / length * (x[:, None] / length) ** (powers - 1)
    zero = np.zeros_like(value)
    w, dw = np.hstack([value, zero]), np.hstack([slope, zero])
    turn, bend = np.hstack([zero, value]), np.hstack([zero, slope])
    area, inertia = thickness, thickness**3 / 12

    def gram(a):
        return a.T @ (weight[:, None] * a)

    K = 2e11 * inertia * gram(bend) + 5 / 6 * 1e11 * area * gram(dw - turn)
    M = 7800.0 * (area * gram(w) + inertia * gram(turn))
    # Powers are nearly dependent: their own basis keeps the pencil definite.
    scale, basis = scipy.linalg.eigh(M / np.sqrt(np.outer(M.diagonal(), M.diagonal())))
    scale, basis = scale[scale > 1e-12], basis[:, scale > 1e-12]
    basis = basis / np.sqrt(scale) / np.sqrt(M.diagonal())[:, None]
    return np.sqrt(scipy.linalg.eigvalsh(basis.T @ K @ basis)[0]) / (2 * np.pi)


def cantilever_hz(length, thickness, n):
    model = beam(length, thickness, n, supports=[Support("x_min")])
    modes = solve_modes(model, n_modes=2)
    assert modes.n_rigid == 0
    return modes.frequencies_hz[0]


def test_cantilever_converges_to_timoshenko():
    """Second order while cells are longer than the beam is high.

    Without shear a quadratic deflection leaves the curvature constant along a cell.
    """
    length, thickness = 0.2, 0.004
    exact = timoshenko_hz(length, thickness)
    error = np.array([cantilever_hz(length, thickness, n) / exact - 1 for n in (4, 8, 16, 32)])
    rate = np.log2(error[:-1] / error[1:])
    assert np.all(rate > 1.9) and rate[0] < 2.5
    assert 0 < error[-1] < 2e-4


def test_short_cantilevers_leave_euler_bernoulli_with_the_square_of_their_height():
    """The deviation is Timoshenko's, and of second order in height over length."""
    length, ratio = 0.2, []
    for thickness in (0.005, 0.01, 0.02):
        bernoulli = 1.8751041**2 * np.sqrt(2e11 * thickness**2 / 12 / 7800) / length**2 / 2 / np.pi
        f = cantilever_hz(length, thickness, 24)
        assert f == pytest.approx(timoshenko_hz(length, thickness), rel=1e-3)
        ratio.append(1 - f / bernoulli)
    assert np.log2(ratio[2] / ratio[1]) == pytest.approx(2.0, abs=0.15)


def test_stretch_is_a_really_thicker_part():
    thick = solve_modes(beam(0.1, 0.010, 4, nu=0.3), n_modes=12)
    stretched = solve_modes(beam(0.1, 0.008, 4, nu=0.3, stretch=1.25), n_modes=12)
    assert thick.n_rigid == stretched.n_rigid == 6
    elastic = slice(6, None)
    assert stretched.frequencies_hz[elastic] == pytest.approx(thick.frequencies_hz[elastic], 1e-9)


def test_rigid_motions_cost_no_energy():
    """K r = 0 for all six, and r^T M r is the mass for a translation."""
    layer = joint("layer", LAYERS, E=1e9, G=4e8)
    model = Structure(lap_plates(MPI.COMM_SELF, element_size=0.02, n_thickness=1), [solid(), layer])
    K, M = model.stiffness(), model.mass()
    stiff = K.norm()
    for i in range(6):

        def motion(x, i=i):
            axis = np.eye(3)[i % 3][:, None]
            return axis + 0 * x if i < 3 else np.cross(axis, x, axis=0)

        u = fem.Function(model.V)
        u.interpolate(motion)
        r = u.x.petsc_vec
        assert (K * r).norm() < 1e-12 * stiff * r.norm()
        if i < 3:
            assert r.dot(M * r) == pytest.approx(model.total_mass())
    assert solve_modes(model, n_modes=8).n_rigid == 6


def test_welded_limit_is_one_body():
    """A layer as stiff as the plates and of no thickness, beside plates that share their nodes."""
    lmbda, mu = lame_parameters(E, NU)
    size = {"element_size": 0.02, "n_thickness": 1}
    layer = joint("layer", LAYERS, E=lmbda + 2 * mu, G=mu, stretch="s")
    welded = Structure(lap_plates(MPI.COMM_SELF, **size), [solid(), layer], [Parameter("s", 1e-4)])
    whole = Structure(lap_plates(MPI.COMM_SELF, layer=0.0, **size), [solid()])
    expected = solve_modes(whole, n_modes=14).frequencies_hz[6:]

    def deviation(s):
        found = solve_modes(welded, {"s": s}, n_modes=14).frequencies_hz[6:]
        return np.max(np.abs(found / expected - 1))

    assert deviation(1e-4) < 1e-5
    # In proportion to the thickness: it is the layer's own, nothing else is left over.
    assert deviation(1e-2) / deviation(1e-3) == pytest.approx(10.0, rel=0.1)


@pytest.mark.parallel
@pytest.mark.parametrize(("direction", "key"), [(2, "E"), (0, "G"), (1, "G")])
def test_layer_is_a_spring_of_modulus_times_area_over_thickness(direction, key):
    """The upper plate moves as one: k = E A / h across the layer and G A / h along it."""
    h, size = 5e-4, {"element_size": 0.02, "n_thickness": 1}
    areas = {"near": 4 * 0.02**2, "away": 0.08**2 - 4 * 0.02**2}
    names = [f"{zone}.{k}" for zone in areas for k in "EG"]
    layers = [
        joint(zone, f"joint_{zone}", E=f"{zone}.E", G=f"{zone}.G", stretch="s") for zone in areas
    ]
    parameters = [*(Parameter(name, 1e9) for name in names), Parameter("s", 1.0)]
    model = Structure(lap_plates(MPI.COMM_WORLD, layer=h, **size), [solid(), *layers], parameters)

    def lift(x):
        axis = np.eye(3)[direction][:, None]
        return axis * np.clip((x[2] - 0.008) / h, 0.0, 1.0)

    u = fem.Function(model.V)
    u.interpolate(lift)
    values = {"near.E": 3e9, "near.G": 1e9, "away.E": 5e6, "away.G": 2e6}
    for s in (1.0, 0.4):
        K = model.stiffness({**values, "s": s})
        expected = sum(values[f"{zone}.{key}"] * areas[zone] / (h * s) for zone in areas)
        x = u.x.petsc_vec
        assert x.dot(K * x) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parallel
def test_body_on_a_spring_with_a_mass_inside():
    """sqrt(k / m): spring and mass at the middle of a block, which is no node of the mesh."""
    side, middle = 0.1, (0.05, 0.05, 0.05)
    slant = (0.6, 0.8, 0.0)
    model = Structure(
        box(MPI.COMM_WORLD, (side, side, side), (3, 3, 3)),
        [part("block", "body", E=2e11, nu=0.3, rho=7800.0)],
        [Parameter("k", 3e4), Parameter("m", 5.0)],
        masses=[PointMass("lead", "m", middle)],
        springs=[Spring("cord", "k", middle, slant), Spring("cord 2", "k", middle, slant)],
    )
    block = 7800.0 * side**3
    for k, m in ((3e4, 5.0), (1e5, 0.0)):
        given = {"k": k, "m": m}
        assert model.total_mass(given) == pytest.approx(block + m)
        modes = solve_modes(model, given, n_modes=7)
        assert modes.n_rigid == 5
        expected = np.sqrt(2 * k / (block + m)) / (2 * np.pi)
        assert modes.frequencies_hz[5] == pytest.approx(expected, rel=1e-4)


def test_total_mass_counts_parts_layers_and_shares():
    layer = joint("layer", LAYERS, E=1e9, G=4e8, rho=1200.0, stretch=0.5)
    points = [PointMass(f"bolt {i}", "m", (0.14, 0.02, 0.0), share=0.25) for i in range(4)]
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.02, n_thickness=1)
    model = Structure(tagged, [solid(), layer], [Parameter("m", 0.16)], masses=points)
    plates = 2 * 0.2 * 0.08 * 0.008
    expected = RHO * plates + 1200.0 * 0.5 * 0.08 * 0.08 * 5e-4 + 0.16
    assert model.total_mass() == pytest.approx(expected)
    assert model.volumes() == pytest.approx([plates, 0.08**2 * 5e-4])
    assert model.extent(1) == pytest.approx(5e-4)


def test_held_dofs_are_out_of_both_matrices():
    held = [Support("x_min", (0,)), Support("x_max")]
    model = beam(0.1, 0.01, 3, supports=held)
    K, M = model.stiffness(), model.mass()
    for bc in model.bcs:
        for i in bc.dof_indices()[0]:
            columns, values = K.getRow(int(i))
            assert values[columns == i] == 1.0 and not values[columns != i].any()
            assert not M.getRow(int(i))[1].any()
    assert sum(len(bc.dof_indices()[0]) for bc in model.bcs) > 0


def isotropic(**changes):
    values = {"E": 1e9, "G": 4e8, "law": "isotropic"} | changes
    return joint("layer", LAYERS, **values)


def test_mistakes_are_named():
    coarse = lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1)

    def lap(regions, parameters=(), **more):
        return Structure(coarse, regions, parameters, degree=1, **more)

    both, a = [solid(), isotropic()], Parameter("a", 1.0)
    for make, error, said in (
        (lambda: lap([solid(E="a"), isotropic()]), InputError, "plates.E names the parameter 'a'"),
        (lambda: lap([solid()]), MeshError, "than one: joint_near, joint_away; expected"),
        (lambda: lap([solid(), *both]), InputError, "plates is given twice"),
        (lambda: lap([solid(), isotropic(E=1.2e9)]).stiffness(), InputError, r"layer.E.*E < 3 G"),
        (lambda: lap([solid(nu=0.5), isotropic()]).mass(), InputError, r"plates.nu = 0.5"),
        (lambda: lap(both, [a]).values({"a": np.nan}), InputError, "a = nan: expected a finite"),
        (lambda: lap(both, [a, a]), InputError, "parameter a is given twice"),
        (lambda: lap(both, supports=[Support("wall")]), MeshError, "'wall'"),
        (lambda: isotropic(law="viscous"), InputError, "layer.law = 'viscous'"),
        (lambda: isotropic(normal=(0, 0, 0)), InputError, "layer.normal"),
        (lambda: Parameter("a", 2.0, upper=1.0), InputError, "a = 2.*bounds"),
        (lambda: Parameter("a", 0.0), InputError, "a = 0: expected a positive value"),
    ):
        with pytest.raises(error, match=said):
            make()
