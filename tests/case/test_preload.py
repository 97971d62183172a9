"""Obstacles, displacements and loads in a case file: mistakes, closed forms, and what modes see."""

from __future__ import annotations

import pytest

pytest.importorskip("dolfinx")

from block_file import write_block
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.check.run import check_case, run_check
from fenics_joints.commands.modes import run_modes
from fenics_joints.commands.preload import run_preload
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress

SELF, QUIET = MPI.COMM_SELF, Progress(silent=True)
E, AREA, HEIGHT, WAY = 70e9, 4e-4, 0.04, 1e-5
FORCE = E * AREA * WAY / HEIGHT  # of a bar

BEAM = """
[mesh]
builder = "lap_beam"
[parts.beams]
cells = ["beam_1", "beam_2"]
E = "207 GPa"
nu = 0.3
rho = 7800
[supports.clamp]
facets = "clamp"
[obstacles.ball]
kind = "sphere"
facets = "washer_lower"
centre = ["210 mm", "0 mm", "-56.03 mm"]
radius = "50 mm"
friction = 0.2
travel = [0, 0, "0.1 mm"]
[displacements.grip]
facets = "tip"
value = ["free", "free", "-0.1 mm"]
[loads.hook]
facets = "washer_upper"
force = [0, 0, "-20 N"]
"""
MISTAKES = [
    ('facets = "washer_lower"', 'facets = "washer"', ["obstacles.ball.facets = 'washer'", "mean"]),
    ('facets = "tip"', 'facets = "tips"', ["displacements.grip.facets", "mean 'tip'"]),
    ('facets = "washer_upper"', 'facets = "hook"', ["loads.hook.facets", "is not in the mesh"]),
    ('kind = "sphere"', 'kind = "spheres"', ["obstacles.ball.kind = 'spheres'", "mean 'sphere'"]),
    ('kind = "sphere"', 'kind = "plane"', ["obstacles.ball.normal is missing", "unknown key"]),
    ('radius = "50 mm"', 'radius = "-50 mm"', ["obstacles.ball.radius = '-50 mm'", "above 0 m"]),
    ("friction = 0.2", "friction = -0.2", ["obstacles.ball.friction = -0.2", "at least 0"]),
    ('"0.1 mm"]\n[dis', '"0.1 N"]\n[dis', ["obstacles.ball.travel[2] = '0.1 N'", "a length"]),
    ('travel = [0, 0, "0.1 mm"]', "travel = [0, 0, 1]\nforce = [0, 0, 1]", ["both are given"]),
    ('travel = [0, 0, "0.1 mm"]', "force = [0, 0, 0]", ["obstacles.ball.force", "not zero"]),
    ('["free", "free", "-0.1 mm"]', '["free", "free"]', ["displacements.grip.value", "not 'free'"]),
    ('["free", "free", "-0.1 mm"]', '["fre", 0, 0]', ["value[0] = 'fre'", "a length", "'free'"]),
    ('["free", "free", "-0.1 mm"]', "[0]", ["displacements.grip.value", "2 items"]),
    ('force = [0, 0, "-20 N"]', "", ["loads.hook", "either force or pressure"]),
    ('force = [0, 0, "-20 N"]', "pressure = 0", ["loads.hook.pressure = 0", "other than zero"]),
    ("[loads.hook]", "[loads.grip]", ["loads.grip: the name is used by displacements.grip"]),
    ('facets = "tip"', 'facets = "washer_lower"', ["grip.facets", "obstacles.ball governs"]),
    ('facets = "tip"', 'facets = "clamp"', ["moves 'clamp' along z, in which supports.clamp"]),
]


@pytest.mark.parametrize(("old", "new", "words"), MISTAKES)
def test_mistakes(tmp_path, old, new, words):
    file = tmp_path / "case.toml"
    file.write_text(BEAM)
    assert load_case(file).obstacles["ball"].radius == 0.05
    assert BEAM.count(old) == 1
    file.write_text(BEAM.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_case(file)
    for fragment in [str(file), *words]:
        assert fragment in str(caught.value)


def test_what_does_not_count_is_refused(tmp_path):
    """Ways and loads without contact; a rest on obstacles; models and fits that have no contact."""
    file = tmp_path / "case.toml"

    def refused(text, words, load=load_case):
        file.write_text(text)
        with pytest.raises(InputError, match=words):
            load(file)

    def build(file):
        build_structure(load_case(file), SELF)

    start, obstacle = BEAM[: BEAM.index("[obst")], BEAM[BEAM.index("[obst") : BEAM.index("[disp")]
    loads = BEAM[BEAM.index("[disp") :]
    refused(start + loads, r"displacements and loads: expected.*obstacles.NAME")
    rest = obstacle.replace('travel = [0, 0, "0.1 mm"]\n', "")
    refused(start + rest, "nothing presses the bodies on them; expected.*bolts")
    refused(BEAM, r"knows no \[obstacles\], \[displacements\], \[loads\]", build)
    contact = '[contacts.lap]\nlower = "interface_lower"\nupper = "interface_upper"\n'
    refused(start + contact, r"without contact knows no \[contacts\]", build)
    file.write_text(BEAM.replace('"-0.1 mm"]', "-0.1]"))
    said = " ".join(check_case(file, SELF, QUIET).notes)
    assert "displacements.grip.value[2] = -0.1 m is unusual" in said


BLOCK = f"""
title = "Block"
[mesh]
file = "block.msh"
scale = "1 mm"
degree = 1
[parts.block]
cells = ["block"]
E = {E}
nu = 0.3
rho = 2700
"""
FLOOR = """
[obstacles.floor]
kind = "plane"
facets = "bottom"
point = [0, 0, "-1 um"]
normal = [0, 0, 1]
gap = "-1 um"
"""
GRIP = f"""
[displacements.grip]
facets = "top"
value = ["free", "free", {-WAY}]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("block")
    write_block(made / "block.msh")
    return made


def block(folder, *sections):
    (folder / "case.toml").write_text(BLOCK + "".join(sections))
    return load_case(folder)


def elastic(case, **options):
    """Frequencies above those of rigid motions, Hz."""
    modes = run_modes(case, SELF, QUIET, n_modes=10, **options).result
    return modes.modes.frequencies_hz[modes.modes.n_rigid :]


def test_bar_between_floor_and_grip(folder, keeps_rules):
    """A bar's force; its modes are those of supports in place of a grip and a smooth floor."""
    case = block(folder, FLOOR, GRIP)
    outcome = run_preload(case, SELF, QUIET)
    facts = outcome.json()
    assert facts["contacts"][0]["force_n"] == pytest.approx(FORCE, rel=1e-8)
    floor, grip = facts["applied"]
    assert (floor["kind"], grip["kind"]) == ("obstacle", "displacement")
    assert grip["displacement_m"] == [None, None, pytest.approx(-WAY)]
    assert grip["force_n"] == pytest.approx([0, 0, -FORCE], abs=1e-6 * FORCE)
    assert floor["force_n"] == pytest.approx([0, 0, FORCE], abs=1e-6 * FORCE)
    assert facts["bolt_forces_n"] == {}
    keeps_rules(outcome.page().html())
    support = '[supports.{0}]\nfacets = "{0}"\ndirections = {1}\n'
    top, found = support.format("top", ["z"]), (elastic(case, state="preload"), elastic(case))
    for modes, ways in zip(found, (["z"], ["x", "y", "z"]), strict=True):
        held = elastic(block(folder, support.format("bottom", ways), top))
        assert modes == pytest.approx(held[: len(modes)], rel=1e-6)


def test_loads_on_faces(folder):
    """A pressure is its force on the face; a floor that is pushed goes as far as it gives."""
    load = '[loads.{}]\nfacets = "top"\n{}\n'
    halves = (
        load.format("piston", f"pressure = {0.5 * FORCE / AREA}"),
        load.format("weight", f"force = [0, 0, {-0.5 * FORCE}]"),
    )
    found = run_preload(block(folder, FLOOR, *halves), SELF, QUIET)
    floor, piston, weight = found.json()["applied"]
    assert piston["force_n"] == pytest.approx(weight["force_n"], abs=1e-9 * FORCE)
    assert floor["force_n"][2] == pytest.approx(FORCE, rel=1e-8)
    top = found.result.result.displacement.x.array.reshape(-1, 3)[:, 2].min()
    assert top == pytest.approx(-WAY, rel=1e-8)
    pushed = FLOOR.replace("gap =", f"force = [0, 0, {FORCE}]\ngap =")
    hold = '[supports.top]\nfacets = "top"\ndirections = ["z"]\n'
    (floor,) = run_preload(block(folder, pushed, hold), SELF, QUIET).json()["applied"]
    assert floor["displacement_m"] == pytest.approx([0, 0, WAY], rel=1e-6, abs=1e-9 * WAY)
    assert floor["force_n"] == pytest.approx([0, 0, FORCE], abs=1e-9 * FORCE)


def test_check_names_and_draws_them(folder, keeps_rules):
    """Places of what acts; a floor that the face does not look at, and vectors of another size."""
    load = '[loads.piston]\nfacets = "left"\npressure = "1 MPa"\n'
    block(folder, FLOOR, GRIP, load)
    outcome = run_check(folder, SELF, QUIET)
    found = outcome.result
    assert not found.errors
    at = {(p.kind, p.name): p for p in found.places}
    assert at["obstacle", "floor"].point == pytest.approx([0.01, 0.01, -1e-6])
    assert at["obstacle", "floor"].direction == pytest.approx([0, 0, 1])
    assert at["displacement", "grip"].direction == pytest.approx([0, 0, -1])
    assert at["load", "piston"].point == pytest.approx([0, 0.01, 0.02])
    page = outcome.page().html()
    keeps_rules(page)
    assert "1 of kind obstacle, 1 of kind displacement, 1 of kind load" in page
    block(folder, FLOOR.replace("[0, 0, 1]", "[0, 0, -1]"), GRIP)
    assert "floor: no facet of the face looks" in " ".join(check_case(folder, SELF, QUIET).errors)
    block(folder, FLOOR, GRIP.replace('"free", "free"', '"free"'))
    (error,) = check_case(folder, SELF, QUIET).errors
    assert "displacements.grip.value = ['free', -1e-05]: expected 3 components" in error
