"""Results of the study as a folder: report as one page and as Markdown, pictures, every comparison."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from mcp_asdf_tools.common import UsageError, image_of, write_atomically
from mcp_asdf_tools.experiments import Trials
from mcp_asdf_tools.reproduction import report_text as text
from mcp_asdf_tools.reproduction.decisions import Decided
from mcp_asdf_tools.reproduction.heat_maps import heat_map
from mcp_asdf_tools.reproduction.paper_figures import FIGURES, Drawn, ReportFigure
from mcp_asdf_tools.reproduction.runs import Run
from mcp_asdf_tools.reproduction.study import Part, Scale

_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The paper's study, run again</title>
<style>
body {{ font: 15px/1.45 sans-serif; color: #222; max-width: 75rem; margin: 1.5rem auto; padding: 0 1rem }}
table {{ border-collapse: collapse; margin: .6rem 0 }}
th, td {{ border: 1px solid #ccc; padding: .2rem .5rem; text-align: left; vertical-align: top }}
th {{ background: #eef3f7 }}
h3 {{ margin-top: 2.2rem }}
img {{ max-width: 100% }}
</style>
{body}
</html>
"""


def write_report(folder: Path, runs: Sequence[Run], series: Sequence[Trials], scale: Scale) -> None:
    """Write ``report.html``, which needs no other file, ``report.md`` with its pictures, and
    ``comparisons.csv``.

    Raises UsageError if that cannot be done.
    """
    first = runs[0]
    drawn = Drawn(first.study, series, scale)
    figures = [each for each in FIGURES if each.needs <= first.study.parts]
    images = dict(_images(first.decided, drawn, figures))
    for name, image in images.items():
        _make_folder((folder / name).parent)
        write_atomically(folder / name, image)
    content = _markdown(runs, drawn, figures)
    write_atomically(folder / "report.md", content)
    write_atomically(folder / "report.html", _page(content, images))
    write_atomically(folder / "comparisons.csv", comparisons(runs, scale))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}; choose another") from error


def _images(decided: Decided, drawn: Drawn, figures: Sequence[ReportFigure]) -> Iterator[tuple[str, bytes]]:
    for each in decided:
        name = f"claims/{each.file}.svg"
        yield name, image_of(heat_map(each.finding.comparisons), Path(name), has_text=True)
    for figure in figures:
        name = f"figures/{figure.name}.png"
        yield name, image_of(figure.draw(drawn), Path(name))


def _markdown(runs: Sequence[Run], drawn: Drawn, figures: Sequence[ReportFigure]) -> str:
    decided, scale, verdicts = runs[0].decided, drawn.scale, text.verdicts_of(runs)
    parts = [part for part in Part if part in drawn.study.parts]
    shown = [
        f"![{text.plain(figure.title)}](figures/{figure.name}.png)\n\n{figure.caption(drawn)}"
        for figure in figures
    ]
    sections = [
        text.overview(decided, scale),
        text.introduction(parts, runs, scale),
        text.claims_tables(decided, verdicts, scale),
        text.claim_pictures(decided, scale),
        "## The paper's figures, and others",
        *shown,
        text.RULES,
    ]
    return "\n\n".join(sections) + "\n"


def _page(content: str, images: dict[str, bytes]) -> str:
    """The report as one page with its pictures in it."""
    from markdown_it import MarkdownIt  # noqa: PLC0415 (loads slowly)

    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(content)
    kinds = {".svg": "image/svg+xml", ".png": "image/png"}

    def embedded(found: re.Match[str]) -> str:
        name = found[1]
        data = base64.b64encode(images[name]).decode()
        return f'src="data:{kinds[Path(name).suffix]};base64,{data}"'

    return _PAGE.format(body=re.sub(r'src="([^"]*)"', embedded, body))


_COLUMNS = (
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


def comparisons(runs: Sequence[Run], scale: Scale) -> str:
    """A line for every comparison with every seed, as CSV."""
    content = io.StringIO()
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for run in runs:
        for decision in run.decided:
            verdict = decision.finding.verdict.value if scale.allows_verdicts else ""
            head = (run.seed, decision.claim.name, decision.claim.where, text.about(decision.part), verdict)
            for each in decision.finding.comparisons:
                holds = {True: "yes", False: "no", None: "open"}[each.holds]
                values = (f"{value:.6g}" for value in (each.size, *each.estimate))
                writer.writerow([*head, each.label, each.expectation.value, *values, holds])
    return content.getvalue()
