"""Robots in processes of their own, each with its own connection to the bus, driven in lockstep."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup

_EXIT_TIMEOUT = 10.0
"""Seconds that a process has to end after SIGTERM."""


class NodeProcesses:
    """Processes of ``mcp-asdf node``. A context manager: entering starts them, leaving ends them all.

    Open the connection that commands them first, then wait until all are up::

        with can_bus as bus, NodeProcesses(robots, lambda robot: choice, Subjects(), 10) as nodes:
            lockstep = Lockstep(bus, check=nodes.check)
            lockstep.wait_until_up([robot.id for robot in robots], timeout=60)

    They end with this process, however it dies.

    Attributes:
        reports: What each node reported at its end, by robot id: ``mcp-asdf node --json``.
    """

    def __init__(
        self,
        robots: Sequence[RobotSetup],
        bus_of: Callable[[int], BusChoice],
        subjects: Subjects,
        steps_per_second: int,
    ) -> None:
        """Prepare a process for each of ``robots``, whose ids differ, on the bus that ``bus_of`` gives.

        A heartbeat is due every ``steps_per_second`` ticks. On SocketCAN this process and those it starts
        stay on one processor. Raises UsageError if a bus is inside this process.
        """
        self.reports: dict[int, dict[str, Any]] = {}
        self._processes: dict[int, subprocess.Popen[str]] = {}
        node_command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", "node", "--until-eof", "--json"]
        node_command += [
            f"--steps-per-second={steps_per_second}",
            f"--subject={subjects.estimates.subject}",
            f"--priority={subjects.estimates.priority}",
            f"--telemetry-subject={subjects.telemetry.subject}",
            f"--command-subject={subjects.commands.subject}",
        ]
        self._commands: dict[int, list[str]] = {}
        interfaces = set()
        for robot in robots:
            setup_option = f"--setup={json.dumps(robot.plain())}"
            bus_choice = bus_of(robot.id)
            self._commands[robot.id] = [*node_command, setup_option, *bus_choice.arguments()]
            interfaces.add(bus_choice.interface)
        if "socketcan" in interfaces:
            # A virtual CAN interface of Linux delivers a frame on the processor of its sender. With several
            # one robot may receive a command before the estimate that it followed; lockstep needs one order.
            _stay_on_one_processor()

    def __enter__(self) -> NodeProcesses:
        """Start all processes. They may not be up yet when this returns."""
        pipe = subprocess.PIPE
        for robot, command in self._commands.items():
            self._processes[robot] = subprocess.Popen(
                command,
                stdin=pipe,
                stdout=pipe,
                stderr=pipe,
                text=True,
                start_new_session=True,  # Ctrl-C is for this process, which then ends the others
            )
        return self

    def check(self) -> None:
        """Check that all processes still run. O(processes).

        Raises LockstepError, with the exit code and the error output, if one has ended.
        """
        for robot, process in self._processes.items():
            if process.poll() is not None:
                # Reading does not wait, as the process that writes there has ended.
                error_output = process.stderr.read().strip() if process.stderr else ""
                raise LockstepError(
                    f"the process of robot {robot} ended with exit code {process.returncode}: "
                    f"{error_output or 'no error output'}"
                )

    def __exit__(self, *_: object) -> None:
        """End all processes, and keep what they report; those that do not end in time are killed."""
        for process in self._processes.values():  # all are asked first, so that they end side by side
            process.terminate()
        for robot, process in self._processes.items():
            try:
                report, _error_output = process.communicate(timeout=_EXIT_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                report, _error_output = process.communicate()
            # A process that was killed, or failed early, has printed no report: its robot gets no entry.
            with suppress(ValueError):
                self.reports[robot] = json.loads(report)


def _stay_on_one_processor() -> None:
    """Let this process, and those it starts from now on, run on the first of its processors alone."""
    this_process = 0
    first_processor = min(os.sched_getaffinity(this_process))
    os.sched_setaffinity(this_process, {first_processor})
