"""A diagnosis of a structure and a test from a script: the same as that of a case file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from virtual_plates import (
    NOISE,
    NU,
    RHO,
    TORQUES,
    E,
    along,
    assert_same_evidence,
    virtual_test,
    write_virtual_case,
)

from fenics_joints.case import build_structure, load_case
from fenics_joints.diagnosis import Effect, Prior, diagnose
from fenics_joints.diagnosis.model.of_structure import case_of
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.structure import (
    ElasticSupport,
    Parameter,
    PointMass,
    Spring,
    Structure,
    Support,
    interface,
    joint,
    part,
    transition,
)

CELLS = ("plate_1", "plate_2")
NAMES = ["accelerometer mass", "joint tangential compliance", "modulus error"]
OPTIONS = {"n_modes": 18, "samples": 8, "max_effects": 1, "patches": 0, "mesh_error": False}


def plates(comm, *, regions=None, **more) -> Structure:
    """The nominal model of `virtual_plates`, some numbers of which are parameters."""
    if regions is None:
        regions = [
            part("plates", CELLS, E="modulus", nu=NU, rho=RHO, stretch="t"),
            joint("near", "joint_near", E=1e9, G=0.4e9),
            joint("away", "joint_away", E="k", G=4e8),
        ]
    parameters = [Parameter("modulus", E), Parameter("t", 1.0), Parameter("k", 1e9)]
    tagged = lap_plates(comm, element_size=0.02, n_thickness=1)
    tagged = replace(tagged, points={}) if more.pop("unbolted", False) else tagged
    return Structure(tagged, regions, [*parameters, *more.pop("parameters", [])], **more)


def measured(**truth) -> TestData:
    found = virtual_test(**truth).noisy()
    names = [f"bending {i + 1}" for i in range(4)]
    return TestData(
        TORQUES, found.frequencies_hz, names, "torque", "N·m", noise=NOISE, sensors=along(0.5e-3)
    )


@pytest.mark.parallel
def test_script_and_case_file_give_the_same_diagnosis(shared_tmp_path):
    """On one rank or two, of a joint on another mesh, of another thickness: and it is named."""
    comm = MPI.COMM_WORLD
    test = comm.bcast(measured(k_t=3e11))
    if comm.rank == 0:
        lines = ("max_effects = 1", "patches = 0", "mesh_error = false", f"effects = {NAMES}")
        write_virtual_case(shared_tmp_path, virtual_test(k_t=3e11).noisy(), *lines)
    comm.barrier()
    case = load_case(shared_tmp_path)
    attached = {name: own.model_dump(exclude_unset=True) for name, own in case.attached.items()}
    file = diagnose(case, MPI.COMM_SELF)
    script = diagnose(
        plates(comm), test, effects=NAMES, bolted=["near"], attached=attached, **OPTIONS
    )
    assert script.verdict == file.verdict == "cause"
    assert script.effects[0].name == "joint tangential compliance"
    assert_same_evidence(script, file)
    assert len(script.hypotheses) == 5
    assert script.after.model_hz == pytest.approx(file.after.model_hz, rel=1e-4)
    assert script.model["dofs"] == file.model["dofs"]


def film(values, theta, torque):
    """A film over the lap, as stiff as the bolts press it."""
    for name in ("near.G", "away.G"):
        series = theta["k"] * 0.5e-3 * np.sqrt(torque / TORQUES[-1])
        values[name] = 1 / (1 / values[name] + 1 / series)


def test_effects_are_all_that_is_weighed():
    """An effect of one's own alone, and its parameter as it was put in; in a table."""
    k = Prior("k", 1e12, 3.0, "Pa/m")
    own = Effect("film", "lap", (k,), film, depends_on_condition=True)
    nominal = plates(MPI.COMM_SELF, unbolted=True)
    found = diagnose(nominal, measured(k_t=3e11), effects=[own], **OPTIONS)
    assert any("no bolts of near, away are known" in note for note in found.model["notes"])
    assert {e.name for e in found.effects} == {"film", "none of these", "no gap"}
    assert found.verdict == "cause" and found.effects[0].name == "film"
    pytest.importorskip("pandas")
    effects, fitted = found.to_dataframe(), found.to_dataframe("parameters")
    assert list(effects["name"]) == [e.name for e in found.effects]
    fitted = fitted[(fitted["hypothesis"] == "film") & (fitted["name"] == "k")]
    (row,) = fitted.to_dict("records")
    sd = 0.5 * np.log(row["high"] / row["low"])
    assert abs(np.log(row["value"] / 3e11)) < 2 * sd < 1.0 and row["unit"] == "Pa/m"
    assert effects.to_dict("records")[0] == {
        "name": "film",
        "region": "lap",
        "probability": found.effects[0].probability,
        "class": "film",
        "detectable": True,
        "odds": 1.0,
    }
    with pytest.raises(InputError, match="effects, parameters"):
        found.to_dataframe("causes")


def all_kinds(comm) -> Structure:
    """Something of everything that a structure may be made of, but for what is refused."""
    axis, top = (0.0, 0.6, 0.8), 16.5e-3
    return plates(
        comm,
        unbolted=True,
        regions=[
            part("plates", CELLS, E=E, nu=NU, rho=RHO),
            joint("near", "joint_near", E=8.6e8, G="G", law="isotropic", rho=1e3),
            interface("away", "joint_away", k_n=2e12, k_t=1e12, meshed=0.5e-3),
        ],
        parameters=[
            Parameter("G", 3.4e8),
            Parameter("bolts.mass", 0.2),
            Parameter("at", 0.0, "m", -0.01, 0.1, log=False),
        ],
        masses=[
            PointMass("b1", "bolts.mass", (0.14, 0.02, 0.0), share=0.25),
            PointMass("b2", "bolts.mass", (0.18, 0.06, 0.0), share=0.5),
            PointMass("b3", "bolts.mass", (0.14, 0.06, 0.0), share=0.25),
            PointMass("moving", 0.05, (0.02, 0.04, 0.0), (1.0, 0.0, 0.0), "at"),
            PointMass("moved", 0.04, (0.3, 0.04, top), (-1.0, 0.0, 0.0), 0.05),
        ],
        springs=[Spring("a", 2e5, (0.02, 0.0, 4e-3), axis), Spring("b", 1e6, (0.2, 0.0, 4e-3))],
        supports=[
            ElasticSupport("clamp", "end_1", 1e12, 5e11),
            Support(points=[(0.32, 0.0, top)], directions=(2,)),
        ],
    )


def test_a_structure_comes_back_as_it_was():
    """Through the sections of a case; its modes are those of the user's own model."""
    own = all_kinds(MPI.COMM_SELF)
    known = {"plates.E": 0.02, "bolts.mass": 0.1, "b.stiffness": 0.3}
    case = case_of(own, measured(k_t=3e11), tolerances=known)
    again = build_structure(case, MPI.COMM_SELF, elastic_supports=True)
    theirs = [solve_modes(s, n_modes=8).frequencies_hz for s in (own, again)]
    assert theirs[1] == pytest.approx(theirs[0], rel=1e-9)
    assert again.total_mass() == pytest.approx(own.total_mass(), rel=1e-12)
    assert case.tolerances() == known
    assert case.masses["moving"].travel == pytest.approx((0.01, 0.12))
    (note,) = case.joint_notes()
    assert "near, away" in note and "bolts" in note


def test_what_is_not_usable_is_refused():
    comm, test = MPI.COMM_SELF, measured(k_t=3e11)
    good = plates(comm)
    solid = part("plates", CELLS, E=E, nu=NU, rho=RHO)

    def of(*regions, **more):
        return plates(comm, regions=[solid, *regions], **more)

    near = joint("near", "joint_near", E=1e9, G=4e8)
    ring = transition("ring", "joint_away", E=1e9, nu=0.3, h=1e-3, meshed=0.5e-3)
    graded = joint("away", "joint_away", E=lambda x, p: 1e9 * (1 + x[0]), G=4e8)
    thick = joint("away", "joint_away", E=1e9, G=4e8, stretch=2.0)
    spaced = joint("far off", "joint_away", E=1e9, G=4e8)
    wrong = Effect("own", "", (Prior("k", 1.0, 0.1),), lambda v, t, c: v.update(x=v["far.E"]))
    for what, match in [
        (lambda: diagnose("plates", test), "structure = 'plates': expected a Structure"),
        (lambda: diagnose(good, comm), "expected a TestData"),
        (lambda: diagnose(good, test, max_effect=1), "max_effect: .*did you mean 'max_effects'"),
        (lambda: diagnose(good, test, samples=1), "structure: diagnose.samples = 1"),
        (lambda: diagnose(good, test, effects=[]), "expected one at least"),
        (lambda: diagnose(good, test, effects="film"), "sequence of"),
        (lambda: diagnose(good, test, effects=["film"]), "'film' does not exist"),
        (lambda: diagnose(good, test, effects=[wrong]), "'far.E' .*plates.E.*away.E"),
        (lambda: diagnose(good, test, bolts={"lap": [[0, 0, 0]]}), "'lap' is no joint"),
        (lambda: diagnose(good, test, bolts={"near": [[0, 0, 0]]}), r"near.bolts\[0\].*outside"),
        (lambda: diagnose(good, test, tolerances={"plate.E": 0.1}), "did you mean 'plates.E'"),
        (lambda: diagnose(of(near, ring), test), "ring is of transition material"),
        (lambda: diagnose(of(near, graded), test), "away.E is a function of position"),
        (lambda: diagnose(of(near, thick), test), "away.thickness = 2"),
        (lambda: diagnose(of(near, spaced), test), "'far off' is not usable"),
        (
            lambda: diagnose(good, test.again("heavier", np.full(4, 100.0), {"m": 1.0})),
            "test.known: 'm'",
        ),
    ]:
        with pytest.raises(InputError, match=match):
            what()
