"""File of events of a run: how each robot started, and what it observed and received in every tick.

That is enough to run every robot again. The events of ``run.log`` are in ``run.log.events``, a text
compressed by gzip, with one JSON value a line. The first line describes the run (`EventsHeader`): only its
robots have to be there, everything else has a default. Every other line is either

- ``[robot id, event, ...]``: the next events of one robot, in order. An event is one of

    - ``0``, ``1``, ``2``: a tick began, in which the robot observed white, black, nothing
    - ``3``: the tick ended (these four are the values of ``frame_layout.Action``)
    - ``[sender, x_hat, alpha]``: the robot received an estimate, which its firmware may have refused;
      integers as in ``mcp_asdf_tools.bus.frames.Estimate``
    - ``[x_hat, alpha]``: a fault changed the robot's last broadcast to these values; alpha as the 32 bits of
      the IEEE number in the frame
    - ``"silent"``: a fault kept the robot's last broadcast from the bus
    - ``"restart"``: the robot started again in the state of the header

- ``"186BB92A#0000603333F307E5"``: a frame on the bus that no robot sent, but a fault; as candump writes it.

Versions 3 and 4 of the format are read, too, unless a robot has the robust filter: it was another filter
then. Version 3 is not compressed, and may have a hexadecimal mask such as ``"1b"`` in place of estimates. It
stands for the last estimate in the file of each sender whose bit is set, here of robots 0, 1, 3 and 4 in this
order.
"""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import count
from pathlib import Path
from typing import IO, Any

import can

from mcp_asdf.robot import MAX_ID, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import FrameFormat, format_frame
from mcp_asdf_tools.common.errors import UsageError, refusing_wrong_values
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.recording.frame_logs import PART_SUFFIX
from mcp_asdf_tools.robots.robot_setup import RobotSetup, format_ids

FORMAT = "mcp-asdf events"
VERSION = 5
_READABLE_VERSIONS = (3, 4, VERSION)
"""Version 1 had alpha as the bits of an IEEE number and t-tables of another format. Version 2 repeated each
estimate for every receiver, without compression. Version 4 has the form of version 5."""
_FIRST_VERSION_OF_ROBUST_FILTER = 5
"""First version in which robots with the robust filter keep the latest estimate of each sender. Before, every
message was a vote, so such a robot would not repeat its run."""

Event = int | str | list[int]
"""One event of a robot as the file has it; the list above has the forms."""
SETTLE = Action.SETTLE.value
"""Event: the tick ended."""
SILENT = "silent"
"""Event: the last broadcast did not reach the bus."""
RESTART = "restart"
"""Event: the robot started again."""

MAX_LINE_LENGTH = 2**24
"""Maximum number of characters in a line: a damaged or hostile file must not fill the memory with one."""
_MAX_EVENTS_PER_LINE = 100_000
"""Number of events after which a line is written before the tick has ended. So the line of a robot that
received a flood of frames is short enough to be read."""
_MAX_INTEGER = 2**32 - 1
"""Maximum of the integers in an event: all of them have at most 32 bits in the firmware."""
_SENDER_MASK = re.compile(r"[0-9a-f]{1,32}")
_USE_OTHER_VERSION = "replay the log with the mcp-asdf that wrote it, or record the run again"
_GZIP_MAGIC = b"\x1f\x8b"
"""First two bytes of every file that is compressed by gzip."""


def events_path(log: Path | str) -> Path:
    """Return the path of a log's events: ``run.log.events`` for ``run.log``.

    For ``run.log.part``, the log of a run that was cut off, it is ``run.log.events.part``. Raises UsageError
    if ``log`` is the path of a file of events.
    """
    path = Path(log)
    if path.suffix == ".events":
        raise UsageError(
            f"{path} is what happened to the robots of a log; give the log, {path.with_suffix('')}"
        )
    if path.suffix == PART_SUFFIX:
        return Path(f"{path.with_suffix('')}.events{PART_SUFFIX}")
    return Path(f"{path}.events")


@dataclass(frozen=True)
class EventsHeader:
    """Description of a run, which is the first line of its events.

    Attributes:
        robots: Initial states of the robots whose events follow. No two have the same id.
        seed: Seed of all random numbers; None if there were none.
        frames: Subject and priority of the robots' estimates.
        parameters: All settings of the run by name, for people and for ``mcp-asdf view``.
        versions: Versions of the software by name.
    """

    robots: Sequence[RobotSetup]
    seed: int | None
    frames: FrameFormat
    parameters: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=software_versions)

    def to_line(self) -> str:
        """Return the first line of a file of events, with its end.

        Raises ValueError if a parameter has a value that JSON cannot express, such as NaN.
        """
        plain_header = {
            "format": FORMAT,
            "version": VERSION,
            "versions": self.versions,
            "seed": self.seed,
            "frames": asdict(self.frames),
            "parameters": self.parameters,
            "robots": [robot.plain() for robot in self.robots],
        }
        return json.dumps(plain_header, allow_nan=False) + "\n"


# --- Writing ---------------------------------------------------------------------------------------------


class EventRecorder:
    """Recorder of one robot's events, which writes a line each time that the robot ends a tick."""

    def __init__(self, robot_id: int, write_line: Callable[[str], object]) -> None:
        """Record the events of a robot; ``write_line`` is called with each line, with its end."""
        self._robot_id = robot_id
        self._write_line = write_line
        self._events: list[Event] = []

    def record_observation(self, observation: Observation | None) -> None:
        """Record that a tick began, in which the robot observed a colour; None for no observation."""
        self._events.append(Action.to_observe(observation).value)

    def record_estimates(self, estimates: Sequence[list[int]]) -> None:
        """Record that the robot received estimates, each a list of sender, x_hat and alpha. O(estimates).

        If the events of this tick have become too many for one line, they are written at once.
        """
        self._events += estimates
        if len(self._events) > _MAX_EVENTS_PER_LINE:
            self.flush()

    def record_settle(self) -> None:
        """Record that the robot ended the tick, and write the line of its events."""
        self._events.append(SETTLE)
        self.flush()

    def record_restart(self) -> None:
        """Record that the robot started again in the state of the header."""
        self._events.append(RESTART)

    def record_silence(self) -> None:
        """Record that the robot's last broadcast did not reach the bus."""
        self._events.append(SILENT)

    def record_false_values(self, x_hat: int, alpha_bits: int) -> None:
        """Record that the robot's last broadcast went out with these values in place of its own.

        ``alpha_bits`` are the 32 bits of the IEEE number in the frame.
        """
        self._events.append([x_hat, alpha_bits])

    def record_foreign_frame(self, frame: can.Message) -> None:
        """Record a frame that another node sent under the robot's id."""
        self._write_line(_line_of_frame(frame))

    def flush(self) -> None:
        """Write the events since the last line as a line, if there are any."""
        if self._events:
            line = json.dumps([self._robot_id, *self._events], separators=(",", ":"))
            self._write_line(f"{line}\n")
            self._events = []


class EventsWriter:
    """Writer of all lines of a file of events but the header.

    Attributes:
        recorders: Recorder of each robot in the header, by the robot's id.
    """

    def __init__(self, header: EventsHeader, write_line: Callable[[str], object]) -> None:
        """Create the recorders; ``write_line`` is called with each line, with its end."""
        self._write_line = write_line
        self.recorders = {robot.id: EventRecorder(robot.id, write_line) for robot in header.robots}

    def record_injected_frame(self, frame: can.Message) -> None:
        """Record a frame on the bus that no robot sent, but a fault."""
        self._write_line(_line_of_frame(frame))

    def finish(self) -> None:
        """Write the events of ticks that have not ended."""
        for recorder in self.recorders.values():
            recorder.flush()


def _line_of_frame(frame: can.Message) -> str:
    """Return the line for a frame: a JSON text of the frame as candump writes it."""
    return f'"{format_frame(frame)}"\n'


# --- Reading ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RobotEvents:
    """The next events of one robot, in order: a line of the file."""

    robot_id: int
    events: Sequence[Event]


@dataclass(frozen=True)
class InjectedFrame:
    """A frame that no robot sent, but a fault: a line of the file, with the frame as candump writes it."""

    text: str


class EventsReader:
    """Reader of a file of events, and a context manager that closes the file.

    Attributes:
        header: Description of the run.
        is_part: Whether the file is the part of a run that was cut off. Then a last line without an end is
            ignored.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file and read its header. Raises UsageError if it is missing or malformed."""
        self._path = Path(path)
        self.is_part = self._path.suffix == PART_SUFFIX
        self._line_number = 1
        self._last_estimates: dict[int, list[int]] = {}
        """The last estimate of each sender in the lines read so far, by the sender's id."""
        try:
            self._file = _open_text(self._path)
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror}") from error
        self._values = self._read_values()
        try:
            first_value = next(self._values, None)  # None, of an empty file, is refused as a header
            self.header = self._parse_header(first_value)
        except UsageError:
            self._file.close()
            raise
        self._robot_ids = {robot.id for robot in self.header.robots}

    def __enter__(self) -> EventsReader:
        """Return the reader, whose file is open since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def entries(self) -> Iterator[RobotEvents | InjectedFrame]:
        """Yield what each line after the header holds: the next events of a robot, or an injected frame.

        All received estimates are in the events, also those that a file of version 3 only refers to: it may
        have a mask of senders in place of estimates that it has told before. Raises UsageError, which names
        the line, for a malformed one.
        """
        for value in self._values:
            if isinstance(value, str):
                yield InjectedFrame(value)
            else:
                yield self._parse_robot_events(value)

    def error_in_line(self, text: str) -> UsageError:
        """Return a UsageError that names the line read last, and then says ``text``; the caller raises it."""
        return UsageError(f"{self._path}, line {self._line_number}: {text}")

    def _parse_robot_events(self, value: Any) -> RobotEvents:
        """Return the events of a robot in the JSON value of a line, which has to begin with the robot's id.

        Raises UsageError for any other value, for a robot that is not in the header, and as ``_parse_events``
        does.
        """
        begins_with_id = isinstance(value, list) and len(value) > 0 and _is_whole_number(value[0])
        if not begins_with_id:
            raise self.error_in_line("neither a robot with its events nor a frame")
        robot_id, *plain_events = value
        if robot_id not in self._robot_ids:
            raise self.error_in_line(f"robot {robot_id} is not in the first line")
        return RobotEvents(robot_id, self._parse_events(plain_events))

    def _parse_events(self, plain_events: Sequence[Any]) -> list[Event]:
        """Return the events in the JSON values of a line, with estimates in place of a mask of senders.

        Remembers the last estimate of each sender, to which a mask in this line or a later one may refer.
        Raises UsageError for a value that is no event, and for a mask of a sender without an estimate.
        """
        events: list[Event] = []
        for plain_event in plain_events:
            if isinstance(plain_event, str) and _SENDER_MASK.fullmatch(plain_event):
                events += self._estimates_of_mask(plain_event)
                continue
            if not _is_event(plain_event):
                raise self.error_in_line(f"{plain_event!r} is no event")
            if is_received_estimate(plain_event):
                sender, _x_hat, _alpha = plain_event
                self._last_estimates[sender] = plain_event
            events.append(plain_event)
        return events

    def _estimates_of_mask(self, mask_text: str) -> Sequence[Event]:
        """Return the last estimates of the senders in a mask of version 3, by rising id.

        Bit k of the hexadecimal number stands for the robot with id k. Raises UsageError if one of these
        robots has sent no estimate before.
        """
        mask = int(mask_text, 16)
        senders = [sender for sender in range(MAX_ID + 1) if (mask >> sender) & 1]
        if not all(sender in self._last_estimates for sender in senders):
            raise self.error_in_line(f"{mask_text!r} refers to a robot of which no message is told before")
        return [self._last_estimates[sender] for sender in senders]

    def _read_values(self) -> Iterator[Any]:
        """Yield the JSON value of each line, the header included.

        If the run was cut off, an incomplete last line is left out. Sets ``_line_number`` to the number of
        each line before its value is yielded, or of the line in which an error is. Raises UsageError if the
        file is damaged, if it ends in the middle though the run was not cut off, or if a line is too long or
        not JSON.
        """
        for line_number in count(1):
            line = self._read_line(line_number)
            is_incomplete = self.is_part and not line.endswith("\n")
            # At the end of the file ``_line_number`` stays at the last line, for later errors.
            if not line or is_incomplete:
                return
            self._line_number = line_number
            if len(line) > MAX_LINE_LENGTH:
                raise self.error_in_line(f"not JSON of at most {MAX_LINE_LENGTH} characters")
            try:
                value = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise self.error_in_line(f"not JSON ({error}); was the file cut?") from error
            yield value

    def _read_line(self, line_number: int) -> str:
        """Return the next line, at most the first MAX_LINE_LENGTH + 1 characters; an empty text at the end.

        If the run was cut off, compressed data may end without a mark of their end. ``line_number`` is that
        of the line, for errors. Raises UsageError if the file is damaged there, or lacks its end though the
        run was not cut off.
        """
        try:
            return self._file.readline(MAX_LINE_LENGTH + 1)
        except EOFError as error:  # the end of the compressed data is missing
            if self.is_part:
                return ""
            self._line_number = line_number
            raise self.error_in_line("the file ends here, in the middle; was it cut?") from error
        except (OSError, zlib.error) as error:
            self._line_number = line_number
            raise self.error_in_line(f"the file is damaged here: {error}") from error

    def _parse_header(self, plain_header: Any) -> EventsHeader:
        """Return the description of a run in the JSON value of the first line.

        Settings of robots and frames that are missing have their defaults: the file was written before they
        existed. Raises UsageError for another format; for a version that cannot be read, or one that had
        another robust filter, if a robot has that filter; for robots that are no list or share an id; and for
        a value that is missing without a default, unknown or impossible.
        """
        # Format and version come first: in another one all else may have another meaning.
        version = self._version_of(plain_header)
        try:
            robots = self._parse_robots(plain_header.get("robots"))
            # An unknown key gives a TypeError, which becomes a UsageError.
            with refusing_wrong_values():
                frames = FrameFormat(**plain_header.get("frames", {}))
        except UsageError as error:
            raise self.error_in_line(str(error)) from error
        if version < _FIRST_VERSION_OF_ROBUST_FILTER:
            self._check_without_robust_filter(robots)
        return EventsHeader(
            robots,
            plain_header.get("seed"),
            frames,
            parameters=self._object_in(plain_header, "parameters"),
            versions=self._object_in(plain_header, "versions"),
        )

    def _version_of(self, plain_header: Any) -> int:
        """Return the version of the format. Raises UsageError for another format or unreadable version."""
        if not isinstance(plain_header, dict) or plain_header.get("format") != FORMAT:
            raise self.error_in_line(f'"format": "{FORMAT}" is missing')
        version: Any = plain_header.get("version")
        if version not in _READABLE_VERSIONS:
            raise self.error_in_line(
                f"the format is version {version}, and versions {_READABLE_VERSIONS[0]} to {VERSION} "
                f"are read here; {_USE_OTHER_VERSION}"
            )
        return int(version)

    @staticmethod
    def _parse_robots(plain_robots: Any) -> tuple[RobotSetup, ...]:
        """Return the robots in the JSON value of the header.

        Raises UsageError, without the line, if the value is no list, if one of its entries is no robot, and
        if two robots have the same id.
        """
        if not isinstance(plain_robots, list):
            raise UsageError(f"robots is {plain_robots!r}; it must be a list in brackets")
        robots = tuple(RobotSetup.from_plain(plain_robot) for plain_robot in plain_robots)
        ids = {robot.id for robot in robots}
        if len(ids) < len(robots):
            raise UsageError("two robots have the same id")
        return robots

    def _check_without_robust_filter(self, robots: Sequence[RobotSetup]) -> None:
        """Raise UsageError if one of the robots of an earlier version has that version's robust filter."""
        ids_with_robust_filter = frozenset(
            robot.id for robot in robots if robot.config.filter == Filter.ROBUST
        )
        if ids_with_robust_filter:
            raise self.error_in_line(
                f"robots {format_ids(ids_with_robust_filter)} have the robust filter of an earlier mcp-asdf, "
                f"which cannot be repeated here; {_USE_OTHER_VERSION}"
            )

    def _object_in(self, plain_header: dict[str, Any], key: str) -> dict[str, Any]:
        """Return the JSON object at a key of the header, or an empty one. Raises UsageError if it is none."""
        value = plain_header.get(key, {})
        if not isinstance(value, dict):
            raise self.error_in_line(f"{key} is {value!r}; it must be an object in braces")
        return value


def _open_text(path: Path) -> IO[str]:
    """Open a text, which may be compressed by gzip. Raises OSError if it cannot be read."""
    with path.open("rb") as file:
        is_compressed = file.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
    # Bytes that are no ASCII become escapes. These are no JSON, so their line is reported as malformed.
    if is_compressed:
        return gzip.open(path, "rt", encoding="ascii", errors="backslashreplace", newline="\n")
    return path.open(encoding="ascii", errors="backslashreplace", newline="\n")


def is_received_estimate(event: Event) -> bool:
    """Return whether an event is a received estimate, which is a list of sender, x_hat and alpha."""
    return isinstance(event, list) and len(event) == 3


def _is_event(event: Any) -> bool:
    """Return whether a JSON value is an event of a robot.

    That is the number of an ``Action``, "silent", "restart", or a list of two or three integers of 32 bits.
    """
    if isinstance(event, list):
        # An estimate is [sender, x_hat, alpha], a broadcast that a fault has changed [x_hat, alpha].
        if len(event) not in (2, 3):
            return False
        has_whole_numbers = all(map(_is_whole_number, event))
        return has_whole_numbers and max(event) <= _MAX_INTEGER
    if isinstance(event, str):
        return event in (SILENT, RESTART)
    # The numbers of actions are 0 to 3, and that of SETTLE is the last.
    return _is_whole_number(event) and event <= SETTLE


def _is_whole_number(value: Any) -> bool:
    """Return whether a JSON value is an integer of at least 0, and not true or false."""
    return type(value) is int and value >= 0  # for isinstance, a bool is an int, too
