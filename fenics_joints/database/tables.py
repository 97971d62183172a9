"""The database on the terminal."""

from __future__ import annotations

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from fenics_joints.database.joints import NUMBERS, JointRow
from fenics_joints.database.kriging import Interpolation
from fenics_joints.database.query import Answer, JointSurfaces
from fenics_joints.formatting import MISSING, interval, number, percent, prefixed, quantity

#: Factor and unit in which a column is read best.
_SHOWN = {
    "diameter": (1e3, "mm"),
    "force": (1e-3, "kN"),
    "torque": (1.0, "N·m"),
    "thickness": (1e3, "mm"),
    "roughness": (1e6, "µm"),
    "radius": (1e3, "mm"),
    "pressure": (1e-6, "MPa"),
    "E": (1e-9, "GPa"),
    "nu": (1.0, ""),
    "h": (1e3, "mm"),
}


def in_words(estimate: Interpolation | None, unit: str) -> str:
    """An estimate with its deviation and interval: ``51.4 ± 0.4 mm (95 %: 50.6 to 52.2 mm)``."""
    if estimate is None:
        return MISSING
    factor, shown = prefixed(estimate.value, unit)
    value, sd = number(estimate.value * factor), number(estimate.sd * factor, 2)
    mark = ", extrapolated" if estimate.extrapolated else ""
    return f"{value} ± {sd} {shown} (95 %: {interval(estimate.low, estimate.high, unit)}{mark})"


def show_answer(console: Console, answer: Answer) -> None:
    """Print an answer."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row("bolt force", f"{quantity(answer.force, 'N')} ({answer.force_from})")
    table.add_row("contact radius", in_words(answer.radius, "m"))
    table.add_row("mean pressure", in_words(answer.pressure, "Pa"))
    row = answer.identified
    if row is not None:
        found = f"E {quantity(row.E, 'Pa')}, nu {quantity(row.nu)}, h {quantity(row.h, 'm')}"
        table.add_row("interface", found)
    table.add_row("", answer.identified_note)
    for note in answer.notes:
        table.add_row("note", note)
    console.print(table, markup=False)


def show_rows(console: Console, rows: list[JointRow]) -> None:
    """Print the numbers of the rows, then their sources."""
    columns = [c for c in NUMBERS if any(getattr(j, c) is not None for j in rows)]
    if all(j.bolt for j in rows):
        columns.remove("diameter")  # the bolt's name says it
    sources = list(dict.fromkeys(map(_source, rows)))
    table = _table("bolt", *map(_head, columns), "from", title=f"{len(rows)} rows")
    for j in rows:
        cells = [_cell(getattr(j, c), c) for c in columns]
        table.add_row(j.bolt or MISSING, *cells, str(sources.index(_source(j)) + 1))
    console.print(table)
    for i, source in enumerate(sources, 1):
        console.print(f"{i}: {source}", markup=False, highlight=False)


def show_leave_one_out(console: Console, surfaces: JointSurfaces) -> None:
    """Print each row's value beside what all others predict."""
    for output, kriging in surfaces.kriging.items():
        left = kriging.leave_one_out()
        table = _table(
            *map(_head, kriging.inputs),
            _head(output),
            "predicted",
            "error",
            "standardised",
            title=f"{output}: each row predicted from the others",
        )
        for x, y, value, error, z in zip(
            kriging.x, kriging.y, left.value, left.error, left.standardised, strict=True
        ):
            cells = [_cell(v, n) for v, n in zip(x, kriging.inputs, strict=True)]
            cells += [_cell(y, output), _cell(value, output), percent(error), f"{z:+.1f}"]
            table.add_row(*cells)
        console.print(table)
        console.print(
            f"mean absolute error {percent(np.abs(left.error).mean())}, spread of the standardised "
            f"errors {left.standardised.std():.2f} (1 if the uncertainty is right)\n"
            f"{kriging.in_words()}\n",
            highlight=False,
            markup=False,
        )


def leave_one_out_json(surfaces: JointSurfaces) -> dict[str, object]:
    """What `show_leave_one_out` prints, for JSON."""
    content = {}
    for output, kriging in surfaces.kriging.items():
        left = kriging.leave_one_out()
        content[output] = {
            "kriging": kriging.in_words(),
            "predicted": left.value.tolist(),
            "error": left.error.tolist(),
            "standardised": left.standardised.tolist(),
            "mean_absolute_error": float(np.abs(left.error).mean()),
        }
    return content


def _table(*heads: str, title: str) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i == 0 else "right", overflow="fold")
    return table


def _head(column: str) -> str:
    unit = _SHOWN[column][1]
    return f"{column}\n{unit}" if unit else column


def _cell(value: float | None, column: str) -> str:
    return MISSING if value is None else number(float(value) * _SHOWN[column][0], 4)


def _source(j: JointRow) -> str:
    return "; ".join(part for part in (j.model, j.author, j.version, j.source) if part) or MISSING
