"""Put the tables of the robust filter's study into docs/robust.md, and draw the picture of that page.

mcp-asdf reproduce --part robust --output FOLDER
PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/peers.toml --record 500 --output FOLDER/peers.parquet
python tests/benchmarks/robust_page.py FOLDER
"""

from __future__ import annotations

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
from mcp_asdf_tools.reproduction import robust
from mcp_asdf_tools.robots.population import FILTER_NAMES

ROOT = Path(__file__).resolve().parents[2]
PAGE, PICTURE = ROOT / "docs/robust.md", ROOT / "docs/images/robust.webp"

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
    halves = [
        [each for each in results if (each.experiment.true_accuracy < 0.6) is over] for over in (False, True)
    ]
    under, over = (robust.table_of("", half, row, special) for half in halves)

    def shown(place: tuple[str, str]) -> str:
        return ", ".join(robust.late(each.entries[place]) for each in (under, over) if place in each.entries)

    rows = dict.fromkeys(row for row, _ in under.entries)
    lines = [f"| underconfident, overconfident | {' | '.join(under.columns)} |"]
    lines += ["|---" * (len(under.columns) + 1) + "|"]
    lines += [f"| {row} | {' | '.join(shown((row, each)) for each in under.columns)} |" for row in rows]
    return "\n".join(lines)


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
    peers, worlds = ([e for e in found["peers"] if is_world(e.experiment) is hard] for hard in (False, True))
    return {
        "grid": grid.lines(robust.whole, robust.WHOLE),
        "beyond": pairs(found[robust.BEYOND], beyond_row),
        "peers": pairs(peers, row_of, PEERS),
        "worlds": pairs(worlds, row_of, PEERS),
    }


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
    return replace(trials, records={"x": x[:, np.linspace(0, x.shape[1] - 1, POINTS + 1).astype(int)]})


def picture_of(found: Results) -> Figure:
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


def small_picture(figure: Figure) -> bytes:
    """The figure as WebP, since it is kept with the sources."""
    image = io.BytesIO()
    figure.savefig(image, format="webp", dpi=140, pil_kwargs={"quality": 75})
    return image.getvalue()


def put_tables(page: Path, tables: Mapping[str, str]) -> None:
    """Write tables between their marks."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        start, _, rest = text.partition(f"<!-- {name} -->\n")
        text = f"{start}<!-- {name} -->\n{table}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    page.write_text(text, encoding="utf-8")


def main() -> int:
    """Write the tables between their marks, and the picture."""
    folder = Path(sys.argv[1])
    sys.path.insert(0, str(ROOT / "tests/peers"))
    names = (robust.GRID, robust.BEYOND, "peers")
    found = {name: experiments_in(read_table(folder / f"{name}.parquet")) for name in names}
    put_tables(PAGE, tables_of(found))
    PICTURE.write_bytes(small_picture(picture_of(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
