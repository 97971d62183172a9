"""Laws of a joint that gives way, by how much in cases known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from effect_rig import LAYER, theta_of

from fenics_joints.diagnosis.effects.joint import (
    bell_pressure,
    compliant,
    graded,
    loose_bolt,
    lost_beyond,
    low_preload,
    pressed_by_bolts,
)
from fenics_joints.diagnosis.zones.zone import Zone

DISTANCE = np.array([[2e-3, 8e-3], [9e-3, 14e-3], [15e-3, 21e-3]])
RINGS = [Zone(f"r{i + 1}", thickness=LAYER, distance=tuple(d)) for i, d in enumerate(DISTANCE)]
STIFF = {
    key: value for zone in RINGS for key, value in zip(zone.parameters(), (2e11, 8e10), strict=True)
}


def put(effect, condition=20.0, **theta):
    values = dict(STIFF)
    effect.apply(values, {**theta_of(effect, 0.0), **theta}, condition)
    return values


def joint_law(kind):
    return {
        "all": compliant("c", "joint", RINGS, reference=20.0),
        "graded": graded({"in": RINGS[:1], "out": RINGS[1:]}, "nt", "somehow", 20.0),
        "pressed": pressed_by_bolts(RINGS, 20.0),
        "loose": loose_bolt("b1", RINGS, 1.0),
    }[kind]


@pytest.mark.parametrize("kind", ["all", "graded", "pressed", "loose"])
def test_a_stiff_interface_is_none_and_a_soft_one_carries_nothing(kind):
    effect = joint_law(kind)
    stiff = {p.name: 1e40 for p in effect.priors if p.unit == "Pa/m"}
    assert put(effect, radius=1.0, **stiff) == pytest.approx(STIFF)
    left = put(effect, radius=1.0, **dict.fromkeys(stiff, 1.0))
    assert all(left[key] < 1e-7 * STIFF[key] for key in STIFF)
    assert min(left.values()) > 0


@pytest.mark.parametrize("kind", ["all", "graded", "pressed"])
def test_interface_stiffens_by_a_power_of_the_torque(kind):
    """From the series the interface's own spring is taken out by hand."""
    effect = joint_law(kind)
    betas = {p.name: 0.6 for p in effect.priors if p.name.startswith("beta")}

    def spring(condition):
        values = put(effect, condition, radius=0.1, **betas)
        return np.array([1 / (1 / values[key] - 1 / STIFF[key]) for key in STIFF])

    assert spring(5.0) / spring(20.0) == pytest.approx(np.full(len(STIFF), 0.25**0.6))
    assert effect.depends_on_condition


def test_bell_is_the_mean_of_the_pressure_over_a_ring():
    for radius in (6e-3, 12e-3, 17e-3, 30e-3):
        mean = []
        for a, b in DISTANCE:
            r = np.linspace(a, b, 20001)
            mean.append(np.average(np.maximum(0, 1 - (r / radius) ** 2), weights=r))
        assert bell_pressure(*DISTANCE.T, radius) == pytest.approx(mean, abs=1e-4)
    assert bell_pressure([5e-3], [5e-3], 10e-3) == pytest.approx([0.75])


def test_pressed_interface_is_softer_further_out_and_lost_beyond():
    effect = pressed_by_bolts(RINGS, None)
    values = put(effect, radius=14.5e-3, k_t=1e12, k_n=1e12, beta=0.5)
    springs = [1 / (1 / values[f"{r}.G"] - 1 / 8e10) / LAYER for r in ("r1", "r2")]
    pressure = bell_pressure(*DISTANCE.T, 14.5e-3)
    assert springs == pytest.approx(1e12 * np.sqrt(pressure[:2]))
    assert values["r3.G"] < 1e-8 * STIFF["r3.G"]
    assert not effect.depends_on_condition


def test_contact_is_lost_ring_by_ring_from_outside():
    effect = lost_beyond(RINGS)
    assert put(effect, radius=0.1) == STIFF
    left = np.array(
        [
            [put(effect, radius=r)[f"{z.name}.E"] / 2e11 for z in RINGS]
            for r in np.linspace(30e-3, 0.0, 200)
        ]
    )
    assert np.all(np.diff(left, axis=0) <= 0) and np.all(np.diff(left, axis=1) <= 0)
    assert left[-1, 1:] == pytest.approx([1e-9, 1e-9])
    (prior,) = effect.priors
    assert prior.scan > 0 and prior.span[0] < prior.median < prior.span[1]


def test_low_preload_is_a_power_of_what_is_left():
    effect = low_preload("joint", RINGS, "low")
    values = put(effect, preload=0.25, beta=0.5)
    assert values == pytest.approx({key: 0.5 * value for key, value in STIFF.items()})
