"""A robot's firmware image under QEMU in a swarm of ten, with its mirror: every frame is compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import cache
from pathlib import Path

import can

from mcp_asdf_tools.bus.frames import Action, Command, encode_command
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from mcp_asdf_tools.robots.node import RobotNode
from mcp_asdf_tools.robots.record import RobotRecord, TickConfig
from mcp_asdf_tools.tables.thresholds import generate
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import World
from support import ROOT, run
from targets.c_node import WARNINGS
from targets.qemu import Board

SOURCE = ROOT / "c_ref/ports/slcan"
BOARDS = {"cortex-m3": "mps2-an385", "cortex-m4": "mps2-an386", "rv32imc": "virt"}
"""Name of the toolchain file, and the board that runs its code."""

IMAGE_ID, ROBOTS = 3, 10
FILL_RATIO, ACCURACY, FLAWED_ACCURACY = 0.55, 0.95, 0.55
SEED = 20261121
TIMEOUT = 20.0


Send = Callable[[Sequence[can.Message]], None]
Receive = Callable[[], can.Message | None]


class DifferenceError(AssertionError):
    """The image said something else than its mirror, or nothing."""


def build(target: str, folder: Path, filter_period: int, flags: str = "") -> Path:
    """Build the image for a key of BOARDS, or for this computer if "host", in ``folder``; returns it."""
    chosen = {"ID": IMAGE_ID, "B_HAT": FLAWED_ACCURACY, "FILTER_PERIOD": filter_period}
    settings = [f"-DROBOT_{name}={value}" for name, value in chosen.items()]
    if target != "host":
        settings.append(f"-DCMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake'}/{target}.cmake")
    run("cmake", "-G", "Ninja", "-S", SOURCE, "-B", folder, *settings, CFLAGS=f"{WARNINGS} {flags}")
    run("cmake", "--build", folder)
    return folder / "slcan_robot"


def mirror_node(filter_period: int) -> RobotNode:
    """The image's robot, in plain integers."""
    return RobotNode(RobotRecord(IMAGE_ID, "mirror", FLAWED_ACCURACY, _config(filter_period)))


@cache
def _config(filter_period: int) -> TickConfig:
    return TickConfig(table=generate(Decimal("0.05"), 30), filter_period=filter_period)


class Loop:
    """An image, its mirror, and its neighbours in one swarm, tick by tick.

    Attributes:
        mirror: The robot whose frames the image has to send; it runs the firmware in plain integers.
        compared: Frames that the image has sent so far, all of them as expected.
    """

    def __init__(self, send: Send, receive: Receive, filter_period: int, seed: int = SEED) -> None:
        """``send`` takes frames to the image, ``receive`` returns its next one, or None if none comes."""
        config = _config(filter_period)
        self.mirror = mirror_node(filter_period)
        self.compared = 0
        self._neighbours = {
            i: RobotNode(RobotRecord(i, "native", ACCURACY, config)) for i in range(ROBOTS) if i != IMAGE_ID
        }
        self._world = World(
            WorldSettings(robots=ROBOTS, fill_ratio=FILL_RATIO, true_accuracy=ACCURACY, seed=seed)
        )
        self._send, self._receive = send, receive
        self._commands = self._tick = 0

    def start(self) -> None:
        """Find the robot just switched on."""
        self.expect(self.mirror.start())

    def tick(self) -> None:
        """One control tick of all robots. Raises DifferenceError if the image and its mirror do not agree."""
        seen = self._world.step()
        self._order(Action.observing(seen[IMAGE_ID]))
        spoken = [frame for i, node in self._neighbours.items() for frame in node.observe(seen[i])]
        self.deliver(spoken)
        spoken += self._answers
        for i, node in self._neighbours.items():
            for frame in spoken:
                if frame.arbitration_id & 127 != i:
                    node.hear(frame)
            node.settle()
        self._order(Action.SETTLE)
        self._tick += 1

    def _order(self, action: Action) -> None:
        self._answers = self.deliver([self.command(action)])
        self.expect(self._answers)

    def command(self, action: Action) -> can.Message:
        """The next command to the image, for the present tick."""
        command = Command(DRIVER_ID, self._tick, IMAGE_ID, action, self._commands % 32)
        self._commands += 1
        return encode_command(command)

    def deliver(self, frames: Sequence[can.Message]) -> list[can.Message]:
        """Send frames to the image and to its mirror; returns what the mirror answers."""
        self._send(frames)
        return [answer for frame in frames for answer in self.mirror.hear(frame)]

    def expect(self, frames: Sequence[can.Message]) -> None:
        """The image's next frames are these."""
        for frame in frames:
            found = self._receive()
            if found is None or (found.arbitration_id, found.data) != (frame.arbitration_id, frame.data):
                raise DifferenceError(f"tick {self._tick}: expected {frame}, found {found}")
            self.compared += 1


def over(bus: can.BusABC) -> tuple[Send, Receive]:
    """The two functions that a loop needs, over a bus of python-can."""

    def send(frames: Sequence[can.Message]) -> None:
        for frame in frames:
            bus.send(frame, timeout=TIMEOUT)

    return send, lambda: bus.recv(TIMEOUT)


def open_bus(board: Board) -> can.BusABC:
    """The board's serial line as a bus of python-can."""
    return can.Bus(interface="slcan", channel=board.channel, sleep_after_open=0, ignore_config=True)
