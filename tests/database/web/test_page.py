"""The page as a function of what was typed."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import pytest
from mpi4py import MPI

from fenics_joints.database import JointRow, JointSurfaces, Store
from fenics_joints.database.web.page import Page
from fenics_joints.database.web.server import Refused

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")
EVIL = "<script>alert(1)</script>\"'&"


def shown(page: Page, **typed: str) -> str:
    return page.reply("", typed).body.decode()


@pytest.fixture(scope="module")
def page(seed_surfaces) -> Page:
    return Page(seed_surfaces)


@pytest.fixture(scope="module")
def hostile_page() -> Page:
    """Of a database that someone sent: texts are markup; plates of one thickness, some rough."""
    store = Store(":memory:")
    same = {"diameter": 0.012, "bolt": "M12", "thickness": 0.02, "model": EVIL, "source": EVIL}
    store.add(
        JointRow(
            force=1e3 * (10 + 7 * i), roughness=1e-6 * (1 + i % 3), radius=0.03 + 1e-3 * i, **same
        )
        for i in range(6)
    )
    return Page(JointSurfaces.fit(store))


def test_what_is_typed_or_stands_in_the_database_is_text_and_no_markup(page, hostile_page):
    for text in (shown(page, torque=EVIL), shown(hostile_page, roughness="2")):
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
        assert "<script>" not in text and "alert(1)</" not in text
        assert re.findall(r"<script[^>]*>", text) == ['<script src="page.js" defer>']
        assert not re.search(r"\son\w+=|\sstyle=|javascript:", text)
    assert 'id="field-roughness" hidden' not in shown(hostile_page)
    assert 'id="field-roughness" hidden' in shown(page)


@pytest.mark.parametrize(
    "typed",
    [
        {"picture": "<svg>"},
        {"trame__title": "x"},
        {"torque": "1" * 41},
        {"bolt": "M12<b>"},
        {"way": "K2"},
        {"output": "picture"},
        {"extrapolate": "yes"},
    ],
)
def test_what_the_form_does_not_offer_is_refused(page, typed):
    for path in ("", "picture.svg"):
        with pytest.raises(Refused, match="Bad Request"):
            page.reply(path, typed)


@pytest.mark.parametrize("path", ["ws", "index.html", "page.py", "../page.css", "page.html"])
def test_only_the_page_its_picture_style_and_script_are_served(page, path):
    with pytest.raises(Refused, match="Not Found"):
        page.reply(path, {})


@pytest.mark.parametrize(
    "text", ["", "ten", "nan", "inf", "1e999", "1_0", "١٢", "0x10", "1,2.3", "--1", "1e-99", "-5"]
)
def test_a_number_is_one_that_a_joint_can_have(page, text):
    said = re.search(r'id="error" role="alert">([^<]*)', shown(page, torque=text))[1]
    assert said.startswith("torque") and "expected a number" in said


def test_the_widest_questions_have_an_answer_and_a_picture(page, hostile_page):
    wide = {"extrapolate": "on", "way": "force"}
    for force, thickness in (("0,001", "0.01"), ("1e5", "1e4"), ("0.001", "1e4")):
        for p in (page, hostile_page):
            typed = wide | {"force": force, "thickness": thickness}
            assert 'id="extrapolated"' in shown(p, **typed) and "nan" not in shown(p, **typed)
            ElementTree.fromstring(p.reply("picture.svg", typed).body)
