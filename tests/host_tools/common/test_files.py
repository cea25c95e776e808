"""Files are read up to a limit, and output files are complete or absent, alone and in sets."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import (
    check_target,
    drafts_for,
    make_folder,
    read_at_most,
    read_text,
    remove_abandoned_drafts,
    rename_drafts,
    results_beside,
    write_atomically,
    write_together,
)
from support import names_in

# --- Reading ------------------------------------------------------------------------------------------


def test_a_file_that_is_larger_than_the_maximum_size_is_refused(tmp_path: Path) -> None:
    """The caller says how many bytes the file may have, so that none fills the memory. It has 5."""
    (tmp_path / "file").write_bytes(b"12345")
    assert read_at_most(tmp_path / "file", 5) == b"12345"
    with pytest.raises(ValueError, match="it has more than 4 bytes"):
        read_at_most(tmp_path / "file", 4)


def test_a_file_without_an_end_is_refused() -> None:
    """A text may have 16 MiB; the system's file of zeros never ends."""
    with pytest.raises(UsageError, match="cannot read /dev/zero: it has more than 16777216 bytes; give a sh"):
        read_text("/dev/zero")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_text_may_have_a_byte_order_mark(encoding: str, tmp_path: Path) -> None:
    """Programs of Windows write one, and some write UTF-16."""
    (tmp_path / "file").write_text("k_m ≥ 1", encoding=encoding)
    assert read_text(tmp_path / "file") == "k_m ≥ 1"


def test_a_file_that_is_no_text_is_refused_with_the_place(tmp_path: Path) -> None:
    """The error names the place of the first byte that is no UTF-8."""
    (tmp_path / "file").write_bytes(b"abc\xff")
    with pytest.raises(UsageError, match=r"cannot read .*file: it is no text in UTF-8 \(byte 3\)"):
        read_text(tmp_path / "file")


def test_a_text_that_is_missing_is_refused_by_its_path(tmp_path: Path) -> None:
    """The error has the reason that the system gives."""
    with pytest.raises(UsageError, match=r"cannot read .*missing: No such file or directory"):
        read_text(tmp_path / "missing")


# Standard input is read by the tests of "mcp-asdf calibrate".


# --- One file -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "content"), [("k_m ≥ 1\n", b"k_m \xe2\x89\xa5 1\n"), (b"\0\xff", b"\0\xff")]
)
def test_a_written_file_replaces_a_longer_one(data: str | bytes, content: bytes, tmp_path: Path) -> None:
    """Nothing of the longer file is left, and no other file is in the folder. A text is written as UTF-8."""
    path = tmp_path / "file"
    path.write_bytes(b"something much longer than what comes next")
    write_atomically(path, data)

    assert path.read_bytes() == content
    assert names_in(tmp_path) == ["file"]


def test_a_write_through_a_symbolic_link_replaces_the_file_behind_it(tmp_path: Path) -> None:
    """The link stays a link; the file behind it is in another folder."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder/file")
    write_atomically(tmp_path / "link", "new")

    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "folder/file").read_text() == "new"


def test_a_written_file_has_the_usual_permissions(tmp_path: Path) -> None:
    """The file has the permissions of any new file, though it was written under another name first."""
    write_atomically(tmp_path / "written", "x")
    (tmp_path / "usual").touch()
    assert (tmp_path / "written").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_an_error_while_a_draft_is_written_leaves_the_old_file(tmp_path: Path) -> None:
    """A draft is the name under which a file is written until it is complete; it is removed."""
    path = tmp_path / "file"
    path.write_text("old")

    with pytest.raises(ZeroDivisionError), drafts_for([path]) as [draft]:
        draft.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert names_in(tmp_path) == ["file"]


def test_two_programs_that_write_one_file_do_not_mix_their_data(tmp_path: Path) -> None:
    """Each has a draft under another name, so the file comes from the program that is ready last."""
    path = tmp_path / "file"
    with drafts_for([path]) as [first_draft]:
        first_draft.write_text("first")
        with drafts_for([path]) as [second_draft]:
            second_draft.write_text("second")
        assert path.read_text() == "second"

    assert path.read_text() == "first"


WRITER_THAT_IS_KILLED = """\
import os, signal
from pathlib import Path
from mcp_asdf_tools.common.files import drafts_for
with drafts_for([Path("file")]) as [draft]:
    draft.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_kill_leaves_the_old_file_and_a_draft_that_can_be_removed(tmp_path: Path) -> None:
    """The process that writes is killed when it has written half of the new file under another name."""
    (tmp_path / "file").write_text("old")
    subprocess.run([sys.executable, "-c", WRITER_THAT_IS_KILLED], cwd=tmp_path, check=False)
    assert (tmp_path / "file").read_text() == "old"
    assert len(names_in(tmp_path)) == 2

    remove_abandoned_drafts(tmp_path)
    assert names_in(tmp_path) == ["file"]


# --- Two files that belong together -------------------------------------------------------------------


class RecordedFile(io.FileIO):
    """File with methods that ``SystemCalls`` can replace."""

    def __init__(self, path: Path, *_: object) -> None:
        super().__init__(path, "w")


class SystemCalls:
    """Replacements of system calls. They record each call, and one of them may fail.

    Attributes:
        calls: Name of each call, and the name of the file that it is about.
    """

    def __init__(
        self, patch: pytest.MonkeyPatch, failing_index: int | None, failure: BaseException | None
    ) -> None:
        """Replace the calls by ``patch``; that with the index ``failing_index`` raises ``failure``."""
        self.calls: list[tuple[str, str]] = []
        self._failing_index = failing_index
        self._failure = failure
        for owner, name in ((RecordedFile, "write"), (RecordedFile, "close"), (os, "fsync"), (os, "replace")):
            patch.setattr(owner, name, self._recorded(name, getattr(owner, name)))
        patch.setattr(Path, "open", self._recorded("open", RecordedFile))

    def _recorded(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that records a call and then calls ``function``, or fails."""

        def call(file: Any, *arguments: Any) -> Any:
            index = len(self.calls)
            self.calls.append((name, _file_name(file)))
            if index == self._failing_index and self._failure is not None:
                if name == "close":
                    function(file)  # a close that fails closes the file all the same
                raise self._failure
            return function(file, *arguments)

        return call


def _file_name(file: RecordedFile | Path | int) -> str:
    """Return the name of an open file, of a path or of what a file descriptor is connected to."""
    if isinstance(file, RecordedFile):
        return Path(str(file.name)).name
    if isinstance(file, int):
        return Path(os.readlink(f"/dev/fd/{file}")).name
    return file.name


DISK_IS_FULL = OSError(errno.ENOSPC, "No space left on device")
WRITE_ONE = ["open", "write", "close"]
CALLS = [*WRITE_ONE, *WRITE_ONE, "fsync", "fsync", "replace", "replace", "fsync"]
"""System calls of a write of two files in one folder, in their order."""
FIRST_REPLACE = CALLS.index("replace")
FOLDER_SYNC = len(CALLS) - 1


def replace_old_files(
    folder: Path, failing_index: int | None = None, failure: BaseException | None = None
) -> SystemCalls:
    """Replace the files "a" and "b" with the content "old" by "new"; return the system calls.

    That with the index ``failing_index`` raises ``failure``.
    """
    paths = [folder / "a", folder / "b"]
    for path in paths:
        path.write_text("old")
    with pytest.MonkeyPatch.context() as patch:
        system_calls = SystemCalls(patch, failing_index, failure)
        write_together(dict.fromkeys(paths, "new"))
    return system_calls


def contents_of(folder: Path) -> dict[str, str]:
    """Return the content of each file in a folder, by its name."""
    return {path.name: path.read_text() for path in sorted(folder.iterdir())}


def test_two_files_are_written_with_these_system_calls(tmp_path: Path) -> None:
    """CALLS lists them; the other tests let each of them fail."""
    system_calls = replace_old_files(tmp_path)
    assert [name for name, _ in system_calls.calls] == CALLS
    assert contents_of(tmp_path) == {"a": "new", "b": "new"}


with_each_failing_call = pytest.mark.parametrize("failing_index", range(FIRST_REPLACE + 1))
"""Let each system call fail, one at a time, up to the renaming of the first file."""


@with_each_failing_call
def test_a_full_disk_leaves_both_old_files(failing_index: int, tmp_path: Path) -> None:
    """System calls write the files "a" and "b" and rename the first. One of these calls fails."""
    with pytest.raises(UsageError, match=r"cannot write .*/[ab]: No space left on device; choose a folder"):
        replace_old_files(tmp_path, failing_index, DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "old", "b": "old"}


@with_each_failing_call
def test_ctrl_c_leaves_both_old_files(failing_index: int, tmp_path: Path) -> None:
    """System calls write the files "a" and "b" and rename the first. Ctrl-C comes in one of these calls."""
    with pytest.raises(KeyboardInterrupt):
        replace_old_files(tmp_path, failing_index, KeyboardInterrupt())
    assert contents_of(tmp_path) == {"a": "old", "b": "old"}


def test_a_failure_between_the_renamings_leaves_two_complete_files(tmp_path: Path) -> None:
    """The file "a" has got its name, and then the disk refuses the name "b"."""
    second_replace = FIRST_REPLACE + 1
    with pytest.raises(UsageError, match=r"cannot write .*/b: No space left on device"):
        replace_old_files(tmp_path, second_replace, DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "new", "b": "old"}


def test_a_folder_that_cannot_be_synced_is_no_error(tmp_path: Path) -> None:
    """Not every file system can wait until the names in a folder are on the disk."""
    replace_old_files(tmp_path, FOLDER_SYNC, DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "new", "b": "new"}


def test_output_files_get_their_names_only_when_their_contents_are_on_disk(tmp_path: Path) -> None:
    """So whenever the power fails, a name stands for the old content or for all of the new one.

    A sync waits until the disk has what was written into a draft, or, at the end, the names in the folder.
    """
    calls = replace_old_files(tmp_path).calls
    drafts = [file for name, file in calls if name == "open"]
    syncs_and_renamings = [(name, file) for name, file in calls if name in ("fsync", "replace")]

    sync_both = [("fsync", draft) for draft in drafts]
    rename_both = [("replace", draft) for draft in drafts]
    assert syncs_and_renamings == [*sync_both, *rename_both, ("fsync", tmp_path.name)]


def test_obsolete_files_are_removed_before_the_first_renaming(tmp_path: Path) -> None:
    """The renaming of the draft fails, and the obsolete file is gone by then."""
    (tmp_path / "draft").touch()
    (tmp_path / "obsolete").touch()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(UsageError):
        patch.setattr(os, "replace", Mock(side_effect=DISK_IS_FULL))
        rename_drafts({tmp_path / "file": tmp_path / "draft"}, obsolete=[tmp_path / "obsolete"])

    assert names_in(tmp_path) == ["draft"]


def test_an_obsolete_file_that_is_missing_is_no_error(tmp_path: Path) -> None:
    """An obsolete file would be removed before the draft gets its name."""
    (tmp_path / "draft").write_text("new")
    rename_drafts({tmp_path / "file": tmp_path / "draft"}, obsolete=[tmp_path / "obsolete"])
    assert contents_of(tmp_path) == {"file": "new"}


def test_writing_files_leaves_no_file_descriptor_open(tmp_path: Path) -> None:
    """A program that writes many files would run out of descriptors; /dev/fd lists the open ones."""
    open_before = len(os.listdir("/dev/fd"))
    write_together({tmp_path / "a": "x", tmp_path / "b": "x"})
    assert len(os.listdir("/dev/fd")) == open_before


# --- Folders and paths that cannot be written ---------------------------------------------------------


def test_a_folder_is_made_with_those_above_it_and_one_that_exists_is_kept(tmp_path: Path) -> None:
    """The first call makes both a and b. The second call leaves the file in b as it is."""
    make_folder(tmp_path / "a/b")
    (tmp_path / "a/b/file").touch()
    make_folder(tmp_path / "a/b")
    assert names_in(tmp_path / "a/b") == ["file"]


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    """The error names the path, the reason of the system and a fix."""
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"cannot write .*/file: File exists; choose a folder that takes it"):
        make_folder(tmp_path / "file")


def test_writing_a_file_in_place_of_a_folder_or_a_pipe_is_refused(tmp_path: Path) -> None:
    """The program at the other end of a pipe would get nothing, as a new file would take its name."""
    with pytest.raises(UsageError, match=f"cannot write {tmp_path}: it is not a regular file; choose"):
        write_atomically(tmp_path, "x")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match=r"pipe: it is not a regular file; choose another name"):
        write_atomically(tmp_path / "pipe", "x")


def test_writing_a_file_into_a_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    """The user may have mistyped the folder, so it is not made."""
    with pytest.raises(UsageError, match=r"missing/file: its folder does not exist; make it first"):
        write_atomically(tmp_path / "missing/file", "x")


def test_a_path_below_a_file_is_refused_by_its_name(tmp_path: Path) -> None:
    """A file stands where a folder should be, and the error names the path."""
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=f"cannot write {tmp_path}/file/below: "):
        write_atomically(tmp_path / "file/below", "x")


def test_writing_a_file_into_a_folder_without_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``os.access`` is replaced, since tests may run as root, who may write to every folder."""
    may_access = Mock(return_value=False)
    monkeypatch.setattr(os, "access", may_access)
    with pytest.raises(UsageError, match="you may not write to its folder; choose another"):
        check_target(tmp_path / "file")
    may_access.assert_called_once_with(tmp_path, os.W_OK | os.X_OK)


def test_the_results_of_an_output_file_stand_beside_it(tmp_path: Path) -> None:
    """The results are a run's, in JSON. The output file is the log of the same run."""
    assert results_beside(tmp_path / "run.log") == tmp_path / "run.log.json"


def test_results_are_refused_if_they_or_the_output_file_cannot_be_written(tmp_path: Path) -> None:
    """A run writes an output file and results. Before the run the user learns if a folder has such a name."""
    with pytest.raises(UsageError, match=f"cannot write {tmp_path}: it is not a regular file"):
        results_beside(tmp_path)
    (tmp_path / "run.log.json").mkdir()
    with pytest.raises(UsageError, match=r"run\.log\.json: it is not a regular file"):
        results_beside(tmp_path / "run.log")
