"""From a case to what is sampled: the prior, and a model for it whose error is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.bayes.model import Frequencies, ReducedCheck, read_frequencies, write_frequencies
from fenics_joints.bayes.priors import PriorDensity, default_density, density
from fenics_joints.bayes.sampled import SampledModel
from fenics_joints.case import Case, build_structure
from fenics_joints.case.bayes import bayes_data, prior_numbers
from fenics_joints.case.dimensions import refuse_unfit
from fenics_joints.case.fingerprint import fingerprint
from fenics_joints.case.update import Bayes
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.surrogate import tested_models
from fenics_joints.structure.components import Parameter, number
from fenics_joints.units import parameter_unit
from fenics_joints.updating.coordinates import LogScale

#: Relative distance from a law's limit.
_INSIDE = 1e-6


@dataclass(frozen=True, eq=False)
class HeldModes:
    """Modes kept from the likelihood.

    Attributes:
        mode_names: Names, m of them.
        measured_hz: Shape (m,).
        measured_sd: Relative standard deviation of the test's noise, (m,).
        predicted_hz: Draws, (n, m), without those at which the model lacks a mode, or which are
            beyond a law's limit.
    """

    mode_names: tuple[str, ...]
    measured_hz: np.ndarray
    measured_sd: np.ndarray
    predicted_hz: np.ndarray


@dataclass(frozen=True, eq=False)
class CaseModel:
    """A case made ready for sampling.

    Attributes:
        prior: Of the parameters.
        frequencies: ln f at many values.
        check: Against the full model at points of the prior.
        bound: Largest error of a frequency that is estimated in the prior, at more points; the
            estimate, of the residuals, exceeds the error wherever both are known.
        start: All parameters' values at the start.
        n_dofs: Degrees of freedom of the full model.
        n_basis: Of the model that is sampled.
    """

    prior: PriorDensity
    frequencies: Frequencies
    check: ReducedCheck
    bound: float
    start: Mapping[str, float]
    n_dofs: int
    n_basis: int


def case_prior(case: Case, parameters: list[Parameter], start, model) -> PriorDensity:
    """The priors of a case; lognormal about the start where it has none."""
    section, densities = case.update.bayes or Bayes(), []
    for p in parameters:
        if p.name in section.priors:
            found = density(p.name, section.priors[p.name].kind, prior_numbers(case, p.name))
        else:
            found = default_density(p, start[p.name], case.update.regularisation)
        densities.append(found)
    scale = LogScale([p.name for p in parameters], model)
    return PriorDensity(tuple(parameters), tuple(densities), scale)


def case_model(
    case: Case, comm: MPI.Intracomm, progress: Progress | None = None, *, keep: Path | None = None
) -> CaseModel:
    """Build a case's model for sampling, and check it. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        keep: File of a solid case's reduced model: read if it is there and of the same case, else
            written. Beams need none.

    Raises:
        InputError: If the case has no test, no parameters to update or no [update.bayes].
        ConvergenceError: If the reduced model does not become as good as the case asks for.
    """
    _check_asked(case)
    progress = progress or Progress(silent=True)
    progress.step("building the model")
    full, start = build_structure(case, comm), {**case.nominal(), **case.start()}
    refuse_unfit(case, full, case.update.parameters)
    parameters = within_laws([full.parameters[n] for n in case.update.parameters], start, full)
    prior = case_prior(case, parameters, start, full)
    data = bayes_data(case)
    given = {
        "sensors": data.sensors,
        "n_test": len(data.mode_names),
        "n_modes": case.diagnose.n_modes,
        "shapes": data.shapes,
    }
    tolerance = (case.update.bayes or Bayes()).tolerance
    # What is exact is made in no time.
    keep = None if tested_models(full).exact else keep
    frequencies, check, bound = _ready(case, full, start, given, prior, tolerance, progress, keep)
    check.require(tolerance)
    return CaseModel(
        prior, frequencies, check, bound, start, full.n_dofs, frequencies.forward.model.n_dofs
    )


def within_laws(parameters: list[Parameter], start, model) -> list[Parameter]:
    """The parameters, with bounds that keep each E below its G's limit where one of them is fixed.

    Where both are free the coordinates do that.
    """
    found = {p.name: p for p in parameters}
    for region in model.regions:
        limit, E, G = region.law.ratio_limit, *(region.properties.get(k) for k in "EG")
        if limit is None or (E in found) == (G in found):
            continue
        if E in found:
            most = (1 - _INSIDE) * limit * number(G, start)
            found[E] = replace(found[E], upper=min(found[E].upper, most))
        else:
            least = (1 + _INSIDE) * number(E, start) / limit
            found[G] = replace(found[G], lower=max(found[G].lower, least))
    return list(found.values())


def _check_asked(case: Case) -> None:
    """Refuse a case that does not say what is sampled, with what to write."""
    if case.test is None:
        raise InputError(f"{case.path}: test is missing: expected measured frequencies")
    if case.update is not None and case.update.cutoff is not None:
        raise InputError(
            f"{case.path}: update.cutoff: the search for the cut-off pressure gives no posterior; "
            "--bayes expects update.parameters, such as moduli. Leave --bayes out."
        )
    if case.update is None or not case.update.parameters:
        raise InputError(f"{case.path}: update.parameters is missing: expected names to identify")
    unseen = [name for name in case.update.parameters if name in case.damping_names()]
    if unseen:
        raise InputError(
            f"{case.path}: update.parameters: {', '.join(unseen)}: the posterior uses undamped "
            "frequencies, which damping does not change. Expected stiffnesses and masses."
        )
    if case.update.bayes is None:
        start = {**case.nominal(), **case.start()}
        lines = [_prior_line(case, name, start[name]) for name in case.update.parameters]
        raise InputError(
            f"{case.path}: update.bayes is missing: --bayes needs a prior for each parameter. For "
            "instance, with 68 % between the median divided by 1.6 and times 1.6:\n"
            + "\n".join(["[update.bayes.priors]", *lines])
        )


def _prior_line(case: Case, name: str, value: float) -> str:
    unit = parameter_unit(name).replace("*", " ")
    median = f'"{value:.4g} {unit}"' if unit else f"{value:.4g}"
    return f'"{name}" = {{ kind = "lognormal", median = {median}, log_sd = 0.5 }}'


def _ready(case: Case, full, start, given, prior: PriorDensity, tolerance, progress, keep):
    """A model's frequencies, check and estimated error, from their file if it is there."""
    cache, name = None, ""
    if keep is not None:
        said = [start, prior.names, prior.exactly(), given["n_test"], tolerance]
        shapes = None if given["shapes"] is None else given["shapes"].tolist()
        key = fingerprint(case, full, given["sensors"], *said, shapes)
        cache, name = Cache(keep.parent, key, full.comm), keep.name.removesuffix(".h5")
        kept = read_frequencies(cache, name, given["sensors"], progress)
        if kept is not None:
            return kept
    found = SampledModel(full, start, prior, tolerance, progress, **given).ready()
    if cache is not None and found[1].error <= tolerance:
        write_frequencies(cache, name, *found)
    return found
