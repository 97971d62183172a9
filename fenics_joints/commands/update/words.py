"""Sentences on identified parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.formatting import number, spread
from fenics_joints.modal.sensitivity import Identifiability

#: Share of a direction from which a parameter is named in it; chosen.
_NAMED = 0.2
#: Condition number from which a direction is known by rounding alone.
_OPEN = 1e10
#: Standard deviation of a logarithm from which a value is called open; chosen.
_UNKNOWN = 10.0


def in_words(found: Identifiability) -> list[str]:
    """Which parameters the data determine, in sentences."""
    least = int(np.argmax(np.where(np.isfinite(found.sd), found.sd, np.inf)))
    if not found.undetermined:
        words = f"The data alone determine {_and(found.names)}"
        if len(found.names) > 1:
            sd = found.sd[least]
            words += f"; the least well known is {found.names[least]}, to {accuracy(sd)}"
        sentences = [words + "."]
    else:
        rest = [name for name in found.names if name not in found.undetermined]
        open_ = _and(found.undetermined)
        known = f"determine {_and(rest)}, but not {open_}" if rest else f"do not determine {open_}"
        sentences = [f"The data alone {known}."]
    together = _together(found)
    return [*sentences, together] if together else sentences


def _together(found: Identifiability) -> str | None:
    """The direction that the data know least, if several parameters take part in it."""
    parts = sorted(zip(found.weakest, found.names, strict=True), key=lambda p: -abs(p[0]))
    parts = [(float(share), name) for share, name in parts if abs(share) >= _NAMED]
    if len(parts) < 2:
        return None
    (a, first), (b, second), *_ = parts
    if found.condition < _OPEN:
        times = number(found.condition, 2)
        known = f"the data know this combination {times} times less accurately than the best one"
    else:
        known = "the data do not determine it at all"
    if len(parts) == 2 and abs(abs(a) - abs(b)) < 0.1:
        what = "ratio" if a * b > 0 else "product"
        how = "by a common factor" if a * b > 0 else "in opposite directions by a common factor"
        return (
            f"{first} and {second} can change together, {how}: {known}. The data determine "
            f"their {what} only."
        )
    sign = 1 if a > 0 else -1
    mixed = ", ".join(f"{name} {sign * share:+.2f}" for share, name in parts)
    return f"The least certain combination of logarithms is {mixed}; {known}."


def _and(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def accuracy(sd: float) -> str:
    """A relative standard deviation of two digits, a factor either way, or ``open``."""
    if sd > _UNKNOWN:
        return "open"
    return f"{number(100 * sd, 2)} %" if np.isfinite(sd) and sd < 0.3 else spread(sd)


def decibel(value: float | None) -> str:
    """A level difference such as ``0.42 dB``."""
    return "–" if value is None else f"{value:.2f} dB"


def start_words(found: Identifiability, pull: float | None) -> str | None:
    """How regularisation narrows standard deviations of open parameters; None if it does not."""
    left = found.undetermined
    if pull is None or not left:
        return None
    return (
        f"The standard deviations, in particular of {_and(left)}, include update.regularisation = "
        f"{number(pull, 2)}, which keeps every parameter within about a factor of "
        f"{number(float(np.exp(pull)), 2)} of its start; the data alone would give larger ones."
    )
