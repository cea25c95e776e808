"""The C node takes observations, keeps time, survives faults of its surroundings and goes on where it was."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import (
    Health,
    Heartbeat,
    Telemetry,
    decode_heartbeat,
    decode_telemetry,
)
from mcp_asdf_tools.robots.lockstep import Lockstep
from support import PATIENCE, interruptible, require
from targets.c_node import (
    PLAIN,
    CNode,
    Start,
    built,
    drive,
    twin,
)
from targets.unix_bus import Peer, UnixBus

CAN_ERR_CRTL, CAN_ERR_PROT, CAN_ERR_BUSOFF, CAN_ERR_RESTARTED = 0x4, 0x8, 0x40, 0x100


BOTH = [Observation.WHITE, Observation.BLACK]


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


def traced(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    bus: UnixBus,
    strace: str,
    *options: object,
    status: int = 0,
) -> tuple[dict[str, Any], list[str]]:
    """The summary of a node under strace, and the calls that were written down."""
    trace = tmp_path / "trace"
    command = [require("strace", "strace"), "-o", trace, *strace.split(), *built(PLAIN, tmp_path_factory)]
    options = ("--steps-per-second", 1000, *options)
    with CNode(list(map(str, command)), bus.channel_info, 5, *options) as node:
        hear_out(bus, bus.accept())
        return node.summary(status), trace.read_text(encoding="utf-8").splitlines()


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


def test_a_state_that_does_not_reach_the_disk_replaces_nothing(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, state = tmp_path / "observations", tmp_path / "state"
    text.write_text("101", encoding="ascii")
    state.write_bytes(before := twin(5).robot.save())  # type: ignore[attr-defined]
    options = ("--state", state, "--observations", text)
    fails = "-e trace=fsync -e inject=fsync:error=EIO"
    traced(tmp_path, tmp_path_factory, bus, fails, *options, status=1)
    assert state.read_bytes() == before


def test_a_signal_that_interrupts_reading_does_not_end_the_input(
    bus: UnixBus, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text = tmp_path / "observations"
    text.write_text("1011", encoding="ascii")
    interrupted = f"-e trace=read -P {text} -e inject=read:error=EINTR:when=1"
    figures, calls = traced(tmp_path, tmp_path_factory, bus, interrupted, "--observations", text)
    assert "EINTR" in calls[0]
    assert (figures["t"], figures["n"], figures["missing"]) == (4, 3, 1)
