"""Recording of a run: its log and its events on their way to disk."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from copy import copy
from pathlib import Path

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, explaining, sync_folders
from mcp_asdf_tools.recording.events import EventsHeader, EventsWriter, events_path
from mcp_asdf_tools.recording.frame_logs import PART

LogOutputs = tuple[Callable[[can.Message], None] | None, EventsWriter | None]
"""What takes the frames, and what takes the events; None where they are not recorded."""

_FLUSH_PERIOD = 1.0
"""Seconds after which frames and events are on disk."""
_MAX_UNFLUSHED = 4096
"""Frames and lines of events after which they are on disk even earlier."""
_GZIP_FORMAT = 31
"""``wbits`` of zlib that makes a gzip file, whose header has no time: the same run gives the same events."""


class _PartFile:
    """A file that is being written: text goes into the memory, and to disk with the next flush."""

    def __init__(self, path: Path, is_compressed: bool) -> None:
        """Create the file. Raises FileExistsError if there is one."""
        self.path = path
        self.file = path.open("xb", buffering=0)
        self._compressor = zlib.compressobj(wbits=_GZIP_FORMAT) if is_compressed else None
        self._unwritten = bytearray()

    def write(self, text: str) -> None:
        """Take text, which is on disk after the next flush."""
        data = text.encode()
        self._unwritten += data if self._compressor is None else self._compressor.compress(data)

    def flush(self) -> None:
        """Write to disk what was taken, so that it can be read from there. Raises OSError if that fails."""
        if self._compressor is not None:
            self._unwritten += self._compressor.flush(zlib.Z_SYNC_FLUSH)
        self._write_to_disk()

    def close(self) -> None:
        """Write what was taken, with the end of the file, and close it. Raises OSError as ``flush``."""
        if self._compressor is not None:
            self._unwritten += self._compressor.flush(zlib.Z_FINISH)
        self._write_to_disk()
        self.file.close()

    def _write_to_disk(self) -> None:
        while self._unwritten:
            # An almost full disk takes a part of the data before it refuses the rest.
            written_bytes = self.file.write(self._unwritten)
            del self._unwritten[:written_bytes]


class NoRecording(nullcontext[LogOutputs]):
    """Stands for a recording where none was asked for."""

    failure: str | None = None

    def __init__(self) -> None:
        super().__init__((None, None))


class Recording:
    """Log of a run and, with a header, its events; a context manager that yields what takes them.

    Both grow as ``NAME.part``, are on disk once a second, and take their names at a regular end, the log
    last: a log under its own name never has another run's events. After any other end they stay parts. What
    goes wrong, such as a full disk, ends the recording but not the run. Events are written before the frames
    that followed from them, so while the disk takes both, the events on it explain the frames on it but for
    those of open ticks.

    Attributes:
        failure: Why the recording is not complete; None while nothing is wrong with it.
    """

    def __init__(
        self,
        path: Path,
        header: EventsHeader | None,
        warn: Callable[[str], object],
        channel: str = "vcan0",
    ) -> None:
        """Prepare to write the log ``path``, in candump's format, and events beside it if there is a header.

        ``warn`` gets a line if the recording fails; it says what is on disk. ``channel`` is that of frames
        that do not name theirs. Raises UsageError, as entering does, if the log's name or place is unusable.
        """
        if path.suffix.lower() != ".log":
            raise UsageError(
                f"cannot log to {path.name}: choose .log, candump's format; python-can's can_logconvert "
                "makes others of it"
            )
        self.failure: str | None = None
        self._path = path
        self._header = header
        self._channel = channel
        self._warn = warn
        names = [path] if header is None else [path, events_path(path)]
        self._targets = [check_target(name) for name in names]
        self._parts = [target.with_name(target.name + PART) for target in self._targets]
        self._files: list[_PartFile] = []
        self._is_empty = True
        self._is_over = False
        self._unflushed_count = 0
        self._flush_time = time.monotonic() + _FLUSH_PERIOD
        self._events = None if header is None else EventsWriter(header, self._write_events_line)

    def __enter__(self) -> LogOutputs:
        for part in self._parts:
            if part.exists():  # what another run left must not be lost
                raise UsageError(
                    f"{part} is there: another program writes it, or its run was cut off; rename or remove it"
                )
        with explaining(self._path):
            log_part, *events_parts = self._parts
            self._files = [_PartFile(log_part, is_compressed=False)]
            self._files += [_PartFile(part, is_compressed=True) for part in events_parts]
        self._log_writer = can.CanutilsLogWriter(self._files[0])  # type: ignore[arg-type]  # which only writes
        if self._header is not None:
            self._files[1].write(self._header.to_line())
        return self._write_frame, self._events

    def __exit__(self, error_type: type[BaseException] | None, *_: object) -> None:
        if self._events is not None:
            self._events.finish()
        self._attempt(self._close_files)
        if error_type is None:
            self._attempt(self._rename_parts)
        elif self._is_empty:
            for part in self._parts:
                part.unlink(missing_ok=True)
        else:
            self._fail("the run did not end regularly", "partial data is")

    def _rename_parts(self) -> None:
        """Give the files their names. Raises UsageError if that cannot be done."""
        for target in self._targets:
            check_target(target)
        with explaining(self._path):
            for part in self._parts:
                with part.open("rb") as file:
                    os.fsync(file.fileno())  # a file must not have its name before the disk has its content
            log_target = self._targets[0]
            # The old log is removed first: it must never stand beside the events of another run.
            for old_file in (log_target, events_path(log_target)):
                old_file.unlink(missing_ok=True)
            for part, target in reversed(list(zip(self._parts, self._targets, strict=True))):
                os.replace(part, target)
            sync_folders(self._targets)

    def _write_frame(self, frame: can.Message) -> None:
        self._flush_if_due()
        named_frame = copy(frame)
        # candump's format has one word for the channel.
        named_frame.channel = "_".join(str(frame.channel or self._channel).split())
        self._attempt(lambda: self._log_writer.on_message_received(named_frame))

    def _write_events_line(self, line: str) -> None:
        self._flush_if_due()
        if not self._is_over:
            self._files[1].write(line)

    def _flush_if_due(self) -> None:
        """Write to disk what came before. The events that led to the last frame are among it."""
        self._is_empty = False
        self._unflushed_count += 1
        if self._unflushed_count > _MAX_UNFLUSHED or time.monotonic() >= self._flush_time:
            self._unflushed_count = 0
            self._flush_time = time.monotonic() + _FLUSH_PERIOD
            self._attempt(self._flush_files)

    def _flush_files(self) -> None:
        """Write to disk what came before, events before frames. Raises OSError if the disk refuses."""
        self._call_in_order([file.flush for file in self._files])

    def _close_files(self) -> None:
        """Write the rest in the same order, and close the files. Raises OSError if the disk refuses."""
        self._call_in_order([file.close for file in self._files])

    def _call_in_order(self, calls: Sequence[Callable[[], None]]) -> None:
        """Call a method of each file, the log's last. Raises the first OSError when all have been called."""
        errors: list[OSError] = []
        for call in reversed(calls):
            try:
                call()
            except OSError as error:  # the log may still have room, or less to write
                errors.append(error)
        if errors:
            raise errors[0]

    def _attempt(self, action: Callable[[], object]) -> None:
        """Call ``action`` unless the recording has ended; an error in it ends the recording."""
        if self._is_over:
            return
        try:
            action()
        except OSError as error:
            self._fail(error.strerror or str(error), "what followed is lost, what came before is")
        except UsageError as error:
            self._fail(str(error), "partial data is")

    def _fail(self, reason: str, data_on_disk: str) -> None:
        """End the recording, and warn once: of the reason, and in which files there is what was recorded."""
        if self._is_over:
            return
        self._is_over = True
        self.failure = reason
        parts = " and ".join(str(part) for part in self._parts)
        self._warn(f"the log {self._path} is not complete: {reason}; {data_on_disk} in {parts}")
        for file in self._files:
            file.file.close()
