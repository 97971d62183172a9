"""Test modes that match no mode of the model, or several: the notes of an update on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.case import Case
from fenics_joints.commands.update.data import UpdateData
from fenics_joints.commands.update.result import ModeTable
from fenics_joints.formatting import percent
from fenics_joints.measurements.gap import UNLIKE, TooFewModes, rms, same_modes
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.frf_basis import paired
from fenics_joints.updating import Update

#: Most modes of the model that are searched for the test's, as a multiple of the test's and the six
#: rigid ones, and the factor by which a search is extended; chosen.
_MOST, _FACTOR = 4, 2
#: Remaining root mean square error of ln f from which a fit explains nothing: neighbouring modes
#: are often no further apart; chosen.
_NOTHING = 0.2


class WithoutPartner(Exception):
    """Some test modes have no partner in the model, neither at the start nor after the fit.

    Attributes:
        names: Names of these modes.
        index: Their indices, ascending.
    """

    def __init__(self, names: Sequence[str], index: Sequence[int]):
        super().__init__(", ".join(names))
        self.names, self.index = tuple(names), tuple(index)


def without(case: Case, error: WithoutPartner) -> tuple[Case, str]:
    """The case without the modes that have no partner, and a note on it."""
    note = (
        f"{', '.join(error.names)}: left out: no mode of the model matches it, before the fit or "
        f"after; {UNLIKE}"
    )
    return case.without_modes(error.index), note


def explains_nothing(
    modes: ModeTable | None, alone: np.ndarray, spare: int, in_order: np.ndarray, excess: float
) -> str | None:
    """Why a fit does not explain a test, in words; None if it may.

    Args:
        modes: Frequencies before and after.
        alone: Mask of the modes without a partner, before and after, (m,).
        spare: How many may be left out.
        in_order: Frequencies of the modes that the test sees before the fit, ascending, Hz, (m,).
        excess: Of the `Update`: a fit that ends within the data's noise explains them.
    """
    if modes is None:
        return None
    if alone.sum() > spare:
        names = [name for name, is_alone in zip(modes.names, alone, strict=True) if is_alone]
        return f"no mode of the model matches {', '.join(names)}, over a third of the test's modes"
    errors = np.log(modes.after / modes.test)[modes.fitted]
    left = rms(errors) if np.isfinite(errors).any() else 0.0
    if left >= _NOTHING:
        return (
            f"the frequencies are still off by {percent(float(np.expm1(left)))} after the fit "
            "(root mean square), as much as the distance of neighbouring modes"
        )
    if excess == 1 or modes.mac_after is None:
        return None
    return _shapes_of_others(modes, in_order)


def _shapes_of_others(modes: ModeTable, in_order: np.ndarray) -> str | None:
    """A sentence if the frequencies contradict the pairs that the shapes name; else None.

    A fit to such pairs gives up the shapes that it was paired by, each of them, and still ends
    further from the frequencies than the model before it with its modes in order.
    """
    fitted = modes.fitted & np.isfinite(modes.test)
    lost = (np.diag(modes.mac_after) < np.diag(modes.mac_before))[fitted]
    after = rms(modes.error_after[fitted]) if fitted.any() else 0.0
    before = rms(in_order[fitted] / np.sort(modes.test[fitted]) - 1) if fitted.any() else 0.0
    if not lost.all() or after <= before:
        return None
    return (
        f"the frequencies are off by {percent(after)} after the fit (root mean square), each MAC "
        f"is lower than before, and with modes paired in order of frequency the model was off by "
        f"{percent(before)} before the fit: do the shapes belong to other modes?"
    )


def more_or_fewer(case: Case, error: TooFewModes) -> tuple[Case, str | None]:
    """The case with more modes of the model; or else without modes that have no partner.

    Args:
        case: The case whose update ended so.
        error: Why.

    Returns:
        The case to update instead, and a note on it or None.

    Raises:
        TooFewModes: If no mode of the test has a partner, or one that is held out has none.
    """
    names = case.measurements().mode_names
    most = _MOST * (6 + len(names))
    if case.diagnose.n_modes < most:
        count = min(_FACTOR * case.diagnose.n_modes, most)
        section = case.diagnose.model_copy(update={"n_modes": count})
        section.model_fields_set.add("n_modes")
        return case.model_copy(update={"diagnose": section}), None
    out = [name for i, name in enumerate(names) if i not in error.partnered]
    held = case.update.held.modes if case.update.held is not None else None
    if not error.partnered or isinstance(held, list | tuple) and set(out) & set(held):
        raise error
    note = (
        f"{', '.join(out)}: left out, since the model has fewer modes visible to the test's "
        "sensors than were measured; are the sensors' places and directions right ([test.sees]), "
        "or does the model lack a part that moves there?"
    )
    return case.with_modes(error.partnered), note


def other_partners(data: UpdateData, found: Update, modes: Modes) -> list[str]:
    """Modes for which a fit took another of the model's than the full model does, in words.

    Where two are as like a measured one, a hair decides.

    Args:
        data: The test's data.
        found: The fit.
        modes: Modes of the full model at its values.
    """
    sensors, own = data.target.shape_sensors, found.prediction
    if own.shapes is None or sensors is None:
        return []
    pairing = paired(modes, data.target)
    taken = same_modes(modes, sensors, own.shapes, own.frequencies_hz)
    hz, notes = modes.frequencies_hz, []
    for j, (fitted, shown) in enumerate(zip(taken, pairing.index, strict=True)):
        if fitted != shown and j not in found.widths.without:
            notes.append(
                f"two modes of the model match {data.mode_names[j]} about equally well: the fit "
                f"used the one at {hz[fitted]:.5g} Hz, the table shows the one at {hz[shown]:.5g} "
                "Hz; sensors that distinguish them, or another start, would help"
            )
    return notes
