"""C nodes without CAN, on a multicast group: the bits of Python nodes, over a network that loses, repeats and
mixes up datagrams as Wi-Fi does, and has others' on it."""

from __future__ import annotations

import ctypes
import json
import os
import random
import subprocess
import time
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus as Group
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from datagrams import odd_datagrams
from mcp_asdf_tools.bus.datagrams import unpack_data_frame
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.cli.main import main
from multicast import multicast
from support import PATIENCE, require, run, slow
from targets.c_node import (
    CORTEX_A8,
    PLAIN_BUILD,
    SANITIZED_BUILD,
    SOURCES,
    CNode,
    NodeBuild,
    assert_same_robot,
    candump_lines,
    node_command,
    python_node,
    without_repeated_greetings,
)
from targets.test_node import ID, SUBJECTS, any_frame, command_frame

PORT = 20000 + os.getpid() % 12000
"""Below those that the kernel gives senders. Other processes that run this have others."""
IPV4, IPV6 = "239.74.163.91", "ff15:7079:7468:6f6e:6465:6d6f:6d63:91"
NODE = (
    *("--lockstep", "--hop-limit", 0, "--steps-per-second", 3, "--b-hat", 0.75, "--filter-period", 4),
    *("--subject", 0, "--telemetry-subject", 8, "--command-subject", 9),
)


def join(address: str) -> Group:
    """One more member, which hears what it says. Skips the test where there is no multicast."""
    multicast(91)
    try:
        return Group(address, PORT, 0)
    except can.CanError as error:
        pytest.skip(f"no multicast to {address}: {error}")


def interface(address: str) -> str:
    return f"udp:[{address}]:{PORT}" if ":" in address else f"udp:{address}:{PORT}"


def on_wifi(frames: list[can.Message], draw: random.Random) -> list[tuple[can.Message | None, bytes]]:
    """Frames as they arrive, with their datagrams: some lost, twice, or late, and datagrams that are none."""
    arrived: list[tuple[can.Message | None, bytes]] = []
    for frame in frames:
        arrived += [(frame, pack_message(frame))] * draw.choice((0, 1, 1, 1, 1, 1, 2))
        if draw.random() < 0.1:
            arrived[-2:] = reversed(arrived[-2:])
        if draw.random() < 0.1:
            whole = pack_message(frame)
            arrived.append((None, draw.choice((b"", whole[:-1], whole + b"\0", bytes(3000), b"\x8b" * 150))))
    return arrived


@pytest.mark.parametrize("address", [IPV4, *slow([IPV6])])
@pytest.mark.parametrize("kind", [SANITIZED_BUILD, *slow([CORTEX_A8])], ids=lambda kind: kind.name)
def test_the_bits_are_those_of_a_python_node_that_hears_the_same(
    kind: NodeBuild, address: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    draw, group = random.Random(address), join(address)
    expected = python_node(ID, 0.75, SUBJECTS, 3, filter_period=4)
    answers, said, odd = expected.start(), list[can.Message](), 0

    def tell(frame: can.Message | None, datagram: bytes) -> None:
        nonlocal odd
        group.send(datagram)
        if frame is not None and is_classic(frame):
            answers.extend(expected.receive_frame(frame))
        else:
            odd += 1

    arrived = on_wifi([any_frame(draw) for _ in range(600)], draw)
    with CNode(node_command(kind, tmp_path_factory), interface(address), ID, *NODE) as node:
        hear(group, said, len(answers))
        for number, (frame, datagram) in enumerate(arrived):
            tell(frame, datagram)
            if number % 20 == 19:  # else they overflow a socket
                hear(group, said, len(answers))
        for action in (
            Action.SETTLE,
            Action.OBSERVE_BLACK,
            Action.SETTLE,
        ):  # the last answer shows that all was heard
            tell(end := command_frame(expected._tick_of_command or 0, ID, action), pack_message(end))
        hear(group, said, len(answers))
        figures = node.stop()
    group.shutdown()
    assert candump_lines(said) == candump_lines(answers)
    assert_same_robot(figures, expected)
    assert figures["refused"] + figures["others"] == expected.reception.rejected.total()
    assert figures["received"] == len(arrived) + 3, "neither its own nor another group's"
    assert (figures["odd_packets"], figures["overflowed"], figures["downs"]) == (odd, 0, 0)
    assert min(odd, figures["repeated"], figures["collisions"], figures["obeyed"]) > 10


def is_classic(frame: can.Message) -> bool:
    return not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)


def hear(group: Group, said: list[can.Message], frames: int) -> None:
    """Listen until the node has said so many in all; they are packed as python-can does it."""
    while len(said) < frames:
        received = group.recv(PATIENCE / 10)
        assert received is not None, f"{len(said)} of {frames} answers"
        datagram, sender, _ = received
        if sender[1] != PORT:
            said.append(unpack_message(datagram, check=True))
            assert pack_message(said[-1]) == datagram
            said[:] = without_repeated_greetings(said)
            assert abs(said[-1].timestamp - time.time()) < PATIENCE


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The C node's multicast.c."""
    path = tmp_path_factory.mktemp("multicast") / "multicast.so"
    run(require("gcc"), "-D_GNU_SOURCE", "-shared", "-fPIC", SOURCES / "multicast.c", "-o", path)
    return ctypes.CDLL(str(path))


def test_the_c_node_and_the_tools_unpack_the_same_datagrams_to_the_same_frames(library: ctypes.CDLL) -> None:
    raw_frame = (ctypes.c_uint8 * 72)()
    for datagram in odd_datagrams():
        frame = unpack_data_frame(datagram)
        is_unpacked = library.multicast_unpack(raw_frame, datagram, len(datagram)) & 1
        assert is_unpacked == (frame is not None), datagram
        if frame is not None:
            identifier = int.from_bytes(bytes(raw_frame[:4]), "little")
            assert identifier == frame.arbitration_id | frame.is_extended_id << 31
            assert bytes(raw_frame[8 : 8 + raw_frame[4]]) == frame.data


def test_what_is_taken_is_what_python_can_takes(library: ctypes.CDLL) -> None:
    """Of datagrams that it packs, each classic data frame; of spoilt ones, none that it refuses."""
    unpack, frame = library.multicast_unpack, (ctypes.c_uint8 * 72)()
    draw, taken = random.Random(8), [0, 0]

    def check(datagram: bytes, *, is_spoilt: bool) -> None:
        expected: can.Message | None
        try:
            expected = unpack_message(datagram, replace={"timestamp": 0.0}, check=True)
        except UnicodeDecodeError:  # the name of a channel, which nobody reads
            return
        except Exception:  # it raises what it likes
            expected = None
        if unpack(frame, datagram, len(datagram)) & 1:
            assert expected is not None
            assert is_classic(expected)
            identifier = int.from_bytes(bytes(frame[:4]), "little")
            assert identifier == expected.arbitration_id | expected.is_extended_id << 31
            assert bytes(frame[8 : 8 + frame[4]]) == expected.data
            taken[is_spoilt] += 1
        else:
            assert is_spoilt or expected is None or not is_classic(expected)

    for _ in range(3000):
        datagram = pack_message(any_message(draw))
        check(datagram, is_spoilt=False)
        spoilt = bytearray(datagram)
        spoilt[draw.randrange(len(spoilt))] ^= 1 << draw.randrange(8)
        check(bytes(spoilt), is_spoilt=True)
    assert taken[0] > 1500
    assert taken[1] > 200


def any_message(draw: random.Random) -> can.Message:
    """One that may be anything, seldom not a classic data frame."""
    kind = draw.choice((None,) * 6 + ("is_fd", "is_remote_frame", "is_error_frame"))
    fields: dict[str, Any] = {kind: True} if kind else {}
    is_extended = draw.random() < 0.7
    data = None if kind == "is_remote_frame" else draw.randbytes(draw.randrange(9))
    return can.Message(
        timestamp=draw.choice((0, 0.0, 300, 1.8e9)),
        arbitration_id=draw.getrandbits(draw.choice((7, 11, 29 if is_extended else 11))),
        is_extended_id=is_extended,
        channel=draw.choice((None, "can0", "c" * 99, 3)),
        data=data,
        **fields,
    )


@pytest.mark.slow
def test_nothing_is_allocated_after_the_start(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    join(IPV4).shutdown()
    (tmp_path / "seen").write_text("10" * 40, encoding="ascii")
    trace = tmp_path / "trace"
    strace = [require("strace", "strace"), "-o", str(trace), "-e", "trace=%memory,sendto,setsockopt"]
    options = (
        "--network",
        "lo",
        "--hop-limit",
        0,
        "--observations",
        tmp_path / "seen",
        "--steps-per-second",
        1000,
    )
    with CNode(
        [*strace, *node_command(PLAIN_BUILD, tmp_path_factory)], interface(IPV4), ID, *options
    ) as node:
        assert node.summary()["unsent"] == 0
    calls = trace.read_text(encoding="utf-8").splitlines()
    assert any("IP_MULTICAST_TTL, [0]" in call for call in calls)
    sent = [number for number, call in enumerate(calls) if call.startswith("sendto(")]
    assert len(sent) >= 80
    assert sent == list(range(sent[0], sent[-1] + 1))


LOSING = """\
ip link add wlan0 type veth peer name air
ip link set wlan0 addrgenmode none
come() { ip link set $1 up; ip addr add 10.0.0.$2/24 dev $1; ip addr add fe80::$2/64 dev $1 nodad; }
come air 1; come wlan0 7
"$@" --id 1 & "$@" --id 2 &
sleep 1; ip link set wlan0 down; sleep 0.5; ip addr flush dev wlan0; come wlan0 8; sleep 3
kill %1 %2; wait
"""


@pytest.mark.slow
@pytest.mark.parametrize("address", [IPV4, IPV6])
def test_a_network_may_go_and_come_back(
    address: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Two nodes lose each other, tick on, and hear each other, never themselves, from another address."""
    if subprocess.run(["unshare", "-rn", "ip", "link"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespaces: unshare -rn fails here")
    sensor = tmp_path / "sensor"
    sensor.write_text("1", encoding="ascii")
    node = [*node_command(PLAIN_BUILD, tmp_path_factory), "--network", "wlan0", "--steps-per-second", "100"]
    node += ["--interface", interface(address), "--sensor", str(sensor)]
    lines = run("unshare", "-rn", "bash", "-m", "-c", LOSING, "robots", *node).splitlines()
    assert len(lines) == 2
    for figures in map(json.loads, lines):
        assert (figures["downs"], figures["collisions"]) == (1, 0)
        assert 20 <= figures["unsent"] < figures["ticks"] - 150
        assert figures["heard"] > 150, "more than before"


@pytest.mark.slow
def test_the_verdict_on_a_node_without_can_is_good(tmp_path_factory: pytest.TempPathFactory) -> None:
    choice = multicast(92)
    group = f"udp:{choice.settings['channel']}:{choice.settings['port']}"
    options = ("--lockstep", "--hop-limit", 0, "--b-hat", 0.75, "--filter-period", 4)
    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), group, 3, *options):
        robot = ("--id", "3", "--b-hat", "0.75", "--filter-period", "4", "--robots", "3", "--steps", "20")
        assert main(["radio", "--verify", *robot, "--timeout", str(PATIENCE), *choice.arguments()]) == 0
