"""The update of a cut-off pressure on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.commands.cutoff.result import CutoffReport
from fenics_joints.commands.preload.contacts import area_words
from fenics_joints.formatting import hertz, percent, quantity
from fenics_joints.report.terminal import new_table, say


def show_cutoff(console: Console, u: CutoffReport) -> None:
    """Print the best cut-off of each scheme beside the test and the stuck model."""
    say(console, f"{u.case.title}: cut-off pressure", "bold")
    if u.calibration is not None:
        c = u.calibration
        value = quantity(c["value"], c["unit"], 4)
        say(console, f"{c['parameter']} = {value} from {c['mode']} of the stuck model")
    for s in u.schemes:
        console.print()
        best = f"{quantity(s.cutoff, 'Pa')}, sum of errors {percent(s.objective)}"
        say(console, f"{s.scheme} conditions: best cut-off {best}", "bold")
        say(console, f"stuck on {area_words(s.area)} of {area_words(u.whole_area)}")
        rows = new_table(
            "mode", ">test, Hz", ">stuck, Hz", ">best, Hz", ">stuck", ">best", ">crosses at"
        )
        for j, mode in enumerate(u.mode_names):
            test = u.test_hz[j]
            crossing = s.crossings[j]
            rows.add_row(
                Text(mode),
                hertz(test),
                hertz(u.stuck_hz[j]),
                hertz(s.frequencies_hz[j]),
                percent(u.stuck_hz[j] / test - 1, sign=True),
                percent(s.frequencies_hz[j] / test - 1, sign=True),
                "-" if crossing is None else quantity(crossing, "Pa"),
            )
        console.print(rows)
        say(
            console,
            f"{len(s.sweep.cutoffs)} cut-offs by {s.sweep_solves} full solutions, "
            f"error {percent(s.sweep.error, 3)}, {s.seconds:.0f} s",
        )
        m = s.minimum
        say(
            console,
            f"minimum alone: {quantity(m.cutoff, 'Pa')}, {percent(m.objective)} by "
            f"{len(m.visited)} full solutions",
        )
