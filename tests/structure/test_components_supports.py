"""Supports of lines and points."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Structure, Support, part

STEEL = {"E": 200e9, "nu": 0.3, "rho": 7800.0}


def plate(supports, sides=(1.0, 0.8, 0.02), counts=(8, 8, 2), degree=2):
    tagged = box(MPI.COMM_WORLD, sides, counts)
    x, y, z = (np.linspace(0.0, side, n + 1) for side, n in zip(sides, counts, strict=True))
    rim = [
        (a, b, 0.5 * sides[2]) for a, b in product(x, y) if a in (0, sides[0]) or b in (0, sides[1])
    ]
    tagged.points["rim"] = np.array(rim)
    return Structure(tagged, [part("plate", "body", **STEEL)], supports=supports, degree=degree)


@pytest.mark.parallel
def test_simply_supported_plate():
    """Held across along the lines in the middle of its rims: Navier's frequencies."""
    modes = solve_modes(plate([Support(points="rim", directions=(2,))]), n_modes=6)
    assert modes.n_rigid == 3  # in the plane
    found = modes.frequencies_hz[3:]
    stiffness = 200e9 * 0.02**3 / (12 * (1 - 0.3**2))
    factor = np.pi / 2 * np.sqrt(stiffness / (7800 * 0.02))
    exact = sorted(factor * (m**2 + (n / 0.8) ** 2) for m in (1, 2) for n in (1, 2))[:3]
    assert found == pytest.approx(exact, rel=0.01)


@pytest.mark.parallel
def test_three_points_hold_a_body_without_stress():
    """Three, two and one direction at three points: no rigid motion is left, none is resisted."""
    held = [
        Support(points=[(0.0, 0.0, 0.0)]),
        Support(points=[(1.0, 0.0, 0.0)], directions=(1, 2)),
        Support(points=[(0.0, 0.8, 0.0)], directions=(2,)),
    ]
    for n in (2, 3):
        structure = plate(held[:n], degree=1)
        rigid = solve_modes(structure, n_modes=3).n_rigid
        assert rigid == (1 if n == 2 else 0)
        held_here = int(structure.held_dofs[: structure.n_local].sum())
        assert structure.comm.allreduce(held_here) == n + 3


def test_what_is_no_support():
    for given in ({}, {"facets": "x_min", "points": "rim"}):
        with pytest.raises(InputError, match="either facets or points"):
            Support(**given)
    with pytest.raises(MeshError, match="no point or line named 'edge'; it has: rim"):
        plate([Support(points="edge")])
    with pytest.raises(MeshError, match=r"\[0.5, 0.4, 1.0\] m is 0.98 m from the nearest vertex"):
        plate([Support(points=[(0.5, 0.4, 1.0)])])
