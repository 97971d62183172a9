"""``[update.bayes]`` of a case: the numbers that an identification takes, and their checks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenics_joints.bayes import GaussianLikelihood, Specimens
from fenics_joints.bayes.distributions import FAMILIES, checked_frequencies
from fenics_joints.bayes.likelihood import checked_specimens
from fenics_joints.bayes.priors import density
from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, message, unknown
from fenics_joints.errors import InputError, located
from fenics_joints.measurements import TestData, read_table
from fenics_joints.units import to_si

_WITHOUT_UNIT = ("log_sd",)


def prior_numbers(case: Case, name: str) -> dict[str, float]:
    """Numbers of a parameter's prior, SI.

    Raises:
        InputError: If a unit is wrong, or the kind or a number is not usable.
    """
    section = case.update.bayes.priors[name]
    unit, found = case.unit_of(name), {}
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
        raise InputError(message("update.held.modes", names, expected))
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


def check_bayes(case: Case) -> Iterator[str]:
    """A line for each thing in [update.bayes] that cannot be used."""
    bayes, parameters = case.update.bayes, case.update.parameters
    if bayes is None:
        return
    try:
        bayes_data(case)
    except InputError as error:
        yield str(error)
        return
    for name in bayes.priors:
        if name not in parameters:
            hint = did_you_mean(name, parameters)
            yield f"update.bayes.priors.{name}: is not in update.parameters{hint}"
            continue
        try:
            prior_numbers(case, name)
        except InputError as error:
            yield f"update.bayes.priors.{name}: {error}"
    given = [("update.bayes.distributions", name) for name in bayes.distributions or ()]
    yield from unknown(given, FAMILIES, "unknown")
    samples, burn_in = bayes.length()
    if burn_in >= samples:
        yield message("update.bayes.burn_in", burn_in, f"expected below samples = {samples}")
    if bayes.kind != "gaussian" and bayes.specimens is None:
        expected = "expected update.bayes.specimens too, a table of their frequencies"
        yield message("update.bayes.likelihood", bayes.kind, expected)
    if bayes.specimens is not None and case.test is not None:
        try:
            _check_likelihood(case)
        except InputError as error:
            yield f"update.bayes.specimens: {error}"


def _check_likelihood(case: Case) -> None:
    """Refuse a table that the likelihood cannot use.

    Raises:
        InputError: For a bad table, or too few specimens, or scales that are not positive.
    """
    bayes, table, modes = case.update.bayes, specimens(case), bayes_data(case).mode_names
    if bayes.kind == "hierarchical":
        Specimens(modes, table, bayes.noise, bayes.noise_known, bayes.scatter)
    elif bayes.kind == "gaussian":
        GaussianLikelihood.from_specimens(modes, table)
    else:
        for mode, column in zip(modes, table.T, strict=True):
            checked_frequencies(mode, column)
