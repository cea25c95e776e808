"""Random tests draw some of their cases in ``make test``, and all in ``make verify``; no test may hang."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from browser import new_page, running_browser
from support import DRAWS_ALL

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

LONGEST_TESTS = ("test_python_mutants", "test_types_are_right", "test_c_tests_pass")
"""Tests that begin first, so that no worker waits for one of them at the end."""

TIMEOUT, SLOW_TIMEOUT = 300, 1200
"""Seconds that a test may take before it fails as one that hangs; those in a guest kernel have no limit."""


settings.register_profile(
    "busy", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)  # how long an example takes says more about the machine
settings.load_profile("busy")


def pytest_configure(config: pytest.Config) -> None:
    """Before ``support`` is imported by the tests."""
    if config.option.markexpr == "slow":
        os.environ[DRAWS_ALL] = "1"


def pytest_itemcollected(item: pytest.Item) -> None:
    if item.get_closest_marker("random") and DRAWS_ALL in os.environ:
        item.add_marker("slow")


@pytest.hookimpl(trylast=True)  # when all have been marked that are slow
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not any(name in item.nodeid for name in LONGEST_TESTS))
    if not config.pluginmanager.hasplugin("timeout"):
        return
    for item in items:
        is_slow = item.get_closest_marker("slow") is not None
        item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT if is_slow else TIMEOUT))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A browser for all tests of a module."""
    with running_browser() as chromium:
        yield chromium


@pytest.fixture
def browser(chromium: Browser) -> Iterator[Page]:
    """An empty page of a browser; the test fails if a script of the page does."""
    with new_page(chromium) as browser:
        yield browser
