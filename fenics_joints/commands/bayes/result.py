"""What ``fenics-joints update --bayes`` found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import numpy as np

import fenics_joints
from fenics_joints.bayes import Chains, Settings
from fenics_joints.bayes.predictive import PredictiveCheck
from fenics_joints.commands.bayes.held import HeldModes
from fenics_joints.commands.bayes.model import CaseModel
from fenics_joints.files import plain
from fenics_joints.formatting import number, quantity


@dataclass(frozen=True, eq=False)
class Predicted:
    """What converged chains predict.

    Attributes:
        hz: Draws of the frequencies that were fitted, (n, m).
        held: Modes that were not, or None.
        check: Against the specimens, or None without.
        rival: The same check of the paper's likelihood, beside a hierarchical one.
    """

    hz: np.ndarray
    held: HeldModes | None
    check: PredictiveCheck | None
    rival: PredictiveCheck | None

    def __repr__(self) -> str:
        return f"Predicted({len(self.hz)} draws of {self.hz.shape[1]} frequencies)"


@dataclass(frozen=True, eq=False)
class BayesReport:
    """What ``fenics-joints update --bayes`` found.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition of the data.
        chains: Draws, converged or not.
        units: Units of the quantities, by name.
        prior: In words, one for each parameter.
        likelihood: In words.
        doubts: What to be wary of, in words.
        mode_names: Names of the modes.
        measured_hz: One set of frequencies, or the specimens' mean, (m,).
        measured_sd: Relative standard deviation, or the specimens' scatter, (m,).
        predicted: What follows; None from chains that did not converge.
        model: The model, and how good its reduction is.
        settings: How it was sampled.
        keep: File of the chains, or None.
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
    predicted: Predicted | None
    model: CaseModel
    settings: Settings
    keep: Path | None

    def __repr__(self) -> str:
        state = "converged" if self.chains.converged else "not converged"
        return f"BayesReport({self.title!r}, {shorten(', '.join(self.units), 60)}, {state})"

    @property
    def failure(self) -> str | None:
        """Why nothing here may be used, and what to do; None for chains that converged."""
        if self.chains.converged:
            return None
        return (
            f"the chains did not converge ({self.chains.shortly()}): nothing is predicted from "
            f"them. {self.advice}"
        )

    @property
    def advice(self) -> str:
        """What to do about chains that did not converge."""
        if self.keep is not None:
            return (
                f"They are in {self.keep}: the same command goes on from there. If that does not "
                "help: a narrower prior, or fewer parameters."
            )
        return (
            "Take more samples (update.bayes.samples), a longer burn-in or a narrower prior; with "
            "--keep FILE.nc the next run would go on from these."
        )

    @property
    def samples(self) -> tuple[int, int]:
        """Draws of each chain that were made, and those thrown away."""
        info = self.chains.info
        return tuple(info[key] * info["walkers"] for key in ("steps", "burn_in"))

    def rows(self) -> list[dict]:
        """Each quantity: mean, sd, median, 90 % interval, R-hat, effective sample sizes, unit."""
        return [{**row, "unit": self.units.get(row["name"], "")} for row in self.chains.table()]

    def answer(self) -> list[str]:
        """The parameters, and how much specimens scatter, in words; none without convergence."""
        if self.failure is not None:
            return []
        rows = {row["name"]: row for row in self.rows()}
        said = [
            f"{n} is {in_words(rows[n], 'mean')} \N{PLUS-MINUS SIGN} {in_words(rows[n], 'sd')}"
            for n in self.units
        ]
        scatter = [
            f"{n} by {in_words(rows[f'scatter {n}'], 'mean')}"
            for n in self.units
            if f"scatter {n}" in rows
        ]
        found = [f"{', '.join(said)} (mean and standard deviation)"]
        return found + ([f"Specimens scatter in {', in '.join(scatter)}"] if scatter else [])

    def frequencies(self) -> list[dict]:
        """Measured and predicted frequency of each mode, with its 90 % interval; held ones last."""
        if self.predicted is None:
            return []
        rows = _rows(self.mode_names, self.measured_hz, self.predicted.hz, held=False)
        held = self.predicted.held
        if held is not None:
            rows += _rows(held.mode_names, held.measured_hz, held.predicted_hz, held=True)
        return rows

    def to_json(self) -> dict[str, object]:
        """The documented keys of ``update --bayes --json``."""
        found, (samples, burn_in) = self.predicted, self.samples
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.title,
                "converged": self.chains.converged,
                "problems": self.chains.problems,
                "parameters": self.rows(),
                "correlation": {
                    "names": list(self.chains.names),
                    "matrix": self.chains.correlation(),
                },
                "prior": self.prior,
                "likelihood": self.likelihood,
                "doubts": self.doubts,
                "frequencies": self.frequencies(),
                "predictive_check": None if not found or not found.check else found.check.to_json(),
                "independent_check": None
                if not found or not found.rival
                else found.rival.to_json(),
                "sampler": {
                    "name": self.chains.sampler,
                    "chains": self.settings.chains,
                    "samples": samples,
                    "burn_in": burn_in,
                    "seed": self.settings.seed,
                    "acceptance": np.mean(self.chains.acceptance),
                    "evaluations": self.chains.evaluations,
                },
                "model": {
                    "dofs": self.model.n_dofs,
                    "basis": self.model.n_basis,
                    "frequency_error": self.model.check.error,
                    "estimated_error": self.model.bound,
                    "checked_points": self.model.check.n_points,
                    "points_without_modes": self.model.check.n_missing,
                },
            }
        )

    def sentences(self) -> list[str]:
        """What the checks against the specimens say."""
        found = self.predicted
        words = [] if found is None or found.check is None else found.check.words()
        if found is not None and found.rival is not None:
            words += [
                f"the paper's likelihood, of independent frequencies: {line}"
                for line in found.rival.words()
            ]
        return words


def in_words(row: dict, key: str) -> str:
    """A number of a row of quantities with its unit; ratios other than correlations in per cent."""
    if key == "rhat":
        return f"{row[key]:.3f}" if row[key] < 10 else number(row[key])
    digits = 3 if key == "sd" else 4
    if row["unit"]:
        return quantity(row[key], row["unit"], digits)
    if row["name"].startswith("correlation"):
        return f"{row[key]:.2f}"
    return f"{number(100 * row[key], 3)} %"


def _rows(names, measured, draws, *, held: bool) -> list[dict]:
    low, median, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
    return [
        {
            "mode": name,
            "measured_hz": measured[i],
            "median_hz": median[i],
            "low_hz": low[i],
            "high_hz": high[i],
            "held": held,
        }
        for i, name in enumerate(names)
    ]
