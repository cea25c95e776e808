"""No flipped bit makes a call trap or hang, or keeps x wrong in silence; and the published table is true."""

from __future__ import annotations

from dataclasses import dataclass
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
from golden import assert_equals_section
from mcp_asdf import Filter

BITS_OF_A_ROBOT = 8 * (16 + 1 + 1 + 10 + 24 + 20 + 29 + 64)
"""All members but the pointer: senders, id, updated, counters, accuracy, five words, robust, received."""


@dataclass(frozen=True)
class CountedFlips:
    """Each bit of a robot's memory has flipped so often, and each flip is counted by its effect.

    Attributes:
        flips_per_bit: How often each bit has flipped.
        members: The members of the robot's memory, by name.
    """

    flips_per_bit: int
    members: dict[str, Member]


@cache
def count_flips(filter_kind: Filter, flips_per_bit: int) -> CountedFlips:
    """Flip each bit of a robot with this filter so often, and count the effects."""
    with TemporaryDirectory() as folder:
        return CountedFlips(flips_per_bit, count_effects(Path(folder), flips_per_bit, filter_kind))


@pytest.fixture(
    params=[
        pytest.param((Filter.ROBUST, 1), id="once"),
        pytest.param((Filter.ROBUST, FLIPS_PER_BIT), id="robust", marks=pytest.mark.slow),
        pytest.param((Filter.ADAPTIVE, FLIPS_PER_BIT), id="adaptive", marks=pytest.mark.slow),
    ]
)
def counted(request: pytest.FixtureRequest) -> CountedFlips:
    """The effects of all flips: each bit is flipped once, or as often as for the published table."""
    filter_kind, flips_per_bit = request.param
    return count_flips(filter_kind, flips_per_bit)


def test_every_bit_of_a_robot_s_memory_flips_and_each_flip_has_one_effect(counted: CountedFlips) -> None:
    """Its memory has members, such as t and b_hat. An effect is, say, that a check finds the flip in time.

    Each bit is flipped once or ten times. ``counted`` has the number of flips, and that of each effect, for
    each member.
    """
    effects_of_all_members = sum_of_members(counted.members.values())
    assert effects_of_all_members["flips"] == counted.flips_per_bit * BITS_OF_A_ROBOT
    for name, effects in counted.members.items():
        flips_with_an_effect = sum(effects[outcome] for outcome in OUTCOMES)
        assert flips_with_an_effect == effects["flips"], name


def test_no_flip_keeps_x_wrong_in_silence(counted: CountedFlips) -> None:
    """x is what a robot believes. Only flips of what it has counted may keep it wrong, with other counts.

    "still" is the number of flips after which x is still off by 1 % at the end, after 1800 ticks. Of these,
    "unexplained" are those after which counts and b_hat are what they would have been.
    """
    members_that_keep_x_wrong = {name for name, effects in counted.members.items() if effects["still"] > 0}
    effects_of_all_members = sum_of_members(counted.members.values())

    members_with_counts = {"t", "n", "filter_left"}
    assert members_that_keep_x_wrong <= members_with_counts
    assert effects_of_all_members["unexplained"] == 0


def members_not_found_in_time(counted: CountedFlips, prefix: str) -> list[str]:
    """Return the members with this prefix where some flip makes x wrong before it is found."""
    members = {name: effects for name, effects in counted.members.items() if name.startswith(prefix)}
    assert len(members) > 0
    return [name for name, effects in members.items() if effects["in_time"] < effects["flips"]]


def test_every_flip_of_what_follows_from_b_hat_is_found_in_time(counted: CountedFlips) -> None:
    """These members are called accuracy.c and so on. In time is before what it believes is off by 1 %."""
    assert members_not_found_in_time(counted, "accuracy") == []


@pytest.mark.slow
def test_every_flip_of_the_robust_filter_s_memory_is_found_in_time_with_another_filter() -> None:
    """The other filter leaves that memory as it was made, so each change of it is a fault.

    The members are called robust.centre and so on. In time is before what the robot believes is off by 1 %.
    """
    counted = count_flips(Filter.ADAPTIVE, FLIPS_PER_BIT)
    assert members_not_found_in_time(counted, "robust") == []


@pytest.mark.slow
def test_the_docs_have_the_table_of_what_flipped_bits_do_to_the_last_digit() -> None:
    """Each bit flips ten times with either filter. With RENEW_GOLDEN_FILES=1 this writes the table again."""
    table = format_table({kind: count_flips(kind, FLIPS_PER_BIT).members for kind in FILTERS})
    number_of_flips = len(FILTERS) * FLIPS_PER_BIT * BITS_OF_A_ROBOT

    assert_equals_section(PAGE, "bit flips", table)
    assert f"none of these {number_of_flips:,} did" in PAGE.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("filter_kind", FILTERS)
def test_no_flip_makes_the_firmware_do_what_c_leaves_open(filter_kind: Filter, tmp_path: Path) -> None:
    """Each bit is flipped twice. Sanitizers would end the program with an error where it does.

    The effects are the same as without sanitizers.
    """
    sanitizers = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")

    flips_per_bit = 2
    counts_with_sanitizers = count_effects(tmp_path, flips_per_bit, filter_kind, *sanitizers)
    counts_without = count_effects(tmp_path, flips_per_bit, filter_kind)

    assert counts_with_sanitizers == counts_without
