"""Run the tests that notice mutants of the firmware: the independent implementation and the C tests.

They run under the choices of every target, compiled by tcc, which takes milliseconds.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from proofs.source import ARITHMETIC, AVR, FIRMWARE, LANES_HEADER, SOURCES, VARIANTS, Variant
from support import ROOT, TABLE, require, run

MUTATED = (
    *FIRMWARE,
    *ARITHMETIC,
    LANES_HEADER,
)
"""The firmware, and what the engine divides with. The other headers declare what callers see; tests in both
languages compare their numbers."""
TESTS = ROOT / "tests/c_ref"
PORTS = ROOT / "c_ref/ports"
COUNT_LEADING_ZEROS = Path(__file__).with_name("clz.h")
BUILDS = tuple(Variant("1001", f"MCP_ASDF_WITH_{filter}=0") for filter in ("ROBUST", "ASDF"))
"""Builds without a filter; only the independent implementation is run with them."""
ALL_VARIANTS = (*VARIANTS, *BUILDS)
"""The arithmetic of every target with both filters, and these builds."""
VARIANTS_OF = {
    "mcp_asdf_target_avr.h": (AVR, Variant("3010")),
    "mcp_asdf_target_small.h": tuple(map(Variant, ("2100", "2000", "4000"))),
    "lanes_arithmetic.h": (Variant("4000"),),
    "mcp_asdf_frame.c": VARIANTS[:1],
    "mcp_asdf_small.c": VARIANTS[:1],
}
"""Variants with which the mutants of a file are tried, by file. Other files' mutants are tried with all.

A file of one target is compiled for that target alone, and the codecs do not depend on the target.
"""
THIRD = "third"
"""Name of the independent implementation as a test; all other tests are those of the C tests."""
CORE_LIBRARY = "libcore.so"
CODEC_TESTS = {"mcp_asdf_frame.c": ("node", "frame"), "mcp_asdf_small.c": ("small",)}
"""Tests of the optional files that the independent implementation does not contain."""
FEW_CALLS, MANY_CALLS, MOST_CALLS = 20_000, 1_000_000, 8_000_000
"""Numbers of calls of the independent implementation. Few calls take a fiftieth of a second and show most
mistakes. Some mistakes show only once in many million calls."""


@dataclass(frozen=True)
class Try:
    """A test of a mutant, under a target's choices. The independent implementation makes ``calls`` calls."""

    test: str
    variant: Variant
    calls: int = FEW_CALLS


def is_noticed(path: Path, source: str, is_patient: bool = True) -> bool:
    """Return whether a test fails if a file of the firmware has another text.

    A text that passes the quick tests is tried with those that take seconds, if ``is_patient``.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        for original in (*SOURCES.glob("*.[ch]"), LANES_HEADER):
            shutil.copy(original, folder)
        (folder / path.name).write_text(source, encoding="utf-8")
        return not all(_passes(folder, attempt) for attempt in _tries(path.name, is_patient))


def _tries(file: str, is_patient: bool) -> list[Try]:
    """Return the tests for this file: the quick ones and, if ``is_patient``, those that take seconds."""
    variants = VARIANTS_OF.get(file, ALL_VARIANTS)
    if file in CODEC_TESTS:
        return [Try(test, variants[0]) for test in CODEC_TESTS[file]]
    few_calls = [Try(THIRD, variant) for variant in variants]
    core_tests = [Try("core", variant) for variant in variants if variant not in BUILDS]
    # Nearly all mistakes fail a test of the first variant; of the others' tests the quickest come first.
    first_tries = [few_calls[0], core_tests[0], *few_calls[1:]]
    if not is_patient:
        return [*first_tries, *core_tests[1:]]
    many_calls = [Try(THIRD, variant, MANY_CALLS) for variant in variants]
    # Of 2,448 mistakes 14 show next with many calls of the first variant, one in another's core test.
    most_calls = Try(THIRD, variants[0], MOST_CALLS)
    return [*first_tries, many_calls[0], *core_tests[1:], *many_calls[1:], most_calls]


def _passes(folder: Path, attempt: Try) -> bool:
    """Return whether a test passes with the sources in the folder."""
    flags = ["-std=c99", "-w", "-DCHECK_ONCE", f"-I{folder}", f"-I{PORTS}", *attempt.variant.flags()]
    flags += ["-include", str(COUNT_LEADING_ZEROS)]
    if attempt.variant == AVR:  # it gets its own code, but reads flash as this machine does
        flash_readers = ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
        flags += [f"-DMCP_ASDF_{reader}" for reader in flash_readers]
    if attempt.test != THIRD:
        # A white-box test contains the firmware, any other is linked with it.
        sources = [] if attempt.test == "core" else [*folder.glob("*.c")]
        sources += PORTS.glob("node/*.c") if attempt.test == "node" else ()
        return _succeeds("tcc", *flags, *sources, TABLE, "-run", TESTS / f"test_{attempt.test}.c")
    # The independent implementation loads the core as a library.
    core = (folder / "mcp_asdf.c", folder / "mcp_asdf_image.c")
    if not _succeeds("tcc", *flags, "-shared", *core, "-o", folder / CORE_LIBRARY):
        return False
    build_flags = [f"-D{attempt.variant.target}"] if attempt.variant in BUILDS else []
    program = Path(_third(*build_flags).name, THIRD)
    seconds = 1 + attempt.calls // 100_000  # over ten times its usual time
    seed, calls = "1", str(attempt.calls)
    return _succeeds(program, seed, calls, seconds=seconds, LD_LIBRARY_PATH=str(folder))


@cache
def _third(*flags: str) -> TemporaryDirectory[str]:
    """Build the independent implementation with some flags, and return the folder of the program.

    It is linked with a library of the firmware. When it runs, it loads a mutant's library in its place. A
    process builds it once for the same flags, and the folder lasts as long as the process.
    """
    temporary_folder = TemporaryDirectory()
    folder = Path(temporary_folder.name)
    sources = (SOURCES / "mcp_asdf.c", SOURCES / "mcp_asdf_image.c")
    library = ("-shared", "-fPIC", f"-Wl,-soname,{CORE_LIBRARY}", "-w", *flags)
    run(require("gcc", "gcc"), *library, *sources, "-o", folder / CORE_LIBRARY)
    objects = (third_object(folder, *flags), TABLE, folder / CORE_LIBRARY)
    run("gcc", f"-I{SOURCES}", *objects, "-lstdc++", "-lm", "-o", folder / THIRD)
    return temporary_folder


def third_object(folder: Path, *flags: str) -> Path:
    """Compile the independent implementation, and return the object file.

    The file can be linked with every core that is built with the same flags.
    """
    object_file, source = folder / "third.o", ROOT / "tests/third/third.cpp"
    run(require("g++", "g++"), "-std=c++17", "-O1", f"-I{SOURCES}", *flags, "-c", source, "-o", object_file)
    return object_file


def _succeeds(*command: str | Path, seconds: int = 2, **environment: str) -> bool:
    """Return whether the command succeeds before its processor time is over.

    A mutant that hangs uses it up. A C test takes from a thirtieth to a quarter of two seconds.
    """
    no_output = subprocess.DEVNULL
    process = subprocess.Popen(command, env={**os.environ, **environment}, stdout=no_output, stderr=no_output)
    resource.prlimit(process.pid, resource.RLIMIT_CORE, (0, 0))  # a crash leaves no file
    resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
    return process.wait() == 0
