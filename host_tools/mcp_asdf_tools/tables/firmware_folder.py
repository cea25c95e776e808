"""The C firmware as a folder for other projects: sources, licence, one t-table and a CMake file."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

from mcp_asdf import _native
from mcp_asdf_tools.common.files import write_files
from mcp_asdf_tools.common.versions import own_version
from mcp_asdf_tools.tables.table_files import c_text, stem

_CMAKE = """\
# MCP-ASDF {version}, the firmware and the t-table of omega {omega}, q {q}: made by
# mcp-asdf firmware --omega {omega} --neighbours {q}. Link mcp_asdf::mcp_asdf.
cmake_minimum_required(VERSION 3.21)
project(mcp_asdf LANGUAGES C)

add_library(mcp_asdf STATIC {sources})
add_library(mcp_asdf::mcp_asdf ALIAS mcp_asdf)
set_target_properties(mcp_asdf PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF)
target_include_directories(mcp_asdf PUBLIC ${{CMAKE_CURRENT_LIST_DIR}})
"""


def write_firmware(omega: Decimal, q: int, folder: Path) -> list[Path]:
    """Write the firmware into ``folder``, which is made if need be; returns the paths written.

    All files are written, or none; those of an earlier version are replaced. Raises UsageError if one cannot
    be written.
    """
    core = Path(_native.__file__).parent / "core"  # installed beside the compiled firmware
    contents = {path.name: path.read_text(encoding="utf-8") for path in sorted(core.iterdir())}
    contents[f"{stem(omega, q)}.c"] = c_text(omega, q)
    sources = " ".join(sorted(name for name in contents if name.endswith(".c")))
    contents["CMakeLists.txt"] = _CMAKE.format(version=own_version(), omega=omega, q=q, sources=sources)
    return write_files(folder, contents)
