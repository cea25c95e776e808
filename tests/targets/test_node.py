"""The C node says and computes what the Python node does, here and on a Cortex-A8, keeps time, and survives
faults of its surroundings.

The bus is a Unix socket here, so that the tests need no CAN; ``tests/socketcan`` has those on a real bus.
"""

from __future__ import annotations

import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
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
    Health,
    Heartbeat,
    Message,
    decode_heartbeat,
    encode,
    encode_command,
)
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
CAN_ERR_CRTL, CAN_ERR_PROT, CAN_ERR_BUSOFF, CAN_ERR_RESTARTED = 0x4, 0x8, 0x40, 0x100
FAST = ("--steps-per-second", 1000)


@pytest.fixture(scope="module", params=[HOST, *slow([CORTEX_A8])], ids=lambda kind: kind.name)
def command(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    kind: Kind = request.param
    return built(kind, tmp_path_factory)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UnixBus]:
    with UnixBus(tmp_path / "bus") as opened:
        yield opened


@pytest.fixture
def start(command: list[str], bus: UnixBus) -> Iterator[Start]:
    """Starts nodes on the bus, and stops those that are left."""
    started: list[CNode] = []

    def start_node(robot_id: int, *options: object, **streams: object) -> CNode:
        started.append(CNode(command, bus.channel_info, robot_id, *options, **streams))
        return started[-1]

    yield start_node
    for node in started:
        node.__exit__()


# ---- What Python nodes say ----


@pytest.mark.parametrize("comms_period", [1, 3])
def test_nodes_in_lockstep_say_what_python_nodes_say(start: Start, bus: UnixBus, comms_period: int) -> None:
    config: dict[str, Any] = {"filter_period": 12, "comms_period": comms_period, "steps_per_second": 7}
    options = ("--lockstep", "--filter-period", 12, "--comms-period", comms_period, "--steps-per-second", 7)
    nodes, twins = [], dict[int, RobotNode]()
    for robot, b_hat in enumerate((0.95, 0.55, 0.75)):
        nodes.append((start(robot, *options, "--steps", 61, "--b-hat", b_hat), bus.accept()))
        twins[robot] = twin(robot, b_hat, **config)
    said = {robot: each.start() for robot, each in twins.items()}
    draw, lockstep = random.Random(3), Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up(twins, PATIENCE)
    for tick in range(61):
        seen = {robot: Observation(draw.randrange(2)) for robot in twins}
        lockstep.observe(seen)
        if (tick + 1) % comms_period == 0:
            lockstep.estimates(twins)
        exchange(twins, said, {robot: Action.observing(z) for robot, z in seen.items()}, tick)
        lockstep.settle(twins)
        exchange(twins, said, dict.fromkeys(twins, Action.SETTLE), tick)
    figures = [node.summary() for node, _ in nodes]
    heard = [frame for _, peer in nodes for frame in peer.said]
    for (robot, expected), found in zip(twins.items(), figures, strict=True):
        assert (found["id"], found["ended"], found["collisions"]) == (robot, "ticks", 0)
        assert_same_robot(found, expected)
        assert content(said[robot]) == content(
            frame for frame in heard if frame.arbitration_id & MAX_NODE_ID == robot
        )
    assert sum(each["tests"] for each in figures) > 6 and sum(each["updates"] for each in figures) > 0


def exchange(
    nodes: dict[int, RobotNode], said: dict[int, list[can.Message]], orders: dict[int, Action], tick: int
) -> None:
    """Let Python nodes hear a command for each, and each of them all that the others say then."""
    for target, action in orders.items():
        frame = encode_command(Command(DRIVER_ID, tick, target, action, 0), Subjects().commands)
        for robot, node in nodes.items():
            answers = node.hear(frame)
            said[robot] += answers
            for answer in answers:
                for other in nodes.keys() - {robot}:
                    nodes[other].hear(answer)


SUBJECTS = Subjects(FrameFormat(7, 4), FrameFormat(8, 6), FrameFormat(9, 3))
ODD_SUBJECTS = ("--subject", 7, "--telemetry-subject", 8, "--command-subject", 9)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_frame_whatever_makes_them_differ(start: Start, bus: UnixBus, seed: int) -> None:
    firmware = ("--comms-period", 2, "--filter-period", 4, "--activation", "always", "--memory", 64)
    node = start(5, "--lockstep", "--steps-per-second", 3, *ODD_SUBJECTS, *firmware)
    peer = bus.accept()
    expected = twin(5, 0.95, SUBJECTS, 3, comms_period=2, filter_period=4, filter=Filter.ALWAYS, memory=64)
    draw = random.Random(seed)
    frames = [any_frame(draw) for _ in range(3000)]
    answers = expected.start() + [answer for frame in frames for answer in expected.hear(frame)]
    ends = (Action.SETTLE, Action.OBSERVE_BLACK, Action.SETTLE)  # the last answer shows that all was heard
    frames += [command_frame(expected._tick_of_command or 0, 5, action) for action in ends]
    answers += [answer for frame in frames[-3:] for answer in expected.hear(frame)]
    tell_and_hear(bus, peer, frames, len(answers))
    assert content(answers) == content(peer.said)
    figures = node.stop()
    assert node.complaints == [
        "mcp_asdf_node: another node sends under this node's own id: 5; give one of them another"
    ]
    assert_same_robot(figures, expected)
    rejected = figures["refused"] + figures["others"] + figures["error_frames"]
    assert rejected == expected.reception.rejected.total()
    often = (
        "refused",
        "others",
        "error_frames",
        "collisions",
        "obeyed",
        "disobeyed",
        "unsettled",
        "repeated",
    )
    assert all(figures[name] > 50 for name in (*often, "rejected"))
    assert figures["updates"] >= 5


def command_frame(tick: int, target: int, action: Action) -> can.Message:
    return encode_command(Command(126, tick, target, action, 0), SUBJECTS.commands)


def any_frame(draw: random.Random) -> can.Message:
    """A frame for the test above: legal, or with something wrong."""
    if draw.random() < 0.5:
        alpha = draw.choice((0, 0xFF, draw.getrandbits(32)))
        frame = encode(Message(draw.randrange(8), draw.randrange(2**23 + 1), alpha, 0), SUBJECTS.estimates)
    else:
        frame = command_frame(draw.randrange(2), draw.choice((5, 5, 255, 4)), draw.choice(list(Action)))
    if draw.random() < 0.7:
        return frame
    changes = draw.choice(SPOILT)(frame, draw)
    fields: dict[str, Any] = {"arbitration_id": frame.arbitration_id, "data": frame.data}
    return can.Message(**fields | changes)


SPOILT: tuple[Callable[[can.Message, random.Random], dict[str, Any]], ...] = (
    lambda frame, draw: {"arbitration_id": frame.arbitration_id ^ 1 << draw.randrange(29)},
    lambda frame, draw: {"data": draw.randbytes(8)},
    lambda frame, draw: {"data": frame.data[:3] + draw.randbytes(4) + frame.data[7:]},
    lambda frame, draw: {"data": frame.data[: draw.randrange(8)]},
    lambda frame, draw: {"data": b"\xff" * 7 + frame.data[7:]},
    lambda frame, draw: {"arbitration_id": frame.arbitration_id & 0x7FF, "is_extended_id": False},
    lambda frame, draw: {"data": None, "dlc": 8, "is_remote_frame": True},
    lambda frame, draw: {"is_fd": True},
    lambda frame, draw: {"arbitration_id": CAN_ERR_PROT, "is_error_frame": True},
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


# ---- Usage ----

LOCKSTEP, ON_A_BUS = "--id 1 --lockstep", "--interface unix:/no/such/socket "


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (ON_A_BUS + "--id 1x --lockstep", "--id is 1x; choose a whole number, 0 to 127"),
        (ON_A_BUS + f"--id 0 --lockstep --state {'x' * 4096}", "File name too long; choose another --state"),
        (ON_A_BUS + "--lockstep", "--id is missing; see --help"),
        (ON_A_BUS + "--id 1", "choose one of --lockstep, --observations, --sensor"),
        (ON_A_BUS + f"{LOCKSTEP} --b-hat nan", "--b-hat is nan; choose 2^-20 to 1 - 2^-20"),
        (ON_A_BUS + f"{LOCKSTEP} --comms-period 3", "--filter-period is 1000; choose a multiple"),
        (ON_A_BUS + f"{LOCKSTEP} --memory 66", "--memory is 66; choose a multiple of 4"),
        (ON_A_BUS + f"{LOCKSTEP} --steps 4294967296", "--steps is 4294967296; "),
        (ON_A_BUS + f"{LOCKSTEP} --subject 3002", "choose three different subjects"),
        (ON_A_BUS + f"{LOCKSTEP} surplus", "surplus belongs to no option"),
        (ON_A_BUS + "--id 1 --observations /no/such/file", "/no/such/file"),
        (LOCKSTEP, "--interface is missing"),
        (f"{LOCKSTEP} --interface nocan7", "modprobe vcan\n  ip link add dev nocan7 type vcan\n"),
        (ON_A_BUS + LOCKSTEP, "cannot join unix:/no/such/socket: "),
        (f"{LOCKSTEP} --interface unix:/{'x' * 200}", "cannot join unix:/xxx"),
    ],
)
def test_what_is_wrong_is_named(tmp_path_factory: pytest.TempPathFactory, options: str, told: str) -> None:
    node = [*built(HOST, tmp_path_factory), *options.split()]
    done = subprocess.run(node, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr


def test_analysers_find_nothing(tmp_path: Path) -> None:
    checks = ("--enable=warning,style,performance,portability", "--std=c99", "--quiet", "--error-exitcode=1")
    known = "--suppress=knownConditionTrueFalse"
    run(require("cppcheck", "cppcheck"), *checks, known, *DEFINITIONS, *C_FILES)
    options = ("-std=c99", "-fanalyzer", "-O2", "-Werror", *DEFINITIONS)
    run(require("gcc", "gcc"), *options, "-c", *C_FILES, cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("path", C_FILES, ids=lambda path: path.name)
def test_clang_tidy_finds_nothing(path: Path) -> None:
    run(require("clang-tidy"), "--quiet", path, "--", "-std=c99", *DEFINITIONS)


# ---- Observations and time ----


def test_observations_come_from_a_file_or_the_standard_input(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    draw, text = random.Random(7), tmp_path / "observations"
    symbols = [draw.choice("01-") for _ in range(300)]
    text.write_text("\n".join(symbols) + " \t\n", encoding="ascii")
    options = (*FAST, "--telemetry-period", 100, "--filter-period", 30, "--observations")
    expected = twin(5, filter_period=30)
    for symbol in symbols:
        expected.observe(None if symbol == "-" else Observation(int(symbol)))
        expected.settle()
    for path in (text, "-"):
        with text.open() as stream:
            node = start(5, *options, path, stdin=stream)
        bus.hear_out(bus.accept())
        figures = node.summary()
        assert (figures["ended"], figures["ticks"], figures["missing"]) == ("observations", 300, 0)
        assert (figures["t"], figures["n"]) == (300 - symbols.count("-"), symbols.count("1"))
        assert figures["x"] == int(expected.robot.x * 2**23)
        assert (figures["estimates"], figures["telemetry"], figures["heartbeats"]) == (300, 3, 1)


def test_what_is_no_observation_ends_the_run(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    text = tmp_path / "observations"
    text.write_text("1 x", encoding="ascii")
    node = start(5, *FAST, "--observations", text)
    bus.hear_out(bus.accept())
    figures = node.summary(status=1)
    assert (figures["ended"], figures["t"]) == ("observations not valid", 1)
    told = f"mcp_asdf_node: character 3 of {text} is no observation; write 0, 1 or -"
    assert node.complaints == [told]


def test_an_input_without_observations_is_missed_but_not_waited_for(start: Start, bus: UnixBus) -> None:
    ticks = ("--steps-per-second", 200, "--steps", 40, "--filter", "none")
    node = start(7, *ticks, "--observations", "-", stdin=subprocess.PIPE)
    bus.accept()
    assert node.process.stdin is not None
    for part in ("1 0", "11"):
        node.process.stdin.write(part)
        node.process.stdin.flush()
        time.sleep(0.05)
    node.process.wait(PATIENCE)
    figures = node.summary()
    assert [figures[name] for name in ("t", "n", "ended", "missing")] == [4, 3, "ticks", 36]


def test_a_sensor_s_file_is_read_anew_in_every_tick(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    sensor = tmp_path / "value"
    sensor.write_text("1\n", encoding="ascii")
    node = start(5, "--steps-per-second", 100, "--sensor", sensor)
    peer = bus.accept()
    for value in ("1\n", "0\n", "what?\n", None, "1"):
        sensor.with_suffix(".new").write_text(value or "", encoding="ascii")
        sensor.with_suffix(".new").replace(sensor)
        if value is None:
            sensor.unlink()
        wait_for_more(bus, peer, 6)
    figures = node.stop()
    assert 5 < figures["n"] < figures["t"]
    assert figures["missing"] > 5
    assert figures["t"] + figures["missing"] == figures["ticks"]
    assert figures["ended"] == "signal"


def wait_for_more(bus: UnixBus, peer: Peer, frames: int) -> None:
    goal = len(peer.said) + frames
    while len(peer.said) < goal:
        assert bus.recv(PATIENCE) is not None


@pytest.fixture
def blacks(tmp_path: Path) -> tuple[object, ...]:
    """Options of a robot that sees black 400 times."""
    (tmp_path / "observations").write_text("1" * 400, encoding="ascii")
    return ("--observations", tmp_path / "observations")


def test_the_clock_keeps_its_rate_and_leaves_out_what_it_missed(
    start: Start, bus: UnixBus, blacks: tuple[object, ...]
) -> None:
    begin = time.monotonic()
    node = start(5, "--steps-per-second", 100, *blacks)
    peer = bus.accept()
    wait_for_more(bus, peer, 60)
    node.process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)
    node.process.send_signal(signal.SIGCONT)
    wait_for_more(bus, peer, 5)
    figures = node.stop()
    assert figures["skipped"] >= 25
    assert figures["worst_lateness_us"] >= 250_000
    most = 100 * (time.monotonic() - begin) + 1
    assert figures["ticks"] + figures["skipped"] <= most, "faster than the clock"


# ---- Faults around it ----


def test_error_frames_show_in_the_node_s_health(start: Start, bus: UnixBus) -> None:
    node = start(5, "--lockstep", "--steps-per-second", 1)
    peer = bus.accept()
    reports = (
        (CAN_ERR_PROT, 0, Health.NOMINAL),
        (CAN_ERR_CRTL, 0x08, Health.ADVISORY),
        (CAN_ERR_CRTL, 0x10, Health.CAUTION),
        (CAN_ERR_CRTL, 0x40, Health.NOMINAL),
        (CAN_ERR_BUSOFF, 0, Health.WARNING),
        (CAN_ERR_PROT, 0, Health.WARNING),
        (CAN_ERR_RESTARTED, 0, Health.NOMINAL),
    )
    lockstep = Lockstep(bus, timeout=PATIENCE)
    lockstep.wait_until_up([5], PATIENCE)
    for kind, controller, _ in (reports[0], *reports):  # what the first tick says is of before
        data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
        bus.send(can.Message(arbitration_id=kind, is_error_frame=True, data=data))
        lockstep.observe({5: Observation.BLACK})
        lockstep.estimates([5])
        lockstep.settle([5])
    figures = node.stop()
    beats = [beat for frame in peer.said if isinstance(beat := decode_heartbeat(frame), Heartbeat)]
    assert [beat.health for beat in beats[1:]] == [health for *_, health in reports]
    assert (figures["error_frames"], figures["bus_off"]) == (8, 1)


def test_a_bus_that_closes_ends_the_run_with_a_failure(start: Start, bus: UnixBus) -> None:
    node = start(5, "--lockstep")
    bus.accept().connection.close()
    assert node.summary(status=1)["ended"] == "bus closed"


def test_a_full_queue_costs_frames_but_no_tick(
    start: Start, bus: UnixBus, blacks: tuple[object, ...]
) -> None:
    node = start(5, *FAST, *blacks)
    peer = bus.accept()
    figures = node.summary()  # meanwhile no one reads
    assert figures["t"] == 400
    assert figures["unsent"] > 0 < figures["queue_full"]
    bus.hear_out(peer)
    assert len(peer.said) == figures["estimates"] + figures["heartbeats"] - figures["unsent"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@interruptible()
def test_signals_end_the_run_cleanly(start: Start, bus: UnixBus, number: signal.Signals) -> None:
    node = start(5, "--lockstep")
    bus.accept()
    drive(bus, [5], 1, seed=1)
    figures = node.stop(number)
    assert (figures["ended"], figures["ticks"]) == ("signal", 1)


# ---- The state in a file ----


def saved(node: RobotNode) -> bytes:
    """The state of a Python node's robot."""
    image: bytes = node.robot.save()  # type: ignore[attr-defined]
    return image


def test_a_node_goes_on_where_it_was(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    text, state, expected = tmp_path / "observations", tmp_path / "state", twin(5, filter_period=10)
    options = (*FAST, "--filter-period", 10, "--state", state, "--observations", text)
    for symbols in ("011", "100", "111"):
        text.write_text(symbols, encoding="ascii")
        node = start(5, *options)
        bus.hear_out(bus.accept())
        assert node.summary()["ticks"] == 3
        for symbol in symbols:
            expected.robot.step(Observation(int(symbol)))
    assert state.read_bytes() == saved(expected)
    assert not state.with_name("state.new").exists()


def test_state_is_saved_in_between(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    node = start(5, "--lockstep", "--state", tmp_path / "state", "--save-period", 4)
    bus.accept()
    drive(bus, [5], 7, seed=3)
    node.process.kill()
    expected, draw = twin(5), random.Random(3)
    for _ in range(4):
        expected.robot.step(Observation(draw.randrange(2)))
    assert (tmp_path / "state").read_bytes() == saved(expected)


def test_a_state_that_does_not_fit_is_refused(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    image, state = saved(twin(5)), tmp_path / "state"
    cases = (
        (image[:-1], (), "damaged"),
        (image + b"x", (), "damaged"),
        (image[:20] + bytes([image[20] ^ 1]) + image[21:], (), "damaged"),
        (image, ("--filter-period", 10), "periods"),
        (saved(twin(6)), (), "another robot"),
        (None, (), str(tmp_path)),
    )
    for held, options, why in cases:
        if held is not None:
            state.write_bytes(held)
        node = start(5, "--lockstep", "--state", state if held else tmp_path, *options)
        printed, complaints = node.process.communicate(timeout=PATIENCE)
        assert (node.process.returncode, printed) == (2, "")
        assert why in complaints
        assert held in (None, state.read_bytes())


@pytest.mark.parametrize("fails", ["", "fsync:error=ENOSPC", "write:retval=50"])
def test_a_state_is_on_the_disk_before_it_replaces_the_last_one(
    bus: UnixBus,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    blacks: tuple[object, ...],
    fails: str,
) -> None:
    """A full disk does not stop the robot: the state of before stays, and one line tells."""
    trace, state = tmp_path / "trace", tmp_path / "state"
    state.write_bytes(before := saved(twin(5)))
    strace = [require("strace", "strace"), "-o", str(trace), "-P", f"{state}.new"]
    strace += ["-e", "trace=write,fsync,rename", *(["-e", f"inject={fails}"] if fails else [])]
    command = [*strace, *built(PLAIN, tmp_path_factory)]
    with CNode(command, bus.channel_info, 5, *FAST, *blacks, "--state", state, "--save-period", 300) as node:
        bus.hear_out(bus.accept())
        figures = node.summary(status=int(fails != ""))
    calls = [line for line in trace.read_text(encoding="utf-8").splitlines() if not line.startswith("+++")]
    assert figures["t"] == 400
    if fails:
        told = f"mcp_asdf_node: cannot save the state {state}: No space left on device; going on"
        assert node.complaints == [told]
        assert state.read_bytes() == before
        assert not state.with_name("state.new").exists()
    else:
        assert [call.partition("(")[0] for call in calls] == ["write", "fsync", "rename"] * 2
