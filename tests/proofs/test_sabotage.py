"""Falsehoods have no proof; and each way to make the proofs lenient lets one of them pass, so this file
notices it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import z3

from proofs import arithmetic
from proofs import prove as prover
from proofs.arithmetic import RATIO
from proofs.formulas import Claim
from proofs.machine import Machine
from proofs.prove import Contract, UnprovenError, always
from proofs.source import HERE, program

CALLS = Path(__file__).with_name("few_calls.c")
PRIME = 16769023
"""It takes long to see that this number is a prime."""
NEVER = z3.BoolVal(False)


def factors(p: Any, q: Any) -> list[Any]:
    return [p > 1, q > 1, p * q == PRIME]


def doubled(word: Any) -> Any:
    """With so many bits that no product wraps."""
    return z3.ZeroExt(word.size(), word)


def contradiction_by_sort() -> None:
    """p < q < p + 1, after the same text of real numbers."""
    real, whole = (
        [p < q, q < p + s, s * s == s, s + s != s] for p, q, s in (z3.Reals("p q s"), z3.Ints("p q s"))
    )
    prover.prove_all([("sound", z3.BoolVal(True), real), ("planted", NEVER, whole)])


def unsettled() -> None:
    p, q = z3.Ints("p q")
    *known, product = factors(p, q)
    prover.prove(z3.Not(product), *known)


def of_calls(name: str, *contracts: dict[str, Contract]) -> Callable[[], None]:
    """That the function keeps its contract, with one set of contracts after the other."""

    def prove() -> None:
        done = set[Any]()
        for each in contracts:
            prover.prove_lemma(program(HERE[0], CALLS), name, each, done)

    return prove


def large(value: Any) -> Any:
    return z3.UGT(value, 7)


ANY, NONE = Contract(always), Contract(lambda *_: NEVER)
SAME, CALLER = (Contract(lambda found, value: found == value, uses=uses) for uses in ((), ("same",)))
WHERE_LARGE = Contract(lambda found, value: large(found), requires=large)
FALSEHOODS: dict[str, Callable[[], None]] = {
    "untrue": lambda: prover.prove(z3.Int("p") > 0),
    "not settled": unsettled,
    "possible": lambda: prover.require_possible(factors(*z3.Ints("p q")), "factors"),
    "possible for words": lambda: prover.require_possible(
        factors(*map(doubled, z3.BitVecs("p q", 32))), "factors"
    ),
    "from a contradiction": lambda: prover.prove_all([("planted", NEVER, factors(*z3.Ints("p q")))]),
    "from a contradiction in this sort": contradiction_by_sort,
    "nothing claimed": lambda: prover.prove_all([]),
    "no case": of_calls("same", {"same": replace(NONE, cases=("value", ()))}),
    "no argument": of_calls("same", {"same": replace(NONE, requires=lambda *_: NEVER)}),
    "not defined": of_calls("shifted", {"shifted": ANY}),
    "too many turns": of_calls("turned", {"turned": ANY}),
    "duty": of_calls("caller", {"caller": replace(ANY, uses=("same",)), "same": WHERE_LARGE}),
    "on another path": of_calls(
        "caller_where_large",
        {
            "caller_where_large": Contract(lambda found, value: large(value), uses=("same",)),
            "same": Contract(lambda found, value: large(value), requires=large),
        },
    ),
    "counted": of_calls("counted", {"counted": Contract(lambda found, value: found == 1)}),
    "step": of_calls("same", {"same": replace(NONE, steps=(lambda *_: NEVER,))}),
    "another contract": of_calls("same", {"same": ANY}, {"same": NONE}),
    "another lemma": of_calls("caller", {"caller": CALLER, "same": SAME}, {"caller": CALLER, "same": ANY}),
    "no lemma": of_calls("caller", {"caller": CALLER}),
}
"""What proves each."""


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prover, "EFFORTS", (10**5,))


@pytest.mark.slow
def test_a_premise_of_a_caller_that_a_function_does_not_keep_is_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """quotient() relies on what ratio() promises: with a false promise it has a proof, and ratio() has none.

    The promise stands in one place, ``is_ratio``, so neither can rely on another one.
    """
    is_ratio, code = arithmetic.is_ratio, program(HERE[0])
    monkeypatch.setattr(prover, "EFFORTS", (8 * 10**6,))
    monkeypatch.setattr(
        arithmetic,
        "is_ratio",
        lambda *numbers: z3.And(is_ratio(*numbers), 2**32 * numbers[0] == numbers[2]),
    )
    contracts = arithmetic.contracts(HERE[0])

    prover.prove_lemma(code, "quotient", contracts, set())
    with pytest.raises(UnprovenError, match="broken by"):
        prover.prove_lemma(code, "ratio", {**contracts, "ratio": replace(RATIO, steps=())}, set())


def test_a_side_effect_counts_on_the_path_of_the_code_that_has_it() -> None:
    """counted() of few_calls.c returns 1 for numbers above 7, 2 for those below 3, and 0 for others."""
    zero = z3.BitVecVal(0, 32)
    contract = Contract(
        lambda result, value: result == z3.If(large(value), 1, z3.If(z3.ULT(value, 3), 2, zero))
    )
    prove_counted = of_calls("counted", {"counted": contract})

    prove_counted()


@pytest.mark.parametrize("name", FALSEHOODS)
def test_falsehood_has_no_proof(name: str) -> None:
    with pytest.raises((UnprovenError, KeyError)):
        FALSEHOODS[name]()


def possible_by(key: Callable[[list[Any]], Any]) -> Callable[[Iterable[Claim]], None]:
    """prove_all(), which takes what is possible from another list with the same key."""

    def prove_all(claims: Iterable[Claim]) -> None:
        possible = set[Any]()
        for about, claim, known in claims:
            if key(known) not in possible:
                prover.require_possible(known, about)
            possible.add(key(known))
            prover.prove(claim, *known)

    return prove_all


ANSWER, STANDS_IN = prover._answer, Contract.stands_in


def unknown_is(answer: Any) -> Callable[..., tuple[Any, Any]]:
    def decided(*formulas: Any) -> tuple[Any, Any]:
        found, solver = ANSWER(*formulas)
        return answer if found == z3.unknown else found, solver

    return decided


def nothing(*_: Any, **__: Any) -> None:
    """In place of a check."""


SABOTAGES: tuple[tuple[str, Any, str, Any], ...] = (
    ("untrue", prover, "prove", nothing),
    ("not settled", prover, "_answer", unknown_is(z3.unsat)),
    ("possible", prover, "_answer", unknown_is(z3.sat)),
    ("possible for words", prover, "_answer", unknown_is(z3.sat)),
    ("from a contradiction in this sort", prover, "prove_all", possible_by(len)),
    ("from a contradiction in this sort", prover, "prove_all", possible_by(str)),
    ("from a contradiction in this sort", prover, "require_possible", nothing),
    ("no argument", prover, "require_possible", nothing),
    ("nothing claimed", prover, "prove_all", possible_by(len)),
    ("not defined", prover, "prove_obligations", nothing),
    ("not defined", Machine, "claim", nothing),
    ("too many turns", prover, "prove_obligations", nothing),
    ("duty", Contract, "stands_in", lambda self, name: STANDS_IN(replace(self, requires=always), name)),
    ("on another path", Machine, "know", lambda self, formula: self.facts.append(formula)),
    ("another contract", Contract, "__eq__", lambda *_: True),
    ("another lemma", Contract, "__eq__", lambda *_: True),
)
"""What passes; and what is replaced in which module or class, and by what."""


@pytest.mark.parametrize(("falsehood", "where", "name", "replacement"), SABOTAGES)
def test_a_prover_without_one_of_its_checks_proves_a_falsehood(
    falsehood: str, where: Any, name: str, replacement: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So each check is needed, and ``test_falsehood_has_no_proof`` fails when it is lost.

    ``replacement`` takes the place of the check, which has a name in a module or class.
    """
    monkeypatch.setattr(where, name, replacement)
    if name == "__eq__":
        monkeypatch.setattr(where, "__hash__", lambda _: 0)  # so that sets ask __eq__

    FALSEHOODS[falsehood]()
