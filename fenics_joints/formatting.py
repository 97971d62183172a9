"""Numbers as people read them: SI prefixes, a dash for what is missing."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Sequence

#: Probabilities are shown between these, and why.
LEAST, MOST = 0.01, 0.99
LIMITS = (
    "Probabilities are shown between 1 and 99 %: no model of a structure is known so well that "
    "more could be said."
)
#: Probabilities of a misfit by chance below this are not told apart: noise is not that normal.
_RARE = 1e-3
#: Shown where there is no number.
MISSING = "–"

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
#: Units whose first symbol takes a prefix; others are written as they are.
_PREFIXED = ("Pa", "N/m", "m", "g", "Hz", "N", "s", "W", "J")
_PLAIN = {"kg/m3": "kg/m³", "kg/m^3": "kg/m³", "N m": "N·m", "Nm": "N·m", "N*m": "N·m"}
#: What a terminal obeys instead of showing it, and what turns the order of letters round; not line
#: breaks and tabs.
_CONTROL = re.compile(
    "\r(?!\n)|[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)


def control_character(text: str) -> str:
    """The first control character of a text, as ``U+001B``; empty if there is none."""
    found = _CONTROL.search(text)
    return f"U+{ord(found[0]):04X}" if found else ""


def printable(text: str) -> str:
    """A text whose control characters are shown as their codes, such as ``\\x1b``."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def first_of(items: Sequence[object], most: int = 12, comma: str = ", ") -> str:
    """The first of many things, and how many more there are."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return comma.join(map(str, items[:most])) + more


def _missing(value) -> bool:
    return value is None or not math.isfinite(value)


def number(value: float | None, digits: int = 3) -> str:
    """A number with a fixed count of significant digits, without an exponent where it can be."""
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -4 <= exponent < 6:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(power)}"
    return f"{value:.{max(digits - 1 - exponent, 0)}f}"


def quantity(value: float | None, unit: str = "", digits: int = 3) -> str:
    """A number with its unit and an SI prefix: 6.6e11 Pa/m is ``660 GPa/m``, 0.16 kg ``160 g``.

    Args:
        value: In SI units; None or nan gives a dash.
        unit: SI unit; ``""`` for a ratio.
        digits: Significant digits.
    """
    if _missing(value):
        return number(value, digits)
    factor, unit = prefixed(value, unit, digits)
    return f"{number(value * factor, digits)} {unit}".rstrip()


def point_mm(point_m: Sequence[float]) -> str:
    """A point, m, in whole millimetres, without its unit: ``(120, 40, 16)``."""
    return f"({', '.join(f'{round(1e3 * float(x)):d}' for x in point_m)})"


def extents(size_m: Sequence[float]) -> str:
    """The extents of a body, m, in the unit that suits the largest: ``200 x 160 x 171 mm``."""
    size = float(max(size_m))
    factor, unit = prefixed(size, "m")
    known = [float(length_mm(s, size)) * 1e-3 for s in size_m]
    return " x ".join(number(s * factor) for s in known) + f" {unit}"


def length_mm(length_m: float, size_m: float) -> str:
    """A coordinate or a distance, m, in millimetres without its unit: ``24.85``; never ``-0``.

    To a ten-thousandth of the structure's size or better, as far as a mesh knows it, and not below
    1 um.

    Args:
        length_m: The length.
        size_m: Size of the structure, m; 0 where it is not known.
    """
    power = math.floor(math.log10(1e-1 * size_m)) if size_m > 0 else -3
    digits = min(max(-power, 0), 3)
    words = f"{round(1e3 * float(length_m), digits) + 0.0:.{digits}f}"
    return words.rstrip("0").rstrip(".") if digits else words


def prefixed(value: float, unit: str, digits: int = 3) -> tuple[float, str]:
    """Factor and unit with the SI prefix that suits a value: 6.6e11, Pa gives 1e-9, GPa."""
    unit, factor = _PLAIN.get(unit, unit), 1.0
    if unit == "kg":
        unit, factor = "g", 1e3
    if value == 0 or (unit not in _PREFIXED and unit.split("/")[0] not in _PREFIXED):
        return factor, unit
    rounded = abs(float(f"{value * factor:.{digits - 1}e}"))
    power = min(max(3 * math.floor(math.log10(rounded) / 3), -12), 12)
    if unit == "g":
        power = min(power, 3)
    return factor / 10.0**power, f"{_PREFIXES[power]}{unit}"


def interval(low: float | None, high: float | None, unit: str = "") -> str:
    """Two quantities, the unit once if it is the same: ``510 to 860 GPa/m``."""
    first, last = quantity(low, unit), quantity(high, unit)
    value, _, shared = first.partition(" ")
    return f"{value if shared and last.endswith(' ' + shared) else first} to {last}"


def percent(ratio: float | None, digits: int = 2, *, sign: bool = False) -> str:
    """A ratio in per cent with ``digits`` decimals."""
    if _missing(ratio):
        return MISSING
    # Rounded first, then 0 added, so that no small negative number becomes a negative zero.
    return f"{round(100 * ratio, digits) + 0.0:{'+' if sign else ''}.{digits}f} %"


def error_percent(error: float | None) -> str:
    """A relative error in per cent; above 100 % its size says no more than that it is no answer."""
    return percent(error) if _missing(error) or error <= 1 else "over 100 %"


def spread(log_sd: float | None) -> str:
    """A standard deviation of a logarithm: per cent while small, else as a factor either way."""
    if _missing(log_sd):
        return number(log_sd)
    return percent(log_sd, 1) if log_sd < 0.3 else f"factor {number(math.exp(log_sd), 2)}"


def probability(p: float | None) -> str:
    """A probability in whole per cent, nearer to 0 or 1 than `LEAST` and `MOST` as a bound."""
    if _missing(p):
        return MISSING
    p = round(p, 2)
    if p < LEAST:
        return f"< {100 * LEAST:.0f} %"
    return f"> {100 * MOST:.0f} %" if p > MOST else f"{100 * p:.0f} %"


def bounded(p: float) -> float:
    """A probability between `LEAST` and `MOST`; nan stays."""
    return min(max(p, LEAST), MOST) if math.isfinite(p) else p


def p_value(p: float | None) -> str:
    """Probability of as much by chance; what is too small to matter is shown as a bound."""
    if _missing(p):
        return MISSING
    return f"< {_RARE:g}" if p < _RARE else number(min(p, 1.0), 2)


def hertz(frequency: float | None) -> str:
    """A frequency to a hundredth of a hertz, without the unit."""
    return MISSING if _missing(frequency) else f"{frequency:.2f}"


def condition_value(value: float, unit: str = "") -> str:
    """A torque or other condition, such as ``20 N·m``."""
    return f"{value:g} {_PLAIN.get(unit, unit)}".rstrip()


def spaced(name: str) -> str:
    """A name from a case file in words: ``bolts_and_nuts`` is ``bolts and nuts``."""
    return name.replace("_", " ")


def html_table(caption: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A short table as HTML for a notebook, all of its texts escaped.

    Args:
        caption: Above it.
        head: Of the columns.
        rows: Texts, each as many as there are columns.
    """

    def row(kind: str, texts: Sequence[str]) -> str:
        return f"<tr>{''.join(f'<{kind}>{html.escape(str(t))}</{kind}>' for t in texts)}</tr>"

    body = "".join(row("td", texts) for texts in rows)
    return (
        f"<table><caption>{html.escape(caption)}</caption><thead>{row('th', head)}</thead>"
        f"<tbody>{body}</tbody></table>"
    )
