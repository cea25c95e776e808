"""The robust filter (docs/design.md, section 13): a vote, the test and what becomes of b_hat, in every state
that is possible, are what that section says; its ranges hold, and its test is that of exact rational
arithmetic, except within ``MARGIN`` of the border.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any, cast

import z3

from proofs.arithmetic import WORDS
from proofs.core import ONE
from proofs.formulas import Claim, call, formed, same
from proofs.machine import Machine, Summary
from proofs.numbers import Integers, Number, Type
from proofs.prove import Contract, UnprovenError, prove
from proofs.source import Program

MARGIN = Fraction(1, 2**13)
"""By how much of itself the larger side of the test's inequality must exceed the other one."""
B_HAT = (2**12, 2**32 - 2**12)

# --- A vote ----------------------------------------------------------------------------------------------


def _zeros(machine: Machine, votes: Number) -> Number:
    """leading_zeros() by its lemma; its argument is the new number of votes."""
    machine.claim(votes.term == _votes(machine.given["robot"]["crowd"]), "votes")
    return cast("Number", WORDS["leading_zeros"].stands_in("leading_zeros")(machine, votes))


def _votes(crowd: dict[str, Any]) -> Any:
    return _least(_wide(crowd["votes"]) + 1, z3.BitVecVal(2**14, 32))


def _shift(votes: Any) -> Any:
    """max(bits(votes) - 3, 3), of fewer than 2^15 votes."""
    found = z3.BitVecVal(3, 32)
    for bits in range(7, 16):
        found = z3.If(z3.UGE(votes, 2 ** (bits - 1)), z3.BitVecVal(bits - 3, 32), found)
    return found


def _shifted(machine: Machine, value: Number, count: Number) -> Number:
    """shift_right() by its lemma, and by the section's shift or one more: written as there, so that what
    follows is alike."""
    shift = _shift(_votes(machine.given["robot"]["crowd"]))
    try:
        prove(count.term == shift, *machine.facts)
    except UnprovenError:
        prove(count.term == shift + 1, *machine.facts, about="shift")
        shift += 1
    machine.claim(z3.ULE(shift, 13), "a shift by at most 13")
    return Number(z3.LShR(value.term, shift), value.type)


def in_range(crowd: dict[str, Any]) -> Any:
    spread, votes = crowd["spread"], crowd["votes"]
    return z3.And(
        *(z3.ULE(crowd["centre"], 2**30), z3.UGE(spread, 2**18), z3.ULE(spread, 2**28)),
        *(z3.ULE(votes, 2**14), z3.UGE(crowd["first"], B_HAT[0]), z3.ULE(crowd["first"], B_HAT[1])),
    )


def _may_vote(robot: dict[str, Any], _: Any, x_hat: Any) -> Any:
    return z3.And(in_range(robot["crowd"]), z3.ULE(x_hat, ONE))


def _least(a: Any, b: Any) -> Any:
    return z3.If(z3.ULT(a, b), a, b)


def _wide(half_word: Any) -> Any:
    return z3.ZeroExt(16, half_word)


def _is_voted(after: dict[str, Any], robot: dict[str, Any], sender: Any, x_hat: Any) -> Any:
    """The section's formulas."""
    crowd, found = robot["crowd"], after["crowd"]
    r, s, trend, said = crowd["centre"], crowd["spread"], _wide(crowd["trend"]), x_hat * 2**7
    votes, shift = _votes(crowd), _shift(_votes(crowd))
    is_above = z3.UGT(said, r)
    distance = z3.If(is_above, said - r, r - said)
    step, change = z3.LShR(_least(distance, s), shift), z3.LShR(s, shift + 1)
    moved = z3.If(is_above, trend + z3.LShR(2**16 - 1 - trend, 8), trend - z3.LShR(trend, 8))
    wider = z3.If(z3.UGT(distance, s), s + change, s - change)
    expected = {
        "centre": z3.If(is_above, r + step, r - step),
        "spread": z3.If(z3.ULT(wider, 2**18), 2**18, _least(wider, z3.BitVecVal(2**28, 32))),
        "voices": crowd["voices"] | z3.BitVecVal(1, 32) << z3.ZeroExt(24, sender & 31),
        "first": crowd["first"],
    }
    halves = [_wide(found["votes"]) == votes, _wide(found["trend"]) == z3.If(step != 0, moved, trend)]
    others = {name: each for name, each in robot.items() if name != "crowd"}
    return z3.And(same(found, expected), *halves, same(after, others))


def _stays_in_range(after: dict[str, Any], robot: dict[str, Any], _: Any, x_hat: Any) -> Any:
    """And the centre is between where it was and what was said."""
    r, found, said = robot["crowd"]["centre"], after["crowd"]["centre"], x_hat * 2**7
    low, high = z3.If(z3.ULT(r, said), r, said), z3.If(z3.ULT(r, said), said, r)
    return z3.And(in_range(after["crowd"]), z3.ULE(low, found), z3.ULE(found, high))


VOTE = Contract(
    _stays_in_range,
    requires=_may_vote,
    steps=(_is_voted,),
    uses={"leading_zeros": _zeros, "shift_right": _shifted},
)
