"""Tables that several documents have: errors of frequencies, MAC, facts on a model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.files import plain
from fenics_joints.formatting import MISSING, condition_value, percent, spaced
from fenics_joints.measurements.gap import Gap
from fenics_joints.report.document import Cell, Table
from fenics_joints.report.mesh_pictures import diverging

#: Facts on the model, in words.
_FACTS = {
    "dofs": "degrees of freedom of the finite-element model",
    "basis": "vectors of the reduced model's basis",
    "samples": "parameter sets the basis was made from",
    "frequency_error": "largest frequency error of the reduced model against the full one",
    "solutions": "eigenproblems solved",
    "seconds": "seconds that the diagnosis took",
    "reduced_solutions": "eigenproblems of the reduced model solved",
    "not_converged": "conditions at which the identification did not converge, left out",
    "mesh_error": "error of the mesh alone, by the same mesh one degree higher, taken off",
    "crossing_modes": "modes of the test that change places in the model (followed by MAC)",
    "lines_fitted": "lines of the functions that were fitted",
    "lines_measured": "measured lines",
    "functions": "measured functions",
    "function_error": "largest error of the reduced model's functions against the full one's",
    "function_noise": "relative standard deviation of the functions, median",
    "damping_error": "largest error of the reduced model's damping ratios against the full one's",
    "solution_error": "largest error of the drawn functions against a direct solution, two lines",
}


def facts_table(model: Mapping[str, object]) -> Table:
    """Facts on a model: names in words, and values."""
    table = Table(" | >", caption="The model", id="model")
    for key, value in model.items():
        table.add(_FACTS.get(key, spaced(key)), _fact(key, value))
    return table


def _fact(key: str, value) -> str:
    if key == "frequency_error":
        return percent(float(value), 4)
    if isinstance(value, list):
        return ", ".join(value) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {percent(x)}" for name, x in value.items()) or "none"
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    if key == "seconds":
        return f"{value:.1f}"
    whole = float(value).is_integer()
    return f"{int(value):,}".replace(",", "\N{NO-BREAK SPACE}") if whole else f"{value:.4g}"


def frequency_table(
    caption: str,
    before: Gap | None,
    after: Gap,
    condition: tuple[str, str],
    names: tuple[str, str],
    row_names: Sequence[str] = (),
) -> Table:
    """Measured frequencies beside one or two models' at every condition, and the errors.

    Args:
        caption: Of the table.
        before: The first model, or None.
        after: The other.
        condition: Name and unit of the condition.
        names: Of the models.
        row_names: Words behind each condition, such as a known change of the structure.
    """
    pairs = zip(("before", "after"), names, (before, after), strict=True)
    gaps = [(key, name, gap) for key, name, gap in pairs if gap]
    columns = {"condition": condition[0], "mode": "mode", "test_hz": ">measured, Hz"}
    columns |= {f"{key}_hz": f">{name}, Hz" for key, name, _ in gaps}
    columns |= {f"error_{key}_percent": f">{name}" for key, name, _ in gaps}
    heads, rows = _row_heads(after, condition[1], row_names), []
    for i, j in np.ndindex(after.test_hz.shape):
        row = {"condition": heads[i], "mode": after.mode_names[j], "test_hz": after.test_hz[i, j]}
        for key, _, gap in gaps:
            row[f"{key}_hz"] = gap.model_hz[i, j]
            row[f"error_{key}_percent"] = 100 * gap.relative[i, j]
        rows.append(plain(row))
    return Table.of(rows, columns, caption=caption, kind="frequencies")


def _row_heads(gap: Gap, unit: str, names: Sequence[str]) -> list[str]:
    """Conditions in words, with the names of their rows."""
    names = names or [""] * len(gap.conditions)
    pairs = zip(gap.conditions, names, strict=True)
    return [", ".join(filter(None, (condition_value(c, unit), name))) for c, name in pairs]


def heat_table(
    name: str,
    gap: Gap,
    condition: tuple[str, str],
    *,
    largest: float | None = None,
    row_names: Sequence[str] = (),
) -> Table:
    """Relative errors of every mode at every condition in colours, and their root mean squares.

    Args:
        name: Of the model.
        gap: The errors.
        condition: Name and unit of the condition.
        largest: Error that gets the full colour; by default the largest of this gap.
        row_names: See `frequency_table`.
    """
    largest = largest_error(gap) if largest is None else largest
    caption = f"{name}: model over test minus one"
    table = Table([condition[0], *gap.mode_names, "RMS"], caption=caption, kind="heat")
    heads = _row_heads(gap, condition[1], row_names)
    for head, errors, rms in zip(heads, gap.relative, gap.by_condition(), strict=True):
        cells = (_heat_cell(e, largest) for e in errors)
        table.add(head, *cells, Cell(percent(rms, 1), kind="rms", value=float(rms)))
    by_mode = (percent(e, 1) for e in gap.by_mode())
    table.add("RMS", *by_mode, percent(gap.rms, 2), foot=True)
    return table


def largest_error(*gaps: Gap) -> float:
    """Largest error of several gaps: the common scale of their colours."""
    return max(float(np.nanmax(np.abs(g.relative), initial=0.0)) for g in gaps)


def _heat_cell(error: float, largest: float) -> Cell:
    if not np.isfinite(error):
        return Cell(MISSING)
    # A square root, so that errors of a tenth of the largest still show.
    strength = math.copysign(math.sqrt(min(abs(error) / largest, 1.0)), error) if largest else 0.0
    colour = diverging(0.5 + 0.5 * 0.9 * strength)[:3]
    return _coloured(percent(error, 1, sign=True), colour, float(error))


def mac_table(
    matrix: np.ndarray,
    rows: Sequence[str],
    columns: Sequence[object],
    caption: str,
    id: str = "",
    drawn: Sequence[object] = (),
) -> Table:
    """Values of the modal assurance criterion in colours, from white to blue.

    Args:
        matrix: The values, (n_rows, n_columns).
        rows: Names of the test's modes.
        columns: Of the model's modes.
        caption: Of the table.
        id: See `Table`.
        drawn: The columns that the page's view shows, in its order: a click on a value shows both
            shapes.
    """
    table = Table(["", *map(str, columns)], caption=caption, id=id, kind="heat")
    white, blue = np.array([247, 249, 250]) / 255, np.array([31, 95, 150]) / 255
    places = {column: place for place, column in enumerate(drawn)}
    for i, (name, values) in enumerate(zip(rows, matrix, strict=True)):
        cells = []
        for column, v in zip(columns, values.tolist(), strict=True):
            cell = _coloured(f"{v:.2f}", white + min(max(v, 0.0), 1.0) * (blue - white), v)
            pair = f"{i},{places[column]}" if column in places else ""
            cells.append(replace(cell, pair=pair))
        table.add(name, *cells)
    return table


def _coloured(text: str, colour: Sequence[float], value: float) -> Cell:
    """A cell on a colour, its channels from 0 to 1."""
    background = "#" + "".join(f"{round(255 * c):02x}" for c in colour)
    return Cell(text, css=f"background:{background};color:{ink_on(colour)}", value=value)


def ink_on(colour: Sequence[float]) -> str:
    """White or dark, whichever is told better from a colour from 0 to 1 (WCAG 2.1)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "#ffffff" if luminance < 0.179 else "#000000"
