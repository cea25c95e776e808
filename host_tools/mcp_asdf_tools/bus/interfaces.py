"""Choice of the CAN bus: python-can's own options, variables and files, with an in-process default."""

from __future__ import annotations

import configparser
import errno
import logging
import math
import socket
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import can
from can.interfaces.slcan import slcanBus
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message
from can.typechecking import CanFilters
from can.util import load_environment_config, load_file_config

from mcp_asdf_tools.bus.bus_errors import failure_of_bus
from mcp_asdf_tools.bus.datagrams import unpack_data_frame
from mcp_asdf_tools.common.errors import UsageError

_logger = logging.getLogger(__name__)

DEFAULT_INTERFACE = "virtual"

# Only for settings that the user leaves open. Time stamps from the sender make a log depend on the seed
# alone; with one more hop udp_multicast frames would leave this host.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "virtual": {"channel": "vcan0", "preserve_timestamps": True},
    "udp_multicast": {"hop_limit": 0},
}
_SETUP_OF_VIRTUAL_BUS = ("modprobe vcan", "ip link add dev {} type vcan", "ip link set {} up")
_SETUP_OF_REAL_BUS = ("modprobe can-raw", "ip link set {} up type can bitrate 500000")
"""Commands that create a bus of SocketCAN, with a gap for its name."""
_MAX_OWN_DATAGRAMS = 4096
"""Datagrams that a connection has sent, and remembers until the group returns them."""
_MAX_SECONDS_PER_READ = 1.0
"""python-can waits by the time of day, which may be set back: no wait takes longer than this by that."""
_RECEIVE_BUFFER_BYTES = 1 << 20
"""Room for datagrams of a multicast group that a busy program has not read yet.

The kernel counts some 770 bytes for each, and by default has room for fewer than 300. A swarm of 128 robots
may broadcast more at once.
"""
_PROTOCOL_ERROR = 0x8
"""Class of an error frame in SocketCAN's identifiers: damaged on its way."""
_PAUSE_AFTER_FAILURE = 0.001
"""Seconds between two attempts to read from an interface that raises an exception each time."""
_MAX_LINE_BYTES = 1024
"""Longest line that a serial adapter may send; the line of a CAN FD frame has 145 bytes."""
_MAX_STANDARD_ID, _MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
_MAX_BYTES, _MAX_FD_BYTES = 8, 64
_ROBOT_PLACEHOLDER = "{robot}"
"""Stands for a robot's id in the channel of a bus that each robot has for itself."""
_DEFAULT_UDP_PORT = 43113
"""Port of multicast groups in python-can."""


@dataclass(frozen=True)
class BusChoice:
    """A bus that can be joined any number of times.

    Attributes:
        interface: python-can's name of the kind of bus.
        settings: Further arguments of ``can.Bus``.
    """

    interface: str
    settings: dict[str, Any]

    def __str__(self) -> str:
        """Return the interface and the channel if there is one, such as ``socketcan can0``."""
        return f"{self.interface} {self.channel}" if self.channel else self.interface

    @property
    def channel(self) -> str | None:
        """Name of the bus, such as can0, among buses of its kind; None is the interface's own default."""
        channel = self.settings.get("channel")
        if channel is None:
            return None
        return str(channel)

    def plain(self) -> dict[str, Any]:
        """Return the interface and the channel as plain values, for JSON."""
        return {"interface": self.interface, "channel": self.channel}

    @property
    def has_bus_per_robot(self) -> bool:
        """True if each robot has a bus of its own: the channel has a place for the id, as in vcan{robot}."""
        return _ROBOT_PLACEHOLDER in (self.channel or "")

    @property
    def is_private(self) -> bool:
        """True if no other program can be on the bus, and the user gave nothing but its name."""
        default_settings = _DEFAULTS[DEFAULT_INTERFACE] | {"channel": self.settings.get("channel")}
        return self.interface == DEFAULT_INTERFACE and self.settings == default_settings

    def of_robot(self, robot: int) -> BusChoice:
        """Return the bus of a robot, if each has one for itself, else this bus.

        In the channel the robot's id takes the place of ``{robot}``. On UDP multicast it is also added to the
        port.
        """
        if self.channel is None or not self.has_bus_per_robot:
            return self
        own_settings: dict[str, Any] = {"channel": self.channel.replace(_ROBOT_PLACEHOLDER, str(robot))}
        if self.interface == "udp_multicast":
            # Linux hands the frames of every group joined on this host to all sockets of a port.
            own_settings["port"] = int(self.settings.get("port", _DEFAULT_UDP_PORT)) + robot
        return BusChoice(self.interface, self.settings | own_settings)

    def open(self, returns_own: bool = False) -> can.BusABC:
        """Join the bus as one more node. Raises UsageError if that is impossible.

        The connection marks others' frames as received, on any interface, and waits by a clock that nobody
        sets. It returns the frames that it has sent itself, once they have been on the bus, if
        ``returns_own``, and else never.
        """
        bus = self._open_with_python_can(returns_own)
        if bus.channel_info == can.BusABC.channel_info:  # the interface gave it no name
            bus.channel_info = self.channel or self.interface
        _logger.info("opened the bus %s", self)
        _logger.debug("the bus is a %s with the settings %s", type(bus).__name__, self.settings)
        if self.interface == "udp_multicast":
            return Multicast(bus, returns_own)
        if self.interface == "slcan":
            return SerialAdapter(bus, returns_own)
        return Connection(bus, returns_own)

    def _open_with_python_can(self, returns_own: bool) -> can.BusABC:
        """Return python-can's connection to the bus, which returns own frames if ``returns_own``.

        On UDP multicast it returns them in any case. Raises UsageError if the bus cannot be opened.
        """
        settings = dict(self.settings)
        # `Multicast` decides by itself, since python-can's multicast always returns own frames.
        if returns_own and self.interface != "udp_multicast":
            settings["receive_own_messages"] = True
        # single_handle is for Kvaser alone: one handle reads and writes, as in the tools of python-can.
        try:
            return can.Bus(interface=self.interface, single_handle=True, **settings)
        except Exception as error:  # an interface may raise anything
            raise UsageError(f"cannot open the bus {self}: {self._explain_failure(error)}") from error

    def arguments(self) -> list[str]:
        """Return the options with which a command in another process joins the same bus.

        For example ``["--interface=socketcan", "--bus-kwargs", "channel=vcan0"]``. Raises UsageError if the
        bus is inside this process, so that no other can join it.
        """
        if self.interface == DEFAULT_INTERFACE:
            raise UsageError(
                f"the bus {self} is inside this process, so no other can join it; "
                "choose --interface socketcan or udp_multicast"
            )
        # One --bus-kwargs takes all further settings, as in the command lines of python-can.
        options = [f"--interface={self.interface}"]
        if self.settings:
            options.append("--bus-kwargs")
            options += [f"{name}={value}" for name, value in self.settings.items()]
        return options

    def _explain_failure(self, cause: Exception) -> str:
        """Return what went wrong when the bus was opened, and how to fix it.

        For an interface of SocketCAN that does not exist the fix is the commands that create it.
        """
        if self.interface not in can.VALID_INTERFACES:
            return f"there is no such interface; choose one of {', '.join(sorted(can.VALID_INTERFACES))}"
        # Commands help only if SocketCAN has no interface of this name; anything else takes other options.
        is_missing = isinstance(cause, OSError) and cause.errno in (errno.ENODEV, errno.EAFNOSUPPORT)
        if self.interface != "socketcan" or not is_missing:
            return f"{cause}; see --interface, --channel and --bus-kwargs"
        return f"{cause}; as root, create it with: {_command_line_of_setup(self.channel or 'can0')}"


def _command_line_of_setup(channel: str) -> str:
    """Return the command line that creates a bus of SocketCAN: a virtual one if its name begins with vcan."""
    commands = _SETUP_OF_VIRTUAL_BUS if channel.startswith("vcan") else _SETUP_OF_REAL_BUS
    return " && ".join(command.format(channel) for command in commands)


class Connection(can.BusABC):
    """Connection that wraps one of python-can's, and gives all of them the same behaviour.

    - Time limits hold where the time of day is set back: python-can's own ``recv`` would wait longer.
    - Input that python-can cannot decode, or that no CAN controller sends, arrives as an error frame, like a
      frame that is damaged on its way on a CAN bus. It passes every filter.
    - What fails raises can.CanError, and BusGoneError if the bus will not come back.
    """

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, which closes with this connection.

        ``returns_own`` says whether frames that are sent through this connection come back from ``recv``.
        """
        self._bus = bus
        self._returns_own = returns_own
        # can.BusABC sets its filters in its constructor already, through the bus that is wrapped.
        super().__init__(channel=str(bus.channel_info))
        self.channel_info = bus.channel_info
        self._can_protocol = bus.protocol

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, waiting up to ``timeout`` seconds until the bus takes it.

        Without a timeout, None, the interface decides how long. Raises BusGoneError if the bus is gone,
        another can.CanError if it does not take the frame, and what the interface raises for a frame that it
        cannot send.
        """
        try:
            self._send(msg, timeout)
        except Exception as error:  # an interface may raise anything
            self._raise_if_bus_failed(error)
            raise  # the bus is in order, but the interface cannot send this frame

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that passes the filters; None if none comes within ``timeout`` seconds.

        Without a timeout, None, it waits for ever. Input that cannot be decoded, or that no CAN controller
        can have sent, gives an error frame after a short pause. Raises BusGoneError if the bus is gone, and
        another can.CanError if it fails otherwise.
        """
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            seconds_left = deadline - time.monotonic()
            # python-can waits by the time of day, which may be set back: a read waits for a second at most.
            seconds_to_wait = min(max(seconds_left, 0.0), _MAX_SECONDS_PER_READ)
            try:
                frame, has_passed_filters = self._recv_internal(seconds_to_wait)
                if frame is not None:
                    _check_can_be_sent(frame)
            except Exception as error:  # an interface may raise anything
                self._raise_if_bus_failed(error)
                time.sleep(_PAUSE_AFTER_FAILURE)  # an interface that always fails would keep the CPU busy
                return self._create_error_frame(time.time())
            # Some interfaces filter by themselves; for the others it is done here.
            if frame is not None and (has_passed_filters or self._matches_filters(frame)):
                frame.is_rx = True  # On SocketCAN python-can marks what comes from this computer as sent.
                return frame
            # The time is checked after the read, so that a timeout of 0 reads once what is there.
            if seconds_left <= 0.0:
                return None

    def shutdown(self) -> None:
        """Leave the bus, even if its adapter is unplugged."""
        super().shutdown()
        with suppress(Exception):  # an interface may raise anything, and the bus is left in any case
            self._bus.shutdown()

    def _raise_if_bus_failed(self, error: Exception) -> None:
        """Raise can.CanError if ``error``, which the interface has raised, means that the bus has failed.

        Returns if it only means that input, or a frame to send, is not as the interface expects it.
        """
        failure = failure_of_bus(error, self._bus)
        if failure is None:
            return
        if failure is error:
            raise error  # an exception cannot be its own cause
        raise failure from error

    def _create_error_frame(self, timestamp: float) -> can.Message:
        """Return the error frame that stands for undecodable input."""
        return can.Message(
            timestamp=timestamp,
            arbitration_id=_PROTOCOL_ERROR,
            is_error_frame=True,
            dlc=0,
            channel=self.channel_info,
        )

    def _send(self, msg: can.Message, timeout: float | None) -> None:
        """Send a frame. Raises whatever the interface raises."""
        self._bus.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next frame, or None after ``timeout`` seconds, and whether it has passed the filters.

        Raises whatever the interface raises.
        """
        return self._bus._recv_internal(timeout)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        """Let the kernel or the adapter filter, where they can."""
        self._bus.set_filters(filters)


def _check_can_be_sent(frame: can.Message) -> None:
    """Raise ValueError if no CAN controller can send ``frame``, by its identifier or its length.

    From some damaged input python-can decodes frames that no controller can send.
    """
    # An error frame describes the error by an identifier of 29 bits and by data of any length.
    is_extended = frame.is_extended_id or frame.is_error_frame
    has_valid_id = 0 <= frame.arbitration_id <= (_MAX_EXTENDED_ID if is_extended else _MAX_STANDARD_ID)
    # A remote frame states the length of the answer, and has no data itself.
    expected_bytes = 0 if frame.is_remote_frame else frame.dlc
    max_bytes = _MAX_FD_BYTES if frame.is_fd else _MAX_BYTES
    has_valid_length = len(frame.data) == expected_bytes and frame.dlc <= max_bytes
    if not has_valid_id or not (has_valid_length or frame.is_error_frame):
        raise ValueError("no CAN controller can send this frame")


class SerialAdapter(Connection):
    """Connection through an adapter that sends frames as lines of text, damaged or endless ones included."""

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, which closes with this connection; ``Connection`` explains ``returns_own``."""
        super().__init__(bus, returns_own)
        adapter = cast(slcanBus, bus)
        self._port = adapter.serialPortOrig
        self._unfinished_line = adapter._buffer
        # The port of an adapter at socket://HOST:PORT has a socket; the port of a serial line has none.
        self._socket: socket.socket | None = getattr(self._port, "_socket", None)

    def shutdown(self) -> None:
        """Leave the bus, and close the port, which python-can leaves open if the adapter takes no command."""
        super().shutdown()
        with suppress(OSError):
            self._port.close()
        if self._socket is not None:  # pyserial leaves it open if the other end has closed the connection
            self._socket.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next frame, or None after ``timeout`` seconds, and whether it has passed the filters.

        A line that is no text, or too long, is forgotten, and an error raised: ValueError for a line without
        an end, otherwise what the interface raises.
        """
        try:
            frame_and_has_passed_filters = super()._recv_internal(timeout)
        except Exception:
            # python-can keeps a line that is no text, and would add all that follow to it.
            self._unfinished_line.clear()
            raise
        if len(self._unfinished_line) > _MAX_LINE_BYTES:
            self._unfinished_line.clear()
            raise ValueError("a line has no end")
        return frame_and_has_passed_filters


class Multicast(Connection):
    """Connection to a multicast group, where any program of the network may send anything.

    Datagrams are decoded here, not by python-can. Own frames that are returned are the objects that were
    sent, stamped anew.
    """

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, which closes with this connection; ``Connection`` explains ``returns_own``."""
        super().__init__(bus, returns_own)
        self._group = cast(UdpMulticastBus, bus)._multicast
        # The kernel grants less where the system's limit is lower, and says nothing.
        self._group._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        # Datagrams that were sent and have not come back, with their frames. If one is lost, the same one
        # from elsewhere is taken for it, once.
        self._own_frames: deque[tuple[bytes, can.Message]] = deque(maxlen=_MAX_OWN_DATAGRAMS)

    def _send(self, msg: can.Message, timeout: float | None) -> None:
        """Send a frame, and remember its datagram, which the group will return."""
        datagram = pack_message(msg)
        # Remembered first: another thread may receive the datagram before send() returns.
        self._own_frames.append((datagram, msg))
        self._group.send(datagram, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next frame, and whether it has passed the filters.

        Frames that were sent here are returned only if the connection returns them. The frame is None after
        ``timeout`` seconds, and earlier after one that was sent here and is not returned.
        """
        while True:
            packet = self._group.recv(timeout)
            if packet is None:
                return None, False
            datagram, _sender_address, timestamp = packet
            own_frame = self._pop_own_frame(datagram)
            if own_frame is None:  # another node has sent the datagram
                return self._decode(datagram, timestamp)
            if self._returns_own:
                own_frame.timestamp = timestamp
                own_frame.channel = self.channel_info
                return own_frame, True
            # An own frame is skipped. Only what is there already is read now: if there is nothing, the caller
            # waits again for the rest of its time.
            timeout = 0.0

    def _pop_own_frame(self, datagram: bytes) -> can.Message | None:
        """Remove and return the own frame that was sent as ``datagram``, or None if none was."""
        for index, (own_datagram, frame) in enumerate(self._own_frames):
            if own_datagram == datagram:
                del self._own_frames[index]
                return frame
        return None

    def _decode(self, datagram: bytes, timestamp: float) -> tuple[can.Message, bool]:
        """Return the frame in another node's datagram, and False: it has not been filtered.

        For a datagram that holds no frame, return an error frame, and True: it passes every filter.
        """
        frame = unpack_data_frame(datagram)
        if frame is None:
            return self._create_error_frame(timestamp), True
        frame.timestamp = timestamp
        frame.channel = self.channel_info
        return frame, False


def choose_bus(typed_settings: Mapping[str, Any]) -> BusChoice:
    """Return the bus that the user chooses. Without any setting it is one inside this process.

    A setting is an argument of ``can.Bus``, such as interface or channel. Its value comes from the first of
    these sources that states it: ``typed_settings``, which the user has typed; python-can's ``can.rc``,
    variables and files; the defaults of this program. ``bustype``, an old name of python-can for the
    interface, counts only if no source states ``interface``. Raises UsageError if python-can's settings
    cannot be read.
    """
    settings = _load_python_can_settings() | dict(typed_settings)
    old_interface = settings.pop("bustype", None)
    interface = str(settings.pop("interface", None) or old_interface or DEFAULT_INTERFACE)
    return BusChoice(interface, _DEFAULTS.get(interface, {}) | settings)


def _load_python_can_settings() -> dict[str, Any]:
    """Return the settings of files, variables and ``can.rc``; later ones override earlier ones.

    Raises UsageError if a file or a variable cannot be read.
    """
    try:
        return load_file_config() | load_environment_config() | can.rc
    except (configparser.Error, OSError, TypeError, ValueError) as error:
        raise UsageError(
            f"python-can's CAN_* variables or configuration files are not valid: {error}"
        ) from error
