"""How good an update's models are, and what its parameters ran into."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.formatting import number, percent, quantity
from fenics_joints.reduction.frf_basis import ModelError
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.result import Update

#: A value as near to a bound has been stopped there: relative to it where the scale is
#: logarithmic, else to the room between the bounds.
_AT_BOUND = 2e-3
#: Widening of standard deviations from which it is said.
_WIDENED = 1.05
#: Words for each kind of a reduced model's errors, and their decimals in per cent.
_ERRORS = {
    "frequencies": ("frequencies by", 3),
    "frfs": ("functions by up to", 2),
    "damping": ("damping ratios by up to", 2),
}


def too_far(error: ModelError, limits: ModelError) -> list[str]:
    """What of a reduced model is further from the full one than the limits allow, in words."""
    return [
        f"{words} {percent(getattr(error, key), digits)}"
        for key, (words, digits) in _ERRORS.items()
        if (getattr(error, key) or 0.0) > getattr(limits, key)
    ]


def fit_notes(found: Update, mode_names: Sequence[str]) -> list[str]:
    """What a reader has to know of the way in which a fit ended."""
    notes, widths = [], found.widths
    if not found.converged:
        notes.append(f"the fit has {found.message}; the values are the best that were found")
    factors = {
        "frequencies": [widths.frequencies],
        "shapes": widths.shapes,
        "ratios": [widths.damping],
    }
    wide = [
        f"{kind} {_times(min(some), max(some))}"
        for kind, some in factors.items()
        if max(some, default=1.0) >= _WIDENED
    ]
    if wide:
        notes.append(
            "the model does not come as near to the test as the data's standard deviations say: "
            f"the fit takes them wider, those of {', '.join(wide)}"
        )
    left = [mode_names[i] for i in widths.without]
    if left:
        names = " and ".join([", ".join(left[:-1]), left[-1]] if len(left) > 1 else left)
        do, whose = (
            ("changes its partner", "it") if len(left) == 1 else ("change their partners", "them")
        )
        notes.append(
            f"{names} {do} among the model's modes near the answer, so that no value was fitted to "
            f"{whose}; a sharper shape of {whose} would tell which is which"
        )
    return notes


def _times(low: float, high: float) -> str:
    """A factor, or the range of several."""
    low, high = number(low, 2), number(high, 2)
    return f"{high} times" if low == high else f"{low} to {high} times"


def bound_notes(parameters: Sequence[Parameter], found: Update) -> list[str]:
    """What a reader has to know of parameters at or beyond their bounds."""
    notes = []
    for p, value in zip(parameters, found.values, strict=True):
        if found.method == "weighted":
            if not p.lower <= value <= p.upper:
                notes.append(
                    f"{p.name} is outside its bounds, {quantity(p.lower, p.unit)} to "
                    f"{quantity(p.upper, p.unit)}: the weighted equations have none"
                )
            continue
        notes += [
            f"{p.name} ended at its bound, {quantity(bound, p.unit)}: the data want it beyond, and "
            "its standard deviation says nothing"
            for bound in (p.lower, p.upper)
            if is_at(p, value, bound)
        ]
    return notes


def is_at(parameter: Parameter, value: float, bound: float) -> bool:
    """Whether a value is as good as at a bound."""
    if not np.isfinite(bound):
        return False
    room = parameter.upper - parameter.lower
    size = abs(bound) if parameter.log or not np.isfinite(room) else room
    size = size or abs(parameter.value)
    return abs(value - bound) <= _AT_BOUND * size
