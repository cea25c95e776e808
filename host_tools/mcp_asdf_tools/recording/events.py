"""The events of a run: how each robot started, and what it observed and received, in a file beside the log.

They are enough to run every robot again. The events of ``run.log`` are in ``run.log.events``, a text of one
JSON value a line, compressed by gzip. The first line describes the run (`EventsHeader`); what it lacks has
its default, only its robots have to be there. Every other line is either

- ``[robot, event, ...]``: the next events of one robot, in order. An event is

  ====================== ===============================================================================
  0, 1, 2                a tick began, in which the robot observed white, black, nothing
  3                      the tick ended (all four are the numbers of ``frame_layout.Action``)
  [sender, x_hat, alpha] it received an estimate, which its firmware may have refused; integers as in
                         ``mcp_asdf_tools.bus.frames.Estimate``
  [x_hat, alpha]         a fault gave its last broadcast these values, alpha as binary32 bits of the frame
  "silent"               a fault kept its last broadcast from the bus
  "restart"              it started anew, as in the header
  ====================== ===============================================================================

- ``"186BB92A#0000603333F307E5"``: a frame on the bus that no robot sent (a fault), as candump writes it.

Version 3 of the format is read, too. It is not compressed, and has ``"1b"`` for estimates that the file has
before: the last one of each sender whose bit is set in the hexadecimal mask, by rising id.
"""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

import can

from mcp_asdf.robot import MAX_ID, Observation
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import FrameFormat, format_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.recording.frame_logs import PART
from mcp_asdf_tools.robots.robot_setup import RobotSetup

FORMAT = "mcp-asdf events"
VERSION = 4
_READABLE_VERSIONS = (3, VERSION)
"""Version 1 had binary32 bits for alpha, and t-tables of another format; 2 had each estimate once a receiver,
without compression."""

Event = int | str | list[int]
"""One event as the file has it."""
SETTLE = Action.SETTLE.value
SILENT = "silent"
RESTART = "restart"

MAX_LINE_LENGTH = 2**24
"""Characters. A damaged or hostile file must not fill the memory with one line."""
_MAX_EVENTS_PER_LINE = 100_000
"""Events after which a robot's line is written before the tick ends: a flood of frames stays readable."""
_MAX_WORD = 2**32 - 1
_SENDER_MASK = re.compile(r"[0-9a-f]{1,32}")
_GZIP_MAGIC = b"\x1f\x8b"


def events_path(log: Path | str) -> Path:
    """Return the path of a log's events; those of a part are a part.

    Raises UsageError if the path is one of events itself.
    """
    path = Path(log)
    if path.suffix == ".events":
        raise UsageError(
            f"{path} is what happened to the robots of a log; give the log, {path.with_suffix('')}"
        )
    return Path(f"{path.with_suffix('')}.events{PART}" if path.suffix == PART else f"{path}.events")


@dataclass(frozen=True)
class EventsHeader:
    """Description of a run.

    Attributes:
        robots: The robots whose events follow; no two with one id.
        seed: Of everything random; None if nothing was.
        frames: Format of estimates.
        parameters: All settings of the run, for people who read the file.
        versions: Of the software.
    """

    robots: Sequence[RobotSetup]
    seed: int | None
    frames: FrameFormat
    parameters: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=software_versions)

    def to_line(self) -> str:
        """Return the first line of a file of events. Raises ValueError for a parameter that JSON lacks."""
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


class EventRecorder:
    """Recorder of one robot's events: a line each time that the robot ends a tick."""

    def __init__(self, robot_id: int, write_line: Callable[[str], object]) -> None:
        self._robot_id = robot_id
        self._write_line = write_line
        self._events: list[Event] = []

    def record_observation(self, z: Observation | None) -> None:
        """Record that a tick began, in which the robot observed ``z``, or nothing."""
        self._events.append(Action.to_observe(z).value)

    def record_estimates(self, estimates: Sequence[list[int]]) -> None:
        """Record that the robot received estimates: sender, x_hat and alpha each. O(estimates)."""
        self._events += estimates
        if len(self._events) > _MAX_EVENTS_PER_LINE:
            self.flush()

    def record_settle(self) -> None:
        """Record that the robot ended the tick."""
        self._events.append(SETTLE)
        self.flush()

    def record_restart(self) -> None:
        """Record that the robot started anew."""
        self._events.append(RESTART)

    def record_silence(self) -> None:
        """Record that the last broadcast did not go out."""
        self._events.append(SILENT)

    def record_false_values(self, x_hat: int, alpha_bits: int) -> None:
        """Record that the last broadcast went out with these values instead of the robot's."""
        self._events.append([x_hat, alpha_bits])

    def record_foreign_frame(self, frame: can.Message) -> None:
        """Record a frame that another node sent under the robot's id."""
        self._write_line(_line_of_frame(frame))

    def flush(self) -> None:
        """Write the events recorded so far, if there are any."""
        if self._events:
            self._write_line(json.dumps([self._robot_id, *self._events], separators=(",", ":")) + "\n")
            self._events = []


class EventsWriter:
    """Writer of all lines of events after the header.

    Attributes:
        recorders: The recorder of each robot of the header, by id.
    """

    def __init__(self, header: EventsHeader, write_line: Callable[[str], object]) -> None:
        """Create a recorder for each robot of ``header``; ``write_line`` gets each line with its end."""
        self._write_line = write_line
        self.recorders = {robot.id: EventRecorder(robot.id, write_line) for robot in header.robots}

    def record_injected_frame(self, frame: can.Message) -> None:
        """Record a frame on the bus that no robot sent."""
        self._write_line(_line_of_frame(frame))

    def finish(self) -> None:
        """Write what robots have recorded of ticks that have not ended."""
        for recorder in self.recorders.values():
            recorder.flush()


def _line_of_frame(frame: can.Message) -> str:
    return f'"{format_frame(frame)}"\n'


# --- Reading ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RobotEvents:
    """The next events of one robot."""

    robot_id: int
    events: Sequence[Event]


@dataclass(frozen=True)
class InjectedFrame:
    """A frame that no robot sent, as candump writes it."""

    text: str


class EventsReader:
    """Reader of a file of events. A context manager, which closes the file.

    Attributes:
        header: Description of the run.
        is_part: Whether the run was cut off: a last line without an end is left out then.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file and read its header. Raises UsageError if it is missing or malformed."""
        self._path = Path(path)
        self.is_part = self._path.suffix == PART
        self._line_number = 1
        try:
            self._file = _open_text(self._path)
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror}") from error
        self._values = self._read_values()
        try:
            self.header = self._parse_header(next(self._values, None))
        except UsageError:
            self._file.close()
            raise

    def __enter__(self) -> EventsReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def entries(self) -> Iterator[RobotEvents | InjectedFrame]:
        """Yield what the lines after the header hold. Raises UsageError, naming the line, if one is wrong."""
        robot_ids = {robot.id for robot in self.header.robots}
        last_estimates: dict[int, list[int]] = {}
        for value in self._values:
            if isinstance(value, str):
                yield InjectedFrame(value)
                continue
            if not (isinstance(value, list) and value and is_plain_int(value[0])):
                raise self.error("neither a robot with its events nor a frame")
            robot_id, *plain_events = value
            if robot_id not in robot_ids:
                raise self.error(f"robot {robot_id} is not in the first line")
            events: list[Event] = []
            for plain_event in plain_events:
                events += self._parse_event(plain_event, last_estimates)
            yield RobotEvents(robot_id, events)

    def error(self, text: str) -> UsageError:
        """Return an error that names the line read last."""
        return UsageError(f"{self._path}, line {self._line_number}: {text}")

    def _parse_event(self, event: Any, last_estimates: dict[int, list[int]]) -> Sequence[Event]:
        """Return the event, or the estimates that a mask of version 3 stands for.

        An estimate is noted in ``last_estimates``, by its sender, for the masks that follow.
        """
        if isinstance(event, str) and _SENDER_MASK.fullmatch(event):
            mask = int(event, 16)
            senders = [sender for sender in range(MAX_ID + 1) if mask >> sender & 1]
            if not last_estimates.keys() >= set(senders):
                raise self.error(f"{event!r} refers to a robot of which no message is told before")
            return [last_estimates[sender] for sender in senders]
        if not _is_event(event):
            raise self.error(f"{event!r} is no event")
        if isinstance(event, list) and len(event) == 3:
            last_estimates[event[0]] = event
        return (event,)

    def _read_values(self) -> Iterator[Any]:
        """Yield the JSON value of each line. Raises UsageError for a line that has none."""
        for line in self._read_lines():
            try:
                value = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise self.error(f"not JSON ({error}); was the file cut?") from error
            yield value

    def _read_lines(self) -> Iterator[str]:
        """Yield the lines of the file, of a part those that are complete.

        Raises UsageError if the file is damaged, or cut off and no part.
        """
        line_number = 0
        while True:
            line_number += 1
            try:
                line = self._file.readline(MAX_LINE_LENGTH + 1)
            except EOFError as error:  # the end of the compressed data is missing
                if self.is_part:
                    return
                self._line_number = line_number
                raise self.error("the file ends here, in the middle; was it cut?") from error
            except (OSError, zlib.error) as error:
                self._line_number = line_number
                raise self.error(f"the file is damaged here: {error}") from error
            if not line or (self.is_part and not line.endswith("\n")):
                return
            self._line_number = line_number
            if len(line) > MAX_LINE_LENGTH:
                raise self.error(f"not JSON of at most {MAX_LINE_LENGTH} characters")
            yield line

    def _parse_header(self, plain: Any) -> EventsHeader:
        """Return the description of a run. A setting that it lacks is newer, and has its default."""
        if not isinstance(plain, dict) or plain.get("format") != FORMAT:
            raise self.error(f'"format": "{FORMAT}" is missing')
        if plain.get("version") not in _READABLE_VERSIONS:
            versions = " and ".join(map(str, _READABLE_VERSIONS))
            raise self.error(
                f"the format is version {plain.get('version')}, and versions {versions} are read here; "
                "replay the log with the mcp-asdf that wrote it, or record the run again"
            )
        try:
            robots = tuple(RobotSetup.from_plain(plain_robot) for plain_robot in plain["robots"])
            frames = FrameFormat(**plain.get("frames", {}))
        except KeyError as error:
            raise self.error(f"{error} is missing") from error
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            raise self.error(str(error)) from error
        parameters, software = plain.get("parameters", {}), plain.get("versions", {})
        for name, value in (("parameters", parameters), ("versions", software)):
            if not isinstance(value, dict):
                raise self.error(f"{name} is {value!r}; it must be an object in braces")
        if len({robot.id for robot in robots}) < len(robots):
            raise self.error("two robots have the same id")
        return EventsHeader(robots, plain.get("seed"), frames, parameters, software)


def _open_text(path: Path) -> IO[str]:
    """Open a text that may be compressed. Raises OSError if it cannot be read."""
    with path.open("rb") as file:
        is_compressed = file.read(2) == _GZIP_MAGIC
    # Bytes that are no ASCII become escapes, which are no JSON, so the line with them is reported.
    if is_compressed:
        return gzip.open(path, "rt", encoding="ascii", errors="backslashreplace", newline="\n")
    return path.open(encoding="ascii", errors="backslashreplace", newline="\n")


def _is_event(event: Any) -> bool:
    """Return whether a JSON value is an event."""
    if isinstance(event, list):
        return len(event) in (2, 3) and all(map(is_plain_int, event)) and max(event) <= _MAX_WORD
    if isinstance(event, str):
        return event in (SILENT, RESTART)
    return is_plain_int(event) and event <= SETTLE


def is_plain_int(value: Any) -> bool:
    """Return whether a JSON value is an integer >= 0; a bool, which Python counts as one, is not."""
    return type(value) is int and value >= 0
