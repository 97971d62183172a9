"""Joints of one's own mesh that has no layer, from the case file to frequencies."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
from gmsh_files import gmsh_file
from mpi4py import MPI
from step_files import flanges
from touching_blocks import HALF, PART, WIDTH, E, bar_frequency, write_bar

from fenics_joints.case import build_structure, load_case, test_notes
from fenics_joints.commands.update.run import run_update
from fenics_joints.diagnosis.model.subject import subject_of
from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import measure_ring
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal import solve_modes

COMM = MPI.COMM_WORLD
K_N, K_T = 2e12, 5e11
MESH = '[mesh]\nfile = "bar.msh"\nscale = "1 mm"\njoint = "layer"\n'
STEP = """
[mesh]
file = "bar.step"
size = "13 mm"
joint = "layer"
parts = {one = 1, two = 2}
[mesh.faces]
sides = [
  ["5 mm", "5 mm", "0 mm"], ["5 mm", "5 mm", "10 mm"], ["5 mm", "0 mm", "5 mm"],
  ["5 mm", "10 mm", "5 mm"], ["105 mm", "5 mm", "0 mm"], ["105 mm", "5 mm", "10 mm"],
  ["105 mm", "0 mm", "5 mm"], ["105 mm", "10 mm", "5 mm"],
]
"""
SPRINGS = f'[joints.glue]\nlaw = "springs"\ncells = "joint"\nk_n = "{K_N} Pa/m"\nk_t = {K_T}\n'


def held(directions: str) -> str:
    return f'[supports.sides]\nfacets = "sides"\ndirections = {list(directions)}\n'


def built(folder, text: str):
    if COMM.rank == 0:
        (folder / "case.toml").write_text(text, encoding="utf-8")
    COMM.barrier()
    case = load_case(folder)
    return case, build_structure(case, COMM)


def first_modes(folder, text: str, n: int = 3) -> np.ndarray:
    return solve_modes(built(folder, text)[1], n_modes=n).frequencies_hz


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["hexahedron", "tetrahedron", "own vertices", "STEP"])
def test_bar_on_springs(shared_tmp_path, kind):
    """Two free halves on springs: along the bar and across it, as in closed form."""
    if COMM.rank == 0 and kind == "STEP":
        write_step(shared_tmp_path / "bar.step", _halves)
    elif COMM.rank == 0:
        cell = "tetrahedron" if kind == "tetrahedron" else "hexahedron"
        write_bar(shared_tmp_path / "bar.msh", cell, shared=kind != "own vertices")
    text = (STEP if kind == "STEP" else MESH) + PART + SPRINGS
    along = first_modes(shared_tmp_path, text + held("yz"))
    # The whole bar moves freely; half a wave, with the springs at its middle, comes next.
    assert along[1] == pytest.approx(bar_frequency(K_N, E), rel=1e-4)
    across = first_modes(shared_tmp_path, text + held("xz"))
    assert across[1] == pytest.approx(bar_frequency(K_T, E / 2), rel=1e-4)


def _halves(occ):
    length, width = 1e3 * HALF, 1e3 * WIDTH
    for x in (0, length):
        occ.addBox(x, 0, 0, length, width, width)


def test_nothing_moves(tmp_path):
    """A grown layer is thin and moves no end of the bar, also when turned; a note says so."""
    for turn in (0.0, 0.7):
        write_bar(tmp_path / "bar.msh", "tetrahedron", turn=turn)
        case, structure = built(tmp_path, MESH + PART + SPRINGS)
        layer = measure_ring(structure.tagged, "joint")
        assert layer.thickness == pytest.approx(1e-4 * min(structure.size_m), rel=0.8)
        assert layer.area == pytest.approx(WIDTH**2, rel=1e-6)
        assert structure.total_mass() == pytest.approx(2700 * 2 * HALF * WIDTH**2, rel=1e-4)
        assert structure.size_m[0] == pytest.approx(2 * HALF, rel=1e-12) or turn
        (note,) = test_notes(case, structure)
        assert "half into each part (joint between one and two, 100 mm2)" in note


def test_limit_of_meshed_layers(tmp_path):
    """Bending with layers ever thinner tends to that of the thinnest, in proportion to them."""
    write_bar(tmp_path / "bar.msh")
    text = MESH + PART + SPRINGS
    thinnest = first_modes(tmp_path, text, 8)[6]
    off = []
    for h in (0.2, 0.05):
        thicker = text.replace("[parts", f'layer = "{h} mm"\n[parts', 1)
        off.append(abs(first_modes(tmp_path, thicker, 8)[6] / thinnest - 1))
    assert np.log(off[0] / off[-1]) / np.log(4) == pytest.approx(1.0, abs=0.1)
    assert off[-1] < 2e-3


def test_started_from_pressure_and_roughness(tmp_path):
    """Without a stiffness k_n = p / (0.5 h_rms), h_rms = sqrt(pi) Ra, k_t / k_n by nu; noted."""
    write_bar(tmp_path / "bar.msh")
    text = MESH + PART + '[joints.glue]\nlaw = "springs"\ncells = "joint"\n'
    case, structure = built(tmp_path, text + 'pressure = "5 MPa"\nroughness = "2 um"\n')
    k_n = 5e6 / (0.5 * np.sqrt(np.pi) * 2e-6)
    assert structure.parameters["glue.k_n"].value == pytest.approx(k_n, rel=1e-12)
    assert structure.parameters["glue.k_t"].value == pytest.approx(k_n, rel=1e-12)  # nu = 0
    assert any("within a factor of three" in note for note in test_notes(case, structure))
    with pytest.raises(InputError, match="no stiffness and no pressure is given: expected k_n"):
        built(tmp_path, text)
    with pytest.raises(InputError, match="k_n, pressure given: expected k_n and k_t; or pressure"):
        built(tmp_path, text + 'k_n = 1e12\npressure = "5 MPa"\n')


RINGS = """
[mesh]
file = "machine.{0}"
[mesh.bolts]
thread = "M12"
thickness = "8 mm"
force = "20 kN"
[parts.frame]
cells = ["bed", "column"]
E = "150 GPa"
nu = 0.25
rho = "7200 kg/m3"
[joints.bolts]
law = "springs"
cells = "ring_*"
"""


def write_flanges(folder, kind: str) -> str:
    """The flanges as STEP or .msh, and the case's text."""
    write_step(folder / "machine.step", flanges())
    if kind == "step":
        more = 'size = "30 mm"\nring_size = "5 mm"\ncircle = 12\nparts = {bed = 1, column = 2}'
        return RINGS.format("step").replace("[mesh.bolts]", more + "\n[mesh.bolts]", 1)
    with gmsh_file(folder / "machine.msh", MeshSizeMax=5, MeshSizeFromCurvature=12) as gmsh:
        bed, column = (tag for _, tag in gmsh.model.occ.importShapes(str(folder / "machine.step")))
        gmsh.model.occ.fragment([(3, bed)], [(3, column)])
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [bed], 1, "bed")
        gmsh.model.addPhysicalGroup(3, [column], 2, "column")
        gmsh.model.mesh.generate(3)
    return RINGS.format("msh").replace("[mesh.bolts]", 'scale = "1 mm"\n[mesh.bolts]', 1)


def test_rings_of_both_kinds_of_files(tmp_path):
    """Rings at the holes, drawn on a STEP file's faces, picked by facets in a .msh; their start."""
    found = {}
    for kind in ("step", "msh"):
        text = write_flanges(tmp_path, kind)
        case, structure = built(tmp_path, text.replace("[mesh]", "[mesh]\ndegree = 1"))
        bolts = 1e-3 * np.array([(x, y, 20) for x in (45, 85) for y in (15, 45)])
        assert structure.tagged.points["bolts"] == pytest.approx(bolts, abs=1e-6)
        areas = [ring.area for ring in structure.rings()]
        assert len(areas) == 4
        found[kind] = sum(areas), structure.parameters["bolts.k_n"].value
    # A cone of 30 degrees under the head (18 mm across flats) through 8 mm.
    r_wai, r_nei = 9e-3 + 8e-3 * np.tan(np.pi / 6), 6.75e-3
    ring = np.pi * (r_wai**2 - r_nei**2)
    k_n = 20e3 / ring / (0.5 * np.sqrt(np.pi) * 1.6e-6)
    assert found["step"][1] == pytest.approx(k_n, rel=1e-9)
    assert found["step"][0] == pytest.approx(found["msh"][0], rel=0.15)


def _joined(occ, body: int, tool: int):
    """A body, less a tool, and the tool in its place."""
    rest, _ = occ.cut([(3, body)], [(3, tool)], removeTool=False)
    occ.fragment(rest, [(3, tool)])


def _step_in_a_block(occ):
    _joined(occ, occ.addBox(0, 0, 0, 40, 20, 20), occ.addBox(20, 0, 10, 20, 20, 10))


def _two_on_one(occ):
    upper = [(3, occ.addBox(x, 0, 10, 20, 20, 10)) for x in (0, 20)]
    occ.fragment([(3, occ.addBox(0, 0, 0, 40, 20, 10))], upper)


def _shaft_in_a_hub(occ):
    _joined(occ, occ.addBox(-30, -30, 0, 60, 60, 20), occ.addCylinder(0, 0, -10, 0, 0, 40, 10))


def _plates_in_the_plane(occ):
    plates = [(2, occ.addRectangle(0, y, 0, 40, 10)) for y in (0, 10)]
    occ.fragment(plates[:1], plates[1:])
    occ.rotate(occ.getEntities(2), 0, 0, 0, 0, 0, 1, 0.4)


STIFF = '[joints.{0}]\nlaw = "springs"\ncells = "{0}"\nk_n = 9e16\nk_t = 3e16\n'
METAL = '[joints.{0}]\nlaw = "isotropic"\ncells = "{0}"\nE = 7e10\nG = 26.923e9\n'


@pytest.mark.parametrize(
    ("draw", "law", "joints"),
    [
        (_step_in_a_block, STIFF, ["joint_1", "joint_2"]),
        (_two_on_one, STIFF, ["joint_1", "joint_2", "joint_3"]),
        (_shaft_in_a_hub, METAL, ["joint"]),
        (_plates_in_the_plane, STIFF, ["joint"]),
    ],
)
def test_as_stiff_as_metal(tmp_path, draw, law, joints):
    """Layers in corners, where three parts meet, on a curved face and in the plane vanish."""
    with gmsh_file(tmp_path / "bar.msh", MeshSizeMax=10, MeshSizeFromCurvature=16) as gmsh:
        draw(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        dim = gmsh.model.getDimension()
        names = [f"p{tag}" for _, tag in gmsh.model.getEntities(dim)]
        for name in names:
            gmsh.model.addPhysicalGroup(dim, [int(name[1:])], int(name[1:]), name)
        gmsh.model.mesh.generate(dim)
    part = PART.replace('["one", "two"]', str(names)).replace("nu = 0.0", "nu = 0.3")
    text = MESH + f"degree = 1\ngdim = {dim}\n" + part
    whole = first_modes(tmp_path, text.replace('joint = "layer"\n', ""), 9)
    glued = first_modes(tmp_path, text + "".join(law.format(name) for name in joints), 9)
    assert glued[6:] == pytest.approx(whole[6:], rel=2e-4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"layer"', '"layer"\nlayer = "2 mm"', "layer is 2 mm, which is grown into the parts"),
        ('"layer"', '"layer"\nbetween = [["one", "three"]]', r"between has \['one', 'three'\]"),
        ('"layer"', '"layer"\nbonded = [["one", "two"]]', "no two of the parts 'one', 'two' touch"),
        ('joint = "layer"', "[mesh.bolts]\nr_wai = 0.004", "no bolt: expected round holes of 0 to"),
        (
            'joint = "layer"',
            '[mesh.bolts]\nr_wai = 0.002\nat = ["0.1 m", "5 mm", "5 mm"]',
            "bolt 1 at .100, 5, 5. mm: 0 facets of the mesh have their middle between 0 and 2 mm",
        ),
        (
            'joint = "layer"',
            '[mesh.bolts]\nr_wai = 0.02\nat = ["100 m", "5 mm", "5 mm"]',
            "bolt 1 at .* mm: no two flat faces touch within 20 mm",
        ),
    ],
)
def test_refusals(tmp_path, old, new, message):
    write_bar(tmp_path / "bar.msh")
    text = (MESH.replace(old, new) + PART + SPRINGS).replace('cells = "joint"', 'cells = "*"')
    with pytest.raises(MeshError, match=message):
        built(tmp_path, text)


def test_update_finds_the_springs(tmp_path):
    """From twice the stiffness; the command says what was grown."""
    write_bar(tmp_path / "bar.msh")
    text = MESH + PART + SPRINGS
    hertz = first_modes(tmp_path, text, 14)[6:]
    start = text.replace(f"{K_N}", f"{2 * K_N}").replace(f"{K_T}", f"{2 * K_T}")
    header = ",".join(f"mode {i} [Hz]" for i in range(1, 9))
    (tmp_path / "test.csv").write_text(f"{header}\n{','.join(map(repr, hertz.tolist()))}\n")
    start += '[test]\nfrequencies = "test.csv"\nnoise = "0.1 %"\n'
    start += '[update]\nparameters = ["glue.k_n", "glue.k_t"]\n'
    case, _ = built(tmp_path, start)
    outcome = run_update(case, COMM)
    found = {p["name"]: p["value"] for p in outcome.json()["parameters"]}
    assert found == pytest.approx({"glue.k_n": K_N, "glue.k_t": K_T}, rel=1e-3)
    assert any("half into each part" in note for note in outcome.json()["notes"])


@pytest.mark.parametrize("nominal", ["bonded", "given"])
def test_zones_of_a_diagnosis(tmp_path, nominal):
    """Springs become zones round the bolt, as stiff as the case says or bonded."""
    write_bar(tmp_path / "bar.msh", "tetrahedron")
    text = MESH + PART + SPRINGS + 'bolts = [["100 mm", "0 mm", "5 mm"]]\n'
    case, structure = built(tmp_path, text + f'[diagnose]\njoints = "{nominal}"\n')
    subject = subject_of(case, COMM, Mock())
    layer = measure_ring(structure.tagged, "joint").thickness
    for zone in subject.zones:
        stiffness = subject.baseline[f"{zone.name}.E"] / zone.thickness
        assert zone.thickness == pytest.approx(layer, rel=1e-6)
        assert stiffness == pytest.approx(K_N if nominal == "given" else E / layer, rel=1e-3)
        assert zone.bolt == "bolt 1"
    assert sum(zone.area for zone in subject.zones) == pytest.approx(WIDTH**2, rel=1e-3)
