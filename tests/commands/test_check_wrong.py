"""``fenics-joints check`` on cases that are wrong, each in one way, and on those that are right."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from block_file import write_block
from case_tables import write_frequencies, write_table
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.check.run import check_case
from fenics_joints.meshes.step_writer import write_step
from fenics_joints.modal.modes import solve_modes
from fenics_joints.progress import Progress

DEMOS = Path(__file__).resolve().parents[2] / "demos"
CASE, TABLE, SHAPES, DAMPING = "case.toml", "frequencies.csv", "shapes.csv", "damping.csv"
ACROSS = "direction = [0, 1, 0]"
#: The joint that the virtual test of beams with shapes has: the nominal one times these.
TRUE = {"lap.k1": 0.6, "lap.k2": 1.7}


def checked(path: Path):
    return check_case(path, MPI.COMM_SELF, Progress(silent=True))


def base(source: str | Path, folder: Path) -> None:
    """Copies a case, that of the demo's beams unless another folder is given."""
    source = DEMOS / "bolted_beams" if source == "beams" else source
    for file in source.iterdir():
        if file.suffix in (".toml", ".csv"):
            shutil.copy(file, folder)


@pytest.fixture(scope="module")
def shaped(tmp_path_factory) -> Path:
    """The demo's beams with frequencies and shapes of another joint, and noise."""
    folder = tmp_path_factory.mktemp("shaped")
    base("beams", folder)
    case = load_case(folder)
    model = build_structure(case, MPI.COMM_SELF)
    values = {name: factor * model.values()[name] for name, factor in TRUE.items()}
    modes = solve_modes(model, values, n_modes=11)
    rng, elastic = np.random.default_rng(1), slice(modes.n_rigid, None)
    hz = modes.frequencies_hz[elastic]
    seen = modes.at(case.sensors())[:, elastic]
    seen = seen / np.abs(seen).max(axis=0) + 0.02 * rng.standard_normal(seen.shape)
    names = write_frequencies(folder, hz, condition="torque [N·m]", conditions=[23.0])
    write_table(folder / SHAPES, names, seen)
    text = (folder / CASE).read_text(encoding="utf-8")
    text = text.partition("[update.held]")[0] + "[diagnose]\nn_modes = 16\n"
    text = text.replace("[test]\n", '[test]\nshapes = "shapes.csv"\n')
    (folder / CASE).write_text(text, encoding="utf-8")
    return folder


Edit = Callable[[Path], None]


def text(old: str, new: str, file: str = CASE) -> Edit:
    """Replaces a text of a file, which is a regular expression."""

    def edit(folder: Path) -> None:
        before = (folder / file).read_text(encoding="utf-8")
        after, n = re.subn(old, new, before, flags=re.M)
        assert n, old
        (folder / file).write_text(after, encoding="utf-8")

    return edit


def table(change: Callable[[np.ndarray], np.ndarray | None], file: str = TABLE) -> Edit:
    """Changes the numbers of a table, without the column of its condition."""

    def edit(folder: Path) -> None:
        head, *rows = (folder / file).read_text(encoding="utf-8").splitlines()
        values = np.array([[float(x or "nan") for x in row.split(",")] for row in rows])
        first = 0 if file == SHAPES else 1
        numbers = values[:, first:].copy()
        found = change(numbers)
        numbers = numbers if found is None else found
        names = head.split(",")[: first + numbers.shape[1]]
        write_table(folder / file, names, np.hstack([values[: len(numbers), :first], numbers]))
        blanks = (folder / file).read_text(encoding="utf-8").replace("nan", "")
        (folder / file).write_text(blanks, encoding="utf-8")

    return edit


def shapes(change: Callable[[np.ndarray], np.ndarray | None]) -> Edit:
    return table(change, SHAPES)


def setting(index, value) -> Callable[[np.ndarray], None]:
    """Sets some numbers to a value, or to what a function makes of all."""

    def change(x: np.ndarray) -> None:
        x[index] = value(x) if callable(value) else value

    return change


def times(factor: float, column=slice(None)) -> Callable[[np.ndarray], None]:
    return setting((slice(None), column), lambda x: factor * x[:, column])


def columns(*order) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x[:, order]


def rows(*order) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x[list(order)]


def sensors(*places: str) -> Edit:
    return text(r"^positions = \[(.|\n)*?\]", f"positions = {json.dumps(places)}")


#: Without somebody's values and what is held out, which name all modes.
PLAIN = text(r"^\[update.held\](.|\n)*(?=^\[diagnose\])", "")
THREE = text('"lap.k2"\\]', '"lap.k2", "beams.E"]')
#: A joint that is softer than the test's.
SOFT = text("^k2 = .*", "k2 = 1e4")
SWAP, ROTATED, REVERSED = (1, 0, 2, 3, 4, 5, 6, 7), (1, 2, 3, 4, 5, 6, 7, 0), range(7, -1, -1)
N = 15  # sensors of the beams
LAST = range(10, N)

#: Base, what a note or an error has to name, and what is changed.
WRONG = {
    # -- the table of frequencies
    "two modes exchanged": ("beams", "'mode 1'", table(columns(*SWAP))),
    "a mode twice": ("beams", "'mode 3'", table(setting((0, 2), lambda x: x[0, 1]))),
    "first times ten": ("beams", "'mode 1'", table(times(10, 0))),
    "all halved": ("beams", "0.5 times", table(times(0.5))),
    "all halved with shapes": ("shaped", "0.5 times", table(times(0.5))),
    "rad/s called Hz": ("beams", "6.28 times", table(times(2 * np.pi))),
    "Hz called kHz": ("plates", "test.frequencies", table(times(1e3))),
    "an eigenvalue's square": ("beams", "times the model's", table(lambda x: (2 * np.pi * x) ** 2)),
    "one mode": ("beams", "test.frequencies", table(columns(0)), PLAIN),
    "two modes for three": ("beams", "update.parameters", table(columns(0, 1)), PLAIN, THREE),
    "a jump at one torque": ("plates", "torque 8", table(setting((3, 2), 1900.0))),
    "a blank mode": ("beams", "mode 1", table(setting((0, 0), np.nan))),
    "a rigid motion": ("plates", "'bending 1'", table(setting((slice(None), 0), 3.2))),
    "a mode of another structure": ("beams", "'mode 3'", table(setting((0, 2), 600.0))),
    # -- the sensors
    "one sensor": ("beams", "test.sees", sensors("0 mm")),
    "sensors that see nothing": ("plates", "test.sees", text("^direction = .*1]", ACROSS)),
    "sensors in mm": ("beams", "test.sees", text(r'"([\d]+) mm",', r'"\1 m",')),
    "sensors 5 m beside beams": ("beams", "test.sees", text("^along.*", r"\g<0>\nat = {y = 5}")),
    "sensors 5 m away": ("plates", "sensor 1", text(r'y = "40 mm"', 'y = "5 m"')),
    "a sensor twice": ("beams", "sensor 2", text(r'"40 mm", "80 mm"', '"40 mm", "40 mm"')),
    "direction of zero": ("beams", "direction", text("^direction = .*", "direction = [0, 0, 0]")),
    "a direction of beams across": ("beams", "direction", text("^direction = .*", ACROSS)),
    # -- the table of shapes
    "a dead sensor": ("shaped", "sensor 5", shapes(setting(4, 0.0))),
    "a nearly dead sensor": ("shaped", "sensor 5", shapes(setting(4, lambda x: 1e-5 * x[4]))),
    "a flipped sensor": ("shaped", "sensor 5", shapes(setting(4, lambda x: -x[4]))),
    "sensors exchanged": ("shaped", "sensor 10", shapes(rows(0, 1, 2, 3, 9, 5, 6, 7, 8, 4, *LAST))),
    "rows rotated": ("shaped", "test.sees", shapes(rows(*range(1, N), 0))),
    "rows reversed": ("shaped", "test.sees", shapes(rows(*range(N - 1, -1, -1)))),
    "identical shapes": ("shaped", "'mode 8'", shapes(lambda x: x[:, :1] + 0 * x)),
    "columns rotated": ("shaped", "7 columns", shapes(columns(*ROTATED))),
    "two columns exchanged": ("shaped", "'mode 2'", shapes(columns(*SWAP))),
    "a mode twice with its shape": (
        "shaped",
        "'mode 3'",
        table(setting((0, 2), lambda x: 1.001 * x[0, 1])),
        shapes(setting((slice(None), 2), lambda x: x[:, 1])),
    ),
    "columns reversed": ("shaped", "reverse", shapes(columns(*REVERSED))),
    "a gain of ten": ("shaped", "sensor 5", shapes(setting(4, lambda x: 10 * x[4]))),
    "all halved with joints softer": ("shaped", "0.5 times", table(times(0.5)), SOFT),
    "one doubled with its shape": ("shaped", "'mode 6'", table(times(2, 5))),
    "no shape": ("shaped", "shapes", shapes(setting((slice(None), 3), np.nan))),
    # -- how good it is
    "noise of 0": ("beams", "test.noise", text(r'noise = "0.1 %"', 'noise = "0 %"')),
    "tolerances of 0": (
        "beams",
        "parts.beams.tolerance.E",
        text("^tolerance = .*", "tolerance = { E = 0, rho = 0 }"),
    ),
    "a tolerance in per cent": ("beams", "beams.tolerance.E", text(r'E = "1.5 %"', "E = 1.5")),
    "damping in per cent": ("plates", DAMPING, text(r" \[%\]", "", DAMPING)),
    "damping of a third": (
        "plates",
        "test.damping",
        text(r" \[%\]", "", DAMPING),
        table(times(0.1), DAMPING),
    ),
    "torque in N mm": (
        "plates",
        "test.torque",
        *(text("N·m", "N·mm", file) for file in (TABLE, DAMPING, "frequencies_28Nm.csv")),
    ),
    # -- the model
    "beams 10.6 m thick": ("beams", "mesh.thickness", text(r'"10.6 mm"', '"10.6 m"')),
    "beams 3.6 mm long": ("beams", "mesh.lengths", text('"360 mm"', '"3.6 mm"')),
    "density of 7.85": ("beams", "parts.beams.rho", text(r'"7860 kg/m3"', "7.86")),
    "nu of 0.5": ("beams", "parts.beams.nu", text(r"^nu = 0.3 .*", "nu = 0.5")),
    "a bolt of 12 kg": ("beams", "masses.bolt", text(r'mass = "12 g"', "mass = 12")),
    "one element a beam": ("beams", "mesh.elements", text(r"elements = \[.*\]", "elements = 1")),
    "plates by 80 mm": ("plates", "mesh.element_size", text('size = "20 mm"', 'size = "80 mm"')),
    # -- what to do with it
    "a start in N mm": ("beams", "start.lap.k2", text('"lap.k2" = "20000 N m"', '"lap.k2" = 2e9')),
    "a band without a mode": ("nonlinear", "harmonic.band", text(r"band = .*", "band = [50, 65]")),
}


def prepared(kind: str, folder: Path, shaped: Path, write_case) -> None:
    """Puts one of the right cases into a folder."""
    if kind == "plates":
        write_case(folder)
    elif kind == "nonlinear":
        shutil.copy(DEMOS / "lap_beam" / "nonlinear.toml", folder / CASE)
    else:
        base({"shaped": shaped, "dumbbell": DEMOS / "dumbbell"}.get(kind, kind), folder)


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(tmp_path, shaped, write_case, name):
    kind, named, *edits = WRONG[name]
    prepared(kind, tmp_path, shaped, write_case)
    for edit in edits:
        edit(tmp_path)
    found = checked(tmp_path)
    said = "\n".join([*found.errors, *found.notes])
    assert named in said, (said, found.solved)


#: What is right, although something looks odd: base, and what is changed.
RIGHT = {
    "beams": ("beams",),
    "plates": ("plates",),
    "beams with shapes": ("shaped",),
    "shapes in another unit": ("shaped", shapes(lambda x: 1e6 * x)),
    "shapes of any sign": ("shaped", shapes(lambda x: x * np.tile([1, -1], 4))),
    "a blank cell": ("shaped", shapes(setting((4, 2), np.nan))),
    "modes in descending order with shapes": (
        "shaped",
        table(columns(*REVERSED)),
        shapes(columns(*REVERSED)),
    ),
    "a sensor that is not there": ("shaped", shapes(setting(4, np.nan))),
    "five sensors with shapes and a softer joint": (
        "shaped",
        shapes(rows(0, 4, 7, 11, 14)),
        SOFT,
        sensors("0 mm", "160 mm", "280 mm", "440 mm", "570 mm"),
    ),
    "three sensors": ("beams", sensors("10 mm", "200 mm", "500 mm")),
    "a mode left out": ("beams", table(columns(0, 1, 2, 4, 5, 6, 7)), PLAIN),
    "noise by lines alone": ("plates", text("^noise = .*", "noise = 0")),
    "a dumbbell that is all joint": (
        "dumbbell",
        text('^E = "1513 MPa"', 'E = "50 MPa"'),
        text("^bounds = .*", ""),
    ),
}
for factor in (0.001, 0.1, 100):  # the gap is 20 to 300 %, and the joint's
    softer = [
        text(f"^{key} = .*", f"{key} = {value * factor}")
        for key, value in (("k1", 1763.2), ("k2", 37402))
    ]
    RIGHT[f"joints of beams times {factor}"] = ("beams", *softer)
    RIGHT[f"joints of beams with shapes times {factor}"] = ("shaped", *softer)
    RIGHT[f"joints of plates times {factor}"] = (
        "plates",
        text('^E = "863 MPa"\nG = .*', f"E = {863e6 * factor}\nG = {342e6 * factor}"),
        text('^E = "0.933 MPa"\nG = .*', f"E = {0.933e6 * factor}\nG = {0.446e6 * factor}"),
        text("^bounds = .*", ""),
    )
#: Sections that these alone are about, where a value is odd but the joint's.
ODD = ("joints.away.", "without a partner")


@pytest.mark.parametrize("name", RIGHT)
def test_what_is_right_is_not_doubted(tmp_path, shaped, write_case, name):
    """Also where the model is far off because of its joints."""
    kind, *edits = RIGHT[name]
    prepared(kind, tmp_path, shaped, write_case)
    for edit in edits:
        edit(tmp_path)
    found = checked(tmp_path)
    notes = [n for n in found.notes if "times" not in name or not any(odd in n for odd in ODD)]
    assert not found.errors and not notes, (found.errors, notes)
    assert found.solved.startswith("compared with ")


def test_a_large_model_is_solved_on_larger_elements(tmp_path, write_case):
    """With the same answer: nothing is wrong."""
    write_case(tmp_path, ('element_size = "20 mm"', 'element_size = "2.5 mm"'))
    found = checked(tmp_path)
    assert not found.errors and not found.notes and found.dofs > 40_000
    assert int(re.search(r"of (\d+) degrees", found.solved)[1]) < 40_000


def test_a_large_mesh_of_a_file_is_not_solved(tmp_path):
    write_block(tmp_path / "block.msh", (0.3, 0.1, 0.1), (32, 11, 11))
    (tmp_path / TABLE).write_text("row,a [Hz]\n1,5000\n", encoding="utf-8")
    (tmp_path / CASE).write_text(BLOCK, encoding="utf-8")
    found = checked(tmp_path)
    assert not found.errors and found.dofs > 40_000
    assert found.solved.startswith("not compared") and str(found.dofs) in found.solved


LOOSE = """
[mesh]
file = "a.step"
size = "10 mm"
joint = "layer"
[mesh.parts]
plate = 1
box = 2
[parts.plate]
cells = "plate"
E = "70 GPa"
nu = 0.3
rho = 2700
[parts.box]
cells = "box"
E = "70 GPa"
nu = 0.3
rho = 2700
[joints.foot]
cells = "joint"
law = "springs"
k_n = "STIFF Pa/m"
k_t = "STIFF Pa/m"
"""


@pytest.mark.parametrize("stiff, size", [("1e9", 10), ("1e12", 10), ("1e9", 4)])
def test_a_part_that_moves_alone_is_named(tmp_path, stiff, size):
    """Without a test, too: 22 g on 1e9 Pa/m over 4 cm2 bounce far below the plate's first mode."""

    def draw(occ):
        occ.addBox(0, 0, 0, 120, 80, 10)
        occ.addBox(50, 30, 10, 20, 20, 20)

    write_step(tmp_path / "a.step", draw)
    text = LOOSE.replace("STIFF", stiff).replace("10 mm", f"{size} mm")
    (tmp_path / CASE).write_text(text, encoding="utf-8")
    found = checked(tmp_path)
    assert not found.errors and found.solved.startswith("checked 12 modes")
    assert any("moves box alone" in note for note in found.notes) == (stiff == "1e9"), found.notes


BLOCK = """
[mesh]
file = "block.msh"

[parts.block]
cells = "block"
E = "70 GPa"
nu = 0.33
rho = "2700 kg/m3"

[test]
frequencies = "frequencies.csv"
condition = "row"
noise = "0.1 %"
"""
DEMO_CASES = sorted(path.relative_to(DEMOS) for path in DEMOS.glob("*/*.toml"))
#: What is said of a demo: of one that has a layer of the paper's as a part, and of a file that has
#: no deviations of damping.
KNOWN = {
    "lap_beam/identified.toml": 2,
    "half_lap_beam/drawn.toml": 1,
    "half_lap_beam/identified.toml": 1,  # its joint was fitted on this mesh
}
SLOW = {"c_beam", "cad_bracket", "lap_plates", "barc", "dumbbell", "jim_beam"}  # seconds each


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=str(path), marks=[pytest.mark.slow] * (path.parts[0] in SLOW))
        for path in DEMO_CASES
    ],
)
def test_demos_are_not_doubted(path):
    found = checked(DEMOS / path)
    assert not found.errors
    assert len(found.notes) == KNOWN.get(str(path), 0), found.notes
