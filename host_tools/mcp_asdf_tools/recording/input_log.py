"""Input log of a run: the events of each robot in a run, enough to run every robot again.

The input_log of ``run.log`` is ``run.log.events``, text, one JSON value a line. The first line describes the
run (`InputLogHeader`); what it lacks has its default, and only its robots have to be there. Every other line
is either

- ``[robot, event, ...]``: the next events of one robot, in order. An event is

  ===================== ================================================================================
  0, 1, 2               a tick began, in which it observed white, black, nothing
  3                     the tick ended (all four are the numbers of ``frames.Action``)
  [sender, x_hat, alpha] it took a message, which its firmware may have refused; raw integers as in
                        ``mcp_asdf_tools.bus.frames.Message``
  "1b"                  it took the last such message, of any line up to here, of each sender whose bit is
                        set in the hexadecimal mask, by ids: here of robots 0, 1, 3 and 4
  [x_hat, alpha]        its last broadcast went out with these false values (a fault), alpha in the binary32
                        bits of the frame
  "silent"              its last broadcast did not go out at all (a fault)
  "restart"             it started anew, as in the header
  ===================== ================================================================================

- ``"186BB92A#0000603333F307E5"``: a frame on the bus that no robot sent (a fault), as candump writes it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import can

from mcp_asdf.robot import MAX_ID
from mcp_asdf_tools.bus.frames import FrameFormat, format_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.recording.frame_logs import PART
from mcp_asdf_tools.robots.bus_robot import RESTART, SETTLE, SILENT, Event, Recorder
from mcp_asdf_tools.robots.record import RobotRecord

FORMAT = "mcp-asdf events"
VERSION = 3
"""1 had binary32 bits for alpha, and tables of another format; 2 had a message whenever it was heard."""
_MAX_WORD = 2**32 - 1
_MASK = re.compile(r"[0-9a-f]{1,32}")


def input_log_path(log: Path | str) -> Path:
    """Path of the input log of a log; that of a part is a part. Raises UsageError for an input log."""
    path = Path(log)
    if path.suffix == ".events":
        raise UsageError(
            f"{path} is what happened to the robots of a log; give the log, {path.with_suffix('')}"
        )
    return Path(f"{path.with_suffix('')}.events{PART}" if path.suffix == PART else f"{path}.events")


@dataclass(frozen=True)
class InputLogHeader:
    """Description of a run.

    Attributes:
        robots: The robots whose events follow; no two with one id.
        seed: Of everything random; None if nothing was.
        frames: Format of estimates.
        parameters: All settings of the run, for the reader.
        versions: Of the software.
    """

    robots: Sequence[RobotRecord]
    seed: int | None
    frames: FrameFormat
    parameters: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=software_versions)

    def line(self) -> str:
        """The first line of an input log."""
        plain = {
            "format": FORMAT,
            "version": VERSION,
            "versions": self.versions,
            "seed": self.seed,
            "frames": asdict(self.frames),
            "parameters": self.parameters,
            "robots": [robot.plain() for robot in self.robots],
        }
        return json.dumps(plain, allow_nan=False) + "\n"


# --- Writing ---------------------------------------------------------------------------------------------


class _Latest:
    """The last message of each sender that a line told, by which others are told: most are heard by many."""

    def __init__(self) -> None:
        self._told: dict[int, list[int]] = {}

    def tell(self, messages: list[list[int]]) -> str:
        """Events of a robot that took these. O(messages)."""
        events, mask = list[str](), 0

        def end_run() -> None:
            if mask:
                events.append(f'"{mask:x}"')

        for message in messages:
            sender = message[0]
            is_known = self._told.get(sender) == message and sender <= MAX_ID
            if not is_known or mask >> sender:
                end_run()
                mask = 0
            if is_known:
                mask |= 1 << sender
            else:
                self._told[sender] = message
                events.append("[{},{},{}]".format(*message))
        end_run()
        return ",".join(events)


class InputLogWriter:
    """Lines of an input log after its header, as events come.

    Attributes:
        robots: The recorder of each robot of the header, by id.
    """

    def __init__(self, header: InputLogHeader, write: Callable[[str], object]) -> None:
        """Pass each line to ``write``."""
        self._write = write
        tell = _Latest().tell
        self.robots = {robot.id: Recorder(robot.id, write, tell) for robot in header.robots}

    def injected(self, frame: can.Message) -> None:
        """``frame`` went over the bus, but no robot sent it."""
        self._write(f'"{format_frame(frame)}"\n')

    def finish(self) -> None:
        """Pass on what robots have of ticks that are open."""
        for recorder in self.robots.values():
            recorder.flush()


# --- Reading ---------------------------------------------------------------------------------------------


class InputLogReader:
    """An input log being read. A context manager.

    Attributes:
        header: Description of the run.
        is_part: Whether the run was cut off: a last line that has no end is left out then.
    """

    def __init__(self, path: Path | str) -> None:
        """Read the header. Raises UsageError if it is missing or malformed."""
        self._path = Path(path)
        self.is_part = self._path.suffix == PART
        self._number = 1
        try:
            self._file = self._path.open(encoding="ascii", errors="backslashreplace", newline="\n")
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror}") from error
        self._contents = self._parsed()
        try:
            self.header = self._header_of(next(self._contents, None))
        except UsageError:
            self._file.close()
            raise

    def __enter__(self) -> InputLogReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def lines(self) -> Iterator[tuple[int, Sequence[Event]] | str]:
        """Yield the lines after the header: a robot with its next events, or an injected frame as text.

        Raises UsageError, naming the line, if one is malformed.
        """
        known, said = {robot.id for robot in self.header.robots}, dict[int, list[int]]()
        for content in self._contents:
            if isinstance(content, str):
                yield content
                continue
            if not (isinstance(content, list) and content and is_plain_int(content[0])):
                raise self.wrong("neither a robot with its events nor a frame")
            robot, *events = content
            if robot not in known:
                raise self.wrong(f"robot {robot} is not in the first line")
            yield robot, [each for event in events for each in self._read(event, said)]

    def _read(self, event: Any, said: dict[int, list[int]]) -> Sequence[Event]:
        """An event, or the messages that it refers to, of those ``said`` last by their senders."""
        if isinstance(event, str) and _MASK.fullmatch(event):
            senders = [robot for robot in range(MAX_ID + 1) if int(event, 16) >> robot & 1]
            if not said.keys() >= {*senders}:
                raise self.wrong(f"{event!r} refers to a robot of which no message is told before")
            return [said[sender] for sender in senders]
        if not _is_event(event):
            raise self.wrong(f"{event!r} is no event")
        if isinstance(event, list) and len(event) == 3:
            said[event[0]] = event
        return (event,)

    def _parsed(self) -> Iterator[Any]:
        """Yield the value of each line, except a part's last line that has no end."""
        for number, line in enumerate(self._file, 1):
            self._number = number
            if not self.is_part or line.endswith("\n"):
                try:
                    content = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise self.wrong(f"not JSON ({error}); was the file cut?") from error
                yield content

    def _header_of(self, plain: Any) -> InputLogHeader:
        """Read the description of a run; a setting that it lacks is newer, and has its default."""
        if not isinstance(plain, dict) or plain.get("format") != FORMAT:
            raise self.wrong(f'"format": "{FORMAT}" is missing')
        if plain.get("version") != VERSION:
            raise self.wrong(
                f"the format is version {plain.get('version')}, and version {VERSION} is read here; replay "
                "the log with the mcp-asdf that wrote it, or record the run again"
            )
        try:
            robots = tuple(RobotRecord.from_plain(each) for each in plain["robots"])
            frames = FrameFormat(**plain.get("frames", {}))
        except KeyError as error:
            raise self.wrong(f"{error} is missing") from error
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            raise self.wrong(str(error)) from error
        parameters, versions = plain.get("parameters", {}), plain.get("versions", {})
        for name, value in (("parameters", parameters), ("versions", versions)):
            if not isinstance(value, dict):
                raise self.wrong(f"{name} is {value!r}; it must be an object in braces")
        if len({record.id for record in robots}) < len(robots):
            raise self.wrong("two robots have the same id")
        return InputLogHeader(robots, plain.get("seed"), frames, parameters, versions)

    def wrong(self, what: str) -> UsageError:
        """An error that names the line read last."""
        return UsageError(f"{self._path}, line {self._number}: {what}")


def _is_event(event: Any) -> bool:
    if isinstance(event, list):
        return len(event) in (2, 3) and all(map(is_plain_int, event)) and max(event) <= _MAX_WORD
    return event in (SILENT, RESTART) if isinstance(event, str) else is_plain_int(event) and event <= SETTLE


def is_plain_int(value: Any) -> bool:
    """True for an integer >= 0 that is no bool."""
    return type(value) is int and value >= 0
