"""Results of the study as a folder: a report in Markdown with pictures, and every comparison made."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from mcp_asdf_tools.common import save_figure, software_versions, write_atomically
from mcp_asdf_tools.experiments import E_MAX
from mcp_asdf_tools.reproduction.comparisons import Claim
from mcp_asdf_tools.reproduction.paper_claims import CLAIMS
from mcp_asdf_tools.reproduction.paper_figures import FIGURES
from mcp_asdf_tools.reproduction.study import PART_NAMES, Part, Scale, Study, cells_of, experiment_of
from mcp_asdf_tools.reproduction.verdicts import CONFIDENCE, MARGIN, Comparison, Expectation, Finding, Verdict
from mcp_asdf_tools.robots import Filtering

Decided = Sequence[tuple[Claim, Finding]]
"""Claims and what came out of them."""


def decide(study: Study) -> Decided:
    """Decide every claim whose parts have been run. O(comparisons resamples trials)."""
    return [(claim, claim.decide(study)) for claim in CLAIMS if claim.needs <= study.parts]


def write_report(folder: Path, study: Study, scale: Scale) -> Decided:
    """Write ``report.md``, its pictures and ``comparisons.csv`` into a folder; returns what was decided.

    Raises UsageError if that cannot be done.
    """
    decided = decide(study)
    figures = [each for each in FIGURES if each.needs <= study.parts]
    for figure in figures:
        save_figure(figure.draw(study, scale), folder / f"{figure.name}.png")
    write_comparisons(folder / "comparisons.csv", decided)
    sections = [
        _introduction(study, scale),
        "\n\n".join(["## Claims", _RULES, summary_table(decided), claims_table(decided)]),
        "## Pictures\n\n" + "\n\n".join(f"![]({each.name}.png)\n\n{each.caption}" for each in figures),
    ]
    write_atomically(folder / "report.md", "\n\n".join(sections) + "\n")
    return decided


_INTRODUCTION = """\
# The paper's study, run again

{trials} trials of each experiment, seed {seed}, {firmware} firmware, conventions of the {conventions};
{versions}. The results hold all parameters of every trial.

| part | experiments | robots | steps | results |
|---|---|---|---|---|
{rows}

{grids}

Scores are relative to K_max, the length of a trial, and e_max = {e_max}."""

_RULES = f"""\
A comparison is the difference of two medians with its {CONFIDENCE:.0%} bootstrap interval. It is *above*
if the interval is above 0 and the difference at least {MARGIN:g} points of the score, *the same* if the
interval is within {MARGIN:g} points of 0, and open where the interval does not decide; some claims have
other sizes, which `comparisons.csv` states for each. A claim agrees if none of its comparisons fails and
three quarters hold, or just three quarters hold where the paper speaks of most cases, or one where it speaks
of some; it disagrees if it is the other way round."""


def _introduction(study: Study, scale: Scale) -> str:
    parts = [part for part in Part if part in study.parts]
    return _INTRODUCTION.format(
        trials=scale.trials,
        seed=scale.seed,
        firmware=scale.firmware,
        conventions=scale.conventions.value,
        versions=", ".join(f"{name} {version}" for name, version in software_versions().items()),
        rows="\n".join(_row_of(part, scale) for part in parts),
        grids="\n".join(f"- {PART_NAMES[part]}: {_grid_of(part)}" for part in parts),
        e_max=E_MAX,
    )


def _row_of(part: Part, scale: Scale) -> str:
    cells = cells_of(part)
    experiment = experiment_of(cells[0], scale)
    values = (PART_NAMES[part], len(cells), experiment.robots, experiment.steps, f"`{part.value}.parquet`")
    return f"| {' | '.join(map(str, values))} |"


def _grid_of(part: Part) -> str:
    axes = {
        "f": "fill_ratio",
        "b": "true_accuracy",
        "b_hat": "flawed_accuracy",
        "P in %": "percent",
        "tau": "period",
    }
    words = []
    for name, attribute in axes.items():
        values = sorted({getattr(cell, attribute) for cell in cells_of(part)})
        words.append(f"{name} {', '.join(f'{value:g}' for value in values)}")
    modes = {cell.mode for cell in cells_of(part)}
    return "; ".join([*words, ", ".join(mode.value for mode in Filtering if mode in modes)])


# --- Tables ----------------------------------------------------------------------------------------------


def summary_table(decided: Decided) -> str:
    """How many claims of each part agree."""
    counts = Counter((claim.part, finding.verdict) for claim, finding in decided)
    rows = [
        f"| {_about(part)} | {' | '.join(str(counts[part, verdict]) for verdict in Verdict)} |"
        for part in (None, *Part)
        if any(counts[part, verdict] for verdict in Verdict)
    ]
    head = f"| about | {' | '.join(verdict.value for verdict in Verdict)} |"
    return "\n".join([head, "|---" * (1 + len(Verdict)) + "|", *rows])


def claims_table(decided: Decided) -> str:
    """A row for each claim: section, what it is about, what it says, our numbers, the verdict."""
    rows = []
    for claim, finding in decided:
        values = (claim.section, _about(claim.part), claim.text, numbers(finding), finding.verdict.value)
        rows.append(f"| {' | '.join(values)} |")
    return "\n".join(["| section | about | claim | our numbers | verdict |", "|---|---|---|---|---|", *rows])


def _about(part: Part | None) -> str:
    return "equations" if part is None else PART_NAMES[part]


def numbers(finding: Finding) -> str:
    """How many comparisons hold, and the most and the least favourable of them."""
    total, right, wrong = len(finding.comparisons), finding.count(True), finding.count(False)
    parts = [f"{right} of {total} hold"]
    parts += [f"{wrong} fail"] * (wrong > 0) + [f"{total - right - wrong} open"] * (total > right + wrong)
    ranked = sorted(finding.comparisons, key=_favour)
    worst, best = ranked[0], ranked[-1]
    extremes = f"best {_interval(best)}, worst {_interval(worst)}" if total > 1 else _interval(best)
    return f"{', '.join(parts)}; {extremes} ({worst.label})"


def plain(decided: Decided) -> list[dict[str, str | None]]:
    """Claims and verdicts as plain values."""
    return [
        {
            "claim": claim.name,
            "section": claim.section,
            "part": claim.part.value if claim.part else None,
            "verdict": finding.verdict.value,
            "numbers": numbers(finding),
        }
        for claim, finding in decided
    ]


def _favour(comparison: Comparison) -> float:
    """How far the difference lies on the side where it is expected."""
    value = comparison.estimate.value
    if comparison.expectation is Expectation.SAME:
        return -abs(value)
    return value if comparison.expectation in (Expectation.ABOVE, Expectation.NOT_BELOW) else -value


def _interval(comparison: Comparison) -> str:
    estimate = comparison.estimate
    value, low, high = (f"{each:.3g}" for each in (estimate.value, estimate.low, estimate.high))
    return value if low == high else f"{value} [{low}, {high}]"


_COLUMNS = (
    "claim",
    "section",
    "part",
    "verdict",
    "comparison",
    "expected",
    "margin",
    "value",
    "low",
    "high",
    "holds",
)


def write_comparisons(path: Path, decided: Decided) -> None:
    """Write a line for every comparison. Raises UsageError if that cannot be done."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for claim, finding in decided:
        head = (claim.name, claim.section, _about(claim.part), finding.verdict.value)
        for each in finding.comparisons:
            holds = {True: "yes", False: "no", None: "open"}[each.holds]
            values = (
                f"{value:.6g}"
                for value in (each.margin, each.estimate.value, each.estimate.low, each.estimate.high)
            )
            writer.writerow([*head, each.label, each.expectation.value, *values, holds])
    write_atomically(path, text.getvalue())
