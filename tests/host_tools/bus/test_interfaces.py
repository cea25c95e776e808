"""Malformed data on a bus is one invalid frame to its robots; every bus has a name."""

from __future__ import annotations

import argparse
import errno
import os
import random
import signal
import socket
import struct
import threading
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest
from can.interfaces.virtual import VirtualBus

from datagrams import odd_datagrams, packed
from mcp_asdf_tools.bus.datagrams import unpack_data_frame
from mcp_asdf_tools.bus.frame_layout import Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from mcp_asdf_tools.bus.interfaces import BusChoice, Connection
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.cli.options import add_bus_options, bus_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.node import filters_for
from multicast import multicast
from robots import ALPHA_ONE
from support import PATIENCE
from wire import node_in_a_thread

GROUP = 30


def test_a_malformed_datagram_is_one_damaged_frame_and_what_follows_is_heard() -> None:
    choice, after = multicast(GROUP), Estimate(8, 1, ALPHA_ONE, 3)
    with choice.open() as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("@I", 0))
        stranger.connect((str(choice.channel), int(choice.settings["port"])))
        bus.set_filters(filters_for(FrameFormat()))
        for data in odd_datagrams():
            stranger.send(data)
            stranger.send(packed(8, arbitration_id=5))  # which the filters leave out
            stranger.send(packed(8))
            heard: list[Estimate | Rejection] = []
            while after not in heard:
                frame = bus.recv(PATIENCE)
                assert frame is not None and frame.dlc == len(frame.data)
                assert frame.channel == choice.channel
                heard.append(decode_estimate(frame, FrameFormat()))
            is_damaged = unpack_data_frame(data) is None
            assert len(heard) <= 2
            assert (heard[0] is Rejection.ERROR_FRAME) == is_damaged, data


def test_a_burst_of_four_estimates_from_each_robot_waits_in_the_socket_of_a_multicast_group() -> None:
    choice = multicast(GROUP)
    with choice.open() as sender, choice.open() as receiver:
        for number in range(4 * 126):
            sender.send(can.Message(arbitration_id=number))
        received = [receiver.recv(PATIENCE) for _ in range(4 * 126)]
    assert [frame.arbitration_id for frame in received if frame is not None] == [*range(4 * 126)]


def test_no_node_hears_itself_on_a_bus_that_echoes() -> None:
    """But one that asks for it, which gets back what it has sent."""
    choice, draw = multicast(GROUP), random.Random(2)
    connections = [choice.open(returns_own=number == 2) for number in range(3)]
    heard: list[list[tuple[int, bytes]]] = [[], [], []]
    due: list[list[tuple[int, bytes]]] = [[], [], []]
    for step in range(800):
        place = draw.randrange(3) if step < 700 else step % 3
        if step < 700 and draw.random() < 0.5:
            # Contents come again and again, also from others at the same time.
            frame = can.Message(arbitration_id=draw.randrange(2), data=bytes([draw.randrange(2)]))
            connections[place].send(frame, timeout=1)
            for other in {0, 1, 2} - {place} | {2}:
                due[other].append((frame.arbitration_id, bytes(frame.data)))
        while (came := connections[place].recv(0)) is not None:
            heard[place].append((came.arbitration_id, bytes(came.data)))
            assert came.channel == choice.channel and came.timestamp > 0
    for place, connection in enumerate(connections):
        assert sorted(heard[place]) == sorted(due[place]), "replay: random.Random(2)"
        connection.shutdown()


def test_frames_of_other_programs_on_socketcan_are_received() -> None:
    """The kernel filters, and leaving an adapter that is unplugged is no error."""
    bus = Mock(channel_info="can0", protocol=can.CanProtocol.CAN_20)
    bus._recv_internal.side_effect = [(can.Message(is_rx=False), True), (None, True)]
    connection = Connection(bus)
    frame = connection.recv(0)
    assert frame is not None and frame.is_rx and connection.recv(0) is None
    connection.set_filters(filters_for(FrameFormat()))
    bus.set_filters.assert_called_with(filters_for(FrameFormat()))
    assert (connection.protocol, connection.channel_info) == (bus.protocol, "can0")
    bus.shutdown.side_effect = can.CanOperationError("unplugged")
    connection.shutdown()
    bus.shutdown.assert_called_once_with()


def radio(options: str) -> int:
    return main(["radio", "--interface", "virtual", *options.split()])


def test_waits_end_however_often_the_time_of_day_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Node and radio side by side: each takes the frames of the other, and a signal ends one that waits.

    Every look at that clock finds it three days earlier.
    """
    days, waits = count(step=3 * 86400), list[float]()
    receive = VirtualBus._recv_internal

    def waiting(self: Any, timeout: float | None) -> Any:
        waits.append(PATIENCE if timeout is None else timeout)
        assert waits[-1] <= 1, "it would wait for days"
        return receive(self, timeout)

    with node_in_a_thread("--id 5 --b-hat 0.55 --activation always"):
        monkeypatch.setattr("can.bus.time", lambda: -next(days))
        monkeypatch.setattr(VirtualBus, "_recv_internal", waiting)
        assert radio("--id 5 --b-hat 0.56 --activation always --verify --timeout 60") == 1
    ending = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGTERM))
    ending.start()
    assert radio("--id 5 --robots 3 --interface virtual --channel another") == 0
    ending.join()
    with chosen("--channel", "mine").open() as bus:
        assert bus.recv(0.01) is None
    assert len(waits) > 5


def chosen(*words: str) -> BusChoice:
    parser = argparse.ArgumentParser()
    add_bus_options(parser)
    return bus_of(parser.parse_args(words))


def test_another_process_joins_the_bus_by_its_arguments() -> None:
    choice = chosen(
        "-i", "udp_multicast", "-c", "239.1.1.{robot}", "-b", "500000", "--bus-kwargs", "port=9", "a=b"
    )
    own = choice.of_robot(7)
    assert (choice.has_channels, own.has_channels, str(own)) == (True, False, "udp_multicast 239.1.1.7")
    assert own.settings == {"hop_limit": 0, "channel": "239.1.1.7", "bitrate": 500000, "port": 16, "a": "b"}
    again = chosen(*own.arguments())
    assert again.interface == own.interface
    assert {name: str(value) for name, value in own.settings.items()} == again.settings
    assert chosen("-i", "udp_multicast", "-c", "g{robot}").of_robot(2).settings["port"] == 43115
    assert own.of_robot(3) is own
    assert chosen("-i", "socketcan", "-c", "vcan{robot}").of_robot(2).settings == {"channel": "vcan2"}


def test_only_a_bus_of_this_process_without_settings_is_private() -> None:
    assert chosen().is_private
    assert chosen("--channel", "mine").is_private
    assert not chosen("--bus-kwargs", "preserve_timestamps=True").is_private
    assert not chosen("-i", "socketcan", "-c", "vcan0").is_private
    with pytest.raises(SystemExit):
        chosen("--bus-kwargs", "no value")


SEE = "see --interface, --channel and --bus-kwargs"
VIRTUAL = (
    "as root, create it with: modprobe vcan && ip link add dev vcan97 type vcan && ip link set vcan97 up"
)
REAL = "as root, create it with: modprobe can-raw && ip link set can0 up type can bitrate 500000"


@pytest.mark.parametrize(
    ("words", "number", "fix"),
    [
        ("-i socketcan -c vcan97", errno.ENODEV, VIRTUAL),
        ("-i socketcan", errno.EAFNOSUPPORT, REAL),
        ("-i socketcan -c can97", errno.EPERM, SEE),
        ("-i udp_multicast -c nowhere", errno.ENODEV, SEE),
    ],
)
def test_a_bus_that_cannot_be_opened_is_told_with_the_fix(
    words: str, number: int, fix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is missing, that is how to make it."""
    choice = chosen(*words.split())
    if fix is VIRTUAL:
        with pytest.raises(UsageError, match=r"vcan97 up$"):
            choice.open()
    with pytest.raises(UsageError, match=r"there is no such interface; choose one of .*, socketcan, "):
        BusChoice("gremlin", {}).open()
    monkeypatch.setattr(can, "Bus", Mock(side_effect=OSError(number, "no way")))
    with pytest.raises(UsageError) as told:
        choice.open()
    assert str(told.value) == f"cannot open the bus {choice}: [Errno {number}] no way; {fix}"


def test_python_can_s_own_settings_are_honoured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Files, variables, ``can.rc``, options: later ones override earlier ones."""
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".canrc").write_text("[default]\ninterface=pcan\nchannel=file\nbitrate=5\nport=9\n")
    monkeypatch.setenv("CAN_INTERFACE", "udp_multicast")
    monkeypatch.setattr(can, "rc", {"bustype": "pcan", "channel": "rc", "bitrate": 6})
    settings = {"channel": "mine", "bitrate": 6, "port": "9", "hop_limit": 0}
    assert chosen("-c", "mine") == BusChoice("udp_multicast", settings)
    monkeypatch.setenv("CAN_CONFIG", "no JSON")
    with pytest.raises(UsageError, match="variables or configuration files are not valid"):
        chosen()


def test_a_bus_without_a_name_has_that_of_its_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked for own frames where they are wanted, and for one handle, so that it can tell them."""
    infos = [*[can.BusABC.channel_info] * 2, "Leaf"]
    opened = Mock(side_effect=[Mock(channel_info=each) for each in infos])
    monkeypatch.setattr(can, "Bus", opened)
    own, third = {"receive_own_messages": True}, {"channel": 3}
    for settings, name, echo in ((third, "3", {}), ({}, "kvaser", own), (third, "Leaf", {})):
        connection = BusChoice("kvaser", settings).open(returns_own=echo is own)
        assert (type(connection), connection.channel_info) == (Connection, name)
        opened.assert_called_with(interface="kvaser", single_handle=True, **settings, **echo)


def test_no_other_process_joins_a_bus_of_this_one() -> None:
    with pytest.raises(
        UsageError, match="the bus virtual vcan0 is inside this process, so no other can join"
    ):
        chosen().arguments()
    assert chosen("-i", "socketcan").arguments() == ["--interface=socketcan"]
