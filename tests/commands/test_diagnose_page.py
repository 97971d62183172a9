"""The page and the summary of a diagnosis: they show what the result holds, and stand alone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from html_page import Page, check_page
from rich.console import Console

from fenics_joints import formatting
from fenics_joints.commands.diagnose.document import diagnosis_document
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.words import VERDICTS
from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.diagnosis.result import Separation
from fenics_joints.diagnosis.shrinkage import Fold, Shrinkage
from fenics_joints.diagnosis.where.score_tests import ZoneShare
from fenics_joints.measurements import Gap
from fenics_joints.report.html import as_page
from fenics_joints.report.terminal import show

MODES = ("bending 1", "bending <2>")
TORQUES = np.array([2.0, 10.0, 22.0])
TEST = np.array([[375.04, 962.47], [412.56, np.nan], [424.80, 1012.51]])


def diagnosis_html(d: Diagnosis, **more) -> str:
    """The diagnosis as a page."""
    return as_page(diagnosis_document(d, **more))


def gap(factor: float) -> Gap:
    return Gap(TORQUES, MODES, TEST, factor * np.nan_to_num(TEST, nan=990.0))


def fitted(name, value, low, high, unit, nuisance=False, z=0.4) -> dict:
    return {
        "effect": "joint",
        "name": name,
        "value": value,
        "low": low,
        "high": high,
        "unit": unit,
        "nuisance": nuisance,
        "prior_sigmas": z,
    }


def shrinkage() -> Shrinkage:
    fold = Fold(
        "torque 2",
        2,
        "normal compliance",
        "modulus",
        0.31,
        0.019,
        0.104,
        0.008,
        0.96,
        (0.9, 0.99),
        0.68,
        (0.012, 0.031),
        (0.93, 0.99),
        True,
        True,
        1.0,
        {},
    )
    return Shrinkage(before=0.1981, after=0.0142, placebo=0.0731, noise=0.0083, folds=[fold])


def diagnosis(**changes) -> Diagnosis:
    compliance = [
        fitted("k_n", 6.6e11, 5.1e11, 8.6e11, "Pa/m"),
        fitted("mass", 0.0203, 0.0185, 0.0222, "kg", nuisance=True, z=-2.6),
    ]
    first = EffectResult("normal compliance", "joint", 0.61, "compliance", True)
    second = EffectResult("tangential compliance", "joint", 0.35, "compliance", True)
    values = dict(
        title="Plates <b>& bolts</b>",
        verdict="cause",
        summary="The joint gives way.",
        condition=("torque", "N·m"),
        before=gap(1.2),
        after=gap(1.01),
        noise=0.0083,
        heldout_before=0.1981,
        heldout_after=0.0142,
        placebo_after=0.0731,
        placebo="modulus",
        shrinkage=shrinkage(),
        validation=(gap(1.19), gap(0.98)),
        where=[
            ZoneShare("joint", 0.943),
            ZoneShare("plates", 0.032),
            ZoneShare("unexplained", 0.025),
        ],
        effects=[first, second, EffectResult("none of these", "", 1e-5, "none of these", True)],
        hypotheses=[
            HypothesisResult(
                "normal compliance",
                ("normal compliance (joint)",),
                0.6,
                41.25,
                0.0101,
                0.41,
                compliance,
            ),
            HypothesisResult(
                "tangential compliance",
                ("tangential compliance (joint)",),
                0.34,
                40.68,
                0.0123,
                0.2,
                [],
                ("k_t",),
            ),
            HypothesisResult(
                "normal compliance + tangential compliance",
                ("normal compliance (joint)", "tangential compliance (joint)"),
                0.01,
                37.05,
                0.01,
                0.4,
            ),
            HypothesisResult("none of these", (), 1e-5, 30.0, 0.004, 0.9),
        ],
        separations=[Separation("compliance", ("normal", "tangential"), "an axial mode", 2.3263)],
        model_error=3.1e-5,
        model={"dofs": 21345, "seconds": 41.3},
    )
    return Diagnosis(**{**values, **changes})


def test_page_is_well_formed_and_stands_alone():
    check_page(diagnosis_html(diagnosis(), log_sd=np.full((3, 2), 0.01)))


def test_page_keeps_the_rules(browser, tmp_path):
    browser.check(diagnosis_html(diagnosis(), log_sd=np.full((3, 2), 0.01)), tmp_path)


def test_diagnosis_page_shows_the_numbers_of_the_result():
    d = diagnosis()
    page = Page(diagnosis_html(d))
    keys = ("gap-before", "gap-after", "gap-heldout", "gap-placebo", "gap-noise")
    shown = [float(page.texts[key].split()[0]) / 100 for key in keys]
    expected = [d.before.rms, d.after.rms, d.heldout_after, d.placebo_after, d.noise]
    np.testing.assert_allclose(shown, expected, atol=5.1e-5)

    assert page.column("shares", 0) == ["joint", "plates", "unexplained"]
    assert page.column("shares", 1) == ["94.3 %", "3.2 %", "2.5 %"]
    # 0.6 + 0.34 + 0.01 for the class: one hypothesis holds both of its effects.
    assert page.column("effects", 3) == ["95 %", "61 %", "35 %", "< 1 %"]
    assert page.column("hypotheses", 1) == ["60 %", "34 %", "1 %", "< 1 %"]
    assert page.column("hypotheses", 3) == ["0.0", "0.6", "4.2", "11.2"]
    assert page.column("hypotheses", 6) == ["–", "k_t", "–", "–"]
    assert page.tables["fitted"][1:] == [["joint", "k_n", "660 GPa/m", "510 to 860 GPa/m", "+0.40"]]
    assert page.column("nuisances", 2) == ["20.3 g"]
    assert page.column("separations", 4) == ["1 %"]
    assert page.column("folds", 2)[:2] == ["31.00 %", "19.81 %"]
    assert page.column("folds", 4)[0] == "1.20 % to 3.10 %"

    frequencies = page.tables["frequencies"]
    measured = [row[2] for row in frequencies if len(row) == 7 and "Hz" not in row[2]]
    both = [formatting.MISSING if np.isnan(f) else f"{f:.2f}" for f in TEST.ravel()]
    assert measured == both + both  # validation, then all
    heat = [row for row in page.tables["heat"] if row[0] == "10 N·m"]
    assert [row[1] for row in heat] == ["+20.0 %", "+1.0 %"]
    assert [row[2] for row in heat] == [formatting.MISSING] * 2


def test_rows_after_a_known_change_have_its_name_and_points_of_their_own():
    text = diagnosis_html(diagnosis(row_names=("", "", "weight"), validation=None))
    page = Page(text)
    heads = [row[0] for row in page.tables["heat"] if row[0].endswith(("N·m", "weight"))]
    last = page.tables["heat"][3][0]
    assert last.endswith(" N·m, weight") and heads.count(last) == 2 and len(heads) == 6
    rows = {row[0] for row in page.tables["frequencies"][1:]}
    assert last in rows and len(rows) == 3
    assert "measured after the change" in text
    assert "measured after the change" not in diagnosis_html(diagnosis())


def test_titles_and_names_are_escaped():
    text = diagnosis_html(diagnosis())
    assert "Plates &lt;b&gt;&amp; bolts&lt;/b&gt;" in text
    assert "<b>& bolts" not in text and "bending <2>" not in text


@pytest.mark.parametrize("verdict", list(VERDICTS))
def test_every_verdict_without_validation_and_map(verdict):
    d = diagnosis(verdict=verdict, validation=None, shrinkage=None, separations=[])
    page = Page(diagnosis_html(d))
    said = [f"{name}. {sentence}" for name, sentence in explain(d).sentences]
    assert page.texts["verdict"].split() == " ".join([VERDICTS[verdict], *said]).split()
    assert "validation" not in page.ids and "folds" not in page.tables
    console = Console(width=80, record=True, file=io.StringIO())
    show(console, diagnosis_document(d))
    assert VERDICTS[verdict] in " ".join(console.export_text().split())


def large_diagnosis() -> Diagnosis:
    """More of everything than a screen holds, with long names."""
    effects = [
        EffectResult(
            f"an effect with quite a long name, number {i} [b]",
            "joint",
            0.1,
            f"class {i // 2}",
            True,
        )
        for i in range(14)
    ]
    splits = [
        Separation(f"class {i}", ("a", "b"), "a measurement that takes " + 8 * "many words ", 1.5)
        for i in range(5)
    ]
    parameters = [fitted(f"away.k_{i}", 6.6e11, 5.1e9, 8.6e12, "Pa/m") for i in range(9)]
    lead = HypothesisResult("lead", ("x",), 0.9, 1.0, 0.01, 0.4, parameters, ("away.k_0",) * 9)
    where = [ZoneShare(f"region_{i}", 0.1) for i in range(10)]
    return diagnosis(
        summary="A long verdict. " * 18,
        effects=effects,
        separations=splits,
        hypotheses=[lead],
        where=where,
    )


def test_tables_are_short_and_no_line_is_too_wide():
    """However much there is: rows are counted, sentences are not."""
    for d in (diagnosis(), large_diagnosis()):
        for width in (80, 100):
            console = Console(width=width, record=True, file=io.StringIO())
            show(console, diagnosis_document(d))
            lines = console.export_text().splitlines()
            first = next(i for i, line in enumerate(lines) if line.startswith("gap (RMS"))
            assert len(lines) - first <= 40 and max(map(len, lines)) <= width


def test_the_leader_is_the_best_hypothesis_that_says_something():
    """``Diagnosis.after`` is its gap, also when "none of these" is more probable."""
    named = diagnosis().hypotheses[0]
    unknown = HypothesisResult("none of these", (), 0.9, 50.0, 0.004, 0.9)
    d = diagnosis(verdict="unknown", hypotheses=[unknown, named])
    page = Page(diagnosis_html(d))
    assert page.column("nuisances", 2) == ["20.3 g"]
    console = Console(width=80, record=True, file=io.StringIO())
    show(console, diagnosis_document(d))
    assert "660 GPa/m" in console.export_text()
