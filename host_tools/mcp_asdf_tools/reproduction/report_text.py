"""The words of the report: an overview of one screen, what was run, rules, tables of claims, captions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from mcp_asdf_tools.common import software_versions
from mcp_asdf_tools.experiments import E_MAX
from mcp_asdf_tools.reproduction.comparisons import (
    ALMOST_PERFECT,
    EXCELLENT,
    MUCH,
    OVERWHELMING,
    POOR,
    QUITE_HIGH,
    SEEN,
    SIMILAR,
)
from mcp_asdf_tools.reproduction.decisions import Decided, Decision
from mcp_asdf_tools.reproduction.heat_maps import MARKS, in_words
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
    Scope,
    Verdict,
)
from mcp_asdf_tools.robots import Filtering

TOO_SHORT = "**Too short for verdicts: none is given. The paper has 30 trials of 40 000 steps.**"

_ANSWERS = {
    Verdict.AGREE: "yes",
    Verdict.MIXED: "in part",
    Verdict.DISAGREE: "no",
    Verdict.UNDECIDED: "open",
}
_DYNAMIC, _CONNECTED = Part.DYNAMIC, Part.FULLY_CONNECTED
_QUESTIONS: tuple[tuple[str, str, tuple[Part, ...]], ...] = (
    ("Do flawed robots harm a swarm, but where f = b = 0.55?", "flawed_robots_harm", (_DYNAMIC,)),
    (
        "Only flawed robots filter: is it better than no filter?",
        "minus_outperforms_the_baseline",
        (_DYNAMIC, _CONNECTED),
    ),
    (
        "Does that keep overconfident swarms at the level of flawless ones?",
        "minus_keeps_overconfident_flawless",
        (_DYNAMIC, _CONNECTED),
    ),
    (
        "All filter, some are overconfident: is it better than no filter?",
        "plus_improves_overconfident_swarms",
        (_DYNAMIC, _CONNECTED),
    ),
    (
        "Some are underconfident: can a filter improve much?",
        "filters_can_improve_underconfident_swarms",
        (_DYNAMIC, _CONNECTED),
    ),
    ("Is the shortest filtering period best, overall?", "short_periods_are_better", (_DYNAMIC, _CONNECTED)),
    (
        "All robots are flawed: is a filter of no use?",
        "filters_do_not_help_entirely_flawed_swarms",
        (_DYNAMIC, _CONNECTED),
    ),
    (
        "Does filtering leave a short run unharmed?",
        "plus_does_no_harm_in_short_runs",
        (Part.PHYSICAL,),
    ),
)
"""Questions of users, and the claims that answer them."""

Verdicts = Mapping[tuple[str, Part | None], Sequence[Verdict]]
"""Of each claim and part with each seed."""


def verdicts_of(runs: Sequence[Run]) -> Verdicts:
    """Verdicts by claim, seed after seed."""
    found: dict[tuple[str, Part | None], list[Verdict]] = {}
    for run in runs:
        for each in run.decided:
            found.setdefault(each.key, []).append(each.finding.verdict)
    return found


# --- Overview --------------------------------------------------------------------------------------------


def overview(decided: Decided, scale: Scale) -> str:
    """The claims that hold, where, and their meaning for a user: at most one screen."""
    lines = ["# The paper's study, run again", ""]
    if not scale.allows_verdicts:
        return "\n".join([*lines, TOO_SHORT])
    agree = sum(each.finding.verdict is Verdict.AGREE for each in decided)
    lines += [f"{agree} of {len(decided)} claims hold as the paper puts them.", "", _counts(decided), ""]
    return "\n".join([*lines, *_answers(decided)])


def _counts(decided: Decided) -> str:
    """How many claims of each part agree."""
    counts = Counter((each.part, each.finding.verdict) for each in decided)
    rows = [
        [about(part), *(counts[part, verdict] for verdict in Verdict)]
        for part in (None, *Part)
        if any(counts[part, verdict] for verdict in Verdict)
    ]
    return table(["about", *(verdict.value for verdict in Verdict)], rows)


def _answers(decided: Decided) -> list[str]:
    found = {each.key: each for each in decided}
    parts = [part for part in Part if any(each.part is part for each in decided)]
    rows = []
    for question, name, asked in _QUESTIONS:
        cells = [
            _answer(found[name, part]) if part in asked and (name, part) in found else "" for part in parts
        ]
        if any(cells):
            rows.append([question, *cells])
    return [table(["for a user", *(PART_NAMES[part] for part in parts)], rows)]


def _answer(decision: Decision) -> str:
    finding = decision.finding
    share = f"{finding.count(True)} of {len(finding.comparisons)}"
    return f"[{_ANSWERS[finding.verdict]}](#{decision.file}), {share}"


# --- What was run ----------------------------------------------------------------------------------------


def introduction(parts: Iterable[Part], runs: Sequence[Run], scale: Scale) -> str:
    """The runs, with seeds and versions."""
    versions = ", ".join(f"{name} {version}" for name, version in software_versions().items())
    head = (
        f"{scale.firmware.capitalize()} firmware, conventions of the {scale.conventions.value}; {versions}. "
        f"Scores are relative to K_max, the length of a trial, and e_max = {E_MAX}."
    )
    rows = [_row_of(part, runs, scale) for part in parts]
    columns = ["part", "experiments", "robots", "steps", "trials of each", "seeds", "varied"]
    return "\n\n".join(["## What was run", head, table(columns, rows)])


def _row_of(part: Part, runs: Sequence[Run], scale: Scale) -> list[object]:
    cells = cells_of(part)
    experiment = experiment_of(cells[0], scale)
    own = [run for run in runs if part in run.study.parts]
    counts = [len(trials.numbers) for trials in own[0].study.of(part)]
    trials = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    seeds = ", ".join(str(run.seed) for run in own)
    return [PART_NAMES[part], len(cells), experiment.robots, experiment.steps, trials, seeds, _grid_of(part)]


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
    filters = {cell.filter for cell in cells_of(part)}
    return "; ".join([*words, ", ".join(some.value for some in Filtering if some in filters)])


RULES = f"""\
## How a claim is decided

A comparison is the difference of two cells' medians over the trials, with an interval from
{RESAMPLES} bootstrap resamples in which trial i of all cells is drawn together. Intervals are so wide that
all comparisons of a claim, at every look while trials are added, are right together with {CONFIDENCE:.0%}
(Bonferroni).

| expected | holds if | fails if |
|---|---|---|
| above, below | the interval is on that side of 0 and the difference at least the size | \
the interval is below the size |
| the same | the interval is within the size of 0 | it is above or below |
| not above, not below | the interval is within the size on that side | it is above, or below |

Otherwise it is open. Sizes, in points of a score of 0 to 100:

| the paper's words | size |
|---|---|
| better, worse, maintains, as effective as | {SEEN:g} |
| similar, comparable, close, largely the same, not discernible | within {SIMILAR:g} |
| slight, minor, moderate | up to {MUCH:g} |
| much, substantial, significant, remarkable | {MUCH:g} |
| overwhelming | {OVERWHELMING:g} |
| excellent; quite high, quite accurate; almost perfect; poor | \
level {EXCELLENT}; {QUITE_HIGH}; {ALMOST_PERFECT}; {POOR} |

| the paper's words | agrees if of the decided comparisons | disagrees if |
|---|---|---|
| no hedge: *{Scope.ALL.value}* | all hold | at most {FEW:.0%} hold |
| in general, overall, almost all, largely, likely: *{Scope.MOST.value}* | {MOST:.0%} hold | \
at most {1 - MOST:.0%} hold |
| in some cases, may, can: *{Scope.SOME.value}* | one holds | all fail |

Between these it is mixed. With more than {1 - MOST:.0%} of the comparisons open it is undecided.
Other readings are shown where their verdict differs; halved and doubled sizes are readings of every claim."""

# --- Claims ----------------------------------------------------------------------------------------------


def claims_tables(decided: Decided, verdicts: Verdicts, scale: Scale) -> str:
    """A table for each part with a row for each claim."""
    sections = ["## Claims"]
    for part in (None, *Part):
        own = [each for each in decided if each.part is part]
        if own:
            rows = [_claim_row(each, verdicts[each.key], scale) for each in own]
            columns = [
                "where",
                "the paper's words",
                "our numbers",
                "verdict",
                "other seeds",
                "other readings",
            ]
            title = f"{about(part).capitalize()}: {len(own)} claims"
            sections.append(folded(title, table(columns, rows)))
    return "\n\n".join(sections)


def folded(title: str, content: str) -> str:
    """Something to be opened by a click."""
    return f"<details><summary>{title}</summary>\n\n{content}\n\n</details>"


def _claim_row(decision: Decision, verdicts: Sequence[Verdict], scale: Scale) -> list[object]:
    claim = decision.claim
    link = f"[{numbers(decision.finding)}](#{decision.file})"
    return [claim.where, f'"{claim.words}"', link, *_verdict_cells(decision, verdicts, scale)]


def _verdict_cells(decision: Decision, verdicts: Sequence[Verdict], scale: Scale) -> list[str]:
    if not scale.allows_verdicts:
        return ["", "", ""]
    others = ", ".join(verdict.value for verdict in verdicts[1:]) if decision.part else ""
    readings = "; ".join(f"{words}: {verdict.value}" for words, verdict in decision.readings.items())
    return [f"**{verdicts[0].value}**", others, readings]


def about(part: Part | None) -> str:
    """Name of what a claim is about."""
    return "equations" if part is None else PART_NAMES[part]


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


def claim_pictures(decided: Decided, scale: Scale) -> str:
    """The heat map of each claim, with its words."""
    legend = (
        "A cell is a comparison: the difference, blue above 0 and orange below, with its interval; "
        f"{MARKS[True]} holds, {MARKS[False]} fails, {MARKS[None]} open. "
        "A column's head ends in what is claimed. "
        f"Scores are medians over the trials; K_max is the length of a trial, e_max = {E_MAX}."
    )
    return "\n\n".join(["## Pictures of the claims", legend, *(_picture_of(each, scale) for each in decided)])


def _picture_of(decision: Decision, scale: Scale) -> str:
    claim, finding = decision.claim, decision.finding
    verdict = f", {finding.verdict.value}" if scale.allows_verdicts else ""
    alt = f"{about(decision.part)}, {claim.compared}: {numbers(finding)}{verdict}"
    name = claim.name.replace("_", " ")
    return "\n\n".join(
        [
            f'<a id="{decision.file}"></a>\n\n### {name.capitalize()}, {about(decision.part)}{verdict}',
            f'"{claim.words}" ({claim.where})',
            f"{claim.compared[0].upper()}{claim.compared[1:]}; {finding.scope.value} must hold.",
            f"![{plain(alt)}](claims/{decision.file}.svg)",
        ]
    )


def plain(words: str) -> str:
    """Text for the description of an image, without what Markdown would take for marks."""
    return words.replace("[", "(").replace("]", ")")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in (head, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def as_values(decided: Decided, verdicts: Verdicts, scale: Scale) -> list[dict[str, object]]:
    """Claims and verdicts as plain values; verdicts are null where none may be given."""
    return [
        {
            "claim": each.claim.name,
            "where": each.claim.where,
            "words": each.claim.words,
            "part": each.part.value if each.part else None,
            "verdict": each.finding.verdict.value if scale.allows_verdicts else None,
            "verdicts": [v.value for v in verdicts[each.key]] if scale.allows_verdicts else [],
            "readings": {words: verdict.value for words, verdict in each.readings.items()}
            if scale.allows_verdicts
            else {},
            "numbers": numbers(each.finding),
        }
        for each in decided
    ]
