"""Tests that a mutant of the firmware has to get past: the independent implementation and the C tests, under
the choices of every target, compiled by tcc, which takes milliseconds."""

from __future__ import annotations

import atexit
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

from mutation.c_mutants import Mutant
from proofs.source import AVR, LANES_HEADER, SOURCES, VARIANTS, Variant
from support import ROOT, TABLE, require, run

TESTS = ROOT / "tests/c_ref"
PORTS = ROOT / "c_ref/ports"
CLZ = Path(__file__).with_name("clz.h")
BUILDS = tuple(Variant("1001", f"MCP_ASDF_WITH_{filter}=0") for filter in ("ROBUST", "ASDF"))
"""Builds without a filter; only the independent implementation is run with them."""
VARIANTS_OF = {
    "mcp_asdf_target_avr.h": (AVR, Variant("3010")),
    "mcp_asdf_target_small.h": tuple(map(Variant, ("2100", "2000", "4000"))),
    "lanes_arithmetic.h": (Variant("4000"),),
    "mcp_asdf_frame.c": VARIANTS[:1],
    "mcp_asdf_small.c": VARIANTS[:1],
}
"""Variants with which the mutants of a file are tried, by file. Those of other files are tried with all.

A file of one target is compiled for that target alone, and the codecs do not depend on the target.
"""
THIRD = "third"
"""The independent implementation; all else is what it cannot see."""
CORE_LIBRARY = "libcore.so"
CORE_TESTS = (THIRD, "core")
CODEC_TESTS = {"mcp_asdf_frame.c": ("node", "frame"), "mcp_asdf_small.c": ("small",)}
"""Tests of the optional files that the independent implementation does not contain."""
LINKED = {
    "frame": ("mcp_asdf_frame.c",),
    "small": ("mcp_asdf_small.c",),
    "node": ("mcp_asdf.c", "mcp_asdf_image.c", "mcp_asdf_frame.c"),
}
"""Sources that a black-box test is linked with; a white-box test contains the firmware."""
CALLS = 1_000_000
"""Calls of the independent implementation: a tenth of a second."""
PATIENT_CALLS = 8_000_000
"""The same for a mutant that has passed all tests: some mistakes show in one of many million calls."""
SECONDS = 10
"""Processor time that one test may take, over ten times what it needs. A mutant that hangs costs no more."""
PATIENT_SECONDS = 80
"""Processor time that PATIENT_CALLS may take."""


def passes(folder: Path, test: str, variant: Variant, calls: int = CALLS, seconds: int = SECONDS) -> bool:
    """True if the test of this name passes with the sources in the folder."""
    flags: list[str | Path] = [
        f"-I{folder}",
        f"-I{PORTS}",
        *_flags(variant),
        "-w",
        "-DCHECK_ONCE",
        "-include",
        CLZ,
    ]
    if test != THIRD:
        linked = [folder / name for name in LINKED.get(test, ())]
        ports = PORTS.glob("node/*.c") if test == "node" else ()
        return _limited("tcc", *flags, *linked, *ports, TABLE, "-run", TESTS / f"test_{test}.c")
    with TemporaryDirectory() as made:
        core = (folder / "mcp_asdf.c", folder / "mcp_asdf_image.c")
        is_made = _limited("tcc", *flags, "-shared", *core, "-o", Path(made) / CORE_LIBRARY)
        third = _third(*([f"-D{variant.target}"] if variant in BUILDS else []))
        return is_made and _limited("env", f"LD_LIBRARY_PATH={made}", third, "1", str(calls), seconds=seconds)


@cache
def _third(*flags: str) -> Path:
    """The independent implementation, linked with a library that is the firmware, or a mutant where it runs;
    made once a process for each build."""
    folder = Path(mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    sources = (SOURCES / "mcp_asdf.c", SOURCES / "mcp_asdf_image.c")
    library = ("-shared", "-fPIC", f"-Wl,-soname,{CORE_LIBRARY}", "-w", *flags)
    run(require("gcc", "gcc"), *library, *sources, "-o", folder / CORE_LIBRARY)
    objects = (third_object(folder, *flags), TABLE, folder / CORE_LIBRARY)
    run("gcc", f"-I{SOURCES}", *objects, "-lstdc++", "-lm", "-o", folder / THIRD)
    return folder / THIRD


def third_object(folder: Path, *flags: str) -> Path:
    """The independent implementation, compiled once for all cores of a build."""
    made, source = folder / "third.o", ROOT / "tests/third/third.cpp"
    run(require("g++", "g++"), "-std=c++17", "-O2", f"-I{SOURCES}", *flags, "-c", source, "-o", made)
    return made


def _flags(variant: Variant) -> list[str]:
    """An AVR's code of its own, but for its way to read flash."""
    readers = ("ROM=", "READ_WORD(address)=(*(address))", "READ_BYTE(address)=(*(address))")
    own = [f"-DMCP_ASDF_{reader}" for reader in readers] if variant == AVR else []
    return ["-std=c99", *variant.flags(), *own]


def _limited(*command: str | Path, seconds: int = SECONDS) -> bool:
    """True if the command succeeds before its time is over."""
    limits = f'ulimit -c 0; ulimit -t {seconds}; exec "$@"'
    return (
        subprocess.run(("sh", "-c", limits, "sh", *command), capture_output=True, check=False).returncode == 0
    )


def plant(mutant: Mutant, folder: Path) -> None:
    """Put the firmware into the folder, with the mistake in it."""
    for source in (*SOURCES.glob("*.[ch]"), LANES_HEADER):
        shutil.copy(source, folder)
    (folder / mutant.file).write_text(mutant.source(), encoding="utf-8")


def killer(mutant: Mutant, folder: Path, most: int = len(VARIANTS)) -> str:
    """Test and variant that the mutant fails first; nothing if it passes all.

    Args:
        mutant: Of the firmware.
        folder: For the mutant's sources, which stay there.
        most: Variants to try.
    """
    plant(mutant, folder)
    tests: tuple[str, ...] = CODEC_TESTS.get(mutant.file, CORE_TESTS)
    if mutant.file.startswith(("mcp_asdf_arithmetic", "mcp_asdf_target", "lanes")):
        tests = CORE_TESTS[::-1]  # which takes less
    variants = VARIANTS_OF.get(mutant.file, VARIANTS)[:most]
    tries = [(test, variant) for test in tests for variant in variants]
    if tests[0] == THIRD:  # what it cannot see at first, another test sees sooner than it with other choices
        tries.sort(key=lambda each: variants.index(each[1]))
    for test, variant in tries:
        if not passes(folder, test, variant):
            return f"{test} {variant}"
    for variant in () if mutant.file in CODEC_TESTS else BUILDS:
        if not passes(folder, THIRD, variant):
            return f"{THIRD} {variant}"
    if tests[0] == THIRD and not passes(folder, THIRD, variants[0], PATIENT_CALLS, seconds=PATIENT_SECONDS):
        return f"{THIRD} {variants[0]}, after many calls"
    return ""


def same_code(mutant: Mutant, folder: Path) -> bool:
    """True if an optimiser makes the same machine code of the mutant, which then is in the folder."""
    plant(mutant, folder)
    source = "mcp_asdf.c" if mutant.file.endswith(".h") else mutant.file
    return all(
        _usual_code(SOURCES / source, variant) == _code(folder / source, variant, folder)
        for variant in VARIANTS_OF.get(mutant.file, (*VARIANTS, *BUILDS))
    )


@cache
def _usual_code(source: Path, variant: Variant) -> bytes:
    with TemporaryDirectory() as folder:
        return _code(source, variant, Path(folder))


def _code(source: Path, variant: Variant, folder: Path) -> bytes:
    made = folder / "object.o"
    assert _limited("gcc", "-O2", "-w", f"-I{source.parent}", *_flags(variant), "-c", source, "-o", made)
    return made.read_bytes()
