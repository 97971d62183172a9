"""Modes of a test that no mode of the model could be, or more than one: what an update says."""

from __future__ import annotations

from fenics_joints.case import Case
from fenics_joints.commands.update.data import UpdateData
from fenics_joints.measurements.gap import TooFewModes, same_modes
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.combined import paired
from fenics_joints.updating import Update

__all__ = ["more_or_fewer", "other_partners"]

#: How much further a model's modes are looked through, for a test's modes and beyond those a body
#: has at rest, before the test's are left out: its own multiple, and a factor each time.
_MOST, _FACTOR = 4, 2


def more_or_fewer(case: Case, error: TooFewModes) -> tuple[Case, str | None]:
    """The case with more modes of the model; or else without modes that have no partner.

    Args:
        case: The case whose update ended so.
        error: Why.

    Returns:
        The case to update instead, and what is to be said of it.

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
        f"{', '.join(out)}: left out, as the model has fewer modes that the test's sensors see "
        "than the test has; are the sensors' places and directions right ([test.sees]), or does "
        "something move there that is not in the model?"
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
                f"two modes of the model look like {data.mode_names[j]} to the test: the fit took "
                f"that at {hz[fitted]:.5g} Hz, the table that at {hz[shown]:.5g} Hz; sensors that "
                "tell them apart, or another start, would help"
            )
    return notes
