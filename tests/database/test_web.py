"""The page of the database in a headless Chromium; it needs, and serves, this machine only."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sklearn")
pytest.importorskip("trame_vuetify", reason="the page needs trame and trame-vuetify")
pytest.importorskip("choreographer", reason="drives the browser")

import choreographer
from mpi4py import MPI

from fenics_joints.database import Surfaces, query, seed_database
from fenics_joints.database.tables import in_words

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next((path for name in _NAMES if (path := shutil.which(name))), None)

pytestmark = [
    pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process"),
    pytest.mark.skipif(CHROMIUM is None, reason=f"no browser: none of {', '.join(_NAMES)}"),
]


@pytest.fixture(scope="module")
def page_url():
    """Address of a page that is served by the command; at the end it stops on Ctrl-C."""
    command = [sys.executable, "-m", "fenics_joints", "database", "web", "--port", "0"]
    server = subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        url = server.stdout.readline().partition(" ")[0]
        assert url.startswith("http://127.0.0.1:"), server.communicate(timeout=30)
        yield url
    finally:
        server.send_signal(signal.SIGINT)
        try:
            _, errors = server.communicate(timeout=20)
        finally:
            server.kill()
    assert server.returncode in (0, 130) and "Traceback" not in errors, errors


class Page:
    """The few things a person does with a page."""

    def __init__(self, tab):
        self._tab = tab

    async def _send(self, method: str, **parameters) -> dict:
        answer = await self._tab.send_command(method, parameters)
        assert "error" not in answer, answer
        return answer["result"]

    async def js(self, expression: str):
        """Value of an expression; None if it raises, as for an element not there."""
        answer = await self._send("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value") if "exceptionDetails" not in answer else None

    async def text(self, element: str) -> str | None:
        return await self.js(f"document.getElementById('{element}').innerText")

    async def type(self, element: str, text: str) -> None:
        """Replace what is in a field, as by keys."""
        await self.js(f"document.getElementById('{element}').select()")
        await self._send("Input.insertText", text=text)

    async def until(self, element: str, text: str) -> str:
        """Wait for a text in an element, and return all of that."""
        for _ in range(200):
            if text in (shown := await self.text(element) or ""):
                return shown
            await asyncio.sleep(0.05)
        raise AssertionError(f"{element}: {shown!r}, expected {text!r}")


def _in_browser(url: str, steps) -> None:
    async def run() -> None:
        async with choreographer.Browser(CHROMIUM, headless=True, enable_sandbox=False) as browser:
            await steps(Page(await browser.create_tab(url)))

    asyncio.run(asyncio.wait_for(run(), 90))


def test_the_page_fetches_nothing_from_elsewhere_and_serves_nobody_else(page_url):
    async def steps(page: Page) -> None:
        await page.until("radius-value", "mm")
        entries = "performance.getEntriesByType('resource').map(e => e.name)"
        fetched = await page.js(entries)
        assert len(fetched) > 3
        assert [u for u in fetched if not u.startswith((page_url, "data:"))] == []

    _in_browser(page_url, steps)
    port = int(page_url.rstrip("/").rpartition(":")[2])
    listening = []
    for table in ("tcp", "tcp6"):
        path = Path(f"/proc/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else []:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.rpartition(":")[2], 16) == port:
                listening.append(address.partition(":")[0])
    assert listening == ["0100007F"] or not os.path.exists("/proc/net/tcp")


def test_a_typed_torque_gives_the_radius_and_what_is_outside_the_data_is_said(page_url):
    surfaces = Surfaces.fit(seed_database())

    async def steps(page: Page) -> None:
        await page.until("force-value", "50.0 kN")
        before = await page.js("document.querySelector('#picture svg').outerHTML")
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
        after = await page.js("document.querySelector('#picture svg').outerHTML")
        assert after.startswith("<svg") and after != before
        # Outside the data: refused, then answered and marked when that is asked for.
        await page.type("input-torque", "200")
        await page.until("error", "force 83.3 kN, thickness 25.0 mm would be extrapolated")
        assert await page.text("radius-value") == "–"
        await page.js("document.getElementById('input-extrapolate').click()")
        await page.until("extrapolated", "outside the data")
        assert "extrapolated" in await page.text("radius-words")
        await page.type("input-torque", "ten")
        await page.until("error", "torque: expected a number")

    _in_browser(page_url, steps)
