"""The core gets into other projects: copied, added, fetched, found, and as a Python package.

Every way ends in a small program whose output must be the mirror's answer for the same run.
"""

from __future__ import annotations

import re
import shutil
import site
import sys
import tomllib
import zipfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import pytest

from c_ref.consumer import CONSUMER, answer, version_of_header
from support import CORE, HEADER, ROOT, TABLE, require, run, slow

BUILD = """
cmake_minimum_required(VERSION 3.21)
project(consumer LANGUAGES C)
{}
add_executable(consumer main.c t_table_omega05_q30.c)
target_link_libraries(consumer PRIVATE mcp_asdf::mcp_asdf)
install(TARGETS consumer)
"""
ADD = 'add_subdirectory("{}" mcp_asdf)'
FETCH = """
include(FetchContent)
FetchContent_Declare(mcp_asdf SOURCE_DIR "{}")
FetchContent_MakeAvailable(mcp_asdf)
"""
FIND = "find_package(mcp_asdf {} REQUIRED)"
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
TESTED_WHEELS = SETTINGS["tool"]["cibuildwheel"]["test-command"]
"""Commands with which cibuildwheel tests what it makes."""


@pytest.fixture
def expected() -> str:
    return answer()


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the consumer's sources: its program and the table that it chose."""
    (tmp_path / "main.c").write_text(CONSUMER)
    shutil.copy(TABLE, tmp_path)
    return tmp_path


def cmake(*arguments: str | Path) -> str:
    return run(require("cmake"), *arguments)


def build(project: Path, get: str, *options: str) -> Path:
    """Build the consumer, which gets the library by the command ``get``; returns the build folder."""
    (project / "CMakeLists.txt").write_text(BUILD.format(get))
    cmake("-S", project, "-B", project / "build", "-DCMAKE_C_FLAGS=-Wall -Wextra -Werror", *options)
    cmake("--build", project / "build")
    return project / "build"


@pytest.fixture(scope="module", params=["root", "c_ref", "absolute"])
def prefix(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the library was installed to and then moved, so that nothing may name the first place; or where a
    distribution put it that gives folders as absolute paths."""
    folder = tmp_path_factory.mktemp("install")
    place, is_absolute = folder / "first", request.param == "absolute"
    names = {"LIBDIR": "lib/machine", "INCLUDEDIR": "include/here"} if is_absolute else {}
    folders = [f"-DCMAKE_INSTALL_{name}={place / each}" for name, each in names.items()]
    source = ROOT if request.param == "root" else ROOT / "c_ref"
    cmake("-S", source, "-B", folder / "build", f"-DCMAKE_INSTALL_PREFIX={place}", *folders)
    cmake("--build", folder / "build", "--target", "mcp_asdf")
    cmake("--install", folder / "build")
    shutil.rmtree(folder / "build")
    return place if is_absolute else place.rename(folder / "second")


def pkg_config(prefix: Path, *arguments: str) -> str:
    (folder,) = (path.parent for path in prefix.rglob("mcp_asdf.pc"))
    return run(require("pkg-config", "pkgconf"), *arguments, "mcp_asdf", PKG_CONFIG_PATH=str(folder))


# --- Copied ----------------------------------------------------------------------------------------------


PRIVATE = (CORE.with_name("mcp_asdf_arithmetic.h"), *sorted(CORE.parent.glob("mcp_asdf_target*.h")))
ROM = CORE.with_name("mcp_asdf_rom.h")
IMAGE, FRAME = CORE.with_name("mcp_asdf_image.c"), CORE.with_name("mcp_asdf_frame.c")
FOLDER = sorted(CORE.parent.iterdir())
MINIMAL = (CORE, HEADER, ROM, *PRIVATE)
STRICT = ("-pedantic-errors", "-Wall", "-Wextra", "-Werror")
SAVING = """
    mcp_asdf_t copy;
    uint8_t image[MCP_ASDF_IMAGE_SIZE];
    mcp_asdf_save(&robot, image);
    if (mcp_asdf_restore(&copy, &config, image) != MCP_ASDF_OK || !mcp_asdf_invariants_hold(&copy)) {
        return 1;
    }
    robot = copy;
    printf("""


@pytest.mark.parametrize(("compiler", "standard"), [("gcc", "c99"), ("clang", "c17")])
@pytest.mark.parametrize("files", [MINIMAL, FOLDER], ids=["core", "folder"])
def test_the_copied_files_and_a_table_are_all_it_takes(
    files: Sequence[Path], compiler: str, standard: str, project: Path, expected: str
) -> None:
    """The compiler takes nothing beyond the standard."""
    for path in files:
        shutil.copy(path, project)
    if files is FOLDER:
        saving = CONSUMER.replace('#include "mcp_asdf.h"', '#include "mcp_asdf_image.h"')
        (project / "main.c").write_text(saving.replace("    printf(", SAVING))
    sources = [path for path in project.iterdir() if path.suffix == ".c"]
    run(require(compiler, compiler), f"-std={standard}", *STRICT, *sources, "-o", "consumer", cwd=project)
    assert run(project / "consumer") == expected


def test_the_headers_suit_c_plus_plus(project: Path, expected: str) -> None:
    """A C++ program with the C objects; its own copy of the table's declaration has C linkage."""
    optional = '#include "mcp_asdf_image.h"\n#include "mcp_asdf_frame.h"\n#include "mcp_asdf.h"\n'
    source = CONSUMER.replace('#include "mcp_asdf.h"', optional + 'extern "C" {', 1)
    source = source.replace("q30[33];", "q30[33];\n}", 1).replace("#include <stdio.h>", "")
    (project / "main.cpp").write_text("#include <stdio.h>\n" + source)
    include = f"-I{HEADER.parent}"
    run("cc", "-c", include, CORE, TABLE, cwd=project)
    objects = ("mcp_asdf.o", "t_table_omega05_q30.o")
    run(require("c++", "g++"), *STRICT, include, "main.cpp", *objects, "-o", "consumer", cwd=project)
    assert run(project / "consumer") == expected


TARGETS = {
    "host": ("cc", "gcc"),
    "32-bit": ("gcc -m32", "gcc"),
    "Cortex-M4": ("arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb", "gcc-arm-none-eabi"),
    "Cortex-M0+": ("arm-none-eabi-gcc -mcpu=cortex-m0plus -mthumb", "gcc-arm-none-eabi"),
    "RV32": ("riscv64-unknown-elf-gcc -march=rv32imac -mabi=ilp32", "gcc-riscv64-unknown-elf"),
    "AVR": ("avr-gcc -mmcu=atmega328p", "gcc-avr avr-libc"),
    "s390x": ("s390x-linux-gnu-gcc", "gcc-s390x-linux-gnu libc6-dev-s390x-cross"),
}
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Werror")
MEMORY_CALLS = re.compile(r"(__aeabi_)?mem(cpy|set|clr|move)\d?")
LONG_DIVISION = re.compile(r"u?(div|mod|divmod)(di|ti)\d|uldivmod|ldivmod")
FLOAT = re.compile(r"[sdx]f\d|aeabi_[fd]")


@pytest.mark.parametrize("optimisation", ["-Os", *slow(["-O0", "-O2"])])
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("source", [CORE, IMAGE, FRAME], ids=lambda path: path.stem)
def test_the_core_stands_on_its_own(source: Path, target: str, optimisation: str, tmp_path: Path) -> None:
    """No warning on any target, no 64-bit division, no float, no library, no data that can change.

    Of the three parts only the image needs another: it makes robots with the functions of the core.
    """
    (compiler, *flags), packages = TARGETS[target][0].split(), TARGETS[target][1]
    require(compiler, packages)
    freestanding = ("-std=c99", "-pedantic-errors", "-ffreestanding", optimisation, *WARNINGS)
    run(compiler, *flags, *freestanding, "-c", source, "-o", "core.o", cwd=tmp_path)
    tool = compiler.removesuffix("gcc").removesuffix("cc")
    symbols = [line.split()[-2:] for line in run(f"{tool}nm", "core.o", cwd=tmp_path).splitlines()]
    undefined = {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_"}
    foreign = {name for name in undefined if not name.startswith("__") and not MEMORY_CALLS.fullmatch(name)}
    assert foreign == ({"mcp_asdf_init", "mcp_asdf_observe"} if source == IMAGE else set())
    assert not [name for name in undefined if LONG_DIVISION.search(name) or FLOAT.search(name)]
    assert not [name for kind, name in symbols if kind in "bBdDcC"]


# --- Added, fetched, found -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("get", "folder"),
    [(ADD, ROOT), (FETCH, ROOT / "c_ref"), *slow([(ADD, ROOT / "c_ref"), (FETCH, ROOT)])],
    ids=["added root", "fetched c_ref", "added c_ref", "fetched root"],
)
def test_cmake_builds_it_from_source(get: str, folder: Path, project: Path, expected: str) -> None:
    """Nothing of what is embedded is installed or tested with the consumer."""
    built = build(project, get.format(folder))
    assert run(built / "consumer") == expected
    cmake("--install", built, "--prefix", project / "installed")
    assert [path.name for path in (project / "installed").rglob("*") if path.is_file()] == ["consumer"]
    assert "Total Tests: 0" in run("ctest", "-N", "--test-dir", built)


@pytest.mark.slow
def test_find_package_finds_it_by_its_version(prefix: Path, project: Path, expected: str) -> None:
    (config,) = prefix.rglob("mcp_asdf-config.cmake")
    is_usual = config.is_relative_to(prefix / "lib/cmake")
    where = f"-DCMAKE_PREFIX_PATH={prefix}" if is_usual else f"-Dmcp_asdf_DIR={config.parent}"
    assert run(build(project, FIND.format(f"{version_of_header()} EXACT"), where) / "consumer") == expected
    with pytest.raises(AssertionError, match="compatible with requested"):
        build(project, FIND.format("9.0"), where)


def linked_by_pkg_config(prefix: Path, project: Path) -> str:
    """Output of the consumer."""
    flags = pkg_config(prefix, "--cflags", "--libs").split()
    run("cc", *STRICT, "main.c", TABLE.name, *flags, "-o", "consumer", cwd=project)
    return run(project / "consumer")


def test_pkg_config_finds_it(prefix: Path, project: Path, expected: str) -> None:
    assert linked_by_pkg_config(prefix, project) == expected
    assert pkg_config(prefix, "--modversion").strip() == version_of_header() == metadata.version("mcp-asdf")


def test_what_is_installed(prefix: Path) -> None:
    files = {path.name for path in prefix.rglob("*") if path.is_file()}
    config = {"mcp_asdf-config.cmake", "mcp_asdf-config-noconfig.cmake", "mcp_asdf-config-version.cmake"}
    headers = {path.name for path in FOLDER if path.suffix == ".h"} - {path.name for path in PRIVATE}
    assert files == {"libmcp_asdf.a", "mcp_asdf.pc"} | headers | config


# --- The Python package ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    no_network = ("--no-build-isolation", "--no-deps", "--no-index", "--disable-pip-version-check")
    # The set-up has built it for speed already; here that would only take longer.
    options = (*no_network, "--config-settings=cmake.build-type=Debug", "--wheel-dir", folder)
    run(sys.executable, "-m", "pip", "wheel", "--quiet", *options, ROOT)
    (made,) = folder.iterdir()
    return made


def test_the_wheel_holds_the_packages_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    packages = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert packages == {"mcp_asdf", "mcp_asdf_tools"}
    assert {f"{package}/py.typed" for package in packages} <= names
    assert len([name for name in names if re.fullmatch(r"mcp_asdf/_native\..*\.so", name)]) == 1
    for package in (ROOT / "firmware_py/mcp_asdf", ROOT / "host_tools/mcp_asdf_tools"):
        modules = {str(path.relative_to(package.parent)) for path in package.rglob("*.py")}
        assert modules == {name for name in names if re.match(rf"{package.name}/.*\.py$", name)}
    page = ROOT / "host_tools/mcp_asdf_tools/view/page"
    parts = {str(path.relative_to(ROOT / "host_tools")) for path in page.rglob("*") if path.is_file()}
    assert len(parts) > 10
    assert parts <= names
    core = {f"mcp_asdf/core/{path.name}" for path in (ROOT / "c_ref/src").glob("*.[ch]")}
    assert core == {name for name in names if name.endswith((".c", ".h"))}
    assert f"mcp_asdf-{version_of_header()}-" in wheel.name


@pytest.mark.slow
def test_the_wheel_is_installed_by_pip_and_used(wheel: Path, tmp_path: Path) -> None:
    """In a fresh environment, which borrows only the libraries from that of the tests."""
    run(sys.executable, "-m", "venv", tmp_path / "venv")
    python = tmp_path / "venv/bin/python"
    where = Path(run(python, "-c", "import site; print(*site.getsitepackages())").strip())
    (where / "borrowed.pth").write_text("\n".join(site.getsitepackages()))
    run(python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", wheel)
    program = tmp_path / "venv/bin/mcp-asdf"
    assert run(program, "--version") == f"mcp-asdf {version_of_header()}\n"
    for command in TESTED_WHEELS:
        run(program, *command.replace("{project}", str(ROOT)).split()[1:], cwd=tmp_path)
    code = "import mcp_asdf, mcp_asdf_tools; print(mcp_asdf.__file__, mcp_asdf_tools.__file__)"
    assert all(Path(each).is_relative_to(where) for each in run(python, "-c", code).split())
