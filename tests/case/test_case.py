"""Case files: what they mean, and that each mistake in one gets its message."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from gmsh_files import gmsh_file
from mpi4py import MPI
from virtual_plates import plates

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError
from fenics_joints.measurements import read_test_data
from fenics_joints.meshes import box, lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, PointMass, Structure, joint, part


def test_meaning(tmp_path, write_case):
    case = load_case(write_case(tmp_path))
    nominal = case.nominal(attached=True)
    assert nominal["plates.nu"] == pytest.approx(69 / (2 * 26.9) - 1)
    assert nominal["near.E"] == 863e6 and nominal["accelerometer.mass"] == 0
    assert case.tolerances()["plates.E"] == 0.015
    assert case.start() == {"near.E": 3e9}
    data = case.measurements()
    assert data.frequencies_hz.shape == (11, 4) and data.condition_unit == "N·m"
    assert data.damping[0, 0] == pytest.approx(0.0044)
    assert data.log_sd()[0, 0] == pytest.approx(math.hypot(0.003, 12.5 / math.sqrt(12) / 375.04))
    assert data.log_sd()[0, 3] == pytest.approx(0.003)
    assert data.sensors.points[-1] == pytest.approx([0.31, 0.04, 0.0165])
    held = case.update.hold_out
    assert [*data.select(held).conditions, *data.without(held).conditions] == [
        *held,
        *(t for t in range(2, 24, 2) if t not in held),
    ]
    assert case.validation().frequencies_hz[0, 1] == 1012.46


MISTAKES = [
    ('thickness = "8 mm"', 'thickness = "8 kg"', ["mesh.thickness = '8 kg'", "a length"]),
    ('rho = "2750', 'rhoo = "2750', ["parts.plates.rhoo", "mean 'rho'", "rho is missing"]),
    ("[joints.near]", "[joint.near]", ["joint = ", "mean 'joints'"]),
    ('"lap_plates"', '"lap_plate"', ["mesh.builder = 'lap_plate'", "'lap_plates'"]),
    ('builder = "lap_plates"', "", ["mesh = ", "either builder", "or file"]),
    ('builder = "lap_plates"', 'file = "no.msh"', ["mesh.element_size", "unknown key"]),
    ('G = "26.9 GPa"', "", ["parts.plates", "either G or nu"]),
    ('G = "26.9 GPa"', 'G = "20 GPa"', ["parts.plates", "nu = 0.725", "E < 3 G"]),
    ('["joint_near"]', '["joint_naer"]', ["joints.near.cells = 'joint_naer'", "'joint_near'"]),
    ('kind = "spring"', 'kind = "line"', ["attached.rope", "'mass' or 'spring'"]),
    ('["5 mm", "195', '["15 mm", "195', ["attached.accelerometer", "x = 0.01 m"]),
    ("[attached.bolts]", "[attached.near]", ["attached.near", "joints.near"]),
    ('"frequencies.csv"', '"frequency.csv"', ["frequencies = 'frequency.csv'", "no such file"]),
    ('"bending 4"]', '"bending 5"]', ["no column 'bending 5'", "mean 'bending 4'"]),
    ('"12.5 Hz", "12.5 Hz", ', '"12.5 Hz", ', ["resolution = [12.5, 0.0, 0.0]", "4"]),
    ('"0.3 %"', '"0.3 Hz"', ["test.noise", "a ratio"]),
    ('z = ["8 mm", ', "z = [", ["test.sees", "at.z has 4 values", "5"]),
    ("at = 20", "at = 21", ["update.at = 21", "2, 4, 6"]),
    ("[4, 8", "[5, 8", ["update.hold_out[0] = 5", "was not measured"]),
    ('parameters = ["near.E"', 'parameters = ["neer.E"', ["update.parameters[0]", "'near.E'"]),
    ('start = { "near.E" = "3 GPa"', 'start = { "near.E" = "3 mm"', ["update.start.near.E"]),
    ('"2 GPa"]', '"3 MPa"]', ["joints.near.bounds.E", "8.63e+08"]),
    ("max_effects = 2", "max_effects = ", ["cannot be read as TOML", "line"]),
]


CSV_MISTAKES = [
    ("375.04", "-375.04", ["data row 1", "'bending 1'", "above 0 Hz"]),
    ("\n4,387", "\n2,387", ["torque = 2 is repeated"]),
    ("bending 2 [Hz]", "bending 2 [mm]", ["head of column 'bending 2'", "'mm'"]),
    ("bending 2 [Hz]", "bending 2", ["head of column 'bending 2'", "unit in brackets"]),
]


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [("case.toml", *row) for row in MISTAKES] + [("frequencies.csv", *row) for row in CSV_MISTAKES],
)
def test_mistakes(tmp_path, write_case, file, old, new, said):
    write_case(tmp_path, (old, new), file=file)
    with pytest.raises(InputError) as caught:
        load_case(tmp_path)
    for fragment in [str(tmp_path / file), *said]:
        assert fragment in str(caught.value)


def test_data_in_other_words(tmp_path):
    """Empty cells, other units and orders, and TOML say the same as plain CSV in hertz."""
    csv, toml = tmp_path / "f.csv", tmp_path / "f.toml"
    csv.write_text("# comment\nb [kHz];load [N];c [Hz]\n0.2;3;300\n;1;300\n", encoding="utf-8")
    columns = ('"load [N]" = [1, 3]', '"b [Hz]" = [nan, 200]', '"c [Hz]" = [300, 300]')
    toml.write_text("\n".join(columns), encoding="utf-8")
    for file in (csv, toml):
        data = read_test_data(file, condition="load")
        expected = [[np.nan, 300.0], [200.0, 300.0]]
        assert np.array_equal(data.frequencies_hz, expected, equal_nan=True)
        assert list(data.conditions) == [1, 3] and data.condition_unit == "N"


@pytest.fixture
def lap(shared_tmp_path, write_case):
    """The case of `write_case`, on all ranks."""
    if MPI.COMM_WORLD.rank == 0:
        write_case(shared_tmp_path)
    MPI.COMM_WORLD.barrier()
    return load_case(shared_tmp_path)


@pytest.mark.parallel
def test_same_as_built_by_hand(lap):
    comm = MPI.COMM_WORLD
    tagged = lap_plates(comm, element_size=0.02, n_thickness=1)
    regions = [
        part("p", ("plate_1", "plate_2"), E=69e9, nu=69 / 53.8 - 1, rho=2750),
        joint("n", "joint_near", E=863e6, G=342e6, law="isotropic"),
        joint("a", "joint_away", E=0.933e6, G=0.446e6, law="isotropic"),
    ]
    ours = solve_modes(build_structure(lap, comm), n_modes=12).frequencies_hz
    theirs = solve_modes(Structure(tagged, regions), n_modes=12).frequencies_hz
    assert ours[6:] == pytest.approx(theirs[6:], rel=1e-8)


@pytest.mark.parallel
def test_attached_masses(lap):
    """Attached masses at a value equal known ones that stand at the place they travelled to."""
    comm = MPI.COMM_WORLD
    given = {"accelerometer.mass": 0.02, "accelerometer.travel": 0.07, "bolts.mass": 0.16}
    structure = build_structure(lap, comm, attached=True)
    assert list(structure.parameters) == list(lap.nominal(attached=True))
    points = zip(
        [*lap.attached["bolts"].points, (0.08, 0.04, 0.0)], [0.08, 0.08, 0.02], strict=True
    )
    masses = [PointMass(f"m{i}", m, p) for i, (p, m) in enumerate(points)]
    plain = build_structure(lap, comm)
    by_hand = Structure(plain.tagged, plain.regions, plain.parameters.values(), masses=masses)
    modes, expected = solve_modes(structure, given, n_modes=12), solve_modes(by_hand, n_modes=12)
    assert modes.eigenvalues[6:] == pytest.approx(expected.eigenvalues[6:], rel=1e-8)
    gain = structure.total_mass(given) - structure.total_mass()
    assert gain == pytest.approx(0.18, rel=1e-9)


def test_gradient_of_shares():
    """The derivative by a mass that several points share, against central differences."""
    tagged = box(MPI.COMM_SELF, (0.2, 0.05, 0.01), (4, 1, 1))
    shares = {0.01: 0.25, 0.11: 0.75}
    masses = [PointMass(f"m{x}", "m", (x, 0.0, 0.0), share=s) for x, s in shares.items()]
    body = part("p", "body", E=69e9, nu=0.3, rho=2700)
    structure = Structure(tagged, [body], [Parameter("m", 0.05, "kg")], masses=masses)
    step = 1e-4
    low, high = (solve_modes(structure, {"m": 0.05 + h}, n_modes=9) for h in (-step, step))
    slopes = (high.eigenvalues - low.eigenvalues) / (2 * step)
    found = solve_modes(structure, n_modes=9).gradients([6, 7, 8])[:, 0]
    assert found == pytest.approx(slopes[6:], rel=1e-4)


SUPPORTED = """
[masses.block]
points = [["310 mm", "40 mm", "8 mm"]]
mass = "1 kg"
[springs.rope]
points = [["300 mm", "0 mm", "8 mm"]]
direction = [0, 0, 2]
stiffness = "1 kN/m"
[supports.clamp]
facets = "end_1"
"""


def test_supports_masses_and_springs(tmp_path):
    bonded = plates("").replace("n_thickness = 1", "n_thickness = 1\nlayer = 0")
    (tmp_path / "case.toml").write_text(bonded + SUPPORTED)
    structure = build_structure(load_case(tmp_path), MPI.COMM_SELF)
    held = solve_modes(structure, n_modes=2)
    assert held.n_rigid == 0
    assert structure.springs[0].direction == (0, 0, 1)
    # First mode by hand: a clamped beam in bending with most of the mass at its end; the lap is
    # twice as thick. Deflection of the end under a unit force there, by Castigliano.
    flexibility, reach = 0.0, 0.31
    for start, end, thickness in [(0, 0.12, 0.008), (0.12, 0.2, 0.016), (0.2, 0.31, 0.008)]:
        inertia = 0.08 * thickness**3 / 12
        flexibility += ((reach - start) ** 3 - (reach - end) ** 3) / (3 * 69e9 * inertia)
    # Rayleigh: the beam's own 0.7 kg counts for about a quarter.
    mass = 1 + 0.24 * structure.total_mass() - 0.24
    frequency = math.sqrt((1 / flexibility + 1000) / mass) / (2 * math.pi)
    assert held.frequencies_hz[0] == pytest.approx(frequency, rel=0.05)


def test_groups_of_a_file_are_checked(tmp_path, write_case):
    """A mesh without a joint is refused with the key that names the joint."""
    write_case(tmp_path, ("n_thickness = 1", "n_thickness = 1\nlayer = 0"))
    with pytest.raises(InputError, match="joints.near.cells = 'joint_near': is not in the mesh"):
        build_structure(load_case(tmp_path), MPI.COMM_SELF)


BAR = """
[mesh]
file = "bar.msh"
scale = "1 mm"
[parts.bar]
cells = "bar"
E = "200 GPa"
nu = 0
rho = "7.8 g/cm3"
[supports.wall]
"""


def test_mesh_from_a_file(tmp_path):
    """A gmsh file in millimetres, whose weight and held modes are those of the solid it is."""
    pytest.importorskip("gmsh")
    with gmsh_file(tmp_path / "bar.msh", MeshSizeMin=15) as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 100, 20, 10)
        gmsh.model.occ.synchronize()
        # OpenCASCADE's order of faces: the first is at x = 0; and an edge of it along y or z.
        edge = abs(gmsh.model.getBoundary([(2, 1)])[0][1])
        for dim, tag, name in [(3, 1, "bar"), (2, 1, "end"), (1, edge, "edge")]:
            gmsh.model.addPhysicalGroup(dim, [tag], name=name)
        gmsh.model.mesh.generate(3)

    def case(support):
        (tmp_path / "case.toml").write_text(BAR + support)
        return load_case(tmp_path)

    structure = build_structure(case('facets = "end"'), MPI.COMM_SELF)
    assert structure.total_mass() == pytest.approx(7800 * 0.1 * 0.02 * 0.01, rel=1e-9)
    # Euler and Bernoulli's cantilever; shear takes about 1 % off.
    frequency = 1.8751**2 / (2 * math.pi) * math.sqrt(200e9 / 7800 / 12) * 0.01 / 0.1**2
    modes = solve_modes(structure, n_modes=1)
    assert modes.frequencies_hz[0] == pytest.approx(frequency, rel=0.02)
    # Hinged at a line of one end, the bar has one rigid motion; and none with points of the other.
    hinge = 'points = "edge"\n'
    hinged = build_structure(case(hinge), MPI.COMM_SELF)
    size = np.ptp(hinged.tagged.points["edge"], axis=0)
    assert sorted(size) in (pytest.approx([0, 0, 0.01]), pytest.approx([0, 0, 0.02]))
    assert solve_modes(hinged, n_modes=2).n_rigid == 1
    tip = '[supports.tip]\npoints = [["100 mm", "0 mm", "0 mm"], ["100 mm", "20 mm", "10 mm"]]\n'
    assert solve_modes(build_structure(case(hinge + tip), MPI.COMM_SELF), n_modes=2).n_rigid == 0
    with pytest.raises(InputError, match="supports.tip.*expected either facets or points"):
        case(hinge + tip + 'facets = "end"')
    with pytest.raises(InputError, match="supports.wall.facets = 'ends'.* mean 'end'"):
        build_structure(case('facets = "ends"'), MPI.COMM_SELF)


@pytest.mark.smoke
def test_demo_is_a_good_case():
    case = load_case(Path(__file__).parents[2] / "demos" / "lap_plates")
    assert case.measurements().frequencies_hz.shape == (11, 4)
    assert case.validation().conditions == [28]


def test_published_frequencies_go_with_the_modes_that_are_left_out():
    case = load_case(Path(__file__).parents[2] / "demos" / "dumbbell")
    hz = case.update.published.frequencies
    fewer = case.without_modes([1, 4])
    assert fewer.update.published.frequencies == [hz[i] for i in (0, 2, 3, 5)]
    assert len(fewer.measurements().mode_names) == len(hz) - 2
    assert case.with_modes([0, 2]).update.published.frequencies == [hz[0], hz[2]]
    assert case.update.published.frequencies == hz
