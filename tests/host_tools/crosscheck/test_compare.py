"""The cross-check: it finds nothing, it would find a single wrong bit, and its command says so.

Faults are planted in copies of the mirror (its source with one constant changed) and in tables; each must be
caught by comparison with the C, and those in the arithmetic also without it, by exact arithmetic.
"""

from __future__ import annotations

import ast
import json
import math
import random
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import cast

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import mcp_asdf.fixed_point
import mcp_asdf.mirror
import mcp_asdf.robot
import mcp_asdf.table
from mcp_asdf.fixed_point import ALPHA_MAX, HALF, ONE, alpha_units
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf.table import FRACTION_BITS, MAGIC, checksum
from mcp_asdf_tools.cli import crosscheck as command
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck import exact
from mcp_asdf_tools.crosscheck import oracle as audit_module
from mcp_asdf_tools.crosscheck.compare import (
    Check,
    Disagreement,
    Firmware,
    Subject,
    compare_firmwares,
    crosscheck,
    differences,
    shrink,
)
from mcp_asdf_tools.crosscheck.operation_count import CallCount, measure_storage
from mcp_asdf_tools.crosscheck.oracle import Audit
from mcp_asdf_tools.crosscheck.random_scenarios import (
    TABLES,
    random_scenario,
    round_at_threshold,
    spoilt_table,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, TableChoice, build_table, parse_scenario
from support import slow

MIRROR, FIXED_POINT = mcp_asdf.mirror, mcp_asdf.fixed_point
SOURCES = {
    module: Path(cast(str, module.__file__)).read_text(encoding="utf-8") for module in (MIRROR, FIXED_POINT)
}
"""The arithmetic of the mirror."""
SEED = 1
CALLS = 40_000
"""Maximum number of calls to catch a fault; most take a few hundred."""

AnyRobot = type[MirrorRobot] | type[NativeRobot] | type[ReferenceRobot]


def silent(done: int) -> None:
    """Report nothing."""


def judged(left: Firmware, right: Firmware) -> Check:
    """A check that compares two firmwares and audits them."""
    audit = Audit()
    return lambda scenario: compare_firmwares(scenario, left, right, audit.follow(scenario.setup))


def caught(check: Check, calls: int = CALLS) -> Scenario | None:
    """The first scenario in which the check finds something."""
    return crosscheck(check, SEED, calls, silent).failing


def module_of(original: ModuleType, source: str | ast.Module) -> ModuleType:
    """A module of another source, under the name of the original."""
    module = ModuleType(original.__name__)
    exec(compile(source, f"changed {original.__name__}", "exec"), vars(module))
    return module


def copy_of_mirror(changed: ModuleType, source: str | ast.Module) -> Firmware:
    """The robot of a mirror in which one of SOURCES has changed."""
    if changed is MIRROR:
        return cast(Firmware, module_of(MIRROR, source).MirrorRobot)
    sys.modules[changed.__name__] = module_of(changed, source)
    try:
        return cast(Firmware, module_of(MIRROR, SOURCES[MIRROR]).MirrorRobot)
    finally:
        sys.modules[changed.__name__] = changed


# --- Nothing is found ------------------------------------------------------------------------------------


def test_native_and_mirror_agree_and_keep_every_limit() -> None:
    check = judged(NativeRobot, MirrorRobot)
    failing = caught(check, calls=10_000)
    assert failing is None, f"mcp-asdf crosscheck --replay {shrink(failing, check)}"


@cache
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


@pytest.mark.parametrize(
    "outcome",
    [
        *("OK", "ERR_CONFIG", "ERR_TABLE", "ERR_ID", "ERR_B_HAT"),
        *("observe OK", "observe ERR_OBSERVATION", "step OK", "step UPDATED", "step ERR_OBSERVATION"),
        *("receive OK", "receive REPEATED", "receive ERR_SENDER", "receive ERR_X_HAT"),
        *("settle OK", "settle UPDATED", "add OK", "add REFUSED"),
        *("restore OK", "restore ERR_IMAGE", "damage ERR_IMAGE"),
    ],
)
def test_scenarios_bring_about_every_status(outcome: str) -> None:
    assert seen()[0][outcome] >= 1


@pytest.mark.parametrize(
    "trait",
    [
        *("restored", "restored, x_hat and alpha apart", "halved", "capped", "fine", "coarse"),
        *("end", "half", "inside", "inverted", "upright", "nothing", "something", "test 127"),
        *("alpha 0", "alpha 0, shifted", "alpha not canonical", "canonical alpha", "largest alpha"),
        *("alpha with ignored bits", "alpha of low units", "alpha of high units"),
        *(f"{name} wraps" for name in ("accepted", "repeated", "rejected", "tests", "updates")),
        *("update with low units", "update with high units", "hesitates", "hesitates, but updates"),
        *(f"test {m}, {verdict}" for m in (2, 3) for verdict in ("rejects", "accepts")),
        *("update to the least", "update to the most", "update inside"),
    ],
)
def test_scenarios_reach_every_kind_of_state(trait: str) -> None:
    assert seen()[1][trait] >= 1


@pytest.mark.parametrize("robot", [NativeRobot, MirrorRobot, ReferenceRobot])
@pytest.mark.parametrize("alpha", [-1.0, -0.0, math.inf, -math.inf, math.nan])
def test_a_float_that_is_no_confidence_raises(robot: AnyRobot, alpha: float) -> None:
    """Not in the scenarios: every word is a confidence."""
    made = robot(Config(filter=Filter.OFF), 0, 0.75)
    with pytest.raises(ValueError, match="alpha is"):
        made.receive(1, 0.5, alpha)
    assert made.counters == robot(Config(filter=Filter.OFF), 0, 0.75).counters


@pytest.mark.parametrize("choice", [TableChoice(*table) for table in TABLES], ids=str)
def test_rounds_come_near_the_threshold_on_both_sides(choice: TableChoice) -> None:
    source, table, sides = random.Random(5), build_table(choice), Counter[bool]()
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


def test_a_scenario_is_a_function_of_seed_and_number() -> None:
    lines = [str(random_scenario(seed, number)) for seed in (0, 1) for number in range(20)]
    assert len(set(lines)) == len(lines)
    assert lines == [str(random_scenario(seed, number)) for seed in (0, 1) for number in range(20)]


# --- Lines of text ---------------------------------------------------------------------------------------


def test_lines_read_back() -> None:
    for number in range(300):
        scenario = random_scenario(7, number)
        assert parse_scenario(str(scenario)) == scenario, scenario


def test_lines_need_no_quotes() -> None:
    assert all(shlex.quote(line) == line for line in (str(random_scenario(7, n)) for n in range(50)))


ROBOT = "robot:2:1:64:0:2147483648"


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "starts with"),
        ("observe:1", "starts with"),
        ("table:0.05:30", "starts with"),
        ("table:0.05,robot:0:1:64:0:1", "table:0.05 needs omega and q"),
        ("table:1.5:30,robot:0:1:64:0:1", "omega is 1.5"),
        ("table:0.05:1,robot:0:1:64:0:1", "neighbours is 1"),
        ("table:0.05:2:5:1,robot:0:1:64:0:1", "0 to 4"),
        ("table:0.05:2:0:1296258051:6:1,robot:0:1:64:0:1", "0 to 5"),  # word 0 claims q = 3
        ("table:0.05:2:4,robot:0:1:64:0:1", "pairs"),
        ("table:0.05:2:4:4294967296,robot:0:1:64:0:1", "32-bit"),
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


# --- Tables that are none --------------------------------------------------------------------------------

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


# --- Planted faults --------------------------------------------------------------------------------------

FAULTS = {
    "accuracy: square": ("return ratio * ratio >> 32", "return ratio * ratio + (1 << 31) >> 32"),
    "estimate: what says nothing": ("INFORMATIVE_G = 1 << 20", "INFORMATIVE_G = 1 << 21"),
    "estimate: c t": ("least = accuracy.c * total", "least = (accuracy.c ^ 1) * total"),
    "estimate: mirror image": ("return ONE - x_hat if mirrored", "return (ONE ^ 1) - x_hat if mirrored"),
    "alpha at an end": ("part * accuracy.rare +", "part * (accuracy.rare ^ 64) +"),
    "alpha inside": ("(scale * scale >> 32) * total", "(scale * scale >> 32 ^ 64) * total"),
    "alpha_word: cap": ("if exponent > SHIFT_MAX:", "if exponent > SHIFT_MAX ^ 1:"),
    "alpha_word: grid": ("= mantissa >> -exponent, 0", "= mantissa >> -exponent | 1, 0"),
    "received alpha: shift": ("<< (word & SHIFT_MAX)", "<< (word & SHIFT_MAX - 1)"),
    "received alpha: nothing": ("if units == 0:", "if alpha == 0:"),
    "sums": ("sums.x_squared += x_hat * x_hat", "sums.x_squared += x_hat * x_hat ^ 1"),
    "mean": ("// (closed.alpha + own)", "// (closed.alpha + own | 1)"),
    "test": ("table.entry(m) * spread", "(table.entry(m) ^ 1) * spread"),
    "test: fewest messages": ("(2 if mode == Filter.ADAPTIVE", "(3 if mode == Filter.ADAPTIVE"),
    "re-estimate": ("((denominator >> shift + 1) + 1)", "((denominator >> shift + 1) + 0)"),
    "re-estimate: mirror image": ("- x_bar, t - n", "- (x_bar ^ 1), t - n"),
    "halving: ties to even": ("s.n >> 1 & 1) >> 1", "s.n >> 1 & 0) >> 1"),
    "counters": ("COUNTER_MASK = 0xFFFF", "COUNTER_MASK = 0xFFFE"),
    "senders": (">> (sender & 31) & 1:", ">> (sender & 30) & 1:"),
    "filter period": ("if s.filter_left == 0:", "if s.filter_left <= 1:"),
    "save": ("s.repeated << 16 | s.accepted", "s.repeated << 17 | s.accepted"),
    "restore": ("repeated=words[27] >> 16", "repeated=words[27] >> 16 & 0x7FFF"),
    "invariants": ("1 <= s.filter_left", "0 <= s.filter_left"),
    "invariants: updated": ("return s.updated == 1 and", "return s.updated >= 1 and"),
}
"""Lines of SOURCES, and the same with one bit wrong."""


def planted(fault: str) -> Firmware:
    """A copy of the mirror with one of FAULTS."""
    right, wrong = FAULTS[fault]
    counts = {module: source.count(right) for module, source in SOURCES.items()}
    assert sum(counts.values()) == 1, f"the mirror's source has changed: plant {fault!r} anew"
    module = max(counts, key=counts.__getitem__)
    return copy_of_mirror(module, SOURCES[module].replace(right, wrong))


def assert_minimal(scenario: Scenario, check: Check) -> None:
    """Nothing can be left out: no call, and no word that a restore replaces."""
    finding = check(scenario)
    assert finding is not None
    assert finding.calls == len(scenario.calls), "the finding is not at the end"
    for at, call in enumerate(scenario.calls):
        before, behind = scenario.calls[:at], scenario.calls[at + 1 :]
        assert check(scenario.with_calls(before + behind)) is None, f"{scenario} does not need {call}"
        for pair in range(0, len(call.numbers), 2) if call.name == "restore" else ():
            fewer = Call("restore", call.numbers[:pair] + call.numbers[pair + 2 :])
            calls = (*before, fewer, *behind)
            assert check(scenario.with_calls(calls)) is None, f"{scenario} does not need all of {call}"


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught_and_shown_by_a_minimal_scenario(fault: str) -> None:
    check = judged(NativeRobot, planted(fault))
    failing = caught(check)
    assert failing is not None
    least = shrink(failing, check)
    assert_minimal(least, check)
    assert check(parse_scenario(str(least))) == check(least)
    assert judged(NativeRobot, MirrorRobot)(least) is None, "it is not the fault that shows"


@pytest.mark.parametrize(
    "fault",
    [
        *("estimate: what says nothing", "estimate: mirror image", "alpha_word: cap", "sums", "mean"),
        *("received alpha: shift", "received alpha: nothing", "senders", "counters"),
        *("test: fewest messages", "halving: ties to even", "filter period"),
    ],
)
def test_what_both_do_wrong_is_caught_by_exact_arithmetic(fault: str) -> None:
    wrong = planted(fault)
    assert caught(lambda scenario: compare_firmwares(scenario, wrong, wrong), calls=2000) is None
    assert caught(judged(wrong, wrong)) is not None


def functions() -> dict[str, list[tuple[int, int]]]:
    """Integer constants of SOURCES: module and function, or module alone, to lines and columns.

    Of the functions in the second, those that the C has, too; the others bring floats to words and back.
    """
    places: dict[str, list[tuple[int, int]]] = {}
    for module, source in SOURCES.items():
        tree, name = ast.parse(source), module.__name__.rpartition(".")[2]
        owners: list[tuple[str, ast.AST]] = [
            (name, node) for node in tree.body if isinstance(node, ast.Assign)
        ]
        owners += [
            (f"{name}.{node.name}", node)
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef) and (module is MIRROR or node.name in SHARED)
        ]
        for owner, node in owners:
            places[owner] = places.get(owner, []) + constants(node)
    return {name: found for name, found in places.items() if found}


SHARED = {"alpha_units", "sums_add", "mean_possible", "sums_possible"}


def constants(owner: ast.AST) -> list[tuple[int, int]]:
    """Lines and columns of whole numbers outside of texts."""
    texts = {
        id(part) for node in ast.walk(owner) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)
    }
    return [
        (node.lineno, node.col_offset)
        for node in ast.walk(owner)
        if isinstance(node, ast.Constant) and type(node.value) is int and id(node) not in texts
    ]


EQUIVALENT = {
    ("mirror.alpha_word", "if exponent < 0:", 0): "a shift by 0 changes nothing",
    ("mirror.upper_quotient", "if shift < 0:", 0): "both branches agree at 0",
    ("mirror.reestimate", "if alpha >> 32 == 0:", 32): "bits below the upper 32 are dropped in any case",
    ("mirror.reestimate", "if numerator <= 0:", 0): "a numerator of 1 gives at most the least b_hat",
    ("mirror.x_bar_raw", "HALF, 0)", 0): "a mantissa of 0 says nothing, whatever its shift",
    ("mirror.restore", "else (0,)", 0): "neither is the magic word",
    ("mirror._state_from", "words[7:21:2]", 21): "a slice of every second word may end one earlier",
    ("fixed_point", "UNITS_PER_ALPHA =", 1): "of the float view only",
    ("fixed_point", "UNITS_PER_ALPHA =", 24): "of the float view only",
}
"""Constants whose last bit makes no difference: function, part of the line, and value."""


@pytest.mark.slow
@pytest.mark.parametrize("function", functions())
def test_the_last_bit_of_every_constant_of_the_mirror_matters(function: str) -> None:
    module = {module.__name__.rpartition(".")[2]: module for module in SOURCES}[function.partition(".")[0]]
    survivors = []
    for line, column in functions()[function]:
        tree, text = ast.parse(SOURCES[module]), SOURCES[module].splitlines()[line - 1]
        [node] = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and (node.lineno, node.col_offset) == (line, column)
        ]
        if any(name == function and part in text and value == node.value for name, part, value in EQUIVALENT):
            continue
        node.value = cast(int, node.value) ^ 1
        changed = copy_of_mirror(module, tree)
        if caught(partial(compare_firmwares, left=NativeRobot, right=changed)) is None:
            survivors.append(f"line {line}, column {column}: {text.strip()}")
    assert survivors == []


class TamperedRobot(MirrorRobot):
    """A mirror whose table has one bit wrong in one entry, where it has the given q."""

    q, entry, bit = 30, 0, 0

    @classmethod
    def tampered(cls, config: Config) -> Config:
        if config.table is None or config.table.q != cls.q:
            return config
        entries = list(config.table.entries)
        entries[cls.entry] ^= 1 << cls.bit
        return replace(config, table=replace(config.table, entries=tuple(entries)))

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(self.tampered(config), robot_id, b_hat)

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        return super().restore(cls.tampered(config), image)


@pytest.mark.parametrize(
    ("q", "entry", "bit"), [(30, 0, 0), (127, 125, 2), *slow([(30, 28, 1), (30, 29, 0), (2, 0, 3)])]
)
def test_one_bit_of_a_table_entry_is_caught(q: int, entry: int, bit: int) -> None:
    robot = type("Robot", (TamperedRobot,), {"q": q, "entry": entry, "bit": bit})
    check = judged(NativeRobot, cast(Firmware, robot))
    failing = caught(check)
    assert failing is not None
    least = shrink(failing, check)
    assert_minimal(least, check)
    assert build_table(cast(TableChoice, least.setup.table)).q == q


def test_a_table_that_is_wrong_for_both_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(choice: TableChoice, m: int) -> int:
        return round(exact.true_threshold(choice, m) * (1 + 2.0**-20))

    assert caught(judged(MirrorRobot, MirrorRobot), calls=5000) is None
    monkeypatch.setattr(audit_module, "true_threshold", wrong)
    failing = caught(judged(MirrorRobot, MirrorRobot), calls=5000)
    assert failing is not None
    finding = judged(MirrorRobot, MirrorRobot)(failing)
    assert finding is not None
    assert "the true threshold" in finding.problems[0]


class BrokenRobot(MirrorRobot):
    """Fails in a way no firmware may."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")


def test_an_exception_is_a_difference() -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle")
    finding = compare_firmwares(scenario, NativeRobot, BrokenRobot)
    assert finding is not None
    assert (finding.calls, finding.problems[0]) == (2, "status: OK, ZeroDivisionError: in settle")


class UnmakeableRobot(MirrorRobot):
    """Fails to be made in a way no firmware may."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        raise ZeroDivisionError("in init")


def test_the_same_exception_is_no_agreement() -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle")
    for robot, made, place in ((BrokenRobot, 2, "settle"), (UnmakeableRobot, 0, "init")):
        finding = compare_firmwares(scenario, robot, robot)
        assert finding == Disagreement(made, (f"both: ZeroDivisionError: in {place}",))


class SilentlyWrongRobot(MirrorRobot):
    """Has a wrong member that no output shows."""

    def state(self) -> dict[str, int]:
        return super().state() | {"updated": 7}


def test_a_hidden_difference_of_state_is_found_at_once() -> None:
    finding = compare_firmwares(parse_scenario(ROBOT), NativeRobot, SilentlyWrongRobot)
    assert finding == Disagreement(0, ("updated: 0, 7",))


def test_a_robot_that_only_one_firmware_makes_is_a_difference() -> None:
    class Choosy(MirrorRobot):
        def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
            super().__init__(config, robot_id + 128, b_hat)

    assert compare_firmwares(parse_scenario(ROBOT), NativeRobot, Choosy) == Disagreement(
        0, ("status: OK, ERR_ID",)
    )


def test_differences_name_words_of_the_image() -> None:
    one, other = (Subject(MirrorRobot, parse_scenario(ROBOT).setup) for _ in range(2))
    other.apply(Call("restore", (2, 5, 29, 1 << 16)))
    assert list(differences(one.last, other.last)) == [
        "t: 0, 5",
        "updated: 0, 1",
        "t(): 0, 5",
        "save(), word 2: 0x00000000, 0x00000005",
        "save(), word 29: 0x00000000, 0x00010000",
        f"save(), word 30: {int.from_bytes(one.last.image[-4:], 'little'):#010x}, "
        f"{int.from_bytes(other.last.image[-4:], 'little'):#010x}",
    ]


@settings(deadline=None, database=None, derandomize=True)
@given(st.lists(st.integers(0, 2), max_size=30), st.sets(st.integers(0, 29), min_size=1, max_size=4))
def test_shrinking_leaves_exactly_what_is_needed(zs: list[int], needed: set[int]) -> None:
    """Whatever calls a finding needs, those are left, in order."""
    setup = parse_scenario(ROBOT).setup
    calls = tuple(Call("receive", (at, 0, z)) for at, z in enumerate(zs))
    assume(max(needed) < len(calls))

    def check(scenario: Scenario) -> Disagreement | None:
        missing = set(needed)
        for made, call in enumerate(scenario.calls, start=1):
            missing.discard(call.numbers[0])
            if not missing:
                return Disagreement(made, ("all there",))
        return None

    assert shrink(Scenario(setup, calls), check).calls == tuple(calls[at] for at in sorted(needed))


def test_shrinking_what_is_sound_changes_nothing() -> None:
    scenario = random_scenario(SEED, 3)
    assert shrink(scenario, lambda candidate: None) == scenario


@pytest.mark.parametrize("at", [0, 1, 5])
def test_a_run_that_finds_something_counts_the_calls_made(at: int) -> None:
    """Not those of the scenario that were to come."""
    made: list[int] = []

    def check(scenario: Scenario) -> Disagreement | None:
        if sum(made) > 100 and len(scenario.calls) > at:
            return Disagreement(at, ("wrong",))
        made.append(len(scenario.calls))
        return None

    outcome = crosscheck(check, SEED, 5000, silent)
    assert outcome.failing is not None
    assert outcome.calls == sum(made) + at


def test_a_run_stops_after_the_calls_asked_for() -> None:
    heard: list[int] = []
    outcome = crosscheck(lambda scenario: None, SEED, 1234, heard.append)
    assert (outcome.calls, outcome.failing, outcome.interrupted) == (1234, None, False)
    assert heard == sorted(heard)
    assert heard[-1] == 1234


# --- The command -----------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, operations: dict[str, CallCount]) -> None:
    """Count operations and bytes once for all tests."""
    monkeypatch.setattr(command, "count_operations", lambda: operations)
    monkeypatch.setattr(command, "measure_storage", cache(measure_storage))


def use_mirror(monkeypatch: pytest.MonkeyPatch, mirror: Firmware) -> None:
    """Let the command load another mirror."""
    monkeypatch.setattr(command, "load_firmware", {"native": NativeRobot, "mirror": mirror}.__getitem__)


def main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["crosscheck", *arguments])
    return code, *capsys.readouterr()


def test_the_command_reports_everything(quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = main(capsys, "--steps", "3000", "--json")
    report = json.loads(out)
    assert code == 0
    assert (report["ok"], report["steps"], report["seed"], report["failure"]) == (True, 3000, SEED, None)
    assert {row["quantity"] for row in report["errors"]} == set(audit_module.QUANTITIES)
    assert all(row["exact"]["p99.9"] <= row["exact"]["max"] for row in report["errors"])
    assert report["decisions"]["m <= q"]["tests"] > 20
    assert report["operations"]["x"]["axes"]["t"]["1"] == [11, 11]
    assert report["operations"]["x"]["lines"] <= report["operations"]["x"]["line_bound"]
    assert report["storage"]["images"] == [124]


def test_the_command_speaks_to_people(quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = main(capsys, "--steps", "2000", "--seed", "4")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    *_, calls, verdict, again = lines
    assert re.fullmatch(r"calls made and compared: 2000 in \d+ scenarios, seed 4", calls)
    assert verdict == "native and mirror agree in every bit"
    assert again == "again: mcp-asdf crosscheck --steps 2000 --seed 4"
    assert max(map(len, lines)) <= 100
    assert "…" not in out


def test_a_failure_is_printed_with_a_line_that_replays_it(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, planted("halving: ties to even"))
    code, out, _ = main(capsys, "--steps", "30000")
    *_, last = out.splitlines()
    assert code == 1
    assert last.startswith("replay: mcp-asdf crosscheck --replay ")
    replay = shlex.split(last)[3:]
    code, again, _ = main(capsys, *replay)
    assert code == 1
    assert out.endswith(again), "the replay shows something else"
    code, report, _ = main(capsys, *replay, "--json")
    assert code == 1
    assert json.loads(report)["failure"]["replay"] == replay[1]
    calls = parse_scenario(replay[1]).calls
    monkeypatch.undo()
    code, out, _ = main(capsys, *replay)
    assert (code, out) == (0, f"native and mirror agree in every bit over {len(calls)} calls\n")


@pytest.mark.parametrize(
    ("item", "status"),
    [
        ("robot:9:1:64:0:3221225472", "ERR_CONFIG"),
        ("robot:2:1:66:0:3221225472", "ERR_CONFIG"),
        ("robot:2:1:64:128:3221225472", "ERR_ID"),
        ("robot:2:1:64:0:0", "ERR_B_HAT"),
        ("robot:0:1:64:0:3221225472", "ERR_TABLE"),
        ("table:0.05:30:1:0,robot:0:1:64:0:3221225472", "ERR_TABLE"),
    ],
)
def test_a_replay_does_not_claim_calls_of_a_robot_that_is_refused(
    item: str, status: str, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["--replay", f"{item},observe:1,observe:1,observe:1"]
    told = f"native and mirror both refuse to make this robot ({status}); no call was made\n"
    assert main(capsys, *replay) == (0, told, "")
    report = json.loads(main(capsys, *replay, "--json")[1])
    assert report == {"ok": True, "status": status, "calls": 0, "failure": None}


def test_a_replay_tells_the_calls_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["--replay", f"{ROBOT},observe:1,settle,observe:9", "--json"]
    assert json.loads(main(capsys, *replay)[1]) == {"ok": True, "status": "OK", "calls": 3, "failure": None}
    use_mirror(monkeypatch, cast(Firmware, BrokenRobot))
    report = json.loads(main(capsys, *replay)[1])
    assert (report["ok"], report["status"], report["calls"]) == (False, "OK", 2)


def test_a_failure_as_json(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, planted("counters"))
    code, out, _ = main(capsys, "--steps", "30000", "--json")
    report = json.loads(out)
    assert (code, report["ok"]) == (1, False)
    assert report["failure"]["problems"]
    assert parse_scenario(report["failure"]["replay"])


def test_a_claim_that_does_not_hold_fails_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], operations: dict[str, CallCount]
) -> None:
    slow = operations | {"x": replace(operations["x"], most=1000)}
    monkeypatch.setattr(command, "count_operations", lambda: slow)
    code, out, _ = main(capsys, "--steps", "10")
    assert code == 1
    assert "FAILED: x: 1000 operations" in out


class InterruptedRobot(MirrorRobot):
    """Ctrl-C comes while it works."""

    calls = 0

    def observe(self, z: Observation) -> Status:
        InterruptedRobot.calls += 1
        if InterruptedRobot.calls > 50:
            raise KeyboardInterrupt
        return super().observe(z)


def test_an_interrupt_reports_what_was_done(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, InterruptedRobot)
    InterruptedRobot.calls = 0
    code, out, _ = main(capsys, "--steps", "100000", "--json")
    report = json.loads(out)
    assert code == 130
    assert report["interrupted"]
    assert 0 < report["steps"] < 1000
    InterruptedRobot.calls = 0
    code, out, _ = main(capsys, "--steps", "100000")
    assert code == 130
    assert ", interrupted\n" in out


def test_an_interrupt_while_shrinking_still_prints_a_replay(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(scenario: Scenario, check: Check) -> Scenario:
        raise KeyboardInterrupt

    use_mirror(monkeypatch, planted("counters"))
    monkeypatch.setattr(command, "shrink", interrupted)
    code, out, err = main(capsys, "--steps", "30000")
    assert code == 1
    assert "interrupted" in err
    code, again, _ = main(capsys, *shlex.split(out.splitlines()[-1])[3:])
    assert code == 1
    assert out.endswith(again)


def test_the_plot_is_drawn(quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "operations.png"
    assert main(capsys, "--steps", "10", "--plot", str(path))[0] == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--steps", "0"], "--steps is 0"),
        (["--seed", "-1"], "--seed is -1"),
        (["--plot", "operations.txt"], "operations.txt"),
        (["--plot", "no/such/folder/operations.png"], "folder does not exist"),
        (["--replay", "nonsense"], "starts with"),
        (["--replay", ROBOT, "--steps", "5"], "--replay runs one scenario"),
        (["--replay", ROBOT, "--seed", "5"], "--replay runs one scenario"),
        (["--replay", ROBOT, "--plot", "a.png"], "--replay runs one scenario"),
    ],
)
def test_bad_usage(arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = main(capsys, *arguments)
    assert (code, out) == (2, "")
    assert complaint in err
