"""The tutorial of a robot in C: its files are written, built and run, among the robots of its swarm.

The tutorial of an experiment is Python, which tests/test_docs.py runs.
"""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support import PATH, PATIENCE, ROOT, block_with, blocks, interruptible, require, run

PAGE = ROOT / "docs/robot_tutorial.md"
PORT_OF_THE_PAGE = "20001"


def write_file(block: str, folder: Path) -> None:
    """Write a block of the page to the file that its first line, a comment, names."""
    [name] = re.findall(r"my_robot/\S+", block.splitlines()[0])
    (folder / name).write_text(block)


def build_first_robot(folder: Path) -> str:
    """Do what the first two parts of the page say, and return what the robot prints."""
    require("cmake")
    get_firmware, build_and_start, *_ = blocks(PAGE, "sh")
    printed = run("sh", "-exc", get_firmware, cwd=folder)
    assert printed == block_with(PAGE, "wrote 25 files", "text")
    write_file(blocks(PAGE, "c")[0], folder)
    write_file(blocks(PAGE, "cmake")[0], folder)
    return run("sh", "-exc", build_and_start, cwd=folder)


@contextmanager
def running_swarm() -> Iterator[str]:
    """Run the page's swarm while the block runs, and yield its port, which is a free one."""
    [command] = [block for block in blocks(PAGE, "sh") if block.startswith("mcp-asdf swarm")]
    program, *options = shlex.split(command.replace(PORT_OF_THE_PAGE, "0"))
    path = shutil.which(program, path=PATH)
    assert path is not None
    with interruptible():
        started = subprocess.Popen(
            [path, *options], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
    with started as swarm:
        assert swarm.stderr is not None
        try:
            line = swarm.stderr.readline()
            address = re.search(r"socket://\S+:(\d+)", line)
            assert address is not None
            assert line.replace(address[1], PORT_OF_THE_PAGE) == block_with(PAGE, "socket://", "text")
            yield address[1]
        finally:
            swarm.send_signal(signal.SIGINT)
            swarm.communicate(timeout=PATIENCE)


def test_the_first_robot_of_the_tutorial_is_built_and_runs(tmp_path: Path) -> None:
    """Its program prints what the page shows, whose first lines are left out there."""
    shown_end = block_with(PAGE, "share of black 1.000", "text").removeprefix("...\n")

    printed = build_first_robot(tmp_path)

    assert printed.endswith(shown_end)


@pytest.mark.slow
def test_the_second_robot_of_the_tutorial_learns_its_accuracy_from_the_swarm(tmp_path: Path) -> None:
    """It prints now and then what it has learned, and the share of black tiles.

    In the swarm nine of ten tiles are black, and its sensor is right in 95 % of cases. What it prints is near
    that from the first line on.
    """
    printed = run_second_robot(tmp_path)

    states = re.findall(r"share of black (\S+), my sensor is right (\d+) times in 1000", printed)
    assert len(states) > 0, printed
    for share_of_black, thousandths in states:
        assert 0.75 < float(share_of_black) < 1
        assert 800 <= int(thousandths) <= 1000


def run_second_robot(folder: Path) -> str:
    """Build the page's second robot, run it in the page's swarm, and return what it prints."""
    require("bash")
    build_first_robot(folder)
    _first_program, second_program = blocks(PAGE, "c")
    write_file(second_program, folder)
    *_, build_and_start = blocks(PAGE, "sh")
    with running_swarm() as port:
        command = ["sh", "-exc", build_and_start.replace(PORT_OF_THE_PAGE, port)]
        robot = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=True, timeout=PATIENCE
        )
    return robot.stderr
