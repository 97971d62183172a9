"""Summary of nonlinear frequency responses for the terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.text import Text

from fenics_joints.commands.harmonic.identified import mode_notes, mode_rows, source
from fenics_joints.commands.harmonic.result import HarmonicReport
from fenics_joints.formatting import hertz, number, percent, quantity
from fenics_joints.harmonic import IdentificationResult
from fenics_joints.report.terminal import new_table, say


def show_harmonic(console: Console, r: HarmonicReport) -> None:
    """Print the peaks of all levels, beside the measured ones."""
    model = r.built.model
    say(console, f"{r.case.name}: response to {r.title}", "bold")
    points = ", ".join(f"{p.name} {len(p)}" for p in model.interfaces)
    say(
        console,
        f"mode at rest {hertz(r.built.frequencies_hz[r.built.mode])} Hz; {r.built.n_dofs} degrees "
        "of freedom,",
    )
    say(console, f"{model.n_dofs} after reduction; points of joints: {points}")
    console.print()
    rows = new_table(
        f">{r.drive}", ">peak, Hz", f">{r.kind}, {r.unit}", ">damping", ">in joints, per cycle"
    )
    for f in r.facts:
        rows.add_row(
            quantity(f.level, r.level_unit),
            f"{f.frequency_hz:.3f}",
            number(f.amplitude, 4),
            percent(f.damping_ratio),
            quantity(sum(f.joint_energy.values()), "J"),
        )
    console.print(rows)
    if r.static_backbone is not None:
        _modes(console, r)
    if r.stability:
        _stability(console, r)
    if r.identified:
        _identified(console, r)
    if r.predictions:
        _predictions(console, r)
    steps = sum(len(response) for response in r.responses)
    say(console, f"{steps} points of the responses, {r.seconds:.0f} s in all")
    if any(f.turning_points for f in r.facts):
        say(console, "some responses turn back in frequency: a swept test would jump there")
    if r.backbone_note is not None:
        say(console, r.backbone_note)
    for note in r.slider_notes:
        say(console, note)


def _modes(console: Console, r: HarmonicReport) -> None:
    """The mode at the peaks' displacements, by each method."""
    console.print()
    say(console, f"mode over amplitude: {'; '.join(r.mode_methods)}", "bold")
    rows = new_table(">displacement", *(">Hz", ">damping") * len(r.mode_methods))
    for displacement, found in r.mode_rows():
        words = [(f"{at[0]:.3f}", percent(at[1])) if at else ("-", "-") for at in found]
        rows.add_row(quantity(displacement, "m"), *(word for pair in words for word in pair))
    console.print(rows)
    if r.static_backbone.end != "reached":
        say(console, "under static loads the joint gives way before the highest amplitude")


def _stability(console: Console, r: HarmonicReport) -> None:
    """Where the responses' stability changes, and what leaves there."""
    console.print()
    if not any(s.stability.bifurcations for s in r.stability):
        lost = any(not s.stability.stable.all() for s in r.stability)
        say(console, f"no bifurcations; {'not all' if lost else 'all'} responses are stable")
        return
    say(console, "bifurcations, and how many disturbances grow before and after", "bold")
    rows = new_table(f">{r.drive}", "", ">Hz", ">displacement", ">growing", ">branch")
    for found in r.stability:
        for words in found.rows():
            rows.add_row(quantity(found.level, r.level_unit), *words)
    console.print(rows)
    for found in r.stability:
        for note in found.notes:
            say(console, note)


def _identified(console: Console, r: HarmonicReport) -> None:
    """The parameters found, by each method."""
    for found in r.identified:
        console.print()
        say(
            console,
            f"identified from {source(found)}, {found.method}: "
            f"{found.evaluations} responses ({found.solutions} solutions)",
            "bold",
        )
        say(
            console,
            f"sum of errors {found.start_objective:.3f} at the start, "
            f"{found.objective:.4f} at the end",
        )
        rows = new_table("parameter", ">start", ">found", ">s.d.")
        for name, *words in r.parameter_rows(found):
            rows.add_row(Text(name), *words)
        console.print(rows)
        if left := found.undetermined:
            say(console, f"not determined by these data: {', '.join(left)}")
        _mode_over_amplitude(console, found)


def _mode_over_amplitude(console: Console, found: IdentificationResult) -> None:
    """The measured mode beside the identified one."""
    if found.mode is None:
        return
    rows = new_table(">displacement", ">test, Hz", ">model, Hz", ">test, damping", ">model")
    for displacement, hz, made, zeta, ratio in mode_rows(found):
        rows.add_row(
            quantity(displacement, "m"),
            f"{hz:.3f}",
            f"{made:.3f}",
            "-" if np.isnan(zeta) else percent(zeta),
            percent(ratio),
        )
    console.print(rows)
    for note in mode_notes(found):
        say(console, note)


def _predictions(console: Console, r: HarmonicReport) -> None:
    """How far the model is from every measured curve."""
    console.print()
    fitted = r.fitted_levels
    rows = new_table(
        ">measured at", "", ">peak, Hz", ">error", f">peak, {r.unit}", ">error", ">mean error"
    )
    for p in r.predictions:
        (hz, amplitude), _ = p.peaks
        word = "fitted" if p.level in fitted else "predicted"
        rows.add_row(
            quantity(p.level, "N"),
            word if fitted else "",
            f"{hz:.3f}",
            percent(p.frequency_error, sign=True),
            number(amplitude, 4),
            percent(p.amplitude_error, sign=True),
            percent(p.mean_error),
        )
    console.print(rows)
    say(console, "mean error: of the amplitudes near the peak")
