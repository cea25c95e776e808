"""``mcp-asdf firmware``: what it writes is a library that other projects build as it is."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.versions import own_version
from support import ROOT, matching_files, require, run

PROGRAM = """\
#include "mcp_asdf.h"
extern const uint32_t mcp_asdf_t_table_omega10_q30[];
static const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega10_q30);
int main(void)
{
    mcp_asdf_t robot;
    return mcp_asdf_init(&robot, &config, 7, 0xF0000000) == MCP_ASDF_OK ? 0 : 1;
}
"""
PROJECT = """\
cmake_minimum_required(VERSION 3.21)
project(robot LANGUAGES C)
{}
add_executable(robot robot.c)
target_link_libraries(robot PRIVATE mcp_asdf::mcp_asdf)
"""


def write_folder(folder: Path, *options: str) -> None:
    """Run ``mcp-asdf firmware``, which writes the folder."""
    assert main(["firmware", str(folder), *options]) == 0


def configure(
    project: Path, program: str, *settings: str, folders: tuple[str, ...] = ("vendor/mcp_asdf",)
) -> None:
    """Write a CMake project that links a program in C with libraries, and let CMake configure its build.

    The libraries are in the ``folders`` of the project. ``settings`` are further options of CMake.
    """
    lines = [f"add_subdirectory({name} build_of_folder_{index})" for index, name in enumerate(folders)]
    (project / "robot.c").write_text(program)
    (project / "CMakeLists.txt").write_text(PROJECT.format("\n".join(lines)))
    run(require("cmake", "cmake"), "-S", project, "-B", project / "build", *settings)


def build(
    project: Path, program: str, *settings: str, folders: tuple[str, ...] = ("vendor/mcp_asdf",)
) -> None:
    """Configure a project as ``configure`` does, and build it."""
    configure(project, program, *settings, folders=folders)
    run("cmake", "--build", project / "build")


def test_a_project_builds_the_folder_and_a_robot_starts(tmp_path: Path) -> None:
    write_folder(tmp_path / "vendor/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    build(tmp_path, PROGRAM)
    run(tmp_path / "build/robot")


def test_the_folder_has_all_sources_of_the_core_unchanged(tmp_path: Path) -> None:
    write_folder(tmp_path)
    for source in matching_files(ROOT / "c_ref/src", "*.[ch]"):
        assert (tmp_path / source.name).read_bytes() == source.read_bytes()


def test_firmware_names_the_array_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path, "--omega", "0.1", "--neighbours", "30")
    assert "The table is: extern const uint32_t mcp_asdf_t_table_omega10_q30[];" in capsys.readouterr().out


def test_firmware_reports_files_and_array_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path, "--omega", "0.1", "--neighbours", "30", "--json")
    report = json.loads(capsys.readouterr().out)
    assert sorted(report["files"]) == sorted(str(path) for path in tmp_path.rglob("*") if path.is_file())
    assert report["symbol"] == "mcp_asdf_t_table_omega10_q30"


def test_firmware_prints_a_line_for_each_filter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path / "mcp_asdf", "--neighbours", "30")
    printed = capsys.readouterr().out

    assert "static const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;" in printed
    assert "MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30)" in printed
    assert "MCP_ASDF_CONFIG_OFF" in printed
    assert "mcp_asdf_thousandths(mcp_asdf_x(&robot))" in printed


TWO_TABLES = """\
#include "mcp_asdf.h"
extern const uint32_t mcp_asdf_t_table_omega10_q30[], mcp_asdf_t_table_omega05_q127[];
static const mcp_asdf_config_t configs[] = {
    MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega10_q30), MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q127)};
int main(void)
{
    mcp_asdf_t robot;
    return mcp_asdf_init(&robot, &configs[0], 7, 0xF0000000) != MCP_ASDF_OK ||
           mcp_asdf_init(&robot, &configs[1], 7, 0xF0000000) != MCP_ASDF_OK;
}
"""


@pytest.mark.slow
def test_two_folders_of_one_project_share_the_library(tmp_path: Path) -> None:
    """Each folder has the library and a table; built twice, its functions would clash."""
    write_folder(tmp_path / "one", "--omega", "0.1", "--neighbours", "30")
    write_folder(tmp_path / "two")
    write_folder(tmp_path / "three")  # the table of the second one again
    build(tmp_path, TWO_TABLES, folders=("one", "two", "three"))
    run(tmp_path / "build/robot")


@pytest.mark.slow
@pytest.mark.parametrize(
    "folders",
    [
        ("core", "vendor/mcp_asdf"),
        pytest.param(("vendor/mcp_asdf", "core"), marks=pytest.mark.slow),
    ],
)
def test_a_folder_and_the_package_share_the_library(folders: tuple[str, ...], tmp_path: Path) -> None:
    """A project has the firmware as a CMake package and as a folder; built twice, functions would clash."""
    (tmp_path / "core").symlink_to(ROOT / "c_ref")
    write_folder(tmp_path / "vendor/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    build(tmp_path, PROGRAM, folders=folders)
    run(tmp_path / "build/robot")


def test_folders_of_two_versions_are_refused(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_folder(tmp_path / name)
    lists = tmp_path / "two/CMakeLists.txt"
    lists.write_text(lists.read_text().replace(own_version(), "9.8.7"))
    with pytest.raises(AssertionError) as error:
        configure(tmp_path, TWO_TABLES, folders=("one", "two"))
    message = " ".join(str(error.value).split())

    assert f"another version ({own_version()}) than this folder (9.8.7)" in message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "code"),
    [
        ("MCP_ASDF_WITH_ROBUST", "#if MCP_ASDF_WITH_ROBUST || !MCP_ASDF_WITH_ASDF"),
        pytest.param(
            "MCP_ASDF_WITH_ASDF",
            "#if MCP_ASDF_WITH_ASDF || !MCP_ASDF_WITH_ROBUST",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_filter_that_is_switched_off_is_left_out_everywhere(
    setting: str, code: str, tmp_path: Path
) -> None:
    """It is left out of the header, so that the program fails to compile if it is there, and of the library.

    A library without a filter refuses to start a robot that has it.
    """
    write_folder(tmp_path / "vendor/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    config = "MCP_ASDF_CONFIG_ROBUST" if setting == "MCP_ASDF_WITH_ASDF" else "MCP_ASDF_CONFIG_OFF"
    program = PROGRAM.replace("MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega10_q30)", config)
    build(tmp_path, f"{program}{code}\n#error it is there\n#endif\n", f"-D{setting}=OFF")
    run(tmp_path / "build/robot")
    missing_filter = "MCP_ASDF_OFF" if setting == "MCP_ASDF_WITH_ASDF" else "MCP_ASDF_ROBUST"
    (tmp_path / "robot.c").write_text(program.replace(config, f"{{0, 1, 64, {missing_filter}}}"))
    run("cmake", "--build", tmp_path / "build")

    assert subprocess.run([tmp_path / "build/robot"], check=False).returncode == 1


@pytest.mark.slow
def test_build_shared_libs_makes_a_shared_library(tmp_path: Path) -> None:
    write_folder(tmp_path / "vendor/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    build(tmp_path, PROGRAM, "-DBUILD_SHARED_LIBS=ON")
    [library] = (tmp_path / "build").rglob("libmcp_asdf.so")
    symbols = run("nm", "--dynamic", "--defined-only", library)
    assert " T mcp_asdf_alpha\n" in symbols and " R mcp_asdf_t_table_omega10_q30\n" in symbols
    run(tmp_path / "build/robot")


@pytest.mark.slow
def test_cmake_can_be_asked_for_position_independent_code(tmp_path: Path) -> None:
    write_folder(tmp_path / "vendor/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    configure(
        tmp_path,
        PROGRAM,
        "-DCMAKE_POSITION_INDEPENDENT_CODE=ON",
        "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON",
    )
    entries = json.loads((tmp_path / "build/compile_commands.json").read_text())
    library_commands = [entry["command"] for entry in entries if "vendor/mcp_asdf" in entry["file"]]

    assert len(library_commands) == len(list((tmp_path / "vendor/mcp_asdf").glob("*.c")))
    assert all("-fPIC" in command for command in library_commands)


# --- Other build systems --------------------------------------------------------------------------------

ZEPHYR_PROJECT = """\
cmake_minimum_required(VERSION 3.21)
project(robot LANGUAGES C)
set(CONFIG_MCP_ASDF y)
add_library(zephyr_interface INTERFACE)
function(zephyr_include_directories)
    target_include_directories(zephyr_interface INTERFACE ${ARGN})
endfunction()
function(zephyr_library)
    add_library(module)
    target_link_libraries(module PUBLIC zephyr_interface)
endfunction()
function(zephyr_library_sources)
    target_sources(module PRIVATE ${ARGN})
endfunction()
add_subdirectory(modules/mcp_asdf/zephyr)
add_executable(robot robot.c)
target_link_libraries(robot PRIVATE module)
"""
"""A project with functions that do in plain CMake what Zephyr's are for."""


@pytest.mark.slow
def test_the_commands_for_zephyr_build_a_robot(tmp_path: Path) -> None:
    write_folder(tmp_path / "modules/mcp_asdf", "--omega", "0.1", "--neighbours", "30")
    (tmp_path / "robot.c").write_text(PROGRAM)
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR_PROJECT)
    run(require("cmake", "cmake"), "-S", tmp_path, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build")
    run(tmp_path / "build/robot")


def test_zephyr_finds_the_build_commands_that_module_yml_names(tmp_path: Path) -> None:
    write_folder(tmp_path)
    module = yaml.safe_load((tmp_path / "zephyr/module.yml").read_text(encoding="utf-8"))
    assert module["name"] == "mcp_asdf"
    assert (tmp_path / module["build"]["cmake"] / "CMakeLists.txt").is_file()


def test_zephyr_finds_the_option_of_the_library_in_the_file_that_module_yml_names(tmp_path: Path) -> None:
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    write_folder(tmp_path)
    module = yaml.safe_load((tmp_path / "zephyr/module.yml").read_text(encoding="utf-8"))
    options = kconfiglib.Kconfig(str(tmp_path / module["build"]["kconfig"]), warn_to_stderr=False)
    assert [symbol.name for symbol in options.unique_defined_syms] == ["MCP_ASDF"]


def test_platformio_reads_both_manifests_and_builds_for_any_framework(tmp_path: Path) -> None:
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    write_folder(tmp_path)
    printed = run(sys.executable, "-c", PLATFORMIO, tmp_path, PLATFORMIO_CORE_DIR=str(tmp_path / "home"))
    for_platformio, for_arduino = map(json.loads, printed.splitlines())
    for manifest in (for_platformio, for_arduino):
        assert (manifest["name"], manifest["version"]) == ("mcp_asdf", own_version())

    assert for_platformio["frameworks"] == ["*"]


# PlatformIO's own reader and schema; the schema would fetch the list of licences.
PLATFORMIO = """
import json, sys
from platformio.package.manifest.parser import ManifestParserFactory
from platformio.package.manifest.schema import ManifestSchema
ManifestSchema.load_spdx_licenses = staticmethod(lambda: {"licenses": [{"licenseId": "MIT"}]})
for name in ("library.json", "library.properties"):
    found = ManifestParserFactory.new_from_file(f"{sys.argv[1]}/{name}").as_dict()
    ManifestSchema().load_manifest(found)
    print(json.dumps(found))
"""


# --- Writing into a folder that has files already -------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that ``mcp-asdf firmware`` has written with its default table."""
    write_folder(tmp_path)
    return tmp_path


def tables_in(folder: Path) -> list[str]:
    """Return the names of the t-tables in a folder."""
    return [path.name for path in folder.glob("t_table*.c")]


def test_sha256sum_finds_the_files_as_they_were_written(folder: Path) -> None:
    assert run("sha256sum", "--check", "--quiet", "sha256sums.txt", cwd=folder) == ""


def test_another_table_takes_the_place_of_the_first(folder: Path) -> None:
    write_folder(folder, "--neighbours", "30")
    assert tables_in(folder) == ["t_table_omega05_q30.c"]


def test_a_changed_file_is_not_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    core = folder / "mcp_asdf.c"
    core.write_text("/* ours */")

    assert main(["firmware", str(folder)]) == 2
    assert f"{core} is not as mcp-asdf firmware wrote it; keep it elsewhere" in capsys.readouterr().err
    assert core.read_text() == "/* ours */"


def test_a_file_of_an_earlier_version_is_replaced(folder: Path) -> None:
    """A file is of an earlier version if its checksum stands in the folder, although its text is another."""
    core, checksums = folder / "mcp_asdf.c", folder / "sha256sums.txt"
    new_text, old_text = core.read_bytes(), b"/* earlier */"
    new_checksum, old_checksum = hashlib.sha256(new_text).hexdigest(), hashlib.sha256(old_text).hexdigest()
    core.write_bytes(old_text)
    checksums.write_text(checksums.read_text().replace(new_checksum, old_checksum))
    write_folder(folder)

    assert core.read_bytes() == new_text


def test_a_table_of_somebody_else_is_not_deleted(folder: Path) -> None:
    (folder / "t_table_ours.c").write_text("/* ours */")
    assert main(["firmware", str(folder)]) == 2
    assert "t_table_ours.c" in tables_in(folder)


def test_force_replaces_changed_files_and_deletes_other_tables(folder: Path) -> None:
    """Without --force the command keeps what it has not written itself."""
    (folder / "mcp_asdf.c").write_text("/* ours */")
    (folder / "t_table_ours.c").write_text("/* ours */")
    write_folder(folder, "--force")

    assert tables_in(folder) == ["t_table_omega05_q127.c"]
    assert (folder / "mcp_asdf.c").read_bytes() == (ROOT / "c_ref/src/mcp_asdf.c").read_bytes()
