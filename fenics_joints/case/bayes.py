"""What ``[update.bayes]`` says of a case, as the numbers that an identification takes."""

from __future__ import annotations

import numpy as np

from fenics_joints.bayes.likelihood import checked_specimens
from fenics_joints.bayes.priors import density
from fenics_joints.case.case import Case
from fenics_joints.case.messages import said
from fenics_joints.errors import InputError, located
from fenics_joints.measurements import TestData, read_table
from fenics_joints.units import parameter_unit, to_si

_WITHOUT_UNIT = ("log_sd",)


def prior_numbers(case: Case, name: str) -> dict[str, float]:
    """Numbers of a parameter's prior, SI.

    Raises:
        InputError: If a unit is wrong, or the kind or a number is not usable.
    """
    section = case.update.bayes.priors[name]
    unit, found = parameter_unit(name), {}
    for key, value in (section.model_extra or {}).items():
        with located(f"{key} = {value!r}"):
            found[key] = to_si(value, "" if key in _WITHOUT_UNIT else unit)
    density(name, section.kind, found)
    return found


def bayes_data(case: Case) -> TestData | None:
    """The test's data without the modes that ``[update.held]`` keeps from every fit.

    Raises:
        InputError: If those are not the highest ones, which the posterior cannot leave out.
    """
    if case.test is None:
        return None
    data, held = case.measurements(), case.update and case.update.held
    names = held.modes if held and held.modes else []
    out = [name in names for name in data.mode_names]
    n = len(out) - sum(out)
    if any(out[:n]) and not set(names) - set(data.mode_names):
        expected = "expected the highest modes of the test, for a posterior of the others"
        raise InputError(said("update.held.modes", names, expected))
    return data.first_modes(n)


def specimens(case: Case) -> np.ndarray:
    """Frequencies of the specimens, Hz, (n, m): columns named as the test's modes.

    Modes that are held out, see `bayes_data`, are left out.

    Raises:
        InputError: If the table cannot be read, lacks a mode, or has a frequency that is not
            positive.
    """
    table = read_table(case.folder / case.update.bayes.specimens)
    modes = bayes_data(case).mode_names
    columns = np.column_stack([table.column(mode, "Hz") for mode in modes])
    return checked_specimens(modes, columns)
