"""Files of reduced models that hold no such model."""

from __future__ import annotations

import pytest

pytest.importorskip("dolfinx")

import h5py
import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.files import sealed
from fenics_joints.reduction.files import read_array_model


@pytest.mark.parametrize("inside", [False, True])
def test_links_in_a_circle(tmp_path, inside):
    """A link to itself, and a group that holds itself."""
    path = tmp_path / "model.h5"
    with sealed(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"], file.attrs["version"] = "fenics_joints reduced model", 2
        if inside:
            group = file.create_group("model")
            group.attrs["kind"], group.attrs["keys"] = "sequence", "1"
            group["0"] = h5py.SoftLink("/model")
        else:
            file["model"] = h5py.SoftLink("/model")
    with pytest.raises(InputError, match="holds no such model"):
        read_array_model(path)


@pytest.mark.parametrize("more", ["linked", "packed"])
def test_a_small_file_that_would_become_a_large_model(tmp_path, more):
    """One group at many places; an array of zeros that the file does not hold."""
    path = tmp_path / "model.h5"
    with sealed(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"], file.attrs["version"] = "fenics_joints reduced model", 2
        group = file.create_group("model")
        group.attrs["kind"], group.attrs["keys"] = "sequence", "2"
        if more == "linked":
            group["0"] = np.zeros(10)
            group["1"] = group["0"]
        else:
            group.create_dataset("0", (50_000, 50_000), dtype="f8", chunks=(1000, 1000))
    with pytest.raises(InputError, match="in the file twice" if more == "linked" else "of its"):
        read_array_model(path)
