"""The blind check: seals that hold, and scores against numbers worked out by hand."""

from __future__ import annotations

import ast
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("dolfinx")

ROOT = Path(__file__).resolve().parents[2]

from scipy.stats import multivariate_normal, norm  # noqa: E402

from benchmarks.blind import (  # noqa: E402
    counted,
    forecast,
    make,
    matching,
    misses,
    oracle,
    page,
    rates,
    score,
    seal,
    targets,
    weights,
)
from fenics_joints.diagnosis.evidence.entries import Neighbours  # noqa: E402
from fenics_joints.files import json_text  # noqa: E402
from fenics_joints.measurements.data import TestData  # noqa: E402
from fenics_joints.structure import Sensors  # noqa: E402

# -- seals -----------------------------------------------------------------------------------------

ANSWER = {"kind": "single", "effects": [{"name": "loose", "region": "bolt 2", "size": 0.5}]}


@pytest.fixture
def sealed(tmp_path):
    """Two sealed cases, one of them diagnosed, and the key."""
    pytest.importorskip("cryptography")
    folder = tmp_path / "check"
    key = seal.make_key(tmp_path / "check.key", folder)
    cases, kept = [], {}
    (folder / "diagnoses").mkdir(parents=True)
    for name in ("aa", "bb"):
        place = folder / "cases" / name
        place.mkdir(parents=True)
        (place / "case.toml").write_text(f"title = '{name}'")
        sha, kept[name] = seal.promise(ANSWER)
        cases.append({"id": name, "sha256": sha, "data_sha256": seal.files_digest(place)})
    (folder / seal.SEALED).write_text(json_text({"final": False, "cases": cases}))
    (folder / seal.ANSWERS).write_text(seal.encrypt({"cases": kept}, key))
    (folder / "diagnoses" / "aa.json").write_text("{}")
    return folder, key, kept


def test_what_is_made_so_far_is_sealed_and_nothing_else(tmp_path, monkeypatch):
    """A case whose answer was not kept when making was stopped is no case of the check."""
    folder = tmp_path / "check"
    key = seal.make_key(tmp_path / "check.key", folder)
    said = []

    def run(command, input, **given):
        Path(json.loads(input)["folder"], "case.toml").write_text("title = 'a case'")
        truth = json.dumps(ANSWER)
        return SimpleNamespace(returncode=0, stderr="", stdout=f"truth of the case: {truth}\n")

    def say(words):
        said.append(words)
        if len(said) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(make, "subprocess", SimpleNamespace(run=run, TimeoutExpired=TimeoutError))
    with pytest.raises(KeyboardInterrupt):
        make.make_cases(folder, key, 3, 1, jobs=1, say=say)
    listed = make.make_cases(folder, key, 3, 1, so_far=True)
    there = {place.name for place in (folder / "cases").iterdir()}
    assert {case["id"] for case in listed["cases"]} == there == {said[0].split()[-2]}
    assert listed["planned"] == 3


def test_equal_answers_have_unequal_seals(sealed):
    """A list of seals does not tell which cases are alike, nor can a guess be checked."""
    folder, _, _ = sealed
    listed = seal.read_json(folder / seal.SEALED)["cases"]
    assert listed[0]["sha256"] != listed[1]["sha256"]
    assert "bolt" not in (folder / seal.ANSWERS).read_text()


def test_unseal_waits_for_all_diagnoses(sealed):
    folder, key, _ = sealed
    with pytest.raises(seal.SealError, match="1 of 2 cases are not diagnosed"):
        seal.unseal(folder, key)
    assert not (folder / seal.UNSEALED).exists()
    assert seal.unseal(folder, key, partial=True) == {"aa": ANSWER}
    assert "bb" not in (folder / seal.UNSEALED).read_text()
    # What was open may not be diagnosed again.
    for name in ("aa", "bb"):
        (folder / "diagnoses" / f"{name}.json").write_text('{"better": 1}')
    with pytest.raises(seal.SealError, match="again after unsealing: aa"):
        seal.unseal(folder, key)


def test_changed_answer_data_or_key_is_refused(sealed):
    folder, key, kept = sealed
    (folder / "diagnoses" / "bb.json").write_text("{}")
    other = seal.make_key(folder.parent / "other.key", folder)
    with pytest.raises(seal.SealError, match="key is another"):
        seal.unseal(folder, other)
    right = (folder / seal.ANSWERS).read_text()
    (folder / seal.ANSWERS).write_text(right[:60] + ("A" if right[60] != "A" else "B") + right[61:])
    with pytest.raises(seal.SealError, match="or they were changed"):
        seal.unseal(folder, key)
    # Even who holds the key cannot put another answer in.
    forged = json.loads(json.dumps(kept))
    forged["bb"]["answer"]["effects"][0]["size"] = 0.6
    (folder / seal.ANSWERS).write_text(seal.encrypt({"cases": forged}, key))
    with pytest.raises(seal.SealError, match="differ from their seals: bb"):
        seal.unseal(folder, key)
    (folder / seal.ANSWERS).write_text(right)
    (folder / "cases" / "aa" / "case.toml").write_text("title = 'x'")
    with pytest.raises(seal.SealError, match="data of case aa"):
        seal.unseal(folder, key)


def test_key_stays_outside(tmp_path):
    with pytest.raises(seal.SealError, match="outside"):
        seal.make_key(tmp_path / "check" / "my.key", tmp_path / "check")


def test_world_imports_nothing_of_the_suite():
    """The generator shares no code with what it checks."""
    blind = ROOT / "benchmarks" / "blind"
    files = [path for name in ("world", "calculix") for path in (blind / name).rglob("*.py")]
    assert len({path.parent for path in files}) == 2
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 1, f"{path}: reaches out of its own folder"
            elif isinstance(node, ast.Call):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                hidden = ("import_module", "__import__", "exec", "eval")
                names = [f"fenics_joints by {called}"] if called in hidden else []
            wrong = [n for n in names if n.startswith(("fenics_joints", "forms", "meshes"))]
            wrong += [n for n in names if n.startswith("benchmarks")]
            assert not wrong, f"{path} imports {wrong}"


# -- rates -----------------------------------------------------------------------------------------


def test_clopper_pearson():
    """No alarm in 60 proves less than 4.9 %, one-sided; ends by their definition elsewhere."""
    assert rates.clopper_pearson(0, 60, level=0.9)[1] == pytest.approx(1 - 0.05 ** (1 / 60))
    assert rates.clopper_pearson(0, 60, level=0.9)[1] == pytest.approx(0.049, abs=5e-4)
    assert rates.clopper_pearson(1, 100, level=0.9)[1] == pytest.approx(0.047, abs=5e-4)
    assert rates.clopper_pearson(151, 160, level=0.9)[0] == pytest.approx(0.90, abs=5e-3)
    assert rates.clopper_pearson(0, 0) == (0.0, 1.0)


def test_calibration_of_a_perfect_and_of_a_bold_forecaster():
    """A perfect one errs as chance has it; one who adds 0.1 to each is caught by that."""
    random = np.random.default_rng(3)
    p = random.uniform(0.1, 0.9, 2000)
    y = random.random(2000) < p
    found = rates.calibration(p, y)
    assert found.count.tolist() == [200] * 10
    assert found.error < 3 * found.by_chance < 0.1
    bold = rates.calibration(p + 0.1, y)
    assert bold.error == pytest.approx(0.1, abs=0.02) and bold.low > found.by_chance


# -- scores ----------------------------------------------------------------------------------------


def said(hypotheses, *, verdict="cause", groups=None, gap=None):
    """A diagnosis with four effects: ``a`` at two places, ``b`` and ``c``."""
    names, same = [("a", "near"), ("a", "away"), ("b", ""), ("c", "")], {"probability": 0.0}
    effects = [
        {"name": n, "region": r, "class": (groups or {}).get(n, forecast.key(n, r)), **same}
        for n, r in names
    ]
    rows = [
        {"label": " + ".join(keys), "effects": list(keys), "probability": p}
        for keys, p in hypotheses.items()
    ]
    nothing = {"heldout_before": 0.1, "heldout_after": 0.1, "placebo_after": 0.1, "noise": 0.0}
    return forecast.Forecast(
        {"verdict": verdict, "effects": effects, "hypotheses": rows, "gap": gap or nothing}
    )


def record(kind, effects, forecast_, **kwargs):
    truth = {"kind": kind, "geometry": "g", "noise": "small", "final_only": False}
    truth["effects"] = [{"name": n, "region": r} for n, r in effects]
    return score.Record("id", truth, forecast_, **kwargs)


NEAR, AWAY, B, C = ("a (near)",), ("a (away)",), ("b",), ("c",)


def test_weights_are_those_counted_with():
    """Shown probabilities have a floor that a hundred hypotheses would add up; worked out by hand:
    odds 1.5 shared by two, 0.2 of an unknown cause, which takes all that has failed, and what
    looks alike by p = 1."""
    effects = [{"name": n, "region": "", "odds": 1.0, "probability": 0.5} for n in "ab"]
    rows = [("a", 0.0, 1.0), ("b", 3.0, 1e-5), ("no gap", -2.0, 1.0), ("none of these", -1.0, 1.0)]
    same = {"probability": 0.01}
    hypotheses = [
        {"label": n, "effects": [n] if n in "ab" else [], "log_evidence": z, "p_value": p, **same}
        for n, z, p in rows
    ]
    other = 0.2 * math.exp(-1)
    parts = np.array([0.75, other, math.exp(-2), other])  # what failed has what the unknown has
    alike = 1 / (1 + math.exp(2.08))
    expected = (1 - alike) * parts / parts.sum() + np.array([0, 0, 0, alike])
    found = weights.weights_of({"effects": effects, "hypotheses": hypotheses})
    assert found == pytest.approx(expected, rel=1e-12)
    shares = forecast.Forecast({"effects": effects, "hypotheses": hypotheses}).shares
    assert shares("effect")["none of these"] == pytest.approx(expected[3])
    # Once held-out data have spoken, an unknown cause keeps what is said of it.
    later = [
        h | {"probability": p} for h, p in zip(hypotheses, (0.2, 0.2, 0.2, 0.394), strict=True)
    ]
    found = weights.weights_of({"effects": effects, "hypotheses": later})
    assert found[3] == 0.394
    assert found[:3] == pytest.approx((1 - 0.394) * parts[:3] / parts[:3].sum())


def test_three_levels_of_detail():
    """The likeliest effect is b, the likeliest cause a: 0.3 near and 0.25 away make 0.55."""
    r = record("single", [("a", "away")], said({NEAR: 0.3, AWAY: 0.25, B: 0.35, C: 0.1}))
    assert r.rank("effect") == 3 and r.rank("cause") == 1
    assert r.brier("cause") == pytest.approx(0.45**2 + 0.35**2 + 0.1**2)
    assert r.log_score("cause") == pytest.approx(-math.log(0.55))
    assert r.set_of(0.9) == ["b", "a (near)", "a (away)"]
    one_class = said({NEAR: 0.3, AWAY: 0.2, B: 0.4, C: 0.1}, groups={"b": "b or c", "c": "b or c"})
    r = record("single", [("c", "")], one_class)
    assert r.rank("cause") == 3 and r.rank("class") == 1
    assert r.forecast.members("b or c") == 2
    assert r.statement("class") == (pytest.approx(0.5), True)


def test_uniform_guess_and_a_failed_diagnosis():
    """1 - 1/K and ln K, with K = 6 outcomes: four effects, no gap and none of these."""
    sixth = {NEAR: 1, AWAY: 1, B: 1, C: 1, ("no gap",): 1, ("none of these",): 1}
    for kind in ("none", "unknown"):
        r = record(kind, [], said({k: p / 6 for k, p in sixth.items()}))
        assert r.brier("effect") == pytest.approx(5 / 6)
        assert r.log_score("effect") == pytest.approx(math.log(6))
        assert r.rank("effect") == 6  # equals do not help
    failed = record("none", [], forecast.Forecast(None), n_causes=13)
    assert failed.brier("cause") == pytest.approx(0.923, abs=5e-4)
    assert failed.log_score("cause") == pytest.approx(2.565, abs=5e-4)
    assert failed.rank("cause") == math.inf


def test_pairs_alarms_and_unknowns():
    """Counts by hand; marginals, not hypotheses, rank the two effects of a pair."""
    both = said({("a (near)", "b"): 0.5, ("a (near)", "c"): 0.2, B: 0.3})  # a 0.7, b 0.8, c 0.2
    records = [
        record("pair", [("a", "near"), ("b", "")], both),
        record("pair", [("a", "near"), ("c", "")], both),
        record("none", [], said({("no gap",): 0.9, B: 0.1}, verdict="no gap")),
        record("none", [], said({("no gap",): 0.4, B: 0.6}, verdict="ambiguous")),
        record("unknown", [], said({("none of these",): 0.3, B: 0.7}, verdict="unknown")),
        record("unknown", [], said({("none of these",): 0.9, B: 0.1}, verdict="unknown")),
    ]
    # With the two nulls that is 40 known ones, of which 2 may be false: those of 0.5 and 0.4.
    for i in range(38):
        p = {0: 0.5, 1: 0.4}.get(i, 0.001 * i)
        records.append(record("single", [("b", "")], said({("none of these",): p, B: 1 - p})))
    names = [f"case {i}" for i in range(len(records))]
    records = [score.Record(n, r.truth, r.forecast) for n, r in zip(names, records, strict=True)]
    found = score.summary(records)
    assert (found["pair"]["both_cause"]["k"], found["pair"]["one_cause"]["k"]) == (1, 2)
    assert found["none"]["alarm"]["k"] == 1 and found["none"]["cause_named"]["k"] == 0
    unknown = found["unknown"]
    assert unknown["by_verdict"]["caught"]["k"] == 2
    assert unknown["false"]["k"] == 2 and unknown["threshold"] == pytest.approx(0.037)
    assert unknown["caught"]["k"] == 2
    # The tie of 0.5 for none of these and b does not count as right.
    assert found["single"]["top1_cause"]["k"] == 37


def test_shrinkage():
    """From 5 % to 2 % with noise of 1 % is three quarters of what noise allows."""
    gap = {"heldout_before": 0.05, "heldout_after": 0.02, "placebo_after": 0.04, "noise": 0.01}
    r = record("single", [("b", "")], said({B: 1.0}, gap=gap))
    found = score.summary([r])["shrinkage"]
    assert found["s"]["median"] == pytest.approx(0.75)
    assert found["excess"]["median"] == pytest.approx(0.5)
    assert score.shrinkage_of(said({B: 1.0}, gap=gap | {"noise": 0.03}).diagnosis) is None
    # Two of three folds within the intervals stated before; the noise is the folds' own.
    folds = [{"covered": c} for c in (True, True, False)]
    own = {"before": 0.05, "after": 0.03, "placebo": 0.05, "noise": 0.0, "folds": folds}
    r = record("single", [("b", "")], score.Forecast(r.forecast.diagnosis | {"shrinkage": own}))
    found = score.summary([r])["shrinkage"]
    assert found["s"]["median"] == pytest.approx(0.4)
    assert (found["predicted_covered"]["k"], found["predicted_covered"]["n"]) == (2, 3)


def test_wrong_answers_are_told(tmp_path):
    """Six of eight are wrong, the one that nobody could tell (D of 1) after the one that is not."""
    wrong, right = said({C: 0.7, B: 0.3}), said({B: 0.8, C: 0.2})
    nothing = said({("no gap",): 0.9, B: 0.1}, verdict="no gap")
    cases = {
        "aa": record("single", [("b", "here")], wrong, separability=1.0),
        "bb": record("single", [("b", "here")], wrong, separability=5.0),
        "cc": record("single", [("b", "here")], right, separability=5.0),
        "dd": record("none", [], right),
        "ee": record("none", [], nothing),
        "ff": record("unknown", [], nothing),
        "gg": record("pair", [("b", ""), ("d", "")], said({C: 1.0})),
        "hh": record("single", [("b", "")], forecast.Forecast(None), separability=3.0),
    }
    records = [replace(r, name=name) for name, r in cases.items()]
    (tmp_path / "scores.json").write_text(json_text(score.score(records)))
    of_test = {"geometry": "g", "noise": [1e-3, 0.02], "spec": {"shapes": True}, "test": "torque"}
    of_test |= {"frequencies": [[1.0] * 4] * 3, "shapes": [[1.0] * 4] * 7, "missing": [2]}
    of_test |= {"gap": 0.05}
    (tmp_path / seal.UNSEALED).write_text(json_text({"answers": dict.fromkeys(cases, of_test)}))
    (tmp_path / "diagnoses").mkdir()
    for r in records:
        kept = {"diagnosis": r.forecast.diagnosis} if r.forecast.diagnosis else {"error": "?"}
        (tmp_path / "diagnoses" / f"{r.name}.json").write_text(json_text(kept))
    found = misses.told(tmp_path)
    rows = [[x.strip() for x in y.split("|")[1:-1]] for y in found.splitlines() if "| `" in y]
    assert [row[0].strip("`") for row in rows] == ["bb", "hh", "aa", "dd", "ff", "gg"]
    row = dict(zip(("id", "true", "test", "gap", "D", "said", "truth"), rows[0], strict=True))
    assert row["test"] == "g, 4 modes, 6 sensors, 3 torques, 0.10 %, 2.00 %"
    assert (row["true"], row["gap"], row["D"]) == ("b (here)", "5.00 %", "5.0")
    assert (row["said"], row["truth"]) == ("cause: c 0.70; b 0.30", "0.30")


# -- the oracle ------------------------------------------------------------------------------------


def test_what_a_stated_error_turns_is_no_difference():
    """Two modes of a chain whose stiffnesses err by 2 % turn as the eigenvectors of such chains do;
    far apart they do not. What all joints do together is one more direction."""
    x = np.zeros((4, 3))
    x[:, 0] = range(4)
    shapes = np.array([[1.0, 1, 1, 1], [1, -1, 1, -1]]).T
    error = 0.02

    def covariance(hz, joints=()) -> np.ndarray:
        seen = {"sensors": Sensors(x, [0, 0, 1]), "shapes": shapes, "shape_noise": 1e-6}
        test = TestData([30.0], [hz], ["mode 1", "mode 2"], noise=1e-6, **seen)
        errors = counted.Errors(discrepancy=error, of_shapes=1e-4, mesh={})
        near = Neighbours(np.log(hz), shapes, np.arange(2))
        return errors.covariance(test, near, joints)

    def sd_of_turn(hz) -> float:
        """Of what the first shape has of the second."""
        along = np.zeros(10)
        along[[2, 4, 6, 8]] = shapes[:, 1] / 4
        return np.sqrt(along @ covariance(hz) @ along)

    def drawn(hz) -> float:
        """The same of matrices diag(w^2) with each entry off by twice 2 %, as ln w^2 is."""
        squares, random, turns = np.square(hz), np.random.default_rng(0), []
        for coupling in 2 * error * random.standard_normal(4000):
            off = coupling * np.sqrt(np.prod(squares))
            _, v = np.linalg.eigh([[squares[0], off], [off, squares[1]]])
            turns.append(v[1, 0] / v[0, 0])
        return np.std(turns)

    assert sd_of_turn((100.0, 130.0)) == pytest.approx(drawn((100.0, 130.0)), rel=0.05)
    assert sd_of_turn((100.0, 1000.0)) < 0.02
    assert sd_of_turn((100.0, 101.0)) > 0.5
    log_f = np.array([-3.0, -4.0])
    more = covariance((100.0, 130.0), [(log_f, 0 * shapes)]) - covariance((100.0, 130.0))
    joint = 0.5 * error * np.array([3, 4]) / np.sqrt(12.5)
    assert more[:2, :2] == pytest.approx(np.outer(joint, joint)) and not more[2:].any()


def test_oracle_errs_as_often_as_separability_says():
    """Two known effects in Gaussian noise are confused with probability Phi(-D)."""
    random = np.random.default_rng(5)
    noise, nuisance = np.diag([0.5, 1.0, 2.0, 1.0]), random.normal(size=(4, 2))
    white = oracle.Whitened(noise, nuisance)
    a, b = random.normal(size=(2, 4)) * 1.5
    families = {"a": [oracle.Curve(a)], "b": [oracle.Curve(b)]}
    d = oracle.separability(a, {"b": families["b"]}, white)
    root = np.linalg.cholesky(noise + nuisance @ nuisance.T)
    data = a + random.normal(size=(2000, 4)) @ root.T
    wrong = np.mean([oracle.posterior(y, families, white)["a"] < 0.5 for y in data])
    assert 0.02 < norm.cdf(-d) < 0.3
    assert wrong == pytest.approx(norm.cdf(-d), abs=0.025)


def test_oracle_along_sizes():
    """Integrals along a polygon with scatter are those by many points with that covariance."""
    random = np.random.default_rng(6)
    corners, scatter = random.normal(size=(3, 4)) * 3, random.normal(size=(2, 4, 2))
    white = oracle.Whitened(np.eye(4), np.zeros((4, 1)))
    data = corners[1] + random.normal(size=4)
    families = {"line": [oracle.Curve(corners, scatter)], "point": [oracle.Curve(corners[0])]}
    t = (np.arange(4000) + 0.5)[:, None] / 4000
    density = []
    for start, end, s in zip(corners[:-1], corners[1:], scatter, strict=True):
        law = multivariate_normal(cov=np.eye(4) + s @ s.T)
        density.append(np.mean(law.pdf(data - start - t * (end - start))))
    point = multivariate_normal(corners[0], np.eye(4)).pdf(data)
    expected = np.mean(density) / (np.mean(density) + point)
    assert oracle.posterior(data, families, white)["line"] == pytest.approx(expected, rel=1e-5)
    # Between the sizes of a rival lies a nearer one than at either.
    line = oracle.Curve(np.array([data + [3, -1, 0, 0], data + [3, 1, 0, 0]]))
    assert oracle.separability(data, {"line": [line]}, white) == pytest.approx(1.5)


# -- the whole -------------------------------------------------------------------------------------


def test_page_of_a_synthetic_check(keeps_rules):
    """Targets, pictures and every case stand in the page."""
    random = np.random.default_rng(1)
    records = []
    for i in range(60):
        kind = ["single", "single", "pair", "none", "unknown"][i % 5]
        true = {"single": [("b", "")], "pair": [("b", ""), ("c", "")]}.get(kind, [])
        p = random.dirichlet([0.4, 0.4, 3.0, 0.4, 0.5])
        keys = [NEAR, AWAY, {"none": ("no gap",), "unknown": ("none of these",)}.get(kind, B), C]
        verdict = {"none": "no gap", "unknown": "unknown"}.get(kind, "cause")
        gap = {"heldout_before": 0.05, "heldout_after": random.uniform(0.011, 0.03), "noise": 0.01}
        gap["placebo_after"] = random.uniform(0.02, 0.05)
        r = record(kind, true, said(dict(zip(keys, p, strict=False)), verdict=verdict, gap=gap))
        r.truth.update(geometry="xy"[i % 2], final_only=bool(i % 2))
        told = random.uniform(0.2, 9), {"b": 0.9, "c": 0.1}
        records.append(score.Record(f"id{i}", r.truth, r.forecast, *told))
    scores = score.score(records) | {"rules_changed": False}
    json_text(scores)  # no nan, nothing that JSON has not
    assert [t.outcome for t in targets.targets(scores["summary"])].count("no cases") == 0
    text = page.page(scores, {"final": True, "sealed": "today", "commit": "", "not_made": 1})
    assert text.count("<svg") == 4 and all(f"id{i}" in text for i in range(60))
    keeps_rules(text)


@pytest.mark.slow
def test_small_check(tmp_path):
    """Generator, seals, diagnosis and scores, one after the other."""
    pytest.importorskip("cryptography")
    command = [sys.executable, "-m", "benchmarks.blind", "small", "--cases", "2"]
    command += ["--keep", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stderr[-4000:]
    scores = json.loads((tmp_path / "small" / "scores.json").read_text())
    assert scores["failed"] == 0 and len(scores["cases"]) == 2


def test_names_of_the_world_are_matched():
    """The table of names, and numbers of sensors and bolts."""
    assert matching.same_region("Bolt 2", "bolt_2") and not matching.same_region("bolt 2", "bolt 1")
    assert matching.same_region(["near", "far"], "far") and matching.same_region("x", "")
    five = "bolt 1 / bolt 2 / bolt 3 / bolt 4 / bolt 5"
    assert matching.same_region("bolt 2", five)
    assert not matching.same_region("bolt 2", f"{five} / bolt 6")
    answer = {"geometry": "screw_box", "noise": [1e-3], "kind": "single", "final_only": False}
    soft = {"name": "soft_face", "region": "joint 3", "params": {}}
    region = matching.opened({**answer, "effects": [soft]})["effects"][0]["region"]
    assert matching.same_region(region, "left and lid") and "joint 3" in region
    assert not matching.same_region(region, "base and left")
    assert matching.same_cause("modulus", "modulus error")
    assert matching.same_cause("gasket", "joint compliance that falls with the pressure")
    assert matching.same_cause("hard_spot", "local gain of stiffness")
    assert not matching.same_cause("lining", "added mass")
    assert not matching.same_cause("modulus", "modulus error of all parts")
    assert matching.cause_of("clamp compliance") == "clamp"
