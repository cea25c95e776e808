"""The core gets into other projects in each way that docs/porting.md names.

Ways that build here end in a small program, which must succeed. The others' own tools do here what they can
offline: PlatformIO reads its manifest and Arduino's, and packs the folder, as ESP-IDF does; Kconfig reads
Zephyr's options.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tarfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest
import yaml

from support import CORE, ROOT, TABLE, require, run, version_of_header

PACKAGE = ROOT / "c_ref"
PARTS = ("mcp_asdf", "mcp_asdf_image", "mcp_asdf_frame")
FILES = {f"src/{path.name}" for path in CORE.parent.iterdir()}
HEADERS = {f"{name}.h" for name in (*PARTS, "mcp_asdf_rom")}
"""Headers that a user includes; the core's arithmetic has others."""

# --- The small program -----------------------------------------------------------------------------------

CONSUMER = """
#include "mcp_asdf_frame.h"
#include "mcp_asdf_image.h"

#ifdef __cplusplus
extern "C"
#else
extern
#endif
const uint32_t mcp_asdf_t_table_omega05_q30[33];

int main(void)
{
    static const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30);
    static const mcp_asdf_heartbeat_t beat = {0, 0, 0, 0, 0, 0};
    mcp_asdf_t robot, copy;
    mcp_asdf_frame_t frame;
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    if (mcp_asdf_init(&robot, &config, 1, 0xC0000000) != MCP_ASDF_OK ||
        mcp_asdf_step(&robot, MCP_ASDF_BLACK) != MCP_ASDF_OK) {
        return 1;
    }
    mcp_asdf_save(&robot, image);
    return mcp_asdf_restore(&copy, &config, image) != MCP_ASDF_OK || mcp_asdf_x(&copy) != MCP_ASDF_ONE ||
           mcp_asdf_encode_heartbeat(&frame, 4, &beat) != MCP_ASDF_FRAME_OK;
}
"""
STRICT = ("-pedantic-errors", "-Wall", "-Wextra", "-Werror")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the program and the table that it chose."""
    (tmp_path / "main.c").write_text(CONSUMER)
    shutil.copy(TABLE, tmp_path)
    return tmp_path


# --- Ways that build it ----------------------------------------------------------------------------------

BUILD = """
cmake_minimum_required(VERSION 3.21)
project(consumer LANGUAGES C)
{}
add_executable(consumer main.c t_table_omega05_q30.c)
target_link_libraries(consumer PRIVATE mcp_asdf::mcp_asdf)
install(TARGETS consumer)
"""
FETCH = """
include(FetchContent)
FetchContent_Declare(mcp_asdf SOURCE_DIR "{}")
FetchContent_MakeAvailable(mcp_asdf)
"""


def cmake(*arguments: str | Path) -> str:
    return run(require("cmake"), *arguments)


def installed(folder: Path, *options: str) -> Path:
    """The library is installed and then moved, so that nothing may name the first place."""
    place = folder / "first"
    cmake("-S", PACKAGE, "-B", folder / "made", f"-DCMAKE_INSTALL_PREFIX={place}", *options)
    cmake("--build", folder / "made", "--target", "mcp_asdf")
    cmake("--install", folder / "made")
    shutil.rmtree(folder / "made")
    return place.rename(folder / "second")


def copied(project: Path, compiler: str, source: str) -> None:
    """The compiler takes nothing beyond the standard."""
    for path in CORE.parent.iterdir():
        shutil.copy(path, project)
    for path in (*CORE.parent.glob("*.c"), TABLE):
        run(require("gcc", "gcc"), "-std=c99", *STRICT, "-c", path.name, cwd=project)
    (project / "main.c").rename(project / source)
    objects = sorted(project.glob("*.o"))
    run(require(compiler, compiler), *STRICT, source, *objects, "-o", "consumer", cwd=project)


def built(project: Path, get: str, *options: str) -> None:
    """CMake gets the library by the command ``get``; nothing of what is embedded is installed or tested."""
    (project / "CMakeLists.txt").write_text(BUILD.format(get))
    cmake("-S", project, "-B", project / "build", "-DCMAKE_C_FLAGS=-Wall -Wextra -Werror", *options)
    cmake("--build", project / "build")
    cmake("--install", project / "build", "--prefix", project / "whole")
    (program,) = (path for path in (project / "whole").rglob("*") if path.is_file())
    program.rename(project / "consumer")
    assert "Total Tests: 0" in run("ctest", "-N", "--test-dir", project / "build")


def found(project: Path) -> None:
    """CMake finds the version; what is installed is for users only."""
    prefix = installed(project / "library")
    built(
        project,
        f"find_package(mcp_asdf {version_of_header()} EXACT REQUIRED)",
        f"-DCMAKE_PREFIX_PATH={prefix}",
    )
    config = {f"mcp_asdf-config{kind}.cmake" for kind in ("", "-noconfig", "-version")}
    files = {path.name for path in prefix.rglob("*") if path.is_file()}
    assert files == {"libmcp_asdf.a", "mcp_asdf.pc"} | HEADERS | config


def without_the_robust_filter(project: Path) -> None:
    """What leaves the filter out reaches the program."""
    check = "#if MCP_ASDF_WITH_ROBUST\n#error it is there\n#endif\n"
    (project / "main.c").write_text(CONSUMER + check)
    built(project, f'add_subdirectory("{PACKAGE}" mcp_asdf)', "-DMCP_ASDF_WITH_ROBUST=OFF")


def without_the_papers(project: Path) -> None:
    """The same of an installed library, with a robot that has no table."""
    robust = CONSUMER.replace("MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30)", "MCP_ASDF_CONFIG_ROBUST")
    (project / "main.c").write_text(f"{robust}#if MCP_ASDF_WITH_ASDF\n#error it is there\n#endif\n")
    prefix = installed(project / "library", "-DMCP_ASDF_WITH_ASDF=OFF")
    (description,) = prefix.rglob("mcp_asdf.pc")
    assert "-DMCP_ASDF_WITH_ASDF=0" in description.read_text(encoding="utf-8")
    built(project, "find_package(mcp_asdf REQUIRED)", f"-DCMAKE_PREFIX_PATH={prefix}")


def pkg_config(project: Path) -> None:
    (folder,) = (path.parent for path in installed(project / "library").rglob("mcp_asdf.pc"))
    ask = (require("pkg-config", "pkgconf"), "mcp_asdf")
    flags = run(*ask, "--cflags", "--libs", PKG_CONFIG_PATH=str(folder)).split()
    assert run(*ask, "--modversion", PKG_CONFIG_PATH=str(folder)).strip() == version_of_header()
    run("cc", *STRICT, "main.c", TABLE.name, *flags, "-o", "consumer", cwd=project)


WAYS: dict[str, Callable[[Path], None]] = {
    "copied, C": lambda project: copied(project, "clang", "main.c"),
    "copied, C++": lambda project: copied(project, "g++", "main.cpp"),
    "add_subdirectory": lambda project: built(project, f'add_subdirectory("{PACKAGE}" mcp_asdf)'),
    "FetchContent": lambda project: built(project, FETCH.format(ROOT)),
    "find_package": found,
    "pkg-config": pkg_config,
    "without the robust filter": without_the_robust_filter,
    "without the paper's": without_the_papers,
}


@pytest.mark.parametrize("way", WAYS)
def test_a_project_gets_it_in_each_way(way: str, project: Path) -> None:
    WAYS[way](project)
    run(project / "consumer")


# --- Manifests -------------------------------------------------------------------------------------------


def test_all_manifests_agree() -> None:
    lines = (PACKAGE / "library.properties").read_text(encoding="utf-8").splitlines()
    manifests = [
        dict(line.split("=", 1) for line in lines),
        json.loads((PACKAGE / "library.json").read_text(encoding="utf-8")),
        yaml.safe_load((PACKAGE / "idf_component.yml").read_text(encoding="utf-8")),
        yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8")),
    ]
    for manifest in manifests:
        assert (manifest["version"], manifest["license"]) == (version_of_header(), "MIT")
    assert set(manifests[1]["headers"]) == HEADERS
    assert manifests[1]["build"] == {"srcDir": "src", "includeDir": "src"}
    assert metadata.version("mcp-asdf") == version_of_header()


# PlatformIO's own reader, schema and packer; the schema would fetch the list of licences.
PLATFORMIO = """
import sys
from platformio.package.manifest.parser import ManifestParserFactory
from platformio.package.manifest.schema import ManifestSchema
from platformio.package.pack import PackagePacker
ManifestSchema.load_spdx_licenses = staticmethod(lambda: {"licenses": [{"licenseId": "MIT"}]})
for name in ("library.json", "library.properties"):
    found = ManifestParserFactory.new_from_file(f"{sys.argv[1]}/{name}").as_dict()
    ManifestSchema().load_manifest(found)
PackagePacker(sys.argv[1]).pack(sys.argv[2])
"""


def files_in(archive: Path) -> set[str]:
    with tarfile.open(archive) as tar:
        return {member.name.removeprefix("./") for member in tar if member.isfile()}


def test_platformio_packs_it(tmp_path: Path) -> None:
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    archive = tmp_path / "packed.tar.gz"
    run(sys.executable, "-c", PLATFORMIO, PACKAGE, archive, PLATFORMIO_CORE_DIR=str(tmp_path / "home"))
    expected = FILES | {"library.json", "library.properties", "README.md", "LICENSE"}
    assert files_in(archive) - {".piopm"} == expected


@pytest.mark.slow
def test_esp_idf_packs_it(tmp_path: Path) -> None:
    require("compote")
    run("compote", "manifest", "lint", PACKAGE / "idf_component.yml")
    run("compote", "component", "pack", "--name", "mcp_asdf", "--dest-dir", tmp_path, cwd=PACKAGE)
    files = files_in(tmp_path / f"mcp_asdf_{version_of_header()}.tgz")
    assert files == FILES | {"CMakeLists.txt", "idf_component.yml", "README.md", "LICENSE"}
    component = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    (sources,) = re.findall(r"idf_component_register\(\s*SRCS (.*) INCLUDE_DIRS src\)", component)
    assert set(sources.split()) == {name for name in FILES if name.endswith(".c")}


@pytest.mark.parametrize(
    ("chosen", "parts"), [("", ()), ("=y", PARTS), ("=y\nCONFIG_MCP_ASDF_IMAGE=n", PARTS[::2])]
)
def test_zephyr_builds_what_its_options_say(chosen: str, parts: tuple[str, ...], tmp_path: Path) -> None:
    """The optional parts come with the core, unless they are left out; nothing comes unasked."""
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    module = yaml.safe_load((PACKAGE / "zephyr/module.yml").read_text(encoding="utf-8"))["build"]
    (tmp_path / "prj.conf").write_text(f"CONFIG_MCP_ASDF{chosen}" if chosen else "")
    kconfig = kconfiglib.Kconfig(str(PACKAGE / module["kconfig"]), warn_to_stderr=False)
    kconfig.load_config(str(tmp_path / "prj.conf"))
    assert kconfig.warnings == []
    options = {symbol.name: symbol.str_value for symbol in kconfig.unique_defined_syms}
    assert options == {name.upper(): "y" if name in parts else "n" for name in PARTS}
    text = (PACKAGE / module["cmake"] / "CMakeLists.txt").read_text(encoding="utf-8")
    assert "zephyr_library_sources(../src/mcp_asdf.c ../src/mcp_asdf_accessors.c)" in text
    for name in PARTS[1:]:
        assert f"zephyr_library_sources_ifdef(CONFIG_{name.upper()} ../src/{name}.c)" in text
