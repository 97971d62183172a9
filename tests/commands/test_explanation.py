"""A diagnosis in words: on results made by hand, whose right sentences are known."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from diagnosed import diagnosis, fold, location, page_of, shown, shrinkage, zone
from markupsafe import escape

from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.run import assumptions
from fenics_joints.commands.diagnose.words import heading_of
from fenics_joints.commands.results import result_schema
from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown, PointMassFound
from fenics_joints.diagnosis.verdict import confirm
from fenics_joints.errors import InputError
from fenics_joints.files import json_text


def undecided(**changes) -> Diagnosis:
    return diagnosis(verdict="ambiguous", **changes)


def point(d: Diagnosis, question: str) -> str:
    return explain(d).points[question]


def test_sentences_of_a_cause():
    words = explain(diagnosis())
    assert words.causes == (
        (
            "Cause (96 %)",
            "The joint is more compliant than modelled. This test cannot distinguish two effects "
            "(class A): joint normal compliance (66 %) and joint tangential compliance (30 %). "
            "Best fit (68 % interval): k_n = 660 GPa/m (510 to 860).",
        ),
    )
    assert words.which == ": ".join(words.causes[0])
    assert words.how_far == (
        "Held-out error: 20.00 % before, 3.30 % after (placebo 12.00 %, noise floor 0.50 %): 86 % "
        "of the error beyond noise is gone (90 % interval 79 to 93 %)."
    )
    # 0.66 over 0.033, the best hypothesis without either of the class.
    assert words.apart == (
        "An axial mode would best distinguish the effects of class A: their predictions differ by "
        "up to 3.4 times the noise. The best explanation that lacks this cause, modulus error "
        "(plate 1), is 20 times less probable."
    )
    # Where it is, the cause says; a score test beside it may say something else.
    assert words.where == ""
    assert [h for h, _ in words.sentences] == ["Cause (96 %)", "How far", "Rivals", "Compared"]


def test_what_the_test_does_not_identify_has_no_value():
    first, *others = diagnosis().hypotheses
    rows = [{**first.parameters[0], "identified": False}]
    d = diagnosis(hypotheses=[replace(first, parameters=rows), *others])
    which = explain(d).which
    assert "Not identified by this test: k_n." in which and "660" not in which
    for text in (shown(d), page_of(d)):
        assert "not identified" in text and "660 GPa/m" not in text


def test_where_is_one_place_with_its_change_and_what_may_as_well_be_it():
    both = (zone("plates", 0.93, 1e-3, 0.2), zone("the_lap", 0.94, 1e-12, 0.4))
    words = explain(undecided(location=location(regions=both))).where
    assert words.startswith('The error lies most probably in "the lap" (softer than in the model).')
    assert words.endswith('(p below 0.001). "plates" cannot be ruled out.')
    found = location()
    patch = zone("plates 1", 0.97, 1e-9, 0.01)
    for change, said in (
        (patch.change, '"plates" (-27 % of stiffness) near (50, 20, 0) mm. A change there'),
        ((0.1, 6.0), "(+82 % of mass) near"),
        ((0.1, 60.0), "(much more mass) near"),
    ):
        patches = replace(found.patches, tests=(replace(patch, change=change),))
        d = undecided(location=replace(found, patches=patches))
        assert said in explain(d).where
    assert "not how much" in point(d, "In which part?")
    silent = (zone("plates", 0.4, 0.3, 0.5), zone("the_lap", 0.5, 0.06, 0.5))
    for found in (location(regions=silent, zones=(), patches=None), None):
        words = explain(undecided(location=found)).where
        assert words.startswith("The test does not show where")


def test_a_cause_in_the_test_is_not_put_into_the_structure():
    name = "sensor mis-scaled"
    lead = HypothesisResult(name, (f"{name} (sensor 3)",), 0.97, 3.0, 0.01, 0.3)
    d = diagnosis(effects=[EffectResult(name, "sensor 3", 0.97, name, True)], hypotheses=[lead])
    words = explain(d)
    assert words.where.startswith("In the test, not in the structure: sensor 3.")
    assert words.which == "Cause (97 %): Sensor mis-scaled (sensor 3)."
    assert "fault in the test" in point(d, "In which part?")
    # Two sensors misplaced stood as one name twice.
    plain, away = diagnosis(), "sensor misplaced"
    two = [EffectResult(away, f"sensor {i}", 0.2, "family", True) for i in (3, 9)]
    text = shown(replace(plain, effects=[*two, *plain.effects[2:]])).partition("effect  ")[2]
    assert f"{away} (sensor 3)" in text and f"{away} (sensor 9)" in text


def test_two_causes_name_the_rival_that_lacks_one():
    pair = ("joint normal compliance (joint)", "modulus error (plate_1)")
    hypotheses = [
        HypothesisResult("both", pair, 0.9, 50.0, 0.01, 0.5),
        HypothesisResult("one", pair[1:], 0.03, 46.6, 0.02, 0.2),
        HypothesisResult("other", pair[:1], 1e-9, 30.0, 0.05, 1e-5),
    ]
    effects = [
        EffectResult("joint normal compliance", "joint", 0.9, "joint", True),
        EffectResult("modulus error", "plate_1", 0.93, "modulus error (plate_1)", True),
    ]
    d = diagnosis(hypotheses=hypotheses, effects=effects)
    assert explain(d).causes == (
        ("Cause 1 (93 %)", "Modulus error (plate 1)."),
        ("Cause 2 (90 %)", "Joint normal compliance."),
    )
    assert explain(d).apart == (
        "The best explanation that lacks cause 1 or cause 2, modulus error (plate 1), is 30 times "
        "less probable."
    )
    why = point(d, "Why this and not another?")
    assert (
        "without modulus error (plate 1), joint normal compliance, leaves an error of 5.00 %" in why
    )
    # Beyond 10 a difference says no more: no model of this kind is that exact.
    assert re.findall(r"ln evidence is (.*?)\.(?: |$)", why) == ["more than 10 lower", "3.4 lower"]
    h = diagnosis().hypotheses
    ahead = [replace(h[0], probability=0.9), replace(h[2], log_evidence=43.0)]
    why = point(diagnosis(hypotheses=ahead), "Why this and not another?")
    assert why.endswith("Its ln evidence is 1.0 higher, but it was less likely before the test.")


def test_no_gap_needs_no_cause():
    h = diagnosis().hypotheses
    words = explain(diagnosis(verdict="no gap", hypotheses=[replace(h[3], probability=0.97)]))
    assert "chi-square of the baseline model is 200" in words.where
    assert words.where.endswith("model error give about 12.")
    assert words.causes[0][1].startswith(
        "None is needed: the baseline model within its tolerances has a probability of 97 %."
    )


AT_CHANCE = {"shrinkage": shrinkage(claimed=False)}


def unknown(best=0, p_value=1e-8, **changes) -> Diagnosis:
    """A cause outside the library, and what is the best inside."""
    h = diagnosis().hypotheses
    inside = replace(h[best], probability=0.01, p_value=p_value)
    hypotheses = [replace(h[4], probability=0.98), inside]
    return diagnosis(verdict="unknown", hypotheses=hypotheses, **changes)


@pytest.mark.parametrize(
    ("p_value", "changes", "said"),
    [
        (1e-8, AT_CHANCE, "explains the whole test. The best, joint normal compliance, leaves an"),
        (1e-8, {**AT_CHANCE, "at_once": 1e-5}, "do not explain it either (p below 0.001)"),
        (1e-8, {**AT_CHANCE, "at_once": 0.31}, "All effects together can explain it (p = 0.31)"),
        # What noise may leave is not refuted: it is less probable than what nobody listed.
        (0.5, AT_CHANCE, "is as probable as a cause outside the library. The best, joint"),
        # What is borne out by data that were held out is not denied for what it leaves.
        (1e-8, {}, "the placebo, so it is probably a part of the cause"),
    ],
)
def test_an_unknown_cause(p_value, changes, said):
    d = unknown(p_value=p_value, **changes)
    which = explain(d).which
    assert said in which and which.endswith("outside the library has a probability of 98 %.")
    known_in_part = not changes
    assert (heading_of(d) == "Cause unknown, or known in part") == known_in_part
    assert d.to_json().get("at_once") == changes.get("at_once")


def test_an_unknown_cause_may_have_a_place_or_stand_beside_the_nominal_model():
    mass = PointMassFound(0.058, 0.05, 0.065, (0.02, 0.04, 0.0), 12.0)
    d = unknown(somewhere=LocalisedUnknown(0.97, mass))
    said = point(d, "What if it is something else?")
    assert "stiffness or mass in one place is 97 %; as a point mass, 58 g" in said
    assert d.to_json()["somewhere"]["point"]["kg"] == 0.058
    assert ". As a point mass, 58 g" in explain(d).where
    words = explain(unknown(best=3, **AT_CHANCE))
    assert "The best, the baseline model within its tolerances, leaves" in words.which
    assert "79 to 93 %), by changes within tolerance alone." in words.how_far


def test_a_class_of_many_is_a_doubt():
    """A cause that is one of a dozen is hardly known, and no heading says that it is found."""
    plain = diagnosis()
    assert "cannot distinguish" not in " ".join(explain(plain).doubts)
    more = [replace(plain.effects[0], name=f"{i}", probability=0.001) for i in range(10)]
    many = replace(plain, effects=[*plain.effects, *more])
    said = "cannot distinguish the 12 effects of class A (joint normal compliance and others)"
    assert said in " ".join(explain(many).doubts)
    for d, heading in (
        (plain, "Cause found, confirmed on held-out data"),
        (many, "Cause narrowed down to one of 12, confirmed on held-out data"),
        (replace(many, verdict="likely"), "Likely one of 12 causes, not confirmed on held-out"),
    ):
        assert heading_of(d).startswith(heading)


def test_a_mesh_that_makes_much_of_the_gap_is_a_doubt():
    """Errors of 0.06 and 0.08 are 0.071 (root mean square), of which 0.36 stays uncertain."""
    plain = diagnosis()
    doubted = replace(plain, model={**plain.model, "mesh_error": {"a": 0.06, "b": 0.08}})
    off = np.sqrt(0.005)
    said = f"The discretisation error is {100 * off:.2f} % (RMS over the modes). "
    left = 100 * np.hypot(0.3, 0.2) * off / plain.before.rms
    share = f"uncertainty is {left:.0f} % of the error of the model"
    assert [w for w in explain(doubted).doubts if w.startswith(said) and share in w]
    own = f"discretisation error ({100 * off:.2f} %) is subtracted."
    assert explain(doubted).start.endswith(own)
    assert "discretisation" not in explain(plain).start
    fine = replace(plain, model={**plain.model, "mesh_error": {"a": 0.002, "b": 0.002}})
    assert explain(fine).doubts == explain(plain).doubts


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"claimed": False}, "(placebo 12.00 %, noise floor 0.50 %): 86 %"),
        ({"claimed": False}, "The placebo is not significantly worse."),
        (
            {"after": 0.21, "shrink": -0.05, "shrink_interval": (-0.6, -0.1)},
            "21.00 % after (placebo 12.00 %, noise floor 0.50 %). It grows: the fit",
        ),
        ({"shrink": np.nan}, "already as good as noise allows"),
        ({"folds": []}, "Held-out error: 20.00 % before, 3.30 % after."),
        # It was 5,612 % once, of a mass that one part held out did not bear.
        ({"placebo": 56.12, "after": 0.21}, "over 100 %"),
    ],
)
def test_how_far_says_when_it_is_no_evidence(changes, said):
    assert said in explain(diagnosis(shrinkage=shrinkage(**changes))).how_far


def test_doubts_are_told_and_only_where_there_are_any():
    clean = [replace(h, parameters=[]) for h in diagnosis().hypotheses]
    good = dict(hypotheses=clean, shrinkage=shrinkage(coverage=1.0))
    assert explain(diagnosis(**good)).doubts == ()

    bad = [replace(clean[0], at_bound=("k_n",), p_value=0.02), *clean[1:]]
    low, order = shrinkage(shrink=0.2, coverage=0.5, claimed=False), "Modes are paired by order."
    d = diagnosis(hypotheses=bad, shrinkage=low, model_error=0.004)
    doubts = " ".join(explain(replace(d, model={**d.model, "order": order})).doubts)
    for words in (
        "p = 0.020",
        "limit of their range: k_n",
        "the placebo does nearly as well",
        "On held-out data, 80 % of the frequency error beyond noise remains",
        "Only 50 % of the held-out parts ended in the 90 % interval",
        "up to 0.400 %",
        order,
    ):
        assert words in doubts
    (far,) = explain(diagnosis(shrinkage=shrinkage(coverage=1.0))).doubts
    assert far.endswith("far from their expected values: rho of plates (+2.4 s.d.).")


def test_points_hold_the_numbers_behind_the_sentences():
    d = diagnosis()
    assert "frequencies 194 for 6, shapes 6 for 6" in point(d, "Is there more than chance?")
    # Bending 1 alone is within chance; both torques are not.
    assert point(d, "In which data?") == (
        "Of 3 modes, these add more error than chance to what the others show: bending 2 and "
        "bending 3. Of 2 values of the torque, these add more error than chance to what the others "
        "show: 5 N·m and 20 N·m."
    )
    part = point(d, "In which part?")
    assert '"the lap, bolt 2, ring 1" (softer than in the model)' in part
    assert "1 explain more than chance; 1 of them could be the only place" in part
    assert '"the lap" (softer than in the model) near (150, 25, 10) mm' in part
    without = diagnosis(location=location(patches=None))
    assert "patches" not in point(without, "In which part?")
    assert "The colour is the share of chi-square" not in page_of(without)
    assert "Which of these it is" in point(d, "What can these data not tell?")
    for text in (page_of(d), shown(d)):
        assert "This test cannot show micro-slip in the joint" in " ".join(text.split())


def test_page_and_terminal_lead_with_the_sentences():
    """And folds that end better than was stated have held."""
    better = fold("mode bending 2", after=0.002, covered=False, better=True)
    folds = [fold("mode bending 1"), better, fold("torque 5 N·m", after=0.09, covered=False)]
    d = diagnosis(shrinkage=shrinkage(folds=folds, coverage=2 / 3))
    page, words = page_of(d), explain(d)
    assert "1.00 % to 3.00 %: better" in page and page.count("1.00 % to 3.00 %: missed") == 1
    assert [f["better"] for f in d.to_json()["folds"]] == [False, True, False]
    assert "41.2</td>" in page
    which, apart = escape(words.causes[0][1]), escape(words.apart)
    assert page.index(which) < page.index(words.how_far) < page.index(apart)
    assert page.index(apart) < page.index('id="words"') < page.index('id="tests"')
    for table in ("tests", "zones", "folds", "shrinkage"):
        assert f'id="{table}"' in page
    assert "not visible to this test" in page

    text = " ".join(shown(d, 80).split())
    heading = "Cause found, confirmed on held-out data"
    said = ". ".join(words.causes[0])
    assert text.startswith(f"Plates: {heading} {said} How far. {words.how_far} ")
    assert f"Compared. {words.start} but: {words.doubts[0]}" in text


def test_assumptions_are_those_of_the_case(write_case, tmp_path):
    case = load_case(write_case(tmp_path))
    rows = dict(assumptions(case, case.measurements()))
    text = (tmp_path / "case.toml").read_text(encoding="utf-8")
    noise = float(re.search(r'^noise = "([\d.]+) %"', text, re.M)[1])
    assert float(rows["noise of a frequency"].split()[0]) == pytest.approx(noise)
    assert rows["joints of the baseline model"].startswith("bonded to the parts")
    assert any("E 1.5 %" in value for value in rows.values())


def test_a_cause_that_held_out_data_speak_against_is_likely_at_most():
    grows = dict(before=0.0253, after=0.0274, shrink=-0.1, shrink_interval=(-0.4, 0.2))
    chance = dict(shrink_interval=(-0.1, 0.9))
    for changes, why in (
        (grows, "their error grows from 2.53 % to 2.74 %"),
        (chance, "may be due to chance"),
        ({"claimed": False}, "the placebo predicts them nearly as well"),
        ({"folds": []}, "nothing could be held out"),
    ):
        verdict, summary = confirm("cause", "It is the joint.", s := shrinkage(**changes))
        assert verdict == "likely" and why in summary
        d = diagnosis(verdict=verdict, shrinkage=s, joints="given")
        assert why in explain(d).doubts[0]
        assert heading_of(d) == "Likely cause, not confirmed on held-out data"
        assert "(joints with the stiffness of the case) is 20.00 %" in explain(d).start
    assert confirm("cause", "It is.", shrinkage()) == ("cause", "It is.")
    assert confirm("ambiguous", "It may be.", shrinkage(**grows)) == ("ambiguous", "It may be.")


def test_no_probability_is_shown_as_certain_but_files_have_all_of_it():
    extreme, plain = (0.999999, 1e-7, 4e-159, 0.0, 0.0, 0.0), diagnosis()
    sure = [replace(h, probability=p) for h, p in zip(plain.hypotheses, extreme, strict=False)]
    effects = [replace(e, probability=p) for e, p in zip(plain.effects, extreme, strict=True)]
    d = diagnosis(hypotheses=sure, effects=effects)
    rows = d.to_json()
    assert [h["probability"] for h in rows["hypotheses"]] == list(extreme[:5])
    assert rows["classes"][0]["effects"] == [h.effects[0] for h in plain.hypotheses[:2]]
    mixed = replace(plain.shrinkage.folds[0], weights={"the joint": 1 - 1e-9, "modulus": 1e-9})
    d = replace(d, shrinkage=replace(plain.shrinkage, folds=[mixed]))
    words = explain(d)
    assert words.causes[0][0] == "Cause (> 99 %)"
    assert "more than 99 times less probable" in words.apart
    page = page_of(d)
    assert "e-1" not in str(words.to_json()) and "between 1 and 99 %" in page
    tables = re.findall(r'<table id="(?:effects|hypotheses)"[^>]*>.*?</table>', page, re.S)
    shown = {x for t in tables for x in re.findall(r'<td class="n">([^<]*\d+ %)<', t)}
    assert {"&gt; 99 %", "&lt; 1 %"} < shown and not {"100 %", "0 %"} & shown


def test_the_json_keeps_to_its_schema():
    """Every key is documented, and a wrong value is noticed."""
    jsonschema = pytest.importorskip("jsonschema")
    schema, words = result_schema("diagnose"), explain(diagnosis()).to_json()
    run = dict.fromkeys(schema["properties"]["run"]["required"], "")
    run |= {"changes": [], "inputs": {}, "seed": None, "ranks": 1}
    head = {"schema": "fenics-joints diagnose 1", "run": run, "notes": []}
    found = json.loads(json_text({**head, **diagnosis().to_json(), "in_words": words}))
    jsonschema.validate(found, schema)
    assert set(found) <= set(schema["properties"])
    assert found["classes"][0]["probability"] == pytest.approx(0.96)
    assert len(found["classes"][0]["effects"]) == 2
    assert found["effects"][0]["class"] == found["classes"][0]["name"]
    for wrong in ({"verdict": "sure"}, {"effects": [{"probability": 1.2}]}, {"where": [{}]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**found, **wrong}, schema)
    with pytest.raises(InputError, match="'solve' has no schema"):
        result_schema("solve")
