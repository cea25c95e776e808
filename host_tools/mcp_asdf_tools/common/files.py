"""Writing output files so that a reader never meets half of one, nor one of a pair without the other."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

from mcp_asdf_tools.common.errors import UsageError


class FileSet:
    """Output files that take their names together, once all are complete, or not at all.

    A context manager: on a regular end every file begun replaces what stood under its name, a symbolic
    link being followed. On an exception, or if one of them cannot be written, none does.
    """

    def __init__(self) -> None:
        """Begin with no file."""
        self._drafts: list[tuple[Path | str, Path]] = []

    def write(self, path: Path | str, data: bytes | str) -> None:
        """Write what will be ``path``; text as UTF-8. Raises UsageError if it cannot be written."""
        temporary = check_target(path).with_name(f".{secrets.token_hex(8)}.tmp")
        self._drafts.append((path, temporary))
        with explaining(path), temporary.open("wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())  # it must not have its name before the disk has it: the power may fail

    def __enter__(self) -> FileSet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._keep()
        finally:
            for _, temporary in self._drafts:
                with suppress(OSError):
                    temporary.unlink()

    def _keep(self) -> None:
        # What can be known to fail is looked for again before the first file is replaced.
        targets = [check_target(path) for path, _ in self._drafts]
        for (path, temporary), target in zip(self._drafts, targets, strict=True):
            with explaining(path):
                os.replace(temporary, target)


def write_atomically(path: Path | str, data: bytes | str) -> None:
    """Write ``data`` (text as UTF-8) to ``path``, whole or not at all.

    Raises UsageError if it cannot be written, which leaves an earlier file unchanged.
    """
    with FileSet() as files:
        files.write(path, data)


def write_files(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write texts by file name into ``folder``, which is made if need be; returns their paths.

    All are written, or none. Raises UsageError if one cannot be.
    """
    with explaining(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with FileSet() as files:
        for name, text in contents.items():
            files.write(folder / name, text)
    return [folder / name for name in contents]


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
