"""The report of the paper's study: pages, tables and values."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from host_tools.studies.conftest import PlantedResults
from mcp_asdf_tools.studies import bootstrap, report
from mcp_asdf_tools.studies.bootstrap import Interval
from mcp_asdf_tools.studies.cells import StudyPart, StudySize
from mcp_asdf_tools.studies.claims import CLAIMS, IDENTICAL_ROBOTS, Decision, decide
from mcp_asdf_tools.studies.figures import Picture
from mcp_asdf_tools.studies.verdicts import Comparison, Expectation, Verdict, exact_comparison

PAPER_SIZE = StudySize()
SHORT_SIZE = StudySize(trials=10)
TRIED_CLAIMS = [claim for claim in CLAIMS if claim.name != IDENTICAL_ROBOTS]  # it needs real trials


@dataclass(frozen=True)
class WrittenReport:
    """A report of planted results for two parts of the study.

    Attributes:
        folder: Where it is.
        decisions: What it reports.
        markdown: ``report.md``.
        page: ``report.html``.
    """

    folder: Path
    decisions: Sequence[Decision]
    markdown: str
    page: str

    def section_of(self, decision: Decision) -> str:
        """Return the part of the Markdown about one claim."""
        return self.markdown.partition(f'<a id="{decision.anchor}"></a>')[2].partition("<a id")[0]


def write_planted_report(folder: Path, study_size: StudySize) -> WrittenReport:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bootstrap, "RESAMPLES", 50)
        bootstrap.resample_indices.cache_clear()
        picture = Picture("one", "What it shows", Figure())
        patch.setattr(report, "draw_pictures", lambda study_results, study_size: [picture])
        study_results = PlantedResults("90 - P / 2", [StudyPart.DYNAMIC, StudyPart.PHYSICAL])
        decisions = decide(study_results, TRIED_CLAIMS)
        report.write_report(folder, study_results, decisions, study_size)
    bootstrap.resample_indices.cache_clear()
    markdown, page = ((folder / f"report.{kind}").read_text(encoding="utf-8") for kind in ("md", "html"))
    return WrittenReport(folder, decisions, markdown, page)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> WrittenReport:
    return write_planted_report(tmp_path_factory.mktemp("report"), PAPER_SIZE)


def test_the_report_begins_with_how_many_claims_agree(written: WrittenReport) -> None:
    agreeing = sum(decision.verdict is Verdict.AGREE for decision in written.decisions)
    total = len(written.decisions)
    assert f"\n{agreeing} of {total} claims hold as the paper puts them.\n" in written.markdown


def test_the_report_counts_verdicts_for_each_part(written: WrittenReport) -> None:
    assert "| equations | 7 | 1 | 0 | 0 |\n" in written.markdown
    dynamic = [decision.verdict for decision in written.decisions if decision.study_part is StudyPart.DYNAMIC]
    counts = " | ".join(str(dynamic.count(verdict)) for verdict in Verdict)
    assert f"| dynamic | {counts} |\n" in written.markdown


def test_questions_of_a_user_are_answered_with_a_link(written: WrittenReport) -> None:
    answer = "[yes](#dynamic-flawed_robots_harm), 24 of 24"
    assert f"where f = b = 0.55? | {answer} |  |\n" in written.markdown


def test_the_report_says_what_was_run(written: WrittenReport) -> None:
    assert "| dynamic | 216 | 20 | 40000 | 30 | 1 |\n" in written.markdown
    assert "| physical | 20 | 8 | 10000 | 30 | 1 |\n" in written.markdown


def test_each_claim_has_its_verdict_in_its_heading(written: WrittenReport) -> None:
    for decision in written.decisions:
        heading = f"#### {report.heading_of(decision.claim.name)}: {decision.verdict.value}\n"
        assert heading in written.section_of(decision)


def test_each_claim_has_the_papers_words_and_ours(written: WrittenReport) -> None:
    for decision in written.decisions:
        section = written.section_of(decision)
        assert f'"{decision.claim.quote}" ({decision.claim.where})' in section
        assert f"\nCompared: {decision.claim.compared}; " in section
        assert report.summarize(decision) in section


def test_each_claim_has_a_mark_for_every_comparison(written: WrittenReport) -> None:
    for decision in written.decisions:
        marks = [written.section_of(decision).count(f"| {mark} ") for mark in "✓✗?"]
        assert marks == [decision.count(holds) for holds in (True, False, None)]


def test_every_link_has_its_target(written: WrittenReport) -> None:
    links = set(re.findall(r"\]\(#([^)]+)\)", written.markdown))
    assert links == set(re.findall(r'<a id="([^"]+)">', written.markdown))


def test_no_line_of_the_markdown_ends_in_a_space(written: WrittenReport) -> None:
    assert " \n" not in written.markdown


def test_pictures_are_files_beside_the_markdown(written: WrittenReport) -> None:
    assert "![What it shows](figures/one.png)" in written.markdown
    assert (written.folder / "figures/one.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_needs_no_other_file(written: WrittenReport) -> None:
    assert re.findall(r'src="([^,"]*,iVBOR)', written.page) == ["data:image/png;base64,iVBOR"]
    assert not re.search(r"(src|href)=\"(?!data:|#)", written.page)


def test_the_csv_has_a_line_for_every_comparison(written: WrittenReport) -> None:
    with (written.folder / "comparisons.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(decision.comparisons) for decision in written.decisions)
    row = next(row for row in rows if row["claim"] == "confidence_increases_with_b_hat")

    assert row == {
        "seed": "1",
        "claim": "confidence_increases_with_b_hat",
        "where": "III-A",
        "part": "equations",
        "verdict": "agree",
        "cells": "n/t 0.505: least ratio of alpha to that of a b_hat 0.005 lower, less 1",
        "expected": "above",
        "size": "1e-09",
        **dict.fromkeys(("value", "low", "high"), "0.0205123"),
        "holds": "yes",
    }


def test_claims_are_plain_values_for_programs(written: WrittenReport) -> None:
    values = report.decisions_as_json(written.decisions, PAPER_SIZE)
    value = next(value for value in values if value["claim"] == "confidence_increases_with_b_hat")

    assert value == {
        "claim": "confidence_increases_with_b_hat",
        "part": None,
        "verdict": "agree",
        "numbers": "3 of 3 hold; best 0.0205, worst 0.0205",
    }
    assert {value["part"] for value in values} == {None, "dynamic", "physical"}


def test_trials_that_are_too_few_get_no_verdict(tmp_path: Path) -> None:
    short = write_planted_report(tmp_path, SHORT_SIZE)
    assert "Too short for verdicts" in short.page
    assert ": agree" not in short.markdown
    verdicts = {value["verdict"] for value in report.decisions_as_json(short.decisions, SHORT_SIZE)}

    assert verdicts == {None}


@pytest.mark.parametrize(
    ("name", "heading"),
    [
        ("low_b_hat_is_slow", "Low b_hat is slow"),
        ("minus_holds_the_level", "ASDF\N{MINUS SIGN} holds the level"),
        ("short_runs_do_not_depend_on_p", "Short runs do not depend on P"),
        ("plus_and_surplus", "ASDF+ and surplus"),
    ],
)
def test_a_heading_has_the_papers_symbols(name: str, heading: str) -> None:
    assert report.heading_of(name) == heading


# --- Numbers ---------------------------------------------------------------------------------------------


def exact(value: float, expectation: Expectation = Expectation.ABOVE, study_size: float = 2) -> Comparison:
    return exact_comparison("row", "column", value, expectation, study_size)


OPEN = Comparison("row", "column", Interval(0.1, -0.25, 3), Expectation.NOT_BELOW, 0.2)
BELOW = exact(-4, Expectation.BELOW)
SAME = exact(1, Expectation.SAME)


@pytest.mark.parametrize(
    ("comparisons", "summary"),
    [
        ([exact(9), exact(-9), BELOW, SAME], "3 of 4 hold, 1 fail; best 9.0, worst -9.0"),
        ([exact(-9), BELOW, SAME], "2 of 3 hold, 1 fail; best -4.0, worst -9.0"),
        ([OPEN], "0 of 1 hold, 1 open; 0.1 [-0.25, 3]"),
        ([exact(9), exact(3, study_size=0.2)], "2 of 2 hold; best 3, worst 9.0"),
        ([OPEN, SAME], "1 of 2 hold, 1 open; best 0.1 [-0.25, 3], worst 1.0"),
    ],
)
def test_a_summary_has_the_most_and_the_least_favourable_comparison(
    comparisons: list[Comparison], summary: str
) -> None:
    decision = Decision(CLAIMS[0], StudyPart.DYNAMIC, tuple(comparisons))
    assert report.summarize(decision).replace("\N{MINUS SIGN}", "-") == summary


def test_a_table_has_a_row_for_each_swarm_and_a_column_for_each_contrast() -> None:
    decision = Decision(CLAIMS[0], StudyPart.DYNAMIC, (exact(9), BELOW))
    assert report.comparison_table(decision) == [
        ["", "column: at least 2", "column: at most \N{MINUS SIGN}2"],
        ["row", "✓ 9.0", "✓ \N{MINUS SIGN}4.0"],
    ]
