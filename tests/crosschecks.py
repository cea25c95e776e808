"""Cross-checks as tests run them, call by call or as a whole, and mirrors with a planted fault to find."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import cast
from unittest.mock import patch

import mcp_asdf.arithmetic
import mcp_asdf.fixed_point
import mcp_asdf.mirror
import mcp_asdf.robust_filter
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Status
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.compare import (
    Failure,
    Firmware,
    RobotUnderTest,
    compare_firmwares,
    run_crosscheck,
)
from mcp_asdf_tools.crosscheck.oracle import check_call
from mcp_asdf_tools.crosscheck.scenario import CallRecord, Scenario

SOURCES = {
    module.__name__: Path(cast(str, module.__file__)).read_text(encoding="utf-8")
    for module in (mcp_asdf.fixed_point, mcp_asdf.arithmetic, mcp_asdf.robust_filter, mcp_asdf.mirror)
}
"""Sources of the mirror's arithmetic by module, in the order of their imports."""
ROBOT_WITHOUT_FILTER = "robot:2:1:64:0:2147483648"
"""The robot of a scenario, without a filter.

The numbers are filter (``Filter``), filter period, memory, id, and b_hat in units of 2**-32, here 1/2.
"""
SEED = 1
CALLS = 40_000
"""Maximum number of calls to find a fault; most take a few hundred."""


def compare_with_oracle(scenario: Scenario, first: Firmware, second: Firmware) -> Failure | None:
    """Compare two firmwares in a scenario, and the first with exact arithmetic; return what is wrong."""
    return compare_firmwares(scenario, first, second, partial(check_call, audit=Audit()))


def find_failure(first: Firmware, second: Firmware, max_calls: int = CALLS) -> Failure | None:
    """Cross-check two firmwares by random scenarios, and return the first failure.

    The first firmware is also compared with exact arithmetic. Return None if ``max_calls`` calls agree.
    """

    def check_scenario(scenario: Scenario) -> Failure | None:
        return compare_with_oracle(scenario, first, second)

    return run_crosscheck(check_scenario, SEED, max_calls, lambda calls_made: None).failure


def check_calls(scenario: Scenario, audit: Audit) -> Iterator[CallRecord]:
    """Make the calls of a scenario on a mirror, and yield a record of each. Exact arithmetic must agree."""
    robot = RobotUnderTest(MirrorRobot, scenario.setup)
    for call in scenario.calls:
        record = CallRecord(scenario.setup, call, before=robot.last_result, after=robot.apply(call))
        assert check_call(record, audit) == []
        yield record


def with_value_after(record: CallRecord, name: str, value: int) -> CallRecord:
    """Return the record of a call after which a field of the state has another value."""
    return replace(record, after=replace(record.after, state=record.new_state | {name: value}))


def with_outcome(record: CallRecord, outcome: str) -> CallRecord:
    """Return the record of a call with another outcome."""
    return replace(record, after=replace(record.after, outcome=outcome))


FAULTS = {
    "estimate: what says nothing": "INFORMATIVE_G = 1 << {20 => 21}",
    "estimate: c t": "errors = multiply_high({accuracy.c => (accuracy.c ^ 1)}, total)",
    "estimate: mirror image": "x_hat = {ONE => (ONE ^ 1)} - x_hat_of_rarer if is_mirrored",
    "alpha_word: cap": "if shift > {SHIFT_MAX => SHIFT_MAX ^ 1}:",
    "mean": "return sum_alpha_x // {sum_alpha => (sum_alpha | 1)}\n",
    "test": "{table.entry(m) => (table.entry(m) ^ 1)} * scaled_variance",
    "test: fewest messages": "= {2 => 3} if config.filter == Filter.ADAPTIVE",
    "halving: ties to even": "s.n = {round(s.n / 2) => s.n // 2}",
    "counters": "COUNTER_MASK = {0xFFFF => 0xFFFE}",
    "filter period": "if s.filter_left {== 0 => <= 1}:",
    "restore": "s.updated = senders_and_events{ => ; s.repeated &= 0x7FFF}",
    # The robust filter: its slots
    "slot: ids up to 31": "slot = {sender % SLOTS => min(sender, SLOTS - 1)}",
    "slot: ids modulo 16": "slot = sender % {SLOTS => 16}\n",
    "slot: the next one": "slot = {sender => (sender + 1)} % SLOTS\n    estimates",
    "slot: rounding": "return min({(x_hat + 64) => x_hat} >> 7, SLOT_ESTIMATE_MAX)",
    "slot: 1.0 wraps": "return {min((x_hat + 64) >> 7, SLOT_ESTIMATE_MAX) => (x_hat + 64) >> 7 & 0xFFFF}",
    "slot: without confidence": "elif {has_confidence => True}:",
    "slot: without confidence, with a shift": "elif {has_confidence => alpha}:",
    "slot: first estimate of a sender": (
        "estimates[slot] = {slot => estimates[slot] or slot}_estimate(x_hat)\n"
    ),
    "slot: average of a sender": (
        "estimates[slot] = slot_estimate({x_hat) => x_hat) if not robust.is_filled(slot) else "
        "(estimates[slot] + slot_estimate(x_hat)) // 2}\n"
    ),
    # Its votes
    "vote: every message": "robust.filled_slots |= 1 << slot{ => ; count_vote(robust, x_hat)}",
    "vote: the turn stays": "robust.turn = voter + {1 => 0}\n",
    "vote: the turn does not go back to 0": "robust.turn = {0 => 1}\n",
    "vote: not in the round of a test": (
        "            { => if s.filter_left > 1: }take_vote(s.robust, s.estimates"
    ),
    "vote: gain": "VOTES_OF_MAX_GAIN = {32 => 16}",
    "vote: constant gain": "return {votes_that_count.bit_length() - 3 => 3}",
    "vote: smallest gain 1/256": "VOTES_MAX = 1 << {9 => 10}",
    "vote: smallest gain 1/64": "VOTES_MAX = 1 << {9 => 8}",
    "vote: the first is the centre": (
        "position = q30_from_q23(x_hat){ => \n    if robust.votes == 1: robust.centre = position}"
    ),
    "vote: clamp": "step = {min(distance, robust.spread) => distance} >> gain_shift",
    "vote: clamp at two spreads": "min(distance, {robust.spread => 2 * robust.spread}) >> gain_shift",
    "vote: spread": "is_outside = distance {> => >=} robust.spread",
    "vote: the spread never shrinks": "if is_outside else {-spread_step => 0})",
    "vote: smallest spread": "robust.spread = min(max(new_spread, {SPREAD_MIN => 0}), SPREAD_MAX)",
    "vote: largest spread": "robust.spread = min(max(new_spread, SPREAD_MIN), {SPREAD_MAX => 1 << 29})",
    "vote: order": "return {lowest_bit(remaining_slots) => remaining_slots.bit_length() - 1}",
    "vote: own estimate": "return OWN_ESTIMATE if {has_confidence => False} else",
    "vote: own estimate without confidence": "return OWN_ESTIMATE if {has_confidence => True} else",
    "broadcast: the centre of the votes": "return {self.s.x_hat => self.x_raw}\n",
    # The dispersion of its own observations
    "batch: halving": "{begin_batch(s.robust, s.t, s.n) => pass}",
    "batch: begins anew": "{begin_batch(robust, t, n) => pass}",
    "batch: begins too early": "count = t - {robust.batch_t => t}",
    "dispersion: weight": "DISPERSION_SHIFT = {3 => 2}",
    "dispersion: outlier": "largest_ratio = {REJECTED_SIGMAS_SQUARED => 13} * robust.dispersion",
    "dispersion: smallest": "min(max(average, {DISPERSION_MIN => 0}), DISPERSION_MAX)",
    "dispersion: largest": "min(max(average, DISPERSION_MIN), {DISPERSION_MAX => DISPERSION_MAX - 1})",
    "dispersion: none": (
        "robust.dispersion = {min(max(average, DISPERSION_MIN), DISPERSION_MAX) => DISPERSION_MIN}"
    ),
    # Its test
    "table: four estimates": "TESTED_ESTIMATES_MIN = {5 => 4}",
    "table: five estimates are too few": "TESTED_ESTIMATES_MIN = {5 => 6}",
    "table: median": "return {(lower_middle + upper_middle) // 2 => lower_middle}",
    "table: smallest spread": "return min(max(median_of(distances), {smallest => 0}), largest)",
    "table: largest spread": "return min(max(median_of(distances), smallest), {largest => MAX_WORD})",
    "table: no steps": "HUBER_STEPS = {3 => 0}",
    "table: two steps": "HUBER_STEPS = {3 => 2}",
    "table: four steps": "HUBER_STEPS = {3 => 4}",
    "table: inside": "sum(abs(difference) {<= => <} spread for",
    "table: mean of all estimates": "[{max(-spread, min(spread, difference)) => difference} for",
    "robust test: centre of the votes": (
        "robust_test_rejects(robust, s.t, s.n, {centre => min(robust.centre >> 6, 0xFFFF00)}, spread)"
    ),
    "robust test: spread of the votes": (
        "robust_test_rejects(robust, s.t, s.n, centre, {spread => robust.spread >> 6})"
    ),
    "robust test: three sigmas": "SIGMAS_SQUARED = {12 => 9}",
    "robust test: sigmas": "q32_from_q40({REJECTED_SIGMAS_SQUARED => 13} * robust.dispersion",
    "robust test: sigmas of the centre": "- {REJECTED_SIGMAS_SQUARED => 13} * g_spread**2",
    "robust test: no spread": "{g_spread**2 => 0}",
    "robust test: variance": "variance = {max => min}(",
    "robust test: variance of the count alone": (
        "max(variance_of_observation(share), {variance_of_observation(p) => 0})"
    ),
    "robust test: dispersion": "{robust.dispersion => DISPERSION_MIN} * variance)",
    "robust test: tests the present b_hat": (
        "is_rejected = robust_test_rejects({robust => "
        "RobustFilter(**vars(robust) | {'initial_b_hat': s.accuracy.b_hat})}, s.t"
    ),
    "precision: n/t of 23 bits": "share = q32_quotient(n, t){ =>  >> 9 << 9}\n    p = ",
    "precision: p of 23 bits": (
        "return {black_observed_as_black + white_observed_as_black => "
        "(black_observed_as_black + white_observed_as_black) >> 9 << 9}"
    ),
    # What follows a rejection
    "robust: present b_hat is the initial one": (
        "{s.accuracy => s.robust.initial_b_hat = new_b_hat; s.accuracy} = accuracy_of(new_b_hat)"
    ),
    "robust: eq. 8 from its own estimate": "s.n, {q32_from_q24(centre) => s.x_hat << 9})",
    "robust: eq. 8 from the centre of the votes": (
        "s.n, {q32_from_q24(centre) => min(robust.centre << 2, 0xFFFFFFFF)})"
    ),
    "robust: way back": "return None if is_initial else {robust.initial_b_hat => None}",
    "supporters: none": "return 5 * supporter_count > {2 => 5} * len(estimates)",
    "supporters: half": "return {5 * => 4 *} supporter_count > 2 * len(estimates)",
    "supporters: tie": "if distance_from_robot {< => <=} distance_from_centre",
    "supporters: two fifths": "return 5 * supporter_count {> => >=} 2 * len(estimates)",
    "supporters: the other way": "return 5 * supporter_count {> => <=} 2 * len(estimates)",
}
"""Faults by name, as `mirror_with` reads them: places in SOURCES and what is wrong there, often one bit.

The cross-check finds all of them, and the verification of a controller most (`wrong_robots`)."""


def changed_sources(*changes: str) -> dict[str, str]:
    """Return the mirror's sources by their modules' names, with changes.

    A change ``before {right => wrong} after`` replaces ``before right after``, which must be unique in the
    sources, by ``before wrong after``.
    """
    sources = dict(SOURCES)
    for change in changes:
        match = re.fullmatch(r"(.*?)\{(.*?) => (.*)\}(.*)", change, re.DOTALL)
        assert match is not None
        before, right, wrong, after = match.groups()
        right_text, wrong_text = before + right + after, before + wrong + after
        occurrences = sum(source.count(right_text) for source in sources.values())
        assert occurrences == 1, f"{change!r} occurs {occurrences} times: plant it anew"
        sources = {name: source.replace(right_text, wrong_text) for name, source in sources.items()}
    return sources


def mirror_with(*changes: str) -> Firmware:
    """Return the mirror with changes in its source, as ``changed_sources`` reads them."""
    with patch.dict(sys.modules):
        for name, source in changed_sources(*changes).items():
            sys.modules[name] = ModuleType(name)
            exec(compile(source, f"changed {name}", "exec"), vars(sys.modules[name]))
        return cast(Firmware, sys.modules[mcp_asdf.mirror.__name__].MirrorRobot)


class BrokenRobot(MirrorRobot):
    """Raises an exception that no firmware may raise."""

    def settle(self) -> Status:
        raise ZeroDivisionError("in settle")
