"""The report says what was decided, in pages, tables and values."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from matplotlib.figure import Figure

from host_tools.reproduction.test_claims import MadeUp
from mcp_asdf_tools.reproduction import report, resampling
from mcp_asdf_tools.reproduction.decisions import decide
from mcp_asdf_tools.reproduction.figures import Picture
from mcp_asdf_tools.reproduction.resampling import Estimate, exactly
from mcp_asdf_tools.reproduction.runs import Run
from mcp_asdf_tools.reproduction.study import PAPER, QUICK, Part, cells_of
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation, Finding, Place, Verdict


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resampling, "RESAMPLES", 50)


class Counted(MadeUp):
    """Made-up results of which a part has 30 or 60 trials."""

    def of(self, part: Part) -> list[Any]:
        return [SimpleNamespace(numbers=[0] * count) for count in (30, 45, 60)]


def run_of(seed: int, expression: str, *parts: Part) -> Run:
    study = Counted(expression, parts)
    decided = [
        each for each in decide(study, PAPER) if each.claim.name != "connected_estimates_are_identical"
    ]
    return Run(seed, study, decided)


def test_a_report_has_every_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With two seeds for one part and one for the other, in Markdown, HTML, CSV and values."""
    picture = Picture("one", "What it shows", Figure())
    runs = [run_of(1, "90 - P / 2", Part.DYNAMIC, Part.PHYSICAL), run_of(2, "40 + P / 2", Part.DYNAMIC)]
    monkeypatch.setattr(report, "pictures", lambda study, scale: [picture] * (study is runs[0].study))
    report.write_report(tmp_path, runs, PAPER)
    content, page = ((tmp_path / f"report.{kind}").read_text(encoding="utf-8") for kind in ("md", "html"))
    decided = runs[0].decided
    agree = sum(each.finding.verdict is Verdict.AGREE for each in decided)
    assert f"\n{agree} of {len(decided)} claims hold as the paper puts them.\n" in content
    assert "|---|---|---|---|---|\n| equations | " in content and " \n" not in content
    assert len(re.findall(r"\[(?:yes|no|in part)\]\(#", content)) == 7 + 1
    assert f"| dynamic | {len(cells_of(Part.DYNAMIC))} | 20 | 40000 | 30 to 60 | 1, 2 |\n" in content
    assert f"| physical | {len(cells_of(Part.PHYSICAL))} | 8 | 10000 | 30 to 60 | 1 |\n" in content
    values = {(each["claim"], each["part"]): each["verdict"] for each in report.as_values(runs[0], PAPER)}
    for each in decided:
        section = content.partition(f'<a id="{each.anchor}"></a>')[2].partition("<a id")[0]
        title = re.search(r"^#### .*: (\w+)$", section, re.M)
        assert title and title[1] == each.finding.verdict.value
        marks = [section.count(f"| {mark} ") for mark in "✓✗?"]
        assert marks == [each.finding.count(holds) for holds in (True, False, None)]
        assert f'"{each.claim.words}" ({each.claim.where})' in section
        assert report.numbers(each.finding) in section
        assert f"- [{report.heading(each.claim.name)}](#{each.anchor}): {title[1]}\n" in content
        assert f"\nCompared: {each.claim.compared}; " in section
        verdicts = [
            own.finding.verdict.value for run in runs for own in run.decided if own.anchor == each.anchor
        ]
        others = re.findall(r"^- Other seeds: (.*)\.$", section, re.M)
        assert others == (verdicts[1:] if each.part else [])
        readings = dict(re.findall(r'^- Read as "(.*)": (\w+)\.$', section, re.M))
        assert readings == {words: found.value for words, found in each.readings.items()}
        assert values[each.claim.name, each.part and each.part.value] == verdicts[0]
    with (tmp_path / "comparisons.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(each.finding.comparisons) for run in runs for each in run.decided)
    assert {row["verdict"] for row in rows} <= {verdict.value for verdict in Verdict}
    assert "![What it shows](figures/one.png)" in content
    assert re.findall(r'src="([^,"]*,iVBOR)', page) == ["data:image/png;base64,iVBOR"]
    assert (tmp_path / "figures/one.png").read_bytes().startswith(b"\x89PNG")
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)
    assert set(re.findall(r"\]\(#([^)]+)\)", content)) <= set(re.findall(r'<a id="([^"]+)">', content))
    report.write_report(tmp_path, runs, QUICK)
    assert "Too short for verdicts" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert {each["verdict"] for each in report.as_values(runs[0], QUICK)} == {None}


def test_headings_are_words_and_symbols_stay() -> None:
    names = (
        "low_b_hat_is_slow",
        "minus_holds_the_level",
        "short_runs_do_not_depend_on_p",
        "plus_and_surplus",
    )
    found = [report.heading(name).replace("\N{MINUS SIGN}", "-") for name in names]
    assert found == [
        "Low b_hat is slow",
        "ASDF- holds the level",
        "Short runs do not depend on P",
        "ASDF+ and surplus",
    ]


def test_numbers_are_the_best_and_the_worst() -> None:
    """By the side on which a difference is expected; what is exact has no interval."""
    place = Place("row", "column")
    rows = [(9, Expectation.ABOVE), (-9, Expectation.ABOVE), (-4, Expectation.BELOW), (1, Expectation.SAME)]
    found = [Comparison(place, exactly(value), expected, 2) for value, expected in rows]
    unsure = Comparison(place, Estimate(0.1, -0.25, 3), Expectation.NOT_BELOW, 0.2)
    for each, words in (
        (found, "3 of 4 hold, 1 fail; best 9.0, worst -9.0"),
        (found[1:], "2 of 3 hold, 1 fail; best -4.0, worst -9.0"),
        ([unsure], "0 of 1 hold; 0.1 [-0.25, 3]"),
        ([found[0], Comparison(place, exactly(3), Expectation.ABOVE, 0.2)], "2 of 2 hold; best 3, worst 9.0"),
        ([unsure, found[3]], "1 of 2 hold, 1 open; best 0.1 [-0.25, 3], worst 1.0"),
    ):
        assert report.numbers(Finding(each)).replace("\N{MINUS SIGN}", "-") == words
