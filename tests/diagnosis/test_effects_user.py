"""An effect written for the joints of a case acts on every zone of them, once."""

from __future__ import annotations

import pytest

from fenics_joints.diagnosis import Effect
from fenics_joints.diagnosis.effects.library import for_zones

ZONES = {
    "near": ("near_b1_r1", "near_b2_r1"),
    "away": ("away_r1", "away_r2", "away_r3"),
    "clamp": ("clamp",),
}
VALUES = {
    "near_b1_r1.E": 2.0,
    "near_b2_r1.E": 4.0,
    "away_r1.E": 8.0,
    "away_r2.E": 16.0,
    "away_r3.E": 32.0,
    "clamp.E": 64.0,
    "plates.E": 128.0,
}


def applied(apply) -> dict[str, float]:
    values = dict(VALUES)
    for_zones(Effect("own", "joint", (), apply), ZONES).apply(values, {}, 1.0)
    return values


def test_each_zone_is_changed_once_and_parts_too():
    def halve(values, theta, condition):
        for key in ("near.E", "away.E", "clamp.E", "plates.E"):
            values[key] /= 2

    assert applied(halve) == {key: value / 2 for key, value in VALUES.items()}


def test_zones_see_their_own_values():
    def in_series(values, theta, condition):
        values["away.E"] = 1 / (1 / values["away.E"] + 1 / values["near.E"])

    found = applied(in_series)
    assert found["away_r1.E"] == pytest.approx(1 / (1 / 8 + 1 / 2))
    assert found["away_r2.E"] == pytest.approx(1 / (1 / 16 + 1 / 4))
    assert found["away_r3.E"] == pytest.approx(1 / (1 / 32 + 1 / 4))
    assert {k: v for k, v in found.items() if "away" not in k} == {
        k: v for k, v in VALUES.items() if "away" not in k
    }


def test_one_that_names_zones_acts_once():
    def loosen(values, theta, condition):
        values["away_r2.E"] *= 0.1

    assert applied(loosen) == {**VALUES, "away_r2.E": pytest.approx(1.6)}


def test_a_name_that_is_not_there_is_told():
    def wrong(values, theta, condition):
        values["far.E"] += values["far.E"]

    with pytest.raises(KeyError, match=r"far\.E"):
        applied(wrong)
