"""Effects on damping, parts and the test, by how much in cases known by hand."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from effect_rig import TORQUES, touched

from fenics_joints.diagnosis.effects import effect as effects_module
from fenics_joints.diagnosis.effects.damping import hysteretic_damping, viscous_damping
from fenics_joints.diagnosis.effects.effect import Sensing
from fenics_joints.diagnosis.effects.part import temperature
from fenics_joints.diagnosis.effects.rig import misplaced_sensor, misscaled_sensor, swapped_modes
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions, PointwiseForward, model_of
from fenics_joints.diagnosis.zones.zone import Zone

MODES = ("a", "b", "c")


def at_one_condition(count: int, damped=False) -> Evidence:
    flat = np.zeros((1, count))
    return Evidence(np.ones(1), flat, flat + 0.01, 0.01, log_damping=flat if damped else None)


class Springs(PointwiseForward):
    """Three modes with given shares of their energy in a joint's spring."""

    model, shares = model_of(["lap.E", "lap.G"]), np.array([0.2, 0.1, 0.3])

    def __call__(self, values):
        by = np.zeros((3, 2))
        by[:, 1] = 0.5 * self.shares / values["lap.G"]
        return np.log([100.0, 200.0, 400.0]), by


@pytest.mark.parametrize("kind", ["hysteretic", "viscous"])
def test_damping_is_the_share_of_the_energy_at_the_frequency(kind):
    make = {"hysteretic": hysteretic_damping, "viscous": lambda z: viscous_damping(z, 200.0)}
    effect = make[kind]([Zone("lap")])
    hypothesis = Hypothesis((effect,), modes=MODES, damped=True)
    evidence = at_one_condition(3, damped=True)
    baseline = {"lap.E": 1e11, "lap.G": 4e10}
    z = np.zeros(len(hypothesis.priors))
    z[0] = 0.5
    predicted, _ = ManyPredictions(hypothesis, Springs(), evidence, baseline).at(z)
    eta = 0.02 * 4**0.5
    by_hz = np.array([0.5, 1.0, 2.0]) if kind == "viscous" else np.ones(3)
    expected = 0.003 + 0.5 * eta * by_hz * Springs.shares
    assert np.exp(predicted[3:]) == pytest.approx(expected, rel=1e-9)
    assert touched(effect, baseline) == set()


def test_temperature_drifts_by_the_order_of_the_conditions():
    values = [{"p.E": 1.0} for _ in TORQUES]
    drifting = temperature(["p"], TORQUES, drifts=True)
    for own, torque in zip(values, TORQUES, strict=True):
        drifting.apply(own, {"offset": 10.0, "drift": -5.0}, torque)
    steps = [1 - own["p.E"] for own in values]
    assert steps == pytest.approx([4e-3, 3e-3, 2e-3])
    assert [p.name for p in temperature(["p"], TORQUES, drifts=False).priors] == ["offset"]
    assert [p.name for p in temperature(["p"], TORQUES[:1], drifts=True).priors] == ["offset"]


def test_causes_in_the_test_change_how_it_reads():
    sensing = Sensing.true(3, 2)
    swapped_modes(1, MODES).sensing(sensing, {})
    assert sensing.order.tolist() == [0, 2, 1]
    misscaled_sensor(1, 0.5).sensing(sensing, {"gain": 1.3})
    misplaced_sensor(0, 0.3, 0.5).sensing(sensing, {"shift": -2e-3})
    assert sensing.gains.tolist() == [1.0, 1.3]
    assert sensing.shifts[:, 0].tolist() == [-2e-3, 0, 4e-6, 0, 0, -8e-9, 0, 0, 0]
    both = {"shift": 1e-3, "shift across": 4e-3}
    misplaced_sensor(1, 0.3, 0.5, ways=2).sensing(sensing, both)
    assert sensing.shifts[:2].tolist() == [[-2e-3, 1e-3], [0.0, 4e-3]]
    assert sensing.shifts[2:5, 1] == pytest.approx([1e-6, 4e-6, 16e-6])
    assert sensing.shifts[5:, 1] == pytest.approx([1e-9, 4e-9, 16e-9, 64e-9])
    assert misplaced_sensor(0, 0.3, 0.5).priors[0].spread == pytest.approx(9e-3)
    hypothesis = Hypothesis((swapped_modes(1, MODES),), modes=MODES)
    evidence = at_one_condition(3)
    baseline = {"lap.E": 1.0, "lap.G": 1.0}
    got, slopes = ManyPredictions(hypothesis, Springs(), evidence, baseline).at(np.zeros(0))
    assert np.exp(got) == pytest.approx([100.0, 400.0, 200.0]) and slopes.shape == (3, 0)


def test_ten_lines_in_the_documentation_make_an_effect():
    text = inspect.getdoc(effects_module)
    lines = text.split("::\n", 1)[1].split("\nIt goes in", 1)[0].splitlines()
    code = inspect.cleandoc("\n".join(lines))
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    space = {}
    exec(code, space)
    effect = space["delaminated"]

    class Lid(PointwiseForward):
        model = model_of(["lid.E"])

        def __call__(self, values):
            E = values["lid.E"]
            return np.full(2, 0.5 * np.log(E)), np.full((2, 1), 0.5 / E)

    evidence = at_one_condition(2)
    hypothesis = Hypothesis((effect,), modes=("a", "b"))
    got, slopes = ManyPredictions(hypothesis, Lid(), evidence, {"lid.E": 7e10}).at(np.ones(1))
    lost = 0.1 * np.exp(0.7)
    assert got == pytest.approx(0.5 * np.log(7e10 * (1 - lost)))
    assert slopes == pytest.approx(np.full((2, 1), -0.5 * 0.7 * lost / (1 - lost)), rel=1e-6)
