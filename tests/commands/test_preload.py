"""Cases with contacts and bolts: what they mean, their mistakes, and the commands that use them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from typer.testing import CliRunner

from fenics_joints.case import load_case
from fenics_joints.cli import app
from fenics_joints.commands.preload import run_preload
from fenics_joints.errors import InputError
from fenics_joints.meshes import CBeams, c_beams
from fenics_joints.modal import solve_modes
from fenics_joints.preload import BeamBolt, Contact, PreloadModel, solve_preload
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.progress import Progress
from fenics_joints.structure import PointMass, Structure, part

DEMO = Path(__file__).resolve().parents[2] / "demos" / "c_beam"
SMALL = {"element_size": 6e-3, "radial_size": 3e-3, "middle_size": 25e-3}
#: The demo's case on the small mesh, with eight-node elements: fast, and of no other use.
COARSE = [
    ('\nelement_size = "2.5 mm"', '\nelement_size = "6 mm"'),
    ('\nradial_size = "1.5 mm"', '\nradial_size = "3 mm"'),
    ('\nmiddle_size = "20 mm"', '\nmiddle_size = "25 mm"'),
    ("\ndegree = 2", "\ndegree = 1"),
]

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


def write_beams(folder: Path, *edits: tuple[str, str]) -> Path:
    """Put the coarse case there; on rank 0 only."""
    shutil.copy(DEMO / "frequencies.csv", folder)
    text = (DEMO / "case.toml").read_text(encoding="utf-8")
    for old, new in (*COARSE, *edits):
        assert old in text, f"{old!r} is not in the case"
        text = text.replace(old, new, 1)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


MISTAKES = [
    ('pad_length = "49.7', 'pad_lenght = "49.7', ["mesh.pad_lenght", "mean 'pad_length'"]),
    ('lower = "interface_lower"', 'lower = "interface"', ["contacts.pads.lower = 'interface'"]),
    ('lower = "washer_1_lower"', 'lower = "washer_lower"', ["bolts.bolt_1.lower", "washer_1_l"]),
    ('force = "28.0 kN"', "", ["bolts.bolt_1", "either force or torque"]),
    ('force = "28.0 kN"', 'torque = "25.1 N m"', ["bolts.bolt_1", "needs the thread"]),
    ('force = "28.0 kN"', 'force = 1\nthread = "5/16-25"', ["bolts.bolt_1.thread", "5/16-24"]),
    ('kind = "beam"', 'kind = "beams"', ["bolts.bolt_1.kind = 'beams'", "mean 'beam'"]),
    ("[bolts.bolt_1]", "[bolts.pads]", ["bolts.pads", "contacts.pads"]),
    ('travel = ["204 mm"', 'travel = ["260 mm"', ["masses.accelerometers_middle", "x = 0.254"]),
    ('"beams.E", mode', '"beam.E", mode', ["update.cutoff.calibrate.parameter", "mean 'beams.E'"]),
    ('mode = "mode 10"', 'mode = "mode 6"', ["update.cutoff.calibrate.mode = 'mode 6'"]),
]


@serial
@pytest.mark.parametrize(("old", "new", "said"), MISTAKES)
def test_mistakes(tmp_path, old, new, said):
    write_beams(tmp_path, (old, new))
    with pytest.raises(InputError) as caught:
        load_case(tmp_path)
    for fragment in [str(tmp_path / "case.toml"), *said]:
        assert fragment in str(caught.value)


@serial
@pytest.mark.parametrize("torque, force", [(10.2, 8.6e3), (16.9, 14.3e3), (25.1, 21.2e3)])
def test_torque_is_the_papers_force(tmp_path, torque, force):
    """Fronk et al. 2019, Table 3."""
    given = f'torque = "{torque} N m"\nthread = "5/16-24"\nfriction = 0.107'
    case = load_case(write_beams(tmp_path, ('force = "28.0 kN"', given)))
    assert case.bolts["bolt_1"].preload() == pytest.approx(force, rel=6e-3)
    assert case.bolts["bolt_2"].preload() == 28e3


@pytest.mark.parametrize("kind", [{}, {"bonded": True}, {"layer": 1e-4}])
def test_builder_knows_its_groups(kind):
    """A case is checked against the names that the builder's mesh has."""
    beams = CBeams(**SMALL, n_thickness=(2, 1), **kind)
    tagged = beams.build(MPI.COMM_WORLD)
    assert [*map(sorted, beams.groups())] == [sorted(tagged.cell_names), sorted(tagged.facet_names)]


def by_hand(comm) -> PreloadModel:
    """The coarse case without its file."""
    places = ((0.254, 0.0127), (0.254, -0.0127), (0.102, 0.0127), (0.406, -0.0127))
    structure = Structure(
        c_beams(comm, **SMALL, n_thickness=(1, 1)),
        [part("beams", ("beam_1", "beam_2"), E=194e9, nu=0.29, rho=8000.0)],
        masses=[PointMass(f"at {x}, {z}", 0.02, (x, 0, z)) for x, z in places],
        degree=1,
    )
    given = {"E": 194e9, "nu": 0.29, "rho": 8000.0, "head_mass": 8e-3}
    bolts = [
        BeamBolt(f"b{i}", f"washer_{i}_lower", f"washer_{i}_upper", 28e3, 7.94e-3, **given)
        for i in (1, 2)
    ]
    contact = Contact("pads", "interface_lower", "interface_upper", friction=0.3)
    return PreloadModel(structure, [contact], bolts)


@pytest.mark.parallel
def test_preload_command(shared_tmp_path, keeps_rules):
    """The command finds, on any number of ranks, what the objects make of the same numbers."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        write_beams(shared_tmp_path)
    comm.barrier()
    case = load_case(shared_tmp_path)
    found = run_preload(case, comm, Progress(silent=True), fields=shared_tmp_path / "p.xdmf")
    page, facts = found.page().html(), found.json()
    keeps_rules(page)
    assert len(repr(found.result)) <= 120
    model = by_hand(MPI.COMM_SELF)
    state = solve_preload(model)["pads"]
    contact = facts["contacts"][0]
    # Two bolts of 28 kN.
    assert contact["force_n"] == pytest.approx(56e3, rel=1e-6)
    assert contact["peak_pressure_pa"] == pytest.approx(state.facet_pressure.max(), rel=1e-6)
    assert contact["area_m2"] == pytest.approx(state.area, rel=1e-9)
    # Symmetric ends; each radius is that of its own pad, not the way to the other.
    radius = contact["radius_m"]
    assert radius["bolt_1"] == pytest.approx(radius["bolt_2"], rel=1e-4)
    assert 0.01 < radius["bolt_1"] < 0.03
    stuck = solve_modes(LinearJoint(model), n_modes=13).frequencies_hz[6:12]
    assert facts["frequencies_hz"]["stuck"] == pytest.approx(stuck, rel=1e-7)
    # A preload leaves edges open: frequencies fall, that of clapping most.
    ratio = np.array(facts["frequencies_hz"]["preloaded"]) / stuck
    assert np.all(ratio < 1 + 1e-6) and ratio[0] < 0.97 and ratio.max() > 0.9999
    comm.barrier()
    assert (shared_tmp_path / "p.xdmf").is_file()
    assert (f"{contact['peak_pressure_pa'] / 1e6:.1f} MPa" in page) == (comm.rank == 0)


@serial
def test_update_command(tmp_path, keeps_rules):
    """The cut-off of least error, its crossings and its page, from the sweep's own numbers."""
    write_beams(tmp_path, ('scheme = "both"', 'scheme = "two"'))
    out, page = tmp_path / "u.json", tmp_path / "u.html"
    options = ["--json", str(out), "--report", str(page)]
    done = CliRunner().invoke(app, ["update", str(tmp_path), *options])
    assert done.exit_code == 0, done.output
    found = json.loads(out.read_text())
    test = np.array([258, 331, 478, 567, 710, 855.0])  # Fronk et al. 2019, Table 1
    # Mode 10 is calibrated, and E is what it takes: frequencies go with its root, but for bolts.
    assert found["frequencies_hz"]["stuck"][3] == pytest.approx(567, rel=1e-5)
    plain = solve_modes(LinearJoint(by_hand(MPI.COMM_SELF)), n_modes=13).frequencies_hz[9]
    scale = found["calibration"]["value"] / 194e9
    assert scale == pytest.approx((567 / plain) ** 2, rel=2e-3)
    (two,) = found["schemes"]
    cutoffs, hz = np.array(two["sweep"]["cutoffs_pa"]), np.array(two["sweep"]["frequencies_hz"])
    objective = np.abs(hz / test - 1).sum(axis=1)
    assert two["objective"] == pytest.approx(objective.min(), rel=1e-12)
    assert two["cutoff_pa"] == cutoffs[objective.argmin()]
    # Less held is never stiffer, within what the reduced models err.
    assert np.all(hz[1:, 0] <= hz[:-1, 0] * (1 + two["reduced_error"]))
    for j, place in enumerate(two["crossings_pa"]):
        if place is not None:
            assert np.interp(place, cutoffs, hz[:, j]) == pytest.approx(test[j], rel=1e-9)
    assert two["minimum"]["objective"] == pytest.approx(two["objective"], rel=1e-3)
    assert two["minimum"]["full_solutions"] <= 15 and two["reduced_error"] < 2e-4
    assert "cut-off pressure" in done.output
    keeps_rules(page.read_text())


#: Two plates with two screws whose faces slide without friction.
SLIDING = Path(__file__).parent / "data" / "preload"


def test_faces_that_slide_leave_motions_and_six_elastic_modes():
    """A plate glides on the other along two directions and turns; the table has no mode less."""
    found = run_preload(load_case(SLIDING), MPI.COMM_SELF, Progress(silent=True))
    facts, report = found.json(), found.result
    assert facts["free_motions"] == 3
    hz = facts["frequencies_hz"]
    assert len(hz["stuck"]) == len(hz["preloaded"]) == 6
    assert min(hz["stuck"] + hz["preloaded"]) > 100
    # By their order, freed modes seemed to rise by 20 %; freed of a constraint no mode does.
    pairs = [(a, b) for a, b in zip(hz["stuck"], hz["stuck_become"], strict=True) if b]
    assert len(pairs) >= 2 and all(b < 1.005 * a for a, b in pairs)
    (contact,) = facts["contacts"]
    assert contact["force_n"] == pytest.approx(sum(facts["bolt_forces_n"].values()), rel=1e-6)
    assert contact["area_above_1_mpa_m2"] <= contact["area_m2"] <= contact["whole_area_m2"]
    for bolt, (equal, least, most) in contact["equal_radius_m"].items():
        assert least <= equal <= most and equal <= contact["radius_m"][bolt] * 1.02
    json.dumps(facts)
    # Receding contact: twice the force, twice the pressure on the same area.
    state, solver = report.result["joint"], report.result.solver
    twice = solver.solve({name: 2 * f for name, f in facts["bolt_forces_n"].items()})["joint"]
    assert np.array_equal(twice.status, state.status)
    assert np.abs(twice.pressure - 2 * state.pressure).max() < 1e-6 * twice.pressure.max()
    assert any("receding" in note for note in facts["notes"])


def test_odd_friction_and_torque_are_noted(tmp_path):
    """Friction of 20 holds what touches, as 0.15 does, and is noted, as is a torque of 1e12.

    Friction of 1e9 is refused.
    """
    text, made = (SLIDING / "case.toml").read_text(), {}
    (tmp_path / "two_w.step").write_bytes((SLIDING / "two_w.step").read_bytes())
    for friction, torque in (("0.15", '"25 N m"'), ("20", "1e12")):
        changed = text.replace("friction = 0\n", f"friction = {friction}\n")
        changed = changed.replace('torque = "25 N m"', f"torque = {torque}")
        (tmp_path / "case.toml").write_text(changed)
        case = load_case(tmp_path)
        made[friction] = run_preload(case, MPI.COMM_SELF, Progress(silent=True)).json()
    hz = [made[key]["frequencies_hz"]["preloaded"] for key in made]
    assert hz[0] == pytest.approx(hz[1], rel=1e-6)
    assert len(made["20"]["notes"]) == len(made["0.15"]["notes"]) + 2
    (tmp_path / "case.toml").write_text(text.replace("friction = 0\n", "friction = 1e9\n"))
    with pytest.raises(InputError, match="friction"):
        run_preload(load_case(tmp_path), MPI.COMM_SELF, Progress(silent=True))
