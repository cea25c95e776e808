"""The independent implementation (``tests/third``), linked with the core under the choices of one target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from support import CORE, ROOT, TABLE, require, run

SOURCE = ROOT / "tests/third/third.cpp"
LANES = ROOT / "host_tools/mcp_asdf_tools/experiments/engine/lanes_arithmetic.h"
CHOICES = ("DIVIDE", "SPLIT_MULTIPLY", "SHIFT_BYTES", "HAS_CLZ")
VARIANTS = ("1001", "2100", "1000", "3010", "4000", "2000")
"""Choices of Cortex-M4, Cortex-M0+, RV32, AVR, lanes of host engines, any other; those of CMakeLists.txt."""


def choices(variant: str) -> list[str]:
    """A compiler's flags for these choices."""
    flags = [f"-DMCP_ASDF_{name}={digit}" for name, digit in zip(CHOICES, variant, strict=True)]
    if variant[0] != "4":
        return flags
    return [*flags, f"-I{LANES.parent}", "-include", LANES.name]


def third_object(folder: Path, flags: Sequence[str] = ()) -> Path:
    """The independent implementation, compiled once for all cores of a build."""
    made = folder / "third.o"
    run(require("g++", "g++"), "-std=c++17", "-O2", f"-I{CORE.parent}", *flags, "-c", SOURCE, "-o", made)
    return made


def third_program(third: Path, variant: str, compiler: Sequence[str], program: Path) -> Path:
    """A program of it and of the core, compiled by ``compiler`` with its flags under these choices."""
    objects = []
    for source in (CORE, CORE.with_name("mcp_asdf_image.c"), TABLE):
        objects.append(program.with_name(f"{program.name}_{source.stem}.o"))
        flags = ("-std=c99", f"-I{CORE.parent}", *choices(variant))
        run(*compiler, *flags, "-c", source, "-o", objects[-1])
    run(*compiler, third, *objects, "-lstdc++", "-lm", "-o", program)
    return program
