"""The page and the summary of an update on frequencies."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
from html_page import Page, check_page
from rich.console import Console

from fenics_joints import formatting
from fenics_joints.commands.update import sweep_page
from fenics_joints.measurements import Gap
from fenics_joints.modal import Identifiability

MODES = ("bending 1", "bending <2>")
TORQUES = np.array([2.0, 10.0, 22.0])
TEST = np.array([[375.04, 962.47], [412.56, np.nan], [424.80, 1012.51]])


def update(**changes) -> SimpleNamespace:
    one = Gap(TORQUES[:1], MODES, TEST[:1], 1.02 * TEST[:1])
    fits = [
        {"condition": t, "parameters": {"near.E": 1e8 * t**0.5}, "sd": {"near.E": 0.08},
         "frequencies_hz": list(TEST[i]), "errors_percent": [0.5, None if i == 1 else -0.25],
         "held_out": i == 1}
        for i, t in enumerate(TORQUES)
    ]  # fmt: skip
    values = dict(
        title="Plates", condition=("torque", "N·m"), at=2.0, message="Converged.", iterations=7,
        parameters=[{"name": "near.E", "value": 8.63e8, "unit": "Pa", "sd": 0.081, "start": 3e9}],
        gap_before=Gap(TORQUES[:1], MODES, TEST[:1], 1.1 * TEST[:1]), gap_after=one,
        published={"source": "paper", "parameters": {"near.E": 8.7e8}, "model_hz": [380.0, 970.0],
                   "frequencies_hz": [375.0, None], "errors_percent": [1.3333, None]},
        identifiability=Identifiability(("near.E",), 1.0, 1.0, np.array([0.1]), np.ones(1), ()),
        torque_fits=fits,
        curves=[{"name": "near.E", "form": "a (T/T0)^b", "T0": 4.0, "a": 2e8, "b": 0.5}],
        curve_gap_fitted=0.0091, curve_gap_heldout=0.0113, curve_gap_validation=None,
        curve_frequencies=Gap(TORQUES, MODES, TEST, 1.005 * np.nan_to_num(TEST, nan=990.0)),
        validation=None, model={"dofs": 21345},
    )  # fmt: skip
    return SimpleNamespace(**{**values, **changes})


def test_page_is_well_formed_and_stands_alone():
    check_page(sweep_page.update_html(update()))


def test_update_page_shows_the_numbers_of_the_result():
    page = Page(sweep_page.update_html(update()))
    row = page.tables["values"][1]
    assert row == ["near.E", "3.00 GPa", "863 MPa", "8.1 %", "870 MPa"]
    assert page.column("published", 3) == ["+1.33 %", formatting.MISSING]
    # The curve goes through the points that were made on it: 2e8 (T / 4)^0.5 = 1e8 T^0.5.
    (panel,) = sweep_page.parameter_rows(update())
    x, line = panel["curve"]
    np.testing.assert_allclose(np.interp(panel["x"], x, line), panel["value"], rtol=1e-3)
    formula = {"name": "near.E", "form": "3 near.G s/(1 + s)", "T0": 4.0, "a": 2e8, "b": 0.5}
    assert sweep_page.curve_line(formula, TORQUES) is None
    x, line = sweep_page.curve_line({**formula, "samples": [[2.0, 5.0], [22.0, 6.0]]}, TORQUES)
    assert list(x) == [2.0, 22.0] and list(line) == [5.0, 6.0]
    assert page.column("fits", 0) == ["2 N·m", "10 N·m *", "22 N·m"]
    assert page.column("fits", 3) == ["-0.25 %", formatting.MISSING, "-0.25 %"]
    assert page.texts["gap-before"] == "10.00 %" and page.texts["gap-after"] == "2.00 %"
    bare = update(torque_fits=[], curves=[], curve_frequencies=None, published=None)
    assert "fits" not in Page(sweep_page.update_html(bare)).tables


def test_summary_fits_a_screen():
    for width in (80, 100):
        console = Console(width=width, record=True, file=io.StringIO())
        sweep_page.show_update(console, update())
        lines = console.export_text().splitlines()
        assert len(lines) <= 40 and max(map(len, lines)) <= width
