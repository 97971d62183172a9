"""What ``fenics-joints update --bayes`` found, and what is said of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import numpy as np

import fenics_joints
from fenics_joints.bayes import Chains, Settings
from fenics_joints.bayes.predictive import PredictiveCheck
from fenics_joints.commands.bayes import pictures
from fenics_joints.commands.bayes.model import CaseModel, HeldModes
from fenics_joints.files import plain
from fenics_joints.formatting import condition_value, hertz, number, percent, quantity
from fenics_joints.report.document import (
    Document,
    Figure,
    Folded,
    Heading,
    Items,
    OnPage,
    OnTerminal,
    Table,
    Text,
    Verdict,
    sentence,
)


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


# -- what is said of it ----------------------------------------------------------------------------


def bayes_document(b: BayesReport) -> Document:
    """What is said of a posterior."""
    name, value, unit = b.condition
    at = f"At {name} {condition_value(value, unit)}"
    sentences = [*b.answer(), *b.likelihood, *(f"but: {line}" for line in b.doubts)]
    verdicts = [Verdict(at, [("", sentence(line)) for line in sentences])]
    if b.failure is not None:
        failed = [
            "The chains have not found the posterior, and nothing is predicted from them.",
            *map(sentence, b.chains.problems),
            b.advice,
        ]
        verdicts = [
            Verdict("Not converged: not to be used", [("", line) for line in failed], style="bad"),
            *(Text(line) for line in sentences),
        ]
    return Document(
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
    state = "What the chains have so far" if b.failure else "What is known now"
    table = Table(
        "quantity | >mean | >s.d. | >5 % | >95 % | >R-hat | >ESS, bulk | >ESS, tail",
        caption=f"{'Draws that are not yet the posterior' if b.failure else 'Posterior'}; R-hat at "
        "most 1.01 and at least 400 effective draws mean that the chains agree",
        id="values",
    )
    for row in b.rows():
        numbers = (in_words(row, key) for key in ("mean", "sd", "low", "high", "rhat"))
        table.add(row["name"], *numbers, *(f"{row[key]:.0f}" for key in ("ess_bulk", "ess_tail")))
    shown = pictures.Shown(b.chains, b.units)
    return [
        Heading(state, "parameters"),
        table,
        Figure(shown.pairs, "Draws of each two quantities."),
    ]


def _predictions(b: BayesReport) -> list:
    found = b.predicted
    table = Table(
        "mode | >measured, Hz | >median, Hz | >5 % | >95 %",
        caption=f"Frequencies of {'new specimens' if found.check else 'the structure'}",
        id="frequencies",
    )
    for row in b.frequencies():
        keys = ("measured_hz", "median_hz", "low_hz", "high_hz")
        name = f"{row['mode']}, held out" if row["held"] else row["mode"]
        table.add(name, *(hertz(row[key]) for key in keys))
    held = ""
    if found.held is not None:
        held = (
            " Modes that were held out are no part of the likelihood; they are computed with the "
            f"full model at {len(found.held.predicted_hz)} draws."
        )
    measured = (b.mode_names, b.measured_hz, b.measured_sd)
    blocks = [
        Heading("What it predicts", "predicted"),
        table,
        Figure(
            lambda: pictures.frequencies(*measured, found.hz, found.held),
            f"Predicted frequencies: 90 % (thin), half (thick) and the median.{held}",
        ),
    ]
    if found.check is None:
        return blocks
    rival = ""
    if found.rival is not None:
        rival = "; right, by the product of a distribution for each frequency"
    both = (found.check, found.rival)
    return [
        *blocks,
        OnTerminal([Text(f"- {line}") for line in b.sentences()]),
        Items(b.sentences()),
        Figure(
            lambda: pictures.correlations(*both),
            "Correlation of each two modes' frequencies over the specimens, and of as many new "
            f"ones as the posterior has them (medians){rival}.",
        ),
        Figure(
            lambda: pictures.scatter(*both),
            "Scatter and correlation of new sets of specimens beside those of the measured one.",
        ),
    ]


def _chains(b: BayesReport) -> list:
    shown = pictures.Shown(b.chains, b.units)
    figures = [
        Figure(
            shown.traces,
            "Draws in their order, a colour for each chain: chains that agree lie on each other.",
        ),
        Figure(
            shown.effective,
            "How many independent draws the chains are worth at each quantile: the dashed line is "
            "400.",
        ),
    ]
    heading = Heading("Whether the chains can be believed", "chains")
    if b.failure is not None:
        return [heading, *figures]
    folded = Folded("Draws of every chain, and effective draws by quantile", figures)
    words = "R-hat and effective draws of all quantities are in the table at the top."
    return [heading, OnPage([Text(words)]), folded]


def _basis(b: BayesReport) -> list:
    """What the posterior rests on."""
    model, (samples, burn_in), least = b.model, b.samples, 1e-6
    table = Table(" | ", id="model")
    for line in b.prior:
        table.add("prior", line)
    table.add(
        "sampler",
        f"{b.chains.sampler}; {b.settings.chains} chains of {samples} samples, the first {burn_in} "
        "thrown away",
    )
    table.add(
        "model",
        f"{model.n_dofs} degrees of freedom, sampled with {model.n_basis}; frequencies off by at "
        f"most {percent(max(model.check.error, least), 4)} at {model.check.n_points} points of the "
        f"prior; estimated there and at more: at most {percent(max(model.bound, least), 4)}",
    )
    if model.check.n_missing:
        words = f"at {model.check.n_missing} of its points the model lacks a mode that the test saw"
        table.add("prior", words)
    return [
        OnTerminal([Text(f"{b.chains.sampler}; {b.settings.chains} chains", "note")]),
        OnPage([Heading("What this rests on", "rests-on"), table]),
    ]


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
