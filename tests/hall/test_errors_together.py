"""Errors that are said together."""

from __future__ import annotations

import pytest

from fenics_joints.errors import InputError, MeshError, Problems


def found(where, *lines, kind=InputError) -> str:
    problems = Problems(where)
    for line in lines:
        problems.add(kind(line))
    with pytest.raises(kind) as raised:
        problems.check()
    return str(raised.value)


def test_one_error_is_itself_and_several_are_a_list():
    Problems("a.csv").check()
    assert found("a.csv", "a.csv: row 2: bad") == "a.csv: row 2: bad"
    assert found("a.csv", "a.csv: row 2: bad", "a.csv: row 3: worse", kind=MeshError) == (
        "a.csv: 2 errors:\n  row 2: bad\n  row 3: worse"
    )
    assert found("", "a.csv: bad", "b.csv: bad").startswith("2 errors in the files:\n  a.csv: bad")


def test_the_same_of_several_places_is_one_line_and_ten_lines_are_enough():
    alike = found("a.uff", *(f"a.uff: dataset {i}: no unit" for i in range(1, 9)))
    assert alike.splitlines()[1:] == [
        "  dataset 1, dataset 2, dataset 3, dataset 4 and 4 more: no unit"
    ]
    many = found("a.uff", *(f"a.uff: dataset {i}: has {i}" for i in range(1, 15)))
    assert len(many.splitlines()) == 12 and many.endswith("and 4 more")
    assert many.startswith("a.uff: 14 errors:")
