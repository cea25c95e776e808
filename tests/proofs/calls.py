"""The calls: observe, receive, settle and the test do what docs/design.md says (sections 2 and 8), in all
states in the ranges of docs/internals/properties.md. In these proofs a function that they call may return
anything for its arguments, and changes no more than its own lemma says.
"""

from __future__ import annotations

from typing import Any

import z3

from proofs import arithmetic, robust
from proofs.arithmetic import high_word, low_word, wide, zero_extend
from proofs.prove import Contract, result_of, stand_in
from proofs.robust import (
    B_HAT_RANGE,
    ONE,
    ROBUST,
    choose_terms,
    has_observed,
    is_b_hat_or_zero,
    is_robust,
    is_same,
    keeps_initial_b_hat,
    may_run,
    may_vote,
    minimum_of,
    product,
)
from proofs.source import VARIANTS, Variant, program
from support import CORE

UPDATED, REPEATED, ERR_OBSERVATION, ERR_SENDER, ERR_X_HAT = 2, 1, -5, -6, -7


def alpha_in_units(alpha: Any) -> Any:
    """Return the 64 bits of an alpha word in units of 2^-24."""
    mantissa, exponent = z3.LShR(alpha, 8), alpha & 31
    return zero_extend(mantissa) << zero_extend(exponent)


def zeros_like(structure: Any) -> Any:
    """Return a structure like this one in which all members are 0."""
    if isinstance(structure, dict):
        return {name: zeros_like(member) for name, member in structure.items()}
    return z3.BitVecVal(0, structure.size())


def returns_code_of_first(status: Any, *cases: tuple[Any, int]) -> Any:
    """Return the formula that a status is the code of the first case whose condition holds, or else 0."""
    expected_status = z3.BitVecVal(0, status.size())
    # From the last case to the first, so that the first one is asked first.
    for condition, code in reversed(cases):
        expected_status = z3.If(condition, z3.BitVecVal(code, status.size()), expected_status)
    return status == expected_status


# --- observe ---------------------------------------------------------------------------------------------


def _may_observe(robot: Any, _z: Any) -> Any:
    """Return that the robot fulfils property I2, and has a memory that init admits."""
    memory = robot["config"]["memory"]
    is_allowed = (z3.UGE(memory, 64), z3.ULE(memory, 2**31), z3.Extract(1, 0, memory) == 0)
    return z3.And(*is_allowed, z3.ULE(robot["n"], robot["t"]), z3.ULT(robot["t"], memory))


def _is_observed(status: Any, robot_after: Any, robot: Any, z: Any) -> Any:
    """Return what observe promises: t and n count the observation, and I2 holds again."""
    is_colour = z3.Or(z == 0, z == 1)
    # With 64 bits neither sum can wrap.
    counted_t, counted_n = zero_extend(robot["t"]) + 1, zero_extend(robot["n"]) + zero_extend(z)
    has_reached_memory = counted_t == zero_extend(robot["config"]["memory"])
    # An odd n is halved to the even one of the two nearest integers.
    halved_n = z3.If(counted_n % 2 == 0, z3.UDiv(counted_n, 2), 2 * z3.UDiv(counted_n + 1, 4))
    new_t = z3.If(has_reached_memory, z3.UDiv(counted_t, 2), counted_t)
    new_n = z3.If(has_reached_memory, halved_n, counted_n)
    t, n = z3.Extract(31, 0, new_t), z3.Extract(31, 0, new_n)
    estimate = result_of("estimate", {"x_hat": t, "alpha": t}, t, n, robot["accuracy"])
    # Where t and n are halved, the robust filter begins a batch of observations anew.
    begins_batch = z3.And(has_reached_memory, is_robust(robot["config"]))
    new_batch = {**robot["robust"], "batch_t": t, "batch_n": n}
    changed_members = {
        "t": t,
        "n": n,
        "updated": z3.BitVecVal(0, 8),
        "robust": choose_terms(begins_batch, new_batch, robot["robust"]),
        **estimate,
    }
    return z3.And(
        returns_code_of_first(status, (z3.Not(is_colour), ERR_OBSERVATION)),
        is_same(robot_after, choose_terms(is_colour, {**robot, **changed_members}, robot)),
        _may_observe(robot_after, z),
    )


# design: R1, R2, R3, R29
OBSERVE = Contract(_is_observed, _may_observe, stand_ins={"estimate": stand_in("estimate")})

# --- receive ---------------------------------------------------------------------------------------------


def _heard_senders(robot: Any) -> Any:
    """Return the set of senders heard as one word, in which each id has a bit."""
    # The union's bytes or, after they were cleared, its two long words.
    (parts,) = robot["heard"].values()
    return z3.Concat(*reversed(parts.values()))


def _count_if(counter: Any, condition: Any) -> Any:
    """Return a counter of 16 bits, one higher where the condition holds."""
    return counter + z3.If(condition, z3.BitVecVal(1, 16), z3.BitVecVal(0, 16))


def _is_received(status: Any, robot_after: Any, robot: Any, *message: Any) -> Any:
    """Return what receive promises of a message (sender, x_hat, alpha)."""
    sender, x_hat, alpha = message
    is_sender = z3.And(z3.ULE(sender, 127), sender != robot["id"])
    is_valid = z3.And(is_sender, z3.ULE(x_hat, ONE))
    heard_senders = _heard_senders(robot)
    # A sender of more than 127 has no bit, and is refused anyway.
    sender_bit = z3.BitVecVal(1, 128) << zero_extend(sender, 128)
    is_new = heard_senders & sender_bit == 0
    is_accepted = z3.And(is_valid, is_new)

    # A message without confidence only counts. Another one enters the sums, or a slot of the robust filter.
    has_confidence = z3.And(is_accepted, alpha_in_units(alpha) != 0)
    enters_slot = z3.And(has_confidence, is_robust(robot["config"]))
    enters_sums = z3.And(has_confidence, z3.Not(is_robust(robot["config"])))
    expected_robot = {
        **robot,
        **_members_with_estimate_in_slot(robot, sender, x_hat, enters_slot),
        "counters": _counters_after_message(robot["counters"], is_valid, is_new),
    }
    sums = robot["received"]["sums"]
    new_sums = _sums_with_message(sums["open"], x_hat, alpha_in_units(alpha))
    open_sums = choose_terms(enters_sums, new_sums, sums["open"])
    expected_robot["received"]["sums"] = {**sums, "open": open_sums}
    del expected_robot["heard"]  # compared as a set of senders instead
    return z3.And(
        returns_code_of_first(
            status, (z3.Not(is_sender), ERR_SENDER), (z3.Not(is_valid), ERR_X_HAT), (z3.Not(is_new), REPEATED)
        ),
        _heard_senders(robot_after) == z3.If(is_accepted, heard_senders | sender_bit, heard_senders),
        is_same(robot_after, expected_robot),
    )


def _counters_after_message(counters: Any, is_valid: Any, is_new: Any) -> dict[str, Any]:
    """Return the counters after a message, which counts as accepted, repeated or rejected."""
    is_repeated = z3.And(is_valid, z3.Not(is_new))
    return {
        **counters,
        "accepted": _count_if(counters["accepted"], z3.And(is_valid, is_new)),
        "repeated": _count_if(counters["repeated"], is_repeated),
        "rejected": _count_if(counters["rejected"], z3.Not(is_valid)),
    }


def _members_with_estimate_in_slot(robot: Any, sender: Any, x_hat: Any, enters_slot: Any) -> dict[str, Any]:
    """Return the members ``received`` and ``robust`` of a robot after a message.

    If ``enters_slot`` holds, x_hat is in the sender's slot. Otherwise they are as before.
    """
    slot = zero_extend(sender & 31, 32)
    estimates = {
        index: z3.If(z3.And(enters_slot, slot == index), _to_slot_estimate(x_hat), estimate)
        for index, estimate in robot["received"]["estimates"].items()
    }
    filled_slots = robot["robust"]["filled_slots"] | z3.BitVecVal(1, 32) << slot
    robust = choose_terms(enters_slot, {**robot["robust"], "filled_slots": filled_slots}, robot["robust"])
    return {"received": {**robot["received"], "estimates": estimates}, "robust": robust}


def _to_slot_estimate(x_hat: Any) -> Any:
    """Return an x_hat as a slot keeps it (section 13): to nearest, and 2^16 - 1 for 1.0."""
    rounded = z3.LShR(x_hat + 64, 7)
    return z3.Extract(15, 0, z3.If(z3.ULT(rounded, 2**16 - 1), rounded, z3.BitVecVal(2**16 - 1, 32)))


def _sums_with_message(sums: Any, x_hat: Any, alpha: Any) -> Any:
    """Return the sums of a round with one more message, as section 6 adds it."""

    def times_x_hat(word: Any) -> Any:
        return product(word, x_hat)

    message_terms = {
        "alpha": alpha,
        "alpha_x_low": times_x_hat(low_word(alpha)),
        "alpha_x_high": times_x_hat(high_word(alpha)),
        "x_squared": times_x_hat(x_hat),
        "x": x_hat,
        "count": 1,
    }
    return {name: sum_ + message_terms[name] for name, sum_ in sums.items()}


# design: R4, R5, R6, R7, R13
RECEIVE = Contract(_is_received, used_lemmas=("alpha_units",), stand_ins={"multiply": stand_in("multiply")})

# --- settle ----------------------------------------------------------------------------------------------

FILTER_CHANGES = ("accuracy", "counters", "updated", "robust")
"""Members of a robot that a run of its filter may change; the contract of update_b_hat() says how."""


def _may_update(robot: Any) -> Any:
    """Return that the filter is one that init admits, and may run after an observation."""
    runs_robust_filter = z3.And(is_robust(robot["config"]), robot["t"] != 0)
    return z3.And(z3.ULE(robot["config"]["filter"], ROBUST), z3.Implies(runs_robust_filter, may_run(robot)))


def _may_settle(robot: Any) -> Any:
    """Return the conditions for a vote, if the filter is the robust one, and for its run, if one is due."""
    return z3.And(
        z3.Implies(is_robust(robot["config"]), may_vote(robot)),
        z3.Implies(robot["filter_left"] == 1, _may_update(robot)),
    )


def _is_settled(status: Any, robot_after: Any, robot: Any) -> Any:
    """Return what settle promises.

    A vote is taken or the sums are published; then the filter runs, and the next round begins. With the
    robust filter the sums stay, with another one the estimates stay.
    """
    # The counter is decremented first, and the filter runs when it reaches 0.
    filter_left, period = robot["filter_left"] - 1, robot["config"]["filter_period"]
    filter_runs, takes_vote = filter_left == 0, is_robust(robot["config"])
    sums = robot["received"]["sums"]
    published_sums = {**sums, "closed": {name: sums["open"][name] for name in sums["closed"]}}
    robust_after_vote = result_of("take_vote robust", robot["robust"], robot)
    robot_after_round = {
        **robot,
        "robust": choose_terms(takes_vote, robust_after_vote, robot["robust"]),
        "received": {**robot["received"], "sums": choose_terms(takes_vote, sums, published_sums)},
        "filter_left": period,
    }
    changes_of_filter = {
        name: result_of(f"update_b_hat {name}", robot[name], robot_after_round) for name in FILTER_CHANGES
    }
    status_of_filter = result_of("update_b_hat", status, robot_after_round)
    expected_robot = choose_terms(
        filter_runs,
        {**robot_after_round, **changes_of_filter},
        {**robot_after_round, "filter_left": filter_left},
    )
    # The filter has run on the sums of the round; now they are cleared for the next one.
    next_sums = {**published_sums, "open": zeros_like(sums["open"])}
    expected_robot["received"] = {**robot["received"], "sums": choose_terms(takes_vote, sums, next_sums)}
    del expected_robot["heard"]  # compared as a set of senders instead
    return z3.And(
        status == z3.If(filter_runs, status_of_filter, z3.BitVecVal(0, status.size())),
        _heard_senders(robot_after) == 0,
        is_same(robot_after, expected_robot),
    )


# design: R4, R8, R9, R10
SETTLE = Contract(
    _is_settled,
    requires=_may_settle,
    stand_ins={
        "update_b_hat": stand_in("update_b_hat", *FILTER_CHANGES, requires=_may_update),
        "take_vote": stand_in("take_vote", "robust", requires=may_vote, ensures=keeps_initial_b_hat),
    },
)

# --- The filter ------------------------------------------------------------------------------------------


def _with_test_counted(robot: Any, is_tested: Any) -> Any:
    """Return a robot whose counter of tests is one higher where the condition holds."""
    return {
        **robot,
        "counters": {**robot["counters"], "tests": _count_if(robot["counters"]["tests"], is_tested)},
    }


def _is_b_hat_updated(status: Any, robot_after: Any, robot: Any) -> Any:
    """Return that the b_hat that the robot's filter finds becomes its b_hat, if there was an observation.

    A b_hat of 0 stands for none. Nothing else changes but what counts it, and what the run of the robust
    filter may change.
    """
    # Without an observation there is no estimate that a filter could test.
    robust_runs = z3.And(has_observed(robot), is_robust(robot["config"]))
    robot_after_run = {
        **robot,
        "robust": result_of("run_robust_filter robust", robot["robust"], robot),
        "counters": result_of("run_robust_filter counters", robot["counters"], robot),
    }
    b_hat_of_paper, robot_after_test = _run_of_paper(robot)
    b_hat = z3.If(robust_runs, result_of("run_robust_filter", 32, robot), b_hat_of_paper)
    expected_robot = choose_terms(robust_runs, robot_after_run, robot_after_test)

    is_updated = b_hat != 0
    accuracy = result_of("set_b_hat accuracy", robot["accuracy"], expected_robot, b_hat)
    updates = _count_if(expected_robot["counters"]["updates"], is_updated)
    updated_robot = {
        **expected_robot,
        "accuracy": accuracy,
        "counters": {**expected_robot["counters"], "updates": updates},
        "updated": z3.BitVecVal(1, 8),
    }
    return z3.And(
        status == z3.If(is_updated, z3.BitVecVal(UPDATED, status.size()), 0),
        is_same(robot_after, choose_terms(is_updated, updated_robot, expected_robot)),
    )


def _run_of_paper(robot: Any) -> tuple[Any, dict[str, Any]]:
    """Return the b_hat that the paper's filter finds, or 0 for none, and the robot with its test counted."""
    filter_, sums = robot["config"]["filter"], robot["received"]["sums"]
    # The filter ADAPTIVE tests from two estimates on, and ALWAYS takes one without a test.
    count = sums["open"]["count"]
    is_tested = z3.And(has_observed(robot), filter_ == 0, z3.UGE(count, 2))
    tested_robot = _with_test_counted(robot, is_tested)
    is_rejected = z3.And(is_tested, result_of("asdf_test_rejects", 1, tested_robot) == 1)
    is_due_without_test = z3.And(has_observed(robot), filter_ == 1, z3.UGE(count, 1))
    mean = result_of(
        "round_mean", 32, *(sums["closed"][name] for name in ("alpha", "alpha_x_low", "alpha_x_high"))
    )
    new_b_hat = result_of("reestimate", 32, tested_robot, mean)
    return z3.If(z3.Or(is_rejected, is_due_without_test), new_b_hat, 0), tested_robot


# design: R10, R13, R23, R29
UPDATE_B_HAT = Contract(
    _is_b_hat_updated,
    _may_update,
    stand_ins={
        "run_robust_filter": stand_in("run_robust_filter", "robust", "counters", requires=may_run),
        "set_b_hat": stand_in("set_b_hat", "accuracy"),
        **{name: stand_in(name) for name in ("asdf_test_rejects", "round_mean", "reestimate")},
    },
)

# --- The test --------------------------------------------------------------------------------------------


def _may_test(robot: Any) -> Any:
    """Return what the test needs: a possible round of two estimates or more, and an x_hat of at most 1.

    The sums of m estimates x from 0 to 1 are possible if sum x^2 <= sum x, and (sum x)^2 <= m sum x^2
    (I7; Cauchy).
    """
    sums = robot["received"]["sums"]["open"]
    m, x, x_squared = (wide(sums[name]) for name in ("count", "x", "x_squared"))
    in_range = (z3.UGE(m, 2), z3.ULE(m, 127), z3.ULE(x, ONE * m), z3.ULE(x_squared, ONE * x))
    return z3.And(*in_range, z3.ULE(x * x, m * x_squared), z3.ULE(robot["x_hat"], ONE))


def _is_test_of_paper(rejects: Any, _robot_after: Any, robot: Any) -> list[Any]:
    """Return that the test is eq. 12 multiplied out, with k in units of 2^-26.

    The formulas before the last one are steps of the proof.
    """
    sums, word_at = robot["received"]["sums"]["open"], robot["config"]["table"].word_at
    # The lowest byte of the table's first word is q, its number of thresholds. Beyond q all k_m are the same.
    m, x, q = sums["count"], sums["x"], word_at(z3.BitVecVal(0, 32)) & 0xFF
    k, m_x_hat = word_at(z3.If(z3.ULE(m, q), m, q + 1)), m * robot["x_hat"]
    difference = z3.If(z3.UGT(x, m_x_hat), x - m_x_hat, m_x_hat - x)
    spread = zero_extend(m) * sums["x_squared"] - zero_extend(x) * zero_extend(x)
    spread_is_exact = wide(spread) + wide(x) * wide(x) == wide(m) * wide(sums["x_squared"])
    spread_fits = z3.And(spread_is_exact, z3.ULT(spread, 2**58))
    m_x_hat_fits = z3.ULT(wide(m) * wide(robot["x_hat"]), 2**30)
    # The products of k and the spread's two words add up to that of k and the spread.
    upper_product, lower_product = wide(k) * wide(high_word(spread)), wide(k) * wide(low_word(spread))
    k_spread = wide(k) * wide(spread)
    is_sum_of_two = z3.And(k_spread == (upper_product << 32) + lower_product, z3.ULT(upper_product, 2**58))
    is_rejected = z3.UGT(wide(difference) * wide(difference) * 2**26, k_spread)
    return [spread_fits, m_x_hat_fits, is_sum_of_two, (rejects != 0) == is_rejected]


# design: R24
TEST = Contract(_is_test_of_paper, _may_test, used_lemmas=("multiply",))

# --- The re-estimate -------------------------------------------------------------------------------------


def _is_reestimated(b_hat: Any, _robot_after: Any, robot: Any, x_bar: Any) -> list[Any]:
    """Return that b_hat is the result of eq. 8, limited to its range, or 0 if x_bar is too near to 1/2.

    The claim holds whatever multiply() and quotient() return. Where x_bar is below 1/2 the colours are
    exchanged: x is then ~x_bar, which is 1 - x_bar - 2^-32.
    """
    t = robot["t"]
    is_mirrored = z3.ULT(x_bar, 2**31)
    x, n = z3.If(is_mirrored, ~x_bar, x_bar), z3.If(is_mirrored, t - robot["n"], robot["n"])
    # Both sides of eq. 8 are multiplied by t: t (2 x - 1), and n - t (1 - x), in units of 2^-32.
    g = 2 * x  # the 1 is 2^32, which is lost in 32 bits
    divisor = product(t, g)
    dividend = z3.Concat(n, z3.BitVecVal(0, 32)) - product(t, -x)
    positive_dividend = z3.If(dividend < 0, z3.BitVecVal(0, 64), dividend)
    quotient = result_of("quotient", 32, minimum_of(positive_dividend, divisor), divisor)
    least, largest = (z3.BitVecVal(limit, 32) for limit in B_HAT_RANGE)
    limited_quotient = z3.If(z3.ULT(quotient, least), least, minimum_of(quotient, largest))
    is_eq_8 = b_hat == z3.If(z3.ULT(g, 2**20), z3.BitVecVal(0, 32), limited_quotient)
    return [is_b_hat_or_zero(b_hat), is_eq_8]


def _is_zero_only_for_zero(result: Any, a: Any, b: Any) -> Any:
    """Return that a product is 0 only if one of its factors is: the lemma of multiply() implies it."""
    return z3.Implies(result == 0, z3.Or(a == 0, b == 0))


# design: R23
REESTIMATE = Contract(
    _is_reestimated,
    requires=has_observed,
    stand_ins={
        "multiply": stand_in("multiply", ensures=_is_zero_only_for_zero),
        "quotient": stand_in("quotient", requires=arithmetic.QUOTIENT.requires),
    },
)

# --- Alpha, and the means over a round -------------------------------------------------------------------


def _is_in_units(result: Any, alpha: Any) -> Any:
    return z3.Concat(result["high"], result["low"]) == alpha_in_units(alpha)


def _is_normal(mantissa: Any, exponent: Any) -> Any:
    """Return that the mantissa has 24 bits; and the exponent, modulo 2^32, is at least -31."""
    return z3.And(z3.LShR(mantissa, 23) == 1, exponent >= -31)


def _is_rounded_alpha(result: Any, mantissa: Any, exponent: Any) -> Any:
    """Return that the result is the largest confidence if the exponent is too large for it.

    Otherwise it is the number itself, or whole units of it, rounded down, with shift 0.
    """
    # An alpha word has the mantissa in its upper 24 bits, and the shift, up to 31, below it.
    largest_alpha, exact_alpha = 0xFFFFFF1F, mantissa << 8 | exponent
    whole_units = z3.LShR(mantissa, -exponent) << 8
    return z3.If(
        exponent > 31, result == largest_alpha, result == z3.If(exponent >= 0, exact_alpha, whole_units)
    )


def _is_possible_sum(alpha: Any, low: Any, high: Any) -> Any:
    """Return that sums of a round are in their ranges (I7), and that their mean is at most 1."""
    ranges = [alpha != 0, z3.ULT(alpha, 2**62), z3.ULT(low, 2**62), z3.ULT(high, 2**53)]
    return z3.And(*ranges, z3.ULE((wide(high) << 32) + wide(low), wide(alpha) << 23))


def _is_mean(mean: Any, alpha: Any, low: Any, high: Any) -> Any:
    """Return that the mean is the quotient of the sums as they are, less a fraction below 2^-32 of alpha.

    Where alpha is short, both have 32 bits more, and no fraction is lost. With the 7 units of quotient() the
    mean is less than 8 units of 2^-32 too small.
    """
    total = (wide(high) << 32) + wide(low)
    long_mean = result_of("quotient", 32, z3.Extract(63, 0, z3.LShR(total, 23)), alpha)
    short_mean = result_of("quotient", 32, z3.Extract(63, 0, total << 9), alpha << 32)
    return mean == z3.If(z3.ULT(alpha, 2**32), short_mean, long_mean)


ROUND_MEAN = Contract(
    _is_mean,
    _is_possible_sum,
    stand_ins={"quotient": stand_in("quotient", requires=arithmetic.QUOTIENT.requires)},
)


def _is_informed_estimate(result: Any, _sums_after: Any, sums: Any, x_hat: Any, own_alpha: Any) -> Any:
    """Return that the result is eq. 7, with the robot's own message: the exact quotient, rounded down.

    quotient() makes the mean less than 8 units of 2^-32 too small, so that its upper 23 bits, x, are right or
    one too small. The rest of the division shows which: S - x alpha is below alpha, or from there to below
    2 alpha. It has less than 64 bits, so that it may be formed modulo 2^64.
    """
    own_units = result_of("alpha_units", {"high": own_alpha, "low": own_alpha}, own_alpha)
    alpha = sums["alpha"] + z3.Concat(own_units["high"], own_units["low"])
    low = sums["alpha_x_low"] + product(own_units["low"], x_hat)
    high = sums["alpha_x_high"] + product(own_units["high"], x_hat)
    # The mean is in units of 2^-32, and x in units of 2^-23.
    x = z3.LShR(result_of("round_mean", 32, alpha, low, high), 9)
    zero_word = z3.BitVecVal(0, 32)
    x_alpha = product(x, low_word(alpha)) + z3.Concat(x * high_word(alpha), zero_word)
    rest = low + z3.Concat(low_word(high), zero_word) - x_alpha
    correction = z3.If(z3.UGE(rest, alpha), z3.BitVecVal(1, 32), z3.BitVecVal(0, 32))
    return result == z3.If(alpha == 0, x_hat, x + correction)


# design: R21
INFORMED_ESTIMATE = Contract(
    _is_informed_estimate,
    stand_ins={name: stand_in(name) for name in ("alpha_units", "round_mean", "multiply")},
)

CONTRACTS = {
    "mcp_asdf_observe": OBSERVE,
    "mcp_asdf_receive": RECEIVE,
    "mcp_asdf_settle": SETTLE,
    "update_b_hat": UPDATE_B_HAT,
    "asdf_test_rejects": TEST,
    "reestimate": REESTIMATE,
    "alpha_units": Contract(_is_in_units),
    "alpha_word_from_mantissa": Contract(_is_rounded_alpha, _is_normal),
    "round_mean": ROUND_MEAN,
    "informed_estimate": INFORMED_ESTIMATE,
}


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions that have one, for one variant."""
    return {**arithmetic.contracts(variant), **robust.CONTRACTS, **CONTRACTS}


NAMES = sorted({name for variant in VARIANTS for name in contracts(variant)})
"""The names of all functions that have a contract in a variant."""


def variants_with(name: str) -> list[Variant]:
    """Return the variants that define a function and have a contract for it."""
    return [
        variant
        for variant in VARIANTS
        if name in contracts(variant) and name in program(variant, CORE).functions
    ]
