"""The study of the robust filter, which is not the paper's: medians over trials, with their intervals.

What is run stands in ``studies/robust_grid.toml``, the paper's cells, and ``studies/robust_beyond.toml``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from mcp_asdf_tools.common.files import write_together
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPERS, score
from mcp_asdf_tools.reproduction.resampling import MEDIAN, Estimate, Sample, averaged, interval, summarized
from mcp_asdf_tools.reproduction.study import Scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = GRID, BEYOND = "robust_grid", "robust_beyond"
SAMPLING_INTERVAL = 1000
"""Steps between the values of x of which the late error is made."""
T = TypeVar("T")
CONFIDENCE = 0.95
OFF = 0.05
"""A healthy robot whose b_hat ends as far from b was harmed by its filter."""


def experiments_of(name: str, scale: Scale, seed: int | None) -> list[Experiment]:
    """The experiments of a file; trials and a seed are the file's where None are given."""
    return [
        replace(
            each,
            trials=each.trials if scale.trials is None else scale.trials,
            steps=min(each.steps, scale.steps),
            seed=each.seed if seed is None else seed,
        )
        for each in read_experiments(STUDIES / f"{name}.toml")
    ]


@dataclass(frozen=True)
class Special:
    """What a world has that its parameters do not say.

    Attributes:
        liars: How many of the last robots lie and are not counted, by experiment.
        late_f: The share of black tiles in the last quarter.
        column: Who filters, as the head of a column.
        more: Further measures by name.
    """

    liars: Callable[[Experiment], int] = lambda experiment: 0
    late_f: Callable[[Experiment], float] = lambda experiment: experiment.fill_ratio
    column: Callable[[Experiment], str] = lambda experiment: experiment.filter_name
    more: Mapping[str, Callable[[Trials], Sample]] = field(default_factory=dict)


PLAIN = Special()


def measures_of(trials: Trials, special: Special = PLAIN) -> dict[str, Sample]:
    """By name a value for each trial, over the honest robots.

    ``H``; ``e``, the paper's error, from K on; ``late``, the mean error of the last quarter; and ``harmed``,
    the share of the healthy robots whose b_hat is wrong in the end, NaN if there are none.
    """
    experiment = trials.experiment
    honest = experiment.robots - special.liars(experiment)
    k, e = trials.convergence_steps[:, :honest], trials.errors[:, :honest]
    x = trials.records["x"][..., :honest]
    late = x[:, -max(1, x.shape[1] // 4) :]
    last = trials.b_hat[:, -1, experiment.flawed : honest]
    off = abs(last - experiment.true_accuracy) > OFF
    return {
        "H": score(k, e, *PAPERS.of(experiment))["H"],
        "e": e.mean(axis=1),
        "late": abs(late - special.late_f(experiment)).mean(axis=(1, 2)),
        "harmed": off.mean(axis=1) if off.size else np.full(len(e), np.nan),
        **{name: measure(trials) for name, measure in special.more.items()},
    }


def mean_of_medians(samples: Sequence[Sample], is_rare: bool = False) -> Estimate:
    """The mean of the samples' medians, or of their means where medians would be 0 as it ``is_rare``; their
    trials are drawn alike, as they saw the same worlds."""
    if any(np.isnan(each).any() for each in samples):
        return Estimate(np.nan, np.nan, np.nan)
    each = [averaged(sample) if is_rare else summarized(sample, MEDIAN) for sample in samples]
    value = float(np.mean([one.value for one in each]))
    return interval(value, np.mean([one.again for one in each], axis=0), CONFIDENCE)


class Entry(NamedTuple):
    """A place of a table: over how many trials of each cell, and the measures by name."""

    trials: int
    measures: Mapping[str, Estimate]


Place = tuple[str, str]
"""Row and column."""


class Table(NamedTuple):
    """Entries by their place, in the order of the experiments."""

    title: str
    entries: Mapping[Place, Entry]


def in_markdown(entries: Mapping[Place, T], shown: Callable[[T], str], head: str) -> str:
    """A table with a row and a column for all that there are."""
    columns = list(dict.fromkeys(column for _, column in entries))
    lines = [f"| {head} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row in dict.fromkeys(row for row, _ in entries):
        own = [entries.get((row, column)) for column in columns]
        lines.append(f"| {row} | {' | '.join('' if each is None else shown(each) for each in own)} |")
    return "\n".join(lines)


def table_of(
    title: str,
    results: Iterable[Trials],
    row_of: Callable[[Experiment], str],
    special: Special = PLAIN,
) -> Table:
    """Experiments of one row and column are cells, of whose medians the mean is taken."""
    cells: dict[Place, list[Trials]] = {}
    for trials in results:
        place = (row_of(trials.experiment), special.column(trials.experiment))
        cells.setdefault(place, []).append(trials)
    entries = {}
    for place, own in cells.items():
        measured = [measures_of(trials, special) for trials in own]
        estimates = {
            name: mean_of_medians([one[name] for one in measured], name == "harmed") for name in measured[0]
        }
        entries[place] = Entry(min(len(trials.numbers) for trials in own), estimates)
    return Table(title, entries)


def grid_row(experiment: Experiment) -> str:
    """The row of a cell of the paper's grid."""
    share = round(100 * experiment.flawed / experiment.robots)
    return f"{'moving' if experiment.is_dynamic else 'fully connected'}, {share} % flawed"


def row_of(experiment: Experiment) -> str:
    """The row of any experiment: what sets it apart from 20 robots of which 30 % are flawed."""
    own = experiment
    words = ["moving" if own.is_dynamic else "fully connected"]
    share = round(100 * own.flawed / own.robots)
    usual_latency = int(own.is_dynamic)
    for is_said, word in (
        (own.robots != 20, f"{own.robots} robots"),
        (share != 30 and own.robots == 20, f"{share} % flawed"),
        (own.density != 1, f"density {own.density:g}"),
        (own.latency != usual_latency, f"latency {own.latency}"),
        (own.white_offset, f"b {own.white_offset:+g} on white"),
        (own.drift == "wiener", "sensors age each in its own way"),
        (own.drift == "linear", "sensors age alike"),
    ):
        if is_said:
            words.append(word)
    if own.flawed:
        words.append("underconfident" if own.flawed_accuracy < own.true_accuracy else "overconfident")
    return ", ".join(words)


WHOLE = "H, error of the last quarter, e, healthy robots harmed"


def whole(entry: Entry) -> str:
    """What WHOLE says."""
    h, harmed = entry.measures["H"], Estimate(*(100 * each for each in entry.measures["harmed"]))
    words = [with_interval(h, "{:.1f}".format, 0.5), late(entry), error(entry.measures["e"].value)]
    if not np.isnan(harmed.value):
        words.append(with_interval(harmed, "{:.1f}".format, 1) + " %")
    return ", ".join(words)


LATE = "error of the last quarter"


def late(entry: Entry) -> str:
    """The error of the last quarter."""
    own = entry.measures["late"]
    return with_interval(own, error, own.value / 10)


def with_interval(estimate: Estimate, shown: Callable[[float], str], near: float) -> str:
    """A number, and its interval where that reaches farther than ``near`` from it."""
    value, low, high = (shown(each) for each in estimate)
    is_near = max(estimate.high - estimate.value, estimate.value - estimate.low) <= near
    return value if is_near or low == high else f"{value} ({low}..{high})"


def error(value: float) -> str:
    """An error with two to three digits that count."""
    return f"{value:.4f}" if value < 0.01 else f"{value:.3f}"


INTERVALS = (
    "Medians over trials. A 95 % interval stands in brackets where it reaches farther than 0.5 from H, a "
    "tenth from an error, or 1 % from a share of robots."
)


def csv_of(tables: Iterable[Table]) -> str:
    """Every estimate with its interval, one a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("table", "row", "filter", "trials", "measure", "value", "low", "high"))
    for table in tables:
        for (row, column), entry in table.entries.items():
            for name, estimate in entry.measures.items():
                bounds = (f"{value:.6g}" for value in estimate)
                writer.writerow((table.title, row, column, entry.trials, name, *bounds))
    return text.getvalue()


def write_page(folder: Path, name: str, table: Table, lines: str, picture: Figure) -> None:
    """Write a page of a table, which ``lines`` shows, and a picture: ``name.md``, ``.csv`` and ``.svg``."""
    from mcp_asdf_tools.common.figures import image_of  # noqa: PLC0415 (matplotlib loads slowly)

    title, file = table.title, folder / f"{name}.svg"
    write_together(
        {
            folder / f"{name}.md": f"# {title}\n\n{lines}\n\n![{title}]({file.name})\n",
            folder / f"{name}.csv": csv_of([table]),
            file: image_of(picture, file),
        }
    )


def write_report(folder: Path, results: Mapping[str, Sequence[Trials]]) -> None:
    """Write ``robust.md`` and ``robust.csv``."""
    grid = table_of("The paper's grid", results[GRID], grid_row)
    beyond = table_of("Beyond it", results[BEYOND], row_of)
    report = (
        f"# The robust filter\n\n{INTERVALS}\n\n"
        f"## {grid.title}\n\n{in_markdown(grid.entries, whole, WHOLE)}\n\n"
        f"## {beyond.title}\n\n{in_markdown(beyond.entries, late, LATE)}\n"
    )
    write_together({folder / "robust.md": report, folder / "robust.csv": csv_of([grid, beyond])})
