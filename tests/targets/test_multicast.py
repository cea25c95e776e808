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
from support import PATIENCE, require, run
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
    """Join a multicast group, also to receive own datagrams. Skips the test where there is no multicast."""
    multicast(91)
    try:
        return Group(address, PORT, 0)
    except can.CanError as error:
        pytest.skip(f"no multicast to {address}: {error}")


def interface(address: str) -> str:
    """Return the option --interface of a node in a group."""
    return f"udp:[{address}]:{PORT}" if ":" in address else f"udp:{address}:{PORT}"


def datagrams_on_wifi(
    frames: list[can.Message], rng: random.Random
) -> list[tuple[can.Message | None, bytes]]:
    """Return datagrams as they arrive, each with its frame, or None if it has none.

    Some frames are lost, some come twice or late, and between them are datagrams that are no frames.
    """
    arrivals: list[tuple[can.Message | None, bytes]] = []
    for frame in frames:
        datagram = pack_message(frame)
        copies = rng.choice((0, 1, 1, 1, 1, 1, 2))
        arrivals += [(frame, datagram)] * copies
        if rng.random() < 0.1:
            arrivals[-2:] = reversed(arrivals[-2:])
        if rng.random() < 0.1:
            garbage = (b"", datagram[:-1], datagram + b"\0", bytes(3000), b"\x8b" * 150)
            arrivals.append((None, rng.choice(garbage)))
    return arrivals


@pytest.mark.slow
@pytest.mark.parametrize("address", [IPV4, IPV6])
@pytest.mark.parametrize("kind", [SANITIZED_BUILD, CORTEX_A8], ids=lambda kind: kind.name)
def test_c_and_python_node_answer_the_datagrams_of_a_bad_network_alike(
    kind: NodeBuild, address: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """They send the same frames, and end with the same state and counters.

    The C node gets all datagrams, of which some are lost, repeated, late or garbage, and its twin in Python
    their frames. Now and then the test waits for all answers, as they overflow a socket otherwise.
    """
    rng, group = random.Random(address), join(address)
    twin = python_node(ID, 0.75, SUBJECTS, 3, filter_period=4)
    expected_answers = twin.start()
    received_frames: list[can.Message] = []
    odd_datagram_count = 0

    def send_to_both_nodes(frame: can.Message | None, datagram: bytes) -> None:
        nonlocal odd_datagram_count
        group.send(datagram)
        if frame is not None and is_classic(frame):
            expected_answers.extend(twin.receive_frame(frame))
        else:
            odd_datagram_count += 1

    arrivals = datagrams_on_wifi([any_frame(rng) for _ in range(600)], rng)
    with CNode(node_command(kind, tmp_path_factory), interface(address), ID, *NODE) as node:
        receive_until(group, received_frames, len(expected_answers))
        for number, (frame, datagram) in enumerate(arrivals, start=1):
            send_to_both_nodes(frame, datagram)
            if number % 20 == 0:
                receive_until(group, received_frames, len(expected_answers))
        # The last of these commands is answered for certain, which shows that all before was handled.
        last_actions = (Action.SETTLE, Action.OBSERVE_BLACK, Action.SETTLE)
        for action in last_actions:
            command = command_frame(twin._tick_of_command or 0, ID, action)
            send_to_both_nodes(command, pack_message(command))
        receive_until(group, received_frames, len(expected_answers))
        summary = node.stop()
    group.shutdown()

    assert candump_lines(received_frames) == candump_lines(expected_answers)
    assert_same_robot(summary, twin)
    assert summary["refused"] + summary["others"] == twin.reception.rejected.total()
    # None of them is its own or another group's.
    assert summary["received"] == len(arrivals) + len(last_actions)
    assert summary["odd_packets"] == odd_datagram_count
    assert summary["overflowed"] == 0
    assert summary["downs"] == 0
    assert odd_datagram_count > 10
    for counter in ("repeated", "collisions", "obeyed"):
        assert summary[counter] > 10, counter


def is_classic(frame: can.Message) -> bool:
    """Return whether a frame is a data frame of classic CAN."""
    return not (frame.is_fd or frame.is_remote_frame or frame.is_error_frame)


def receive_until(group: Group, received_frames: list[can.Message], count: int) -> None:
    """Append the node's frames to ``received_frames`` until there are ``count``, its greeting once.

    Each datagram is what python-can packs of its frame, with the present time.
    """
    while len(received_frames) < count:
        received = group.recv(PATIENCE / 10)
        assert received is not None, f"{len(received_frames)} of {count} answers"
        datagram, (_, sender_port, *_), _ = received
        if sender_port != PORT:
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


def assert_unpacked_to(raw_frame: Any, frame: can.Message) -> None:
    """Check that what the C has unpacked, a ``struct canfd_frame`` of Linux, is this frame."""
    identifier = int.from_bytes(bytes(raw_frame[:4]), "little")
    length = raw_frame[4]
    assert identifier == frame.arbitration_id | frame.is_extended_id << 31
    assert bytes(raw_frame[8 : 8 + length]) == frame.data


def test_the_c_node_and_the_tools_unpack_the_same_datagrams_to_the_same_frames(library: ctypes.CDLL) -> None:
    """The datagrams are a list of odd ones, and frames of all kinds."""
    raw_frame = (ctypes.c_uint8 * 72)()
    for datagram in odd_datagrams():
        frame = unpack_data_frame(datagram)

        is_unpacked = library.multicast_unpack(raw_frame, datagram, len(datagram)) & 1  # C's bool is a byte

        assert is_unpacked == (frame is not None), datagram
        if frame is not None:
            assert_unpacked_to(raw_frame, frame)


def unpack_by_python_can(datagram: bytes) -> can.Message | None:
    """Return the frame that python-can finds in a datagram, or None if it refuses it.

    Raises UnicodeDecodeError where only the name of a channel, which the C does not read, is no text.
    """
    try:
        return unpack_message(datagram, replace={"timestamp": 0.0}, check=True)
    except UnicodeDecodeError:
        raise
    except Exception:  # it raises what it likes
        return None


def test_the_c_node_unpacks_each_ordinary_frame_that_python_can_packs(library: ctypes.CDLL) -> None:
    """And none of CAN FD, no remote frame and no error frame."""
    raw_frame = (ctypes.c_uint8 * 72)()
    rng = random.Random(8)
    unpacked_count = 0
    for _ in range(3000):
        datagram = pack_message(any_message(rng))
        frame = unpack_by_python_can(datagram)
        assert frame is not None

        is_unpacked = library.multicast_unpack(raw_frame, datagram, len(datagram)) & 1  # C's bool is a byte

        assert is_unpacked == is_classic(frame), datagram
        if is_unpacked:
            assert_unpacked_to(raw_frame, frame)
            unpacked_count += 1
    assert unpacked_count > 1500


def test_the_c_node_unpacks_no_damaged_datagram_that_python_can_refuses(library: ctypes.CDLL) -> None:
    """One bit of each is flipped. Of those that python-can accepts the C node may refuse some."""
    raw_frame = (ctypes.c_uint8 * 72)()
    rng = random.Random(8)
    unpacked_count = 0
    for _ in range(3000):
        datagram = bytearray(pack_message(any_message(rng)))
        datagram[rng.randrange(len(datagram))] ^= 1 << rng.randrange(8)
        try:
            frame = unpack_by_python_can(bytes(datagram))
        except UnicodeDecodeError:
            continue

        if library.multicast_unpack(raw_frame, bytes(datagram), len(datagram)) & 1:  # C's bool is a byte
            assert frame is not None, datagram.hex()
            assert is_classic(frame), datagram.hex()
            assert_unpacked_to(raw_frame, frame)
            unpacked_count += 1
    assert unpacked_count > 200


def any_message(rng: random.Random) -> can.Message:
    """Return a frame, in one of three cases CAN FD, a remote frame or an error frame."""
    kind = rng.choice((None,) * 6 + ("is_fd", "is_remote_frame", "is_error_frame"))
    fields: dict[str, Any] = {kind: True} if kind else {}
    is_extended = rng.random() < 0.7
    data = None if kind == "is_remote_frame" else rng.randbytes(rng.randrange(9))
    return can.Message(
        timestamp=rng.choice((0, 0.0, 300, 1.8e9)),
        arbitration_id=rng.getrandbits(rng.choice((7, 11, 29 if is_extended else 11))),
        is_extended_id=is_extended,
        channel=rng.choice((None, "can0", "c" * 99, 3)),
        data=data,
        **fields,
    )


@pytest.mark.slow
def test_the_node_asks_the_system_for_no_memory_once_it_sends(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """strace lists its calls that send, and those about memory: there is none between those that send."""
    join(IPV4).shutdown()  # skips where there is no multicast
    tiles, trace = tmp_path / "tiles", tmp_path / "trace"
    tiles.write_text("10" * 40, encoding="ascii")
    strace = [require("strace", "strace"), "-o", str(trace), "-e", "trace=%memory,sendto,setsockopt"]
    command = [*strace, *node_command(PLAIN_BUILD, tmp_path_factory)]
    options = ("--network", "lo", "--hop-limit", 0, "--observations", tiles, "--steps-per-second", 1000)

    with CNode(command, interface(IPV4), ID, *options) as node:
        summary = node.summary()

    calls = trace.read_text(encoding="utf-8").splitlines()
    numbers_of_sending_calls = [number for number, call in enumerate(calls) if call.startswith("sendto(")]
    first, last = numbers_of_sending_calls[0], numbers_of_sending_calls[-1]
    assert numbers_of_sending_calls == list(range(first, last + 1))
    assert len(numbers_of_sending_calls) >= 80, "an estimate for each tile"
    assert summary["unsent"] == 0
    assert any("IP_MULTICAST_TTL, [0]" in call for call in calls), "--hop-limit"


COMMANDS_THAT_LOSE_THE_NETWORK = """\
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
def test_nodes_hear_each_other_again_when_their_network_comes_back(
    address: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Two nodes run while the network is taken down and comes back with another address.

    Each ticks on meanwhile, and hears the other, but never itself, before and after.
    """
    if subprocess.run(["unshare", "-rn", "ip", "link"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespaces: unshare -rn fails here")
    sensor = tmp_path / "sensor"
    sensor.write_text("1", encoding="ascii")
    node = [*node_command(PLAIN_BUILD, tmp_path_factory), "--network", "wlan0", "--steps-per-second", "100"]
    node += ["--interface", interface(address), "--sensor", str(sensor)]

    printed = run("unshare", "-rn", "bash", "-m", "-c", COMMANDS_THAT_LOSE_THE_NETWORK, "robots", *node)

    summaries = [json.loads(line) for line in printed.splitlines()]
    assert len(summaries) == 2
    for summary in summaries:
        assert summary["downs"] == 1
        assert summary["collisions"] == 0, "frames with its own id"
        # The network is away for half a second or more of at least 2, at 100 ticks a second.
        assert 20 <= summary["unsent"] < summary["ticks"] - 150
        assert summary["heard"] > 150, "more than before"


@pytest.mark.slow
def test_the_radio_command_passes_a_node_on_multicast(tmp_path_factory: pytest.TempPathFactory) -> None:
    """It compares all that the node answers with the robot in Python of the same settings."""
    choice = multicast(92)
    group = f"udp:{choice.settings['channel']}:{choice.settings['port']}"
    options = ("--lockstep", "--hop-limit", 0, "--b-hat", 0.75, "--filter-period", 4)

    with CNode(node_command(PLAIN_BUILD, tmp_path_factory), group, 3, *options):
        robot = ("--id", "3", "--b-hat", "0.75", "--filter-period", "4", "--robots", "3", "--steps", "20")
        exit_code = main(["radio", "--verify", *robot, "--timeout", str(PATIENCE), *choice.arguments()])

    assert exit_code == 0
