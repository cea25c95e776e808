"""Python nodes on a real bus, each with a thread and a socket of its own, and who drives them all."""

from __future__ import annotations

import threading
from types import TracebackType

from mcp_asdf_tools.robots.node import send_all
from socketcan.vcan import Vcan
from support import PATIENCE
from targets.c_node import twin


class PythonNode:
    """A Python node in lockstep, on integers. A context manager: inside, it is on the bus."""

    def __init__(self, vcan: Vcan, robot_id: int, b_hat: float, filter_period: int) -> None:
        self.node = twin(robot_id, b_hat, filter_period=filter_period)
        self._bus = vcan.bus()
        self._thread = threading.Thread(target=self._run)
        self._is_over = False

    def __enter__(self) -> PythonNode:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over = True
        self._thread.join()
        self._bus.shutdown()

    def _run(self) -> None:
        send_all(self._bus, self.node.start(), PATIENCE)
        while not self._is_over:
            frame = self._bus.recv(0.05)
            if frame is not None:
                send_all(self._bus, self.node.hear(frame), PATIENCE)
