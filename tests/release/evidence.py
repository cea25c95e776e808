"""Put the evidence of a release into one archive: ``python -m release.evidence``, after the tests.

The archive has the reports of ``make test`` and ``make verify``; the commit and what differs from it; SHA-256
of each file of the project; the versions of tools and packages that tests used; and the bill of materials.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import shutil
import subprocess
import sys
import tarfile
from importlib import metadata
from pathlib import Path

from release.sbom import bill
from support import PATH, ROOT, run

REPORTS, ARCHIVE = ROOT / "build/reports", ROOT / "build/evidence.tar.gz"
TOOLS = (
    *("gcc", "clang", "clang-19", "tcc", "arm-none-eabi-gcc", "avr-gcc", "riscv64-unknown-elf-gcc"),
    *(
        "arm-linux-gnueabihf-gcc",
        "s390x-linux-gnu-gcc",
        "qemu-system-arm",
        "qemu-system-riscv32",
        "qemu-s390x",
    ),
    *("frama-c", "cppcheck", "clang-tidy", "cmake", "ninja", "afl-fuzz", "node", "tshark", "shellcheck"),
)


def versions() -> str:
    """The machine, its tools by the first line that each says of itself, and the installed packages."""
    lines = [f"{platform.platform()}, Python {platform.python_version()}"]
    for tool in TOOLS:
        place = shutil.which(tool, path=PATH)
        words = [place or "", "-version" if tool == "frama-c" else "--version"]
        told = subprocess.run(words, capture_output=True, text=True, check=False) if place else None
        said = (told.stdout + told.stderr).strip().split("\n")[0] if told else "not installed"
        lines.append(f"{tool}: {said}")
    packages = {f"{each.name}=={each.version}" for each in metadata.distributions()}
    return "\n".join([*lines, *sorted(packages, key=str.lower), ""])


def contents(reports: Path) -> dict[str, bytes]:
    """The files of the archive. Raises SystemExit where no tests have run."""
    found = {f"reports/{path.name}": path.read_bytes() for path in sorted(reports.glob("*.xml"))}
    if not found:
        raise SystemExit(f"no reports of tests in {reports}; run make test and make verify first")
    tracked = [name for name in run("git", "ls-files", "-z").split("\0") if (ROOT / name).is_file()]
    sums = [f"{hashlib.sha256((ROOT / name).read_bytes()).hexdigest()}  {name}\n" for name in tracked]
    texts = {
        "commit.txt": run("git", "log", "-1", "--format=%H %cI") + run("git", "status", "--porcelain"),
        "versions.txt": versions(),
        "SHA256SUMS": "".join(sums),
        "sbom.json": json.dumps(bill(), indent=2),
    }
    return found | {name: text.encode() for name, text in texts.items()}


def main(reports: Path = REPORTS, archive: Path = ARCHIVE) -> None:
    """Write the archive and tell its hash, by which others can name it."""
    files = contents(reports)
    with tarfile.open(archive, "w:gz") as made:
        for name, data in files.items():
            entry = tarfile.TarInfo(f"evidence/{name}")
            entry.size = len(data)
            made.addfile(entry, io.BytesIO(data))
    print(f"{archive}: {len(files)} files, SHA-256 {hashlib.sha256(archive.read_bytes()).hexdigest()}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
