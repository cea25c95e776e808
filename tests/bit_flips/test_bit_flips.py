"""No flipped bit makes a call trap or hang, or keeps x wrong in silence; and the published table is true."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from golden import assert_equals_section
from mcp_asdf import Filter
from support import CORE, ROOT, TABLE, run

PROGRAM = Path(__file__).with_name("bit_flips.c")
PAGE = ROOT / "docs/internals/trust.md"
FLIPS_PER_BIT = 10
"""How often each bit is flipped for the published table."""
FILTERS = (Filter.ADAPTIVE, Filter.ROBUST)
OUTCOMES = ("in_time", "late", "no_effect", "less", "more")
"""Effects of a flip. Each flip has one effect; ``bit_flips.c`` explains them."""
COUNTS = ("flips", *OUTCOMES, "still", "unexplained")
"""What the program prints of each member, in this order."""

BITS_OF_A_ROBOT = 8 * (16 + 1 + 1 + 10 + 24 + 20 + 29 + 64)
"""The number of bits of all members but the pointer.

The bytes are those of senders, id, updated, counters, accuracy, five words, robust and received.
"""

Member = dict[str, int]
"""The numbers of flips of a member's bits, by the names of COUNTS."""
Counts = dict[str, Member]
"""The numbers of all members of a robot's memory, by the member's name."""


def count_effects(folder: Path, flips_per_bit: int, filter_kind: Filter, *flags: str) -> Counts:
    """Flip each bit of a robot with this filter so often, and return the counts by the member's name.

    The program is compiled into the folder, with further ``flags`` of gcc.
    """
    program = folder / "bit_flips"
    run("gcc", "-std=c99", "-O2", f"-I{CORE.parent}", *flags, PROGRAM, TABLE, "-o", program)
    counts_by_member = {}
    for line in run(program, str(flips_per_bit), str(int(filter_kind))).splitlines():
        name, *counts = line.split()
        counts_by_member[name] = dict(zip(COUNTS, map(int, counts), strict=True))
    return counts_by_member


def sum_of_members(members: Iterable[Member]) -> Member:
    """Add up the counts of several members."""
    members = list(members)
    return {name: sum(member[name] for member in members) for name in COUNTS}


@cache
def count_flips(filter_kind: Filter, flips_per_bit: int) -> Counts:
    """Return the counts of ``count_effects``, which are made once per filter and number of flips."""
    with TemporaryDirectory() as folder:
        return count_effects(Path(folder), flips_per_bit, filter_kind)


@pytest.fixture(
    params=[
        pytest.param((Filter.ROBUST, 1), id="once"),
        pytest.param((Filter.ROBUST, FLIPS_PER_BIT), id="robust", marks=pytest.mark.slow),
        pytest.param((Filter.ADAPTIVE, FLIPS_PER_BIT), id="adaptive", marks=pytest.mark.slow),
    ]
)
def filter_and_flips(request: pytest.FixtureRequest) -> tuple[Filter, int]:
    """A filter, and how often each bit is flipped: once, or as often as for the published table."""
    parameters: tuple[Filter, int] = request.param
    return parameters


@pytest.fixture
def counted(filter_and_flips: tuple[Filter, int]) -> Counts:
    """The effects of all flips in a robot with the filter."""
    return count_flips(*filter_and_flips)


def test_every_bit_of_a_robot_s_memory_flips_and_each_flip_has_one_effect(
    filter_and_flips: tuple[Filter, int], counted: Counts
) -> None:
    """Its memory has members, such as t and b_hat. An effect is, say, that a check finds the flip in time.

    Each bit is flipped once or ten times. ``counted`` has the number of flips, and that of each effect, for
    each member.
    """
    _filter, flips_per_bit = filter_and_flips
    effects_of_all_members = sum_of_members(counted.values())
    assert effects_of_all_members["flips"] == flips_per_bit * BITS_OF_A_ROBOT
    for name, effects in counted.items():
        flips_with_an_effect = sum(effects[outcome] for outcome in OUTCOMES)
        assert flips_with_an_effect == effects["flips"], name


def test_no_flip_keeps_x_wrong_in_silence(counted: Counts) -> None:
    """x is what a robot believes. Only flips of what it has counted may keep it wrong, with other counts.

    "still" is the number of flips after which x is still off by 1 % at the end, after 1800 ticks. Of these,
    "unexplained" are those after which counts and b_hat are what they would have been.
    """
    members_that_keep_x_wrong = {name for name, effects in counted.items() if effects["still"] > 0}
    effects_of_all_members = sum_of_members(counted.values())

    members_with_counts = {"t", "n", "filter_left"}
    assert members_that_keep_x_wrong <= members_with_counts
    assert effects_of_all_members["unexplained"] == 0


def members_not_found_in_time(counted: Counts, prefix: str) -> list[str]:
    """Return the members with this prefix where some flip makes x wrong before it is found."""
    members = {name: effects for name, effects in counted.items() if name.startswith(prefix)}
    assert len(members) > 0
    return [name for name, effects in members.items() if effects["in_time"] < effects["flips"]]


def test_every_flip_of_what_follows_from_b_hat_is_found_in_time(counted: Counts) -> None:
    """These members are called accuracy.c and so on. In time is before what it believes is off by 1 %."""
    assert members_not_found_in_time(counted, "accuracy") == []


@pytest.mark.slow
def test_every_flip_of_the_robust_filter_s_memory_is_found_in_time_with_another_filter() -> None:
    """The other filter leaves that memory as it was made, so each change of it is a fault.

    The members are called robust.centre and so on. In time is before what the robot believes is off by 1 %.
    """
    counted = count_flips(Filter.ADAPTIVE, FLIPS_PER_BIT)
    assert members_not_found_in_time(counted, "robust") == []


def format_table(counts_by_filter: dict[Filter, Counts]) -> str:
    """Return the page's table, in per cent of all flips, of counts with FLIPS_PER_BIT flips."""
    titles = (
        *("filter", "bits", "seen before x is off", "seen after"),
        *("unseen: x right", "less off", "off by 1 %", "so after 1800 ticks"),
    )
    rows = [titles, ("---",) * len(titles)]
    for filter_kind, counts_by_member in counts_by_filter.items():
        total = sum_of_members(counts_by_member.values())
        shares = [_format_share(total, name) for name in (*OUTCOMES, "still")]
        rows.append((filter_kind.name.lower(), str(total["flips"] // FLIPS_PER_BIT), *shares))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _format_share(member: Member, name: str) -> str:
    """Return a count in per cent of the flips with two digits, and nothing for 0."""
    share = 100 * member[name] / member["flips"]
    if share == 0:
        return ""
    return f"{share:.2g}" if share < 10 else f"{share:.0f}"


@pytest.mark.slow
def test_the_docs_have_the_table_of_what_flipped_bits_do_to_the_last_digit() -> None:
    """Each bit flips ten times with either filter. With RENEW_GOLDEN_FILES=1 this writes the table again."""
    table = format_table({kind: count_flips(kind, FLIPS_PER_BIT) for kind in FILTERS})
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
