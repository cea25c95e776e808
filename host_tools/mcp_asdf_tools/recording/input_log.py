"""Input log of a run: the events of each robot in a run, enough to run every robot again.

The input_log of ``run.log`` is ``run.log.events``, text, one JSON value a line. The first line describes the
run (`InputLogHeader`). Every other line is either

- ``[robot, event, ...]``: the next events of one robot, in order. Lines of different robots may come in
  any order, for robots share no state. An event is

  ===================== ================================================================================
  0, 1, 2               a tick began, in which it observed white, black, nothing
  3                     the tick ended (all four are the numbers of ``frames.Action``)
  [sender, x_hat, alpha] it took a message, which its firmware may have refused; raw integers as in
                        ``mcp_asdf_tools.bus.frames.Message``
  [x_hat, alpha]        its last broadcast went out with these false values (a fault), alpha in the binary32
                        bits of the frame
  "silent"              its last broadcast did not go out at all (a fault)
  "restart"             it started anew, as in the header
  ===================== ================================================================================

- ``"186BB92A#0000603333F307E5"``: a frame on the bus that no robot sent (a fault), as candump writes it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import can

from mcp_asdf_tools.bus.frames import FrameFormat, frame_as_text
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.recording.frame_logs import PART
from mcp_asdf_tools.robots.bus_robot import RESTART, SETTLE, SILENT, Event, Recorder
from mcp_asdf_tools.robots.record import RobotRecord

FORMAT = "mcp-asdf events"
VERSION = 2
"""1 had binary32 bits for alpha, and tables of another format."""
_MAX_WORD = 2**32 - 1


def input_log_path(log: Path | str) -> Path:
    """Path of the input log of a log; that of a part is a part."""
    path = Path(log)
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


class InputLogWriter:
    """Lines of an input log after its header, as events come.

    Attributes:
        robots: The recorder of each robot of the header, by id.
    """

    def __init__(self, header: InputLogHeader, write: Callable[[str], object]) -> None:
        """Pass each line to ``write``. Raises UsageError if two robots have one id."""
        ids = [robot.id for robot in header.robots]
        if len(set(ids)) < len(ids):
            raise UsageError(f"two robots have one id among {sorted(ids)}; give each an id of its own")
        self._write = write
        self.robots = {robot: Recorder(robot, write) for robot in ids}

    def injected(self, frame: can.Message) -> None:
        """``frame`` went over the bus, but no robot sent it."""
        self._write(f'"{frame_as_text(frame)}"\n')

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
        known = {robot.id for robot in self.header.robots}
        for content in self._contents:
            if isinstance(content, str):
                yield content
                continue
            if not (isinstance(content, list) and content and is_plain_int(content[0])):
                raise self.wrong("neither a robot with its events nor a frame")
            robot, *events = content
            if robot not in known:
                raise self.wrong(f"robot {robot} is not in the first line")
            for event in events:
                if not _is_event(event):
                    raise self.wrong(f"{event!r} is no event")
            yield robot, events

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
        if not isinstance(plain, dict) or plain.get("format") != FORMAT:
            raise self.wrong(f'"format": "{FORMAT}" is missing')
        if plain.get("version") != VERSION:
            raise self.wrong(
                f"the format is version {plain.get('version')}, and version {VERSION} is read here; replay "
                "the log with the mcp-asdf that wrote it, or record the run again"
            )
        try:
            robots = tuple(RobotRecord.from_plain(each) for each in plain["robots"])
            frames = FrameFormat(**plain["frames"])
            return InputLogHeader(robots, plain["seed"], frames, plain["parameters"], plain["versions"])
        except KeyError as error:
            raise self.wrong(f"{error} is missing") from error
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            raise self.wrong(str(error)) from error

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
