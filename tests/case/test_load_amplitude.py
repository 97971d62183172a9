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
F, ZETA = JOINT.backbone(LEVELS / (2 * np.pi * 79.5) ** 2)
PLAIN = table("level [m/s2],frequency [Hz],damping [%]", LEVELS, F, 100 * ZETA)


def decay() -> str:
    dt = 1 / JOINT.hz / 640
    t, _, a = JOINT.motion(0.0, int(2.5 / dt), dt, x=7 * JOINT.yields_at)
    noise = np.random.default_rng(0).normal(0, 1e-2, len(t))
    return table("time [s],a1 [m/s2]", t[::16], (a + noise)[::16])


def case(
    folder, text=PLAIN, *, test='amplitude = { "bending 1" = "data.csv" }', modes="", more=IDENTIFY
):
    """A case with a file of amplitude data, and perhaps a table of modes."""
    (folder / "data.csv").write_text(text, encoding="utf-8")
    (folder / "modes.csv").write_text(modes, encoding="utf-8")
    layer = LAYER.replace('measured = "frf.csv"\n', "")
    (folder / "case.toml").write_text(
        f"{layer}{test and '[test]'}\n{test}\n{more}", encoding="utf-8"
    )
    return load_case(folder)


@pytest.mark.parametrize("make", [lambda: PLAIN, decay])
def test_every_kind_is_a_backbone_for_harmonic_and_a_test_by_level_for_a_diagnosis(tmp_path, make):
    made = case(tmp_path, make())
    backbone = made.backbones()["bending 1"]
    assert backbone.response == "acceleration" and len(backbone) >= 4
    data = made.measurements()
    assert data.by_level and data.mode_names == ("bending 1",) and len(data) <= 8
    f, zeta = JOINT.backbone(data.conditions / (2 * np.pi * data.frequencies_hz[:, 0]) ** 2)
    # Where the slider begins to yield damping turns sharply.
    assert data.frequencies_hz[:, 0] == pytest.approx(f, rel=1.5e-3)
    assert data.damping[:, 0] == pytest.approx(zeta, rel=0.2, abs=2e-4)
    assert data.noise[0] > 0 and data.damping_noise > 0


def test_a_test_by_level_is_a_backbone_and_noise_and_lines_of_the_analyser_count(tmp_path):
    test = 'frequencies = "data.csv"\ncondition = "level"\nmodes = ["frequency"]\nnoise = "0.1 %"'
    backbone = case(tmp_path, test=test).backbones()["frequency"]
    same = case(tmp_path).backbones()["bending 1"]
    assert backbone.damping == pytest.approx(same.damping)
    assert backbone.frequencies_sd == pytest.approx(same.frequencies_sd)
    lines = 'resolution = "0.1 Hz"\nnoise = "0.05 %"\ndamping_noise = "3 %"\n'
    found = case(tmp_path, test=f'{lines}amplitude = {{ b = ["data.csv"] }}', more="").backbones()
    sd = np.hypot(5e-4 * found["b"].frequencies_hz, 0.1 / np.sqrt(12))
    assert found["b"].frequencies_sd == pytest.approx(sd)
    assert found["b"].damping_sd == pytest.approx(0.03 * found["b"].damping)


def test_beside_frequencies_it_is_for_harmonic_and_one_test_with_them_for_a_diagnosis(tmp_path):
    """The levels of the driven mode alone, of the others what was measured without a level."""
    modes = "bending 1 [Hz],bending 2 [Hz],bending 2 damping [%]\n80,300,0.4\n"
    test = 'frequencies = "modes.csv"\nnoise = "0.3 %"\namplitude = {{ "{}" = "data.csv" }}'
    own = '[test.amplitude."bending 1"]\nfiles = "data.csv"\nnoise = "0.05 %"\n'
    made = case(tmp_path, test=test.partition("amplitude")[0] + own, modes=modes)
    assert made.measurements().mode_names == ("bending 1", "bending 2")
    one = made.diagnosed_test()
    assert one.mode_names == ("bending 1", "bending 2") and one.by_level
    assert one.conditions == pytest.approx([0.1 * LEVELS[0], *LEVELS])
    assert np.isnan(one.frequencies_hz[0, 0]) and np.isnan(one.frequencies_hz[1:, 1]).all()
    f = made.backbones()["bending 1"].frequencies_hz
    assert one.frequencies_hz[1:, 0] == pytest.approx(f) and one.frequencies_hz[0, 1] == 300
    assert one.damping[0, 1] == pytest.approx(0.004) and one.damping_noise == pytest.approx(0.1)
    assert one.noise == pytest.approx([5e-4, 3e-3])
    assert "of bending 1 (80 Hz without a level" in one.notes[-1]
    # A mode that the table lacks goes where its frequency is, unless it is one by another name.
    driven = test.format("driven").replace('noise = "0.3 %"\n', "")
    made = case(tmp_path, test=driven, modes="a [Hz],b [Hz]\n30,300\n")
    assert made.diagnosed_test().mode_names == ("a", "driven", "b")
    assert any("taken to be known to 0.1 %" in note for note in made.test_notes())
    with pytest.raises(InputError, match=r"within 2 % of 'b' .* expected that name"):
        case(tmp_path, test=driven, modes="a [Hz],b [Hz]\n30,80.5\n").diagnosed_test()
    # Of several torques it is no part.
    torques = driven + '\ncondition = "torque"'
    apart = case(tmp_path, test=torques, modes="torque [N*m],b [Hz]\n5,80\n9,81\n").diagnosed_test()
    assert not apart.by_level and "no part of the diagnosis" in apart.notes[-1]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"text": ""}, r"test.amplitude.bending 1: .*data.csv: has 0 rows"),
        ({"test": 'amplitude = { b1 = "no.csv" }'}, "test.amplitude.b1: .*no.csv.*: no such file"),
        ({"test": 'amplitude = { b = "data.csv" }\ncondition = "level"'}, "condition: expected"),
        ({"test": 'amplitude = { b1 = { file = "data.csv" } }'}, "files"),
        ({"text": "level [m/s2],frequency [Hz]\n5,80\n"}, "measured at one amplitude"),
        ({"test": 'amplitude = { a = "data.csv", b = "data.csv" }'}, "identify.mode: expected one"),
        ({"test": ""}, r"expected level, .* or a mode over its amplitude"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, given, words):
    with pytest.raises(InputError, match=words):
        case(tmp_path, **given)
