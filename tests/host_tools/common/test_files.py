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
    """The caller says how many bytes the file may have, so that none fills the memory.

    A file of 5 bytes is read if 5 are allowed, and refused if only 4 are.
    """
    (tmp_path / "file").write_bytes(b"12345")
    assert read_at_most(tmp_path / "file", max_bytes=5) == b"12345"
    with pytest.raises(ValueError, match="it has more than 4 bytes"):
        read_at_most(tmp_path / "file", max_bytes=4)


def test_a_file_without_an_end_is_refused() -> None:
    """The system's file of zeros never ends. A text may have 16 MiB, or 16777216 bytes."""
    with pytest.raises(UsageError, match="cannot read /dev/zero: it has more than 16777216 bytes; give a sh"):
        read_text("/dev/zero")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_text_may_have_a_byte_order_mark(encoding: str, tmp_path: Path) -> None:
    """Programs of Windows write such a mark before a text in UTF-8, and some write UTF-16."""
    (tmp_path / "file").write_text("k_m ≥ 1", encoding=encoding)
    assert read_text(tmp_path / "file") == "k_m ≥ 1"


def test_a_file_that_is_no_text_is_refused_with_the_place(tmp_path: Path) -> None:
    """The byte 0xff, which no text in UTF-8 has, stands behind three letters: it is byte 3, from 0 on."""
    (tmp_path / "file").write_bytes(b"abc\xff")
    with pytest.raises(
        UsageError, match=r"cannot read .*file: it is no text in UTF-8 \(byte 3\); save it as UTF-8"
    ):
        read_text(tmp_path / "file")


def test_a_text_that_is_missing_is_refused_by_its_path(tmp_path: Path) -> None:
    """The error has the reason that the system gives."""
    with pytest.raises(UsageError, match=r"cannot read .*missing: No such file or directory"):
        read_text(tmp_path / "missing")


# Standard input is read by the tests of "mcp-asdf calibrate".


# --- One file -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text_or_bytes", "expected_bytes"), [("k_m ≥ 1\n", b"k_m \xe2\x89\xa5 1\n"), (b"\0\xff", b"\0\xff")]
)
def test_a_written_file_replaces_a_longer_one(
    text_or_bytes: str | bytes, expected_bytes: bytes, tmp_path: Path
) -> None:
    """Nothing of the longer file is left, and no other file is in the folder. A text is written as UTF-8."""
    path = tmp_path / "file"
    path.write_bytes(b"something much longer than what comes next")
    write_atomically(path, text_or_bytes)

    assert path.read_bytes() == expected_bytes
    assert names_in(tmp_path) == ["file"]


def test_a_write_through_a_symbolic_link_writes_the_file_behind_it(tmp_path: Path) -> None:
    """The link stays a link. It points to a file in another folder, which is not there before."""
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
    """A draft is the file in which new content is collected until it is complete; it is removed.

    Here the program fails when it has written half of the new content.
    """
    path = tmp_path / "file"
    path.write_text("old")

    with pytest.raises(ZeroDivisionError), drafts_for([path]) as [draft]:
        draft.write_text("half")
        raise ZeroDivisionError  # stands for any error

    assert path.read_text() == "old"
    assert names_in(tmp_path) == ["file"]


def test_two_programs_that_write_one_file_do_not_mix_their_data(tmp_path: Path) -> None:
    """Each has a draft under another name, which becomes the file at the end of the block.

    The second program begins while the first one writes, and ends before it. So the file has its content
    until the first program ends, too.
    """
    path = tmp_path / "file"
    with drafts_for([path]) as [draft_of_first_program]:
        draft_of_first_program.write_text("first")
        with drafts_for([path]) as [draft_of_second_program]:
            draft_of_second_program.write_text("second")
        assert path.read_text() == "second"

    assert path.read_text() == "first"


def test_a_kill_leaves_the_old_file_and_a_draft_that_can_be_removed(tmp_path: Path) -> None:
    """The process that writes is killed when it has written half of the new file under another name."""
    program_that_kills_itself = """\
import os, signal
from pathlib import Path
from mcp_asdf_tools.common.files import drafts_for
with drafts_for([Path("file")]) as [draft]:
    draft.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    (tmp_path / "file").write_text("old")
    subprocess.run([sys.executable, "-c", program_that_kills_itself], cwd=tmp_path, check=False)

    assert (tmp_path / "file").read_text() == "old"
    assert len(names_in(tmp_path)) == 2  # the file and the draft

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
        numbered_calls: Name of each call with its number among the calls of that name: "write 2".
    """

    def __init__(
        self, patch: pytest.MonkeyPatch, failing_call: str | None, failure: BaseException | None
    ) -> None:
        """Replace the calls by ``patch``; ``failing_call``, such as "write 2", raises ``failure``."""
        self.calls: list[tuple[str, str]] = []
        self.numbered_calls: list[str] = []
        self._failing_call = failing_call
        self._failure = failure
        for owner, name in ((RecordedFile, "write"), (RecordedFile, "close"), (os, "fsync"), (os, "replace")):
            patch.setattr(owner, name, self._recorded(name, getattr(owner, name)))
        patch.setattr(Path, "open", self._recorded("open", RecordedFile))

    def _recorded(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that records a call and then calls ``function``, or fails."""

        def call(file: Any, *arguments: Any) -> Any:
            self.calls.append((name, _file_name(file)))
            number = [called_name for called_name, _file in self.calls].count(name)
            numbered_call = f"{name} {number}"
            self.numbered_calls.append(numbered_call)
            if numbered_call == self._failing_call and self._failure is not None:
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
CALLS_UP_TO_THE_FIRST_RENAMING = [
    "open 1",
    "write 1",
    "close 1",
    "open 2",
    "write 2",
    "close 2",
    "fsync 1",
    "fsync 2",
    "replace 1",
]


def replace_files_a_and_b(
    folder: Path, failing_call: str | None = None, failure: BaseException | None = None
) -> SystemCalls:
    """Replace the files "a" and "b" with the content "old" by "new"; return the system calls.

    ``failing_call``, such as "write 2" for the second call of write, raises ``failure``.
    """
    file_a, file_b = folder / "a", folder / "b"
    file_a.write_text("old")
    file_b.write_text("old")
    with pytest.MonkeyPatch.context() as patch:
        system_calls = SystemCalls(patch, failing_call, failure)
        write_together({file_a: "new", file_b: "new"})
    assert failing_call is None or failing_call in system_calls.numbered_calls
    return system_calls


def contents_of(folder: Path) -> dict[str, str]:
    """Return the content of each file in a folder, by its name."""
    return {path.name: path.read_text() for path in sorted(folder.iterdir())}


with_each_failing_call = pytest.mark.parametrize("failing_call", CALLS_UP_TO_THE_FIRST_RENAMING)
"""Let each system call fail, one at a time, up to the renaming of the first file."""


@with_each_failing_call
def test_a_full_disk_leaves_both_old_files(failing_call: str, tmp_path: Path) -> None:
    """System calls write the files "a" and "b" and rename the first. One of these calls fails.

    ``failing_call`` is "write 2", for example, if the second call of write fails.
    """
    with pytest.raises(UsageError, match=r"cannot write .*/[ab]: No space left on device; choose a folder"):
        replace_files_a_and_b(tmp_path, failing_call, failure=DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "old", "b": "old"}


@with_each_failing_call
def test_ctrl_c_leaves_both_old_files(failing_call: str, tmp_path: Path) -> None:
    """System calls write the files "a" and "b" and rename the first. Ctrl-C comes in one of these calls.

    ``failing_call`` is "write 2", for example, if it comes in the second call of write.
    """
    with pytest.raises(KeyboardInterrupt):
        replace_files_a_and_b(tmp_path, failing_call, failure=KeyboardInterrupt())
    assert contents_of(tmp_path) == {"a": "old", "b": "old"}


def test_a_failure_between_the_renamings_leaves_two_complete_files(tmp_path: Path) -> None:
    """The new file "a" has got its name, and then the second call of replace, for "b", fails."""
    with pytest.raises(UsageError, match=r"cannot write .*/b: No space left on device"):
        replace_files_a_and_b(tmp_path, failing_call="replace 2", failure=DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "new", "b": "old"}


def test_a_folder_that_cannot_be_synced_is_no_error(tmp_path: Path) -> None:
    """Not every file system can wait until the names in a folder are on the disk.

    The first two calls of fsync are for the files "a" and "b", and the third one is for the folder.
    """
    replace_files_a_and_b(tmp_path, failing_call="fsync 3", failure=DISK_IS_FULL)
    assert contents_of(tmp_path) == {"a": "new", "b": "new"}


def test_output_files_get_their_names_only_when_their_contents_are_on_disk(tmp_path: Path) -> None:
    """So whenever the power fails, a name stands for the old content or for all of the new one.

    A sync waits until the disk has what was written into a draft, or, at the end, the names in the folder.
    """
    calls = replace_files_a_and_b(tmp_path).calls
    draft_of_a, draft_of_b = [file for name, file in calls if name == "open"]
    syncs_and_renamings = [(name, file) for name, file in calls if name in ("fsync", "replace")]

    folder = tmp_path.name
    assert syncs_and_renamings == [
        ("fsync", draft_of_a),
        ("fsync", draft_of_b),
        ("replace", draft_of_a),
        ("replace", draft_of_b),
        ("fsync", folder),
    ]


def test_obsolete_files_are_removed_before_the_first_renaming(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The renaming of the draft to "file" fails, and the obsolete file is gone by then."""
    (tmp_path / "draft").touch()
    (tmp_path / "obsolete").touch()
    renaming_that_fails = Mock(side_effect=DISK_IS_FULL)
    monkeypatch.setattr(os, "replace", renaming_that_fails)

    with pytest.raises(UsageError):
        rename_drafts({tmp_path / "file": tmp_path / "draft"}, obsolete=[tmp_path / "obsolete"])
    assert names_in(tmp_path) == ["draft"]


def test_an_obsolete_file_that_is_missing_is_no_error(tmp_path: Path) -> None:
    """An obsolete file would be removed before the draft gets the name "file"; here there is none."""
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
    """The first call makes the folder a and, in it, b. The second call leaves the file in b as it is."""
    make_folder(tmp_path / "a/b")
    (tmp_path / "a/b/file").touch()
    make_folder(tmp_path / "a/b")
    assert names_in(tmp_path / "a/b") == ["file"]


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    """A file has the name of the folder that is to be made. The error has path, reason and a fix."""
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"cannot write .*/file: File exists; choose a folder that takes it"):
        make_folder(tmp_path / "file")


def test_writing_a_file_in_place_of_a_folder_or_a_pipe_is_refused(tmp_path: Path) -> None:
    """The program at the other end of a pipe would get nothing, as a new file would take its name."""
    folder = tmp_path
    with pytest.raises(UsageError, match=f"cannot write {folder}: it is not a regular file; choose"):
        write_atomically(folder, "x")
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
    """``os.access`` is replaced, since tests may run as root, who may write to every folder.

    It is asked once whether the user may write (W) to the folder and open files in it (X).
    """
    access_denied = Mock(return_value=False)
    monkeypatch.setattr(os, "access", access_denied)
    with pytest.raises(UsageError, match="you may not write to its folder; choose another"):
        check_target(tmp_path / "file")
    access_denied.assert_called_once_with(tmp_path, os.W_OK | os.X_OK)


def test_the_results_of_an_output_file_stand_beside_it(tmp_path: Path) -> None:
    """``results_beside`` gives the path of a run's results in JSON; the output file is the run's log."""
    assert results_beside(tmp_path / "run.log") == tmp_path / "run.log.json"


def test_results_are_refused_if_they_or_the_output_file_cannot_be_written(tmp_path: Path) -> None:
    """``results_beside`` gets the path of a run's output file, and gives that of the run's results.

    It is called before the run, so the user learns at once if a folder has one of these names.
    """
    folder = tmp_path
    with pytest.raises(UsageError, match=f"cannot write {folder}: it is not a regular file"):
        results_beside(folder)
    (tmp_path / "run.log.json").mkdir()
    with pytest.raises(UsageError, match=r"run\.log\.json: it is not a regular file"):
        results_beside(tmp_path / "run.log")
