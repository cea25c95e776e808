"""The report of the paper's study: one page, the same in Markdown with its pictures, and every comparison."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common.figures import image_of
from mcp_asdf_tools.common.files import make_folder, write_atomically
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.scores import E_MAX
from mcp_asdf_tools.studies.bootstrap import RESAMPLES
from mcp_asdf_tools.studies.cells import (
    SHORTEST_FILTER_PERIOD,
    StudyPart,
    StudySize,
    cells_of,
    experiment_of,
)
from mcp_asdf_tools.studies.claims import LEVELS, QUESTIONS, SIZES, Decision
from mcp_asdf_tools.studies.figures import Picture, draw_pictures
from mcp_asdf_tools.studies.study_results import StudyResults
from mcp_asdf_tools.studies.text_tables import format_cells, format_table
from mcp_asdf_tools.studies.verdicts import (
    CONFIDENCE,
    MOST_SHARE,
    REFUTED_SHARE,
    Comparison,
    Expectation,
    Verdict,
)

MARK_OF_OUTCOME = {True: "\N{CHECK MARK}", False: "\N{BALLOT X}", None: "?"}
"""How a table shows that a comparison holds, fails or is open."""

EXPECTED_RANGES = {
    Expectation.ABOVE: "at least {:g}",
    Expectation.BELOW: "at most \N{MINUS SIGN}{:g}",
    Expectation.SAME: "within \N{PLUS-MINUS SIGN}{:g}",
    Expectation.NOT_ABOVE: "not above {:g}",
    Expectation.NOT_BELOW: "not below \N{MINUS SIGN}{:g}",
}
"""The range in which a difference is expected, with a field for the smallest difference that counts."""

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
    """Write the report of the study into a folder, which is made if it does not exist.

    The files are ``report.html``, which needs no other file, the same as ``report.md`` with its pictures in
    ``figures/``, and ``comparisons.csv``, a line for every comparison. Raises UsageError if they cannot be
    written. What can fail, the pictures and the Markdown, is made before the first file is written.
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
    """Return the text of one of the templates of this folder.

    Its variables are those of ``context`` and of _TEMPLATE_GLOBALS, by name. Raises jinja2's UndefinedError
    for any other.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 (loads slowly)

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the templates are Markdown, and all that is filled in is our own
    )
    return environment.get_template(name, globals=_TEMPLATE_GLOBALS).render(context)


def render_markdown(
    study_results: StudyResults,
    decisions: Sequence[Decision],
    study_size: StudySize,
    pictures: Sequence[Picture],
) -> str:
    """Return the report in Markdown, with links to the pictures in ``figures/``."""
    markdown = _fill_template(
        "report.md.j2",
        study_size=study_size,
        decisions=decisions,
        decisions_by_part=_decisions_by_part(decisions),
        answers_by_question=_answers_by_question(decisions),
        parts=study_results.parts,
        table_of_runs=_table_of_runs(study_results.parts, study_size),
        versions=", ".join(f"{name} {version}" for name, version in software_versions().items()),
        pictures=pictures,
        users_name=study_results.users_name,
    )
    # Empty cells of the template leave spaces at the ends of lines.
    return re.sub(r" +$", "", markdown, flags=re.MULTILINE)


def render_page(markdown: str, images: Mapping[str, bytes]) -> str:
    """Return the report as an HTML page that contains its pictures.

    ``images`` has the PNG of every picture by its link in the Markdown, such as "figures/series.png".
    """
    from markdown_it import MarkdownIt  # noqa: PLC0415 (loads slowly)

    def embed_image(link_attribute: re.Match[str]) -> str:
        """Return the attribute src of an image with its content, in base64, in place of its link."""
        image_text = base64.b64encode(images[link_attribute[1]]).decode()
        return f'src="data:image/png;base64,{image_text}"'

    # The Markdown has the targets of its links as HTML, and tables, which CommonMark lacks.
    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(markdown)
    body_with_images = re.sub(r'src="([^"]*)"', embed_image, body)
    return _fill_template("report.html.j2", body=body_with_images)


def _decisions_by_part(decisions: Sequence[Decision]) -> dict[str, list[Decision]]:
    """Group decisions by the label of their part of the study, such as "dynamic" or "equations".

    The equations come first, then the parts in the paper's order; parts without decisions are left out.
    """
    groups: dict[str, list[Decision]] = {}  # Jinja's groupby would sort the parts by name
    for study_part in (None, *StudyPart):
        decisions_of_part = [decision for decision in decisions if decision.study_part is study_part]
        if decisions_of_part:
            groups[decisions_of_part[0].part_label] = decisions_of_part
    return groups


def _answers_by_question(decisions: Sequence[Decision]) -> dict[str, list[Decision]]:
    """Return the decisions that answer the questions of users, by question.

    A question is answered by the decisions on the claim that has it in QUESTIONS; each part of the study that
    the claim is about has one. Questions without an answer are left out.
    """
    answers_by_question: dict[str, list[Decision]] = {}
    for claim_name, question in QUESTIONS.items():
        answers = [decision for decision in decisions if decision.claim.name == claim_name]
        if answers:
            answers_by_question[question] = answers
    return answers_by_question


def _table_of_runs(parts: Sequence[StudyPart], study_size: StudySize) -> str:
    """Return the table of the experiments that were run, in Markdown; each part of the study has a row."""
    rows: list[list[object]] = []
    for study_part in parts:
        cells = cells_of(study_part)
        # All experiments of a part have as many robots and steps as its first one.
        first = experiment_of(cells[0], study_size)
        rows.append(
            [study_part.label, len(cells), first.robots, first.steps, study_size.trials, study_size.seed]
        )
    return format_table(["part", "experiments", "robots", "steps", "trials of each", "seed"], rows)


def heading_of(claim_name: str) -> str:
    """Return a claim's heading: its name with spaces, a capital, and the paper's symbols.

    Of "short_runs_do_not_depend_on_p", for example, this is "Short runs do not depend on P".
    """
    heading = claim_name.replace("_", " ").replace("b hat", "b_hat")
    # Only whole words are symbols: p, but not the p in period.
    heading = re.sub(r"\bp\b", "P", heading)
    heading = re.sub(r"\bplus\b", "ASDF+", heading)
    heading = re.sub(r"\bminus\b", "ASDF\N{MINUS SIGN}", heading)
    return heading[0].upper() + heading[1:]  # capitalize() would make b_hat and P lower-case


def comparison_table(decision: Decision) -> str:
    """Return a claim's comparisons as a table in Markdown; each says in which row and column it belongs.

    The cell of a comparison has a mark of MARK_OF_OUTCOME and the difference with its interval. Cells of
    which the claim has no comparison are empty.
    """
    text_by_cell: dict[tuple[str, str], str] = {}
    for comparison in decision.comparisons:
        mark = MARK_OF_OUTCOME[comparison.holds]
        text = f"{mark} {format_difference(comparison)}"
        text_by_cell[comparison.row, _column_head(comparison)] = text
    return format_cells("", text_by_cell)


def _column_head(comparison: Comparison) -> str:
    """Return the head of a comparison's column: its label, and the range of the expected difference."""
    expected_range = EXPECTED_RANGES[comparison.expectation].format(comparison.size)
    return f"{comparison.column}: {expected_range}"


def format_difference(comparison: Comparison) -> str:
    """Format a difference with its interval, such as "12.3 [10.1, 14.0]".

    Scores have one decimal, all else has three significant digits. A difference that is not subject to
    chance, whose interval has no width, is formatted without it.
    """
    interval = comparison.interval
    # "Seen" is the smallest size that a difference of scores can have, in points of 100. Confidences,
    # correlations and b_hat have smaller sizes.
    is_score = comparison.size >= SIZES["seen"]
    layout = ".1f" if is_score else ".3g"
    text = f"{interval.value:{layout}}"
    if interval.low != interval.high:
        text += f" [{interval.low:{layout}}, {interval.high:{layout}}]"
    return text.replace("-", "\N{MINUS SIGN}")


def summarize(decision: Decision) -> str:
    """Return how many comparisons of a claim hold, fail and are open, such as "3 of 4 hold, 1 open"."""
    counts = f"{decision.count(True)} of {len(decision.comparisons)} hold"
    # Numbers of zero are left out.
    if decision.count(False):
        counts += f", {decision.count(False)} fail"
    if decision.count(None):
        counts += f", {decision.count(None)} open"
    return counts


_TEMPLATE_GLOBALS: dict[str, Any] = {
    "Verdict": Verdict,
    "heading_of": heading_of,
    "summarize": summarize,
    "comparison_table": comparison_table,
    "marks": MARK_OF_OUTCOME,
    "users_period": SHORTEST_FILTER_PERIOD,  # of a filter or firmware of the user's
    "sizes": SIZES,
    "levels": LEVELS,
    "confidence": CONFIDENCE,
    "most_share": MOST_SHARE,
    "refuted_share": REFUTED_SHARE,
    "resamples": RESAMPLES,
    "e_max": E_MAX,
}
"""Variables that templates have in every report: functions that show claims, and the limits of verdicts."""


# --- Other formats ---------------------------------------------------------------------------------------


def comparisons_as_csv(decisions: Sequence[Decision], study_size: StudySize) -> str:
    """Return the text of ``comparisons.csv``: CSV_COLUMNS, then a line for every comparison of every claim.

    Verdicts are empty if the trials are fewer or shorter than the paper's.
    """
    csv_text = io.StringIO()
    writer = csv.writer(csv_text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for decision in decisions:
        claim = decision.claim
        verdict = decision.verdict.value if study_size.allows_verdicts else ""
        # The columns of the claim are repeated in each line, so that any line can be read alone.
        claim_columns = [study_size.seed, claim.name, claim.where, decision.part_label, verdict]
        for comparison in decision.comparisons:
            writer.writerow([*claim_columns, *_csv_columns_of(comparison)])
    return csv_text.getvalue()


def _csv_columns_of(comparison: Comparison) -> list[str]:
    """Return the texts of a comparison for the columns "cells" to "holds" of CSV_COLUMNS.

    They are what is compared, which difference is expected, the smallest difference that counts, the
    difference with the ends of its interval, and whether the expectation holds.
    """
    text_of_outcome = {True: "yes", False: "no", None: "open"}
    numbers = (comparison.size, *comparison.interval)  # value, low and high
    return [
        comparison.label,
        comparison.expectation.value,
        *(f"{number:.6g}" for number in numbers),
        text_of_outcome[comparison.holds],
    ]


def decisions_as_json(decisions: Sequence[Decision], study_size: StudySize) -> list[dict[str, object]]:
    """Return a dictionary for JSON for every decision: the claim, its part, its verdict, and a summary.

    The part is None where equations decide. The verdict is None if the trials are fewer or shorter than the
    paper's.
    """
    records: list[dict[str, object]] = []
    for decision in decisions:
        part_name = decision.study_part.value if decision.study_part else None
        verdict = decision.verdict.value if study_size.allows_verdicts else None
        records.append(
            {
                "claim": decision.claim.name,
                "part": part_name,
                "verdict": verdict,
                "numbers": summarize(decision),
            }
        )
    return records
