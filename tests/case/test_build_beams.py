"""Cases with ``builder = "offset_beams"``: the commands, supports, travel, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from case_tables import write_table
from mpi4py import MPI
from virtual_beams import DEMO, written

from fenics_joints.case import build_structure, load_case, model_damping
from fenics_joints.commands.harmonic.run import run_harmonic
from fenics_joints.commands.modes import run_modes
from fenics_joints.commands.preload import run_preload
from fenics_joints.commands.update.run import update_case
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.structure import Sensors


@pytest.mark.parallel
def test_update_identifies_slap_and_slip():
    """Jalali et al. 2019, Tables 1 and 2."""
    found = update_case(load_case(DEMO), MPI.COMM_WORLD, Progress(silent=True))
    k1, k2 = (p["value"] for p in found.parameters)
    assert k1 == pytest.approx(1763.2, rel=0.04)
    assert k2 == pytest.approx(37402, rel=0.01)
    assert max(np.abs(found.published["errors_percent"])) < 0.2
    assert found.model == {"dofs": 168}  # nothing was reduced
    # Modes 6 to 8 are predicted, not fitted: Table 1.
    assert [held["name"] for held in found.held] == ["mode 6", "mode 7", "mode 8"]
    errors = [held["error_percent"] for held in found.held]
    np.testing.assert_allclose(errors, [-2.10, 5.07, -2.50], atol=0.4)
    assert MPI.COMM_WORLD.allgather(k1) == [k1] * MPI.COMM_WORLD.size


@pytest.mark.parallel
def test_what_the_commands_say_of_beams():
    """`modes` lists and draws them; what needs a mesh or contacts is refused in words."""
    case, quiet = load_case(DEMO), Progress(silent=True)
    outcome = run_modes(case, MPI.COMM_WORLD, quiet, n_modes=9)
    found = outcome.result
    assert found.modes.n_rigid == 3 and len(repr(found)) <= 120
    np.testing.assert_allclose(found.size_m, [0.57, 0.021, 0.0212])
    assert outcome.page().html().count("Mode shape") >= 6
    # The drawn corners move as sensors there do.
    corners, motion = found.modes.model.corner_motion([found.modes.vector(5)])
    sensors = Sensors(corners[::7].reshape(-1, 3), [1.0, 0, 1])
    read = found.modes.at(sensors)[:, 5]
    moved = motion[0, ::7].reshape(-1, 3) @ [1.0, 0, 1] / np.sqrt(2)
    np.testing.assert_allclose(moved, read, atol=1e-12 * np.abs(read).max())
    assert np.ptp(corners[..., 2]) == pytest.approx(2 * 0.0106)
    with pytest.raises(InputError, match="no mesh for multigrid"):
        run_modes(case, MPI.COMM_WORLD, quiet, method="iterative")
    with pytest.raises(InputError, match="expected sections .contacts.NAME."):
        run_modes(case, MPI.COMM_WORLD, quiet, state="preload")
    with pytest.raises(InputError, match="preload needs solid parts"):
        run_preload(case, MPI.COMM_WORLD, quiet)
    with pytest.raises(InputError, match="harmonic needs solid parts"):
        run_harmonic(case, MPI.COMM_WORLD, quiet)


@pytest.mark.parallel
def test_functions_identify_the_damping_too(shared_tmp_path):
    """Jalali et al. 2019, Fig. 13: c from functions of finer beams, by the matrices."""
    tmp_path, comm = shared_tmp_path, MPI.COMM_WORLD
    truth = {"lap.k1": 2000.0, "lap.k2": 33000.0, "lap.c": 0.5}
    mesh = load_case(DEMO).mesh.model_copy(update={"elements": [45, 30]})
    fine = load_case(DEMO).model_copy(update={"mesh": mesh})
    beams = build_structure(fine, MPI.COMM_WORLD)
    K, M, C = (getattr(beams, name)(truth) for name in ("stiffness", "mass", "damping_matrix"))
    places, up = {"1": 0.01, "2": 0.3, "3": 0.57}, [0.0, 0, 1]
    rows = beams.loads(Sensors([[x, 0, 0.0106 * (x < 0.4)] for x in places.values()], up)).T
    lines, noise = np.arange(100.0, 1000.0, 4.0), np.random.default_rng(4)
    omega = 2 * np.pi * lines
    H = np.array(
        [-w * w * rows @ np.linalg.solve(K + 1j * w * C - w * w * M, rows[0]) for w in omega]
    )
    H = H * (1 + 0.01 / np.sqrt(2) * (noise.standard_normal((*H.shape, 2)) @ [1, 1j]))
    if comm.rank == 0:
        head = [f"{n}:+z/1:+z {part} [m/s2/N]" for n in places for part in ("re", "im")]
        parts = [part for h in H.T for part in (h.real, h.imag)]
        write_table(
            tmp_path / "frf.csv", ["frequency [Hz]", *head], zip(lines, *parts, strict=True)
        )
        nodes = [(int(n), x, 0, 0.0106 * (x < 0.4)) for n, x in places.items()]
        write_table(tmp_path / "nodes.csv", ["node", "x [m]", "y [m]", "z [m]"], nodes)
    changes = {
        'parameters = ["lap.k1", "lap.k2"] ': 'parameters = ["lap.k1", "lap.k2", "lap.c"] ',
        "[test.sees]": '[test.frfs]\nfiles = ["frf.csv", "nodes.csv"]\nnoise = "1 %"\n[test.sees]',
        'modes = ["mode 6", "mode 7", "mode 8"]': 'responses = ["3:+z"]',
        "[update.held]": 'data = ["frfs"]\n[update.held]',
    }
    if comm.rank == 0:
        path = written(tmp_path, changes)
        text = path.read_text(encoding="utf-8")
        path.write_text(text[: text.index("[update.published]")], encoding="utf-8")
    comm.barrier()
    found = update_case(load_case(tmp_path), MPI.COMM_WORLD, Progress(silent=True))
    for row in found.parameters:
        assert row["value"] == pytest.approx(
            truth[row["name"]], rel=max(4 * row["relative_standard_deviation"], 5e-3)
        ), row
    held = found.functions.summary()
    assert held["held_after"] < 0.3 < 3 < held["held_before"]
    assert "samples" not in found.model
    # All of a joint's stiffness, by the name that the case has for it.
    more = "\n[damping]\nhysteretic = { lap = 0.02, beams = 1e-4 }\n"
    if comm.rank == 0:
        written(tmp_path, {}, more)
    comm.barrier()
    lossy = load_case(tmp_path)
    damping = model_damping(lossy, build_structure(lossy, MPI.COMM_WORLD, damping=True))
    names = ["lap.slap", "lap.slip", "beam_1", "lap.beam_1", "lap.beam_2", "beam_2"]
    assert list(damping.hysteretic) == names
    assert damping.viscous == {"lap.c": "lap.c"}


def test_supports_springs_travel_and_what_is_attached(tmp_path):
    more = """
[supports.clamp]
facets = "left"
[attached.cable]
kind = "mass"
mass = "5 g"
points = [["500 mm", "0 mm", "0 mm"]]
travel = ["450 mm", "560 mm"]
[springs.cord]
points = [["570 mm", "0 mm", "0 mm"]]
direction = [0, 0, 1]
stiffness = "1 MN/m"
"""
    case = load_case(written(tmp_path, {}, more))
    structure = build_structure(case, MPI.COMM_WORLD, attached=True, width=True)
    assert solve_modes(structure, n_modes=3).n_rigid == 0 and structure.n_dofs == 165
    held, heavier, moved, softer = (
        solve_modes(structure, given, n_modes=3).frequencies_hz
        for given in (
            {},
            {"cable.mass": 5e-3},
            {"cable.mass": 5e-3, "cable.travel": 0.05},
            {"cord.stiffness": 1e4},
        )
    )
    assert np.all(heavier < held) and softer[0] < 0.9 * held[0]
    assert moved[0] != pytest.approx(heavier[0], rel=1e-4)
    wider = structure.total_mass({"beams.width": 2.0}) - structure.total_mass()
    assert wider == pytest.approx(7860 * 0.021 * 0.0106 * 0.62)


def test_zones_of_a_lap(tmp_path):
    """Equal zones are the lap; the middle one, under the bolt, on its own is another structure."""
    zones = {
        "lap_elements = 5 ": "lap_elements = 5\nlap_zones = [2, 1, 2] ",
        'cells = "lap"': 'cells = ["zone_1", "zone_3"]',
    }
    more = """
[joints.bolted]
cells = "zone_2"
law = "generic"
k1 = 1763.2
k2 = 37402
c = 0.15
"""
    whole = build_structure(load_case(DEMO), MPI.COMM_WORLD)
    split = build_structure(load_case(written(tmp_path, zones, more)), MPI.COMM_WORLD)
    for call in ("stiffness", "mass", "damping_matrix"):
        a, b = (getattr(s, call)() for s in (split, whole))
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(b).max())
    change = split.stiffness({"bolted.k2": 1e5}) - split.stiffness()
    assert np.linalg.matrix_rank(change, tol=1.0) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({'law = "generic"': 'law = "uncoupled"'}, "E is missing.*k1 is given"),
        ({'k1 = "1763.2 N m"': 'k1 = "-5 N m"'}, r"joints\.lap\.k1 = .*expected above 0"),
        ({'k2 = "37402 N m"': 'k2 = "37402 N/m"'}, "measures something else"),
        ({'c = "0.15 N m s"': "G = 1e9"}, "G is given"),
        ({'cells = "lap"': 'cells = "beam_1"'}, "in none"),
        ({'laps = "50 mm"': 'laps = ["50 mm", "40 mm"]'}, "laps has 2 values: expected 1"),
        ({"lap_elements = 5 ": "lap_zones = [2, 2] "}, "zones of 5 elements together"),
        ({'laps = "50 mm"': 'laps = "300 mm"'}, "expected more than the sum of its laps"),
        ({'cells = ["beam_1", "beam_2"]': 'cells = ["beam_1"]'}, "'beam_2' is in none"),
        ({'"520 mm", "570 mm"]': '"520 mm", "580 mm"]'}, "point 15 at x = 0.58 m is beside"),
        ({"direction = [0, 0, 1]": "direction = [0, 1, 0]"}, "direction that is not y alone"),
        ({"shear = 1.2": "degree = 2"}, "beams have no cells"),
        ({"elements = [30, 20]": "elements = [300, 200]"}, "expected at most 400 in all"),
        ({'["lap.k1", "lap.k2"]': '["lap.k1", "lap.k2", "lap.c"]'}, "do not depend on damping"),
        ({'"mode 6", "mode 7"': '"mode 2"'}, "expected the highest modes"),
    ],
)
def test_bad_cases_are_said(changes, words, tmp_path):
    with pytest.raises(InputError, match=words):
        build_structure(load_case(written(tmp_path, changes)), MPI.COMM_WORLD)


def test_solid_cases_refuse_what_beams_have(tmp_path, write_case):
    write_case(tmp_path, ('mass = "160 g"', 'mass = "160 g"\ninertia = 1e-6'))
    with pytest.raises(InputError, match=r"bolts\.inertia.*offset_beams"):
        load_case(tmp_path)
