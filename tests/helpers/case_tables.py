"""Tables of a virtual test, beside its case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np


def write_table(path: Path, heads: Sequence[str], rows) -> None:
    """A table with ten digits."""
    lines = [",".join(heads), *(",".join(f"{x:.10g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_frequencies(
    folder: Path,
    values: np.ndarray,
    name: str = "mode",
    condition: str = "",
    conditions: Sequence[float] = (),
    file: str = "frequencies.csv",
    unit: str = " [Hz]",
) -> list[str]:
    """The table of a test's frequencies, or of other numbers of its modes; names of the modes.

    Args:
        folder: Where to.
        values: (m,), or (n, m) by condition.
        name: What the modes are called, with a number.
        condition: Name and unit of the conditions; if empty there are none.
        conditions: (n,).
        file: Name of the table.
        unit: Of the numbers.
    """
    values = np.atleast_2d(values)
    names = [f"{name} {i + 1}" for i in range(values.shape[1])]
    heads = [f"{name}{unit}" for name in names]
    if condition:
        heads, values = [condition, *heads], np.column_stack([conditions, values])
    write_table(folder / file, heads, values)
    return names
