"""Cyphal's command-line tool reads a running swarm, by the commands of docs/platforms/can_tools.md."""

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

import pytest

from mcp_asdf.fixed_point import alpha_word_from_float
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import Estimate
from mcp_asdf_tools.recording.frame_logs import read_log
from messages import DEFAULT_FORMAT, write_regulated_types
from support import PATH, PATIENCE, ROOT, interruptible, require

PAGE_OF_CAN_TOOLS = (ROOT / "docs/platforms/can_tools.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_yakut_prints_what_the_robots_of_a_running_swarm_broadcast(tmp_path: Path) -> None:
    """Yakut shows 30 estimates from all three robots. Each estimate is in the swarm's own log."""
    require("yakut")
    environment = environment_of_yakut(tmp_path)
    subcommand = "sub 3000:mcp_asdf_messages.estimate"  # subscribes to subject 3000
    assert f"yakut {subcommand}" in PAGE_OF_CAN_TOOLS

    log = tmp_path / "run.log"
    with running_swarm(f"--robots 3 --log {log}", environment) as port:
        with_sender = "+M"  # the metadata of a message has its sender
        command = [*documented_command(port), *subcommand.split(), "--count", "30", with_sender]
        output = subprocess.check_output(command, env=environment, timeout=PATIENCE)
    shown_estimates = {estimate_in_line(line) for line in output.splitlines()}

    assert {estimate.sender for estimate in shown_estimates} == {0, 1, 2}
    assert shown_estimates <= estimates_in_log(log)


def environment_of_yakut(folder: Path) -> dict[str, str]:
    """Return environment variables by which yakut finds our types of messages, and Cyphal's in a folder."""
    write_regulated_types(folder)
    folders_of_types = f"{ROOT / 'host_tools/mcp_asdf_tools/bus/dsdl'}{os.pathsep}{folder}"
    return {**os.environ, "PATH": PATH, "CYPHAL_PATH": folders_of_types, "HOME": str(folder)}


@contextmanager
def running_swarm(options: str, environment: dict[str, str]) -> Iterator[str]:
    """Run a swarm in real time, and yield the port at which it serves its bus as an slcan adapter."""
    endless = "--steps 100000000 --clock real-time --steps-per-second 200 --comms-period 20"
    command = f"{require('mcp-asdf')} swarm {endless} --filter-period 1000 --slcan 0 {options}"
    with interruptible():
        swarm = subprocess.Popen(
            command.split(), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
    with swarm:
        try:
            assert swarm.stderr
            address = re.search(r"socket://\S+:(\d+)", swarm.stderr.readline())
            assert address
            yield address[1]
        finally:
            swarm.send_signal(signal.SIGINT)
            swarm.communicate()


def documented_command(port: str) -> list[str]:
    """Return the page's command for an slcan adapter, at another port, without its subcommand."""
    lines = PAGE_OF_CAN_TOOLS.splitlines()
    line = next(line for line in lines if line.startswith("yakut") and "slcan" in line)
    yakut, *options, monitor = shlex.split(line.replace("20000", port))
    assert monitor == "monitor"
    return [yakut, "--json", *options]


def estimate_in_line(line: bytes) -> Estimate:
    """Return the estimate that a line of yakut shows in JSON."""
    fields: dict[str, Any] = json.loads(line)["3000"]
    meta = fields["_meta_"]
    assert meta["dtype"] == "mcp_asdf_messages.Estimate.1.0"
    alpha = alpha_word_from_float(fields["alpha"])
    return Estimate(meta["source_node_id"], fields["x_q23"], alpha, meta["transfer_id"] % 32)


def estimates_in_log(log: Path) -> set[Estimate]:
    """Return all estimates in a log."""
    decoded = [frames.decode_estimate(frame, DEFAULT_FORMAT) for frame in read_log(log)]
    return {estimate for estimate in decoded if isinstance(estimate, Estimate)}
