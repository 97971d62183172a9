"""A headless Chromium that looks at the project's pages, started once for all tests."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import threading
from pathlib import Path

import pytest

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next((path for name in _NAMES if (path := shutil.which(name))), None)
#: Seconds until a step counts as hung.
_PATIENCE = 60
#: Rules of axe-core that do not hold for a page that is a report, or that it judges by pixels.
_RULES = {
    "runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"],
    "resultTypes": ["violations"],
    "rules": {"region": {"enabled": False}},
}


class Browser:
    """One tab, driven from the tests' own thread."""

    def __init__(self):
        import choreographer.browsers

        class Chromium(choreographer.browsers.Chromium):
            """As people use it: the driver would turn off what keeps web sites apart."""

            def get_cli(self) -> list[str]:
                return [part for part in super().get_cli() if part != "--disable-web-security"]

        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self._browser = choreographer.Browser(
            CHROMIUM, browser_cls=Chromium, headless=True, enable_sandbox=False
        )
        self._run(self._browser.open())
        self._tab = self._run(self._browser.create_tab("about:blank"))
        self._send("Page.enable")

    def _run(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(_PATIENCE)

    def _send(self, name: str, **values):
        return self._run(self._tab.send_command(name, values))

    def close(self) -> None:
        """End it."""
        self._run(self._browser.close())
        self._loop.call_soon_threadsafe(self._loop.stop)

    def show(self, page: Path | str, *, width: int = 1280, dark: bool = False) -> None:
        """Load a page from a file, as by a double click, or from an address."""
        self._send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._send("Emulation.setEmulatedMedia", features=[scheme])
        address = page.resolve().as_uri() if isinstance(page, Path) else page
        self._send("Page.navigate", url=address)
        there = f"location.protocol === '{address.partition(':')[0]}:'"
        self.until(f"{there} && document.readyState === 'complete'")

    def until(self, expression: str) -> None:
        """Wait until it holds.

        Raises:
            AssertionError: If it does not within some seconds.
        """
        for _ in range(400):
            if self.js(expression):
                return
            threading.Event().wait(0.02)
        raise AssertionError(f"it never came to hold that {expression}")

    def js(self, expression: str):
        """Value of an expression, which may be a promise.

        Raises:
            AssertionError: If it raises.
        """
        answer = self._send(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )["result"]
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def type(self, element: str, text: str) -> None:
        """Replace what is in a field, as by keys."""
        self.js(f"document.getElementById('{element}').select()")
        self._send("Input.insertText", text=text)

    def rules(self, *names: str) -> list[str]:
        """What axe-core finds wrong with the page as it is shown, and where; by some rules only."""
        pytest.importorskip("axe_core_python", reason="checks rules of pages")
        from axe_core_python.base import AXE_SCRIPT

        self.js(f"{AXE_SCRIPT}; 0")
        only = {"runOnly": {"type": "rule", "values": names}} if names else {}
        asked = json.dumps({**_RULES, **only})
        found = self.js(
            f"axe.run(document, {asked}).then(r => r.violations.flatMap(v => "
            "v.nodes.map(n => `${v.id}: ${n.html.slice(0, 120)} ${n.failureSummary}`)))"
        )
        return found[:12]

    def picture(self, page: Path, target: Path, size: tuple[int, int], element: str = "") -> None:
        """Write what a page shows as PNG.

        Args:
            page: Its file.
            target: The picture.
            size: Width of the page and height of the picture, pixels.
            element: Selector of the element that is shown whole instead of the top.
        """
        width, height = size
        self.show(page, width=width)
        self.until("[...document.querySelectorAll('.stage')].every(s => s.matches('.live'))")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        if element:
            box = self.js(
                f"(b => [b.x, b.y + scrollY, b.width, b.height])"
                f"(document.querySelector({json.dumps(element)}).getBoundingClientRect())"
            )
            clip.update(zip(("x", "y", "width", "height"), box, strict=True))
        self._run(asyncio.sleep(1.0))  # until what scripts draw is there
        found = self._send("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        target.write_bytes(base64.b64decode(found["result"]["data"]))

    def check(self, text: str, folder: Path) -> None:
        """Fail if a page breaks a rule, in light or dark, or does not fit a phone or paper."""
        file = folder / "page.html"
        file.write_text(text, encoding="utf-8")
        views = text.count('type="application/json"')
        self.check_at(file, f"document.querySelectorAll('.live').length === {views}")

    def check_at(self, page: Path | str, ready: str) -> None:
        """`check` of a page that is there already.

        Args:
            page: Its file or address.
            ready: JavaScript that says whether it is drawn.
        """
        for width, dark in ((1280, False), (1280, True), (390, False)):
            self.show(page, width=width, dark=dark)
            self.until(ready)
            assert self.js("document.documentElement.scrollWidth") <= width
            self.js("document.querySelectorAll('details').forEach(d => { d.open = true; })")
            if width > 600:
                found = self.rules(*(("color-contrast",) if dark else ()))
                assert not found, "\n".join(found)
        # A4 less 10 mm on either side: what does not fit there is lost.
        self._send(
            "Emulation.setDeviceMetricsOverride",
            width=718,
            height=1047,
            deviceScaleFactor=1,
            mobile=False,
        )
        self._send("Emulation.setEmulatedMedia", media="print")
        cut = self.js(
            "[...document.querySelectorAll('table')].filter(t => t.getBoundingClientRect().right "
            "> 719).map(t => t.id + ' ' + t.innerText.slice(0, 60))"
        )
        self._send("Emulation.setEmulatedMedia", media="")
        assert cut == []
