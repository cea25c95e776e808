"""can-utils' candump reading along."""

from __future__ import annotations

import subprocess
from pathlib import Path

import can

from socketcan.vcan import connect
from support import PATIENCE, require, wait_until


def listeners(interface: str) -> int:
    """Return how many sockets receive all frames of an interface: the kernel has a line for each."""
    found = Path("/proc/net/can/rcvlist_all")
    lines = found.read_text(encoding="ascii").splitlines() if found.exists() else []  # until the first socket
    return sum(line.split()[:1] == [interface] for line in lines)


class Candump:
    """candump on an interface. A context manager: it hears all that is sent inside."""

    def __init__(self, vcan: str, folder: Path) -> None:
        self._vcan = vcan
        self._path = folder / "candump.log"

    def __enter__(self) -> Candump:
        command = [require("candump", "can-utils"), "-L", "-r", "4000000", self._vcan]
        others = listeners(self._vcan)
        with self._path.open("wb") as stream:
            self._process = subprocess.Popen(command, stdout=stream)
        wait_until(lambda: listeners(self._vcan) > others)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE)

    def frames(self) -> list[can.Message]:
        """Return all frames sent so far, in the order of the bus."""
        last = can.Message(arbitration_id=0x7FF, is_extended_id=False)  # which no robot sends
        with connect(self._vcan) as own:
            own.send(last, timeout=PATIENCE)
        wait_until(lambda: self._path.read_text(encoding="ascii").endswith("7FF#\n"))
        with can.LogReader(self._path) as reader:
            return [frame for frame in reader if frame.is_extended_id]
