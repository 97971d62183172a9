"""What ``fenics-joints new`` makes of a test's files: units that they leave out."""

from __future__ import annotations

import re

import measured_world as world
import numpy as np
import pytest
from mpi4py import MPI
from uff_files import mode_55, nodes_15, units_164

from fenics_joints.commands.new.draft import Draft
from fenics_joints.commands.new.tests import TestFiles, draft_test
from fenics_joints.commands.new.text import text_of
from fenics_joints.errors import InputError
from fenics_joints.files import read_toml

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process")

#: Sensors on a frame of 0.12 x 0.15 x 0.3 m, m.
PLACES = np.array([[x, y, z] for x in (0, 0.12) for y in (0, 0.15) for z in (0, 0.15, 0.3)])
FACTORS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}


def silent(question, answer, check):
    check(answer)
    return answer


def sketch(tests, extents=None, ask=silent):
    return draft_test(tests, lambda path: path.name, ask, lambda: extents)


def lines(test):
    """Of the case that the test stands in, without the comments that say what a key means."""
    text = text_of("a case", Draft({}), test)
    return [re.sub(r"(?<!^)  # (?!\?).*", "", line) for line in text.splitlines()]


def lab_file(path, places, units=""):
    nodes = {i: place for i, place in enumerate(places, start=1)}
    shape = {i: (i, 0.0, 1.0) for i in nodes}
    path.write_text(units + nodes_15(nodes) + mode_55(1, 62.0, shape), encoding="utf-8")
    return TestFiles(uff=(path,))


@pytest.mark.parametrize("unit", FACTORS)
def test_a_unit_by_the_size_of_the_structure(tmp_path, unit):
    """Axes that are swapped and moved change nothing; the case says it, and that it is a guess."""
    places = (PLACES[:, [2, 0, 1]] + [0.5, -1.0, 0.2]) / FACTORS[unit]
    found = sketch(lab_file(tmp_path / "lab.uff", places), np.array([0.12, 0.15, 0.302]))
    assert any(line.startswith(f'length_unit = "{unit}"  # ?') for line in lines(found))
    assert any("unit" in question for question in found.questions)
    assert np.ptp(found.places, axis=0) == pytest.approx([0.3, 0.12, 0.15], rel=1e-4)


def test_a_unit_that_the_file_says(tmp_path):
    """It stands, whatever the size; and nothing is asked."""

    def ask(question, answer, check):
        assert "Unit" not in question
        return answer

    tests = lab_file(tmp_path / "lab.uff", 1e3 * PLACES, units_164())
    found = sketch(tests, np.array([3.0, 3.0, 3.0]), ask)
    assert 'shapes = "lab.uff"' in lines(found)
    assert np.ptp(found.places, axis=0) == pytest.approx([0.12, 0.15, 0.3])


def test_a_table_without_units(tmp_path):
    """Its places are written in metres; half a head with units is refused."""
    table = tmp_path / "shapes.csv"
    rows = [f"{x},{y},{z},0,0,1,{i + 1}" for i, (x, y, z) in enumerate(100 * PLACES)]
    table.write_text("\n".join(["x,y,z,dx,dy,dz,mode 1", *rows]), encoding="utf-8")
    found = sketch(TestFiles(shapes=table), np.array([0.12, 0.15, 0.3]))
    assert found.places == pytest.approx(PLACES) and any("cm" in line for line in lines(found))
    table.write_text("\n".join(["x [mm],y,z,mode 1", "0,0,0,1"]), encoding="utf-8")
    with pytest.raises(InputError, match=r"units of x, y and z"):
        sketch(TestFiles(shapes=table))


LEVELS = "level [m/s2],frequency [Hz],damping [%]\n5,80.4,0.15\n20,80.2,0.2\n80,80.0,0.6\n"


def test_levels_of_a_mode_that_the_table_of_frequencies_names(tmp_path):
    """By its frequency; alone it is the lowest; the data read as the case says it. Where the
    sensors were is asked, and has a place in the case."""
    (tmp_path / "hz.csv").write_text("row,a [Hz],b [Hz]\n1,30,80.5\n", encoding="utf-8")
    (tmp_path / "levels.csv").write_text(LEVELS, encoding="utf-8")
    tests = TestFiles(frequencies=tmp_path / "hz.csv", amplitude=(tmp_path / "levels.csv",))
    found = sketch(tests)
    assert any("[test.sees]" in line for line in lines(found))
    assert any(question.startswith("The test's sensors") for question in found.questions)
    assert found.n_modes == 2 and 'condition = "row"  # ? without a unit' in lines(found)
    (tmp_path / "test.toml").write_text("\n".join(lines(found)), encoding="utf-8")
    section = read_toml(tmp_path / "test.toml", "a test")["test"]["amplitude"]
    assert section == {"b": {"files": ["levels.csv"]}}
    assert "b at 3 amplitudes (backbone) in levels.csv" in found.found
    alone = sketch(TestFiles(amplitude=tests.amplitude))
    assert alone.n_modes == 1 and '[test.amplitude."mode 1"]' in "\n".join(lines(alone))
    assert any("the lowest that the sensors see" in question for question in alone.questions)


def test_ring_downs_of_several_sensors_and_files_that_cannot_be_read(tmp_path):
    """One sensor is taken and the others named; all bad files are said at once."""
    t = np.arange(0, 2.0, 1 / 2000)
    a = 40 * np.exp(-0.004 * 2 * np.pi * 80 * t) * np.sin(2 * np.pi * 80 * t)
    rows = [f"{x:.6f},{y:.6g},{0.5 * y:.6g}" for x, y in zip(t, a, strict=True)]
    hit = tmp_path / "hit.csv"
    hit.write_text("\n".join(["time [s],a1 [m/s2],a2 [m/s2]", *rows]), encoding="utf-8")
    found = sketch(TestFiles(amplitude=(hit,)))
    assert 'sensor = "a1"  # ? or a2' in lines(found)
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    (tmp_path / "words.csv").write_text("a,b\nx,y\n", encoding="utf-8")
    with pytest.raises(InputError) as bad:
        sketch(TestFiles(amplitude=(tmp_path / "empty.csv", hit, tmp_path / "words.csv")))
    assert "empty.csv" in str(bad.value) and "words.csv" in str(bad.value)


def test_functions_without_levels_are_a_question(tmp_path):
    """As comments beside other modes; refused alone; asked for where somebody answers."""
    pytest.importorskip("pyuff")
    hz = np.linspace(75, 85, 41)
    w, own = 2 * np.pi * hz, 2 * np.pi * 80
    function = -(w**2) / (own**2 - w**2 + 2j * 0.01 * own * w)
    one = world.function(0, 0, x=hz, data=function, ordinate_axis_units_lab="m/s2")
    world.write_uff(tmp_path / "held.uff", one, one)
    (tmp_path / "hz.csv").write_text("a [Hz]\n80.1\n", encoding="utf-8")
    held = (tmp_path / "held.uff",)
    beside = sketch(TestFiles(frequencies=tmp_path / "hz.csv", amplitude=held))
    assert '# levels = ["5 m/s2", "10 m/s2"]' in "\n".join(lines(beside))
    with pytest.raises(InputError, match="expected the levels"):
        sketch(TestFiles(amplitude=held))

    def answer(question, taken, check):
        taken = "2 m/s2, 4 m/s2" if question.startswith("Levels of the 2 FRFs") else taken
        check(taken)
        return taken

    asked = sketch(TestFiles(amplitude=held), ask=answer)
    assert 'levels = ["2 m/s2", "4 m/s2"]' in lines(asked) and asked.n_modes == 1
