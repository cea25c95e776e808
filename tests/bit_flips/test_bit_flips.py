"""No flipped bit makes a call trap or hang, or keeps x wrong in silence; and the published table is true."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from bit_flips.flips import (
    FILTERS,
    FLIPS_PER_BIT,
    OUTCOMES,
    PAGE,
    Member,
    count_effects,
    format_table,
    sum_of_members,
)
from mcp_asdf import Filter
from support import slow

BITS = 8 * (16 + 1 + 1 + 10 + 24 + 20 + 29 + 64)
"""All members but the pointer: senders, id, updated, counters, accuracy, five words, robust, received."""
COUNTED = {"t", "n", "filter_left"}
"""Members whose change may alter the robot's counted data, and b_hat with it, and show nowhere else."""
EACH_FILTER = [Filter.ROBUST, *slow(kind for kind in FILTERS if kind != Filter.ROBUST)]


@cache
def counts_of_one_flip(filter_kind: Filter) -> dict[str, Member]:
    """Return the counts by member if each bit flips once."""
    with TemporaryDirectory() as folder:
        return count_effects(Path(folder), 1, filter_kind)


@cache
def published_counts(filter_kind: Filter) -> dict[str, Member]:
    """Return the counts by member if each bit flips as often as for the published table."""
    with TemporaryDirectory() as folder:
        return count_effects(Path(folder), FLIPS_PER_BIT, filter_kind)


def check_that_no_flip_keeps_x_wrong(counts_by_member: dict[str, Member]) -> None:
    """Check that after the last tick x is off in silence only where t, n or b_hat is another."""
    assert sum_of_members(counts_by_member.values())["unexplained"] == 0
    assert {name for name, member in counts_by_member.items() if member["still"]} <= COUNTED


@pytest.mark.parametrize("filter_kind", EACH_FILTER)
def test_each_bit_of_a_robot_s_memory_flips_once_and_has_one_effect(filter_kind: Filter) -> None:
    """A member of its memory has bits, and each flip of one is counted under one outcome."""
    counts_by_member = counts_of_one_flip(filter_kind)

    assert sum_of_members(counts_by_member.values())["flips"] == BITS
    for name, member in counts_by_member.items():
        assert sum(member[outcome] for outcome in OUTCOMES) == member["flips"], name


@pytest.mark.parametrize("filter_kind", EACH_FILTER)
def test_no_flip_keeps_x_wrong_in_silence(filter_kind: Filter) -> None:
    check_that_no_flip_keeps_x_wrong(counts_of_one_flip(filter_kind))


def check_that_every_flip_is_found_in_time(counts_by_member: dict[str, Member], prefix: str) -> None:
    """Check members of a robot's memory whose names begin so: found before x is off by more than 1 %."""
    members = {name: member for name, member in counts_by_member.items() if name.startswith(prefix)}
    assert len(members) > 0
    for name, member in members.items():
        assert member["in_time"] == member["flips"], name


@pytest.mark.parametrize("filter_kind", EACH_FILTER)
def test_every_flip_of_what_follows_from_b_hat_is_found_in_time(filter_kind: Filter) -> None:
    check_that_every_flip_is_found_in_time(counts_of_one_flip(filter_kind), "accuracy")


@pytest.mark.slow
def test_every_flip_of_the_robust_filter_s_memory_is_found_in_time_with_another_filter() -> None:
    """Which leaves that memory as it was made."""
    check_that_every_flip_is_found_in_time(counts_of_one_flip(Filter.ADAPTIVE), "robust")


@pytest.mark.slow
@pytest.mark.parametrize("filter_kind", FILTERS)
def test_none_of_the_published_flips_keeps_x_wrong_in_silence(filter_kind: Filter) -> None:
    check_that_no_flip_keeps_x_wrong(published_counts(filter_kind))


@pytest.mark.slow
def test_the_docs_have_the_table_of_what_flipped_bits_do_to_the_last_digit() -> None:
    page = PAGE.read_text(encoding="utf-8")
    table = format_table({kind: published_counts(kind) for kind in FILTERS})
    flips = len(FILTERS) * FLIPS_PER_BIT * BITS

    assert table in page, "PYTHONPATH=tests python -m bit_flips.flips"
    assert f"none of these {flips:,} did" in page


@pytest.mark.slow
@pytest.mark.parametrize("filter_kind", FILTERS)
def test_no_flip_makes_the_firmware_do_what_c_leaves_open(filter_kind: Filter, tmp_path: Path) -> None:
    """Sanitizers would end the program where it does, and then its counts would differ."""
    sanitizers = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")

    sanitized_counts = count_effects(tmp_path, 2, filter_kind, *sanitizers)

    assert sanitized_counts == count_effects(tmp_path, 2, filter_kind)
