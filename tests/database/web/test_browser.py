"""The page of the database in a headless Chromium; it needs, and serves, this machine only."""

from __future__ import annotations

import asyncio
import os
import shutil
import threading
from contextlib import AsyncExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("sklearn")
pytest.importorskip("choreographer", reason="drives the browser")

import choreographer.browsers
from mpi4py import MPI

from fenics_joints.database import JointSurfaces, query, seed_database, web
from fenics_joints.database.query import in_words

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next((path for name in _NAMES if (path := shutil.which(name))), None)

pytestmark = [
    pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process"),
    pytest.mark.skipif(CHROMIUM is None, reason=f"no browser: none of {', '.join(_NAMES)}"),
]


class Chromium(choreographer.browsers.Chromium):
    """As people use it: the driver would turn off what keeps web sites apart."""

    def get_cli(self) -> list[str]:
        return [part for part in super().get_cli() if part != "--disable-web-security"]


class Page:
    """The few things a person does with a page."""

    def __init__(self, tab):
        self._tab = tab

    async def js(self, expression: str):
        """Value of an expression; None if it raises, or the page is not there yet."""
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = await self._tab.send_command("Runtime.evaluate", asked)
        found = answer.get("result", {"exceptionDetails": answer})
        return None if "exceptionDetails" in found else found["result"].get("value")

    async def text(self, element: str) -> str | None:
        return await self.js(f"document.getElementById('{element}').innerText")

    async def type(self, element: str, text: str) -> None:
        """Replace what is in a field, as by keys."""
        await self.js(f"document.getElementById('{element}').select()")
        await self._tab.send_command("Input.insertText", {"text": text})

    async def picture(self) -> str | None:
        """What the picture shows, once it is there; None if it is broken."""
        return await self.js(
            "(async () => { const i = document.getElementById('picture'); await i.decode();"
            " return await (await fetch(i.src)).text(); })()"
        )

    async def until(self, element: str, text: str) -> str:
        """Wait for a text in an element, and return all of that."""
        for _ in range(200):
            if text in (shown := await self.text(element) or ""):
                return shown
            await asyncio.sleep(0.05)
        raise AssertionError(f"{element}: {shown!r}, expected {text!r}")


def _in_browser(url: str, steps, browsers: int = 1) -> None:
    """Go through steps with a page in each of some browsers, which are then killed."""

    async def run() -> None:
        async with AsyncExitStack() as stack:
            pages = []
            for _ in range(browsers):
                browser = choreographer.Browser(
                    CHROMIUM, browser_cls=Chromium, headless=True, enable_sandbox=False
                )
                await stack.enter_async_context(browser)
                pages.append(Page(await browser.create_tab(url)))
            await steps(*pages)

    asyncio.run(asyncio.wait_for(run(), 90))


def test_the_page_fetches_nothing_from_elsewhere_and_serves_nobody_else(page_url):
    async def steps(page: Page) -> None:
        await page.until("radius-value", "mm")
        await page.picture()
        entries = "performance.getEntriesByType('resource').map(e => e.name)"
        fetched = await page.js(entries)
        names = {urlsplit(u).path.rpartition("/")[2] for u in fetched}
        assert {"page.css", "page.js", "picture.svg"} <= names
        assert [u for u in fetched if not u.startswith((page_url, "data:"))] == []

    _in_browser(page_url, steps)
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


def test_a_typed_torque_gives_the_radius_and_what_is_outside_the_data_is_said(page_url):
    surfaces = JointSurfaces.fit(seed_database())

    async def steps(page: Page) -> None:
        await page.until("force-value", "50.0 kN")
        before = await page.picture()
        await page.type("input-torque", "90")
        await page.until("force-value", "37.5 kN")
        assert "K = 0.2" in await page.text("force-words")
        # The same question asked without the page; the table has 49.45 mm for it.
        expected = query(surfaces, bolt="M12", torque=90.0, thickness=0.025)
        assert expected.radius.low < 0.04945 < expected.radius.high
        radius = await page.until("radius-value", "mm")
        interval = await page.text("radius-words")
        assert f"{radius} ({interval})" == in_words(expected.radius, "m")
        assert (await page.text("pressure-value")).endswith("MPa")
        assert "identified for M12, 120 N·m" in await page.text("interface-words")
        after = await page.picture()
        assert after.lstrip().startswith("<?xml") and after != before
        # Outside the data: refused, then answered and marked when that is asked for.
        await page.type("input-torque", "200")
        await page.until("error", "force 83.3 kN, thickness 25.0 mm would be extrapolated")
        assert await page.text("radius-value") == "–"
        await page.js("document.getElementById('input-extrapolate').click()")
        await page.until("extrapolated", "outside the data")
        assert "extrapolated" in await page.text("radius-words")
        await page.type("input-torque", "ten")
        await page.until("error", "torque: expected a number")
        # What was typed is there after a reload.
        await page.js("location.reload()")
        await page.until("error", "torque: expected a number")

    _in_browser(page_url, steps)


def test_two_browsers_do_not_write_into_each_other_and_closing_one_ends_nothing(page_url):
    async def steps(one: Page, two: Page) -> None:
        for page in (one, two):
            await page.until("force-value", "50.0 kN")
        await one.type("input-torque", "90")
        await two.type("input-torque", "60")
        await one.until("force-value", "37.5 kN")
        await two.until("force-value", "25.0 kN")
        assert await one.text("force-value") == "37.5 kN"
        assert await one.picture() != await two.picture()
        # What was typed is there after a reload.
        await one.js("location.reload()")
        assert await one.until("force-value", "37.5 kN") == "37.5 kN"
        await two.type("input-torque", "70")  # left while the answer is on its way

    for _ in range(2):
        _in_browser(page_url, steps, browsers=2)


def test_what_is_typed_before_the_script_is_there_is_answered_too(page_url):
    script = (Path(web.__file__).with_name("page.js")).read_text(encoding="utf-8")

    async def steps(page: Page) -> None:
        await page.until("force-value", "50.0 kN")
        asked = "performance.getEntriesByType('resource').filter(e => e.name.includes('/?')).length"
        assert await page.js(f"document.readyState == 'complete' ? {asked} : 0") == 0
        await page.js("document.getElementById('input-torque').value = '60'")  # nobody listens
        await page.js(f"{{ {script} }}")
        await page.until("force-value", "25.0 kN")

    _in_browser(page_url, steps)


def test_another_web_site_cannot_use_the_page_even_if_it_knows_the_secret(page_url):
    class Site(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<p id=there>there</p>")

        def log_message(self, format, *arguments) -> None:
            pass

    loads = (
        "new Promise(done => {{ const e = document.createElement('{tag}'); "
        "e.onload = () => done('loaded'); e.onerror = () => done('refused'); "
        "e.src = '{url}'; document.body.append(e); }})"
    )

    async def steps(page: Page) -> None:
        await page.until("there", "there")
        say = ".then(r => r.type + r.status, () => 'refused')"
        assert await page.js(f"fetch('{page_url}'){say}") == "refused"
        # What it cannot read it can still send: nothing but a refusal comes back.
        assert await page.js(f"fetch('{page_url}', {{mode: 'no-cors'}}){say}") == "refused"
        for tag, file in (("img", "picture.svg"), ("script", "page.js")):
            assert await page.js(loads.format(tag=tag, url=page_url + file)) == "refused"
        frame = "document.querySelector('iframe').contentDocument"
        assert await page.js(loads.format(tag="iframe", url=page_url)) == "loaded"  # the error page
        assert await page.js(frame) is None
        socket = f"new WebSocket('{page_url.replace('http', 'ws')}ws')"
        opened = f"s = {socket}; s.onopen = () => done('open'); s.onerror = () => done('refused')"
        assert await page.js(f"new Promise(done => {{ let {opened} }})") == "refused"

    with ThreadingHTTPServer(("127.0.0.1", 0), Site) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        try:
            _in_browser(f"http://localhost:{site.server_port}/", steps)
        finally:
            site.shutdown()
