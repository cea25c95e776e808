"""Scenarios: they reach every outcome and kind of state, and are lines that read back."""

from __future__ import annotations

import random
import re
import shlex
from collections import Counter
from collections.abc import Iterator

import pytest

from crosschecks import ROBOT, SEED
from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE, alpha_units
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.compare import Subject
from mcp_asdf_tools.crosscheck.random_scenarios import TABLES, random_scenario, round_at_threshold
from mcp_asdf_tools.crosscheck.scenario import Call, TableChoice, parse_scenario


def seen() -> tuple[Counter[str], Counter[str]]:
    """Outcomes of calls, and traits of them and of states, in 400 scenarios."""
    outcomes, states = Counter[str](), Counter[str]()
    for number in range(400):
        scenario = random_scenario(SEED, number)
        subject = Subject(MirrorRobot, scenario.setup)
        outcomes[subject.last.outcome] += 1
        for call in scenario.calls if subject.last.state else ():
            before, after = subject.last, subject.apply(call)
            outcomes[f"{call.name} {after.outcome}"] += 1
            states.update(traits(call, before.state, after.state))
    return outcomes, states


def traits(call: Call, before: dict[str, int], after: dict[str, int]) -> Iterator[str]:
    """Names for the remarkable in a call."""
    if call.name == "restore" and after != before:
        yield "restored, x_hat and alpha apart" if after["updated"] else "restored"
    if call.name in ("observe", "step") and call.numbers[0] < 2:
        yield from observed(before, after)
    if call.name == "receive" and after["accepted"] != before["accepted"]:
        yield from received(call.numbers[2])
    if call.name in ("settle", "step"):
        yield from settled(before, after)
    counters = ("accepted", "repeated", "rejected", "tests", "updates")
    wrapped = [name for name in counters if (before[name], after[name]) == (0xFFFF, 0)]
    yield from (f"{name} wraps" for name in wrapped if call.name not in ("restore", "damage"))


def observed(before: dict[str, int], after: dict[str, int]) -> Iterator[str]:
    alpha = after["alpha"]
    yield "halved" if after["t"] < before["t"] else "counted"
    yield "capped" if alpha == ALPHA_MAX else "fine" if alpha >> 31 else "coarse"
    yield "end" if after["x_hat"] in (0, ONE) else "half" if after["x_hat"] == HALF else "inside"
    yield "inverted" if after["accuracy_b_hat"] < 2**31 else "upright"
    yield "nothing" if after["accuracy_c"] == 2**32 - 1 else "something"


def received(alpha: int) -> Iterator[str]:
    mantissa, junk, shift = alpha >> 8, alpha >> 5 & 7, alpha & 31
    yield "alpha with ignored bits" if junk else "alpha without ignored bits"
    yield "alpha of high units" if alpha_units(alpha) >> 32 else "alpha of low units"
    if mantissa == 0:
        yield "alpha 0, shifted" if shift else "alpha 0"
    elif shift and mantissa < 2**23:
        yield "alpha not canonical"
    else:
        yield "largest alpha" if alpha | 0xE0 == ALPHA_MAX | 0xE0 else "canonical alpha"


def settled(before: dict[str, int], after: dict[str, int]) -> Iterator[str]:
    m, b, beta = before["open_count"], after["b_hat()"], after["closed_alpha"]
    updated = after["updates"] != before["updates"]
    away = abs(after["x_bar()"] - HALF)
    if after["tests"] != before["tests"]:
        yield f"test {min(m, 3)}, {'rejects' if updated else 'accepts'}"
        yield "test 127" if m == 127 else "test fewer"
    if updated:
        yield f"update {'to the least' if b == 2**12 else 'to the most' if b == 2**32 - 2**12 else 'inside'}"
        yield f"update {'with high units' if beta >> 32 else 'with low units'}"
    if before["filter_left"] == 1 and m > 1 and abs(away - 1024) < 3:
        yield "hesitates, but updates" if updated else "hesitates"


OUTCOMES = [
    *("OK", "observe OK", "observe ERR_OBSERVATION", "step OK", "step UPDATED", "step ERR_OBSERVATION"),
    *("receive OK", "receive REPEATED", "receive ERR_SENDER", "receive ERR_X_HAT"),
    *("settle OK", "settle UPDATED", "restore OK", "restore ERR_IMAGE", "damage ERR_IMAGE"),
]
TRAITS = [
    *("restored", "restored, x_hat and alpha apart", "halved", "capped", "fine", "coarse"),
    *("end", "half", "inside", "inverted", "upright", "nothing", "something", "test 127"),
    *("alpha 0", "alpha 0, shifted", "alpha not canonical", "canonical alpha", "largest alpha"),
    *("alpha with ignored bits", "alpha of low units", "alpha of high units"),
    *(f"{name} wraps" for name in ("accepted", "repeated", "rejected", "tests", "updates")),
    *("update with low units", "update with high units", "hesitates", "hesitates, but updates"),
    *(f"test {m}, {verdict}" for m in (2, 3) for verdict in ("rejects", "accepts")),
    *("update to the least", "update to the most", "update inside"),
]


def test_scenarios_bring_about_every_status_and_kind_of_state() -> None:
    outcomes, states = seen()
    assert [each for each in OUTCOMES if not outcomes[each]] == []
    assert [each for each in TRAITS if not states[each]] == []


@pytest.mark.parametrize("choice", [TableChoice(*table) for table in TABLES], ids=str)
def test_rounds_come_near_the_threshold_on_both_sides(choice: TableChoice) -> None:
    source, table, sides = random.Random(5), choice.build(), Counter[bool]()
    for _ in range(400):
        m = source.randint(2, 127)
        x_hats, own = round_at_threshold(source, table, m)
        assert len(x_hats) == m
        assert all(0 <= x <= ONE for x in (*x_hats, own))
        left = (sum(x_hats) - m * own) ** 2 << FRACTION_BITS
        right = table.entry(m) * (m * sum(x * x for x in x_hats) - sum(x_hats) ** 2)
        if right and abs(left - right) * 2**24 < right:
            sides[left > right] += 1
    assert min(sides[False], sides[True]) > 20


def test_scenarios_differ_and_are_lines_that_read_back() -> None:
    scenarios = [random_scenario(seed, number) for seed in (0, 1) for number in range(100)]
    lines = [str(each) for each in scenarios]
    assert len(set(lines)) == len(lines)
    assert [parse_scenario(line) for line in lines] == scenarios
    assert all(shlex.quote(line) == line for line in lines), "a line needs no quotes"


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "starts with"),
        ("observe:1", "starts with"),
        ("table:0.05:30", "starts with"),
        ("table:0.05,robot:0:1:64:0:1", "table:0.05 needs omega and q"),
        ("table:1.5:30,robot:0:1:64:0:1", "omega is 1.5"),
        ("table:0.05:1,robot:0:1:64:0:1", "neighbours is 1"),
        ("table:0.05:2:5,robot:0:1:64:0:1", "table:0.05:2:5 needs omega and q"),
        ("robot:0:1:64:0", "takes 5"),
        ("robot:0:1:64:256:1", "256 is too large"),
        (f"{ROBOT},leave:1", "'leave:1' is no call"),
        (f"{ROBOT},{ROBOT}", "is no call"),
        (f"{ROBOT},observe", "takes 1"),
        (f"{ROBOT},observe:1:1", "takes 1"),
        (f"{ROBOT},observe:-1", "'-1' is no whole number"),
        (f"{ROBOT},observe:0x1", "'0x1' is no whole number"),
        (f"{ROBOT},observe:²", "'²' is no whole number"),
        (f"{ROBOT},observe:", "'' is no whole number"),
        (f"{ROBOT},observe:{'1' * 5000}", "is no whole number"),
        (f"{ROBOT},receive:1:4294967296:0", "4294967296 is too large"),
        (f"{ROBOT},restore:1", "pairs"),
        (f"{ROBOT},restore:0:1", "1 to 29"),
        (f"{ROBOT},restore:30:1", "1 to 29"),
        (f"{ROBOT},restore:1:4294967296", "32-bit"),
        (f"{ROBOT},damage:124:1", "124 is too large"),
    ],
)
def test_a_line_that_will_not_do_is_explained(line: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=re.escape(complaint)):
        parse_scenario(line)
