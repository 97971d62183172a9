"""``fenics-joints check``: all that is wrong or unlikely in one run, masses, places, costs."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from mpi4py import MPI
from rich.console import Console
from step_files import flanges

from fenics_joints.case import build_mesh, estimate, examine_case, load_case
from fenics_joints.cli import main
from fenics_joints.commands.check.costs import costs_of
from fenics_joints.commands.check.places import CasePoint
from fenics_joints.commands.check.run import Checked, check_case, check_document, run_check
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.progress import Progress
from fenics_joints.report.html import as_page

DEMOS = Path(__file__).resolve().parents[2] / "demos"
PLATES = 2 * 0.2 * 0.08 * 0.008 * 2750  # kg: two plates by hand
STEP = """
[mesh]
file = "machine.step"
size = "30 mm"
circle = 6
[mesh.bolts]
at = [{bolts}]
r_wai = "9 mm"
[parts.frame]
cells = ["bed", "foot"]
E = "210 GPa"
nu = 0.3
rho = "7850 kg/m3"
[joints.rings]
law = "transition"
cells = "ring_*"
E = "6111 MPa"
nu = 0.253
h = "0.7 mm"
"""


def checked(path, comm=MPI.COMM_SELF):
    return check_case(path, comm, Progress(silent=True))


@pytest.mark.parallel
@pytest.mark.smoke
def test_masses_and_places(shared_tmp_path, write_case):
    """Masses are those by hand, on any number of ranks; a good case has nothing to say."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        write_case(shared_tmp_path)
    comm.barrier()
    found = checked(shared_tmp_path, comm)
    assert found.errors == () and found.notes == ()
    assert found.mass == pytest.approx(PLATES, rel=1e-12)
    assert sum(w.mass for w in found.weights if w.kind == "attached") == pytest.approx(0.18)
    sensors = [place for place in found.places if place.kind == "sensor"]
    assert len(sensors) == 5 and all(place.off == 0 for place in sensors)
    assert len(found.bolts) == 4
    assert [cost.command for cost in found.costs] == ["modes", "update", "diagnose"]


def test_a_diagnosis_is_said_to_take_what_it_took():
    """386 s of the lap plates on one rank; sampled evidence is most hypotheses' or none's. And
    350 s of the beam from a drawing with eight levels of a mode, 126 s with the hammer alone."""

    def seconds(case, ranks: int = 1) -> float:
        costs = costs_of(case, estimate(case, ranks=ranks), None, ranks)
        return next(cost.seconds for cost in costs if cost.command == "diagnose")

    plates = load_case(DEMOS / "lap_plates")
    sampled = {
        n: plates.model_copy(update={"diagnose": plates.diagnose.model_copy(update={"nested": n})})
        for n in (0, 1, 6, 50)
    }
    assert 386 / 2 < seconds(sampled[6]) < 2 * 386
    assert seconds(sampled[0]) < seconds(sampled[1]) == seconds(sampled[50])
    assert 0.4 < seconds(sampled[6], ranks=2) / seconds(sampled[6]) < 0.7
    beam = load_case(DEMOS / "half_lap_beam/drawn.toml")
    hammer = beam.model_copy(update={"test": beam.test.model_copy(update={"amplitude": {}})})
    assert 350 / 2 < seconds(beam) < 2 * 350 and 126 / 2 < seconds(hammer) < 2 * 126


def test_all_at_once(tmp_path, write_case, keeps_rules):
    """What cannot be read, what is not there, what is beside the mesh and what is unlikely."""
    write_case(
        tmp_path,
        ('E = "69 GPa"', 'E = "69 Pa"\nmass = "70.4 g"'),
        ('damping = "damping.csv"', 'damping = "dampin.csv"\nmass = "900 g"'),
        ('noise = "0.3 %"', 'noise = "0.3 kg"'),
        ('positions = ["10 mm", "60 mm"', 'positions = ["-25 mm", "60 mm"'),
        ('G = "0.446 MPa"', 'G = "0.446 MPa"\nthickness = "1 mm"'),
        ('points = [["10 mm", "40 mm"]]', 'points = [["10 mm", "90 mm"]]'),
    )
    text = (tmp_path / "case.toml").read_text().replace('G = "26.9 GPa"', "nu = 0.3")
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    outcome = run_check(tmp_path, MPI.COMM_SELF, Progress(silent=True))
    found = outcome.result
    keeps_rules(outcome.page().html())
    errors, notes = "\n".join(found.errors), "\n".join(found.notes)
    assert "test.noise[0] = '0.3 kg'" in errors
    assert "joints.away.thickness = '1 mm': unknown key" in errors
    assert "dampin.csv" in errors and "no such file" in errors
    assert "sensor 1 at [-0.025, 0.04, 0.008] m is outside the mesh, by 25 mm" in errors
    assert "accelerometer at [0.01, 0.09, 0.0] m is outside the mesh, by 10 mm" in errors
    assert "parts.plates.E = 69 Pa is unusual" in notes
    assert "parts.plates is 704 g in the model and 70.4 g on the scales (10 times as much)" in notes
    assert "the whole structure is 884 g in the model and 900 g" not in notes  # within 5 %
    # A screen of 80 columns, no sentence cut.
    text = io.StringIO()
    outcome.summary(Console(file=text, width=80))
    said = text.getvalue().splitlines()
    assert max(map(len, said)) <= 80
    assert "was '69 GPa' meant?" in " ".join(text.getvalue().split())
    # Errors are numbered, notes are not.
    starts = [line.partition(": ")[0] for line in said if line.startswith(("error", "note"))]
    assert starts == [f"error {i + 1}" for i in range(len(found.errors))] + ["note"] * len(
        found.notes
    )


def test_a_case_without_a_title_is_named_by_its_folder_or_its_file(
    tmp_path, write_case, monkeypatch
):
    write_case(tmp_path)
    text = (tmp_path / "case.toml").read_text(encoding="utf-8")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("title"))
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    (tmp_path / "broken.toml").write_text("title = [", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for file, title in (("case.toml", tmp_path.name), ("broken.toml", "broken.toml")):
        found = check_case(file, MPI.COMM_SELF, Progress(silent=True), solve=False)
        assert check_document(found).title == title and found.to_json()["title"] == title


def test_places_have_the_digits_that_are_known():
    """A bolt's point is the middle of two faces, whose coordinates are known but for round-off."""
    bolt = CasePoint("bolt", "bolt 1", (0.02485, -2e-19, -1.31e-6), None)
    sensor = CasePoint("sensor", "1", (0.1, 0.0, 0.0125), (6e-17, -1.0, 0.0), 3e-7)
    found = Checked(Path("case.toml"), None, (), places=(sensor,), bolts=(bolt,))
    found = replace(found, size_m=np.array([0.26, 0.1, 0.1]))
    shown = Page(as_page(check_document(found)))
    assert shown.column("places", 2) == ["24.85, 0, 0", "100, 0, 12.5"]
    assert shown.column("places", 3) == ["", "0, -1, 0"]
    assert shown.column("places", 4) == ["", "0"]


def test_bolts_and_groups_of_a_step_file(tmp_path):
    """Bolts at one place, said before and although gmsh refuses the rings; a group that is not
    there is one error, and what the mesh says stays as notes."""
    write_step(tmp_path / "machine.step", flanges(), labels=("bed", "foot"))
    places = ["[0.045, 0.015, 0.02]", "[0.085, 0.015, 0.02]", "[0.0452, 0.015, 0.02]"]
    (tmp_path / "case.toml").write_text(STEP.format(bolts=", ".join(places)), encoding="utf-8")
    errors = "\n".join(checked(tmp_path).errors)
    assert "mesh.bolts.at[0] and mesh.bolts.at[2] are at one place" in errors
    text = STEP.format(bolts=", ".join(places[:2]))
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    found = checked(tmp_path)
    assert found.errors == () and len(found.bolts) == 2
    holes = 4 * 3.14159265 * 6e-3**2 * 35e-3  # polygons of the mesh are a little smaller
    solid = 0.1 * 0.06 * 0.02 + 0.08 * 0.06 * 0.015
    assert found.mass == pytest.approx(7850 * (solid - holes), rel=0.01)
    (tmp_path / "case.toml").write_text(text.replace('"foot"', '"nowhere"'), encoding="utf-8")
    lost = checked(tmp_path)
    assert all("nowhere" in error for error in lost.errors) and lost.errors
    assert set(build_mesh(found.case, MPI.COMM_SELF).notes) <= set(lost.notes)


def test_sensors_of_another_unit(tmp_path, write_case):
    """Numbers of inches read as mm lie within the structure, but see a corner of it."""
    places = '"0.4 mm", "2.4 mm", "4.3 mm", "8.3 mm", "12.2 mm"'
    write_case(
        tmp_path,
        ('"10 mm", "60 mm", "110 mm", "210 mm", "310 mm"', places),
        ('z = ["8 mm", "8 mm", "8 mm", "16.5 mm", "16.5 mm"]', 'z = "8 mm"'),
    )
    found = checked(tmp_path)
    assert found.errors == () and "span 11.8 mm of a structure of 320 mm" in found.notes[0]


BESIDES = """
[test.stiffness.tip]
point = ["900 mm", "40 mm", "16.5 mm"]
direction = [0, 0, 1]
stiffness = "20 kN/m"

[test.antiresonances.end]
point = ["10 mm", "40 mm", "0 mm"]
direction = [0, 0, 1]
frequencies = ["300 Hz"]

[test.changed.loaded]
frequencies = "loaded.csv"
mass = "40 g"
points = [["300 mm", "40 mm", "-9 mm"]]

[test.frfs]
files = "frfs.csv"
points = { "1" = ["310 mm", "40 mm", "16.5 mm"], "2" = ["400 mm", "40 mm", "8 mm"] }

[test.sees]"""


def test_where_else_a_test_measured(tmp_path, write_case):
    """Of what was measured beside modes, too, all that is beside the mesh is said at once."""
    write_case(tmp_path, ("[test.sees]", BESIDES))
    head = "bending 1 [Hz],bending 2 [Hz],bending 3 [Hz],bending 4 [Hz]\n400,1000,2200,3100\n"
    (tmp_path / "loaded.csv").write_text(head)
    table = "frequency [Hz],2:+z/1:+z re [m/s2/N],2:+z/1:+z im [m/s2/N]\n1,2,3\n2,3,4\n3,4,6\n"
    (tmp_path / "frfs.csv").write_text(table)
    found = checked(tmp_path)
    names = {place.name: place.kind for place in found.places}
    assert names["test.antiresonances.end"] == names["force 1"] == "force"
    assert names["test.changed.loaded"] == "mass" and names["2:+z"] == "sensor"
    said = "\n".join(found.errors)
    for name in ("test.stiffness.tip", "test.changed.loaded", "2:+z"):
        assert name in said, said
    assert "test.antiresonances.end" not in said


def test_hopeless_files(tmp_path):
    """Empty, truncated and foreign files are one clear list, and still a page."""
    for text, words in (
        ("", "mesh is missing"),
        ("[mesh", "cannot be read as TOML"),
        ("x = 1\n", "x = 1: unknown key"),
    ):
        (tmp_path / "case.toml").write_text(text, encoding="utf-8")
        outcome = run_check(tmp_path, MPI.COMM_SELF, Progress(silent=True))
        assert words in "\n".join(outcome.result.errors) and outcome.failure
        assert words in outcome.page().html() and outcome.json()["errors"]


def test_what_can_be_read_is(tmp_path, write_case):
    """A part that cannot be read does not hide what is wrong with the test's files."""
    write_case(tmp_path, ('E = "69 GPa"', 'E = "stiff"'), ('G = "342 MPa"', ""))
    (tmp_path / "frequencies.csv").unlink()
    found = examine_case(tmp_path)
    assert found.errors[0].startswith("parts.plates.E ") and "joints.near:" in found.errors[1]
    assert "frequencies.csv" in found.errors[2] and not found.whole and found.has_mesh


def test_command(tmp_path, write_case, monkeypatch, capfd):
    """Files are written and the exit code is 1 where something is wrong."""
    write_case(tmp_path, ('positions = ["10 mm"', 'positions = ["-25 mm"'))
    page, out = tmp_path / "page.html", tmp_path / "out.json"
    with monkeypatch.context() as patch, pytest.raises(SystemExit) as end:
        arguments = ["check", str(tmp_path), "--report", str(page), "--json", str(out)]
        patch.setattr(sys, "argv", ["fenics-joints", *arguments])
        main()
    assert end.value.code == 1
    said = capfd.readouterr()
    assert "error 1: sensor 1 at" in said.out and "1 error, listed above" in said.err
    content = json.loads(out.read_text())
    assert content["mass_kg"] == pytest.approx(PLATES) and len(content["errors"]) == 1
    assert content["places"][0]["off_mm"] == pytest.approx(25)
    assert page.read_text().count("<svg") == 2
