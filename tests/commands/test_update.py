"""``update`` on frequencies, shapes and functions: what it finds, predicts, says and writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from case_tables import write_frequencies, write_table
from dumbbell_case import SANDWICH
from mpi4py import MPI
from rich.console import Console

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.update.data import update_data
from fenics_joints.commands.update.document import update_document
from fenics_joints.commands.update.run import update_case
from fenics_joints.commands.update.words import accuracy, in_words, start_words
from fenics_joints.errors import InputError
from fenics_joints.measurements.frfs import choose_lines, near_peaks
from fenics_joints.meshes import dumbbell
from fenics_joints.modal import identifiability, solve_modes
from fenics_joints.reduction.frf_basis import CombinedModel
from fenics_joints.response import solve_frf
from fenics_joints.structure import Damping, Parameter, Sensors, Structure, part, transition
from fenics_joints.updating.result import is_at

E, NU, H, LOSS = 10e9, 0.24, 10e-3, 0.02
BODIES = ("head_1", "neck_1", "neck_2", "head_2")
#: Corners, the last two on body 2, whose places are those of the case's mesh.
POINTS = [(0.12, 0.09, -0.13), (-0.12, 0.09, -0.13), (0.12, -0.09, 0.15), (0.12, 0.09, 0.15)]
AXES = np.tile(np.eye(3), (len(POINTS), 1))
LINES = np.arange(450.0, 2700.0, 30.0)
NAMES = [f"mode {i + 1}" for i in range(6)]
NOISE, FUNCTION_NOISE = 2e-4, 0.01

CASE = (
    """
title = "Sandwich"
[mesh]
builder = "dumbbell"
layer = "20 mm"
element_size = "60 mm"
"""
    + SANDWICH
    + """\
[damping]
structural = 0.004
hysteretic = {{ joint = "5 %" }}
[test]
frequencies = "f.csv"
shapes = "x.csv"
noise = 2e-4
shape_noise = "1 %"
[test.sees]
points = {points}
directions = {directions}
[test.frfs]
files = ["frf.csv", "nodes.csv"]
noise = "1 %"
[update]
"""
)


@pytest.fixture(scope="module")
def test_files(shared_module_path) -> Path:
    """Files of a test of dumbbells with a thinner layer, in a mesh of its own thickness."""
    tagged = dumbbell(MPI.COMM_WORLD, layer=H, element_size=0.06)
    model = Structure(
        tagged,
        [
            part("bodies", BODIES, E=130e9, nu=0.27, rho=7850.0),
            transition("joint", "joint", E=E, nu=NU, h=H, meshed=H),
        ],
    )
    rng = np.random.default_rng(3)
    points = np.array(POINTS)
    points[points[:, 2] > 0, 2] -= 20e-3 - H
    sensors = Sensors(np.repeat(points, 3, axis=0), AXES)
    modes = solve_modes(model, n_modes=12)
    shapes = modes.at(sensors)[:, 6:]
    size = np.sqrt(np.mean(shapes**2, axis=0))
    shapes = shapes + 0.01 * size * rng.standard_normal(shapes.shape)
    f = modes.frequencies_hz[6:] * np.exp(NOISE * rng.standard_normal(6))
    some, force = Sensors(sensors.points[[0, 2, 9, 11]], AXES[[0, 2, 9, 11]]), [0, 2]
    H_ij = solve_frf(
        model,
        frequencies_hz=LINES,
        sensors=some,
        kind="accelerance",
        excitation=Sensors(sensors.points[force], AXES[force]),
        damping=Damping(structural=0.004, hysteretic={"joint": LOSS}),
    ).values
    noise = rng.standard_normal((2, *H_ij.shape))
    H_ij = H_ij * (1 + FUNCTION_NOISE * (noise[0] + 1j * noise[1]))
    if MPI.COMM_WORLD.rank == 0:
        _write(shared_module_path, f, shapes, H_ij)
    MPI.COMM_WORLD.barrier()
    return shared_module_path


def _write(folder: Path, f, shapes, H_ij) -> None:
    write_frequencies(folder, f, file="f.csv")
    write_table(folder / "x.csv", NAMES, shapes)
    pairs = [f"{r}/{s}" for r in ("1:+x", "1:+z", "4:+x", "4:+z") for s in ("1:+x", "1:+z")]
    heads = [f"{pair} {part} [m/s2/N]" for pair in pairs for part in ("re", "im")]
    flat = H_ij.reshape(len(LINES), -1)
    table = np.stack([flat.real, flat.imag], axis=2).reshape(len(LINES), -1)
    write_table(folder / "frf.csv", ["frequency [Hz]", *heads], np.column_stack([LINES, table]))
    nodes = [(i + 1, *point) for i, point in enumerate(POINTS)]
    write_table(folder / "nodes.csv", ["node", "x [m]", "y [m]", "z [m]"], nodes)


@pytest.fixture(scope="module")
def shared_module_path(tmp_path_factory) -> Path:
    """A folder that all ranks have in common."""
    comm = MPI.COMM_WORLD
    return Path(comm.bcast(str(tmp_path_factory.mktemp("test")) if comm.rank == 0 else None))


def _case(folder: Path, update: str, name: str):
    points = [list(p) for p in POINTS for _ in range(3)]
    text = CASE.format(points=points, directions=AXES.tolist()) + update
    path = folder / f"{name}.toml"
    if MPI.COMM_WORLD.rank == 0:
        path.write_text(text, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return load_case(path)


EVERYTHING = """
parameters = ["joint.E", "joint.nu", "joint.h", "joint.loss_factor"]
lines = 40
[update.held]
modes = ["mode 5"]
responses = ["4:+z"]
bands = [["1500 Hz", "1700 Hz"]]
"""


@pytest.fixture(scope="module")
def everything(test_files):
    """An update to all three kinds of data, parts of each held out."""
    return update_case(_case(test_files, EVERYTHING, "everything"), MPI.COMM_WORLD)


@pytest.mark.parallel
def test_finds_the_truth(everything):
    """From twice the thickness, on another mesh: within the stated standard deviations."""
    assert everything.kinds == ("frequencies", "shapes", "frfs")
    for p, true in zip(everything.parameters, (E, NU, H, LOSS), strict=True):
        sd = p["relative_standard_deviation"]
        assert abs(p["value"] / true - 1) < max(3.5 * sd, 1e-4) and sd < 0.01, p["name"]
    found = everything.update
    assert found.chi2 / found.degrees_of_freedom == pytest.approx(1, abs=0.25)
    assert not everything.notes
    before, after = everything.conditions
    assert before > 1e6 * after


def assert_predicted(held: dict, times: float) -> None:
    """Within so many standard deviations, and far nearer than before."""
    allowed = times * np.hypot(100 * NOISE, held["standard_deviation_percent"])
    before = 100 * abs(held["before_hz"] / held["test_hz"] - 1)
    assert abs(held["error_percent"]) < allowed < 0.2 * before


@pytest.mark.parallel
def test_predicts_what_it_did_not_see(everything):
    (held,) = everything.held
    assert held["name"] == "mode 5" and held["alone"]
    assert_predicted(held, 5)
    functions, levels = everything.functions, everything.functions.summary()
    assert functions.held[:, functions.names[0].index("4:+z")].all()
    outside = (LINES < 1500) | (LINES > 1700)
    assert not functions.lines[~outside].any() and functions.lines.sum() == 40
    # Noise of 1 % is 0.087 dB.
    assert levels["held_after"] < 0.13 < 1 < levels["held_before"]
    assert np.diag(everything.modes.mac_after).min() > 0.999
    assert not everything.modes.fitted[4] and everything.modes.fitted.sum() == 5


def test_tells_it(everything):
    """JSON, page and summary hold what was found."""
    outcome = Outcome(everything, update_document(everything))
    data = json.loads(json.dumps(outcome.json(), allow_nan=False))
    assert data["method"] == "log" and data["parameters"][0]["determined"]
    assert data["modes"][4]["fitted"] is False and data["held_modes"][0]["name"] == "mode 5"
    assert data["functions_db"]["fitted_after"] == everything.functions.summary()["fitted_after"]
    page = outcome.page().html()
    for text in ('id="held-modes"', "4:+z by 1:+x", "joint.loss_factor", "MAC before"):
        assert text in page
    console = Console(width=80, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    outcome.summary(console)
    shown = console.export_text()
    assert "mode 5 *" in shown and "held out" in shown
    assert max(len(line) for line in shown.splitlines()) <= 80 and shown.count("\n") <= 42


def test_a_thin_layer_is_seen_as_a_spring(test_files):
    """Six frequencies know E / h far better than E and h; and each frequency is predicted from the
    other five, since the model is right."""
    update = """
parameters = ["joint.E", "joint.nu", "joint.h"]
data = "frequencies"
[update.held]
modes = "each"
"""
    report = update_case(_case(test_files, update, "each"), MPI.COMM_WORLD)
    assert [h["name"] for h in report.held] == NAMES
    for held in report.held:
        assert_predicted(held, 4)
    E_found, _, h_found = report.update.values
    assert E_found / h_found == pytest.approx(E / H, rel=0.01)
    assert report.parameters[0]["relative_standard_deviation"] > 20 * NOISE
    assert report.functions is None and "their ratio" in " ".join(
        in_words(report.update.identifiability)
    )


def test_words():
    """The direction that data leave open, in words, is that of the smallest singular value."""
    ratio = np.array([[100.0, -100.0, 3.0], [50.0, -50.0, -8.0], [0.1, 0.1, 0.0]])
    for slopes, words in (
        (ratio, ["determine nu, but not E and h", "their ratio"]),
        (ratio * [1, -1, 1], ["their product"]),
        (ratio[:1, :2], ["do not determine it at all"]),
    ):
        said = " ".join(in_words(identifiability(slopes, ("E", "h", "nu")[: slopes.shape[1]])))
        assert all(word in said for word in words) and "∞" not in said
    assert accuracy(1.4e5) == "open" and accuracy(0.012) == "1.2 %"


def test_weighted(test_files):
    """The paper's equations go astray on functions from the paper's start, and say so; on
    frequencies with limited steps they find what frequencies know."""
    update = """
parameters = ["joint.E", "joint.nu", "joint.h"]
method = "weighted"
step_limit = 0.3
data = ["frequencies", "frfs"]
lines = 12
"""
    astray = update_case(_case(test_files, update, "astray"), MPI.COMM_WORLD)
    assert not astray.update.converged and np.isfinite(astray.update.values).all()
    assert any("has diverged" in note or "has not converged" in note for note in astray.notes)
    outcome = Outcome(astray, update_document(astray))
    fit = json.loads(json.dumps(outcome.json(), allow_nan=False))["fit"]
    assert fit["converged"] is False and fit["reason"] == astray.update.message
    assert "not converged" in outcome.page().html() and outcome.failure is None
    only = update.replace(', "frfs"', "").replace("lines = 12\n", "")
    report = update_case(_case(test_files, only, "weighted"), MPI.COMM_WORLD)
    assert report.update.method == "weighted" and report.update.converged
    E_found, nu_found, h_found = report.update.values
    assert E_found / h_found == pytest.approx(E / H, rel=0.02)
    assert nu_found == pytest.approx(NU, rel=0.02)


def test_functions_alone(test_files):
    """No mode of the test says how far up the basis has to reach: the lines do."""
    case = _case(test_files, 'parameters = ["joint.E"]\ndata = "frfs"\n', "bare")
    target, damping = update_data(case).target, case.damping.damping()
    model = CombinedModel(
        build_structure(case, MPI.COMM_WORLD, damping=True), target, damping, n_modes=10
    )
    values = {**case.nominal(damping=True), "joint.E": 12e9}
    model.add(values)
    model.build()
    assert len(target) == 0 and model.error_at(values, model.modes(values)).frfs < 0.02


def test_what_the_data_leave_open(test_files):
    """One frequency for two parameters: what their standard deviations are then, is said."""
    held = ", ".join(f'"{name}"' for name in NAMES[1:])
    update = f"""
parameters = ["joint.E", "joint.h"]
data = "frequencies"
[update.held]
modes = [{held}]
"""
    report = update_case(_case(test_files, update, "open"), MPI.COMM_WORLD)
    # Half of the start's variance of ln E and of ln h is left, all in their product.
    log_sd = [p["relative_standard_deviation"] for p in report.parameters]
    assert log_sd == pytest.approx([2.3 / np.sqrt(2)] * 2, rel=0.3)
    assert report.update.identifiability.undetermined == ("joint.E", "joint.h")
    assert "update.regularisation = 2.3" in start_words(report.update.identifiability, report.pull)
    outcome = Outcome(report, update_document(report))
    assert 'id="pull"' in outcome.page().html() and outcome.json()["fit"]["regularisation"] == 2.3


def test_a_start_beyond_its_bounds_is_refused(test_files):
    update = """
parameters = ["joint.E", "joint.loss_factor"]
start = { "joint.loss_factor" = 3 }
"""
    with pytest.raises(InputError, match=r"update.start.joint.loss_factor = 3.*to 1"):
        update_case(_case(test_files, update, "beyond"), MPI.COMM_WORLD)


def test_bounds_have_the_parameters_size():
    """A damping of a microsecond is not at its bound of a nanosecond, though both are near 0 s."""
    beta = Parameter("beta", 1e-6, "s", 1e-9, 1e-3, log=True)
    assert is_at(beta, 1.001e-9, 1e-9) and not is_at(beta, 1e-6, 1e-9)
    nu = Parameter("nu", 0.3, "", 0.0, 0.49, log=False)
    assert is_at(nu, 1e-4, 0.0) and not is_at(nu, 0.01, 0.0)


def test_lines():
    """Lines crowd where functions change, and keep off resonances when damping is not sought."""
    f = np.linspace(50.0, 250.0, 401)
    H_ij = (1 / (100.0**2 - f**2 + 2j * 100 * f * 0.01) + 1 / (200.0**2 - f**2 + 4j * f))[
        :, None, None
    ]
    valley = f[np.argmin(np.abs(H_ij[100:300, 0, 0])) + 100]
    every = choose_lines(f, H_ij, 30)
    assert len(np.unique(every)) == 30 and np.all(np.diff(every) > 0)
    near = np.abs(f[every] - 100) < 5
    # Twice as many as if they were spread evenly.
    assert near.sum() > 2 * 30 * 10 / 200 and np.abs(f[every] - valley).min() < 5
    away = choose_lines(f, H_ij, 30, peaks=False)
    peaks = near_peaks(H_ij)
    # Half-power width 2 zeta f = 2 Hz: five lines of 0.5 Hz, give or take one.
    assert 3 <= peaks[(f > 90) & (f < 110)].sum() <= 6 and not peaks[away].any()
    allowed = f < 150
    assert np.all(allowed[choose_lines(f, H_ij, 10, allowed=allowed)])
