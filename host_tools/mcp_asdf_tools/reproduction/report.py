"""The report of a study as a folder: one page, the same in Markdown with its pictures, every comparison."""

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
from mcp_asdf_tools.reproduction.claims import LEVELS, QUESTIONS, SIZES
from mcp_asdf_tools.reproduction.decisions import Decided, Decision
from mcp_asdf_tools.reproduction.figures import Picture, pictures
from mcp_asdf_tools.reproduction.resampling import RESAMPLES
from mcp_asdf_tools.reproduction.runs import Run
from mcp_asdf_tools.reproduction.study import PART_NAMES, Part, Scale, cells_of, experiment_of
from mcp_asdf_tools.reproduction.verdicts import (
    CONFIDENCE,
    FEW,
    MOST,
    Comparison,
    Expectation,
    Finding,
    Verdict,
)

_COLUMNS = ("seed", "claim", "where", "part", "verdict", "cells", "expected", "size", "value", "low", "high")
_MARKS = {True: "\N{CHECK MARK}", False: "\N{BALLOT X}", None: "?"}
_WORDS = {
    Expectation.ABOVE: "at least {:g}",
    Expectation.BELOW: "at most \N{MINUS SIGN}{:g}",
    Expectation.SAME: "within \N{PLUS-MINUS SIGN}{:g}",
    Expectation.NOT_ABOVE: "not above {:g}",
    Expectation.NOT_BELOW: "not below \N{MINUS SIGN}{:g}",
}


def write_report(folder: Path, runs: Sequence[Run], scale: Scale) -> None:
    """Write ``report.html``, which needs no other file, ``report.md`` with ``figures``, ``comparisons.csv``.

    Raises UsageError if that cannot be done.
    """
    drawn = list(pictures(runs[0].study, scale))
    images = {f"figures/{each.name}.png": image_of(each.figure, Path(f"{each.name}.png")) for each in drawn}
    make_folder(folder / "figures")
    for name, image in images.items():
        write_atomically(folder / name, image)
    content = re.sub(r" +$", "", _rendered("report.md.j2", **_context(runs, scale, drawn)), flags=re.M)
    write_atomically(folder / "report.md", content)
    write_atomically(folder / "report.html", _page(content, images))
    write_atomically(folder / "comparisons.csv", comparisons(runs, scale))


def _rendered(template: str, **context: Any) -> str:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 (loads slowly)

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # Markdown of our own words
    )
    return environment.get_template(template).render(context)


def _page(content: str, images: Mapping[str, bytes]) -> str:
    """The report as one page with its pictures in it."""
    from markdown_it import MarkdownIt  # noqa: PLC0415 (loads slowly)

    body = MarkdownIt("commonmark", {"html": True}).enable("table").render(content)

    def embedded(found: re.Match[str]) -> str:
        return f'src="data:image/png;base64,{base64.b64encode(images[found[1]]).decode()}"'

    return _rendered("report.html.j2", body=re.sub(r'src="([^"]*)"', embedded, body))


# --- Everything that the template shows ------------------------------------------------------------------


def _context(runs: Sequence[Run], scale: Scale, drawn: Sequence[Picture]) -> dict[str, Any]:
    decided = runs[0].decided
    parts = [part for part in Part if part in runs[0].study.parts]
    return {
        "scale": scale,
        "decided": decided,
        "Verdict": Verdict,
        "verdicts": _verdicts_of(runs),
        "sections": {part: own for part in (None, *Part) if (own := [d for d in decided if d.part is part])},
        "counts": Counter((each.part, each.finding.verdict) for each in decided),
        "parts": parts,
        "names": {None: "equations", **PART_NAMES},
        "questions": _questions(decided),
        "versions": ", ".join(f"{name} {version}" for name, version in software_versions().items()),
        "runs": [_run_row(part, runs, scale) for part in parts],
        "pictures": drawn,
        "numbers": numbers,
        "heading": heading,
        "table_of": _table_of,
        "marks": _MARKS,
        "strong": [SIZES["much"], SIZES["overwhelming"]],
        "rules": {"confidence": CONFIDENCE, "most": MOST, "few": FEW, "resamples": RESAMPLES},
        "sizes": SIZES,
        "levels": LEVELS,
        "e_max": E_MAX,
    }


def _verdicts_of(runs: Sequence[Run]) -> dict[str, list[str]]:
    """Verdicts on each claim, seed after seed."""
    found: dict[str, list[str]] = {}
    for each in (each for run in runs for each in run.decided):
        found.setdefault(each.anchor, []).append(each.finding.verdict.value)
    return found


def _questions(decided: Decided) -> list[tuple[str, dict[Part | None, Decision]]]:
    """Questions of a user with the decisions that answer them, by part."""
    answers = [
        (words, {each.part: each for each in decided if each.claim.name == name})
        for name, words in QUESTIONS.items()
    ]
    return [(words, own) for words, own in answers if own]


def _run_row(part: Part, runs: Sequence[Run], scale: Scale) -> list[object]:
    cells = cells_of(part)
    experiment = experiment_of(cells[0], scale)
    own = [run for run in runs if part in run.study.parts]
    counts = sorted({len(trials.numbers) for trials in own[0].study.of(part)})
    trials = " to ".join(map(str, dict.fromkeys([counts[0], counts[-1]])))
    seeds = ", ".join(str(run.seed) for run in own)
    return [PART_NAMES[part], len(cells), experiment.robots, experiment.steps, trials, seeds]


def heading(name: str) -> str:
    """A claim's name in words; symbols stay as they are."""
    words = f"{name} ".replace("_", " ").replace("b hat", "b_hat").replace(" p ", " P ").strip()
    words = re.sub(r"\bminus\b", "ASDF\N{MINUS SIGN}", re.sub(r"\bplus\b", "ASDF+", words))
    return words[0].upper() + words[1:]


def _table_of(finding: Finding) -> list[list[str]]:
    """Comparisons with a row for each f, b and b_hat and a column for each contrast; heads come first."""
    heads = list(dict.fromkeys(map(_head, finding.comparisons)))
    rows = dict.fromkeys(each.place.row for each in finding.comparisons)
    cells = {
        (each.place.row, _head(each)): f"{_MARKS[each.holds]} {in_words(each)}"
        for each in finding.comparisons
    }
    return [["", *heads], *([row, *(cells.get((row, head), "") for head in heads)] for row in rows)]


def _head(comparison: Comparison) -> str:
    """The contrast, and what is claimed of it."""
    return f"{comparison.place.column}: {_WORDS[comparison.expectation].format(comparison.size)}"


def in_words(comparison: Comparison) -> str:
    """The difference with its interval."""
    estimate = comparison.estimate
    digits = ".1f" if comparison.size >= SIZES["seen"] else ".3g"
    value, low, high = (format(each, digits).replace("-", "\N{MINUS SIGN}") for each in estimate)
    share = "" if comparison.share is None else f", more in {100 * comparison.share:.0f} %"
    return (value if estimate.low == estimate.high else f"{value} [{low}, {high}]") + share


def numbers(finding: Finding) -> str:
    """How many comparisons hold, and the most and the least favourable of them."""
    total, right, wrong = len(finding.comparisons), finding.count(True), finding.count(False)
    parts = [f"{right} of {total} hold"]
    parts += [f"{wrong} fail"] * (wrong > 0) + [f"{total - right - wrong} open"] * (total > right + wrong)
    ranked = sorted(finding.comparisons, key=_favour)
    if total == 1:
        return f"{parts[0]}; {in_words(ranked[0])}"
    return f"{', '.join(parts)}; best {in_words(ranked[-1])}, worst {in_words(ranked[0])}"


def _favour(comparison: Comparison) -> float:
    """How far the difference lies on the side where it is expected, in sizes."""
    value = comparison.estimate.value / comparison.size
    if comparison.expectation is Expectation.SAME:
        return -abs(value)
    return value if comparison.expectation in (Expectation.ABOVE, Expectation.NOT_BELOW) else -value


# --- For machines ----------------------------------------------------------------------------------------


def comparisons(runs: Sequence[Run], scale: Scale) -> str:
    """A line for every comparison with every seed, as CSV."""
    content = io.StringIO()
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow([*_COLUMNS, "holds", "share"])
    for run in runs:
        for decision in run.decided:
            claim, finding = decision.claim, decision.finding
            verdict = finding.verdict.value if scale.allows_verdicts else ""
            about = "equations" if decision.part is None else PART_NAMES[decision.part]
            for each in finding.comparisons:
                holds = {True: "yes", False: "no", None: "open"}[each.holds]
                values = (f"{value:.6g}" for value in (each.size, *each.estimate))
                head = (run.seed, claim.name, claim.where, about, verdict, each.label, each.expectation.value)
                share = "" if each.share is None else f"{each.share:.4g}"
                writer.writerow([*head, *values, holds, share])
    return content.getvalue()


def as_values(run: Run, scale: Scale) -> list[dict[str, object]]:
    """Claims and verdicts with a seed as plain values; verdicts are null where none may be given."""
    return [
        {
            "claim": each.claim.name,
            "part": each.part.value if each.part else None,
            "verdict": each.finding.verdict.value if scale.allows_verdicts else None,
            "numbers": numbers(each.finding),
        }
        for each in run.decided
    ]
