"""Summary of nonlinear frequency responses for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from fenics_joints.case_harmonic import identifiable
from fenics_joints.formatting import hertz, number, percent, quantity
from fenics_joints.measured_curves import UNITS
from fenics_joints.summary import new_table, say

if TYPE_CHECKING:
    from fenics_joints.harmonic_run import HarmonicReport

__all__ = ["harmonic"]


def harmonic(console: Console, r: HarmonicReport) -> None:
    """Print the peaks of all levels, beside the measured ones."""
    title, model = r.case.title or r.case.path.parent.name, r.built.model
    say(console, f"{title}: response to sinusoidal forces", "bold")
    points = ", ".join(f"{p.name} {len(p)}" for p in model.interfaces)
    say(
        console,
        f"mode at rest {hertz(r.built.frequencies_hz[r.built.mode])} Hz; {r.built.n_dofs} degrees "
        "of freedom,",
    )
    say(console, f"{model.n_dofs} after reduction; points of joints: {points}")
    console.print()
    measured = r.curves is not None
    unit = UNITS[r.kind].replace("s2", "s²")
    columns = [">force", ">peak, Hz", f">{r.kind}, {unit}", ">damping", ">in joints, per cycle"]
    if measured:
        columns += [">test, Hz", f">test, {unit}", ">error, Hz", ">error"]
    rows = new_table(*columns)
    for f in r.facts:
        cells = [
            quantity(f.level, "N"), f"{f.frequency_hz:.3f}", number(f.amplitude, 4),
            percent(f.damping_ratio), quantity(sum(f.joint_energy.values()), "J"),
        ]  # fmt: skip
        if measured:
            cells += ["-"] * 4 if f.measured is None else [
                f"{f.measured_hz:.3f}", number(f.measured, 4),
                percent(f.frequency_hz / f.measured_hz - 1, sign=True),
                percent(f.amplitude / f.measured - 1, sign=True),
            ]  # fmt: skip
        rows.add_row(*cells)
    console.print(rows)
    if r.identified:
        _identified(console, r)
    if r.predictions:
        _predictions(console, r)
    steps = sum(len(response) for response in r.responses)
    say(console, f"{steps} points of the responses, {r.seconds:.0f} s in all")
    if any(f.turning_points for f in r.facts):
        say(console, "some responses turn back in frequency: a swept test would jump there")


def _identified(console: Console, r: HarmonicReport) -> None:
    """The parameters found, by each method."""
    console.print()
    known = identifiable(r.case)
    first = r.identified[0]
    say(console, f"identified from the curve at {quantity(first.level, 'N')}", "bold")
    rows = new_table(
        "method", *(f">{name}" for name in first.values), ">eq. 6", ">responses", ">solutions"
    )
    for found in r.identified:
        cells = [_value(found, name, known[name][1]) for name in found.values]
        rows.add_row(
            found.method, *cells, f"{found.start_objective:.3f} -> {found.objective:.4f}",
            str(found.evaluations), str(found.solutions),
        )  # fmt: skip
    console.print(rows)
    if left := r.identified[-1].undetermined:
        say(console, f"not determined by these data: {', '.join(left)}")


def _value(found, name: str, unit: str) -> str:
    spread = found.sd[name]
    text = quantity(found.values[name], unit, 4)
    return f"{text} ± {percent(spread, 1)}" if spread < 1 else f"{text} (open)"


def _predictions(console: Console, r: HarmonicReport) -> None:
    """How far the model is from every measured curve."""
    console.print()
    fitted = {found.level for found in r.identified}
    rows = new_table("measured curve", ">peak, Hz", ">error", f">peak, {UNITS[r.kind]}", ">error",
                     ">mean error near the peak")  # fmt: skip
    for p in r.predictions:
        (hz, amplitude), _ = p.peaks
        word = "fitted" if p.level in fitted else "predicted"
        rows.add_row(
            f"{quantity(p.level, 'N')}, {word}" if fitted else quantity(p.level, "N"),
            f"{hz:.3f}", percent(p.frequency_error, sign=True), number(amplitude, 4),
            percent(p.amplitude_error, sign=True), percent(p.mean_error),
        )  # fmt: skip
    console.print(rows)
