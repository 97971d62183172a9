"""Names that are markup, formulas or mathematics, from a case to its pages, in a browser."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("dolfinx")

from html_page import check_page
from mpi4py import MPI
from typer.testing import CliRunner

from fenics_joints.cli import app

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "demos" / "bolted_beams"
#: Ends every element and attribute that it could stand in, and runs whatever way it gets through.
RUN = "window.taken=1"
HOSTILE = (
    f"</title></style></script></svg>--></table>'\"><img src=x onerror={RUN}><svg onload={RUN}>"
    f"<script>{RUN}</script><a href=javascript:{RUN}>x</a>"
)
CONDITION = "<u>torque</u>"
NAMES = [
    f"<b onclick={RUN}>1</b>",
    f'"><img src=x onerror={RUN}>',
    "</script>",
    "$\\frac{1$",
    "=cmd|'/C calc'!A0",
    "javascript:alert(1)",
    "{{ 7*7 }}",
    "&lt;i&gt;",
]

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Bolted beams of a stranger: title, condition and modes of these names."""
    folder = tmp_path_factory.mktemp("hostile") / "<script>window.taken=1<script>"
    folder.mkdir()
    text = (DEMO / "case.toml").read_text(encoding="utf-8")
    text = text.replace('"Bolted beams"', json.dumps(HOSTILE))
    text = text.replace('condition = "torque"', f'condition = "{CONDITION}"')
    for i, name in enumerate(NAMES):
        text = text.replace(f'"mode {i + 1}"', json.dumps(name))
    text = text[: text.index("[update.bayes]")] + text[text.index("[diagnose]") :]
    (folder / "case.toml").write_text(text, encoding="utf-8")
    head, *rows = (DEMO / "frequencies.csv").read_text(encoding="utf-8").splitlines()
    assert len(head.split(",")) == len(NAMES) + 1
    cells = [f"{CONDITION} [N m]", *(f"{name} [Hz]".replace('"', '""') for name in NAMES)]
    heads = ",".join(f'"{cell}"' for cell in cells)
    (folder / "frequencies.csv").write_text("\n".join([heads, *rows]), encoding="utf-8")
    return folder


@pytest.mark.parametrize("command", ["check", "modes", "update"])
def test_names_stay_text_in_every_page(case, command, browser):
    """No script runs and no element comes in; the page says the names as they are."""
    page = case.parent / f"{command}.html"
    run = CliRunner().invoke(app, [command, str(case), "--report", str(page)])
    assert page.is_file(), run.output
    text = page.read_text(encoding="utf-8")
    if command != "check":  # which has no pictures of beams
        check_page(text)
    browser.show(page)
    assert browser.js("window.taken") is None
    assert (
        browser.js(
            "document.querySelectorAll('[onerror], [onload], [onclick], img[src=x], "
            "a[href^=javascript], b[onclick], u').length"
        )
        == 0
    )
    assert "<img src=x" in browser.js("document.body.innerText + document.title")
    assert "49" not in browser.js("document.title")
