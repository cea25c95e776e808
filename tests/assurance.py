"""Figures of the assurance case in docs/trust.md, counted where the evidence is.

PYTHONPATH=tests python -m assurance

Writes them into the page; nothing is measured.
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.cost.report import fill
from mutation.c_mutants import MUTATED, mutants
from mutation.equivalents import equivalents
from proofs import accuracy, arithmetic, core, sums
from proofs.source import VARIANTS, program
from support import ROOT

PAGE = ROOT / "docs/trust.md"
MARKER = "assurance figures"


def _of_proofs() -> Iterator[tuple[str, str]]:
    named = {each for variant in VARIANTS for room in (arithmetic, core) for each in room.contracts(variant)}
    yield "functions with a lemma, and variants of the code", f"{len(named)}, {len(VARIANTS)}"
    code = program(VARIANTS[0], core.CORE)
    of_code = sum(1 for claims in (*accuracy.OF_THE_CODE, *sums.OF_THE_CODE) for _ in claims(code))
    of_numbers = sum(1 for claims in (*accuracy.OF_THE_NUMBERS, *sums.OF_THE_NUMBERS) for _ in claims())
    yield "claims of sums and errors: of the code, of the numbers", f"{of_code}, {of_numbers}"


def _of_tests() -> Iterator[tuple[str, str]]:
    mistakes, harmless = sum(1 for file in MUTATED for _ in mutants(file)), len(equivalents("c"))
    yield "mistakes made in the C, and those of them that make no difference", f"{mistakes}, {harmless}"
    corpora = sorted((ROOT / "tests/fuzz/corpus").glob("*.txt"))
    kept = [f"{each.stem} {len(each.read_text(encoding='ascii').split())}" for each in corpora]
    yield "fuzzers' inputs that every test run replays", ", ".join(kept)


def section() -> str:
    """The table between the markers."""
    rows = (*_of_proofs(), *_of_tests())
    return "\n".join(["| counted | |", "|---|---|", *(f"| {what} | {count} |" for what, count in rows)])


def filled(page: str) -> str:
    """The page's text with the figures as they are now."""
    return fill(page, {MARKER: section()})


def main() -> None:
    """Write the page."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
