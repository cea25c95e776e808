"""Small mistakes in the mirror and in the exact oracle are noticed: some at random, all by the command."""

from __future__ import annotations

import random

import pytest

from mutation.equivalents import equivalents
from mutation.python_mutants import MIRROR, ORACLES, Mutant, dies, mutants, sample, source
from support import DRAWS_ALL

SAMPLE = {MIRROR: 60, ORACLES[0]: 20, ORACLES[1]: 20}
SURVIVE = {MIRROR: 0, ORACLES[0]: 2, ORACLES[1]: 2}
"""At most so many. The cross-check is the same after an edit; the oracles' tests then draw other numbers."""


@pytest.mark.slow
@pytest.mark.parametrize("module", SAMPLE)
def test_each_mutant_has_a_name_of_its_own_and_other_code(module: str) -> None:
    found = list(mutants(module))
    assert len(found) > 200 and len({each.name for each in found}) == len({each.code for each in found})
    assert all(" => " in each.name for each in found)


@pytest.mark.slow
def test_each_equivalent_mutant_is_a_mutant() -> None:
    assert set(equivalents("python")) <= {each.name for module in SAMPLE for each in mutants(module)}


@pytest.mark.slow
@pytest.mark.parametrize("module", [MIRROR, ORACLES[1]])
def test_what_is_not_changed_passes(module: str) -> None:
    assert not dies(Mutant(module, "", source(module).read_text(encoding="utf-8")))


@pytest.mark.slow
@pytest.mark.parametrize("draws_all", [True, False])
def test_random_tests_notice_too(draws_all: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake that only tests with random cases notice, which are slow where all cases are drawn."""
    monkeypatch.delenv(DRAWS_ALL, raising=False)
    if draws_all:
        monkeypatch.setenv(DRAWS_ALL, "1")
    found = next(each for each in mutants(ORACLES[0]) if "Fraction(1) if d < UNINFORMATIVE" in each.name)
    assert dies(found)


@pytest.mark.slow
@pytest.mark.parametrize("module", SAMPLE)
def test_some_mistakes_are_noticed(module: str) -> None:
    seed = random.randrange(1 << 32)
    print(f"python -m mutation.python_mutants {module} --sample {SAMPLE[module]} --seed {seed}")
    survive = [each.name for each in sample(module, SAMPLE[module], seed) if not dies(each)]
    print(*survive, sep="\n")
    assert len(survive) <= SURVIVE[module]
