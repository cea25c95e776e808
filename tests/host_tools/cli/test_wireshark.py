"""Wireshark's own dissector reads a swarm's frames, as docs/frame.md says."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections import Counter
from pathlib import Path

from mcp_asdf_tools.cli.main import main
from support import ROOT, require

PAGE = (ROOT / "docs/frame.md").read_text(encoding="utf-8")
ROBOTS, TICKS, SECONDS = 3, 50, 5


def commands() -> tuple[list[str], list[str]]:
    """The page's two commands: one that writes a log, one that reads it."""
    found = re.search(r"```text\nmcp-asdf (swarm .*--log run\.blf)\ntshark (.*)\n```", PAGE)
    assert found is not None
    return shlex.split(found[1]), shlex.split(found[2])


def test_wireshark_shows_every_frame_as_a_transfer(tmp_path: Path) -> None:
    tshark = require("tshark", "tshark")
    swarm, reading = commands()
    log = str(tmp_path / "run.blf")
    assert main([log if word == "run.blf" else word for word in swarm]) == 0
    command = [tshark, *(log if word == "run.blf" else word for word in reading)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    kinds = Counter(re.findall(r"Message: (\d+)", done.stdout))
    assert kinds == {"3000": ROBOTS * TICKS, "7509": ROBOTS * SECONDS}
    assert "Heartbeat.1.0" in done.stdout


def test_wireshark_reads_candump_logs_without_their_last_column(tmp_path: Path) -> None:
    tshark = require("tshark", "tshark")
    log = tmp_path / "run.log"
    assert main(["swarm", "--robots", "2", "--steps", "5", "--quiet", "--log", str(log)]) == 0
    log.write_text(re.sub(r" [RT]$", "", log.read_text(), flags=re.MULTILINE))
    done = subprocess.run([tshark, "-r", log], capture_output=True, text=True, check=True)
    assert len(done.stdout.splitlines()) == 2 * 5 + 2
