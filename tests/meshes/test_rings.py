"""Bolts' rings tagged in a user's ``.msh``: found, measured, and refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from gmsh_files import gmsh_file
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import MeshError
from fenics_joints.meshes import layer_thickness, measure_ring, read_msh
from fenics_joints.modal import solve_modes

COMM = MPI.COMM_WORLD
CENTRES = [(0.02, 0.02), (0.062, 0.018)]
R_NEI, R_WAI = 0.006, 0.012
Z = "[0, 0, 1]"


def rings_between_plates(path, layers=(0.002, 0.002), turn=0.0, short=None):
    """Write two plates of 80 x 40 x 10 mm with a ring between at each centre.

    With two thicknesses the upper plate has a step; ``turn`` is about y; the ring ``short`` ends
    below the upper plate. Groups: lower, upper, ring_1, ring_2; foot.
    """
    with gmsh_file(path, MeshSizeMax=0.012, MeshSizeFromCurvature=12) as gmsh:
        occ = gmsh.model.occ
        lower = [(3, occ.addBox(0, 0, -0.01, 0.08, 0.04, 0.01))]
        low = zip((0, 0.04), layers, strict=True)
        halves = [(3, occ.addBox(x, 0, h, 0.04, 0.04, 0.012 - h)) for x, h in low]
        others = occ.fuse(halves[:1], halves[1:])[0]
        for number, ((x, y), h) in enumerate(zip(CENTRES, layers, strict=True), start=1):
            h *= 0.5 if number == short else 1
            full, hole = ([(3, occ.addCylinder(x, y, 0, 0, 0, h, r))] for r in (R_WAI, R_NEI))
            others += occ.cut(full, hole)[0]
        _, found = occ.fragment(lower, others)
        occ.rotate(occ.getEntities(3), 0, 0, 0, 0, 1, 0, turn)
        occ.synchronize()
        names = ["lower", "upper", "ring_1", "ring_2"]
        for number, (name, part) in enumerate(zip(names, found, strict=True), start=1):
            gmsh.model.addPhysicalGroup(3, [tag for _, tag in part], number, name)
        gmsh.model.mesh.generate(3)


def turned(x, y, z, turn):
    return np.array([x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)])


@pytest.mark.parallel
def test_rings_are_found_and_measured(shared_tmp_path):
    """Centres, radii, thickness, normal and parts as drawn, in a turned mesh on any ranks."""
    path, turn = shared_tmp_path / "rings.msh", 0.4
    if COMM.rank == 0:
        rings_between_plates(path, turn=turn)
    COMM.barrier()
    tagged = read_msh(path, COMM)
    for number, (x, y) in enumerate(CENTRES, start=1):
        ring = measure_ring(tagged, f"ring_{number}")
        centre = turned(x, y, 0.001, turn)
        assert np.allclose([ring.centre, tagged.points["bolts"][number - 1]], centre, atol=1e-8)
        sizes = ring.r_nei, ring.r_wai, ring.thickness
        assert np.allclose(sizes, [R_NEI, R_WAI, 2e-3], rtol=1e-6)
        assert np.allclose(ring.normal, turned(0, 0, 1, turn), atol=1e-9)
        assert (ring.lower, ring.upper) == (("lower",), ("upper",))
        annulus = np.pi * (R_WAI**2 - R_NEI**2)
        assert 0.9 * annulus < ring.area < annulus
    thickness = layer_thickness(tagged, ["ring_1", "ring_2"], turned(0, 0, 5, turn))
    assert thickness == pytest.approx(2e-3, rel=1e-9)


CASE = """
[mesh]
file = "rings.msh"
degree = 1
[parts.plates]
cells = ["lower", "upper"]
E = "150 GPa"
nu = 0.23
rho = "7200 kg/m3"
"""
JOINT = """
[joints.{}]
cells = {}
E = "6111 MPa"
{}
normal = {}
"""


def structure(folder, *joints):
    """The structure of a case with joints (name, cells, h in mm, normal); thin ones without h."""
    text = CASE
    for name, cells, h, normal in joints:
        law = f'law = "transition"\nnu = 0.253\nh = "{h} mm"'
        thin = 'law = "uncoupled"\nG = "2 GPa"'
        text += JOINT.format(name, cells, law if h else thin, normal)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return build_structure(load_case(folder), MPI.COMM_SELF)


def test_rings_of_two_thicknesses(tmp_path):
    """One joint for both is refused; a joint for each has the thickness of its own ring.

    At h as meshed a joint is what it is in the mesh: the same as with ``meshed`` given.
    """
    rings_between_plates(tmp_path / "rings.msh", layers=(0.002, 0.003))
    with pytest.raises(MeshError, match="joints.rings: ring_2 is 3 mm thick, ring_1 2 mm"):
        structure(tmp_path, ("rings", '"ring_*"', 2, Z))
    own = structure(tmp_path, ("a", '"ring_1"', 2, Z), ("b", '"ring_2"', 3, Z))
    given = structure(
        tmp_path,
        ("a", '"ring_1"', 2, Z + "\nmeshed = 0.002"),
        ("b", '"ring_2"', 3, Z + "\nmeshed = 0.003"),
    )
    frequencies = [solve_modes(s, n_modes=9).frequencies_hz[6:] for s in (own, given)]
    assert frequencies[0] == pytest.approx(frequencies[1], rel=1e-8)
    meshed = [region.properties["meshed"] for region in own.regions if region.is_joint]
    assert meshed == pytest.approx([2e-3, 3e-3], rel=1e-9)


FLAT = r"joints.rings: ring_1: it is flat along \(0.199, 0, 0.98\), .*not \(0, 0, 1\)"
#: Cells, thickness, normal, and what is said of them, by the drawing.
REFUSED = {
    "turned": (
        {"turn": 0.2},
        ('"ring_*"', 2, Z, "ring_1: its face towards .* is 11.5 degrees off the normal"),
        # Also where no thickness is measured: a given one, and the law of a thin layer.
        ('"ring_*"', 2, Z + "\nmeshed = 0.002", FLAT),
        ('["ring_1", "ring_2"]', None, Z, FLAT),
    ),
    "short": (
        {"short": 2},
        ('"ring_*"', 2, Z, "ring_2: it touches lower on one side only"),
        ('"ring_*"', 2, "[1, 0, 0]", "ring_1: its face towards .* is 90 degrees off the normal"),
        ('["ring_1", "ring_3"]', 2, Z, "joints.rings.cells = 'ring_3': is not in the"),
        ('"bolt_*"', 2, Z, r"joints.rings.cells = 'bolt_\*': is not in the mesh"),
        # Millimetres without a scale.
        ('"ring_1"', 0.002, Z, "rings: its layer is 2 mm thick .* h is 0.002 mm; .*scale"),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(tmp_path, name):
    """Each names the ring and what was expected."""
    drawing, *cases = REFUSED[name]
    rings_between_plates(tmp_path / "rings.msh", **drawing)
    for cells, h, normal, message in cases:
        with pytest.raises(MeshError, match=message):
            structure(tmp_path, ("rings", cells, h, normal))
