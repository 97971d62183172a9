"""The document of modes, as a page and on the terminal; pairs beside a test's modes."""

from __future__ import annotations

import io
import shutil
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
    text = beams.page().html()
    check_page(text)
    keeps_rules(text)
    page = Page(text)
    hz = solve_modes(build_structure(load_case(DEMO), MPI.COMM_SELF), n_modes=30).frequencies_hz
    assert page.column("modes", 1) == ["0.00"] * 3 + [f"{f:.2f}" for f in hz[3:]]
    kinds = page.column("modes", 2)
    assert kinds[:3] == ["rigid body"] * 3
    assert page.texts["visible"] == str(kinds.count("visible to the test"))
    pairs = beams.json()["test"]["pairs"]
    assert page.column("pairs", 2) == [str(pair["mode"]) for pair in pairs]
    errors = np.array([float(e.split()[0]) for e in page.column("pairs", 4)])
    np.testing.assert_allclose(errors, [pair["error_percent"] for pair in pairs], atol=5e-3)
    console = Console(width=80, record=True, file=io.StringIO())
    beams.summary(console)
    text = console.export_text()
    lines = text.splitlines()
    assert "and 10 more" in text and len(lines) <= 40 and max(map(len, lines)) <= 80


#: Plates on a clamped beam: measured torsion of the beam, 859 Hz, which sensors near the middle see
#: faintly, and which is like no mode that they see well.
STACK = Path(__file__).parent / "data" / "stack"


def beside(folder):
    pytest.importorskip("gmsh")
    return run_modes(load_case(folder), MPI.COMM_SELF, Progress(silent=True)).result.beside


def test_a_mode_seen_faintly_is_the_partner_of_the_shape_that_is_like_it():
    """925 Hz, the seventh, with a MAC of 0.99; not 1705 Hz, whose MAC is 0.001."""
    found = beside(STACK)
    assert found.index.tolist() == [0, 1, 3, 4, 5, 6, 7, 8]
    assert found.model_hz[5] == pytest.approx(925.4, rel=0.02)
    assert found.mac.min() > 0.98 and found.partnered.all()
    assert found.rms < 0.04


def test_a_shape_that_is_like_none_has_no_partner(tmp_path):
    """One sensor alone moves: named, null in the JSON, and no part of the error."""
    folder = shutil.copytree(STACK, tmp_path / "stack")
    head, *_ = (folder / "shapes.csv").read_text(encoding="utf-8").splitlines()
    shapes = np.loadtxt(folder / "shapes.csv", delimiter=",", skiprows=1)
    shapes[:, 5] = np.eye(len(shapes))[4]
    np.savetxt(folder / "shapes.csv", shapes, delimiter=",", header=head, comments="")
    found = beside(folder)
    assert found.alone == ("mode 6",) and found.rms < 0.04
    written = found.to_json()
    assert written["without_partner"] == ["mode 6"]
    assert written["pairs"][5]["mode"] is None and written["pairs"][5]["test_hz"] > 0
