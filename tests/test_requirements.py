"""Every numbered statement of the design has a test, and every test names statements that are there."""

from __future__ import annotations

import itertools
from importlib import import_module
from pathlib import Path

from requirements import (
    NUMBER,
    find_problems,
    find_statements,
    format_table_of_project,
    read_project,
    trace_files,
)
from support import ROOT


def test_every_statement_of_the_design_has_a_test() -> None:
    """A test names its statements in a comment, such as "design: R1". No other numbers stand there."""
    statements, tests_by_statement = read_project()
    assert find_problems(statements, tests_by_statement) == []


def test_statements_of_the_design_are_numbered_in_order() -> None:
    """Their numbers in docs/design.md are R1, R2 and so on."""
    numbers = NUMBER.findall((ROOT / "docs/design.md").read_text(encoding="utf-8"))
    assert len(numbers) > 30
    assert numbers == [f"R{index}" for index in range(1, len(numbers) + 1)]


def test_the_table_has_a_row_for_every_statement() -> None:
    """It is built into docs/internals/trust.md."""
    statements, _tests_by_statement = read_project()
    table = format_table_of_project()
    for number in statements:
        assert f"| {number} |" in table


def contracts_that_are_proved() -> set[str]:
    """Return the contracts that tests/proofs proves, in the form of a trace: "proofs/FILE.py: VARIABLE"."""
    places = set[str]()
    for module_name in ("calls", "robust"):
        module = import_module(f"proofs.{module_name}")
        for name, value in vars(module).items():
            if any(value is contract for contract in module.CONTRACTS.values()):
                places.add(f"proofs/{module_name}.py: {name}")
    return places


def test_every_contract_that_is_named_beside_a_statement_is_proved() -> None:
    """A place below ``proofs`` that is named beside a statement is a contract or a test."""
    _statements, tests_by_statement = read_project()
    places = itertools.chain.from_iterable(tests_by_statement.values())  # such as "a.py: test_it"
    named_contracts = {place for place in places if place.startswith("proofs/") and ": test_" not in place}
    assert len(named_contracts) > 8

    assert named_contracts <= contracts_that_are_proved()


# --- How statements and tests are found ------------------------------------------------------------------


def test_a_statement_begins_after_a_paragraph_an_item_or_a_number() -> None:
    """It ends with its number, and may be broken into lines."""
    page = "## 1. Calls\n\nIt counts.<sup>R1</sup> It\nstops.<sup>R2</sup>\n\n1. It halves.<sup>R3</sup>\n"
    assert find_statements(page) == {"R1": "It counts.", "R2": "It stops.", "R3": "It halves."}


def test_a_test_belongs_to_the_statements_whose_numbers_stand_in_the_comment_above_it(tmp_path: Path) -> None:
    """Statements have numbers, R1 and so on. A comment without a test below it is found as "no test"."""
    comment = "# " + "design:"  # in one piece, it would be a comment of this file
    (tmp_path / "a.py").write_text(
        f"{comment} R1, R4\n@mark\ndef test_it() -> None:\n    pass\n\n\n{comment} R2\nA = 1\n"
    )

    tests_by_statement = trace_files([tmp_path / "a.py"], folder=tmp_path)

    assert tests_by_statement == {"R1": ["a.py: test_it"], "R4": ["a.py: test_it"], "R2": ["a.py: no test"]}


def test_statements_without_tests_and_tests_without_statements_are_problems() -> None:
    """R3 has no test, and R4 is no statement. "no test" is a comment for R2 without a test below it."""
    statements = {"R1": "It counts.", "R2": "It stops.", "R3": "It halves."}
    tests_by_statement = {"R1": ["a.py: test_it"], "R4": ["a.py: test_it"], "R2": ["a.py: no test"]}

    assert find_problems(statements, tests_by_statement) == [
        "R3 has no test: It halves.",
        "a.py: no test",
        "a.py: test_it names R4, which is none",
    ]
