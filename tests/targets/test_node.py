"""The C node says and computes what the Python node does, here and on a Cortex-A8, and survives faults.

The bus is a Unix socket here, so that the tests need no CAN; ``tests/socketcan`` has those on a real bus.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import can
import pytest
from cffi import FFI
from hypothesis import given, settings
from hypothesis import strategies as st

from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.bus.frames import (
    MAX_NODE_ID,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Telemetry,
    decode_heartbeat,
    decode_telemetry,
    encode,
    encode_command,
)
from mcp_asdf_tools.bus.id_conflicts import IdConflictWatch
from mcp_asdf_tools.robots.lockstep import DRIVER_ID, Lockstep
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from support import PATIENCE, ROOT, interruptible, require, run, slow
from targets.c_node import (
    CORTEX_A8,
    HOST,
    PLAIN,
    SOURCES,
    CNode,
    Kind,
    assert_same_robot,
    built,
    content,
    twin,
)
from targets.unix_bus import Peer, UnixBus

C_FILES = sorted(SOURCES.glob("*.c"))
DEFINITIONS = ("-D_GNU_SOURCE", "-DMCP_ASDF_NODE_TABLE=some_table", f"-I{ROOT / 'c_ref/src'}")
CAN_ERR_CRTL, CAN_ERR_PROT, CAN_ERR_BUSOFF, CAN_ERR_RESTARTED = 0x4, 0x8, 0x40, 0x100
BOTH = [Observation.WHITE, Observation.BLACK]


@pytest.fixture(scope="module", params=[HOST, *slow([CORTEX_A8])], ids=lambda kind: kind.name)
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    kind: Kind = request.param
    return built(kind, tmp_path_factory)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UnixBus]:
    with UnixBus(tmp_path / "bus") as opened:
        yield opened


Start = Callable[..., CNode]


@pytest.fixture
def start(command: list[str], bus: UnixBus) -> Iterator[Start]:
    """Starts nodes on the bus, and stops those that are left."""
    started: list[CNode] = []

    def start_node(robot_id: int | str, *options: object, **streams: object) -> CNode:
        started.append(CNode(command, bus.channel_info, robot_id, *options, **streams))
        return started[-1]

    yield start_node
    for node in started:
        node.__exit__()


def replay(node: RobotNode, frames: list[can.Message]) -> list[can.Message]:
    """The answers of a Python node in lockstep to ``frames``."""
    return node.start() + [answer for frame in frames for answer in node.hear(frame)]


# ---- Lockstep: the same frames, the same bits ----


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


def drive(bus: UnixBus, robots: range, ticks: int, seed: int) -> None:
    """Let robots observe what a seeded generator draws, exchange, and settle."""
    draw = random.Random(seed)
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up(robots, PATIENCE)
    for _ in range(ticks):
        lockstep.observe({robot: draw.choice(BOTH) for robot in robots})
        lockstep.estimates(robots)
        lockstep.settle(robots)


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


def test_each_robot_of_a_process_has_its_observations_and_its_state(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    """Two steps of three robots, by rising id; then, from their files, one more."""
    text = tmp_path / "observations"
    options = ("--steps-per-second", 1000, "--filter", "none", "--state", tmp_path / "of {id}.state")
    totals = {7: [0, 0], 8: [0, 0], 9: [0, 0]}
    for symbols in ("01-\n11-\n", "-01\n"):
        text.write_text(symbols, encoding="ascii")
        node = start("7-9", *options, "--observations", text)
        hear_out(bus, bus.accept())
        for place, symbol in enumerate(symbols.replace("\n", "")):
            totals[7 + place % 3][0] += symbol != "-"
            totals[7 + place % 3][1] += symbol == "1"
        figures = node.summaries()
        assert [each["ended"] for each in figures] == ["observations"] * 3
        assert {each["id"]: [each["t"], each["n"]] for each in figures} == totals
    assert sorted(path.name for path in tmp_path.glob("*.state")) == [f"of {n}.state" for n in (7, 8, 9)]


def test_a_row_that_comes_in_parts_shifts_no_robot_s_observations(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    """Robot 7 sees black and 8 white, wherever a writer's buffer happens to end."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    node = start("7-8", "--filter", "none", "--steps-per-second", 200, "--observations", pipe)
    with pipe.open("w", encoding="ascii") as stream:
        peer = bus.accept()
        for part in ("1 0 1", "0 10 1", "0"):
            stream.write(part)
            stream.flush()
            time.sleep(0.05)
    hear_out(bus, peer)
    assert {each["id"]: (each["t"], each["n"]) for each in node.summaries()} == {7: (4, 4), 8: (4, 0)}


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


# ---- Real time ----


def test_observations_come_from_a_file_or_the_standard_input(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    draw = random.Random(7)
    symbols = [draw.choice("01-") for _ in range(300)]
    text = tmp_path / "observations"
    text.write_text("\n".join(symbols) + " \t\n", encoding="ascii")
    options = ("--steps-per-second", 1000, "--telemetry-period", 100, "--filter-period", 30, "--observations")
    expected = twin(5, filter_period=30)
    for symbol in symbols:
        expected.observe(None if symbol == "-" else Observation(int(symbol)))
        expected.settle()
    for path in (text, "-"):
        with text.open() as stream:
            node = start(5, *options, path, stdin=stream)
        peer = bus.accept()
        hear_out(bus, peer)
        hear_out(bus, peer)
        figures = node.summary()
        assert (figures["ended"], figures["ticks"], figures["missing"]) == ("observations", 300, 0)
        assert (figures["t"], figures["n"]) == (300 - symbols.count("-"), symbols.count("1"))
        assert figures["x"] == int(expected.robot.x * 2**23)
        assert (figures["estimates"], figures["telemetry"], figures["heartbeats"]) == (300, 3, 1)
        telemetry = [each for frame in peer.said if isinstance(each := decode_telemetry(frame), Telemetry)]
        assert [each.transfer_id for each in telemetry] == [0, 1, 2]
        assert telemetry[-1].x == figures["x"]


def hear_out(bus: UnixBus, peer: Peer) -> None:
    """Listen until a node has ended."""
    while not peer.is_gone:
        bus.recv(0.1)


def test_an_input_without_observations_is_missed_but_not_waited_for(start: Start, bus: UnixBus) -> None:
    node = start(5, "--steps-per-second", 200, "--steps", 40, "--observations", "-", stdin=subprocess.PIPE)
    bus.accept()
    assert node.process.stdin is not None
    node.process.stdin.write("1\n1 0")
    node.process.stdin.flush()
    figures = {**waited(node)}
    assert (figures["t"], figures["n"], figures["ended"]) == (3, 2, "ticks")
    assert figures["missing"] == 37


def waited(node: CNode) -> dict[str, object]:
    """Its summary, while its standard input stays open."""
    node.process.wait(PATIENCE)
    return node.summary()


def test_a_sensor_s_file_is_read_anew_in_every_tick(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    sensor = tmp_path / "value"
    sensor.write_text("1\n", encoding="ascii")
    node = start(5, "--steps-per-second", 100, "--sensor", sensor)
    peer = bus.accept()
    seen = []
    for content_now in ("1\n", "0\n", "what?\n", None, "1"):
        replace(sensor, content_now)
        seen.append(len(peer.said))
        wait_for_more(bus, peer, 6)
    figures = node.stop()
    assert 5 < figures["n"] < figures["t"]
    assert figures["missing"] > 5
    assert figures["t"] + figures["missing"] == figures["ticks"]
    assert figures["ended"] == "signal"


def replace(path: Path, text: str | None) -> None:
    """Let the file at once have another content, or not be there."""
    if text is None:
        path.unlink()
    else:
        path.with_suffix(".new").write_text(text, encoding="ascii")
        path.with_suffix(".new").replace(path)


def wait_for_more(bus: UnixBus, peer: Peer, frames: int) -> None:
    goal = len(peer.said) + frames
    while len(peer.said) < goal:
        assert bus.recv(PATIENCE) is not None


def test_the_clock_keeps_its_rate_and_leaves_out_what_it_missed(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    text = tmp_path / "observations"
    text.write_text("01" * 1000, encoding="ascii")
    begin = time.monotonic()
    node = start(5, "--steps-per-second", 100, "--observations", text)
    peer = bus.accept()
    wait_for_more(bus, peer, 60)
    node.process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)
    node.process.send_signal(signal.SIGCONT)
    wait_for_more(bus, peer, 5)
    figures = node.stop()
    elapsed = time.monotonic() - begin
    assert figures["skipped"] >= 25
    assert figures["worst_lateness_us"] >= 250_000
    assert figures["ticks"] + figures["skipped"] <= 100 * elapsed + 1, "faster than the clock"


# ---- Faults of the surroundings ----


def test_error_frames_show_in_the_node_s_health(start: Start, bus: UnixBus) -> None:
    node = start(5, "--lockstep", "--steps-per-second", 1)
    peer = bus.accept()
    told: list[Health] = []
    reports = (
        (CAN_ERR_PROT, 0, Health.NOMINAL),
        (CAN_ERR_CRTL, 0x08, Health.ADVISORY),
        (CAN_ERR_CRTL, 0x10, Health.CAUTION),
        (CAN_ERR_CRTL, 0x40, Health.NOMINAL),
        (CAN_ERR_BUSOFF, 0, Health.WARNING),
        (CAN_ERR_PROT, 0, Health.WARNING),
        (CAN_ERR_RESTARTED, 0, Health.NOMINAL),
    )
    lockstep = Lockstep(bus, timeout=PATIENCE, watch=lambda frame: told.extend(health_in(frame)))
    lockstep.wait_until_up([5], PATIENCE)
    for kind, controller, _ in ((CAN_ERR_PROT, 0, None), *reports):
        data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
        bus.send(can.Message(arbitration_id=kind, is_error_frame=True, data=data))
        lockstep.observe({5: Observation.BLACK})
        lockstep.estimates([5])
        lockstep.settle([5])
    assert told[1:] == [health for *_, health in reports]  # the first is that of the start
    figures = node.stop()
    assert (figures["error_frames"], figures["bus_off"]) == (8, 1)
    assert len(peer.said) == 8 + 8 + 8


def health_in(frame: can.Message) -> list[Health]:
    heartbeat = decode_heartbeat(frame)
    return [heartbeat.health] if isinstance(heartbeat, Heartbeat) else []


def test_a_bus_that_closes_ends_the_run_with_a_failure(start: Start, bus: UnixBus) -> None:
    node = start(5, "--lockstep")
    bus.accept().connection.close()
    assert node.summary(status=1)["ended"] == "bus closed"


def test_a_full_queue_costs_frames_but_no_tick(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    text = tmp_path / "observations"
    text.write_text("1" * 400, encoding="ascii")
    node = start(5, "--steps-per-second", 1000, "--observations", text)
    peer = bus.accept()
    figures = node.summary()  # meanwhile no one reads
    assert figures["t"] == 400
    assert figures["unsent"] > 0 < figures["queue_full"]
    hear_out(bus, peer)
    assert len(peer.said) == figures["estimates"] + figures["heartbeats"] - figures["unsent"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@interruptible()
def test_signals_end_the_run_cleanly(start: Start, bus: UnixBus, number: signal.Signals) -> None:
    node = start(5, "--lockstep")
    drive_one(bus, bus.accept())
    figures = node.stop(number)
    assert (figures["ended"], figures["ticks"]) == ("signal", 1)


def drive_one(bus: UnixBus, peer: Peer) -> None:
    drive(bus, range(5, 6), 1, seed=1)
    assert len(peer.said) == 3


# ---- State ----


def test_a_node_goes_on_where_it_was(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    text, state = tmp_path / "observations", tmp_path / "state"
    text.write_text("110", encoding="ascii")
    options = ("--filter-period", 10, "--state", state, "--steps-per-second", 1000, "--observations", text)
    expected = twin(5, filter_period=10)
    for _ in range(4):
        node = start(5, *options)
        peer = bus.accept()
        figures = node.summary()
        hear_out(bus, peer)
        for symbol in "110":
            expected.robot.step(Observation(int(symbol)))
    assert (figures["t"], figures["n"], figures["ticks"]) == (12, 8, 3)
    assert figures["x"] == int(expected.robot.x * 2**23)
    assert state.read_bytes() == expected.robot.save()  # type: ignore[attr-defined]
    assert not state.with_name("state.new").exists()


def test_state_is_saved_in_between(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    state = tmp_path / "state"
    node = start(5, "--lockstep", "--state", state, "--save-period", 4)
    bus.accept()
    drive(bus, range(5, 6), 7, seed=3)
    node.process.kill()
    expected, draw = twin(5), random.Random(3)
    for _ in range(4):
        expected.robot.step(draw.choice(BOTH))
    assert state.read_bytes() == expected.robot.save()  # type: ignore[attr-defined]


def test_a_state_that_does_not_fit_is_refused(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    image = twin(5).robot.save()  # type: ignore[attr-defined]
    cases = (
        (image[:-1], (), "damaged"),
        (image + b"x", (), "damaged"),
        (image[:20] + bytes([image[20] ^ 1]) + image[21:], (), "damaged"),
        (image, ("--filter-period", 10), "periods"),
        (twin(6).robot.save(), (), "another robot"),  # type: ignore[attr-defined]
    )
    state = tmp_path / "state"
    for content_now, options, why in cases:
        state.write_bytes(content_now)
        assert why in complaint(start(5, "--lockstep", "--state", state, *options))
        assert state.read_bytes() == content_now
    assert "state" in complaint(start(5, "--lockstep", "--state", tmp_path))


def test_a_full_disk_does_not_stop_the_robot(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    """Files of at most 50 bytes stand for it: the state of before stays, and one line tells."""
    text, state = tmp_path / "observations", tmp_path / "state"
    text.write_text("1" * 100, encoding="ascii")
    state.write_bytes(before := twin(5).robot.save())  # type: ignore[attr-defined]
    options = ("--state", state, "--save-period", 10, "--steps-per-second", 1000, "--observations", text)
    node = start(
        5,
        *options,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50, 50)),
        restore_signals=False,  # Python ignores SIGXFSZ; so must the node here
    )
    hear_out(bus, bus.accept())
    figures = node.summary(status=1)
    assert figures["t"] == 100
    assert node.complaints == [
        f"mcp_asdf_node: cannot save the state {state}: No space left on device; going on"
    ]
    assert state.read_bytes() == before
    assert not state.with_name("state.new").exists()


def complaint(node: CNode) -> str:
    """The error message of a node that does not start."""
    printed, complaints = node.process.communicate(timeout=PATIENCE)
    assert (node.process.returncode, printed) == (2, "")
    return str(complaints)


# ---- What the kernel is asked for, and when ----


def traced(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, bus: UnixBus, strace: str, *options: object
) -> tuple[dict[str, Any], list[str]]:
    """The summary of a node under strace, and the calls that were written down."""
    trace = tmp_path / "trace"
    command = [require("strace", "strace"), "-o", trace, *strace.split(), *built(PLAIN, tmp_path_factory)]
    options = ("--steps-per-second", 1000, *options)
    with CNode(list(map(str, command)), bus.channel_info, 5, *options) as node:
        hear_out(bus, bus.accept())
        return node.summary(), trace.read_text(encoding="utf-8").splitlines()


def test_a_state_is_on_the_disk_before_it_replaces_the_last_one(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, state = tmp_path / "observations", tmp_path / "state"
    text.write_text("101", encoding="ascii")
    options = ("--state", state, "--observations", text)
    _, calls = traced(tmp_path, tmp_path_factory, bus, "-e trace=fsync,rename", *options)
    ends = [call for call in calls if not call.startswith("+++")]
    assert [call.partition("(")[0] for call in ends] == ["fsync", "rename"]
    assert all(call.endswith("= 0") for call in ends)


def test_a_signal_that_interrupts_reading_does_not_end_the_input(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text = tmp_path / "observations"
    text.write_text("1011", encoding="ascii")
    interrupted = f"-e trace=read -P {text} -e inject=read:error=EINTR:when=1"
    figures, calls = traced(tmp_path, tmp_path_factory, bus, interrupted, "--observations", text)
    assert "EINTR" in calls[0]
    assert (figures["t"], figures["n"], figures["missing"]) == (4, 3, 1)


@given(st.integers(1000, 10**9), st.integers(0, 10**12), st.lists(st.integers(0, 10**10), min_size=1))
@settings(deadline=None)
def test_the_ticker_leaves_out_exactly_the_ticks_that_it_missed(
    period: int, begin: int, waits: list[int]
) -> None:
    """Ticks are due at begin + k period; one that is taken late takes the place of all up to then."""
    ffi, library = ticker()
    one, now, taken, worst = ffi.new("ticker_t *", library.ticker_start(period, begin)), begin, 0, 0
    for wait in waits:
        now += wait
        due = begin + (taken + one.skipped) * period
        assert library.ticker_is_due(one, now) == (now >= due)
        if now >= due:
            taken, worst = taken + 1, max(worst, now - due)
            assert one.next - period <= now < one.next
        assert (one.next, one.worst) == (begin + (taken + one.skipped) * period, worst)


@cache
def ticker() -> tuple[FFI, Any]:
    """ticker.c as a library."""
    ffi, folder = FFI(), Path(tempfile.mkdtemp())
    ffi.cdef(
        "typedef struct { int64_t period, next, worst; uint32_t skipped; } ticker_t;"
        "ticker_t ticker_start(int64_t period, int64_t now);"
        "bool ticker_is_due(ticker_t *ticker, int64_t now);"
    )
    run(require("gcc"), "-shared", "-fPIC", SOURCES / "ticker.c", "-o", folder / "ticker.so")
    return ffi, ffi.dlopen(str(folder / "ticker.so"))


# ---- Bad usage ----


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


# ---- The sources ----


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
