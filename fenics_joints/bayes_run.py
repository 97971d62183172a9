"""``fenics-joints update --bayes``: the posterior of a case's parameters, and what it predicts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

import fenics_joints
from fenics_joints.bayes.arviz_files import arviz
from fenics_joints.bayes.case_model import CaseModel, case_model
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.hierarchical import Specimens, sample_hierarchy
from fenics_joints.bayes.likelihood import FittedLikelihood, GaussianLikelihood
from fenics_joints.bayes.posterior import Posterior
from fenics_joints.bayes.predictive import PredictiveCheck, check_predictive, replicate
from fenics_joints.bayes.samplers import Settings, sample
from fenics_joints.case import Case
from fenics_joints.case_bayes import Bayes, bayes_data, specimens
from fenics_joints.files import check_writable
from fenics_joints.meshes.tagged import on_root
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["BayesReport", "run_bayes"]

_SETS, _PREDICTED = 400, 2000


@dataclass(frozen=True, eq=False)
class BayesReport:
    """What ``fenics-joints update --bayes`` found.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition of the data.
        chains: Draws; converged, or there would be no report.
        units: Units of the parameters, by name.
        prior: In words, one for each parameter.
        likelihood: In words.
        doubts: What to be wary of, in words.
        mode_names: Names of the modes.
        measured_hz: One set of frequencies, or the specimens' mean, (m,).
        measured_sd: Relative standard deviation, or the specimens' scatter, (m,).
        predicted_hz: Draws of frequencies, (n, m).
        check: Against the specimens, or None without.
        model: The model, and how good its reduction is.
        settings: How it was sampled.
    """

    title: str
    condition: tuple[str, float, str]
    chains: Chains
    units: dict[str, str]
    prior: list[str]
    likelihood: list[str]
    doubts: list[str]
    mode_names: tuple[str, ...]
    measured_hz: np.ndarray
    measured_sd: np.ndarray
    predicted_hz: np.ndarray
    check: PredictiveCheck | None
    model: CaseModel
    settings: Settings

    def rows(self) -> list[dict]:
        """Each quantity: mean, sd, median, 90 % interval, R-hat, effective sample sizes, unit."""
        return [{**row, "unit": self.units.get(row["name"], "")} for row in self.chains.table()]

    def predicted(self) -> list[dict]:
        """Measured and predicted frequency of each mode, with its 90 % interval."""
        low, median, high = np.quantile(self.predicted_hz, [0.05, 0.5, 0.95], axis=0)
        return [
            {
                "mode": name, "measured_hz": float(f) if np.isfinite(f) else None,
                "median_hz": float(median[i]), "low_hz": float(low[i]), "high_hz": float(high[i]),
            }
            for i, (name, f) in enumerate(zip(self.mode_names, self.measured_hz, strict=True))
        ]  # fmt: skip

    def json(self) -> dict[str, object]:
        """The documented keys of ``update --bayes --json``."""
        return {
            "version": fenics_joints.__version__,
            "title": self.title,
            "parameters": [_finite(row) for row in self.rows()],
            "correlation": {
                "names": list(self.chains.names),
                "matrix": self.chains.correlation().tolist(),
            },
            "prior": self.prior,
            "likelihood": self.likelihood,
            "doubts": self.doubts,
            "frequencies": self.predicted(),
            "predictive_check": None if self.check is None else self.check.to_json(),
            "sampler": {
                "name": self.chains.sampler,
                "chains": self.settings.chains,
                "samples": self.settings.samples,
                "burn_in": self.settings.burn_in,
                "seed": self.settings.seed,
                "acceptance": float(np.mean(self.chains.acceptance)),
                "evaluations": self.chains.evaluations,
            },
            "model": {
                "dofs": self.model.n_dofs,
                "basis": self.model.n_basis,
                "frequency_error": self.model.check.error,
                "checked_points": self.model.check.n_points,
                "points_without_modes": self.model.check.n_missing,
            },
        }

    def html(self) -> str:
        """The page."""
        from fenics_joints.bayes import pictures
        from fenics_joints.report import render, svg

        names, pair = list(self.chains.names), pictures.pairs(self.chains, self.chains.names)
        return render(
            "bayes.html", b=self, rows=self.rows(), predicted=self.predicted(),
            trace=svg(pictures.traces(self.chains, names)),
            pair=None if pair is None else svg(pair),
            frequencies=svg(pictures.frequencies(
                self.mode_names, self.measured_hz, self.measured_sd, self.predicted_hz
            )),
            correlations=None if self.check is None else svg(pictures.correlations(self.check)),
        )  # fmt: skip

    def show(self, console: Console) -> None:
        """Print the summary."""
        from fenics_joints.formatting import hertz, quantity
        from fenics_joints.summary import new_table, say

        say(console, f"{self.title}: posterior", "bold")
        for line in (*self.likelihood, f"{self.chains.sampler}; {self.settings.chains} chains"):
            say(console, line)
        for line in self.doubts:
            say(console, f"but: {line}", "yellow")
        table = new_table("quantity", ">mean", ">s.d.", ">5 %", ">95 %", ">R-hat", ">ESS")
        for row in self.rows():
            table.add_row(
                row["name"],
                *(quantity(row[k], row["unit"]) for k in ("mean", "sd", "low", "high")),
                f"{row['rhat']:.3f}", f"{min(row['ess_bulk'], row['ess_tail']):.0f}",
            )  # fmt: skip
        console.print(table)
        table = new_table("mode", ">measured, Hz", ">predicted, Hz", ">5 %", ">95 %")
        for row in self.predicted():
            keys = ("measured_hz", "median_hz", "low_hz", "high_hz")
            table.add_row(row["mode"], *(hertz(row[k]) for k in keys))
        console.print(table)
        for line in [] if self.check is None else self.check.words():
            say(console, line)


def run_bayes(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, keep: Path | None = None
) -> BayesReport:
    """The ``update --bayes`` command. Collective.

    Args:
        case: The case.
        comm: Communicator; the chains are shared out over its ranks.
        progress: Told what is being done.
        keep: File of the chains, see `fenics_joints.bayes.samplers.sample`.

    Raises:
        InputError: If the case, a prior or the data cannot be used; a distribution does not fit.
        ConvergenceError: If the chains did not converge; they are in the file all the same, to be
            prolonged. Or if the reduced model is not good enough.
    """
    arviz()  # missing, it is said before the work
    if keep is not None:
        on_root(comm, lambda: check_writable(keep, "--keep"))
    with threadpool_limits(1):
        model = case_model(case, comm, progress)
        return _Run(case, model, comm, progress, keep).report()


class _Run:
    def __init__(self, case: Case, model: CaseModel, comm, progress: Progress, keep):
        self.case, self.model, self.comm, self.keep = case, model, comm, keep
        self.section = case.update.bayes or Bayes()
        self.data, self.progress = bayes_data(case), progress
        at = case.update.at
        self.row = self.data.row(at) if at is not None else len(self.data) - 1
        self.table = None if self.section.specimens is None else specimens(case)
        own = self.section.discrepancy
        self.discrepancy = case.diagnose.discrepancy if own is None else own
        samples, burn_in = self.section.length()
        self.settings = Settings(
            self.section.sampler, samples, burn_in, self.section.chains, self.section.seed
        )

    def report(self) -> BayesReport:
        case, condition = self.case, float(self.data.conditions[self.row])
        kind, names = self.section.kind, self.data.mode_names
        progress, last = self.progress, [0]
        progress.step("sampling", 100)

        def told(share: float) -> None:
            now = int(100 * share)
            progress.advance(now - last[0])
            last[0] = now

        run = {"comm": self.comm, "keep": self.keep, "told": told}
        doubts: list[str] = []
        if kind == "hierarchical":
            chains, words, replicates = self._hierarchy(run)
        else:
            likelihood = self._likelihood(kind)
            doubts, words = likelihood.doubts(), likelihood.describe()
            posterior = Posterior(self.model.prior, self.model.frequencies, likelihood)
            chains = sample(posterior, self.settings, **run).require_converged()
            replicates = None
            if kind == "fitted":
                replicates = replicate(chains, self.model.frequencies, len(self.table), _SETS)
        check = None
        if replicates is not None and len(names) > 1:
            check = check_predictive(names, self.table, replicates)
        log_f, sd = self._measured()
        return BayesReport(
            case.title, (self.data.condition_name, condition, self.data.condition_unit), chains,
            {p.name: p.unit for p in self.model.prior.parameters},
            list(self.model.prior.describe()), words, doubts, names, np.exp(log_f), sd,
            self._predicted(chains, replicates), check, self.model, self.settings,
        )  # fmt: skip

    def _likelihood(self, kind: str):
        names = self.data.mode_names
        if kind == "fitted":
            return FittedLikelihood.from_specimens(
                names, self.table, self.section.distributions, seed=self.settings.seed
            )
        if self.table is not None:
            return GaussianLikelihood.from_specimens(
                names, self.table, discrepancy=self.discrepancy
            )
        return GaussianLikelihood.from_row(
            names, self.data.frequencies_hz[self.row], self.data.log_sd()[self.row],
            self.discrepancy,
        )  # fmt: skip

    def _hierarchy(self, run):
        section = self.section
        data = Specimens(
            self.data.mode_names, self.table, section.noise, section.noise_known, section.scatter,
            self.discrepancy,
        )  # fmt: skip
        found = sample_hierarchy(
            data, self.model.prior, self.model.frequencies, self.settings, **run
        )
        found.chains.require_converged()
        words = [
            f"hierarchical: {len(self.table)} specimens scatter about a mean; discrepancy of the "
            f"model {100 * self.discrepancy:g} %"
        ]
        return found.chains, words, found.replicate(self.model.frequencies, _SETS)

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """ln f that the prediction is compared with, and its standard deviation."""
        if self.table is not None:
            logs = np.log(self.table)
            return np.nanmean(logs, axis=0), np.nanstd(logs, axis=0, ddof=1)
        return np.log(self.data.frequencies_hz[self.row]), self.data.log_sd()[self.row]

    def _predicted(self, chains: Chains, replicates) -> np.ndarray:
        """Frequencies, Hz, of new specimens, or of the structure where there are none."""
        if replicates is not None:
            return np.exp(replicates.reshape(-1, replicates.shape[2]))
        draws = chains.draws()
        some = np.random.default_rng(self.settings.seed).choice(len(draws), _PREDICTED)
        return np.exp(self.model.frequencies(draws[some]))


def _finite(row: dict) -> dict:
    return {k: v if isinstance(v, str) or np.isfinite(v) else None for k, v in row.items()}
