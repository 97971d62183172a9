"""Meshes of separate bodies: measures against closed forms, matching by an independent route."""

import re
from dataclasses import replace

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import (
    bolted_plates,
    bolted_plates_section,
    box,
    c_beams,
    check_contact,
    check_mesh,
    graded_lines,
    separate,
    stacked_blocks,
)
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import flat_lists, tensor_grid
from fenics_joints.meshes.skin import add_faces, facets_between
from fenics_joints.meshes.tagged import MeshLists, distribute
from fenics_joints.parallel import on_root

COMM = MPI.COMM_WORLD
X, Y = graded_lines([0, 0.5, 1], [0.1, 0.3, 0.1]), np.array([0, 0.2, 0.5, 0.6])
LOW, HIGH = np.array([-0.5, -0.2, 0]), np.array([0, 0.1, 0.3])
SMALL_BEAMS = {
    "element_size": 6e-3, "radial_size": 3e-3, "middle_size": 25e-3, "n_thickness": (2, 1),
}  # fmt: skip


def integral(tagged, integrand):
    return COMM.allreduce(fem.assemble_scalar(fem.form(integrand)))


def parts(tagged, weight=None):
    """Integral of the weight over each part; of 1 if there is none."""
    dx = ufl.Measure("dx", tagged.mesh, subdomain_data=tagged.cell_tags)
    one = fem.Constant(tagged.mesh, 1.0) if weight is None else weight(tagged.mesh)
    return {name: integral(tagged, one * dx(tag)) for name, tag in tagged.cell_names.items()}


def faces(tagged, weight=None):
    """Integral of the weight over each exterior face; one in the inside of a body has none."""
    ds = ufl.Measure("ds", tagged.mesh, subdomain_data=tagged.facet_tags)
    one = fem.Constant(tagged.mesh, 1.0) if weight is None else weight(tagged.mesh)
    return {name: integral(tagged, one * ds(tag)) for name, tag in tagged.facet_names.items()}


def corners_and_sides(tagged, name):
    """Sorted vertices of a face, without repetition, and the parts of the cells behind it."""
    mesh, fdim = tagged.mesh, tagged.mesh.topology.dim - 1
    facets = tagged.facet_tags.find(tagged.facet_tag(name))
    facets = facets[facets < mesh.topology.index_map(fdim).size_local]
    mesh.topology.create_connectivity(0, fdim + 1)
    links, to_vertex = (mesh.topology.connectivity(fdim, dim) for dim in (fdim + 1, 0))
    parts = {int(tagged.cell_tags.values[c]) for f in facets for c in links.links(f)}
    vertices = np.unique([to_vertex.links(f) for f in facets]).astype(np.int32)
    x = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 0, vertices)] if len(facets) else []
    gathered = COMM.allgather((np.round(np.reshape(x, (-1, 3)), 12) + 0.0, parts))
    return np.unique(np.vstack([x for x, _ in gathered]), axis=0), set.union(
        *(parts for _, parts in gathered)
    )


def assert_pair(tagged, lower, upper, parts):
    below, behind = corners_and_sides(tagged, lower)
    above, before = corners_and_sides(tagged, upper)
    np.testing.assert_array_equal(below, above)
    assert behind == {tagged.cell_tag(parts[0])} and before == {tagged.cell_tag(parts[1])}
    match = check_contact(tagged, lower, upper)
    assert match.vertices == len(below) and match.distance == 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_small_block_on_a_big_one(cell):
    plan = [X] if cell in ("quadrilateral", "triangle") else [X, Y]
    x0, x1, y1 = X[1], X[-3], Y[2]
    span = (x0, x1) if len(plan) == 1 else ((x0, x1), (0.0, y1))
    tagged = stacked_blocks(COMM, lower=(*plan, LOW), upper=HIGH, upper_span=span, cell=cell)
    width, depth = x1 - x0, (1.0, 1.0) if len(plan) == 1 else (0.6, y1)
    big, small = depth
    assert parts(tagged) == pytest.approx({"lower": 0.5 * big, "upper": 0.3 * width * small})
    ends = 0.5 * big + 0.3 * small
    expected = {"interface_lower": width * small, "interface_upper": width * small, "bottom": big}
    expected |= {"top": width * small, "left": ends, "right": ends}
    if len(plan) == 2:
        expected |= dict.fromkeys(("front", "back"), 0.5 + 0.3 * width)
    assert faces(tagged) == pytest.approx(expected)
    assert check_mesh(tagged).bodies == 2
    assert_pair(tagged, "interface_lower", "interface_upper", ("lower", "upper"))


def test_lines_grow_from_size_to_size():
    lines = graded_lines([1.0, 3.0, 4.0], [0.05, 0.4, 0.4])
    steps = np.diff(lines)
    assert {1.0, 3.0, 4.0} <= set(lines) and steps.max() <= 0.4 + 1e-12
    first = steps[lines[1:] <= 3.0]
    np.testing.assert_allclose(first[1:] / first[:-1], first[1] / first[0])
    assert 0.04 < first[0] < 0.06 and 0.35 < first[-1] <= 0.4
    np.testing.assert_allclose(graded_lines([0, 1], [0.25, 0.25]), np.linspace(0, 1, 5))


def three_layers(cell):
    """Three layers of cells, the third part beside the second; faces across and outside."""
    points, quads = tensor_grid(np.arange(4.0), np.arange(3.0))
    right = points[quads][:, :, 0].mean(axis=1) > 2
    names = {"a": 1, "b": 2, "c": 3}
    if cell in ("quadrilateral", "triangle"):
        top = points[quads][:, :, 1].mean(axis=1) > 1
        return flat_lists(points, quads, np.where(top, 2 + right, 1), cell, names)
    values = np.array([np.ones(len(quads), int), 2 + right])
    column = Extrusion(points, quads, np.arange(3.0), values, cell)
    return MeshLists(cell, *column.lists(), names, {})


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_three_bodies_meet_and_tags_stay(cell):
    def build():
        lists = three_layers(cell)
        names = ("a", "b"), ("a", "c"), ("b", "c")
        tags = {f"{p}{q}": facets_between(lists, p, q) for p, q in names}
        named = {("a", "b"): ("a_b", "b_a"), ("b", "c"): ("b_c", "c_b")}
        return separate(add_faces(lists, tags), lists.cell_names, named)

    tagged = distribute(COMM, on_root(COMM, build))
    depth = 1.0 if cell in ("quadrilateral", "triangle") else 2.0
    # The old tags of named pairs are replaced; that of the third pair stays, with the first body.
    expected = {"a_b": 2 * depth, "b_a": 2 * depth, "b_c": depth, "c_b": depth, "ac": depth}
    assert faces(tagged) == pytest.approx(expected)
    assert corners_and_sides(tagged, "ac")[1] == {1}
    assert check_mesh(tagged).bodies == 3
    assert_pair(tagged, "a_b", "b_a", "ab")
    assert_pair(tagged, "c_b", "b_c", "cb")


@pytest.mark.parallel
@pytest.mark.parametrize(("layer", "bonded"), [(0.0, False), (0.0, True), (5e-4, False)])
def test_c_beams_measures(layer, bonded):
    tagged = c_beams(COMM, layer=layer, bonded=bonded, **SMALL_BEAMS)
    n = 16  # four elements along the zone's side

    def polygon(diameter):
        return n / 2 * (diameter / 2) ** 2 * np.sin(2 * np.pi / n)

    hole = polygon(8.43e-3)
    pads = 2 * (0.0497 * 0.0318 - hole)
    beam = 0.508 * 0.0318 * 9.65e-3 + pads * 3.05e-3 - 2 * hole * 9.65e-3
    expected = {"beam_1": beam, "beam_2": beam}
    assert parts(tagged) == pytest.approx(expected | ({"joint": pads * layer} if layer else {}))
    found = faces(tagged)
    wall = n * 8.43e-3 * np.sin(np.pi / n) * 2 * (25.4e-3 + layer)
    rings = {f"washer_{i}_{side}": polygon(17.46e-3) - hole for i in (1, 2)
             for side in ("lower", "upper")}  # fmt: skip
    inside = ("joint_lower", "joint_upper") if layer else ("interface",)
    between = (
        dict.fromkeys(inside, 0.0)
        if layer or bonded
        else dict.fromkeys(("interface_lower", "interface_upper"), pads)
    )
    assert found == pytest.approx({"holes": wall} | rings | between)
    assert check_mesh(tagged).bodies == (1 if layer or bonded else 2)
    if not (layer or bonded):
        assert_pair(tagged, "interface_lower", "interface_upper", ("beam_1", "beam_2"))
    x = ufl.SpatialCoordinate
    heights = faces(tagged, lambda mesh: x(mesh)[2])
    ring = rings["washer_1_lower"] * (12.7e-3 + layer / 2)
    assert heights["washer_1_lower"] == pytest.approx(-ring)
    assert heights["washer_2_upper"] == pytest.approx(ring)
    along = faces(tagged, lambda mesh: x(mesh)[0])["washer_2_upper"] / rings["washer_2_upper"]
    assert along == pytest.approx(tagged.points["bolts"][1, 0]) == pytest.approx(0.48315)


def expected_plates(given, circle, disc):
    """Volumes and areas by the circumference and the area of a disc of diameter d."""
    plates = {f"plate_{i}": (disc(0.2) - disc(0.0135)) * 0.02 for i in (1, 2)}
    if given != "plates":
        washer = (disc(0.024) - disc(0.013)) * 0.0025
        plates |= {"washer_1": washer, "washer_2": washer}
    if given == "bolt":
        half = disc(0.012) * 0.0225 + disc(0.018) * 0.0075
        plates |= {"bolt_lower": half, "bolt_upper": half}
    pairs = {"interface": disc(0.2) - disc(0.0135)}
    if given != "plates":
        pairs |= dict.fromkeys(("seat_1", "seat_2"), disc(0.024) - disc(0.0135))
    if given == "bolt":
        pairs |= dict.fromkeys(("head_1", "head_2"), disc(0.018) - disc(0.013))
        pairs["section"] = disc(0.012)
    areas = {f"{name}_{side}": area for name, area in pairs.items() for side in ("lower", "upper")}
    if given == "plates":
        ring = disc(0.024) - disc(0.0135)
        areas |= {"washer_1": ring, "washer_2": ring}
    if given == "washers":
        load = disc(0.018) - disc(0.013)
        areas |= {"load_1": load, "load_2": load}
    walls = {"hole": circle(0.0135) * 0.04, "rim": circle(0.2) * 0.04}
    return plates, areas | walls


PAIRS = {
    "interface": ("plate_1", "plate_2"), "seat_1": ("washer_1", "plate_1"),
    "seat_2": ("plate_2", "washer_2"), "head_1": ("bolt_lower", "washer_1"),
    "head_2": ("washer_2", "bolt_upper"), "section": ("bolt_lower", "bolt_upper"),
}  # fmt: skip


def assert_plates(tagged, given):
    for name, pair in PAIRS.items():
        if f"{name}_lower" in tagged.facet_names:
            assert_pair(tagged, f"{name}_lower", f"{name}_upper", pair)
    bodies = {"plates": 2, "washers": 4, "bolt": 6}
    assert check_mesh(tagged).bodies == bodies[given]


@pytest.mark.parallel
@pytest.mark.parametrize("given", ["plates", "washers", "bolt"])
def test_section_of_bolted_plates_revolved_is_round(given):
    tagged = bolted_plates_section(COMM, parts=given, size=2e-3)

    def around(mesh):
        return 2 * np.pi * ufl.SpatialCoordinate(mesh)[0]

    volumes, areas = expected_plates(
        given, lambda diameter: np.pi * diameter, lambda diameter: np.pi / 4 * diameter**2
    )
    assert parts(tagged, around) == pytest.approx(volumes)
    found = faces(tagged, around)
    assert found.pop("axis", 0.0) == pytest.approx(0.0, abs=1e-15)
    assert found == pytest.approx(areas)
    if given == "bolt":
        assert faces(tagged)["axis"] == pytest.approx(0.06)
    assert_plates(tagged, given)


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("given", "quarter", "cell"),
    [
        ("plates", False, "tetrahedron"),
        ("washers", True, "hexahedron"),
        ("bolt", False, "hexahedron"),
        ("bolt", True, "tetrahedron"),
    ],
)
def test_bolted_plates_are_polygons(given, quarter, cell):
    n, share = 16, 0.25 if quarter else 1.0
    tagged = bolted_plates(
        COMM, parts=given, quarter=quarter, cell=cell, n_around=n, size=5e-3, growth=1.5
    )
    volumes, areas = expected_plates(
        given,
        lambda diameter: share * n * diameter * np.sin(np.pi / n),
        lambda diameter: share * n / 2 * (diameter / 2) ** 2 * np.sin(2 * np.pi / n),
    )
    if quarter:
        cut = 2 * 0.02 * (0.1 - 0.00675) + 2 * 0.0025 * (0.012 - 0.0065)
        cut += (0.045 * 0.006 + 2 * 0.0075 * 0.009) if given == "bolt" else 0.0
        areas |= {"symmetry_x": cut, "symmetry_y": cut}
    assert parts(tagged) == pytest.approx(volumes)
    assert faces(tagged) == pytest.approx(areas)
    assert_plates(tagged, given)


@pytest.mark.parametrize(
    ("seats", "heads", "bodies"),
    [("bonded", "contact", 4), ("contact", "bonded", 4), ("bonded", "bonded", 2)],
)
def test_bonded_washers_share_vertices(seats, heads, bodies):
    tagged = bolted_plates_section(MPI.COMM_SELF, parts="bolt", size=3e-3, seats=seats, heads=heads)
    assert check_mesh(tagged).bodies == bodies
    assert ("seat_1_lower" in tagged.facet_names) == (seats == "contact")
    assert ("head_2_upper" in tagged.facet_names) == (heads == "contact")
    check_contact(tagged, "interface_lower", "interface_upper")


def two_blocks(change):
    """Two blocks of tetrahedra face to face, of which ``change`` alters the upper's lists."""

    def build():
        points, quads = tensor_grid(X, Y)
        values = np.ones((1, len(quads)), dtype=int)
        sides = []
        for number, z in enumerate((LOW[1:], HIGH[:2])):
            column = Extrusion(points, quads, z, values * (1 + number), "tetrahedron")
            column.tag_level(1 - number, np.ones(len(quads), dtype=bool), 1 + number)
            x, *rest = column.lists()
            sides.append(change(x.copy(), *rest) if number else (x, *rest))
        (x0, c0, v0, f0, t0), (x1, c1, v1, f1, t1) = sides
        names = {"lower": 1, "upper": 2}, {"low": 1, "high": 2}
        return MeshLists(
            "tetrahedron", np.vstack([x0, x1]), np.vstack([c0, c1 + len(x0)]),
            np.append(v0, v1), np.vstack([f0, f1 + len(x0)]), np.append(t0, t1), *names,
        )  # fmt: skip

    return distribute(COMM, on_root(COMM, build))


def moved(x, *rest):
    x[np.all(x == [X[2], 0.2, 0.0], axis=1), 0] += 0.01
    return x, *rest


def tilted(x, *rest):
    return x + [0, 0, 1e-3], *rest


def flipped(x, cells, *rest):
    # Mirrored at z = 0, into the lower block; the cells keep their orientation.
    cells = cells[:, [1, 0, 2, 3]]
    return x * [1, 1, -1], cells, *rest


def mirrored(x, cells, *rest):
    # The plan's lines are symmetric in x, the cut of the quadrilaterals is not.
    return np.column_stack([1 - x[:, 0], x[:, 1:]]), cells[:, [1, 0, 2, 3]], *rest


def cracked(x, cells, values, facets, tags):
    # One cell's corner on the face gets a vertex of its own.
    corner = facets[0, 0]
    cells, facets = cells.copy(), facets.copy()
    cell = np.flatnonzero(np.isin(cells, facets[0]).sum(axis=1) == 3)[0]
    cells[cell][cells[cell] == corner] = len(x)
    facets[0, 0] = len(x)
    return np.vstack([x, x[corner]]), cells, values, facets, tags


n_vertices = len(X) * len(Y)
BAD_PAIRS = {
    "moved": (moved, f"face 'low' has 1 of {n_vertices} vertices without a partner on 'high'; the "
                     f"farthest off is at ({X[2]:.6g}, 0.2, 0) m, its nearest neighbour 0.01 m"),
    "apart": (tilted, f"face 'low' has {n_vertices} of {n_vertices} vertices without a partner"),
    "overlap": (flipped, "the bodies overlap; check the faces' names"),
    "diagonals": (mirrored, f"have matching vertices, but {4 * (len(X) - 1) * (len(Y) - 1)} facets "
                            "without a partner"),
    "cracked": (cracked, "has vertices that coincide, so it is cracked"),
}  # fmt: skip


@pytest.mark.parallel
@pytest.mark.parametrize("case", BAD_PAIRS)
def test_faces_that_do_not_match_are_refused(case):
    change, message = BAD_PAIRS[case]
    tagged = two_blocks(change)
    check_mesh(tagged)
    with pytest.raises(MeshError, match=re.escape(message)):
        check_contact(tagged, "low", "high")


@pytest.mark.parallel
def test_bonded_bodies_are_no_contact():
    tagged = c_beams(COMM, bonded=True, **SMALL_BEAMS)
    with pytest.raises(MeshError, match="216 of 216 facets between two cells: it is inside one"):
        check_contact(tagged, "interface", "holes")
    cube = box(COMM, (1.0, 1.0, 1.0), (2, 2, 2))
    with pytest.raises(MeshError, match=re.escape("share 3 vertices, the first at (0, 0, ")):
        check_contact(cube, "x_min", "y_min")
    with pytest.raises(MeshError, match="no face named 'interface_upper'"):
        check_contact(tagged, "interface", "interface_upper")
    # Apart by more than the default tolerance, which the caller may raise.
    assert check_contact(two_blocks(tilted), "low", "high", 0.02).distance == pytest.approx(1e-3)


SECTION, PLATES = bolted_plates_section, bolted_plates
WITH_BOLT = {"parts": "bolt"}


@pytest.mark.parametrize(
    ("builder", "arguments", "message"),
    [
        (stacked_blocks, {"lower": (X,), "upper": HIGH}, "expected lines (x, height), or"),
        (stacked_blocks, {"lower": (X, -HIGH), "upper": HIGH}, "lower[1] is [-0.0, -0.1, -0.3], "),
        (stacked_blocks, {"lower": (X, HIGH), "upper": HIGH}, "expected heights that end at 0 m"),
        (stacked_blocks, {"lower": (X, LOW), "upper": LOW}, "expected heights that start at 0 m"),
        (
            stacked_blocks,
            {"lower": (X, LOW), "upper": HIGH, "upper_span": (0.1234, 1)},
            "upper_span is (0.1234, 1), expected two ascending lines of lower[0]",
        ),
        (
            stacked_blocks,
            {"lower": (X, LOW), "upper": HIGH, "cell": "hexahedron"},
            "cell is 'hexahedron', expected one of quadrilateral, triangle in 2-D",
        ),
        (c_beams, {"thickness": 0.02}, "thickness is 0.02, expected less than pad_thickness"),
        (c_beams, {"zone": 0.04}, "zone is 0.04, expected less than width = 0.0318 m"),
        (c_beams, {"washer_diameter": 0.023}, "expected less than 0.9 * zone = 0.0216 m"),
        (c_beams, {"n_thickness": 3}, "n_thickness is 3, expected two whole numbers"),
        (SECTION, {"parts": "nut"}, "parts is 'nut', expected one of plates, washers, bolt"),
        (SECTION, {"thickness": 0.02}, "thickness is 0.02, expected two lengths above 0 m"),
        (SECTION, {"fine_radius": 0.2}, "fine_radius is 0.2, expected from half washer_diameter"),
        (SECTION, {"growth": 1.0}, "growth is 1.0, expected a ratio above 1"),
        (SECTION, WITH_BOLT | {"bolt_diameter": 0.013}, "expected less than the holes, 0.013 m"),
        (SECTION, WITH_BOLT | {"head_diameter": 0.03}, "head_diameter is 0.03, expected above"),
        (SECTION, WITH_BOLT | {"seats": "glued"}, "seats is 'glued', expected 'contact' or"),
        (PLATES, WITH_BOLT | {"n_around": 12}, "n_around is 12, expected a multiple of 8"),
    ],
)
def test_impossible_dimensions_are_refused(builder, arguments, message):
    with pytest.raises(MeshError, match=re.escape(message)):
        builder(MPI.COMM_SELF, **arguments)


def test_separate_says_what_is_wrong():
    lists = three_layers("quadrilateral")
    for bodies, names, message in [
        (["a", "b"], {}, "bodies lacks c, expected each part in one body"),
        (["a", ("b", "a"), "c"], {}, "bodies has 'a' twice, expected one body for it"),
        (["a", "b", "d"], {}, "bodies has 'd', expected parts of: a, b, c"),
        ([("a", "b"), "c"], {("a", "b"): ("1", "2")}, "expected parts of two bodies, not of one"),
        ("abc", {("a", "d"): ("1", "2")}, "faces has ('a', 'd'), expected two parts of"),
    ]:
        with pytest.raises(MeshError, match=re.escape(message)):
            separate(lists, bodies, names)
    lists = replace(lists, cell_values=np.where(lists.x[lists.cells][:, :, 0].min(axis=1) < 1, 3,
                    np.where(lists.x[lists.cells][:, :, 0].max(axis=1) > 2, 2, 1)))  # fmt: skip
    with pytest.raises(MeshError, match=re.escape("faces has ('b', 'c'), expected parts that")):
        separate(lists, "abc", {("b", "c"): ("1", "2")})
