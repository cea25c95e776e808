"""Wireshark's own dissector reads a swarm's frames, as docs/frame.md says."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from support import ROOT, require

PAGE = (ROOT / "docs/frame.md").read_text(encoding="utf-8")
ROBOTS, TICKS, SECONDS = 3, 50, 5


def test_wireshark_shows_every_frame_as_a_transfer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's commands: one writes a log, one converts it, one reads it."""
    tshark = require("tshark", "tshark")
    monkeypatch.chdir(tmp_path)
    found = re.search(r"```text\nmcp-asdf (swarm .*)\ncan_logconvert (.*)\ntshark (.*)\n```", PAGE)
    assert found is not None
    swarm, converting, reading = map(shlex.split, found.groups())
    assert main(swarm) == 0
    subprocess.run([sys.executable, "-m", "can.logconvert", *converting], check=True)
    done = subprocess.run([tshark, *reading], capture_output=True, text=True, check=True)
    kinds = Counter(re.findall(r"Message: (\d+)", done.stdout))
    assert kinds == {"3000": ROBOTS * TICKS, "7509": ROBOTS * SECONDS}
    assert "Heartbeat.1.0" in done.stdout
