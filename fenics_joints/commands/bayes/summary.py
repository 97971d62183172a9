"""The posterior of a case's parameters on the terminal."""

from __future__ import annotations

from rich.console import Console

from fenics_joints.commands.bayes.result import BayesReport, in_words
from fenics_joints.formatting import hertz
from fenics_joints.report.terminal import new_table, say, tell


def show_bayes(console: Console, b: BayesReport) -> None:
    """Print the answer, what to doubt, and the numbers of the chains."""
    say(console, f"{b.title}: posterior", "bold")
    how = f"{b.chains.sampler}; {b.settings.chains} chains"
    for line in (*b.answer(), *b.likelihood, how):
        say(console, line)
    for line in b.doubts:
        tell(console, f"but: {line}", "yellow")
    if b.failure is not None:
        say(console, "not converged: the numbers below are not those of the posterior", "red")
    table = new_table("quantity", ">mean", ">s.d.", ">5 %", ">95 %", ">R-hat", ">ESS")
    for row in b.rows():
        table.add_row(
            row["name"],
            *(in_words(row, key) for key in ("mean", "sd", "low", "high")),
            in_words(row, "rhat"),
            f"{min(row['ess_bulk'], row['ess_tail']):.0f}",
        )
    console.print(table)
    if b.predicted is None:
        return
    table = new_table("mode", ">measured, Hz", ">predicted, Hz", ">5 %", ">95 %")
    for row in b.frequencies():
        keys = ("measured_hz", "median_hz", "low_hz", "high_hz")
        name = f"{row['mode']}, held out" if row["held"] else row["mode"]
        table.add_row(name, *(hertz(row[k]) for k in keys))
    console.print(table)
    for line in b.sentences():
        tell(console, f"- {line}")
