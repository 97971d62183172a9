"""Mode shapes as functions and in files for ParaView, against what sensors see of them."""

from __future__ import annotations

from types import SimpleNamespace
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import ufl
from dolfinx import fem, io
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.modal import Modes, solve_modes, write_shapes
from fenics_joints.structure import Sensors, Structure, part

pytestmark = pytest.mark.parallel
COMM = MPI.COMM_WORLD
RHO = 7800.0


@pytest.fixture(scope="module", params=["tetrahedron", "hexahedron"])
def modes(request):
    """Of a free bar; three elastic ones, by quadratic or serendipity elements."""
    tagged = box(COMM, (0.3, 0.03, 0.02), (6, 2, 1), cell=request.param)
    bar = Structure(tagged, [part("bar", "body", E=200e9, nu=0.3, rho=RHO)])
    return solve_modes(bar, n_modes=9)


def test_shapes_are_functions_of_unit_modal_mass(modes):
    found = [modes.shape(i) for i in range(6, 9)]
    for u, v in zip(found, [*found[1:], found[0]], strict=True):
        for other, expected in ((u, 1.0), (v, 0.0)):
            product = fem.assemble_scalar(fem.form(RHO * ufl.inner(u, other) * ufl.dx))
            assert COMM.allreduce(product) == pytest.approx(expected, abs=1e-6)
    found[0].x.array[:] = 0.0  # a copy
    assert modes.shape(6).x.array.any() or not len(modes.shape(6).x.array)
    with pytest.raises(InputError, match="at most 8"):
        modes.shape(9)


def seen(modes, points, i):
    """Mode ``i`` at points by sensors along the axes, (n, 3)."""
    sensors = Sensors(np.repeat(points, 3, axis=0), np.tile(np.eye(3), (len(points), 1)))
    return modes.at(sensors)[:, i].reshape(-1, 3)


def names(modes):
    return [f"mode_{i + 1:02d}_{modes.frequencies_hz[i]:.2f}_Hz" for i in range(6, 9)]


def test_xdmf_holds_what_sensors_see(modes, shared_tmp_path):
    files = write_shapes(modes, shared_tmp_path / "modes.xdmf")
    assert [f.name for f in files] == ["modes.xdmf", "modes.h5"]
    root = ElementTree.parse(files[0]).getroot()
    assert [a.get("Name") for a in root.iter("Attribute")] == names(modes)
    with h5py.File(files[1]) as heavy:
        points = heavy["Mesh/mesh/geometry"][:]
        for i, a in enumerate(root.iter("Attribute"), start=6):
            values = heavy[a.find("DataItem").text.strip().partition(":")[2]][:]
            scale = np.abs(values).max()
            assert values == pytest.approx(seen(modes, points, i), abs=1e-8 * scale)
    COMM.barrier()  # all have read before the folder goes


def test_vtx_holds_the_midside_values_too(modes, shared_tmp_path):
    if not hasattr(io, "VTXWriter"):
        pytest.skip("DOLFINx was built without ADIOS2")
    path = shared_tmp_path / "modes.bp"
    assert write_shapes(modes, path) == [path]
    # ADIOS2's file holds each rank's values as they are in memory; its own reader is optional.
    raw = b"".join(p.read_bytes() for p in sorted(path.glob("data.*")))
    index = b"".join(p.read_bytes() for p in path.glob("md*"))
    assert all(name.encode() in index for name in names(modes))
    V = fem.functionspace(modes.model.mesh, ("Lagrange", 2, (3,)))
    field = fem.Function(V)
    field.interpolate(modes.shape(8))
    values = field.x.array[: 3 * V.dofmap.index_map.size_local]
    assert values.size and values.tobytes() in raw
    COMM.barrier()


def test_what_is_no_field_is_refused(modes, shared_tmp_path):
    with pytest.raises(InputError, match="of a rigid body; expected more modes"):
        write_shapes(solve_modes(modes.model, n_modes=6), shared_tmp_path / "modes.xdmf")
    with pytest.raises(InputError, match="ends in .bp or .xdmf"):
        write_shapes(modes, shared_tmp_path / "modes.vtk")
    beams = SimpleNamespace(is_dense=True)
    reduced = Modes(beams, {}, np.array([1.0, 4.0]), np.array([[1.0, 2.0], [3.0, 4.0]]), 0)
    assert reduced.shape(1).tolist() == [2.0, 4.0]
    with pytest.raises(InputError, match="SimpleNamespace has no mesh"):
        write_shapes(reduced, shared_tmp_path / "modes.xdmf")
    assert not list(shared_tmp_path.iterdir())
