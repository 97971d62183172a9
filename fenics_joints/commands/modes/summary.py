"""The modes of a case on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.case import told
from fenics_joints.commands.modes.compared import Compared, condition_words
from fenics_joints.commands.modes.result import ModeList, ring_row
from fenics_joints.files import shown_path
from fenics_joints.formatting import extents, hertz, percent
from fenics_joints.report.terminal import new_table, say, tell

#: Rows of each table, so that all of it fits on a screen.
_MODES, _RINGS, _PAIRS = 26, 16, 12


def show_modes(console: Console, result: ModeList) -> None:
    """Print natural frequencies, the bolts' rings and the size of the model."""
    say(console, f"{result.case.name}: nominal model", "bold")
    table = new_table(">mode", ">frequency, Hz", "what it is")
    rows = list(zip(result.frequencies_hz, result.kinds(), strict=True))
    for i, (f, kind) in enumerate(rows[:_MODES]):
        dim = kind.startswith(("rigid", "not"))
        table.add_row(str(i + 1), hertz(float(f)), kind, style="dim" if dim else None)
    console.print(table)
    if len(rows) > _MODES:
        say(console, f"and {len(rows) - _MODES} more", "dim")
    if result.rings:
        table = new_table("ring", ">centre, mm", ">thick, mm", ">radii, mm", "between")
        for ring in result.rings[:_RINGS]:
            table.add_row(*(Text(cell) for cell in ring_row(ring)))
        console.print(table)
        if len(result.rings) > _RINGS:
            say(console, f"and {len(result.rings) - _RINGS} more", "dim")
    size = f", {extents(result.size_m)}" if len(result.size_m) else ""
    if result.beside is not None:
        _show_pairs(console, result.beside)
    for note in result.notes:
        tell(console, told(note), "yellow")
    say(console, f"{result.modes.model.n_dofs} degrees of freedom{size}")
    for path in result.written:
        say(console, f"wrote {shown_path(path)}")


def _show_pairs(console: Console, beside: Compared) -> None:
    """The test's modes with their partners."""
    at = condition_words(beside)
    rms = f"error {percent(beside.rms)} (root mean square)" if beside.partnered.any() else "no pair"
    tell(console, f"test{at}: {rms}", "bold")
    table = new_table("test", ">Hz", ">mode", ">model, Hz", ">error", ">MAC")
    for pair in beside.to_json()["pairs"][:_PAIRS]:
        hz, error, value = pair["model_hz"], pair["error_percent"], pair["mac"]
        table.add_row(
            Text(pair["name"]),
            "–" if pair["test_hz"] is None else hertz(pair["test_hz"]),
            "none" if hz is None else str(pair["mode"]),
            "–" if hz is None else hertz(hz),
            "–" if error is None else percent(error / 100, 2, sign=True),
            "–" if value is None else f"{value:.3f}",
        )
    console.print(table)
    if len(beside.names) > _PAIRS:
        say(console, f"and {len(beside.names) - _PAIRS} more", "dim")
