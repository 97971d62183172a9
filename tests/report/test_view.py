"""Views in three dimensions: their numbers, and what a browser makes of them."""

from __future__ import annotations

import base64
import io
import json
import re

import numpy as np
import pytest
from cell_map import cells
from matplotlib import colormaps

from fenics_joints.report.chart import Curve, curve_chart
from fenics_joints.report.document import Document, Folded, Text, View
from fenics_joints.report.html import as_page
from fenics_joints.report.surface import coarsened, surface
from fenics_joints.report.view import Arrows, Colours, SurfaceView, scene

HOSTILE = "</script><script>document.title='taken'</script><img src=x onerror=alert(1)>"


def triangles(s) -> np.ndarray:
    """Corners of the triangles that faces are cut into."""
    p = s.points[s.faces]
    return np.concatenate([p[:, [0, 1, 2]], p[:, [0, 2, 3]]])


def area(s) -> float:
    x = triangles(s)
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()


def block(n: int) -> np.ndarray:
    """Cells of a cube of 1 m, n^3 of them."""
    corner = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    return (corner[None] + np.array([*np.ndindex(n, n, n)])[:, None]) / n


def test_a_surface_is_what_is_outside_each_level():
    cube = surface(block(3))
    assert len(cube.points) == 4**3 - 2**3 and len(cube.faces) == 6 * 9
    assert area(cube) == pytest.approx(6.0)
    # In two levels, each has a face where it touched the other.
    two = surface(block(2), level=(block(2)[:, :, 2].mean(axis=1) > 0.5).astype(int))
    assert area(two) == pytest.approx(8.0)
    # Two groups do not share vertices, nor do cells that touch and move apart.
    left = block(2)[:, :, 0].mean(axis=1) > 0.5
    motion = np.where(left[:, None, None], block(2), -1.0)
    shared = len(surface(block(2)).points)
    assert len(surface(block(2), group=left.astype(int)).points) == shared + 8
    assert len(surface(block(2), motions=[motion]).points) == shared + 8


def test_a_coarser_surface_has_vertices_that_were_there_and_is_closed():
    fine = surface(block(24))
    coarse = coarsened(fine, 600)
    assert 150 < len(coarse.points) <= 600 and coarse.whole == len(fine.faces) == 6 * 24**2
    assert np.array_equal(block(24).reshape(-1, 3)[coarse.pick], coarse.points)
    assert area(coarse) == pytest.approx(6.0, rel=0.15)
    assert coarsened(fine, len(fine.points)) is fine


def looks(s) -> list[SurfaceView]:
    moved = s.points * [0.0, 0.0, 1.0]
    more = {"scales": [1.0, -2.0], "mac": [0.5, 0.25], "match": 0}
    arrows = [Arrows("measured", "#009e73", s.points[:2], moved[:2])]
    colours = Colours(colormaps["RdBu_r"], "low", "high", HOSTILE)
    return [
        SurfaceView(
            "moves", colours, motion=moved, way=np.array([0.0, 0.0, 1.0]), arrows=arrows, **more
        ),
        SurfaceView(
            HOSTILE,
            colours,
            values=np.linspace(0, 1, len(s.points)),
            shown=(0.0, 50.0, "MPa"),
            texts=[HOSTILE, HOSTILE],
        ),
    ]


def page() -> str:
    found = cells()
    whole = surface(found.vertices, found.region, found.region)
    tests = [Arrows(HOSTILE, "#009e73", whole.points[:2], whole.points[:2]) for _ in range(2)]
    parts = [f"{HOSTILE} {i}" for i in range(1 + whole.level.max())]
    view = scene(whole, looks, HOSTILE, apart=True, parts=parts, tests=tests)
    return as_page(Document(HOSTILE, "view", blocks=[View(view)]))


def test_numbers_in_the_page_are_those_of_the_surface():
    found = cells()
    whole = surface(found.vertices, found.region, found.region)
    content = json.loads(re.search(r'json">(.*?)</script>', page(), re.DOTALL)[1])
    points = np.frombuffer(base64.b64decode(content["points"]), "<i2").reshape(-1, 3)
    back = (points / 32767 * content["unit_mm"] + content["middle_mm"]) / 1e3
    np.testing.assert_allclose(back, whole.points, atol=np.ptp(whole.points) / 32767)
    faces = np.frombuffer(base64.b64decode(content["faces"]), "<u2").reshape(-1, 4)
    assert np.array_equal(faces, whole.faces) and content["coarse"] == []
    assert content["looks"][1]["name"] == HOSTILE


def test_a_view_of_a_large_mesh_is_small_and_says_so():
    n = 170
    plate = (block(1)[0] + np.array([*np.ndindex(n, n, 1)])[:, None]) / n
    text = scene(surface(plate), looks, "large")
    drawn, whole = json.loads(text)["coarse"]
    assert len(text) < 1_000_000 and whole == 2 * n**2 + 4 * n and drawn < 60_000


def test_a_browser_draws_turns_plays_and_runs_nothing_else(browser, tmp_path):
    file = tmp_path / "view.html"
    file.write_text(page(), encoding="utf-8")
    browser.show(file)
    assert browser.js("document.title") != "taken"
    assert browser.js("document.querySelectorAll('img').length") == 0
    browser.js("window.view = document.querySelector('.stage').view; 0")
    pixels = (
        "(() => { view.paint(performance.now()); const { width, height } = view.canvas, "
        "gl = view.gl, p = new Uint8Array(4 * width * height); gl.readPixels(0, 0, width, height, "
        "gl.RGBA, gl.UNSIGNED_BYTE, p); let n = 0, sum = 0; "
        "for (let i = 0; i < p.length; i += 4) { "
        "n += p[i + 3] > 0; sum = (31 * sum + p[i] + p[i + 1] * (i % 97)) % 1000003; } "
        "return [n / width / height, sum]; })()"
    )
    filled, first = browser.js(pixels)
    assert 0.1 < filled < 0.95
    seen = {first}
    for step in ("view.rotate(0.5, 0.2)", "view.amplitude = 3", "view.choose(1)", "view.apart = 0"):
        browser.js(f"{step}; 0")
        seen.add(browser.js(pixels)[1])
    assert len(seen) == 5
    # A name is text wherever it is shown, and a value is said where the pointer is.
    assert HOSTILE in browser.js("view.key.textContent")
    tip = browser.js(
        "(() => { const b = view.canvas.getBoundingClientRect(); let said = ''; for (let i = 1; "
        "i < 20 && !said; i++) { view.point({ clientX: b.left + b.width * i / 20, "
        "clientY: b.top + b.height / 2 }); said = view.tip.hidden ? '' : view.tip.textContent; } "
        "return said; })()"
    )
    assert "MPa" in tip and "mm" in tip and HOSTILE in tip
    # The policy of the page lets no other script run.
    run = "const s = document.createElement('script'); s.textContent = 'window.run = 1'; "
    assert browser.js(f"(() => {{ {run} document.body.append(s); return window.run; }})()") is None


def test_a_view_hides_parts_shows_measured_shapes_and_is_saved(browser, tmp_path):
    file = tmp_path / "view.html"
    file.write_text(page(), encoding="utf-8")
    browser.show(file)
    browser.js("window.view = document.querySelector('.stage').view; 0")
    faces = "view.lists[0].length"
    whole = browser.js(faces)
    browser.js("document.querySelector('.parts input').click(); 0")
    assert 0 < browser.js(faces) < whole
    browser.js("document.querySelector('.parts input').click(); 0")
    assert browser.js(faces) == whole
    # A value of the MAC shows its two shapes, in the scale that belongs to them.
    browser.js("view.choose(0, 1); 0")
    assert "MAC 0.250" in browser.js("view.note.textContent")
    assert browser.js("view.shown.length") == 2 and browser.js("view.choose(1), view.test") == -1
    # Frames that move, of one size: read by another program's decoder.
    browser.js("view.choose(0); 0")
    gif = browser.js(
        "(async () => { const b = new Uint8Array(await view.movie().arrayBuffer()); let s = ''; "
        "for (const c of b) s += String.fromCharCode(c); return btoa(s); })()"
    )
    images = pytest.importorskip("PIL.Image")
    with images.open(io.BytesIO(base64.b64decode(gif))) as found:
        assert found.n_frames == 24 and found.size[0] == 640
        first = np.asarray(found.convert("RGB"), dtype=int)
        found.seek(6)
        quarter = np.asarray(found.convert("RGB"), dtype=int)
        found.seek(12)
        half = np.asarray(found.convert("RGB"), dtype=int)
    assert np.abs(first - quarter).max() > 50 and np.abs(first - half).mean() < 2


def test_a_chart_shows_the_curves_by_panel_and_on_other_axes(browser, tmp_path):
    """Curves may turn back; what a reader saves are the numbers that were computed."""
    x = np.array([1.0, 10.0, 5.0, 100.0])
    curves = [
        Curve(HOSTILE, x, x**2, "#0072b2"),
        Curve("points", x[:2], np.array([2.0, np.nan]), width=0, mark="o", panel=1),
    ]
    chart = curve_chart(curves, "f, Hz", ["first", HOSTILE], HOSTILE, log=(False, True))
    text = as_page(Document("case", "chart", blocks=[chart]))
    content = json.loads(re.search(r'json">(.*?)</script>', text, re.DOTALL)[1])
    stored = np.frombuffer(base64.b64decode(content["curves"][0]["y"]), "<f8")
    assert np.array_equal(stored, x**2) and text.count("<svg") == 1
    file = tmp_path / "chart.html"
    file.write_text(text, encoding="utf-8")
    browser.show(file)
    browser.until("!!document.querySelector('.stage.live')")
    assert browser.js("document.title") == "case: chart"
    browser.js("window.stage = document.querySelector('.stage'); window.c = stage.chart; 0")
    shown = "[0, 1].map(i => c.isDatasetVisible(i))"
    assert browser.js(shown) == [True, False]
    assert browser.js("c.scales.y.type") == "logarithmic"
    at = "[0, 2].map(i => c.getDatasetMeta(0).data[i].x)"
    assert browser.js(at)[0] < browser.js(at)[1]
    browser.js("stage.querySelectorAll('input')[1].click(); 0")
    assert browser.js("c.scales.y.type") == "linear"
    browser.js(
        "stage.querySelector('select').value = 1; stage.querySelector('select').onchange(); 0"
    )
    assert browser.js(shown) == [False, True]


def test_paper_has_what_is_folded_away_at_its_end(browser, tmp_path):
    blocks = [Folded("more", [Text("hidden")]), Text("last")]
    file = tmp_path / "page.html"
    file.write_text(as_page(Document("case", "result", blocks=blocks)), encoding="utf-8")
    browser.show(file)
    order = "document.querySelector('main').innerText.replace(/\\s+/g, ' ')"
    assert "hidden" not in browser.js(order)
    browser.js("dispatchEvent(new Event('beforeprint')); 0")
    words = browser.js(order)
    assert words.index("last") < words.index("Appendix") < words.index("hidden")
    browser.js("dispatchEvent(new Event('afterprint')); 0")
    assert "Appendix" not in browser.js(order) and "hidden" not in browser.js(order)
