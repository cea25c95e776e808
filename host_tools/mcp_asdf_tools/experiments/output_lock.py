"""Lock files by which one process at a time works on an output.

The system releases a lock when its process ends in any way, so a process that was killed leaves none.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

_DESCRIPTOR_OF_LOCKED_FILE: dict[Path, int] = {}
"""File descriptors of the lock files that this process has locked. They stay open, since a process loses its
lock when it closes any of its descriptors of the file."""
_MAX_ID_LENGTH = 20
"""Bytes that are read of a lock file, which is more than any process id has."""


def lock_file(path: Path) -> str | None:
    """Lock a file for this process, and create it if it does not exist.

    Returns None if this process has the lock now or had it before. The file then contains this process's id.
    If another process has the lock, returns the id of that process as a text. On Windows, and on file systems
    without locks, every process gets the lock.
    Raises OSError if the file cannot be created.
    """
    try:
        import fcntl  # noqa: PLC0415
    except ImportError:  # Windows
        return None
    # Repeated only if the file was removed by another process meanwhile.
    while path not in _DESCRIPTOR_OF_LOCKED_FILE:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner_id = os.read(descriptor, _MAX_ID_LENGTH).decode("ascii", "replace")
            os.close(descriptor)
            # Any other error means that there are no locks.
            has_owner = error.errno in (errno.EACCES, errno.EAGAIN)
            return owner_id if has_owner else None
        if _is_open_file(path, descriptor):
            _write_own_id(descriptor)
            _DESCRIPTOR_OF_LOCKED_FILE[path] = descriptor  # which ends the loop
        else:
            # Between opening and locking, the process that had the lock removed the file: try again with the
            # file that is there now, which others try to lock, too.
            os.close(descriptor)
    return None


def _is_open_file(path: Path, descriptor: int) -> bool:
    """Return whether the file at a path is the one that is open under a descriptor."""
    return path.exists() and os.path.samestat(os.fstat(descriptor), path.stat())


def _write_own_id(descriptor: int) -> None:
    """Replace the content of an open file by the id of this process."""
    # A process that was killed leaves its file, whose id may be longer.
    os.ftruncate(descriptor, 0)
    os.write(descriptor, str(os.getpid()).encode())


def unlock_file(path: Path) -> None:
    """Remove a lock file and release its lock, if this process has it."""
    if path in _DESCRIPTOR_OF_LOCKED_FILE:
        # Removed first: once the lock is released, another process may have locked the file.
        path.unlink(missing_ok=True)
        os.close(_DESCRIPTOR_OF_LOCKED_FILE.pop(path))
