"""The C firmware as a folder for other projects: sources, licence, one t-table and a CMake file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from hashlib import sha256
from pathlib import Path

from mcp_asdf import _native
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import write_files
from mcp_asdf_tools.common.versions import own_version
from mcp_asdf_tools.tables.table_files import c_text, stem

_CMAKE = """\
# MCP-ASDF {version}, the firmware and the t-table of omega {omega}, q {q}: made by
# mcp-asdf firmware --omega {omega} --neighbours {q}. Link mcp_asdf::mcp_asdf.
cmake_minimum_required(VERSION 3.21)
project(mcp_asdf LANGUAGES C)

option(MCP_ASDF_WITH_ASDF "Build the paper's filter" ON)
option(MCP_ASDF_WITH_ROBUST "Build the robust filter" ON)

# A project may have several such folders: the first one makes the library, each adds its table.
if(NOT TARGET mcp_asdf)
    # Static or shared by BUILD_SHARED_LIBS, position-independent by CMAKE_POSITION_INDEPENDENT_CODE.
    add_library(mcp_asdf {sources})
    add_library(mcp_asdf::mcp_asdf ALIAS mcp_asdf)
    set_target_properties(
        mcp_asdf PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF
                            WINDOWS_EXPORT_ALL_SYMBOLS ON MCP_ASDF_VERSION {version})
    foreach(filter IN ITEMS ASDF ROBUST)
        if(NOT MCP_ASDF_WITH_${{filter}}) # the header of whoever uses it has to agree
            target_compile_definitions(mcp_asdf PUBLIC MCP_ASDF_WITH_${{filter}}=0)
        endif()
    endforeach()
    target_include_directories(mcp_asdf PUBLIC ${{CMAKE_CURRENT_LIST_DIR}})
endif()

get_target_property(other_version mcp_asdf MCP_ASDF_VERSION)
if(NOT other_version STREQUAL "{version}")
    message(FATAL_ERROR
        "The project has a target mcp_asdf of another version (${{other_version}}) than this folder "
        "({version}): run mcp-asdf firmware for both folders")
endif()
get_target_property(tables mcp_asdf MCP_ASDF_TABLES)
if(NOT {table} IN_LIST tables)
    target_sources(mcp_asdf PRIVATE ${{CMAKE_CURRENT_LIST_DIR}}/{table})
    set_property(TARGET mcp_asdf APPEND PROPERTY MCP_ASDF_TABLES {table})
endif()
"""
_SUMS = "sha256sums.txt"


def write_firmware(omega: Decimal, q: int, folder: Path, force: bool = False) -> list[Path]:
    """Write the firmware into ``folder``, which is made if need be; returns the paths written.

    All files are written, or none; those of an earlier version are replaced, and other tables removed. Raises
    UsageError if one cannot be written or, without ``force``, has been changed since it was written.
    """
    core = Path(_native.__file__).parent / "core"  # installed beside the compiled firmware
    contents = {path.name: path.read_text(encoding="utf-8") for path in sorted(core.iterdir())}
    sources = " ".join(sorted(name for name in contents if name.endswith(".c")))
    table = f"{stem(omega, q)}.c"
    contents[table] = c_text(omega, q)
    contents["CMakeLists.txt"] = _CMAKE.format(
        version=own_version(), omega=omega, q=q, sources=sources, table=table
    )
    sums = {name: sha256(text.encode()).hexdigest() for name, text in sorted(contents.items())}
    others = [path for path in sorted(folder.glob("t_table_*.c")) if path.name not in contents]
    if not force:
        _check_unchanged([*others, *(folder / name for name in contents)], folder / _SUMS, sums)
    contents[_SUMS] = "".join(f"{each}  {name}\n" for name, each in sums.items())
    paths = write_files(folder, contents)
    for path in others:
        path.unlink()
    return paths


def _check_unchanged(paths: Iterable[Path], before: Path, sums: Mapping[str, str]) -> None:
    """Raises UsageError for a file that has neither its checksum in the file ``before`` nor the new one."""
    text = before.read_text(encoding="utf-8", errors="replace") if before.is_file() else ""
    known = {(name, each) for each, _, name in (line.partition("  ") for line in text.splitlines())}
    for path in paths:
        if path.is_file() and (path.name, sha256(path.read_bytes()).hexdigest()) not in known | {
            *sums.items()
        }:
            fix = "keep it elsewhere, or give --force to replace it"
            raise UsageError(f"{path} is not as mcp-asdf firmware wrote it; {fix}")
