"""Documents of the database: an answer, its rows, and how well each is predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from fenics_joints.database.joints import NUMBERS, JointRow
from fenics_joints.database.query import Answer, JointSurfaces, in_words
from fenics_joints.formatting import MISSING, number, percent, quantity
from fenics_joints.report.document import Cell, Document, Table, Text

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


def answer_document(answer: Answer) -> Document:
    """The document of an answer."""
    table, row = Table(" | "), answer.identified
    table.add("bolt force", f"{quantity(answer.force, 'N')} ({answer.force_from})")
    table.add("contact radius", in_words(answer.radius, "m"))
    table.add("mean pressure", in_words(answer.pressure, "Pa"))
    if row is not None:
        found = f"E {quantity(row.E, 'Pa')}, nu {quantity(row.nu)}, h {quantity(row.h, 'm')}"
        table.add("interface", found)
    table.add("", answer.identified_note)
    for note in answer.notes:
        table.add("note", note)
    return Document(answer.thread.name, "joint parameters", blocks=[table], data=answer.json)


def _cells(values: Mapping[str, float | None]) -> dict[str, Cell]:
    """Numbers by column, in the units in which these are read best."""
    return {
        name: Cell(MISSING if v is None else number(float(v) * _SHOWN[name][0], 4), value=v)
        for name, v in values.items()
    }


def _heads(names: Sequence[str]) -> dict[str, str]:
    return {name: f">{name}\n{_SHOWN[name][1]}".strip() for name in names}


def rows_document(
    path: str, rows: Sequence[JointRow], surfaces: JointSurfaces | None = None
) -> Document:
    """The rows and their sources, and each row predicted from the others.

    Args:
        path: The database.
        rows: Its rows.
        surfaces: What is fitted to them; None without predictions.
    """
    columns = [c for c in NUMBERS if any(getattr(j, c) is not None for j in rows)]
    if all(j.bolt for j in rows) and rows:
        columns.remove("diameter")  # the bolt's name says it
    sources = list(dict.fromkeys(map(_source, rows)))
    table = Table.of(
        [
            {
                "bolt": j.bolt or MISSING,
                **_cells({c: getattr(j, c) for c in columns}),
                "source": sources.index(_source(j)) + 1,
            }
            for j in rows
        ],
        {"bolt": "bolt", **_heads(columns), "source": ">from"},
    )
    blocks: list = [table, *(Text(f"{i}: {source}") for i, source in enumerate(sources, 1))]
    data: dict[str, object] = {"rows": [asdict(j) for j in rows]}
    if surfaces is not None:
        data["leave_one_out"] = left_out = {}
        for output, kriging in surfaces.kriging.items():
            left = kriging.leave_one_out()
            error = float(np.abs(left.error).mean())
            left_out[output] = {
                "kriging": kriging.in_words(),
                "predicted": left.value.tolist(),
                "error": left.error.tolist(),
                "standardised": left.standardised.tolist(),
                "mean_absolute_error": error,
            }
            made = []
            for x, y, value, off, z in zip(
                kriging.x, kriging.y, left.value, left.error, left.standardised, strict=True
            ):
                row = _cells({**dict(zip(kriging.inputs, x, strict=True)), output: y})
                row["predicted"] = _cells({output: value})[output]
                made.append({**row, "error_percent": 100 * off, "standardised": f"{z:+.1f}"})
            heads = _heads((*kriging.inputs, output)) | {"predicted": ">predicted"}
            heads |= {"error_percent": ">error", "standardised": ">standardised"}
            said = (
                f"mean absolute error {percent(error)}, spread of the standardised errors "
                f"{left.standardised.std():.2f} (1 if the uncertainty is right)"
            )
            blocks += [
                Text(f"{output}: each row predicted from the others", "bold"),
                Table.of(made, heads),
                Text(said),
                Text(kriging.in_words()),
            ]
    return Document(path, f"{len(rows)} rows", blocks=blocks, data=lambda: data)


def _source(j: JointRow) -> str:
    return "; ".join(part for part in (j.model, j.author, j.version, j.source) if part) or MISSING
