"""The page and the summary of an update on frequencies."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page, check_page
from rich.console import Console

from fenics_joints import formatting
from fenics_joints.commands.update.document import (
    curve_line,
    parameter_rows,
    update_document,
    verdict_words,
)
from fenics_joints.commands.update.result import (
    Functions,
    ModeTable,
    Sweep,
    UpdateReport,
    parameter_records,
)
from fenics_joints.measurements.gap import Gap
from fenics_joints.modal.sensitivity import Identifiability
from fenics_joints.report.html import as_page
from fenics_joints.report.terminal import show
from fenics_joints.updating import Iteration, Prediction, Update
from fenics_joints.updating.residuals import Widths
from fenics_joints.updating.result import fit_notes

MODES = ("bending 1", "bending <2>")
TORQUES = np.array([2.0, 10.0, 22.0])
TEST = np.array([[375.04, 962.47], [412.56, np.nan], [424.80, 1012.51]])


def report(**changes) -> UpdateReport:
    """An update at 2 N m, at all torques, and as a curve."""
    fits = [
        {
            "condition": t,
            "parameters": {"near.E": 1e8 * t**0.5},
            "sd": {"near.E": 0.08},
            "frequencies_hz": [400.0, 1000.0],
            "errors_percent": [0.5, None if i == 1 else -0.25],
            "held_out": i == 1,
        }
        for i, t in enumerate(TORQUES)
    ]
    curves = [{"name": "near.E", "form": "a (T/T0)^b", "T0": 4.0, "a": 2e8, "b": 0.5}]
    on_curves = Gap(TORQUES, MODES, TEST, 1.005 * np.nan_to_num(TEST, nan=990.0))
    found = Identifiability(("near.E",), 1.0, 1.0, np.array([0.1]), np.ones(1), ())
    errors = np.full(2, 0.02), (np.nan, np.nan)
    update = Update(
        "log",
        ("near.E",),
        np.array([3e9]),
        np.array([8.63e8]),
        np.array([[(0.081 * 8.63e8) ** 2]]),
        found,
        True,
        "converged",
        7,
        tuple(Iteration(np.array([E]), *errors, False, 1.0, 1.0, 1.0) for E in (3e9, 8.63e8)),
        Prediction(1.02 * TEST[0], np.ones((2, 1))),
        3.0,
        1,
    )
    values = dict(
        title="Plates",
        condition=("torque", 2.0, "N·m"),
        kinds=("frequencies",),
        update=update,
        parameters=parameter_records(update, ["Pa"], [3e9]),
        modes=ModeTable(TEST[0], 1.1 * TEST[0], 1.02 * TEST[0], np.ones(2, dtype=bool), MODES),
        functions=None,
        held=[],
        pull=2.3,
        model={"dofs": 21345},
        published={
            "source": "paper",
            "parameters": {"near.E": 8.7e8},
            "model_hz": [380.0, 970.0],
            "frequencies_hz": [375.0, None],
            "errors_percent": [1.3333, None],
        },
        sweep=Sweep(fits, curves, on_curves, None, np.full((3, 2), 0.01)),
    )
    return UpdateReport(**{**values, **changes})


def page_of(report: UpdateReport) -> str:
    return as_page(update_document(report))


def summary(found: UpdateReport, width: int = 100) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    show(console, update_document(found))
    return console.export_text()


def test_update_page_shows_the_numbers_of_the_result(keeps_rules):
    check_page(page_of(report()))
    keeps_rules(page_of(report()))
    shown = Page(page_of(report()))
    row = shown.tables["values"][1]
    assert row == ["near.E", "3.000 GPa", "863.0 MPa", "8.1 %", "870.0 MPa"]
    assert shown.column("published", 3) == ["+1.33 %", formatting.MISSING]
    # The curve goes through the points that were made on it: 2e8 (T / 4)^0.5 = 1e8 T^0.5.
    (panel,) = parameter_rows(report())
    x, line = panel["curve"]
    np.testing.assert_allclose(np.interp(panel["x"], x, line), panel["value"], rtol=1e-3)
    formula = {"name": "near.E", "form": "3 near.G s/(1 + s)", "T0": 4.0, "a": 2e8, "b": 0.5}
    assert curve_line(formula, TORQUES) is None
    x, line = curve_line({**formula, "samples": [[2.0, 5.0], [22.0, 6.0]]}, TORQUES)
    assert list(x) == [2.0, 22.0] and list(line) == [5.0, 6.0]
    assert shown.column("fits", 0) == ["2 N·m", "10 N·m *", "22 N·m"]
    assert shown.column("fits", 3) == ["-0.25 %", formatting.MISSING, "-0.25 %"]
    assert shown.texts["gap-after"] == "2.00 %"
    assert "from 10.00 % to 2.00 %" in verdict_words(report())
    bare = page_of(report(sweep=None, published=None))
    assert "fits" not in Page(bare).tables
    alone = Sweep(report().sweep.fits[:1], [], None, None, np.full((1, 2), 0.01))  # and no curves
    check_page(page_of(report(sweep=alone)))


def test_json_holds_what_the_command_line_promises_and_the_summary_fits_a_screen():
    data = json.loads(json.dumps(report().to_json(), allow_nan=False))
    assert data["condition"] == {"name": "torque", "value": 2.0, "unit": "N·m"}
    assert data["frequencies_hz"]["test"] == [375.04, 962.47] and data["iterations"] == 7
    np.testing.assert_allclose(data["errors_percent"], [2.0, 2.0])
    np.testing.assert_allclose(data["errors_before_percent"], [10.0, 10.0])
    assert data["torque_fits"][1]["held_out"] and data["curves"][0]["T0"] == 4.0
    gaps = data["curve_gap"]
    assert gaps["validation"] is None
    np.testing.assert_allclose([gaps["fitted"], gaps["heldout"]], 0.005)
    assert len(repr(report())) <= 120 and len(repr(report().update)) <= 120
    for width in (80, 100):
        lines = summary(report(), width).splitlines()
        assert len(lines) <= 40 and max(map(len, lines)) <= width


def test_held_out_errors_stand_in_the_headline_and_larger_ones_in_the_first_line():
    def held(predicted: float) -> UpdateReport:
        names = dict(before_hz=1.04 * 375.04, predicted_hz=predicted * 375.04, test_hz=375.04)
        row = dict(name=MODES[0], error_percent=100 * (predicted - 1), alone=True, **names)
        return report(held=[row])

    worse, better = held(1.05), held(1.03)
    first, *rest = summary(worse).splitlines()
    assert "worse on held-out data" in first and "worse" not in summary(better)
    assert any("from 4.00 % to 5.00 %" in line for line in rest[:4])
    verdict = page_of(worse).partition('id="verdict"')[2].partition("</div>")[0]
    assert "worse on held-out data" in verdict and "from 4.00 % to 5.00 %" in verdict
    shown = Page(page_of(better))
    assert shown.texts["held-rms"] == "3.00 %"
    assert worse.held_changes()["frequencies"] == pytest.approx((0.04, 0.05))


def test_held_out_functions_and_ratios_count_where_they_are_data():
    measured = np.ones((3, 1, 1), dtype=complex)
    held = np.array([False, False, True])[:, None, None]
    functions = Functions(
        np.arange(3.0),
        measured,
        2 * measured,
        4 * measured,
        np.ones(3, dtype=bool),
        held,
        "m/s2/N",
        (("1:+z",), ("1:+z",)),
        0.0,
    )
    row = dict(name="x", test_hz=None, before_hz=100.0, predicted_hz=100.0, damping_test=0.01)
    row |= dict(damping_before=0.012, damping_predicted=0.011)
    found = report(functions=functions, held=[row]).held_changes()
    assert found["damping ratios"] == pytest.approx((0.2, 0.1)) and "frequencies" not in found
    assert found["FRFs"] == pytest.approx((20 * np.log10(2), 20 * np.log10(4)))


def test_modes_whose_partners_change_are_said_once_and_with_the_reason():
    found = replace(report().update, widths=Widths(without=(0, 1)))
    (note,) = fit_notes(found, ("mode 1", "mode 2"))
    assert note.startswith("mode 1 and mode 2 change their partners among the model's modes")
    unfitted = replace(report().modes, fitted=np.zeros(2, dtype=bool))
    said = summary(report(update=found, modes=unfitted, notes=[note]))
    assert said.index("note: mode 1 and mode 2") < said.index(
        "* its frequency was not fitted: left out for the reason given above"
    )
