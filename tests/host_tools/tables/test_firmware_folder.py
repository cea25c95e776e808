"""``mcp-asdf firmware``: what it writes is a library that other projects build as it is."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from support import ROOT, require, run

PROGRAM = """\
#include "mcp_asdf.h"
extern const uint32_t mcp_asdf_t_table_omega10_q30[];
static const mcp_asdf_config_t config = MCP_ASDF_CONFIG(mcp_asdf_t_table_omega10_q30);
int main(void)
{
    mcp_asdf_t robot;
    return mcp_asdf_init(&robot, &config, 7, 0xF0000000) == MCP_ASDF_OK ? 0 : 1;
}
"""
PROJECT = """\
cmake_minimum_required(VERSION 3.21)
project(robot LANGUAGES C)
add_subdirectory(vendor/mcp_asdf)
add_executable(robot robot.c)
target_link_libraries(robot PRIVATE mcp_asdf::mcp_asdf)
"""


def test_a_project_builds_what_it_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "vendor/mcp_asdf"
    command = ["firmware", str(folder), "--omega", "0.1", "--neighbours", "30"]
    assert main(command) == 0
    assert "The table is: extern const uint32_t mcp_asdf_t_table_omega10_q30[];" in capsys.readouterr().out
    assert main([*command, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert sorted(told["files"]) == sorted(map(str, folder.iterdir()))
    assert told["symbol"] == "mcp_asdf_t_table_omega10_q30"
    for source in (ROOT / "c_ref/src").glob("*.[ch]"):
        assert (folder / source.name).read_bytes() == source.read_bytes()
    (tmp_path / "robot.c").write_text(PROGRAM)
    (tmp_path / "CMakeLists.txt").write_text(PROJECT)
    cmake = require("cmake", "cmake")
    run(cmake, "-S", tmp_path, "-B", tmp_path / "build")
    run(cmake, "--build", tmp_path / "build")
    run(tmp_path / "build/robot")


def test_what_somebody_has_changed_stays_without_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its own files it replaces, and leaves one table; an earlier version is what its checksums say."""
    folder, core = tmp_path / "mcp_asdf", tmp_path / "mcp_asdf/mcp_asdf.c"

    def written(*options: str) -> list[str]:
        code = main(["firmware", str(folder), *options])
        assert code == 0 or "--force" in capsys.readouterr().err
        return [path.name for path in folder.glob("t_table*.c")] if code == 0 else []

    assert written() == ["t_table_omega05_q127.c"]
    assert run("sha256sum", "--check", "--quiet", "sha256sums.txt", cwd=folder) == ""
    assert written("--neighbours", "30") == ["t_table_omega05_q30.c"]
    before, sums = core.read_bytes(), folder / "sha256sums.txt"
    core.write_text("/* ours */")
    assert written() == [] and core.read_text() == "/* ours */"
    known = hashlib.sha256(before).hexdigest()
    sums.write_text(sums.read_text().replace(known, hashlib.sha256(core.read_bytes()).hexdigest()))
    assert written() == ["t_table_omega05_q127.c"] and core.read_bytes() == before
    (folder / "t_table_ours.c").write_text("/* ours */")
    assert written() == []
    assert written("--force") == ["t_table_omega05_q127.c"]
