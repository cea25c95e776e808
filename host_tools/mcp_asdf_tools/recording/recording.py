"""Recording of a run: its log and its input log on their way to disk."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from copy import copy
from pathlib import Path

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, explaining, sync_folders
from mcp_asdf_tools.recording.frame_logs import PART
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogWriter, input_log_path

LogOutputs = tuple[Callable[[can.Message], None] | None, InputLogWriter | None]
"""Takers of frames and of events, None where there is no log."""

_PERIOD = 1.0
"""Seconds after which frames and events are on disk."""
_MOST_WAITING = 4096
"""Frames and events that may wait for that."""


class _Part:
    """A file that is being written; what a full disk does not take waits."""

    def __init__(self, path: Path) -> None:
        self.path, self._waiting = path, bytearray()
        self.file = path.open("xb", buffering=0)

    def write(self, text: str) -> None:
        """Take text, which is on disk after the next flush."""
        self._waiting += text.encode()

    def flush(self) -> None:
        """Write what waits. Raises OSError if the disk does not take it."""
        while self._waiting:
            del self._waiting[: self.file.write(self._waiting)]

    def close(self) -> None:
        """The same, and that was all."""
        self.flush()
        self.file.close()


class NoRecording(nullcontext[LogOutputs]):
    """Recording that takes nothing."""

    failure: str | None = None

    def __init__(self) -> None:
        super().__init__((None, None))


class Recording:
    """Log of a run and, with a header, its input log; a context manager that yields their takers.

    Both grow as ``NAME.part``, are on disk once a second, and take their names at a regular end, the log
    last: a log under its own name never has another run's input log. After any other end they stay parts. On
    a full disk the input log gives way to the log; when that has no room either the recording ends, but not
    the run.

    Attributes:
        failure: Why the recording is not complete; None while nothing is wrong with it.
    """

    def __init__(
        self,
        path: Path,
        header: InputLogHeader | None,
        warn: Callable[[str], object],
        channel: str = "vcan0",
    ) -> None:
        """Prepare the log ``path``, in candump's format. ``warn`` gets a line each if the input
        log is given up and if the recording fails.

        ``channel`` is that of frames that do not name theirs. Raises UsageError, as entering does, if the
        log's name or place is unusable.
        """
        if path.suffix.lower() != ".log":
            raise UsageError(
                f"cannot log to {path.name}: choose .log, candump's format; python-can's can_logconvert "
                "makes others of it"
            )
        self.failure: str | None = None
        self._path, self._header, self._channel, self._warn = path, header, channel, warn
        names = [path] if header is None else [path, input_log_path(path)]
        self._targets = [check_target(each) for each in names]
        self._parts = [target.with_name(target.name + PART) for target in self._targets]
        self._is_empty, self._is_over = True, False
        self._waiting = 0
        self._flush_at = time.monotonic() + _PERIOD
        self._events = None if header is None else InputLogWriter(header, self._write_events)

    def __enter__(self) -> LogOutputs:
        for part in self._parts:
            if part.exists():  # what another run left is not lost
                raise UsageError(
                    f"{part} is there: another program writes it, or its run was cut off; rename or remove it"
                )
        with explaining(self._path):
            self._files = [_Part(part) for part in self._parts]
        self._log = can.CanutilsLogWriter(self._files[0])  # type: ignore[arg-type]  # which only writes
        if self._header is not None:
            self._files[1].write(self._header.line())
        return self._write_frame, self._events

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._events is not None:
            self._events.finish()
        self._attempt(lambda: self._on_files("close"))
        if kind is None:
            self._attempt(self._take_names)
        elif self._is_empty:
            for part in self._parts:
                part.unlink(missing_ok=True)
        else:
            self._fail("the run did not end regularly")

    def _take_names(self) -> None:
        for target in self._targets:
            check_target(target)
        with explaining(self._path):
            for part in self._parts:
                with part.open("rb") as file:
                    os.fsync(file.fileno())  # it must not have its name before the disk has it
            log = self._targets[0]
            for old in (log, input_log_path(log)):  # the old log first: it must not get another's input log
                old.unlink(missing_ok=True)
            for part, target in reversed(list(zip(self._parts, self._targets, strict=True))):
                os.replace(part, target)
            sync_folders(self._targets)

    def _write_frame(self, frame: can.Message) -> None:
        self._flush_if_due()
        named = copy(frame)
        named.channel = "_".join(str(frame.channel or self._channel).split())  # one word, as the format wants
        self._attempt(lambda: self._log.on_message_received(named))

    def _write_events(self, line: str) -> None:
        self._flush_if_due()
        if len(self._files) > 1 and not self._is_over:
            self._files[1].write(line)

    def _flush_if_due(self) -> None:
        """Write to disk what came before: the events that follow from the last frame are among it."""
        self._is_empty = False
        self._waiting += 1
        if self._waiting > _MOST_WAITING or time.monotonic() >= self._flush_at:
            self._waiting = 0
            self._flush_at = time.monotonic() + _PERIOD
            self._attempt(lambda: self._on_files("flush"))

    def _on_files(self, call: str) -> None:
        """Flush or close, the log last: so the input log explains all that it holds but open ticks."""
        for file in reversed(self._files):
            try:
                getattr(file, call)()
            except OSError as error:
                if len(self._files) == 1:
                    raise
                self._give_up_events(error.strerror or str(error))
                getattr(self._files[0], call)()

    def _give_up_events(self, reason: str) -> None:
        """Leave their room to the log."""
        events, _ = self._files.pop(), self._targets.pop()
        events.file.close()
        self._parts.pop().unlink()
        self.failure = reason
        self._warn(
            f"{events.path} is given up to leave room for the log, which goes on: {reason}; mcp-asdf replay "
            "cannot check this log, as it needs the events, but mcp-asdf view shows its frames"
        )

    def _attempt(self, work: Callable[[], object]) -> None:
        """Do ``work`` unless the recording is over; what goes wrong ends it."""
        if self._is_over:
            return
        try:
            work()
        except (OSError, UsageError) as error:
            self._fail(error.strerror or str(error) if isinstance(error, OSError) else str(error))

    def _fail(self, reason: str) -> None:
        if not self._is_over:
            self._is_over, self.failure = True, reason
            self._warn(f"the log {self._path} is not complete: {reason}; partial data is in {self._parts[0]}")
            for part in self._files:
                part.file.close()
