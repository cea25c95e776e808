"""Put the tables of the robust filter's study into docs/robust.md, and draw the picture of that page.

mcp-asdf reproduce --part robust --output FOLDER
PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/peers.toml --record 500 --output FOLDER/peers.parquet
python tests/benchmarks/robust_page.py FOLDER
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common import figures
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import filter_colours, median_interval
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.reproduction import robust
from mcp_asdf_tools.robots.population import FILTER_NAMES

ROOT = Path(__file__).resolve().parents[2]
PAGE, PICTURE = ROOT / "docs/robust.md", ROOT / "docs/images/robust.svg"

Results = Mapping[str, Sequence[Trials]]
"""Of the study's two files and of the peers, by name."""

COLUMNS = {"bayescpf": "BayesCPF", "all-counts": "all counts", "first-draft": "first draft"}
WORLDS = {"lossy": "3 messages of 10 lost", "liars-1": "1 liar", "liars-2": "2 liars", "liars-5": "5 liars"}


def column_of(experiment: Experiment) -> str:
    """The filter, or the firmware that stands for one."""
    name = FILTER_NAMES[experiment.filter]
    if experiment.firmware == "remembering":
        return f"{name} with memory"
    return COLUMNS.get(experiment.firmware, name)


def row_of(experiment: Experiment) -> str:
    """What sets a world apart, over- and underconfident robots in one row."""
    share = f", {100 * experiment.flawed // experiment.robots} % flawed"
    words = [re.sub(r", (under|over)confident|, \d+ robots", "", robust.row_of(experiment))]
    if experiment.firmware in WORLDS:
        words.append(WORLDS[experiment.firmware])
    elif experiment.sensor:
        words.append("the floor changes")
    elif share not in words[0]:
        words[0] += share
    return ", ".join(words)


PEERS = robust.Special(
    liars=lambda each: int(each.firmware[-1]) if each.firmware.startswith("liars") else 0,
    late_f=lambda each: 0.95 if each.sensor == "changing-floor" else each.fill_ratio,
    column=column_of,
)


def pairs(table: dict[str, robust.Table], head: str) -> str:
    """Late errors, of the underconfident and the overconfident in one place."""
    under, over = table["under"], table["over"]

    def shown(place: tuple[str, str]) -> str:
        return ", ".join(robust.late(each.entries[place]) for each in (under, over) if place in each.entries)

    rows = dict.fromkeys(row for row, _ in under.entries)
    lines = [f"| {head} | {' | '.join(under.columns)} |", "|---" * (len(under.columns) + 1) + "|"]
    lines += [f"| {row} | {' | '.join(shown((row, each)) for each in under.columns)} |" for row in rows]
    return "\n".join(lines)


def halves(results: Sequence[Trials], special: robust.Special, row: object) -> dict[str, robust.Table]:
    """Two tables: of the underconfident, with those of which none are flawed, and of the overconfident."""
    over = [each for each in results if each.experiment.true_accuracy < 0.6]
    under = [each for each in results if each.experiment.true_accuracy >= 0.6]
    return {
        name: robust.table_of(name, some, row, special)  # type: ignore[arg-type]
        for name, some in (("under", under), ("over", over))
    }


def beyond_row(experiment: Experiment) -> str:
    """The row without what all have in common."""
    return re.sub(r", (under|over)confident|, 0 % flawed", "", robust.row_of(experiment))


def is_world(experiment: Experiment) -> bool:
    """Whether it is a hard world, not a peer."""
    e = experiment
    return e.firmware in {*WORLDS, "first-draft"} or bool(e.sensor) or 2 * e.flawed == e.robots


def tables_of(found: Results) -> dict[str, str]:
    """The tables of the page by the words of their marks."""
    grid = robust.table_of("", found[robust.GRID], robust.grid_row)
    worlds = [each for each in found["peers"] if is_world(each.experiment)]
    peers = [each for each in found["peers"] if not is_world(each.experiment)]
    head = "underconfident, overconfident"
    return {
        "grid": grid.lines(robust.whole, robust.WHOLE),
        "beyond": pairs(halves(found[robust.BEYOND], robust.PLAIN, beyond_row), head),
        "peers": pairs(halves(peers, PEERS, row_of), head),
        "worlds": pairs(halves(worlds, PEERS, row_of), head),
    }


# --- The picture -----------------------------------------------------------------------------------------

IN_PICTURE: dict[str, tuple[str, Callable[[Experiment], bool]]] = {
    "30 % flawed": (robust.GRID, lambda each: 10 * each.flawed == 3 * each.robots),
    "30 % flawed and 5 liars": ("peers", lambda each: each.firmware == "liars-5"),
    "50 % flawed": (robust.GRID, lambda each: 2 * each.flawed == each.robots),
}
"""The columns: their results, and which of them."""

HUES = dict(zip(FILTER_NAMES, filter_colours([*FILTER_NAMES]), strict=True))

POINTS = 20
"""Of a curve, besides the start."""


def error_over_time(trials: Trials) -> NDArray[np.float64]:
    """Steps, the median over the trials of the honest robots' mean error, and its 95 % interval; 4 rows."""
    honest = trials.experiment.robots - PEERS.liars(trials.experiment)
    x = trials.records["x"][..., :honest]
    chosen = np.linspace(0, x.shape[1] - 1, POINTS + 1).astype(int)
    errors = abs(x[:, chosen] - trials.experiment.fill_ratio).mean(axis=2)
    steps = chosen * trials.experiment.steps / (x.shape[1] - 1)
    return np.array([steps, *np.array([median_interval(each) for each in errors.T]).T])


def draw(axes: Axes, results: Iterable[Trials]) -> None:
    """A line for each filter, in a band that is its interval."""
    for trials in results:
        steps, middle, low, high = error_over_time(trials)
        axes.fill_between(steps, low, high, color=HUES[trials.experiment.filter], alpha=0.25, linewidth=0)
        axes.plot(steps, middle, color=HUES[trials.experiment.filter], linewidth=1.4)
    axes.set(yscale="log", ylim=(3e-4, 1))
    figures.clean(axes)


def picture_of(found: Results) -> Figure:
    """Errors over time: a column for each of IN_PICTURE, a row for under- and for overconfident robots."""
    figure = figures.empty_figure(figures.WIDTH, 5)
    grid = figure.subplots(2, len(IN_PICTURE), sharex="col", sharey=True)
    for row, name, world in zip(
        grid, ("under", "over"), ((0.55, 0.95, 0.55), (0.95, 0.55, 0.95)), strict=True
    ):
        for axes, (title, (source, is_meant)) in zip(row, IN_PICTURE.items(), strict=True):
            own = [(each, each.experiment) for each in found[source] if each.experiment.is_dynamic]
            own = [
                (each, e) for each, e in own if (e.fill_ratio, e.true_accuracy, e.flawed_accuracy) == world
            ]
            draw(axes, [each for each, e in own if is_meant(e)])
            axes.set_title(f"{title}, {name}confident", fontsize=figures.SMALL)
    figure.supylabel("mean error of x", fontsize=figures.MEDIUM)
    figures.add_caption(figure, "step", "")
    looks = zip(FILTER_NAMES.values(), HUES.values(), strict=True)
    figures.add_legend(figure, [Line2D([], [], color=hue, label=name) for name, hue in looks])
    return figure


def main() -> int:
    """Write the tables between their marks, and the picture."""
    folder = Path(sys.argv[1])
    sys.path.insert(0, str(ROOT / "tests/peers"))
    names = (robust.GRID, robust.BEYOND, "peers")
    found = {name: experiments_in(read_table(folder / f"{name}.parquet")) for name in names}
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables_of(found).items():
        start, _, rest = text.partition(f"<!-- {name} -->\n")
        text = f"{start}<!-- {name} -->\n{table}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    PAGE.write_text(text, encoding="utf-8")
    figures.save_figure(picture_of(found), PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
