"""Output files: whole or not at all, together or not at all, and what cannot be written is named."""

from __future__ import annotations

import errno
import io
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mcp_asdf_tools.common import files
from mcp_asdf_tools.common.errors import UsageError


@pytest.mark.parametrize("data", ["k_m ≥ 1\n", b"\x00\xff"])
def test_write_atomically_replaces_the_whole_file(tmp_path: Path, data: str | bytes) -> None:
    """A link stays one, and permissions are the usual ones."""
    (tmp_path / "file").write_bytes(b"something much longer than what comes next")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    files.write_atomically(tmp_path / "link", data)
    assert (tmp_path / "file").read_bytes() == (data.encode() if isinstance(data, str) else data)
    assert (tmp_path / "link").is_symlink() and len([*tmp_path.iterdir()]) == 2
    assert files.write_files(tmp_path / "new/one", {"a": "1", "b": "2"}) == [
        tmp_path / "new/one/a",
        tmp_path / "new/one/b",
    ]
    (tmp_path / "usual").touch()
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "usual").stat().st_mode


class Writer(io.FileIO):
    """A file whose writing and closing may be made to fail."""

    def __init__(self, path: Path, *_: object, **__: object) -> None:
        super().__init__(path, "w")


class Faulty:
    """System calls of this process, of which the ``at``-th fails, but for those that clean up.

    Attributes:
        calls: Names of the calls with the file that they are about, in order.
    """

    def __init__(self, patch: pytest.MonkeyPatch, at: int, failure: BaseException) -> None:
        self.calls, self._at, self._failure = list[tuple[str, str]](), at, failure
        for owner, name in ((Writer, "write"), (Writer, "close"), (os, "fsync"), (os, "replace")):
            patch.setattr(owner, name, self._faulty(name, getattr(owner, name)))
        patch.setattr(Path, "open", self._faulty("open", Writer))

    def _faulty(self, name: str, usual: Callable[..., Any]) -> Callable[..., Any]:
        def call(about: Any, *rest: Any, **options: Any) -> Any:
            path = about.name if isinstance(about, Writer) else about
            path = os.readlink(f"/dev/fd/{about}") if isinstance(about, int) else path
            self.calls.append((name, Path(path).name))
            if len(self.calls) == self._at:
                raise self._failure
            return usual(about, *rest, **options)

        return call


FULL = OSError(errno.ENOSPC, "No space left on device")


def written_with_fault(folder: Path, at: int, failure: BaseException) -> list[tuple[str, str]]:
    """Replace two old files while the ``at``-th system call fails: both are whole. Returns the calls."""
    paths = [folder / "a", folder / "b"]
    told: BaseException | None = None
    for path in paths:
        path.write_text("old")
    with pytest.MonkeyPatch.context() as patch:
        faulty = Faulty(patch, at, failure)
        try:
            files.write_files(folder, {"a": "new", "b": "new"})
        except (UsageError, KeyboardInterrupt) as error:
            told = error
    assert sorted(folder.iterdir()) == paths, "a draft is left"
    found = [path.read_text() for path in paths]
    renamed = sum(name == "replace" for name, _ in faulty.calls[: at - 1])
    assert found == ["new"] * renamed + ["old"] * (2 - renamed), "what stands at its name stays"
    if isinstance(told, UsageError):
        assert re.match(f"cannot write {folder}/[ab]: No space left on device; choose a", str(told))
    assert (told is None) == (found == ["new"] * 2)
    return faulty.calls


@pytest.mark.parametrize("failure", [FULL, KeyboardInterrupt()])
def test_a_set_that_the_disk_does_not_take_leaves_the_old_one(failure: BaseException, tmp_path: Path) -> None:
    """Each system call fails once."""
    names = [name for name, _ in written_with_fault(tmp_path, 1000, failure)]
    assert names.count("open") == names.count("write") == names.count("replace") == 2 < names.count("fsync")
    for at in range(1, len(names)):  # the last is the folder's sync, which may fail
        written_with_fault(tmp_path, at, failure)


def test_names_are_given_when_the_disk_has_the_contents_and_then_kept(tmp_path: Path) -> None:
    """Whenever the power fails, each name has the old contents or the new, and in the end the new."""
    calls = [call for call in written_with_fault(tmp_path, 1000, FULL) if call[0] in ("fsync", "replace")]
    (first, second), folder = {name: None for _, name in calls[:2]}, tmp_path.name
    drafts = [(kind, name) for kind in ("fsync", "replace") for name in (first, second)]
    assert calls == [*drafts, ("fsync", folder)]


def test_places_that_cannot_be_written_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    places = {
        tmp_path: "not a regular file; choose another name",
        tmp_path / "pipe": "not a regular file; choose another name",
        tmp_path / "missing/file": "its folder does not exist; make it first",
        tmp_path / "file/below": "",
    }
    for path, told in places.items():
        with pytest.raises(UsageError, match=f"cannot write {path}: .*{told}"):
            files.write_atomically(path, "x")
    with pytest.raises(UsageError, match=f"cannot write {tmp_path}: it is not a regular file"):
        files.results_beside(tmp_path)
    (tmp_path / "run.json").mkdir()
    with pytest.raises(UsageError, match=r"run.json: it is not a regular file"):
        files.results_beside(tmp_path / "run")
    assert files.results_beside(tmp_path / "other") == tmp_path / "other.json"
    entering = os.W_OK | os.X_OK  # root may do everything
    monkeypatch.setattr(os, "access", lambda path, mode: mode != entering or path != tmp_path)
    with pytest.raises(UsageError, match="you may not write to its folder"):
        files.check_target(tmp_path / "file")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "pipe", "run.json"]
