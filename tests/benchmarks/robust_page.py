"""Put the tables of the robust filter's study into docs/robust.md.

mcp-asdf reproduce --part robust --output FOLDER
PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/peers.toml --record 500 --output FOLDER/peers.parquet
python tests/benchmarks/robust_page.py FOLDER
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.reproduction import robust
from mcp_asdf_tools.robots.population import FILTER_NAMES

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/robust.md"

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
        entries = [each.entries[place] for each in (under, over) if place in each.entries]
        return ", ".join(robust.error(entry.measures["late"].value) for entry in entries)

    rows = dict.fromkeys(row for row, _ in under.entries)
    lines = [f"| {head} | {' | '.join(under.columns)} |", "|---" * (len(under.columns) + 1) + "|"]
    lines += [f"| {row} | {' | '.join(shown((row, each)) for each in under.columns)} |" for row in rows]
    return "\n".join(lines)


def halves(results: list[Trials], special: robust.Special, row: object) -> dict[str, robust.Table]:
    """Two tables: of the underconfident, with those of which none are flawed, and of the overconfident."""
    over = [each for each in results if each.experiment.true_accuracy < 0.6]
    under = [each for each in results if each.experiment.true_accuracy >= 0.6]
    return {
        name: robust.table_of(name, some, row, special)  # type: ignore[arg-type]
        for name, some in (("under", under), ("over", over))
    }


def main() -> int:
    """Write the tables between their marks."""
    folder = Path(sys.argv[1])
    sys.path.insert(0, str(ROOT / "tests/peers"))
    found = {
        name: experiments_in(read_table(folder / f"{name}.parquet"))
        for name in (robust.GRID, robust.BEYOND, "peers")
    }
    grid = robust.table_of("The paper's grid", found[robust.GRID], robust.grid_row)
    plain = [each for each in found["peers"] if each.experiment.steps == 20_000]
    worlds = [each for each in found["peers"] if each not in plain or each.experiment.firmware in WORLDS]
    peers = [each for each in plain if each.experiment.firmware not in WORLDS]
    head = "underconfident, overconfident"
    tables = {
        "grid": grid.lines(robust.whole, robust.WHOLE),
        "beyond": pairs(halves(found[robust.BEYOND], robust.PLAIN, beyond_row), head),
        "peers": pairs(halves(peers, PEERS, row_of), head),
        "worlds": pairs(halves(worlds, PEERS, row_of), head),
    }
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables.items():
        start, _, rest = text.partition(f"<!-- {name} -->\n")
        text = f"{start}<!-- {name} -->\n{table}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    PAGE.write_text(text, encoding="utf-8")
    return 0


def beyond_row(experiment: Experiment) -> str:
    """The row without what all have in common."""
    return re.sub(r", (under|over)confident|, 0 % flawed", "", robust.row_of(experiment))


if __name__ == "__main__":
    sys.exit(main())
