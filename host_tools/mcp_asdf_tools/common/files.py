"""Output that no reader meets half of, nor one of a pair without the other; input that is bounded."""

from __future__ import annotations

import codecs
import os
import secrets
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from mcp_asdf_tools.common.errors import UsageError

LONGEST_TEXT = 2**24
"""Bytes of a text that people write; a device has more, without an end."""


def read_at_most(path: Path | str, most: int = LONGEST_TEXT) -> bytes:
    """All bytes of a file. Raises OSError if it cannot be read, ValueError if it has more than ``most``."""
    with Path(path).open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"it has more than {most} bytes")
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
    """Write files by their paths, texts as UTF-8: once all are complete they take their names, or none does.

    Each replaces what stood under its name, a symbolic link being followed. Raises UsageError if one cannot
    be written.
    """
    drafts: dict[Path, Path] = {}
    try:
        for path, data in contents.items():
            drafts[path] = check_target(path).with_name(f".{secrets.token_hex(8)}.tmp")
            with explaining(path), drafts[path].open("wb") as file:
                file.write(data.encode() if isinstance(data, str) else data)
                file.flush()
                os.fsync(file.fileno())  # the disk must have it before it has its name: the power may fail
        # What can be known to fail is looked for again before the first file is replaced.
        for path, target in [(path, check_target(path)) for path in drafts]:
            with explaining(path):
                os.replace(drafts[path], target)
        sync_folders(drafts)
    finally:
        for draft in drafts.values():
            with suppress(OSError):
                draft.unlink()


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """The name of a file that takes the place of ``path`` when this is left, unless by an error.

    For what is too large to be written at once. Raises UsageError if it cannot be written.
    """
    draft = check_target(path).with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with explaining(path):
            yield draft
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            os.replace(draft, check_target(path))
            sync_folders([path])
    finally:
        draft.unlink(missing_ok=True)


def sync_folders(paths: Iterable[Path]) -> None:
    """Put the names of files on the disk, where their folders can be read and synced."""
    for folder in {path.resolve().parent for path in paths}:
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


def write_atomically(path: Path | str, data: bytes | str) -> None:
    """Write one file as ``write_together`` does."""
    write_together({Path(path): data})


def write_files(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write texts by file name into ``folder``, which is made if need be; returns their paths.

    All are written, or none. Raises UsageError if one cannot be.
    """
    make_folder(folder)
    write_together({folder / name: text for name, text in contents.items()})
    return [folder / name for name in contents]


def make_folder(folder: Path) -> None:
    """Make a folder if there is none. Raises UsageError if that cannot be done."""
    with explaining(folder):
        folder.mkdir(parents=True, exist_ok=True)


def check_target(path: Path | str) -> Path:
    """The file that ``path`` leads to, links followed.

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
    """Where parameters and results go that belong to the output file ``path``.

    Raises UsageError if either of the two cannot be written.
    """
    check_target(path)
    results = Path(f"{path}.json")
    check_target(results)
    return results


@contextmanager
def explaining(path: Path | str) -> Iterator[None]:
    """Turn what goes wrong while ``path`` is written, an OSError, into a UsageError that names it."""
    try:
        yield
    except OSError as error:
        fix = "choose a folder that takes it, or make room there"
        raise UsageError(f"cannot write {path}: {error.strerror or error}; {fix}") from error
