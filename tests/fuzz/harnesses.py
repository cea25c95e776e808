"""Fuzzing what reads untrusted bytes: the harnesses, how they are compiled, and the inputs that are kept.

A harness is a C file with libFuzzer's entry. Everything happens in one process, without input or output.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from support import CORE, ROOT, TABLE, matching_files, require

HERE = Path(__file__).parent
BUILD = ROOT / "build/fuzz"
PORTS = ROOT / "c_ref/ports"
FAST = ("-O2", "-fsanitize=undefined", "-fsanitize-trap=undefined")
CHECKED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


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
        """The file of the harness's inputs. An input is a line of hexadecimal digits."""
        return HERE / f"corpus/{self.name}.txt"

    def unpack(self, folder: Path) -> Path:
        """Write the kept inputs into a new folder, each as a file as fuzzers want it; return the folder."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for line in self.corpus.read_text(encoding="ascii").split():
            data = bytes.fromhex(line)
            (folder / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
        return folder

    def run(self, inputs: Path, flags: tuple[str, ...], *options: str) -> None:
        """Compile the harness beside a folder of inputs, and run it with these.

        ``flags`` are for the compiler, and ``options`` for libFuzzer: they say whether it only tries the
        inputs or draws others from them. Raises CalledProcessError if it finds something. Before that
        libFuzzer has printed what it is, and the file of the input.
        """
        clang, program = require("clang", "clang libclang-rt-dev"), inputs.with_name(self.name)
        words = ("-std=c99", "-D_GNU_SOURCE", f"-I{CORE.parent}", f"-I{PORTS}", "-fsanitize=fuzzer", *flags)
        sources = (HERE / f"fuzz_{self.name}.c", *self.sources)
        subprocess.run((clang, *words, *sources, "-lm", "-o", program), check=True)
        common = (f"-artifact_prefix={inputs.parent}/", f"-max_len={self.longest}", "-timeout=60")
        subprocess.run((program, *common, *options, inputs), check=True)


_NODE = tuple(matching_files(PORTS, "node/*.c"))
HARNESSES = {
    each.name: each
    for each in (
        Harness("slcan", (PORTS / "slcan" / "slcan.c", *_NODE, *sorted(CORE.parent.glob("*.c")), TABLE), 128),
        Harness("multicast", (PORTS / "linux" / "multicast.c",), 256),
        Harness("radio", (PORTS / "packet_radio.c",), 96),
    )
}
