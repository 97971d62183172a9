"""The document of modes: as a page, on the terminal."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from html_page import Page, check_page
from mpi4py import MPI
from rich.console import Console

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.modes import run_modes
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress

DEMO = Path(__file__).parents[2] / "demos" / "bolted_beams"

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


def test_page_and_summary_show_the_modes_of_the_model(keeps_rules):
    """Thirty modes of bolted beams, eight of which were measured."""
    beams = run_modes(load_case(DEMO), MPI.COMM_SELF, Progress(silent=True), n_modes=30)
    text = beams.page()
    check_page(text)
    keeps_rules(text)
    page = Page(text)
    hz = solve_modes(build_structure(load_case(DEMO), MPI.COMM_SELF), n_modes=30).frequencies_hz
    assert page.column("modes", 1) == ["0.00"] * 3 + [f"{f:.2f}" for f in hz[3:]]
    kinds = page.column("modes", 2)
    assert kinds[:3] == ["rigid body"] * 3
    assert page.texts["visible"] == str(kinds.count("seen by the test"))
    pairs = beams.json()["test"]["pairs"]
    assert page.column("pairs", 2) == [str(pair["mode"]) for pair in pairs]
    errors = np.array([float(e.split()[0]) for e in page.column("pairs", 4)])
    np.testing.assert_allclose(errors, [pair["error_percent"] for pair in pairs], atol=5e-3)
    console = Console(width=80, record=True, file=io.StringIO())
    beams.summary(console)
    text = console.export_text()
    lines = text.splitlines()
    assert "and 10 more" in text and len(lines) <= 40 and max(map(len, lines)) <= 80
