"""The C tests pass under every preset of CMakePresets.json, and with every choice that a target can make."""

from __future__ import annotations

import json
import shutil
import subprocess
from itertools import product
from pathlib import Path

import pytest

from support import CORE, ROOT, require, run

SETTINGS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
WARNINGS = SETTINGS["configurePresets"][0]["environment"]["WARNINGS"].split()
PRESETS = [preset["name"] for preset in SETTINGS["workflowPresets"]]

COMPILERS = {
    "gcc": ("gcc", "gcc"),
    "clang": ("clang", "clang"),
    "sanitizers": ("clang -fsanitize=address", "libclang-rt-dev"),
    "32-bit": ("gcc -m32", "gcc-12-multilib, or gcc's version"),
    "big-endian": ("s390x-linux-gnu-gcc", "gcc-s390x-linux-gnu libc6-dev-s390x-cross"),
}
"""The compiler of each preset, and the Debian packages with which it makes programs."""


def skip_without_tools(preset: str) -> None:
    """Skip the test where the compiler of a preset, its libraries or its emulator is missing."""
    compiler, packages = COMPILERS[preset]
    program, *flags = compiler.split()
    command = [require(program, packages), *flags, "-x", "c", "-", "-o", "/dev/null"]
    source = '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n'
    done = subprocess.run(command, input=source, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"{compiler} makes no programs: apt-get install {packages}")
    if preset == "big-endian":
        require("qemu-s390x", "qemu-user")


def test_the_c_tests_pass_with_gcc() -> None:
    """CMake builds the C tests with the settings of a preset, and ctest runs them. run() raises if one fails.

    To be quick, this test has the arithmetic of one target, makes fewer calls, and does not optimise. The
    next test leaves nothing out.
    """
    skip_without_tools("gcc")
    folder = ROOT / "build/quick/gcc"
    report = ROOT / "build/reports/ctest-gcc.xml"
    one_target, both_filters, fewer_calls = "-DTEST_VARIANTS=1001", "-DTEST_WITHOUT=", "-DTEST_CALLS=200000"
    unoptimised = ("-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_C_FLAGS_DEBUG=-O0 -g1")
    options = (one_target, both_filters, fewer_calls, *unoptimised)

    run(require("cmake"), "--preset", "gcc", "-B", folder, *options)
    run("cmake", "--build", folder)
    run("ctest", "--preset", "gcc", "--test-dir", folder, "--output-junit", report)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_all_c_tests_pass_for_the_arithmetic_of_every_target(preset: str) -> None:
    """CMake builds all C tests with a preset, a compiler with flags. run() raises if a test fails."""
    skip_without_tools(preset)
    run(require("cmake"), "--workflow", "--preset", preset)


def copy_of_c_sources(clone: Path) -> Path:
    """Copy all that is needed to build C into a new folder, and return it."""
    for name in ("c_ref", "tables", "tests/c_ref", "tests/third", "host_tools/mcp_asdf_tools/experiments"):
        shutil.copytree(ROOT / name, clone / name)
    for name in ("CMakeLists.txt", "CMakePresets.json"):
        shutil.copy(ROOT / name, clone / name)
    return clone


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_set_up_in_a_clone_whose_folder_has_a_space(preset: str, tmp_path: Path) -> None:
    """The preset's flags have to be quoted: to set up, CMake compiles small programs with them.

    run() raises if one of them does not compile.
    """
    skip_without_tools(preset)
    clone = copy_of_c_sources(tmp_path / "a clone")

    run(require("cmake"), "--preset", preset, cwd=clone)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["gcc -O2 -c", "clang -O2 -fsyntax-only"])
def test_the_firmware_compiles_without_a_warning_for_any_target_s_choices(
    command: str, tmp_path: Path
) -> None:
    """By macros a target chooses how it divides, multiplies and shifts. The commands have all combinations.

    -Werror is among the WARNINGS of CMakePresets.json, so that run() raises for a warning.
    """
    compiler, *flags = command.split()
    require(compiler, packages=compiler)
    assert "-Werror" in WARNINGS
    ways_to_divide = (1, 2, 3)  # not 4, for which whoever includes the core has to bring a function
    no_or_yes = (0, 1)
    combinations = product(ways_to_divide, no_or_yes, no_or_yes, no_or_yes)
    for way_to_divide, split_multiply, shift_bytes, has_clz in combinations:
        definitions = [
            f"-DMCP_ASDF_DIVIDE={way_to_divide}",
            f"-DMCP_ASDF_SPLIT_MULTIPLY={split_multiply}",
            f"-DMCP_ASDF_SHIFT_BYTES={shift_bytes}",
            f"-DMCP_ASDF_HAS_CLZ={has_clz}",
        ]
        run(compiler, "-std=c99", *flags, *WARNINGS, *definitions, CORE, cwd=tmp_path)


def compiler_errors(definition: str) -> str:
    """Compile the core with one more definition, which must fail, and return what the compiler prints."""
    command = ["gcc", "-std=c99", "-fsyntax-only", definition, str(CORE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stderr


@pytest.mark.parametrize("unknown_way", [0, 5])
def test_the_core_does_not_compile_with_an_unknown_way_to_divide(unknown_way: int) -> None:
    """A macro chooses one of the ways 1 to 4; the compiler's message says so."""
    errors = compiler_errors(f"-DMCP_ASDF_DIVIDE={unknown_way}")
    assert "MCP_ASDF_DIVIDE is out of range: choose " in errors


@pytest.mark.parametrize(
    "macro", ["ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))"]
)
def test_the_core_does_not_compile_with_one_of_the_macros_for_read_only_memory_alone(macro: str) -> None:
    """A target whose tables are in flash defines three macros; the compiler's message asks for all."""
    assert "define all of MCP_ASDF_ROM" in compiler_errors(f"-DMCP_ASDF_{macro}")
