"""Output files: whole or not at all, together or not at all, and what cannot be written is named."""

from __future__ import annotations

import errno
import os
from pathlib import Path

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


@pytest.mark.parametrize("function", ["fsync", "replace"])
@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("after", [0, 1])
def test_a_set_that_the_disk_does_not_take_leaves_the_old_one(
    function: str, failure: BaseException, after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the first or the second file is written or renamed."""
    paths, calls = [tmp_path / "a", tmp_path / "b"], list[object]()
    usual = getattr(os, function)

    def fail(*arguments: object) -> object:
        calls.append(arguments)
        if len(calls) > after:
            raise failure
        return usual(*arguments)

    for path in paths:
        path.write_text("old")
    monkeypatch.setattr(os, function, fail)
    with pytest.raises(UsageError if isinstance(failure, OSError) else KeyboardInterrupt) as caught:
        files.write_files(tmp_path, {"a": "new", "b": "new"})
    if isinstance(failure, OSError):
        assert str(caught.value).startswith(f"cannot write {paths[after]}: No space left on device; choose a")
    assert sorted(tmp_path.iterdir()) == paths, "a draft is left"
    is_renamed = function == "replace" and after == 1  # what stands at its name already stays
    assert [path.read_text() for path in paths] == ["new" if is_renamed else "old", "old"]


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
