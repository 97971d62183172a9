"""Files of a preload state, read back and compared with the state."""

from __future__ import annotations

from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from contact_blocks import COMM, pair, pressed
from dolfinx import io
from mpi4py import MPI
from scipy.spatial import cKDTree

from fenics_joints.errors import InputError
from fenics_joints.meshes import stacked_blocks
from fenics_joints.preload import PreloadSolver, Traction, fields
from fenics_joints.structure import grids

pytestmark = pytest.mark.parallel


def state(cell="hexahedron", degree=1):
    """A block pressed unevenly on another: open, slipping and stuck pairs."""
    x, z = np.linspace(0.0, 0.1, 8), np.linspace(0.0, 0.01, 3)
    space = cell in ("hexahedron", "tetrahedron")
    base = (x, 0.8 * x) if space else (x,)
    tagged = stacked_blocks(COMM, lower=(*base, -z[::-1]), upper=z, cell=cell)

    def uneven(x):
        return np.exp(-np.sum((x[:, :-1] - 0.04) ** 2, axis=1) / 0.012**2)

    down = (0.0, 0.0, -9e3) if space else (0.0, -9e3)
    loads, parts = [Traction("down", "top", down, uneven)], pair({}, {"E": 70e9, "rho": 2700.0})
    model = pressed(tagged, loads, parts=parts, degree=degree, friction=0.2)
    return PreloadSolver(model).solve()


def datasets(path):
    """Arrays of a whole XDMF file by name, through the references in the file; serial."""
    found = {}
    for parent in ElementTree.parse(path).getroot().iter():
        for item in parent.findall("DataItem"):
            shape = tuple(map(int, item.get("Dimensions").split()))
            if item.get("Format") == "XML":
                numbers = np.array(item.text.split(), dtype=float)
            else:
                name, key = item.text.split(":")
                with h5py.File(path.parent / name, "r") as file:
                    numbers = file[key][()]
            found[parent.get("Name", parent.tag)] = numbers.reshape(shape)
    return found


def at_pairs(points, result, read):
    """Rows of the file at the lower and upper vertex of each pair.

    They are in one place; traction presses the upper one along the normal or, where there is none,
    it has moved further along it.
    """
    c = result["c"].interface
    gdim = c.points.shape[1]
    near = cKDTree(points[:, :gdim]).query_ball_point(c.points, 1e-9)
    rows = np.array(near.tolist())
    assert rows.shape == (len(c), 2)
    along = {
        key: np.einsum("nsi,ni->ns", read[key][rows][..., :gdim], c.normals)
        for key in ("traction", "displacement")
    }
    kind = np.where(result["c"].closed[:, None], along["traction"], along["displacement"])
    return np.take_along_axis(rows, np.argsort(kind, axis=1), axis=1)


@pytest.mark.parametrize(
    ("cell", "degree"), [("hexahedron", 2), ("tetrahedron", 1), ("quadrilateral", 2)]
)
def test_xdmf_holds_the_state(shared_tmp_path, cell, degree):
    result = state(cell, degree)
    # What is there already is replaced.
    for _ in range(2):
        files = fields.write(result, shared_tmp_path / "state.xdmf")
    names = ["state.h5", "state.xdmf", "state_contacts.xdmf"]
    assert sorted(p.name for p in shared_tmp_path.iterdir()) == names
    assert sorted(p.name for p in files) == names
    displacement = result.displacement
    largest = COMM.allreduce(np.abs(displacement.x.array).max(), op=MPI.MAX)
    if COMM.rank == 0:
        check_xdmf(result, files, largest)


def check_xdmf(result, files, largest):
    c = result["c"]
    read, gdim = datasets(files[0]), c.interface.points.shape[1]
    root = ElementTree.parse(files[0]).getroot()
    assert len(root.findall(".//Grid")) == 1
    rows = at_pairs(read["Geometry"], result, read)
    for name in ("pressure", "gap", "status"):
        assert read[name][rows, 0] == pytest.approx(np.column_stack([getattr(c, name)] * 2))
    # The jump of the displacement in the file is gap and slip, by another route.
    jump = (read["displacement"][rows[:, 1]] - read["displacement"][rows[:, 0]])[:, :gdim]
    own = np.einsum("nki,ni->nk", c.interface.frames, jump)
    assert own == pytest.approx(np.column_stack([c.gap, c.slip]), abs=1e-9 * largest)
    slip = np.einsum("nki,ni->nk", c.interface.frames, read["slip"][rows[:, 1], :gdim])
    assert slip[:, 1:] == pytest.approx(c.slip, abs=1e-9 * largest)
    # Tractions over the vertices' areas are the force of either body on the other.
    for side, sign in ((1, 1.0), (0, -1.0)):
        total = c.interface.areas @ read["traction"][rows[:, side], :gdim]
        assert total == pytest.approx(sign * c.resultant, rel=1e-9, abs=1e-6)
    away = np.setdiff1d(np.arange(len(read["status"])), rows)
    assert np.all(read["status"][away] == -1) and np.all(read["pressure"][away] == 0)
    assert np.abs(read["displacement"]).max() <= largest * (1 + 1e-12)
    contact = datasets(files[-1])
    assert contact["facet_pressure"] @ c.facet_area == pytest.approx(c.normal_force)
    assert contact["Geometry"][:, :gdim] == pytest.approx(c.interface.points)
    assert area_of(contact) == pytest.approx(c.interface.areas.sum())
    assert contact["pressure"] == pytest.approx(c.pressure)
    assert set(contact["facet_status"]) <= {0.0, 1.0, 2.0}
    opened = (c.pressure[c.interface.facets] == 0).all(axis=1)
    assert np.array_equal(contact["facet_status"] == 0, opened) and opened.any()


def area_of(contact):
    """Area of polygons in the order of their corners: wrong for one that crosses itself."""
    x = contact["Geometry"][contact["Topology"].astype(int)]
    if x.shape[1] == 2:
        return np.linalg.norm(x[:, 1] - x[:, 0], axis=1).sum()
    turn = np.cross(x, np.roll(x, -1, axis=1)).sum(axis=1)
    return 0.5 * np.linalg.norm(turn, axis=1).sum()


def test_vtx_holds_the_state(shared_tmp_path):
    if not hasattr(io, "VTXWriter"):
        pytest.skip("DOLFINx was built without ADIOS2")
    result = state()
    path = shared_tmp_path / "state.bp"
    for _ in range(2):
        files = fields.write(result, path)
    assert sorted(p.name for p in shared_tmp_path.iterdir()) == ["state.bp", "state_contacts.xdmf"]
    assert files == [path, shared_tmp_path / "state_contacts.xdmf"]
    functions = fields.nodal_fields(result)
    # ADIOS2's file holds each rank's values as they are in memory; its own reader is optional.
    raw = b"".join(p.read_bytes() for p in sorted(path.glob("data.*")))
    index = b"".join(p.read_bytes() for p in path.glob("md*"))
    for function in functions:
        assert function.name.encode() in index
        n = function.function_space.dofmap.index_map.size_local
        values = function.x.array.reshape(-1, function.function_space.dofmap.index_map_bs)[:n]
        assert values.size and values.tobytes() in raw, function.name


def test_nothing_is_left_of_a_failed_attempt(shared_tmp_path, monkeypatch):
    result = state("quadrilateral")
    path = shared_tmp_path / "state.xdmf"
    fields.write(result, path)
    COMM.barrier()
    before = {p.name: p.read_bytes() for p in shared_tmp_path.iterdir()}

    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(grids, "share_grid", fail)
    with pytest.raises(InputError, match="no space left"):
        fields.write(result, path)
    COMM.barrier()
    assert {p.name: p.read_bytes() for p in shared_tmp_path.iterdir()} == before
    COMM.barrier()  # all have looked before the folder below is made
    with pytest.raises(InputError, match="ends in"):
        fields.write(result, shared_tmp_path / "state.vtk")
    with pytest.raises(InputError, match="no folder"):
        fields.write(result, shared_tmp_path / "none" / "state.bp")
    folder = shared_tmp_path / "mine.bp"
    if COMM.rank == 0:
        folder.mkdir()
        (folder / "letter.txt").write_text("dear")
    COMM.barrier()
    with pytest.raises(InputError, match="none of ADIOS2"):
        fields.write(result, folder)
