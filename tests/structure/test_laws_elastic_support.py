"""Faces on springs, against closed forms and rigid supports."""

from __future__ import annotations

import numpy as np
import pytest
from eigen_slopes import assert_second_order
from mpi4py import MPI
from scipy.optimize import brentq

from fenics_joints.case import Case, build_structure
from fenics_joints.case.parameters import RIGID_SUPPORT
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import ElasticSupport, Parameter, Structure, Support, part

LENGTH, RHO = 0.5, 7800.0
NAMES = ("wall.k_n", "wall.k_t")


def rod(supports, comm=MPI.COMM_SELF, nu=0.0, k=1e12, n=12):
    body = part("rod", "body", E=2e11, nu=nu, rho=RHO)
    wall = ElasticSupport("wall", "x_min", *NAMES)
    tagged = box(comm, (LENGTH, 0.02, 0.01), (n, 1, 1))
    parameters = [Parameter(name, k) for name in NAMES]
    return Structure(tagged, [body], parameters, supports=[wall, *supports])


@pytest.mark.parallel
@pytest.mark.parametrize(("axis", "modulus", "key"), [(0, 2e11, "k_n"), (1, 1e11, "k_t")])
def test_rod_on_a_spring_at_its_end(axis, modulus, key):
    """All moves along one axis: b tan b = k L / modulus, of axial or of shear waves, nu = 0."""
    others = tuple(i for i in range(3) if i != axis)
    held = [Support(face, others) for face in ("y_min", "y_max", "z_min", "z_max")]
    model = rod(held, MPI.COMM_WORLD)
    speed = np.sqrt(modulus / RHO)
    for k in (1e10, 4e11, 1e14):
        roots = [
            brentq(lambda b, k=k: b * np.sin(b) - k * LENGTH / modulus * np.cos(b), low, high)
            for low, high in ((1e-6, np.pi / 2), (np.pi, 3 * np.pi / 2))
        ]
        expected = np.array(roots) * speed / LENGTH / (2 * np.pi)
        other = {name: 0.0 for name in NAMES}
        modes = solve_modes(model, other | {f"wall.{key}": k}, n_modes=2)
        assert modes.frequencies_hz == pytest.approx(expected, rel=2e-5)


def clamped(**more):
    data = {
        "mesh": {"builder": "lap_beam", "bonded": True, "n_length": 8, "n_lap": 2, "n_width": 1},
        "parts": {"beams": {"cells": ["beam_1", "beam_2"], "E": 2e11, "nu": 0.3, "rho": RHO}},
        "supports": {"clamp": {"facets": "clamp"}},
    }
    return build_structure(Case.model_validate(data), MPI.COMM_WORLD, **more)


@pytest.mark.parallel
def test_nominal_support_is_as_good_as_rigid():
    """And softer ones approach it in proportion to their compliance."""
    exact = solve_modes(clamped(), n_modes=6)
    model = clamped(elastic_supports=True)
    assert list(model.parameters)[-2:] == ["clamp.k_n", "clamp.k_t"]

    def short(k):
        modes = solve_modes(model, {"clamp.k_n": k, "clamp.k_t": k}, n_modes=6)
        assert modes.n_rigid == 0
        return 1 - modes.frequencies_hz / exact.frequencies_hz

    assert model.parameters["clamp.k_n"].value == RIGID_SUPPORT
    assert np.abs(short(RIGID_SUPPORT)).max() < 1e-5
    assert short(1e17) / short(1e18) == pytest.approx(np.full(6, 10.0), rel=0.1)
    free = solve_modes(model, {"clamp.k_n": 0.0, "clamp.k_t": 0.0}, n_modes=7)
    assert free.n_rigid == 6


@pytest.mark.parallel
def test_reduced_model_and_derivatives():
    """A sample is reproduced; halving a step quarters what the derivatives leave."""
    full = rod([], MPI.COMM_WORLD, nu=0.3, k=RIGID_SUPPORT, n=6)
    point = {"wall.k_n": 3e12, "wall.k_t": 2e11}
    small = reduce(full, [{}, point, {"wall.k_n": 1e15}], 10, tolerance=1e-10)
    for given in ({}, point):
        exact = solve_modes(full, given, n_modes=9).frequencies_hz
        assert solve_modes(small, given, n_modes=9).frequencies_hz == pytest.approx(exact, rel=1e-6)
    for model in (full, small):
        steps = {name: 0.04 * value for name, value in point.items()}
        bounds = {"least": 1, "floor": 1e-8, "order": 1.85}
        assert_second_order(model, steps, np.arange(8), point, **bounds, n_modes=9)


def test_mistakes_are_named():
    with pytest.raises(MeshError, match="'door'"):
        rod([ElasticSupport("gate", "door", 1.0, 1.0)]).stiffness()
    with pytest.raises(InputError, match=r"wall.k_t = -1 is out of range: expected k_t >= 0"):
        rod([]).stiffness({"wall.k_t": -1.0})
    with pytest.raises(InputError, match=r"gate.k_n names the parameter 'a'"):
        rod([ElasticSupport("gate", "x_max", "a", 1.0)])
