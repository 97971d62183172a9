"""Contacts under preload on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.commands.preload.result import PreloadReport
from fenics_joints.formatting import hertz, percent, quantity
from fenics_joints.report.terminal import new_table, say

__all__ = ["area", "show_preload"]


def area(square_metres: float) -> str:
    """An area in mm2."""
    return f"{square_metres * 1e6:.0f} mm²"


def show_preload(console: Console, p: PreloadReport) -> None:
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
