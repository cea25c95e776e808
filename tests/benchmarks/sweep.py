"""Speed of a sweep on two workers against one: ``python tests/benchmarks/sweep.py``.

Runs the same sweep of moving robots on both and prints the seconds of each. It means something on a machine
with two idle processors only. Exit code 1 if two workers are less than 1.9 times as fast.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

FLOOR = 1.9
SWEEP = """\
topology = "dynamic"
latency = 1
robots = 20
steps = 40000
filter = ["none", "asdf-plus"]
flawed = ["10%", "50%"]
trials = 400
"""


def seconds(workers: int) -> float:
    """Time that the sweep takes on so many workers."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "sweep.toml").write_text(SWEEP, encoding="utf-8")
        command = (
            "-m",
            "mcp_asdf_tools.cli.main",
            "sweep",
            "sweep.toml",
            "--workers",
            str(workers),
            "--json",
        )
        start = time.monotonic()
        subprocess.run([sys.executable, *command], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        return time.monotonic() - start


if __name__ == "__main__":
    one, two = seconds(1), seconds(2)
    print(f"1 worker: {one:.1f} s, 2 workers: {two:.1f} s, speed-up {one / two:.2f}")
    sys.exit(int(one / two < FLOOR))
