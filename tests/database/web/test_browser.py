"""The page of the database in a headless Chromium; it needs, and serves, this machine only."""

from __future__ import annotations

import json
import os
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("sklearn")

from browser import Browser

from fenics_joints.database import JointSurfaces, query, seed_database, web
from fenics_joints.database.query import in_words

#: What the picture shows, once it is there.
PICTURE = (
    "(async () => { const i = document.getElementById('picture'); await i.decode();"
    " return await (await fetch(i.src)).text(); })()"
)


def text(page: Browser, element: str) -> str:
    return page.js(f"document.getElementById('{element}').innerText")


def until(page: Browser, element: str, words: str) -> str:
    """Wait for words in an element, and return all of its text."""
    page.until(f"document.getElementById('{element}')?.innerText.includes({json.dumps(words)})")
    return text(page, element)


@pytest.fixture
def page(browser, page_url):
    browser.show("about:blank")
    browser.show(page_url)
    return browser


def test_the_page_fetches_nothing_from_elsewhere_and_serves_nobody_else(page, page_url):
    until(page, "radius-value", "mm")
    page.js(PICTURE)
    fetched = page.js("performance.getEntriesByType('resource').map(e => e.name)")
    names = {urlsplit(u).path.rpartition("/")[2] for u in fetched}
    assert {"page.css", "page.js", "picture.svg"} <= names
    assert [u for u in fetched if not u.startswith((page_url, "data:"))] == []
    port = urlsplit(page_url).port
    listening = []
    for table in ("tcp", "tcp6"):
        path = Path(f"/proc/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else []:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.rpartition(":")[2], 16) == port:
                listening.append(address.partition(":")[0])
    assert listening == ["0100007F"] or not os.path.exists("/proc/net/tcp")


def test_the_page_keeps_the_rules_of_the_others(page_url, browser):
    """Contrast in light and dark, names of fields, a phone's width, paper."""
    browser.check_at(page_url, "document.getElementById('radius-value').innerText.includes('mm')")


def test_a_typed_torque_gives_the_radius_and_what_is_outside_the_data_is_said(page):
    until(page, "force-value", "50.0 kN")
    before = page.js(PICTURE)
    page.type("input-torque", "90")
    until(page, "force-value", "37.5 kN")
    assert "K = 0.2" in text(page, "force-words")
    # The same question asked without the page; the table has 49.45 mm for it.
    surfaces = JointSurfaces.fit(seed_database())
    expected = query(surfaces, bolt="M12", torque=90.0, thickness=0.025)
    assert expected.radius.low < 0.04945 < expected.radius.high
    radius, interval = until(page, "radius-value", "mm"), text(page, "radius-words")
    assert f"{radius} ({interval})" == in_words(expected.radius, "m")
    assert text(page, "pressure-value").endswith("MPa")
    assert "identified for M12, 120 N·m" in text(page, "interface-words")
    after = page.js(PICTURE)
    assert after.lstrip().startswith("<?xml") and after != before
    # Outside the data: refused, then answered and marked when that is asked for.
    page.type("input-torque", "200")
    until(page, "error", "force 83.3 kN, thickness 25.0 mm would be extrapolated")
    assert text(page, "radius-value") == "–"
    page.js("document.getElementById('input-extrapolate').click()")
    until(page, "extrapolated", "outside the data")
    assert "extrapolated" in text(page, "radius-words")
    page.type("input-torque", "ten")
    until(page, "error", "torque: expected a number")
    # What was typed is there after a reload.
    page.show(page.js("location.href"))
    until(page, "error", "torque: expected a number")


def test_two_browsers_do_not_write_into_each_other_and_closing_one_ends_nothing(page, page_url):
    for _ in range(2):
        other = Browser()
        for one in (page, other):
            one.show(page_url)
            until(one, "force-value", "50.0 kN")
        page.type("input-torque", "90")
        other.type("input-torque", "60")
        until(page, "force-value", "37.5 kN")
        until(other, "force-value", "25.0 kN")
        assert text(page, "force-value") == "37.5 kN"
        assert page.js(PICTURE) != other.js(PICTURE)
        other.type("input-torque", "70")
        other.close()  # while the answer is on its way


def test_what_is_typed_before_the_script_is_there_is_answered_too(page):
    script = (Path(web.__file__).with_name("page.js")).read_text(encoding="utf-8")
    until(page, "force-value", "50.0 kN")
    asked = "performance.getEntriesByType('resource').filter(e => e.name.includes('/?')).length"
    assert page.js(asked) == 0
    page.js("document.getElementById('input-torque').value = '60'")  # nobody listens
    page.js(f"{{ {script} }}; 0")
    until(page, "force-value", "25.0 kN")


class Site(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<p id=there>there</p>")

    def log_message(self, format, *arguments) -> None:
        pass


def test_another_web_site_cannot_use_the_page_even_if_it_knows_the_secret(browser, page_url):
    loads = (
        "new Promise(done => {{ const e = document.createElement('{tag}'); "
        "e.onload = () => done('loaded'); e.onerror = () => done('refused'); "
        "e.src = '{url}'; document.body.append(e); }})"
    )
    with ThreadingHTTPServer(("127.0.0.1", 0), Site) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        browser.show(f"http://localhost:{site.server_port}/")
        until(browser, "there", "there")
        say = ".then(r => r.type + r.status, () => 'refused')"
        assert browser.js(f"fetch('{page_url}'){say}") == "refused"
        # What it cannot read it can still send: nothing but a refusal comes back.
        assert browser.js(f"fetch('{page_url}', {{mode: 'no-cors'}}){say}") == "refused"
        for tag, file in (("img", "picture.svg"), ("script", "page.js")):
            assert browser.js(loads.format(tag=tag, url=page_url + file)) == "refused"
        # The error page, which is not to be read.
        assert browser.js(loads.format(tag="iframe", url=page_url)) == "loaded"
        assert browser.js("document.querySelector('iframe').contentDocument") is None
        socket = f"new WebSocket('{page_url.replace('http', 'ws')}ws')"
        opened = f"s = {socket}; s.onopen = () => done('open'); s.onerror = () => done('refused')"
        assert browser.js(f"new Promise(done => {{ let {opened} }})") == "refused"
        site.shutdown()
