"""Events of one robot, in the form of an input log's lines."""

from __future__ import annotations

from collections.abc import Callable

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus import Action, frame_as_text
from mcp_asdf_tools.robots.firmwares import Words

SETTLE = 3
SILENT, RESTART = "silent", "restart"

_OBSERVED = {z: str(Action.observing(z).value) for z in (None, *Observation)}

Event = int | str | list[int]
"""One event in a line."""


class Recorder:
    """Recorder of one robot's events, that writes a line per settle."""

    def __init__(self, robot: int, write: Callable[[str], object]) -> None:
        self._head = f"[{robot}"
        self._parts = [self._head]
        self._write = write

    def observe(self, z: Observation | None) -> None:
        """The robot began a tick and observed ``z``, if anything."""
        self._parts.append(_OBSERVED[z])

    def receive(self, words: Words) -> None:
        """The robot took messages. O(messages)."""
        if len(words):
            self._parts.append(str(words.tolist())[1:-1].replace(" ", ""))

    def settle(self) -> None:
        """The robot ended the tick."""
        self._parts.append(str(SETTLE))
        self.flush()

    def silent(self) -> None:
        """The last broadcast did not go out."""
        self._parts.append(f'"{SILENT}"')

    def falsified(self, x_hat: int, alpha_bits: int) -> None:
        """The last broadcast went out with these values instead of the robot's own."""
        self._parts.append(f"[{x_hat},{alpha_bits}]")

    def restart(self) -> None:
        """The robot started anew."""
        self._parts.append(f'"{RESTART}"')

    def foreign(self, frame: can.Message) -> None:
        """Another node sent ``frame`` under the robot's id."""
        self._write(f'"{frame_as_text(frame)}"\n')

    def flush(self) -> None:
        """Write the events taken so far."""
        if len(self._parts) > 1:
            self._write(",".join(self._parts) + "]\n")
            self._parts = [self._head]
