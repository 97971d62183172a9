"""``[update.bayes]``: what `fenics-joints update --bayes` assumes and how it samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from fenics_joints.case.messages import did_you_mean, said
from fenics_joints.case.sections import Names, Section, Share
from fenics_joints.case.sections import Update as PlainUpdate
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData, read_table
from fenics_joints.units import parameter_unit, to_si

if TYPE_CHECKING:
    from fenics_joints.case.case import Case

__all__ = [
    "Bayes", "PriorSection", "Update", "bayes_data", "check_bayes", "prior_numbers",
    "specimens",
]  # fmt: skip

_WITHOUT_UNIT = ("log_sd",)


class PriorSection(Section):
    """A prior, such as ``{ kind = "normal", mean = "1763 N m", sd = "88 N m" }``.

    `fenics_joints.bayes.priors.KINDS` says which numbers each kind needs.
    """

    model_config = ConfigDict(extra="allow", frozen=True)
    kind: str


def _a_table(value):
    """A prior that is no table, in words."""
    if not isinstance(value, dict | PriorSection):
        such = '{ kind = "lognormal", median = 1, log_sd = 0.5 }'
        raise ValueError(f"expected a table such as {such}")
    return value


#: Keys that a likelihood makes no use of.
_WITHOUT_EFFECT = {
    "gaussian": ("distributions", "scatter", "noise", "noise_known"),
    "fitted": ("scatter", "noise", "noise_known", "discrepancy"),
    "hierarchical": ("sampler",),
}


class Bayes(Section):
    """``[update.bayes]``.

    Without ``specimens`` the frequencies of the test are one set of data. With a table of them, a
    row for each specimen and a column for each mode, the ``likelihood`` is ``hierarchical``
    (scatter of the specimens and lack of knowledge apart), ``fitted`` (the paper's: the product of
    a distribution for each mode) or ``gaussian`` (of the specimens' mean). ``noise`` is that of a
    measured frequency of a specimen: the scale of its prior, or itself if ``noise_known``.
    ``discrepancy`` is the relative error of frequencies that the best model may have, by default
    that of ``[diagnose]``; the fitted likelihood has no place for it. ``tolerance`` is the largest
    relative error of the reduced model's frequencies. A parameter without a prior has a lognormal
    one about its start, as wide as the regularisation.
    """

    likelihood: Literal["gaussian", "fitted", "hierarchical"] | None = None
    specimens: str | None = None
    distributions: Names | None = None
    sampler: Literal["metropolis", "prior_metropolis", "emcee"] = "metropolis"
    samples: Annotated[int, Field(ge=10, strict=True)] | None = None
    burn_in: Annotated[int, Field(ge=0, strict=True)] | None = None
    chains: Annotated[int, Field(ge=2, strict=True)] = 4
    seed: Annotated[int, Field(ge=0, strict=True)] = 1
    discrepancy: Share | None = None
    scatter: Share = 0.1
    noise: Share = 0.001
    noise_known: bool = False
    tolerance: Share = 1e-4
    priors: dict[str, Annotated[PriorSection, BeforeValidator(_a_table)]] = {}

    @property
    def kind(self) -> str:
        """The likelihood, the default one put in."""
        return self.likelihood or ("gaussian" if self.specimens is None else "hierarchical")

    def length(self) -> tuple[int, int]:
        """Samples and burn-in: the paper's 20,000 and 5,000, but fewer of the costlier Gibbs."""
        samples = self.samples or (2000 if self.kind == "hierarchical" else 20000)
        return samples, samples // 4 if self.burn_in is None else self.burn_in


    def without_effect(self) -> list[str]:
        """Keys that were given though the likelihood makes no use of them, in words."""
        unused = [key for key in _WITHOUT_EFFECT[self.kind] if key in self.model_fields_set]
        return [
            f"update.bayes.{key} = {getattr(self, key)!r} has no effect with the {self.kind} "
            "likelihood" for key in unused
        ]  # fmt: skip


class Update(PlainUpdate):
    """``[update]`` with its ``[update.bayes]``."""

    bayes: Bayes | None = None


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
    errors += _unknown_distributions(bayes.distributions or ())
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
    from fenics_joints.bayes.distributions import FEWEST
    from fenics_joints.bayes.hierarchical import Specimens
    from fenics_joints.bayes.likelihood import GaussianLikelihood

    bayes, table, modes = case.update.bayes, specimens(case), bayes_data(case).mode_names
    if bayes.kind == "hierarchical":
        Specimens(modes, table, bayes.noise, bayes.noise_known, bayes.scatter)
    elif bayes.kind == "gaussian":
        GaussianLikelihood.from_specimens(modes, table)
    else:
        for mode, n in zip(modes, np.sum(np.isfinite(table), axis=0), strict=True):
            if n < FEWEST:
                raise InputError(
                    f"{mode}: {n} measured frequencies: expected at least {FEWEST} for a "
                    "distribution"
                )


def _unknown_distributions(names) -> list[str]:
    from fenics_joints.bayes.distributions import FAMILIES

    return [
        said("update.bayes.distributions", name, f"unknown{did_you_mean(name, list(FAMILIES))}")
        for name in names if name not in FAMILIES
    ]  # fmt: skip


def prior_numbers(case: Case, name: str) -> dict[str, float]:
    """Numbers of a parameter's prior, SI.

    Raises:
        InputError: If a unit is wrong, or the kind or a number is not usable.
    """
    from fenics_joints.bayes.priors import density

    section = case.update.bayes.priors[name]
    unit, found = parameter_unit(name), {}
    for key, value in (section.model_extra or {}).items():
        try:
            found[key] = to_si(value, "" if key in _WITHOUT_UNIT else unit)
        except InputError as error:
            raise InputError(f"{key} = {value!r}: {error}") from error
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
    from fenics_joints.bayes.likelihood import checked_specimens

    table = read_table(case.folder / case.update.bayes.specimens)
    modes = bayes_data(case).mode_names
    columns = np.column_stack([table.column(mode, "Hz") for mode in modes])
    return checked_specimens(modes, columns)
