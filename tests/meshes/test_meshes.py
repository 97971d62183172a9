"""Meshes: measures and tags against closed forms, and every refusal by its message."""

import re

import basix.ufl
import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import TaggedMesh, box, check_mesh, lap_plates, read_msh

COMM = MPI.COMM_WORLD
CELLS = ["hexahedron", "tetrahedron"]


def volumes(tagged: TaggedMesh) -> dict[str, float]:
    """Volume of each part, from the cell averages of one."""
    space = fem.functionspace(tagged.mesh, ("DG", 0))
    vector = fem.assemble_vector(fem.form(ufl.TestFunction(space) * ufl.dx))
    n_owned = space.dofmap.index_map.size_local
    by_cell = vector.array[:n_owned]
    found = {}
    for name, tag in tagged.cell_names.items():
        cells = tagged.cell_tags.find(tag)
        found[name] = COMM.allreduce(by_cell[cells[cells < n_owned]].sum())
    return found


def area(mesh: dolfinx.mesh.Mesh, facets: np.ndarray) -> float:
    """Area of this rank's owned plane facets, by cross products of their edges."""
    fdim = mesh.topology.dim - 1
    facets = facets[facets < mesh.topology.index_map(fdim).size_local]
    mesh.topology.create_connectivity(fdim, mesh.topology.dim)
    doubled = np.empty((0, 3))
    if len(facets):  # DOLFINx 0.9 divides by their number
        x = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, fdim, facets)]
        ends = (1, 0, 2, 0) if x.shape[1] == 3 else (3, 0, 2, 1)
        a, b, c, d = (x[:, end] for end in ends)
        doubled = np.cross(a - b, c - d)
    return COMM.allreduce(0.5 * np.linalg.norm(doubled, axis=1).sum())


def areas(tagged: TaggedMesh) -> dict[str, float]:
    return {
        name: area(tagged.mesh, tagged.facet_tags.find(tag))
        for name, tag in tagged.facet_names.items()
    }


def skin(tagged: TaggedMesh) -> float:
    """Area of all exterior facets; a cut that does not conform would add its faces to it."""
    mesh = tagged.mesh
    mesh.topology.create_connectivity(2, 3)
    return area(mesh, dolfinx.mesh.exterior_facet_indices(mesh.topology))


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_lap_plates_measures(cell):
    tagged = lap_plates(COMM, cell=cell)
    near = 4 * 0.02**2
    assert volumes(tagged) == pytest.approx(
        {
            "plate_1": 0.2 * 0.08 * 0.008,
            "plate_2": 0.2 * 0.08 * 0.008,
            "joint_near": near * 0.5e-3,
            "joint_away": (0.08**2 - near) * 0.5e-3,
        },
        rel=1e-10,
    )
    plate, lap, end = 0.2 * 0.08, 0.08 * 0.08, 0.08 * 0.008
    assert areas(tagged) == pytest.approx(
        {
            "end_1": end, "end_2": end, "bottom": plate, "top": plate,
            "joint_lower": lap, "joint_upper": lap,
        },
        rel=1e-10,
    )  # fmt: skip
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


def test_benchmark_size_is_that_of_the_count_by_hand():
    tagged = lap_plates(MPI.COMM_SELF, n_length=60, n_width=24, n_thickness=4)
    element = basix.ufl.element("S", "hexahedron", 2, shape=(3,))
    space = fem.functionspace(tagged.mesh, element)
    nx, ny, nz, lap = 60, 24, 4, 24
    vertices = (nx + 1) * (ny + 1) * (nz + 1)
    edges = nx * (ny + 1) * (nz + 1) + (nx + 1) * ny * (nz + 1) + (nx + 1) * (ny + 1) * nz
    upright_in_layer = (lap + 1) * (ny + 1)
    expected = 3 * (2 * (vertices + edges) + upright_in_layer)
    assert space.dofmap.index_map.size_global * 3 == expected == 173145


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_holes_are_regular_polygons(cell):
    hole, washer, zone, layer = 0.011, 0.016, 0.02, 0.5e-3
    tagged = lap_plates(
        COMM, hole_diameter=hole, washer_diameter=washer, zone=zone, layer=layer, cell=cell
    )
    n = 4 * 4  # the zone's side has four elements of 5 mm

    def polygon(diameter):
        return n / 2 * (diameter / 2) ** 2 * np.sin(2 * np.pi / n)

    plate = 0.2 * 0.08 - 4 * polygon(hole)
    found = volumes(tagged)
    assert found["plate_1"] == pytest.approx(plate * 0.008, rel=1e-10)
    assert found["plate_2"] == pytest.approx(plate * 0.008, rel=1e-10)
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


@pytest.mark.parallel
@pytest.mark.parametrize("cell", CELLS)
def test_box_measures(cell):
    tagged = box(COMM, (1.0, 0.2, 0.3), (5, 2, 3), cell)
    assert volumes(tagged) == pytest.approx({"body": 0.06})
    sides = {"x": 0.06, "y": 0.3, "z": 0.2}
    expected = {f"{axis}_{end}": sides[axis] for axis in "xyz" for end in ("min", "max")}
    assert areas(tagged) == pytest.approx(expected)
    assert skin(tagged) == pytest.approx(2 * sum(sides.values()))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"length": -1.0}, "length is -1.0, expected a length above 0 m"),
        ({"thickness": float("nan")}, "thickness is nan, expected"),
        ({"lap": 0.2}, "lap is 0.2, expected less than length = 0.2 m"),
        ({"layer": -1e-3}, "layer is -0.001, expected 0 m or"),
        ({"element_size": 0}, "element_size is 0, expected"),
        ({"n_length": 2.5}, "n_length is 2.5, expected a whole number"),
        ({"n_thickness": 0}, "n_thickness is 0, expected a whole number"),
        ({"cell": "prism"}, "cell is 'prism', expected 'hexahedron' or 'tetrahedron'"),
        ({"bolts": [0.14, 0.02]}, "bolts is [0.14, 0.02], expected a pair (x, y)"),
        ({"bolts": [(0.1, 0.04)]}, "bolts[0] x is 0.1, expected a position within 0.12 to 0.2 m"),
        ({"zone": 0.05}, "zone is 0.05, expected at most 0.04 m, so that the zone of bolts[0] x"),
        ({"hole_diameter": 0.019}, "hole_diameter is 0.019, expected a diameter above 0 m and"),
        ({"washer_diameter": 0.02}, "washer_diameter is 0.02, expected None when hole_diameter"),
        (
            {"hole_diameter": 0.011, "washer_diameter": 0.01},
            "washer_diameter is 0.01, expected more than hole_diameter = 0.011 m",
        ),
        (
            {"hole_diameter": 0.01, "bolts": [(0.15, 0.04), (0.16, 0.045)]},
            "zone is 0.02, expected at most the distance of bolts[0] and bolts[1], 0.01 m",
        ),
    ],
)
def test_impossible_lap_plates_are_refused(arguments, message):
    with pytest.raises(MeshError, match=re.escape(message)):
        lap_plates(MPI.COMM_SELF, **arguments)


# Two hexahedra side by side along x in gmsh's numbering, the face between them and one end.
NODES = [(x, y, z) for x in (0, 1, 2) for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))]
LEFT, RIGHT = [1, 5, 6, 2, 4, 8, 7, 3], [5, 9, 10, 6, 8, 12, 11, 7]
HEXAHEDRON, TETRAHEDRON, PRISM, QUADRATIC_TETRAHEDRON, QUADRILATERAL = 5, 4, 6, 11, 3
NAMES = {(3, 1): "left", (3, 2): "right", (2, 3): "interface"}
ELEMENTS = [(HEXAHEDRON, 1, LEFT), (HEXAHEDRON, 2, RIGHT), (QUADRILATERAL, 3, [5, 6, 7, 8])]


def write_msh(folder, elements=ELEMENTS, names=NAMES, nodes=NODES):
    """Write format 2.2; an element is (gmsh's type, group, vertices from 1[, entity])."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", f"{len(names)}"]
    lines += [f'{dim} {tag} "{name}"' for (dim, tag), name in names.items()]
    lines += ["$EndPhysicalNames", "$Nodes", f"{len(nodes)}"]
    lines += [f"{number} {x} {y} {z}" for number, (x, y, z) in enumerate(nodes, start=1)]
    lines += ["$EndNodes", "$Elements", f"{len(elements)}"]
    for number, (kind, group, vertices, *entity) in enumerate(elements, start=1):
        ids = " ".join(str(vertex) for vertex in vertices)
        lines.append(f"{number} {kind} 2 {group} {entity[0] if entity else group + 10} {ids}")
    path = folder / "mesh.msh"
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    return path


def written(folder, **content):
    if COMM.rank == 0:
        write_msh(folder, **content)
    COMM.barrier()
    return folder / "mesh.msh"


@pytest.mark.parallel
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_named_groups_are_read(shared_tmp_path, order):
    path = written(shared_tmp_path, elements=[ELEMENTS[i] for i in order])
    required = {"required_cells": ["left", "right"], "required_facets": ["interface"]}
    tagged = read_msh(path, COMM, scale=1e-3, **required)
    assert tagged.cell_names == {"left": 1, "right": 2} and tagged.facet_names == {"interface": 3}
    assert volumes(tagged) == pytest.approx({"left": 1e-9, "right": 1e-9})
    assert areas(tagged) == pytest.approx({"interface": 1e-6})
    for cell in tagged.cell_tags.find(1):
        corners = dolfinx.mesh.entities_to_geometry(tagged.mesh, 3, np.array([cell]))
        np.testing.assert_allclose(tagged.mesh.geometry.x[corners[0]].mean(axis=0), 5e-4)


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [0, 1])
def test_what_gmsh_writes_is_read(tmp_path, version, binary):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("of_the_caller")
    ball = gmsh.model.occ.addSphere(0, 0, 0, 1)
    cube = gmsh.model.occ.addBox(-2, -2, -2, 4, 4, 4)
    gmsh.model.occ.fragment([(3, ball)], [(3, cube)])
    gmsh.model.occ.synchronize()
    inside = gmsh.model.getEntitiesInBoundingBox(-1.1, -1.1, -1.1, 1.1, 1.1, 1.1, 3)[0][1]
    outside = next(tag for _, tag in gmsh.model.getEntities(3) if tag != inside)
    sphere = [tag for _, tag in gmsh.model.getBoundary([(3, inside)], oriented=False)]
    gmsh.model.addPhysicalGroup(3, [inside], 5, "ball")
    gmsh.model.addPhysicalGroup(3, [outside], 6, "rest")
    gmsh.model.addPhysicalGroup(2, sphere, 7, "sphere")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "ball.msh"))
    tagged = read_msh(tmp_path / "ball.msh", MPI.COMM_SELF)
    current = gmsh.model.getCurrent()
    gmsh.finalize()
    assert current == "of_the_caller"
    found = volumes(tagged)
    # The inscribed polyhedron lacks about h^2 / 4 of the ball, and the rest has what it lacks.
    assert 4 / 3 * np.pi * (1 - 0.4**2 / 2) < found["ball"] < 4 / 3 * np.pi
    assert found["ball"] + found["rest"] == pytest.approx(64)
    assert 4 * np.pi * (1 - 0.4**2 / 2) < areas(tagged)["sphere"] < 4 * np.pi


FLAT = [(x, y, z) if x < 2 else (1, y + 1, z) for x, y, z in NODES]
BAD_FILES = {
    "unnamed group": (
        {"names": {(3, 1): "left", (2, 3): "interface"}}, "volume group 2 has no name"
    ),
    "cells in no group": (
        {"elements": [*ELEMENTS[:1], (HEXAHEDRON, 0, RIGHT), ELEMENTS[2]]},
        "1 cells (volume 10) are in no named group, expected every cell in one; groups of "
        "dimension 3: left",
    ),
    "no cells": ({"elements": ELEMENTS[2:]}, "no cells of dimension 3"),
    "cell in two groups": (
        {"elements": [(HEXAHEDRON, 1, LEFT, 11), (HEXAHEDRON, 2, RIGHT, 11)]},
        "volume 11 is in 'left' and 'right', expected one group",
    ),
    "missing part": (
        {"elements": [ELEMENTS[0], ELEMENTS[2]]}, "part 'right' is missing, expected a group; "
        "it has: left",
    ),
    "missing face": ({"elements": ELEMENTS[:2]}, "face 'interface' is missing, expected a group"),
    "inverted": (
        {"elements": [ELEMENTS[0], (HEXAHEDRON, 2, RIGHT[4:] + RIGHT[:4]), ELEMENTS[2]]},
        "1 inverted and 0 flat cells; the first has its centre at (1.5, 0.5, 0.5) m in part "
        "'right'",
    ),
    "flat": (
        {"nodes": FLAT},
        "0 inverted and 1 flat cells; the first has its centre at (1, 1, 0.5) m in part 'right'",
    ),
    "mixed shapes": (
        {"elements": [ELEMENTS[0], (TETRAHEDRON, 2, [5, 9, 6, 8]), ELEMENTS[2]]},
        "the elements of dimension 3 are hexahedron and tetrahedron, expected one shape",
    ),
    "prisms": (
        {"elements": [ELEMENTS[0], (PRISM, 2, [5, 9, 10, 8, 12, 11]), ELEMENTS[2]]},
        "group 'right' has Prism 6 elements, expected",
    ),
    "second order": (
        {"elements": [(QUADRATIC_TETRAHEDRON, 1, range(1, 11)), ELEMENTS[1]]},
        "group 'left' has elements of order 2 (Tetrahedron 10), expected order 1",
    ),
    "face that is no facet": (
        {"elements": [*ELEMENTS[:2], (QUADRILATERAL, 3, [5, 6, 11, 12])]},
        "0 of 1 facets of face 'interface' are facets of the cells",
    ),
    "face off the cells": (
        {
            "nodes": [*NODES, (5, 5, 5)],
            "elements": [*ELEMENTS[:2], (QUADRILATERAL, 3, [5, 6, 7, 13])],
        },
        "a face has vertices that no cell has",
    ),
}  # fmt: skip


@pytest.mark.parallel
@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_on_every_rank(shared_tmp_path, case):
    content, message = BAD_FILES[case]
    path = written(shared_tmp_path, **content)
    required = {"required_cells": ["left", "right"], "required_facets": ["interface"]}
    with pytest.raises(MeshError, match=re.escape(message)) as caught:
        read_msh(path, COMM, **required)
    assert str(path) in str(caught.value)


def test_what_is_no_msh_file_is_refused(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        read_msh(tmp_path / "absent.msh", MPI.COMM_SELF)
    # gmsh would run this as its script.
    script = tmp_path / "script.msh"
    script.write_text("SetFactory('OpenCASCADE'); Box(1) = {0, 0, 0, 1, 1, 1};")
    with pytest.raises(MeshError, match="not a gmsh .msh file"):
        read_msh(script, MPI.COMM_SELF)
    whole = write_msh(tmp_path).read_text()
    (tmp_path / "mesh.msh").write_text(whole[: whole.index("$Elements") - 40])
    with pytest.raises(MeshError, match="mesh.msh: "):
        read_msh(tmp_path / "mesh.msh", MPI.COMM_SELF)


@pytest.mark.parallel
def test_bodies_that_only_look_joined_are_counted(shared_tmp_path):
    # Three rods along x; the first two share the vertices between them, the third has its own.
    n, nodes, elements = 8, [], []
    for rod in range(3):
        for i in range(n + 1):
            nodes += [(i, y + rod, z) for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))]
        first = 4 * (n + 1) * rod
        slices = [[first + 4 * i + k for k in (1, 2, 3, 4)] for i in range(n + 1)]
        if rod == 1:
            below = [[4 * i + k for k in (2, 3)] for i in range(n + 1)]
            slices = [[b[0], s[1], s[2], b[1]] for s, b in zip(slices, below, strict=True)]
        for a, b in zip(slices[:-1], slices[1:], strict=True):
            elements.append((HEXAHEDRON, rod + 1, [a[0], b[0], b[1], a[1], a[3], b[3], b[2], a[2]]))
    names = {(3, rod + 1): f"rod_{rod + 1}" for rod in range(3)}
    path = written(shared_tmp_path, elements=elements, names=names, nodes=nodes)
    tagged = read_msh(path, COMM)
    assert check_mesh(tagged).bodies == 2
