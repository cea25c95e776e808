"""Run the quick tests of a package with another text of one of its files: a mutant.

This file is also the plugin that plants the text: pytest runs in a process of its own.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from unittest.mock import patch

import pytest

from support import DRAWS_ALL, ROOT

MUTATED_FILE, MUTANT_SOURCE = "MCP_ASDF_MUTATED_FILE", "MCP_ASDF_MUTANT"
"""Variables of the environment with the file that is imported with other text, and with that text."""
TIMEOUT = 120
"""Seconds after which a test fails because it hangs. A quick test takes ten at most."""
RUN_TIMEOUT = 1800
"""Seconds after which all tests are ended: a mutant may also hang between tests. They take a sixth of it."""
SLOW_PACKAGES = ("crosscheck", "experiments", "studies", "swarm")
"""Packages of the tools whose tests take longest."""


def is_noticed(path: Path, source: str) -> bool:
    """Return whether a quick test of its package fails, or hangs, if a Python file has another text."""
    # Variables that another run of pytest has set would change this one.
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", DRAWS_ALL))
    }
    environment |= {"PYTHONPATH": "tests", MUTATED_FILE: str(path), MUTANT_SOURCE: source}
    options = ("-x", "-m", "not slow", "-p", __name__, "-p", "no:xdist", "-p", "no:cacheprovider")
    tests = subprocess.Popen(
        [sys.executable, "-m", "pytest", *options, *_tests_of(path)],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that what the tests have started can be ended with them
    )
    try:
        return tests.wait(RUN_TIMEOUT) != pytest.ExitCode.OK
    except subprocess.TimeoutExpired:
        return True
    finally:
        if tests.poll() is None:
            os.killpg(tests.pid, signal.SIGKILL)
            tests.wait()


def _tests_of(path: Path) -> list[str]:
    """Return the folders and files with the tests of a Python file's package.

    The firmware has its own tests and those of the cross-check. The packages cli and common are used
    everywhere, so they have all tests of the tools but the slowest.
    """
    top_folder, _, package, *_ = path.relative_to(ROOT).parts
    if top_folder == "firmware_py":
        return ["tests/firmware_py", "tests/host_tools/crosscheck"]
    tests = ROOT / "tests/host_tools"
    if package in ("cli", "common"):
        ignored_options = [f"--ignore={tests / slow_package}" for slow_package in SLOW_PACKAGES]
        return [*ignored_options, str(tests)]
    return [str(tests / (f"test_{package}" if package.endswith(".py") else package))]


# --- The plugin ------------------------------------------------------------------------------------------


def pytest_configure() -> None:
    """Let Python import the mutated file with the mutant's text."""
    original_get_code = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        if loader.path == os.environ[MUTATED_FILE]:
            return compile(os.environ[MUTANT_SOURCE], loader.path, "exec")
        return original_get_code(loader, name)

    patch.object(SourceFileLoader, "get_code", get_code).start()


def pytest_itemcollected(item: pytest.Item) -> None:
    item.add_marker(pytest.mark.timeout(TIMEOUT), append=False)
