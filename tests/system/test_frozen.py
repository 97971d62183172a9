"""The table of frozen numbers: what counts as moved, and that the table is whole."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
FROZEN = runpy.run_path(str(TESTS / "frozen.py"))
printed, moved, of_json = (FROZEN[name] for name in ("printed", "moved", "of_json"))

BEFORE = """
measured, Hz         424.91   1,012.50
E = 6.90e10 Pa of plate_1, M10: 3 of 6
"""


@pytest.mark.parametrize(
    ("after", "lines"),
    [
        (BEFORE, 0),
        ("The test has 424.92 Hz,\nthen 1,012.5; E is 6.91e10 Pa by 3\nof the 6.", 0),
        (BEFORE.replace("424.91", "424.95"), 1),
        (BEFORE.replace("e10", "e11"), 1),
        (BEFORE.replace("   1,012.50", ""), 1),
        ("", 5),
    ],
    ids=["same", "other words", "one", "power", "one is gone", "nothing"],
)
def test_words_may_change_and_numbers_not(after, lines):
    found = moved(printed(BEFORE, "exact"), printed(after, "exact"), False)
    assert len(found) == lines
    if "424.95" in after:
        assert "424.95" in found[0] and "424.91" in found[0]


def diagnosis(verdict="cause", modulus=0.7, other=0.3, value=1.2):
    factor = {"effect": "modulus (stem)", "name": "factor", "nuisance": False}
    factor |= {"value": value, "low": 1.1, "high": 1.3}
    hypothesis = {"label": "modulus", "probability": modulus, "parameters": [factor]}
    effects = [("modulus", "stem", modulus), ("no gap", "", other), ("mass", "bolts", 0.001)]
    return {
        "verdict": verdict,
        "gap": {"before": 0.05, "after": 0.01, "noise": 1e-3, "seconds": 3},
        "effects": [
            {"name": n, "region": r, "probability": p, "class": f"class of {n}"}
            for n, r, p in effects
        ],
        "hypotheses": [hypothesis],
    }


@pytest.mark.parametrize(
    ("change", "places"),
    [
        ({}, []),
        ({"modulus": 0.69, "other": 0.31, "value": 1.203}, []),
        ({"verdict": "likely"}, ["verdict"]),
        ({"value": 1.23}, ["identified.modulus.modulus (stem), factor.value"]),
        (
            {"modulus": 0.6},
            ["probability.of effect.modulus (stem)", "probability.of class.class of modulus"],
        ),
    ],
)
def test_a_diagnosis_is_compared_by_its_answer(change, places):
    before, after = (of_json("diagnose", diagnosis(**c)) for c in ({}, change))
    assert [line.split(": ")[0] for line in moved(before, after, True)] == places


def test_the_table_is_whole():
    """Every entry is one that runs, every number has a reason, and CI's part is there."""
    table = json.loads((TESTS / "frozen.json").read_text(encoding="utf-8"))
    known = {entry.name: entry for entry in FROZEN["entries"](table)}
    assert set(table["entries"]) <= set(known)
    assert {name for name, entry in known.items() if entry.quick} <= set(table["entries"])
    for entry in table["entries"].values():
        assert entry["numbers"]
        for _, value, may, why in entry["numbers"]:
            assert why in FROZEN["REASONS"] and may >= 0
            assert why == "exact" or isinstance(value, float | int)


def test_forty_cases_are_of_every_kind():
    cases = json.loads((TESTS / "frozen_cases.json").read_text(encoding="utf-8"))
    kinds = {(case["geometry"], case["kind"]) for case in cases}
    assert len({case["id"] for case in cases}) == 40 and len(kinds) == 12
    assert sum(case["seconds"] for case in cases) / 2 < 25 * 60
