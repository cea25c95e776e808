"""Writing the C firmware as a folder for other projects: sources, licence, one t-table and build files.

The build files are for CMake, ESP-IDF, Meson, Arduino, PlatformIO and Zephyr.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from hashlib import sha256
from pathlib import Path

from mcp_asdf import _native
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import make_folder, write_together
from mcp_asdf_tools.common.versions import own_version
from mcp_asdf_tools.tables.table_files import format_c_source, table_name

_CMAKE = """\
# MCP-ASDF {version}, the firmware and the t-table of omega {omega}, q {q}: made by
# mcp-asdf firmware --omega {omega} --neighbours {q}. Link mcp_asdf::mcp_asdf.
if(ESP_PLATFORM) # a component of ESP-IDF, which builds it in its own way
    idf_component_register(SRCS {sources} {table} INCLUDE_DIRS .)
    return()
endif()

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
_MESON = """\
# subdir() of this folder gives your meson.build the variable mcp_asdf, for dependencies: of an executable.
mcp_asdf = declare_dependency(
    sources: files({quoted_sources}),
    include_directories: include_directories('.'))
"""
_LIBRARY_JSON = """\
{{
  "name": "mcp_asdf",
  "version": "{version}",
  "description": "Collective perception by robots that calibrate their own sensors",
  "license": "MIT",
  "frameworks": "*",
  "platforms": "*"
}}
"""
"""PlatformIO's manifest. Without it, PlatformIO takes Arduino's, and builds the library for Arduino only."""
_LIBRARY_PROPERTIES = """\
name=mcp_asdf
version={version}
author=The mcp-asdf authors
maintainer=The mcp-asdf authors
sentence=Collective perception by robots that calibrate their own sensors.
paragraph=MCP-ASDF in fixed-point C99, with the frames that robots exchange.
category=Data Processing
url=https://arxiv.org/abs/2410.21546
architectures=*
includes=mcp_asdf.h
license=MIT
"""
_ZEPHYR_MODULE = """\
name: mcp_asdf
build:
  cmake: zephyr
  kconfig: zephyr/Kconfig
"""
_ZEPHYR_CMAKE = """\
if(CONFIG_MCP_ASDF)
    zephyr_include_directories(..)
    zephyr_library()
    zephyr_library_sources({parent_sources})
endif()
"""
_ZEPHYR_KCONFIG = """\
config MCP_ASDF
    bool "MCP-ASDF: collective perception by robots that calibrate their own sensors"
    help
      Builds the firmware core and its t-table.
"""
_BUILD_FILE_TEMPLATES = {
    "CMakeLists.txt": _CMAKE,
    "meson.build": _MESON,
    "library.json": _LIBRARY_JSON,
    "library.properties": _LIBRARY_PROPERTIES,
    "zephyr/module.yml": _ZEPHYR_MODULE,
    "zephyr/CMakeLists.txt": _ZEPHYR_CMAKE,
    "zephyr/Kconfig": _ZEPHYR_KCONFIG,
}
"""Templates of the files by which build systems find the sources, by name."""
_CHECKSUMS_FILE = "sha256sums.txt"
"""Checksums of all other files as written, in sha256sum's format: they show what has been changed since."""


def write_firmware(omega: Decimal, q: int, folder: Path, force: bool = False) -> list[Path]:
    """Write the firmware's sources and one t-table into ``folder``, and return the paths of all files.

    The table is for ``omega``, the type II error probability of the test, and has exact thresholds for up to
    ``q`` neighbours. The folder is created if need be. All files are written, or none; files of an earlier
    version are replaced, and other tables in the folder are deleted. Raises UsageError if a file cannot be
    written or, without ``force``, if one has been changed since it was written.
    """
    texts = _folder_texts(omega, q)
    # The folder is for one table: tables of an earlier run with another omega or q are deleted.
    other_tables = [path for path in sorted(folder.glob("t_table_*.c")) if path.name not in texts]
    if not force:
        _check_unchanged(folder, [*(path.name for path in other_tables), *texts], new_texts=texts)
    # The file of checksums cannot hold its own, so it is made of all others.
    texts[_CHECKSUMS_FILE] = _format_checksums(texts)
    make_folder(folder / "zephyr")  # the only folder inside, and with it ``folder`` itself
    text_by_path = {folder / name: text for name, text in texts.items()}
    write_together(text_by_path)
    # Only now that the new files are complete: if writing them fails, the old tables stay.
    for path in other_tables:
        path.unlink()
    return list(text_by_path)


def _folder_texts(omega: Decimal, q: int) -> dict[str, str]:
    """Return the text of each file of the folder, by name: the sources, the t-table and the build files."""
    core_folder = Path(_native.__file__).parent / "core"  # installed beside the compiled firmware
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(core_folder.iterdir())}
    sources = sorted(name for name in texts if name.endswith(".c"))
    texts[f"{table_name(omega, q)}.c"] = format_c_source(omega, q)
    return texts | _build_files(omega, q, sources)


def _build_files(omega: Decimal, q: int, sources: Sequence[str]) -> dict[str, str]:
    """Return the texts of the files by which build systems find the sources and the t-table, by name."""
    table_file = f"{table_name(omega, q)}.c"
    compiled_files = [*sources, table_file]
    values = {
        "version": own_version(),
        "omega": omega,
        "q": q,
        "sources": " ".join(sources),
        "table": table_file,
        "quoted_sources": ", ".join(f"'{name}'" for name in compiled_files),
        "parent_sources": " ".join(f"../{name}" for name in compiled_files),
    }
    return {name: template.format_map(values) for name, template in _BUILD_FILE_TEMPLATES.items()}


def _checksum(data: bytes) -> str:
    """Return the checksum of a file's content as sha256sum writes it."""
    return sha256(data).hexdigest()


def _check_unchanged(folder: Path, names: Iterable[str], new_texts: Mapping[str, str]) -> None:
    """Raise UsageError for the first file that is neither as it was written nor as it is about to be.

    The files are those with these names in the folder, if they exist. How they were written is known from the
    checksums in the folder.
    """
    old_checksums = _read_checksums(folder / _CHECKSUMS_FILE)
    for name in names:
        path = folder / name
        if not path.is_file():
            continue
        data = path.read_bytes()
        is_as_written = _checksum(data) == old_checksums.get(name)
        is_as_new = name in new_texts and data == new_texts[name].encode()
        if not is_as_written and not is_as_new:
            fix = "keep it elsewhere, or give --force to replace it"
            raise UsageError(f"{path} is not as mcp-asdf firmware wrote it; {fix}")


def _format_checksums(texts: Mapping[str, str]) -> str:
    """Compute the checksums of texts, and return them in sha256sum's format, in lines sorted by name."""
    return "".join(f"{_checksum(texts[name].encode())}  {name}\n" for name in sorted(texts))


def _read_checksums(path: Path) -> dict[str, str]:
    """Return the checksums in a file of sha256sum's format by file name; none if there is no such file."""
    if not path.is_file():
        return {}
    checksums = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        # sha256sum separates both by two spaces. A line of another form gives an entry that no file matches.
        checksum, _, name = line.partition("  ")
        checksums[name] = checksum
    return checksums
