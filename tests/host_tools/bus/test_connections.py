"""Connections to a bus whose input is damaged, which fails, or which is gone."""

from __future__ import annotations

import errno
import json
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any
from unittest.mock import Mock

import can
import pytest
import serial  # type: ignore[import-untyped]

from mcp_asdf_tools.bus.bus_errors import BusGoneError
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from mcp_asdf_tools.bus.interfaces import BusChoice, Connection, SerialAdapter
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.radio.real_time import RadioRun
from mcp_asdf_tools.robots.node import BusLink
from support import PATIENCE
from wrong_robots import settings_with_four_neighbours

pytestmark = [
    pytest.mark.usefixtures("private_setup"),
    # pyserial leaves closing to the garbage collector where the other end has closed first.
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),
]


LINE_OF_ESTIMATE = b"T106BB80180000400000803FE0\r"
"""An estimate of robot 1 in slcan: T, identifier, number of bytes, data, and a carriage return."""

DAMAGED_LINES = (
    *(b"T106BB8\r", b"TZZ\r", b"t\r", b"\xff\r", b"T106BB8018000040000080ZZE0\r", b"T106BB80180000\r"),
    *(b"TFFFFFFFF0\r", b"T-00000010\r", b"tFFF0\r", b"r1239\r", b"t1239112233445566778899\r", b"dZZZ0\r"),
)
"""Lines that python-can turns into an exception, or into a frame that no CAN controller sends."""


def send_to_first_program(
    listener: socket.socket, lines: Sequence[bytes], may_close: threading.Event
) -> None:
    """Send lines to the first program that connects and opens the channel, and close when it is allowed."""
    with suppress(OSError):  # nobody has come, or the program has left
        connection, _ = listener.accept()
        with connection:
            connection.recv(2)  # the command that opens the channel
            connection.sendall(b"".join(lines))
            may_close.wait()


@contextmanager
def adapter_that_sends(lines: Sequence[bytes], stays_open: bool = True) -> Iterator[BusChoice]:
    """Serve a serial adapter at a TCP port, and yield the choice of its bus, which a test opens.

    The adapter sends ``lines`` to the first program that opens the bus. Then it closes the connection: at
    once, or if it ``stays_open``, when the block is left.
    """
    may_close = threading.Event()
    if not stays_open:
        may_close.set()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=send_to_first_program, args=(listener, lines, may_close))
        thread.start()
        try:
            _host, port = listener.getsockname()
            channel = f"socket://127.0.0.1:{port}"
            settings = {"channel": channel, "sleep_after_open": 0, "ignore_config": True}
            yield BusChoice("slcan", settings)
        finally:
            may_close.set()
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def receive(bus: can.BusABC) -> can.Message:
    """Return the next frame, which must come in time."""
    frame = bus.recv(timeout=PATIENCE)
    assert frame is not None
    return frame


@pytest.mark.parametrize("line", DAMAGED_LINES)
def test_a_damaged_line_is_one_error_frame_and_the_frame_behind_it_is_received(line: bytes) -> None:
    """A serial adapter sends frames as lines of text: here a damaged one, then an estimate."""
    with adapter_that_sends([line, LINE_OF_ESTIMATE]) as adapter, adapter.open() as bus:
        error_frame, frame = receive(bus), receive(bus)
    assert error_frame.is_error_frame
    assert isinstance(decode_estimate(frame, FrameFormat()), Estimate)


def test_a_line_that_never_ends_is_an_error_frame_as_soon_as_it_is_too_long() -> None:
    """A broken adapter would fill the memory, unnoticed. So a line may have at most 1024 characters."""
    with adapter_that_sends([b"T" * 3000]) as adapter, adapter.open() as bus:
        assert receive(bus).is_error_frame


def test_a_line_without_an_end_is_dropped() -> None:
    """A serial adapter sends 3000 characters without the end of a line, and then the same estimate twice.

    The characters become error frames and may cost the first estimate. The second one is received.
    """
    lines = [b"T" * 3000, LINE_OF_ESTIMATE, LINE_OF_ESTIMATE]
    with adapter_that_sends(lines) as adapter, adapter.open() as bus:
        frame = receive(bus)
        assert frame.is_error_frame
        while frame.is_error_frame:
            frame = receive(bus)

    assert isinstance(decode_estimate(frame, FrameFormat()), Estimate)


def test_reading_from_an_adapter_that_has_closed_raises_that_the_bus_is_gone() -> None:
    """A serial adapter at a TCP port sends an estimate and closes the connection."""
    with adapter_that_sends([LINE_OF_ESTIMATE], stays_open=False) as adapter, adapter.open() as bus:
        receive(bus)
        with pytest.raises(BusGoneError, match="socket disconnected"):
            bus.recv(timeout=PATIENCE)


def test_leaving_a_bus_closes_its_socket_though_the_adapter_has_closed_first() -> None:
    """Pyserial would leave it open here. An open socket has a descriptor of 0 or more."""
    with adapter_that_sends([], stays_open=False) as adapter:
        bus = adapter.open()
        assert isinstance(bus, SerialAdapter)
        with pytest.raises(BusGoneError):
            bus.recv(timeout=PATIENCE)
        connection = bus._socket
        bus.shutdown()

    assert connection is not None
    descriptor_of_a_closed_socket = -1
    assert connection.fileno() == descriptor_of_a_closed_socket


def failing_connection(error: Exception, descriptor: int = 5) -> Connection:
    """Return a connection to a bus with this file descriptor that raises ``error`` whenever it is used."""
    bus = Mock(channel_info="can0", protocol=can.CanProtocol.CAN_20)
    bus._recv_internal.side_effect = bus.send.side_effect = error
    bus.fileno.return_value = descriptor
    return Connection(bus)


def caused_by(cause: Exception) -> can.CanOperationError:
    """Return what python-can makes of an exception of a driver or the system."""
    error = can.CanOperationError("could not read")
    error.__cause__ = cause
    return error


ERRORS_OF_A_BUS_THAT_IS_GONE: list[Exception] = [
    caused_by(serial.SerialException("device disconnected")),
    caused_by(OSError(errno.ENODEV, "No such device")),
    caused_by(OSError(errno.EIO, "Input/output error")),
    OSError(errno.EBADF, "Bad file descriptor"),
    RuntimeError("the driver has crashed"),
]


@pytest.mark.parametrize("error", ERRORS_OF_A_BUS_THAT_IS_GONE, ids=str)
def test_a_bus_whose_device_was_unplugged_or_whose_driver_crashed_is_reported_as_gone(
    error: Exception,
) -> None:
    """Whatever the driver raised, reading and sending raise BusGoneError, as neither will work again."""
    connection = failing_connection(error)
    with pytest.raises(BusGoneError):
        connection.recv(timeout=0)
    with pytest.raises(BusGoneError):
        connection.send(can.Message(), timeout=0)


FAILURES_THAT_MAY_PASS: list[Exception] = [
    caused_by(OSError(errno.ENETDOWN, "Network is down")),
    caused_by(serial.SerialTimeoutException("Write timeout")),
    can.CanOperationError("bus-off"),
    can.CanTimeoutError("no room in the queue"),
    OSError(errno.ENOBUFS, "No buffer space available"),
]


@pytest.mark.parametrize("error", FAILURES_THAT_MAY_PASS, ids=str)
def test_a_failure_that_may_pass_is_not_reported_as_a_bus_that_is_gone(error: Exception) -> None:
    """The failure raises a CanError, but not BusGoneError. A program that runs for long tries again."""
    connection = failing_connection(error)
    with pytest.raises(can.CanError) as raised:
        connection.recv(timeout=0)
    assert not isinstance(raised.value, BusGoneError)


NOT_UTF_8 = UnicodeDecodeError("utf-8", b"", 0, 1, "")
DECODING_ERRORS: list[Exception] = [ValueError("no number"), caused_by(NOT_UTF_8)]


@pytest.mark.parametrize("error", DECODING_ERRORS, ids=str)
def test_input_that_cannot_be_decoded_is_received_as_an_error_frame(error: Exception) -> None:
    """To its receivers it is like a frame that was damaged on its way."""
    connection = failing_connection(error)
    frame = connection.recv(timeout=0)
    assert frame is not None
    assert frame.is_error_frame


UNUSUAL_FRAMES = [
    can.Message(is_error_frame=True, arbitration_id=1 << 28, is_extended_id=False, dlc=8, data=bytes(8)),
    can.Message(is_error_frame=True, dlc=8, data=bytes(2)),
    can.Message(is_remote_frame=True, arbitration_id=3, dlc=5),
]
"""Frames as interfaces pass them on: errors that a controller has found, and a request for five bytes."""


@pytest.mark.parametrize("frame", UNUSUAL_FRAMES, ids=str)
def test_an_error_frame_and_a_remote_frame_are_received_as_they_are(frame: can.Message) -> None:
    """A log has the details of the error then. Only damaged input becomes an error frame without details."""
    bus = Mock(channel_info="can0", protocol=can.CanProtocol.CAN_20)
    bus._recv_internal.return_value = (frame, True)
    assert Connection(bus).recv(timeout=0) is frame


@pytest.mark.parametrize("error", DECODING_ERRORS, ids=str)
def test_a_decoding_error_of_a_bus_that_is_closed_is_reported_as_a_bus_that_is_gone(error: Exception) -> None:
    """Some drivers decode nothing as if it were input when their device is gone.

    The same errors on a bus that is open are input that cannot be decoded.
    """
    connection = failing_connection(error, descriptor=-1)  # as that of a socket that is closed
    with pytest.raises(BusGoneError):
        connection.recv(timeout=0)


def test_a_connection_pauses_after_each_failure_of_an_interface_that_always_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After each of ten failures there is a pause of 1 ms, so that the processor is not kept busy."""
    seconds_of_pauses: list[float] = []
    monkeypatch.setattr("mcp_asdf_tools.bus.interfaces.time.sleep", seconds_of_pauses.append)
    connection = failing_connection(IndexError("raised by the driver at each call"))
    for _ in range(10):
        connection.recv(timeout=0)

    assert seconds_of_pauses == [0.001] * 10


# Commands


COMMANDS = ["view", "radio --id 0 --robots 3", "node --id 3", "swarm --robots 2 --steps 10"]


@pytest.mark.parametrize("command_line", COMMANDS)
def test_a_command_reports_in_json_that_its_bus_is_gone(
    command_line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its bus is a serial adapter that sends damaged lines and closes; the exit code for that is 1."""
    with adapter_that_sends(DAMAGED_LINES, stays_open=False) as adapter:
        assert main([*command_line.split(), "--json", *options_of_bus(adapter, command_line)]) == 1
    failure = json.loads(capsys.readouterr().err)

    command, *_options = command_line.split()
    assert failure["command"] == f"mcp-asdf {command}"
    assert failure["exit_code"] == 1
    assert "serial device" in failure["error"]


def test_the_verdict_on_a_controller_says_that_the_bus_is_gone(capsys: pytest.CaptureFixture[str]) -> None:
    """``radio --verify`` checks a controller at a bus, here a serial adapter that closes the connection."""
    command_line = "radio --id 0 --robots 3 --verify --json"
    with adapter_that_sends(DAMAGED_LINES, stays_open=False) as adapter:
        assert main([*command_line.split(), *options_of_bus(adapter, command_line)]) == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]

    assert "serial device" in verdict["disturbance"]


@pytest.mark.parametrize("command_line", COMMANDS)
def test_a_bus_that_is_gone_ends_a_command_within_a_second(
    command_line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command waits for the bus at most ten times, and the longest wait takes a tenth of a second."""
    connection = failing_connection(OSError(errno.ENODEV, "No such device"))
    receive_or_wait = Mock(wraps=connection.recv)
    monkeypatch.setattr(connection, "recv", receive_or_wait)
    monkeypatch.setattr(BusChoice, "open", Mock(return_value=connection))
    unplugged_adapter = BusChoice("slcan", {"channel": "/dev/ttyACM0"})

    assert main([*command_line.split(), *options_of_bus(unplugged_adapter, command_line)]) == 1
    assert receive_or_wait.call_count <= 10


def options_of_bus(bus_choice: BusChoice, command_line: str) -> list[str]:
    """Return the options with which a command joins the bus."""
    if command_line.startswith("swarm"):
        return ["--channel", "v{robot}", "--device", f"0=slcan:{bus_choice.channel}"]
    return ["-i", "slcan", "-c", str(bus_choice.channel), "--bus-kwargs", "sleep_after_open=0"]


def radio_run_on(bus: can.BusABC, ticks: int) -> RadioRun:
    """Return a run of ticks of 1 ms with emulated robots as neighbours of a controller on a bus."""
    settings = settings_with_four_neighbours(steps_per_second=1000)
    return RadioRun(settings, BusLink(bus, tolerates_failures=True), ticks)


def test_neighbours_in_real_time_end_before_their_first_tick_when_the_bus_is_gone() -> None:
    """The adapter of the bus has been unplugged. The outcome of the run has the error as its ending."""
    unplugged_bus = failing_connection(OSError(errno.ENODEV, "No such device"))
    run = radio_run_on(unplugged_bus, ticks=20)
    run.run()

    assert run.outcome.has_failed
    assert run.outcome.ending == "the bus failed: [Errno 19] No such device"
    assert run.neighbours.ticks == 0


def test_neighbours_in_real_time_take_all_ticks_on_a_bus_that_fails_and_may_come_back() -> None:
    """The bus takes no frame in any of the 20 ticks. The outcome of the run has the failure as its ending."""
    bus: Any = Mock()
    bus.recv.return_value = None
    bus.send.side_effect = can.CanOperationError("bus-off")
    run = radio_run_on(bus, ticks=20)
    run.run()

    assert run.outcome.ending == "the bus failed: bus-off"
    assert run.neighbours.ticks == 20


def test_an_error_of_the_driver_keeps_the_cause_that_the_driver_gave_it() -> None:
    """A traceback shows both: what could not be done, and why."""
    cause = RuntimeError("bus-off")
    error_of_driver = can.CanOperationError("could not read")
    error_of_driver.__cause__ = cause
    connection = failing_connection(error_of_driver)
    with pytest.raises(can.CanOperationError) as raised:
        connection.recv(timeout=0)
    assert raised.value is error_of_driver
    assert raised.value.__cause__ is cause
