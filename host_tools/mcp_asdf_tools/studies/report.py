"""The report of the paper's study: one page, the same in Markdown with its pictures, and every comparison."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common.figures import image_of
from mcp_asdf_tools.common.files import make_folder, write_atomically
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.scores import E_MAX
from mcp_asdf_tools.studies.bootstrap import RESAMPLES
from mcp_asdf_tools.studies.cells import StudyPart, StudySize, cells_of, experiment_of
from mcp_asdf_tools.studies.claims import LEVELS, QUESTIONS, SIZES, Decision
from mcp_asdf_tools.studies.figures import Picture, draw_pictures
from mcp_asdf_tools.studies.study_results import StudyResults
from mcp_asdf_tools.studies.verdicts import (
    CONFIDENCE,
    MOST_SHARE,
    REFUTED_SHARE,
    Comparison,
    Expectation,
    Verdict,
)

MARKS = {True: "\N{CHECK MARK}", False: "\N{BALLOT X}", None: "?"}
"""How a table shows that a comparison holds, fails or is open."""

EXPECTED_RANGES = {
    Expectation.ABOVE: "at least {:g}",
    Expectation.BELOW: "at most \N{MINUS SIGN}{:g}",
    Expectation.SAME: "within \N{PLUS-MINUS SIGN}{:g}",
    Expectation.NOT_ABOVE: "not above {:g}",
    Expectation.NOT_BELOW: "not below \N{MINUS SIGN}{:g}",
}
"""The range in which a difference is expected, to be filled with the size."""

CSV_COLUMNS = (
    "seed",
    "claim",
    "where",
    "part",
    "verdict",
    "cells",
    "expected",
    "size",
    "value",
    "low",
    "high",
    "holds",
)


def write_report(
    folder: Path, study_results: StudyResults, decisions: Sequence[Decision], study_size: StudySize
) -> None:
    """Write ``report.html``, which needs no other file, ``report.md`` with ``figures``, ``comparisons.csv``.

    Raises UsageError if that cannot be done.
    """
    pictures = list(draw_pictures(study_results, study_size))
    images = {
        f"figures/{picture.name}.png": image_of(picture.figure, Path(f"{picture.name}.png"))
        for picture in pictures
    }
    markdown = render_markdown(study_results, decisions, study_size, pictures)
    make_folder(folder / "figures")
    for name, image in images.items():
        write_atomically(folder / name, image)
    write_atomically(folder / "report.md", markdown)
    write_atomically(folder / "report.html", render_page(markdown, images))
    write_atomically(folder / "comparisons.csv", comparisons_as_csv(decisions, study_size))


def _fill_template(name: str, **context: Any) -> str:
    """Return one of the templates of this folder, filled in; a name that is missing is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 (loads slowly)

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the templates are Markdown, and all that is filled in is our own
    )
    return environment.get_template(name).render(context)


def render_markdown(
    study_results: StudyResults,
    decisions: Sequence[Decision],
    study_size: StudySize,
    pictures: Sequence[Picture],
) -> str:
    """Return the report in Markdown."""
    questions = {
        question: [decision for decision in decisions if decision.claim.name == claim_name]
        for claim_name, question in QUESTIONS.items()
    }
    markdown = _fill_template(
        "report.md.j2",
        study_size=study_size,
        decisions=decisions,
        decisions_by_part=_decisions_by_part(decisions),
        verdict_counts=Counter((decision.part_label, decision.verdict) for decision in decisions),
        answers={question: answers for question, answers in questions.items() if answers},
        parts=study_results.parts,
        runs=[_describe_run(study_part, study_size) for study_part in study_results.parts],
        versions=", ".join(f"{name} {version}" for name, version in software_versions().items()),
        pictures=pictures,
        Verdict=Verdict,
        heading_of=heading_of,
        summarize=summarize,
        comparison_table=comparison_table,
        marks=MARKS,
        sizes=SIZES,
        levels=LEVELS,
        confidence=CONFIDENCE,
        most_share=MOST_SHARE,
        refuted_share=REFUTED_SHARE,
        resamples=RESAMPLES,
        e_max=E_MAX,
    )
    # Empty cells of the template leave spaces at the ends of lines.
    return re.sub(r" +$", "", markdown, flags=re.MULTILINE)


def render_page(markdown: str, images: Mapping[str, bytes]) -> str:
    """Return the report as a page of HTML with the pictures in it; ``images`` are by their link."""
    from markdown_it import MarkdownIt  # noqa: PLC0415 (loads slowly)

    def embed_image(source: re.Match[str]) -> str:
        """Return the attribute of an image with its content in place of its link."""
        return f'src="data:image/png;base64,{base64.b64encode(images[source[1]]).decode()}"'

    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(markdown)
    return _fill_template("report.html.j2", body=re.sub(r'src="([^"]*)"', embed_image, body))


def _decisions_by_part(decisions: Sequence[Decision]) -> dict[str, list[Decision]]:
    """Group decisions by the label of their part: the equations first, then the paper's order."""
    # Jinja's groupby would sort by name; parts without decisions have no group.
    groups: dict[str, list[Decision]] = {}
    for study_part in (None, *StudyPart):
        decisions_of_part = [decision for decision in decisions if decision.study_part is study_part]
        if decisions_of_part:
            groups[decisions_of_part[0].part_label] = decisions_of_part
    return groups


def _describe_run(study_part: StudyPart, study_size: StudySize) -> list[object]:
    """Return a row of the table of what was run."""
    experiment = experiment_of(cells_of(study_part)[0], study_size)
    cell_count = len(cells_of(study_part))
    return [
        study_part.label,
        cell_count,
        experiment.robots,
        experiment.steps,
        study_size.trials,
        study_size.seed,
    ]


def heading_of(claim_name: str) -> str:
    """Return the heading of a claim: its name with spaces; symbols and names of filters as in the paper."""
    heading = claim_name.replace("_", " ").replace("b hat", "b_hat")
    heading = re.sub(r"\bp\b", "P", heading)
    heading = re.sub(r"\bplus\b", "ASDF+", heading)
    heading = re.sub(r"\bminus\b", "ASDF\N{MINUS SIGN}", heading)
    return heading[0].upper() + heading[1:]  # capitalize() would make b_hat and P lower-case


def comparison_table(decision: Decision) -> list[list[str]]:
    """Return a claim's comparisons as rows of text; the first row has the heads of the columns."""
    rows = list(dict.fromkeys(comparison.row for comparison in decision.comparisons))
    columns = list(dict.fromkeys(_column_head(comparison) for comparison in decision.comparisons))
    # Not every contrast has a comparison for every swarm: those cells stay empty.
    texts = {
        (comparison.row, _column_head(comparison)): " ".join(
            [MARKS[comparison.holds], format_difference(comparison)]
        )
        for comparison in decision.comparisons
    }
    return [["", *columns], *([row, *(texts.get((row, column), "") for column in columns)] for row in rows)]


def _column_head(comparison: Comparison) -> str:
    """Return what is compared, and the range in which it is expected."""
    return f"{comparison.column}: {EXPECTED_RANGES[comparison.expectation].format(comparison.size)}"


def format_difference(comparison: Comparison) -> str:
    """Format a difference with its interval; a number that is not subject to chance has none."""
    interval = comparison.interval
    # Scores have points and tenths; confidences, correlations and b_hat are small numbers of any size.
    layout = ".1f" if comparison.size >= SIZES["seen"] else ".3g"
    value, low, high = (format(number, layout).replace("-", "\N{MINUS SIGN}") for number in interval)
    return value if interval.low == interval.high else f"{value} [{low}, {high}]"


def summarize(decision: Decision) -> str:
    """Return how many comparisons hold, fail and are open, and the most and the least favourable of them."""
    total = len(decision.comparisons)
    counts = f"{decision.count(True)} of {total} hold"
    if decision.count(False):
        counts += f", {decision.count(False)} fail"
    if decision.count(None):
        counts += f", {decision.count(None)} open"
    # Sizes make comparisons of different measures comparable.
    ranked = sorted(decision.comparisons, key=_favour)
    worst, best = format_difference(ranked[0]), format_difference(ranked[-1])
    return f"{counts}; {best}" if total == 1 else f"{counts}; best {best}, worst {worst}"


def _favour(comparison: Comparison) -> float:
    """Return how far a difference lies on the side on which it is expected, in multiples of the size."""
    value = comparison.interval.value / comparison.size
    match comparison.expectation:
        case Expectation.SAME:
            return -abs(value)
        case Expectation.ABOVE | Expectation.NOT_BELOW:
            return value
        case _:
            return -value


def comparisons_as_csv(decisions: Sequence[Decision], study_size: StudySize) -> str:
    """Return a line of CSV for every comparison; verdicts are empty where none may be given."""
    csv_text = io.StringIO()
    writer = csv.writer(csv_text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for decision in decisions:
        # The columns of the claim are repeated in each line, so that any line can be read alone.
        verdict = decision.verdict.value if study_size.allows_verdicts else ""
        claim_columns = (
            study_size.seed,
            decision.claim.name,
            decision.claim.where,
            decision.part_label,
            verdict,
        )
        for comparison in decision.comparisons:
            numbers = (f"{number:.6g}" for number in (comparison.size, *comparison.interval))
            holds = {True: "yes", False: "no", None: "open"}[comparison.holds]
            expected = comparison.expectation.value
            writer.writerow([*claim_columns, comparison.label, expected, *numbers, holds])
    return csv_text.getvalue()


def decisions_as_json(decisions: Sequence[Decision], study_size: StudySize) -> list[dict[str, object]]:
    """Return claims and verdicts as plain values; a verdict is None where none may be given."""
    return [
        {
            "claim": decision.claim.name,
            "part": decision.study_part.value if decision.study_part else None,
            "verdict": decision.verdict.value if study_size.allows_verdicts else None,
            "numbers": summarize(decision),
        }
        for decision in decisions
    ]
