"""Lap plates: measures and tags against closed forms."""

import dolfinx
import numpy as np
import pytest
from matching_faces import polygon
from mesh_measures import CELLS, COMM, areas, skin, volumes
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, lap_plates


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_lap_plates_measures(cell):
    tagged = lap_plates(COMM, cell=cell)
    near = 4 * 0.02**2
    assert volumes(tagged) == pytest.approx(
        dict.fromkeys(("plate_1", "plate_2"), 0.2 * 0.08 * 0.008)
        | {"joint_near": near * 0.5e-3, "joint_away": (0.08**2 - near) * 0.5e-3},
        rel=1e-10,
    )
    plate, lap, end = 0.2 * 0.08, 0.08 * 0.08, 0.08 * 0.008
    expected = dict.fromkeys(("end_1", "end_2"), end) | dict.fromkeys(("bottom", "top"), plate)
    expected |= dict.fromkeys(("joint_lower", "joint_upper"), lap)
    assert areas(tagged) == pytest.approx(expected, rel=1e-10)
    sides = 2 * (2 * 0.2 * 0.008 + 0.08 * 0.5e-3)
    edges = 4 * end + 2 * 0.08 * 0.5e-3
    assert skin(tagged) == pytest.approx(4 * plate - 2 * lap + sides + edges, rel=1e-10)
    quality = check_mesh(tagged)
    assert quality.scaled_jacobian > 0.04 and quality.bodies == 1


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_without_layer_the_plates_share_an_interface(cell):
    tagged = lap_plates(COMM, layer=0, cell=cell)
    assert sorted(tagged.cell_names) == ["plate_1", "plate_2"]
    assert areas(tagged)["interface"] == pytest.approx(0.08**2, rel=1e-10)
    interface = tagged.facet_tags.find(tagged.facet_tag("interface"))
    links = tagged.mesh.topology.connectivity(2, 3)
    tag_of = tagged.cell_tags.values
    n_owned = tagged.mesh.topology.index_map(2).size_local
    for facet in interface[interface < n_owned]:
        # Both cells are known here, ghosts included, and one belongs to each plate.
        assert sorted(tag_of[links.links(facet)]) == [1, 2]
    with pytest.raises(MeshError, match="no part named 'joint_near'; it has: plate_1, plate_2"):
        tagged.cell_tag("joint_near")


def test_zones_are_exact_where_no_regular_grid_line_is():
    bolts = np.array([[0.1437, 0.0213], [0.1791, 0.0571]])
    tagged = lap_plates(MPI.COMM_SELF, bolts=bolts, zone=0.0173, element_size=6.1e-3)
    cells = tagged.cell_tags.find(tagged.cell_tag("joint_near"))
    mesh = tagged.mesh
    corners = dolfinx.mesh.entities_to_geometry(mesh, 3, cells.astype(np.int32))
    x = mesh.geometry.x[corners]
    nearest = np.linalg.norm(x.mean(axis=1)[:, None, :2] - bolts, axis=2).argmin(axis=1)
    for number, bolt in enumerate(bolts):
        around = x[nearest == number][:, :, :2].reshape(-1, 2)
        np.testing.assert_allclose(around.min(axis=0), bolt - 0.0173 / 2, rtol=0, atol=1e-12)
        np.testing.assert_allclose(around.max(axis=0), bolt + 0.0173 / 2, rtol=0, atol=1e-12)
    np.testing.assert_allclose(tagged.points["bolts"][:, :2], bolts)
    np.testing.assert_allclose(tagged.points["bolts"][:, 2], 0.00825)


def test_elements_are_as_many_as_asked():
    """Two plates of 60 x 24 x 4, with the lap's 24 x 24 between."""
    tagged = lap_plates(MPI.COMM_SELF, n_length=60, n_width=24, n_thickness=4)
    assert tagged.mesh.topology.index_map(3).size_local == 2 * 60 * 24 * 4 + 24 * 24
    vertices = tagged.mesh.topology.index_map(0).size_local
    assert vertices == 2 * 61 * 25 * 5  # those of the layer are the plates'


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_holes_are_regular_polygons(cell):
    hole, washer, zone, layer = 0.011, 0.016, 0.02, 0.5e-3
    tagged = lap_plates(
        COMM, hole_diameter=hole, washer_diameter=washer, zone=zone, layer=layer, cell=cell
    )
    n = 4 * 4  # the zone's side has four elements of 5 mm

    plate = 0.2 * 0.08 - 4 * polygon(hole)
    found = volumes(tagged)
    for name in ("plate_1", "plate_2"):
        assert found[name] == pytest.approx(plate * 0.008, rel=1e-10)
    assert found["joint_near"] == pytest.approx(4 * (zone**2 - polygon(hole)) * layer, rel=1e-10)
    assert found["joint_away"] == pytest.approx((0.08**2 - 4 * zone**2) * layer, rel=1e-10)
    faces = areas(tagged)
    wall = n * hole * np.sin(np.pi / n) * (2 * 0.008 + layer)
    assert faces["holes"] == pytest.approx(4 * wall, rel=1e-10)
    assert faces["washers"] == pytest.approx(8 * (polygon(washer) - polygon(hole)), rel=1e-10)
    assert faces["bottom"] + faces["washers"] / 2 == pytest.approx(plate, rel=1e-10)
    assert faces["joint_lower"] == pytest.approx(0.08**2 - 4 * polygon(hole), rel=1e-10)
    outside = 4 * 0.2 * 0.008 + 2 * 0.08 * layer + 4 * 0.08 * 0.008 + 2 * 0.08 * layer
    apart = 2 * (0.2 - 0.08) * 0.08  # the faces of the plates that look at each other's side
    assert skin(tagged) == pytest.approx(2 * plate + apart + outside + 4 * wall, rel=1e-10)
    assert check_mesh(tagged).scaled_jacobian > 0.02
