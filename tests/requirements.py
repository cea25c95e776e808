"""Requirements: the numbered statements of docs/design.md, and the tests and proofs that show each.

A statement ends with its number, ``<sup>R7</sup>``. A comment ``design: R7, R8`` stands above each test, in
Python or C, and above each contract and set of claims, that fails if a statement does not hold.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from support import ROOT

NUMBER = re.compile(r"<sup>(R\d+)</sup>")
_BEGIN = re.compile(r"\n\s*\n|^\d\. |^- |</sup>", re.MULTILINE)
_TAG = re.compile(r"(?:#|/\*) design: (R\d+(?:, R\d+)*)")
_SHOWN_BY = re.compile(r"^(?:def |static void )?(\w+)(?:\(| = Contract\()", re.MULTILINE)


def statements(page: str) -> dict[str, str]:
    """Each numbered statement by its number: the text since the paragraph, item or last number began."""
    found = {}
    for number in NUMBER.finditer(page):
        *_, begin = _BEGIN.finditer(page, 0, number.start())
        found[number[1]] = " ".join(page[begin.end() : number.start()].split()).lstrip(".; ")
    return found


def traced(files: Iterable[Path], folder: Path = ROOT / "tests") -> dict[str, list[str]]:
    """The tests and proofs that name each number, as ``path: name``."""
    found: dict[str, list[str]] = {}
    for path in files:
        text = path.read_text(encoding="utf-8")
        for tag in _TAG.finditer(text):
            test = _SHOWN_BY.search(text, tag.end())
            for number in tag[1].split(", "):
                place = f"{path.relative_to(folder)}: {test[1] if test else 'no test'}"
                found.setdefault(number, []).append(place)
    return found


def problems(stated: Mapping[str, str], shown: Mapping[str, list[str]]) -> list[str]:
    """What is wrong with the trace, one line each."""
    untested = [f"{number} has no test: {stated[number]}" for number in stated.keys() - shown.keys()]
    unknown = [f"{shown[number][0]} names {number}, which is none" for number in shown.keys() - stated.keys()]
    lost = [place for places in shown.values() for place in places if place.endswith(": no test")]
    return sorted([*untested, *unknown, *lost])


def here() -> tuple[dict[str, str], dict[str, list[str]]]:
    """Statements and tests of this project."""
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    files = [path for suffix in ("py", "c") for path in sorted((ROOT / "tests").rglob(f"*.{suffix}"))]
    return statements(page), traced(files)


def table() -> str:
    """The trace in Markdown."""
    stated, shown = here()
    rows = ["| | statement | tests | proofs |", "|---|---|---|---|"]
    for number, text in stated.items():
        tests, proofs = (
            "<br>".join(f"`{each}`" for each in shown[number] if each.startswith("proofs/") == is_proof)
            for is_proof in (False, True)
        )
        rows.append(f"| {number} | {text.replace('|', '&#124;')} | {tests} | {proofs} |")
    return "\n".join([*rows, ""])
