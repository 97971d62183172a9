"""A diagnosis made by hand, with every field that a result can have."""

from __future__ import annotations

import io

import numpy as np
from rich.console import Console

from fenics_joints.commands.diagnose.document import diagnosis_document
from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult, Silent
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Separation
from fenics_joints.diagnosis.shrinkage import Fold, Shrinkage
from fenics_joints.diagnosis.where.patches import PatchMap
from fenics_joints.diagnosis.where.score_tests import Attribution, ScoreTest, ZoneShare
from fenics_joints.measurements import Gap
from fenics_joints.report.html import as_page
from fenics_joints.report.terminal import show

TORQUES, MODES = np.array([5.0, 20.0]), ("bending 1", "bending 2", "bending 3")
TEST = np.array([[400.0, 900.0, 2000.0], [410.0, 910.0, 2050.0]])


def zone(name: str, share: float, p: float, rest: float, **changes) -> ScoreTest:
    values = dict(
        zone=name,
        region="the_lap" if "lap" in name else name.split()[0],
        kind="joint" if "lap" in name else "part",
        odds=1.0,
        dof=2,
        statistic=200 * share,
        p=p / 3,
        p_adjusted=p,
        share=share,
        rest_p=rest,
        log_evidence=100 * share,
        change=(-2.1, 0.1),
        change_sd=(0.2, 0.3),
        log_f=-0.05,
    )
    return ScoreTest(**{**values, **changes})


def location(**changes) -> Location:
    """A joint that explains nearly all, plates that explain some; frequencies and shapes."""
    corner = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    vertices = np.stack([corner + [i, 0, 0] for i in range(4)]) * [0.05, 0.05, 0.01]
    values = dict(
        regions=(
            zone("plates", 0.31, 0.2, 1e-9),
            zone("the_lap", 0.94, 1e-12, 0.4),
            zone("ropes", 0, 1, 0, dof=0),
        ),
        zones=(zone("the_lap_b1_r2", 0.6, 1e-7, 0.01), zone("the_lap_b2_r1", 0.9, 1e-11, 0.3)),
        shares=(ZoneShare("the_lap", 0.94), ZoneShare("unexplained", 0.06)),
        attribution=(
            Attribution("mode", "bending 1", 4.0, 4, 0.41),
            Attribution("mode", "bending 2", 150.0, 4, 1e-30),
            Attribution("mode", "bending 3", 46.0, 4, 2e-9),
            Attribution("condition", "5", 130.0, 6, 1e-20),
            Attribution("condition", "20", 70.0, 6, 1e-9),
            Attribution("kind", "frequencies", 194.0, 6, 1e-30),
            Attribution("kind", "shapes", 6.0, 6, 0.42),
        ),
        patches=PatchMap(
            (zone("plates 1", 0.2, 0.5, 1e-9), zone("the_lap 1", 0.9, 1e-9, 0.3)),
            np.array([[0.05, 0.02, 0.0], [0.15, 0.025, 0.01]]),
            np.ones(2),
            np.zeros((0, 3)),
            vertices=vertices,
            patch=np.array([0, 0, 1, 1]),
        ),
        misfit=200.0,
        n_data=12,
    )
    return Location(**{**values, **changes})


def fold(name: str, **changes) -> Fold:
    values = dict(
        name=name,
        n=2,
        chosen="joint normal compliance",
        placebo_chosen="modulus error",
        before=0.2,
        after=0.02,
        placebo=0.12,
        noise=0.005,
        shrink=0.92,
        shrink_interval=(0.85, 0.97),
        placebo_shrink=0.41,
        predicted_after=(0.01, 0.03),
        predicted_shrink=(0.8, 1.0),
        covered=True,
        shrink_covered=True,
        entries_covered=1.0,
        weights={},
    )
    return Fold(**{**values, **changes})


def shrinkage(**changes) -> Shrinkage:
    folds = [
        fold("mode bending 1"),
        fold("mode bending 2", after=0.05, shrink=0.77, covered=False, entries_covered=0.5),
        fold("torque 5 N·m"),
    ]
    values = dict(
        before=0.2,
        after=0.033,
        placebo=0.12,
        noise=0.005,
        shrink=0.856,
        shrink_interval=(0.79, 0.93),
        placebo_shrink=0.41,
        placebo_interval=(0.3, 0.5),
        excess=0.446,
        excess_interval=(0.31, 0.58),
        claimed=True,
        coverage=2 / 3,
        shrink_coverage=1.0,
        entries_coverage=5 / 6,
        folds=folds,
    )
    return Shrinkage(**{**values, **changes})


def parameter(effect, name, value, low, high, unit="", nuisance=False, z=0.3) -> dict:
    return {
        "effect": effect,
        "name": name,
        "value": value,
        "low": low,
        "high": high,
        "unit": unit,
        "nuisance": nuisance,
        "prior_sigmas": z,
    }


def diagnosis(**changes) -> Diagnosis:
    """The joint is compliant, normal or tangential, which is one class; the modulus is right."""
    normal, along = "joint normal compliance (joint)", "joint tangential compliance (joint)"
    family = "joint normal compliance or joint tangential compliance"
    hypotheses = [
        HypothesisResult(
            "joint normal compliance",
            (normal,),
            0.66,
            42.0,
            0.011,
            0.4,
            [
                parameter(normal, "k_n", 6.6e11, 5.1e11, 8.6e11, "Pa/m"),
                parameter("rho of plates (plates)", "factor", 1.02, 1.01, 1.03, "", True, 2.4),
            ],
        ),
        HypothesisResult("joint tangential compliance", (along,), 0.30, 41.2, 0.012, 0.3),
        HypothesisResult("modulus error", ("modulus error (plate_1)",), 0.033, 39.0, 0.031, 0.02),
        HypothesisResult("no gap", (), 0.001, 35.5, 0.2, 1e-9),
        HypothesisResult("none of these", (), 0.006, 37.3, 0.004, 0.9),
    ]
    values = dict(
        title="Plates",
        verdict="cause",
        summary="",
        condition=("torque", "N·m"),
        before=Gap(TORQUES, MODES, TEST, 1.2 * TEST),
        after=Gap(TORQUES, MODES, TEST, 1.011 * TEST),
        noise=0.005,
        heldout_before=0.2,
        heldout_after=0.033,
        placebo_after=0.12,
        placebo="modulus error",
        validation=None,
        where=[
            ZoneShare("the_lap", 0.88),
            ZoneShare("plates", 0.07),
            ZoneShare("unexplained", 0.05),
        ],
        effects=[
            EffectResult("joint normal compliance", "joint", 0.66, family, True),
            EffectResult("joint tangential compliance", "joint", 0.30, family, True),
            EffectResult("modulus error", "plate_1", 0.033, "modulus error (plate_1)", True),
            EffectResult("temperature", "all parts", 0.0, "temperature", False),
            EffectResult("none of these", "", 0.006, "none of these", True),
            EffectResult("no gap", "", 0.001, "no gap", True),
        ],
        hypotheses=hypotheses,
        separations=[Separation(family, ("a", "b"), "an axial mode", 3.4)],
        model_error=1e-5,
        model={"dofs": 12345},
        silent=(Silent("micro-slip in the joint", "the test is by torque"),),
        location=location(),
        shrinkage=shrinkage(),
    )
    return Diagnosis(**{**values, **changes})


def page_of(d: Diagnosis, **more) -> str:
    """The diagnosis as an HTML page."""
    return as_page(diagnosis_document(d, **more))


def shown(d: Diagnosis, width: int = 100) -> str:
    """The diagnosis as printed on a terminal."""
    console = Console(width=width, record=True, file=io.StringIO())
    show(console, diagnosis_document(d))
    return console.export_text()
