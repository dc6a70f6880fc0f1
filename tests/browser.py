"""Debian's Chromium, driven by playwright, without a graphics card: the browser of all tests of the page."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from tests import common

PLACES = (Path("/usr/bin/chromium"), Path("/usr/bin/chromium-browser"))
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
DESKTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
PATIENCE = 1000 * common.PATIENCE  # ms
KNOWN = ("net::ERR_CONNECTION", "net::ERR_INCOMPLETE", "status of 401", "status of 503", "GPU stall")
"""Complaints of a browser without a server, a token, or a graphics card."""


def missing() -> str:
    """Reason why there is no browser; empty where there is one."""
    if find_spec("playwright") is None:
        return "needs playwright, which drives the browser"
    return "" if any(map(Path.exists, PLACES)) else "needs Chromium in /usr/bin, as Debian installs it"


needed = pytest.mark.skipif(bool(missing()), reason=missing())


@contextmanager
def launched() -> Iterator[Any]:
    """The browser; it is closed in the end."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=PATIENCE)
    program = next(filter(Path.exists, PLACES))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(program), args=FLAGS)
        yield browser
        browser.close()


def expect(what: Any) -> Any:
    """Playwright's assertions about a part of a page, imported where there is a browser."""
    from playwright.sync_api import expect as expected

    return expected(what)


class Visit:
    """A window of the browser, and what it complained of."""

    def __init__(self, browser: Any, address: str, *, phone: bool = False, **looks: Any) -> None:
        self.complaints: list[str] = []
        self.context = browser.new_context(viewport=PHONE if phone else DESKTOP, **looks)
        self.context.set_default_timeout(PATIENCE)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._hear)
        self.page.goto(address)

    def _hear(self, said: Any) -> None:
        if said.type in ("error", "warning") and not any(known in said.text for known in KNOWN):
            self.complaints.append(said.text)


def number(words: str) -> int:
    """The number that its digits make."""
    return int("".join(filter(str.isdecimal, words)))


def figure(page: Any, name: str) -> Any:
    """The part of the page that shows a figure of the chosen job."""
    return page.locator("#figures > div", has=page.get_by_text(name, exact=True)).locator("dd").first
