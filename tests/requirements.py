"""Requirements: the numbered statements of docs/design.md, and the tests and proofs that show each.

A statement ends with its number, ``<sup>R7</sup>``. A comment ``design: R7, R8`` stands above each test, in
Python or C, and above each contract and set of claims, that fails if a statement does not hold.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from support import ROOT, matching_files

TESTS = ROOT / "tests"
NUMBER = re.compile(r"<sup>(R\d+)</sup>")
_BEGIN_OF_STATEMENT = re.compile(r"\n\s*\n|^\d\. |^- |</sup>", re.MULTILINE)
_TAG = re.compile(r"(?:#|/\*) design: (R\d+(?:, R\d+)*)")
_TEST_OR_PROOF = re.compile(r"^(?:def |static void )?(\w+)(?:\(| = Contract\()", re.MULTILINE)

Statements = dict[str, str]
"""Texts by number."""
Trace = dict[str, list[str]]
"""Tests and proofs by the number of the statement that they show, each as ``path: name``."""


def find_statements(page: str) -> Statements:
    """Return the numbered statements of a page in Markdown.

    A statement is the text since its paragraph or its item began, or since the last number.
    """
    statements = {}
    for number in NUMBER.finditer(page):
        *_, begin = _BEGIN_OF_STATEMENT.finditer(page, 0, number.start())
        statements[number[1]] = " ".join(page[begin.end() : number.start()].split()).lstrip(".; ")
    return statements


def trace_files(files: Iterable[Path], folder: Path = TESTS) -> Trace:
    """Return the tests and proofs below the comments of these files; paths are relative to ``folder``.

    A comment without a test or proof below it is traced as ``path: no test``.
    """
    trace: Trace = {}
    for path in files:
        text = path.read_text(encoding="utf-8")
        for tag in _TAG.finditer(text):
            test = _TEST_OR_PROOF.search(text, tag.end())
            place = f"{path.relative_to(folder)}: {test[1] if test else 'no test'}"
            for number in tag[1].split(", "):
                trace.setdefault(number, []).append(place)
    return trace


def find_problems(statements: Mapping[str, str], trace: Mapping[str, list[str]]) -> list[str]:
    """Return what is wrong with a trace, one line each.

    Wrong are statements without a test, numbers of no statement, and comments without a test below.
    """
    problems = []
    for number in statements.keys() - trace.keys():
        problems.append(f"{number} has no test: {statements[number]}")
    for number, places in trace.items():
        if number not in statements:
            first_place, *_ = places
            problems.append(f"{first_place} names {number}, which is none")
        problems += [place for place in places if place.endswith(": no test")]
    return sorted(problems)


def read_project() -> tuple[Statements, Trace]:
    """Return the statements of docs/design.md, and the trace of all tests of the project."""
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    files = [path for suffix in ("py", "c") for path in matching_files(TESTS, f"**/*.{suffix}")]
    return find_statements(page), trace_files(files)


def format_table(statements: Mapping[str, str], trace: Mapping[str, list[str]]) -> str:
    """Return a table in Markdown: each statement with its tests and its proofs."""
    rows = ["| | statement | tests | proofs |", "|---|---|---|---|"]
    for number, text in statements.items():
        places = trace[number]
        tests = "<br>".join(f"`{place}`" for place in places if not place.startswith("proofs/"))
        proofs = "<br>".join(f"`{place}`" for place in places if place.startswith("proofs/"))
        rows.append(f"| {number} | {text.replace('|', '&#124;')} | {tests} | {proofs} |")
    return "\n".join([*rows, ""])


def format_table_of_project() -> str:
    """Return the table of this project's statements, for docs/internals/trust.md.

    Links in the statements start at docs/design.md, and are made to start at that page.
    """
    table = format_table(*read_project())
    table = table.replace("](#", "](../design.md#")
    return re.sub(r"\]\((?=\w+\.md)", "](../", table)
