"""The C node on a CAN controller: in the guest, two cards with a SJA1000 each are on one wire. QEMU's has bit
rates, a queue and echoes, but no bus-off, and breaks after a remote frame with a length: nobody sends one."""

from __future__ import annotations

import json
import random
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.robots.lockstep import Lockstep
from robots import ALPHA_ONE
from socketcan.test_socketcan import ESTIMATE, wait_for
from socketcan.vcan import connect, ip
from support import PATIENCE
from targets.c_node import PLAIN_BUILD, CNode, assert_same_run, node_command, python_node

pytestmark = pytest.mark.socketcan

BITRATE = "type can bitrate 500000 restart-ms 100"


@pytest.fixture
def wire() -> Iterator[can.BusABC]:
    """The other end of the wire that the node's can0 is on. Skips the test where there are no such cards."""
    for name in ("can0", "can1"):
        driver = Path(f"/sys/class/net/{name}/device/driver").resolve().name
        if driver != "kvaser_pci":
            pytest.skip("no two Kvaser cards on one wire; tests/socketcan/guest.py has a machine with them")
    ip(*(f"link set {name} {what}" for name in ("can0", "can1") for what in (BITRATE, "up")))
    with connect("can1") as bus:
        yield bus
    ip("link set can0 down", "link set can1 down")


def details(name: str) -> dict[str, Any]:
    """What the kernel says of a controller."""
    done = subprocess.run(["ip", "-details", "-json", "link", "show", name], capture_output=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)[0]["linkinfo"]["info_data"]
    return found


def test_a_node_on_a_controller_has_the_bits_of_a_python_node(
    wire: can.BusABC, tmp_path_factory: pytest.TempPathFactory
) -> None:
    draw, frames = random.Random(5), list[can.Message]()
    options = ("--lockstep", "--b-hat", 0.75, "--filter-period", 5, "--steps", 25)
    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), "can0", 3, *options) as node:
        lockstep = Lockstep(wire, timeout=PATIENCE, on_frame=frames.append)
        lockstep.wait_until_up([3], PATIENCE)
        for tick in range(25):
            lockstep.observe({3: Observation(draw.randrange(2))})
            for robot in (0, 1, 2):
                frames.append(
                    encode_estimate(
                        Estimate(robot, draw.randrange(2**23), ALPHA_ONE, tick % 32), FrameFormat()
                    )
                )
                wire.send(frames[-1], timeout=PATIENCE)
            lockstep.estimates([3])
            lockstep.settle([3])
        figures = node.summary()
    expected = python_node(3, 0.75, filter_period=5)
    assert_same_run(frames, figures, expected)
    assert figures["updates"] > 0
    assert (figures["ticks"], figures["heard"], figures["filtered_by"]) == (25, 75, "kernel")
    assert (figures["unsent"], figures["error_frames"], figures["overflowed"]) == (0, 0, 0)


def test_a_controller_may_be_restarted_at_another_bit_rate(
    wire: can.BusABC, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The node ticks on meanwhile, and afterwards sends and hears again."""
    (tmp_path / "value").write_text("1", encoding="ascii")
    options = ("--sensor", tmp_path / "value", "--steps-per-second", 50)
    assert details("can0")["bittiming"]["bitrate"] == 500_000
    assert details("can0")["restart_ms"] == 100
    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), "can0", 0, *options) as node:
        wait_for(wire, 5)
        ip("link set can0 down")
        time.sleep(2)
        ip("link set can0 type can bitrate 250000", "link set can0 up")
        wait_for(wire, 5)
        wire.send(ESTIMATE)
        wait_for(wire, 5)
        figures = node.stop()
    assert details("can0")["bittiming"]["bitrate"] == 250_000
    assert (figures["downs"], figures["heard"]) == (1, 1)
    assert figures["unsent"] > 0
