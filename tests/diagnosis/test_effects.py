"""The library of effects: what each changes, and by how much in cases known by hand."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import Case, build_mesh, build_structure
from fenics_joints.diagnosis.effects import effect as effects_module
from fenics_joints.diagnosis.effects.bolts import loose_bolt, low_preload
from fenics_joints.diagnosis.effects.damping import hysteretic_damping, viscous_damping
from fenics_joints.diagnosis.effects.joint import (
    bell_pressure,
    gives_way,
    graded,
    lost_beyond,
    pressed_by_bolts,
)
from fenics_joints.diagnosis.effects.library import case_effects, case_nuisances
from fenics_joints.diagnosis.effects.part import temperature
from fenics_joints.diagnosis.effects.rig import misplaced_sensor, misscaled_sensor, swapped_modes
from fenics_joints.diagnosis.effects.samples import sample_ranges, sample_values
from fenics_joints.diagnosis.effects.sensing import Sensing
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.prediction import predict
from fenics_joints.diagnosis.zones.joints import joint_zones
from fenics_joints.diagnosis.zones.nominal import bonded_values
from fenics_joints.diagnosis.zones.places import LayerZone, placed
from fenics_joints.diagnosis.zones.zone import Zone, Zones
from fenics_joints.errors import InputError
from fenics_joints.forms import lame_from_moduli
from fenics_joints.measurements import TestData
from fenics_joints.structure import Sensors

STEEL = {"E": 2e11, "nu": 0.3, "rho": 7800.0}
SOFT = {"E": 1e9, "G": 4e8}
RIG = {
    "mesh": {"builder": "lap_plates", "element_size": 2e-2, "n_thickness": 1, "degree": 1},
    "parts": {
        "upper": {"cells": ["plate_2"], **STEEL},
        "lower": {"cells": ["plate_1"], "tolerance": {"width": 0.01}, **STEEL},
    },
    "joints": {
        "near": {"cells": "joint_near", "bolted": True, **SOFT},
        "away": {"cells": "joint_away", **SOFT},
    },
    "masses": {"nut": {"points": [[0.01, 0.04, 0.0]], "mass": 0.01}},
    "springs": {
        "cord": {
            "points": [[0.01, 0.04, 0.0]], "direction": [0, 0, 1], "stiffness": 1e3,
            "tolerance": 0.2,
        },
    },
    "attached": {"cell": {"kind": "mass", "points": [[0.01, 0.04, 0.0]], "mass": 0.02}},
    "supports": {"left_end": {"facets": "end"}},
}  # fmt: skip
LAYER, TORQUES = 5e-4, np.array([5.0, 10.0, 20.0])
MODES = ("a", "b", "c")


def measured(conditions=TORQUES, name="torque", unit="N·m", shapes=False, damping=False):
    shape = (len(conditions), len(MODES))
    hz = np.broadcast_to([100.0, 200.0, 400.0], shape)
    sensors = Sensors(np.array([[x, 0.04, 0.0] for x in (0.0, 0.1, 0.3)]), [0, 0, 1])
    there = np.array([[1.0, 1.0, 1.0], [0.5, -1.0, 0.2], [-1.0, 1.0, 0.1]])
    return TestData(
        conditions, hz, MODES, name, unit, sensors=sensors, noise=0.01,
        shapes=there if shapes else None,
        damping=np.full(shape, 2e-3) if damping else None, damping_noise=0.1 if damping else None,
    )  # fmt: skip


@pytest.fixture(scope="module")
def zones():
    case = Case.model_validate({key: RIG[key] for key in ("mesh", "parts", "joints")})
    return joint_zones(case, build_mesh(case, MPI.COMM_SELF))


@pytest.fixture(scope="module")
def case(zones):
    more = {key: RIG[key] for key in ("masses", "springs", "attached", "supports")}
    return zones.case.model_copy(update={k: getattr(whole(more), k) for k in more})


def whole(tables):
    base = {key: RIG[key] for key in ("mesh", "parts", "joints")}
    return Case.model_validate(base | tables)


def library(case, zones, data, **diagnose):
    case = case.model_copy(update={"diagnose": case.diagnose.model_copy(update=diagnose)})
    return case_effects(case, data, zones.with_thickness(dict.fromkeys(case.joints, LAYER)))


def theta_of(effect, z=0.7):
    return {p.name: p.value(float(np.clip(z, *p.limits()))) for p in effect.priors}


def touched(effect, baseline, condition=10.0) -> set[str]:
    values = dict(baseline)
    if effect.apply is not None:
        effect.apply(values, theta_of(effect), condition)
    assert set(values) == set(baseline)
    return {key for key in values if values[key] != baseline[key]}


# -- what they change ------------------------------------------------------------------------------


def test_each_effect_changes_what_it_should_and_no_more(case, zones):
    found, silent = library(case, zones, measured(shapes=True, damping=True), joints="given")
    assert {s.effect for s in silent} == {
        "micro-slip in the joint", "gapping without slip", "damping that grows without softening"
    }  # fmt: skip
    baseline = bonded_values(case)
    E, G = ({f"{zone}.{key}" for zone in case.joints} for key in "EG")
    bolt = {k for k in E | G if "_b2_" in k}
    away = {k for k in E | G if k.startswith("away")}
    expected = {
        "joint normal compliance (joint)": E,
        "joint tangential compliance (joint)": G,
        "joint normal and tangential compliance (joint)": E | G,
        "compliance away from the bolts only (away)": away,
        "joint compliance graded from zone to zone (joint)": E | G,
        "joint compliance that falls with the pressure (joint)": E | G,
        "compliance at one bolt (bolt 2)": bolt,
        "loose bolt (bolt 2)": bolt,
        "preload lower than nominal (joint)": E | G,
        "preload of one bolt lower than nominal (bolt 2)": bolt,
        "joint hysteretic damping (joint)": set(),
        "joint viscous damping (joint)": set(),
        "modulus error (upper)": {"upper.E"},
        "density error (lower)": {"lower.rho"},
        "thickness error (upper)": {"upper.thickness"},
        "width error (lower)": {"lower.width"},
        "modulus error of all parts (all parts)": {"upper.E", "lower.E"},
        "width error of all parts (all parts)": {"upper.width", "lower.width"},
        "temperature (all parts)": {"upper.E", "lower.E"},
        "cell mass (cell)": {"cell.mass"},
        "mass error (nut)": {"nut.mass"},
        "spring error (cord)": {"cord.stiffness"},
        "left end compliance (left_end)": {"left_end.k_n", "left_end.k_t"},
        "mode mis-pairing (a, b)": set(),
        "sensor mis-scaled (sensor 2)": set(),
        "sensor misplaced (sensor 3)": set(),
    }
    by_key = {effect.key: effect for effect in found}
    assert len(by_key) == len(found)
    for key, names in expected.items():
        assert touched(by_key[key], baseline) == names, key
    lost = by_key["contact lost at low pressure (joint)"]
    values = dict(baseline)
    lost.apply(values, {"radius": 0.75 * np.nanmax(zones.distance), "cutoff": 1e-4}, 10.0)
    gone = {key for key in values if values[key] != baseline[key]}
    assert gone and gone < E | G
    # Nothing in the library but what was looked at here, or its like at another place.
    assert {e.name for e in found} == {e.name for e in map(by_key.get, [*expected, lost.key])} | {
        "density error of all parts", "thickness error of all parts"
    }  # fmt: skip
    for effect in found:
        assert (effect.apply is None) == (touched(effect, baseline) == set() and effect != lost)


def test_weights_of_places_sum_to_one(case, zones):
    found, _ = library(case, zones, measured(shapes=True), joints="given")
    total = {}
    for effect in found:
        total[effect.name] = total.get(effect.name, 0.0) + effect.weight
    # A description of a joint is less of a cause than a physical law.
    assert total.pop("joint compliance graded from zone to zone") == pytest.approx(0.25)
    assert total == pytest.approx(dict.fromkeys(total, 1.0))
    places = {e.region for e in found if e.name == "loose bolt"}
    assert places == {"bolt 1", "bolt 2", "bolt 3", "bolt 4"}
    assert {e.region for e in found if e.name == "mode mis-pairing"} == {"a, b", "b, c"}


def test_what_a_test_cannot_speak_of_is_said(case, zones):
    found, silent = library(case, zones, measured())
    reasons = {s.effect: s.reason for s in silent}
    assert set(reasons) >= {
        "preload lower than nominal", "joint hysteretic damping", "joint viscous damping",
        "sensor mis-scaled", "sensor misplaced",
    }  # fmt: skip
    assert not set(reasons) & {effect.name for effect in found}
    assert 'joints = "given"' in reasons["preload lower than nominal"]
    assert "no mode shapes" in reasons["sensor misplaced"]
    one, _ = library(case, zones, measured(), effects=["loose bolt", "sensor misplaced"])
    assert {e.name for e in one} == {"loose bolt"}
    with pytest.raises(InputError, match=r"diagnose.effects: 'rust' does not exist"):
        library(case, zones, measured(), effects=["rust"])


# -- joints ----------------------------------------------------------------------------------------

DISTANCE = np.array([[2e-3, 8e-3], [9e-3, 14e-3], [15e-3, 21e-3]])
RINGS = [Zone(f"r{i + 1}", thickness=LAYER, distance=tuple(d)) for i, d in enumerate(DISTANCE)]
STIFF = {key: value for zone in RINGS
         for key, value in zip(zone.parameters(), (2e11, 8e10), strict=True)}  # fmt: skip


def put(effect, condition=20.0, **theta):
    values = dict(STIFF)
    effect.apply(values, {**theta_of(effect, 0.0), **theta}, condition)
    return values


def joint_law(kind):
    return {
        "all": gives_way("c", "joint", RINGS, reference=20.0),
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
    left = np.array([[put(effect, radius=r)[f"{z.name}.E"] / 2e11 for z in RINGS]
                     for r in np.linspace(30e-3, 0.0, 200)])  # fmt: skip
    assert np.all(np.diff(left, axis=0) <= 0) and np.all(np.diff(left, axis=1) <= 0)
    assert left[-1, 1:] == pytest.approx([1e-9, 1e-9])
    (prior,) = effect.priors
    assert prior.scan > 0 and prior.span[0] < prior.median < prior.span[1]


def test_low_preload_is_a_power_of_what_is_left(case, zones):
    effect = low_preload("joint", RINGS, "low")
    values = put(effect, preload=0.25, beta=0.5)
    assert values == pytest.approx({key: 0.5 * value for key, value in STIFF.items()})


def test_given_joints_are_those_of_the_case():
    data = {**RIG, "joints": {"near": RIG["joints"]["near"], "away": {
        "cells": "joint_away", "law": "isotropic", "E": 1e9, "G": 4e8}}}  # fmt: skip
    case = Case.model_validate(data | {"diagnose": {"joints": "given"}})
    values = bonded_values(case)
    assert (values["near.E"], values["near.G"]) == (1e9, 4e8)
    # lambda + 2 G of E = 1 GPa, nu = 0.25.
    assert values["away.E"] == pytest.approx(1.2e9) and values["away.G"] == 4e8
    assert sum(lame_from_moduli(1e9, 4e8)) + 4e8 == pytest.approx(1.2e9)
    bonded = bonded_values(Case.model_validate(data))
    assert bonded["near.E"] == pytest.approx(2e11 * 0.7 / (1.3 * 0.4))
    with pytest.raises(ValueError, match="joints"):
        Case.model_validate(data | {"diagnose": {"joints": "glued"}})


def zones_at(joints, axes):
    """Zones without a mesh, two rings each."""
    rows = [
        LayerZone(f"{joint}_b1_r{ring}", joint, 1.0, 1, ring, span, axis)
        for joint, axis in zip(joints, axes, strict=True)
        for ring, span in ((1, (0.0, 5e-3)), (2, (6e-3, 9e-3)))
    ]
    own = {row.name: SimpleNamespace(bolted=False, normal=(0.0, 0.0, 1.0)) for row in rows}
    return placed(SimpleNamespace(joints=own), rows)


def test_bolts_of_stacked_layers_are_one_and_those_of_other_joints_are_not():
    stacked = zones_at(["low", "up"], [[0.1, 0, 0], [0.1, 0, 0.02]])
    assert stacked.by("bolt") == {"bolt 1": stacked.names}
    assert stacked.places == {}
    apart = zones_at(["left", "right"], [[0, 0, 0], [0.5, 0, 0]])
    assert apart.by("bolt") == {"bolt 1": apart.names[:2], "right bolt 1": apart.names[2:]}
    # A joint with one bolt is that bolt's place.
    assert apart.places == {"joint": {"left": apart.names[:2], "right": apart.names[2:]}}
    assert apart.away == ("left_b1_r2", "right_b1_r2")
    (grading,) = apart.gradings
    assert grading.groups == {
        "ring 1": ("left_b1_r1", "right_b1_r1"), "ring 2": ("left_b1_r2", "right_b1_r2")
    }  # fmt: skip


# -- damping, parts, tests -------------------------------------------------------------------------


class Springs:
    """f^2 of a series of the parts' spring and the joint's: shares of the energy by hand."""

    sensors = None
    model = SimpleNamespace(parameters=dict.fromkeys(["lap.E", "lap.G"]))

    def __call__(self, values):
        shares = self.shares(values)
        soft = np.array([0.0, np.log(2.0), np.log(4.0)]) + np.log(100.0)
        by = np.zeros((3, 2))
        by[:, 1] = 0.5 * shares / values["lap.G"]
        return soft, by

    @staticmethod
    def shares(values):
        return np.array([0.2, 0.1, 0.3])


@pytest.mark.parametrize("kind", ["hysteretic", "viscous"])
def test_damping_is_the_share_of_the_energy_at_the_frequency(kind):
    make = {"hysteretic": hysteretic_damping, "viscous": lambda z: viscous_damping(z, 200.0)}
    effect = make[kind]([Zone("lap")])
    hypothesis = Hypothesis((effect,), modes=MODES, damped=True)
    flat = np.zeros((1, 3))
    evidence = Evidence(np.ones(1), flat, flat + 0.01, 0.01, log_damping=flat)
    baseline = {"lap.E": 1e11, "lap.G": 4e10}
    z = np.zeros(len(hypothesis.priors))
    z[0] = 0.5
    predicted, _ = predict(hypothesis, Springs(), evidence, z, baseline)
    eta = 0.02 * 4**0.5
    by_hz = np.array([0.5, 1.0, 2.0]) if kind == "viscous" else np.ones(3)
    expected = 0.003 + 0.5 * eta * by_hz * np.array([0.2, 0.1, 0.3])
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
    assert sensing.gains.tolist() == [1.0, 1.3] and sensing.shifts.tolist() == [-2e-3, 0.0]
    assert misplaced_sensor(0, 0.3, 0.5).priors[0].spread == pytest.approx(6e-3)
    hypothesis = Hypothesis((swapped_modes(1, MODES),), modes=MODES)
    flat = np.zeros((1, 3))
    evidence = Evidence(np.ones(1), flat, flat + 0.01, 0.01)
    got, slopes = predict(
        hypothesis, Springs(), evidence, np.zeros(0), {"lap.E": 1.0, "lap.G": 1.0}
    )
    assert np.exp(got) == pytest.approx([100.0, 400.0, 200.0]) and slopes.shape == (3, 0)


def test_nuisances_hold_what_the_case_says():
    sprung = whole({"springs": RIG["springs"]})
    names = {effect.name for effect in case_nuisances(sprung, Zones(sprung))}
    assert {"width of lower, within tolerance", "stiffness of cord, within tolerance"} <= names
    assert "width of upper, within tolerance" not in names


# -- the reduced model's samples -------------------------------------------------------------------


def test_samples_hold_every_effect_within_its_prior(case, zones):
    found, _ = library(case, zones, measured(shapes=True))
    baseline = bonded_values(case)
    acting = [e for e in found if e.apply is not None]
    samples = sample_values(found, baseline, TORQUES, 2 * len(acting), seed=2)
    assert len(samples) == 2 * len(acting)
    assert samples == sample_values(found, baseline, TORQUES, 2 * len(acting), seed=2)
    for effect, values in zip(acting, samples, strict=False):
        changed = {key for key in values if values[key] != baseline[key]}
        assert changed <= touched(effect, baseline) or "radius" in theta_of(effect)
    # 1.5 standard deviations of 15 % for a wrong material; a temperature may come on top.
    off = np.log([values["upper.E"] / baseline["upper.E"] for values in samples])
    assert 0.05 < np.abs(off).max() < 0.25
    of_joints = sample_values(found, baseline, TORQUES, 30, seed=2, known=sample_ranges(case))
    touched_alone = [[k for k in v if v[k] != baseline[k]] for v in of_joints[:10]]
    assert all(key.split("_")[0] in ("near", "away") for keys in touched_alone for key in keys)
    ranges = sample_ranges(case)
    assert {"upper.width", "left_end.k_n", "left_end.k_t", "cord.stiffness", "nut.mass"} <= set(
        ranges
    )
    assert all(low < high and key in baseline for key, (low, high, _) in ranges.items())
    assert sample_values([], baseline, TORQUES, 8, seed=2) == []


def test_library_and_model_have_the_same_parameters(zones):
    """What effects change is there in the structure, and nothing is missing from the values."""
    clamp = {"left_end": {"facets": sorted(zones.tagged.facet_names)[0]}}
    case = zones.case.model_copy(update={"supports": whole({"supports": clamp}).supports})
    model = build_structure(
        case, MPI.COMM_SELF, law="uncoupled", attached=True, width=True,
        elastic_supports=True, tagged=zones.tagged,
    )  # fmt: skip
    assert set(model.parameters) == set(bonded_values(case))
    assert "left_end.k_n" in model.parameters


# -- one of the user's own -------------------------------------------------------------------------


def test_ten_lines_in_the_documentation_make_an_effect():
    text = inspect.getdoc(effects_module)
    lines = text.split("::\n", 1)[1].split("\nIt goes in", 1)[0].splitlines()
    code = inspect.cleandoc("\n".join(lines))
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    space = {}
    exec(code, space)
    effect = space["delaminated"]

    class Lid:
        sensors = None
        model = SimpleNamespace(parameters={"lid.E": None})

        def __call__(self, values):
            E = values["lid.E"]
            return np.full(2, 0.5 * np.log(E)), np.full((2, 1), 0.5 / E)

    flat = np.zeros((1, 2))
    evidence = Evidence(np.ones(1), flat, flat + 0.01, 0.01)
    hypothesis = Hypothesis((effect,), modes=("a", "b"))
    got, slopes = predict(hypothesis, Lid(), evidence, np.ones(1), {"lid.E": 7e10})
    lost = 0.1 * np.exp(0.7)
    assert got == pytest.approx(0.5 * np.log(7e10 * (1 - lost)))
    assert slopes == pytest.approx(np.full((2, 1), -0.5 * 0.7 * lost / (1 - lost)), rel=1e-6)
