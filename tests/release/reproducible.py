"""Build the library and the wheel twice, in two folders, and compare every byte.

Run as ``python -m release.reproducible`` with ``tests`` on PYTHONPATH. Exit code 1 if the builds differ.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from support import ROOT, run

FOLDERS = ("first", "another folder/with a longer name")


def build(source: Path, out: Path) -> dict[str, str]:
    """SHA-256 of each file that is built from a copy of the source in this folder, by its path."""
    for name in filter(None, run("git", "ls-files", "-z", "-co", "--exclude-standard").split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)  # with the time of now
    given = {"SOURCE_DATE_EPOCH": "1700000000", "CFLAGS": f"-g -ffile-prefix-map='{source}'=."}
    flags = ("-DCMAKE_BUILD_TYPE=RelWithDebInfo", "-DCMAKE_INSTALL_PREFIX=/usr")
    run("cmake", "-S", source / "c_ref", "-B", source / "build", *flags, cwd=source, **given)
    run("cmake", "--build", source / "build", cwd=source, **given)
    run("cmake", "--install", source / "build", cwd=source, **given, DESTDIR=str(out / "library"))
    options = ("--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", out)
    where = f"--config-settings=build-dir={source / 'build wheel'}"
    run(sys.executable, "-m", "pip", "wheel", *options, where, source, cwd=source, **given)
    (made,) = out.glob("*.whl")
    zipfile.ZipFile(made).extractall(out / "contents")
    paths = sorted(path for path in out.rglob("*") if path.is_file())
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def build_twice(folder: Path) -> list[dict[str, str]]:
    """Both builds' digests."""
    return [build(folder / name, folder / f"made {number}") for number, name in enumerate(FOLDERS)]


def main() -> int:
    """Print each file with its digest; returns the exit code."""
    with TemporaryDirectory(prefix="mcp-asdf-") as folder:
        first, second = build_twice(Path(folder))
    for name in sorted({*first, *second}):
        same = first.get(name) == second.get(name)
        print(f"{first.get(name, second.get(name))}  {name}{'' if same else '  DIFFERS'}")
    return int(first != second)


if __name__ == "__main__":
    sys.exit(main())
