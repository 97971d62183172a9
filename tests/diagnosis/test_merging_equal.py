"""Hypotheses that are one another in other words, and those that only look so."""

from __future__ import annotations

import pytest

from fenics_joints.diagnosis.effects.damping import gapping, micro_slip
from fenics_joints.diagnosis.effects.effect import Effect, Prior, relative_error
from fenics_joints.diagnosis.effects.joint import compliant, graded
from fenics_joints.diagnosis.evidence.merging import KnownEffects, distinct, equal
from fenics_joints.diagnosis.zones.zone import Zone

BASELINE = {"near.E": 9e10, "near.G": 3e10, "away.E": 8e10, "away.G": 2e10, "lid.E": 7e10}
NEAR, AWAY = Zone("near", thickness=3e-4), Zone("away", thickness=3e-4)

pytestmark = pytest.mark.smoke


def in_words(reference=None):
    """Graded, and the same in other words: the one zone gives way, and the other."""
    away = compliant("away from the bolts only", "away", [AWAY], None, reference)
    near = compliant("at one joint", "near", [NEAR], None, reference, family="one place")
    two = {"ring 1": [NEAR], "away": [AWAY]}
    return (away, near), graded(two, ("n", "t"), "from zone to zone", reference)


def test_two_zones_that_give_way_are_one_graded_joint():
    pair, one = in_words()
    assert equal(pair, (one,), BASELINE, [1.0]) and equal((one,), pair[::-1], BASELINE, [1.0])
    known = KnownEffects(BASELINE, [1.0])
    assert known.same((one,)) is None
    assert known.same(pair) == (one,)
    assert known.same(pair[:1]) is None
    # With torques each of the pair has exponents of its own, which the graded one shares.
    pair, one = in_words(reference=20.0)
    assert not equal(pair, (one,), BASELINE, [5.0, 20.0])


def test_causes_that_look_alike_stay_two():
    """The same values, at another prior density: another cause."""
    modulus = relative_error("modulus error", "lid", ["lid.E"], 0.03, "")
    again = relative_error("E of the lid", "lid", ["lid.E"], 0.03, "")
    looser = relative_error("wrong alloy", "lid", ["lid.E"], 0.1, "")

    def heat(values, theta, condition):
        values["lid.E"] *= 1 - 5e-4 * theta["kelvin"]

    heated = Effect("temperature", "lid", (Prior("kelvin", 0.0, 60.0, "K", log=False),), heat)
    found = distinct((modulus, again, looser, heated), BASELINE, [1.0])
    assert [e.name for e in found] == ["modulus error", "wrong alloy", "temperature"]


def test_losses_tell_effects_of_equal_stiffness_apart():
    levels = [1.0, 2.0]
    slip, gap = micro_slip([NEAR], 2.0), gapping([NEAR], 2.0)
    assert len(distinct((slip, gap, micro_slip([NEAR], 2.0)), BASELINE, levels)) == 2

    def loss(eta):
        def of(theta, level, hz):
            return {"near.G": eta * theta["factor"]}

        return of

    prior = (Prior("factor", 1.0, 0.5),)
    lossy = [Effect(f"loss {x}", "", prior, None, loss=loss(x)) for x in (0.01, 0.02)]
    assert len(distinct(lossy, BASELINE, levels)) == 2
