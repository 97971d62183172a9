"""The posterior of a case's parameters as a page."""

from __future__ import annotations

from fenics_joints.commands.bayes import pictures
from fenics_joints.commands.bayes.result import BayesReport, in_words
from fenics_joints.report.html import render, svg


def bayes_html(b: BayesReport) -> str:
    """The page of ``update --bayes``."""
    found, shown = b.predicted, pictures.Shown(b.chains, b.units)
    given = {
        "trace": shown.traces(),
        "effective": shown.effective(),
        "pair": shown.pairs(),
        "frequencies": None,
        "correlations": None,
        "scatter": None,
    }
    if found is not None:
        given["frequencies"] = pictures.frequencies(
            b.mode_names, b.measured_hz, b.measured_sd, found.hz, found.held
        )
    if found is not None and found.check is not None:
        given["correlations"] = pictures.correlations(found.check, found.rival)
        given["scatter"] = pictures.scatter(found.check, found.rival)
    given = {key: None if text is None else svg(text) for key, text in given.items()}
    return render(
        "bayes.html", b=b, rows=b.rows(), in_words=in_words, predicted=b.frequencies(), **given
    )
