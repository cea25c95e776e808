"""The base installation: what works without the extras, and how a missing one is named."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.extras import EXTRAS

HIDING = f"""\
import sys

class Finder:
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {sorted(EXTRAS)}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Finder())
"""


def in_base(folder: Path, *lines: str) -> tuple[list[int], list[str]]:
    """Run commands one after the other in a Python that has none of the extras; exit codes and errors."""
    code = (
        f"{HIDING}from mcp_asdf_tools.cli.main import main\n"
        f"print('codes', *[main(line.split()) for line in {list(lines)}])"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    last = done.stdout.splitlines()[-1:]
    return [int(each) for line in last for each in line.split()[1:]], done.stderr.splitlines()


def test_the_base_runs_robots_and_knows_all_options(tmp_path: Path) -> None:
    """The options of commands, too, that need more to run."""
    lines = [
        "swarm --robots 4 --steps 30 --filter-period 10 --quiet --log run.log",
        "swarm --robots 4 --steps 5 --topology dynamic --quiet",
        "replay run.log",
        "view run.log --export run.html",
        "table --output tables --neighbours 4",
        "radio --id 3 --robots 3 --steps 1 --steps-per-second 500",
        "firmware vendor",
        "dbc --output mcp_asdf.dbc",
        "crosscheck --replay robot:2:1:64:0:2147483648,step:1",
        *(f"{name} --help" for name in cli.COMMANDS),
    ]
    codes, errors = in_base(tmp_path, *lines)
    assert codes == [0] * len(lines), errors


def test_a_missing_extra_is_named_in_one_line(tmp_path: Path) -> None:
    needed = {
        "simulate --steps 1000 --trials 1": ("pyarrow", "study"),
        "sweep physical --output physical.parquet": ("pyarrow", "study"),
        "score x.parquet": ("pyarrow", "study"),
        "plot x.parquet x.png": ("matplotlib", "study"),
        "reproduce --quick": ("pyarrow", "study"),
        "swarm --steps 3 --view": ("uvicorn", "view"),
    }
    codes, errors = in_base(tmp_path, *needed)
    assert codes == [2] * len(needed) and len(errors) == len(needed)
    for told, (module, extra) in zip(errors, needed.values(), strict=True):
        assert module in told and f"pip install 'mcp-asdf[{extra}]'" in told
