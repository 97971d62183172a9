"""Cases with nonlinear joints: what they mean, their mistakes, and the ``harmonic`` command."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest
import ufl
from case_tables import write_table
from dolfinx import fem
from harmonic_case import CONTACT, LAYER, write
from mpi4py import MPI
from typer.testing import CliRunner

from fenics_joints.case import build_structure, load_case
from fenics_joints.cli import app
from fenics_joints.commands.harmonic.model import harmonic_model
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.commands.harmonic.view import peak_shapes
from fenics_joints.errors import InputError
from fenics_joints.harmonic import solve_backbone
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")
QUIET, SELF = Progress(silent=True), MPI.COMM_SELF

FREE = (
    ('[supports.clamp]\nfacets = "clamp"\n', ""),
    ('measured = "frf.csv"\n', "interface_modes = 0\n"),
    ('levels = ["0.01 N", "10 N"]', 'levels = ["1e-8 N", "2 N"]'),
    ('force = { point = ["100 mm"', 'force = { point = ["20 mm"'),  # not at a node of the mode
    ('damping = "1 %"', 'damping = "0.2 %"'),
    ("samples = 64", "samples = 32"),
)
BAND, LAYER_LAW = 'band = ["25 Hz", "31 Hz"]', 'E = "5 MPa"\nG = "1.7 MPa"'
SOFT = (BAND, 'band = ["168 Hz", "177 Hz"]')
BONDED = (
    (LAYER_LAW, 'E = "207 GPa"\nG = "80 GPa"'),
    (BAND, 'band = ["194 Hz", "199 Hz"]'),
    ('S_y = "500 kPa"', 'S_y = "500 GPa"'),
)
#: The same joint by its stiffness per area, and the beam on soft cords.
HUNG = (
    SOFT,
    (LAYER_LAW, 'law = "springs"\nk_n = "83.3 GPa/m"\nk_t = "28.3 GPa/m"'),
    (
        "[harmonic]",
        """[springs.cords]
points = [["100 mm", "0 mm", "-6 mm"], ["400 mm", "0 mm", "6 mm"]]
direction = [0, 0, 1]
stiffness = "100 N/m"
[harmonic]""",
    ),
)


def view_of(page: str) -> dict:
    """What a page's view draws."""
    return json.loads(re.search(r'application/json">(.*?)</script>', page, re.DOTALL)[1])


@pytest.mark.smoke
@pytest.mark.parallel
def test_small_forces_give_the_linear_resonance_and_large_ones_soften_and_damp(shared_tmp_path):
    static = "samples = 64", 'samples = 64\nquasi_static = "full"'
    case = load_case(write(shared_tmp_path, LAYER, static))
    outcome = run_harmonic(case, MPI.COMM_WORLD, QUIET)
    report = outcome.result
    assert len(repr(report)) <= 120
    small, large = report.facts
    built = harmonic_model(case, SELF, QUIET)
    modes = solve_modes(built.model, n_modes=3)
    hz = modes.frequencies_hz[built.mode]
    force, sensor = (
        built.model.row(kind, name) @ modes.vector(built.mode)
        for kind, name in (("forces", "force"), ("sensors", "sensor"))
    )
    receptance = abs(force * sensor) / (2 * 0.01 * (2 * np.pi * hz) ** 2)
    assert small.peak_hz == pytest.approx(hz, rel=5e-4)
    assert small.peak_displacement_m / small.level == pytest.approx(receptance, rel=2e-3)
    assert small.damping_ratio == pytest.approx(0.01, rel=1e-2)
    assert large.peak_hz < small.peak_hz * (1 - 1e-4)
    assert large.damping_ratio > 1.02 * small.damping_ratio
    # All that the force puts in beyond the modes' damping goes to the joint.
    assert large.joint_energy_j["lap"] > 0
    assert (large.measured_peak_hz, large.measured_peak) == (27.8, 90.0)
    assert small.measured_peak is None
    # The backbone passes the peaks: phase resonance and amplitude resonance differ by zeta^2.
    b = report.backbone
    at = np.interp(large.peak_displacement_m, b.amplitude("sensor"), b.frequencies_hz)
    assert large.peak_hz == pytest.approx(at, rel=1e-3)
    # And static loads of the full model say the same of the mode, in the same table.
    for row, f in zip(report.mode_records(), report.facts, strict=True):
        assert row["displacement_m"] == f.peak_displacement_m
        assert row["static_hz"] == pytest.approx(row["periodic_hz"], rel=1e-3)
        assert row["static_damping"] == pytest.approx(row["periodic_damping"], rel=0.02)
    page = outcome.page().html()
    assert MPI.COMM_WORLD.rank > 0 or "quasi-static, full, Hz" in page
    if MPI.COMM_WORLD.rank == 0:
        names = [look["name"] for look in view_of(page)["looks"]]
        hz = [f"{f.peak_hz:.3f} Hz" for f in (large, small)]
        assert names[:2] == [f"peak at 10.0 N, {hz[0]}", f"peak at 10.0 mN, {hz[1]}"]
        assert names[2:] == ["shear strain at 10.0 N", "energy per cycle at 10.0 N"]


@pytest.mark.parallel
def test_command_writes_the_same_on_any_number_of_ranks_and_goes_on_from_branches(
    shared_tmp_path, monkeypatch
):
    write(shared_tmp_path, LAYER, *NARROW, FEW)
    branches = shared_tmp_path / "branches"
    runner, contents = CliRunner(), []
    for name in ("first", "again"):
        files = [str(shared_tmp_path / f"{name}.{kind}") for kind in ("json", "html")]
        arguments = ["harmonic", str(shared_tmp_path), "--branches", str(branches)]
        found = runner.invoke(app, [*arguments, "--json", files[0], "--report", files[1]])
        assert found.exit_code == 0, found.output
        MPI.COMM_WORLD.barrier()
        contents.append(json.loads(Path(files[0]).read_text(encoding="utf-8")))
        assert contents[-1].pop("run")["ranks"] == MPI.COMM_WORLD.size
    # The structure's modes are solved anew, branches are not.
    rest = [c.pop("frequencies_at_rest_hz") for c in contents]
    assert rest[1] == pytest.approx(rest[0], rel=1e-9) and contents[0] == contents[1]
    # A case that has changed has no business with them.
    write(shared_tmp_path, LAYER, *NARROW, FEW, ('damping = "1 %"', 'damping = "1.01 %"'))
    with pytest.raises(InputError, match=r"model.h5: holds another model"):
        run_harmonic(load_case(shared_tmp_path), MPI.COMM_WORLD, QUIET, branches=branches)
    write(shared_tmp_path, LAYER, *NARROW, FEW)
    if MPI.COMM_WORLD.size > 1:
        peaks = [level["peak"] for level in contents[0]["levels"]]
        alone = run_harmonic(load_case(shared_tmp_path), SELF, QUIET).result
        assert peaks == pytest.approx([f.peak for f in alone.facts], rel=1e-5)
    pages = [(shared_tmp_path / f"{n}.html").read_text("utf-8") for n in ("first", "again")]
    # A model that was kept has no mesh to look at.
    assert [page.count("<svg") for page in pages] == [5, 4] and "10.0 N" in pages[0]


@serial
@pytest.mark.parametrize("changes", [(SOFT,), BONDED, HUNG], ids=["free", "bonded", "hung"])
def test_a_free_beam_resonates_as_its_linear_modes_say_and_slips(tmp_path, changes):
    """Its rigid motions take part in the response, and determine nothing of the joint."""
    case = load_case(write(tmp_path, LAYER, *FREE, *changes))
    report = run_harmonic(case, SELF, QUIET).result
    small, large = report.facts
    modes = solve_modes(build_structure(case, SELF), n_modes=8)
    assert modes.n_rigid == (4 if changes == HUNG else 6)
    (i,) = np.flatnonzero(np.abs(modes.frequencies_hz / small.peak_hz - 1) < 1e-3)
    places = Sensors([case.harmonic.force.point, case.harmonic.sensor.point], [0, 0, 1])
    force, sensor = modes.at(places)[:, i]
    receptance = abs(force * sensor) / (2 * 0.002 * modes.eigenvalues[i])
    assert small.peak_displacement_m / small.level == pytest.approx(receptance, rel=1e-2)
    assert small.damping_ratio == pytest.approx(0.002, rel=2e-2)
    slips = changes != BONDED
    assert (large.damping_ratio > 1.05 * small.damping_ratio) == slips
    assert (large.peak_hz < small.peak_hz * (1 - 1e-4)) == slips
    # Free, what the force puts in per cycle moves the mean nowhere.
    mean = report.responses[-1].coefficients[:, :, 0]
    free = report.built.model.free_motions()
    assert np.abs(mean @ free.inertia).max() < 1e-9


NARROW = (
    ('band = ["25 Hz", "31 Hz"]', 'band = ["26.8 Hz", "29.2 Hz"]'),
    ("samples = 64", "samples = 32"),
)
FEW = ("harmonics = 3", "harmonics = 3\ninterface_modes = 0\nmodes = 6")
IDENTIFY = 'frf.csv"\n[harmonic.identify]\nlevel = "{}"\nparameters = "{}'
FORCE_LINE = 'force = { point = ["100 mm", "0 mm", "-6 mm"], direction = [0, 0, 1] }\n'
SMALL = (
    ('measured = "frf.csv"\n', "backbone = false\n"),
    ('["0.01 N", "10 N"]', '["0.001 N"]'),
    ("harmonics = 3", "harmonics = 1"),
)


@serial
def test_a_base_that_shakes_is_the_inertia_of_the_mode(tmp_path):
    """Of acceleration, and of the displacement that is the same at the peak."""
    base = "harmonics = 1", "harmonics = 1\nbase = { direction = [0, 0, 1] }"
    edits = (*SMALL[:1], (FORCE_LINE, ""), (SMALL[1][0], '["1 mm/s2"]'), SMALL[2], base)
    case = load_case(write(tmp_path, LAYER, *edits))
    outcome = run_harmonic(case, SELF, QUIET)
    (fact,) = outcome.result.facts
    structure = build_structure(case, SELF)
    modes = solve_modes(structure, n_modes=3)
    i = outcome.result.built.mode
    shape = modes.shape(i)
    cells = [structure.tagged.cell_tag(name) for name in ("beam_1", "beam_2")]
    dx = ufl.Measure("dx", structure.mesh, subdomain_data=structure.tagged.cell_tags)
    push = 7800.0 * fem.assemble_scalar(fem.form(shape[2] * dx(tuple(cells))))
    sensor = modes.at(Sensors([case.harmonic.sensor.point], [0, 0, 1]))[0, i]
    expected = 1e-3 * abs(push * sensor) / (2 * 0.01 * modes.eigenvalues[i])
    assert fact.peak_displacement_m == pytest.approx(expected, rel=2e-3)
    assert outcome.json()["level_unit"] == "m/s2" and "base acceleration" in outcome.page().html()
    moved = 1e-3 / (2 * np.pi * fact.peak_hz) ** 2
    edits = (
        *edits[:2],
        (SMALL[1][0], f'["{1e9 * moved:.9g} nm"]'),
        SMALL[2],
        (base[0], base[1].replace("}", ', motion = "displacement" }')),
    )
    (by_way,) = run_harmonic(load_case(write(tmp_path, LAYER, *edits)), SELF, QUIET).result.facts
    assert by_way.peak_displacement_m == pytest.approx(fact.peak_displacement_m, rel=1e-3)


@serial
@pytest.mark.slow
def test_loads_of_a_case_add_up_with_their_phases(tmp_path):
    """A second one at the same place, a quarter of a cycle later, is as much again."""
    one = run_harmonic(load_case(write(tmp_path, LAYER, *SMALL)), SELF, QUIET).result.facts[0]
    load = "loads = [{" + FORCE_LINE.strip()[9:-1] + "phase_degrees = -90 }]"
    load = "harmonics = 1\n" + load.replace("1] phase", "1], phase")
    edits = (*SMALL[:2], (SMALL[2][0], load))
    two = run_harmonic(load_case(write(tmp_path, LAYER, *edits)), SELF, QUIET).result.facts[0]
    assert two.peak_displacement_m == pytest.approx(np.sqrt(2) * one.peak_displacement_m, rel=1e-4)
    assert two.peak_hz == pytest.approx(one.peak_hz, rel=1e-4)


@serial
def test_identification_finds_the_strength_that_made_the_curves(tmp_path):
    """Curves of one strength, with other sliders; the level that is not fitted is met as well."""
    one = '"0.01 N", "10 N"]', '"7 N", "10 N"]'
    edits = one, *NARROW, FEW, ('damping = "1 %"', 'damping = "1 %"\nbackbone = false')
    true = ('S_y = "500 kPa"', 'S_y = "400 kPa"\nsliders = 30')
    true_case = load_case(write(tmp_path, LAYER, *edits, true))
    made = run_harmonic(true_case, SELF, QUIET).result
    rows = []
    for level, r in zip((7, 10), made.responses, strict=True):
        a = r.amplitude("sensor", "acceleration")
        around = range(max(r.peak.index - 8, 0), r.peak.index + 9)
        rows += [(level, r.frequencies_hz[i], a[i]) for i in around]
    wanted = IDENTIFY.format("10 N", "lap.S_y") + '"\nmethod = "gradient'
    write(tmp_path, LAYER, *edits, ("frf.csv", wanted))
    heads = ["level [N]", "frequency [Hz]", "amplitude [m/s2]"]
    write_table(tmp_path / "frf.csv", heads, rows)
    outcome = run_harmonic(load_case(tmp_path), SELF, QUIET)
    report = outcome.result
    (found,) = report.identified
    assert found.values["lap.S_y"] == pytest.approx(400e3, rel=0.02)
    assert found.start["lap.S_y"] == 500e3 and found.evaluations < 30
    unseen, fitted = report.predictions
    assert unseen.level == 7 and abs(unseen.amplitude_error) < 0.01
    assert outcome.json()["identified"][0]["undetermined"] == []
    assert "predicted" in outcome.page().html()


@serial
def test_contact_with_friction_under_preload(tmp_path, keeps_rules):
    # 120 N on beams of 6 mm open gaps of nanometres, which the smaller force must not close.
    levels = 'levels = ["0.01 N", "10 N"]', 'levels = ["0.00002 N", "3 N"]'
    edits = levels, *NARROW, ('measured = "frf.csv"\n', "")
    full = "interface_modes = 30", 'interface_modes = 30\nquasi_static = "full"'
    with pytest.raises(InputError, match="quasi_static = 'full': expected layers"):
        run_harmonic(load_case(write(tmp_path, CONTACT, full)), SELF, QUIET)
    static = full[0], 'interface_modes = 15\nquasi_static = "reduced"'
    case = load_case(write(tmp_path, CONTACT, *edits, static))
    outcome = run_harmonic(case, SELF, QUIET)
    report = outcome.result
    (small, large), built = report.facts, report.built
    # Not all of the lap is pressed: the mode at rest is that of the closed part.
    assert small.peak_hz == pytest.approx(built.frequencies_hz[built.mode], rel=1e-3)
    # Bending presses one end of the lap while the other opens: with little friction it slides, and
    # what it takes is at most friction over the largest slip, back and forth.
    loops = report.responses[-1].loops(report.responses[-1].peak.index)["lap"]
    points = report.built.model.interfaces[0]
    pressure = points.law.parameters["pressure"][:, 0] - loops.stress[..., 0].min(axis=1)
    most = 4 * points.weights @ (0.02 * pressure * loops.slip_amplitude)
    assert 0.02 * most < large.joint_energy_j["lap"] < most
    assert large.damping_ratio > small.damping_ratio
    row = report.mode_records()[-1]
    assert row["static_hz"] == pytest.approx(row["periodic_hz"], rel=0.01)
    page = outcome.page().html()
    keeps_rules(page)
    # What is seen of the sensor's point is what the table says; the joint's values are its own.
    shapes = peak_shapes(report)
    x, moved = (a.reshape(-1, 3) for a in (shapes.vertices, shapes.motions[-1]))
    line = np.flatnonzero(np.linalg.norm(x[:, 1:] - [5e-3, 6e-3], axis=1) < 1e-6)
    line = line[np.argsort(x[line, 0])]
    seen = np.interp(0.41, x[line, 0], moved[line, 2])
    assert abs(seen) == pytest.approx(large.peak_displacement_m, rel=2e-3)
    view = view_of(page)
    values, spot = (
        np.frombuffer(base64.b64decode(text), "<i2")
        for text in (view["looks"][2]["values"], view["points"])
    )
    x = view["middle_mm"] + view["unit_mm"] * spot.reshape(-1, 3) / 32767
    lap = (x[:, 0] > 185 - 1e-2) & (x[:, 0] < 235 + 1e-2) & (np.abs(x[:, 2]) < 1e-2)
    assert np.array_equal(values >= 0, lap) and values.max() == 32767
    assert view["looks"][2]["shown"][1] == pytest.approx(loops.slip_amplitude.max())


@serial
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('law = "richard_abbott"', 'law = "richard"', "did you mean 'richard_abbott'"),
        ("[nonlinear.lap]", "[nonlinear.lop]", "nonlinear.lop: no joint or contact"),
        ('S_y = "500 kPa"', 'S_y = "500 N"', "nonlinear.lap.S_y"),
        ('levels = ["0.01 N", "10 N"]', 'levels = ["0 N"]', "harmonic.levels"),
        ('band = ["25 Hz", "31 Hz"]', 'band = ["31 Hz", "25 Hz"]', "low < high"),
        ("samples = 64", "samples = 8", "four for each harmonic"),
        ('measured = "frf.csv"', 'measured = "frs.csv"', "harmonic.measured: .*no such file"),
        ('stress = "equivalent"', 'stress = "peel"', "nonlinear.lap.stress"),
        (FORCE_LINE, "", "either force or base"),
        ("samples = 64", 'samples = 64\nbifurcations = "perhaps"', "harmonic.bifurcations"),
        ("harmonics = 3", "harmonics = 3\nbase = { direction = [0, 0, 1] }", "levels of a base"),
        ("frf.csv", IDENTIFY.format("10 N", "lap.S_z"), "did you mean 'lap.S_y'"),
        ("frf.csv", IDENTIFY.format("0.01 N", "lap.S_y"), "not among the measured curves"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        load_case(write(tmp_path, LAYER, (old, new)))


@serial
def test_a_band_without_a_mode_is_named(tmp_path):
    case = load_case(write(tmp_path, LAYER, ('["25 Hz", "31 Hz"]', '["5 Hz", "8 Hz"]')))
    with pytest.raises(InputError, match="no mode is near it"):
        run_harmonic(case, SELF, QUIET)


@serial
@pytest.mark.slow
def test_a_backbone_identifies_the_law_and_the_answer_says_what_it_cannot(tmp_path):
    """Phase resonance of the truth, with noise; the case's damping and modulus are a bit wrong."""
    few = "interface_modes = 0\nmodes = 6\n"
    bare = LAYER.replace('measured = "frf.csv"\n', few).replace("500 kPa", "200 kPa")
    built = harmonic_model(load_case(write(tmp_path, bare)), SELF, QUIET)
    truth = solve_backbone(
        built.model, (1e-4, 5e-3), force="force", near=28, sensor="sensor", harmonics=3, samples=64
    )
    at, rng = np.linspace(0, len(truth) - 1, 8).astype(int), np.random.default_rng(3)
    levels = truth.amplitude("sensor", "acceleration")[at] / 9.80665
    hz = truth.frequencies_hz[at] * (1 + 2e-4 * rng.normal(size=8))
    percent = 100 * truth.damping_ratios[at] * (1 + 0.01 * rng.normal(size=8))
    heads = ["level [g]", "frequency [Hz]", "damping [%]"]
    write_table(tmp_path / "data.csv", heads, zip(levels, hz, percent, strict=True))
    write(
        tmp_path,
        bare + '[harmonic.identify]\nparameters = ["lap.S_y"]\n[test]\namplitude = '
        '{ "bending 1" = { files = "data.csv", noise = "0.02 %", damping_noise = "1 %" } }\n',
        ('S_y = "200 kPa"', 'S_y = "400 kPa"'),
        ('damping = "1 %"', 'damping = "0.8 %"'),
        ('E = "207 GPa"', 'E = "208 GPa"'),
        ('levels = ["0.01 N", "10 N"]', 'levels = ["0.1 N"]'),
    )
    found, page = tmp_path / "found.json", tmp_path / "page.html"
    files = ["--json", str(found), "--report", str(page)]
    run = CliRunner().invoke(app, ["harmonic", str(tmp_path), *files])
    assert run.exit_code == 0, run.output
    (one,) = json.loads(found.read_text(encoding="utf-8"))["identified"]
    assert abs(np.log(one["values"]["lap.S_y"] / 200e3)) < 2.5 * one["sd_ln"]["lap.S_y"] < 0.1
    rest = one["backbone"]["at_rest"]
    assert rest["damping at rest"]["value"] == pytest.approx(2e-3, abs=3e-4)
    assert rest["frequency at rest"]["value"] < 0
    words = " ".join(run.output.split())
    assert "Identified from a mode at 8 amplitudes (backbone)" in words
    assert "below the model's" in words and "more than the model, at all" in words
    html = page.read_text(encoding="utf-8")
    assert "from a mode at 8 amplitudes" in html and "Crosses: the test." in html
