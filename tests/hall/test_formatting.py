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


def test_points_in_millimetres():
    assert formatting.point_mm([-4e-4, 0.128, 0.0476]) == "(0, 128, 48)"
