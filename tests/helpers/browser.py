"""Headless Chromium for tests of pages; tests that need it are skipped, with the reason, where it is missing."""

from __future__ import annotations

import base64
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

# Software rendering takes seconds for the balls of the map and for a picture at rest: tests that need one ask for it.
TIMEOUT_MS = 90_000
"""After which a page has failed; pictures are drawn without a GPU, by cores that others use as well."""
COARSE = """new MutationObserver(() => {
  clearTimeout(explorer.refining);
  Object.assign(explorer, { rest: 1e6, pendingThumbnails: [] });
}).observe(document, { subtree: true, attributeFilter: ["data-ready"] });"""
PACKED = """window.packed = ({ buffer, byteOffset, byteLength }) =>
  btoa([...new Uint8Array(buffer, byteOffset, byteLength)].map((byte) => String.fromCharCode(byte)).join(""));"""
"""What returns a typed array as text, for `unpacked`: Playwright checks lists number by number."""


@dataclass
class Visit:
    """A page, and what it has said and asked for.

    Attributes:
        page: of Playwright.
        errors: console errors and uncaught exceptions.
        requests: addresses asked for, without the page itself, `blob:` and `data:`.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    address: str = ""

    def open(self, address: str) -> None:
        """Load a page of the map and wait for its first picture."""
        self.address = address.split("#")[0]
        self.errors.clear()  # of the page before, which its own test has judged
        self.page.goto("about:blank")  # else another fragment of the same page would not load it
        self.page.goto(address)
        self.page.wait_for_selector("[data-ready], #problem:not([hidden])", state="attached")
        assert self.errors == []


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser, or a skipped test."""
    api = pytest.importorskip(
        "playwright.sync_api", reason="Playwright is not installed: pip install playwright"
    )
    executable = shutil.which("chromium") or shutil.which("google-chrome")
    if executable is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=executable, args=["--enable-unsafe-swiftshader", "--no-sandbox"]
        )
        yield browser
        browser.close()


def visit(browser: Any, address: str, *, width: int = 1280, height: int = 900, **options: Any) -> Visit:
    """Open a page of the map in a window of its own and wait for its first picture."""
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.add_init_script(COARSE)
    page.add_init_script(PACKED)
    made = Visit(page)
    page.on("console", lambda m: made.errors.append(m.text) if _is_error(m) else None)
    page.on("pageerror", lambda error: made.errors.append(str(error)))
    page.on(
        "request",
        lambda request: made.requests.append(request.url) if _leaves(request.url, made.address) else None,
    )
    page.set_default_timeout(TIMEOUT_MS)
    made.open(address)
    return made


def state(page: Any) -> Any:
    """What a page of the map shows."""
    return shown(page, "window.explorer.state")


def shown(page: Any, script: str, *arguments: Any) -> Any:
    """The value of a script once what was asked for is shown."""
    settle(page)
    return page.evaluate(script, *arguments)


def unpacked(text: str, kind: type = np.uint8) -> np.ndarray:
    """The numbers of `packed` on a page, (n,)."""
    return np.frombuffer(base64.b64decode(text), kind)


def follow(page: Any, fragment: str) -> None:
    """Follow a link within the page, until what it links to is shown."""
    script = """(fragment) => new Promise((done) => {
      const before = location.hash;
      addEventListener("hashchange", done, { once: true }); // after the page's own listener
      location.hash = fragment;
      if (location.hash === before) done();
    })"""
    page.evaluate(script, fragment)
    settle(page)


def control(page: Any, selector: str, **options: Any) -> Any:
    """The locator of a control, whose tab is shown first, beside what was asked for before."""
    settle(page)
    page.evaluate(
        "(selector) => explorer.showTab(document.querySelector(selector).closest('[role=tabpanel]').id)",
        selector,
    )
    return page.locator(selector, **options)


def settle(page: Any) -> None:
    """Wait until what was asked for is shown: no event is waiting, and no frame is to be drawn."""
    page.evaluate("""async () => {
      do {
        await new Promise((done) => setTimeout(done));
        await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
      } while (window.explorer?.requested);
    }""")


def _leaves(address: str, own: str) -> bool:
    return not address.startswith(("blob:", "data:")) and address.split("#")[0] != own


def _is_error(message: Any) -> bool:
    """Failed requests are counted as responses, with their address."""
    return message.type == "error" and not message.text.startswith("Failed to load resource")
