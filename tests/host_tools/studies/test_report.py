"""The report of the paper's study: pages, tables and values."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from host_tools.studies.conftest import PlantedResults, rare_resampling
from mcp_asdf_tools.studies import report
from mcp_asdf_tools.studies.bootstrap import Interval
from mcp_asdf_tools.studies.cells import StudyPart, StudySize
from mcp_asdf_tools.studies.claims import CLAIMS, IDENTICAL_ROBOTS, Claim, Decision, decide
from mcp_asdf_tools.studies.figures import Picture
from mcp_asdf_tools.studies.verdicts import Comparison, Expectation, Verdict, exact_comparison

PAPER_SIZE = StudySize()
TRIED_CLAIMS = [claim for claim in CLAIMS if claim.name != IDENTICAL_ROBOTS]  # it needs real trials
MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class WrittenReport:
    """A report of planted results for two parts of the study.

    Attributes:
        folder: Where it is.
        decisions: What it reports.
        markdown: The text of ``report.md``.
        html: The text of ``report.html``.
    """

    folder: Path
    decisions: Sequence[Decision]
    markdown: str
    html: str

    def section_of(self, decision: Decision) -> str:
        """Return the section of the Markdown about one claim, from its anchor to the next one."""
        _before, _anchor, text_from_section_on = self.markdown.partition(f'<a id="{decision.anchor}"></a>')
        section, _next_anchor, _after = text_from_section_on.partition("<a id")
        return section


def write_planted_report(folder: Path, study_size: StudySize, claims: Sequence[Claim]) -> WrittenReport:
    """Write a report on claims, with one picture, of results in which scores fall with the flawed robots."""
    picture = Picture(name="scores", title="Scores of dynamic swarms", figure=Figure())
    with rare_resampling(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "draw_pictures", lambda study_results, study_size: [picture])
        study_results = PlantedResults("90 - P / 2", [StudyPart.DYNAMIC, StudyPart.PHYSICAL])
        decisions = decide(study_results, claims)
        report.write_report(folder, study_results, decisions, study_size)
    markdown = (folder / "report.md").read_text(encoding="utf-8")
    html = (folder / "report.html").read_text(encoding="utf-8")
    return WrittenReport(folder, decisions, markdown, html)


@pytest.fixture(scope="module")
def planted_report(tmp_path_factory: pytest.TempPathFactory) -> WrittenReport:
    return write_planted_report(tmp_path_factory.mktemp("report"), PAPER_SIZE, TRIED_CLAIMS)


# --- Overview --------------------------------------------------------------------------------------------


def test_the_report_begins_with_how_many_claims_of_the_paper_hold(planted_report: WrittenReport) -> None:
    """The number stands in a sentence below the title."""
    verdicts = [decision.verdict for decision in planted_report.decisions]
    agreeing_count = verdicts.count(Verdict.AGREE)

    _title, _empty_line, sentence, *_rest = planted_report.markdown.splitlines()
    assert sentence == f"{agreeing_count} of {len(verdicts)} claims hold as the paper puts them."


def test_the_report_counts_the_verdicts_on_the_claims_that_equations_decide(
    planted_report: WrittenReport,
) -> None:
    """Equations decide eight claims: seven agree, one is mixed, none disagrees and none is undecided."""
    assert "| equations | 7 | 1 | 0 | 0 |\n" in planted_report.markdown


def test_the_report_answers_a_question_of_a_user_with_a_link_to_the_claim(
    planted_report: WrittenReport,
) -> None:
    """The question is whether flawed robots harm a swarm. All 24 comparisons of the claim hold.

    A table has it with an answer about dynamic swarms, and an empty cell for physical ones.
    """
    answer = "[yes](#dynamic-flawed_robots_harm), 24 of 24"
    assert f"where f = b = 0.55? | {answer} |  |\n" in planted_report.markdown


def test_the_report_says_how_many_experiments_robots_steps_and_trials_with_which_seed_were_run(
    planted_report: WrittenReport,
) -> None:
    """A line has the part of the study, then experiments, robots, steps, trials and seed.

    But for the seed, these are the paper's numbers.
    """
    assert "| dynamic | 216 | 20 | 40000 | 30 | 1 |\n" in planted_report.markdown
    assert "| physical | 20 | 8 | 10000 | 30 | 1 |\n" in planted_report.markdown


# --- Claims ----------------------------------------------------------------------------------------------


def test_the_heading_of_each_claim_in_the_report_has_its_verdict(planted_report: WrittenReport) -> None:
    for decision in planted_report.decisions:
        heading = report.heading_of(decision.claim.name)
        assert f"#### {heading}: {decision.verdict.value}\n" in planted_report.section_of(decision)


def test_the_section_of_each_claim_has_the_papers_words_what_was_compared_and_a_summary(
    planted_report: WrittenReport,
) -> None:
    """The words of the paper stand in quotation marks, with the place in the paper behind them."""
    for decision in planted_report.decisions:
        section = planted_report.section_of(decision)
        assert f'"{decision.claim.quote}" ({decision.claim.where})' in section
        assert f"\nCompared: {decision.claim.compared}; " in section
        assert report.summarize(decision) in section


def test_the_table_of_each_claim_has_a_mark_for_every_comparison(planted_report: WrittenReport) -> None:
    """A tick stands for one that holds, a cross for one that fails, a question mark for one that is open."""
    for decision in planted_report.decisions:
        section = planted_report.section_of(decision)
        assert section.count("| ✓ ") == decision.count(holds=True)
        assert section.count("| ✗ ") == decision.count(holds=False)
        assert section.count("| ? ") == decision.count(holds=None)


# --- Files -----------------------------------------------------------------------------------------------


def test_every_link_within_the_report_has_a_target_and_every_target_a_link(
    planted_report: WrittenReport,
) -> None:
    """A link of the Markdown is [text](#name), and its target is <a id="name">."""
    names_in_links = set(re.findall(r"\]\(#([^)]+)\)", planted_report.markdown))
    names_of_targets = set(re.findall(r'<a id="([^"]+)">', planted_report.markdown))
    assert names_in_links == names_of_targets


def test_no_line_of_the_report_in_markdown_ends_in_a_space(planted_report: WrittenReport) -> None:
    assert " \n" not in planted_report.markdown


def test_the_report_in_markdown_links_to_its_pictures_which_are_files(planted_report: WrittenReport) -> None:
    """The report has a single picture, with the name "scores" and the title that stands in brackets."""
    assert "![Scores of dynamic swarms](figures/scores.png)" in planted_report.markdown
    assert (planted_report.folder / "figures/scores.png").read_bytes().startswith(b"\x89PNG")


def test_the_report_in_html_contains_its_picture_and_needs_no_other_file(
    planted_report: WrittenReport,
) -> None:
    """The picture is written into the page in base64. Links may lead only to data, or into the page (#)."""
    first_letters_of_a_png = "iVBOR"  # in base64
    links_to_other_files = re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', planted_report.html)

    assert planted_report.html.count(f'src="data:image/png;base64,{first_letters_of_a_png}') == 1
    assert links_to_other_files == []


@pytest.fixture(scope="module")
def csv_rows(planted_report: WrittenReport) -> list[dict[str, str]]:
    """The lines of comparisons.csv, each as cells by the heads of their columns."""
    with (planted_report.folder / "comparisons.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_comparisons_csv_has_a_line_for_every_comparison_of_every_claim(
    planted_report: WrittenReport, csv_rows: list[dict[str, str]]
) -> None:
    """The column ``cells`` has the label of a comparison, which says which swarms are compared."""
    labels = []
    for decision in planted_report.decisions:
        labels += [comparison.label for comparison in decision.comparisons]
    assert [row["cells"] for row in csv_rows] == labels


def test_a_line_of_comparisons_csv_has_claim_verdict_expectation_and_interval(
    csv_rows: list[dict[str, str]],
) -> None:
    """The first line of a claim that equations decide. Both ends of the interval are its value."""
    rows_of_claim = [row for row in csv_rows if row["claim"] == "confidence_increases_with_b_hat"]
    first_row, *_others = rows_of_claim
    assert first_row == {
        "seed": "1",
        "claim": "confidence_increases_with_b_hat",
        "where": "III-A",
        "part": "equations",
        "verdict": "agree",
        "cells": "n/t 0.505: least ratio of alpha to that of a b_hat 0.005 lower, less 1",
        "expected": "above",
        "size": "1e-09",
        "value": "0.0205123",
        "low": "0.0205123",
        "high": "0.0205123",
        "holds": "yes",
    }


def test_decisions_for_json_have_claim_part_verdict_and_a_summary(planted_report: WrittenReport) -> None:
    """The part of the study is None for a claim that equations decide, and its name for other claims."""
    decisions = report.decisions_as_json(planted_report.decisions, PAPER_SIZE)
    [decision_by_equations] = [
        decision for decision in decisions if decision["claim"] == "confidence_increases_with_b_hat"
    ]

    assert decision_by_equations == {
        "claim": "confidence_increases_with_b_hat",
        "part": None,
        "verdict": "agree",
        "numbers": "3 of 3 hold",
    }
    assert {decision["part"] for decision in decisions} == {None, "dynamic", "physical"}


def test_the_report_gives_no_verdicts_by_fewer_trials_than_the_papers(tmp_path: Path) -> None:
    """The page says why, no claim is said to agree, and the verdicts in JSON are None."""
    ten_trials = StudySize(trials=10)  # the paper has 30
    some_claims = CLAIMS[:5]
    short_report = write_planted_report(tmp_path, ten_trials, some_claims)

    assert "Too short for verdicts" in short_report.html
    assert ": agree" not in short_report.markdown
    for decision in report.decisions_as_json(short_report.decisions, ten_trials):
        assert decision["verdict"] is None


# --- Text of a claim -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "heading"),
    [
        ("low_b_hat_is_slow", "Low b_hat is slow"),
        ("minus_holds_the_level", f"ASDF{MINUS} holds the level"),
        ("short_runs_do_not_depend_on_p", "Short runs do not depend on P"),
        ("plus_and_surplus", "ASDF+ and surplus"),
    ],
)
def test_the_heading_of_a_claim_is_its_name_with_the_papers_symbols(name: str, heading: str) -> None:
    """The name "minus_holds_the_level" becomes "ASDF- holds the level" with a real minus sign."""
    assert report.heading_of(name) == heading


HOLDS = exact_comparison("row", "column", 9, Expectation.ABOVE, size=2)
FAILS = exact_comparison("row", "column", -9, Expectation.ABOVE, size=2)
OPEN = Comparison("row", "column", Interval(0.1, low=-0.25, high=3), Expectation.NOT_BELOW, size=0.2)


@pytest.mark.parametrize(
    ("comparisons", "summary"),
    [
        ([HOLDS, HOLDS], "2 of 2 hold"),
        ([HOLDS, FAILS, HOLDS, FAILS], "2 of 4 hold, 2 fail"),
        ([HOLDS, FAILS, OPEN], "1 of 3 hold, 1 fail, 1 open"),
    ],
)
def test_the_summary_of_a_claim_counts_what_holds_and_what_fails_or_is_open_if_anything_does(
    comparisons: list[Comparison], summary: str
) -> None:
    any_claim, *_others = CLAIMS
    decision = Decision(any_claim, StudyPart.DYNAMIC, tuple(comparisons))
    assert report.summarize(decision) == summary


@pytest.mark.parametrize(
    ("comparison", "text"),
    [
        (HOLDS, "9.0"),
        (Comparison("", "", Interval(1.26, -2.5, 3), Expectation.ABOVE, size=2), f"1.3 [{MINUS}2.5, 3.0]"),
        (OPEN, f"0.1 [{MINUS}0.25, 3]"),  # of a size below those of scores: three significant digits
    ],
)
def test_a_difference_has_one_decimal_if_it_is_of_scores_and_an_interval_if_it_is_subject_to_chance(
    comparison: Comparison, text: str
) -> None:
    assert report.format_difference(comparison) == text


def test_the_table_of_a_claim_has_a_row_for_each_swarm_and_a_column_for_each_expectation() -> None:
    """Two comparisons of a swarm's score expect a rise of at least 2, and a fall of at least 2.

    A tick says that they hold.
    """
    rise = exact_comparison("swarm", "score", value=9, expectation=Expectation.ABOVE, size=2)
    fall = exact_comparison("swarm", "score", value=-4, expectation=Expectation.BELOW, size=2)
    any_claim, *_others = CLAIMS

    table = report.comparison_table(Decision(any_claim, StudyPart.DYNAMIC, (rise, fall)))

    assert table.splitlines() == [
        f"|  | score: at least 2 | score: at most {MINUS}2 |",
        "|---|---|---|",
        f"| swarm | ✓ 9.0 | ✓ {MINUS}4.0 |",
    ]
