"""Locks by which one process at a time works on an output; the system frees them when the process ends."""

from __future__ import annotations

import errno
import os
from pathlib import Path

_LOCKED_FILES: dict[Path, int] = {}
"""Descriptors of the files that this process has locked. To close any descriptor of a file frees its lock."""


def lock_file(path: Path) -> str | None:
    """Lock a file, which is made if need be, for this process.

    Returns None if this process has it now, or had it before, and the number of the process that has it
    otherwise. Where the system or the file system has no locks, every process gets it. Raises OSError if the
    file cannot be made.
    """
    try:
        import fcntl  # noqa: PLC0415
    except ImportError:  # Windows
        return None
    while path not in _LOCKED_FILES:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(descriptor, 20).decode("ascii", "replace")
            os.close(descriptor)
            is_locked = error.errno in (errno.EACCES, errno.EAGAIN)
            return holder if is_locked else None
        if not _is_still_at(path, descriptor):
            # The process that had it removed the file in the meantime: lock the one that is there now.
            os.close(descriptor)
            continue
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
        _LOCKED_FILES[path] = descriptor
    return None


def _is_still_at(path: Path, descriptor: int) -> bool:
    """Return whether the open file is the one that has the name ``path`` now."""
    return path.exists() and os.path.samestat(os.fstat(descriptor), path.stat())


def unlock_file(path: Path) -> None:
    """Remove a file that this process has locked; nothing happens if it has not."""
    if path in _LOCKED_FILES:
        path.unlink(missing_ok=True)
        os.close(_LOCKED_FILES.pop(path))
