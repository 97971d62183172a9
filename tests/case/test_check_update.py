"""Cases for an update to frequencies, shapes and functions: their meaning, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dumbbell_case import SANDWICH

pytest.importorskip("dolfinx")

from fenics_joints.case import load_case, parameters
from fenics_joints.errors import InputError

CASE = (
    """
title = "Dumbbell"
[mesh]
builder = "dumbbell"
layer = "10 mm"
element_size = "60 mm"
"""
    + SANDWICH
    + """\
[damping]
rayleigh = ["6 1/s", "0 s"]
hysteretic = { joint = "1 %" }
[test]
frequencies = "f.csv"
condition = "torque"
noise = "0.1 %"
[test.sees]
points = [[0.12, 0.09, 0.14], [0.12, -0.09, 0.14]]
directions = [[1, 0, 0], [0, 0, 1]]
[test.frfs]
files = ["frf.csv", "nodes.csv"]
noise = "2 %"
[update]
parameters = ["joint.E", "joint.h", "joint.loss_factor"]
start = { "joint.loss_factor" = "3 %" }
data = ["frequencies", "frfs"]
lines = 3
[update.held]
modes = ["two"]
bands = [["450 Hz", "1 kHz"]]
"""
)
HEAD = "frequency [Hz]," + ",".join(
    f"{node}/1:+x {part}"
    for node in ("1:+x", "2:+z")
    for part in ("re [m/s2/N]", "im [m/s2/N]", "coherence")
)
LINES = "\n".join(f"{f},1,2,0.9,3,4,0.8" for f in (100, 200, 300, 400, 500))


def write(folder: Path, *edits: tuple[str, str]) -> Path:
    """The case and its data in a folder; texts are replaced, in whichever file they stand."""
    texts = {
        "case.toml": CASE,
        "f.csv": "torque [N·m],one [Hz],two [Hz]\n10,150,350\n20,160,360\n",
        "frf.csv": f"{HEAD}\n{LINES}\n",
        "nodes.csv": "node,x [m],y [m],z [m]\n1,0.12,0.09,0.14\n2,0.12,-0.09,0.14\n",
    }
    for old, new in edits:
        files = [name for name, text in texts.items() if old in text]
        assert len(files) == 1 and texts[files[0]].count(old) == 1, old
        texts[files[0]] = texts[files[0]].replace(old, new)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


ALL = ('data = ["frequencies", "frfs"]\n', "")
NO_LOSS = [(', "joint.loss_factor"]', "]"), ('start = { "joint.loss_factor" = "3 %" }\n', "")]


def test_meaning(tmp_path):
    case = load_case(write(tmp_path))
    assert case.combined() and case.fitted_data() == ("frequencies", "frfs")
    damping = case.damping.damping()
    assert damping.rayleigh == ("damping.alpha", 0.0)
    assert damping.hysteretic == {"joint": "joint.loss_factor"} and not damping.is_modal
    nominal = case.nominal(damping=True)
    assert nominal["damping.alpha"] == 6 and nominal["joint.loss_factor"] == 0.01
    assert "joint.loss_factor" not in case.nominal()
    assert case.start() == {"joint.loss_factor": 0.03}
    found = {p.name: p for p in parameters(case, damping=True)}
    assert found["damping.alpha"].unit == "1/s" and found["joint.loss_factor"].upper == 1.0
    assert case.update.held.bands == [(450.0, 1000.0)]
    assert case.frfs().response_names == ("1:+x", "2:+z")


def test_what_there_is(tmp_path):
    """Without a word on the data all of them are fitted; without functions nothing changes; a
    frequency may be missing, at the update's condition or at another."""
    lone = ('modes = ["two"]\n', "")
    for edits in ([ALL], [("20,160,360", "20,160,"), lone], [("10,150,350", "10,,350"), lone]):
        assert load_case(write(tmp_path, *edits)).fitted_data() == ("frequencies", "frfs")
    frfs = '[test.frfs]\nfiles = ["frf.csv", "nodes.csv"]\nnoise = "2 %"\n'
    rest = CASE[CASE.index('data = ["freq') :]
    assert not load_case(write(tmp_path, (frfs, ""), (rest, ""), *NO_LOSS)).combined()


def test_noise_from_coherence(tmp_path):
    case = load_case(write(tmp_path, ('\nnoise = "2 %"', "\naverages = 8")))
    sd = case.frfs().relative_sd(case.test.frfs.averages)
    assert sd[0, :, 0] == pytest.approx(np.sqrt([0.1 / (2 * 0.9 * 8), 0.2 / (2 * 0.8 * 8)]))


MISTAKES = [
    ("hysteretic = { joint", "hysteretic = { jiont", ["damping.hysteretic.jiont", "'joint'"]),
    ('hysteretic = { joint = "1 %" }', 'hysteretic = { joint = "1 mm" }', ["a ratio"]),
    ('["6 1/s", "0 s"]\nhysteretic = { joint = "1 %" }', "[0, 0]", ["expected some damping"]),
    ('["6 1/s", "0 s"]', '["6 Hz m", "0 s"]', ["damping.rayleigh[0]", "a rate"]),
    ("[parts.bodies]", "[parts.damping]", ["parts.damping", "expected another"]),
    ('\nnoise = "2 %"', '\nnoise = "2 %"\naverages = 8', ["either noise or averages"]),
    ('\nnoise = "2 %"', "\naverages = 1", ["test.frfs.averages = 1"]),
    ("[test.frfs]", "[test.frfs]\nat = 10", ["test.frfs.at = 10", "20 N·m"]),
    ('s", "frfs"]', 's"]', ["parameters[2] = 'joint.loss_factor'", "update.lines", "held.bands"]),
    ('["frequencies", "frfs"]', '["shapes", "frfs"]', ["data[0] = 'shapes'", "update.held.modes"]),
    ('"frequencies", "frfs"', '"frequencies", "frf"', ["'frfs'"]),
    ('"joint.E", "joint.h"', '"joint.E", "joint.E"', ["update.parameters[1]", "once"]),
    ("lines = 3", "lines = 0", ["update.lines", "from 1 on"]),
    ("lines = 3", "lines = 6", ["update.lines = 6", "at most the 5"]),
    ("lines = 3", 'lines = ["300 Hz", "700 Hz"]', ["update.lines[1]", "from 100 to 500 Hz"]),
    ("lines = 3", "lines = 3\nhold_out = [10]", ["update.hold_out", "[update.held]"]),
    ("lines = 3", "lines = 3\nstep_limit = 0.5", ["step_limit = 0.5", "'weighted'"]),
    ("lines = 3", 'lines = 3\nmethod = "weigthed"', ["update.method", "'weighted'"]),
    ('modes = ["two"]', 'modes = ["tow"]', ["update.held.modes[0] = 'tow'", "'two'"]),
    ('modes = ["two"]', 'modes = ["two", "one"]', ["expected some modes left"]),
    ("20,160,360", "20,160,", ["update.held.modes[0] = 'two'", "was not measured"]),
    ('modes = ["two"]', 'responses = ["3:+x"]', ["update.held.responses[0]", "'1:+x'"]),
    ('bands = [["450 Hz", "1 kHz"]]', 'bands = [["50 Hz", "1 kHz"]]', ["some lines left"]),
    ('bands = [["450 Hz", "1 kHz"]]', 'bands = [["1 kHz", "2 kHz"]]', ["measured lines in them"]),
    ("[damping]\nrayleigh", "[test.nothing]\nrayleigh", ["test.nothing"]),
]


@pytest.mark.parametrize(("old", "new", "said"), MISTAKES)
def test_mistakes(tmp_path, old, new, said):
    write(tmp_path, (old, new))
    with pytest.raises(InputError) as caught:
        load_case(tmp_path)
    for fragment in [str(tmp_path / "case.toml"), *said]:
        assert fragment in str(caught.value)


def test_no_damping(tmp_path):
    section = '[damping]\nrayleigh = ["6 1/s", "0 s"]\nhysteretic = { joint = "1 %" }\n'
    write(tmp_path, (section, ""), *NO_LOSS)
    with pytest.raises(InputError, match=r"damping is missing: expected a section \[damping\]"):
        load_case(tmp_path)
