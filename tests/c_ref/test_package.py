"""The core gets into other projects in each way that docs/porting.md names.

Each way that builds here ends in a small program, which must succeed. The tools of the other ways do what
they can without a network: PlatformIO reads its manifest and Arduino's, and packs the folder, as ESP-IDF
does; Kconfig reads Zephyr's options. test_arduino.py builds Arduino's sketch.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
import tarfile
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from support import CORE, ROOT, TABLE, blocks, require, run, version_of_header

PACKAGE = ROOT / "c_ref"
PARTS = ("mcp_asdf", "mcp_asdf_image", "mcp_asdf_frame", "mcp_asdf_small")
SOURCE_FILES = {f"src/{path.name}" for path in CORE.parent.iterdir()}
HEADERS = {f"{name}.h" for name in (*PARTS, "mcp_asdf_rom")}
"""Headers that a user includes; the core's arithmetic has others."""

# --- The small program -----------------------------------------------------------------------------------

PROGRAM = """
#include "mcp_asdf_frame.h"
#include "mcp_asdf_image.h"
#include "mcp_asdf_small.h"

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
    static const mcp_asdf_small_message_t message = {1, MCP_ASDF_ONE, 0};
    mcp_asdf_t robot, copy;
    mcp_asdf_frame_t frame;
    uint8_t image[MCP_ASDF_IMAGE_SIZE], bytes[MCP_ASDF_SMALL_BYTES];
    if (mcp_asdf_init(&robot, &config, 1, 0xC0000000) != MCP_ASDF_OK ||
        mcp_asdf_step(&robot, MCP_ASDF_BLACK) != MCP_ASDF_OK) {
        return 1;
    }
    mcp_asdf_save(&robot, image);
    return mcp_asdf_restore(&copy, &config, image) != MCP_ASDF_OK || mcp_asdf_x(&copy) != MCP_ASDF_ONE ||
           mcp_asdf_encode_heartbeat(&frame, 4, &beat) != MCP_ASDF_FRAME_OK ||
           mcp_asdf_encode_small(bytes, &message) != MCP_ASDF_OK;
}
"""
ROBUST_PROGRAM = PROGRAM.replace(
    "MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30)", "MCP_ASDF_CONFIG_ROBUST"
)
"""The same with a robot that needs no table."""
STRICT = ("-pedantic-errors", "-Wall", "-Wextra", "-Werror")


STOP_IF_THERE_IS_A_ROBUST_FILTER = "#if MCP_ASDF_WITH_ROBUST\n#error it is there\n#endif\n"
STOP_IF_THERE_IS_A_FILTER_OF_THE_PAPER = "#if MCP_ASDF_WITH_ASDF\n#error it is there\n#endif\n"
"""C code that stops the compiler if the library's header offers a filter."""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the program and with the table that it names."""
    (tmp_path / "main.c").write_text(PROGRAM)
    shutil.copy(TABLE, tmp_path)
    return tmp_path


# --- Copied files ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def copied_core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the core and a table, compiled with nothing beyond C99."""
    folder = tmp_path_factory.mktemp("copied")
    for path in (*CORE.parent.iterdir(), TABLE):
        shutil.copy(path, folder)
    names = [path.name for path in folder.glob("*.c")]
    run(require("gcc", "gcc"), "-std=c99", *STRICT, "-c", *names, cwd=folder)
    return folder


@pytest.mark.parametrize(("compiler", "source"), [("clang", "main.c"), ("g++", "main.cpp")])
def test_a_program_in_c_or_cpp_builds_with_copied_files(
    compiler: str, source: str, copied_core: Path
) -> None:
    """A user may copy the core's files into a project, and compile them as C for a program in C or C++.

    run() raises if the program has a warning, or if it ends with another code than 0.
    """
    require(compiler, packages=compiler)
    (copied_core / source).write_text(PROGRAM)
    compiled_core = copied_core.glob("*.o")

    run(compiler, *STRICT, source, *compiled_core, "-o", "program", cwd=copied_core)

    run(copied_core / "program")


# --- CMake -----------------------------------------------------------------------------------------------

CMAKE_PROJECT = """
cmake_minimum_required(VERSION 3.21)
project(consumer LANGUAGES C)
{}
add_executable(program main.c t_table_omega05_q30.c)
target_link_libraries(program PRIVATE mcp_asdf::mcp_asdf)
install(TARGETS program)
"""
ADD_SUBDIRECTORY = f'add_subdirectory("{PACKAGE}" mcp_asdf)'
FETCH_CONTENT = f"""
include(FetchContent)
FetchContent_Declare(mcp_asdf SOURCE_DIR "{ROOT}")
FetchContent_MakeAvailable(mcp_asdf)
"""


def cmake(*arguments: str | Path) -> str:
    return run(require("cmake"), *arguments)


def build_with_cmake(project: Path, library_commands: str, *options: str) -> Path:
    """Build and install a project that gets the library by these commands, and return its program.

    Nothing else may be installed, and none of the library's tests may be built.
    """
    (project / "CMakeLists.txt").write_text(CMAKE_PROJECT.format(library_commands))
    cmake("-S", project, "-B", project / "build", "-DCMAKE_C_FLAGS=-Wall -Wextra -Werror", *options)
    cmake("--build", project / "build")
    cmake("--install", project / "build", "--prefix", project / "installed")
    [program] = [path for path in (project / "installed").rglob("*") if path.is_file()]
    assert "Total Tests: 0" in run("ctest", "-N", "--test-dir", project / "build")
    return program


def install_library(folder: Path, *options: str) -> Path:
    """Install the library below a folder, and return where it is.

    It is moved once it is installed, so no file may name the folder that it was installed in.
    """
    cmake("-S", PACKAGE, "-B", folder / "build", f"-DCMAKE_INSTALL_PREFIX={folder / 'first'}", *options)
    cmake("--build", folder / "build", "--target", "mcp_asdf")
    cmake("--install", folder / "build")
    shutil.rmtree(folder / "build")
    return (folder / "first").rename(folder / "second")


@pytest.fixture(scope="module")
def installed_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the library as it is installed without further options."""
    return install_library(tmp_path_factory.mktemp("library"))


@pytest.fixture
def pkg_config_path(installed_library: Path) -> str:
    """The folder in which pkg-config finds the description of the installed library."""
    [description] = installed_library.rglob("mcp_asdf.pc")
    return str(description.parent)


def test_a_project_adds_the_folder_of_the_library(project: Path) -> None:
    """It does so with CMake's add_subdirectory. run() raises unless its program ends with the code 0."""
    program = build_with_cmake(project, ADD_SUBDIRECTORY)
    run(program)


@pytest.mark.slow
def test_a_project_fetches_the_whole_repository(project: Path) -> None:
    """It does so with CMake's FetchContent, here from a folder. run() raises if its program fails."""
    program = build_with_cmake(project, FETCH_CONTENT)
    run(program)


@pytest.mark.slow
def test_cmake_finds_the_installed_version(project: Path, installed_library: Path) -> None:
    """find_package gets the version of the header. run() raises if the program that is linked to it fails."""
    command = f"find_package(mcp_asdf {version_of_header()} EXACT REQUIRED)"
    program = build_with_cmake(project, command, f"-DCMAKE_PREFIX_PATH={installed_library}")
    run(program)


@pytest.mark.slow
def test_library_headers_and_descriptions_are_installed_and_nothing_else(installed_library: Path) -> None:
    """The descriptions are those for CMake and for pkg-config."""
    installed_files = {path.name for path in installed_library.rglob("*") if path.is_file()}

    descriptions = {"mcp_asdf.pc", "mcp_asdf-config.cmake"}
    descriptions |= {"mcp_asdf-config-noconfig.cmake", "mcp_asdf-config-version.cmake"}
    assert installed_files == {"libmcp_asdf.a"} | HEADERS | descriptions


@pytest.mark.slow
def test_a_program_builds_with_the_flags_of_pkg_config(project: Path, pkg_config_path: str) -> None:
    """A description that is installed with the library has them. run() raises if the program fails.

    pkg-config refuses a description of another version than the header's.
    """
    pkg_config = require("pkg-config", "pkgconf")

    library = f"mcp_asdf = {version_of_header()}"
    flags = run(pkg_config, library, "--cflags", "--libs", PKG_CONFIG_PATH=pkg_config_path)

    sources = ("main.c", TABLE.name)  # the program, and the table of thresholds that it names
    run("cc", *STRICT, *sources, *shlex.split(flags), "-o", "program", cwd=project)
    run(project / "program")


@pytest.mark.slow
def test_meson_finds_the_installed_library(project: Path, pkg_config_path: str) -> None:
    """Meson asks pkg-config, by the lines of docs/platforms/elsewhere.md. run() raises if it fails."""
    require("meson")
    require("ninja")
    [page_s_lines] = blocks(ROOT / "docs/platforms/elsewhere.md", "meson")
    (project / "meson.build").write_text(page_s_lines)

    run("meson", "setup", "--werror", "build", cwd=project, PKG_CONFIG_PATH=pkg_config_path)
    run("meson", "compile", "-C", "build", cwd=project)

    run(project / "build/robot")


@pytest.mark.slow
def test_a_library_without_the_robust_filter_hides_it_from_the_program(project: Path) -> None:
    """An option of CMake leaves the filter out. The program compiles only if the header hides it.

    For that it ends with an #error for a header that offers the filter. run() raises if it does not compile.
    """
    (project / "main.c").write_text(PROGRAM + STOP_IF_THERE_IS_A_ROBUST_FILTER)
    program = build_with_cmake(project, ADD_SUBDIRECTORY, "-DMCP_ASDF_WITH_ROBUST=OFF")
    run(program)


@pytest.mark.slow
def test_an_installed_library_without_the_filter_of_the_paper_hides_it_from_the_program(
    project: Path,
) -> None:
    """A robot has one of two filters, and only the robust one is left, which the program's robot has.

    The program compiles only if the header hides the other one, and run() raises if it does not. For users of
    pkg-config a flag hides it.
    """
    (project / "main.c").write_text(ROBUST_PROGRAM + STOP_IF_THERE_IS_A_FILTER_OF_THE_PAPER)

    prefix = install_library(project / "library", "-DMCP_ASDF_WITH_ASDF=OFF")

    command = "find_package(mcp_asdf REQUIRED)"
    program = build_with_cmake(project, command, f"-DCMAKE_PREFIX_PATH={prefix}")
    run(program)
    [description] = prefix.rglob("mcp_asdf.pc")
    assert "-DMCP_ASDF_WITH_ASDF=0" in description.read_text(encoding="utf-8")


# --- Manifests -------------------------------------------------------------------------------------------


def read_manifest(path: Path) -> dict[str, Any]:
    """Read a manifest in JSON, in YAML, or in Arduino's lines of ``name=value``."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return cast(dict[str, Any], json.loads(text))
    if path.suffix == ".properties":
        return dict(line.split("=", 1) for line in text.splitlines())
    return cast(dict[str, Any], yaml.safe_load(text))


@pytest.mark.parametrize(
    "path",
    [
        PACKAGE / "library.properties",
        PACKAGE / "library.json",
        PACKAGE / "idf_component.yml",
        ROOT / "CITATION.cff",
    ],
    ids=lambda path: path.name,
)
def test_a_manifest_has_the_version_of_the_header_and_the_licence(path: Path) -> None:
    """Arduino, PlatformIO, ESP-IDF and those who cite read it; the version stands in the C header."""
    manifest = read_manifest(path)
    assert manifest["version"] == version_of_header()
    assert manifest["license"] == "MIT"


def test_the_python_package_has_the_version_of_the_header() -> None:
    """The header of the firmware in C has it in three macros."""
    assert metadata.version("mcp-asdf") == version_of_header()


def test_platformio_is_told_where_sources_and_headers_are() -> None:
    """Its manifest library.json names the headers for users, and the folder of all files."""
    manifest = read_manifest(PACKAGE / "library.json")
    assert set(manifest["headers"]) == HEADERS
    assert manifest["build"] == {"srcDir": "src", "includeDir": "src"}


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
    """Return the paths of the files in a tar archive."""
    with tarfile.open(archive) as tar:
        return {member.name.removeprefix("./") for member in tar if member.isfile()}


def test_platformio_packs_sources_example_manifests_and_licence(tmp_path: Path) -> None:
    """Its own packer makes the archive, and puts a note of its own, .piopm, into it.

    The program PLATFORMIO also checks the two manifests; run() raises if it fails.
    """
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    archive = tmp_path / "packed.tar.gz"

    run(sys.executable, "-c", PLATFORMIO, PACKAGE, archive, PLATFORMIO_CORE_DIR=str(tmp_path / "home"))

    example = {"examples/MinimalRobot/MinimalRobot.ino"}
    others = {"library.json", "library.properties", "README.md", "LICENSE"}
    assert files_in(archive) - {".piopm"} == SOURCE_FILES | example | others


@pytest.mark.slow
def test_esp_idf_packs_sources_build_file_manifest_and_licence(tmp_path: Path) -> None:
    """ESP-IDF's own tool compote checks the manifest, and makes the archive."""
    compote = require("compote")
    run(compote, "manifest", "lint", PACKAGE / "idf_component.yml")

    run(compote, "component", "pack", "--name", "mcp_asdf", "--dest-dir", tmp_path, cwd=PACKAGE)

    files = files_in(tmp_path / f"mcp_asdf_{version_of_header()}.tgz")
    assert files == SOURCE_FILES | {"CMakeLists.txt", "idf_component.yml", "README.md", "LICENSE"}


def test_esp_idf_builds_all_sources() -> None:
    """It reads their names in CMakeLists.txt, in a call of idf_component_register."""
    commands = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    [sources] = re.findall(r"idf_component_register\(\s*SRCS (.*?)\s+INCLUDE_DIRS src\)", commands)
    assert set(sources.split()) == {name for name in SOURCE_FILES if name.endswith(".c")}


def zephyr_module() -> dict[str, Any]:
    """Return where Zephyr's module file says that options and build commands are."""
    text = (PACKAGE / "zephyr/module.yml").read_text(encoding="utf-8")
    return cast(dict[str, Any], yaml.safe_load(text)["build"])


@pytest.mark.parametrize(
    ("settings", "expected_parts"),
    [
        ("", []),
        ("CONFIG_MCP_ASDF=y", ["mcp_asdf", "mcp_asdf_frame", "mcp_asdf_image", "mcp_asdf_small"]),
        ("CONFIG_MCP_ASDF=y\nCONFIG_MCP_ASDF_IMAGE=n", ["mcp_asdf", "mcp_asdf_frame", "mcp_asdf_small"]),
    ],
)
def test_zephyr_has_the_optional_parts_with_the_firmware_unless_they_are_left_out(
    settings: str, expected_parts: list[str], tmp_path: Path
) -> None:
    """``settings`` is what a user writes into prj.conf; each part has an option of its name, y or n.

    kconfiglib reads Zephyr's options in the place of Zephyr's tools.
    """
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    (tmp_path / "prj.conf").write_text(settings)
    file_of_options = PACKAGE / zephyr_module()["kconfig"]
    kconfig = kconfiglib.Kconfig(str(file_of_options), warn_to_stderr=False)

    kconfig.load_config(str(tmp_path / "prj.conf"))

    options = kconfig.unique_defined_syms
    chosen_parts = [option.name.lower() for option in options if option.str_value == "y"]
    assert sorted(chosen_parts) == expected_parts
    assert len(options) == 4, "an option for each part, and no more"
    assert kconfig.warnings == []


def test_zephyr_builds_the_parts_that_its_options_choose() -> None:
    """It builds the method once the firmware is chosen, and each other part if its option is y."""
    folder_of_commands = PACKAGE / zephyr_module()["cmake"]
    commands = (folder_of_commands / "CMakeLists.txt").read_text(encoding="utf-8")

    assert "zephyr_library_sources(../src/mcp_asdf.c ../src/mcp_asdf_accessors.c)" in commands
    for part in ("mcp_asdf_image", "mcp_asdf_frame", "mcp_asdf_small"):
        option = f"CONFIG_{part.upper()}"
        assert f"zephyr_library_sources_ifdef({option} ../src/{part}.c)" in commands
