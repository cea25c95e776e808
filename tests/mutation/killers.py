"""Tests that a mutant of the firmware has to get past: the independent implementation and the C tests, under
the choices of every target."""

from __future__ import annotations

import atexit
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

from c_ref.third import third_object
from mutation.c_mutants import Mutant
from proofs.source import LANES_HEADER, SOURCES, Variant
from support import CORE, ROOT, TABLE

TESTS = ROOT / "tests/c_ref"
PORTS = ROOT / "c_ref/ports"
CLZ = Path(__file__).with_name("clz.h")
VARIANTS = (
    *(Variant(digits) for digits in ("1001", "2100", "3010", "4000", "2000", "1000")),
    Variant("3010", "__AVR__"),
    Variant("1000", "__riscv"),
)
"""The choices of each target, and the two targets with code of their own."""
THIRD = "third"
"""The independent implementation; all else is what it cannot see."""
CORE_TESTS = (THIRD, "arithmetic", "api", "state")
BLACK_BOX = ("api", "frame", "node")
CALLS = 1_000_000
"""Calls of the independent implementation: a tenth of a second."""
SECONDS = 3
"""Of processor for one test, many times what it needs; a mutant that hangs costs no more."""


@dataclass(frozen=True)
class Compiler:
    """How a test is compiled and run at once.

    Attributes:
        name: Of the program: ``tcc``, which takes milliseconds, or ``gcc``, where there is none.
    """

    name: str

    def passes(self, folder: Path, test: str, variant: Variant) -> bool:
        """True if the test of this name passes with the sources in the folder."""
        if test == THIRD:
            return self._third_passes(folder, variant)
        flags = [f"-I{folder}", f"-I{PORTS}", *_flags(variant), "-w", "-DCHECK_ONCE"]
        sources = [TESTS / f"test_{test}.c", *_linked(folder, test)]
        if self.name == "tcc":
            return _limited("tcc", *flags, "-include", CLZ, *sources[1:], "-run", sources[0])
        with TemporaryDirectory() as made:  # the folder may be the firmware's own
            program = Path(made) / "program"
            return _limited("gcc", "-O1", *flags, *sources, "-o", program, seconds=60) and _limited(program)

    def _third_passes(self, folder: Path, variant: Variant) -> bool:
        own: tuple[str | Path, ...] = ("-include", CLZ) if self.name == "tcc" else ("-O1",)
        with TemporaryDirectory() as made:
            objects: list[Path] = []
            program = Path(made) / "program"
            for source in (folder / "mcp_asdf.c", folder / "mcp_asdf_image.c", TABLE):
                objects.append(Path(made) / f"{source.stem}.o")
                flags = (f"-I{folder}", *_flags(variant), "-w", *own)
                if not _limited(self.name, *flags, "-c", source, "-o", objects[-1]):
                    return False
            is_linked = _limited("gcc", "-no-pie", _third(), *objects, "-lstdc++", "-lm", "-o", program)
            return is_linked and _limited(program, "1", str(CALLS))


@cache
def _third() -> Path:
    """The independent implementation, compiled; it is made once a process."""
    folder = Path(mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return third_object(folder)


@cache
def fastest() -> Compiler:
    """``tcc``, or ``gcc`` without it."""
    return Compiler("tcc" if shutil.which("tcc") else "gcc")


def _flags(variant: Variant) -> list[str]:
    """An AVR's code of its own, but for its way to read flash."""
    readers = ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
    return [
        "-std=c99",
        *variant.flags(),
        *(f"-DMCP_ASDF_{reader}" for reader in readers if variant.target == "__AVR__"),
    ]


def _linked(folder: Path, test: str) -> list[Path]:
    """Objects that a black-box test is linked with; a white-box test contains the firmware."""
    if test not in BLACK_BOX:
        return []
    if test == "frame":
        return [folder / "mcp_asdf_frame.c"]
    sources = [folder / "mcp_asdf.c", folder / "mcp_asdf_image.c", TABLE]
    if test == "node":
        sources += [folder / "mcp_asdf_frame.c", *sorted((PORTS / "node").glob("*.c"))]
    return sources


def _limited(*command: str | Path, seconds: int = SECONDS) -> bool:
    """True if the command succeeds before its time is over."""
    done = subprocess.run(
        ("sh", "-c", f'ulimit -c 0; ulimit -t {seconds}; exec "$@"', "sh", *command),
        capture_output=True,
        check=False,
    )
    return done.returncode == 0


@cache
def _lines(file: str, variant: Variant) -> frozenset[int]:
    """Lines of a source that are compiled."""
    start = CORE if file.endswith(".h") else SOURCES / file
    shown = subprocess.run(
        [fastest().name, f"-I{SOURCES}", *_flags(variant), "-E", start],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found, line, here = set(), 0, False
    for text in shown.splitlines():
        if mark := re.match(r'# (\d+) "(.*)"', text):
            line, here = int(mark[1]), Path(mark[2]).name == file
            continue
        if here and text.strip():
            found.add(line)
        line += 1
    return frozenset(found)


def variants_of(mutant: Mutant) -> Iterator[Variant]:
    """Those in which the mutant differs from the firmware."""
    for variant in VARIANTS:
        if mutant.function.startswith("define ") or mutant.line in _lines(mutant.file, variant):
            yield variant


def tests_of(mutant: Mutant) -> tuple[str, ...]:
    """Names of the tests that run the mutant's file."""
    return ("node", "frame") if mutant.file == "mcp_asdf_frame.c" else CORE_TESTS


def killer(mutant: Mutant, folder: Path, most: int = len(VARIANTS)) -> str:
    """Test and variant that the mutant fails first; nothing if it passes all.

    Args:
        folder: For the mutant's sources, which stay there.
        most: Variants to try.
    """
    for source in (*SOURCES.glob("*.[ch]"), LANES_HEADER):
        shutil.copy(source, folder)
    (folder / mutant.file).write_text(mutant.source(), encoding="utf-8")
    variants = list(variants_of(mutant))[: 1 if mutant.file == "mcp_asdf_frame.c" else most]
    for test in tests_of(mutant):
        for variant in variants:
            if not fastest().passes(folder, test, variant):
                return f"{test} {variant}"
    return ""


def same_code(mutant: Mutant, folder: Path) -> bool:
    """True if an optimiser makes the same machine code of the mutant, for each of its variants: then it is no
    mistake."""
    source = "mcp_asdf.c" if mutant.file.endswith(".h") else mutant.file
    return all(
        _good_object(source, variant) == _object(folder / source, variant, folder)
        for variant in variants_of(mutant)
    )


@cache
def _good_object(source: str, variant: Variant) -> bytes:
    with TemporaryDirectory() as folder:
        made = _object(SOURCES / source, variant, Path(folder))
    assert made, f"gcc does not compile {source}"
    return made


def _object(source: Path, variant: Variant, folder: Path) -> bytes:
    target = folder / "object.o"
    if not _limited("gcc", "-O2", "-w", f"-I{source.parent}", *_flags(variant), "-c", source, "-o", target):
        return b""
    return target.read_bytes()
