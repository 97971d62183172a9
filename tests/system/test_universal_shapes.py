"""Cases whose test is a universal file alone: reading, comparison of modes, update."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner
from uff_files import complex_mode_55, mode_55, nodes_15, nodes_2411, units_164

pytest.importorskip("dolfinx")
pytest.importorskip("pyuff")

from mpi4py import MPI

from fenics_joints.case import build_structure, load_case, test_notes
from fenics_joints.cli import app
from fenics_joints.commands.modes import run_modes
from fenics_joints.errors import InputError
from fenics_joints.measurements import mac, pair_modes
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="writes a case in a folder")

#: The sections [test] and [update] of the lap plates' case.
SECTIONS = re.compile(r"\[test\].*?(?=\[diagnose\])", re.DOTALL)
UPDATE = """[update]
parameters = ["near.E", "near.G"]
data = ["frequencies", "shapes"]
start = { "near.E" = "300 MPa", "near.G" = "120 MPa" }

"""
#: mm; 0.4 mm above the plates, as the base of a glued sensor is.
NODES = {
    100 * i + j: (x, y, (8.0 if x < 200 else 16.5) + 0.4)
    for i, x in enumerate((10, 60, 110, 210, 260, 310), 1)
    for j, y in enumerate((5, 75), 1)
}
N_MODES = 5


@pytest.fixture
def lap(tmp_path, write_case):
    """A function that puts a case with this section [test] into the folder, with files."""
    write_case(tmp_path)
    text = (tmp_path / "case.toml").read_text(encoding="utf-8")

    def put(test, update=UPDATE, **files):
        for name, content in files.items():
            (tmp_path / f"{name}.uff").write_text(content, encoding="utf-8")
        own = SECTIONS.sub(lambda _: test + update, text)
        (tmp_path / "case.toml").write_text(own, encoding="utf-8")
        return tmp_path

    return put


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """Frequencies and shapes along z, by node, of the lap plates with the case's own stiffness."""
    text = (Path(__file__).parents[1] / "lap_case.toml").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("truth") / "case.toml"
    path.write_text(SECTIONS.sub("", text), encoding="utf-8")
    case = load_case(path)
    points = np.array(list(NODES.values())) * 1e-3
    sensors = Sensors(points, (0, 0, 1.0))
    modes = solve_modes(build_structure(case, MPI.COMM_SELF), n_modes=14)
    index = pair_modes(modes, N_MODES, sensors).index
    return modes.frequencies_hz[index], modes.at(sensors)[:, index]


def universal(truth, *, geometry=None, angle=0.4, units=True):
    """A file of complex modes along z, turned by an angle."""
    hz, shapes = truth
    blocks = [units_164()] if units else []
    blocks += [nodes_2411(NODES) if geometry is None else geometry]
    for i, f in enumerate(hz):
        z = shapes[:, i] * np.exp(1j * angle * (i + 1))
        shape = {node: (0j, 0j, value) for node, value in zip(NODES, z, strict=True)}
        blocks += [complex_mode_55(i + 1, f, 1e-3 * (i + 1), shape)]
    return "".join(blocks)


def test_a_universal_file_is_the_whole_test(lap, truth):
    folder = lap('[test]\nshapes = "shapes.uff"\n\n', "", shapes=universal(truth))
    case = load_case(folder)
    data = case.measurements()
    assert data.frequencies_hz[0] == pytest.approx(truth[0], rel=1e-5)
    assert data.damping[0] == pytest.approx(1e-3 * np.arange(1, N_MODES + 1), rel=1e-4)
    assert np.diag(mac(data.shapes, truth[1])) == pytest.approx(1, abs=1e-6)
    outcome = run_modes(case, MPI.COMM_SELF, Progress(silent=True))
    notes = outcome.result.notes
    assert "5 complex shapes were made real: MAC of real with complex from 1.000" in notes[0]
    moved = "12 of 12 sensors stood beside the mesh and were moved onto it, the farthest (101:z) by"
    assert notes[1] == f"{moved} 0.4 mm"
    console = Console(record=True, width=80)
    outcome.summary(console)
    words = " ".join(console.export_text().split())
    assert notes[1] in words and "…" not in words
    assert notes[1] in outcome.page().html() and outcome.json()["notes"] == list(notes)
    beside, said = outcome.result.beside, outcome.json()["test"]
    assert beside.relative == pytest.approx(0, abs=1e-5)
    assert beside.mac == pytest.approx(1, abs=1e-6)
    assert beside.index.tolist() == outcome.result.visible.nonzero()[0][:N_MODES].tolist()
    assert [p["mode"] - 1 for p in said["pairs"]] == beside.index.tolist()
    assert "+0.00 %" in words and "MAC 1.000" in outcome.page().html()


def test_modes_are_paired_by_their_shapes_where_frequencies_mislead(lap, truth):
    """A file whose second and third mode have each other's frequency, one sensor missing."""
    hz, shapes = truth
    order = [0, 2, 1, 3, 4]
    file = units_164() + nodes_2411(NODES)
    for i, f in enumerate(hz):
        shape = {n: (0, 0, z) for n, z in zip(NODES, shapes[:, order[i]], strict=True)}
        if i == 0:
            del shape[next(iter(NODES))]
        file += mode_55(i + 1, f, shape)
    case = load_case(lap('[test]\nshapes = "shapes.uff"\n\n', "", shapes=file))
    outcome = run_modes(case, MPI.COMM_SELF, Progress(silent=True))
    beside = outcome.result.beside
    expected = outcome.result.visible.nonzero()[0][order]
    assert beside.index.tolist() == expected.tolist()
    assert beside.mac == pytest.approx(1, abs=1e-6)
    assert beside.relative[1] == pytest.approx(hz[2] / hz[1] - 1, rel=1e-3)
    # The partner is shown in the scale of what was measured.
    there = np.isfinite(beside.test_shapes)
    assert beside.model_shapes[there] == pytest.approx(beside.test_shapes[there], rel=1e-3)
    everything = run_modes(case, MPI.COMM_SELF, Progress(silent=True), n_modes=14, draw_all=True)
    assert (
        everything.page().html().count("Mode shape ") == 8
        and outcome.page().html().count("Mode shape ") == 6
    )
    few = run_modes(case, MPI.COMM_SELF, Progress(silent=True), n_modes=9)
    assert few.result.beside is None and "not compared with the test" in few.result.notes[-1]


def test_update_finds_what_made_the_file(lap, truth):
    folder = lap('[test]\nnoise = "0.1 %"\nshapes = ["shapes.uff"]\n\n', shapes=universal(truth))
    out = folder / "update.json"
    ran = CliRunner().invoke(app, ["update", str(folder), "--json", str(out)])
    assert ran.exit_code == 0, ran.output
    result = json.loads(out.read_text(encoding="utf-8"))
    values = {p["name"]: p["value"] for p in result["parameters"]}
    # Shear is what the plates' bending leaves to the layer.
    assert values["near.G"] == pytest.approx(342e6, rel=0.02)
    assert max(map(abs, result["errors_percent"])) < 0.02
    assert any("moved onto it" in note for note in result["notes"])


def test_shapes_beside_frequencies_of_several_torques(lap, truth):
    """Modes of a table find their shapes by frequency; spare ones stay away; units are said."""
    hz, shapes = truth
    real = "".join(
        mode_55(i + 1, hz[i], dict(zip(NODES, np.outer(shapes[:, i], (0, 0, 1)), strict=True)))
        for i in range(N_MODES)
    )
    rows = [f"{torque},{scale * hz[1]},{scale * hz[3]}" for torque, scale in ((5, 0.97), (20, 1))]
    test = (
        '[test]\nfrequencies = "f.csv"\ncondition = "torque"\nshapes_at = 5\n'
        '[test.shapes]\nfiles = ["modes.uff", "geometry.uff"]\nlength_unit = "mm"\n\n'
    )
    folder = lap(test, "", modes=real, geometry=nodes_15(NODES))
    table = "\n".join(["torque [N·m],b [Hz],d [Hz]", *rows])
    (folder / "f.csv").write_text(table, encoding="utf-8")
    data = load_case(folder).measurements()
    assert data.mode_names == ("b", "d") and data.shape_row == 0 and data.damping is None
    assert np.diag(mac(data.shapes, shapes[:, [1, 3]])) == pytest.approx(1, abs=1e-6)
    (folder / "f.csv").write_text(f"torque [N·m],b [Hz]\n5,{2 * hz[-1]}", encoding="utf-8")
    with pytest.raises(InputError, match=r"test: .*modes.uff.*within 10 % of each of"):
        load_case(folder)


def test_files_that_do_not_fit_the_model_are_one_error(lap, truth):
    """Millimetres read as metres, axes turned, and nodes of which some are elsewhere."""
    turned = nodes_2411({n: (-x, y, z) for n, (x, y, z) in NODES.items()})
    away = nodes_2411({n: (x, y, z + 20 * (n % 100 == 2)) for n, (x, y, z) in NODES.items()})
    inside = '[test]\nshapes = "a.uff"\n\n'
    metres = '[test.shapes]\nfiles = "a.uff"\nlength_unit = "m"\n\n'
    wrong = {
        "were mm and not m": (metres, universal(truth, units=False)),
        "with (-x, y, z) in place": (inside, universal(truth, geometry=turned)),
        "6 of 12 sensors are outside": (inside, universal(truth, geometry=away)),
    }
    for words, (test, content) in wrong.items():
        folder = lap(test, "", a=content)
        case = load_case(folder)
        with pytest.raises(InputError) as caught:
            test_notes(case, build_structure(case, MPI.COMM_SELF))
        assert words in str(caught.value)


SEEN = '[test.sees]\nalong = "x"\npositions = [0.1]\ndirection = [0, 0, 1]\n\n'
IN_MM = '[test.shapes]\nfiles = "shapes.csv"\nlength_unit = "mm"\n\n'


@pytest.mark.parametrize(
    ("test", "words"),
    [
        (f'[test]\nshapes = "shapes.uff"\n{SEEN}', "whose nodes are the sensors"),
        ('[test]\nshapes = "shapes.csv"\n\n', "expected frequencies, shapes in a universal"),
        ('[test]\nshapes = "other.uff"\n\n', r"test.shapes: .*other.uff: no such file"),
        ('[test]\nshapes = "shapes.uff"\nmodes = ["one"]\n\n', "1 modes are named: expected 5"),
        (f'[test]\nfrequencies = "f.csv"\n{IN_MM}', "expected one table, or universal files"),
    ],
)
def test_mistakes_in_the_case_are_named(lap, truth, test, words):
    with pytest.raises(InputError, match=words):
        load_case(lap(test, "", shapes=universal(truth)))
