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
_VIRTUAL = ("modprobe vcan", "ip link add dev {} type vcan", "ip link set {} up")
_REAL = ("modprobe can-raw", "ip link set {} up type can bitrate 500000")
_MOST_ECHOES = 4096
_LONGEST_WAIT = 1.0
"""Seconds."""
_RECEIVE_BUFFER_BYTES = 1 << 20
"""Room for datagrams of a multicast group that a busy program has not read yet.

The kernel counts some 770 bytes for each, and by default has room for fewer than 300. A swarm of 128 robots
may broadcast more at once.
"""
_PROTOCOL_ERROR = 0x8
"""Class of an error frame in SocketCAN's identifiers: damaged on its way."""
_PAUSE = 0.001
"""Seconds between two attempts to read from an interface that raises an exception each time."""
_LONGEST_LINE = 1024
"""Bytes of a serial adapter's line; that of a CAN FD frame has 145."""
_MAX_STANDARD_ID, _MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
_MAX_BYTES, _MAX_FD_BYTES = 8, 64
_ROBOT = "{robot}"
_UDP_PORT = 43113
"""python-can's."""


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
        return self.interface + (f" {self.channel}" if self.channel else "")

    @property
    def channel(self) -> str | None:
        """The bus among those of its kind; None is the interface's own default."""
        channel = self.settings.get("channel")
        return None if channel is None else str(channel)

    @property
    def has_channels(self) -> bool:
        """True if each robot has a bus of its own: the channel has a place for the id, as in vcan{robot}."""
        return _ROBOT in (self.channel or "")

    @property
    def is_private(self) -> bool:
        """True if no other program can be on the bus, and the user gave nothing but its name."""
        plain = _DEFAULTS[DEFAULT_INTERFACE] | {"channel": self.settings.get("channel")}
        return self.interface == DEFAULT_INTERFACE and self.settings == plain

    def of_robot(self, robot: int) -> BusChoice:
        """The bus of a robot, if each has one, else this bus."""
        if self.channel is None or not self.has_channels:
            return self
        own: dict[str, Any] = {"channel": self.channel.replace(_ROBOT, str(robot))}
        if self.interface == "udp_multicast":
            # Linux hands the frames of every group joined on this host to all sockets of a port.
            own["port"] = int(self.settings.get("port", _UDP_PORT)) + robot
        return BusChoice(self.interface, self.settings | own)

    def open(self, returns_own: bool = False) -> can.BusABC:
        """Join the bus as one more node. Raises UsageError if that is impossible.

        The connection marks others' frames as received, on any interface, and waits by a clock that nobody
        sets. Own frames it returns, once they have been on the bus, if ``returns_own``, and else never.
        """
        echo = {"receive_own_messages": True} if returns_own and self.interface != "udp_multicast" else {}
        try:
            bus = can.Bus(interface=self.interface, single_handle=True, **self.settings | echo)
        except Exception as error:  # an interface may raise anything
            raise UsageError(f"cannot open the bus {self}: {self._explain(error)}") from error
        if bus.channel_info == can.BusABC.channel_info:
            bus.channel_info = self.channel or self.interface
        _logger.info("opened the bus %s", self)
        _logger.debug("the bus is a %s with the settings %s", type(bus).__name__, self.settings)
        connection = {"udp_multicast": Multicast, "slcan": SerialAdapter}.get(self.interface, Connection)
        return connection(bus, returns_own)

    def arguments(self) -> list[str]:
        """Options with which a command in another process joins the same bus.

        Raises UsageError if no other process can.
        """
        if self.interface == DEFAULT_INTERFACE:
            raise UsageError(
                f"the bus {self} is inside this process, so no other can join it; "
                "choose --interface socketcan or udp_multicast"
            )
        words = [f"{name}={value}" for name, value in self.settings.items()]
        return [f"--interface={self.interface}", *(["--bus-kwargs", *words] if words else [])]

    def _explain(self, cause: Exception) -> str:
        """The failure and its fix."""
        if self.interface not in can.VALID_INTERFACES:
            return f"there is no such interface; choose one of {', '.join(sorted(can.VALID_INTERFACES))}"
        is_missing = isinstance(cause, OSError) and cause.errno in (errno.ENODEV, errno.EAFNOSUPPORT)
        if self.interface != "socketcan" or not is_missing:
            return f"{cause}; see --interface, --channel and --bus-kwargs"
        channel = self.channel or "can0"
        ways = _VIRTUAL if channel.startswith("vcan") else _REAL
        return f"{cause}; as root, create it with: " + " && ".join(way.format(channel) for way in ways)


class Connection(can.BusABC):
    """Connection that wraps one of python-can's, and gives all of them the same behaviour.

    - Time limits hold where the time of day is set back: python-can's own ``recv`` would wait longer.
    - Input that python-can cannot decode, or that no CAN controller sends, arrives as an error frame, like a
      frame that is damaged on its way on a CAN bus. It passes every filter.
    - What fails raises can.CanError, and BusGoneError if the bus will not come back.
    """

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, which closes with this connection, and returns own frames or not."""
        self._bus = bus
        self._returns_own = returns_own
        self._was_undecodable = False
        super().__init__(channel=str(bus.channel_info))
        self.channel_info = bus.channel_info
        self._can_protocol = bus.protocol

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, as ``can.BusABC.send``. Raises BusGoneError if the bus is gone."""
        try:
            self._send(msg, timeout)
        except Exception as error:  # an interface may raise anything
            failure = failure_of_bus(error, self._bus)
            if failure is None or failure is error:
                raise
            raise failure from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that passes the filters, as ``can.BusABC.recv``.

        Raises BusGoneError if the bus is gone.
        """
        end = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            seconds_left = end - time.monotonic()
            frame, is_filtered = self._receive(min(max(seconds_left, 0.0), _LONGEST_WAIT))
            if frame is not None and (is_filtered or self._matches_filters(frame)):
                frame.is_rx = True  # on SocketCAN python-can marks what comes from this computer as sent
                return frame
            if seconds_left <= 0.0:
                return None

    def shutdown(self) -> None:
        """Leave the bus, even if its adapter is unplugged."""
        super().shutdown()
        with suppress(Exception):  # an interface may raise anything, and the bus is left in any case
            self._bus.shutdown()

    def _receive(self, timeout: float) -> tuple[can.Message | None, bool]:
        """Return what ``_recv_internal`` returns, and an error frame in place of undecodable input."""
        try:
            frame, is_filtered = self._recv_internal(timeout)
            is_decodable = frame is None or _can_be_sent(frame)
        except Exception as error:  # an interface may raise anything
            failure = failure_of_bus(error, self._bus)
            if failure is not None:
                raise failure from error
            frame, is_filtered, is_decodable = None, False, False
        if not is_decodable:
            if self._was_undecodable:
                time.sleep(_PAUSE)  # an interface that always fails must not keep the processor busy
            frame, is_filtered = self._error_frame(time.time()), True
        self._was_undecodable = not is_decodable
        return frame, is_filtered

    def _error_frame(self, timestamp: float) -> can.Message:
        """Return the error frame that stands for undecodable input."""
        return can.Message(
            timestamp=timestamp,
            arbitration_id=_PROTOCOL_ERROR,
            is_error_frame=True,
            dlc=0,
            channel=self.channel_info,
        )

    def _send(self, msg: can.Message, timeout: float | None) -> None:
        self._bus.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self._bus._recv_internal(timeout)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._bus.set_filters(filters)  # by the kernel or the adapter, where they can


def _can_be_sent(frame: can.Message) -> bool:
    """Return whether a CAN controller can send ``frame``: python-can decodes some damaged input to others."""
    if not 0 <= frame.arbitration_id <= _MAX_EXTENDED_ID:
        return False
    if frame.is_error_frame:  # its identifier has bits that describe the error
        return True
    has_valid_id = frame.is_extended_id or frame.arbitration_id <= _MAX_STANDARD_ID
    has_right_length = len(frame.data) == (0 if frame.is_remote_frame else frame.dlc)
    return has_valid_id and has_right_length and frame.dlc <= (_MAX_FD_BYTES if frame.is_fd else _MAX_BYTES)


class SerialAdapter(Connection):
    """Connection through an adapter that sends frames as lines of text, damaged or endless ones included."""

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, as ``Connection``."""
        super().__init__(bus, returns_own)
        adapter = cast(slcanBus, bus)
        self._port = adapter.serialPortOrig
        self._unfinished_line = adapter._buffer
        # The port of an adapter at socket://HOST:PORT has a socket; that of a serial line has none.
        self._socket: socket.socket | None = getattr(self._port, "_socket", None)

    def shutdown(self) -> None:
        """Leave the bus, and close the port, which python-can leaves open if the adapter takes no command."""
        super().shutdown()
        with suppress(OSError):
            self._port.close()
        if self._socket is not None:  # pyserial leaves it open if the other end has closed the connection
            self._socket.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            received = super()._recv_internal(timeout)
        except Exception:
            # python-can keeps a line that is no text, and would add all that follow to it.
            self._unfinished_line.clear()
            raise
        if len(self._unfinished_line) > _LONGEST_LINE:
            self._unfinished_line.clear()
            raise ValueError("a line has no end")
        return received


class Multicast(Connection):
    """Connection to a multicast group, where any program of the network may send anything.

    Datagrams are decoded here, not by python-can. Own frames that are returned are the objects that were
    sent, stamped anew.
    """

    def __init__(self, bus: can.BusABC, returns_own: bool = False) -> None:
        """Take over ``bus``, as ``Connection``."""
        super().__init__(bus, returns_own)
        self._group = cast(UdpMulticastBus, bus)._multicast
        # The kernel grants less where the system's limit is lower, and says nothing.
        self._group._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        # If an own datagram is lost, the same one from elsewhere is taken for it, once.
        self._own: deque[tuple[bytes, can.Message]] = deque(maxlen=_MOST_ECHOES)

    def _send(self, msg: can.Message, timeout: float | None) -> None:
        datagram = pack_message(msg)
        self._own.append((datagram, msg))
        self._group.send(datagram, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while (received := self._group.recv(timeout)) is not None:
            datagram, _, timestamp = received
            own_frame = self._take_own(datagram)
            if own_frame is None:
                return self._decode(datagram, timestamp)
            if self._returns_own:
                own_frame.timestamp, own_frame.channel = timestamp, self.channel_info
                return own_frame, True
            timeout = 0.0  # the caller waits again for the rest of its time
        return None, False

    def _take_own(self, datagram: bytes) -> can.Message | None:
        """Return the own frame that has come back, if it is one, and forget it."""
        for index, (own_datagram, frame) in enumerate(self._own):
            if own_datagram == datagram:
                del self._own[index]
                return frame
        return None

    def _decode(self, datagram: bytes, timestamp: float) -> tuple[can.Message, bool]:
        """Return another's frame, or an error frame for a datagram that holds none, and whether it passes any
        filter."""
        frame = unpack_data_frame(datagram)
        if frame is None:
            return self._error_frame(timestamp), True
        frame.timestamp, frame.channel = timestamp, self.channel_info
        return frame, False


def choose_bus(typed_settings: Mapping[str, Any]) -> BusChoice:
    """Return the bus that the user chooses, in this process if nothing says which.

    ``typed_settings`` are the arguments of ``can.Bus`` that the user has typed, such as interface and
    channel. Where they leave it open, python-can's files, variables and ``can.rc`` decide. Raises UsageError
    if these cannot be read.
    """
    settings = _inherited() | dict(typed_settings)
    kind, interface = settings.pop("bustype", None), settings.pop("interface", None)
    chosen = str(interface or kind or DEFAULT_INTERFACE)
    return BusChoice(chosen, _DEFAULTS.get(chosen, {}) | settings)


def _inherited() -> dict[str, Any]:
    """Settings of files, variables and ``can.rc``; later ones override earlier ones."""
    try:
        return load_file_config() | load_environment_config() | can.rc
    except (configparser.Error, OSError, TypeError, ValueError) as error:
        raise UsageError(
            f"python-can's CAN_* variables or configuration files are not valid: {error}"
        ) from error
