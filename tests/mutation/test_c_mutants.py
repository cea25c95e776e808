"""Each small mistake in the firmware's C fails a C test; those that are none are listed with the reason."""

from __future__ import annotations

import itertools
import random
import re
from functools import cache
from pathlib import Path

import pytest

from mutation.c_mutants import MUTATED, Mutant, mutants
from mutation.equivalents import equivalents
from mutation.killers import CODEC_TESTS, THIRD, Try, first_failing_test, passes
from proofs.source import SOURCES, VARIANTS
from support import ROOT, require

EQUIVALENTS = equivalents("c")
PARTS = 4
READS_BEYOND_AN_ARRAY = "the array ends, which the sanitizers report"
"""Part of the reason of a change that is harmless unless an array is full."""


@pytest.fixture(autouse=True)
def compiler() -> None:
    require("tcc", "tcc")


@cache
def all_mutants() -> dict[str, Mutant]:
    """All mutants by their names."""
    mutants_by_name: dict[str, Mutant] = {}
    for file in MUTATED:
        for mutant in mutants(file):
            assert mutant.name not in mutants_by_name, f"two mutants have one name: {mutant.name}"
            mutants_by_name[mutant.name] = mutant
    return mutants_by_name


def test_each_change_that_is_listed_as_harmless_is_one_that_is_tried() -> None:
    """An entry of equivalents.toml about code of the past would hide a mistake later.

    EQUIVALENTS has the reason by the change's name. A mutant is the firmware with a change that is tried.
    """
    assert set(EQUIVALENTS) <= set(all_mutants())


def test_few_changes_are_listed_as_harmless_and_each_with_a_reason() -> None:
    """Less than one change in twenty is listed, such as a comparison with the same result for all values."""
    assert len(EQUIVALENTS) < len(all_mutants()) / 20
    for name, reason in EQUIVALENTS.items():
        assert len(reason) > 20, name


def test_the_page_about_trust_states_to_a_hundred_how_many_mistakes_are_tried() -> None:
    """A mutant is the firmware with one mistake, and ``all_mutants`` has all that are tried."""
    page = (ROOT / "docs/internals/trust.md").read_text("utf-8")

    [stated_count] = re.findall(r"Each of some ([\d,]+) small ones", page)

    assert int(stated_count.replace(",", "")) == pytest.approx(len(all_mutants()), abs=99)


@pytest.mark.slow
def test_the_firmware_without_a_mistake_passes_the_tests_that_find_mistakes() -> None:
    """It passes in every variant of its arithmetic. Otherwise a test would fail with any planted change.

    A test is a program in C, or the comparison with the independent implementation (THIRD). What is built for
    the tests does not stand among the sources.
    """
    files_before = set(SOURCES.iterdir())
    codec_tests = list(itertools.chain.from_iterable(CODEC_TESTS.values()))

    for variant, test in itertools.product(VARIANTS, (THIRD, "core", *codec_tests)):
        assert passes(SOURCES, Try(test, variant)), f"{test} {variant}"

    assert set(SOURCES.iterdir()) == files_before


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_every_mistake_fails_a_test(part: int, tmp_path: Path) -> None:
    """A mistake is, say, a < that becomes <=. The test runs four times, each with a quarter of all mistakes.

    A change is no mistake if the list says why it is harmless.
    """
    mistakes = [mutant for name, mutant in all_mutants().items() if name not in EQUIVALENTS]
    mistakes_of_this_part = mistakes[part::PARTS]  # each fourth one
    survivors = []
    for mutant in mistakes_of_this_part:
        if first_failing_test(mutant, tmp_path) == "":
            survivors.append(mutant.name)
    assert survivors == []


@pytest.mark.slow
def test_changes_that_are_listed_as_harmless_fail_no_quick_test(tmp_path: Path) -> None:
    """Twelve are drawn, as each takes a second or more.

    A change that reads beyond an array is not tried: what it reads there is different in each run.
    """
    names = [name for name, reason in EQUIVALENTS.items() if READS_BEYOND_AN_ARRAY not in reason]
    for name in random.sample(names, 12):
        failing_test = first_failing_test(all_mutants()[name], tmp_path, is_patient=False)
        assert failing_test == "", name


# --- What kills a mutant, and what does not ---------------------------------------------------------------

WRONG_MASK_OF_NODE_ID = "mcp_asdf_frame.c define ID_NODE_MASK: [0x7F => 0x7e]U"
"""Name of a mutant: the file, the place in it, and what becomes what there."""


def test_a_mistake_in_a_mask_of_the_frame_codec_fails_the_tests_of_the_node(tmp_path: Path) -> None:
    """They are the first tests that fail, in the first variant of the arithmetic, whose name is 1001."""
    mutant = all_mutants()[WRONG_MASK_OF_NODE_ID]
    assert first_failing_test(mutant, tmp_path) == "node 1001"


def test_a_harmless_change_fails_no_test(tmp_path: Path) -> None:
    """Tests that failed with every change would look perfect.

    A "<" becomes a "<=" where both give 0 for equal numbers: a mantissa of 24 bits is shifted by 24.
    """
    name = (
        "mcp_asdf_frame.c alpha_word_from_binary32: "
        "return lost_bits [< => <=] 24U ? (mantissa >> lost_bits) << 8 : 0U;"
    )
    assert first_failing_test(all_mutants()[name], tmp_path) == ""
