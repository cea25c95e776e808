"""Everything that one robot saw, heard and did, as the lines of a sidecar have it."""

from __future__ import annotations

from collections.abc import Callable

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus import Action, frame_as_text

SETTLE = 3


SILENT, RESTART = "silent", "restart"


Event = int | str | list[int]
"""One event as the lines have it."""


class Recorder:
    """Takes one robot's events, each in O(1), and passes them on in lines, one a settle."""

    def __init__(self, robot: int, write: Callable[[str], object]) -> None:
        self._head = f"[{robot}"
        self._parts = [self._head]
        self._write = write

    def observe(self, z: Observation | None) -> None:
        """It began a tick and observed ``z``, if anything."""
        self._parts.append(str(Action.observing(z).value))

    def receive(self, sender: int, x_hat: int, alpha: int) -> None:
        """It was given a message of these raw values."""
        self._parts.append(f"[{sender},{x_hat},{alpha}]")

    def settle(self) -> None:
        """It ended the tick."""
        self._parts.append(str(SETTLE))
        self.flush()

    def silent(self) -> None:
        """The broadcast of its last tick does not go out."""
        self._parts.append(f'"{SILENT}"')

    def falsified(self, x_hat: int, alpha_bits: int) -> None:
        """The broadcast of its last tick goes out with these values instead of its own."""
        self._parts.append(f"[{x_hat},{alpha_bits}]")

    def restart(self) -> None:
        """It starts anew."""
        self._parts.append(f'"{RESTART}"')

    def foreign(self, frame: can.Message) -> None:
        """``frame`` went over the bus under its id, and it was another that sent it."""
        self._write(f'"{frame_as_text(frame)}"\n')

    def flush(self) -> None:
        """Pass on what was taken so far."""
        if len(self._parts) > 1:
            self._write(",".join(self._parts) + "]\n")
            self._parts = [self._head]
