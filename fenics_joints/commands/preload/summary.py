"""Summaries of a preload and of a cut-off update for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from fenics_joints.formatting import hertz, percent, quantity
from fenics_joints.report.terminal import new_table, say

if TYPE_CHECKING:
    from fenics_joints.commands.preload.cutoff import CutoffReport
    from fenics_joints.commands.preload.run import PreloadReport

__all__ = ["area", "cutoff", "preload"]


def area(square_metres: float) -> str:
    """An area in mm2."""
    return f"{square_metres * 1e6:.0f} mm²"


def preload(console: Console, p: PreloadReport) -> None:
    """Print the contacts and what the preload does to the frequencies."""
    title = p.case.title or p.case.path.parent.name
    say(console, f"{title}: contact under preload", "bold")
    forces = ", ".join(f"{name} {quantity(f, 'N')}" for name, f in p.result.forces.items())
    iterations = f"{p.result.iterations} iterations, {p.result.model.jumps.n} degrees of freedom"
    say(console, f"{forces}; {iterations}")
    console.print()
    for c in p.contacts:
        rows = new_table(f"contact {c['name']}", ">")
        rows.add_row("force between the faces", quantity(c["force_n"], "N"))
        rows.add_row("peak pressure, facet", quantity(c["peak_pressure_pa"], "Pa"))
        rows.add_row("mean pressure, closed area", quantity(c["mean_pressure_pa"], "Pa"))
        rows.add_row("closed area", f"{area(c['area_m2'])} of {area(c['whole_area_m2'])}")
        rows.add_row("area above 1 MPa", area(c["area_above_1_mpa_m2"]))
        for bolt, radius in c["radius_m"].items():
            rows.add_row(Text(f"radius above 1 MPa, {bolt}"), quantity(radius, "m"))
        rows.add_row("open / slip / stick", f"{c['open']} / {c['slip']} / {c['stick']}")
        console.print(rows)
        console.print()
    rows = new_table(">elastic mode", ">stuck, Hz", ">preloaded, Hz", ">change")
    for i, (a, b) in enumerate(zip(p.stuck_hz, p.preloaded_hz, strict=True)):
        rows.add_row(str(i + 1), hertz(a), hertz(b), percent(b / a - 1, sign=True))
    console.print(rows)
    for path in p.written:
        say(console, f"wrote {path}")


def cutoff(console: Console, u: CutoffReport) -> None:
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
        say(console, f"stuck on {area(s.area)} of {area(u.whole_area)}")
        rows = new_table(
            "mode", ">test, Hz", ">stuck, Hz", ">best, Hz", ">stuck", ">best", ">crosses at"
        )
        for j, mode in enumerate(u.mode_names):
            test = u.test_hz[j]
            crossing = s.crossings[j]
            rows.add_row(
                Text(mode), hertz(test), hertz(u.stuck_hz[j]), hertz(s.frequencies_hz[j]),
                percent(u.stuck_hz[j] / test - 1, sign=True),
                percent(s.frequencies_hz[j] / test - 1, sign=True),
                "-" if crossing is None else quantity(crossing, "Pa"),
            )  # fmt: skip
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
