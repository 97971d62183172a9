"""``fenics-joints new``: from files alone to a case that is clean and runs without editing."""

from __future__ import annotations

import itertools
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from gmsh_files import gmsh_file
from mpi4py import MPI
from step_files import bores, bracket, joined, screws, spigot
from uff_files import mode_55, nodes_15, nodes_2411, units_164

from fenics_joints.case import build_structure, load_case
from fenics_joints.cli import main
from fenics_joints.commands.check.run import check_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.commands.new.draft import BoltHole, stacked
from fenics_joints.commands.new.run import Source, run_new
from fenics_joints.commands.new.tests import TestFiles
from fenics_joints.commands.preload import run_preload
from fenics_joints.commands.update.run import update_case
from fenics_joints.errors import InputError
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process")

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "meshes" / "data"
QUIET = Progress(silent=True)
LEFT, RIGHT = [(20, 15), (20, 65), (55, 40)], [(140, 15), (140, 65), (105, 40)]


def silent(question, answer, check):
    """The answer that is taken for granted, which must be one that can be used."""
    check(answer)
    return answer


def answers(**own):
    """What answers the questions that have a word."""

    def ask(question, answer, check):
        for word, other in own.items():
            answer = other if word in question else answer
        return silent(question, answer, check)

    return ask


def written(folder, source, tests=None, ask=silent, **more):
    """What `new` writes, and the case that stands there then."""
    found = run_new(folder, source, tests or TestFiles(), ask, QUIET, **more)
    return found, load_case(folder)


def frequencies(case, n=8):
    """Of the case's modes, as the command finds them; the first six are of a free body."""
    outcome = run_modes(case, MPI.COMM_SELF, QUIET, n_modes=n)
    return outcome.result.modes.frequencies_hz


def three_parts(occ):
    """A base, and two blocks on it with three bolts each, M8 and M10."""
    base = occ.addBox(0, 0, 0, 160, 80, 10)
    left, right = occ.addBox(0, 0, 10, 70, 80, 12), occ.addBox(90, 0, 10, 70, 80, 15)
    occ.cut([(3, base)], bores(occ, LEFT, -1, 11, 4.5) + bores(occ, RIGHT, -1, 11, 4.25))
    occ.cut([(3, left)], bores(occ, LEFT, 9, 23, 4.5))
    occ.cut([(3, right)], bores(occ, RIGHT, 9, 26, 5.5))


def test_step_of_three_parts_and_six_bolts(tmp_path):
    """Solids by their labels, six bolts where they were drawn, their threads, and modes."""
    labels = ("Base, EN AW-6061", "Left block", "right")
    step = write_step(tmp_path / "three.step", three_parts, labels=labels)
    found, case = written(tmp_path / "case", Source(step=step))
    assert found.checked.errors == () and found.checked.notes == ()
    assert found.copied == () and case.mesh.file == "../three.step"
    at = sorted(
        tuple(np.round(1e3 * np.array(point[:2])).astype(int)) for point in case.mesh.bolts.at
    )
    assert at == sorted(LEFT + RIGHT)
    text = (tmp_path / "case" / "case.toml").read_text(encoding="utf-8")
    assert text.count("9 mm, M8?") == 3 and text.count("8.5 and 11 mm, M10?") == 3
    assert [part.rho for part in case.parts.values()] == [2700, 7850, 7850]
    assert text.count("normal = [0.0, 0.0, 1.0]  # ?") == 3
    assert [part.across for part in case.parts.values()] == [(0, 1, 0), (1, 0, 0), (1, 0, 0)]
    assert [len(joint.cells) for joint in case.joints.values()] == [3, 3]
    modes = frequencies(case, 7)
    assert np.all(modes[:6] < 1e-3 * modes[6]) and 500 < modes[6] < 3000


def test_step_of_a_demo(tmp_path):
    """The bracket: its four M12 with tapped holes; its first mode is near the demo's."""
    step = ROOT / "demos" / "cad_bracket" / "bracket.step"
    found, case = written(tmp_path / "case", Source(step=step), material="cast-iron")
    assert found.checked.errors == () and found.checked.notes == ()
    assert [path.name for path in found.copied] == ["bracket.step"]
    assert case.mesh.bolts.thread == "M12" and len(case.mesh.bolts.at) == 4
    assert {"Base_plate", "Bracket"} == set(case.parts)
    demo = build_structure(load_case(step.parent), MPI.COMM_SELF).volumes()[0]
    own = build_structure(case, MPI.COMM_SELF)
    assert own.volumes()[:2].sum() == pytest.approx(demo, rel=0.01)
    # The pressure that the joints start from is over the rings as they are.
    assert np.allclose([ring.r_nei for ring in own.rings()], case.mesh.bolts.inner())


@pytest.mark.parametrize(
    "draw, bolts, normal", [(bracket, 2, (0.540, -0.326, 0.776)), (spigot, 3, (0, 0, 1))]
)
def test_steps_that_are_turned_or_centred(tmp_path, draw, bolts, normal):
    """Bolts of other directions; the hole of a spigot is no bolt's."""
    step = write_step(tmp_path / "drawn.step", draw)
    found, case = written(tmp_path / "case", Source(step=step))
    assert found.checked.errors == () and len(found.checked.bolts) == bolts
    ways = [ring.normal for ring in build_structure(case, MPI.COMM_SELF).rings()]
    assert np.allclose(np.abs(ways), np.abs(normal), atol=2e-3)


def write_msh(path, unit=1e3, layer=True, holes=()):
    """Two plates, lapped, with a layer or holes of 6.6 mm, in some unit (by a metre)."""
    u, t = unit, 0.001 * layer
    with gmsh_file(path, MeshSizeMax=(0.005 if holes else 0.03) * u) as gmsh:
        occ = gmsh.model.occ
        low = occ.addBox(0, 0, 0, 0.1 * u, 0.06 * u, 0.01 * u)
        up = occ.addBox(0.04 * u, 0, (0.01 + t) * u, 0.1 * u, 0.06 * u, 0.01 * u)
        parts = {"lower plate": low, "upper-alu": up}
        if layer:
            parts["joint"] = occ.addBox(0.04 * u, 0, 0.01 * u, 0.06 * u, 0.06 * u, t * u)
        for x, y in holes:
            for tag in (low, up):
                hole = occ.addCylinder(x * u, y * u, -u, 0, 0, 2 * u, 0.0033 * u)
                occ.cut([(3, tag)], [(3, hole)])
        occ.fragment([(3, tag) for tag in parts.values()], [])
        occ.synchronize()
        for name, tag in parts.items():
            gmsh.model.addPhysicalGroup(3, [tag], name=name)
        gmsh.model.mesh.generate(3)
    return path


def test_msh(tmp_path):
    """Its unit by its size, a layer by its name and thickness; masses are those by hand. Plates
    that touch get a layer where they do; with holes, rings round the bolts in them."""
    found, case = written(tmp_path / "case", Source(msh=write_msh(tmp_path / "plates.msh")))
    assert found.checked.errors == () and found.checked.notes == ()
    assert case.mesh.scale == pytest.approx(1e-3) and case.joints["joint"].h == pytest.approx(1e-3)
    assert found.checked.mass == pytest.approx(0.1 * 0.06 * 0.01 * (7850 + 2700))
    assert frequencies(case, 7)[6] > 100
    bare = write_msh(tmp_path / "bare.msh", unit=1.0, layer=False)
    found, case = written(tmp_path / "layer", Source(msh=bare))
    assert found.checked.errors == () and case.mesh.joint == "layer"
    assert case.mesh.scale == pytest.approx(1.0)
    assert case.joints["contact"].k_n > 1e11 and frequencies(case, 7)[6] > 100
    holed = write_msh(tmp_path / "holed.msh", layer=False, holes=[(0.055, 0.02), (0.085, 0.04)])
    found, case = written(tmp_path / "rings", Source(msh=holed))
    assert found.checked.errors == () and len(found.checked.bolts) == 2
    assert case.mesh.bolts.thread == "M6" and np.allclose(
        np.array(case.mesh.bolts.at), [(0.055, 0.02, 0.01), (0.085, 0.04, 0.01)], atol=1e-4
    )


def test_shapes_of_a_builder(tmp_path):
    """A universal file of a model's own shapes: sensors, modes; found again with a MAC of one."""
    written(tmp_path / "plain", Source(builder="dumbbell"))
    model = build_structure(load_case(tmp_path / "plain"), MPI.COMM_SELF)
    modes = solve_modes(model, n_modes=10)
    points = np.array([*itertools.product((-0.12, 0.12), (-0.09, 0.09), (-0.13, 0.13))])
    ways = np.eye(3)
    shapes = np.array([modes.at(Sensors(points, way))[:, 6:10] for way in ways])
    nodes = {i + 1: 1e3 * point for i, point in enumerate(points)}
    text = units_164() + nodes_2411(nodes)
    for j, hz in enumerate(modes.frequencies_hz[6:10]):
        shape = {n: shapes[:, n - 1, j] for n in nodes}
        text += mode_55(j + 1, hz, shape, ratio=0.01)
    (tmp_path / "lab.uff").write_text(text, encoding="utf-8")
    tests = TestFiles(uff=(tmp_path / "lab.uff",))
    found, case = written(tmp_path / "tested", Source(builder="dumbbell"), tests)
    assert found.checked.errors == () and found.checked.notes == ()
    assert case.test.shapes.files == ["../lab.uff"] and case.measured.shapes.shape == (24, 4)
    assert case.update.parameters == ["joint.E"]
    outcome = run_modes(case, MPI.COMM_SELF, QUIET, n_modes=12)
    assert np.all(outcome.result.beside.mac > 0.999) and outcome.result.beside.rms < 1e-4


@pytest.mark.parametrize("builder", ["half_lap_beam", "engraving_machine", "offset_beams"])
def test_builders(tmp_path, builder):
    """Contacts with bolts, rings, beams: all are built."""
    found, case = written(tmp_path / "case", Source(builder=builder))
    assert found.checked.errors == () and found.checked.notes == ()
    assert len(found.checked.bolts) == {"half_lap_beam": 3, "engraving_machine": 16}.get(builder, 0)
    if builder != "engraving_machine":
        assert frequencies(case, 8)[7] > 10


def test_frequencies(tmp_path):
    """The column of the torque by its unit; the last torque is that of the update."""
    shutil.copy(ROOT / "demos" / "lap_plates" / "frequencies.csv", tmp_path)
    tests = TestFiles(frequencies=tmp_path / "frequencies.csv")
    found, case = written(tmp_path / "case", Source(builder="lap_plates"), tests)
    assert found.checked.errors == ()
    assert case.test.condition == "torque" and len(case.measured.mode_names) == 4
    assert case.update.at == case.measured.conditions[-1] and case.test.noise == [0.002]


def test_answers(tmp_path):
    """What the user says goes before what was guessed."""

    own = answers(Material="titanium", Unit="cm")

    def ask(question, answer, check):
        with pytest.raises(ValueError):
            check("nonsense")
        return own(question, answer, check)

    _, case = written(tmp_path / "case", Source(msh=write_msh(tmp_path / "a.msh")), ask=ask)
    assert case.mesh.scale == 0.01 and {part.rho for part in case.parts.values()} == {4430}


def test_refusals(tmp_path):
    """What is there stays, and nothing is left of what failed."""
    folder = tmp_path / "case"
    with pytest.raises(InputError, match="expected one of --step"):
        written(folder, Source())
    (tmp_path / "no.step").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="not a STEP file"):
        written(folder, Source(step=tmp_path / "no.step"))
    with pytest.raises(InputError, match="no such file"):
        written(folder, Source(builder="dumbbell"), TestFiles(frequencies=tmp_path / "no.csv"))
    assert not folder.exists()
    written(folder, Source(builder="offset_beams"))
    before = (folder / "case.toml").read_bytes()
    with pytest.raises(InputError, match="is there already"):
        written(folder, Source(builder="dumbbell"))
    assert (folder / "case.toml").read_bytes() == before


def test_command(tmp_path, monkeypatch, capfd):
    """From the shell, silent; what was guessed is said, and what `check` finds."""
    folder = tmp_path / "case"
    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", ["fenics-joints", "new", str(folder), "--beams", "--yes"])
        with pytest.raises(SystemExit) as end:
            main()
    said = capfd.readouterr().out
    assert not end.value.code and (folder / "case.toml").is_file()
    assert "? The stiffness of the lap." in said and "no errors, nothing unlikely" in said


# -- files of strangers: sheets, stacks, inches, names that are taken ------------------------------


def edited(folder, *edits):
    """What check finds in the case after some edits."""
    path = folder / "case.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return check_case(folder, MPI.COMM_SELF, QUIET)


@pytest.mark.parametrize(
    "name, bolts, faces, joints",
    [("washers", 2, 3, 5), ("sheet_between_plates", 4, 3, 3), ("overlap_0001", 2, 1, 1)],
)
def test_stacks(tmp_path, name, bolts, faces, joints):
    """Each bolt once, a ring on each pair of faces."""
    found, case = written(tmp_path / "case", Source(step=DATA / f"{name}.step"))
    assert found.checked.errors == () and found.checked.notes == ()
    assert len(case.mesh.bolts.at) == bolts * faces and len(case.joints) == joints
    each = "" if faces == 1 else f" of {faces} pressed faces each"
    assert f"{bolts} bolts{each}: " in " ".join(found.draft.found)


def test_a_mesh_in_inches(tmp_path):
    """7.09 units long: not metres, of which it would weigh 15 t."""
    found, case = written(tmp_path / "case", Source(msh=DATA / "inch.msh"))
    assert case.mesh.scale == pytest.approx(0.0254) and found.checked.notes == ()
    assert found.checked.size_m[0] == pytest.approx(0.18, rel=1e-3)
    in_metres = edited(tmp_path / "case", ('"0.0254 m"', '"1 m"'))
    (note,) = [note for note in in_metres.notes if "weighs" in note]
    assert "unit" in note and in_metres.mass == pytest.approx(0.7536 / 0.0254**3, rel=1e-3)


def test_a_plane_mesh_is_said_and_a_sheet_bends(tmp_path):
    """120 x 40 x 2 mm of steel bends near 740 Hz: 22.37 / (2 pi l^2) sqrt(E t^2 / 12 rho)."""
    source = Source(msh=DATA / "shell.msh")
    found, case = written(tmp_path / "section", source)
    assert case.mesh.thickness is None and "thickness" in " ".join(found.checked.notes)
    assert any("plane" in question for question in found.draft.questions)
    found, case = written(tmp_path / "sheet", source, ask=answers(Thickness="2 mm"))
    assert case.mesh.thickness == 0.002 and found.checked.notes == ()
    assert found.checked.mass == pytest.approx(0.12 * 0.04 * 0.002 * 7850)
    modes = run_modes(case, MPI.COMM_SELF, QUIET, n_modes=8).result.modes
    beam = 22.37 / (2 * np.pi * 0.12**2) * np.sqrt(210e9 * 0.002**2 / (12 * 7850))
    assert modes.frequencies_hz[6] == pytest.approx(beam, rel=0.03)
    (error,) = edited(tmp_path / "sheet", ("gdim = 2", "gdim = 3")).errors
    assert "thickness" in error


def flanges_named(occ):
    for z in (0, 10):
        plate = occ.addBox(0, 0, z, 100, 60, 10)
        occ.cut([(3, plate)], bores(occ, [(25, 30), (75, 30)], z - 1, z + 11, 4.5))


def test_bolts_on_one_axis():
    """One bolt through three plates; two in blind holes from both sides of a block, or beside one
    another, or far apart."""
    z, at = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    top = at + 0.02 * z

    def bolts(place, way=z, depths=(None, None), second=(1, 2)):
        first = BoltHole((0, 1), at, z, (0.008,), depths=depths[0])
        return stacked([first, BoltHole(second, place, way, (0.008,), depths=depths[1])])

    assert bolts(top, depths=((0.01, 0.02), (0.02, 0.01))) == [1, 1]
    assert bolts(top, -z, depths=((0.01, 0.008), (0.008, 0.01))) == [1, 2]
    assert bolts(top + [0.01, 0, 0]) == bolts(25 * top, second=(2, 3)) == [1, 2]


@pytest.mark.parametrize("labels", [("ring_1", "joint"), ("joint_2", "ring_2")])
def test_names_of_layers_are_taken(tmp_path, labels):
    """Solids that are called as layers are get other names; a case with such a name is refused,
    and one with cells larger than all is noted."""
    step = write_step(tmp_path / "a.step", flanges_named, labels=labels)
    found, case = written(tmp_path / "case", Source(step=step))
    assert found.checked.errors == () and set(case.parts) == {f"part_{x}" for x in labels}
    text = (tmp_path / "case" / "case.toml").read_text(encoding="utf-8")
    (line,) = [line for line in text.splitlines() if line.startswith("size = ")]
    (note,) = edited(tmp_path / "case", (line, "size = 5")).notes
    assert "mesh.size = 5" in note
    bad = next(label for label in labels if label.startswith("ring"))
    again = edited(tmp_path / "case", (f"part_{bad}", bad))
    (error,) = [line for line in again.errors if bad in line]
    assert "expected another" in error
    assert 0.5 < again.estimate.dofs / found.checked.dofs < 2  # though it was not meshed


def test_a_mass_on_a_bolt(tmp_path):
    """The hole is empty: the mass sits on the ring, with the bolt's axis as its centre."""
    step = write_step(tmp_path / "a.step", flanges_named)
    written(tmp_path / "case", Source(step=step))
    path = tmp_path / "case" / "case.toml"
    screw = '[masses.screw]\nmass = "20 g"\npoints = [["25 mm", "30 mm", "10 mm"]]\n'
    path.write_text(path.read_text(encoding="utf-8") + screw, encoding="utf-8")
    assert check_case(tmp_path / "case", MPI.COMM_SELF, QUIET).errors == ()
    model = build_structure(load_case(tmp_path / "case"), MPI.COMM_SELF)
    places = np.array([mass.point for mass in model.masses])
    assert sum(mass.share for mass in model.masses) == pytest.approx(1.0)
    assert np.allclose(places.mean(axis=0), [0.025, 0.03, 0.01], atol=1e-5)
    beside = screw.replace('"25 mm", "30 mm"', '"50 mm", "70 mm"')
    path.write_text(path.read_text(encoding="utf-8").replace(screw, beside), encoding="utf-8")
    (error,) = check_case(tmp_path / "case", MPI.COMM_SELF, QUIET).errors
    assert "screw" in error


# -- drawings of the demos -------------------------------------------------------------------------

DEMOS = ROOT / "demos"


def universal(case, path):
    """The shapes of a demo's test as a lab would send them: in inches, and without saying so."""
    data = case.measured
    places = np.round(data.sensors.points / 0.0254, 6)
    nodes, which = np.unique(places, axis=0, return_inverse=True)
    text = nodes_15(dict(enumerate(nodes, start=1)))
    for j, hz in enumerate(data.frequencies_hz[0]):
        shape = {i: np.zeros(3) for i in range(1, len(nodes) + 1)}
        for k, way in enumerate(data.sensors.directions):
            shape[int(which[k]) + 1] += way * data.shapes[k, j]
        text += mode_55(j + 1, hz, shape, ratio=float(data.damping[0, j]))
    path.write_text(text, encoding="utf-8")
    return path


def lab_files(name, folder):
    """The test's files of a demo, as a lab has them."""
    if name == "barc":
        return TestFiles(uff=(universal(load_case(DEMOS / name), folder / "box.uff"),))
    own = DEMOS / name
    return TestFiles(frequencies=own / "frequencies.csv", shapes=own / "shapes.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name, joints, least_mac", [("barc", 4, 0.7), ("jim_beam", 2, 0.95)])
def test_a_drawing_of_the_demos(tmp_path, name, joints, least_mac):
    """Joints are found, nothing is wrong; six modes of a free body, then the test's."""
    (step,) = (DEMOS / name).glob("*.step")
    found, case = written(tmp_path / "case", Source(step=step), lab_files(name, tmp_path))
    assert found.checked.errors == () and found.checked.notes == ()
    assert len(case.joints) == joints and found.checked.bolts == ()
    outcome = run_modes(case, MPI.COMM_SELF, QUIET, n_modes=26)
    hz, beside = outcome.result.modes.frequencies_hz, outcome.result.beside
    assert np.all(hz[:6] < 1e-3 * hz[6])
    assert np.median(beside.mac) > least_mac and beside.rms < 0.2


@pytest.mark.slow
def test_the_box_is_updated_to_its_end():
    """A model that is wrong, a mode with two partners, five open stiffnesses: it settles, and says
    which mode it left out; the small model is as good as the full one."""
    report = update_case(load_case(DEMOS / "barc"), MPI.COMM_WORLD)
    assert report.update.converged and report.update.widths.without == (8,)
    said = " ".join(report.notes)
    assert "mode 9 changes its partner" in said and "reduced model is still off" not in said
    errors = report.modes.error_after
    assert np.sqrt(np.mean(errors[:8] ** 2)) < 0.03


def test_one_solid_is_a_case_without_joints(tmp_path):
    """A free bar from CAD bends at the frequency of Euler and Bernoulli's beam."""
    step = write_step(tmp_path / "bar.step", lambda occ: occ.addBox(0, 0, 0, 300, 12, 6))
    _, case = written(tmp_path / "case", Source(step=step))
    assert not case.joints and not check_case(tmp_path / "case", MPI.COMM_SELF, QUIET).errors
    wave, radius = 4.730041 / 0.3, 6e-3 / np.sqrt(12)
    expected = wave**2 * radius * np.sqrt(210e9 / 7850) / (2 * np.pi)
    assert frequencies(case)[6] == pytest.approx(expected, rel=5e-3)


def test_bolts_in_a_drawing_leave_their_mass(tmp_path):
    """Two M8 with nuts: the mass of their cylinders, in the middle of two rings."""

    def draw(occ):
        joined(occ, [(30, 20), (70, 20)])
        screws(occ, [(30, 20), (70, 20)], 0, 20, nut=True)

    found, case = written(tmp_path / "case", Source(step=write_step(tmp_path / "a.step", draw)))
    each = np.pi * (6.5**2 * 8 + 4**2 * 28 + (6.5**2 - 4**2) * 6.5) * 1e-9 * 7850
    assert case.mesh.without == [3, 4, 5, 6] and list(case.joints) == ["joint"]
    assert case.masses["fasteners"].mass == pytest.approx(2 * each, rel=1e-3)
    assert not found.checked.errors
    assert np.all(frequencies(case)[6:] > 1000)


def test_preload_of_a_drawing(tmp_path):
    """What is written runs: bolts by Motosh's equation, contact that carries their force.

    One bolt has a nut and one is screwed into the lower plate, all turned in space.
    """

    def draw(occ):
        lower, upper = occ.addBox(0, 0, 0, 100, 40, 20), occ.addBox(0, 0, 20, 100, 40, 10)
        occ.cut(
            [(3, lower)], bores(occ, [(30, 20)], -1, 21, 4.5) + bores(occ, [(70, 20)], 6, 21, 3.4)
        )
        occ.cut([(3, upper)], bores(occ, [(30, 20), (70, 20)], 19, 31, 4.5))
        occ.rotate(occ.getEntities(3), 0, 0, 0, 1, 2, -0.5, 0.7)

    step = write_step(tmp_path / "a.step", draw)
    found, case = written(tmp_path / "case", Source(step=step, preload=True))
    assert not found.checked.errors and len(case.mesh.washers) == 3 and len(case.mesh.faces) == 1
    # M8: pitch 1.25, pitch diameter 7.188, flats 13, hole 9 mm; cos 30 degrees.
    arm = 1.25 / (2 * np.pi) + 0.12 * 7.188 / 2 / np.cos(np.pi / 6) + 0.12 * (13 + 9) / 4
    for bolt in case.bolts.values():
        assert bolt.preload() == pytest.approx(1e3 * bolt.torque / arm, rel=1e-3)
        assert bolt.preload() == pytest.approx(0.6 * 580 * 36.6, rel=0.05)  # N/mm2, mm2
    coarse = case.model_copy(update={"mesh": case.mesh.model_copy(update={"degree": 1})})
    (contact,) = run_preload(coarse, MPI.COMM_SELF, QUIET).result.result.contacts.values()
    total = sum(bolt.preload() for bolt in case.bolts.values())
    assert contact.normal_force == pytest.approx(total, rel=1e-3)


def test_preload_without_bolts_is_refused(tmp_path):
    step = write_step(tmp_path / "bar.step", lambda occ: occ.addBox(0, 0, 0, 300, 12, 6))
    with pytest.raises(InputError, match="--preload: no bolt was found"):
        written(tmp_path / "case", Source(step=step, preload=True))
    with pytest.raises(InputError, match="--preload is for --step"):
        written(tmp_path / "case", Source(builder="lap_plates", preload=True))
