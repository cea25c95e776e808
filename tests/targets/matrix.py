"""Build the golden vectors' player for every target and run it under emulation: every compiler, every level,
and every choice that the core's arithmetic has.

    PYTHONPATH=tests python -m targets.matrix [--target NAME ...]

Prints a line for each build: the verdict and the image's bytes, or why it was left out. Exits with 1 if one
failed or none was played, 2 for bad usage. Takes minutes; the test suite runs one build of each target and of
each choice (test_targets.py).
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import Symbol, SymbolTableSection

from targets.golden_scenarios import edge_scenarios, run_scenarios

HERE = Path(__file__).resolve().parent
TOOLCHAINS = HERE.parents[1] / "c_ref" / "cmake"
IMAGE = "golden_vectors"
CORE_SOURCES = ("mcp_asdf.c", "mcp_asdf_image.c")
"""Sources of the firmware that the player needs."""

VECTORS = {"golden_edges.bin": edge_scenarios, "golden_runs.bin": run_scenarios}
"""Files of vectors, and the scenarios that they hold."""

_VERDICT = re.compile(r"PASS scenarios \d+ calls \d+ ticks \d+")
_ANSI = re.compile(r"\x1b\[\d+m")
_BY_COMPILERS = r"memcpy|memset"
_ON_CORTEX_M = r"|__aeabi_lmul|__gnu_thumb1_case_\w+"
_ON_AVR = r"|__(ashl|lshr|add|sub|mul)di3|__cmpdi2(_s8)?|__mul(ohi|uhi)?si3|__umulsidi3"


class BuildError(Exception):
    """A tool failed; the message holds what it said."""


class PlayError(Exception):
    """An image or its output is not as it should be; the message names the difference."""


@dataclass(frozen=True)
class Target:
    """A microcontroller or machine.

    Attributes:
        name: Of the preset and of the toolchain file.
        tools: Its compiler and its emulator.
        packages: Debian packages with what it needs.
        helpers: Regular expression of what the core may leave to the compiler's own library: integer helpers.
        bare: Whether it has no operating system.
        clang: Whether Clang builds for it (version 14 runs out of registers on an AVR).
    """

    name: str
    tools: tuple[str, str]
    packages: str
    helpers: str
    bare: bool = True
    clang: bool = True

    def missing(self, *more: str) -> str:
        """Why it cannot be built or run here, naming the packages; empty if it can."""
        absent = [tool for tool in (*self.tools, *more) if shutil.which(tool) is None]
        return f"no {' and no '.join(absent)}: apt-get install {self.packages}" if absent else ""


def _cortex_m(name: str) -> Target:
    tools = ("arm-none-eabi-gcc", "qemu-system-arm")
    return Target(name, tools, "gcc-arm-none-eabi qemu-system-arm", _BY_COMPILERS + _ON_CORTEX_M)


def _riscv(name: str) -> Target:
    tools = ("riscv64-unknown-elf-gcc", "qemu-system-riscv32")
    return Target(name, tools, "gcc-riscv64-unknown-elf qemu-system-misc", _BY_COMPILERS)


TARGETS = (
    Target("avr", ("avr-gcc", "simavr"), "gcc-avr avr-libc simavr", _BY_COMPILERS + _ON_AVR, clang=False),
    *map(_cortex_m, ("cortex-m0", "cortex-m3", "cortex-m4")),
    *map(_riscv, ("rv32imc", "rv32imac")),
    Target(
        "cortex-a8",
        ("arm-linux-gnueabihf-gcc", "qemu-arm"),
        "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user",
        _BY_COMPILERS,
        bare=False,
    ),
    Target(
        "s390x-linux-gnu",
        ("s390x-linux-gnu-gcc", "qemu-s390x"),
        "gcc-s390x-linux-gnu libc6-dev-s390x-cross qemu-user",
        _BY_COMPILERS,
        bare=False,
    ),
)

HOST = Target("host", ("gcc", "cmake"), "gcc cmake", _BY_COMPILERS, bare=False)
"""This computer."""

LEVELS = {
    "-O0": ("Debug", "OFF"),
    "-Os": ("MinSizeRel", "OFF"),
    "-O2": ("RelWithDebInfo", "OFF"),
    "-O3": ("Release", "OFF"),
    "-O2 LTO": ("RelWithDebInfo", "ON"),
}
"""CMake's name of the level, and whether the linker optimises."""

CHOICES = {
    "own": (),
    "divide by table": ("MCP_ASDF_DIVIDE=2",),
    "divide by bits": ("MCP_ASDF_DIVIDE=3", "MCP_ASDF_SHIFT_BYTES=1", "MCP_ASDF_HAS_CLZ=0"),
    "multiply halves": ("MCP_ASDF_SPLIT_MULTIPLY=1", "MCP_ASDF_HAS_CLZ=0"),
}
"""Ways to compute that a target's core can be built with, as definitions for the compiler."""


@dataclass(frozen=True)
class Cell:
    """One cell of the matrix.

    Attributes:
        target: Where the image runs.
        compiler: gcc or clang.
        level: Key of ``LEVELS``.
        choice: Key of ``CHOICES``.
    """

    target: Target
    compiler: str = "gcc"
    level: str = "-O2"
    choice: str = "own"

    def __str__(self) -> str:
        return f"{self.target.name:16} {self.compiler:6} {self.level:8} {self.choice:16}"


def cells_of(target: Target) -> list[Cell]:
    """Every compiler at every level; for this computer and a big-endian machine also every choice."""
    compilers = ("gcc", "clang")
    own = [Cell(target, compiler, level) for compiler in compilers for level in LEVELS]
    if target.name not in (HOST.name, "s390x-linux-gnu"):
        return own
    return own + [
        Cell(target, *more) for more in product(compilers, ("-Os", "-O2"), CHOICES) if more[-1] != "own"
    ]


def build(preset: str, folder: Path, *settings: str, only: str = "all") -> Path:
    """Build the player and the ports, or ``only`` a target of CMake's, in ``folder``; returns the image.

    Raises BuildError with all that was said.
    """
    _tool("cmake", "--preset", preset, "-B", str(folder), *(f"-D{setting}" for setting in settings))
    _tool("cmake", "--build", str(folder), "--target", only)
    return folder / IMAGE


@cache
def verdict_of(*names: str) -> str:
    """Expected output of an image that plays these files of ``VECTORS``; every call counts."""
    scenarios = [scenario for name in names for scenario in VECTORS[name]()]
    calls = [call.name for scenario in scenarios for call in scenario.calls()]
    ticks = calls.count("observe") + calls.count("step")
    return f"PASS scenarios {len(scenarios)} calls {2 * len(scenarios) + len(calls)} ticks {ticks}"


def verdict_in(printed: str) -> str | None:
    """The verdict among what an image and its emulator printed, if all its scenarios passed."""
    found = _VERDICT.search(printed)
    return found[0] if found else None


def run(folder: Path) -> tuple[bool, str]:
    """Run the image built in ``folder`` on its emulator: whether it passed, and what both printed."""
    command = ["ctest", "--test-dir", str(folder), "--verbose"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    lines = [line[3:] for line in done.stdout.splitlines() if line.startswith("1: ")]
    return done.returncode == 0, _ANSI.sub("", "\n".join(lines))


def _tool(*command: str) -> str:
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def link_core_alone(target: Target, folder: Path) -> Path:
    """Link the core built in ``folder`` by GCC with nothing else: no start-up code, no library."""
    core, linked = folder / "core" / "libmcp_asdf.a", folder / "core_alone.elf"
    cache = (folder / "CMakeCache.txt").read_text(encoding="utf-8")
    match = re.search(r"^CMAKE_C_FLAGS:STRING=(.*)$", cache, re.MULTILINE)
    flags = match[1].split() if match else []
    whole = ("-Wl,--whole-archive", str(core), "-Wl,--no-whole-archive")
    _tool(target.tools[0], *flags, "-nostdlib", "-r", *whole, "-o", str(linked))
    return linked


def core_objects(folder: Path) -> list[Path]:
    """The core as it was compiled in ``folder``: the method, and saving and restoring."""
    found = [path for name in CORE_SOURCES for path in folder.glob(f"core/**/{name}.o*")]
    assert len(found) == len(CORE_SOURCES), found
    return found


def symbols(elf: Path) -> list[Symbol]:
    """The symbols of an object or image, names of source files among them."""
    with elf.open("rb") as stream:
        table = ELFFile(stream).get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        return list(table.iter_symbols())


def needed_symbols(elf: Path) -> set[str]:
    """Symbols that an object uses and does not have."""
    return {symbol.name for symbol in symbols(elf) if symbol["st_shndx"] == "SHN_UNDEF"} - {""}


def ram_sections(elf: Path, *more: str) -> dict[str, int]:
    """Bytes of every section that takes RAM: the writable ones, and those whose names start with ``more``."""
    with elf.open("rb") as stream:
        return {
            section.name: section["sh_size"]
            for section in ELFFile(stream).iter_sections()
            if section["sh_size"] > 0
            and section["sh_flags"] & SH_FLAGS.SHF_ALLOC
            and (section["sh_flags"] & SH_FLAGS.SHF_WRITE or section.name.startswith(more or ("\0",)))
        }


def flash(image: Path) -> int:
    """Bytes that the image puts into flash: what is loaded from the file."""
    with image.open("rb") as stream:
        return sum(segment["p_filesz"] for segment in ELFFile(stream).iter_segments("PT_LOAD"))


def images_of(cell: Cell) -> list[tuple[str, ...]]:
    """The vectors that each image of a cell plays: an ATmega328P's flash holds one file at a time."""
    return [(name,) for name in VECTORS] if _on_atmega328p(cell) else [tuple(VECTORS)]


def _on_atmega328p(cell: Cell) -> bool:
    return cell.target.name == "avr" and cell.level == "-Os"


def settings_of(cell: Cell, vectors: tuple[str, ...]) -> Iterator[str]:
    """CMake's settings for an image of a cell."""
    kind, optimising_linker = LEVELS[cell.level]
    yield f"CMAKE_BUILD_TYPE={kind}"
    yield f"CMAKE_INTERPROCEDURAL_OPTIMIZATION={optimising_linker}"
    yield f"GOLDEN_VECTORS={';'.join(str(HERE / name) for name in vectors)}"
    yield f"MCP_ASDF_CHOICE={';'.join(CHOICES[cell.choice])}"
    if cell.target == HOST:
        yield f"CMAKE_C_COMPILER={cell.compiler}"
    elif cell.compiler == "clang":
        yield f"CMAKE_TOOLCHAIN_FILE={TOOLCHAINS / 'clang.cmake'}"
        yield f"MCP_ASDF_TARGET={cell.target.name}"
    if cell.target.name == "avr" and not _on_atmega328p(cell):
        yield "MCP_ASDF_AVR=atmega1284p"  # 32 KB hold the core and the vectors at -Os alone


def result_of(cell: Cell) -> tuple[str, str]:
    """Build and run a cell: "passed", "left out" or "FAILED", and the details."""
    reason = _left_out(cell)
    if reason:
        return "left out", reason
    try:
        sizes = [_play(cell, vectors) for vectors in images_of(cell)]
    except (BuildError, PlayError) as error:
        return "FAILED", str(error)
    return "passed", " and ".join(f"{size:7} bytes" for size in sizes)


def _left_out(cell: Cell) -> str:
    tools = {"cmake": "cmake", "ninja": "ninja-build"}
    if cell.compiler == "clang":
        if not cell.target.clang:
            return "clang does not build for it"
        tools |= {"clang": "clang"} if cell.target == HOST else {"clang": "clang", "ld.lld": "lld"}
    missing = cell.target.missing(*tools)
    return f"{missing} {' '.join(tools.values())}" if missing else ""


def _play(cell: Cell, vectors: tuple[str, ...]) -> int:
    """Build and run an image; returns its bytes. Raises BuildError, or PlayError if it is not in order."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image = build(cell.target.name, folder, *settings_of(cell, vectors))
        odd = set() if "LTO" in cell.level else _unexpected(cell.target, folder)
        if odd:
            raise PlayError(f"the core needs {', '.join(sorted(odd))}")
        passed, printed = run(folder)
        wanted = verdict_of(*vectors)
        if not passed or verdict_in(printed) != wanted:
            raise PlayError(f"{printed}\ninstead of {wanted}")
        return flash(image)


def _unexpected(target: Target, folder: Path) -> set[str]:
    """Symbols that the core needs and may not need; those of the core itself are none of them."""
    core = core_objects(folder)
    own = {symbol.name for elf in core for symbol in symbols(elf) if symbol["st_shndx"] != "SHN_UNDEF"}
    needed = set[str]().union(*map(needed_symbols, core)) - own
    return {name for name in needed if not re.fullmatch(target.helpers, name)}


def main() -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Run the golden vectors on every target with every compiler."
    )
    known = (*TARGETS, HOST)
    names = [target.name for target in known]
    parser.add_argument("--target", choices=names, action="append", help="only this one (may be repeated)")
    chosen = parser.parse_args().target or names
    cells = [cell for target in known if target.name in chosen for cell in cells_of(target)]
    verdicts = Counter[str]()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for cell, (verdict, details) in zip(cells, pool.map(result_of, cells), strict=True):
            print(f"{cell} {verdict:8} {details}", flush=True)
            verdicts[verdict] += 1
    print(", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())))
    return 1 if verdicts["FAILED"] or not verdicts["passed"] else 0


if __name__ == "__main__":
    sys.exit(main())
