"""The C tests pass under every preset of CMakePresets.json; the sanitizer's exceptions are all needed."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from c_ref.third import choices, third_object, third_program
from support import CORE, ROOT, TABLE, require, run

PRESETS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
NAMES = [preset["name"] for preset in PRESETS["workflowPresets"]]
CHOSEN = re.findall(r"\b\d{4}\b", (ROOT / "tests/c_ref/CMakeLists.txt").read_text(encoding="utf-8"))
"""Choices that the white-box tests are built for."""


def compiles(*compiler: str) -> bool:
    """True if the compiler makes a program with the standard library."""
    source = '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n'
    command = [*compiler, "-x", "c", "-", "-o", "/dev/null"]
    done = subprocess.run(command, input=source, text=True, stderr=subprocess.DEVNULL, check=False)
    return done.returncode == 0


def skip_without_tools(preset: str) -> None:
    """Skip where the preset's compiler or emulator is not installed, naming Debian's packages."""
    if preset in ("clang", "sanitizers"):
        require("clang", "clang")
    if preset == "sanitizers" and not compiles("clang", "-fsanitize=address"):
        pytest.skip("clang's sanitizers are not installed (apt-get install libclang-rt-dev)")
    if preset == "32-bit" and not compiles("gcc", "-m32"):
        pytest.skip("gcc makes no 32-bit programs (apt-get install gcc-12-multilib, or gcc's version)")
    if preset == "big-endian":
        require("s390x-linux-gnu-gcc", "gcc-s390x-linux-gnu libc6-dev-s390x-cross")
        require("qemu-s390x", "qemu-user")


@pytest.mark.parametrize("preset", NAMES)
def test_c_tests_pass(preset: str) -> None:
    """Under every preset, and for every choice under one of them, without the time that optimising takes."""
    skip_without_tools(preset)
    folder = ROOT / "build/quick" / preset
    report = ROOT / f"build/reports/ctest-{preset}.xml"
    debug = ["-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_C_FLAGS_DEBUG=-O0 -g1"]
    choices = ";".join(CHOSEN[NAMES.index(preset) :: len(NAMES)])
    run(require("cmake"), "--preset", preset, "-B", folder, f"-DTEST_VARIANTS={choices}", *debug)
    run("cmake", "--build", folder)
    run("ctest", "--preset", preset, "--test-dir", folder, "--output-junit", report)


@pytest.mark.slow
@pytest.mark.parametrize("preset", NAMES)
def test_c_tests_pass_for_every_choice(preset: str) -> None:
    skip_without_tools(preset)
    run(require("cmake"), "--workflow", "--preset", preset)


def test_every_preset_is_run() -> None:
    configured = {p["name"] for p in PRESETS["configurePresets"] if not p.get("hidden")}
    assert configured == set(NAMES) >= {"gcc", "clang", "sanitizers", "32-bit", "big-endian"}


# --- Wrapping on purpose ---------------------------------------------------------------------------------

WRAPPING = ROOT / "c_ref/cmake/intended_wrapping.txt"
KINDS = {
    "unsigned integer overflow": "unsigned-integer-overflow",
    "left shift": "unsigned-shift-base",
    "implicit conversion": "implicit-signed-integer-truncation",
}
"""Kinds of the sanitizer's reports, and the section of the list that allows each."""
REPORT = re.compile(rf"(\S*/c_ref/src/\S*?):(\d+):\d+: runtime error: ({'|'.join(KINDS)}|.*)")
DEFINITION = re.compile(r"\b(?!if\b|for\b|while\b|switch\b)(\w+)\([^(){};]*\)\s*\{")
WRAPPING_VARIANTS = ("2100", "3010")
"""Choices under which every function that wraps on purpose is compiled."""


def function_at(path: Path, line: int) -> str:
    """The name of the C function that the line is part of."""
    above = "".join(path.read_text(encoding="utf-8").splitlines(keepends=True)[:line])
    return str(DEFINITION.findall(above)[-1])


def wraps(program: Path) -> set[tuple[str, str]]:
    """Sections and functions of all reports of the sanitizer in one run."""
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    return {
        (KINDS[kind], function_at(Path(path), int(line)))
        for path, line, kind in REPORT.findall(done.stdout + done.stderr)
    }


@pytest.mark.slow
def test_the_list_of_intended_wrapping_is_exact(tmp_path: Path) -> None:
    """Without the list, the sanitizer reports each function on it, and no other one."""
    skip_without_tools("sanitizers")
    tests = ROOT / "tests/c_ref"
    flags = ("-std=c99", "-O0", "-fsanitize=integer", "-fsanitize-recover=all", f"-I{CORE.parent}")
    image = CORE.with_name("mcp_asdf_image.c")
    run("clang", *flags, tests / "test_api.c", CORE, image, TABLE, "-o", tmp_path / "test_api")
    third = third_object(tmp_path)
    for variant in WRAPPING_VARIANTS:
        third_program(third, variant, ("clang", *flags[1:]), tmp_path / f"third_{variant}")
        for name in ("arithmetic", "state"):
            program = tmp_path / f"{name}_{variant}"
            run("clang", *flags, *choices(variant, "TEST"), tests / f"test_{name}.c", "-o", program)
    found = set().union(*(wraps(program) for program in tmp_path.iterdir() if program.suffix != ".o"))
    section, listed = "", []
    for line in WRAPPING.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line.startswith("fun:"):
            listed.append((section, line.removeprefix("fun:")))
    assert (sorted(found - set(listed)), sorted(set(listed) - found)) == ([], [])
