"""Building and running ``mcp_asdf_node``, and the Python node that has to send the same frames."""

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
from wire import setup_of_robot

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
class NodeBuild:
    """A way to build the node.

    Attributes:
        name: Name of the folder of the program.
        compiler: The compiler, and the Debian packages that have it.
        flags: Further flags of the compiler.
        runner: Command before the program, such as an emulator.
        settings: Further options of CMake.
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
        settings = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", *self.settings)
        run("cmake", "-G", "Ninja", "-S", SOURCES, "-B", folder, *settings, CFLAGS=WARNINGS + self.flags)
        run("cmake", "--build", folder)


SANITIZED_BUILD = NodeBuild(
    "host",
    flags=SANITIZERS,
    settings=("-DCMAKE_C_FLAGS_RELWITHDEBINFO=-O1 -g",),  # compiles soon
)
"""For this machine, with sanitizers: the usual build of these tests."""
PLAIN_BUILD = NodeBuild("plain")
"""For this machine, as users build it."""
COVERAGE_BUILD = NodeBuild(
    "covered",
    ("gcov", "gcc"),
    " --coverage -O0 -Dalways_inline=unused",  # each function once
    settings=("-DCMAKE_BUILD_TYPE=Debug",),
)
CORTEX_A8 = NodeBuild(
    "cortex-a8",
    ("arm-linux-gnueabihf-gcc", "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross"),
    runner=("qemu-arm", "-cpu", "cortex-a8"),
    settings=(f"-DCMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake/cortex-a8.cmake'}",),
)


def node_command(kind: NodeBuild, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the command that runs the node of a build, which is made once, unless it is there already."""
    if kind.runner:
        emulator, *_options = kind.runner
        require(emulator, "qemu-user")
    folder = Path(os.environ.get(NODES, "no such folder"), kind.name)
    if not folder.exists():
        folder = made_once(tmp_path_factory, f"node {kind.name}", kind.build)
    return [*kind.runner, str(folder / "mcp_asdf_node")]


def unexecuted_lines(folder: Path) -> set[str]:
    """Return the lines of the core that a coverage build has not executed, or only in one way.

    Each is "file: text of the line".
    """
    least_count_by_line: dict[str, int] = {}
    for data in folder.glob("core/**/*.gcda"):
        report = run("gcov", "--branch-probabilities", "--json-format", "--stdout", data, cwd=folder)
        for file in json.loads(report)["files"]:
            path = Path(file["file"])
            if path.parent != ROOT / "c_ref/src" or path.stem == "mcp_asdf_image":  # which saves and restores
                continue
            for text, least_count in count_executions(path, file["lines"]).items():
                # Several files include a header; it is enough if the line runs in one of them.
                least_count_by_line[text] = max(least_count, least_count_by_line.get(text, 0))
    return {text for text, least_count in least_count_by_line.items() if least_count == 0}


def count_executions(path: Path, lines: list[dict[str, Any]]) -> dict[str, int]:
    """Return how often each line of a file, or its rarest branch, was executed, by "file: text of the line".

    ``lines`` is gcov's report. If lines have the same text, the last one counts.
    """
    source_lines = path.read_text(encoding="utf-8").splitlines()
    counts = {}
    for line in lines:
        code, *_comment = source_lines[line["line_number"] - 1].split("/*")
        counts_of_branches = [branch["count"] for branch in line["branches"]]
        counts[f"{path.name}: {code.strip()}"] = min([line["count"], *counts_of_branches])
    return counts


class CNode:
    """A running ``mcp_asdf_node``.

    Attributes:
        error_lines: What it has written to standard error, once it has ended.
    """

    def __init__(
        self, command: Sequence[str], interface: str, robot_id: int, *options: object, **streams: Any
    ) -> None:
        """Start it with the options given, by default with the paper's filter, as ``python_node`` has it.

        ``streams`` are those of subprocess.Popen.
        """
        if "--filter" not in options:
            options = ("--filter", "asdf-plus", *options)
        whole_command = [*command, "--interface", interface, "--id", str(robot_id), *map(str, options)]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
        self.process = subprocess.Popen(whole_command, text=True, **pipes)
        self.error_lines: list[str] = []

    def summary(self, status: int = 0) -> dict[str, Any]:
        """Wait until the node has ended by itself with ``status``, and return the summary that it prints.

        With status 0 its only messages may be those that another node has its id.
        """
        printed, complaints = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == status, f"{self.process.returncode}\n{printed}\n{complaints}"
        self.error_lines = complaints.splitlines()
        if status == 0:
            assert all("; give one of them another" in line for line in self.error_lines)
        figures: dict[str, Any] = json.loads(printed)
        return figures

    def stop(self, number: signal.Signals = signal.SIGTERM) -> dict[str, Any]:
        """End the node by a signal, and return the summary that it prints."""
        self.process.send_signal(number)
        return self.summary()

    def __enter__(self) -> CNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


StartNode = Callable[..., CNode]
"""A function that starts a node on a bus with these options."""


def python_node(
    robot_id: int,
    b_hat: float = 0.95,
    subjects: Subjects | None = None,
    steps_per_second: int = 10,
    allow: frozenset[int] | None = None,
    **config: Any,
) -> RobotNode:
    """Return the Python node with the same options. Its firmware is the mirror."""
    usual = {"table": TABLE, "filter": Filter.ADAPTIVE, "filter_period": DEFAULT_FILTER_PERIOD}
    start = replace(setup_of_robot(robot_id, "mirror", b_hat, **(usual | config)), allow=allow)
    return RobotNode(start, subjects, steps_per_second)


def candump_lines(frames: Iterable[can.Message]) -> list[str]:
    """Return each frame as candump writes it, such as 106BB805#0102, for comparison."""
    return [f"{frame.arbitration_id:08X}#{frame.data.hex().upper()}" for frame in frames]


def without_repeated_greetings(frames: Iterable[can.Message]) -> list[can.Message]:
    """Return the frames of one node with its greeting once. It repeats the greeting until it is commanded."""
    remaining_frames = list(frames)
    while len(remaining_frames) > 1:
        first_line, second_line = candump_lines(remaining_frames[:2])
        if first_line != second_line:
            break
        remaining_frames.pop(0)
    return remaining_frames


def numbers_of_robot(node: RobotNode) -> dict[str, int]:
    """Return the numbers of a Python node that are also in the C node's summary, by their names there."""
    robot = node.robot
    assert isinstance(robot, MirrorRobot)
    return {
        **{name: getattr(robot, f"{name}_raw") for name in ("b_hat", "x_hat", "alpha", "x_bar", "beta", "x")},
        **{name: getattr(node, name) for name in ("ticks", "obeyed", "disobeyed", "unsettled")},
        **{"t": robot.t, "n": robot.n, "heard": node.reception.delivered},
        **vars(robot.counters),
        **vars(node.sent),
    }


def assert_same_run(log: Iterable[can.Message], figures: dict[str, Any], node: RobotNode) -> None:
    """Check that the C node has sent what the Python node sends on the same bus, and ends in its state.

    Args:
        log: All frames on the bus, those of the C node included.
        figures: The C node's summary.
        node: The Python node, which has not been started yet.
    """
    frames_of_c_node: list[can.Message] = []
    expected_frames = node.start()
    for frame in log:
        if frame.arbitration_id & MAX_NODE_ID == node.id:
            frames_of_c_node.append(frame)
        else:
            expected_frames += node.receive_frame(frame)
    assert candump_lines(without_repeated_greetings(frames_of_c_node)) == candump_lines(expected_frames)
    expected_numbers = numbers_of_robot(node)
    assert {name: figures[name] for name in expected_numbers} == expected_numbers


def run_lockstep(bus: can.BusABC, robots: Collection[int], ticks: int, seed: int) -> list[can.Message]:
    """Command robots for so many ticks: to observe what a seeded generator draws, broadcast and settle.

    Returns the frames of the robots in order.
    """
    rng = random.Random(seed)
    frames: list[can.Message] = []
    lockstep = Lockstep(bus, timeout=PATIENCE, on_frame=frames.append)
    lockstep.wait_until_up(robots, PATIENCE)
    for _ in range(ticks):
        lockstep.observe({robot: Observation(rng.randrange(2)) for robot in robots})
        lockstep.wait_for_estimates(robots)
        lockstep.settle(robots)
    return [frame for frame in frames if frame.is_rx]
