"""Units: a bounded grammar stands before the library that computes with them."""

from __future__ import annotations

import math
import re
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_test_data
from fenics_joints.response.units import frf_unit
from fenics_joints.units import plain_number, to_si

#: Newton metres, by the definitions of the pound (0.45359237 kg), of its weight (9.80665 N/kg), of
#: the inch and of the foot.
NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "ozf": 4.4482216152605 / 16}
METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("1 N/(mm·mm)", "Pa", 1e6),
        ("1 N·mm⁻²", "Pa", 1e6),
        ("3 (s^2)^(-1/2)", "1/s", 3.0),
        ("2 s**-1", "1/s", 2.0),
        ("3 (kHz^2)^(1/2)", "Hz", 3000.0),
        ("0.5 rad/s", "1/s", 0.5),
        ("12 N m s/rad", "N*m*s", 12.0),
        ("2 lb/in", "N/m", 2 * 4.4482216152605 / 0.0254),
        ("3 lb/in3", "kg/m3", 3 * 0.45359237 / 0.0254**3),
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
        "1 m**9**9**9",
        "1 m^9^9^9",
        "1 m^(9)^(9)^(9)",
        "1 m**(9**9**9)",
        "1 9**9**9*m",
        "1 (((((m^9)^9)^9)^9)^9)^9",
        "1 1^9^9^9",
        "1 m⁹⁹⁹⁹⁹⁹⁹⁹⁹",
        "1 m^(9/9)^9^9**9",
        "1 m.real",
        "1 m+m",
        "1 m(",
        "1 " + "m*" * 1000 + "m",
        "1 " + "(" * 90,
        "1" * 5000 + " m",
        "1" * 50_000 + "\n\nx",
        "1e999 m",
        10**400,
    ],
)
def test_nothing_else_is_computed(text):
    """Powers of powers take for ever (9**9**9 has 369,693,100 digits) where they are computed."""
    start = time.perf_counter()
    with pytest.raises(InputError, match="expected") as refused:
        to_si(text, "m")
    with pytest.raises(InputError, match="expected"):
        frf_unit(str(text)[2:])
    assert time.perf_counter() - start < 5.0 and len(str(refused.value)) < 300


@settings(deadline=None, derandomize=True)
@given(
    st.sampled_from(sorted(NEWTONS)),
    st.sampled_from(sorted(METRES)),
    st.booleans(),
    st.sampled_from("-*·.⋅ ") | st.just(""),
    st.floats(1e-3, 1e3),
)
def test_torques_in_every_spelling(force, arm, first, sign, value):
    """Force by arm or arm by force: N-m, lbf.ft, in·lb, Nmm; pounds are their weight."""
    if not sign and (("N" in force) != ("m" in arm) or ("N" in force and not first)):
        sign = "-"  # kNm and ftlbf are written; mN is a force
    expected = value * NEWTONS[force] * METRES[arm]
    for word in {force, force.replace("f", "")}:
        unit = sign.join((word, arm) if first else (arm, word))
        assert to_si(f"{value!r} {unit}", "N*m") == pytest.approx(expected, rel=1e-12), unit


@settings(deadline=None, derandomize=True)
@given(
    st.text(alphabet="NmHzsradlbfinoz·*/-.^() 0123456789µ%", max_size=20),
    st.sampled_from(["N*m", "Hz", "m", "", "Pa"]),
)
def test_any_text_is_a_unit_or_an_input_error(text, unit):
    try:
        one = to_si(f"1 {text}", unit)
    except InputError:
        return
    assert math.isfinite(one)
    if re.match(r"[\sa-zA-Zµ(]", text):  # else it may go on with the number
        assert one > 0 and to_si(f"2 {text}", unit) == pytest.approx(2 * one)


@pytest.mark.parametrize(
    "unit", ["1/s", "s^-1", "Bq", "rpm", "rad/s", "deg/s", "rad Hz", "cycles/s", "1/min"]
)
def test_what_is_no_frequency_in_hertz(unit):
    """Rates have its dimension, and would be wrong by 2 pi, 60 or 360."""
    with pytest.raises(InputError, match="expected"):
        to_si(f"1 {unit}", "Hz")


@pytest.mark.parametrize("text", ["500 lb", "3 oz"])
def test_a_mass_alone_is_no_force(text):
    with pytest.raises(InputError, match="expected"):
        to_si(text, "N")


@pytest.mark.parametrize("unit", ["bananas", "N", "lb", "Nm2"])
def test_head_of_a_torque_has_a_unit_of_torque(tmp_path, unit):
    table = tmp_path / "f.csv"
    table.write_text(f"torque [{unit}], a [Hz]\n5, 100\n10, 110\n")
    with pytest.raises(InputError, match=rf"torque.*\[?{unit}"):
        read_test_data(table, condition="torque", noise=1e-3)
    table.write_text("torque [in-lb], a [Hz]\n5, 100\n10, 110\n")
    assert read_test_data(table, condition="torque", noise=1e-3).condition_unit == "in-lb"


def test_numbers_of_tables_have_no_underscores(tmp_path):
    table = tmp_path / "f.csv"
    table.write_text("torque [N·m], a [Hz]\n5, 1_00\n10, 110\n")
    with pytest.raises(InputError, match="1_00"):
        read_test_data(table, condition="torque", noise=1e-3)
    with pytest.raises(ValueError):
        plain_number("1_00")
