"""Rows of docs/nonlinear_checks.md: cases whose numbers are held to others' and to the page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "nonlinear_checks.md"


@dataclass(frozen=True)
class Case:
    """One row: what, whose, their number, ours, and how near they have to be."""

    name: str
    source: str
    theirs: Callable[[], float]
    ours: Callable[[], float]
    near: float


def rows() -> dict[str, list[str]]:
    """Cells of the page's table by case."""
    lines = [
        line.strip("| ").split(" | ")
        for line in PAGE.read_text("utf-8").splitlines()
        if line.startswith("| ")
    ]
    return {cells[0].strip(): [c.strip() for c in cells] for cells in lines if len(cells) == 4}


def hold(case: Case) -> None:
    """Our number is theirs, and the page tells both."""
    theirs, ours = float(case.theirs()), float(case.ours())
    assert ours == pytest.approx(theirs, rel=case.near)
    _, source, told, found = rows()[case.name]
    assert source == case.source
    assert float(told) == pytest.approx(theirs, rel=1e-5)
    assert float(found) == pytest.approx(ours, rel=max(1e-5, 0.1 * case.near))


def show(cases: Sequence[Case]) -> None:
    """Print rows of the table."""
    for one in cases:
        try:
            cells = one.name, one.source, f"{float(one.theirs()):.7g}", f"{float(one.ours()):.7g}"
        except Exception as error:
            cells = one.name, one.source, "failed", repr(error)
        sys.stdout.write("| " + " | ".join(cells) + " |\n")
        sys.stdout.flush()
