"""Atomic writes of one or several files, and reads with a limit on size."""

from __future__ import annotations

import codecs
import logging
import os
import secrets
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from mcp_asdf_tools.common.errors import UsageError

_logger = logging.getLogger(__name__)

LONGEST_TEXT = 2**24
"""Bytes of the longest text that people write. A device such as /dev/zero has no end."""


def read_at_most(path: Path | str, max_bytes: int = LONGEST_TEXT) -> bytes:
    """Return all bytes of a file.

    Raises OSError if it cannot be read, ValueError if it has more than ``max_bytes``.
    """
    with Path(path).open("rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise ValueError(f"it has more than {max_bytes} bytes")
    return data


def read_text(path: Path | str) -> str:
    """Return a text that people or programs have written: a file, or standard input if ``path`` is ``-``.

    It is UTF-8, or UTF-16 with a byte order mark, and not longer than LONGEST_TEXT. Raises UsageError.
    """
    name = "standard input" if str(path) == "-" else str(path)
    try:
        data = _read_standard_input() if str(path) == "-" else read_at_most(path)
        encoding = "utf-16" if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
        return data.decode(encoding)
    except OSError as error:
        raise UsageError(f"cannot read {name}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"cannot read {name}: it is no text in UTF-8 (byte {error.start})") from error
    except ValueError as error:
        raise UsageError(f"cannot read {name}: {error}; give a shorter one") from error


def _read_standard_input() -> bytes:
    """Return all of standard input. Raises OSError if it is closed, ValueError beyond LONGEST_TEXT."""
    if sys.stdin is None:
        raise OSError("it is closed")
    data = sys.stdin.buffer.read(LONGEST_TEXT + 1)
    if len(data) > LONGEST_TEXT:
        raise ValueError(f"it has more than {LONGEST_TEXT} bytes")
    return data


def write_together(contents: Mapping[Path, bytes | str]) -> None:
    """Write files by their paths, texts as UTF-8; they take their names once all are complete, or none does.

    Each replaces the file of its name; a symbolic link is followed. Raises UsageError if one cannot be
    written.
    """
    with replace_together(contents) as drafts:
        for path, data in contents.items():
            with explaining(path), drafts[path].open("wb") as file:
                file.write(data.encode() if isinstance(data, str) else data)


@contextmanager
def replace_when_complete(path: Path) -> Iterator[Path]:
    """Yield the name of a draft, which takes the place of ``path`` when this context ends without an error.

    It is for files that are too large to be written at once. Raises UsageError if it cannot be written.
    """
    with explaining(path), replace_together([path]) as drafts:
        yield drafts[path]


@contextmanager
def replace_together(paths: Iterable[Path]) -> Iterator[dict[Path, Path]]:
    """Yield names of drafts by path, which take the places of ``paths`` together.

    They do so when this context ends without an error; otherwise they are removed. Raises UsageError if a
    path cannot be written.
    """
    drafts: dict[Path, Path] = {}
    try:
        for path in paths:
            drafts[path] = check_target(path).with_name(f".{secrets.token_hex(8)}.tmp")
        yield drafts
        put_in_place(drafts)
    finally:
        for draft in drafts.values():
            with suppress(OSError):
                draft.unlink()


def put_in_place(draft_by_path: Mapping[Path, Path]) -> None:
    """Give complete drafts their names, in this order, each in place of the file that has the name.

    Raises UsageError if a path cannot be written; what can be known to fail does so before the first rename.
    """
    # The disk must have each file before the file has its name: the power may fail.
    for path, draft in draft_by_path.items():
        with explaining(path):
            sync_file(draft)
    targets = {path: check_target(path) for path in draft_by_path}
    for path, draft in draft_by_path.items():
        with explaining(path):
            os.replace(draft, targets[path])
        _logger.info("wrote %s", path)
    sync_folders(draft_by_path)


def sync_file(path: Path) -> None:
    """Wait until the disk has the content of a file or folder. Raises OSError if that fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folders(paths: Iterable[Path]) -> None:
    """Wait until the disk has the names of files; nothing is done for folders that cannot be synced."""
    for folder in {path.resolve().parent for path in paths}:
        with suppress(OSError):
            sync_file(folder)


def write_atomically(path: Path | str, data: bytes | str) -> None:
    """Write a file, a text as UTF-8, that takes its name when it is complete. Raises UsageError."""
    write_together({Path(path): data})


def write_files(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write all texts, or none, by file name into ``folder``, which is made if need be; return their paths.

    Raises UsageError if one cannot be written.
    """
    make_folder(folder)
    write_together({folder / name: text for name, text in contents.items()})
    return [folder / name for name in contents]


def make_folder(folder: Path) -> None:
    """Make a folder if there is none. Raises UsageError if that cannot be done."""
    with explaining(folder):
        folder.mkdir(parents=True, exist_ok=True)


def check_target(path: Path | str) -> Path:
    """Return the file that is to be written for ``path``, with links followed.

    Raises UsageError if it is a folder or a device, or has no folder that may be written to.
    """
    with explaining(path):
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise UsageError(f"cannot write {path}: it is not a regular file; choose another name")
        if not target.parent.is_dir():
            raise UsageError(f"cannot write {path}: its folder does not exist; make it first")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise UsageError(f"cannot write {path}: you may not write to its folder; choose another")
    return target


def results_beside(path: Path | str) -> Path:
    """Return the file for the parameters and results that belong to the output file ``path``.

    Raises UsageError if either of the two cannot be written.
    """
    check_target(path)
    results = Path(f"{path}.json")
    check_target(results)
    return results


@contextmanager
def explaining(path: Path | str) -> Iterator[None]:
    """Turn an OSError while ``path`` is written into a UsageError that names it, with a fix."""
    try:
        yield
    except OSError as error:
        fix = "choose a folder that takes it, or make room there"
        raise UsageError(f"cannot write {path}: {error.strerror or error}; {fix}") from error
