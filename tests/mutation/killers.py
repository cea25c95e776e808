"""Run the tests that notice mutants of the firmware: the independent implementation and the C tests.

They run under the choices of every target, compiled by tcc, which takes milliseconds.
"""

from __future__ import annotations

import atexit
import os
import resource
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

from mutation.c_mutants import Mutant
from proofs.source import AVR, LANES_HEADER, SOURCES, VARIANTS, Variant
from support import ROOT, TABLE, require, run

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
LINKED = {
    "frame": ("mcp_asdf_frame.c",),
    "small": ("mcp_asdf_small.c",),
    "node": ("mcp_asdf.c", "mcp_asdf_image.c", "mcp_asdf_frame.c"),
}
"""Sources that a black-box test is linked with; a white-box test contains the firmware."""
FEW_CALLS, MANY_CALLS, MOST_CALLS = 20_000, 1_000_000, 8_000_000
"""Numbers of calls of the independent implementation. Few calls take a fiftieth of a second and show most
mistakes. Some mistakes show only once in many million calls."""
SECONDS_BY_CALLS = {FEW_CALLS: 1, MANY_CALLS: 10, MOST_CALLS: 80}
"""Processor time that the independent implementation may take: over ten times its usual time."""
SECONDS = 2
"""Processor time that any other test may take: four to thirty times its usual time. A mutant that hangs
uses it up."""


@dataclass(frozen=True)
class Try:
    """A test of a mutant, under a target's choices. The independent implementation makes ``calls`` calls."""

    test: str
    variant: Variant
    calls: int = FEW_CALLS

    def __str__(self) -> str:
        return f"{self.test} {self.variant}"


def passes(folder: Path, attempt: Try) -> bool:
    """Return whether the test passes with the sources in the folder."""
    if attempt.test == THIRD:
        return _third_passes(folder, attempt)
    return _c_test_passes(folder, attempt)


def _c_test_passes(folder: Path, attempt: Try) -> bool:
    """Return whether a C test passes, which tcc compiles with the sources in the folder and runs at once."""
    linked_sources = [folder / name for name in LINKED.get(attempt.test, ())]
    ports = PORTS.glob("node/*.c") if attempt.test == "node" else ()
    flags = _flags_of_tcc(folder, attempt.variant)
    test_source = TESTS / f"test_{attempt.test}.c"
    return _succeeds("tcc", *flags, *linked_sources, *ports, TABLE, "-run", test_source)


def _third_passes(folder: Path, attempt: Try) -> bool:
    """Return whether the independent implementation finds no difference from the core in the folder.

    It is a program that loads the core as a library, which tcc makes. A core that does not compile fails.
    """
    program = _third(*([f"-D{attempt.variant.target}"] if attempt.variant in BUILDS else []))
    flags = _flags_of_tcc(folder, attempt.variant)
    core = (folder / "mcp_asdf.c", folder / "mcp_asdf_image.c")
    with TemporaryDirectory() as library_folder:
        if not _succeeds("tcc", *flags, "-shared", *core, "-o", Path(library_folder, CORE_LIBRARY)):
            return False
        seed, calls = "1", str(attempt.calls)
        seconds = SECONDS_BY_CALLS[attempt.calls]
        return _succeeds(program, seed, calls, seconds=seconds, LD_LIBRARY_PATH=library_folder)


@cache
def _third(*flags: str) -> Path:
    """Build the independent implementation, once a process for each build, and return the program.

    It is linked with a library that is the firmware, or where it runs a mutant.
    """
    folder = Path(mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    sources = (SOURCES / "mcp_asdf.c", SOURCES / "mcp_asdf_image.c")
    library = ("-shared", "-fPIC", f"-Wl,-soname,{CORE_LIBRARY}", "-w", *flags)
    run(require("gcc", "gcc"), *library, *sources, "-o", folder / CORE_LIBRARY)
    objects = (third_object(folder, *flags), TABLE, folder / CORE_LIBRARY)
    run("gcc", f"-I{SOURCES}", *objects, "-lstdc++", "-lm", "-o", folder / THIRD)
    return folder / THIRD


def third_object(folder: Path, *flags: str) -> Path:
    """Compile the independent implementation, which fits all cores of a build, and return the object file."""
    object_file, source = folder / "third.o", ROOT / "tests/third/third.cpp"
    run(require("g++", "g++"), "-std=c++17", "-O1", f"-I{SOURCES}", *flags, "-c", source, "-o", object_file)
    return object_file


def _flags_of_tcc(folder: Path, variant: Variant) -> list[str]:
    """Return the flags with which tcc compiles the sources in a folder, without warnings, for a variant.

    An AVR gets its own code, but reads flash as this machine does. With CHECK_ONCE a C test ends at the first
    check that fails.
    """
    flags = ["-std=c99", "-w", "-DCHECK_ONCE", f"-I{folder}", f"-I{PORTS}", *variant.flags()]
    flags += ["-include", str(COUNT_LEADING_ZEROS)]
    if variant == AVR:
        flash_readers = ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
        flags += [f"-DMCP_ASDF_{reader}" for reader in flash_readers]
    return flags


def _succeeds(*command: str | Path, seconds: int = SECONDS, **environment: str) -> bool:
    """Return whether the command succeeds before its processor time is over."""
    no_output = subprocess.DEVNULL
    process = subprocess.Popen(command, env={**os.environ, **environment}, stdout=no_output, stderr=no_output)
    resource.prlimit(process.pid, resource.RLIMIT_CORE, (0, 0))  # a crash leaves no file
    resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
    return process.wait() == 0


def plant(mutant: Mutant, folder: Path) -> None:
    """Put the firmware into the folder, with the mistake in it."""
    for source in (*SOURCES.glob("*.[ch]"), LANES_HEADER):
        shutil.copy(source, folder)
    (folder / mutant.file).write_text(mutant.source(), encoding="utf-8")


def tries(file: str) -> tuple[list[Try], list[Try]]:
    """Return the tests for mutants of this file: quick ones, and those that take seconds."""
    variants = VARIANTS_OF.get(file, ALL_VARIANTS)
    if file in CODEC_TESTS:
        return [Try(test, variants[0]) for test in CODEC_TESTS[file]], []
    few_calls = [Try(THIRD, variant) for variant in variants]
    core_tests = [Try("core", variant) for variant in variants if variant not in BUILDS]
    # Nearly all mistakes fail a test of the first variant; of the others' tests the quickest come first.
    quick_tries = [few_calls[0], core_tests[0], *few_calls[1:], *core_tests[1:]]
    many_calls = [Try(THIRD, variant, MANY_CALLS) for variant in variants]
    return quick_tries, [*many_calls, Try(THIRD, variants[0], MOST_CALLS)]


def first_failing_test(mutant: Mutant, folder: Path, is_patient: bool = True) -> str:
    """Return the test and the variant that the mutant fails first, or nothing if it passes all.

    Args:
        mutant: Of the firmware.
        folder: For the mutant's sources, which stay there.
        is_patient: Whether a mutant that passes the quick tests is tried with those that take seconds.
    """
    plant(mutant, folder)
    quick_tries, patient_tries = tries(mutant.file)
    attempts = quick_tries + patient_tries if is_patient else quick_tries
    for attempt in attempts:
        if not passes(folder, attempt):
            return str(attempt)
    return ""
