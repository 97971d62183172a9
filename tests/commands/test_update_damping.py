"""``update`` on damping ratios: against the state matrix itself and the modes' strain energy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from case_tables import write_frequencies
from dumbbell_case import SANDWICH
from mpi4py import MPI

from fenics_joints.beams import identify_damping
from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.update.document import update_document
from fenics_joints.commands.update.run import update_case
from fenics_joints.errors import InputError
from fenics_joints.formatting import percent
from fenics_joints.measurements import Target
from fenics_joints.meshes import dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ArrayModel
from fenics_joints.reduction.affine import AffinePencil, RegionTerm
from fenics_joints.response.complex_modes import damping_ratios
from fenics_joints.structure import Damping, Parameter, Structure, part, transition
from fenics_joints.structure.laws import ELASTIC_SUPPORT
from fenics_joints.updating import Predictor

BEAMS = Path(__file__).parents[2] / "demos" / "bolted_beams" / "case.toml"
TRUTH = {"lap.k1": 1763.2, "lap.k2": 37402.0, "lap.c": 0.15}
NOISE = 0.02


def beam_text(update: str) -> str:
    """The beams of the demo with measured ratios."""
    text, _, _ = BEAMS.read_text(encoding="utf-8").partition("[update]")
    assert text.count('"frequencies.csv"') == 1
    test = f"'{BEAMS.parent}/frequencies.csv'\ndamping = \"damping.csv\"\n"
    test += f'damping_noise = "{100 * NOISE} %"'
    return text.replace('"frequencies.csv"', test) + "[update]\nat = 23\n" + update


def put(folder: Path, text: str, ratios: str | None = None):
    """Write a case and its ratios, once for all ranks, and read it."""
    if MPI.COMM_WORLD.rank == 0:
        (folder / "case.toml").write_text(text, encoding="utf-8")
        if ratios is not None:
            (folder / "damping.csv").write_text(ratios, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return load_case(folder)


def table(ratios) -> str:
    names = ",".join(f"mode {i + 1}" for i in range(len(ratios)))
    return f"torque [N·m],{names}\n23,{','.join(f'{z:.8g}' for z in ratios)}\n"


def state_ratios(beams, values) -> np.ndarray:
    """Damping ratios of all modes that oscillate, by the matrix of Jalali et al. 2019, eq. 9."""
    K, M, C = beams.stiffness(values), beams.mass(values), beams.damping_matrix(values)
    n = len(K)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    s = np.linalg.eigvals(A)
    s = s[s.imag > 100.0]  # rigid-body modes are at zero
    s = s[np.argsort(np.abs(s))]
    return -s.real / np.abs(s)


@pytest.fixture(scope="module")
def measured():
    """Ratios of eight modes of finer beams, with noise."""
    case = load_case(BEAMS)
    mesh = case.mesh.model_copy(update={"elements": [45, 30]})
    beams = build_structure(case.model_copy(update={"mesh": mesh}), MPI.COMM_WORLD)
    ratios = state_ratios(beams, TRUTH)[:8]
    return ratios * np.exp(NOISE * np.random.default_rng(2).standard_normal(8))


@pytest.mark.parallel
def test_ratios_alone_give_c(measured, shared_tmp_path):
    """From four times as much; the standard deviation is that of `identify_damping`, that of the
    noise times the root of what is left by degree of freedom."""
    text = beam_text(
        'parameters = ["lap.c"]\nstart = { "lap.c" = 0.6 }\ndata = "damping"\n'
        '[update.held]\nmodes = ["mode 6", "mode 7", "mode 8"]\n'
    )
    case = put(shared_tmp_path, text, table(measured))
    found = update_case(case, MPI.COMM_WORLD)
    (c,) = found.parameters
    known = identify_damping(
        build_structure(case, MPI.COMM_WORLD), ["lap.c"], measured[:5], TRUTH, relative_sd=NOISE
    )
    # One takes logarithms, the other differences: alike to second order in the noise.
    assert c["value"] == pytest.approx(known.values[0], rel=2e-3)
    sd = c["relative_standard_deviation"]
    assert sd == pytest.approx(known.sd[0] / known.values[0], rel=0.05)
    left = np.log(known.ratios[:5] / measured[:5]) / NOISE
    widened = np.sqrt(max(1.0, left @ left / 4))
    assert sd == pytest.approx(widened * NOISE / np.sqrt(5), rel=0.05)
    assert c["value"] == pytest.approx(0.15, rel=3 * sd)
    assert found.kinds == ("damping",) and found.update.degrees_of_freedom == 4
    for held, ratio in zip(found.held, measured[5:], strict=True):
        assert held["damping_test"] == pytest.approx(ratio)
        off = abs(held["damping_error_percent"]) / 100
        assert off < 4 * NOISE < 2 < held["damping_before"] / ratio - 1
        assert held["damping_standard_deviation_percent"] == pytest.approx(100 * sd, rel=0.05)
    assert MPI.COMM_WORLD.allgather(c["value"]) == [c["value"]] * MPI.COMM_WORLD.size


def test_taken_by_default_where_damping_is_sought(measured, tmp_path):
    """Stiffness and damping at once; JSON and page tell both."""
    text = beam_text('parameters = ["lap.k1", "lap.k2", "lap.c"]\n')
    assert put(tmp_path, text, table(measured[:5])).combined()
    held = '[update.held]\nmodes = ["mode 6", "mode 7", "mode 8"]\n'
    case = put(tmp_path, text + held)
    assert case.fitted_data() == ("frequencies", "damping")
    found = update_case(case, MPI.COMM_WORLD)
    assert abs(found.parameters[2]["value"] / 0.15 - 1) < 0.05
    outcome = Outcome(found, update_document(found))
    rows = json.loads(json.dumps(outcome.json(), allow_nan=False))["modes"]
    assert rows[3]["damping_test"] == pytest.approx(measured[3], rel=1e-6)
    after = 100 * (rows[3]["damping_after"] / measured[3] - 1)
    assert rows[3]["damping_error_after_percent"] == pytest.approx(after, abs=1e-4)
    assert rows[6]["damping_test"] is None and not rows[6]["damping_fitted"]
    assert outcome.json()["held_modes"][0]["damping_error_percent"] is None
    page = outcome.page().html()
    assert 'id="damping-ratios"' in page and 'id="damping-after"' in page
    assert f">{percent(after / 100, 1, sign=True)}<" in page
    assert "The error of the frequencies went from" in page
    assert "that of the damping ratios from" in page
    # Without a parameter of damping nothing changes.
    assert not put(tmp_path, beam_text('parameters = ["lap.k1", "lap.k2"]\n')).combined()


def test_slopes_are_those_of_the_state_matrix():
    """By stiffness, inertia and c; no mode is mistaken for another with another's damping."""
    beams = build_structure(load_case(BEAMS), MPI.COMM_WORLD)
    names, given = ["lap.k1", "lap.k2", "lap.c", "beams.rho"], {**TRUTH, "beams.rho": 7860.0}
    target = Target(damping_ratios=np.full(5, 1e-3), damping_log_sd=0.1)
    predictor = Predictor(beams.arrays(), target, names, damping=beams.joint_damping())
    found = predictor(given)

    def ratios(name, factor):
        return state_ratios(beams, {**given, name: given[name] * factor})[:5]

    np.testing.assert_allclose(found.damping_ratios, ratios("lap.c", 1.0), rtol=1e-6)
    for column, name in enumerate(names):
        h = 1e-3
        slope = (ratios(name, 1 + h) - ratios(name, 1 - h)) / (2 * h * given[name])
        size = np.abs(slope).max()
        np.testing.assert_allclose(
            found.damping_slopes[:, column], slope, atol=1e-4 * size, err_msg=name
        )


def test_modes_keep_their_ratios_where_damping_changes_their_order():
    """Two masses on springs that do not know of each other: the lossy one's |s| rises past that of
    the other, (1 + eta^2)^(1/4) w, and its ratio is sin(arctan(eta) / 2)."""
    unit = np.eye(2)

    def spring(name, k, row):
        matrices = np.array([np.outer(row, row), 0 * unit])
        return RegionTerm(name, ELASTIC_SUPPORT, {"k_n": k, "k_t": 0}, matrices, 0 * unit, 0.0)

    springs = [spring("lossy", 1e6, unit[0]), spring("other", 1.2e6, unit[1])]
    model = ArrayModel(AffinePencil({}, springs, fixed=(0 * unit, unit)), 1.0)
    modes = solve_modes(model, n_modes=2)
    ratios, _ = damping_ratios(model, None, Damping(hysteretic={"lossy": 1.0}), modes, [0, 1])
    assert ratios == pytest.approx([np.sin(np.pi / 8), 0.0], abs=1e-12)


SOLID = (
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
hysteretic = { joint = "5 %" }
[test]
frequencies = "f.csv"
damping = "damping.csv"
noise = 2e-4
[update]
parameters = ["joint.E", "joint.loss_factor"]
[update.held]
modes = ["mode 5"]
"""
)
E, LOSS = 10e9, 0.02
BODIES = ("head_1", "neck_1", "neck_2", "head_2")


@pytest.mark.parallel
def test_loss_factor_of_a_layer_of_a_solid(shared_tmp_path):
    """Modal strain energy: 2 zeta = eta + eta_c U_c / U, and U_c / U = d ln lambda / d ln E_c, by
    differences of undamped frequencies."""
    path = shared_tmp_path
    tagged = dumbbell(MPI.COMM_WORLD, layer=20e-3, element_size=0.06)
    model = Structure(
        tagged,
        [
            part("bodies", BODIES, E=130e9, nu=0.27, rho=7850.0),
            transition("joint", "joint", E="E", nu=0.27, h=20e-3, meshed=20e-3),
        ],
        [Parameter("E", E, "Pa", 1e8, 1e12)],
    )
    h = 0.02
    low, f, high = (
        solve_modes(model, {"E": E * x}, n_modes=12, tolerance=1e-11).frequencies_hz[6:]
        for x in (np.exp(-h), 1.0, np.exp(h))
    )
    ratios = 0.5 * 0.004 + LOSS * np.log(high / low) / (2 * h)
    assert ratios.max() > 1.2 * ratios.min()
    if MPI.COMM_WORLD.rank == 0:
        for file, unit, row in (("f.csv", " [Hz]", f), ("damping.csv", "", ratios)):
            write_frequencies(path, row, file=file, unit=unit)
    found = update_case(put(path, SOLID), MPI.COMM_WORLD)
    assert found.kinds == ("frequencies", "damping")
    assert len(found.notes) == 1 and "taken as the model's lowest" in found.notes[0]
    # Strain energy leaves out terms of the order of the loss factor squared.
    values = [p["value"] for p in found.parameters]
    np.testing.assert_allclose(values, [E, LOSS], rtol=1e-3)
    assert found.parameters[1]["relative_standard_deviation"] == pytest.approx(
        0.1 / np.linalg.norm(np.delete((ratios - 0.002) / ratios, 4)), rel=0.02
    )
    (held,) = found.held
    assert held["damping_predicted"] == pytest.approx(ratios[4], rel=1e-3)
    assert float(found.model["damping_error"].rstrip(" %")) < 0.1
    assert MPI.COMM_WORLD.allgather(values) == [values] * MPI.COMM_WORLD.size


SOME, NONE = np.full(5, 1e-3), np.full(5, np.nan)
ALL_HELD = 'data = "damping"\nheld = { modes = ["mode 1", "mode 2"] }'


@pytest.mark.parametrize(
    ("update", "ratios", "words"),
    [
        ('data = "damping"', SOME, "damping is missing.* a lap of"),
        ('data = "frequencies"', SOME, "depend on damping.*'damping'"),
        ("", NONE, "do not depend on damping"),
        ('data = "damping"', NONE, r"update.data\[0\] = 'damping': there are none.*test.damping"),
        ("", [1e-3, 0.0], "test.damping: mode 2 = 0 at torque = 23"),
        ('method = "weighted"', SOME, "no damping in update.data"),
        (ALL_HELD, SOME[:2], "expected some modes left"),
    ],
)
def test_mistakes(tmp_path, update, ratios, words):
    text = beam_text(f'parameters = ["lap.c"]\n{update}\n')
    if "damping is missing" in words:
        text = text.replace('c = "0.15 N m s"', "")
    with pytest.raises(InputError, match=words):
        put(tmp_path, text, table(ratios))


def test_a_mode_that_nothing_damps_is_said():
    """The logarithm of its ratio would be that of round-off."""
    beams = build_structure(load_case(BEAMS), MPI.COMM_WORLD)
    target = Target(damping_ratios=np.full(3, 1e-3))
    predictor = Predictor(beams.arrays(), target, ["lap.c"], damping=beams.joint_damping())
    with pytest.raises(InputError, match="mode 1 of the test has no damping"):
        predictor({**TRUTH, "lap.c": 0.0})
