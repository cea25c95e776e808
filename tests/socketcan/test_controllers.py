"""The C node on a CAN controller: in the guest, two cards with a SJA1000 each are on one wire. QEMU's has bit
rates, a queue and echoes, but no bus-off, and breaks after a remote frame with a length: nobody sends one."""

from __future__ import annotations

import json
import random
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.robots.lockstep import Lockstep
from robots import ALPHA_ONE
from socketcan.test_socketcan import ESTIMATE_OF_ROBOT_3
from socketcan.vcan import connect, ip, wait_for_frames
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


def bit_rate_of(name: str) -> int:
    """Return the bits a second that the kernel has set for a controller."""
    done = subprocess.run(["ip", "-details", "-json", "link", "show", name], capture_output=True, check=True)
    [description] = json.loads(done.stdout)
    return int(description["linkinfo"]["info_data"]["bittiming"]["bitrate"])


def drive_robot_3(wire: can.BusABC, ticks: int) -> list[can.Message]:
    """Command robot 3 through so many ticks. Robots 0, 1 and 2 send an estimate in each tick.

    Observations and estimates are drawn with a fixed seed. Returns all frames on the wire, in order.
    """
    draw, frames = random.Random(5), list[can.Message]()
    lockstep = Lockstep(wire, timeout=PATIENCE, on_frame=frames.append)
    lockstep.wait_until_up([3], PATIENCE)
    for tick in range(ticks):
        lockstep.observe({3: Observation(draw.randrange(2))})
        for robot in (0, 1, 2):
            estimate = Estimate(robot, draw.randrange(2**23), ALPHA_ONE, tick % 32)
            frames.append(encode_estimate(estimate, FrameFormat()))
            wire.send(frames[-1], timeout=PATIENCE)
        lockstep.wait_for_estimates([3])
        lockstep.settle([3])
    return frames


def test_a_node_on_a_controller_has_the_bits_of_a_python_node(
    wire: can.BusABC, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """It hears three robots in each of 25 ticks, and neither loses a frame nor meets an error.

    ``assert_same_run`` compares its frames and its final state with those of a Python node.
    """
    options = ("--lockstep", "--b-hat", 0.75, "--filter-period", 5, "--steps", 25)
    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), "can0", 3, *options) as node:
        frames = drive_robot_3(wire, ticks=25)
        summary = node.summary()

    assert_same_run(frames, summary, python_node(3, b_hat=0.75, filter_period=5))
    assert summary["updates"] > 0, "of its accuracy"
    assert summary["ticks"] == 25
    assert summary["heard"] == 3 * 25, "an estimate of three robots in each tick"
    assert summary["filtered_by"] == "kernel"
    assert summary["unsent"] == 0
    assert summary["error_frames"] == 0
    assert summary["overflowed"] == 0


def test_a_node_goes_on_when_its_controller_is_restarted_at_another_bit_rate(
    wire: can.BusABC, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The node ticks on meanwhile, and afterwards sends and hears again."""
    (tmp_path / "value").write_text("1", encoding="ascii")
    options = ("--sensor", tmp_path / "value", "--steps-per-second", 50)
    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), "can0", 0, *options) as node:
        wait_for_frames(wire, 5)
        ip("link set can0 down")
        time.sleep(2)
        ip("link set can0 type can bitrate 250000", "link set can0 up")
        wait_for_frames(wire, 5)
        wire.send(ESTIMATE_OF_ROBOT_3)
        wait_for_frames(wire, 5)
        summary = node.stop()

    assert bit_rate_of("can0") == 250_000
    assert summary["downs"] == 1
    assert summary["heard"] == 1, "the estimate that is sent after the restart"
    assert summary["unsent"] > 0, "frames meanwhile"
