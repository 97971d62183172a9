"""``fenics-joints update --bayes``: the posterior of a case's parameters, and what it predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.bayes.arviz_files import arviz
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.checks import FEWEST as FEWEST_CHECKED
from fenics_joints.bayes.checks import (
    PredictiveCheck,
    check_predictive,
    check_prior,
    outside,
    replicate,
)
from fenics_joints.bayes.distributions import FEWEST
from fenics_joints.bayes.hierarchical import Hierarchy, Specimens, sample_hierarchy
from fenics_joints.bayes.likelihood import FittedLikelihood, GaussianLikelihood
from fenics_joints.bayes.posterior import Posterior
from fenics_joints.bayes.samplers import Settings, sample
from fenics_joints.case import Case, build_structure
from fenics_joints.case.bayes import bayes_data, specimens
from fenics_joints.case.update import Bayes
from fenics_joints.commands.bayes.model import CaseModel, HeldModes, case_model
from fenics_joints.commands.bayes.result import BayesReport, Predicted, bayes_document
from fenics_joints.commands.outcome import Outcome
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.files import check_writable
from fenics_joints.measurements.gap import pair_modes
from fenics_joints.modal.modes import solve_modes
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress

#: New sets of specimens; draws for frequencies.
_SETS, _PREDICTED = 400, 2000
#: Draws for held modes, by the full model; more of them below so many degrees of freedom.
_HELD, _HELD_SMALL, _SMALL = 40, 200, 2000
#: Offset of a mode, in standard deviations of its prior, from which it is doubted.
_OFFSET = 3.0


def run_bayes(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, keep: Path | None = None
) -> Outcome[BayesReport]:
    """The ``update --bayes`` command. Collective.

    Args:
        case: The case.
        comm: Communicator; the chains are shared out over its ranks.
        progress: Told what is being done.
        keep: File of the chains, see `fenics_joints.bayes.samplers.sample`; a solid case's reduced
            model is kept beside it, with the ending ``.model.h5``.

    Returns:
        The report; of chains that did not converge too, which then is a failure and predicts
        nothing.

    Raises:
        InputError: If the case, a prior or the data cannot be used; a distribution does not fit.
        ConvergenceError: If the reduced model is not good enough.
    """
    arviz()  # missing, it is said before the work
    if keep is not None:
        on_root(comm, lambda: check_writable(keep, "--keep"))
    with threadpool_limits(1):
        beside = None if keep is None else Path(keep).with_suffix(".model.h5")
        model = case_model(case, comm, progress, keep=beside)
        found = _CasePosterior(case, model, comm, progress, keep).report()
    return Outcome(found, bayes_document(found), found.failure)


class _CasePosterior:
    def __init__(self, case: Case, model: CaseModel, comm, progress: Progress, keep):
        self.case, self.model, self.comm, self.keep = case, model, comm, keep
        self.section = case.update.bayes or Bayes()
        self.data, self.progress = bayes_data(case), progress
        self.row = self.data.row(case.update.at)
        self.table = None if self.section.specimens is None else specimens(case)
        own = self.section.discrepancy
        self.discrepancy = case.diagnose.discrepancy if own is None else own
        samples, burn_in = self.section.length()
        self.settings = Settings(
            self.section.sampler, samples, burn_in, self.section.chains, self.section.seed
        )

    def report(self) -> BayesReport:
        section, progress = self.section, self.progress
        progress.step("sampling", 100)
        run = {"comm": self.comm, "keep": self.keep}
        run["told"] = lambda share: progress.reach(int(100 * share))
        doubts = [*section.without_effect(), *self._prior_doubts()]
        if section.kind == "hierarchical":
            found = self._hierarchy(run)
            chains, off = found.chains, f"{100 * self.discrepancy:g} %"
            how = f"hierarchical: {len(self.table)} specimens scatter about a mean"
            words = [f"{how}; discrepancy of the model {off}"]
            doubts += self._normal_doubts()
        else:
            likelihood = self._likelihood(section.kind)
            words = likelihood.describe()
            doubts += likelihood.doubts()
            posterior = Posterior(self.model.prior, self.model.frequencies, likelihood)
            found = chains = sample(posterior, self.settings, **run)
        predicted = None
        if chains.converged:
            predicted, more = self._predicted(found)
            doubts = [*doubts, *more]
        log_f, sd = self._measured()
        data, prior = self.data, self.model.prior
        return BayesReport(
            self.case.title,
            (data.condition_name, float(data.conditions[self.row]), data.condition_unit),
            chains,
            {p.name: p.unit for p in prior.parameters},  # other quantities: ratios
            list(prior.describe()),
            words,
            doubts,
            data.mode_names,
            np.exp(log_f),
            sd,
            predicted,
            self.model,
            self.settings,
            self.keep,
        )

    def _likelihood(self, kind: str):
        names, table, section = self.data.mode_names, self.table, self.section
        if kind == "fitted":
            more = {"seed": self.settings.seed}
            return FittedLikelihood.from_specimens(names, table, section.distributions, **more)
        if table is not None:
            more = {"discrepancy": self.discrepancy, "n_parameters": self.model.prior.size}
            return GaussianLikelihood.from_specimens(names, table, **more)
        hz, sd = self.data.frequencies_hz[self.row], self.data.log_sd()[self.row]
        return GaussianLikelihood.from_row(names, hz, sd, self.discrepancy)

    def _hierarchy(self, run) -> Hierarchy:
        s, model = self.section, self.model
        noise = s.noise, s.noise_known, s.scatter
        data = Specimens(self.data.mode_names, self.table, *noise, self.discrepancy)
        return sample_hierarchy(data, model.prior, model.frequencies, self.settings, **run)

    def _prior_doubts(self) -> list[str]:
        log_f, sd = self._measured()
        return check_prior(
            self.model.prior,
            self.model.frequencies,
            self.data.mode_names,
            log_f,
            np.hypot(np.nan_to_num(sd, nan=1.0), self.discrepancy),
        )

    def _normal_doubts(self) -> list[str]:
        """Doubts on modes whose specimens do not scatter about one mean."""
        enough = np.sum(np.isfinite(self.table), axis=0) >= FEWEST
        fitted = FittedLikelihood.from_specimens(
            [n for n, e in zip(self.data.mode_names, enough, strict=True) if e],
            self.table[:, enough],
            ["normal"],
            seed=self.settings.seed,
            accept_misfit=True,
        )
        return [f"{line}: the specimens do not scatter about one mean" for line in fitted.doubts()]

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """ln f that the prediction is compared with, and its standard deviation."""
        if self.table is not None:
            logs = np.log(self.table)
            return np.nanmean(logs, axis=0), np.nanstd(logs, axis=0, ddof=1)
        return np.log(self.data.frequencies_hz[self.row]), self.data.log_sd()[self.row]

    # -- predictions from chains that converged ---------------------------------------------------

    def _predicted(self, found: Chains | Hierarchy) -> tuple[Predicted, list[str]]:
        """Frequencies of new specimens, or of the structure where there are none; and doubts."""
        names, frequencies = self.data.mode_names, self.model.frequencies
        rng, doubts = np.random.default_rng(self.settings.seed), []
        checked = self._checked(doubts)
        check = rival = None
        if isinstance(found, Hierarchy):
            replicates = found.replicate(frequencies, _SETS)
            log_f = replicates.reshape(-1, replicates.shape[2])
            values, _, tau = found.new_specimens(self._count(), 1, seed=1)
            values, log_sd = values[:, 0], np.hypot(tau, self.discrepancy)
            if checked:
                check = check_predictive(names, self.table, replicates)
                rival = self._rival(doubts)
            doubts += self._offset_doubts(found.chains)
        else:
            draws = found.draws()
            log_f = frequencies(draws[rng.choice(len(draws), _PREDICTED)])
            values, log_sd = draws[rng.choice(len(draws), self._count())], self.discrepancy
            if self.section.kind == "fitted":
                log_sd = 0.0
                if checked:
                    check = self._independent(found)
        # Specimens that the model cannot be, beyond a law's limit, have no frequencies.
        hz = np.exp(log_f[np.all(np.isfinite(log_f), axis=1)])
        held = self._held(values, log_sd)
        doubts += outside(names, np.exp(self._measured()[0]), hz, self._not_drawn())
        if held is not None:
            held_names = [f"{name}, held out" for name in held.mode_names]
            doubts += outside(held_names, held.measured_hz, held.predicted_hz, held.measured_sd)
        return Predicted(hz, held, check, rival), doubts

    def _checked(self, doubts: list[str]) -> bool:
        """Whether the specimens suffice to check scatter and correlation; a doubt if not."""
        if self.table is None or self.table.shape[1] < 2 or self.section.kind == "gaussian":
            return False
        n = int(np.sum(np.all(np.isfinite(self.table), axis=1)))
        if n < FEWEST_CHECKED:
            doubts.append(
                f"scatter and correlation are not checked: {n} specimens have all modes, expected "
                f"at least {FEWEST_CHECKED}"
            )
        return n >= FEWEST_CHECKED

    def _not_drawn(self) -> np.ndarray | float:
        """Relative error of a measured frequency that the draws do not have themselves."""
        if self.section.kind != "gaussian":
            return 0.0  # draws are of specimens, which scatter
        sd = self._measured()[1]
        if self.table is not None:
            sd = sd / np.sqrt(np.sum(np.isfinite(self.table), axis=0))
        return np.hypot(np.nan_to_num(sd), self.discrepancy)

    def _offset_doubts(self, chains: Chains) -> list[str]:
        """Modes that the model has only with more than the discrepancy that was allowed."""
        rows = [row for row in chains.table() if row["name"].startswith("offset ")]
        return [
            f"{row['name']}: {100 * row['mean']:.2g} %, more than {_OFFSET:g} times the assumed "
            f"discrepancy of the model, {100 * self.discrepancy:g} %"
            for row in rows
            if abs(row["mean"]) > _OFFSET * self.discrepancy
        ]

    def _independent(self, chains: Chains) -> PredictiveCheck:
        replicates = replicate(chains, self.model.frequencies, len(self.table), _SETS)
        return check_predictive(self.data.mode_names, self.table, replicates)

    def _rival(self, doubts: list[str]) -> PredictiveCheck | None:
        """The predictive check of the paper's likelihood; a doubt where it cannot be sampled."""
        self.progress.step("the paper's likelihood, for comparison")
        try:
            model, likelihood = self.model, self._likelihood("fitted")
            posterior = Posterior(model.prior, model.frequencies, likelihood)
            settings = replace(self.settings, sampler="metropolis", samples=5000, burn_in=1000)
            return self._independent(sample(posterior, settings, self.comm))
        except (InputError, ConvergenceError) as error:
            doubts.append(f"not compared with the paper's likelihood: {error}")
            return None

    def _count(self) -> int:
        return _HELD_SMALL if self.model.n_dofs < _SMALL else _HELD

    def _held(self, values: np.ndarray, log_sd) -> HeldModes | None:
        n = len(self.data.mode_names)
        if len(self.case.measurements().mode_names) == n:
            return None
        self.progress.step("modes that were held out", len(values))
        points = [{**self.model.start, **point} for point in self.model.frequencies.by_name(values)]
        return predict_held(self.case, self.row, n, points, log_sd, self.comm, self.progress)


def predict_held(
    case: Case,
    row: int,
    n_fitted: int,
    points: Sequence[Mapping[str, float]],
    log_sd: np.ndarray | float,
    comm: MPI.Intracomm,
    progress: Progress | None = None,
    seed: int = 0,
) -> HeldModes:
    """Frequencies of the test's modes above those that were fitted. Collective.

    Args:
        case: The case.
        row: Which of the test's conditions.
        n_fitted: Number of modes in the likelihood, the lowest of the test's.
        points: All values of the model, a draw of the posterior each.
        log_sd: Standard deviation of a frequency about the model's, for each point or all.
        comm: Communicator.
        progress: Told after each point.
        seed: Of the scatter about the model.

    Raises:
        InputError: If the model has these modes at none of the points.
    """
    data, full = case.measurements(), build_structure(case, comm)
    n_test, n_modes = len(data.mode_names), max(case.diagnose.n_modes, len(data.mode_names))
    start = {**case.nominal(), **case.start()}
    first = pair_modes(
        solve_modes(full, start, n_modes=n_modes), n_test, data.sensors, reference=data.shapes
    )
    reference, found = first.shapes if data.shapes is None else data.shapes, []
    for values in points:
        if progress is not None:
            progress.advance()
        try:
            modes = solve_modes(full, values, n_modes=n_modes)
            index = pair_modes(modes, n_test, data.sensors, reference=reference).index
        except InputError:
            found.append(np.full(n_test - n_fitted, np.nan))
            continue
        found.append(modes.frequencies_hz[index[n_fitted:]])
    scatter = np.random.default_rng([seed, 9]).standard_normal(np.shape(found))
    log_f = np.log(found) + np.broadcast_to(log_sd, len(found))[:, None] * scatter
    there = np.all(np.isfinite(log_f), axis=1)
    if not there.any():
        raise InputError(f"{case.path}: no draw of the posterior gives the held-out modes.")
    return HeldModes(
        data.mode_names[n_fitted:],
        data.frequencies_hz[row, n_fitted:],
        data.log_sd()[row, n_fitted:],
        np.exp(log_f[there]),
    )
