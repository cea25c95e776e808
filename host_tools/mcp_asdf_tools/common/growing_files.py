"""Files of a run that can be read while they grow, and that take their names together at its end."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, explaining

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None  # type: ignore[assignment]


PART = ".part"
"""Suffix, behind all others, of a file that is not complete."""

_BUFFER = 1 << 20
"""Bytes; more than is written between two flushes, so that these decide on the order of what is on disk."""


class GrowingFiles:
    """Files that grow as ``NAME.part`` and take their names together: all, or none.

    A file under the first name belongs with those under the others, wherever a run is killed: before they
    change, the old first file is removed, and the new one takes its name last.

    Attributes:
        parts: Where they grow, in the order of their paths.
        files: The open files, in the same order; their writer closes them.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Begin. Parts that an earlier run left are kept: run.log.part becomes run-1.log.part.

        Raises UsageError if a file cannot be written or another program is writing the first one.
        """
        self._paths = list(paths)
        self.parts = [_part_of(path) for path in paths]
        self.files: list[BinaryIO] = []
        with explaining(paths[0]):
            self._set_aside()
            for part in self.parts:
                self.files.append(part.open("xb", buffering=_BUFFER))
            _lock(self.files[0])

    def keep(self, obsolete: Iterable[Path] = ()) -> None:
        """Let the files, which are closed by now, take their names.

        ``obsolete`` files go with the old first file. Raises UsageError if that is impossible.
        """
        targets = [check_target(path) for path in self._paths]
        with explaining(self._paths[0]):
            for part in self.parts:
                _sync(part)
            for old in (targets[0], *obsolete):
                old.unlink(missing_ok=True)
            for part, target in reversed(list(zip(self.parts, targets, strict=True))):
                os.replace(part, target)

    def discard(self) -> None:
        """Remove the files, which hold nothing."""
        for part in self.parts:
            with suppress(OSError):
                part.unlink()

    def _set_aside(self) -> None:
        """Rename the parts of an earlier run, the first one last, since it counts."""
        first = self.parts[0]
        if not first.exists():
            self.discard()
            return
        with first.open("rb") as file:
            if not _lock(file):
                raise UsageError(f"another program is writing {first}; choose another name")
        if not first.stat().st_size:
            self.discard()
            return
        number = next(n for n in count(1) if not _numbered(first, n).exists())
        was_taking_names = not first.with_suffix("").exists()
        for part in reversed(self.parts):
            for source in (part, part.with_suffix("")) if was_taking_names else (part,):
                if source.exists():
                    os.replace(source, _numbered(part, number))
                    break


def _part_of(path: Path) -> Path:
    target = check_target(path)
    return target.with_name(target.name + PART)


def _numbered(part: Path, number: int) -> Path:
    """Another name for a part: run-1.log.part for run.log.part."""
    stem, dot, suffixes = part.name.partition(".")
    return part.with_name(f"{stem}-{number}{dot}{suffixes}")


def _lock(file: BinaryIO) -> bool:
    """Lock an open file as long as its program lives; returns whether no other program has it.

    Some network file systems, and Windows, have no such locks: there the answer is always yes.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def _sync(path: Path) -> None:
    """Let the disk have the file before it gets its name, for the case that the power fails."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
