"""C nodes without CAN, on a multicast group: the bits of Python nodes, over a network that loses, repeats and
mixes up datagrams as Wi-Fi does, and has others' on it."""

from __future__ import annotations

import ctypes
import json
import os
import random
import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus as Group
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from datagrams import odd_datagrams
from mcp_asdf_tools.bus.datagrams import unpack_data_frame
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.robots.node import RobotNode
from multicast import multicast
from support import PATIENCE, require, run
from targets.c_node import (
    CORTEX_A8,
    PLAIN_BUILD,
    SANITIZED_BUILD,
    SOURCES,
    CNode,
    NodeBuild,
    candump_lines,
    node_command,
    numbers_of_robot,
    python_node,
    without_repeated_greetings,
)
from targets.test_node import ID, OPTIONS_OF_SUBJECTS, SUBJECTS, any_frame, commands_that_are_answered

PORT = 20000 + os.getpid() % 12000
"""The group's port. It is below those that the kernel gives senders, and other processes use other ports."""
IPV4, IPV6 = "239.74.163.91", "ff15:7079:7468:6f6e:6465:6d6f:6d63:91"


@contextmanager
def joined(address: str) -> Iterator[Group]:
    """Join a multicast group, also to receive own datagrams. Skips the test where there is no multicast."""
    multicast(group=91)  # only skips
    try:
        group = Group(address, PORT, 0)
    except can.CanError as error:
        pytest.skip(f"no multicast to {address}: {error}")
    yield group
    group.shutdown()


def interface(address: str) -> str:
    """Return the option --interface of a node in a group."""
    return f"udp:[{address}]:{PORT}" if ":" in address else f"udp:{address}:{PORT}"


Arrival = tuple[can.Message | None, bytes]
"""A datagram that arrives: its frame of classic CAN, or None if it has no such frame, and its bytes."""


def arrival_of(frame: can.Message) -> Arrival:
    """Return the arrival of a frame, in the datagram that python-can makes of it."""
    is_classic = not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)
    return frame if is_classic else None, pack_message(frame)


def datagrams_on_wifi(frames: list[can.Message], rng: random.Random) -> list[Arrival]:
    """Return the arrivals of some frames: some are lost, some come twice or late. Others are garbage."""
    arrivals: list[Arrival] = []
    for frame in frames:
        arrival = arrival_of(frame)
        copies = rng.choice((0, 1, 1, 1, 1, 1, 2))
        arrivals += [arrival] * copies
        if rng.random() < 0.1:
            arrivals[-2:] = reversed(arrivals[-2:])  # the last two change places
        if rng.random() < 0.1:
            _frame, datagram = arrival
            garbage = (b"", datagram[:-1], datagram + b"\0", bytes(3000), b"\x8b" * 150)
            arrivals.append((None, rng.choice(garbage)))
    return arrivals


OPTIONS = (
    f"--lockstep --hop-limit 0 --b-hat 0.75 {OPTIONS_OF_SUBJECTS} --steps-per-second 3 --filter-period 4"
).split()


def exchange(
    group: Group, twin: RobotNode, arrivals: list[Arrival]
) -> tuple[list[can.Message], list[can.Message]]:
    """Send datagrams to the C node in a group, and their frames to its twin in Python.

    Returns the answers of the C node and those of the twin. The first answer is a heartbeat.
    """
    answers: list[can.Message] = []
    expected_answers = list(twin.start())
    receive_until(group, answers, len(expected_answers))
    for number, (frame, datagram) in enumerate(arrivals, start=1):
        group.send(datagram)
        if frame is not None:
            expected_answers += twin.receive_frame(frame)
        if number % 20 == 0:  # more answers might overflow the socket
            receive_until(group, answers, len(expected_answers))
    receive_until(group, answers, len(expected_answers))
    return answers, expected_answers


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "address"),
    [(SANITIZED_BUILD, IPV4), (SANITIZED_BUILD, IPV6), (CORTEX_A8, IPV4)],
    ids=["host IPv4", "host IPv6", "cortex-a8 IPv4"],
)
def test_c_and_python_node_answer_the_datagrams_of_a_bad_network_alike(
    kind: NodeBuild, address: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Both send the same frames, and end with the same state and counters.

    600 frames are sent to the C node as datagrams, of which some are lost, repeated or late, and between them
    is garbage. The Python node, its twin with the same options, gets the frames that arrive. The C node
    prints its state and counters in the end, as a summary.
    """
    rng = random.Random(address)
    arrivals = datagrams_on_wifi([any_frame(rng) for _ in range(600)], rng)
    arrivals += map(arrival_of, commands_that_are_answered())  # these answers are the last ones
    twin = python_node(ID, b_hat=0.75, subjects=SUBJECTS, steps_per_second=3, filter_period=4)
    command = node_command(kind, tmp_path_factory)
    with joined(address) as group, CNode(command, interface(address), ID, *OPTIONS) as node:
        answers, expected_answers = exchange(group, twin, arrivals)
        summary = node.stop()

    assert candump_lines(answers) == candump_lines(expected_answers)
    assert_same_numbers(summary, twin, arrivals)
    for event in ("odd_packets", "repeated", "collisions", "obeyed"):
        assert summary[event] > 10, f"{event}: too rare to be tested"


def assert_same_numbers(summary: dict[str, Any], twin: RobotNode, arrivals: list[Arrival]) -> None:
    """Check that a C node's summary has the twin's numbers, and counts all datagrams."""
    odd_count = sum(frame is None for frame, _datagram in arrivals)
    numbers_of_datagrams = {"received": len(arrivals), "odd_packets": odd_count, "overflowed": 0, "downs": 0}
    expected_numbers = {**numbers_of_robot(twin), **numbers_of_datagrams}
    assert {name: summary[name] for name in expected_numbers} == expected_numbers
    # The C node counts damaged frames and frames for others apart. The twin counts both together.
    assert summary["refused"] + summary["others"] == twin.reception.rejected.total()


def receive_until(group: Group, received_frames: list[can.Message], count: int) -> None:
    """Append the node's frames to ``received_frames`` until there are ``count``, its greeting once.

    Each datagram is what python-can packs of its frame, with the present time.
    """
    while len(received_frames) < count:
        received = group.recv(PATIENCE / 10)
        assert received is not None, f"{len(received_frames)} of {count} answers"
        datagram, (_, sender_port, *_), _ = received
        if sender_port != PORT:  # not what this test has sent
            frame = unpack_message(datagram, check=True)
            assert pack_message(frame) == datagram
            assert abs(frame.timestamp - time.time()) < PATIENCE
            received_frames[:] = without_repeated_greetings([*received_frames, frame])


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The C node's multicast.c."""
    path = tmp_path_factory.mktemp("multicast") / "multicast.so"
    run(require("gcc"), "-D_GNU_SOURCE", "-shared", "-fPIC", SOURCES / "multicast.c", "-o", path)
    return ctypes.CDLL(str(path))


@dataclass(frozen=True)
class RawFrame:
    """A data frame as Linux has it in C.

    Attributes:
        identifier: Its bits, and in bit 31 whether it has 29.
        data: Its bytes.
    """

    identifier: int
    data: bytes


def unpack_by_c(library: ctypes.CDLL, datagram: bytes) -> RawFrame | None:
    """Return the frame that the C node finds in a datagram, or None if it refuses it."""
    memory = (ctypes.c_uint8 * 72)()  # a struct canfd_frame
    result = library.multicast_unpack(memory, datagram, len(datagram))
    is_frame = bool(result & 1)  # C's bool is one byte of the int that ctypes reads
    if not is_frame:
        return None
    length = memory[4]
    return RawFrame(int.from_bytes(bytes(memory[:4]), "little"), bytes(memory[8 : 8 + length]))


def unpack_by_tools(datagram: bytes) -> RawFrame | None:
    """Return the frame that the tools in Python find in a datagram, or None if they refuse it."""
    frame = unpack_data_frame(datagram)
    if frame is None:
        return None
    return RawFrame(frame.arbitration_id | frame.is_extended_id << 31, bytes(frame.data))


def test_the_tools_unpack_every_odd_datagram_that_the_c_node_unpacks_to_the_same_frame(
    library: ctypes.CDLL,
) -> None:
    """The datagrams are a list of odd ones, most of which both refuse.

    The tools also take some that the C node refuses: those with a large or negative number as their time or
    channel, which nobody reads.
    """
    for datagram in odd_datagrams():
        frame = unpack_by_c(library, datagram)
        if frame is not None:
            assert frame == unpack_by_tools(datagram), datagram


def test_the_c_node_and_the_tools_unpack_random_and_damaged_datagrams_to_the_same_frames(
    library: ctypes.CDLL,
) -> None:
    """Each of 3000 frames comes as python-can packs it, and once more with one bit that is flipped.

    Some are of CAN FD, remote frames or error frames, which both refuse.
    """
    rng = random.Random(8)
    unpacked_frames = []
    for _ in range(3000):
        datagram = pack_message(any_message(rng))
        damaged_datagram = flip_random_bit(datagram, rng)
        frame = unpack_by_c(library, datagram)
        damaged_frame = unpack_by_c(library, damaged_datagram)
        assert frame == unpack_by_tools(datagram), datagram.hex()
        if damaged_frame is not None:
            assert damaged_frame == unpack_by_tools(damaged_datagram), damaged_datagram.hex()
        unpacked_frames += [unpacked for unpacked in (frame, damaged_frame) if unpacked is not None]
    assert len(unpacked_frames) > 1700, "too few of 6000 datagrams had a frame, so too little was compared"


def flip_random_bit(datagram: bytes, rng: random.Random) -> bytes:
    """Return a datagram with one bit that differs."""
    damaged = bytearray(datagram)
    damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def any_message(rng: random.Random) -> can.Message:
    """Return a frame, in one of three cases CAN FD, a remote frame or an error frame."""
    is_extended = rng.random() < 0.7
    message = can.Message(
        timestamp=rng.choice((0, 0.0, 300, 1.8e9)),
        arbitration_id=rng.getrandbits(rng.choice((7, 11, 29 if is_extended else 11))),
        is_extended_id=is_extended,
        channel=rng.choice((None, "can0", "c" * 99, 3)),
        data=rng.randbytes(rng.randrange(9)),
    )
    attributes_of_other_kinds = ("is_fd", "is_remote_frame", "is_error_frame")
    kind = rng.choice(("data",) * 6 + attributes_of_other_kinds)
    if kind == "is_remote_frame":
        message.data = bytearray()
    if kind != "data":
        setattr(message, kind, True)
    return message


@pytest.fixture(scope="module")
def calls_of_sending_node(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The system calls of a node that sends an estimate for each of 80 tiles, as strace writes them.

    Only three kinds are written: calls that send, calls about memory, and calls that set a socket option.
    """
    with joined(IPV4):  # skips where there is no multicast
        pass
    folder = tmp_path_factory.mktemp("strace")
    tiles, trace = folder / "tiles", folder / "trace"
    tiles.write_text("10" * 40, encoding="ascii")
    strace = [require("strace", "strace"), "-o", str(trace), "-e", "trace=%memory,sendto,setsockopt"]
    command = [*strace, *node_command(PLAIN_BUILD, tmp_path_factory)]
    options = ("--network", "lo", "--hop-limit", 0, "--observations", tiles, "--steps-per-second", 1000)
    with CNode(command, interface(IPV4), ID, *options) as node:
        summary = node.summary()
    assert summary["unsent"] == 0
    return trace.read_text(encoding="utf-8").splitlines()


@pytest.mark.slow
def test_a_node_asks_the_system_for_memory_only_before_it_sends_or_after(
    calls_of_sending_node: list[str],
) -> None:
    """There is no call about memory from the first call of sendto to the last.

    The node sends at least an estimate for each of 80 tiles.
    """
    # Each character stands for one system call: s for a send, - for any other call.
    calls = "".join("s" if call.startswith("sendto(") else "-" for call in calls_of_sending_node)
    assert re.fullmatch("-*s{80,}-*", calls), "80 or more sends, one after another"


@pytest.mark.slow
def test_the_hop_limit_of_the_command_line_is_set_for_the_socket(calls_of_sending_node: list[str]) -> None:
    """The node was started with --hop-limit 0, so no router passes its datagrams on.

    In the calls that strace has listed, TTL (time to live) is the hop limit.
    """
    assert any("IP_MULTICAST_TTL, [0]" in call for call in calls_of_sending_node)


COMMANDS_THAT_LOSE_THE_NETWORK = """\
ip link add wlan0 type veth peer name air
ip link set wlan0 addrgenmode none
come() { ip link set $1 up; ip addr add 10.0.0.$2/24 dev $1; ip addr add fe80::$2/64 dev $1 nodad; }
come air 1; come wlan0 7
"$@" --id 1 & "$@" --id 2 &
sleep 1; ip link set wlan0 down; sleep 0.5; ip addr flush dev wlan0; come wlan0 8; sleep 3
kill %1 %2; wait
"""


def run_nodes_that_lose_their_network(folder: Path, command: list[str]) -> list[dict[str, Any]]:
    """Run two nodes while their network is taken down and comes back, and return their summaries."""
    result = subprocess.run(["unshare", "-rn", "ip", "link"], capture_output=True, check=False)
    if result.returncode != 0:
        pytest.skip("no network namespaces: unshare -rn fails here")
    sensor = folder / "sensor"
    sensor.write_text("1", encoding="ascii")
    node = [*command, "--network", "wlan0", "--steps-per-second", "100", "--sensor", str(sensor)]
    printed = run("unshare", "-rn", "bash", "-m", "-c", COMMANDS_THAT_LOSE_THE_NETWORK, "robots", *node)
    return [json.loads(line) for line in printed.splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("address", [IPV4, IPV6])
def test_nodes_receive_each_other_again_when_their_network_comes_back(
    address: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Two nodes tick 100 times a second, and receive each other, but never themselves.

    After a second the network goes down for half a second, and comes back with another address for three.
    """
    group = interface(address)
    command = [*node_command(PLAIN_BUILD, tmp_path_factory), "--interface", group]

    summaries = run_nodes_that_lose_their_network(tmp_path, command)

    assert len(summaries) == 2
    for summary in summaries:
        assert summary["downs"] == 1
        assert summary["collisions"] == 0, "frames with its own id"
        # 100 ticks come before, 50 without a network, and 300 after. A busy computer skips some.
        assert summary["unsent"] >= 20
        assert summary["ticks"] - summary["unsent"] > 150
        assert summary["heard"] > 150, "more than the 100 before the network went down"


@pytest.mark.slow
def test_the_radio_command_passes_a_node_on_multicast(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The command compares all answers of the node, robot 3, with the answers of an equal robot in Python."""
    choice = multicast(group=92)
    group = f"udp:{choice.settings['channel']}:{choice.settings['port']}"
    options = ("--lockstep", "--hop-limit", 0, "--b-hat", 0.75, "--filter-period", 4)

    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), group, 3, *options):
        robot = ("--id", "3", "--b-hat", "0.75", "--filter-period", "4", "--robots", "3", "--steps", "20")
        exit_code = main(["radio", "--verify", *robot, "--timeout", str(PATIENCE), *choice.arguments()])

    assert exit_code == 0
