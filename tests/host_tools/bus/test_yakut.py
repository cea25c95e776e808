"""Cyphal's command-line tool reads a running swarm, by the commands that docs/frame.md shows."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.fixed_point import alpha_to_word
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Message
from messages import DEFAULT, write_regulated_types
from support import PATH, PATIENCE, ROOT, interruptible, require

ROBOTS = 3
PAGE = (ROOT / "docs/frame.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables that show yakut OpenCyphal's types and ours, and a home for its compiled files."""
    folder = tmp_path_factory.mktemp("types")
    write_regulated_types(folder)
    path = f"{ROOT / 'host_tools/mcp_asdf_tools/bus/dsdl'}{os.pathsep}{folder}"
    home = str(tmp_path_factory.mktemp("home"))
    return {**os.environ, "PATH": PATH, "CYPHAL_PATH": path, "HOME": home, "COLUMNS": "160", "LINES": "60"}


@contextmanager
def swarm(environment: dict[str, str], *options: str) -> Iterator[list[str]]:
    """A swarm that runs; gives the documented command that joins its bus, without what it is to do."""
    require("yakut")
    command = [require("mcp-asdf"), "swarm", "--robots", f"{ROBOTS}", "--set", "comms-period=20"]
    endless = ["--filter-period", "1000", "--steps", "100000000", "--slcan", "0", *options]
    endless += ["--clock", "real-time", "--steps-per-second", "200"]
    quiet, told = subprocess.DEVNULL, subprocess.PIPE
    with interruptible():
        started = subprocess.Popen(command + endless, env=environment, stdout=quiet, stderr=told, text=True)
    with started as running:
        assert running.stderr
        where = re.search(r"socket://\S+:(\d+)", running.stderr.readline())
        try:
            assert where
            yield documented(where[1])
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate()


def documented(port: str) -> list[str]:
    """The page's command for port 20000, for another port."""
    line = next(line for line in PAGE.splitlines() if line.startswith("yakut") and "slcan" in line)
    *command, monitor = shlex.split(line.replace("20000", port))
    assert monitor == "monitor"
    return command


@pytest.mark.slow
def test_it_prints_what_the_robots_broadcast(environment: dict[str, str], tmp_path: Path) -> None:
    """Every estimate that it shows is in the swarm's own log, member by member."""
    wanted = ["sub", "3000:mcp_asdf_messages.estimate"]
    assert " ".join(["yakut", *wanted]) in PAGE
    with swarm(environment, "--log", str(tmp_path / "run.log")) as yakut:
        command = [*yakut[:1], "--json", *yakut[1:], *wanted, "--count", "30", "+M"]
        shown = subprocess.run(
            command, env=environment, capture_output=True, timeout=PATIENCE, check=True
        ).stdout
    estimates = [json.loads(line)["3000"] for line in shown.splitlines()]
    assert {estimate["_meta_"]["source_node_id"] for estimate in estimates} == set(range(ROBOTS))
    assert {message_of(estimate) for estimate in estimates} <= logged(tmp_path / "run.log")


def message_of(estimate: dict[str, Any]) -> Message:
    meta = estimate["_meta_"]
    assert meta["dtype"] == "mcp_asdf_messages.Estimate.1.0"
    alpha = alpha_to_word(estimate["alpha"])
    return Message(meta["source_node_id"], estimate["x_q23"], alpha, meta["transfer_id"] % 32)


def logged(log: Path) -> set[Message]:
    with can.LogReader(log) as reader:
        found = (frames.decode(frame, DEFAULT) for frame in reader)
        return {message for message in found if isinstance(message, Message)}
