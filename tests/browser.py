"""A real browser for tests of the page."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from support import PATIENCE

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Frame, Page

CHROMIUM = ("chromium", "chromium-headless-shell")


@contextmanager
def running_browser() -> Iterator[Browser]:
    """Yield Debian's Chromium; to start it takes longer than most tests.

    Skips the test where the browser or playwright is not installed.
    """
    path = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if path is None:
        pytest.skip(f"no browser is installed: apt-get install {CHROMIUM[-1]}")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make setup")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def new_page(browser: Browser, width: int = 1280, height: int = 800) -> Iterator[Page]:
    """Yield an empty page of the browser. Fails at its end if a script of the page has failed."""
    page = browser.new_page(viewport={"width": width, "height": height})
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    try:
        yield page
        assert errors == []
    finally:
        page.close()


def until(page: Page | Frame, condition: str) -> Any:
    """Wait until a JavaScript expression is true; returns its value.

    Asked from here: the page's own rules forbid scripts that another one makes.
    """
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        value = page.evaluate(condition)
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"the page never came to {condition}")
