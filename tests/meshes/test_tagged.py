"""Parts in patches, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from matching_faces import parts
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import in_patches, stacked_blocks


@pytest.mark.parallel
def test_patches_are_where_they_are_told_to_be():
    lines = np.linspace(0.0, 0.4, 5), np.linspace(0.0, 0.2, 3)
    mesh = stacked_blocks(MPI.COMM_WORLD, lower=(*lines, [-0.1, 0.0]), upper=[0.0, 0.3])
    split, names = in_patches(mesh, "lower", lambda x: 10 * (x[:, 0] > 0.1).astype(int) + 7)
    assert names == ("lower_7", "lower_17")
    expected = {"lower_7": 0.002, "lower_17": 0.006, "upper": 0.024}
    assert parts(split) == pytest.approx(expected)
    with pytest.raises(MeshError, match="whole number"):
        in_patches(mesh, "lower", lambda x: x[:, 0])
    with pytest.raises(MeshError, match="no part named"):
        in_patches(mesh, "nothing", lambda x: np.zeros(len(x), dtype=int))
