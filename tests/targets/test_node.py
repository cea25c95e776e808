"""The C node says and computes what the Python node does, here and on a Cortex-A8, keeps time, and survives
faults of its surroundings.

The bus is a Unix socket here, so that the tests need no CAN; ``tests/socketcan`` has those on a real bus.
"""

from __future__ import annotations

import fcntl
import json
import os
import random
import re
import signal
import subprocess
import termios
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus.frame_layout import Action, Health
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
from support import PATIENCE, interruptible, require, slow
from targets.c_node import (
    CORTEX_A8,
    COVERED,
    HOST,
    PLAIN,
    TABLE,
    CNode,
    Kind,
    Start,
    assert_same_robot,
    built,
    content,
    drive,
    twin,
    unexecuted,
)
from targets.unix_bus import UnixBus
from wrong_robots import surroundings

ID = 101
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
def start(command: list[str], bus: UnixBus) -> Iterator[Callable[..., CNode]]:
    """Starts nodes on the bus, one at a time, and stops those that are left."""
    with ExitStack() as started:

        def start_node(*options: object, **streams: object) -> CNode:
            node = started.enter_context(CNode(command, bus.channel_info, ID, *options, **streams))
            bus.accept()
            return node

        yield start_node


# ---- What a Python node says ----


SUBJECTS = Subjects(FrameFormat(0, 4), FrameFormat(8, 6), FrameFormat(9, 3))


FILTERS = {
    Filter.ALWAYS: "--activation always",
    Filter.ADAPTIVE: "--activation adaptive",
    Filter.ROBUST: "--filter robust",
}


@pytest.mark.parametrize("chosen", FILTERS)
def test_no_frame_whatever_makes_them_differ(start: Start, bus: UnixBus, chosen: Filter) -> None:
    config = {"comms_period": 2, "filter_period": 4, "memory": 64}
    words = [word for name, value in config.items() for word in (f"--{name.replace('_', '-')}", value)]
    node = start(
        *("--lockstep", "--steps-per-second", 3, "--b-hat", 0.75, *FILTERS[chosen].split()),
        *("--subject", 0, "--telemetry-subject", 8, "--command-subject", 9, *words, "--allow", "0+2-5"),
        *("--receive-buffer", 0, "--save-period", 0, "--telemetry-period", 0),
    )
    expected = twin(ID, 0.75, SUBJECTS, 3, filter=chosen, allow=frozenset((0, *range(2, 6))), **config)
    draw = random.Random(chosen)
    frames = [any_frame(draw) for _ in range(3000)]
    answers = expected.start() + [answer for frame in frames for answer in expected.receive_frame(frame)]
    ends = (Action.SETTLE, Action.OBSERVE_BLACK, Action.SETTLE)  # the last answer shows that all was heard
    frames += [command_frame(expected._tick_of_command or 0, ID, action) for action in ends]
    answers += [answer for frame in frames[-3:] for answer in expected.receive_frame(frame)]
    for number, frame in enumerate(frames):
        bus.send(frame)
        if number % 20 == 19:  # else the answers fill the socket and are dropped
            while bus.recv(0) is not None:
                pass
    bus.hear(len(answers) - len(bus.said))
    assert content(answers) == content(bus.said)
    figures = node.stop()
    assert node.complaints == [
        f"mcp_asdf_node: another node sends under this node's own id: {ID}; give one of them another"
    ]
    assert_same_robot(figures, expected)
    rejected = figures["refused"] + figures["others"] + figures["error_frames"]
    assert rejected == expected.reception.rejected.total()
    counted = Counter(kind.value for kind, _ in expected.reception.events.elements())
    found = {"conflict": "collisions", "unknown": "unknown", "jump": "jumps"}
    assert {kind: figures[name] for kind, name in found.items()} == dict.fromkeys(found, 0) | counted
    often = "unknown refused others error_frames collisions obeyed disobeyed unsettled repeated rejected"
    assert all(figures[name] > 50 for name in often.split())
    assert figures["updates" if chosen == Filter.ALWAYS else "tests"] >= 5


def command_frame(tick: int, target: int, action: Action, subjects: Subjects = SUBJECTS) -> can.Message:
    return encode_command(Command(126, tick, target, action, 0), subjects.commands)


def any_frame(draw: random.Random, own: int = ID, subjects: Subjects = SUBJECTS) -> can.Message:
    """A frame that a robot may hear: legal, or with something wrong."""
    if draw.random() < 0.5:
        sender, alpha = draw.choice((own, *range(7))), draw.choice((0, 0xFF, draw.getrandbits(32)))
        frame = encode_estimate(Estimate(sender, draw.randrange(2**23 + 1), alpha, 0), subjects.estimates)
    else:
        target, action = draw.choice((own, own, 255, 4)), draw.choice(list(Action))
        frame = command_frame(draw.randrange(2), target, action, subjects)
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


@pytest.mark.slow
def test_a_node_says_that_it_is_there_until_it_is_commanded(start: Start, bus: UnixBus) -> None:
    node = start("--lockstep")
    began = time.monotonic()
    while bus.greetings < 2:
        assert bus.recv(PATIENCE) is not None
    assert time.monotonic() - began > 0.9
    drive(bus, [ID], 15, seed=1)
    time.sleep(1.1)  # it has been commanded
    assert bus.recv(0) is None
    figures = node.stop()
    assert (figures["heartbeats"], figures["ticks"]) == (2, 15)
    assert [beat.uptime for each in bus.said if isinstance(beat := decode_heartbeat(each), Heartbeat)] == [
        0,
        1,
    ]


# ---- Usage ----

LOCKSTEP, ON_A_BUS = "--id 1 --lockstep", "--interface unix:/no/such/socket "


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (ON_A_BUS + "--id 1x --lockstep", "--id is 1x; choose a whole number, 0 to 127"),
        (ON_A_BUS + "--lockstep", "--id is missing; see --help"),
        *(
            (f"{ON_A_BUS}{LOCKSTEP} --allow {ids}", f"--allow is {ids}; give ids, 0 to 127, such as 0-19+30")
            for ids in ("x", "5-3", "0-", "+1", "1+", "128", "-1", "0-1-2", "1,2")
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
        (
            f"{LOCKSTEP} --interface udp:[ff15::1]:65536",
            "Invalid argument; name a multicast group and a port",
        ),
        (
            f"{LOCKSTEP} --interface udp:239.74.163.2:9 --network no7",
            "No such device; name an interface that",
        ),
        (
            ON_A_BUS + LOCKSTEP + " --network lo",
            "--network is lo; leave it out, or choose an --interface udp",
        ),
        (ON_A_BUS + LOCKSTEP + " --hop-limit 0", "--hop-limit is 0; leave it out, or"),
        (ON_A_BUS + LOCKSTEP, "cannot join unix:/no/such/socket: "),
        (f"{LOCKSTEP} --interface unix:/{'x' * 200}", "cannot join unix:/xxx"),
    ],
)
def test_what_is_wrong_is_named(tmp_path_factory: pytest.TempPathFactory, options: str, told: str) -> None:
    node = [*built(HOST, tmp_path_factory), *options.split()]
    done = subprocess.run(node, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr


# ---- Observations and time ----


def test_observations_come_from_a_file_or_the_standard_input(
    start: Start, bus: UnixBus, tmp_path: Path
) -> None:
    draw, text = random.Random(7), tmp_path / "observations"
    symbols = [draw.choice("01-") for _ in range(300)]
    text.write_text("\n".join(symbols) + " \t\n", encoding="ascii")
    options = (*FAST, "--telemetry-period", 100, "--filter-period", 30, "--observations")
    expected = twin(ID, filter_period=30)
    for symbol in symbols:
        expected.observe(None if symbol == "-" else Observation(int(symbol)))
        expected.settle()
    for path in (text, "-"):
        with text.open() as stream:
            node = start(*options, path, stdin=stream)
        bus.hear_out()
        figures = node.summary()
        assert (figures["ended"], figures["ticks"], figures["missing"]) == ("observations", 300, 0)
        assert (figures["t"], figures["n"]) == (300 - symbols.count("-"), symbols.count("1"))
        assert figures["x"] == int(expected.robot.x * 2**23)
        assert (figures["estimates"], figures["telemetry"], figures["heartbeats"]) == (300, 3, 1)


@pytest.mark.parametrize("character", ["x", "\0"])
def test_a_character_that_is_no_observation_ends_the_run(
    start: Start, bus: UnixBus, tmp_path: Path, character: str
) -> None:
    text = tmp_path / "observations"
    text.write_text(f"1 {character}", encoding="ascii")
    node = start(*FAST, "--observations", text)
    bus.hear_out()
    figures = node.summary(status=1)
    assert (figures["ended"], figures["t"]) == ("observations not valid", 1)
    told = f"mcp_asdf_node: character 3 of {text} is no observation; write 0, 1 or -"
    assert node.complaints == [told]


def test_an_input_without_observations_is_missed_but_not_waited_for(start: Start, bus: UnixBus) -> None:
    node = start("--steps-per-second", 200, "--observations", "-", stdin=subprocess.PIPE)
    assert node.process.stdin is not None
    for part in ("1 0", "11"):
        node.process.stdin.write(part)
        node.process.stdin.flush()
        bus.hear(8)
    figures = node.stop()
    assert (figures["t"], figures["n"], figures["missing"]) == (4, 3, figures["ticks"] - 4)


def test_a_sensor_s_file_is_read_anew_in_every_tick(start: Start, bus: UnixBus, tmp_path: Path) -> None:
    sensor = tmp_path / "value"
    sensor.write_text("1\n", encoding="ascii")
    node = start("--steps-per-second", 100, "--sensor", sensor)
    for value in ("1\n", "0\n", "what?\n", None, "1"):
        sensor.with_suffix(".new").write_text(value or "", encoding="ascii")
        sensor.with_suffix(".new").replace(sensor)
        if value is None:
            sensor.unlink()
        bus.hear(6)
    figures = node.stop()
    assert 5 < figures["n"] < figures["t"]
    assert figures["missing"] > 5
    assert figures["t"] + figures["missing"] == figures["ticks"]
    assert figures["ended"] == "signal"


@pytest.fixture
def blacks(tmp_path: Path) -> tuple[object, ...]:
    """Options of a robot that sees black 400 times."""
    (tmp_path / "observations").write_text("1" * 400, encoding="ascii")
    return ("--observations", tmp_path / "observations")


def test_the_clock_keeps_its_rate_and_leaves_out_what_it_missed(
    start: Start, bus: UnixBus, blacks: tuple[object, ...]
) -> None:
    begin = time.monotonic()
    node = start("--steps-per-second", 100, *blacks)
    bus.hear(60)
    node.process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)
    node.process.send_signal(signal.SIGCONT)
    bus.hear(5)
    figures = node.stop()
    assert figures["skipped"] >= 25
    assert figures["worst_lateness_us"] >= 250_000
    most = 100 * (time.monotonic() - begin) + 1
    assert figures["ticks"] + figures["skipped"] <= most, "faster than the clock"


# ---- Faults around it ----


def test_error_frames_show_in_the_node_s_health(start: Start, bus: UnixBus) -> None:
    node = start("--lockstep", "--steps-per-second", 1, "--steps", 8)
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
    lockstep.wait_until_up([ID], PATIENCE)
    for kind, controller, _ in (reports[0], *reports):  # what the first tick says is of before
        data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
        bus.send(can.Message(arbitration_id=kind, is_error_frame=True, data=data))
        lockstep.observe({ID: Observation.BLACK})
        lockstep.estimates([ID])
        lockstep.settle([ID])
    figures = node.summary()
    beats = [beat for frame in bus.said if isinstance(beat := decode_heartbeat(frame), Heartbeat)]
    assert [beat.health for beat in beats[1:]] == [health for *_, health in reports]
    assert (figures["error_frames"], figures["bus_off"], figures["ended"]) == (8, 1, "ticks")


def test_a_bus_that_closes_ends_the_run_with_a_failure(start: Start, bus: UnixBus) -> None:
    node = start("--lockstep")
    bus.node.close()
    assert node.summary(status=1)["ended"] == "bus closed"


@pytest.mark.slow
def test_a_full_queue_costs_frames_but_no_tick(
    start: Start, bus: UnixBus, blacks: tuple[object, ...]
) -> None:
    node = start(*FAST, *blacks)
    figures = node.summary()  # meanwhile no one reads
    assert figures["t"] == 400
    assert figures["unsent"] > 0 < figures["queue_full"]
    bus.hear_out()
    assert len(bus.said) == figures["estimates"] + figures["heartbeats"] - figures["unsent"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@interruptible()
def test_signals_end_the_run_cleanly(start: Start, bus: UnixBus, number: signal.Signals) -> None:
    node = start("--lockstep")
    drive(bus, [ID], 1, seed=1)
    figures = node.stop(number)
    assert (figures["ended"], figures["ticks"]) == ("signal", 1)


# ---- The state in a file ----


def saved(node: RobotNode) -> bytes:
    """The state of a Python node's robot."""
    image: bytes = node.robot.save()  # type: ignore[attr-defined]
    return image


@pytest.mark.parametrize("chosen", [Filter.ADAPTIVE, Filter.ROBUST])
def test_a_node_goes_on_where_it_was(start: Start, bus: UnixBus, tmp_path: Path, chosen: Filter) -> None:
    text, state = tmp_path / "observations", tmp_path / "state"
    expected = twin(ID, filter_period=10, filter=chosen)
    options = (*FAST, "--filter-period", 10, *FILTERS[chosen].split())
    options += ("--state", state, "--observations", text)
    for symbols in ("011", "100", "111"):
        text.write_text(symbols, encoding="ascii")
        node = start(*options)
        bus.hear_out()
        assert node.summary()["ticks"] == 3
        for symbol in symbols:
            expected.robot.step(Observation(int(symbol)))
    assert state.read_bytes() == saved(expected)
    assert not state.with_name("state.new").exists()


def test_a_state_that_does_not_fit_is_refused(command: list[str], bus: UnixBus, tmp_path: Path) -> None:
    image, state = saved(twin(ID)), tmp_path / "state"
    cases = (
        (image[:-1], (), "damaged"),
        (image + b"x", (), "damaged"),
        (image[:20] + bytes([image[20] ^ 1]) + image[21:], (), "damaged"),
        (image, ("--filter-period", 10), "periods"),
        (image, ("--filter", "robust"), "damaged"),
        (saved(twin(6)), (), "another robot"),
        (None, (), str(tmp_path)),
    )
    for held, options, why in cases:
        if held is not None:
            state.write_bytes(held)
        words = ("--lockstep", "--state", state if held else tmp_path, *options)
        process = CNode(command, bus.channel_info, ID, *words).process
        printed, complaints = process.communicate(timeout=PATIENCE)
        assert (process.returncode, printed) == (2, "")
        assert why in complaints
        assert held in (None, state.read_bytes())


@pytest.mark.slow
@pytest.mark.parametrize("error", ["EINTR", "EAGAIN"])
def test_observations_that_are_interrupted_go_on(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, error: str
) -> None:
    """Each second read fails."""
    text = tmp_path / "observations"
    text.write_text("1" * 600, encoding="ascii")
    strace = [require("strace", "strace"), "-o", str(tmp_path / "trace"), "-P", str(text)]
    words = [*strace, "-e", f"inject=read:error={error}:when=1+2", *built(PLAIN, tmp_path_factory)]
    with CNode(words, bus.channel_info, ID, *FAST, "--observations", text) as node:
        bus.accept()
        bus.hear_out()
        figures = node.summary()
    assert (figures["ended"], figures["t"], figures["missing"] > 2) == ("observations", 600, True)


READING = ("openat:error=EACCES", "read:error=EIO", "read:error=EIO:when=2")
"""System calls of a state's load, and of observations."""


@pytest.mark.parametrize("option", ["--state", "--observations"])
def test_what_cannot_be_read_is_left_alone(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, option: str
) -> None:
    """One line tells, whichever system call of a state's load fails; the run ends where observations do."""
    file, held = tmp_path / "file", saved(twin(ID)) if option == "--state" else b"1" * 256
    file.write_bytes(held)
    for fails in READING:
        strace = [require("strace", "strace"), "-o", str(tmp_path / "trace"), "-P", str(file)]
        words = [*strace, "-e", f"inject={fails}", *built(PLAIN, tmp_path_factory)]
        clock = "--lockstep" if option == "--state" else "--steps-per-second=1000"
        process = CNode(words, bus.channel_info, ID, clock, option, file).process
        printed, complaint = process.communicate(timeout=PATIENCE)
        has_begun = option != "--state" and fails.startswith("read")
        assert process.returncode == 2 - has_begun and file.read_bytes() == held
        why = "Permission denied" if "EACCES" in fails else "Input/output error"
        assert re.fullmatch(
            rf"mcp_asdf_node: cannot (use the state|read|open) {file}: {why}(; .*)?\n", complaint
        )
        if has_begun:
            figures = json.loads(printed)
            assert figures["ended"] == "observations not readable"
            assert figures["t"] == (256 if fails.endswith("2") else 0)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["bus", "file", "trace"]


def test_a_state_that_comes_in_pieces_is_whole(command: list[str], bus: UnixBus, tmp_path: Path) -> None:
    state, expected = tmp_path / "state", twin(ID)
    expected.robot.step(Observation.BLACK)
    image = saved(expected)
    os.mkfifo(state)
    with CNode(command, bus.channel_info, ID, "--lockstep", "--state", state) as node:
        with state.open("wb", buffering=0) as pipe:
            for piece in (image[:50], image[50:51], image[51:]):
                pipe.write(piece)
                while fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)) != bytes(4):
                    time.sleep(0.001)
        bus.accept()
        assert node.stop()["t"] == 1
    assert state.read_bytes() == image


SAVING = ("openat", "write", "fsync", "close", "rename", "openat", "fsync", "close")
"""System calls of a save, about the draft and then its folder: whenever the power fails, the name stands for
all of the old state or all of the new, and in the end for the new."""
FAILING = [
    f"{call}:error=ENOSPC:when={number}"
    for call in sorted(set(SAVING))
    for number in range(1, 2 * SAVING.count(call) + 1)
]
"""Each system call of two saves."""


@pytest.mark.parametrize("fails", ["", "write:retval=50", *slow(FAILING)])
def test_the_state_s_file_holds_the_last_state_or_the_one_before(
    bus: UnixBus,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    blacks: tuple[object, ...],
    fails: str,
) -> None:
    """Whichever system call fails does not stop the robot, and one line tells."""
    trace, state, expected = tmp_path / "trace", tmp_path / "state", twin(ID)
    images = [saved(expected)]
    for ticks in (300, 100):
        for _ in range(ticks):
            expected.robot.step(Observation.BLACK)
        images.append(saved(expected))
    state.write_bytes(images[0])
    strace = [require("strace", "strace"), "-o", str(trace), "-P", f"{state}.new", "-P", str(tmp_path)]
    strace += ["-e", "trace=openat,write,fsync,close,rename", *(["-e", f"inject={fails}"] if fails else [])]
    command = [*strace, *built(PLAIN, tmp_path_factory)]
    is_told = fails != "" and not (fails.startswith("close") and fails[-1] in "24")  # those are the folder's
    with CNode(command, bus.channel_info, ID, *FAST, *blacks, "--state", state, "--save-period", 300) as node:
        bus.accept()
        bus.hear_out()
        figures = node.summary(status=int(is_told))
    calls = [line.partition("(")[0] for line in trace.read_text(encoding="utf-8").splitlines()]
    told = f"mcp_asdf_node: cannot save the state {state}: No space left on device; going on"
    assert figures["t"] == 400 and node.complaints == [told] * is_told
    assert not state.with_name("state.new").exists()
    name, number = fails.partition(":")[0], int(fails.rpartition("=")[2] or 0)
    is_in_last, is_of_draft = number > SAVING.count(name), number % 2 == 1 or SAVING.count(name) == 1
    newest = 0 if number == 50 else 1 if is_in_last and is_of_draft else 2
    assert state.read_bytes() == images[newest]
    if not fails:
        assert calls[:-1] == [*SAVING] * 2


# ---- The verdict ----

NOT_EXECUTED = {
    "configurations that the node refuses before it is there": r"mcp_asdf\.c: (.*config->(filter|memory).*"
    r"|return (MCP_ASDF_ERR_(CONFIG|TABLE|ID|B_HAT)|false);|if \((id|b_hat|head|word|status) .*"
    r"|.*(THRESHOLD_ONE|TABLE_OMEGA_MAX).*)",
    "arguments that its codec refuses before": r"mcp_asdf\.c: (if \((\(uint32_t\)z|x_hat|sender) .*"
    r"|return MCP_ASDF_ERR_(OBSERVATION|X_HAT);|\+\+robot->counters\.rejected;)",
    "error frames, CAN FD, and frames that no node makes": r"mcp_asdf_frame\.c: (return status;"
    r"|if \((status|node|target|format->subject|action|message->\w+) .*"
    r"|if \(\(frame->flags & MCP_ASDF_FRAME_(ERROR|FD)\) .*"
    r"|return MCP_ASDF_FRAME_ERR_(ACTION|B_HAT|(ERROR|FD)_FRAME|FORMAT|HEALTH|MODE|NODE|TARGET|X|X_HAT);)",
    "step(), which the node does not call": r"mcp_asdf\.c: (.*_(step|observe)\(.*|return status == .*)",
    "other configurations: another filter, table or memory, b_hat below 1/2": r"mcp_asdf\.c: "
    r"(if \(filter == .*|const uint32_t k = .*|if \(is_halved\) .*|begin_batch\(robot\);|t >>= 1;|n = \(n .*)"
    r"|mcp_asdf_robust\.h: (const uint32_t g = .*|if \(mcp_asdf_is_robust\(robot->config\)\) .*)",
    "46,341 observations or more: the largest alpha": r"mcp_asdf\.c: return exponent <= ALPHA_SHIFT_MAX .*"
    r"|mcp_asdf_arithmetic\.h: (if \(\(count & 32U\).*|value = high_word\(value\);)",
    "2^21 observations in a filter period": r"mcp_asdf_robust\.h: const uint32_t short_deviation = .*",
    "a centre of the votes that comes to 0": r"mcp_asdf_robust\.h: return centre > step .*",
    "slots whose lower half is nearer to their median than all others": r"mcp_asdf_robust\.h: "
    r"(const uint32_t distance_below = .*|if \(below > 0U .*)",
}
"""What a verification leaves out of the core, and why: patterns of "file: text of a line"."""


@pytest.mark.slow
def test_a_verification_executes_every_line_and_branch_of_the_core(
    bus: UnixBus, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """At the default configuration, of the paper's filter and of the robust one, but those listed above."""
    command = built(COVERED, tmp_path_factory)
    for chosen, config in (("asdf-plus", Config(TABLE)), ("robust", Config(filter=Filter.ROBUST))):
        with CNode(command, bus.channel_info, ID, "--lockstep", "--filter", chosen) as node:
            bus.accept()
            own = RobotSetup(ID, "mirror", 0.95, config)
            verdict = Verification(surroundings(own), BenchOptions(bus, 25, PATIENCE)).run()
            assert verdict.has_passed, verdict.headline
            node.stop()
    left_out = unexecuted(Path(command[-1]).parent)
    reasons = {
        line: [why for why, lines in NOT_EXECUTED.items() if re.fullmatch(lines, line)] for line in left_out
    }
    assert [line for line, why in reasons.items() if not why] == []
    assert {why for whys in reasons.values() for why in whys} == {*NOT_EXECUTED}
