"""``fenics-joints check`` on cases that are wrong, each in one way, and on those that are right."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.check.run import check_case
from fenics_joints.modal.modes import solve_modes
from fenics_joints.progress import Progress

DEMOS = Path(__file__).resolve().parents[2] / "demos"
CASE, TABLE, SHAPES = "case.toml", "frequencies.csv", "shapes.csv"
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
    names = [f"mode {i + 1}" for i in range(len(hz))]
    write(folder / TABLE, ["torque [N·m]", *(f"{n} [Hz]" for n in names)], [[23.0, *hz]])
    write(folder / SHAPES, names, seen)
    text = (folder / CASE).read_text(encoding="utf-8")
    text = text.partition("[update.held]")[0] + "[diagnose]\nn_modes = 16\n"
    text = text.replace("[test]\n", '[test]\nshapes = "shapes.csv"\n')
    (folder / CASE).write_text(text, encoding="utf-8")
    return folder


def write(path: Path, head, rows) -> None:
    lines = [",".join(head)]
    lines += [",".join("" if np.isnan(x) else f"{x:.8g}" for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


Edit = Callable[[Path], None]


def text(old: str, new: str) -> Edit:
    """Replaces a text of the case, which is a regular expression."""

    def edit(folder: Path) -> None:
        before = (folder / CASE).read_text(encoding="utf-8")
        after, n = re.subn(old, new, before, flags=re.M)
        assert n, old
        (folder / CASE).write_text(after, encoding="utf-8")

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
        write(folder / file, names, np.hstack([values[: len(numbers), :first], numbers]))

    return edit


def replaced(file: str, old: str, new: str) -> Edit:
    """Replaces a text of one of the files."""

    def edit(folder: Path) -> None:
        before = (folder / file).read_text(encoding="utf-8")
        assert old in before
        (folder / file).write_text(before.replace(old, new), encoding="utf-8")

    return edit


def setting(index, value) -> Callable[[np.ndarray], None]:
    """Sets some numbers to a value, or to what a function makes of all."""

    def change(x: np.ndarray) -> None:
        x[index] = value(x) if callable(value) else value

    return change


def times(factor: float, column=slice(None)) -> Callable[[np.ndarray], None]:
    return setting((slice(None), column), lambda x: factor * x[:, column])


def columns(order) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x[:, order]


def both(*edits: Edit) -> Edit:
    def edit(folder: Path) -> None:
        for one in edits:
            one(folder)

    return edit


ONE_SENSOR = text(r"^positions = \[(.|\n)*?\]", 'positions = ["0 mm"]')
#: Without somebody's values and what is held out, which name all modes.
PLAIN = text(r"^\[update.held\](.|\n)*(?=^\[diagnose\])", "")
SWAP = [1, 0, 2, 3, 4, 5, 6, 7]
ROTATED = [1, 2, 3, 4, 5, 6, 7, 0]


def rows(order) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x[order]


N = 15  # sensors of the beams
#: Base, what is changed, and what a note or an error has to name.
WRONG = {
    # -- the table of frequencies
    "two modes exchanged": ("beams", table(columns(SWAP)), "'mode 1'"),
    "last two modes exchanged": ("beams", table(columns([0, 1, 2, 3, 4, 5, 7, 6])), "'mode 7'"),
    "descending": ("beams", table(columns(range(7, -1, -1))), "'mode 1'"),
    "a mode twice": ("beams", table(setting((0, 2), lambda x: x[0, 1])), "'mode 3'"),
    "first times ten": ("beams", table(times(10, 0)), "'mode 1'"),
    "third in kHz": ("beams", table(times(1e-3, 2)), "'mode 3'"),
    "first times ten with shapes": ("shaped", table(times(10, 0)), "'mode 1'"),
    "all halved": ("beams", table(times(0.5)), "0.5 times"),
    "all halved on plates": ("plates", table(times(0.5)), "0.5 times"),
    "all halved with shapes": ("shaped", table(times(0.5)), "0.5 times"),
    "all doubled": ("beams", table(times(2)), "2 times"),
    "rad/s called Hz": ("beams", table(times(2 * np.pi)), "6.28 times"),
    "rad/s called Hz on plates": ("plates", table(times(2 * np.pi)), "6.28 times"),
    "kHz called Hz": ("beams", table(times(1e-3)), "0.001 times"),
    "Hz called kHz": ("plates", table(times(1e3)), "test.frequencies"),
    "per minute": ("beams", table(times(60)), "60 times"),
    "an eigenvalue's square": ("beams", table(lambda x: (2 * np.pi * x) ** 2), "times the model's"),
    "one mode": ("beams", both(table(columns([0])), PLAIN), "test.frequencies"),
    "two modes for three parameters": (
        "beams",
        both(table(columns([0, 1])), PLAIN, text('"lap.k2"\\]', '"lap.k2", "beams.E"]')),
        "update.parameters",
    ),
    "a jump at one torque": ("plates", table(setting((3, 2), 1900.0)), "torque 8"),
    "a jump in the last mode": ("plates", table(setting((5, 3), 4100.0)), "'bending 4'"),
    "a blank mode": ("beams", table(setting((0, 0), np.nan)), "mode 1"),
    "a rigid motion": ("plates", table(lambda x: setting((slice(None), 0), 3.2)(x)), "'bending 1'"),
    "a mode of another structure": (
        "beams",
        table(lambda x: setting((0, 2), 600.0)(x)),
        "'mode 3'",
    ),
    "a decimal point": ("beams", table(times(0.1, 4)), "'mode 5'"),
    "in a row alone": ("plates", table(setting((3, 1), 98.7)), "torque 8"),
    # -- the sensors
    "one sensor": ("beams", ONE_SENSOR, "test.sees"),
    "sensors that see nothing": (
        "plates",
        text(r"^direction = \[0, 0, 1\]", "direction = [0, 1, 0]"),
        "test.sees",
    ),
    "sensors in mm": ("beams", text(r'"([\d]+) mm",', r'"\1 m",'), "test.sees"),
    "sensors 5 m away": ("plates", text(r'y = "40 mm"', 'y = "5 m"'), "sensor 1"),
    "sensors 5 m beside beams": (
        "beams",
        text(r'^along = "x"', 'along = "x"\nat = { y = "5 m" }'),
        "test.sees",
    ),
    "a sensor twice": ("beams", text(r'"40 mm", "80 mm"', '"40 mm", "40 mm"'), "sensor 2"),
    "direction of zero": ("beams", text(r"^direction = .*", "direction = [0, 0, 0]"), "direction"),
    "a direction of beams across": (
        "beams",
        text(r"^direction = .*", "direction = [0, 1, 0]"),
        "direction",
    ),
    # -- the table of shapes
    "a dead sensor": ("shaped", table(setting(4, 0.0), SHAPES), "sensor 5"),
    "a nearly dead sensor": (
        "shaped",
        table(setting(4, lambda x: 1e-5 * x[4]), SHAPES),
        "sensor 5",
    ),
    "a flipped sensor": ("shaped", table(setting(4, lambda x: -x[4]), SHAPES), "sensor 5"),
    "two flipped sensors": (
        "shaped",
        table(setting([4, 11], lambda x: -x[[4, 11]]), SHAPES),
        "sensor 12",
    ),
    "sensors exchanged": (
        "shaped",
        table(rows([0, 1, 2, 3, 9, 5, 6, 7, 8, 4, *range(10, N)]), SHAPES),
        "sensor 10",
    ),
    "rows rotated": ("shaped", table(rows([*range(1, N), 0]), SHAPES), "test.sees"),
    "rows reversed": ("shaped", table(rows(range(N - 1, -1, -1)), SHAPES), "test.sees"),
    "identical shapes": ("shaped", table(lambda x: x[:, :1] + 0 * x, SHAPES), "'mode 8'"),
    "two identical shapes": (
        "shaped",
        table(columns([0, 1, 2, 2, 4, 5, 6, 7]), SHAPES),
        "'mode 4'",
    ),
    "columns rotated": ("shaped", table(columns(ROTATED), SHAPES), "7 columns"),
    "two columns exchanged": ("shaped", table(columns(SWAP), SHAPES), "'mode 2'"),
    "a mode twice with its shape": (
        "shaped",
        both(
            table(setting((0, 2), lambda x: 1.001 * x[0, 1])),
            table(setting((slice(None), 2), lambda x: x[:, 1]), SHAPES),
        ),
        "'mode 3'",
    ),
    "columns reversed": ("shaped", table(columns(range(7, -1, -1)), SHAPES), "reverse"),
    "a sensor's gain of ten": (
        "shaped",
        table(setting(4, lambda x: 10 * x[4]), SHAPES),
        "sensor 5",
    ),
    "a sensor in mV": ("shaped", table(setting(4, lambda x: 1e-3 * x[4]), SHAPES), "sensor 5"),
    "all halved with joints softer": (
        "shaped",
        both(table(times(0.5)), text(r"^k2 = .*", "k2 = 1e4")),
        "0.5 times",
    ),
    "one doubled with its shape": ("shaped", table(times(2, 5)), "'mode 6'"),
    "no shape": ("shaped", table(setting((slice(None), 3), np.nan), SHAPES), "shapes"),
    # -- how good it is
    "noise of 1e-6": ("beams", text(r'noise = "0.1 %"', "noise = 1e-6"), "test.noise"),
    "noise of 0": ("beams", text(r'noise = "0.1 %"', 'noise = "0 %"'), "test.noise"),
    "tolerances of 0": (
        "beams",
        text(r"^tolerance = .*", "tolerance = { E = 0, rho = 0 }"),
        "parts.beams.tolerance.E",
    ),
    "a tolerance in per cent": (
        "beams",
        text(r'E = "1.5 %"', "E = 1.5"),
        "parts.beams.tolerance.E",
    ),
    "damping in per cent": ("plates", replaced("damping.csv", " [%]", ""), "damping.csv"),
    "damping of a third": (
        "plates",
        both(replaced("damping.csv", " [%]", ""), table(times(0.1), "damping.csv")),
        "test.damping",
    ),
    "torque in N mm": (
        "plates",
        both(
            *(
                replaced(file, "N·m", "N·mm")
                for file in (TABLE, "damping.csv", "frequencies_28Nm.csv")
            )
        ),
        "test.torque",
    ),
    # -- the model
    "beams 10.6 m thick": ("beams", text(r'"10.6 mm"', '"10.6 m"'), "mesh.thickness"),
    "beams 21 mm long": (
        "beams",
        text(r'\["360 mm", "260 mm"\]', '["3.6 mm", "260 mm"]'),
        "mesh.lengths",
    ),
    "lengths in m": (
        "beams",
        text(r'\["360 mm", "260 mm"\]', '["360 m", "260 m"]'),
        "mesh.lengths",
    ),
    "E in MPa": ("beams", text(r'"208 GPa"', '"208 MPa"'), "parts.beams"),
    "E in MPa on plates": (
        "plates",
        text(r'"69 GPa"\nG = "26.9 GPa"', '"69 MPa"\nG = "26.9 MPa"'),
        "parts.plates.E",
    ),
    "density of 7.85": ("beams", text(r'"7860 kg/m3"', "7.86"), "parts.beams.rho"),
    "density of 785": ("beams", text(r'"7860 kg/m3"', "78"), "parts.beams.rho"),
    "nu of 0.5": ("beams", text(r"^nu = 0.3 .*", "nu = 0.5"), "parts.beams.nu"),
    "nu of 30": ("beams", text(r"^nu = 0.3 .*", "nu = 30"), "parts.beams.nu"),
    "a bolt of 3 kg": ("beams", text(r'mass = "12 g"', 'mass = "3 kg"'), "masses.bolt"),
    "a bolt of 12 kg": ("beams", text(r'mass = "12 g"', "mass = 12"), "masses.bolt"),
    "one element a beam": (
        "beams",
        text(r"elements = \[30, 20\]", "elements = 1"),
        "mesh.elements",
    ),
    "plates meshed by 80 mm": (
        "plates",
        text(r'element_size = "20 mm"', 'element_size = "80 mm"'),
        "mesh.element_size",
    ),
    # -- what to do with it
    "starts off by 1e9": (
        "beams",
        text(r'"1000 N m", "lap.k2" = "20000 N m"', '1e12, "lap.k2" = 2e13'),
        "update.start.lap.k1",
    ),
    "a start in N mm": (
        "beams",
        text(r'"lap.k2" = "20000 N m"', '"lap.k2" = 2e9'),
        "update.start.lap.k2",
    ),
    "a band without a mode": (
        "nonlinear",
        text(r"band = .*", 'band = ["50 Hz", "65 Hz"]'),
        "harmonic.band",
    ),
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
    kind, edit, named = WRONG[name]
    prepared(kind, tmp_path, shaped, write_case)
    edit(tmp_path)
    found = checked(tmp_path)
    said = "\n".join([*found.errors, *found.notes])
    assert named in said, (said, found.solved)


#: What is right, although something looks odd: base, and what is changed.
RIGHT = {
    "beams": ("beams", []),
    "plates": ("plates", []),
    "beams with shapes": ("shaped", []),
    "shapes in another unit": ("shaped", [table(lambda x: 1e6 * x, SHAPES)]),
    "shapes of any sign": ("shaped", [table(lambda x: x * np.tile([1, -1], 4), SHAPES)]),
    "a blank cell": ("shaped", [table(setting((4, 2), np.nan), SHAPES)]),
    "modes in descending order with shapes": (
        "shaped",
        [table(columns(range(7, -1, -1))), table(columns(range(7, -1, -1)), SHAPES)],
    ),
    "a sensor that is not there": ("shaped", [table(setting(4, np.nan), SHAPES)]),
    "five sensors with shapes and a softer joint": (
        "shaped",
        [
            table(rows([0, 4, 7, 11, 14]), SHAPES),
            text(r"^k2 = .*", "k2 = 1e4"),
            text(
                r"^positions = \[(.|\n)*?\]",
                'positions = ["0 mm", "160 mm", "280 mm", "440 mm", "570 mm"]',
            ),
        ],
    ),
    "three sensors": (
        "beams",
        [text(r"^positions = \[(.|\n)*?\]", 'positions = ["10 mm", "200 mm", "500 mm"]')],
    ),
    "a mode left out": ("beams", [table(columns([0, 1, 2, 4, 5, 6, 7])), PLAIN]),
    "noise by lines alone": ("plates", [text(r"^noise = .*", "noise = 0")]),
}
for factor in (0.001, 0.01, 0.1, 0.3, 3, 10, 100):  # the gap is 20 to 300 %, and the joint's
    RIGHT[f"joints of beams times {factor}"] = (
        "beams",
        [text(r"^k1 = .*", f"k1 = {1763.2 * factor}"), text(r"^k2 = .*", f"k2 = {37402 * factor}")],
    )
    RIGHT[f"joints of beams with shapes times {factor}"] = (
        "shaped",
        RIGHT[f"joints of beams times {factor}"][1],
    )
    RIGHT[f"joints of plates times {factor}"] = (
        "plates",
        [
            text(r'^E = "863 MPa"\nG = .*', f"E = {863e6 * factor}\nG = {342e6 * factor}"),
            text(r'^E = "0.933 MPa"\nG = .*', f"E = {0.933e6 * factor}\nG = {0.446e6 * factor}"),
            text(r"^bounds = .*", ""),
        ],
    )
RIGHT["a dumbbell that is all joint"] = (
    "dumbbell",
    [text(r'^E = "1513 MPa"', 'E = "50 MPa"'), text(r"^bounds = .*", "")],
)
#: Sections that these alone are about, where a value is odd but the joint's.
ODD = ("joints.away.", "without a partner")


@pytest.mark.parametrize("name", RIGHT)
def test_what_is_right_is_not_doubted(tmp_path, shaped, write_case, name):
    """Also where the model is far off because of its joints."""
    kind, edits = RIGHT[name]
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
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addBox(0, 0, 0, 0.3, 0.1, 0.1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], name="block")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.009)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(tmp_path / "block.msh"))
    gmsh.finalize()
    (tmp_path / TABLE).write_text("row,a [Hz]\n1,5000\n", encoding="utf-8")
    (tmp_path / CASE).write_text(BLOCK, encoding="utf-8")
    found = checked(tmp_path)
    assert not found.errors and found.dofs > 40_000
    assert found.solved.startswith("not compared") and str(found.dofs) in found.solved


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
KNOWN = {"lap_beam/identified.toml": 2, "half_lap_beam/drawn.toml": 1}
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
