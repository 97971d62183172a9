"""What is unusual in a case is said once and not refused; what makes no sense is refused."""

from __future__ import annotations

import json
import math
import sys

import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import load_case, plausibility
from fenics_joints.case.plausible import USUAL
from fenics_joints.cli import main
from fenics_joints.errors import InputError
from fenics_joints.measurements import read_table, read_test_data
from fenics_joints.preload import thread

BOLT = """
[bolts.{}]
kind = "washers"
lower = "bottom"
upper = "top"
thread = "M10"
force = "20 kN"
"""
#: Text of the case, what takes its place, and what is said.
SOFT = ('E = "69 GPa"\nG = "26.9 GPa"', "E = 69\nnu = 0.3")
UNUSUAL = [
    (*SOFT, "plates.E = 69 Pa is unusual: solid materials have 100 MPa to 1.20 TPa; was '69 GPa'"),
    ('rho = "2750 kg/m3"', "rho = 2.75", "23000 kg/m³; was '2.75 g/cm3'"),
    ('thickness = "8 mm"', "thickness = 800", "mesh.thickness = 800 m is unusual: dimensions"),
    ('E = "0.933 MPa"', "E = 933", "joints.away.E = 933 Pa is unusual: layers of joints have"),
    ('mass = "20 g"', "mass = 2e5", "attached.accelerometer.mass = 200000 kg is unusual"),
    ('stiffness = "1 kN/m"', "stiffness = 0.1", "attached.rope.stiffness = 0.1 N/m is unusual"),
    ('E = "1.5 %", rho', "E = 1.5, rho", "parts.plates.tolerance.E = 1.5 is unusual"),
    ('noise = "0.3 %"', "noise = 0.3", "test.noise = 0.3 is unusual: relative scatter"),
    (
        "[test]",
        "[damping]\nmodal = 0.5\n[test]",
        "damping.modal[0] = 0.5 is unusual: damping ratio",
    ),
]


@pytest.mark.parametrize(("old", "new", "said"), UNUSUAL)
def test_what_is_unusual_is_said(tmp_path, write_case, old, new, said):
    assert plausibility(load_case(write_case(tmp_path))) == ()
    (found,) = plausibility(load_case(write_case(tmp_path, (old, new))))
    assert said in found


def test_measured_values_count_too(tmp_path, write_case):
    path = write_case(tmp_path, ("375.04", "0.01"), file="frequencies.csv")
    (found,) = plausibility(load_case(path))
    assert "test.frequencies.bending 1 = 0.01 Hz is unusual" in found


def test_ranges_are_in_order_and_know_their_units():
    for usual in USUAL.values():
        assert usual.low < usual.high < math.inf
        assert usual.holds(usual.low) and not usual.holds(1e3 * abs(usual.high) + 1)
    # The force of an M10 in kN, read as N, and that of its class 8.8 at 70 % of the yield stress.
    area = thread("M10").stress_area
    assert not USUAL["bolt stress"].holds(28.0 / area)
    assert USUAL["bolt stress"].holds(0.7 * 640e6)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")
def test_a_command_says_it_once(tmp_path, write_case, monkeypatch, capfd):
    """On stderr before the work, in the JSON and on the page; the answer is there all the same."""
    out, page = tmp_path / "m.json", tmp_path / "m.html"
    arguments = ["modes", write_case(tmp_path, SOFT), "-n", "8", "--json", out, "--report", page]
    monkeypatch.setattr(sys, "argv", ["fenics-joints", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    said, made = capfd.readouterr().err, json.loads(out.read_text())
    assert not end.value.code and made["frequencies_hz"][-1] > 0
    assert said.count("parts.plates.E = 69 Pa") == 1
    assert said.index("parts.plates.E = 69 Pa") < said.index("building the model")
    for text in (made["notes"][0], page.read_text()):
        assert "parts.plates.E = 69 Pa" in text


#: Text of the case, what takes its place, and what is said of it.
REFUSED = [
    ("direction = [0, 1, 0]", "direction = [1e300, 0, 0]", "attached.rope.direction.0. = 1e.300: "),
    ("direction = [0, 1, 0]", "direction = [true, 0, 1]", "attached.rope.direction.0. = True: "),
    ("direction = [0, 1, 0]", "direction = [1e-300, 0, 0]", "not zero"),
    (
        'thickness = "8 mm"',
        'thickness = "8 mm"\nbolts = [[0.14, 0.02], [0.14, 0.0200001]]',
        "mesh: lap_plates: bolts is .*each bolt once, 1 mm or more",
    ),
    (
        'E = "863 MPa"',
        'E = "863 MPa"\nbolted = true\nbolts = [[0.1, 0, 0], [0.1, 1e-7, 0]]',
        "bolts.1. = .* is there already: expected each bolt once",
    ),
    *[
        ('{ "near.E" = "3 GPa" }', f'{{ "near.E" = {value} }}', f"update.start.near.E = {said}: ")
        for value, said in (("-1", "-1.0"), ("0", "0.0"), ("true", "True"), ("1e300", "1e.300"))
    ],
    (
        "[test]",
        BOLT.format("left") + BOLT.format("right") + "[test]",
        "bolts.right.lower = 'bottom': is a face of bolts.left",
    ),
    ("hold_out = [4,", "hold_out = [true,", "update.hold_out.0. = True: expected a finite number"),
]


@pytest.mark.parametrize(("old", "new", "said"), REFUSED)
def test_what_makes_no_sense_is_refused(tmp_path, write_case, old, new, said):
    path = write_case(tmp_path, (old, new))
    with pytest.raises(InputError, match=said):
        load_case(path)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("5,,\n6,1,2\n", r"data row 1 \(torque = 5\) has no frequency"),
        ("5,1,\n6,1,\n", "column 'b' has no frequency"),
        ("5,1,2\n5.0000000001,1,2\n", "5.0 and 5.0000000001 are one within 1e-06"),
    ],
)
def test_tables_that_make_no_sense_are_refused(tmp_path, rows, said):
    table = tmp_path / "f.csv"
    table.write_text(f"torque [N·m],a [Hz],b [Hz]\n{rows}")
    with pytest.raises(InputError, match=said):
        read_test_data(table, condition="torque")


def test_a_comma_before_three_digits_is_said(tmp_path):
    table = tmp_path / "f.csv"
    table.write_text("torque [N·m];a [Hz]\n5;1,234\n6;2,5\n")
    read = read_table(table)
    assert read.values[:, 1] == pytest.approx([1.234, 2.5])
    (note,) = read.notes
    assert "'1,234' is read as 1.234, with a decimal comma; for 1234 write it without" in note
    table.write_text("torque [N·m];a [Hz]\n5;1,23\n6;2,5\n")
    assert read_table(table).notes == ()
