"""The result of ``fenics-joints update --bayes``, and its document."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import numpy as np

import fenics_joints
from fenics_joints.bayes import Chains, Settings
from fenics_joints.bayes.checks import PredictiveCheck
from fenics_joints.commands.bayes import pictures
from fenics_joints.commands.bayes.model import CaseModel, HeldModes
from fenics_joints.files import plain
from fenics_joints.formatting import condition_value, number, percent, quantity
from fenics_joints.report import document as doc


@dataclass(frozen=True, eq=False)
class Predicted:
    """Predictions of converged chains.

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
    """The result of ``fenics-joints update --bayes``.

    Attributes:
        title: The case's title.
        condition: Name, value and unit of the condition of the data.
        chains: Draws, converged or not.
        units: Units of the quantities, by name.
        prior: In words, one for each parameter.
        likelihood: In words.
        doubts: Warnings, in words.
        mode_names: Names of the modes.
        measured_hz: One set of frequencies, or the specimens' mean, (m,).
        measured_sd: Relative standard deviation, or the specimens' scatter, (m,).
        predicted: Predictions; None from chains that did not converge.
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
        """Advice on chains that did not converge."""
        if self.keep is not None:
            return (
                f"The chains are kept in {self.keep}: the same command continues them. If that "
                "does not help: a narrower prior, or fewer parameters."
            )
        return (
            "Take more samples (update.bayes.samples), a longer burn-in or a narrower prior; with "
            "--keep FILE.nc the next run would continue these chains."
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
        groups, held = [(self.mode_names, self.measured_hz, self.predicted.hz)], self.predicted.held
        if held is not None:
            groups.append((held.mode_names, held.measured_hz, held.predicted_hz))
        rows = []
        for is_held, (names, measured, draws) in zip((False, True), groups, strict=False):
            low, median, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
            columns = {"mode": names, "measured_hz": measured, "median_hz": median}
            columns |= {"low_hz": low, "high_hz": high, "held": [is_held] * len(names)}
            rows += doc.records(**columns)
        return rows

    def to_json(self) -> dict[str, object]:
        """The documented keys of ``update --bayes --json``."""
        found, (samples, burn_in) = self.predicted, self.samples
        check, rival = (None, None) if found is None else (found.check, found.rival)
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
                "predictive_check": check and check.to_json(),
                "independent_check": rival and rival.to_json(),
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
        """Results of the checks against the specimens."""
        found = self.predicted
        words = [] if found is None or found.check is None else found.check.words()
        if found is not None and found.rival is not None:
            words += [
                f"likelihood of the paper, with independent frequencies: {line}"
                for line in found.rival.words()
            ]
        return words


# -- the document ----------------------------------------------------------------------------------


def bayes_document(b: BayesReport) -> doc.Document:
    """The document of a posterior."""
    name, value, unit = b.condition
    at = f"At {name} {condition_value(value, unit)}"
    sentences = [*b.answer(), *b.likelihood, *(f"note: {line}" for line in b.doubts)]
    verdicts = [doc.Verdict(at, [("", doc.sentence(line)) for line in sentences])]
    if b.failure is not None:
        failed = [
            "The chains have not converged to the posterior, and nothing is predicted from them.",
            *map(doc.sentence, b.chains.problems),
            b.advice,
        ]
        verdicts = [
            doc.Verdict(
                "Not converged: not to be used", [("", line) for line in failed], style="bad"
            ),
            *(doc.Text(line) for line in sentences),
        ]
    return doc.Document(
        b.title,
        "posterior",
        "Bayesian identification from measured frequencies",
        [
            *verdicts,
            *_values(b),
            *([] if b.predicted is None else _predictions(b)),
            *_chains(b),
            *_basis(b),
        ],
        b.to_json,
    )


def _values(b: BayesReport) -> list:
    state = "Chains so far" if b.failure else "Identified parameters"
    keys = ("mean", "sd", "low", "high", "rhat", "ess_bulk", "ess_tail")
    table = doc.Table.of(
        [
            row | {key: doc.Cell(in_words(row, key), value=plain(row[key])) for key in keys}
            for row in b.rows()
        ],
        "name: quantity | mean: >mean | sd: >s.d. | low: >5 % | high: >95 % | rhat: >R-hat | "
        "ess_bulk: >ESS, bulk | ess_tail: >ESS, tail",
        caption=f"{'Draws that are not yet the posterior' if b.failure else 'Posterior'}; R-hat at "
        "most 1.01 and at least 400 effective draws mean that the chains agree",
        id="values",
    )
    return [
        doc.Heading(state, "parameters"),
        table,
        doc.Figure(lambda: pictures.pairs(b.chains, b.units), "Draws of each pair of quantities."),
    ]


def _predictions(b: BayesReport) -> list:
    found = b.predicted
    rows = [r | {"mode": r["mode"] + ", held out" * r["held"]} for r in b.frequencies()]
    table = doc.Table.of(
        rows,
        "mode: mode | measured_hz: >measured, Hz | median_hz: >median, Hz | low_hz: >5 % | "
        "high_hz: >95 %",
        caption=f"Frequencies of {'new specimens' if found.check else 'the structure'}",
        id="frequencies",
    )
    held = ""
    if found.held is not None:
        held = (
            " Held-out modes do not enter the likelihood; they are computed with the full model at "
            f"{len(found.held.predicted_hz)} draws."
        )
    measured = (b.mode_names, b.measured_hz, b.measured_sd)
    blocks = [
        doc.Heading("Predicted frequencies", "predicted"),
        table,
        doc.Figure(
            lambda: pictures.frequencies(*measured, found.hz, found.held),
            f"Predicted frequencies: 90 % (thin), 50 % (thick) and the median.{held}",
        ),
    ]
    if found.check is None:
        return blocks
    rival = ""
    if found.rival is not None:
        rival = "; right: with a likelihood of independent frequencies"
    both = (found.check, found.rival)
    return [
        *blocks,
        doc.OnTerminal([doc.Text(f"- {line}") for line in b.sentences()]),
        doc.Items(b.sentences()),
        doc.Figure(
            lambda: pictures.correlations(*both),
            "Correlation of the frequencies of each pair of modes over the measured specimens, and "
            f"over as many new ones from the posterior (medians){rival}.",
        ),
        doc.Figure(
            lambda: pictures.scatter(*both),
            "Scatter and correlation of new sets of specimens, compared with the measured set.",
        ),
    ]


def _chains(b: BayesReport) -> list:
    figures = [
        doc.Figure(
            lambda: pictures.traces(b.chains, b.units),
            "Draws in sequence, a colour for each chain: chains that agree overlap.",
        ),
        doc.Figure(
            lambda: pictures.effective(b.chains, b.units),
            "Effective number of independent draws at each quantile; the dashed line is 400.",
        ),
    ]
    heading = doc.Heading("Convergence of the chains", "chains")
    if b.failure is not None:
        return [heading, *figures]
    folded = doc.Folded("Draws of every chain, and effective draws by quantile", figures)
    words = "R-hat and effective draws of all quantities are in the table at the top."
    return [heading, doc.OnPage([doc.Text(words)]), folded]


def _basis(b: BayesReport) -> list:
    """Prior, sampler and model of the posterior."""
    model, (samples, burn_in), least = b.model, b.samples, 1e-6
    table = doc.Table(" | ", id="model")
    for line in b.prior:
        table.add("prior", line)
    table.add(
        "sampler",
        f"{b.chains.sampler}; {b.settings.chains} chains of {samples} samples, the first {burn_in} "
        "discarded",
    )
    table.add(
        "model",
        f"{model.n_dofs} degrees of freedom, sampled with {model.n_basis}; error of frequencies "
        f"at most {percent(max(model.check.error, least), 4)} at {model.check.n_points} points of "
        f"the prior, estimated at these and more: {percent(max(model.bound, least), 4)}",
    )
    if model.check.n_missing:
        words = f"at {model.check.n_missing} of its points the model lacks a mode of the test"
        table.add("prior", words)
    return [
        doc.OnTerminal([doc.Text(f"{b.chains.sampler}; {b.settings.chains} chains", "note")]),
        doc.OnPage([doc.Heading("Model and assumptions", "rests-on"), table]),
    ]


def in_words(row: dict, key: str) -> str:
    """A number of a row of quantities with its unit; ratios other than correlations in per cent."""
    value, digits = row[key], 3 if key == "sd" else 4
    if key.startswith("ess"):
        return f"{value:.0f}"
    if key == "rhat":
        return f"{value:.3f}" if value < 10 else number(value)
    if row["unit"]:
        return quantity(value, row["unit"], digits)
    return f"{value:.2f}" if row["name"].startswith("correlation") else f"{number(100 * value)} %"
