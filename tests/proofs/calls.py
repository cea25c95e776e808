"""The calls: observe, receive, settle and the test do what docs/design.md says (sections 2 and 8), in all
states in the ranges of docs/internals/properties.md. What they call is any function of its arguments, and
changes no more than its own lemma says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import z3

from proofs import arithmetic, formulas, robust
from proofs.arithmetic import EXACT_RESULTS, zero_extend
from proofs.formulas import (
    LEMMA_SUMMARIES,
    ONE,
    alpha_in_units,
    function_terms,
    is_same,
    result_of,
    returns_code_of_first,
    zeros_like,
)
from proofs.machine import Machine, Summary, choose_terms
from proofs.numbers import IntegerArithmetic, Number
from proofs.prove import Claim, Contract, Formula, always, any_result
from proofs.robust import VOTE, may_vote
from proofs.source import Program, Variant

ROBUST = 3
"""The configuration's value for the robust filter."""
UPDATED, REPEATED, ERR_OBSERVATION, ERR_SENDER, ERR_X_HAT = 2, 1, -5, -6, -7

SUM_NAMES = ("alpha", "alpha_x_low", "alpha_x_high", "x_squared", "x", "count")
ALPHA_MAX = 2**55 - 2**31

# --- Called functions that may compute anything -----------------------------------------------------------


def iterate_terms(value: Any) -> Iterator[Any]:
    """Yield all terms in a value."""
    if isinstance(value, dict):
        for member in value.values():
            yield from iterate_terms(member)
    elif isinstance(value, z3.ExprRef):
        yield value


def uninterpreted_result(name: str, shape: Any, *arguments: Any) -> Any:
    """Return terms, in the same structure as ``shape``, that an unknown function makes of these arguments.

    Equal arguments give equal results.
    """
    if isinstance(shape, dict):
        return {
            member_name: uninterpreted_result(f"{name} {member_name}", member, *arguments)
            for member_name, member in shape.items()
        }
    # A function of the solver, of which nothing is known: it takes all words of all arguments.
    argument_terms = [term for argument in arguments for term in iterate_terms(argument)]
    argument_sorts = [term.sort() for term in argument_terms]
    return z3.Function(name, *argument_sorts, shape.sort())(*argument_terms)


def uninterpreted_summary(name: str, *changed_members: str, requires: Formula = always) -> Summary:
    """Return a stand-in for a function whose result depends on its arguments alone.

    It changes only these members of what the first argument points to, as its lemma says; if none are named,
    it may write to anything.
    """

    def call_uninterpreted(machine: Machine, *arguments: Any) -> Any:
        argument_terms = [machine.terms_of(argument) for argument in arguments]
        machine.require(requires(*argument_terms), f"what {name} requires")
        for member_name in changed_members:
            location = arguments[0].select(member_name)
            old_terms = machine.terms_of(machine.load(location))
            new_terms = uninterpreted_result(f"{name} {member_name}", old_terms, *argument_terms)
            machine.store(location, numbers_like(machine.load(location), new_terms))
        if not changed_members:
            any_result(name)(machine, *arguments)
        result = machine.fresh_value(machine.program.signatures[name].type, name)
        if result is None:
            return None
        result_terms = uninterpreted_result(name, machine.terms_of(result), *argument_terms)
        return numbers_like(result, result_terms)

    return call_uninterpreted


def numbers_like(value: Any, terms: Any) -> Any:
    """Return terms as numbers that have the types, and the structure, of a value."""
    if isinstance(value, dict):
        return {name: numbers_like(member, terms[name]) for name, member in value.items()}
    return Number(terms, value.type)


def is_robust(config: Any) -> Any:
    """Return that a configuration has the robust filter."""
    return config["filter"] == ROBUST


# --- observe ---------------------------------------------------------------------------------------------


def _may_observe(robot: Any, _z: Any) -> Any:
    """Return I2, and what init admits."""
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
    estimate = uninterpreted_result("estimate", {"x_hat": t, "alpha": t}, t, n, robot["accuracy"])
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
OBSERVE = Contract(
    _is_observed, requires=_may_observe, stand_ins={"estimate": uninterpreted_summary("estimate")}
)

# --- receive ---------------------------------------------------------------------------------------------


def _heard_senders(robot: Any) -> Any:
    """Return the set of senders heard as one word, with a bit for each id."""
    return z3.Concat(*reversed(robot["heard"]["of"].values()))


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

    counters = dict(robot["counters"])
    counters["accepted"] = _count_if(counters["accepted"], is_accepted)
    counters["repeated"] = _count_if(counters["repeated"], z3.And(is_valid, z3.Not(is_new)))
    counters["rejected"] = _count_if(counters["rejected"], z3.Not(is_valid))

    # A message without confidence only counts. Another one enters the sums, or a slot of the robust filter.
    has_confidence = z3.And(is_accepted, alpha_in_units(alpha) != 0)
    enters_sums = z3.And(has_confidence, z3.Not(is_robust(robot["config"])))
    enters_slot = z3.And(has_confidence, is_robust(robot["config"]))
    received, sums = robot["received"], robot["received"]["sums"]
    new_sums = _sums_with_message(sums["open"], x_hat, alpha_in_units(alpha))
    open_sums = choose_terms(enters_sums, new_sums, sums["open"])
    slot = zero_extend(sender & 31, 32)
    filled_slots = robot["robust"]["filled_slots"] | z3.BitVecVal(1, 32) << slot
    estimates = {
        index: z3.If(z3.And(enters_slot, slot == int(index)), _to_slot_estimate(x_hat), estimate)
        for index, estimate in received["estimates"].items()
    }
    expected_robot = {
        **robot,
        "counters": counters,
        "received": {"sums": {**sums, "open": open_sums}, "estimates": estimates},
        "robust": choose_terms(
            enters_slot, {**robot["robust"], "filled_slots": filled_slots}, robot["robust"]
        ),
    }
    del expected_robot["heard"]  # compared as a set of senders instead
    return z3.And(
        returns_code_of_first(
            status, (z3.Not(is_sender), ERR_SENDER), (z3.Not(is_valid), ERR_X_HAT), (z3.Not(is_new), REPEATED)
        ),
        _heard_senders(robot_after) == z3.If(is_accepted, heard_senders | sender_bit, heard_senders),
        is_same(robot_after, expected_robot),
    )


def _to_slot_estimate(x_hat: Any) -> Any:
    """Return an x_hat as a slot keeps it (section 13): to nearest, and 2^16 - 1 for 1.0."""
    rounded = z3.LShR(x_hat + 64, 7)
    return z3.Extract(15, 0, z3.If(z3.ULT(rounded, 2**16 - 1), rounded, z3.BitVecVal(2**16 - 1, 32)))


def _sums_with_message(sums: Any, x_hat: Any, alpha: Any) -> Any:
    """Return the sums of a round with one more message, as section 6 adds it."""

    def times_x_hat(word: Any) -> Any:
        return uninterpreted_result("multiply", alpha, word, x_hat)

    message_terms = {
        "alpha": alpha,
        "alpha_x_low": times_x_hat(EXACT_RESULTS["low_word"](alpha)),
        "alpha_x_high": times_x_hat(EXACT_RESULTS["high_word"](alpha)),
        "x_squared": times_x_hat(x_hat),
        "x": x_hat,
        "count": 1,
    }
    return {name: sum_ + message_terms[name] for name, sum_ in sums.items()}


# design: R4, R5, R6, R7, R13
RECEIVE = Contract(_is_received, stand_ins={**LEMMA_SUMMARIES, "multiply": uninterpreted_summary("multiply")})


# design: R20
def one_more_message_claims() -> Iterator[Claim]:
    """Claim that one more message keeps the sums of a round possible and in their ranges.

    There are no more messages in a round than senders.
    """
    own_id, sender, x_hat, low, high = z3.Ints("own sender x_hat low high")
    is_heard = z3.Bools([f"heard_{id_}" for id_ in range(128)])
    assumptions = [own_id >= 0, own_id <= 127, sender >= 0, sender <= 127, own_id != sender]
    for id_, is_id_heard in enumerate(is_heard):
        assumptions.append(z3.Implies(z3.Or(own_id == id_, sender == id_), z3.Not(is_id_heard)))
    yield Claim("126 others were heard at most (I9)", z3.AtMost(*is_heard, 126), assumptions)

    sums = dict(zip(SUM_NAMES, z3.Ints(SUM_NAMES), strict=True))
    alpha = 2**32 * high + low
    assumptions = [is_possible_round(sums), sums["count"] <= 126]
    assumptions += [x_hat >= 0, x_hat <= ONE, low >= 0, low < 2**32]
    assumptions += [alpha >= 1, alpha <= ALPHA_MAX, high >= 0, high < 2**23]
    message_terms = (alpha, low * x_hat, high * x_hat, x_hat * x_hat, x_hat, 1)
    new_sums = {name: sums[name] + term for name, term in zip(SUM_NAMES, message_terms, strict=True)}
    yield Claim("sums with another message (I7)", is_possible_round(new_sums), assumptions)
    bits_by_sum = {"alpha": 62, "alpha_x_low": 62, "alpha_x_high": 53, "x_squared": 53, "x": 30}
    are_in_range = z3.And([sums[name] < 2**bits for name, bits in bits_by_sum.items()])
    yield Claim("ranges", are_in_range, [is_possible_round(sums)])


# --- settle ----------------------------------------------------------------------------------------------

FILTER_CHANGES = ("accuracy", "counters", "updated", "robust")
"""Members of a robot that a run of its filter may change; ``update_b_hat_claims`` say how."""


def _may_settle(robot: Any) -> Any:
    """Return what a vote needs, with the robust filter."""
    return z3.Implies(is_robust(robot["config"]), may_vote(robot))


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
    robust_after_vote = uninterpreted_result("take_vote robust", robot["robust"], robot)
    robot_after_round = {
        **robot,
        "robust": choose_terms(takes_vote, robust_after_vote, robot["robust"]),
        "received": {**robot["received"], "sums": choose_terms(takes_vote, sums, published_sums)},
        "filter_left": period,
    }
    changes_of_filter = {
        name: uninterpreted_result(f"update_b_hat {name}", robot[name], robot_after_round)
        for name in FILTER_CHANGES
    }
    status_of_filter = uninterpreted_result("update_b_hat", status, robot_after_round)
    expected_robot = choose_terms(
        filter_runs,
        {**robot_after_round, **changes_of_filter},
        {**robot_after_round, "filter_left": filter_left},
    )
    # The filter has run on the sums of the round; now they are cleared for the next one.
    next_sums = {**published_sums, "open": zeros_like(sums["open"])}
    expected_robot["received"] = {**robot["received"], "sums": choose_terms(takes_vote, sums, next_sums)}
    expected_robot["heard"] = zeros_like(robot["heard"])
    return z3.And(
        status == z3.If(filter_runs, status_of_filter, z3.BitVecVal(0, status.size())),
        is_same(robot_after, expected_robot),
    )


# design: R4, R8, R9, R10
SETTLE = Contract(
    _is_settled,
    requires=_may_settle,
    stand_ins={
        "update_b_hat": uninterpreted_summary("update_b_hat", *FILTER_CHANGES),
        "take_vote": uninterpreted_summary("take_vote", "robust", requires=VOTE.requires),
    },
)

# --- The filter ------------------------------------------------------------------------------------------


def _b_hat_of_paper_filters(robot: Any) -> tuple[Any, Any]:
    """Return the b_hat that the paper's filters find, 0 if it stays; and whether a test is counted."""
    sums, filter_ = robot["received"]["sums"], robot["config"]["filter"]
    count = sums["open"]["count"]
    closed_sums = [sums["closed"][name] for name in ("alpha", "alpha_x_low", "alpha_x_high")]
    mean = result_of("round_mean", *closed_sums)
    is_tested = z3.And(filter_ == 0, z3.UGE(count, 2))
    is_rejected = z3.And(is_tested, result_of("asdf_test_rejects") != 0)
    is_reestimated = z3.Or(is_rejected, z3.And(filter_ == 1, z3.UGE(count, 1)))
    return z3.If(is_reestimated, result_of("reestimate", mean), 0), is_tested


# design: R10, R13, R23, R29
def update_b_hat_claims(program: Program) -> Iterator[Claim]:
    """Claim that the b_hat that the robot's filter finds becomes its b_hat, if there was an observation.

    A b_hat of 0 stands for none. Nothing else changes but what counts it. Of the robust filter's run only its
    result is known here; what the run changes is the subject of its own contract.
    """
    robot, status, robot_after = function_terms(program, "update_b_hat")
    counters, accuracy = robot["counters"], robot["accuracy"]
    # Without an observation there is no estimate that a filter could test.
    has_observed, has_robust_filter = robot["t"] != 0, is_robust(robot["config"])
    b_hat_of_paper, counts_test = _b_hat_of_paper_filters(robot)
    b_hat = z3.If(has_robust_filter, result_of("run_robust_filter"), b_hat_of_paper)
    is_updated = z3.And(has_observed, b_hat != 0)
    is_tested = z3.And(has_observed, counts_test)
    expected_robot = {
        **robot,
        "accuracy": {**accuracy, "b_hat": z3.If(is_updated, b_hat, accuracy["b_hat"])},
        "counters": {
            **counters,
            "tests": _count_if(counters["tests"], is_tested),
            "updates": _count_if(counters["updates"], is_updated),
        },
        "updated": z3.If(is_updated, z3.BitVecVal(1, 8), robot["updated"]),
    }
    is_filter = z3.ULE(robot["config"]["filter"], ROBUST)
    expected_status = z3.If(is_updated, z3.BitVecVal(UPDATED, status.size()), 0)
    yield Claim("updated", status == expected_status, [is_filter])
    has_paper_filter = [is_filter, z3.Not(has_robust_filter)]
    yield Claim(
        "the robot with a filter of the paper", is_same(robot_after, expected_robot), has_paper_filter
    )
    new_b_hat = z3.If(is_updated, b_hat, robot_after["accuracy"]["b_hat"])
    yield Claim("b_hat with the robust filter", robot_after["accuracy"]["b_hat"] == new_b_hat, [is_filter])


# --- The test --------------------------------------------------------------------------------------------


def is_possible_round(sums: Any) -> Any:
    """Return that integers are sums of a round that are possible (I7, section 10)."""
    alpha, low, high, _, x, m = (sums[name] for name in SUM_NAMES)
    alpha_range = [m <= alpha, alpha <= m * ALPHA_MAX]
    word_ranges = [low >= 0, low <= (2**32 - 1) * x, high >= 0, high <= (2**23 - 1) * x]
    mean_is_at_most_one = 2**32 * high + low <= ONE * alpha
    return z3.And(are_possible_estimates(sums), *alpha_range, *word_ranges, mean_is_at_most_one)


def are_possible_estimates(sums: Any) -> Any:
    """Return the part of ``is_possible_round`` that is about x_hat alone."""
    m, x, x_squared = (sums[name] for name in ("count", "x", "x_squared"))
    in_range = (m >= 0, m <= 127, x >= 0, x <= ONE * m, x_squared >= 0, x_squared <= ONE * x)
    return z3.And(*in_range, x * x <= m * x_squared)


def _may_test(robot: Any) -> Any:
    """Return what the test needs: a possible round of at least two estimates, and an x_hat of at most 1."""
    return z3.And(
        are_possible_estimates(robot["received"]["sums"]["open"]),
        robot["received"]["sums"]["open"]["count"] >= 2,
        robot["x_hat"] <= ONE,
    )


def _test_terms(robot: Any) -> tuple[Any, Any, Any]:
    """Return (sum x - m x_hat)^2; k_m, the entry for m > q where m > q; and m sum x^2 - (sum x)^2."""
    sums, word_at = robot["received"]["sums"]["open"], robot["config"]["table"].word_at
    # The lowest byte of the table's first word is q, its number of thresholds.
    m, x, q = sums["count"], sums["x"], word_at(0) % 256
    difference = x - m * robot["x_hat"]
    k = word_at(z3.If(m <= q, m, q + 1))
    spread = m * sums["x_squared"] - x * x
    return difference * difference, k, spread


def _spread_fits(_rejects: Any, _robot_after: Any, robot: Any) -> Any:
    _, _, spread = _test_terms(robot)
    return z3.And(spread >= 0, spread < 2**58)


def _m_x_hat_fits(_rejects: Any, _robot_after: Any, robot: Any) -> Any:
    m_x_hat = robot["received"]["sums"]["open"]["count"] * robot["x_hat"]
    return z3.And(m_x_hat >= 0, m_x_hat < 2**30)


def _product_is_sum_of_two(_rejects: Any, _robot_after: Any, robot: Any) -> Any:
    """Return that the products of k_m and the spread's two words add up to that of k_m and the spread."""
    _, k, spread = _test_terms(robot)
    return k * spread == 2**32 * (k * (spread / 2**32)) + k * (spread % 2**32)


def _is_test_of_paper(rejects: Any, _robot_after: Any, robot: Any) -> Any:
    """Return that the test is eq. 12 multiplied out, with k in units of 2^-26."""
    square, k, spread = _test_terms(robot)
    return (rejects != 0) == (2**26 * square > k * spread)


# design: R24
TEST = Contract(
    _is_test_of_paper,
    IntegerArithmetic,
    requires=_may_test,
    proof_steps=(_spread_fits, _m_x_hat_fits, _product_is_sum_of_two),
    used_lemmas=("multiply",),
)
OF_THE_CODE = (update_b_hat_claims,)
CONTRACTS = {
    "mcp_asdf_observe": OBSERVE,
    "mcp_asdf_receive": RECEIVE,
    "mcp_asdf_settle": SETTLE,
    "asdf_test_rejects": TEST,
}


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions that have one, for one variant."""
    return {**arithmetic.contracts(variant), **formulas.CONTRACTS, **robust.CONTRACTS, **CONTRACTS}
