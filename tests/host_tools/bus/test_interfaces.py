"""Malformed data on a bus is one invalid frame to its robots; every bus has a name."""

from __future__ import annotations

import argparse
import errno
import os
import signal
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from messages import IdentifierAndData, identifier_and_data
from multicast import multicast
from robots import ALPHA_ONE
from support import PATIENCE, wait_until
from wire import node_in_a_thread, running_in_thread

ESTIMATE_OF_ROBOT_8 = Estimate(sender=8, x_hat=1, alpha=ALPHA_ONE, transfer_id=3)
"""The estimate in the datagram ``packed(sender=8)``."""


def contents_before_robot_8(bus: can.BusABC) -> list[Estimate | Rejection]:
    """Receive frames up to the estimate of robot 8, and return what those before hold, or are refused for."""
    contents: list[Estimate | Rejection] = []
    while True:
        frame = bus.recv(timeout=PATIENCE)
        assert frame is not None
        content = decode_estimate(frame, FrameFormat())
        if content == ESTIMATE_OF_ROBOT_8:
            return contents
        contents.append(content)


@contextmanager
def foreign_program(choice: BusChoice) -> Iterator[Callable[[bytes], object]]:
    """Yield a function with which a program sends any datagrams to a multicast group."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("@I", 0))
        program.connect((str(choice.channel), int(choice.settings["port"])))
        yield program.send


def test_each_malformed_datagram_is_one_error_frame_and_the_next_frame_is_received() -> None:
    """Each of 850 odd datagrams is followed by two legal ones, of which the second is robot 8's estimate.

    The bus has the filters of a robot: an error frame and an estimate pass them, another frame does not. Few
    of the 850 datagrams are legal frames.
    """
    other_frame = packed(arbitration_id=5)  # the datagram of a frame with an identifier of no estimate
    estimate_of_robot_8 = packed(sender=8)
    choice = multicast(group=30)
    with choice.open() as bus, foreign_program(choice) as send_datagram:
        bus.set_filters(filters_for(FrameFormat()))
        for odd_datagram in odd_datagrams():
            send_datagram(odd_datagram)
            send_datagram(other_frame)
            send_datagram(estimate_of_robot_8)
            contents = contents_before_robot_8(bus)

            if unpack_data_frame(odd_datagram) is None:
                assert contents == [Rejection.ERROR_FRAME], odd_datagram
            else:  # it is a legal frame, which may pass the filters
                assert len(contents) <= 1, odd_datagram
                assert Rejection.ERROR_FRAME not in contents, odd_datagram


@pytest.mark.parametrize("datagram", [packed(sender=8), b"garbage"])
def test_a_frame_of_a_multicast_group_has_the_channel_and_the_length_of_its_data(datagram: bytes) -> None:
    """The frames are an estimate (8 bytes) and the error frame for a malformed datagram (no data)."""
    choice = multicast(group=31)
    with choice.open() as bus, foreign_program(choice) as send_datagram:
        send_datagram(datagram)
        frame = bus.recv(timeout=PATIENCE)

    assert frame is not None
    assert frame.channel == choice.channel
    assert frame.dlc == len(frame.data)


def test_a_burst_of_four_estimates_from_each_robot_waits_in_the_socket_of_a_multicast_group() -> None:
    """None of the frames is lost, and they come in order, though the receiver reads only after the last one.

    126 robots are the most that a bus has beside a tool: their ids are 0 to 125.
    """
    choice = multicast(group=32)
    frame_ids = list(range(4 * 126))  # four frames from each of 126 robots
    with choice.open() as sender, choice.open() as receiver:
        for frame_id in frame_ids:
            sender.send(can.Message(arbitration_id=frame_id))
        received_frames = [receiver.recv(timeout=PATIENCE) for _ in frame_ids]

    assert [frame.arbitration_id for frame in received_frames if frame is not None] == frame_ids


def receive_all(bus: can.BusABC) -> list[IdentifierAndData]:
    """Return what has arrived on a bus, without waiting."""
    frames = []
    while (frame := bus.recv(0)) is not None:
        frames.append(identifier_and_data(frame))
    return frames


def test_a_connection_that_returns_its_own_frames_does_so_once() -> None:
    """A program asks for it that logs what has been on the bus, with the time of each frame."""
    with multicast(group=34).open(returns_own=True) as bus:
        bus.send(can.Message(arbitration_id=1, data=b"a"))
        returned_frame = bus.recv(timeout=PATIENCE)
        assert returned_frame is not None
        assert identifier_and_data(returned_frame) == (1, b"a")
        assert returned_frame.timestamp > 0
        assert bus.recv(timeout=0) is None


def test_equal_frames_of_several_senders_reach_all_others() -> None:
    """Each of three connections sends the same three frames. Two of the frames are alike.

    The group returns each datagram to its sender, who takes the first equal frame for its own. So two
    connections receive only the six frames of the others. The third wants its own frames, too: all nine.
    """
    choice = multicast(group=35)
    with choice.open() as bus_0, choice.open() as bus_1, choice.open(returns_own=True) as bus_2:
        for identifier in (1, 2, 1):
            for bus in (bus_0, bus_1, bus_2):
                bus.send(can.Message(arbitration_id=identifier), timeout=1)
        received_counts = [len(receive_all(bus)) for bus in (bus_0, bus_1, bus_2)]

    assert received_counts == [2 * 3, 2 * 3, 3 * 3]


def socketcan_bus(*received_frames: can.Message) -> Mock:
    """Return a bus of SocketCAN as python-can has it, called can0, which receives these frames."""
    bus = Mock(channel_info="can0", protocol=can.CanProtocol.CAN_20)
    bus._recv_internal.side_effect = [(frame, True) for frame in (*received_frames, None)]
    return bus


def test_frames_of_other_programs_of_this_computer_are_marked_as_received() -> None:
    """Python-can marks them as sent, since on SocketCAN the programs of a computer share a bus."""
    frame_of_other_program = can.Message(is_rx=False)
    frame = Connection(socketcan_bus(frame_of_other_program)).recv(timeout=0)
    assert frame is not None
    assert frame.is_rx


def test_filters_of_a_socketcan_bus_are_given_to_the_kernel() -> None:
    """The kernel then wakes a program only for frames that pass a filter."""
    bus_of_python_can = socketcan_bus()
    filters = filters_for(FrameFormat())
    Connection(bus_of_python_can).set_filters(filters)
    bus_of_python_can.set_filters.assert_called_with(filters)


def test_a_connection_has_the_protocol_and_the_name_of_its_bus() -> None:
    """A connection wraps a bus of python-can, here SocketCAN's can0 for classic CAN, and passes for it."""
    connection = Connection(socketcan_bus())
    assert connection.protocol is can.CanProtocol.CAN_20
    assert connection.channel_info == "can0"


def test_leaving_a_bus_whose_adapter_is_unplugged_is_no_error() -> None:
    """The error that the driver raises is dropped, as the bus has been left anyway."""
    bus_of_python_can = socketcan_bus()
    bus_of_python_can.shutdown.side_effect = can.CanOperationError("unplugged")
    Connection(bus_of_python_can).shutdown()
    bus_of_python_can.shutdown.assert_called_once_with()


def radio(options: str) -> int:
    """Run ``mcp-asdf radio`` on the virtual bus of this process, and return its exit code."""
    return main(["radio", "--interface", "virtual", *options.split()])


@pytest.fixture
def set_clock_back(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[float]]:
    """Function that lets every look at the time of day find it three days earlier than the last one.

    Python-can ends a wait by the time of day, so by itself it would wait for days. The function returns a
    list to which the seconds of each wait for a bus are added from now on.
    """

    def set_back() -> list[float]:
        seconds_set_back, seconds_of_waits = count(step=3 * 86400), list[float]()
        receive = VirtualBus._recv_internal

        def record_wait(bus: Any, timeout: float | None) -> Any:
            assert timeout is not None and timeout <= 1, "it would wait for days"
            seconds_of_waits.append(timeout)
            return receive(bus, timeout)

        monkeypatch.setattr("can.bus.time", lambda: -next(seconds_set_back))
        monkeypatch.setattr(VirtualBus, "_recv_internal", record_wait)
        return seconds_of_waits

    return set_back


def test_node_and_radio_answer_each_other_while_the_clock_is_set_back(
    set_clock_back: Callable[[], list[float]],
) -> None:
    """``radio --verify`` compares a node's answers with a model. Python-can waits by the time of day.

    Here it goes back by three days at each look. The node has another b_hat than the model, so that radio
    finds a difference once the node has answered.
    """
    with node_in_a_thread("--id 5 --b-hat 0.55 --activation always"):
        seconds_of_waits = set_clock_back()
        exit_code = radio("--id 5 --b-hat 0.56 --activation always --verify --timeout 60")

    exit_code_of_a_difference = 1
    assert exit_code == exit_code_of_a_difference
    assert seconds_of_waits, "no connection has waited since the clock was set back"


def test_a_signal_ends_a_command_while_the_clock_is_set_back(
    set_clock_back: Callable[[], list[float]],
) -> None:
    """The command ``radio`` waits for frames that do not come, until SIGTERM ends it with exit code 0."""
    seconds_of_waits = set_clock_back()

    def send_signal_once_radio_waits() -> None:
        wait_until(lambda: len(seconds_of_waits) > 0)
        os.kill(os.getpid(), signal.SIGTERM)

    with running_in_thread(send_signal_once_radio_waits):
        assert radio("--id 5 --robots 3 --channel another") == 0


def test_a_wait_ends_in_time_while_the_clock_is_set_back(set_clock_back: Callable[[], list[float]]) -> None:
    """No frame comes within 10 ms, so ``recv`` returns None. Python-can itself would wait for days."""
    seconds_of_waits = set_clock_back()
    with bus_from_options("--channel", "silent").open() as bus:
        assert bus.recv(timeout=0.01) is None
    assert seconds_of_waits, "the connection has not waited"


def bus_from_options(*options: str) -> BusChoice:
    """Return the bus that these command-line options choose."""
    parser = argparse.ArgumentParser()
    add_bus_options(parser)
    return bus_of(parser.parse_args(options))


@pytest.mark.parametrize(
    ("options", "settings_of_robot_7"),
    [
        (
            "-i udp_multicast -c 239.1.1.{robot} --bus-kwargs port=9 a=b",
            {"hop_limit": 0, "channel": "239.1.1.7", "port": 9 + 7, "a": "b"},
        ),
        # No port is chosen here, and python-can's is 43113.
        ("-i udp_multicast -c g{robot}", {"hop_limit": 0, "channel": "g7", "port": 43113 + 7}),
        ("-i socketcan -c vcan{robot}", {"channel": "vcan7"}),
    ],
)
def test_the_id_of_a_robot_is_put_into_its_channel_and_added_to_the_port_of_a_multicast_group(
    options: str, settings_of_robot_7: dict[str, Any]
) -> None:
    """Linux hands the frames of all groups to every socket of a port, so each robot needs one for itself."""
    bus_of_all = bus_from_options(*options.split())
    assert bus_of_all.of_robot(7).settings == settings_of_robot_7


def test_a_bus_with_a_place_for_the_id_has_a_channel_for_each_robot() -> None:
    """The place is {robot} in the name of the channel. In robot 7's channel its id stands there instead."""
    bus_of_all = bus_from_options("-i", "udp_multicast", "-c", "239.1.1.{robot}")
    bus_of_robot_7 = bus_of_all.of_robot(7)

    assert bus_of_all.has_bus_per_robot
    assert str(bus_of_robot_7) == "udp_multicast 239.1.1.7"
    assert not bus_of_robot_7.has_bus_per_robot
    assert bus_of_robot_7.of_robot(3) is bus_of_robot_7  # there is no place left for another id


def test_the_arguments_of_a_bus_choose_the_same_bus_again() -> None:
    """A command in another process joins the bus by them. All settings are texts there."""
    options = "-i udp_multicast -c 239.1.1.{robot} -b 500000 --bus-kwargs port=9 a=b"
    bus = bus_from_options(*options.split()).of_robot(7)
    same_bus = bus_from_options(*bus.arguments())

    assert same_bus.interface == "udp_multicast"
    settings_as_texts = {name: str(value) for name, value in bus.settings.items()}
    assert same_bus.settings == settings_as_texts


def test_a_bus_without_settings_needs_no_further_arguments() -> None:
    """With these arguments a command in another process joins the same bus."""
    assert bus_from_options("-i", "socketcan").arguments() == ["--interface=socketcan"]


def test_the_arguments_of_a_bus_inside_this_process_are_refused() -> None:
    """A command in another process could not join it. Without options a bus is such a one."""
    bus = bus_from_options()
    with pytest.raises(UsageError, match="the bus virtual vcan0 is inside this process, so no other can"):
        bus.arguments()


@pytest.mark.parametrize(
    ("options", "is_private"),
    [
        ("", True),
        ("--channel another", True),
        ("--bus-kwargs preserve_timestamps=True", False),
        ("-i socketcan -c vcan0", False),
    ],
)
def test_a_bus_of_this_process_is_private_unless_it_has_settings(options: str, is_private: bool) -> None:
    """Private means that no other program can be on the bus, and that the user has given at most its name."""
    assert bus_from_options(*options.split()).is_private == is_private


def test_a_setting_without_a_value_is_refused() -> None:
    """The parser of the options ends the command, as it does for any wrong option."""
    with pytest.raises(SystemExit):
        bus_from_options("--bus-kwargs", "no value")


SEE_OPTIONS = "see --interface, --channel and --bus-kwargs"
CREATE_VIRTUAL_BUS = (
    "as root, create it with: modprobe vcan && ip link add dev vcan97 type vcan && ip link set vcan97 up"
)
CREATE_REAL_BUS = "as root, create it with: modprobe can-raw && ip link set can0 up type can bitrate 500000"


@pytest.mark.parametrize(
    ("options", "error_number", "fix"),
    [
        ("-i socketcan -c vcan97", errno.ENODEV, CREATE_VIRTUAL_BUS),
        ("-i socketcan", errno.EAFNOSUPPORT, CREATE_REAL_BUS),
        ("-i socketcan -c can97", errno.EPERM, SEE_OPTIONS),
        ("-i udp_multicast -c nowhere", errno.ENODEV, SEE_OPTIONS),
    ],
)
def test_the_failure_to_open_a_bus_is_reported_with_its_fix(
    options: str, error_number: int, fix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fix is a command if SocketCAN has no such bus, and otherwise a look at the options."""
    bus = bus_from_options(*options.split())
    fail_to_open = Mock(side_effect=OSError(error_number, "no way"))
    monkeypatch.setattr(can, "Bus", fail_to_open)

    with pytest.raises(UsageError) as raised:
        bus.open()
    assert str(raised.value) == f"cannot open the bus {bus}: [Errno {error_number}] no way; {fix}"


def test_the_failure_to_open_a_bus_that_does_not_exist_says_how_to_create_it() -> None:
    """No driver is replaced here: SocketCAN itself says that it has no such bus."""
    with pytest.raises(UsageError, match=r"vcan97 up$"):
        bus_from_options("-i", "socketcan", "-c", "vcan97").open()


def test_an_interface_that_python_can_does_not_have_is_refused_with_those_that_it_has() -> None:
    """The user has mistyped the name of a kind of bus."""
    with pytest.raises(UsageError, match=r"there is no such interface; choose one of .*, socketcan, "):
        BusChoice("gremlin", {}).open()


def test_a_bus_is_chosen_by_options_before_rc_before_variables_before_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A setting of a source counts if no earlier source has it. Here each source decides on one setting."""
    monkeypatch.setenv("HOME", str(tmp_path))
    lines_of_file = ["[default]", "interface=of_file", "channel=of_file", "bitrate=of_file", "port=of_file"]
    (tmp_path / ".canrc").write_text("\n".join(lines_of_file))
    monkeypatch.setenv("CAN_INTERFACE", "udp_multicast")
    monkeypatch.setattr(can, "rc", {"channel": "of_rc", "bitrate": "of_rc"})

    bus = bus_from_options("-c", "of_option")

    assert bus.interface == "udp_multicast"  # of the variable
    # The hop limit is a default of this program, for multicast.
    assert bus.settings == {"channel": "of_option", "bitrate": "of_rc", "port": "of_file", "hop_limit": 0}


def test_the_name_bustype_for_an_interface_counts_if_no_source_has_the_name_interface(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Old files and programs of python-can call it so. A variable with the new name comes before them all."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("CAN_INTERFACE", raising=False)
    (tmp_path / ".canrc").write_text("[default]\nbustype=udp_multicast\nchannel=of_file")
    assert bus_from_options().interface == "udp_multicast"
    assert bus_from_options("-i", "virtual").interface == "virtual"

    monkeypatch.setattr(can, "rc", {"bustype": "of_rc"})
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    bus = bus_from_options()
    assert bus.interface == "virtual"
    assert "bustype" not in bus.settings


def test_a_variable_of_python_can_that_cannot_be_read_is_a_usage_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Python-can reads settings from the environment, here from CAN_CONFIG, which must hold JSON."""
    monkeypatch.setenv("CAN_CONFIG", "no JSON")
    with pytest.raises(UsageError, match="variables or configuration files are not valid"):
        bus_from_options()


NO_NAME = can.BusABC.channel_info
"""What python-can has as the name of a bus to which the driver gives none."""


@pytest.mark.parametrize(
    ("name_of_driver", "settings", "expected_name"),
    [(NO_NAME, {"channel": 3}, "3"), (NO_NAME, {}, "kvaser"), ("Leaf", {"channel": 3}, "Leaf")],
)
def test_a_bus_has_the_name_that_its_driver_gives_or_that_of_its_channel_or_interface(
    name_of_driver: str, settings: dict[str, Any], expected_name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kvaser's driver is replaced by one without hardware. Without its name, the channel's is taken first."""
    bus_of_driver = Mock(channel_info=name_of_driver)
    monkeypatch.setattr(can, "Bus", Mock(return_value=bus_of_driver))
    bus = BusChoice("kvaser", settings).open()
    assert bus.channel_info == expected_name


@pytest.mark.parametrize("returns_own", [False, True])
def test_a_driver_returns_the_frames_that_a_connection_sends_only_where_they_are_wanted(
    returns_own: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python-can's setting for that, which is off by default, is receive_own_messages."""
    open_bus = Mock(return_value=Mock(channel_info="Leaf"))
    monkeypatch.setattr(can, "Bus", open_bus)

    BusChoice("kvaser", {"channel": 3}).open(returns_own)

    expected_settings: dict[str, Any] = {"interface": "kvaser", "channel": 3}
    expected_settings["single_handle"] = True  # Kvaser's driver cannot tell own frames from others without
    if returns_own:
        expected_settings["receive_own_messages"] = True
    open_bus.assert_called_with(**expected_settings)
