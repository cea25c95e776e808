"""Each small mistake in the firmware's C fails a C test; those that are none are listed with the reason."""

from __future__ import annotations

import random
import re

import pytest

from mutation.c_killers import MUTATED, is_noticed
from mutation.mutants import equivalents, mistakes, mutants
from proofs.source import SOURCES
from support import ROOT, require

MUTANTS = [mutant for path in MUTATED for mutant in mutants(path)]
MISTAKES = [mistake for path in MUTATED for mistake in mistakes(path)]
HARMLESS_CHANGES = [mutant for mutant in MUTANTS if mutant.name in equivalents()]
PARTS = 4
READS_BEYOND_AN_ARRAY = "the array ends, which the sanitizers report"
"""Part of the reason of a change that is harmless unless an array is full."""


@pytest.fixture(autouse=True)
def compiler() -> None:
    require("tcc", "tcc")


def test_the_page_about_trust_states_how_many_mistakes_are_tried_and_how_many_are_harmless() -> None:
    """It rounds the first number to a hundred."""
    page = (ROOT / "docs/internals/trust.md").read_text("utf-8")

    [counts] = re.findall(r"Each of some ([\d,]+) small ones .* except (\d+) that make no difference", page)

    all_count, harmless_count = (int(count.replace(",", "")) for count in counts)
    assert all_count == pytest.approx(len(MUTANTS), abs=99)
    assert harmless_count == len(HARMLESS_CHANGES)


@pytest.mark.slow
@pytest.mark.parametrize("file", ["mcp_asdf.c", "mcp_asdf_frame.c", "mcp_asdf_small.c"])
def test_the_firmware_without_a_mistake_passes_the_tests_that_find_mistakes(file: str) -> None:
    """Otherwise a test would fail with any planted change. Each file stands for those with the same tests."""
    assert not is_noticed(SOURCES / file, (SOURCES / file).read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_every_mistake_fails_a_test(part: int) -> None:
    """A mistake is, say, a < that becomes <=. The test runs four times, each with a quarter of all mistakes.

    A change is no mistake if the list says why it is harmless.
    """
    survivors = [
        mutant.name for mutant in MISTAKES[part::PARTS] if not is_noticed(mutant.path, mutant.source())
    ]
    assert survivors == []


@pytest.mark.slow
def test_changes_that_are_listed_as_harmless_fail_no_quick_test() -> None:
    """Twelve are drawn, as each takes a second or more.

    A change that reads beyond an array is not tried: what it reads there is different in each run.
    """
    tried_changes = [
        mutant for mutant in HARMLESS_CHANGES if READS_BEYOND_AN_ARRAY not in equivalents()[mutant.name]
    ]
    for mutant in random.sample(tried_changes, 12):
        assert not is_noticed(mutant.path, mutant.source(), is_patient=False), mutant.name
