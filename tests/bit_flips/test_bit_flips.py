"""No flipped bit makes a call trap or hang, or keeps x wrong in silence; and the published table is true."""

from __future__ import annotations

from pathlib import Path

import pytest

from bit_flips.flips import FILTERS, FLIPS, OUTCOMES, PAGE, Member, members, table, total
from mcp_asdf import Filter
from support import slow

BITS = 8 * (16 + 1 + 1 + 10 + 24 + 20 + 20 + 40 + 24)
"""All members but the pointer: senders, id, updated, counters, accuracy, five words, crowd, two rounds."""
COUNTED = {"t", "n", "filter_left"}
"""Members whose change may alter the robot's counted data, and b_hat with it, and show nowhere else."""


def check(kind: Filter, found: dict[str, Member], flips: int) -> None:
    """Properties of any number of flips."""
    idle = "open." if kind is Filter.ROBUST else "crowd."
    assert all(found[name]["in_time"] == found[name]["flips"] for name in found if name.startswith(idle))
    every = total(found.values())
    assert every["flips"] == flips * BITS
    assert every["unexplained"] == 0
    assert {name for name, member in found.items() if member["still"]} <= COUNTED
    for name, member in found.items():
        assert sum(member[each] for each in OUTCOMES) == member["flips"], name
    assert all(
        found[name]["in_time"] == found[name]["flips"] for name in found if name.startswith("accuracy")
    )


@pytest.mark.parametrize("kind", [Filter.ROBUST, *slow(kind for kind in FILTERS if kind != Filter.ROBUST)])
def test_each_bit_flips_once(kind: Filter, tmp_path: Path) -> None:
    check(kind, members(tmp_path, 1, kind), 1)


@pytest.mark.slow
def test_the_published_table_is_true(tmp_path: Path) -> None:
    """To the last digit; and no flip is undefined behaviour."""
    found = {kind: members(tmp_path, FLIPS, kind) for kind in FILTERS}
    for kind, counts in found.items():
        check(kind, counts, FLIPS)
    page = PAGE.read_text(encoding="utf-8")
    assert table(found) in page, "PYTHONPATH=tests python -m bit_flips.flips"
    assert f"none of these {len(FILTERS) * FLIPS * BITS:,} did" in page
    robust = found[Filter.ROBUST]
    for name in ("first", "voices", "trend"):  # as the page says
        assert robust[f"crowd.{name}"]["no_effect"] == robust[f"crowd.{name}"]["flips"]
    sanitizers = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    for kind in FILTERS:
        assert members(tmp_path, 2, kind, *sanitizers) == members(tmp_path, 2, kind)
