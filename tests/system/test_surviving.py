"""The list of tests that any rewriting has to leave."""

from __future__ import annotations

import runpy
from pathlib import Path

SURVIVING = runpy.run_path(str(Path(__file__).parents[1] / "surviving.py"))


def test_each_is_still_there_and_the_list_is_whole():
    listed = set(SURVIVING["listed"]())
    assert SURVIVING["gone"]() == []
    assert sorted(set(SURVIVING["reasons"]()) - listed) == [], "python3 tests/surviving.py --write"


def test_those_on_two_ranks_are_what_pytest_marks():
    """By the sources' text, beside what the syntax trees say."""
    texts = {p: p.read_text(encoding="utf-8") for p in Path(__file__).parents[1].rglob("test_*.py")}
    at_all = {p.name for p, text in texts.items() if f"mark.{'parallel'}" in text}
    kept = {name for name, why in SURVIVING["listed"]().items() if "two ranks" in why}
    assert {Path(name.split("::")[0]).name for name in kept} == at_all - {Path(__file__).name}
