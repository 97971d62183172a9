"""Tables of records, on a page, in its CSV and in the JSON file; charts in a page."""

from __future__ import annotations

import csv
import io
import re
from urllib.parse import unquote

import numpy as np
import pytest
from html_page import Page
from matplotlib.figure import Figure

from fenics_joints.files import plain
from fenics_joints.formatting import MISSING
from fenics_joints.report.document import Cell, Document, Folded, OnPage, Table, bar, records
from fenics_joints.report.html import DocumentPage, as_page
from fenics_joints.report.style import style, to_svg

ROWS = records(
    name=["=1+1", "b, <c>"],
    test_hz=np.array([27.3456789, np.nan]),
    error_percent=[1.23456, -0.001],
    force_n=[12345.678, 0.5],
)
COLUMNS = "name: mode | test_hz: >test, Hz | mac: >MAC | error_percent: >error | force_n: >force"


def table() -> Table:
    more = [{**ROWS[0], "size": Cell("2.00 mm", value=0.002)}, ROWS[1]]
    columns = f"{COLUMNS} | size: >size"
    return Table.of(more, columns, id="modes", on_page=("size",))


def read(text: str) -> list[dict]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_page_shows_units_and_the_csv_has_the_records():
    assert plain(ROWS) == ROWS and ROWS[1]["test_hz"] is None
    text = as_page(Document("case", "result", blocks=[table()]))
    page = Page(text)
    head, first, second = page.tables["modes"]
    # No record has a MAC.
    assert head == ["mode", "test, Hz", "error", "force", "size"]
    assert first == ["=1+1", "27.35", "+1.23 %", "12.3 kN", "2.00 mm"]
    assert second == ["b, <c>", MISSING, "+0.00 %", "500 mN", MISSING]
    link = re.search(r'href="data:text/csv;charset=utf-8,([^"]*)"', text)[1]
    found = read(unquote(link))
    assert found == read(table().to_csv())
    assert float(found[0]["test_hz"]) == 27.3456789 and float(found[0]["size"]) == 0.002
    assert float(found[1]["error_percent"]) == -0.001 and found[1]["name"] == "b, <c>"
    assert found[1]["test_hz"] == found[1]["size"] == ""
    # A spreadsheet runs no name as a formula.
    assert found[0]["name"] == "'=1+1"


def test_rows_have_styles_and_no_record_leaves_the_headings():
    made = Table.of(ROWS, COLUMNS, style=lambda row: "dim" if row["test_hz"] is None else "")
    assert [row.style for row in made.rows] == ["", "dim"]
    assert Table.of([], COLUMNS).names == ["mode", "test, Hz", "MAC", "error", "force"]
    assert table().page_columns == 1


def test_names_are_text_and_powers_of_ten_are_not():
    """Half a formula of mathematics ends nothing; ticks keep their powers."""
    name = r"cost $\frac{1$ & <b onclick=x>"
    with style():
        figure = Figure()
        axes, named = figure.subplots(1, 2)
        named.set_yticks([0.0, 1.0], [name, "b"])
        axes.loglog([1e-3, 1e3], [1.0, 2e5], label=name)
        axes.set(title=name, xlabel=name)
        axes.legend()
    text = to_svg(figure, "x", f'"{name}')
    assert text.count(r"cost $\frac{1$ &amp; &lt;b onclick=x&gt;") >= 4
    assert "mathdefault" not in re.sub("<!--.*?-->", "", text, flags=re.DOTALL)
    assert "<b " not in text and 'aria-label="&quot;cost' in text


def test_every_table_of_a_document_has_a_file_of_its_own():
    """Also those that are folded away, made for the page alone, or without a name."""
    plain = Table("a | b", caption="Errors: by mode, <all>")
    plain.add("x", "1")
    again = Table("a | b", caption="Errors: by mode, <all>")
    again.add("y", bar(0.25))
    inside = OnPage(lambda: [Folded("more", [again])])
    page = DocumentPage.of(Document("case", "result", blocks=[table(), plain, inside]))
    assert list(page.tables()) == ["modes", "errors_by_mode_all", "errors_by_mode_all_2"]
    assert page.html().count('class="csv"') == 3
    assert read(page.tables()["errors_by_mode_all_2"].to_csv()) == [{"a": "y", "b": "0.25"}]
    pytest.importorskip("pandas")
    frame = page.tables()["modes"].to_dataframe()
    assert frame["test_hz"][0] == 27.3456789 and frame["name"][0] == "=1+1"


def test_a_page_says_what_it_comes_from():
    run = {
        "date": "2026-01-02T03:04:05+00:00",
        "command": "fenics-joints modes <b>",
        "changes": ["title='</style>'"],
        "inputs": {"case.toml": "ab" * 32},
        "inputs_sha256": "cd" * 32,
        "seed": 7,
        "ranks": 2,
        **dict.fromkeys(("fenics_joints", "dolfinx", "petsc", "python"), "1.2.3"),
    }
    text = DocumentPage.of(Document("</style><b>", "result")).html(run)
    for words in ("2026-01-02", "modes &lt;b&gt;", "cdcdcdcdcdcdcdcd", "2 ranks", "case.toml"):
        assert words in text
    assert text.count("</style>") == 1 and "<b>" not in text.partition("<main>")[2]
