"""The analysers find nothing: style, types, formats and what compilers and checkers of C warn of."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import CORE, ROOT, TABLE, require, run

C_SOURCES = sorted((ROOT / "c_ref/src").glob("*.c"))
C_FILES = sorted(path for room in ("c_ref", "tests") for path in (ROOT / room).rglob("*.[ch]"))


def test_ruff_finds_nothing() -> None:
    run(require("ruff"), "check")


def test_python_is_formatted() -> None:
    run(require("ruff"), "format", "--diff")


def test_types_are_right() -> None:
    run(require("mypy"))


@pytest.mark.parametrize("path", C_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_c_is_formatted(path: Path) -> None:
    run(require("clang-format"), "--dry-run", "-Werror", path)


@pytest.mark.parametrize("path", C_SOURCES, ids=lambda path: path.name)
def test_clang_tidy_finds_nothing(path: Path) -> None:
    run(require("clang-tidy"), "--quiet", path, "--", "-std=c99", f"-I{CORE.parent}")


# Locals may be named like the function whose result they hold, and cppcheck takes 0 - x for negative.
NOT_CPPCHECK = ("--suppress=shadowFunction", "--suppress=knownConditionTrueFalse")


@pytest.mark.parametrize(
    ("split", "divide", "eight"), [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 0, 1)]
)
def test_cppcheck_finds_nothing(split: int, divide: int, eight: int) -> None:
    speed = {"SPLIT_MULTIPLY": split, "HARDWARE_DIVIDE": divide, "EIGHT_BIT": eight}
    choices = [f"-DMCP_ASDF_{name}={choice}" for name, choice in speed.items()]
    checks = ("--enable=warning,style,performance,portability", "--std=c99", "--inline-suppr", "--quiet")
    run(require("cppcheck", "cppcheck"), *checks, *NOT_CPPCHECK, *choices, "--error-exitcode=1", *C_SOURCES)


def test_gcc_s_analyser_finds_nothing(tmp_path: Path) -> None:
    include = f"-I{CORE.parent}"
    run(require("gcc", "gcc"), "-fanalyzer", "-O2", "-Werror", "-c", include, *C_SOURCES, TABLE, cwd=tmp_path)


@pytest.mark.parametrize("script", ["setup", "run"])
def test_shell_scripts_are_sound(script: str) -> None:
    run(require("shellcheck", "shellcheck"), ROOT / ".ci" / script)
