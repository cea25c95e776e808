"""Random tests draw some of their cases in ``make test``, and all in ``make verify``; no test may hang.

The option ``--shuffle SEED`` runs the tests in another order: none may need what another one has left behind.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from browser import new_page, running_browser
from support import DRAWS_ALL

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

LONGEST_TESTS = (
    "test_python_mutants",
    "test_mypy_finds_no_wrong_type",
    "test_the_c_tests_pass_with_the_settings",
)
"""Tests that begin first, so that no worker waits for them at the end."""

TIMEOUT, SLOW_TIMEOUT = 300, 1200
"""Seconds after which a test fails because it hangs. Tests in a guest kernel have no limit."""


settings.register_profile(
    "busy", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)  # how long an example takes says more about the machine
settings.load_profile("busy")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run the tests in an order drawn by a seed")


def pytest_report_header(config: pytest.Config) -> str | None:
    """Return the line that says how to repeat an order, or none if tests are in their own."""
    seed = config.getoption("--shuffle")
    return None if seed is None else f"order of the tests: --shuffle {seed}"


def pytest_configure(config: pytest.Config) -> None:
    """Set the variable that ``support`` reads, before tests import it."""
    if config.option.markexpr == "slow":
        os.environ[DRAWS_ALL] = "1"


def pytest_itemcollected(item: pytest.Item) -> None:
    if item.get_closest_marker("random") and DRAWS_ALL in os.environ:
        item.add_marker("slow")


def shuffle_tests(items: list[pytest.Item], generator: random.Random) -> None:
    """Shuffle the files, and the tests of each file.

    Tests of a file stay together, since they share what takes long to make.
    """
    items_by_file: dict[str, list[pytest.Item]] = {}
    for item in items:
        items_by_file.setdefault(item.nodeid.partition("::")[0], []).append(item)
    files = list(items_by_file)
    generator.shuffle(files)
    for file in files:
        generator.shuffle(items_by_file[file])
    items[:] = [item for file in files for item in items_by_file[file]]


@pytest.hookimpl(trylast=True)  # when all have been marked that are slow
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    seed = config.getoption("--shuffle")
    if seed is not None:
        shuffle_tests(items, random.Random(seed))
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
