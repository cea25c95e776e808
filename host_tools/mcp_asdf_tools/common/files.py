"""Atomic writes of one or several files, and reads with a limit on size.

A new file is written under another name in its folder, as a draft, and renamed when it is complete. So a
reader finds the old file or the new one, also after a kill, a full disk or a power failure, and never a half.
"""

from __future__ import annotations

import codecs
import logging
import os
import secrets
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mcp_asdf_tools.common.errors import UsageError

_logger = logging.getLogger(__name__)

LONGEST_TEXT = 2**24
"""Maximum size in bytes of a text that is read. Without a limit, a device such as /dev/zero has no end."""

_DRAFT_PREFIX = "."
_DRAFT_SUFFIX = ".tmp"


def read_at_most(path: Path | str, max_bytes: int = LONGEST_TEXT) -> bytes:
    """Return the content of a file.

    Raises OSError if it cannot be read, ValueError if it has more than ``max_bytes`` bytes.
    """
    with Path(path).open("rb") as file:
        return _read_to_end(file, max_bytes)


def _read_to_end(file: BinaryIO, max_bytes: int) -> bytes:
    """Return what is left of an open file. Raises ValueError if that is more than ``max_bytes`` bytes."""
    data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise ValueError(f"it has more than {max_bytes} bytes")
    return data


def read_text(path: Path | str) -> str:
    """Return the text of a file, or of standard input if ``path`` is ``-``.

    It may be UTF-8 with or without a byte order mark, or UTF-16 with one, as Excel writes it. Raises
    UsageError if it cannot be read, is no such text, or has more than LONGEST_TEXT bytes.
    """
    is_standard_input = str(path) == "-"
    name = "standard input" if is_standard_input else str(path)
    try:
        data = _read_standard_input() if is_standard_input else read_at_most(path)
        is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        encoding = "utf-16" if is_utf_16 else "utf-8-sig"  # either skips the byte order mark
        return data.decode(encoding)
    except OSError as error:
        raise UsageError(f"cannot read {name}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(
            f"cannot read {name}: it is no text in UTF-8 (byte {error.start}); save it as UTF-8"
        ) from error
    except ValueError as error:  # from either read: the text has more than LONGEST_TEXT bytes
        raise UsageError(f"cannot read {name}: {error}; give a shorter one") from error


def _read_standard_input() -> bytes:
    """Return what is left of standard input, up to its end.

    Raises OSError if it is closed, ValueError if that is more than LONGEST_TEXT bytes.
    """
    if sys.stdin is None:
        raise OSError("it is closed")
    return _read_to_end(sys.stdin.buffer, LONGEST_TEXT)


def write_atomically(path: Path | str, data: bytes | str) -> None:
    """Write one file, a text as UTF-8, in place of the file of its name. Raises UsageError if that fails."""
    write_together({Path(path): data})


def write_together(data_by_path: Mapping[Path, bytes | str]) -> None:
    """Write files, texts as UTF-8, each in place of the file of its name: all of them, or none.

    A symbolic link stays, and the file that it leads to is replaced. Raises UsageError if a file cannot be
    written.
    """
    paths = list(data_by_path)
    with drafts_for(paths) as drafts:
        for path, draft in zip(paths, drafts, strict=True):
            content = data_by_path[path]
            data = content.encode() if isinstance(content, str) else content
            with explaining_write_errors(path), draft.open("wb") as file:
                file.write(data)


@contextmanager
def drafts_for(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Context manager that yields drafts: the names under which the caller writes the files of ``paths``.

    At the end of the context the drafts are renamed to ``paths``. If it ends with an error, they are removed.
    Raises UsageError if a path cannot be written.
    """
    drafts: list[Path] = []
    try:
        for path in paths:
            # Random names keep two programs apart that write the same file.
            draft_name = f"{_DRAFT_PREFIX}{secrets.token_hex(8)}{_DRAFT_SUFFIX}"
            drafts.append(check_target(path).with_name(draft_name))
        yield drafts
        rename_drafts(dict(zip(paths, drafts, strict=True)))
    finally:
        for draft in drafts:
            with suppress(OSError):  # a draft that was renamed, or never written, is not there
                draft.unlink()


def rename_drafts(draft_by_path: Mapping[Path, Path], obsolete: Iterable[Path] = ()) -> None:
    """Rename complete files to the paths that they are drafts of, in this order, replacing what is there.

    Files of ``obsolete`` that exist are removed before the first renaming. Raises UsageError if a path cannot
    be written. Nearly all reasons for that are found before anything is changed; should the system refuse a
    later renaming, those before it stay.
    """
    # A file gets its name only when its content is on the disk, since the power may fail in between.
    for path, draft in draft_by_path.items():
        with explaining_write_errors(path):
            _sync(draft)
    # All targets are checked before anything is changed.
    target_by_path = {path: check_target(path) for path in draft_by_path}
    for path in obsolete:
        with explaining_write_errors(path):
            path.unlink(missing_ok=True)
    for path, draft in draft_by_path.items():
        with explaining_write_errors(path):
            os.replace(draft, target_by_path[path])
        _logger.info("wrote %s", path)
    for folder in {target.parent for target in target_by_path.values()}:
        with suppress(OSError):  # not every file system can sync a folder
            _sync(folder)


def _sync(path: Path) -> None:
    """Wait until the disk has the content of a file, or the names in a folder. Raises OSError if it fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_abandoned_drafts(folder: Path) -> None:
    """Delete the drafts in a folder that programs left which were killed; nobody may be writing there now."""
    for draft in folder.glob(f"{_DRAFT_PREFIX}*{_DRAFT_SUFFIX}"):
        draft.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Create a folder, with the folders above it, if it does not exist. Raises UsageError if that fails."""
    with explaining_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


def check_target(path: Path | str) -> Path:
    """Return the file that a write to ``path`` replaces: the path itself, or where symbolic links lead to.

    Raises UsageError if it is a folder or a device, or if nothing can be written to its folder.
    """
    with explaining_write_errors(path):
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise UsageError(f"cannot write {path}: it is not a regular file; choose another name")
        if not target.parent.is_dir():
            raise UsageError(f"cannot write {path}: its folder does not exist; make it first")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise UsageError(f"cannot write {path}: you may not write to its folder; choose another")
    return target


def results_beside(path: Path | str) -> Path:
    """Check an output file and the JSON file of its run's results beside it; return the JSON file's path.

    That of ``run.log`` is ``run.log.json``. Raises UsageError if either of the two cannot be written.
    """
    results_path = Path(f"{path}.json")
    check_target(path)
    check_target(results_path)
    return results_path


@contextmanager
def explaining_write_errors(path: Path | str) -> Iterator[None]:
    """Context manager for writing ``path``: it turns an OSError into a UsageError with the path and a fix."""
    try:
        yield
    except OSError as error:
        fix = "choose a folder that takes it, or make room there"
        raise UsageError(f"cannot write {path}: {error.strerror or error}; {fix}") from error
