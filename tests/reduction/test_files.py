"""Files of reduced models that hold no such model."""

from __future__ import annotations

import os
from contextlib import contextmanager

import pytest

pytest.importorskip("dolfinx")

import h5py
import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.files import sealed
from fenics_joints.progress import Progress
from fenics_joints.reduction import ArrayModel
from fenics_joints.reduction.affine import AffinePencil, RegionTerm
from fenics_joints.reduction.files import (
    ARRAYS,
    Cache,
    read_array_model,
    read_model,
    write_array_model,
    write_model,
)
from fenics_joints.structure.laws import SOLID


@contextmanager
def written(path):
    """A file of arrays, to be filled by hand."""
    with sealed(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"], file.attrs["version"] = ARRAYS, 4
        file.attrs["made"] = ""
        yield file


@pytest.mark.parametrize("inside", [False, True])
def test_links_in_a_circle(tmp_path, inside):
    """A link to itself, and a group that holds itself."""
    path = tmp_path / "model.h5"
    with written(path) as file:
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
    with written(path) as file:
        group = file.create_group("model")
        group.attrs["kind"], group.attrs["keys"] = "sequence", "2"
        if more == "linked":
            group["0"] = np.zeros(10)
            group["1"] = group["0"]
        else:
            group.create_dataset("0", (50_000, 50_000), dtype="f8", chunks=(1000, 1000))
    with pytest.raises(InputError, match="in the file twice" if more == "linked" else "of its"):
        read_array_model(path)


@pytest.fixture
def model(tmp_path):
    """A small model in its file."""
    rng = np.random.default_rng(3)
    n = 12
    stiffness, inertia = (x @ x.T + n * np.eye(n) for x in rng.normal(size=(2, n, n)))
    given = {"E": 2e11, "nu": 0.3, "rho": 7800.0, "stretch": 1.0}
    region = RegionTerm("rod", SOLID, given, stiffness[None], inertia, 1e-3)
    path = tmp_path / "model.h5"
    write_array_model(ArrayModel(AffinePencil({}, [region]), 100.0), path)
    return path


def test_no_changed_bit_is_taken(model):
    """Anywhere in the file: refused, each of 300, and wherever it is cut off."""
    whole, rng = model.read_bytes(), np.random.default_rng(44)
    read_array_model(model)
    for bit in rng.integers(8 * len(whole), size=300):
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        model.write_bytes(content)
        with pytest.raises(InputError, match=r"model\.h5"):
            read_array_model(model)
    for length in (0, 1, 72, 73, len(whole) // 2, len(whole) - 1):
        model.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"model\.h5"):
            read_array_model(model)


def test_a_kept_model_is_of_what_it_was_made_of(model):
    """A file that the user names is read whatever made it."""
    write_model(read_array_model(model), model, ARRAYS, "this mesh")
    assert read_model(model, ARRAYS, ArrayModel, "this mesh").n_dofs == 12
    with pytest.raises(InputError, match="another structure"):
        read_model(model, ARRAYS, ArrayModel, "that mesh")
    assert read_array_model(model).n_dofs == 12


def test_another_users_file_is_not_kept(model):
    """One that others can write to might be theirs; root may give it away in earnest."""
    write_model(read_array_model(model), model, ARRAYS, "this mesh")
    assert not model.stat().st_mode & 0o022
    model.chmod(0o646)
    with pytest.raises(InputError, match="written to by other users"):
        read_model(model, ARRAYS, ArrayModel, "this mesh")
    model.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(model, 1234, -1)
        with pytest.raises(InputError, match="1234"):
            read_model(model, ARRAYS, ArrayModel, "this mesh")


@pytest.mark.parametrize("side_by_side", [True, False])
def test_a_cache_gives_a_result_to_the_key_that_made_it(model, tmp_path, side_by_side):
    """Of another key it keeps both or the later one; what others can write to is not taken."""
    small, told, progress = read_array_model(model), [], Progress(silent=True)
    progress.step = told.append
    one, other = (Cache(tmp_path, key, side_by_side=side_by_side) for key in ("one", "other"))
    one.write("small", small)
    assert one.read("small", ArrayModel).n_dofs == 12
    assert other.read("small", ArrayModel) is None and one.read("none", ArrayModel) is None
    other.write("small", small)
    assert (one.read("small", ArrayModel) is not None) is side_by_side
    assert other.read("small", RegionTerm) is None
    other.path("small").chmod(0o646)
    assert other.read("small", ArrayModel, progress) is None
    assert len(told) == 1 and "other users" in told[0] and str(other.path("small")) in told[0]


@pytest.mark.parametrize("what", ["other file", "virtual", "text", "references"])
def test_arrays_of_a_file_are_numbers_in_that_file(tmp_path, what):
    path, secret = tmp_path / "model.h5", tmp_path / "secret"
    secret.write_bytes(b"0123456789abcdef")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.ones(2)
    with written(path) as file:
        if what == "other file":
            file.create_dataset("model", (2,), "f8", external=[(str(secret), 0, 16)])
        elif what == "virtual":
            layout = h5py.VirtualLayout((2,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (2,))
            file.create_virtual_dataset("model", layout)
        elif what == "text":
            file["model"] = "text"
        else:
            file.create_dataset("model", data=[file.ref], dtype=h5py.ref_dtype)
    with pytest.raises(InputError, match="no array of numbers"):
        read_array_model(path)


def test_symmetric_matrices_come_back_to_the_last_bit(tmp_path):
    """Kept as halves, each of a stack too; matrices that are not quite symmetric are kept whole."""
    rng = np.random.default_rng(2)
    half = rng.standard_normal((3, 40, 40))
    stack = half + half.swapaxes(1, 2)
    model = [stack, stack[0], half, np.zeros((2, 2)), np.ones((1, 1)), np.zeros((0, 3, 3))]
    model[3][0, 1] = 1e-300
    path = tmp_path / "model.h5"
    write_model(tuple(model), path, "arrays")
    read = read_model(path, "arrays", tuple)
    assert [a.shape for a in model] == [b.shape for b in read]
    assert all(map(np.array_equal, model, read))
    whole = sum(a.nbytes for a in model)
    assert path.stat().st_size < whole - 0.45 * (stack.nbytes + stack[0].nbytes) + 20_000


@pytest.mark.parametrize("n", [7, -5, 10**9])
def test_halves_of_matrices_of_another_size_are_none(tmp_path, n):
    path = tmp_path / "model.h5"
    with written(path) as file:
        file.create_dataset("model", data=np.zeros(10)).attrs["symmetric"] = n
    with pytest.raises(InputError, match="no upper halves"):
        read_array_model(path)
