"""Assemblies from STEP: measures against the drawing, modes against hexahedra."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matching_faces import faces, parts
from mpi4py import MPI
from step_files import FLANGE_BOLTS, bores, bracket, dumbbell_halves, flanges, spigot
from step_meshes import meshed

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, dumbbell, measure_ring, read_step
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal import solve_modes
from fenics_joints.preload import check_contact
from fenics_joints.structure import Structure, part, transition

COMM = MPI.COMM_WORLD
MM, MM2, MM3 = 1e-3, 1e-6, 1e-9
CIRCLE = 12
#: Area of a polygon of so many corners on a circle, as a share of the circle's.
POLYGON = np.sin(2 * np.pi / CIRCLE) / (2 * np.pi / CIRCLE)


def shared(folder, draw, labels=(), **given):
    """The mesh of a drawing on all ranks."""
    if COMM.rank == 0:
        write_step(folder / "assembly.step", draw, labels)
    COMM.barrier()
    return read_step(folder / "assembly.step", COMM, circle=CIRCLE, **given)


@pytest.mark.parallel
def test_flanges_hold_together_by_rings(shared_tmp_path):
    """A clearance hole over a tapped one, faces 0.4 mm apart: every measure against the drawing."""
    names = {"bed": "Bed casting", "column": (0.06, 0.03, 0.03)}
    points = {"ground": (0.01, 0.01, 0), "sides": [(0, 0.03, 0.01), (0.02, 0.03, 0.03)]}
    sizes = {"element_size": 25 * MM, "r_wai": 11 * MM, "layer": 0.5 * MM, "ring_size": 5 * MM}
    labels = "Bed casting", "foot/2"
    tagged = shared(shared_tmp_path, flanges(0.4, 5.1), labels, parts=names, faces=points, **sizes)
    rings = [f"ring_{i}" for i in (1, 2, 3, 4)]
    assert list(tagged.cell_names) == ["bed", "column", *rings]
    assert check_mesh(tagged).bodies == 1
    found = parts(tagged)
    for name, box, radius, height in (("bed", 120e3, 6, 20), ("column", 72e3, 5.1, 15)):
        bored = 4 * np.pi * radius**2 * height
        assert box - bored < found[name] / MM3 <= box - POLYGON * bored * (1 - 1e-9)
    annulus = np.pi * (11**2 - 6**2)
    for i, (name, bolt) in enumerate(zip(rings, FLANGE_BOLTS, strict=True)):
        ring = measure_ring(tagged, name)
        centre = np.array([*bolt, 20.25]) * MM
        assert np.allclose([ring.centre, tagged.points["bolts"][i]], centre, atol=1e-9)
        assert np.allclose([ring.thickness, ring.r_nei, ring.r_wai], [5e-4, 6e-3, 11e-3], rtol=1e-6)
        assert np.allclose(ring.normal, [0, 0, 1]) and (ring.lower, ring.upper) == (
            ("bed",),
            ("column",),
        )
        # Not all circles have so many corners, some more: the inner one lacks more, or less.
        assert ring.area / MM2 == pytest.approx(annulus, rel=1 - POLYGON)
        assert found[name] == pytest.approx(ring.area * 0.5 * MM, rel=1e-9)
    area = faces(tagged)
    # Rings' faces are inside, open faces and named ones on the surface; the foot moved by 0.1 mm.
    joint = faces(tagged, inner=True)["joint_lower"]
    assert joint == pytest.approx(sum(found[r] for r in rings) / (0.5 * MM), rel=1e-9)
    assert area["joint_lower"] == area["joint_upper"] == 0
    assert area["bed_to_column"] == pytest.approx(area["column_to_bed"], rel=1e-9)
    holes = 4 * np.pi * 36 * MM2
    assert area["bed_to_column"] + joint == pytest.approx(80 * 60 * MM2 - holes, rel=1e-2)
    assert area["ground"] == pytest.approx(100 * 60 * MM2 - holes, rel=1e-2)
    assert area["sides"] == pytest.approx(60 * (20 + 15) * MM2, rel=1e-9)
    top = COMM.allreduce(float(tagged.mesh.geometry.x[:, 2].max()), op=MPI.MAX)
    assert top == pytest.approx(35.5 * MM, rel=1e-12)


def test_unit_of_the_file(tmp_path):
    """The same numbers in metres are a thousand times as large; a caller's gmsh stays as it is."""
    import gmsh

    path = write_step(tmp_path / "a.step", flanges())
    text = path.read_text(encoding="utf-8")
    text = text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)")
    (tmp_path / "metres.step").write_text(text, encoding="utf-8")
    size = {"element_size": 40.0, "r_wai": 11.0, "circle": 6, "layer": 0.7, "ring_size": 9.0}
    tagged = read_step(tmp_path / "metres.step", MPI.COMM_SELF, **size)
    assert np.ptp(tagged.mesh.geometry.x, axis=0) == pytest.approx([100, 60, 35.7], rel=1e-6)
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("mine")
    read_step(path, MPI.COMM_SELF, **{k: v if k == "circle" else v * MM for k, v in size.items()})
    assert gmsh.model.getCurrent() == "mine"
    gmsh.model.occ.importShapes(str(path))
    assert np.diff(np.reshape(gmsh.model.occ.getBoundingBox(3, 1), (2, 3)), axis=0)[0] == (
        pytest.approx([100, 60, 20], rel=1e-4)
    )
    gmsh.finalize()


@pytest.mark.parallel
def test_modes_of_the_dumbbell(shared_tmp_path):
    """Tetrahedra from STEP and the hexahedra of our builder have the same six frequencies."""
    centres, layer, r_wai = [(-0.035, 0.0), (0.035, 0.0)], 0.657 * MM, 20 * MM
    sizes = {"element_size": 60 * MM, "ring_size": 8 * MM, "r_wai": r_wai, "layer": layer}
    cad = shared(shared_tmp_path, dumbbell_halves, parts={"lower": 1, "upper": 2}, **sizes)
    blocks = {"head": (0.16, 0.12, 0.03), "neck": (0.12, 0.063, 0.02), "element_size": 0.025}
    bolts = {"rings": centres, "r_wai": r_wai, "r_nei": 8.75 * MM, "holes": True}
    hexahedra = dumbbell(COMM, **blocks, **bolts)
    body, rings = {"E": 1.3e11, "nu": 0.27, "rho": 7850.0}, ("ring_1", "ring_2")
    frequencies = []
    for tagged in (cad, hexahedra):
        solids = tuple(name for name in tagged.cell_names if name not in rings)
        ring = transition("rings", rings, E=1513e6, nu=0.201, h=layer, meshed=layer)
        structure = Structure(tagged, [part("halves", solids, **body), ring], degree=2)
        frequencies.append(solve_modes(structure, n_modes=12).frequencies_hz)
    assert np.all(np.array(frequencies)[:, :6] < 1)
    assert frequencies[0][6:] == pytest.approx(frequencies[1][6:], rel=0.01)


def test_turned_bracket(tmp_path):
    """Contacts of any direction: normal, centres and the wider hole as they were drawn."""
    places = (75, 50, 12), (45, 45, 12)
    rings = {"r_wai": 11 * MM, "r_nei": 6 * MM, "ring_size": 5 * MM, "layer": 0.7 * MM}
    bolts = [turned(*place) for place in places]
    tagged = meshed(tmp_path, bracket, bolts=bolts, n_layer=2, **rings)
    normal = turned(0, 0, 1000)
    for i, place in enumerate(places, start=1):
        ring = measure_ring(tagged, f"ring_{i}")
        assert np.allclose(ring.normal, normal, atol=1e-9)
        assert np.allclose(ring.centre, turned(*place) + 0.35 * MM * normal, atol=1e-8)
        assert np.allclose([ring.thickness, ring.r_nei], [7e-4, 6e-3], rtol=1e-6)


def turned(*place):
    """A place of the drawing in metres after its rotation by 0.7 about (1, 2, -0.5)."""
    k = np.array([1, 2, -0.5]) / np.linalg.norm([1, 2, -0.5])
    x = np.array(place) * MM
    return x * np.cos(0.7) + np.cross(k, x) * np.sin(0.7) + k * (k @ x) * (1 - np.cos(0.7))


def test_layer_and_contact(tmp_path):
    """All that touches as one layer; or two bodies whose faces match, round a collar too."""
    given = {"element_size": 25 * MM, "parts": {"lower": 1, "upper": 2}}
    layer = meshed(tmp_path, spigot, joint="layer", layer=1 * MM, **given)
    assert list(layer.cell_names) == ["lower", "upper", "joint"]
    ring = measure_ring(layer, "joint")
    assert ring.thickness == pytest.approx(1 * MM, rel=1e-9)
    flat = np.pi * (50**2 - 20**2 - 3 * 5**2) * MM2
    assert ring.area == pytest.approx(flat, rel=0.12) and ring.area < flat
    # The collar's wall is open: no layer, and no common vertices.
    wall = faces(layer)["lower_to_upper"]
    assert wall == pytest.approx(2 * np.pi * 20 * 5 * MM2, rel=0.1)
    assert check_mesh(layer).bodies == 1
    contact = meshed(tmp_path, spigot, joint="contact", **given)
    assert check_mesh(contact).bodies == 2
    assert len(check_contact(contact, "lower_to_upper", "upper_to_lower").facets) > 50
    area = faces(contact)["lower_to_upper"]
    assert area == pytest.approx(ring.area + wall, rel=1e-2)


def pile(occ):
    """Three blocks of 80 x 40 x 20 mm on each other, with two holes through all."""
    for z in (0, 20, 40):
        block = occ.addBox(0, 0, z, 80, 40, 20)
        occ.cut([(3, block)], bores(occ, [(20, 20), (60, 20)], z - 1, z + 21, 5))


def trough(occ):
    """Two walls on one face of a base."""
    occ.addBox(0, 0, 0, 80, 60, 8)
    for y in (0, 44):
        occ.addBox(0, y, 8, 80, 16, 20)


def test_bolts_given_by_place_where_parts_touch_on_one_plane(tmp_path):
    """Each ring is between the base and the wall that stands there."""
    given = {"ring_size": 12 * MM, "circle": 6, "r_wai": 7 * MM, "r_nei": 2 * MM}
    bolts, parts = [[0.04, y, 0.008] for y in (0.008, 0.052)], {"base": 1, "front": 2, "back": 3}
    tagged = meshed(tmp_path, trough, bolts=bolts, parts=parts, **given)
    assert [measure_ring(tagged, f"ring_{i}").upper for i in (1, 2)] == [("front",), ("back",)]


def turned_pile(occ):
    pile(occ)
    occ.rotate(occ.getEntities(3), 0, 0, 0, 1, 2, -0.5, 0.7)


def test_layers_of_a_drawing_that_is_turned_in_space(tmp_path):
    """Their areas and normal are those of the drawing as it stands."""
    tagged = meshed(tmp_path, turned_pile, joint="layer")
    assert list(tagged.cell_names)[3:] == ["joint_1", "joint_2"]
    for name in ("joint_1", "joint_2"):
        layer = measure_ring(tagged, name)
        assert np.abs(layer.normal @ turned(0, 0, 1000)) == pytest.approx(1, abs=1e-9)
        assert layer.area == pytest.approx((80 * 40 - 2 * np.pi * 5**2) * MM2, rel=0.02)


def test_pile_of_parts(tmp_path):
    """A bolt through three parts has two rings, lifted by those below; one if two are welded.

    Without a thickness of the layers nothing is lifted.
    """
    given = {"parts": {"a": 1, "b": 2, "c": 3}, "r_wai": 12 * MM, "ring_size": 8 * MM}
    lifted, there = [20.35, 20.35, 41.05, 41.05], [20, 20]
    bc = [("b", "c")]
    for layer, bonded, heights in (
        (0.7 * MM, [], lifted),
        (0.7 * MM, bc, lifted[:2]),
        (None, bc, there),
    ):
        tagged = meshed(tmp_path, pile, bonded=bonded, layer=layer, **given)
        assert tagged.points["bolts"][:, 2] / MM == pytest.approx(heights)
        assert check_mesh(tagged).bodies == 1
        top = tagged.mesh.geometry.x[:, 2].max() / MM
        layers = len(heights) / 2 if layer else 0
        assert top == pytest.approx(60 + 0.7 * layers, abs=2e-3)
        assert ("b_to_c" in tagged.facet_names) == (not bonded)
    assert measure_ring(tagged, "ring_2").upper == ("b",)


def test_labels(tmp_path):
    """Accents are spelt out, and labels with slashes or of two solids are told apart."""
    sizes = {"element_size": 0.04, "r_wai": 11 * MM, "circle": 6, "ring_size": 9 * MM}
    labels = "Größe Éq", "M12/Fuß"
    tagged = meshed(tmp_path, flanges(), labels, parts={"foot": "M12/Fuß"}, **sizes)
    assert list(tagged.cell_names)[:2] == ["Groesse_Eq", "foot"]
    path = write_step(tmp_path / "b.step", flanges(), ("plate", "plate"))
    with pytest.raises(MeshError, match="fits 2 solids") as told:
        read_step(path, MPI.COMM_SELF, parts={"bed": "plate"}, **sizes)
    # gmsh numbers the instances of all files that it writes.
    first, second = re.findall(r"/(\d+/plate)'", str(told.value))
    assert first != second
    tagged = read_step(path, MPI.COMM_SELF, parts={"top": second}, **sizes)
    assert list(tagged.cell_names)[:2] == ["plate", "top"]
