"""Sizes of elements in a wrong unit are refused before anything is made."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from fenics_joints import meshes
from fenics_joints.errors import MeshError


@pytest.mark.parametrize("builder", ["c_beams", "dumbbell", "engraving_machine", "lap_plates"])
def test_a_nanometre_is_refused(builder):
    make = getattr(meshes, builder)
    with pytest.raises(MeshError, match="element_size|cells"):
        make(MPI.COMM_SELF, element_size=1e-9)
