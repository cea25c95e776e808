"""Recording of a run: writes its log of frames and its file of events to disk while it goes on."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from copy import copy
from functools import partial
from pathlib import Path
from typing import NamedTuple

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, explaining_write_errors, rename_drafts
from mcp_asdf_tools.recording.events import EventRecorder, EventsHeader, EventsWriter, events_path
from mcp_asdf_tools.recording.frame_logs import PART_SUFFIX

_FLUSH_PERIOD = 1.0
"""Seconds after which frames and events are on disk."""
_MAX_UNFLUSHED = 4096
"""Number of frames and lines of events after which they are on disk even before that."""
_GZIP_FORMAT = 31
"""``wbits`` of zlib for a gzip file. Its header has no time: equal runs give equal files of events."""


class _PartFile:
    """A file that grows while a run goes on: text is kept in memory until the next flush.

    Attributes:
        file: The open file.
    """

    def __init__(self, path: Path, is_compressed: bool) -> None:
        """Create the file, compressed by gzip if asked for. Raises FileExistsError if there is one."""
        self.file = path.open("xb", buffering=0)
        self._compressor = zlib.compressobj(wbits=_GZIP_FORMAT) if is_compressed else None
        self._unwritten = bytearray()

    def write(self, text: str) -> None:
        """Keep a text in memory for the next flush."""
        data = text.encode()
        self._unwritten += data if self._compressor is None else self._compressor.compress(data)

    def flush(self) -> None:
        """Write to disk what is in memory, so that others can read it there. Raises OSError if it fails."""
        if self._compressor is not None:
            # A sync flush ends at a whole byte, so that a reader can decompress all text so far.
            self._unwritten += self._compressor.flush(zlib.Z_SYNC_FLUSH)
        self._write_to_disk()

    def close(self) -> None:
        """Write what is in memory and the end of compressed data, and close the file.

        Raises OSError if the disk refuses the data; the file stays open then.
        """
        if self._compressor is not None:
            self._unwritten += self._compressor.flush(zlib.Z_FINISH)
        self._write_to_disk()
        self.file.close()

    def _write_to_disk(self) -> None:
        """Write all unwritten bytes. Raises OSError if that fails; then the rest stays unwritten."""
        while self._unwritten:
            # An almost full disk accepts some of the bytes before it refuses the others.
            written_count = self.file.write(self._unwritten)
            del self._unwritten[:written_count]


class LogOutputs(NamedTuple):
    """Destinations of the frames and the events of a run.

    Attributes:
        record_frame: Called with each frame.
        events_writer: Writer of the events; None if they are not recorded.
    """

    record_frame: Callable[[can.Message], None]
    events_writer: EventsWriter | None

    def recorder_of(self, robot_id: int) -> EventRecorder | None:
        """Return the recorder of a robot's events; None if they are not recorded."""
        return None if self.events_writer is None else self.events_writer.recorders[robot_id]


class NoRecording(nullcontext[LogOutputs]):
    """Context manager with the interface of ``Recording`` that records nothing."""

    failure: str | None = None

    def __init__(self) -> None:
        """Create a context that yields outputs which keep nothing."""
        super().__init__(LogOutputs(lambda frame: None, None))


class Recording:
    """Log of a run and, if there is a header, its events; a context manager that yields ``LogOutputs``.

    Both files grow as ``NAME.part``, are on disk once a second, and get their names at a regular end, the
    log last: a log under its own name never stands beside another run's events. After any other end they
    stay parts. A problem such as a full disk ends the recording but not the run.

    Events are written before the frames that followed from them. So the events on disk explain the frames
    on disk, except those of ticks that have not ended.

    Attributes:
        failure: Reason why the recording is not complete; None as long as nothing is wrong.
    """

    def __init__(
        self,
        path: Path,
        header: EventsHeader | None,
        warn: Callable[[str], object],
        channel: str = "vcan0",
    ) -> None:
        """Prepare to write the log ``path`` in candump's format, and its events if ``header`` is not None.

        Args:
            path: The log. Its name must end in ``.log``.
            header: First line of the events.
            warn: Called with one line if the recording fails; it says what is on disk.
            channel: Channel in the log for frames that have none.

        Raises UsageError, as entering the context does, if the files cannot be written.
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
        # The files of the recording by the paths that they get at a regular end
        self._part_by_path = {path: _part_of(path)}
        if header is not None:
            self._part_by_path[events_path(path)] = _part_of(events_path(path))
        self._files: list[_PartFile] = []
        """The open files: the log, then the events if there is a header."""
        self._is_empty = True
        """Whether neither a frame nor an event was recorded."""
        self._has_failed = False
        """Whether the recording has ended before the run, so that nothing more is recorded."""
        self._unflushed_count = 0
        self._flush_time = time.monotonic() + _FLUSH_PERIOD
        self._events = None if header is None else EventsWriter(header, self._write_events_line)

    def __enter__(self) -> LogOutputs:
        """Create the part files, and return what writes to them. Raises UsageError if they cannot be written.

        A part of another run that is there is not replaced, but refused.
        """
        for part in self._part_by_path.values():
            if part.exists():  # the data that another run left must not be lost
                raise UsageError(
                    f"{part} is there: another program writes it, or its run was cut off; rename or remove it"
                )
        with explaining_write_errors(self._path):
            log_file = _PartFile(self._part_by_path[self._path], is_compressed=False)
            self._files = [log_file]
            if self._header is not None:
                events_part = self._part_by_path[events_path(self._path)]
                events_file = _PartFile(events_part, is_compressed=True)
                self._files.append(events_file)
                events_file.write(self._header.to_line())
        # The writer uses no method of a file but "write".
        self._log_writer = can.CanutilsLogWriter(log_file)  # type: ignore[arg-type]
        return LogOutputs(self._write_frame, self._events)

    def __exit__(self, error_type: type[BaseException] | None, *_: object) -> None:
        """Close the files, and rename them after a regular end.

        After an error the parts stay, with a warning, or are deleted if nothing was recorded.
        """
        if self._events is not None:
            self._events.finish()
        self._do_or_end_recording(self._close_files)
        if error_type is None:
            self._do_or_end_recording(self._rename_parts)
        elif self._is_empty:
            for part in self._part_by_path.values():
                part.unlink(missing_ok=True)
        else:
            self._fail("the run did not end regularly", "partial data is")

    def _rename_parts(self) -> None:
        """Give the files their names, the log last. Raises UsageError if that fails."""
        log_path, *events_paths = self._part_by_path
        log_target = check_target(log_path)
        # A log must never stand beside the events of another run. So the old log and its events are removed
        # first, and the new log gets its name when its events have theirs.
        paths_in_order = [*events_paths, log_path]
        part_by_path = {path: self._part_by_path[path] for path in paths_in_order}
        rename_drafts(part_by_path, obsolete=[log_target, events_path(log_target)])

    def _write_frame(self, frame: can.Message) -> None:
        """Record a frame, which is on disk after the next flush; nothing happens if the recording has failed.

        A frame without a channel is recorded with that of the recording, but not changed itself.
        """
        self._flush_if_due()
        logged_frame = copy(frame)
        channel = str(frame.channel or self._channel)
        logged_frame.channel = "_".join(channel.split())  # in candump's format a channel has no spaces
        write_frame = partial(self._log_writer.on_message_received, logged_frame)
        self._do_or_end_recording(write_frame)

    def _write_events_line(self, line: str) -> None:
        """Record a line of the file of events, which is on disk after the next flush.

        Nothing happens if the recording has failed.
        """
        self._flush_if_due()
        if not self._has_failed:
            _log_file, events_file = self._files
            events_file.write(line)

    def _flush_if_due(self) -> None:
        """Count an entry that is about to be recorded, and flush those before it if it is time.

        It is time after _FLUSH_PERIOD seconds, or _MAX_UNFLUSHED entries if these come earlier. So events
        that led to a frame are on disk no later than the frame.
        """
        self._is_empty = False  # so that a run that fails keeps its part files
        self._unflushed_count += 1
        is_due = self._unflushed_count > _MAX_UNFLUSHED or time.monotonic() >= self._flush_time
        if is_due:
            self._unflushed_count = 0
            self._flush_time = time.monotonic() + _FLUSH_PERIOD
            self._do_or_end_recording(self._flush_files)

    def _flush_files(self) -> None:
        """Flush the events, then the log. Raises OSError if the disk refuses one of them."""
        for file in reversed(self._files):
            file.flush()

    def _close_files(self) -> None:
        """Close the events, then the log. Raises OSError if the disk refuses one of them."""
        for file in reversed(self._files):
            file.close()

    def _do_or_end_recording(self, action: Callable[[], object]) -> None:
        """Call ``action`` unless the recording has ended; an OSError or UsageError in it ends that."""
        if self._has_failed:
            return
        try:
            action()
        except OSError as error:
            self._fail(error.strerror or str(error), "what followed is lost, what came before is")
        except UsageError as error:
            self._fail(str(error), "partial data is")

    def _fail(self, reason: str, data_on_disk: str) -> None:
        """End the recording and warn, unless it has ended before.

        The warning has the reason, ``data_on_disk``, which says what of the data is there, and the names of
        the files that it is in. These are closed.
        """
        if self._has_failed:
            return
        self._has_failed = True
        self.failure = reason
        parts = " and ".join(str(part) for part in self._part_by_path.values())
        self._warn(f"the log {self._path} is not complete: {reason}; {data_on_disk} in {parts}")
        for part_file in self._files:
            part_file.file.close()


def _part_of(path: Path) -> Path:
    """Return the path that a file has while it grows: that of the file itself, with ``.part`` behind it.

    A link is followed to the file. Raises UsageError if there can be no file of this path.
    """
    target = check_target(path)
    return target.with_name(f"{target.name}{PART_SUFFIX}")
