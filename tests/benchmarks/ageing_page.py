"""Put the tables of the study of sensors that age into docs/ageing.md, and its picture beside it.

mcp-asdf reproduce --part ageing --output FOLDER
PYTHONPATH=tests/peers mcp-asdf sweep tests/peers/ageing.toml --record 1000 --output FOLDER/peers.parquet
PYTHONPATH=tests python -m benchmarks.ageing_page FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.robust_page import ROOT, put_tables, small_picture
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import experiments_in, read_table
from mcp_asdf_tools.reproduction import ageing, robust
from mcp_asdf_tools.robots.population import FILTER_NAMES

PAGE, PICTURE = ROOT / "docs/ageing.md", ROOT / "docs/images/ageing.webp"
PEERS = {"oracle": "knows b now", "mean-accuracy": "knows its mean", "ageing-bayescpf": "BayesCPF"}


def column_of(experiment: Experiment) -> str:
    """The filter, or what the firmware knows."""
    return PEERS.get(experiment.firmware, FILTER_NAMES[experiment.filter])


def main() -> int:
    """Write the tables between their marks, and the picture."""
    folder = Path(sys.argv[1])
    sys.path.insert(0, str(ROOT / "tests/peers"))
    own, peers = (experiments_in(read_table(folder / f"{name}.parquet")) for name in ("ageing", "peers"))
    head = "error of the last quarter (95 % interval)"
    tables = {
        "filters": robust.table_of("", own, ageing.row_of),
        "peers": robust.table_of("", peers, ageing.row_of, robust.Special(column=column_of)),
    }
    put_tables(PAGE, {name: each.lines(robust.late, head) for name, each in tables.items()})
    PICTURE.write_bytes(small_picture(ageing.picture_of(own)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
