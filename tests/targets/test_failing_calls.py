"""The node's state and observations where the kernel fails."""

from __future__ import annotations

from pathlib import Path

from support import CORE, ROOT, require, run

HERE = Path(__file__).parent


def test_state_and_observations_survive_calls_that_fail(tmp_path: Path) -> None:
    program = tmp_path / "failing_calls"
    sources = (CORE, CORE.with_name("mcp_asdf_image.c"), ROOT / "tables/t_table_omega05_q30.c")
    options = ("-std=c99", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined")
    folders = (f"-I{CORE.parent}", f"-I{ROOT / 'c_ref/ports'}")
    run(require("gcc", "gcc"), *options, *folders, HERE / "failing_calls.c", *sources, "-o", program)
    assert run(program, tmp_path) == ""
