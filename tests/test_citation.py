"""Every place that cites the paper gives its exact title and its arXiv number."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from support import ROOT, require, run

TITLE = "Adaptive Self-Calibration for Minimalistic Collective Perception by Imperfect Robot Swarms"
NUMBER = "2410.21546"
WRONG_TITLE = "Minimalistic Collective Perception with an Adaptive Sensor Degradation Filter"
"""Cited here for a while."""

CITING = {"CITATION.cff", "README.md", "c_ref/README.md", "c_ref/src/mcp_asdf.h", "docs/design.md"}
"""At least these cite the paper."""

COMMENT_MARKER = re.compile(r"^[ \t]*(?:/\*+|\*+/|\*(?=\s)|//+|#+|>+|%+|--)?[ \t]*", re.MULTILINE)
ARXIV = re.compile(r"arxiv\D{0,20}(\d{4}\.\d+)", re.IGNORECASE)
TITLE_WORDS = re.compile(
    r"Adaptive [Ss]elf[- ]?[Cc]alibration"
    r"|Imperfect [Rr]obot [Ss]warm"
    r"|Minimalist\w* [Cc]ollective [Pp]erception(?! \()"  # "... (MCP)" spells out the abbreviation
)
"""Left once the exact title is taken out, these belong to a wrong one. A title keeps its capitals."""

MARKED = r'["“*{\[]([A-Z][^"“”*{}\[\]]*[^\s"“”*{}\[\]])["”*}\]]'
"""Marks around a title: quotation marks, emphasis, braces or the text of a link."""
BETWEEN = r'[^"“”*}\]]{0,80}'
BESIDE_ARXIV = (
    re.compile(rf"{MARKED}{BETWEEN}arxiv", re.IGNORECASE),
    re.compile(rf"arxiv\D{{0,20}}\d{{4}}\.\d+{BETWEEN}{MARKED}", re.IGNORECASE),
)


def plain(text: str) -> str:
    """The text on one line: comment markers gone, each run of white space one space."""
    return " ".join(COMMENT_MARKER.sub("", text).split())


def cites(text: str) -> bool:
    return TITLE in plain(text) or ARXIV.search(text) is not None


def mistakes(text: str) -> list[str]:
    """Every number and title in the text that is wrong."""
    line = plain(text)
    numbers = [number for number in ARXIV.findall(line) if number != NUMBER]
    words = TITLE_WORDS.findall(line.replace(TITLE, ""))
    beside = [found.strip(" ,.") for pattern in BESIDE_ARXIV for found in pattern.findall(line)]
    titles = [found for found in beside if len(found.split()) > 3 and found[0].isupper() and found != TITLE]
    return numbers + words + titles


def project_files() -> dict[str, str]:
    """The text of every file of the project, by path."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listed = run(require("git", "git"), "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    paths = [ROOT / name for name in listed.split("\0") if name]
    here = Path(__file__).resolve()
    found = {}
    for path in paths:
        if path.is_file() and path != here:
            found[str(path.relative_to(ROOT))] = path.read_text(encoding="utf-8", errors="replace")
    return found


def test_every_file_cites_the_paper_correctly() -> None:
    files = project_files()
    assert {name for name, text in files.items() if cites(text)} >= CITING
    wrong = {name: mistakes(text) for name, text in files.items()}
    assert {name: found for name, found in wrong.items() if found} == {}


def test_citation_file_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    papers = [citation["preferred-citation"], *citation["references"]]
    for paper in papers:
        assert paper["title"] == TITLE
        assert paper["notes"] == f"arXiv:{NUMBER}"
        assert paper["url"] == f"https://arxiv.org/abs/{NUMBER}"
        assert [author["family-names"] for author in paper["authors"]] == ["Chin", "Pinciroli"]


@pytest.mark.parametrize(
    "text",
    [
        f"{TITLE}, arXiv {NUMBER}",
        f'/* The method of "{TITLE.replace(" by ", chr(10) + " * by ")}"\n * (arXiv {NUMBER}); "eq." is */',
        f"*{TITLE}* (K. Y. Chin, C. Pinciroli, arXiv {NUMBER})",
        f"# {TITLE.replace(' for ', chr(10) + '#   for ')}\n# https://arxiv.org/abs/{NUMBER}v2",
        f"MCP-ASDF, [arXiv {NUMBER}](https://arxiv.org/abs/{NUMBER}).",
        f"[the paper that this implements](https://arxiv.org/abs/{NUMBER})",
        "Minimalistic Collective Perception (MCP) and an Adaptive Sensor Degradation Filter (ASDF)",
        f'puts("No title in a few words"); /* Text of a comment */ /* arXiv {NUMBER} */',
    ],
)
def test_right_citations_pass(text: str) -> None:
    assert mistakes(text) == []


@pytest.mark.parametrize(
    "text",
    [
        WRONG_TITLE,
        f'"{WRONG_TITLE.replace(" with ", chr(10) + " * with ")}" (arXiv {NUMBER})',
        TITLE.replace("Minimalistic", "Minimalist"),
        TITLE.replace("Swarms", "Teams"),
        TITLE.replace("Self-Calibration", "self calibration"),
        f"{TITLE}, arXiv 2410.21564",
        f"{TITLE} <https://arxiv.org/abs/2401.21546>",
        f"doi:10.48550/arXiv.2410.2154, {TITLE}",
        f"*Swarms that perceive their world together* (arXiv {NUMBER})",
        f"“Swarms that perceive their world together,” [arXiv {NUMBER}](https://arxiv.org/abs/{NUMBER})",
        f'arXiv:{NUMBER}, "Swarms that perceive\n * their world together"',
        f"[Swarms that perceive their world](https://arxiv.org/abs/{NUMBER})",
        f"title = {{Swarms that perceive their world}}, eprint = {{arXiv:{NUMBER}}}",
    ],
)
def test_wrong_citations_fail(text: str) -> None:
    assert mistakes(text) != []
