"""Threads by the holes that they go through, against ISO 273 and tapping drills."""

from __future__ import annotations

import pytest

from fenics_joints.errors import InputError
from fenics_joints.preload.clearance import guess_thread


@pytest.mark.parametrize(
    "widest, narrowest, name",
    [
        (6.6, None, "M6"),
        (9.0, None, "M8"),
        (8.4, None, "M8"),
        (11.0, None, "M10"),
        (13.5, 10.2, "M12"),
        (14.5, None, "M12"),
        (17.5, None, "M16"),
        (22.0, 17.5, "M20"),
        (11.0, 8.5, "M10"),
        (9.0, 6.8, "M8"),
        (5.3, 4.2, "M5"),
        (26.0, 21.0, "M24"),
    ],
)
def test_threads(widest, narrowest, name):
    small = None if narrowest is None else 1e-3 * narrowest
    assert guess_thread(1e-3 * widest, small).thread.name == name


def test_doubts_and_none():
    """12 mm is M10 coarse or M12 without clearance; a hole of 150 mm is no bolt's."""
    guess = guess_thread(12e-3)
    assert {guess.thread.name, *guess.others} >= {"M10", "M12"}
    assert guess_thread(0.15) is None
    with pytest.raises(InputError, match="widest"):
        guess_thread(-1.0)
