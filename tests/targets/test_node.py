"""The C node sends and computes what the Python node does, here and on a Cortex-A8, keeps time, and survives
faults of its surroundings.

The bus is a Unix socket here, so that the tests need no CAN; ``tests/socketcan`` has those on a real bus.
"""

from __future__ import annotations

import fcntl
import os
import random
import re
import signal
import subprocess
import sys
import termios
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Health
from mcp_asdf_tools.bus.frames import (
    Command,
    Estimate,
    FrameFormat,
    Heartbeat,
    decode_heartbeat,
    encode_command,
    encode_estimate,
)
from mcp_asdf_tools.radio.controller_link import BenchOptions
from mcp_asdf_tools.radio.verification import Verification
from mcp_asdf_tools.robots.lockstep import Lockstep
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from support import PATIENCE, interruptible, names_in, require, slow
from targets.c_node import (
    CORTEX_A8,
    COVERAGE_BUILD,
    SANITIZED_BUILD,
    TABLE,
    CNode,
    NodeBuild,
    StartNode,
    candump_lines,
    node_command,
    numbers_of_robot,
    python_node,
    run_lockstep,
    unexecuted_lines,
)
from targets.unix_bus import UnixBus
from wrong_robots import settings_with_four_neighbours

ID = 101
CONTROLLER_STATE, GARBLED_FRAME, BUS_OFF, RESTARTED = 0x4, 0x8, 0x40, 0x100
"""Kinds of error frames: CAN_ERR_CRTL, _PROT, _BUSOFF and _RESTARTED of linux/can/error.h."""
MANY_ERRORS, ERROR_PASSIVE, ERROR_ACTIVE = 0x08, 0x10, 0x40
"""States of a controller in the second byte of an error frame (CAN_ERR_CRTL_TX_WARNING and so on)."""
FAST_CLOCK = ("--steps-per-second", 1000)


@pytest.fixture(scope="module", params=[SANITIZED_BUILD, *slow([CORTEX_A8])], ids=lambda kind: kind.name)
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    kind: NodeBuild = request.param
    return node_command(kind, tmp_path_factory)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UnixBus]:
    with UnixBus(tmp_path / "bus") as opened:
        yield opened


@pytest.fixture
def start_node(command: list[str], bus: UnixBus) -> Iterator[StartNode]:
    """A function that starts a node on the bus, one at a time; those that are left are stopped."""
    with ExitStack() as running_nodes:

        def start_on_bus(*options: object, **streams: object) -> CNode:
            node = running_nodes.enter_context(CNode(command, bus.channel_info, ID, *options, **streams))
            bus.accept_node()
            return node

        yield start_on_bus


# ---- The same frames as a Python node ----


SUBJECTS = Subjects(FrameFormat(0, 4), FrameFormat(8, 6), FrameFormat(9, 3))
"""Subjects and priorities other than the default ones."""
OPTIONS_OF_SUBJECTS = "--subject 0 --telemetry-subject 8 --command-subject 9"

OPTIONS_OF_FILTER = {
    Filter.ALWAYS: "--activation always",
    Filter.ADAPTIVE: "--activation adaptive",
    Filter.ROBUST: "--filter robust",
}
"""Options of the C node by filter; without ``--filter`` it has the paper's (``CNode``)."""


@dataclass
class BothNodes:
    """The robot's program in C on a bus, and its twin in Python, which gets the same frames.

    Attributes:
        bus: The bus of the C program.
        node: The C program.
        twin: The Python robot.
        sent_frames: What both have got.
        expected_answers: What the twin has answered, its first heartbeat included.
    """

    bus: UnixBus
    node: CNode
    twin: RobotNode
    sent_frames: list[can.Message] = field(default_factory=list)
    expected_answers: list[can.Message] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.expected_answers += self.twin.start()

    def add(self, frame: can.Message) -> None:
        """Give a frame to the twin, and note it for the C program."""
        self.sent_frames.append(frame)
        self.expected_answers += self.twin.receive_frame(frame)

    def send_all_to_c_program(self) -> dict[str, Any]:
        """Send the frames to the C program, receive all answers, stop it, and return its summary.

        Commands that are answered come last: the answer shows that all frames before have been handled.
        """
        for command in commands_that_are_answered():
            self.add(command)
        for number, frame in enumerate(self.sent_frames, start=1):
            self.bus.send(frame)
            if number % 20 == 0:  # so that the answers do not fill the socket
                while self.bus.recv(0) is not None:
                    pass
        self.bus.receive_frames(len(self.expected_answers) - len(self.bus.received_frames))
        return self.node.stop()


@pytest.fixture
def make_both_nodes(start_node: StartNode, bus: UnixBus) -> Callable[[Filter], BothNodes]:
    """A function that starts both nodes with a filter, and with settings that let everything happen soon."""

    def make(firmware_filter: Filter) -> BothNodes:
        options = "--lockstep --steps-per-second 3 --b-hat 0.75 --allow 0+2-5 --memory 64 --receive-buffer 0"
        periods = "--comms-period 2 --filter-period 4 --save-period 0 --telemetry-period 0"
        all_options = " ".join([options, periods, OPTIONS_OF_FILTER[firmware_filter], OPTIONS_OF_SUBJECTS])
        node = start_node(*all_options.split())
        twin = python_node(
            ID,
            b_hat=0.75,
            subjects=SUBJECTS,
            steps_per_second=3,
            filter=firmware_filter,
            allow=frozenset((0, 2, 3, 4, 5)),
            comms_period=2,
            filter_period=4,
            memory=64,
        )
        return BothNodes(bus, node, twin)

    return make


COUNTERS_OF_BROKEN_FRAMES = ("unknown", "refused", "others", "error_frames", "collisions")
COUNTERS_OF_COMMANDS_AND_ESTIMATES = ("obeyed", "disobeyed", "unsettled", "repeated", "rejected")


@pytest.mark.parametrize(
    ("firmware_filter", "counter_of_filter"),
    [(Filter.ALWAYS, "updates"), (Filter.ADAPTIVE, "tests"), (Filter.ROBUST, "tests")],
)
def test_c_and_python_node_answer_thousands_of_legal_and_broken_frames_alike(
    firmware_filter: Filter, counter_of_filter: str, make_both_nodes: Callable[[Filter], BothNodes]
) -> None:
    """Both get 3000 random estimates and commands, some of them damaged, and send the same answers.

    Both end with the same state, which the C node prints as a summary, and have counted the same kinds of
    frames, more than 50 of each kind.
    """
    both = make_both_nodes(firmware_filter)
    rng = random.Random(firmware_filter)
    for _ in range(3000):
        both.add(any_frame(rng))

    summary = both.send_all_to_c_program()

    assert candump_lines(both.bus.received_frames) == candump_lines(both.expected_answers)
    expected_numbers = numbers_of_robot(both.twin)
    assert {name: summary[name] for name in expected_numbers} == expected_numbers
    assert numbers_of_reception(summary) == expected_numbers_of_reception(both.twin)
    for counter in (*COUNTERS_OF_BROKEN_FRAMES, *COUNTERS_OF_COMMANDS_AND_ESTIMATES):
        assert summary[counter] > 50, f"{counter}: too rare to be tested"
    assert summary[counter_of_filter] >= 5, "runs of the filter"


def numbers_of_reception(summary: dict[str, Any]) -> dict[str, int]:
    """Return how many frames a C node has rejected, and what it has noticed of others."""
    rejected = summary["refused"] + summary["others"] + summary["error_frames"]
    return {"rejected": rejected, **{name: summary[name] for name in ("collisions", "unknown", "jumps")}}


def expected_numbers_of_reception(twin: RobotNode) -> dict[str, int]:
    """Return the same numbers of the Python node, which calls a collision a conflict.

    Fails if it has noticed anything else.
    """
    events = Counter(kind.value for kind, _ in twin.reception.events.elements())
    assert events.keys() <= {"conflict", "unknown", "jump"}
    return {
        "rejected": twin.reception.rejected.total(),
        "collisions": events["conflict"],
        "unknown": events["unknown"],
        "jumps": events["jump"],
    }


def test_a_node_reports_once_that_another_node_sends_under_its_id(
    make_both_nodes: Callable[[Filter], BothNodes],
) -> None:
    """Two estimates come from a node that has the same id. Both are counted, and one message is printed."""
    both = make_both_nodes(Filter.ROBUST)
    for x_hat in (1000, 2000):
        both.add(encode_estimate(Estimate(ID, x_hat, alpha=0, transfer_id=0), SUBJECTS.estimates))

    summary = both.send_all_to_c_program()

    assert summary["collisions"] == 2
    assert both.node.error_lines == [
        f"mcp_asdf_node: another node sends under this node's own id: {ID}; give one of them another"
    ]


def command_frame(tick: int, target: int, action: Action, subjects: Subjects = SUBJECTS) -> can.Message:
    """Return a command of the node with id 126."""
    return encode_command(Command(126, tick, target, action, transfer_id=0), subjects.commands)


def commands_that_are_answered() -> list[can.Message]:
    """Return two commands that begin and end a tick, even if a tick of ``any_frame`` has not ended."""
    other_tick = 7
    return [command_frame(other_tick, ID, action) for action in (Action.OBSERVE_BLACK, Action.SETTLE)]


def any_frame(rng: random.Random, robot_id: int = ID, subjects: Subjects = SUBJECTS) -> can.Message:
    """Return an estimate or a command that a robot may receive: legal, or in 3 of 10 cases damaged."""
    is_estimate = rng.random() < 0.5
    draw_frame = draw_estimate if is_estimate else draw_command
    frame = draw_frame(rng, robot_id, subjects)
    if rng.random() < 0.7:
        return frame
    change_frame = rng.choice(DAMAGES)
    fields: dict[str, Any] = {"arbitration_id": frame.arbitration_id, "data": frame.data}
    return can.Message(**fields | change_frame(frame, rng))


def draw_estimate(rng: random.Random, robot_id: int, subjects: Subjects) -> can.Message:
    """Return an estimate from robot 0 to 6, or under the receiver's own id. Its alpha may be illegal."""
    sender = rng.choice((robot_id, *range(7)))
    alpha = rng.choice((0, 0xFF, rng.getrandbits(32)))
    x_hat = rng.randrange(2**23 + 1)
    return encode_estimate(Estimate(sender, x_hat, alpha, transfer_id=0), subjects.estimates)


def draw_command(rng: random.Random, robot_id: int, subjects: Subjects) -> can.Message:
    """Return a command of tick 0 or 1, for the robot, for every robot or for robot 4."""
    target = rng.choice((robot_id, robot_id, EVERY_ROBOT, 4))
    action = rng.choice(list(Action))
    return command_frame(rng.randrange(2), target, action, subjects)


DAMAGES: tuple[Callable[[can.Message, random.Random], dict[str, Any]], ...] = (
    lambda frame, rng: {"arbitration_id": frame.arbitration_id ^ 1 << rng.randrange(29)},  # a flipped bit
    lambda frame, rng: {"data": rng.randbytes(8)},  # other data
    lambda frame, rng: {"data": frame.data[:3] + rng.randbytes(4) + frame.data[7:]},  # another alpha
    lambda frame, rng: {"data": frame.data[: rng.randrange(8)]},  # too short
    lambda frame, rng: {"data": b"\xff" * 7 + frame.data[7:]},  # numbers too large
    lambda frame, rng: {"arbitration_id": frame.arbitration_id & 0x7FF, "is_extended_id": False},
    lambda frame, rng: {"data": None, "dlc": 8, "is_remote_frame": True},  # a request for data
    lambda frame, rng: {"is_fd": True},
    lambda frame, rng: {"arbitration_id": GARBLED_FRAME, "is_error_frame": True},
)
"""Functions of a frame that return the arguments of ``can.Message`` to change in it."""


def heartbeats_in(frames: list[can.Message]) -> list[Heartbeat]:
    """Return the heartbeats among frames, decoded."""
    contents = [decode_heartbeat(frame) for frame in frames]
    return [content for content in contents if isinstance(content, Heartbeat)]


@pytest.mark.slow
def test_a_node_repeats_its_first_heartbeat_each_second_until_it_is_commanded(
    start_node: StartNode, bus: UnixBus
) -> None:
    """It is commanded when it has sent its first heartbeat twice. Then it is silent for over a second."""
    start_node("--lockstep")
    start_time = time.monotonic()
    while bus.greeting_count < 2:
        assert bus.recv(PATIENCE) is not None
    assert time.monotonic() - start_time > 0.9, "seconds: two heartbeats are 1 s apart"

    run_lockstep(bus, [ID], ticks=1, seed=1)
    time.sleep(1.1)

    assert bus.recv(0) is None, "no heartbeat of its own accord"


# ---- Usage ----

LOCKSTEP = "--id 1 --lockstep"
ON_A_BUS = "--interface unix:/no/such/socket "
"""A bus that is not there, which the node finds out only if nothing else is wrong."""


WRONG_OPTIONS = [
    (ON_A_BUS + "--id 1x --lockstep", "--id is 1x; choose a whole number, 0 to 127"),
    (ON_A_BUS + "--lockstep", "--id is missing; see --help"),
    *(
        (f"{ON_A_BUS}{LOCKSTEP} --allow {ids}", f"--allow is {ids}; give ids, 0 to 127, such as 0-19+30")
        for ids in ("x", "5-3", "0-", "1+", "128", "1,2")
    ),
    (ON_A_BUS + "--id 1", "choose one of --lockstep, --observations, --sensor"),
    (ON_A_BUS + f"{LOCKSTEP} --b-hat nan", "--b-hat is nan; choose 2^-20 to 1 - 2^-20"),
    (ON_A_BUS + f"{LOCKSTEP} --filter asdf-minus", "choose none, asdf-plus or robust"),
    (ON_A_BUS + f"{LOCKSTEP} --activation never", "choose adaptive or always"),
    # The default filter is the robust one, which has no other activation.
    (ON_A_BUS + f"{LOCKSTEP} --activation always", "leave it out, or choose --filter asdf-plus"),
    (ON_A_BUS + f"{LOCKSTEP} --comms-period 3", "--filter-period is 1000; choose a multiple"),
    (ON_A_BUS + f"{LOCKSTEP} --memory 66", "--memory is 66; choose a multiple of 4"),
    (ON_A_BUS + f"{LOCKSTEP} --subject 3002", "choose three different subjects"),
    (ON_A_BUS + f"{LOCKSTEP} --command-subject 3001", "choose three different subjects"),
    (ON_A_BUS + f"{LOCKSTEP} surplus", "surplus belongs to no option"),
    (ON_A_BUS + "--id 1 --observations /no/such/file", "cannot open /no/such/file: "),
    (LOCKSTEP, "--interface is missing"),
    (f"{LOCKSTEP} --interface nocan7", "modprobe vcan\n  ip link add dev nocan7 type vcan\n"),
    (f"{LOCKSTEP} --interface udp:239.74.163.2", "Invalid argument; name a multicast group and a port"),
    (f"{LOCKSTEP} --interface udp:10.0.0.1:43113", "Invalid argument; name a multicast group and a port"),
    (f"{LOCKSTEP} --interface udp:239.74.163.2:0", "Invalid argument; name a multicast group and a port"),
    (f"{LOCKSTEP} --interface udp:[ff15::1]:65536", "Invalid argument; name a multicast group and a port"),
    (f"{LOCKSTEP} --interface udp:239.74.163.2:9 --network no7", "No such device; name an interface that"),
    (ON_A_BUS + LOCKSTEP + " --network lo", "--network is lo; leave it out, or choose an --interface udp"),
    (ON_A_BUS + LOCKSTEP + " --hop-limit 0", "--hop-limit is 0; leave it out, or"),
    (ON_A_BUS + LOCKSTEP, "cannot join unix:/no/such/socket: "),
    (f"{LOCKSTEP} --interface unix:/{'x' * 200}", "cannot join unix:/xxx"),
]
"""Options, and part of the message about them."""


WRONG_USAGE = 2
"""Exit code of a program that does not start because of its options."""
FAILED_RUN = 1
"""Exit code of a program that has started, but could not do all that it had to."""


@pytest.mark.parametrize(("wrong_options", "expected_message"), WRONG_OPTIONS)
def test_the_node_refuses_wrong_options_and_says_what_to_give_instead(
    tmp_path_factory: pytest.TempPathFactory, wrong_options: str, expected_message: str
) -> None:
    """It does not start, ends with exit code 2, and prints to standard error alone."""
    command = [*node_command(SANITIZED_BUILD, tmp_path_factory), *wrong_options.split()]

    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)

    assert result.returncode == WRONG_USAGE
    assert result.stdout == ""
    assert expected_message in result.stderr


# ---- Observations and time ----


@pytest.mark.parametrize("source", ["a file", "the standard input"])
def test_a_node_computes_what_its_twin_in_python_does_from_the_same_observations(
    source: str, start_node: StartNode, bus: UnixBus, tmp_path: Path
) -> None:
    """Both count and believe the same after 300 ticks. In 100 ticks there is no observation.

    Each symbol of the file stands for a tick: 0 is white, 1 is black, and - is no observation. The same six
    symbols repeat. They hold four observations, and three of these are black.
    """
    file = tmp_path / "observations"
    white_space_at_the_end = " \t\n"  # no symbol, and so no tick
    file.write_text("1\n0\n-\n1\n1\n-\n" * 50 + white_space_at_the_end, encoding="ascii")

    option = file if source == "a file" else "-"
    with file.open() as standard_input:
        node = start_node(*FAST_CLOCK, "--observations", option, stdin=standard_input)
    bus.receive_until_node_ends()

    twin = python_node(ID).robot
    for is_black in [True, False, True, True] * 50:
        twin.step(Observation(is_black))
    summary = node.summary()
    assert summary["ended"] == "observations"
    assert summary["ticks"] == 300
    assert summary["missing"] == 0, "ticks without a symbol"
    assert summary["t"] == 4 * 50, "observations"
    assert summary["n"] == 3 * 50, "black tiles"
    assert summary["x"] / 2**23 == twin.x, "the summary has x in units of 2^-23"


def test_a_node_sends_estimates_telemetry_and_heartbeats_at_their_periods(
    start_node: StartNode, bus: UnixBus, tmp_path: Path
) -> None:
    """It sends an estimate in each of 300 ticks, telemetry in every hundredth, and a heartbeat each second.

    There are 1000 ticks in a second, so there is only the heartbeat with which it starts.
    """
    file = tmp_path / "observations"
    file.write_text("1" * 300, encoding="ascii")

    node = start_node("--steps-per-second", 1000, "--telemetry-period", 100, "--observations", file)
    bus.receive_until_node_ends()

    summary = node.summary()
    assert summary["estimates"] == 300
    assert summary["telemetry"] == 3
    assert summary["heartbeats"] == 1


@pytest.mark.parametrize("character", ["x", "\0"])
def test_a_character_that_is_no_observation_ends_the_run(
    start_node: StartNode, bus: UnixBus, tmp_path: Path, character: str
) -> None:
    """The observation before it counts, and the node says where in the file the character stands."""
    file = tmp_path / "observations"
    file.write_text(f"1 {character}", encoding="ascii")

    node = start_node(*FAST_CLOCK, "--observations", file)
    bus.receive_until_node_ends()

    summary = node.summary(status=FAILED_RUN)
    assert summary["ended"] == "observations not valid"
    assert summary["t"] == 1, "observations"
    assert node.error_lines == [f"mcp_asdf_node: character 3 of {file} is no observation; write 0, 1 or -"]


def test_a_node_does_not_wait_for_its_observations(start_node: StartNode, bus: UnixBus) -> None:
    """Four tiles, three of them black, come in two parts, at least eight ticks apart.

    The node ticks on meanwhile, and counts the other ticks as missing an observation.
    """
    node = start_node("--steps-per-second", 200, "--observations", "-", stdin=subprocess.PIPE)
    standard_input = node.process.stdin
    assert standard_input is not None
    for symbols in ("1 0", "11"):
        standard_input.write(symbols)
        standard_input.flush()
        wait_for_ticks(bus, 8)

    summary = node.stop()

    assert summary["t"] == 4, "observations"
    assert summary["n"] == 3, "black tiles"
    assert summary["missing"] == summary["ticks"] - 4, "ticks without an observation"


def wait_for_ticks(bus: UnixBus, count: int) -> None:
    """Wait until the node has sent so many frames: an estimate in each tick."""
    bus.receive_frames(count)


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    """The file into which a sensor writes its value; it sees black at the start."""
    file = tmp_path / "value"
    file.write_text("1\n", encoding="ascii")
    return file


@pytest.fixture
def node_with_sensor(start_node: StartNode, sensor: Path) -> CNode:
    """A node that reads the file of its sensor 100 times a second."""
    return start_node("--steps-per-second", 100, "--sensor", sensor)


def test_a_sensor_s_file_is_read_anew_in_every_tick(
    node_with_sensor: CNode, sensor: Path, bus: UnixBus
) -> None:
    """The sensor sees black (1) for six ticks, then white (0), and then black again."""
    wait_for_ticks(bus, 6)
    for text in ("0\n", "1"):
        replace_content(sensor, text)
        wait_for_ticks(bus, 6)

    summary = node_with_sensor.stop()

    assert summary["ended"] == "signal"
    assert summary["n"] > 5, "black tiles: at least those of the first six ticks"
    assert summary["n"] < summary["t"], "t counts all tiles, and some were white"
    assert summary["t"] == summary["ticks"]


def test_a_tick_without_a_value_of_the_sensor_has_no_observation(
    node_with_sensor: CNode, sensor: Path, bus: UnixBus
) -> None:
    """For six ticks its file has no number, and for some more there is no file; the node goes on."""
    replace_content(sensor, "what?\n")
    wait_for_ticks(bus, 6)
    sensor.unlink()
    wait_for_ticks(bus, 3)

    summary = node_with_sensor.stop()

    assert summary["missing"] > 5, "ticks without an observation"
    assert summary["t"] + summary["missing"] == summary["ticks"]


def replace_content(file: Path, text: str) -> None:
    """Replace a file at once, so that nobody reads half of it."""
    draft = file.with_suffix(".new")
    draft.write_text(text, encoding="ascii")
    draft.replace(file)


@pytest.fixture
def options_for_400_black_tiles(tmp_path: Path) -> tuple[object, ...]:
    """Options of a node that observes 400 black tiles, and then ends."""
    (tmp_path / "observations").write_text("1" * 400, encoding="ascii")
    return ("--observations", tmp_path / "observations")


def test_the_clock_keeps_its_rate_and_leaves_out_what_it_missed(
    start_node: StartNode, bus: UnixBus, options_for_400_black_tiles: tuple[object, ...]
) -> None:
    """The node is stopped for 0.3 seconds, when 30 ticks are due. It does not make up for the lost ticks.

    It counts the ticks that it has skipped, and the longest time by which a tick was late.
    """
    ticks_per_second = 100
    start_time = time.monotonic()
    node = start_node("--steps-per-second", ticks_per_second, *options_for_400_black_tiles)
    wait_for_ticks(bus, 10)
    node.process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)
    node.process.send_signal(signal.SIGCONT)
    wait_for_ticks(bus, 5)

    summary = node.stop()

    most_ticks = ticks_per_second * (time.monotonic() - start_time) + 1
    assert summary["ticks"] + summary["skipped"] <= most_ticks, "faster than the clock"
    assert summary["skipped"] >= 25, "of 30 ticks in 0.3 seconds"
    assert summary["worst_lateness_us"] >= 250_000, "microseconds; it was stopped for 300,000"


# ---- Faults around it ----


def error_frame(kind: int, controller_state: int = 0) -> can.Message:
    """Return an error frame as Linux delivers it: its second byte is the controller's state."""
    data = bytes([0, controller_state, 0, 0, 0, 0, 0, 0])
    return can.Message(arbitration_id=kind, is_error_frame=True, data=data)


def test_the_node_s_heartbeat_says_how_the_bus_is(start_node: StartNode, bus: UnixBus) -> None:
    """The node has a health, from nominal to warning, which follows from the error frames that it receives.

    In each tick it receives an error frame, and observes and broadcasts. A tick takes a second here, so it
    has a heartbeat. The heartbeat of the first tick comes before any error frame.
    """
    frame_and_health_by_tick = [
        (error_frame(GARBLED_FRAME), Health.NOMINAL),
        (error_frame(GARBLED_FRAME), Health.NOMINAL),  # a garbled frame alone is no reason to worry
        (error_frame(CONTROLLER_STATE, MANY_ERRORS), Health.ADVISORY),
        (error_frame(CONTROLLER_STATE, ERROR_PASSIVE), Health.CAUTION),
        (error_frame(CONTROLLER_STATE, ERROR_ACTIVE), Health.NOMINAL),
        (error_frame(BUS_OFF), Health.WARNING),
        (error_frame(GARBLED_FRAME), Health.WARNING),  # the controller is still off the bus
        (error_frame(RESTARTED), Health.NOMINAL),
    ]
    node = start_node("--lockstep", "--steps-per-second", 1, "--steps", 8)
    send_one_in_each_tick(bus, [frame for frame, _health in frame_and_health_by_tick])

    summary = node.summary()

    received_health = [heartbeat.health for heartbeat in heartbeats_in(bus.received_frames)]
    assert received_health == [health for _frame, health in frame_and_health_by_tick]
    assert summary["error_frames"] == 8
    assert summary["bus_off"] == 1


def send_one_in_each_tick(bus: UnixBus, frames: list[can.Message]) -> None:
    """Send each frame to the node on the bus, and command a tick after it."""
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up([ID], PATIENCE)
    for frame in frames:
        bus.send(frame)
        lockstep.observe({ID: Observation.BLACK})
        lockstep.wait_for_estimates([ID])
        lockstep.settle([ID])


def test_a_bus_that_closes_ends_the_run_with_a_failure(start_node: StartNode, bus: UnixBus) -> None:
    """Its summary says that the bus has closed, and the exit code, 1, says that the run has failed."""
    node = start_node("--lockstep")

    bus.node.close()

    summary = node.summary(status=FAILED_RUN)
    assert summary["ended"] == "bus closed"


@pytest.mark.slow
def test_a_node_whose_frames_nobody_takes_loses_them_but_no_tick(
    start_node: StartNode, bus: UnixBus, options_for_400_black_tiles: tuple[object, ...]
) -> None:
    """The test receives no frame until the node has observed 400 tiles and has ended: the socket is full.

    The summary counts the frames that were lost, and the other ones arrive.
    """
    node = start_node(*FAST_CLOCK, *options_for_400_black_tiles)

    summary = node.summary()  # waits until the node has ended

    assert summary["t"] == 400
    assert summary["unsent"] > 0
    assert summary["queue_full"] > 0
    bus.receive_until_node_ends()
    frames_made = summary["estimates"] + summary["heartbeats"]
    assert len(bus.received_frames) == frames_made - summary["unsent"]


@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@interruptible()
def test_a_signal_ends_the_node_with_its_summary(
    start_node: StartNode, bus: UnixBus, signal_number: signal.Signals
) -> None:
    """It means Ctrl-C, a service that is stopped, or a terminal that is closed, and comes after one tick."""
    node = start_node("--lockstep")
    run_lockstep(bus, [ID], ticks=1, seed=1)

    summary = node.stop(signal_number)

    assert summary["ended"] == "signal"
    assert summary["ticks"] == 1


# ---- The state in a file ----


def saved_state(node: RobotNode) -> bytes:
    """Return the image that a Python node's robot saves, the content of the file ``--state`` of a C node."""
    image: bytes = node.robot.save()  # type: ignore[attr-defined]
    return image


@pytest.mark.parametrize("firmware_filter", [Filter.ADAPTIVE, Filter.ROBUST])
def test_a_node_that_is_started_again_goes_on_with_its_saved_state(
    start_node: StartNode, bus: UnixBus, tmp_path: Path, firmware_filter: Filter
) -> None:
    """Two runs of three tiles each end in the state of one robot that has observed all six.

    Nothing is left of the draft to which the node writes a state before it has its name.
    """
    observations, state = tmp_path / "observations", tmp_path / "state"
    options = ("--state", state, "--observations", observations, *OPTIONS_OF_FILTER[firmware_filter].split())
    for tiles in ("011", "100"):
        observations.write_text(tiles, encoding="ascii")
        node = start_node(*FAST_CLOCK, *options)
        bus.receive_until_node_ends()
        assert node.summary()["ticks"] == 3

    node_without_restart = python_node(ID, filter=firmware_filter)
    for tile in [0, 1, 1, 1, 0, 0]:
        node_without_restart.robot.step(Observation(tile))
    assert state.read_bytes() == saved_state(node_without_restart)
    assert not draft_of(state).exists()


def state_with_a_flipped_bit() -> bytes:
    state = bytearray(saved_state(python_node(ID)))
    state[20] ^= 1  # any bit
    return bytes(state)


@pytest.mark.parametrize(
    ("refused_state", "options", "expected_reason"),
    [
        pytest.param(saved_state(python_node(ID))[:-1], (), "damaged", id="too short"),
        pytest.param(saved_state(python_node(ID)) + b"x", (), "damaged", id="too long"),
        pytest.param(state_with_a_flipped_bit(), (), "damaged", id="a flipped bit"),
        pytest.param(saved_state(python_node(ID)), ("--filter-period", 10), "periods", id="another period"),
        pytest.param(saved_state(python_node(ID)), ("--filter", "robust"), "damaged", id="another filter"),
        pytest.param(saved_state(python_node(6)), (), "another robot", id="another robot"),
    ],
)
def test_a_state_that_is_damaged_or_of_another_configuration_is_refused_and_kept(
    refused_state: bytes,
    options: tuple[object, ...],
    expected_reason: str,
    message_for_refused_state: Callable[..., str],
    tmp_path: Path,
) -> None:
    """The node, with id 101 and the paper's filter, does not start, says why, and leaves the file alone."""
    state = tmp_path / "state"
    state.write_bytes(refused_state)

    message = message_for_refused_state(state, *options)

    assert expected_reason in message
    assert state.read_bytes() == refused_state


@pytest.fixture
def message_for_refused_state(command: list[str], bus: UnixBus) -> Callable[..., str]:
    """A function that starts a node with a state that it has to refuse, and returns its error message."""
    return partial(start_with_refused_state, command, bus)


def test_a_folder_in_place_of_the_state_is_refused(
    message_for_refused_state: Callable[..., str], tmp_path: Path
) -> None:
    """The node does not start, and its message has the name of the folder."""
    assert str(tmp_path) in message_for_refused_state(tmp_path)


def start_with_refused_state(command: list[str], bus: UnixBus, state: Path, *options: object) -> str:
    """Start a node with a state that it has to refuse, by its exit code, and return its error message."""
    process = CNode(command, bus.channel_info, ID, "--lockstep", "--state", state, *options).process
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == WRONG_USAGE
    assert output == ""
    return str(errors)


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    """File to which strace writes the system calls of a node."""
    return tmp_path / "trace"


@pytest.fixture
def command_under_strace(trace: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[str]]:
    """A function that returns the command of a node whose system calls on some files strace lets fail."""

    def make_command(paths: Sequence[Path], *settings: str) -> list[str]:
        """Take the files, and settings such as ``inject=read:error=EIO:when=2`` for the second read."""
        # The sanitizer's search for leaks does not work under strace.
        strace = ["env", "ASAN_OPTIONS=detect_leaks=0", require("strace", "strace"), "-o", str(trace)]
        for path in paths:
            strace += ["-P", str(path)]
        for setting in settings:
            strace += ["-e", setting]
        return [*strace, *node_command(SANITIZED_BUILD, tmp_path_factory)]

    return make_command


@pytest.mark.slow
@pytest.mark.parametrize("error", ["EINTR", "EAGAIN"])
def test_a_read_of_observations_that_fails_for_the_moment_is_repeated(
    bus: UnixBus, tmp_path: Path, command_under_strace: Callable[..., list[str]], error: str
) -> None:
    """None of 600 observations is lost, although the first, the third and every second read after it fail.

    strace lets the reads fail, as the system may if a signal comes or nothing is there yet. A tick whose read
    has failed counts as missing an observation. A read takes up to 256 bytes, so there are several.
    """
    file = tmp_path / "observations"
    file.write_text("1" * 600, encoding="ascii")
    command = command_under_strace([file], f"inject=read:error={error}:when=1+2")

    with CNode(command, bus.channel_info, ID, *FAST_CLOCK, "--observations", file) as node:
        bus.accept_node()
        bus.receive_until_node_ends()
        summary = node.summary()

    assert summary["ended"] == "observations"
    assert summary["t"] == 600
    assert summary["missing"] > 2


def pattern_of_message(file: Path, reason: str) -> str:
    """Return the pattern of the node's message about a file that the system does not let it read."""
    return rf"mcp_asdf_node: cannot (use the state|read) {file}: {reason}(; .*)?\n"


@pytest.mark.parametrize(
    ("failing_call", "expected_reason"),
    [("openat:error=EACCES", "Permission denied"), *slow([("read:error=EIO:when=2", "Input/output error")])],
)
def test_a_state_that_cannot_be_read_is_refused_and_kept(
    failing_call: str,
    expected_reason: str,
    bus: UnixBus,
    tmp_path: Path,
    command_under_strace: Callable[..., list[str]],
) -> None:
    """The node does not start, and leaves no other file in the folder. strace lets the system call fail."""
    state = tmp_path / "state"
    image = saved_state(python_node(ID))
    state.write_bytes(image)
    command = command_under_strace([state], f"inject={failing_call}")

    message = start_with_refused_state(command, bus, state)

    assert re.fullmatch(pattern_of_message(state, expected_reason), message)
    assert state.read_bytes() == image
    assert names_in(tmp_path) == ["bus", "state", "trace"]


@pytest.mark.parametrize(
    ("failing_read", "expected_observations"),
    [
        ("read:error=EIO", 0),
        ("read:error=EIO:when=2", 256),  # the first read takes the whole file
    ],
)
def test_a_run_ends_with_a_failure_where_observations_cannot_be_read(
    failing_read: str,
    expected_observations: int,
    bus: UnixBus,
    tmp_path: Path,
    command_under_strace: Callable[..., list[str]],
) -> None:
    """The file has 256 observations. strace lets the first read fail, or the second.

    The observations of the reads before it count; t is their number.
    """
    file = tmp_path / "observations"
    file.write_bytes(b"1" * 256)
    command = command_under_strace([file], f"inject={failing_read}")

    with CNode(command, bus.channel_info, ID, *FAST_CLOCK, "--observations", file) as node:
        summary = node.summary(status=FAILED_RUN)

    [error_line] = node.error_lines
    assert re.fullmatch(pattern_of_message(file, "Input/output error"), error_line + "\n")
    assert summary["ended"] == "observations not readable"
    assert summary["t"] == expected_observations


def test_a_state_that_can_only_be_read_in_pieces_is_complete(
    command: list[str], bus: UnixBus, tmp_path: Path
) -> None:
    """The file of the state is a pipe, which is read byte by byte. The robot has observed one tile.

    When the node ends, it saves the unchanged state in an ordinary file of the same name.
    """
    python_twin = python_node(ID)
    python_twin.robot.step(Observation.BLACK)
    image = saved_state(python_twin)
    state = tmp_path / "state"
    os.mkfifo(state)

    with CNode(command, bus.channel_info, ID, "--lockstep", "--state", state) as node:
        write_byte_by_byte(state, image)
        bus.accept_node()
        summary = node.stop()

    assert summary["t"] == 1
    assert state.read_bytes() == image


def write_byte_by_byte(path: Path, content: bytes) -> None:
    """Write into a pipe, each byte when the reader has read the one before."""
    with path.open("wb", buffering=0) as pipe:
        for byte in content:
            pipe.write(bytes([byte]))
            while unread_bytes(pipe) > 0:
                time.sleep(0.001)


def unread_bytes(pipe: FileIO) -> int:
    """Return the number of bytes in a pipe that its reader has not read yet."""
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


TRACE_CALLS_OF_SAVE = "trace=openat,write,fsync,close,rename"


@pytest.fixture(scope="module")
def states() -> list[bytes]:
    """The states of a robot after 0, 300 and 400 black tiles: before the saves, of save 1 and of save 2."""
    model = python_node(ID)
    states = [saved_state(model)]
    for further_tiles in (300, 100):
        for _ in range(further_tiles):
            model.robot.step(Observation.BLACK)
        states.append(saved_state(model))
    return states


@pytest.fixture
def state(tmp_path: Path, states: list[bytes]) -> Path:
    """The file of the state of a node that has not observed anything yet."""
    path = tmp_path / "state"
    path.write_bytes(states[0])
    return path


@pytest.fixture
def run_with_two_saves(
    bus: UnixBus,
    state: Path,
    options_for_400_black_tiles: tuple[object, ...],
    command_under_strace: Callable[..., list[str]],
) -> Callable[..., list[str]]:
    """A function that runs a node under strace and returns the lines of its error messages.

    The node saves its state after 300 ticks, and after 400 in the end. It has to observe all tiles, to leave
    no draft, and to end with the exit code given. strace traces the calls of both saves, and obeys further
    settings.
    """

    def run_node(*settings: str, exit_code: int) -> list[str]:
        command = command_under_strace([draft_of(state), state.parent], TRACE_CALLS_OF_SAVE, *settings)
        options = (*FAST_CLOCK, *options_for_400_black_tiles, "--state", state, "--save-period", 300)
        with CNode(command, bus.channel_info, ID, *options) as node:
            bus.accept_node()
            bus.receive_until_node_ends()
            summary = node.summary(status=exit_code)
        assert summary["t"] == 400
        assert not draft_of(state).exists()
        return node.error_lines

    return run_node


def draft_of(state: Path) -> Path:
    """Return the file to which a state is written before it gets its name."""
    return state.with_name("state.new")


def test_a_save_writes_a_draft_to_the_disk_before_it_gets_the_name_of_the_state(
    run_with_two_saves: Callable[..., list[str]], trace: Path, state: Path, states: list[bytes]
) -> None:
    """Whenever the power fails, the name stands for all of the old state or all of the new.

    strace lists the system calls of two saves. fsync waits until the disk has a file, or a folder's names.
    """
    _old_state, _state_of_first_save, state_after_the_run = states

    error_lines = run_with_two_saves(exit_code=0)

    assert error_lines == []
    assert state.read_bytes() == state_after_the_run
    calls_about_draft = ["openat", "write", "fsync", "close", "rename"]
    calls_about_folder = ["openat", "fsync", "close"]
    calls_of_a_save = [*calls_about_draft, *calls_about_folder]
    assert traced_calls(trace) == [*calls_of_a_save, *calls_of_a_save]


def traced_calls(trace: Path) -> list[str]:
    """Return the names of the calls that strace has listed; its last line says how the program ended."""
    *calls, _exit = trace.read_text(encoding="utf-8").splitlines()
    return [call.partition("(")[0] for call in calls]


def test_the_old_state_is_kept_if_every_save_writes_only_a_part(
    run_with_two_saves: Callable[..., list[str]], state: Path, states: list[bytes]
) -> None:
    """strace lets each write return 50, as if no more bytes of a state, which has 124, had room on the disk.

    The node prints one message, observes all its tiles, and ends with the exit code of a failed run.
    """
    old_state, *_ = states

    error_lines = run_with_two_saves("inject=write:retval=50", exit_code=FAILED_RUN)

    assert error_lines == [f"mcp_asdf_node: cannot save the state {state}: No space left on device; going on"]
    assert state.read_bytes() == old_state


@pytest.mark.slow
@pytest.mark.parametrize(
    ("failing_call", "kept_save"),
    [
        # The first save fails at its first call, or when its draft is complete; the second save saves all.
        ("openat:error=ENOSPC:when=1", 2),
        ("rename:error=ENOSPC:when=1", 2),
        # The second save fails. The first five calls are about its draft, without which the state of the
        # first save is kept.
        ("openat:error=ENOSPC:when=3", 1),
        ("write:error=ENOSPC:when=2", 1),
        ("fsync:error=ENOSPC:when=3", 1),
        ("close:error=ENOSPC:when=3", 1),
        ("rename:error=ENOSPC:when=2", 1),
        ("openat:error=ENOSPC:when=4", 2),
        ("fsync:error=ENOSPC:when=4", 2),
    ],
)
def test_whichever_call_of_a_save_fails_the_last_state_or_the_one_before_is_kept(
    failing_call: str,
    kept_save: int,
    run_with_two_saves: Callable[..., list[str]],
    state: Path,
    states: list[bytes],
) -> None:
    """The robot goes on, prints one message, and ends with the exit code of a failed run.

    There are two saves, after 300 tiles and after 400; ``kept_save`` is 1 or 2, as ``states`` begin with the
    state before. strace lets a call fail, say the third openat of both saves, as if the disk were full.
    """
    error_lines = run_with_two_saves(f"inject={failing_call}", exit_code=FAILED_RUN)

    assert error_lines == [f"mcp_asdf_node: cannot save the state {state}: No space left on device; going on"]
    assert state.read_bytes() == states[kept_save]


@pytest.mark.slow
@pytest.mark.parametrize("number_of_close", [2, 4])
def test_a_folder_that_cannot_be_closed_after_a_save_does_no_harm(
    number_of_close: int, run_with_two_saves: Callable[..., list[str]], state: Path, states: list[bytes]
) -> None:
    """The node says nothing of it. There are two saves: calls 1 and 3 of ``close`` are about a draft.

    Calls 2 and 4 are about the folder, and strace lets one of them fail.
    """
    _old_state, _state_of_first_save, state_after_the_run = states

    error_lines = run_with_two_saves(f"inject=close:error=ENOSPC:when={number_of_close}", exit_code=0)

    assert error_lines == []
    assert state.read_bytes() == state_after_the_run


# ---- The verdict ----

NOT_EXECUTED = {
    "configurations that the node refuses before it is there": r"mcp_asdf\.c: (.*config->(filter|memory).*"
    r"|return (MCP_ASDF_ERR_(CONFIG|TABLE|ID|B_HAT)|false);"
    r"|if \((filters_from_first|id|b_hat|head|word|status) .*"
    r"|.*(THRESHOLD_ONE|TABLE_OMEGA_MAX).*)",
    "arguments that its codec refuses before": r"mcp_asdf\.c: (if \((\(uint32_t\)z|x_hat|sender) .*"
    r"|return MCP_ASDF_ERR_(OBSERVATION|X_HAT);|\+\+robot->counters\.rejected;)",
    "error frames, CAN FD, and frames that no node makes": r"mcp_asdf_frame\.c: (return status;"
    r"|if \((status|node|target|format->subject|action|message->\w+) .*"
    r"|if \(\(frame->flags & MCP_ASDF_FRAME_(ERROR|FD)\) .*"
    r"|return MCP_ASDF_FRAME_ERR_(ACTION|B_HAT|(ERROR|FD)_FRAME|FORMAT|HEALTH|MODE|NODE|TARGET|X|X_HAT);)",
    "step(), which the node does not call": r"mcp_asdf\.c: (.*_(step|observe)\(.*|return status == .*)",
    "other configurations: another filter, table or memory, b_hat below 1/2": r"mcp_asdf\.c: "
    r"(if \(filter == .*|const uint32_t k = .*|if \(is_halved\) .*|begin_batch\(robot\);|t >>= 1;|n = \(n .*"
    r"|const uint32_t (rounded_down|is_rounded_down_odd) = .*)"
    r"|mcp_asdf_robust\.h: (return b_hat < UINT32_C\(1\) .*|if \(mcp_asdf_is_robust\(robot->config\)\) .*)",
    "46,341 observations or more: the largest alpha": r"mcp_asdf\.c: return exponent <= ALPHA_SHIFT_MAX .*"
    r"|mcp_asdf_arithmetic\.h: (if \(\(count & 32U\).*|value = high_word\(value\);)",
    "2^21 observations in a filter period": r"mcp_asdf_robust\.h: high_word\(short_deviation\) .*",
    "slots whose lower half is nearer to their median than all others": r"mcp_asdf_robust\.h: "
    r"(const uint32_t distance_below = .*|if \(below > 0U .*)",
}
"""What a verification leaves out of the core, and why: patterns of "file: text of a line"."""


@pytest.fixture
def folder_of_verified_node(bus: UnixBus, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a coverage build of the node that has passed two verifications, with either filter.

    They are those of ``mcp-asdf radio --verify``, and all other settings are the default ones.
    """
    command = node_command(COVERAGE_BUILD, tmp_path_factory)
    for filter_name, config in (("asdf-plus", Config(TABLE)), ("robust", Config(filter=Filter.ROBUST))):
        with CNode(command, bus.channel_info, ID, "--lockstep", "--filter", filter_name) as node:
            bus.accept_node()
            assert_passes_verification(bus, config)
            node.stop()
    return Path(command[-1]).parent


def assert_passes_verification(bus: UnixBus, config: Config) -> None:
    """Check that the node on the bus passes the verification of a robot with these settings."""
    setup = RobotSetup(ID, "mirror", 0.95, config)
    bench = BenchOptions(bus, ticks=25, timeout=PATIENCE)
    verdict = Verification(settings_with_four_neighbours(setup), bench).run()
    assert verdict.has_passed, verdict.headline


@pytest.mark.slow
def test_the_radio_command_s_verdict_executes_every_line_and_branch_of_the_firmware(
    folder_of_verified_node: Path,
) -> None:
    """So a robot that passes has no untried code but the lines that NOT_EXECUTED lists with reasons.

    The keys of NOT_EXECUTED are reasons. A value is the pattern of the lines of C for which its reason holds.
    """
    lines_without_reason = []
    used_reasons = set()
    for line in unexecuted_lines(folder_of_verified_node):
        reasons = {reason for reason, pattern in NOT_EXECUTED.items() if re.fullmatch(pattern, line)}
        used_reasons |= reasons
        if not reasons:
            lines_without_reason.append(line)

    assert lines_without_reason == []
    assert used_reasons == set(NOT_EXECUTED), "a reason that is not needed any more is to be removed"
