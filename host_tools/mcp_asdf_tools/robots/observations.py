"""Sources of a robot's observations: the emulated world, or lines of a file or of standard input."""

from __future__ import annotations

import os
import select
from collections import deque
from pathlib import Path
from typing import Protocol

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common import UsageError, standard_input
from mcp_asdf_tools.world import World, WorldSettings

_OF_LINE = {b"0": Observation.WHITE, b"1": Observation.BLACK, b"-": None}


class ObservationSource(Protocol):
    """Source of a robot's observations, tick by tick."""

    def next(self, seconds: float) -> Observation | None:
        """The observation of the next tick, None for a tick without one.

        Raises TimeoutError if it has not come within ``seconds``, EOFError if there will be no more.
        """

    def close(self) -> None:
        """Release the input."""


class WorldSource:
    """Observations of robot ``robot`` in the emulated world, as in any other tool with this seed."""

    def __init__(self, robot: int, fill_ratio: float, true_accuracy: float, seed: int) -> None:
        """Put a robot into the world. Raises UsageError if a number is out of range."""
        settings = WorldSettings(
            robots=robot + 1, fill_ratio=fill_ratio, true_accuracy=true_accuracy, seed=seed
        )
        self._world = World(settings)
        self._robot = robot

    def next(self, seconds: float) -> Observation | None:
        """The next observation."""
        return self._world.step()[self._robot]

    def close(self) -> None:
        """Do nothing."""


class LineSource:
    """Lines 0 (white), 1 (black) or - (nothing this tick), from a file, a pipe or a terminal as they come."""

    def __init__(self, name: str) -> None:
        """Open the file ``name``, or standard input if that is ``-``.

        Raises UsageError if it cannot be opened.
        """
        self._name = "standard input" if name == "-" else name
        self._is_own = name != "-"
        try:
            # Unbuffered: select() would not see input that Python has read ahead.
            self._fd = os.open(Path(name), os.O_RDONLY) if self._is_own else standard_input()
        except OSError as error:
            raise UsageError(f"cannot read observations from {self._name}: {error.strerror}") from error
        self._lines: deque[bytes] = deque()
        self._rest = b""
        self._has_ended = False
        self._number = 0

    def next(self, seconds: float) -> Observation | None:
        """The next line's observation. Raises UsageError for a malformed line, else as the protocol."""
        if not self._lines and not self._has_ended:
            self._read(seconds)
        if not self._lines:
            raise EOFError if self._has_ended else TimeoutError
        self._number += 1
        line = self._lines.popleft().strip()
        if line not in _OF_LINE:
            raise UsageError(
                f"{self._name}, line {self._number}: {line.decode(errors='replace')!r} is no observation; "
                "give 0 (white), 1 (black) or - (nothing)"
            )
        return _OF_LINE[line]

    def close(self) -> None:
        """Close the file; standard input stays open."""
        if self._is_own:
            os.close(self._fd)

    def _read(self, seconds: float) -> None:
        if not select.select([self._fd], [], [], seconds)[0]:
            return
        try:
            read = os.read(self._fd, 1 << 16)
        except OSError as error:
            raise UsageError(f"cannot read observations from {self._name}: {error}") from error
        *lines, self._rest = (self._rest + read).split(b"\n")
        if not read:
            self._has_ended = True
            lines = [self._rest] if self._rest else []
        self._lines.extend(lines)
