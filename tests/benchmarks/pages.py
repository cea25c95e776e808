"""Put what a study has found into the documentation: tables between their marks, and a picture.

mcp-asdf reproduce --output FOLDER                   # also the verdicts, into tests/data/study_verdicts.csv
PYTHONPATH=tests python -m benchmarks.pages study FOLDER

mcp-asdf reproduce --part robust --output FOLDER     # or ageing, or scale, which has no peers
PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/peers.toml --record 500 --output FOLDER/peers.parquet
PYTHONPATH=tests python -m benchmarks.pages robust FOLDER

The peers of ageing are tests/peers/ageing.toml with --record 1000; the costs of scale are measured again. The
exit code is 1 if the report of a study has no verdicts.
"""

from __future__ import annotations

import csv
import io
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import Name, errors_over_time
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.reproduction import ageing, robust, scaling
from mcp_asdf_tools.robots.population import FILTER_NAMES

ROOT = Path(__file__).resolve().parents[2]

Results = Mapping[str, Sequence[Trials]]
"""Of a study's files and of the peers, by name."""

# --- Tables ----------------------------------------------------------------------------------------------

COLUMNS = {
    **{"bayescpf": "BayesCPF", "all-counts": "all counts"},
    **{"oracle": "knows b now", "mean-accuracy": "knows its mean", "ageing-bayescpf": "BayesCPF"},
}
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
    if experiment.sensor:
        words.append("the floor changes")
    if experiment.firmware in WORLDS:
        words.append(WORLDS[experiment.firmware])
    elif not experiment.sensor and share not in words[0]:
        words[0] += share
    if experiment.steps == 10_000:
        words.append("10,000 steps")
    return ", ".join(words)


PEERS = robust.Special(
    liars=lambda each: int(each.firmware[-1]) if each.firmware.startswith("liars") else 0,
    late_f=lambda each: 0.95 if each.sensor == "changing-floor" else each.fill_ratio,
    column=column_of,
)


def pairs(results: Sequence[Trials], row: Name, special: robust.Special = robust.PLAIN) -> str:
    """A table of late errors, of the underconfident, or where none are flawed, and of the overconfident."""
    entries: dict[robust.Place, list[robust.Entry]] = {}
    for over in (False, True):
        half = [each for each in results if (each.experiment.true_accuracy < 0.6) is over]
        for place, entry in robust.table_of("", half, row, special).entries.items():
            entries.setdefault(place, []).append(entry)
    return robust.in_markdown(
        entries, lambda own: ", ".join(map(robust.late, own)), "underconfident, overconfident"
    )


def beyond_row(experiment: Experiment) -> str:
    """The row without what all have in common."""
    return re.sub(r", (under|over)confident|, 0 % flawed", "", robust.row_of(experiment))


def is_world(experiment: Experiment) -> bool:
    """Whether it is a hard world, not a peer."""
    return experiment.firmware in WORLDS or bool(experiment.sensor)


def is_for_the_way_back(experiment: Experiment) -> bool:
    """Whether it says what the way back and the trend are worth, which the page has in words."""
    return experiment.firmware == "first-draft" or 2 * experiment.flawed == experiment.robots


def is_in_page(experiment: Experiment) -> bool:
    """Whether its row beyond the grid decides: others are like these, or docs/ageing.md has them."""
    e = experiment
    return e.latency == e.is_dynamic and e.robots not in {10, 127} and e.drift == "none"


def tables_of_robust(found: Results) -> dict[str, str]:
    """The tables of docs/robust.md by the words of their marks."""
    grid = robust.table_of("", found[robust.GRID], robust.grid_row)
    shown = [each for each in found["peers"] if not is_for_the_way_back(each.experiment)]
    peers, worlds = ([e for e in shown if is_world(e.experiment) is hard] for hard in (False, True))
    return {
        "grid": robust.in_markdown(grid.entries, robust.whole, robust.WHOLE),
        "beyond": pairs([e for e in found[robust.BEYOND] if is_in_page(e.experiment)], beyond_row),
        "peers": pairs(peers, row_of, PEERS),
        "worlds": pairs(worlds, row_of, PEERS),
    }


def tables_of_ageing(found: Results) -> dict[str, str]:
    """Those of docs/ageing.md, without the ways to age of which the picture says enough."""
    special = robust.Special(column=column_of)
    ways = [e for e in found["ageing"] if e.experiment.drift != "stepped" and not e.experiment.drift_spread]
    tables = {
        mark: robust.table_of("", each, ageing.row_of, special)
        for mark, each in (("filters", ways), ("peers", found["peers"]))
    }
    head = f"{robust.LATE} (95 % interval)"
    return {name: robust.in_markdown(each.entries, robust.late, head) for name, each in tables.items()}


def tables_of_scale(found: Results) -> dict[str, str]:
    """That of many robots, in docs/robust.md: the smallest and the largest swarm."""
    sizes = {each.experiment.robots for each in found["scale"]}
    ends = [each for each in found["scale"] if each.experiment.robots in {min(sizes), max(sizes)}]
    own = robust.table_of("", ends, scaling.row_of, scaling.COSTS)
    return {"scale": scaling.lines_of(own)}


# --- The picture -----------------------------------------------------------------------------------------

IN_PICTURE: dict[str, tuple[str, Callable[[Experiment], bool]]] = {
    "30 % flawed": (robust.GRID, lambda each: 10 * each.flawed == 3 * each.robots),
    "30 % flawed and 5 liars": ("peers", lambda each: each.firmware == "liars-5" and not each.sensor),
    "50 % flawed": (robust.GRID, lambda each: 2 * each.flawed == each.robots),
}
"""The columns: their results, and which of them."""

POINTS = 16
"""Of a curve, besides the start."""


def honest_and_few(trials: Trials) -> Trials:
    """The trials without liars, and with few samples."""
    x = trials.records["x"][..., : trials.experiment.robots - PEERS.liars(trials.experiment)]
    few = x[:, np.linspace(0, x.shape[1] - 1, POINTS + 1).astype(int)]
    return replace(trials, records={"x": few}, sampling_interval=trials.experiment.steps // POINTS)


def picture_of_robust(found: Results) -> Figure:
    """Errors over time: a column for each of IN_PICTURE, a row for under- and for overconfident robots."""
    panels = {}
    for name, *world in ("underconfident", 0.55, 0.95, 0.55), ("overconfident", 0.95, 0.55, 0.95):
        for title, (source, is_meant) in IN_PICTURE.items():
            own = [(each, each.experiment) for each in found[source] if each.experiment.is_dynamic]
            own = [(one, e) for one, e in own if [e.fill_ratio, e.true_accuracy, e.flawed_accuracy] == world]
            panels[f"{title}, {name}"] = [honest_and_few(each) for each, e in own if is_meant(e)]
    figure = errors_over_time(panels)
    figure.supxlabel("step")  # the page has the caption
    for axes in figure.axes:
        axes.minorticks_off()
    return figure


# --- The paper's study -----------------------------------------------------------------------------------

Row = tuple[str, str, str, int, int]
"""Claim, part, verdict, how many comparisons hold, and of how many."""


def overview_of(report: str) -> str:
    """What a report says before its claims, without links."""
    chosen = report.partition("\n\n")[2].partition("## Claims")[0]
    chosen = re.sub(r"^(#+) ", r"#\1 ", chosen, flags=re.M)
    return re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", chosen).strip()


def rows_of(comparisons: Path) -> list[Row]:
    """The verdicts with the first seed."""
    found: dict[tuple[str, ...], list[bool]] = {}
    with comparisons.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["seed"] == rows[0]["seed"]:
            key = (row["claim"], row["part"], row["verdict"])
            found.setdefault(key, []).append(row["holds"] == "yes")
    return [(*key, sum(holds), len(holds)) for key, holds in found.items()]  # type: ignore[misc]


def put_study(folder: Path) -> int:
    """Write overview and verdicts; returns the exit code."""
    report = (folder / "report.md").read_text(encoding="utf-8")
    if "Too short for verdicts" in report:
        return 1
    with (ROOT / "tests/data/study_verdicts.csv").open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(("claim", "part", "verdict", "holds", "of"))
        lines.writerows(rows_of(folder / "comparisons.csv"))
    put_tables("reproduce.md", {"results": overview_of(report)})
    return 0


# --- Pages -----------------------------------------------------------------------------------------------

Page = tuple[str, Sequence[str], Callable[[Results], Mapping[str, str]], Callable[[Results], Figure]]
"""Its name, the files that it needs, and what makes its tables and its picture."""

PAGES: dict[str, Page] = {
    "robust": ("robust.md", (*robust.FILES, "peers"), tables_of_robust, picture_of_robust),
    "ageing": ("ageing.md", (*ageing.FILES, "peers"), tables_of_ageing, ageing.picture_of),
    "scale": ("robust.md", scaling.FILES, tables_of_scale, scaling.picture_of),
}


def put_tables(page: str, tables: Mapping[str, str]) -> None:
    """Write tables between their marks."""
    path = ROOT / "docs" / page
    text = path.read_text(encoding="utf-8")
    for name, table in tables.items():
        start, _, rest = text.partition(f"<!-- {name} -->\n")
        text = f"{start}<!-- {name} -->\n{table}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    path.write_text(text, encoding="utf-8")


def main() -> int:
    """Write a page; returns the exit code."""
    part, folder = sys.argv[1], Path(sys.argv[2])
    if part == "study":
        return put_study(folder)
    page, names, tables_of, picture_of = PAGES[part]
    sys.path.insert(0, str(Path(__file__).parents[1] / "peers"))
    found = {name: experiments_in(read_table(folder / f"{name}.parquet")) for name in names}
    put_tables(page, tables_of(found))
    image = io.BytesIO()  # WebP, since it is kept with the sources
    picture_of(found).savefig(image, format="webp", dpi=140, pil_kwargs={"quality": 75})
    (ROOT / f"docs/images/{part}.webp").write_bytes(image.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
