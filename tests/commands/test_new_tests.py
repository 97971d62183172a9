"""What ``fenics-joints new`` makes of a test's files: units that they leave out."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from uff_files import mode_55, nodes_15, units_164

from fenics_joints.commands.new.tests import TestFiles, test_sketch
from fenics_joints.errors import InputError

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="new is for one process")

#: Sensors on a frame of 0.12 x 0.15 x 0.3 m, m.
PLACES = np.array([[x, y, z] for x in (0, 0.12) for y in (0, 0.15) for z in (0, 0.15, 0.3)])
FACTORS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}


def silent(question, answer, check):
    check(answer)
    return answer


def sketch(tests, extents=None, ask=silent):
    return test_sketch(tests, lambda path: path.name, ask, lambda: extents)


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
    assert any(line.startswith(f'length_unit = "{unit}"  # ?') for line in found.lines)
    assert any("unit" in question for question in found.questions)
    assert np.ptp(found.places, axis=0) == pytest.approx([0.3, 0.12, 0.15], rel=1e-4)


def test_a_unit_that_the_file_says(tmp_path):
    """It stands, whatever the size; and nothing is asked."""
    def ask(question, answer, check):
        assert "Unit" not in question
        return answer

    tests = lab_file(tmp_path / "lab.uff", 1e3 * PLACES, units_164())
    found = sketch(tests, np.array([3.0, 3.0, 3.0]), ask)
    assert 'shapes = "lab.uff"' in found.lines
    assert np.ptp(found.places, axis=0) == pytest.approx([0.12, 0.15, 0.3])


def test_a_table_without_units(tmp_path):
    """Its places are written in metres; half a head with units is refused."""
    table = tmp_path / "shapes.csv"
    rows = [f"{x},{y},{z},0,0,1,{i + 1}" for i, (x, y, z) in enumerate(100 * PLACES)]
    table.write_text("\n".join(["x,y,z,dx,dy,dz,mode 1", *rows]), encoding="utf-8")
    found = sketch(TestFiles(shapes=table), np.array([0.12, 0.15, 0.3]))
    assert found.places == pytest.approx(PLACES) and any("cm" in line for line in found.lines)
    table.write_text("\n".join(["x [mm],y,z,mode 1", "0,0,0,1"]), encoding="utf-8")
    with pytest.raises(InputError, match=r"units of x, y and z"):
        sketch(TestFiles(shapes=table))


def test_what_a_table_of_frequencies_leaves_open(tmp_path):
    """Where the sensors were: asked, and a place for it in the case."""
    table = tmp_path / "hz.csv"
    table.write_text("first [Hz],second [Hz]\n80,300\n", encoding="utf-8")
    found = sketch(TestFiles(frequencies=table))
    assert any("[test.sees]" in line for line in found.lines)
    assert any(question.startswith("What the test saw") for question in found.questions)
