"""Modes over their amplitude in a case file: each kind of data, and what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from harmonic_case import LAYER
from jenkins import Jenkins, table

from fenics_joints.case import load_case
from fenics_joints.errors import InputError

JOINT = Jenkins()
IDENTIFY = '[harmonic.identify]\nparameters = "lap.S_y"\n'
LEVELS = np.array([2.0, 8.0, 15.0, 30.0])
SWEPT = np.linspace(78.6, 80.8, 33)


def plain() -> str:
    f, zeta = JOINT.backbone(LEVELS / (2 * np.pi * 79.5) ** 2)
    return table("level [m/s2],frequency [Hz],damping [%]", LEVELS, f, 100 * zeta)


def held_response() -> str:
    """The force that held an acceleration."""
    level, hz = (a.ravel() for a in np.meshgrid(LEVELS, SWEPT, indexing="ij"))
    force = level / np.abs(JOINT.at_acceleration(level, hz))
    return table("level [m/s2],frequency [Hz],force [N]", level, hz, force)


def held_force() -> str:
    rows = []
    for level in (0.02, 0.06, 0.15):
        h = -((2 * np.pi * SWEPT) ** 2) * JOINT.held(level, SWEPT)
        a, phase = level * np.abs(h), np.angle(h, deg=True)
        rows.append((np.full(33, level), SWEPT, a, phase))
    head = "level [N],frequency [Hz],acceleration [m/s2],phase [deg]"
    return table(head, *np.concatenate(rows, axis=1))


def decay() -> str:
    dt = 1 / JOINT.hz / 640
    t, _, a = JOINT.motion(0.0, int(2.5 / dt), dt, x=7 * JOINT.yields_at)
    noise = np.random.default_rng(0).normal(0, 1e-2, len(t))
    return table("time [s],a1 [m/s2]", t[::16], (a + noise)[::16])


def case(folder, text: str, *, test: str = 'amplitude = { "bending 1" = "data.csv" }', more=""):
    """A case with a file of amplitude data."""
    (folder / "data.csv").write_text(text, encoding="utf-8")
    layer = LAYER.replace('measured = "frf.csv"\n', "")
    (folder / "case.toml").write_text(f"{layer}[test]\n{test}\n{more}", encoding="utf-8")
    return load_case(folder)


@pytest.mark.parametrize("make", [plain, held_response, held_force, decay])
def test_every_kind_is_a_backbone_for_harmonic_and_a_test_by_level_for_a_diagnosis(tmp_path, make):
    made = case(tmp_path, make(), more=IDENTIFY)
    backbone = made.backbones()["bending 1"]
    assert backbone.response == "acceleration" and len(backbone) >= 4
    data = made.measurements()
    assert data.by_level and data.mode_names == ("bending 1",) and len(data) <= 8
    f, zeta = JOINT.backbone(data.conditions / (2 * np.pi * data.frequencies_hz[:, 0]) ** 2)
    # Where the slider begins to yield damping turns sharply.
    assert data.frequencies_hz[:, 0] == pytest.approx(f, rel=1.5e-3)
    assert data.damping[:, 0] == pytest.approx(zeta, rel=0.2, abs=2e-4)
    assert data.noise[0] > 0 and data.damping_noise > 0


def test_a_test_by_level_is_a_backbone_too(tmp_path):
    test = 'frequencies = "data.csv"\ncondition = "level"\nmodes = ["frequency"]\nnoise = "0.1 %"'
    made = case(tmp_path, plain(), test=test, more=IDENTIFY)
    same = case(tmp_path, plain()).backbones()["bending 1"]
    backbone = made.backbones()["frequency"]
    assert backbone.damping == pytest.approx(same.damping)
    assert backbone.frequencies_sd == pytest.approx(same.frequencies_sd)


def test_noise_of_the_test_and_lines_of_the_analyser_count(tmp_path):
    lines = 'resolution = "0.1 Hz"\nnoise = "0.05 %"\ndamping_noise = "3 %"\n'
    found = case(tmp_path, plain(), test=f'{lines}amplitude = {{ b = ["data.csv"] }}').backbones()
    sd = np.hypot(5e-4 * found["b"].frequencies_hz, 0.1 / np.sqrt(12))
    assert found["b"].frequencies_sd == pytest.approx(sd)
    assert found["b"].damping_sd == pytest.approx(0.03 * found["b"].damping)


def test_beside_frequencies_it_is_for_harmonic_and_one_test_with_them_for_a_diagnosis(tmp_path):
    """The levels of the driven mode alone, of the others what was measured without a level."""
    modes = "bending 1 [Hz],bending 2 [Hz],bending 2 damping [%]\n80,300,0.4\n"
    (tmp_path / "modes.csv").write_text(modes, encoding="utf-8")
    test = 'frequencies = "modes.csv"\nnoise = "0.3 %"\namplitude = {{ "{}" = "data.csv" }}'
    own = '[test.amplitude."bending 1"]\nfiles = "data.csv"\nnoise = "0.05 %"\n'
    of_both = test.partition("amplitude")[0] + own
    made = case(tmp_path, plain(), test=of_both, more=IDENTIFY)
    one = made.diagnosed_test()
    assert one.mode_names == ("bending 1", "bending 2") and one.by_level
    assert one.conditions == pytest.approx([0.1 * LEVELS[0], *LEVELS])
    assert np.isnan(one.frequencies_hz[0, 0]) and np.isnan(one.frequencies_hz[1:, 1]).all()
    f = made.backbones()["bending 1"].frequencies_hz
    assert one.frequencies_hz[1:, 0] == pytest.approx(f) and one.frequencies_hz[0, 1] == 300
    assert one.damping[0, 1] == pytest.approx(0.004) and one.damping_noise == pytest.approx(0.1)
    assert one.noise == pytest.approx([5e-4, 3e-3])
    assert "the levels alone count of bending 1 (80 Hz without a level" in one.notes[-1]
    # A mode that the table lacks goes where its frequency is, unless it is one by another name.
    (tmp_path / "modes.csv").write_text("a [Hz],b [Hz]\n30,300\n", encoding="utf-8")
    driven = case(tmp_path, plain(), test=test.format("driven"), more=IDENTIFY)
    assert driven.diagnosed_test().mode_names == ("a", "driven", "b")
    (tmp_path / "modes.csv").write_text("a [Hz],b [Hz]\n30,80.5\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"within 2 % of 'b' .* expected that name"):
        case(tmp_path, plain(), test=test.format("driven"), more=IDENTIFY).diagnosed_test()
    # Of several torques it is no part.
    (tmp_path / "modes.csv").write_text("torque [N*m],b [Hz]\n5,80\n9,81\n", encoding="utf-8")
    torques = test.format("driven") + '\ncondition = "torque"'
    apart = case(tmp_path, plain(), test=torques, more=IDENTIFY).diagnosed_test()
    assert not apart.by_level and "no part of the diagnosis" in apart.notes[-1]


def test_beside_frequencies_nothing_else_changes(tmp_path):
    (tmp_path / "modes.csv").write_text("bending 1 [Hz],bending 2 [Hz]\n80,300\n", encoding="utf-8")
    test = 'frequencies = "modes.csv"\namplitude = { "bending 1" = "data.csv" }'
    made = case(tmp_path, plain(), test=test, more=IDENTIFY)
    assert made.measurements().mode_names == ("bending 1", "bending 2")
    assert list(made.backbones()) == ["bending 1"]
    assert any("taken to be known to 0.1 %" in note for note in made.test_notes())


@pytest.mark.parametrize(
    ("text", "test", "words"),
    [
        ("", None, r"test.amplitude.bending 1: .*data.csv: has 0 rows"),
        ("level,frequency [Hz]\n5,80\n", None, "'level': the unit is missing"),
        (None, 'amplitude = { b1 = "none.csv" }', "test.amplitude.b1: .*none.csv.*: no such file"),
        (None, 'amplitude = { b1 = "data.csv" }\ncondition = "level"', "condition: expected"),
        (None, 'amplitude = { b1 = { file = "data.csv" } }', "files"),
        ("level [m/s2],frequency [Hz]\n5,80\n", None, "measured at one amplitude"),
        (None, 'amplitude = { b1 = "data.csv", b2 = "data.csv" }', "identify.mode: expected one"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, test, words):
    given = {} if test is None else {"test": test}
    with pytest.raises(InputError, match=words):
        case(tmp_path, plain() if text is None else text, more=IDENTIFY, **given)


def test_identification_asks_for_data(tmp_path):
    (tmp_path / "case.toml").write_text(
        LAYER.replace('measured = "frf.csv"\n', "") + IDENTIFY, encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"expected level, .* or a mode over its amplitude"):
        load_case(tmp_path)
