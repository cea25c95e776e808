"""Fuzzing what reads untrusted bytes: the harnesses, how they are compiled, and the inputs that are kept.

A harness is a C file with libFuzzer's entry. Everything happens in one process, without input or output.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from support import CORE, ROOT, TABLE, require

HERE = Path(__file__).parent
CORPORA = HERE / "corpus"
BUILD = ROOT / "build/fuzz"
PORTS = ROOT / "c_ref/ports"
COVERAGE = "-fsanitize-coverage=inline-8bit-counters,pc-table"
"""Options that libFuzzer needs; comparisons are not traced, which would take most of the time."""
FAST = ("-O2", COVERAGE, "-fsanitize=undefined", "-fsanitize-trap=undefined")
CHECKED = ("-O1", "-g", COVERAGE, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@dataclass(frozen=True)
class Harness:
    """One program that is fuzzed.

    Attributes:
        sources: What it is linked with, beside the file ``fuzz_NAME``.
        longest: Bytes of its longest input.
    """

    name: str
    sources: tuple[Path, ...]
    longest: int

    @property
    def corpus(self) -> Path:
        """Its inputs, each a line of hexadecimal digits."""
        return CORPORA / f"{self.name}.txt"

    def build(self, flags: tuple[str, ...] = CHECKED, compiler: str = "clang") -> Path:
        """The program, compiled if none of its sources, the compiler and the flags is what it was."""
        require(compiler, "clang libclang-rt-dev")
        known = repr((flags, compiler, *(each.read_bytes() for each in (*_everything(), *self.sources))))
        program = BUILD / f"{self.name}-{hashlib.sha256(known.encode()).hexdigest()[:16]}"
        if not program.exists():
            BUILD.mkdir(parents=True, exist_ok=True)
            part = program.with_name(f"{program.name}-{os.getpid()}.part")
            words = (
                "-std=c99",
                "-D_GNU_SOURCE",
                *flags,
                f"-I{CORE.parent}",
                f"-I{PORTS}",
                "-fsanitize=fuzzer",
            )
            sources = (HERE / f"fuzz_{self.name}.c", *self.sources)
            subprocess.run((compiler, *words, "-fsanitize=fuzzer", *sources, "-lm", "-o", part), check=True)
            part.replace(program)
        return program

    def unpack(self, folder: Path) -> Path:
        """A folder with its kept inputs, as fuzzers like them: a file each."""
        folder.mkdir(parents=True, exist_ok=True)
        for line in self.corpus.read_text(encoding="ascii").split():
            data = bytes.fromhex(line)
            (folder / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
        return folder

    def keep(self, folder: Path) -> None:
        """Make the inputs of a folder the kept ones."""
        lines = sorted(
            (each.read_bytes().hex() for each in folder.iterdir()), key=lambda each: (len(each), each)
        )
        CORPORA.mkdir(exist_ok=True)
        self.corpus.write_text("\n".join(filter(None, lines)) + "\n", encoding="ascii")


_CODEC = CORE.with_name("mcp_asdf_frame.c")
_NODE = tuple(sorted((PORTS / "node").glob("*.c")))
HARNESSES = {
    each.name: each
    for each in (
        Harness("codec", (_CODEC,), 32),
        Harness("slcan", (PORTS / "slcan" / "slcan.c", *_NODE, *sorted(CORE.parent.glob("*.c")), TABLE), 128),
        Harness("node", (), 128),
        Harness("radio", (PORTS / "packet_radio.c",), 96),
    )
}


@cache
def _everything() -> list[Path]:
    """Sources of the programs, whether or not one needs all of them."""
    folders = (HERE, CORE.parent, TABLE.parent, *(PORTS / name for name in ("", "node", "slcan", "linux")))
    return sorted(each for folder in folders for each in folder.glob("*.[ch]*") if each.is_file())


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        executions: Inputs tried.
        finding: The input for which the harness failed, or nothing.
        said: What the program printed.
    """

    executions: int
    finding: bytes
    said: str


def run(program: Path, folder: Path, *options: str) -> Outcome:
    """Run a harness over or from the inputs in a folder."""
    findings = folder.with_name(f"{folder.name}-findings")
    findings.mkdir(parents=True, exist_ok=True)
    for each in findings.iterdir():
        each.unlink()
    done = subprocess.run(
        (program, f"-artifact_prefix={findings}/", "-print_final_stats=1", *options, folder),
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    counted = re.search(r"stat::number_of_executed_units: (\d+)", done.stderr)
    found = next((each.read_bytes() for each in findings.iterdir()), b"")
    if done.returncode != 0 and not found:
        found = b"\0"
    return Outcome(int(counted[1]) if counted else 0, found, done.stderr)
