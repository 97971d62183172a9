"""Numbers with units, as people write them, to SI."""

from __future__ import annotations

import math
import re
from functools import lru_cache

from fenics_joints.errors import InputError

#: What a unit measures and how one would write it, for messages.
_KINDS = {
    "": ("a ratio", "0.5 %"),
    "m": ("a length", "8 mm"),
    "kg": ("a mass", "20 g"),
    "Pa": ("a modulus", "69 GPa"),
    "kg/m3": ("a density", "2750 kg/m3"),
    "N/m": ("a stiffness", "1 kN/m"),
    "Hz": ("a frequency", "12.5 Hz"),
    "Pa/m": ("a stiffness per area", "1e12 Pa/m"),
    "N": ("a force", "28 kN"),
    "N*m": ("a torque", "25 N m"),
    "N*m*s": ("a damping of rotation", "0.15 N m s"),
    "kg*m2": ("a rotary inertia", "3.5e-6 kg m2"),
    "s": ("a time", "2 us"),
    "1/s": ("a rate", "5 1/s"),
}
#: Largest and, of what must be above zero, smallest quantities, SI: far beyond any structure, and
#: near where the sixteen digits of the solvers end. Of other units as the last.
_MOST = {
    "m": 1e6,
    "kg": 1e12,
    "Pa": 1e20,
    "kg/m3": 1e9,
    "N/m": 1e20,
    "Pa/m": 1e25,
    "N": 1e15,
    "N*m": 1e18,
    "Hz": 1e12,
    "s": 1e12,
    None: 1e30,
}
_LEAST = {
    "m": 1e-9,
    "kg": 1e-12,
    "Pa": 1e-6,
    "kg/m3": 1e-6,
    "N/m": 1e-12,
    "Pa/m": 1e-6,
    "N": 1e-12,
    "Hz": 1e-9,
    None: 1e-30,
}
#: SI units of a model's parameters, by the last part of their name; the others are ratios.
_PARAMETERS = {
    "E": "Pa",
    "G": "Pa",
    "rho": "kg/m3",
    "mass": "kg",
    "stiffness": "N/m",
    "travel": "m",
    "k_n": "Pa/m",
    "k_t": "Pa/m",
    "h": "m",
    "k1": "N*m",
    "k2": "N*m",
    "k_axial": "N/m",
    "c": "N*m*s",
    "alpha": "1/s",
    "beta": "s",
    "relaxation": "s",
}
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
#: Units written without a sign between them, with their meaning. Pint's Nm is a count of yarn.
_JOINED = tuple(
    (re.compile(rf"(?<![^\W\d]){first}{second}(?![^\W\d])"), r"\1*\2")
    for first, second in (
        (r"((?:da|[kMmcdµμ])?N)", "([mc]?m)"),
        ("(in|ft)", "(lbf|lbs?|ozf?)"),
        ("(lbf|lbs?|ozf?)", "(in|ft)"),
    )
)
#: Masses that mean their weight where a mass makes no sense, as in a torque in ft lb.
_WEIGHTS = tuple(
    (re.compile(rf"(?<![^\W\d]){mass}(?![^\W\d])"), force)
    for mass, force in (("(?:lbs?|pounds?)", "lbf"), ("(?:oz|ounces?)", "ozf"))
)
_PRODUCT = str.maketrans("·⋅×−⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "***-0123456789-")
#: Characters of a unit and of a quantity, and how deep a unit's brackets may be nested. Nothing but
#: this grammar reaches pint, which computes 9**9**9 if it is asked to.
_LONGEST, _LONGEST_QUANTITY, _NESTED = 100, 200, 4
#: A power: of one digit, a decimal or a fraction; of nothing that is a power itself.
_POWER = re.compile(
    r"(?<![\s\d*^/(+-])\s*(?:\*\*|\^)\s*"
    r"(?:[+-]?\d(?:\.\d{1,3})?|\(\s*[+-]?\d(?:\.\d{1,3}|\s*/\s*[1-9])?\s*\))"
    r"(?![\d.]|\s*(?:\*\*|\^))"
)
_OPERAND = r"(?:[^\W\d]{1,32}|1(?:\.0)?(?![\w.]))"
_TERMS = re.compile(rf"\s*{_OPERAND}(?:\s*[*/]\s*{_OPERAND}|\s+{_OPERAND})*\s*")
_BRACKETS = re.compile(rf"\({_TERMS.pattern}\)")


def parameter_unit(name: str) -> str:
    """SI unit of a model's parameter, such as ``"N*m"`` of ``lap.k1``; ``""`` for a ratio."""
    return _PARAMETERS.get(name.rpartition(".")[2], "")


def to_si(value: float | str, unit: str) -> float:
    """A number in SI units.

    Args:
        value: Text with a unit, such as ``"8 mm"``, or a bare number, which is in SI units.
        unit: SI unit of the result; ``""`` for a ratio, which may be in per cent.

    Raises:
        InputError: If it is no number, is not finite, or its unit measures something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(_expected(unit))
    if isinstance(value, str):
        match = _NUMBER.fullmatch(value) if len(value) <= _LONGEST_QUANTITY else None
        if not match or (unit and not match[2]):
            raise InputError(_expected(unit))
        value = float(match[1]) * factor_to_si(match[2], unit)
    try:
        value = float(value)
    except OverflowError:  # a whole number beyond the largest float
        value = math.inf
    if not math.isfinite(value):
        raise InputError("expected a finite number")
    return value


def sizes(unit: str) -> tuple[float, float]:
    """The smallest quantity of a unit that is not zero, and the largest, that a structure has."""
    return _LEAST.get(unit, _LEAST[None]), _MOST.get(unit, _MOST[None])


@lru_cache(maxsize=1024)
def factor_to_si(text: str, unit: str) -> float:
    """How many of the SI ``unit`` one of the unit ``text`` is.

    Raises:
        InputError: If the unit is unknown or measures something else.
    """
    if text in ("", "%", "‰"):
        if unit and text:
            raise InputError(_expected(unit))
        return {"": 1.0, "%": 1e-2, "‰": 1e-3}[text]
    problem = None
    for spelt in (text, _spelt(text, (*_JOINED, *_WEIGHTS))) if unit != "N" else (text,):
        try:
            return _factor(spelt, unit)
        except ImportError as error:
            raise InputError(f"units need the package pint: {error}") from error
        except Exception as error:  # pint, its tokenizer and Python's raise many kinds
            problem = problem or error
    shown = text if len(text) <= 40 else f"{text[:37]}..."
    if unit == "Hz":  # angles per second, and turns per minute, would pass for a frequency
        reason = f"the unit {shown!r} is not one of cycles per second"
    else:
        reason = f"the unit {shown!r} measures something else or is unknown"
    raise InputError(f"{_expected(unit)} ({reason})") from problem


def _factor(text: str, unit: str) -> float:
    """Factor from the unit ``text`` to ``unit``; raises exceptions of any kind if there is none."""
    quantity = _registry().Quantity
    given, wanted = _parsed(text), _parsed(unit)
    if unit == "Hz":
        # Angles are dimensionless: rad/s and 1/s would pass and be wrong by 2 pi, rpm by 60.
        left = (quantity(1.0, given) / quantity(1.0, wanted)).to_root_units().unit_items()
        if left or "hertz" not in str(given):
            raise InputError("expected cycles per second")
    return float(quantity(1.0, given).to(wanted).magnitude)


def plain_number(text: str) -> float:
    """A number as in tables; Python's ``1_00`` is not one.

    Raises:
        ValueError: If the text is not a number.
    """
    if "_" in text:
        raise ValueError(text)
    return float(text)


def _spelt(text: str, spellings) -> str:
    for pattern, meant in spellings:
        text = pattern.sub(meant, text)
    return text


def _parsed(text: str):
    text = re.sub(r"(?<=[^\W\d])\s*[-.]\s*(?=[^\W\d])", "*", text.translate(_PRODUCT))
    text = _spelt(text, _JOINED)
    text = re.sub(r"(?<=[A-Za-z])\^?(-?\d)", r"**\1", text)
    if not _is_unit(text):
        raise InputError("expected names of units, multiplied, divided, with powers of one digit")
    return _registry().parse_units(text)


def _is_unit(text: str) -> bool:
    """Whether a text is a product of units, whose evaluation is quick whatever they are."""
    if len(text) > _LONGEST:
        return False
    text = _POWER.sub("", text)
    for _ in range(_NESTED):
        text = _BRACKETS.sub(" x ", text)
    return bool(_TERMS.fullmatch(text))


@lru_cache(maxsize=1)
def _registry():
    # Half a second, so only when a unit is read.
    import pint

    return pint.UnitRegistry()


def _expected(unit: str) -> str:
    kind, example = _KINDS.get(unit, ("a number", f"1 {unit}"))
    bare = f"a bare number in {unit}" if unit else "a bare number"
    return f"expected {kind} with its unit, such as {example!r}, or {bare}"
