"""Files of reduced models that hold no such model."""

from __future__ import annotations

import pytest

pytest.importorskip("dolfinx")

import h5py

from fenics_joints.errors import InputError
from fenics_joints.reduction.files import read_array_model


@pytest.mark.parametrize("inside", [False, True])
def test_links_in_a_circle(tmp_path, inside):
    """A link to itself, and a group that holds itself."""
    path = tmp_path / "model.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"], file.attrs["version"] = "fenics_joints reduced model", 1
        if inside:
            group = file.create_group("model")
            group.attrs["kind"], group.attrs["keys"] = "sequence", "1"
            group["0"] = h5py.SoftLink("/model")
        else:
            file["model"] = h5py.SoftLink("/model")
    with pytest.raises(InputError, match="is damaged, or no HDF5 file"):
        read_array_model(path)
