"""Effects at several places that a test cannot tell apart are one, with the prior odds of all."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.merging import merge_indistinguishable
from fenics_joints.reduction import ArrayModel, ModalPrediction
from fenics_joints.reduction.affine import AffinePencil, RegionTerm, spring_term
from fenics_joints.structure import Parameter
from fenics_joints.structure.laws import LAYER_LAWS

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
