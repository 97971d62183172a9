"""Checks of ``[update.bayes]``."""

from __future__ import annotations

from fenics_joints.bayes import GaussianLikelihood, Specimens
from fenics_joints.bayes.distributions import FAMILIES, checked_frequencies
from fenics_joints.case.bayes import bayes_data, prior_numbers, specimens
from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, said, unknown
from fenics_joints.errors import InputError


def check_bayes(case: Case) -> list[str]:
    """A line for each thing in [update.bayes] that cannot be used."""
    bayes = None if case.update is None else case.update.bayes
    if bayes is None:
        return []
    if case.update.cutoff is not None:
        return ["update.bayes: expected none beside update.cutoff; it identifies parameters"]
    errors = []
    try:
        bayes_data(case)
    except InputError as error:
        return [str(error)]
    for name in bayes.priors:
        if name not in case.update.parameters:
            hint = did_you_mean(name, case.update.parameters)
            errors.append(f"update.bayes.priors.{name}: is not in update.parameters{hint}")
    for name in set(bayes.priors) & set(case.update.parameters):
        try:
            prior_numbers(case, name)
        except InputError as error:
            errors.append(f"update.bayes.priors.{name}: {error}")
    given = [("update.bayes.distributions", name) for name in bayes.distributions or ()]
    errors += unknown(given, FAMILIES, "unknown")
    if not bayes.tolerance > 0:
        errors.append(said("update.bayes.tolerance", bayes.tolerance, "expected above 0"))
    samples, burn_in = bayes.length()
    if burn_in >= samples:
        errors.append(said("update.bayes.burn_in", burn_in, f"expected below samples = {samples}"))
    if bayes.kind != "gaussian" and bayes.specimens is None:
        expected = "expected update.bayes.specimens too, a table of their frequencies"
        errors.append(said("update.bayes.likelihood", bayes.kind, expected))
    if bayes.specimens is not None and case.test is not None:
        try:
            _check_likelihood(case)
        except InputError as error:
            errors.append(f"update.bayes.specimens: {error}")
    return errors


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
