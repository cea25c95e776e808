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

from support import PATH, PATIENCE, ROOT, blocks, interruptible, require, run

PAGE = ROOT / "docs/robot_tutorial.md"
PORT = "20001"


@contextmanager
def swarm() -> Iterator[str]:
    """The page's swarm at a free port, which is yielded."""
    (command,) = [block for block in blocks(PAGE, "sh") if block.startswith("mcp-asdf swarm")]
    words = shlex.split(command.replace(PORT, "0"))
    words[0] = str(shutil.which(words[0], path=PATH))
    with interruptible():
        started = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    with started as running:
        assert running.stderr
        try:
            where = re.search(r"socket://\S+:(\d+)", running.stderr.readline())
            assert where
            yield where[1]
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=PATIENCE)


def test_the_robot_of_the_tutorial_is_built_and_runs(tmp_path: Path) -> None:
    build_alone(tmp_path)


def build_alone(folder: Path) -> None:
    """The first two parts of the page."""
    require("cmake")
    firmware, alone, *_ = blocks(PAGE, "sh")
    run("sh", "-exc", firmware, cwd=folder)
    for text in (blocks(PAGE, "c")[0], blocks(PAGE, "cmake")[0]):
        write(text, folder)
    assert run("sh", "-exc", alone, cwd=folder).endswith("share of black 1.000\n")


@pytest.mark.slow
def test_the_robot_learns_its_accuracy_from_the_others(tmp_path: Path) -> None:
    require("bash")
    build_alone(tmp_path)
    write(blocks(PAGE, "c")[1], tmp_path)
    with swarm() as port:
        command = ["sh", "-exc", blocks(PAGE, "sh")[-1].replace(PORT, port)]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=PATIENCE
        )
    learnt = re.findall(r"share of black (\S+), my sensor is right (\d+) times in 1000", done.stderr)
    assert learnt, done.stderr
    for share, accuracy in learnt:
        assert 0.75 < float(share) < 1
        assert 800 <= int(accuracy) <= 1000


def write(block: str, folder: Path) -> None:
    """A block whose first line is a comment with the file's name."""
    (name,) = re.findall(r"my_robot/\S+", block.splitlines()[0])
    (folder / name).write_text(block)
