"""Effects that do the same to the model, or predict the same at different places, are one."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.diagnosis.effects.damping import gapping, micro_slip
from fenics_joints.diagnosis.effects.effect import Effect, Prior, relative_error
from fenics_joints.diagnosis.effects.joint import compliant, graded
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.merging import (
    KnownEffects,
    distinct,
    equal,
    merge_indistinguishable,
)
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.reduction import ArrayModel, ModalPrediction
from fenics_joints.reduction.affine import AffinePencil, RegionTerm, spring_term
from fenics_joints.structure import Parameter
from fenics_joints.structure.laws import LAYER_LAWS

JOINT = {"near.E": 9e10, "near.G": 3e10, "away.E": 8e10, "away.G": 2e10, "lid.E": 7e10}
NEAR, AWAY = Zone("near", thickness=3e-4), Zone("away", thickness=3e-4)


def in_words(reference=None):
    """Graded, and the same in other words: the one zone gives way, and the other."""
    away = compliant("away from the bolts only", "away", [AWAY], None, reference)
    near = compliant("at one joint", "near", [NEAR], None, reference, family="one place")
    two = {"ring 1": [NEAR], "away": [AWAY]}
    return (away, near), graded(two, ("n", "t"), "from zone to zone", reference)


@pytest.mark.smoke
def test_two_zones_that_give_way_are_one_graded_joint():
    pair, one = in_words()
    assert equal(pair, (one,), JOINT, [1.0]) and equal((one,), pair[::-1], JOINT, [1.0])
    known = KnownEffects(JOINT, [1.0])
    assert known.same((one,)) is None
    assert known.same(pair) == (one,)
    assert known.same(pair[:1]) is None
    # With torques each of the pair has exponents of its own, which the graded one shares.
    pair, one = in_words(reference=20.0)
    assert not equal(pair, (one,), JOINT, [5.0, 20.0])


@pytest.mark.smoke
def test_causes_that_look_alike_stay_two():
    """The same values, at another prior density: another cause."""
    modulus = relative_error("modulus error", "lid", ["lid.E"], 0.03, "")
    again = relative_error("E of the lid", "lid", ["lid.E"], 0.03, "")
    looser = relative_error("wrong alloy", "lid", ["lid.E"], 0.1, "")

    def heat(values, theta, condition):
        values["lid.E"] *= 1 - 5e-4 * theta["kelvin"]

    heated = Effect("temperature", "lid", (Prior("kelvin", 0.0, 60.0, "K", log=False),), heat)
    found = distinct((modulus, again, looser, heated), JOINT, [1.0])
    assert [e.name for e in found] == ["modulus error", "wrong alloy", "temperature"]


@pytest.mark.smoke
def test_losses_tell_effects_of_equal_stiffness_apart():
    levels = [1.0, 2.0]
    slip, gap = micro_slip([NEAR], 2.0), gapping([NEAR], 2.0)
    assert len(distinct((slip, gap, micro_slip([NEAR], 2.0)), JOINT, levels)) == 2

    def loss(eta):
        def of(theta, level, hz):
            return {"near.G": eta * theta["factor"]}

        return of

    prior = (Prior("factor", 1.0, 0.5),)
    lossy = [Effect(f"loss {x}", "", prior, None, loss=loss(x)) for x in (0.01, 0.02)]
    assert len(distinct(lossy, JOINT, levels)) == 2


# -- the same predictions at different places ------------------------------------------------------

N = 9
GROUNDS = {"left": 1, "right": 7, "inner": 3}
BASELINE = {"a.rho": 1.0, **{name: 2e6 for name in GROUNDS}}


def symmetric_chain() -> ModalPrediction:
    """On grounding springs: the left one and the right one are mirror images."""
    stiffness = np.zeros((4, N, N))
    for i in range(N - 1):
        rod = np.zeros(N)
        rod[i : i + 2] = -1.0, 1.0
        stiffness[1] += np.outer(rod, rod)
    properties = {"E": 1.0, "G": 3e6, "rho": "a.rho", "stretch": 1.0}
    region = RegionTerm("a", LAYER_LAWS["uncoupled"], properties, stiffness, np.eye(N), 1.0)
    springs = [spring_term(name, name, 1.0, np.eye(N)[i]) for name, i in GROUNDS.items()]
    parameters = {name: Parameter(name, value) for name, value in BASELINE.items()}
    return ModalPrediction(
        ArrayModel(AffinePencil(parameters, [region], springs), 100.0), None, 4, 6
    )


def loose(*places: str, holds=(), weight=0.5) -> Effect:
    def apply(values, theta, condition):
        for place in places:
            values[place] *= theta["left"]

    name = {1: "loose", 2: "two loose"}[len(places)]
    prior = Prior("left", 0.1, 1.0, span=(1e-4, 1.0))
    held = frozenset(f"loose ({place})" for place in holds)
    return Effect(name, ", ".join(places), (prior,), apply, weight=weight, holds=held)


@pytest.mark.parametrize("nearly", [1.0, 1.0 + 1e-9])
def test_mirror_images_are_one(nearly):
    """Also with a round-off between them; what holds them holds the one."""
    forward = symmetric_chain()
    baseline = {**BASELINE, "right": nearly * BASELINE["right"], "inner": 1e-3}
    evidence = Evidence(np.ones(1), forward(baseline)[0][None], np.full((1, 4), 1e-3), 0.01)
    effects = [
        loose("left"),
        loose("right"),
        loose("inner"),
        loose("left", "inner", holds=("left", "inner")),
        loose("right", "inner", holds=("right", "inner")),
    ]
    found = {
        e.key: e
        for e in merge_indistinguishable(effects, forward, evidence, baseline, MPI.COMM_SELF)
    }
    both = "two loose (left, inner / right, inner)"
    assert list(found) == ["loose (left / right)", "loose (inner)", both]
    assert [e.weight for e in found.values()] == [1.0, 0.5, 1.0]
    assert found[both].holds == {"loose (left / right)", "loose (inner)"}
    assert "left; right" in found["loose (left / right)"].describe


def test_what_shows_when_it_is_large_is_not_the_same():
    """At its expected size the test sees neither."""
    forward = symmetric_chain()
    baseline = {**BASELINE, "inner": 1e-3}
    f = forward(baseline)[0][None]
    evidence = Evidence(np.ones(1), f, np.full((1, 4), 1e-3), 0.01)

    def stiffer(place: str) -> Effect:
        def apply(values, theta, condition):
            values[place] += theta["more"] * BASELINE[place]

        return Effect("stiffer", place, (Prior("more", 1e-4, 3.0),), apply)

    effects = [stiffer(place) for place in GROUNDS]
    found = merge_indistinguishable(effects, forward, evidence, baseline, MPI.COMM_SELF)
    assert [e.region for e in found] == ["left / right", "inner"]
