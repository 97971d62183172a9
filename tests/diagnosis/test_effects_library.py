"""The library of effects: what each changes, where, and what a test cannot speak of."""

from __future__ import annotations

import numpy as np
import pytest
from effect_rig import LAYER, RIG, TORQUES, theta_of, touched, whole
from mpi4py import MPI

from fenics_joints.case import Case, build_mesh, build_structure
from fenics_joints.case.dimensions import Dimensions
from fenics_joints.diagnosis.effects.effect import Setting, Silent, relative_error
from fenics_joints.diagnosis.effects.library import LIBRARY, case_effects, case_nuisances
from fenics_joints.diagnosis.effects.samples import sample_ranges, sample_values
from fenics_joints.diagnosis.zones.joints import joint_zones
from fenics_joints.diagnosis.zones.zone import Zones, bonded_values
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.structure import Sensors

MODES = ("a", "b", "c")


def measured(conditions=TORQUES, name="torque", unit="N·m", shapes=False, damping=False):
    shape = (len(conditions), len(MODES))
    hz = np.broadcast_to([100.0, 200.0, 400.0], shape)
    sensors = Sensors(np.array([[x, 0.04, 0.0] for x in (0.0, 0.1, 0.3)]), [0, 0, 1])
    there = np.array([[1.0, 1.0, 1.0], [0.5, -1.0, 0.2], [-1.0, 1.0, 0.1]])
    return TestData(
        conditions,
        hz,
        MODES,
        name,
        unit,
        sensors=sensors,
        noise=0.01,
        shapes=there if shapes else None,
        damping=np.full(shape, 2e-3) if damping else None,
        damping_noise=0.1 if damping else None,
    )


@pytest.fixture(scope="module")
def zones():
    case = Case.model_validate({key: RIG[key] for key in ("mesh", "parts", "joints")})
    return joint_zones(case, build_mesh(case, MPI.COMM_SELF))


@pytest.fixture(scope="module")
def case(zones):
    more = {key: RIG[key] for key in ("masses", "springs", "attached", "supports")}
    return zones.case.model_copy(update={k: getattr(whole(more), k) for k in more})


def library(case, zones, data, **diagnose):
    case = case.model_copy(update={"diagnose": case.diagnose.model_copy(update=diagnose)})
    zones = zones.with_thickness(dict.fromkeys(case.joints, LAYER))
    return case_effects(Setting(case, data, zones))


def test_each_effect_changes_what_it_should_and_no_more(case, zones):
    data = measured(shapes=True, damping=True)
    found, silent = library(case, zones, data, joints="given", rare=True)
    assert {s.effect for s in silent} == {
        "micro-slip in the joint",
        "gapping without slip",
        "damping that grows without softening",
        "stiffening with the level",
        "local loss of stiffness",
        "local gain of stiffness",
        "added mass",
        "cable or stinger",
        "attached resonator",
        "plate not flat",
        "thickness not even",
    }
    baseline = bonded_values(case)
    E, G = ({f"{zone}.{key}" for zone in case.joints} for key in "EG")
    bolt, third = ({k for k in E | G if f"_b{i}_" in k} for i in (2, 3))
    bare = {k for k in E | G if "_b" not in k}
    away = {k for k in E | G if k.startswith("away")}
    expected = {
        "joint normal compliance (joint)": E,
        "joint tangential compliance (joint)": G,
        "joint normal and tangential compliance (joint)": E | G,
        "compliance away from the bolts only (away)": away,
        "joint compliance graded from zone to zone (joint)": E | G,
        "joint compliance that falls with the pressure (joint)": E | G,
        "joint tangential compliance that falls with the pressure (joint)": G,
        "compliance at one bolt (bolt 2)": bolt,
        "loose bolt (bolt 2)": bolt,
        "two loose bolts (bolt 2, bolt 3)": bolt | third,
        "three loose bolts (bolt 1, bolt 2, bolt 4)": (E | G) - third - bare,
        "joint stiffer than given (joint)": E | G,
        "joint stiffer than given at one place (away from the bolts)": away,
        "preload lower than nominal (joint)": E | G,
        "preload of one bolt lower than nominal (bolt 2)": bolt,
        "joint hysteretic damping (joint)": set(),
        "joint viscous damping (joint)": set(),
        "modulus error (upper)": {"upper.E"},
        "shear modulus error (upper)": {"upper.nu"},
        "shear modulus error of all parts (all parts)": {"upper.nu", "lower.nu"},
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
        "damping of the supports (left_end)": {"left_end.k_n", "left_end.k_t"},
        "damping of the supports (cord)": set(),
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
    lost.apply(
        values,
        {"radius": 0.75 * np.nanmax([zone.distance for zone in zones]), "cutoff": 1e-4},
        10.0,
    )
    gone = {key for key in values if values[key] != baseline[key]}
    assert gone and gone < E | G
    less = by_key["contact area smaller than modelled (joint)"]
    least = dict(baseline)
    less.apply(least, {"radius": 0.75 * np.nanmax([zone.distance for zone in zones])}, 10.0)
    assert least == pytest.approx(values, rel=0.01)
    # Nothing in the library but what was looked at here, or its like at another place.
    seen = map(by_key.get, [*expected, lost.key, less.key])
    assert {e.name for e in found} == {e.name for e in seen} | {
        "density error of all parts",
        "thickness error of all parts",
    }
    for effect in found:
        idle = touched(effect, baseline) == set() and effect not in (lost, less)
        assert (effect.apply is None) == idle


def test_weights_of_places_sum_to_one(case, zones):
    found, _ = library(case, zones, measured(shapes=True), joints="given")
    total = {}
    for effect in found:
        total[effect.name] = total.get(effect.name, 0.0) + effect.weight
    # A description of a joint is less of a cause than a physical law.
    assert total.pop("joint compliance graded from zone to zone") == pytest.approx(0.25)
    # What no data tell apart from the same stiffness everywhere has the plainer name.
    sliding = "joint tangential compliance that falls with the pressure"
    assert total.pop(sliding) == pytest.approx(0.5)
    # And of several bolts fewer come loose together than alone.
    assert total.pop("two loose bolts") == pytest.approx(0.5)
    assert total.pop("three loose bolts") == pytest.approx(0.25)
    assert total == pytest.approx(dict.fromkeys(total, 1.0))
    places = {e.region for e in found if e.name == "loose bolt"}
    assert places == {"bolt 1", "bolt 2", "bolt 3", "bolt 4"}
    assert {e.region for e in found if e.name == "mode mis-pairing"} == {"a, b", "b, c"}


def test_what_a_test_cannot_speak_of_is_said(case, zones):
    found, silent = library(case, zones, measured())
    reasons = {s.effect: s.reason for s in silent}
    assert set(reasons) >= {
        "preload lower than nominal",
        "joint hysteretic damping",
        "joint viscous damping",
        "sensor mis-scaled",
        "sensor misplaced",
    }
    assert not set(reasons) & {effect.name for effect in found}
    assert 'joints = "given"' in reasons["preload lower than nominal"]
    assert "no mode shapes" in reasons["sensor misplaced"]
    one, _ = library(case, zones, measured(), effects=["loose bolt", "sensor misplaced"])
    assert {e.name for e in one} == {"loose bolt"}
    with pytest.raises(InputError, match=r"diagnose.effects: 'rust' does not exist"):
        library(case, zones, measured(), effects=["rust"])


def test_an_entry_more_is_an_effect_more(case, zones, monkeypatch):
    """Asked for by its name, or where all are looked for, in its place; silent where it says so."""

    def rusts(setting):
        for part in setting.case.parts:
            yield relative_error("rust", part, [f"{part}.rho"], 0.1, "It rusts.")
        if len(setting.data) < 2:
            yield Silent("rust", "it takes two torques")

    before, _ = library(case, zones, measured())
    monkeypatch.setattr("fenics_joints.diagnosis.effects.library.LIBRARY", [rusts, *LIBRARY])
    found, _ = library(case, zones, measured())
    assert [e.key for e in found[:2]] == ["rust (upper)", "rust (lower)"]
    assert [e.key for e in found[2:]] == [e.key for e in before]
    found, silent = library(case, zones, measured(TORQUES[:1]), effects=["rust"])
    assert {e.name for e in found} == {"rust"} and [s.effect for s in silent] == ["rust"]


def test_what_a_mesh_cannot_have_is_no_cause(case, zones):
    """One of two plates with a joint between them may be thicker, and wider only with the other."""
    more = {"law": "uncoupled", "width": True, "tagged": zones.tagged}
    dimensions = Dimensions(zones.case, build_structure(zones.case, MPI.COMM_SELF, **more))
    zones = zones.with_thickness(dict.fromkeys(case.joints, LAYER))
    found, silent = case_effects(Setting(case, measured(), zones, dimensions))
    regions = {(e.name, e.region) for e in found}
    assert {("thickness error", "lower"), ("width error of all parts", "all parts")} <= regions
    assert not {("width error", "lower"), ("width error", "upper")} & regions
    (reason,) = (s.reason for s in silent if s.effect == "width error")
    assert "of upper, lower: joined" in reason
    names = {effect.name for effect in case_nuisances(case, zones, dimensions)}
    assert "width of lower, within tolerance" not in names
    assert "thickness of lower, within tolerance" in names


def test_nuisances_hold_what_the_case_says():
    sprung = whole({"springs": RIG["springs"]})
    names = {effect.name for effect in case_nuisances(sprung, Zones(sprung))}
    assert {"width of lower, within tolerance", "stiffness of cord, within tolerance"} <= names
    assert "width of upper, within tolerance" not in names


def test_samples_hold_every_effect_within_its_prior(case, zones):
    found, _ = library(case, zones, measured(shapes=True))
    baseline = bonded_values(case)
    acting = [e for e in found if e.apply is not None and not e.holds]
    samples = sample_values(found, baseline, TORQUES, 2 * len(acting), seed=2)
    assert len(samples) == 2 * len(acting)
    assert samples == sample_values(found, baseline, TORQUES, 2 * len(acting), seed=2)
    # First one place of each kind.
    places = {e.key: [o.key for o in acting if o.name == e.name].index(e.key) for e in acting}
    acting = sorted(acting, key=lambda e: places[e.key])
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


def test_few_samples_hold_every_place_of_a_joint(case, zones):
    """A basis that never saw a bolt loose would have it stiff at any stiffness."""
    found, _ = library(case, zones, measured())
    baseline = bonded_values(case)
    samples = sample_values(found, baseline, TORQUES, 4, seed=2, known=sample_ranges(case))
    changed = [{key for key in v if v[key] != baseline[key]} for v in samples]
    loose = [e for e in found if e.name in ("loose bolt", "compliance at one bolt")]
    assert len(loose) > 4 and all(touched(e, baseline) in changed for e in loose)


def test_library_and_model_have_the_same_parameters(zones):
    """What effects change is there in the structure, and nothing is missing from the values."""
    clamp = {"left_end": {"facets": sorted(zones.tagged.facet_names)[0]}}
    case = zones.case.model_copy(update={"supports": whole({"supports": clamp}).supports})
    model = build_structure(
        case,
        MPI.COMM_SELF,
        law="uncoupled",
        attached=True,
        width=True,
        elastic_supports=True,
        tagged=zones.tagged,
    )
    assert set(model.parameters) == set(bonded_values(case))
    assert "left_end.k_n" in model.parameters
