"""Whether a structure moves as freely with another thickness."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, Structure, Support, part
from fenics_joints.structure.stretching import Stretching


@pytest.mark.parallel
def test_a_rank_need_not_have_a_support():
    """A long beam held at one end, of whose facets the other rank has none."""
    tagged = box(MPI.COMM_WORLD, (1.0, 0.02, 0.02), (40, 1, 1))
    beam = part("beam", "body", E=70e9, nu=0.3, rho=2700.0, stretch="t", normal=(0.0, 0.0, 1.0))
    held = Structure(tagged, [beam], [Parameter("t", 1.0)], supports=[Support("x_min")], degree=1)
    rigid = [solve_modes(held, {"t": t}, n_modes=4).n_rigid for t in (1.0, 1.2)]
    assert Stretching(held).keeps(["t"]) == (rigid[0] == rigid[1])
