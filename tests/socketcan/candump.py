"""can-utils' candump reading along."""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path
from types import TracebackType

import can

from socketcan.vcan import Vcan
from support import PATIENCE, require

_LINE = re.compile(r"\(\d+\.\d+\) (\S+) ([0-9A-F]+)#([0-9A-F]*)( [TR])?\n")


def listeners(interface: str) -> int:
    """How many sockets that hear everything are on the interface: the kernel has a line for each."""
    found = Path("/proc/net/can/rcvlist_all")
    lines = found.read_text(encoding="ascii").splitlines() if found.exists() else []  # until the first socket
    return sum(line.split()[:1] == [interface] for line in lines)


class Candump:
    """candump on an interface. A context manager: it hears all that is sent inside."""

    def __init__(self, vcan: Vcan, folder: Path) -> None:
        self._vcan = vcan
        self._path = folder / "candump.log"

    def __enter__(self) -> Candump:
        command = [require("candump", "can-utils"), "-L", "-r", "4000000", self._vcan.name]
        others = listeners(self._vcan.name)
        with self._path.open("wb") as stream:
            self._process = subprocess.Popen(command, stdout=stream)
        deadline = time.monotonic() + PATIENCE
        while listeners(self._vcan.name) == others:
            assert time.monotonic() < deadline and self._process.poll() is None, "candump does not listen"
            time.sleep(0.02)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE)

    def lines(self) -> list[str]:
        """All frames sent so far, in the order of the bus, each as ``ID#DATA``."""
        with self._vcan.socket() as own:
            own.send(_LAST)
        deadline = time.monotonic() + PATIENCE
        while not self._path.read_text(encoding="ascii").endswith("7FF#\n"):
            assert time.monotonic() < deadline, "candump does not write"
            time.sleep(0.02)
        lines = self._path.read_text(encoding="ascii").splitlines(keepends=True)
        found = [match for line in lines if (match := _LINE.fullmatch(line))]
        assert len(found) == len(lines)
        return [f"{match[2]}#{match[3]}" for match in found if match[2] != "7FF"]

    def frames(self) -> list[can.Message]:
        """The same as frames; of those that are not extended data frames there must be none."""
        parts = [line.split("#") for line in self.lines()]
        return [can.Message(arbitration_id=int(name, 16), data=bytes.fromhex(data)) for name, data in parts]


_LAST = b"\xff\x07\0\0" + bytes(12)
"""An empty frame with the lowest priority there is: no robot sends it."""
