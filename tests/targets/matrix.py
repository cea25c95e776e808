"""The targets of the golden vectors, and how an image that plays them is built and run for each."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from support import ROOT, require, run
from targets.golden_vectors import FILES

HERE = Path(__file__).resolve().parent
_ANSI = re.compile(r"\x1b\[\d+m")


@dataclass(frozen=True)
class Target:
    """A microcontroller or machine.

    Attributes:
        name: Name of its preset and of its toolchain file.
        tools: Its compiler and its emulator, and what else building takes.
        packages: Debian packages with what it needs.
    """

    name: str
    tools: tuple[str, ...]
    packages: str


_ARM = (("arm-none-eabi-gcc", "qemu-system-arm"), "gcc-arm-none-eabi qemu-system-arm")
AVR = Target("avr", ("avr-gcc", "simavr"), "gcc-avr avr-libc simavr")
BIG_ENDIAN = Target(
    "s390x-linux-gnu",
    ("s390x-linux-gnu-gcc", "qemu-s390x"),
    "gcc-s390x-linux-gnu libc6-dev-s390x-cross qemu-user",
)
WASM = Target("wasm32", ("clang", "wasm-ld", "llvm-ar", "node"), "clang lld llvm nodejs")
"""The target for browsers. Only clang compiles for it."""
HOST = Target("host", ("gcc", "cmake"), "gcc cmake")
"""This computer."""
TARGETS = (
    AVR,
    Target("cortex-m0", *_ARM),
    Target("cortex-m4", *_ARM),
    Target(
        "rv32imc",
        ("riscv64-unknown-elf-gcc", "qemu-system-riscv32"),
        "gcc-riscv64-unknown-elf qemu-system-misc",
    ),
    Target(
        "cortex-a8",
        ("arm-linux-gnueabihf-gcc", "qemu-arm"),
        "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user",
    ),
    Target(
        "aarch64-linux-gnu",
        ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
        "gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user",
    ),
    BIG_ENDIAN,
    WASM,
    HOST,
)

LEVELS = {
    "-O0": ("Debug", "OFF"),
    "-Os": ("MinSizeRel", "OFF"),
    "-O2": ("RelWithDebInfo", "OFF"),
    "-O3": ("Release", "OFF"),
    "-O2 LTO": ("RelWithDebInfo", "ON"),
}
"""Levels of the compiler by name: CMake's type of the build, and whether the linker optimises, too."""

CHOICES = {
    "own": (),
    "divide by table": ("MCP_ASDF_DIVIDE=2",),
    "divide by bits": ("MCP_ASDF_DIVIDE=3", "MCP_ASDF_SHIFT_BYTES=1", "MCP_ASDF_HAS_CLZ=0"),
    "multiply halves": ("MCP_ASDF_SPLIT_MULTIPLY=1", "MCP_ASDF_HAS_CLZ=0"),
}
"""Ways to compute that a target's core can be built with, as definitions for the compiler."""


@dataclass(frozen=True)
class ImageBuild:
    """A way to build the image that plays the recorded calls on a target.

    Attributes:
        target: Where the image runs.
        compiler: gcc or clang.
        level: Key of ``LEVELS``.
        choice: Key of ``CHOICES``.
        files: Names of the files with recorded calls.
    """

    target: Target
    compiler: str = "gcc"
    level: str = "-O2"
    choice: str = "own"
    files: tuple[str, ...] = tuple(FILES)

    def __str__(self) -> str:
        name = " ".join([self.target.name, self.compiler, self.level, self.choice])
        return name if self.files == tuple(FILES) else f"{name}, {len(self.files)} files"

    def require_tools(self) -> None:
        """Skip the test where the image cannot be built or run."""
        for tool in self.target.tools:
            require(tool, self.target.packages)
        require("ninja")
        if self.compiler == "clang":
            require("clang", "clang lld")
            require("ld.lld", "clang lld")

    def images(self) -> list[list[str]]:
        """Return one list per image of this build: the names of the files that the image plays.

        An ATmega328P's flash holds one small file.
        """
        if self.target == AVR:
            return [[name] for name in self.files if name != "golden_many.bin"]
        return [list(self.files)]

    def settings(self) -> Iterator[str]:
        """Return CMake's settings for its image but for the files."""
        kind, optimising_linker = LEVELS[self.level]
        yield f"CMAKE_BUILD_TYPE={kind}"
        yield f"CMAKE_INTERPROCEDURAL_OPTIMIZATION={optimising_linker}"
        yield f"MCP_ASDF_CHOICE={';'.join(CHOICES[self.choice])}"
        if self.target == HOST:
            yield f"CMAKE_C_COMPILER={self.compiler}"
        elif self.compiler == "clang" and self.target != WASM:
            yield f"CMAKE_TOOLCHAIN_FILE={ROOT / 'c_ref/cmake/clang.cmake'}"
            yield f"MCP_ASDF_TARGET={self.target.name}"
        if self.target == AVR and self.level != "-Os":
            yield "MCP_ASDF_AVR=atmega1284p"  # 32 KB hold the core and the vectors at -Os alone


def usual_build(target: Target) -> ImageBuild:
    """Return the usual way to build the image of a target."""
    if target == WASM:
        return ImageBuild(target, "clang")
    return ImageBuild(target, level="-Os" if target.name in ("avr", "cortex-m0") else "-O2")


def further_builds() -> Iterator[ImageBuild]:
    """Return the other ways to build images.

    Every target has -O3, and clang where it can: Clang 14 runs out of registers on an AVR. The other levels,
    and every choice of the arithmetic, have one target with either order of bytes.
    """
    yield from (ImageBuild(WASM, "clang", level) for level in ("-O0", "-Os", "-O3"))
    for target in TARGETS:
        if target != WASM:
            yield ImageBuild(target, "gcc", "-O3")
        if target not in (WASM, AVR):
            yield ImageBuild(target, "clang", "-Os")
    for target in (BIG_ENDIAN, HOST):
        yield ImageBuild(target, "gcc", "-O0")
        yield ImageBuild(target, "clang", "-O2 LTO")
        for choice in CHOICES:
            if choice != "own":
                yield ImageBuild(target, "gcc" if target == HOST else "clang", "-O2", choice)


def play(build: ImageBuild, folder: Path, *files: Path) -> str:
    """Build the image in ``folder``, let its emulator play these files, and return what it prints."""
    vectors = f"GOLDEN_VECTORS={';'.join(map(str, files))}"
    settings = (f"-D{setting}" for setting in (vectors, *build.settings()))
    run("cmake", "--preset", build.target.name, "-B", folder, *settings, cwd=HERE)
    run("cmake", "--build", folder)
    return run_image(folder)


def run_image(folder: Path) -> str:
    """Run the image that was built in a folder, and return what it prints. If it fails, a last line says so.

    For ctest the image is the only test of the folder.
    """
    command = ["ctest", "--test-dir", str(folder), "--verbose"]
    result = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    # With --verbose ctest puts the number of the test before each line of it.
    lines = [line.removeprefix("1: ") for line in result.stdout.splitlines() if line.startswith("1: ")]
    lines.append("" if result.returncode == 0 else "a test of the image failed")
    return _ANSI.sub("", "\n".join(lines))
