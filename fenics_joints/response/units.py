"""Kinds of frequency response functions, and the units that people and analysers write them in."""

from __future__ import annotations

import re

from fenics_joints.errors import InputError
from fenics_joints.units import factor_to_si

_TABLE = (("receptance", "m"), ("mobility", "m/s"), ("accelerance", "m/s2"))

#: Kind, and how often the displacement was derived by time: the power of i w by which the function
#: is the receptance's multiple.
KINDS = {kind: times for times, (kind, _) in enumerate(_TABLE)}

#: SI unit of the motion of each kind; that of the function is this by newton.
MOTION = dict(_TABLE)

#: In a response g is what an accelerometer says, not a gram.
_GRAVITY = re.compile(r"(?<![A-Za-z_])(?:g|gn|g_n|g0)(?![A-Za-z0-9_])")


def frf_unit(text: str) -> tuple[str, float]:
    """Kind and factor to SI of a unit such as ``m/s2/N``, ``(mm/s)/N``, ``g/lbf`` or ``1/kg``.

    Raises:
        InputError: If it is not the unit of a receptance, mobility or accelerance.
    """
    known = _GRAVITY.sub("standard_gravity", text.strip())
    for kind, motion in MOTION.items() if known else ():
        try:
            return kind, factor_to_si(known, f"{motion}/N")
        except InputError:
            continue
    raise InputError(
        f"the unit {text!r} is not known as one of a frequency response function; expected one of "
        "displacement, velocity or acceleration by force, such as 'm/N', 'mm/s/N' or 'g/N'"
    )


def ratio_unit(motion: str, force: str) -> tuple[str, float]:
    """Kind and factor to SI of a function whose numerator and denominator have these units.

    The numerator may also be the unit of the whole ratio, as some analysers write it.

    Raises:
        InputError: If the two do not make a receptance, mobility or accelerance.
    """
    try:
        return frf_unit(f"({motion})/({force})")
    except InputError as error:
        try:
            return frf_unit(motion)
        except InputError:
            raise error from None


def length_factor(text: str) -> float:
    """How many metres one of a unit of length is; raises InputError if it is none."""
    return factor_to_si(text, "m")


def checked_kind(kind: str) -> str:
    """The kind if it is one; raises InputError if not."""
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"kind = {kind!r}: expected one of {', '.join(map(repr, KINDS))}")
    return kind


def a_kind(kind: str) -> str:
    """The kind with its article, for a message."""
    return f"{'an' if kind == 'accelerance' else 'a'} {kind}"
