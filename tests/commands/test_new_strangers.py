"""``fenics-joints new`` on files of strangers: sheets, stacks, inches, names that are taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from step_files import bores

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.check.run import check_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.commands.new.bolted import BoltHole, stacked
from fenics_joints.commands.new.run import Source, run_new
from fenics_joints.commands.new.tests import TestFiles
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.progress import Progress

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process")

DATA = Path(__file__).parents[1] / "meshes" / "data"


def written(folder, source, **answers):
    """What `new` writes, where the questions that have a word are answered, and the case."""

    def ask(question, answer, check):
        for word, own in answers.items():
            answer = own if word in question else answer
        check(answer)
        return answer

    found = run_new(folder, source, TestFiles(), ask, Progress(silent=True))
    return found, load_case(folder)


def edited(folder, *edits) -> list[str]:
    """What check says against the case after some edits."""
    path = folder / "case.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return check_case(folder, MPI.COMM_SELF, Progress(silent=True))


@pytest.mark.parametrize(
    "name, bolts, faces, joints",
    [("washers", 2, 3, 5), ("sheet_between_plates", 4, 3, 3), ("overlap_0001", 2, 1, 1)],
)
def test_stacks(tmp_path, name, bolts, faces, joints):
    """Each bolt once, a ring on each pair of faces; and joint = "layer" on the same."""
    found, case = written(tmp_path / "case", Source(step=DATA / f"{name}.step"))
    assert found.checked.errors == () and found.checked.notes == ()
    assert len(case.mesh.bolts.at) == bolts * faces and len(case.joints) == joints
    each = "" if faces == 1 else f" of {faces} pressed faces each"
    assert f"{bolts} bolts{each}: " in " ".join(found.draft.found)
    if name == "sheet_between_plates":
        folder = tmp_path / "layers"
        folder.mkdir()
        text = (tmp_path / "case" / "case.toml").read_text(encoding="utf-8")
        mesh, rest = text.split("[mesh.bolts]")
        mesh = mesh.replace("ring_size", 'joint = "layer"\n# ring_size')
        mesh = mesh.replace('"sheet', '"../case/sheet')
        _, rest = rest.split("\n]\n", 1)
        for i in range(3):
            rings = ", ".join(f'"ring_{4 * i + k}"' for k in (1, 2, 3, 4))
            rest = rest.replace(f"[{rings}]", f'["joint_{i + 1}"]\npressure = "1 MPa"')
        (folder / "case.toml").write_text(mesh + rest, encoding="utf-8")
        assert check_case(folder, MPI.COMM_SELF, Progress(silent=True)).errors == ()


def test_bolts_on_one_axis():
    """One bolt through three plates; two in blind holes from both sides of a block."""
    z, at = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    through = [
        BoltHole((0, 1), at, z, (0.008,), depths=(0.01, 0.02)),
        BoltHole((1, 2), at + 0.02 * z, z, (0.008,), depths=(0.02, 0.01)),
    ]
    blind = [
        BoltHole((0, 1), at, z, (0.008,), depths=(0.01, 0.008)),
        BoltHole((1, 2), at + 0.02 * z, -z, (0.008,), depths=(0.008, 0.01)),
    ]
    beside = [
        BoltHole((0, 1), at, z, (0.008,)),
        BoltHole((1, 2), at + 0.02 * z + [0.01, 0, 0], z, (0.008,)),
    ]
    far = [BoltHole((0, 1), at, z, (0.008,)), BoltHole((2, 3), at + 0.5 * z, z, (0.008,))]
    assert [stacked(rings) for rings in (through, blind, beside, far)] == [
        [1, 1],
        [1, 2],
        [1, 2],
        [1, 2],
    ]


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
    found, case = written(tmp_path / "sheet", source, Thickness="2 mm")
    assert case.mesh.thickness == 0.002 and found.checked.notes == ()
    assert found.checked.mass == pytest.approx(0.12 * 0.04 * 0.002 * 7850)
    modes = run_modes(case, MPI.COMM_SELF, Progress(silent=True), n_modes=8).result.modes
    beam = 22.37 / (2 * np.pi * 0.12**2) * np.sqrt(210e9 * 0.002**2 / (12 * 7850))
    assert modes.frequencies_hz[6] == pytest.approx(beam, rel=0.03)
    (error,) = edited(tmp_path / "sheet", ("gdim = 2\n", "")).errors
    assert "thickness" in error


def flanges_named(occ):
    for z in (0, 10):
        plate = occ.addBox(0, 0, z, 100, 60, 10)
        occ.cut([(3, plate)], bores(occ, [(25, 30), (75, 30)], z - 1, z + 11, 4.5))


@pytest.mark.parametrize("labels", [("ring_1", "joint"), ("joint_2", "ring_2")])
def test_names_of_layers_are_taken(tmp_path, labels):
    """Solids that are called as layers are get other names; a case with such a name is refused."""
    step = write_step(tmp_path / "a.step", flanges_named, labels=labels)
    found, case = written(tmp_path / "case", Source(step=step))
    assert found.checked.errors == () and set(case.parts) == {f"part_{x}" for x in labels}
    bad = next(label for label in labels if label.startswith("ring"))
    again = edited(tmp_path / "case", (f"part_{bad}", bad))
    (error,) = [line for line in again.errors if bad in line]
    assert "expected another" in error and again.estimate is None


def test_cells_larger_than_all(tmp_path):
    step = write_step(tmp_path / "a.step", flanges_named)
    written(tmp_path / "case", Source(step=step))
    text = (tmp_path / "case" / "case.toml").read_text(encoding="utf-8")
    (line,) = [line for line in text.splitlines() if line.startswith("size = ")]
    (note,) = edited(tmp_path / "case", (line, "size = 5")).notes
    assert "mesh.size = 5" in note


def test_a_mass_on_a_bolt(tmp_path):
    """The hole is empty: the mass sits on the ring, with the bolt's axis as its centre."""
    step = write_step(tmp_path / "a.step", flanges_named)
    written(tmp_path / "case", Source(step=step))
    path = tmp_path / "case" / "case.toml"
    screw = '[masses.screw]\nmass = "20 g"\npoints = [["25 mm", "30 mm", "10 mm"]]\n'
    path.write_text(path.read_text(encoding="utf-8") + screw, encoding="utf-8")
    assert check_case(tmp_path / "case", MPI.COMM_SELF, Progress(silent=True)).errors == ()
    model = build_structure(load_case(tmp_path / "case"), MPI.COMM_SELF)
    places = np.array([mass.point for mass in model.masses])
    assert sum(mass.share for mass in model.masses) == pytest.approx(1.0)
    assert np.allclose(places.mean(axis=0), [0.025, 0.03, 0.01], atol=1e-5)
    beside = screw.replace('"25 mm", "30 mm"', '"50 mm", "70 mm"')
    path.write_text(path.read_text(encoding="utf-8").replace(screw, beside), encoding="utf-8")
    (error,) = check_case(tmp_path / "case", MPI.COMM_SELF, Progress(silent=True)).errors
    assert "screw" in error
