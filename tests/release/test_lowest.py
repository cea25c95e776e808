"""Each dependency has a lower bound, and the command that tests the bounds takes all of them."""

from __future__ import annotations

import re

from release.lowest import PROJECT, oldest_python, requirements
from support import run


def test_each_dependency_has_a_lower_bound() -> None:
    """Which ``make lowest`` installs; it needs minutes and a connection."""
    stated = [*PROJECT["project"]["dependencies"], *PROJECT["build-system"]["requires"]]
    assert len(requirements()) >= len({*stated}) > 8
    assert [
        each for each in requirements() if not re.fullmatch(r"[\w.-]+(\[[\w,-]+\])?>=\d[\d.]*", each)
    ] == []


def test_the_oldest_python_is_one_that_is_allowed() -> None:
    lowest = PROJECT["project"]["requires-python"].removeprefix(">=")
    said = run(oldest_python(), "-c", "import sys; print(*sys.version_info[:2])")
    assert [int(each) for each in said.split()] >= [int(each) for each in lowest.split(".")]
