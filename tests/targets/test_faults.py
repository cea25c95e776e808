"""What no test can bring about from outside the Linux node: the kernel is asked to filter, and the clock
counts right (faults.c)."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import CORE, ROOT, TABLE, require, run
from targets.c_node import WARNINGS

LINUX = ROOT / "c_ref/ports/linux"
WRAPPED = ("if_nametoindex", "socket", "setsockopt", "bind")
PLANTED = (
    ("main.c", "(uint32_t)(lateness / timer->period);", "(uint32_t)(lateness / timer->period) + 1U;"),
    ("main.c", "(lateness / timer->period + 1)", "(lateness / timer->period + 2)"),
    ("bus.c", "errors = REPORTED_ERRORS", "errors = CAN_ERR_MASK"),
    ("bus.c", "MCP_ASDF_FRAME_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG", "MCP_ASDF_FRAME_MASK"),
)
"""Faults of the node: a file, a text in it, and what stands there instead."""


def play(folder: Path, planted: tuple[str, str, str] | None = None) -> str:
    """Build the node, with a fault if one is given, and the system that it meets in ``folder``; returns what
    that says, which ends in how many checks failed."""
    sources = {path.name: path.read_text(encoding="utf-8") for path in LINUX.glob("*.[ch]")}
    if planted is not None:
        name, right, wrong = planted
        assert sources[name].count(right) == 1, planted
        sources[name] = sources[name].replace(right, wrong)
    (folder / "linux").mkdir()
    (folder / "node").symlink_to(ROOT / "c_ref/ports/node")
    for name, text in sources.items():
        (folder / "linux" / name).write_text(text, encoding="utf-8")
    files = [folder / "linux" / name for name in sources if name.endswith(".c") and name != "main.c"]
    files += [ROOT / "tests/targets/faults.c", folder / "node/node.c", TABLE]
    files += CORE.parent.glob("*.c")
    includes = (folder, ROOT / "c_ref/ports", CORE.parent)
    table = "-DMCP_ASDF_NODE_TABLE=mcp_asdf_t_table_omega05_q30"
    flags = ["-std=c99", "-D_GNU_SOURCE", table, *(f"-I{each}" for each in includes)]
    wraps = [f"-Wl,--wrap={name}" for name in WRAPPED]
    strict = WARNINGS.split() if planted is None else ["-w"]
    run(require("gcc"), *flags, *strict, *wraps, *files, "-lm", "-o", folder / "faults")
    return run("sh", "-c", "./faults || :", cwd=folder)


def test_the_node_s_socket_and_clock(tmp_path: Path) -> None:
    said = play(tmp_path)
    assert said.endswith(" 0 failed\n"), said


@pytest.mark.slow
@pytest.mark.parametrize("planted", PLANTED, ids=lambda planted: f"{planted[0]} {planted[1]}")
def test_planted_faults_are_noticed(planted: tuple[str, str, str], tmp_path: Path) -> None:
    assert not play(tmp_path, planted).endswith(" 0 failed\n")
