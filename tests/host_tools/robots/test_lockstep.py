"""Robots driven in lockstep: what the driver makes of their answers, and robots in processes of their own.

What a robot makes of commands is that of the C node (tests/targets), of which tests/c_ref has the rules.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import can
import pytest

from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    Command,
    FrameFormat,
    Telemetry,
    decode_command,
    decode_telemetry,
)
from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli.node import setup_of
from mcp_asdf_tools.cli.options import bus_of, subjects_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots import processes
from mcp_asdf_tools.robots.lockstep import Lockstep, LockstepError
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.processes import NodeProcesses
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import wait_until
from wire import CLOCK, EndlessWire, Wire, frozen_clock, make_node, setup_of_robot

# Driving


def decode(frame: can.Message) -> Command:
    """Return the command in a frame of the driver."""
    command = decode_command(frame, COMMAND_FORMAT)
    assert isinstance(command, Command)
    return command


def is_telemetry(frame: can.Message) -> bool:
    return isinstance(decode_telemetry(frame), Telemetry)


class LossyWire(Wire):
    """A wire that loses commands of the driver, and telemetry of the nodes.

    Attributes:
        read_count: How often the driver has read from it.
    """

    def __init__(
        self,
        *nodes: RobotNode,
        is_lost: Callable[[Command, int], bool] = lambda command, times_sent: False,
        lost_telemetry: int = -1,
    ) -> None:
        """Create a wire to some nodes.

        ``is_lost`` decides on each command, with how often it has been sent. Each node loses
        one telemetry frame, number ``lost_telemetry``.
        """
        self.read_count = 0
        self._is_lost = is_lost
        self._lost_telemetry = lost_telemetry
        self._times_sent = Counter[tuple[int, int, Action]]()
        super().__init__(*nodes)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        command = decode(msg)
        key = (command.tick, command.target, command.action)
        self._times_sent[key] += 1
        if self._is_lost(command, self._times_sent[key]):
            self.sent.append(msg)
        else:
            super().send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.read_count += 1
        return super().recv(timeout)

    def send_from(self, node: RobotNode, frames: Sequence[can.Message]) -> None:
        is_answer_lost = node.sent.telemetry == self._lost_telemetry and any(map(is_telemetry, frames))
        super().send_from(node, [] if is_answer_lost else frames)


EIGHT_LOST_COMMANDS = {
    *((5, 1, "OBSERVE"), (5, 2, "OBSERVE"), (5, 3, "OBSERVE"), (9, 1, "OBSERVE"), (20, 1, "OBSERVE")),
    *((9, 1, "SETTLE"), (20, 2, "SETTLE"), (20, 3, "SETTLE")),
}
"""Commands that are lost when they are sent first: tick, robot and the beginning of the action's name."""


def is_first_try_of_one_of_eight_commands(command: Command, times_sent: int) -> bool:
    action, _, _ = command.action.name.partition("_")
    return times_sent == 1 and (command.tick, command.target, action) in EIGHT_LOST_COMMANDS


FOUR_ROBOTS = range(4)


def make_four_nodes() -> list[RobotNode]:
    return [make_node(robot, "native", 0.55 + 0.1 * robot) for robot in FOUR_ROBOTS]


def run_four_robots(lockstep: Lockstep, ticks: int) -> None:
    """Drive four robots, which see black in every tick, and wait for their broadcasts, two by two."""
    for _ in range(ticks):
        lockstep.observe(dict.fromkeys(FOUR_ROBOTS, Observation.BLACK))
        lockstep.wait_for_estimates((0, 1))
        lockstep.wait_for_estimates((2, 3))
        lockstep.settle(FOUR_ROBOTS)


@frozen_clock()
def test_a_lost_command_is_sent_once_more_to_the_robots_that_have_not_answered() -> None:
    """Each of 4 robots gets two commands in each of 25 ticks. Eight are lost, and are sent once more.

    A command that is repeated to a robot that has obeyed it would count as disobeyed.
    """
    wire = LossyWire(*make_four_nodes(), is_lost=is_first_try_of_one_of_eight_commands)
    lockstep = Lockstep(wire, timeout=0.02)

    run_four_robots(lockstep, ticks=25)

    assert lockstep.repeated == 8
    assert len(wire.sent) == 25 * 4 * 2 + 8
    for robot in wire.nodes:
        assert robot.unsettled == 0, "ticks without a command to settle"
        assert robot.disobeyed == 0, "commands that came in vain"
        assert robot.robot.t == 25, "observations"


@frozen_clock()
def test_the_transfer_ids_of_commands_count_modulo_32() -> None:
    """The commands to all robots share one count. Each of 4 robots gets two commands in each of 20 ticks."""
    wire = Wire(*make_four_nodes())
    run_four_robots(Lockstep(wire), ticks=20)

    transfer_ids = [decode(frame).transfer_id for frame in wire.sent]
    number_of_commands = 4 * 2 * 20
    assert transfer_ids == [number % 32 for number in range(number_of_commands)]


@frozen_clock()
def test_the_driver_reports_all_frames_that_it_sends_and_receives() -> None:
    """``on_frame`` gets them in their order. Received ones are marked (``is_rx``), and sent ones are not."""
    wire = Wire(*make_four_nodes())
    reported_frames: list[can.Message] = []
    run_four_robots(Lockstep(wire, on_frame=reported_frames.append), ticks=10)

    frames_of_robots, frames_of_driver = wire.frames_of_nodes, wire.sent
    assert [frame for frame in reported_frames if frame.is_rx] == frames_of_robots
    assert [frame for frame in reported_frames if not frame.is_rx] == frames_of_driver


def drive_robot_1(lockstep: Lockstep, ticks: int) -> None:
    """Drive robot 1, and wait for its answers but not for its broadcasts."""
    for _ in range(ticks):
        lockstep.observe({1: Observation.WHITE})
        lockstep.settle({1})


@pytest.mark.parametrize(
    ("expected_robots", "silent_robots"),
    [({0, 2, 4, 5}, "robot 4, 5"), (set(range(10, 20)), "robot 10, 11, 12, 13, 14, 15, 16, 17, ...")],
)
@frozen_clock()
def test_robots_that_send_no_heartbeat_are_named_in_the_error(
    expected_robots: set[int], silent_robots: str
) -> None:
    """Only robots 0 and 2 are on the bus. The error names eight at most, the time, and the bus, "wire".

    The text ``silent_robots`` has the ids of the robots that are waited for in vain.
    """
    lockstep = Lockstep(Wire(make_node(0), make_node(2)))
    message = re.escape(f"{silent_robots} did not send a heartbeat within 0.01 s on wire")
    with pytest.raises(LockstepError, match=message):
        lockstep.wait_until_up(expected_robots, timeout=0.01)


@frozen_clock()
def test_a_heartbeat_of_an_earlier_wait_does_not_show_that_a_robot_is_up() -> None:
    """The robot sends a heartbeat when it starts, and then none, since no tick passes."""
    lockstep = Lockstep(Wire(make_node(1)))
    lockstep.wait_until_up({1}, timeout=0.01)
    with pytest.raises(LockstepError, match="robot 1 did not send a heartbeat"):
        lockstep.wait_until_up({1}, timeout=0.01)


@frozen_clock()
def test_no_command_is_repeated_while_a_heartbeat_is_waited_for() -> None:
    """A robot that gets the last command of its last tick again could take it for one of the next tick."""
    wire = Wire(make_node(1))
    lockstep = Lockstep(wire)
    drive_robot_1(lockstep, ticks=1)
    commands_of_tick = list(wire.sent)
    with pytest.raises(LockstepError, match="robot 1 did not send a heartbeat"):
        lockstep.wait_until_up({1}, timeout=0.01)
    assert wire.sent == commands_of_tick


@frozen_clock()
def test_a_robot_that_does_not_broadcast_or_does_not_end_its_tick_is_named_in_the_error() -> None:
    """Robots 0 and 2 do so, and robot 1 is not on the bus. LockstepError names it and the time limit."""
    lockstep = Lockstep(Wire(make_node(0), make_node(2)), timeout=0.02)
    lockstep.observe({0: Observation.WHITE, 1: Observation.WHITE, 2: Observation.WHITE})
    with pytest.raises(LockstepError, match=r"robot 1 did not broadcast its estimate within 0.02 s"):
        lockstep.wait_for_estimates({0, 1, 2})
    with pytest.raises(LockstepError, match=r"robot 1 did not settle within 0.02 s"):
        lockstep.settle({0, 1, 2})


@frozen_clock()
def test_an_estimate_that_has_come_while_another_robot_was_waited_for_is_not_lost() -> None:
    """The estimate of robot 0 is on the bus before that of robot 2, for which the driver waits first.

    The next call returns the estimate of robot 0.
    """
    lockstep = Lockstep(Wire(make_node(0), make_node(2)), timeout=0.02)
    lockstep.observe({0: Observation.WHITE, 2: Observation.WHITE})
    estimates_waited_for_first = lockstep.wait_for_estimates({2})
    estimates_waited_for_next = lockstep.wait_for_estimates({0})
    assert estimates_waited_for_first.keys() == {2}
    assert estimates_waited_for_next.keys() == {0}


@frozen_clock()
def test_an_estimate_of_the_last_tick_is_not_taken_for_one_of_this_tick() -> None:
    """The robot broadcasts in the second tick and not in the third, for which LockstepError is raised."""
    lockstep = Lockstep(Wire(make_node(1, comms_period=2)), timeout=0.02)
    drive_robot_1(lockstep, ticks=2)
    lockstep.observe({1: Observation.WHITE})

    with pytest.raises(LockstepError, match="robot 1 did not broadcast"):
        lockstep.wait_for_estimates({1})


@frozen_clock()
def test_a_robot_can_be_driven_by_a_second_driver_without_a_restart() -> None:
    """Each driver counts its ticks from 0. The robot has done all six ticks of both."""
    robot = make_node(1)
    first_driver = Lockstep(Wire(robot), timeout=0.02)
    drive_robot_1(first_driver, ticks=3)
    second_driver = Lockstep(Wire(robot), timeout=0.02)
    drive_robot_1(second_driver, ticks=3)
    assert robot.ticks == 3 + 3


@frozen_clock()
def test_a_robot_that_restarts_while_it_is_driven_is_an_error() -> None:
    """It answers ticks 0 to 2 with the transfer_ids 0 to 2. After its restart it answers tick 3 with 0 again.

    LockstepError says that 3 would be the next transfer_id.
    """
    wire = Wire(make_node(1))
    lockstep = Lockstep(wire, timeout=0.02)
    drive_robot_1(lockstep, ticks=3)
    restarted_robot = make_node(1)
    wire.nodes = [restarted_robot]

    with pytest.raises(LockstepError, match=r"in tick 3 with transfer_id 0, not 3 .*restarted"):
        drive_robot_1(lockstep, ticks=1)


class StopWaitingError(Exception):
    """The caller of the driver does not want to wait any longer."""


def stop_waiting() -> None:
    raise StopWaitingError


@pytest.mark.parametrize("kind_of_wire", [Wire, EndlessWire], ids=["quiet bus", "busy bus"])
@frozen_clock()
def test_the_caller_can_end_the_wait_for_heartbeats_and_for_answers(kind_of_wire: type[Wire]) -> None:
    """The driver calls ``check``, a function of the caller, while it waits. Its error ends the wait.

    Robot 2 is not on the bus, and the timeouts are 1e9 s. On a busy bus another node sends without end.
    """
    lockstep = Lockstep(kind_of_wire(make_node(1)), timeout=1e9, check=stop_waiting)
    with pytest.raises(StopWaitingError):
        lockstep.wait_until_up({2}, timeout=1e9)

    lockstep.observe({1: Observation.WHITE, 2: Observation.WHITE})
    with pytest.raises(StopWaitingError):
        lockstep.settle({2})


@frozen_clock()
def test_a_wait_ends_after_twice_the_time_on_a_bus_that_is_never_quiet() -> None:
    """The time limit is 1 s, and the error comes after 2 s. Another node sends every 0.01 s without end.

    A limit of its own for such a bus lets the driver read a long queue of frames, and yet ends the wait.
    """
    endless_wire = EndlessWire(make_node(1))
    start = CLOCK.now
    with pytest.raises(LockstepError, match="robot 3 did not send a heartbeat within 1 s"):
        Lockstep(endless_wire).wait_until_up({3}, timeout=1.0)
    assert 2 <= CLOCK.now - start < 2.1


def is_for_robot_2_in_tick_7(command: Command, action: str) -> bool:
    """Return whether a command is for robot 2 and tick 7, and its action has a name that begins so."""
    return command.tick == 7 and command.target == 2 and command.action.name.startswith(action)


def wire_that_loses_commands_to_robot_2_in_tick_7(action: str) -> LossyWire:
    """Return a wire to three robots that loses commands with this action each time they are sent."""
    return LossyWire(
        make_node(1),
        make_node(2),
        make_node(3),
        is_lost=lambda command, times_sent: is_for_robot_2_in_tick_7(command, action),
    )


def drive_robots_1_to_3(wire: Wire) -> None:
    """Drive the three robots on a wire for 10 ticks."""
    lockstep = Lockstep(wire, timeout=0.02)
    for _ in range(10):
        lockstep.observe({1: Observation.WHITE, 2: Observation.WHITE, 3: Observation.WHITE})
        lockstep.wait_for_estimates({1, 2, 3})
        lockstep.settle({1, 2, 3})


@pytest.mark.parametrize(
    ("lost_action", "expected_message"),
    [
        ("OBSERVE", "robot 2 did not broadcast its estimate within"),
        ("SETTLE", "robot 2 did not settle within"),
    ],
)
@frozen_clock()
def test_a_command_that_is_lost_is_sent_twice_before_the_robot_is_named_in_the_error(
    lost_action: str, expected_message: str
) -> None:
    """A command to robot 2 in tick 7, to observe or to settle, is lost both times that it is sent.

    Then LockstepError names robot 2. Robots 1 to 3 are driven.
    """
    wire = wire_that_loses_commands_to_robot_2_in_tick_7(lost_action)

    with pytest.raises(LockstepError, match=expected_message):
        drive_robots_1_to_3(wire)

    lost_frames = [frame for frame in wire.sent if is_for_robot_2_in_tick_7(decode(frame), lost_action)]
    assert len(lost_frames) == 2


@frozen_clock()
def test_the_driver_waits_for_an_answer_instead_of_reading_again_and_again() -> None:
    """Robot 2 does not answer in tick 7. The driver waits 0.02 s for it, its time limit.

    The clock goes on only while the driver waits. In all 8 ticks it reads fewer than 1000 times.
    """
    wire = wire_that_loses_commands_to_robot_2_in_tick_7("SETTLE")
    start = CLOCK.now

    with pytest.raises(LockstepError, match="robot 2 did not settle"):
        drive_robots_1_to_3(wire)

    assert wire.read_count < 1000
    assert 0.02 <= CLOCK.now - start < 0.021


@frozen_clock()
def test_an_answer_that_is_lost_is_an_error_and_does_not_make_a_robot_settle_twice() -> None:
    """A robot answers a command to end a tick with telemetry. The eighth telemetry of each is lost.

    They get the command to end tick 7 once more, and neither obey it nor answer it again. LockstepError names
    all three.
    """
    wire = LossyWire(make_node(1), make_node(2), make_node(3), lost_telemetry=8)

    with pytest.raises(LockstepError, match="robot 1, 2, 3 did not settle within"):
        drive_robots_1_to_3(wire)

    for robot in wire.nodes:
        assert robot.ticks == 8, "ticks that it has done, 0 to 7"
        assert robot.sent.telemetry == 8
        assert robot.disobeyed == 1, "the repeated command"


@frozen_clock()
def test_a_robot_ends_a_tick_that_was_left_open_when_it_observes_again() -> None:
    """The robot gets no command to end tick 0, nor one to end tick 1, which is followed by tick 8.

    ``skip_settle`` lets the driver go on by a number of ticks without such a command. The robot broadcasts an
    estimate in every second tick that it takes part in, which is tick 1.
    """
    robot = make_node(1, comms_period=2)
    wire = Wire(robot)
    lockstep = Lockstep(wire)

    lockstep.observe({1: Observation.WHITE})
    lockstep.skip_settle(distance=1)
    lockstep.observe({1: Observation.WHITE})
    lockstep.skip_settle(distance=7)
    drive_robot_1(lockstep, ticks=1)

    assert [decode(frame).tick for frame in wire.sent] == [0, 1, 8, 8]  # three to observe, one to settle
    assert lockstep.tick == 9
    assert robot.unsettled == 2, "ticks that ended without a command"
    assert robot.robot.t == 3, "observations"
    assert robot.sent.estimates == 1


def test_a_robot_with_the_id_of_the_driver_is_refused() -> None:
    """The simulator, which drives robots, has the id 126. The error names it."""
    lockstep = Lockstep(Wire())
    with pytest.raises(UsageError, match="robot 126 has the id of the simulator"):
        lockstep.observe({126: Observation.WHITE})


def test_two_kinds_of_messages_with_the_same_subject_number_are_refused() -> None:
    """Estimates get the subject 3001, which telemetry has by default; commands have 3002.

    The error lists all three.
    """
    with pytest.raises(UsageError, match=r"subjects \[3001, 3001, 3002\]; choose three different"):
        Subjects(estimates=FrameFormat(3001))


# Processes


SETUPS = (
    # 0.1 + 0.2 is 0.30000000000000004, which is the same again only with all its digits.
    setup_of_robot(0, b_hat=0.1 + 0.2, table=generate(parse_omega("0.3"), 3)),
    setup_of_robot(7, "mirror", filter=Filter.ALWAYS, table=None, comms_period=2, memory=64),
    setup_of_robot(8, filter=Filter.ROBUST, table=None),
    replace(
        setup_of_robot(9, "reference", b_hat=2**-20, filter=Filter.OFF, table=None),
        allow=frozenset((0, 2, 3)),
    ),
)


def parse_node_command(command: list[str]) -> argparse.Namespace:
    """Return the parsed arguments of a command ``python -m mcp_asdf_tools.cli.main node --setup=...``."""
    _python, _m, _module, name, *options = command
    return cli._parser_for(name, cli._load(name)).parse_all(options)


@pytest.mark.parametrize("setup", SETUPS)
def test_the_command_line_of_a_robot_s_process_has_all_settings_of_the_robot(setup: RobotSetup) -> None:
    """Parsed again, it gives the same robot on the same bus. It ends with its input and reports in JSON.

    The three kinds of messages have other subjects and priorities than by default.
    """
    bus_choice = BusChoice("udp_multicast", {"channel": "239.1.1.1"})
    subjects = Subjects(
        estimates=FrameFormat(subject=7, priority=1),
        telemetry=FrameFormat(subject=8, priority=6),
        commands=FrameFormat(subject=9, priority=3),
    )

    def bus_of_robot(robot: int) -> BusChoice:
        return bus_choice

    nodes = NodeProcesses([setup], bus_of_robot, subjects, steps_per_second=3)
    command_of_robot = nodes._commands[setup.id]
    arguments = parse_node_command(command_of_robot)

    assert setup_of(arguments) == setup
    assert subjects_of(arguments) == subjects
    assert arguments.steps_per_second == 3
    assert str(bus_of(arguments)) == str(bus_choice)
    assert arguments.until_eof
    assert arguments.json


def run_in_place_of_robot_3(command: list[str]) -> NodeProcesses:
    """Return processes, of robot 3 alone, which runs this command in place of the robot's own."""
    nodes = NodeProcesses([setup_of_robot(3)], lambda robot: BusChoice("udp_multicast", {}), Subjects(), 10)
    nodes._commands = {3: command}
    return nodes


def process_of_robot_3(nodes: NodeProcesses) -> subprocess.Popen[str]:
    return nodes._processes[3]


def test_a_robot_s_process_that_ends_is_named_with_its_exit_code_and_what_it_printed_as_error() -> None:
    """A shell in its place prints an error and ends with exit code 2. ``check`` raises LockstepError.

    It has printed no report.
    """
    with run_in_place_of_robot_3(["sh", "-c", "echo memory is 63 >&2; exit 2"]) as nodes:
        process_of_robot_3(nodes).wait()
        with pytest.raises(LockstepError, match="robot 3 ended with exit code 2: memory is 63"):
            nodes.check()

    assert nodes.reports == {}, "JSON that the process has printed, by the robot's id"


def test_a_robot_s_process_that_does_not_end_when_it_is_asked_to_is_killed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A shell in its place ignores SIGTERM, prints the empty report ``{}``, and creates the file "up".

    The end of the block asks it to end, and kills it after 0.1 s. Its report is kept, by the robot's id.
    """
    monkeypatch.setattr(processes, "_EXIT_TIMEOUT", 0.1)
    script = f"trap '' TERM; echo '{{}}'; touch '{tmp_path}/up'; exec sleep 1000"
    with run_in_place_of_robot_3(["sh", "-c", script]) as nodes:
        wait_until((tmp_path / "up").exists)

    empty_report: dict[str, object] = {}
    assert nodes.reports == {3: empty_report}


def test_the_report_that_a_robot_s_process_prints_is_kept() -> None:
    """``reports`` has what a command prints in JSON in place of robot 3, by the robot's id."""
    with run_in_place_of_robot_3(["echo", '{"steps": 1}']) as nodes:
        process_of_robot_3(nodes).wait()

    assert nodes.reports == {3: {"steps": 1}}


def test_ctrl_c_in_a_terminal_does_not_reach_the_robots_processes() -> None:
    """Ctrl-C reaches all processes of a session. So the process of robot 3 is in a session of its own."""
    with run_in_place_of_robot_3(["sleep", "1000"]) as nodes:
        session_of_robot = os.getsid(process_of_robot_3(nodes).pid)
        session_of_this_process = os.getsid(os.getpid())
        assert session_of_robot != session_of_this_process


@pytest.mark.parametrize(
    ("interface", "expected_restrictions"), [("socketcan", [{2}]), ("udp_multicast", [])]
)
def test_robots_processes_run_on_one_processor_alone_if_a_robot_is_on_socketcan(
    interface: str, expected_restrictions: list[set[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """SocketCAN keeps the order of frames only if all processes are on one processor.

    So this process restricts itself to the processor with the lowest number, and the robots' processes, which
    it starts then, inherit that. Robot 10 is on ``interface``. If it is on multicast, as robot 11 is, there
    is no restriction.
    """
    allowed_processors = {3, 2, 4}
    restrictions: list[set[int]] = []

    def restrict_process(process: int, processors: set[int]) -> None:
        restrictions.append(processors)

    monkeypatch.setattr("os.sched_getaffinity", Mock(return_value=allowed_processors))
    monkeypatch.setattr("os.sched_setaffinity", restrict_process)

    def bus_of_robot(robot: int) -> BusChoice:
        return BusChoice(interface if robot == 10 else "udp_multicast", {})

    setups = [setup_of_robot(10), setup_of_robot(11)]
    NodeProcesses(setups, bus_of_robot, Subjects(), steps_per_second=10)

    assert restrictions == expected_restrictions
