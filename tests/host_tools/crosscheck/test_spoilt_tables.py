"""Tables that are none: both firmwares refuse the same, and the scenarios would find one that does not."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

import mcp_asdf.robot
import mcp_asdf.table
from crosschecks import SEED, module_of
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.table import MAGIC, checksum
from mcp_asdf_tools.crosscheck.compare import Firmware, Subject, compare_firmwares
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario, spoilt_table
from mcp_asdf_tools.crosscheck.scenario import Scenario, TableChoice, build_table, parse_scenario

_SOUND = "robot:0:1:64:0:3221225472"


def make(robot: type[MirrorRobot] | type[NativeRobot], *replaced: int, q: int = 30) -> str:
    """The outcome of making a robot whose table has words replaced."""
    table = ":".join(map(str, ("table:0.05", q, *replaced)))
    return Subject(cast(Firmware, robot), parse_scenario(f"{table},{_SOUND}").setup).last.outcome


@pytest.mark.parametrize("robot", [NativeRobot, MirrorRobot])
def test_every_bit_of_a_table_reaches_the_firmware(robot: type[MirrorRobot] | type[NativeRobot]) -> None:
    """With the old checksum each changed bit is refused, with one that fits each of word 0.

    A smaller q aside: such words can be a table.
    """
    words = build_table(TableChoice("0.05", 30)).words()
    assert (make(robot), words[0]) == ("OK", MAGIC | 30)
    for index, word in enumerate(words):
        for bit in range(32):
            changed = word ^ 1 << bit
            last = 2 + (changed & 0xFF) if index == 0 else 32
            stale = () if index == 32 else (last, words[32])
            assert make(robot, index, changed, *stale) == "ERR_TABLE", (index, bit)
            if index == 0 and not (bit < 8 and 2 <= changed & 0xFF < 30):
                assert make(robot, index, changed) == "ERR_TABLE", (index, bit)


@pytest.mark.parametrize("robot", [NativeRobot, MirrorRobot])
def test_the_checksum_of_a_changed_table_is_made_right(robot: type[MirrorRobot] | type[NativeRobot]) -> None:
    least = build_table(TableChoice("0.05", 30)).entries[-1]
    assert make(robot, 31, least - 1) == make(robot, 1, 1) == make(robot, 0, MAGIC | 29) == "OK"
    assert make(robot, 0, MAGIC | 31, 32, least - 1) == "OK", "one more entry"
    assert make(robot, 0, MAGIC | 31) == "ERR_TABLE", "one more entry, which is 0"
    assert make(robot, 0, MAGIC | 127) == "ERR_TABLE", "a table cut short"


def kinds_of_damage(choice: TableChoice) -> Iterator[str]:
    """Damaged parts of a table, and how its checksum is."""
    found, right = build_table(choice).words(), build_table(replace(choice, replaced=())).words()
    if found[0] >> 8 != right[0] >> 8:
        yield "magic"
    if len(found) != len(right):
        yield "cut short" if len(found) > len(right) else "q"
        yield "least q" if len(found) < 5 else "most q" if len(found) > 130 else "possible q"
    for index, (left, other) in enumerate(zip(found[1:-1], right[1:-1], strict=False)):
        if left != other:
            yield "entry" if index else "omega"
    yield "checksum fits" if found[-1] == checksum(found[:-1]) else "checksum does not fit"


def test_scenarios_damage_every_part_of_a_table() -> None:
    met = Counter[str]()
    for number in range(600):
        choice = random_scenario(SEED, number).setup.table
        met.update(kinds_of_damage(choice) if choice is not None and choice.replaced else ())
    parts = {"magic", "q", "cut short", "least q", "most q", "possible q", "omega", "entry"}
    assert parts | {"checksum fits", "checksum does not fit"} == met.keys()


TABLE_FAULTS = {
    "magic": ("if first - q != MAGIC:", "if first - q >> 9 != MAGIC >> 9:"),
    "least q": ("MIN_Q, MAX_Q = 2, 127", "MIN_Q, MAX_Q = 1, 127"),
    "most q": ("MIN_Q, MAX_Q = 2, 127", "MIN_Q, MAX_Q = 2, 128"),
    "least omega": ("1 <= omega_word", "0 <= omega_word"),
    "most omega": ("round(0.9 * 2**32)", "round(0.9 * 2**32) + 1"),
    "checksum": ("if stated != expected:", "if stated >> 1 != expected >> 1:"),
    "falling entries": ("if right >= left:", "if right > left:"),
    "entries above 1": ("entries[-1] <= 1 <<", "entries[-1] < 1 <<"),
}
"""Lines of ``mcp_asdf.table``, and the same that let something through."""


def differing_tables() -> int:
    """How many of 1500 spoilt tables only one of native and mirror takes."""
    source, setup = random.Random(SEED), parse_scenario(_SOUND).setup
    setups = (replace(setup, table=spoilt_table(source)) for _ in range(1500))
    return sum(
        compare_firmwares(Scenario(setup, ()), NativeRobot, MirrorRobot) is not None for setup in setups
    )


def test_spoilt_tables_are_the_same_to_both() -> None:
    assert differing_tables() == 0


@pytest.mark.parametrize("fault", TABLE_FAULTS)
def test_a_fault_in_reading_tables_is_caught(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right, wrong = TABLE_FAULTS[fault]
    source = Path(mcp_asdf.table.__file__).read_text(encoding="utf-8")
    assert source.count(right) == 1, f"the reader's source has changed: plant {fault!r} anew"
    changed = module_of(mcp_asdf.table, source.replace(right, wrong))
    monkeypatch.setattr(mcp_asdf.robot, "Table", changed.Table)
    monkeypatch.setattr(mcp_asdf.robot, "TableError", changed.TableError)
    assert differing_tables() > 0
