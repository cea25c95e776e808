"""A single wrong bit in the mirror, its constants or its table is found, also if the C has it, too."""

from __future__ import annotations

import ast
from dataclasses import replace
from functools import partial
from typing import cast

import pytest

from crosschecks import FAULTS, MIRROR, SOURCES, caught, copy_of_mirror, judged, planted
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.crosscheck import exact
from mcp_asdf_tools.crosscheck import oracle as audit_module
from mcp_asdf_tools.crosscheck.compare import Check, Firmware, compare_firmwares, shrink
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, TableChoice, build_table, parse_scenario
from support import slow


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
