"""The core's choices for a target compile in every combination, and wrong ones do not compile at all."""

from __future__ import annotations

import json
import shutil
import subprocess
from itertools import product
from pathlib import Path

import pytest

from support import CORE, ROOT, require, run

PRESETS = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
WARNINGS = PRESETS["configurePresets"][0]["environment"]["WARNINGS"].split()
CHOICES = {"DIVIDE": range(1, 4), "SPLIT_MULTIPLY": range(2), "SHIFT_BYTES": range(2), "HAS_CLZ": range(2)}


def complaint(*flags: str, source: Path = CORE) -> str:
    """The compiler's errors, with which it refuses the core under these flags."""
    command = ["gcc", "-std=c99", "-fsyntax-only", *flags, str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0, f"{flags} compiles"
    return done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("way", ["gcc -O2 -c", "clang -O2 -fsyntax-only"])
def test_every_combination_compiles_without_a_warning(way: str, tmp_path: Path) -> None:
    compiler, *flags = way.split()
    require(compiler, compiler)
    for values in product(*CHOICES.values()):
        chosen = [f"-DMCP_ASDF_{name}={value}" for name, value in zip(CHOICES, values, strict=True)]
        run(compiler, "-std=c99", *flags, *WARNINGS, *chosen, CORE, cwd=tmp_path)


OWN = {
    "gcc": "1001",
    "gcc -m32": "2001",
    "arm-none-eabi-gcc -mcpu=cortex-m4": "1001",
    "arm-none-eabi-gcc -mcpu=cortex-m3": "1001",
    "arm-none-eabi-gcc -mcpu=cortex-m0plus": "2100",
    "arm-none-eabi-gcc -mcpu=cortex-m23": "1100",
    "riscv64-unknown-elf-gcc -march=rv32imc -mabi=ilp32": "1000",
    "riscv64-unknown-elf-gcc -march=rv32ec -mabi=ilp32e": "2000",
    "avr-gcc -mmcu=atmega328p": "3010",
    "s390x-linux-gnu-gcc": "2000",
}
"""The choices that each compiler makes by itself: the digits are the values of CHOICES."""
PACKAGES = {"arm": "gcc-arm-none-eabi", "riscv64": "gcc-riscv64-unknown-elf", "avr": "gcc-avr avr-libc"}


@pytest.mark.parametrize("command", OWN)
def test_each_target_chooses_for_itself(command: str, tmp_path: Path) -> None:
    compiler, *flags = command.split()
    require(compiler, PACKAGES.get(compiler.partition("-")[0], "gcc-s390x-linux-gnu"))
    marks = "".join(f"own_choice MCP_ASDF_{name}\n" for name in CHOICES)
    (tmp_path / "own.c").write_text(f'#include "mcp_asdf_arithmetic.h"\n{marks}')
    shown = run(compiler, *flags, "-ffreestanding", f"-I{CORE.parent}", "-E", "-P", tmp_path / "own.c")
    values = [line.split(maxsplit=1)[1] for line in shown.splitlines() if line.startswith("own_choice")]
    assert "".join(value.strip("()") for value in values) == OWN[command]


REFUSED = {
    "-DMCP_ASDF_DIVIDE=0": "MCP_ASDF_DIVIDE is out of range: choose ",
    "-DMCP_ASDF_DIVIDE=5": "MCP_ASDF_DIVIDE is out of range: choose ",
    "-DMCP_ASDF_ROM=": "define all of MCP_ASDF_ROM",
    "-DMCP_ASDF_READ_WORD(address)=(*(address))": "define all of MCP_ASDF_ROM",
    "-DMCP_ASDF_READ_BYTE(address)=(*(address))": "define all of MCP_ASDF_ROM",
}


@pytest.mark.parametrize("flag", REFUSED)
def test_a_choice_that_is_none_is_refused(flag: str) -> None:
    assert REFUSED[flag] in complaint(flag)


VIOLATIONS = {
    "enough_senders": ("MAX_ID 127U", "MAX_ID 128U"),
    "t_is_a_word": ("MEMORY_MAX (UINT32_C(1) << 31)", "MEMORY_MAX UINT32_C(0x80000004)"),
    "halves_mirror": ("MEMORY_MIN UINT32_C(64)", "MEMORY_MIN UINT32_C(66)"),
    "b_hat_mirrors": ("B_HAT_MAX UINT32_C(0xFFFFF000)", "B_HAT_MAX UINT32_C(0xFFFFF001)"),
}
"""Name of each assertion of the core, and a change in the header that breaks it."""


@pytest.mark.parametrize("name", VIOLATIONS)
def test_a_broken_assertion_does_not_compile(name: str, tmp_path: Path) -> None:
    shutil.copytree(CORE.parent, tmp_path, dirs_exist_ok=True)
    header = tmp_path / "mcp_asdf.h"
    good, bad = VIOLATIONS[name]
    text = header.read_text(encoding="utf-8")
    assert text.count(good) == 1
    header.write_text(text.replace(good, bad))
    assert f"assert_{name}" in complaint(source=tmp_path / CORE.name)
