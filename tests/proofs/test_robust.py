"""The robust filter is what its section of the design says, and decides as exact arithmetic does: for all
states."""

from __future__ import annotations

import pytest

from proofs import robust
from proofs.core import CORE
from proofs.formulas import BY_LEMMA, RESULTS, Claims
from proofs.prove import prove_all, prove_lemma
from proofs.source import VARIANTS, program
from support import slow


@pytest.mark.parametrize("name", [*sorted(set(robust.CONTRACTS) - {"vote"}), *slow(["vote"])])
def test_lemma(name: str) -> None:
    done: set[str] = set()
    for variant in VARIANTS:
        prove_lemma(program(variant, CORE), name, robust.CONTRACTS[name], done)
    assert done


@pytest.mark.parametrize("name", robust.OF_THE_CODE)
def test_the_code_is_that_of_the_design(name: str) -> None:
    done = set[str]()
    for variant in VARIANTS:
        code = program(variant, CORE)
        text = code.text(name, {*RESULTS, *BY_LEMMA} - {name})
        if text not in done:
            prove_all(robust.OF_THE_CODE[name](code))
        done.add(text)
    assert done


@pytest.mark.parametrize("claims", robust.OF_THE_NUMBERS)
def test_the_decision_is_right_but_for_a_margin(claims: Claims) -> None:
    prove_all(claims())
