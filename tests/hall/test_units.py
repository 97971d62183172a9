"""Units: a bounded grammar stands before the library that computes with them."""

from __future__ import annotations

import time

import pytest

from fenics_joints.errors import InputError
from fenics_joints.response.units import frf_unit
from fenics_joints.units import to_si


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("1 N/(mm·mm)", "Pa", 1e6),
        ("1 N·mm⁻²", "Pa", 1e6),
        ("3 (s^2)^(-1/2)", "Hz", 3.0),
        ("2 s**-1", "Hz", 2.0),
        ("4 m**0.5*m**0.5", "m", 4.0),
        ("7 newton per meter", "N/m", 7.0),
        ("1.5 kg·m²", "kg*m2", 1.5),
        ("1 1/(m s) Pa s m", "Pa", 1.0),
    ],
)
def test_what_people_write(text, unit, expected):
    """Each by hand: a product, a quotient, a power, brackets."""
    assert to_si(text, unit) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "1 m**9**9**9", "1 m^9^9^9", "1 m^(9)^(9)^(9)", "1 m**(9**9**9)", "1 9**9**9*m",
        "1 (((((m^9)^9)^9)^9)^9)^9", "1 1^9^9^9", "1 m⁹⁹⁹⁹⁹⁹⁹⁹⁹", "1 m^(9/9)^9^9**9", "1 m.real",
        "1 m+m", "1 m(", "1 " + "m*" * 1000 + "m", "1 " + "(" * 90, "1" * 5000 + " m",
        "1" * 50_000 + "\n\nx", "1e999 m", 10**400,
    ],
)  # fmt: skip
def test_nothing_else_is_computed(text):
    """Powers of powers take for ever (9**9**9 has 369,693,100 digits) where they are computed."""
    start = time.perf_counter()
    with pytest.raises(InputError, match="expected") as refused:
        to_si(text, "m")
    with pytest.raises(InputError, match="expected"):
        frf_unit(str(text)[2:])
    assert time.perf_counter() - start < 5.0 and len(str(refused.value)) < 300
