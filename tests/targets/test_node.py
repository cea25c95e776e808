"""The C node says and computes what the Python node does, here and on a Cortex-A8.

The bus is a Unix socket here, so that the tests need no CAN; ``tests/socketcan`` has those on a real bus.
"""

from __future__ import annotations

import random
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.bus.frames import (
    MAX_NODE_ID,
    Action,
    Command,
    FrameFormat,
    Message,
    encode,
    encode_command,
)
from mcp_asdf_tools.bus.id_conflicts import IdConflictWatch
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from support import PATIENCE, ROOT, require, run
from targets.c_node import (
    HOST,
    SOURCES,
    Start,
    assert_same_robot,
    built,
    content,
    drive,
    twin,
)
from targets.unix_bus import Peer, UnixBus

C_FILES = sorted(SOURCES.glob("*.c"))


DEFINITIONS = ("-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=some_table", f"-I{ROOT / 'c_ref/src'}")


CAN_ERR_PROT = 0x8


BOTH = [Observation.WHITE, Observation.BLACK]


def replay(node: RobotNode, frames: list[can.Message]) -> list[can.Message]:
    """The answers of a Python node in lockstep to ``frames``."""
    return node.start() + [answer for frame in frames for answer in node.hear(frame)]


def test_nodes_in_lockstep_say_what_python_nodes_say(start: Start, bus: UnixBus) -> None:
    options = ("--lockstep", "--filter-period", 10, "--steps-per-second", 7, "--steps", 60)
    accuracies = (0.95, 0.55, 0.75)
    nodes, peers = [], []
    for robot, b_hat in enumerate(accuracies):
        nodes.append(start(robot, *options, "--b-hat", b_hat))
        peers.append(bus.accept())
    drive(bus, range(3), 60, seed=1)
    tests = updates = 0
    for robot, b_hat in enumerate(accuracies):
        expected = twin(robot, b_hat, steps_per_second=7, filter_period=10)
        assert content(replay(expected, peers[robot].told)) == content(peers[robot].said)
        figures = nodes[robot].summary()
        assert_same_robot(figures, expected)
        assert figures["ended"] == "ticks"
        assert figures["heartbeats"] == 9
        tests, updates = tests + figures["tests"], updates + figures["updates"]
    assert tests > 6 and updates > 0


@pytest.mark.parametrize("comms_period", [1, 3])
def test_robots_of_one_process_hear_each_other_as_robots_of_several_do(
    start: Start, bus: UnixBus, comms_period: int
) -> None:
    """One process of robots 1, 2, 3, one of 4 and 5: the same bits as Python nodes that all hear all."""
    periods = ("--filter-period", 12, "--comms-period", comms_period)
    options = ("--lockstep", *periods, "--steps", 61, "--activation", "always", "--b-hat", 0.7)
    ranges = {"1-3": range(1, 4), "4-5": range(4, 6)}
    nodes, peers = [], []
    for ids in ranges:
        nodes.append(start(ids, *options))
        peers.append(bus.accept())
    config: dict[str, Any] = {"filter_period": 12, "comms_period": comms_period, "filter": Filter.ALWAYS}
    twins = {robot: twin(robot, 0.7, **config) for robot in range(1, 6)}
    for each in twins.values():
        each.start()
    draw = random.Random(3)
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up(twins, PATIENCE)
    for tick in range(61):
        seen = {robot: draw.choice(BOTH) for robot in twins}
        lockstep.observe(seen)
        if (tick + 1) % comms_period == 0:
            lockstep.estimates(twins)
        exchange(
            twins, [Command(DRIVER_ID, tick, robot, Action.observing(z), 0) for robot, z in seen.items()]
        )
        lockstep.settle(twins)
        exchange(twins, [Command(DRIVER_ID, tick, robot, Action.SETTLE, 0) for robot in twins])
    for node, robots, peer in zip(nodes, ranges.values(), peers, strict=True):
        for figures, robot in zip(node.summaries(), robots, strict=True):
            assert (figures["id"], figures["ended"]) == (robot, "ticks")
            assert_same_robot(figures, twins[robot])
            assert figures["updates"] > 0 and figures["collisions"] == 0
        senders = {frame.arbitration_id & MAX_NODE_ID for frame in peer.said}
        assert senders == set(robots)


def exchange(nodes: dict[int, RobotNode], commands: list[Command]) -> None:
    """Let Python nodes hear the commands, and each of them all that the others say then."""
    for command in commands:
        frame = encode_command(command, Subjects().commands)
        for robot, node in nodes.items():
            for answer in node.hear(frame):
                for other in nodes.keys() - {robot}:
                    nodes[other].hear(answer)


SUBJECTS = Subjects(FrameFormat(7, 0), FrameFormat(8, 6), FrameFormat(9, 3))


ODD_SUBJECTS = ("--subject", 7, "--telemetry-subject", 8, "--command-subject", 9, "--priority", 0)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_frame_whatever_makes_them_differ(start: Start, bus: UnixBus, seed: int) -> None:
    firmware = ("--comms-period", 2, "--filter-period", 4, "--activation", "always", "--memory", 64)
    node = start(5, "--lockstep", "--steps-per-second", 3, *ODD_SUBJECTS, *firmware)
    peer = bus.accept()
    expected = twin(5, 0.95, SUBJECTS, 3, comms_period=2, filter_period=4, filter=Filter.ALWAYS, memory=64)
    draw = random.Random(seed)
    frames = [any_frame(draw) for _ in range(3000)]
    answers = replay(expected, frames)
    last = expected._tick_of_command or 0
    frames += [
        command_frame(last, 5, action) for action in (Action.SETTLE, Action.OBSERVE_BLACK, Action.SETTLE)
    ]
    answers += [answer for frame in frames[-3:] for answer in expected.hear(frame)]
    tell_and_hear(bus, peer, frames, len(answers))
    assert content(answers) == content(peer.said)
    figures = node.stop()
    assert_same_robot(figures, expected)
    rejected = figures["refused"] + figures["others"] + figures["error_frames"]
    assert rejected == expected.reception.rejected.total()
    assert all(figures[name] > 50 for name in ("refused", "others", "error_frames", "collisions"))
    assert all(figures[name] > 50 for name in ("obeyed", "disobeyed", "unsettled", "repeated", "rejected"))
    assert figures["updates"] >= 5


def command_frame(tick: int, target: int, action: Action) -> can.Message:
    return encode_command(Command(126, tick, target, action, 0), SUBJECTS.commands)


def any_frame(draw: random.Random) -> can.Message:
    """A frame for the test above: legal, or with something wrong."""
    if draw.random() < 0.5:
        message = Message(
            draw.randrange(8), draw.randrange(2**23 + 1), draw.choice((0, 0xFF, draw.getrandbits(32))), 0
        )
        frame = encode(message, SUBJECTS.estimates)
    else:
        action = draw.choice(list(Action))
        frame = command_frame(draw.randrange(2), draw.choice((5, 5, 255, 4)), action)
    if draw.random() < 0.7:
        return frame
    return draw.choice(SPOILERS)(frame, draw)


def spoilt(frame: can.Message, **changes: object) -> can.Message:
    fields = {"arbitration_id": frame.arbitration_id, "data": frame.data} | changes
    return can.Message(**fields)  # type: ignore[arg-type]


SPOILERS: tuple[Callable[[can.Message, random.Random], can.Message], ...] = (
    lambda frame, draw: spoilt(frame, arbitration_id=frame.arbitration_id ^ 1 << draw.randrange(29)),
    lambda frame, draw: spoilt(frame, data=draw.randbytes(8)),
    lambda frame, draw: spoilt(frame, data=frame.data[:3] + draw.randbytes(4) + frame.data[7:]),
    lambda frame, draw: spoilt(frame, data=frame.data[: draw.randrange(8)]),
    lambda frame, draw: spoilt(frame, data=b"\xff" * 7 + frame.data[7:]),
    lambda frame, draw: spoilt(frame, arbitration_id=frame.arbitration_id & 0x7FF, is_extended_id=False),
    lambda frame, draw: spoilt(frame, data=None, dlc=8, is_remote_frame=True),
    lambda frame, draw: spoilt(frame, is_fd=True),
    lambda frame, draw: spoilt(frame, arbitration_id=CAN_ERR_PROT, is_error_frame=True),
)


def tell_and_hear(bus: UnixBus, peer: Peer, frames: list[can.Message], answers: int) -> None:
    """Send all frames, and listen until there are so many answers."""
    for number, frame in enumerate(frames):
        bus.send(frame)
        if number % 20 == 19:  # else the answers fill the socket and are dropped
            while bus.recv(0) is not None:
                pass
    while len(peer.said) < answers:
        assert bus.recv(PATIENCE) is not None, f"{len(peer.said)} answers, expected {answers}"


@pytest.mark.parametrize("seed", range(3))
def test_it_notices_the_id_conflicts_that_a_python_node_does(start: Start, bus: UnixBus, seed: int) -> None:
    """Some ids have two senders; messages are lost, repeated and late, and senders restart."""
    draw, watch = random.Random(seed), IdConflictWatch(5)
    messages = arriving_messages(draw)
    for message in messages:
        watch.hear(message)
    order = list(watch.found)
    node = start(5, "--lockstep", "--subject", 7, "--command-subject", 9, "--priority", 0)
    peer = bus.accept()
    frames = [encode(message, SUBJECTS.estimates) for message in messages]
    tell_and_hear(bus, peer, [*frames, command_frame(1, 5, Action.OBSERVE_BLACK)], 2)
    figures = node.stop()
    assert figures["heard"] == len(messages)
    assert figures["id_conflicts"] == sorted(order), f"replay: random.Random({seed})"
    said = [f"mcp_asdf_node: {watch.found[each].value}: {each}; give one of them another" for each in order]
    assert node.complaints == said
    assert {5} < set(order) <= {3, 5, 7, 9}


def arriving_messages(draw: random.Random) -> list[Message]:
    """Messages of the ids 0 to 9 in the order of their arrival; 3, 5, 7 and 9 have two senders."""
    arrivals = []
    for robot in range(10):
        loss, late = draw.choice([0, 0.1, 0.2]), draw.choice([0, 3])
        for sender in range(1 + (robot in (3, 5, 7, 9))):
            count = draw.randrange(32)
            for number in range(150):
                count = 0 if draw.random() < 0.01 else count + 1
                message = Message(robot, draw.randrange(2**23), (2**23 + sender) << 8, count % 32)
                for _ in range(1 + (draw.random() < 0.05)):
                    if draw.random() >= loss:
                        arrivals.append((number + draw.uniform(0, late), message))
    return [message for _, message in sorted(arrivals, key=lambda each: each[0])]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("--id 128 --lockstep", "--id is 128; choose a whole number, 0 to 127"),
        ("--id 1x --lockstep", "--id is 1x; "),
        ("--id 5-3 --lockstep", "--id is 5-3; choose a whole number, 0 to 127, or a range such as 0-126"),
        ("--id 0-128 --lockstep", "--id is 0-128; "),
        ("--id 0-3 --sensor x", "--sensor is x; one sensor is for one robot"),
        ("--id 0-3 --lockstep --state x", "--state is x; robots need a file each: write {id} where"),
        (f"--id 0 --lockstep --state {'x' * 4096}", "x; choose a shorter path"),
        ("--lockstep", "--id is missing; see --help"),
        ("--id 1", "choose one of --lockstep, --observations, --sensor"),
        ("--id 1 --lockstep --b-hat 1", "--b-hat is 1; choose 2^-20 to 1 - 2^-20"),
        ("--id 1 --lockstep --b-hat nan", "--b-hat is nan; "),
        (
            "--id 1 --lockstep --comms-period 3",
            "--filter-period is 1000; choose a multiple",
        ),
        ("--id 1 --lockstep --memory 66", "--memory is 66; choose a multiple of 4"),
        ("--id 1 --lockstep --steps 4294967296", "--steps is 4294967296; "),
        ("--id 1 --lockstep --subject 3002", "choose three different subjects"),
        ("--id 1 --observations /no/such/file", "/no/such/file"),
        ("--id 1 --lockstep surplus", "surplus belongs to no option"),
    ],
)
def test_what_is_wrong_is_named(tmp_path_factory: pytest.TempPathFactory, options: str, told: str) -> None:
    command = built(HOST, tmp_path_factory)
    assert told in refusal(command, "--interface", "unix:/no/such/socket", *options.split())


def refusal(command: list[str], *options: str) -> str:
    """The node's error message for invalid options."""
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (2, "")
    return done.stderr


def test_a_bus_that_cannot_be_joined_is_named(command: list[str], tmp_path: Path) -> None:
    node = ("--id", "1", "--lockstep")
    assert "--interface is missing" in refusal(command, *node)
    told = refusal(command, *node, "--interface", "nocan7")
    commands = ("modprobe vcan", "ip link add dev nocan7 type vcan", "ip link set nocan7 up")
    assert [line.strip() for line in told.splitlines()[1:]] == list(commands)
    for path in ("/no/such/socket", str(tmp_path), "/" + "x" * 200):
        assert f"cannot join unix:{path}: " in refusal(command, *node, "--interface", f"unix:{path}")


@pytest.mark.slow
@pytest.mark.parametrize("path", C_FILES, ids=lambda path: path.name)
def test_clang_tidy_finds_nothing(path: Path) -> None:
    run(require("clang-tidy"), "--quiet", path, "--", "-std=c99", *DEFINITIONS)


def test_cppcheck_finds_nothing() -> None:
    checks = ("--enable=warning,style,performance,portability", "--std=c99", "--quiet", "--error-exitcode=1")
    run(
        require("cppcheck", "cppcheck"), *checks, "--suppress=knownConditionTrueFalse", *DEFINITIONS, *C_FILES
    )


def test_gcc_s_analyser_finds_nothing(tmp_path: Path) -> None:
    options = ("-std=c99", "-fanalyzer", "-O2", "-Werror", *DEFINITIONS)
    run(require("gcc", "gcc"), *options, "-c", *C_FILES, cwd=tmp_path)
