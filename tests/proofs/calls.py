"""The calls: observe, receive, settle and the test do what docs/design.md says (sections 2 and 8), in all
states in the ranges of docs/internals/properties.md. What they call is any function of what it is given, and
changes no more than its own lemma says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import z3

from proofs import arithmetic, formulas, robust
from proofs.arithmetic import EXACT, widen
from proofs.formulas import BY_LEMMA, ONE, Claim, call, formed, nothing, returns, same, units
from proofs.machine import Machine, Summary, chosen
from proofs.numbers import Integers, Number
from proofs.prove import Contract, Formula, always, any_result
from proofs.robust import VOTE, may_vote
from proofs.source import Program, Variant

ROBUST = 3
UPDATED, REPEATED, ERR_OBSERVATION, ERR_SENDER, ERR_X_HAT = 2, 1, -5, -6, -7

SUMS = ("alpha", "alpha_x_low", "alpha_x_high", "x_squared", "x", "count")
ALPHA_MOST = 2**55 - 2**31

# --- What is called --------------------------------------------------------------------------------------


def words(value: Any) -> Iterator[Any]:
    """Yield all terms in a value."""
    if isinstance(value, dict):
        for each in value.values():
            yield from words(each)
    elif isinstance(value, z3.ExprRef):
        yield value


def computed(name: str, like: Any, *given: Any) -> Any:
    """Return what an unknown function makes of these arguments, shaped like ``like``.

    Equal arguments give equal results.
    """
    if isinstance(like, dict):
        return {each: computed(f"{name} {each}", value, *given) for each, value in like.items()}
    terms = [each for value in given for each in words(value)]
    return z3.Function(name, *(each.sort() for each in terms), like.sort())(*terms)


def opaque(name: str, *changes: str, requires: Formula = always) -> Summary:
    """Return a stand-in for a function whose result depends on its arguments alone.

    It changes only the members ``changes`` of what the first argument points to, as its lemma says; if none
    are named, it may write to anything.
    """

    def summary(machine: Machine, *arguments: Any) -> Any:
        given = [machine.seen(each) for each in arguments]
        machine.claim(requires(*given), f"what {name} requires")
        for member in changes:
            place = arguments[0].below(member)
            found = computed(f"{name} {member}", machine.seen(machine.load(place)), *given)
            machine.store(place, numbers(machine.load(place), found))
        if not changes:
            any_result(name)(machine, *arguments)
        result = machine.unknown_of(machine.program.heads[name].type, name)
        return None if result is None else numbers(result, computed(name, machine.seen(result), *given))

    return summary


def numbers(like: Any, found: Any) -> Any:
    """Return terms as numbers of the given types."""
    if isinstance(like, dict):
        return {name: numbers(each, found[name]) for name, each in like.items()}
    return Number(found, like.type)


def opaque_all(*names: str) -> dict[str, Summary]:
    return {name: opaque(name) for name in names}


# --- observe ---------------------------------------------------------------------------------------------


def _may_observe(robot: Any, _: Any) -> Any:
    """I2, and what init admits."""
    memory = robot["config"]["memory"]
    allowed = (z3.UGE(memory, 64), z3.ULE(memory, 2**31), z3.Extract(1, 0, memory) == 0)
    return z3.And(*allowed, z3.ULE(robot["n"], robot["t"]), z3.ULT(robot["t"], memory))


def _observed(status: Any, after: Any, robot: Any, z: Any) -> Any:
    """The claim that I2 holds again after an observation."""
    is_colour = z3.Or(z == 0, z == 1)
    t, n = widen(robot["t"]) + 1, widen(robot["n"]) + widen(z)
    has_reached = t == widen(robot["config"]["memory"])
    to_even = z3.If(n % 2 == 0, z3.UDiv(n, 2), 2 * z3.UDiv(n + 1, 4))
    t, n = z3.If(has_reached, z3.UDiv(t, 2), t), z3.If(has_reached, to_even, n)
    t, n = (z3.Extract(31, 0, each) for each in (t, n))
    formed = computed("estimate", {name: t for name in ("x_hat", "alpha")}, t, n, robot["accuracy"])
    # Where t and n are halved, the robust filter begins a batch of observations anew.
    begins_batch = z3.And(has_reached, is_robust(robot["config"]))
    batch = chosen(begins_batch, {**robot["robust"], "batch_t": t, "batch_n": n}, robot["robust"])
    updated = {"t": t, "n": n, "updated": z3.BitVecVal(0, 8), "robust": batch, **formed}
    return z3.And(
        returns(status, (z3.Not(is_colour), ERR_OBSERVATION)),
        same(after, chosen(is_colour, {**robot, **updated}, robot)),
        _may_observe(after, z),
    )


# design: R1, R2, R3, R29
OBSERVE = Contract(_observed, requires=_may_observe, instead=opaque_all("estimate"))

# --- receive ---------------------------------------------------------------------------------------------


def _heard(robot: Any) -> Any:
    """Return the senders heard, as one word."""
    return z3.Concat(*reversed(robot["heard"]["of"].values()))


def is_robust(config: Any) -> Any:
    return config["filter"] == ROBUST


def _received(status: Any, after: Any, robot: Any, *message: Any) -> Any:
    sender, x_hat, alpha = message
    is_sender = z3.And(z3.ULE(sender, 127), sender != robot["id"])
    is_valid = z3.And(is_sender, z3.ULE(x_hat, ONE))
    heard, one = _heard(robot), z3.BitVecVal(1, 128) << widen(sender, 128)
    is_new = heard & one == 0
    is_accepted = z3.And(is_valid, is_new)
    counted = {
        "accepted": is_accepted,
        "repeated": z3.And(is_valid, z3.Not(is_new)),
        "rejected": z3.Not(is_valid),
    }
    counters = robot["counters"]
    counters = {
        **counters,
        **{
            name: counters[name] + z3.If(each, z3.BitVecVal(1, 16), z3.BitVecVal(0, 16))
            for name, each in counted.items()
        },
    }
    says_something = z3.And(is_accepted, units(alpha) != 0)
    received, sums = robot["received"], robot["received"]["sums"]
    enters_sums = z3.And(says_something, z3.Not(is_robust(robot["config"])))
    enters_slot = z3.And(says_something, is_robust(robot["config"]))
    open_round = chosen(enters_sums, _added(sums["open"], x_hat, units(alpha)), sums["open"])
    slot = widen(sender & 31, 32)
    filled_slots = robot["robust"]["filled_slots"] | z3.BitVecVal(1, 32) << slot
    expected = {
        **{name: each for name, each in robot.items() if name != "heard"},
        "counters": counters,
        "received": {
            "sums": {**sums, "open": open_round},
            "estimates": {
                index: z3.If(z3.And(enters_slot, slot == int(index)), _in_slot(x_hat), estimate)
                for index, estimate in received["estimates"].items()
            },
        },
        "robust": chosen(enters_slot, {**robot["robust"], "filled_slots": filled_slots}, robot["robust"]),
    }
    return z3.And(
        returns(
            status, (z3.Not(is_sender), ERR_SENDER), (z3.Not(is_valid), ERR_X_HAT), (z3.Not(is_new), REPEATED)
        ),
        _heard(after) == z3.If(is_accepted, heard | one, heard),
        same(after, expected),
    )


def _in_slot(x_hat: Any) -> Any:
    """Return an x_hat as a slot keeps it (section 13): to nearest, and 2^16 - 1 for 1.0."""
    rounded = z3.LShR(x_hat + 64, 7)
    return z3.Extract(15, 0, z3.If(z3.ULT(rounded, 2**16 - 1), rounded, z3.BitVecVal(2**16 - 1, 32)))


def _added(sums: Any, x_hat: Any, alpha: Any) -> Any:
    """Section 6."""

    def product(a: Any, b: Any) -> Any:
        return computed("multiply", alpha, a, b)

    parts = (EXACT["low_word"](alpha), EXACT["high_word"](alpha), x_hat)
    terms = dict(zip(SUMS, (alpha, *(product(each, x_hat) for each in parts), x_hat, 1), strict=True))
    return {name: each + terms[name] for name, each in sums.items()}


# design: R4, R5, R6, R7, R13
RECEIVE = Contract(_received, instead={**BY_LEMMA, **opaque_all("multiply")})


# design: R20
def of_a_message() -> Iterator[Claim]:
    """One more message keeps the sums of a round possible, in their ranges and no more than senders."""
    own, sender, x_hat, low, high = z3.Ints("own sender x_hat low high")
    heard = z3.Bools([f"heard_{index}" for index in range(128)])
    known = [own >= 0, own <= 127, sender >= 0, sender <= 127, own != sender]
    known += [z3.Implies(z3.Or(own == at, sender == at), z3.Not(each)) for at, each in enumerate(heard)]
    yield "126 others were heard at most (I9)", z3.AtMost(*heard, 126), known
    sums = dict(zip(SUMS, z3.Ints(SUMS), strict=True))
    alpha = 2**32 * high + low
    known = [is_round(sums), sums["count"] <= 126, x_hat >= 0, x_hat <= ONE, low >= 0, low < 2**32]
    known += [alpha >= 1, alpha <= ALPHA_MOST, high >= 0, high < 2**23]
    terms = (alpha, low * x_hat, high * x_hat, x_hat * x_hat, x_hat, 1)
    after = {name: each + term for (name, each), term in zip(sums.items(), terms, strict=True)}
    yield "sums with another message (I7)", is_round(after), known
    bits = zip((62, 62, 53, 53, 30), sums.values(), strict=False)
    yield "ranges", z3.And([each < 2**most for most, each in bits]), [is_round(sums)]


# --- settle ----------------------------------------------------------------------------------------------

FILTER_CHANGES = ("accuracy", "counters", "updated", "robust")
"""Members of a robot that a run of its filter may change; of_filter() says how."""


def _may_settle(robot: Any) -> Any:
    """Return what a vote needs, with the robust filter."""
    return z3.Implies(is_robust(robot["config"]), may_vote(robot))


def _settled(status: Any, after: Any, robot: Any) -> Any:
    """A vote is taken or the sums are published; then the filter runs, and the next round begins.

    With the robust filter the sums stay, with another one the estimates stay.
    """
    left, period = robot["filter_left"] - 1, robot["config"]["filter_period"]
    runs, takes_vote = left == 0, is_robust(robot["config"])
    sums = robot["received"]["sums"]
    published = {**sums, "closed": {name: sums["open"][name] for name in sums["closed"]}}
    after_vote = computed("take_vote robust", robot["robust"], robot)
    ended = {
        **robot,
        "robust": chosen(takes_vote, after_vote, robot["robust"]),
        "received": {**robot["received"], "sums": chosen(takes_vote, sums, published)},
        "filter_left": period,
    }
    of_filter = {name: computed(f"update_b_hat {name}", robot[name], ended) for name in FILTER_CHANGES}
    expected = chosen(runs, {**ended, **of_filter}, {**ended, "filter_left": left})
    next_sums = {**published, "open": nothing(sums["open"])}
    received = {**robot["received"], "sums": chosen(takes_vote, sums, next_sums)}
    status_of_filter = computed("update_b_hat", status, ended)
    return z3.And(
        status == z3.If(runs, status_of_filter, z3.BitVecVal(0, status.size())),
        same(after, {**expected, "received": received, "heard": nothing(robot["heard"])}),
    )


# design: R4, R8, R9, R10
SETTLE = Contract(
    _settled,
    requires=_may_settle,
    instead={
        "update_b_hat": opaque("update_b_hat", *FILTER_CHANGES),
        "take_vote": opaque("take_vote", "robust", requires=VOTE.requires),
    },
)

# --- The filter ------------------------------------------------------------------------------------------


def _of_round(robot: Any) -> tuple[Any, Any]:
    """Return what b_hat becomes by the paper's filters, 0 if it stays; and whether a test is counted."""
    sums, mode = robot["received"]["sums"], robot["config"]["filter"]
    count = sums["open"]["count"]
    mean = call("round_mean", *(sums["closed"][name] for name in ("alpha", "alpha_x_low", "alpha_x_high")))
    is_tested = z3.And(mode == 0, z3.UGE(count, 2))
    runs = z3.Or(z3.And(is_tested, call("asdf_test_rejects") != 0), z3.And(mode == 1, z3.UGE(count, 1)))
    return z3.If(runs, call("reestimate", mean), 0), is_tested


# design: R10, R13, R23, R29
def of_filter(program: Program) -> Iterator[Claim]:
    """If there was an observation, what the robot's own filter finds becomes b_hat, unless it is 0.

    Nothing else changes but what counts it. Of the robust filter's run only its result is seen here; what it
    changes is its own contract's.
    """
    given, (status, after) = formed(program, "update_b_hat")
    counters, accuracy = given["counters"], given["accuracy"]
    has_observed, has_robust_filter = given["t"] != 0, is_robust(given["config"])
    of_round, is_round_tested = _of_round(given)
    b_hat = z3.If(has_robust_filter, call("run_robust_filter"), of_round)
    is_updated = z3.And(has_observed, b_hat != 0)
    is_tested = z3.And(has_observed, is_round_tested)
    one, none = (z3.BitVecVal(value, 16) for value in (1, 0))
    changed = {
        "accuracy": {**accuracy, "b_hat": z3.If(is_updated, b_hat, accuracy["b_hat"])},
        "counters": {
            **counters,
            "tests": counters["tests"] + z3.If(is_tested, one, none),
            "updates": counters["updates"] + z3.If(is_updated, one, none),
        },
        "updated": z3.If(is_updated, z3.BitVecVal(1, 8), given["updated"]),
    }
    known = [z3.ULE(given["config"]["filter"], ROBUST)]
    yield "updated", status == z3.If(is_updated, z3.BitVecVal(2, status.size()), 0), known
    of_paper = [*known, z3.Not(has_robust_filter)]
    yield "the robot with a filter of the paper", same(after, {**given, **changed}), of_paper
    new_b_hat = z3.If(is_updated, b_hat, after["accuracy"]["b_hat"])
    yield "b_hat with the robust filter", after["accuracy"]["b_hat"] == new_b_hat, known


# --- The test --------------------------------------------------------------------------------------------


def is_round(sums: Any) -> Any:
    """Sums of a round that are possible (I7, section 10), in whole numbers."""
    alpha, low, high, _, x, m = (sums[name] for name in SUMS)
    return z3.And(
        *(are_estimates(sums), m <= alpha, alpha <= m * ALPHA_MOST),
        *(low >= 0, low <= (2**32 - 1) * x, high >= 0, high <= (2**23 - 1) * x),
        2**32 * high + low <= ONE * alpha,
    )


def are_estimates(sums: Any) -> Any:
    """Return the part that is about x_hat alone."""
    m, x, x_squared = (sums[name] for name in ("count", "x", "x_squared"))
    in_range = (m >= 0, m <= 127, x >= 0, x <= ONE * m, x_squared >= 0, x_squared <= ONE * x)
    return z3.And(*in_range, x * x <= m * x_squared)


def _may_test(robot: Any) -> Any:
    return z3.And(
        are_estimates(robot["received"]["sums"]["open"]),
        robot["received"]["sums"]["open"]["count"] >= 2,
        robot["x_hat"] <= ONE,
    )


def _terms_of_test(robot: Any) -> tuple[Any, Any, Any]:
    """Return (sum x - m x_hat)^2; k_m, the entry for m > q where m > q; and m sum x^2 - (sum x)^2."""
    sums, word = robot["received"]["sums"]["open"], robot["config"]["table"].word
    m, x, q = sums["count"], sums["x"], word(0) % 256
    difference = x - m * robot["x_hat"]
    return difference * difference, word(z3.If(m <= q, m, q + 1)), m * sums["x_squared"] - x * x


def _spread_is_small(_: Any, __: Any, robot: Any) -> Any:
    spread = _terms_of_test(robot)[2]
    return z3.And(spread >= 0, spread < 2**58)


def _sum_of_own_is_small(_: Any, __: Any, robot: Any) -> Any:
    m_x_hat = robot["received"]["sums"]["open"]["count"] * robot["x_hat"]
    return z3.And(m_x_hat >= 0, m_x_hat < 2**30)


def _product_is_sum_of_two(_: Any, __: Any, robot: Any) -> Any:
    """The products of k_m and the two words of the spread add up to the product of k_m and the spread."""
    _, k, spread = _terms_of_test(robot)
    return k * spread == 2**32 * (k * (spread / 2**32)) + k * (spread % 2**32)


def _decided(rejects: Any, _: Any, robot: Any) -> Any:
    """Eq. 12 multiplied out, with k in units of 2^-26."""
    square, k, spread = _terms_of_test(robot)
    return (rejects != 0) == (2**26 * square > k * spread)


# design: R24
TEST = Contract(
    _decided,
    Integers,
    requires=_may_test,
    steps=(_spread_is_small, _sum_of_own_is_small, _product_is_sum_of_two),
    uses=("multiply",),
)
OF_THE_CODE = (of_filter,)
CONTRACTS = {
    "mcp_asdf_observe": OBSERVE,
    "mcp_asdf_receive": RECEIVE,
    "mcp_asdf_settle": SETTLE,
    "asdf_test_rejects": TEST,
}


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions that have one, for one variant."""
    return {**arithmetic.contracts(variant), **formulas.CONTRACTS, **robust.CONTRACTS, **CONTRACTS}
