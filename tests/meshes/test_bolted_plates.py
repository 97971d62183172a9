"""Bolted plates: bodies and faces against closed forms."""

import numpy as np
import pytest
import ufl
from matching_faces import assert_pair, faces, parts
from mpi4py import MPI

from fenics_joints.meshes import bolted_plates, bolted_plates_section, check_mesh

COMM = MPI.COMM_WORLD


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
    "interface": ("plate_1", "plate_2"),
    "seat_1": ("washer_1", "plate_1"),
    "seat_2": ("plate_2", "washer_2"),
    "head_1": ("bolt_lower", "washer_1"),
    "head_2": ("washer_2", "bolt_upper"),
    "section": ("bolt_lower", "bolt_upper"),
}


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
    assert_pair(tagged, "interface_lower", "interface_upper", PAIRS["interface"])
