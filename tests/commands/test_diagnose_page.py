"""The page and the terminal of a diagnosis show what the result holds, and stand alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import diagnosis, page_of, parameter, shown, shrinkage
from html_page import Page, check_page

from fenics_joints import formatting
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.words import VERDICTS
from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.diagnosis.result import Separation
from fenics_joints.diagnosis.where.score_tests import ZoneShare
from fenics_joints.measurements import Gap

MODES = ("bending 1", "bending <2>")
TORQUES = np.array([2.0, 10.0, 22.0])
TEST = np.array([[375.04, 962.47], [412.56, np.nan], [424.80, 1012.51]])


def gap(factor: float) -> Gap:
    return Gap(TORQUES, MODES, TEST, factor * np.nan_to_num(TEST, nan=990.0))


def marked(**changes) -> Diagnosis:
    """With markup in its names, a frequency that is missing, and data for validation."""
    values = dict(
        title="Plates <b>& bolts</b>",
        before=gap(1.2),
        after=gap(1.01),
        validation=(gap(1.19), gap(0.98)),
        separations=[Separation("any", ("normal", "tangential"), "an axial mode", 2.3263)],
    )
    return diagnosis(**{**values, **changes})


def test_diagnosis_page_shows_the_numbers_of_the_result(keeps_rules):
    d = marked()
    leads = [replace(d.hypotheses[0], at_bound=("k_n",)), *d.hypotheses[1:]]
    d = replace(d, hypotheses=leads)
    text = page_of(d, log_sd=np.full((3, 2), 0.01))
    keeps_rules(text)
    check_page(text)
    assert "Plates &lt;b&gt;&amp; bolts&lt;/b&gt;" in text
    assert "<b>& bolts" not in text and "bending <2>" not in text
    page = Page(text)
    keys = ("gap-before", "gap-after", "gap-heldout", "gap-placebo", "gap-noise")
    numbers = [float(page.texts[key].split()[0]) / 100 for key in keys]
    expected = [d.before.rms, d.after.rms, d.heldout_after, d.placebo_after, d.noise]
    np.testing.assert_allclose(numbers, expected, atol=5.1e-5)

    assert page.column("shares", 0) == ["the lap", "plates", "unexplained"]
    assert page.column("shares", 1) == ["88.0 %", "7.0 %", "5.0 %"]
    # 0.66 + 0.30 for the class of two.
    assert page.column("effects", 2)[:4] == ["96 %", "66 %", "30 %", "3 %"]
    assert page.column("hypotheses", 1) == ["66 %", "30 %", "3 %", "< 1 %", "1 %"]
    assert page.column("hypotheses", 3) == ["0.0", "0.8", "3.0", "6.5", "4.7"]
    assert page.column("hypotheses", 6) == ["k_n", "–", "–", "–", "–"]
    assert page.tables["fitted"][1:] == [
        ["joint normal compliance", "k_n", "660 GPa/m", "510 to 860 GPa/m", "+0.30"]
    ]
    assert page.column("nuisances", 2) == ["1.02"]
    assert "measure an axial mode: their predictions differ by up to 2.3 times the noise" in text
    assert "(one is taken for the other in 1 %)" in text
    assert page.column("folds", 2)[:2] == ["20.00 %", "20.00 %"]
    assert page.column("folds", 4)[0] == "1.00 % to 3.00 %"

    frequencies = page.tables["frequencies"]
    measured = [row[2] for row in frequencies if len(row) == 7 and "Hz" not in row[2]]
    both = [formatting.MISSING if np.isnan(f) else f"{f:.2f}" for f in TEST.ravel()]
    assert measured == both + both  # validation, then all
    heat = [row for row in page.tables["heat"] if row[0] == "10 N·m"]
    assert [row[1] for row in heat] == ["+20.0 %", "+1.0 %"]
    assert [row[2] for row in heat] == [formatting.MISSING] * 2


def test_rows_after_a_known_change_have_its_name_and_points_of_their_own():
    text = page_of(marked(row_names=("", "", "weight"), validation=None))
    page = Page(text)
    heads = [row[0] for row in page.tables["heat"] if row[0].endswith(("N·m", "weight"))]
    last = page.tables["heat"][3][0]
    assert last.endswith(" N·m, weight") and heads.count(last) == 2 and len(heads) == 6
    rows = {row[0] for row in page.tables["frequencies"][1:]}
    assert last in rows and len(rows) == 3
    assert "measured after the change" in text
    assert "measured after the change" not in page_of(marked())


@pytest.mark.parametrize("verdict", list(VERDICTS))
def test_every_verdict_without_validation_and_map(verdict):
    d = diagnosis(verdict=verdict, shrinkage=None, separations=[], location=None)
    page = Page(page_of(d))
    said = [f"{name}. {sentence}" for name, sentence in explain(d).sentences]
    assert page.texts["verdict"].split() == " ".join([VERDICTS[verdict], *said]).split()
    assert "validation" not in page.ids and "folds" not in page.tables
    assert VERDICTS[verdict] in " ".join(shown(d, 80).split())


def large_diagnosis() -> Diagnosis:
    """More of everything than a screen holds, with long names."""
    effects = [
        EffectResult(
            f"an effect with quite a long name, number {i} [b]", "", 0.1, f"{i // 2}", True
        )
        for i in range(14)
    ]
    long = "a measurement that takes " + 8 * "many words "
    splits = [Separation(f"{i}", ("a", "b"), long.strip(), 1.5) for i in range(5)]
    fitted = [parameter("joint", f"away.k_{i}", 6.6e11, 5.1e9, 8.6e12, "Pa/m") for i in range(9)]
    far = [parameter(f"rho of {i}", "factor", 1, 1, 1, "", True, 3.0 + i) for i in range(9)]
    limits = ("away.k_0",) * 9
    lead = HypothesisResult("lead", ("x",), 0.9, 1.0, 0.01, 0.02, [*fitted, *far], limits)
    return diagnosis(
        verdict="likely",
        summary="A long verdict. " * 18,
        effects=effects,
        separations=splits,
        hypotheses=[lead],
        where=[ZoneShare(f"region_{i}", 0.1) for i in range(10)],
        shrinkage=shrinkage(shrink=0.2, coverage=0.5, claimed=False),
        model_error=0.004,
    )


@pytest.mark.parametrize("width", [60, 80, 100])
def test_tables_are_short_and_nothing_is_cut_or_too_wide(width):
    """However much there is: rows are counted; sentences and doubts stand whole."""
    for d in (marked(), large_diagnosis()):
        text, words = shown(d, width), explain(d)
        lines, whole = text.splitlines(), " ".join(text.split())
        assert max(map(len, lines)) <= width and "…" not in text and "..." not in text
        first = next(i for i, line in enumerate(lines) if line.startswith("RMS relative error"))
        assert len(lines) - first <= (41 if width > 60 else 60)
        assert all(f"but: {doubt}" in whole for doubt in words.doubts)
        assert all(sentence in whole for _, sentence in words.sentences)
        assert d.separations[0].measurement in whole
    assert len(words.doubts) == 7 and "rho of 8 (+11.0 s.d.)" in " ".join(words.doubts)


def test_the_leader_is_the_best_hypothesis_that_says_something():
    """``Diagnosis.after`` is its gap, also when "none of these" is more probable."""
    named = diagnosis().hypotheses[0]
    unknown = HypothesisResult("none of these", (), 0.9, 50.0, 0.004, 0.9)
    d = diagnosis(verdict="unknown", hypotheses=[unknown, named])
    page = Page(page_of(d))
    assert page.column("nuisances", 2) == ["1.02"]
    assert "660 GPa/m" in shown(d, 80)
