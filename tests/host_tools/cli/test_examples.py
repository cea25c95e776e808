"""Examples of help texts run as they stand."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from mcp_asdf_tools.cli import main as cli
from support import ROOT, run

NOT_RUN = (
    r"--interface socketcan|--channel|--device",  # wants a CAN interface
    r"--view|^view (?!.*--export)|--interface udp_multicast|--slcan",  # ends with Ctrl-C, or wants a port
    r"^reproduce|--steps 100000000",  # takes minutes or hours
    r"--scheduler|--kind curve|^table --verify",  # wants several machines, a sweep over both, an image
)
"""Examples that are parsed alone."""
FIRST = (
    "simulate --topology dynamic --steps 2000 --trials 1 --record 100 --output run.parquet",
    "swarm --steps 200 --log run.log",
    "sweep grid.toml --record 10",
)
"""Commands that make what examples read."""
GRID = """\
robots = 4
steps = 2000
trials = 4
flawed = 2
filter = ["none", "asdf-plus"]
fill_ratio = [0.55, 0.95]
"""


@pytest.mark.slow
def test_the_examples_run(tmp_path: Path) -> None:
    """As they stand, but for the length of swarms."""
    shutil.copytree(ROOT / "tables", tmp_path / "tables")
    (tmp_path / "grid.toml").write_text(GRID)
    texts = [line for name in cli.COMMANDS for line in cli._load(name).EPILOG.splitlines()]
    found = [
        re.sub(r"\s+#.*", "", line).removeprefix("  mcp-asdf ") for line in texts if "  mcp-asdf " in line
    ]
    lines = [line for line in found if not any(re.search(each, line) for each in NOT_RUN)]
    assert len(lines) > 20
    for line in (*FIRST, *lines):
        if line in ("sweep grid.toml", "simulate --trials 1 --record 100 --output run.parquet"):
            line += " --output of_its_own.parquet"  # noqa: PLW2901
            (tmp_path / "of_its_own.parquet").unlink(missing_ok=True)
        is_long = line.startswith("swarm") and "--steps" not in line
        run("sh", "-exc", f"mcp-asdf {line}{' --steps 300' * is_long}", cwd=tmp_path, MPLBACKEND="Agg")
