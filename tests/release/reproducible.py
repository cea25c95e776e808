"""Build the library, the t-tables and the wheel twice, in two folders, and compare every byte.

Run as ``python -m release.reproducible [library] [tables] [wheel]`` with ``tests`` on PYTHONPATH: all, if
none is named.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from support import ROOT, run

EPOCH = "1700000000"
"""Time that archives give their members instead of now, in seconds since 1970."""
FOLDERS = ("first", "another folder/with a longer name")


def copy_of_source(folder: Path) -> Path:
    """All files that the repository holds or that git does not ignore, copied into this new folder."""
    found = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    for name in filter(None, found.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)  # with the time of now
    return folder


def environment(folder: Path) -> dict[str, str]:
    """Settings that a build in this folder needs to forget the time and its place."""
    return {"SOURCE_DATE_EPOCH": EPOCH, "CFLAGS": f"-g -ffile-prefix-map='{folder}'=."}


def library(source: Path, out: Path) -> None:
    """The static library with debug information, as it is installed."""
    given = environment(source)
    built = source / "build"
    flags = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", "-DCMAKE_INSTALL_PREFIX=/usr")
    run("cmake", "-S", source / "c_ref", "-B", built, *flags, cwd=source, **given)
    run("cmake", "--build", built, cwd=source, **given)
    installed = {**given, "DESTDIR": str(out)}
    run("cmake", "--install", built, cwd=source, **installed)


def tables(source: Path, out: Path) -> None:
    """Two t-tables by the installed tool, and an object file of each that the source holds."""
    given = environment(source)
    make = (sys.executable, "-m", "mcp_asdf_tools.cli.main", "table", "--output", out, "--neighbours", "30")
    for omega in ("0.05", "0.2"):
        run(*make, "--omega", omega, cwd=source, **given)
    for path in sorted((source / "tables").glob("*.c")):
        mapped = ("-g", f"-ffile-prefix-map={source}=.", "-I", source / "c_ref/src")
        run("cc", *mapped, "-c", path, "-o", out / f"{path.stem}.o", cwd=source, **given)


def wheel(source: Path, out: Path) -> None:
    """The wheel and its contents, built by pip with the tools of this environment."""
    where = f"--config-settings=build-dir={source / 'build'}"
    options = ("--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", out, where)
    pip = (sys.executable, "-m", "pip", "wheel", "--disable-pip-version-check")
    run(*pip, *options, source, cwd=source, **environment(source))
    (made,) = out.iterdir()
    zipfile.ZipFile(made).extractall(out / "contents")


KINDS: dict[str, Callable[[Path, Path], None]] = {"library": library, "tables": tables, "wheel": wheel}


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file below the folder, by its path in it."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def build_twice(
    kind: str, folder: Path, change: Callable[[Path], object] = lambda source: None
) -> tuple[dict[str, str], dict[str, str]]:
    """Digests of what two builds made, the second one of a source with a ``change``."""
    found = []
    for number, name in enumerate(FOLDERS):
        source, out = copy_of_source(folder / name), folder / f"made {number}"
        if number:
            change(source)
        out.mkdir()
        KINDS[kind](source, out)
        found.append(digests(out))
    return found[0], found[1]


def main(kinds: list[str]) -> int:
    """Print each file with its digest; returns the exit code: 1 if two builds of one differ."""
    status = 0
    for kind in kinds or KINDS:
        with TemporaryDirectory(prefix="mcp-asdf-") as folder:
            first, second = build_twice(kind, Path(folder))
        for name in sorted({*first, *second}):
            same = first.get(name) == second.get(name)
            status |= not same
            print(f"{first.get(name, second.get(name))}  {name}{'' if same else '  DIFFERS'}", flush=True)
    print("the builds differ" if status else "both builds gave the same bytes")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
