"""The notebooks of the documentation run from the first cell to the last."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib
import pytest

pytest.importorskip("dolfinx")
pytest.importorskip("jupytext")

import jupytext
from mpi4py import MPI

REPOSITORY = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((REPOSITORY / "docs" / "notebooks").glob("*.py"))
#: Of more than some seconds.
SLOW = ("diagnose", "harmonic")

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="once is enough")


def test_they_are_linked_and_have_no_outputs():
    page = (REPOSITORY / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 5 and all(f"(notebooks/{n.name})" in page for n in NOTEBOOKS)


@pytest.mark.parametrize(
    "notebook",
    [pytest.param(n, marks=pytest.mark.slow) if n.stem in SLOW else n for n in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_cells_run(notebook):
    matplotlib.use("Agg")
    cells = jupytext.read(notebook, fmt="py:light").cells
    # Lines such as "%matplotlib inline" are a notebook's own; in the script they are comments.
    code = [
        re.sub("^%", "# %", cell.source, flags=re.M) for cell in cells if cell.cell_type == "code"
    ]
    assert cells[0].cell_type == "markdown" and len(code) >= 2
    names = {"__file__": str(notebook)}
    for number, source in enumerate(code):
        exec(compile(source, f"{notebook.name}, cell {number + 1}", "exec"), names)
