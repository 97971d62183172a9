"""The page and the summary of modes."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
from cell_map import cells
from html_page import Page, check_page
from markupsafe import Markup
from rich.console import Console

from fenics_joints.commands.modes.page import modes_html
from fenics_joints.commands.modes.result import ModeList
from fenics_joints.commands.modes.summary import show_modes
from fenics_joints.report import mesh_pictures


class Modes(SimpleNamespace):
    def __len__(self) -> int:
        return len(self.frequencies_hz)


def mode_list(frequencies_hz=(1e-6, 2e-6, 423.123, 800.5), n_rigid=2, seen=True) -> ModeList:
    """Modes of which the test saw those below 500 Hz, if it is known what it saw."""
    f = np.array(frequencies_hz)
    modes = Modes(frequencies_hz=f, n_rigid=n_rigid, model=SimpleNamespace(n_dofs=21345))
    case = SimpleNamespace(title="Plates <i>", name="Plates <i>")
    return ModeList(case, modes, np.where(f < 500, 1.0, 0.0) if seen else None)


def modes_page_text() -> str:
    shape = mesh_pictures.mode_shape(cells().vertices, cells().vertices, (0, 0, 1), "m7", "shape")
    return modes_html(mode_list(), {2: Markup(shape)})


def test_page_is_well_formed_and_stands_alone():
    check_page(modes_page_text())


def test_page_keeps_the_rules(browser, tmp_path):
    browser.check(modes_page_text(), tmp_path)


def test_modes_page_says_what_the_test_saw():
    page = Page(modes_page_text())
    assert page.column("modes", 1) == ["0.00", "0.00", "423.12", "800.50"]
    kinds = ["rigid body", "rigid body", "seen by the test", "not seen by the test"]
    assert page.column("modes", 2) == kinds
    assert page.texts["visible"] == "1"


def test_summary_fits_a_screen():
    for width in (80, 100):
        console = Console(width=width, record=True, file=io.StringIO())
        show_modes(console, mode_list(np.arange(40.0), 6, seen=False))
        lines = console.export_text().splitlines()
        assert len(lines) <= 40 and max(map(len, lines)) <= width
