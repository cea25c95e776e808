"""Cyphal's command-line tool reads a running swarm, by the commands of docs/platforms/can_tools.md."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate
from messages import DEFAULT, write_regulated_types
from support import PATH, PATIENCE, ROOT, interruptible, require

ROBOTS = 3
PAGE = (ROOT / "docs/platforms/can_tools.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_yakut_prints_what_the_robots_of_a_running_swarm_broadcast(tmp_path: Path) -> None:
    """Every estimate that it shows is in the swarm's own log, member by member."""
    require("yakut")
    write_regulated_types(tmp_path)
    types = f"{ROOT / 'host_tools/mcp_asdf_tools/bus/dsdl'}{os.pathsep}{tmp_path}"
    environment = {**os.environ, "PATH": PATH, "CYPHAL_PATH": types, "HOME": str(tmp_path)}
    log, wanted = tmp_path / "run.log", ["sub", "3000:mcp_asdf_messages.estimate"]
    assert " ".join(["yakut", *wanted]) in PAGE
    running = f"--robots {ROBOTS} --steps 100000000 --clock real-time --steps-per-second 200"
    settings = "--comms-period 20 --filter-period 1000"
    command = f"{require('mcp-asdf')} swarm {running} {settings} --slcan 0 --log {log}"
    quiet, told = subprocess.DEVNULL, subprocess.PIPE
    with interruptible():
        started = subprocess.Popen(command.split(), env=environment, stdout=quiet, stderr=told, text=True)
    with started as swarm:
        try:
            assert swarm.stderr
            where = re.search(r"socket://\S+:(\d+)", swarm.stderr.readline())
            assert where
            yakut, *options = documented(where[1])
            words = [yakut, "--json", *options, *wanted, "--count", "30", "+M"]
            shown = subprocess.check_output(words, env=environment, stderr=told, timeout=PATIENCE)
        finally:
            swarm.send_signal(signal.SIGINT)
            swarm.communicate()
    estimates = [json.loads(line)["3000"] for line in shown.splitlines()]

    assert {estimate["_meta_"]["source_node_id"] for estimate in estimates} == set(range(ROBOTS))
    assert {message_of(estimate) for estimate in estimates} <= logged(log)


def documented(port: str) -> list[str]:
    """The page's command for port 20000, for another port, without what it is to do."""
    line = next(line for line in PAGE.splitlines() if line.startswith("yakut") and "slcan" in line)
    *command, monitor = shlex.split(line.replace("20000", port))
    assert monitor == "monitor"
    return command


def message_of(estimate: dict[str, Any]) -> Estimate:
    meta = estimate["_meta_"]
    assert meta["dtype"] == "mcp_asdf_messages.Estimate.1.0"
    alpha = alpha_word_from_float(estimate["alpha"])
    return Estimate(meta["source_node_id"], estimate["x_q23"], alpha, meta["transfer_id"] % 32)


def logged(log: Path) -> set[Estimate]:
    with can.LogReader(log) as reader:
        found = (frames.decode_estimate(frame, DEFAULT) for frame in reader)
        return {message for message in found if isinstance(message, Estimate)}
