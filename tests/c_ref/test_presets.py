"""The C tests pass under every preset of CMakePresets.json; the core's choices for a target compile in every
combination, and wrong ones do not compile at all."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from itertools import product
from pathlib import Path

import pytest

from support import CORE, ROOT, require, run, slow

PRESETS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
WARNINGS = PRESETS["configurePresets"][0]["environment"]["WARNINGS"].split()
NAMES = [preset["name"] for preset in PRESETS["workflowPresets"]]
CHOSEN = re.findall(r"\b\d{4}\b", (ROOT / "tests/c_ref/CMakeLists.txt").read_text(encoding="utf-8"))
"""Choices that the white-box tests are built for."""


NEEDS = {
    "gcc": ("gcc", "gcc"),
    "clang": ("clang", "clang"),
    "sanitizers": ("clang -fsanitize=address", "libclang-rt-dev"),
    "32-bit": ("gcc -m32", "gcc-12-multilib, or gcc's version"),
    "big-endian": ("s390x-linux-gnu-gcc", "gcc-s390x-linux-gnu libc6-dev-s390x-cross"),
}
"""A preset's compiler, and Debian's packages that have what makes programs with it."""


def skip_without_tools(preset: str) -> None:
    compiler, packages = NEEDS[preset]
    program, *flags = compiler.split()
    command = [require(program, packages), *flags, "-x", "c", "-", "-o", "/dev/null"]
    source = '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n'
    done = subprocess.run(command, input=source, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"{compiler} makes no programs: apt-get install {packages}")
    if preset == "big-endian":
        require("qemu-s390x", "qemu-user")


@pytest.mark.parametrize("preset", [*(name for name in NAMES if name != "clang"), *slow(["clang"])])
def test_c_tests_pass(preset: str) -> None:
    """The choices of targets are spread over the presets. Neither compiling with optimisation nor comparing
    millions of calls is for make test, and neither are builds that leave a filter out."""
    skip_without_tools(preset)
    folder = ROOT / "build/quick" / preset
    report = ROOT / f"build/reports/ctest-{preset}.xml"
    debug = ["-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_C_FLAGS_DEBUG=-O0 -g1"]
    choices = ";".join(CHOSEN[NAMES.index(preset) :: len(NAMES)])
    quick = [f"-DTEST_VARIANTS={choices}", "-DTEST_WITHOUT=", "-DTEST_CALLS=200000"]
    run(require("cmake"), "--preset", preset, "-B", folder, *quick, *debug)
    run("cmake", "--build", folder)
    run("ctest", "--preset", preset, "--test-dir", folder, "--output-junit", report)


@pytest.mark.parametrize("preset", slow(NAMES))
def test_a_preset_works_in_a_folder_with_a_space(preset: str, tmp_path: Path) -> None:
    """CMake compiles small programs with the preset's flags before it writes the build's rules."""
    skip_without_tools(preset)
    source = tmp_path / "a clone"
    for name in ("c_ref", "tables", "tests/c_ref", "tests/third", "host_tools/mcp_asdf_tools/experiments"):
        shutil.copytree(ROOT / name, source / name)
    for name in ("CMakeLists.txt", "CMakePresets.json"):
        shutil.copy(ROOT / name, source / name)
    run(require("cmake"), "--preset", preset, cwd=source)
    run("cmake", "--build", "--preset", preset, "--target", "test_frame", cwd=source)


@pytest.mark.slow
@pytest.mark.parametrize("preset", NAMES)
def test_c_tests_pass_for_every_choice(preset: str) -> None:
    skip_without_tools(preset)
    run(require("cmake"), "--workflow", "--preset", preset)


CHOICES = {"DIVIDE": range(1, 4), "SPLIT_MULTIPLY": range(2), "SHIFT_BYTES": range(2), "HAS_CLZ": range(2)}


@pytest.mark.slow
@pytest.mark.parametrize("way", ["gcc -O2 -c", "clang -O2 -fsyntax-only"])
def test_every_combination_compiles_without_a_warning(way: str, tmp_path: Path) -> None:
    compiler, *flags = way.split()
    require(compiler, compiler)
    for values in product(*CHOICES.values()):
        chosen = [f"-DMCP_ASDF_{name}={value}" for name, value in zip(CHOICES, values, strict=True)]
        run(compiler, "-std=c99", *flags, *WARNINGS, *chosen, CORE, cwd=tmp_path)


@pytest.mark.parametrize(
    ("flag", "complaint"),
    [
        *((f"-DMCP_ASDF_DIVIDE={wrong}", "MCP_ASDF_DIVIDE is out of range: choose ") for wrong in (0, 5)),
        *(
            (f"-DMCP_ASDF_{part}", "define all of MCP_ASDF_ROM")
            for part in ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
        ),
    ],
)
def test_a_choice_that_is_none_is_refused(flag: str, complaint: str) -> None:
    command = ["gcc", "-std=c99", "-fsyntax-only", flag, str(CORE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and complaint in done.stderr
