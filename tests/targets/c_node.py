"""Building and running ``mcp_asdf_node``, and the Python node that has to say the same."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import DEFAULT_FILTER_PERIOD, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import MAX_NODE_ID
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import PATIENCE, ROOT, made_once, require, run
from wire import record

NODES = "MCP_ASDF_NODES"
"""Environment variable: a folder with builds of the node, by name."""

SOURCES = ROOT / "c_ref/ports/linux"
WARNINGS = (
    "-Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wundef -Werror"
)
SANITIZERS = " -fsanitize=address,undefined -fno-sanitize-recover=all"
TABLE = generate(parse_omega("0.05"), q=127)
"""The table that the node is linked with."""


@dataclass(frozen=True)
class Kind:
    """A build of the node.

    Attributes:
        compiler: Its compiler, and the Debian packages that have it.
        runner: What runs the program, if it does not run by itself.
        settings: For CMake.
    """

    name: str
    compiler: tuple[str, str] = ("gcc", "gcc")
    flags: str = ""
    runner: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    def build(self, folder: Path) -> None:
        """Build the node; skips the test where tools are missing."""
        require("ninja")
        require(*self.compiler)
        words = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", *self.settings)
        run("cmake", "-G", "Ninja", "-S", SOURCES, "-B", folder, *words, CFLAGS=WARNINGS + self.flags)
        run("cmake", "--build", folder)


HOST = Kind("host", flags=SANITIZERS)
PLAIN = Kind("plain")
COVERED = Kind(
    "covered",
    ("gcov", "gcc"),
    " --coverage -O0 -Dalways_inline=unused",  # each function once
    settings=("-DCMAKE_BUILD_TYPE=Debug",),
)
CORTEX_A8 = Kind(
    "cortex-a8",
    ("arm-linux-gnueabihf-gcc", "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross"),
    runner=("qemu-arm", "-cpu", "cortex-a8"),
    settings=(f"-DCMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake/cortex-a8.cmake'}",),
)


def built(kind: Kind, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The command of a build that is made once, unless it is there already."""
    for tool in kind.runner[:1]:
        require(tool, "qemu-user")
    ready = Path(os.environ.get(NODES, "none"), kind.name)
    folder = ready if ready.exists() else made_once(tmp_path_factory, f"node {kind.name}", kind.build)
    return [*kind.runner, str(folder / "mcp_asdf_node")]


def unexecuted(folder: Path) -> set[str]:
    """Lines of the core that a covered build has not executed, or only in one way, as "file: text"."""
    rarest = dict[str, int]()
    for data in folder.glob("core/**/*.gcda"):
        report = json.loads(
            run("gcov", "--branch-probabilities", "--json-format", "--stdout", data, cwd=folder)
        )
        for file in report["files"]:
            path = Path(file["file"])
            if path.parent != ROOT / "c_ref/src" or path.stem == "mcp_asdf_image":  # which saves and restores
                continue
            lines = path.read_text(encoding="utf-8").splitlines()
            for line in file["lines"]:
                text = f"{path.name}: {lines[line['line_number'] - 1].split('/*')[0].strip()}"
                least = min([line["count"], *(branch["count"] for branch in line["branches"])])
                rarest[text] = max(least, rarest.get(text, 0)) if path.suffix == ".h" else least
    return {text for text, least in rarest.items() if least == 0}


class CNode:
    """A running ``mcp_asdf_node``.

    Attributes:
        complaints: What it said on standard error, once it has ended.
    """

    def __init__(
        self, command: Sequence[str], interface: str, robot_id: int, *options: object, **streams: Any
    ) -> None:
        """Start it with the options given, by default with the paper's filter, as ``twin`` has it.

        ``streams`` are those of subprocess.Popen.
        """
        if not any(str(option).startswith("--filter") and "period" not in str(option) for option in options):
            options = ("--filter", "asdf-plus", *options)
        words = [*command, *map(str, ("--interface", interface, "--id", robot_id, *options))]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
        self.process = subprocess.Popen(words, text=True, **pipes)

    def summary(self, status: int = 0) -> dict[str, Any]:
        """Its last line, when it has ended by itself with ``status``.

        With status 0 it must not have said anything else but that another node has its id.
        """
        printed, complaints = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == status, f"{self.process.returncode}\n{printed}\n{complaints}"
        self.complaints = complaints.splitlines()
        assert all("; give one of them another" in each for each in self.complaints) or status
        figures: dict[str, Any] = json.loads(printed)
        return figures

    def stop(self, number: signal.Signals = signal.SIGTERM) -> dict[str, Any]:
        """Its last line, after that signal."""
        self.process.send_signal(number)
        return self.summary()

    def __enter__(self) -> CNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


Start = Callable[..., CNode]
"""What starts nodes on a bus: an id and options."""


def twin(
    robot_id: int,
    b_hat: float = 0.95,
    subjects: Subjects | None = None,
    steps_per_second: int = 10,
    allow: frozenset[int] | None = None,
    **config: Any,
) -> RobotNode:
    """The Python node of the same options, on plain integers."""
    usual = {"table": TABLE, "filter": Filter.ADAPTIVE, "filter_period": DEFAULT_FILTER_PERIOD}
    start = replace(record(robot_id, "mirror", b_hat, **(usual | config)), allow=allow)
    return RobotNode(start, subjects, steps_per_second)


def content(frames: Iterable[can.Message]) -> list[str]:
    """Frames as candump writes them, for comparison."""
    return [f"{frame.arbitration_id:08X}#{frame.data.hex().upper()}" for frame in frames]


def greeted_once(frames: Iterable[can.Message]) -> list[can.Message]:
    """What one node said, without the greetings that it repeats until it is commanded."""
    said = list(frames)
    while len(said) > 1 and content(said[:1]) == content(said[1:2]):
        said.pop(0)
    return said


def assert_same_robot(figures: dict[str, Any], node: RobotNode) -> None:
    """The C node's summary has every number of the Python node."""
    robot = node.robot
    assert isinstance(robot, MirrorRobot)
    numbers = {
        **{name: getattr(robot, f"{name}_raw") for name in ("b_hat", "x_hat", "alpha", "x_bar", "beta", "x")},
        **{name: getattr(node, name) for name in ("ticks", "obeyed", "disobeyed", "unsettled")},
        **{"t": robot.t, "n": robot.n, "heard": node.reception.delivered},
        **vars(robot.counters),
        **vars(node.sent),
    }
    assert {name: figures[name] for name in numbers} == numbers


def assert_same_run(log: Iterable[can.Message], figures: dict[str, Any], node: RobotNode) -> None:
    """Of what a bus carried the C node has made what the Python node makes of it."""
    said, answers = list[can.Message](), node.start()
    for frame in log:
        if frame.arbitration_id & MAX_NODE_ID == node.id:
            said.append(frame)
        else:
            answers += node.receive_frame(frame)
    assert content(greeted_once(said)) == content(answers)
    assert_same_robot(figures, node)


def drive(bus: can.BusABC, robots: Collection[int], ticks: int, seed: int) -> list[can.Message]:
    """Let robots observe what a seeded generator draws, exchange and settle.

    Returns all frames that came in, in order: all but the commands.
    """
    draw = random.Random(seed)
    frames: list[can.Message] = []
    lockstep = Lockstep(bus, timeout=PATIENCE, on_frame=frames.append)
    lockstep.wait_until_up(robots, PATIENCE)
    for _ in range(ticks):
        lockstep.observe({robot: Observation(draw.randrange(2)) for robot in robots})
        lockstep.estimates(robots)
        lockstep.settle(robots)
    return [frame for frame in frames if frame.is_rx]
