"""Numbers and quantities in words."""

from __future__ import annotations

import pytest

from fenics_joints import formatting


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (6.6e11, "Pa/m", "660 GPa/m"),
        (0.16, "kg", "160 g"),
        (999.6, "N/m", "1.00 kN/m"),
        (20.0, "N·m", "20.0 N·m"),
        (2750.0, "kg/m3", "2750 kg/m³"),
        (0.42, "", "0.420"),
        (-3.2e-9, "", "-3.20e-9"),
        (float("nan"), "Pa", "–"),
    ],
)
def test_quantities(value, unit, text):
    assert formatting.quantity(value, unit) == text


def test_lengths_have_the_digits_that_are_known_of_them():
    """To a ten-thousandth of the structure or better, a micrometre at least; -0 is 0."""
    rows = {-1.31e-6: "0", 0.02485: "24.85", -0.1: "-100", 0.0123456: "12.35", -0.0: "0"}
    assert {x: formatting.length_mm(x, 0.26) for x in rows} == rows
    assert formatting.length_mm(-1.31e-6, 0.0) == "-0.001"
    assert [formatting.length_mm(1.23456789, size) for size in (0.0015, 2.0, 15.0)] == [
        "1234.568",
        "1234.6",
        "1235",
    ]
    assert formatting.extents([0.508, 0.0254, -1.3e-18]) == "508 x 25.4 x 0 mm"
    assert formatting.extents([2.0, 1.0, 5e-4]) == "2.00 x 1.00 x 0.000500 m"


def test_points_in_millimetres():
    assert formatting.point_mm([-4e-4, 0.128, 0.0476]) == "(0, 128, 48)"
