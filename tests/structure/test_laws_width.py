"""A part's width as a parameter, against meshes of that width."""

from __future__ import annotations

import numpy as np
import pytest
from eigen_slopes import assert_second_order, assert_terms_reproduce
from mpi4py import MPI

from fenics_joints.case import Case, build_structure
from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import reduce
from fenics_joints.structure import Parameter, Structure, part

N_MODES = 14
ELASTIC = slice(6, None)


def bar(width=0.05, across=(0, 1, 0), comm=MPI.COMM_SELF):
    parameters = [Parameter("w", 1.0), Parameter("s", 1.0)]
    normal = (0.0, 0.6, 0.8) if across == (1, 0, 0) else (0.0, 0.0, 1.0)
    changed = {"stretch": "s", "width": "w", "across": across, "normal": normal}
    body = part("bar", "body", E=2e11, nu=0.3, rho=7800.0, **changed)
    return Structure(box(comm, (0.2, width, 0.01), (4, 2, 1)), [body], parameters)


def test_width_is_a_wider_mesh():
    """Also where the case asks for it by its name, and beside a changed thickness."""
    wide = solve_modes(bar(width=0.055), {"s": 1.3}, n_modes=N_MODES)
    stretched = solve_modes(bar(), {"w": 1.1, "s": 1.3}, n_modes=N_MODES)
    assert stretched.n_rigid == wide.n_rigid == 6
    assert stretched.frequencies_hz[ELASTIC] == pytest.approx(wide.frequencies_hz[ELASTIC], 1e-8)
    assert bar().total_mass({"w": 1.1}) == pytest.approx(1.1 * bar().total_mass())
    mesh = {"builder": "lap_plates", "layer": 0.0, "zone": 0.0, "bolts": [], "n_thickness": 1}
    mesh |= {"n_length": 10, "n_width": 4}
    plates = {"cells": ["plate_1", "plate_2"], "E": 7e10, "nu": 0.3, "rho": 2700.0}

    def hz(made, given, **more):
        data = {"mesh": mesh | {"width": made}, "parts": {"plates": plates}}
        model = build_structure(Case.model_validate(data), MPI.COMM_SELF, **more)
        return solve_modes(model, given, n_modes=N_MODES).frequencies_hz[ELASTIC]

    found = hz(0.08, {"plates.width": 1.1}, width=True)
    assert found == pytest.approx(hz(0.088, {}), rel=1e-8)


@pytest.mark.parametrize("across", [(0, 1, 0), (1, 0, 0)])
def test_terms_reproduce_the_assembled_matrices(across):
    """On vectors that were never modes; the second has a slanting normal."""
    cases = [{"w": w, "s": s} for w, s in ((1.1, 1.0), (0.7, 1.9), (3.0, 0.4))]
    fresh = bar(across=across)  # which has no samples to sum up
    assert_terms_reproduce(bar(across=across), fresh, cases, 5)


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_derivative_by_the_width(kind):
    """Halving a small step quarters what the derivative leaves of an eigenvalue's change."""
    model = bar(comm=MPI.COMM_WORLD)
    if kind == "reduced":
        model = reduce(model, [{}, {"w": 1.2}], N_MODES)
    elastic = np.arange(6, N_MODES - 1)
    assert_second_order(model, {"w": 0.02}, elastic, {"s": 1.2}, n_modes=N_MODES)


def test_bad_widths_are_named():
    with pytest.raises(InputError, match=r"bar.width = -1 is out of range: expected width > 0"):
        bar().stiffness({"w": -1.0})
    with pytest.raises(InputError, match=r"bar.across = \[0, 0, 1\].*not parallel to the normal"):
        bar(across=(0, 0, 1))
