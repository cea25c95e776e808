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

PROGRAM_THAT_STARTS_A_ROBOT = """\
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


def write_firmware_folder(folder: Path, *options: str) -> None:
    """Run ``mcp-asdf firmware``, which writes the folder."""
    assert main(["firmware", str(folder), *options]) == 0


def configure_project(
    project: Path, program: str, *settings: str, folders: tuple[str, ...] = ("vendor/mcp_asdf",)
) -> None:
    """Write a CMake project that links a program in C with libraries, and let CMake configure its build.

    The libraries are in the ``folders`` of the project. ``settings`` are further options of CMake.
    """
    lines = [f"add_subdirectory({name} build_of_folder_{index})" for index, name in enumerate(folders)]
    (project / "robot.c").write_text(program)
    (project / "CMakeLists.txt").write_text(PROJECT.format("\n".join(lines)))
    run(require("cmake", "cmake"), "-S", project, "-B", project / "build", *settings)


def build_project(
    project: Path, program: str, *settings: str, folders: tuple[str, ...] = ("vendor/mcp_asdf",)
) -> None:
    """Configure a project as ``configure_project`` does, and build it."""
    configure_project(project, program, *settings, folders=folders)
    run("cmake", "--build", project / "build")


OPTIONS_FOR_TABLE_OF_PROGRAM = ("--omega", "0.1", "--neighbours", "30")
"""Options for the table that PROGRAM_THAT_STARTS_A_ROBOT uses, mcp_asdf_t_table_omega10_q30."""


def run_robot(program: Path) -> None:
    """Run a robot's program. Fails unless it ends with exit code 0, as it does if the robot starts."""
    run(program)


def test_a_compiler_makes_a_robot_that_starts_of_all_sources_in_the_folder(tmp_path: Path) -> None:
    """The robot's program uses the table in the folder."""
    folder = tmp_path / "mcp_asdf"
    write_firmware_folder(folder, *OPTIONS_FOR_TABLE_OF_PROGRAM)
    (tmp_path / "robot.c").write_text(PROGRAM_THAT_STARTS_A_ROBOT)

    sources = sorted(folder.glob("*.c"))
    run("gcc", "-std=c99", f"-I{folder}", tmp_path / "robot.c", *sources, "-o", tmp_path / "robot")
    run_robot(tmp_path / "robot")


def test_the_folder_has_all_sources_of_the_core_unchanged(tmp_path: Path) -> None:
    """The core is the C firmware without its ports. Each file is compared byte for byte."""
    write_firmware_folder(tmp_path)
    for source in matching_files(ROOT / "c_ref/src", "*.[ch]"):
        assert (tmp_path / source.name).read_bytes() == source.read_bytes()


def test_firmware_names_the_array_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The user declares this array of C in a program, and gives it to the firmware."""
    write_firmware_folder(tmp_path, "--omega", "0.1", "--neighbours", "30")
    assert "The table is: extern const uint32_t mcp_asdf_t_table_omega10_q30[];" in capsys.readouterr().out


def test_firmware_reports_files_and_array_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The name of the table's array in C is ``symbol``."""
    write_firmware_folder(tmp_path, "--omega", "0.1", "--neighbours", "30", "--json")
    report = json.loads(capsys.readouterr().out)

    files_in_folder = [str(path) for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(report["files"]) == sorted(files_in_folder)
    assert report["symbol"] == "mcp_asdf_t_table_omega10_q30"


def test_firmware_prints_the_lines_of_c_that_use_the_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """There is a configuration for each filter, and a line that shows the robot's estimate.

    The configuration of ASDF names the table in the folder, which has the omega 0.05 unless it is given.
    """
    write_firmware_folder(tmp_path / "mcp_asdf", "--neighbours", "30")
    output = capsys.readouterr().out

    assert "static const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;" in output
    assert "MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30)" in output
    assert "MCP_ASDF_CONFIG_OFF" in output
    assert "mcp_asdf_thousandths(mcp_asdf_x(&robot))" in output


PROGRAM_WITH_TWO_TABLES = """\
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
def test_folders_of_one_project_share_the_library(tmp_path: Path) -> None:
    """Each folder has the library and a table; built twice, its functions would clash.

    The program uses both tables: for omega 0.1 and 30 neighbours, and the default one.
    """
    write_firmware_folder(tmp_path / "one", "--omega", "0.1", "--neighbours", "30")
    write_firmware_folder(tmp_path / "two")
    write_firmware_folder(tmp_path / "three")  # the table of the second one again
    build_project(tmp_path, PROGRAM_WITH_TWO_TABLES, folders=("one", "two", "three"))
    run_robot(tmp_path / "build/robot")


@pytest.mark.slow
@pytest.mark.parametrize("folders", [("core", "vendor/mcp_asdf"), ("vendor/mcp_asdf", "core")])
def test_a_folder_and_the_package_share_the_library(folders: tuple[str, ...], tmp_path: Path) -> None:
    """A project has the firmware as a CMake package and as a folder; built twice, functions would clash.

    Either of both comes first.
    """
    (tmp_path / "core").symlink_to(ROOT / "c_ref")
    write_firmware_folder(tmp_path / "vendor/mcp_asdf", *OPTIONS_FOR_TABLE_OF_PROGRAM)
    build_project(tmp_path, PROGRAM_THAT_STARTS_A_ROBOT, folders=folders)
    run_robot(tmp_path / "build/robot")


def test_cmake_refuses_a_project_with_folders_of_two_versions(tmp_path: Path) -> None:
    """Both folders would share one library, which has one version. The second folder is of version 9.8.7."""
    write_firmware_folder(tmp_path / "one")
    write_firmware_folder(tmp_path / "two")
    cmake_file_of_two = tmp_path / "two/CMakeLists.txt"
    cmake_file_of_two.write_text(cmake_file_of_two.read_text().replace(own_version(), "9.8.7"))

    # The helper that runs CMake fails with its output.
    with pytest.raises(AssertionError) as failure:
        configure_project(tmp_path, PROGRAM_WITH_TWO_TABLES, folders=("one", "two"))

    output_of_cmake = " ".join(str(failure.value).split())  # CMake breaks lines between words
    assert f"another version ({own_version()}) than this folder (9.8.7)" in output_of_cmake


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "condition", "config", "config_of_missing_filter"),
    [
        (
            "MCP_ASDF_WITH_ROBUST",
            "MCP_ASDF_WITH_ASDF && !MCP_ASDF_WITH_ROBUST",
            "MCP_ASDF_CONFIG_OFF",
            "{0, 1, 64, MCP_ASDF_ROBUST}",  # table, filter period, memory and filter
        ),
        (
            "MCP_ASDF_WITH_ASDF",
            "MCP_ASDF_WITH_ROBUST && !MCP_ASDF_WITH_ASDF",
            "MCP_ASDF_CONFIG_ROBUST",
            "{0, 1, 64, MCP_ASDF_OFF}",
        ),
    ],
)
def test_a_filter_that_is_switched_off_is_left_out_of_header_and_library(
    setting: str, condition: str, config: str, config_of_missing_filter: str, tmp_path: Path
) -> None:
    """The first program does not use the filter, and fails to compile if the header has it.

    The second program needs the filter. Its robot does not start, so that it ends with exit code 1. Condition
    and configurations are texts in C.
    """
    write_firmware_folder(tmp_path / "vendor/mcp_asdf", *OPTIONS_FOR_TABLE_OF_PROGRAM)
    config_with_table = "MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega10_q30)"
    program_without_filter = PROGRAM_THAT_STARTS_A_ROBOT.replace(config_with_table, config)
    check_of_header = f"#if !({condition})\n#error the header has other filters\n#endif\n"
    build_project(tmp_path, program_without_filter + check_of_header, f"-D{setting}=OFF")
    run_robot(tmp_path / "build/robot")

    program_with_filter = PROGRAM_THAT_STARTS_A_ROBOT.replace(config_with_table, config_of_missing_filter)
    (tmp_path / "robot.c").write_text(program_with_filter)
    run("cmake", "--build", tmp_path / "build")
    assert subprocess.run([tmp_path / "build/robot"], check=False).returncode == 1


@pytest.mark.slow
def test_cmake_makes_a_shared_library_if_it_is_asked_for_one(tmp_path: Path) -> None:
    """Its symbols are functions (T) and the read-only table (R), and the program runs with it."""
    write_firmware_folder(tmp_path / "vendor/mcp_asdf", *OPTIONS_FOR_TABLE_OF_PROGRAM)
    build_project(tmp_path, PROGRAM_THAT_STARTS_A_ROBOT, "-DBUILD_SHARED_LIBS=ON")

    [library] = (tmp_path / "build").rglob("libmcp_asdf.so")
    lines_of_symbols = run("nm", "--dynamic", "--defined-only", library)
    assert " T mcp_asdf_alpha\n" in lines_of_symbols
    assert " R mcp_asdf_t_table_omega10_q30\n" in lines_of_symbols
    run_robot(tmp_path / "build/robot")


@pytest.mark.slow
def test_cmake_compiles_all_sources_as_position_independent_code_if_it_is_asked_for_it(
    tmp_path: Path,
) -> None:
    """A shared library of the project can contain the firmware then. CMake lists how it calls compilers."""
    folder = tmp_path / "vendor/mcp_asdf"
    write_firmware_folder(folder, *OPTIONS_FOR_TABLE_OF_PROGRAM)
    settings = ("-DCMAKE_POSITION_INDEPENDENT_CODE=ON", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON")
    configure_project(tmp_path, PROGRAM_THAT_STARTS_A_ROBOT, *settings)

    calls_of_compiler = json.loads((tmp_path / "build/compile_commands.json").read_text())
    position_independent_sources = {call["file"] for call in calls_of_compiler if "-fPIC" in call["command"]}
    for source in matching_files(folder, "*.c"):
        assert str(source) in position_independent_sources


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
    """The robot's program is built and ends with exit code 0. Plain CMake replaces Zephyr's functions."""
    write_firmware_folder(tmp_path / "modules/mcp_asdf", *OPTIONS_FOR_TABLE_OF_PROGRAM)
    (tmp_path / "robot.c").write_text(PROGRAM_THAT_STARTS_A_ROBOT)
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR_PROJECT)
    run(require("cmake", "cmake"), "-S", tmp_path, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build")
    run_robot(tmp_path / "build/robot")


def test_zephyr_finds_the_build_commands_that_module_yml_names(tmp_path: Path) -> None:
    """Zephyr reads module.yml, which says in which folder of ours the commands are."""
    write_firmware_folder(tmp_path)
    module = yaml.safe_load((tmp_path / "zephyr/module.yml").read_text(encoding="utf-8"))
    assert module["name"] == "mcp_asdf"
    assert (tmp_path / module["build"]["cmake"] / "CMakeLists.txt").is_file()


def test_zephyr_finds_the_option_of_the_library_in_the_file_that_module_yml_names(tmp_path: Path) -> None:
    """Kconfig, Zephyr's reader of options, finds one: whether to build the library."""
    kconfiglib = pytest.importorskip("kconfiglib", reason="kconfiglib is not installed: make setup")
    write_firmware_folder(tmp_path)
    module = yaml.safe_load((tmp_path / "zephyr/module.yml").read_text(encoding="utf-8"))
    options = kconfiglib.Kconfig(str(tmp_path / module["build"]["kconfig"]), warn_to_stderr=False)
    assert [symbol.name for symbol in options.unique_defined_syms] == ["MCP_ASDF"]


def test_the_manifests_of_platformio_and_arduino_have_our_name_and_version(tmp_path: Path) -> None:
    """PlatformIO reads library.json, whose * stands for any framework, and Arduino library.properties."""
    write_firmware_folder(tmp_path)
    manifest_of_platformio = json.loads((tmp_path / "library.json").read_text())
    assert manifest_of_platformio["name"] == "mcp_asdf"
    assert manifest_of_platformio["version"] == own_version()
    assert manifest_of_platformio["frameworks"] == "*"

    lines_of_arduino = (tmp_path / "library.properties").read_text().splitlines()
    assert "name=mcp_asdf" in lines_of_arduino
    assert f"version={own_version()}" in lines_of_arduino


@pytest.mark.slow
@pytest.mark.parametrize("manifest_name", ["library.json", "library.properties"])
def test_platformio_accepts_the_manifest_for_itself_and_that_for_arduino(
    manifest_name: str, tmp_path: Path
) -> None:
    """PlatformIO's own reader finds name and version in both, and its schema refuses neither."""
    pytest.importorskip("platformio", reason="platformio is not installed: make setup")
    write_firmware_folder(tmp_path)

    output = run(
        sys.executable,
        "-c",
        PROGRAM_THAT_READS_A_MANIFEST,
        tmp_path / manifest_name,
        PLATFORMIO_CORE_DIR=str(tmp_path / "home"),  # keeps PlatformIO out of the user's home
    )
    values = json.loads(output)
    assert values["name"] == "mcp_asdf"
    assert values["version"] == own_version()


PROGRAM_THAT_READS_A_MANIFEST = """
import json, sys
from platformio.package.manifest.parser import ManifestParserFactory
from platformio.package.manifest.schema import ManifestSchema
ManifestSchema.load_spdx_licenses = staticmethod(lambda: {"licenses": [{"licenseId": "MIT"}]})
values = ManifestParserFactory.new_from_file(sys.argv[1]).as_dict()
ManifestSchema().load_manifest(values)
print(json.dumps(values))
"""
"""Program that reads a manifest as PlatformIO does; its schema would fetch the list of licences."""


# --- Writing into a folder that has files already -------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that ``mcp-asdf firmware`` has written with its default table."""
    write_firmware_folder(tmp_path)
    return tmp_path


def names_of_tables_in(folder: Path) -> list[str]:
    """Return the names of the t-tables in a folder."""
    return [path.name for path in folder.glob("t_table*.c")]


def test_sha256sum_finds_the_files_as_they_were_written(folder: Path) -> None:
    """The folder has a file with the checksums of all others, and ``sha256sum`` prints no complaint."""
    assert run("sha256sum", "--check", "--quiet", "sha256sums.txt", cwd=folder) == ""


def test_another_table_takes_the_place_of_the_first(folder: Path) -> None:
    """The first table was the default one, for 127 neighbours. Only the table for 30 is left."""
    write_firmware_folder(folder, "--neighbours", "30")
    assert names_of_tables_in(folder) == ["t_table_omega05_q30.c"]


def test_a_changed_file_is_not_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody has edited a file of the firmware. The command is refused, with exit code 2."""
    edited_file = folder / "mcp_asdf.c"
    edited_file.write_text("/* ours */")

    exit_code = main(["firmware", str(folder)])

    assert exit_code == 2
    message = f"{edited_file} is not as mcp-asdf firmware wrote it; keep it elsewhere"
    assert message in capsys.readouterr().err
    assert edited_file.read_text() == "/* ours */"


def test_a_file_of_an_earlier_version_is_replaced(folder: Path) -> None:
    """A file is of an earlier version if its checksum stands in the folder, although its text is another."""
    file = folder / "mcp_asdf.c"
    checksums = folder / "sha256sums.txt"
    new_text = file.read_bytes()
    old_text = b"/* earlier */"
    new_checksum = hashlib.sha256(new_text).hexdigest()
    old_checksum = hashlib.sha256(old_text).hexdigest()
    file.write_bytes(old_text)
    checksums.write_text(checksums.read_text().replace(new_checksum, old_checksum))

    write_firmware_folder(folder)

    assert file.read_bytes() == new_text


def test_files_that_are_as_the_command_would_write_them_need_no_checksums(folder: Path) -> None:
    """Somebody has deleted the checksums; the command writes them again."""
    checksums = folder / "sha256sums.txt"
    text = checksums.read_text()
    checksums.unlink()

    write_firmware_folder(folder)

    assert checksums.read_text() == text


def test_a_table_of_somebody_else_is_not_deleted(folder: Path) -> None:
    """The command deletes other tables only if it has written them. Here it is refused, with exit code 2."""
    (folder / "t_table_ours.c").write_text("/* ours */")

    exit_code = main(["firmware", str(folder)])

    assert exit_code == 2
    assert "t_table_ours.c" in names_of_tables_in(folder)


def test_force_replaces_changed_files_and_deletes_other_tables(folder: Path) -> None:
    """Without --force the command keeps files that it has not written itself.

    Of the tables only the default one is left, for omega 0.05 and 127 neighbours.
    """
    (folder / "mcp_asdf.c").write_text("/* ours */")
    (folder / "t_table_ours.c").write_text("/* ours */")

    write_firmware_folder(folder, "--force")

    assert names_of_tables_in(folder) == ["t_table_omega05_q127.c"]
    assert (folder / "mcp_asdf.c").read_bytes() == (ROOT / "c_ref/src/mcp_asdf.c").read_bytes()
