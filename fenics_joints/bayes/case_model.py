"""From a case to what is sampled: the prior, and a model for it whose error is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.bayes.model import Frequencies, ReducedCheck, check_reduced, narrow_frequencies
from fenics_joints.bayes.priors import Prior, default_density, density
from fenics_joints.beams import BeamStructure
from fenics_joints.beams.exact import ExactBeams
from fenics_joints.build import build_structure
from fenics_joints.case import Case
from fenics_joints.case_bayes import Bayes, bayes_data, prior_numbers
from fenics_joints.components import Parameter
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.gap import pair_modes
from fenics_joints.log_scale import LogScale
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.surrogate import Surrogate

__all__ = ["CaseModel", "case_model", "case_prior"]

#: Points of the prior in the basis at first; that the error is checked at; rounds of more of them.
_SAMPLES, _CHECKED, _ROUNDS = 24, 50, 4
#: Modes of so many points of the check, those with the largest errors, are taken into the basis.
_WORST = 16


@dataclass(frozen=True, eq=False)
class CaseModel:
    """A case made ready for sampling.

    Attributes:
        prior: Of the parameters.
        frequencies: ln f at many values.
        check: Against the full model at points of the prior.
        start: All parameters' values at the start.
        n_dofs: Degrees of freedom of the full model.
        n_basis: Of the model that is sampled.
    """

    prior: Prior
    frequencies: Frequencies
    check: ReducedCheck
    start: Mapping[str, float]
    n_dofs: int
    n_basis: int


def case_prior(case: Case, parameters: list[Parameter], start, model) -> Prior:
    """The priors of a case; lognormal about the start where it has none."""
    section, densities = case.update.bayes or Bayes(), []
    for p in parameters:
        if p.name in section.priors:
            found = density(p.name, section.priors[p.name].kind, prior_numbers(case, p.name))
        else:
            found = default_density(p, start[p.name], case.update.regularisation)
        densities.append(found)
    scale = LogScale([p.name for p in parameters], model)
    return Prior(tuple(parameters), tuple(densities), scale)


def case_model(case: Case, comm: MPI.Intracomm, progress: Progress | None = None) -> CaseModel:
    """Build a case's model for sampling, and check it. Collective.

    Raises:
        InputError: If the case has no test or no parameters to update.
        ConvergenceError: If the reduced model does not become as good as the case asks for.
    """
    if case.update is None or not case.update.parameters:
        raise InputError(f"{case.path}: update.parameters is missing: expected what is identified")
    progress = progress or Progress(silent=True)
    progress.step("building the model")
    full, start = build_structure(case, comm), {**case.nominal(), **case.start()}
    parameters = [full.parameters[name] for name in case.update.parameters]
    prior = case_prior(case, parameters, start, full)
    data = bayes_data(case)
    given = {"sensors": data.sensors, "n_test": len(data.mode_names),
             "n_modes": case.diagnose.n_modes, "shapes": data.shapes}  # fmt: skip
    tolerance = (case.update.bayes or Bayes()).tolerance
    if isinstance(full, BeamStructure):
        exact = ExactBeams(full, start, **given)
        frequencies = narrow_frequencies(exact.forward, prior, start, tolerance=tolerance / 10)
        check = check_reduced(frequencies, _many(exact.forward), prior, _CHECKED)
    else:
        frequencies, check = _reduced(full, start, given, prior, tolerance, progress)
    check.require(tolerance)
    frequencies.error = check.error
    return CaseModel(prior, frequencies, check, start, full.n_dofs,
                     frequencies.forward.model.n_dofs)  # fmt: skip


def _many(forward):
    """ln f of a forward at many values, nan where it lacks a mode."""
    def log_f(points):
        found = []
        for values in points:
            try:
                found.append(forward(values)[0])
            except InputError:
                found.append(np.full(forward.n_test, np.nan))
        return np.array(found)

    return log_f


def _reduced(full, start, given, prior: Prior, tolerance: float, progress: Progress):
    """A solid model on the modes at points of the prior, more of them until it is good enough."""
    names, rng = prior.names, np.random.default_rng(7)

    def named(x):
        rows = prior.values(x).tolist()
        return [{**start, **dict(zip(names, row, strict=True))} for row in rows]

    samples = [start, *named(prior.sample(_SAMPLES, rng))]
    progress.step("reduced model: sampling the prior", len(samples))
    surrogate = Surrogate(full, samples, start, progress=progress, **given)
    for i in range(_ROUNDS):
        progress.step("reduced model: checking it in the prior", _CHECKED)
        frequencies = narrow_frequencies(surrogate.forward, prior, start, tolerance=tolerance / 5)
        modes: list = []

        def exact(points, modes=modes):
            return np.array([_solved(surrogate, values, modes, progress) for values in points])

        # Other points each round: those that were put right say nothing of the rest.
        check = check_reduced(frequencies, exact, prior, _CHECKED, seed=12345 + i)
        if check.error <= tolerance or i == _ROUNDS - 1:
            return frequencies, check
        worst = np.argsort(check.errors)[::-1][:_WORST]
        surrogate.refine([modes[k] for k in worst if check.errors[k] > 0.1 * tolerance])
    raise ConvergenceError("the reduced model was not checked")


def _solved(surrogate: Surrogate, values, modes: list, progress: Progress) -> np.ndarray:
    """ln f of the full model, whose modes are added to the list."""
    found = solve_modes(
        surrogate.full, values, n_modes=surrogate.n_modes, solver=surrogate.nominal.solver
    )
    modes.append(found)
    progress.advance()
    try:
        pairing = pair_modes(
            found, surrogate.n_test, surrogate.sensors, reference=surrogate.forward.reference
        )
    except InputError:
        return np.full(surrogate.n_test, np.nan)
    return np.log(found.frequencies_hz[pairing.index])
