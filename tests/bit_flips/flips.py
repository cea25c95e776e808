"""One flipped bit anywhere in a running robot's memory: whether a check finds it, and what it does to x."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mcp_asdf import Filter
from support import CORE, ROOT, TABLE, run

HERE = Path(__file__).parent
PAGE = ROOT / "docs/internals/trust.md"
FLIPS_PER_BIT = 10
"""For the published table."""
FILTERS = (Filter.ADAPTIVE, Filter.ROBUST)
OUTCOMES = ("in_time", "late", "no_effect", "less", "more")
"""Effects of a flip. Each flip has one effect; ``bit_flips.c`` explains them."""
COUNTS = ("flips", *OUTCOMES, "still", "unexplained")
"""What the program prints of each member, in this order."""

Member = dict[str, int]
"""Flips of a member's bits, by their effect."""


def count_effects(folder: Path, flips_per_bit: int, filter_kind: Filter, *flags: str) -> dict[str, Member]:
    """Flip each bit of a robot with this filter so often, and return the counts by the member's name.

    The program is compiled into the folder, with further ``flags`` of gcc.
    """
    program = folder / "bit_flips"
    run("gcc", "-std=c99", "-O2", f"-I{CORE.parent}", *flags, HERE / "bit_flips.c", TABLE, "-o", program)
    counts_by_member = {}
    for line in run(program, str(flips_per_bit), str(int(filter_kind))).splitlines():
        name, *counts = line.split()
        counts_by_member[name] = dict(zip(COUNTS, map(int, counts), strict=True))
    return counts_by_member


def sum_of_members(members: Iterable[Member]) -> Member:
    """Add up the counts of several members."""
    members = list(members)
    return {name: sum(member[name] for member in members) for name in COUNTS}


def format_table(counts_by_filter: dict[Filter, dict[str, Member]]) -> str:
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
