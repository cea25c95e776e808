"""A robot's firmware image under QEMU in a swarm of ten, with its mirror: every frame is compared.

    python tests/targets/firmware_loop.py [--target NAME] [--steps N] [--seconds S]

Builds the image of c_ref/ports/slcan for a target, lets it run in lockstep with nine emulated neighbours
for N ticks as fast as it answers, then for S seconds at ten ticks per second, and prints the comparisons and
the speed of the answers. Exits with 1 at the first frame that differs, or if more than one tick in ten of
those at ten per second was late, with 2 for bad usage.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from decimal import Decimal
from functools import cache
from pathlib import Path

import can
from rich.console import Console
from rich.progress import track

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.bus.frames import Action, Command, encode_command
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.lockstep import DRIVER_ID
from mcp_asdf_tools.robots.node import NodeSettings, RobotNode
from mcp_asdf_tools.robots.rounds import TickConfig, TickedRobot
from mcp_asdf_tools.tables.thresholds import generate
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import World
from targets.qemu import Board

SOURCE = Path(__file__).resolve().parents[2] / "c_ref/ports/slcan"
BOARDS = {"cortex-m3": "mps2-an385", "cortex-m4": "mps2-an386", "rv32imc": "virt"}
"""Name of the toolchain file, and the board that runs its code."""

IMAGE_ID, ROBOTS = 3, 10
FILL_RATIO, ACCURACY, FLAWED_ACCURACY = 0.55, 0.95, 0.55
SEED = 20261121
_DAY = 86400
TIMEOUT = 20.0
PERIOD, MOST_LATE = 0.1, 0.1
"""Seconds of a tick in real time, and the share of ticks that may be late: a computer has more to do."""

_WARNINGS = (
    "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
)

Send = Callable[[Sequence[can.Message]], None]
Receive = Callable[[], can.Message | None]


class DifferenceError(AssertionError):
    """The image said something else than its mirror, or nothing."""


class LateError(AssertionError):
    """The image does not keep up with ten ticks per second."""


def build(target: str, folder: Path, filter_period: int, flags: str = "") -> Path:
    """Build the image for a key of BOARDS, or for this computer if "host", in ``folder``; returns it."""
    if shutil.which("cmake") is None:
        raise UsageError("cmake is not installed; apt-get install cmake ninja-build")
    chosen = {"ID": IMAGE_ID, "B_HAT": FLAWED_ACCURACY, "FILTER_PERIOD": filter_period}
    settings = [f"-DROBOT_{name}={value}" for name, value in chosen.items()]
    if target != "host":
        settings.append(f"-DCMAKE_TOOLCHAIN_FILE={SOURCE}/../../cmake/{target}.cmake")
    environment = {**os.environ, "CFLAGS": f"{_WARNINGS} {flags}"}
    configure = ["cmake", "-G", "Ninja", "-S", str(SOURCE), "-B", str(folder), *settings]
    for command in (configure, ["cmake", "--build", str(folder)]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise UsageError(f"the image cannot be built:\n{done.stdout}\n{done.stderr}")
    return folder / "slcan_robot"


def mirror_node(filter_period: int) -> RobotNode:
    """The image's robot, in plain integers."""
    robot = MirrorRobot(_config(filter_period), IMAGE_ID, FLAWED_ACCURACY)
    return RobotNode(TickedRobot(robot), NodeSettings(IMAGE_ID))


@cache
def _config(filter_period: int) -> Config:
    return TickConfig(table=generate(Decimal("0.05"), 30), filter_period=filter_period).in_rounds()


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
            i: RobotNode(TickedRobot(NativeRobot(config, i, ACCURACY)), NodeSettings(i))
            for i in range(ROBOTS)
            if i != IMAGE_ID
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


def demonstrate(board: Board, filter_period: int, ticks: int, seconds: float) -> str:
    """Lockstep as fast as it goes, then at ten ticks per second; returns what happened, a few lines.

    Raises DifferenceError as Loop, and LateError with those lines if too many ticks were late.
    """
    with open_bus(board) as bus:
        loop = Loop(*over(bus), filter_period)
        loop.start()
        began = time.monotonic()
        for _ in _shown(ticks, "lockstep"):
            loop.tick()
        rate = ticks / (time.monotonic() - began)
        took = [_pace(loop, time.monotonic()) for _ in _shown(round(seconds / PERIOD), "real time")]
    robot, late = loop.mirror.robot, sum(each > PERIOD for each in took)
    told = (
        f"{loop.compared} frames in {ticks + len(took)} ticks are its mirror's, bit for bit\n"
        f"x {robot.x:.6f}  b_hat {robot.b_hat:.6f}  re-estimates {robot.counters.updates}\n"
        f"highest rate {rate:.0f} ticks/s\n"
        f"at 10 ticks/s {late} of {len(took)} were late; the slowest took {1000 * max(took):.0f} ms"
    )
    if late > MOST_LATE * len(took):
        raise LateError(f"{told}: it does not keep up")
    return told


def _shown(ticks: int, what: str) -> Iterable[int]:
    """A range with a progress bar where somebody may see it."""
    console = Console(stderr=True)
    return track(range(ticks), what, transient=True, console=console, disable=not console.is_terminal)


def _pace(loop: Loop, began: float) -> float:
    """One tick at ten per second; returns its duration."""
    loop.tick()
    took = time.monotonic() - began
    time.sleep(max(0.0, PERIOD - took))
    return took


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for a run that cannot be."""
    if args.steps < 1:
        raise UsageError(f"steps is {args.steps}; it must be 1 or more")
    if not PERIOD <= args.seconds <= _DAY:
        raise UsageError(f"seconds is {args.seconds}; it must be {PERIOD}, one tick, to {_DAY}, a day")
    mirror_node(args.filter_period)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Run a firmware image in a swarm of ten and compare every frame."
    )
    parser.add_argument("--target", choices=list(BOARDS), default="cortex-m3", help="default: %(default)s")
    parser.add_argument("--steps", type=int, default=5000, help="of lockstep (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of real time (default: %(default)s)")
    parser.add_argument("--filter-period", type=int, default=1000, help="tau in ticks (default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        _check(args)
        with tempfile.TemporaryDirectory() as folder:
            image = build(args.target, Path(folder), args.filter_period)
            with Board(BOARDS[args.target], image) as board:
                print(f"{args.target} on {BOARDS[args.target]} is robot {IMAGE_ID} of {ROBOTS}; seed {SEED}")
                print(demonstrate(board, args.filter_period, args.steps, args.seconds))
    except (DifferenceError, LateError) as failure:
        print(failure)
        return 1
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
