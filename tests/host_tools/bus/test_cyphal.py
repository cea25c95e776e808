"""The frames as OpenCyphal sees them: pycyphal reads ours by our DSDL, and sends the same ones."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, MAX_B_HAT, Action, Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Command, Estimate, Heartbeat, Telemetry
from messages import (
    DEFAULT_FORMAT,
    KINDS,
    encoded,
    estimates,
    identifier_and_data,
    messages,
    write_regulated_types,
)
from robots import ALPHA_ONE
from support import PATIENCE, ROOT, draws

pytestmark = [
    pytest.mark.random,
    # Nunavut, the compiler of DSDL, takes the time by a function that is deprecated from Python 3.12 on.
    pytest.mark.filterwarnings(r"ignore:datetime.datetime.utcnow\(\):DeprecationWarning:nunavut\.jinja"),
]

pycyphal = pytest.importorskip("pycyphal", reason="pycyphal is not installed (pip install pycyphal)")
transport = importlib.import_module("pycyphal.transport")
media = importlib.import_module("pycyphal.transport.can.media")
pythoncan = importlib.import_module("pycyphal.transport.can.media.pythoncan")
cyphal_can = importlib.import_module("pycyphal.transport.can")

fixed_examples = settings(derandomize=True, deadline=None, max_examples=draws(200))


@pytest.fixture(autouse=True, scope="module")
def pycyphal_closes_a_bus_at_once() -> Iterator[None]:
    """Shorten the steps of 0.1 s in which pycyphal waits for frames, also when its node closes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pythoncan.PythonCANMedia, "_MAXIMAL_TIMEOUT_SEC", 0.005)
        yield


@pytest.fixture(scope="module")
def dsdl_types(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[type, Any]]:
    """Yield the classes that pycyphal's compiler makes from DSDL, by our class for the same message."""
    sources, compiled = tmp_path_factory.mktemp("dsdl"), tmp_path_factory.mktemp("compiled")
    write_regulated_types(sources, "7509.Heartbeat.1.0.dsdl", "Health.1.0.dsdl", "Mode.1.0.dsdl")
    our_sources = ROOT / "host_tools/mcp_asdf_tools/bus/dsdl/mcp_asdf_messages"
    pycyphal.dsdl.compile_all([our_sources, sources / "uavcan"], output_directory=compiled)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(compiled)
        our_types = importlib.import_module("mcp_asdf_messages")
        node_types = importlib.import_module("uavcan.node")
        yield {
            Estimate: our_types.Estimate_1_0,
            Telemetry: our_types.Telemetry_1_0,
            Command: our_types.Command_1_0,
            Heartbeat: node_types.Heartbeat_1_0,
            Health: node_types.Health_1_0,
            Mode: node_types.Mode_1_0,
        }


# --- pycyphal reads our frames ---------------------------------------------------------------------------


@dataclass
class ReceivedTransfer:
    """A transfer of a message as pycyphal reads it.

    Attributes:
        subject: Subject of the message.
        sender: Node that sent it; None if it is anonymous.
        transfer_id: Number of the sender's transfer modulo 32.
        payload: Its bytes without the tail byte.
    """

    subject: int
    sender: int | None
    transfer_id: int
    payload: Any


def read_with_pycyphal(frame: can.Message) -> ReceivedTransfer | None:
    """Return the transfer that one frame is for a receiver of pycyphal that has received no other.

    Returns None if the frame is no transfer, is incomplete, or is of a service instead of a message.
    """
    data = media.DataFrame(media.FrameFormat.EXTENDED, frame.arbitration_id, bytearray(frame.data))
    capture = cyphal_can.CANCapture(transport.Timestamp.now(), data, own=False)
    trace = cyphal_can.CANTransport.make_tracer().update(capture)
    if not isinstance(trace, transport.TransferTrace):
        return None
    session = trace.transfer.metadata.session_specifier
    if not isinstance(session.data_specifier, transport.MessageDataSpecifier):
        return None
    return ReceivedTransfer(
        session.data_specifier.subject_id,
        session.source_node_id,
        trace.transfer.metadata.transfer_id,
        trace.transfer.fragmented_payload,
    )


def values_in_order_of_dsdl(message: Any) -> list[Any]:
    """Return the fields of our message in the order and form of its DSDL type, enumerated ones as numbers.

    Sender and transfer id are not among them, as they belong to the transfer.
    """
    if isinstance(message, Estimate):
        return [message.x_hat, alpha_from_word(message.alpha)]
    if isinstance(message, Heartbeat):
        return [message.uptime, message.health.value, message.mode.value, message.vendor_status]
    if isinstance(message, Telemetry):
        return [message.x, message.b_hat, message.updates]
    assert isinstance(message, Command)
    return [message.tick, message.target, message.action.value]


def values_of_dsdl_object(dsdl_object: Any) -> list[Any]:
    """Return the fields of an object that pycyphal has read, enumerated ones as numbers."""
    return [getattr(value, "value", value) for value in vars(dsdl_object).values()]


@fixed_examples
@given(messages)
@example(Estimate(sender=0, x_hat=0, alpha=0, transfer_id=0))
@example(Estimate(sender=127, x_hat=2**23, alpha=ALPHA_MAX, transfer_id=31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, vendor_status=255))
@example(Telemetry(sender=127, x=2**23, b_hat=MAX_B_HAT, updates=255, transfer_id=31))
@example(Command(127, tick=2**32 - 1, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=31))
def test_pycyphal_reads_our_frames(dsdl_types: dict[type, Any], message: Any) -> None:
    """It finds the subject, the sender, the transfer id and all contents of any message, by our DSDL files.

    The subject is the kind of a message, and DSDL is Cyphal's language for the layout of its contents.
    """
    transfer = read_with_pycyphal(encoded(message))
    assert transfer is not None
    subject_of_kind = KINDS[type(message)].subject  # such as 3000 for estimates
    assert transfer.subject == subject_of_kind
    assert transfer.sender == message.sender
    assert transfer.transfer_id == message.transfer_id
    dsdl_object = pycyphal.dsdl.deserialize(dsdl_types[type(message)], transfer.payload)
    assert values_of_dsdl_object(dsdl_object) == values_in_order_of_dsdl(message)


@pytest.mark.parametrize("action", Action)
def test_an_action_has_the_same_number_in_our_dsdl_file(dsdl_types: dict[type, Any], action: Action) -> None:
    """The file describes a command to other programs of Cyphal, and a command asks for an action."""
    number_in_dsdl = getattr(dsdl_types[Command], action.name)
    assert number_in_dsdl == action.value


def test_our_dsdl_files_state_the_target_of_commands_to_every_robot_and_the_units_of_our_frames(
    dsdl_types: dict[type, Any],
) -> None:
    """Frames hold ratios as integers; a constant of each file is the value of the lowest bit (LSB)."""
    assert dsdl_types[Command].EVERY_ROBOT == EVERY_ROBOT
    assert dsdl_types[Estimate].X_LSB == 2**-23
    assert dsdl_types[Telemetry].X_LSB == 2**-23
    assert dsdl_types[Telemetry].B_HAT_LSB == 2**-24


def flip_bit(frame: can.Message, bit: int) -> None:
    """Flip a bit of a frame: bits 0 to 28 are the identifier, the next 64 the data."""
    if bit < 29:
        frame.arbitration_id ^= 1 << bit
    else:
        byte_index, bit_of_byte = divmod(bit - 29, 8)
        frame.data[byte_index] ^= 1 << bit_of_byte


@fixed_examples
@given(estimates, st.integers(0, 29 + 64 - 1))
def test_pycyphal_takes_a_frame_with_a_flipped_bit_for_an_estimate_exactly_if_we_do(
    message: Estimate, bit: int
) -> None:
    """A frame that we reject for its content counts as an estimate, as pycyphal does not look at the content.

    The default subject of estimates is 3000; anonymous nodes, which have no id, send none.
    """
    frame = frames.encode_estimate(message, DEFAULT_FORMAT)
    flip_bit(frame, bit)

    decoded = frames.decode_estimate(frame, DEFAULT_FORMAT)
    is_rejected_for_its_content = decoded in (Rejection.X_HAT, Rejection.ALPHA)
    is_estimate_for_us = isinstance(decoded, Estimate) or is_rejected_for_its_content
    transfer = read_with_pycyphal(frame)
    is_estimate_for_pycyphal = (
        transfer is not None and transfer.subject == 3000 and transfer.sender is not None
    )
    assert is_estimate_for_pycyphal == is_estimate_for_us


# --- pycyphal sends our frames ---------------------------------------------------------------------------


def first_transfer_of(dsdl_object: Any) -> Any:
    """Return a transfer of pycyphal with an object, the priority 4 and the transfer id 0."""
    return transport.Transfer(
        timestamp=transport.Timestamp.now(),
        priority=transport.Priority(4),
        transfer_id=0,
        fragmented_payload=list(pycyphal.dsdl.serialize(dsdl_object)),
    )


async def frame_sent_by_pycyphal(subject: int, dsdl_object: Any) -> can.Message:
    """Return the frame that pycyphal's node 42 sends for an object, with the transfer id 0."""
    channel = f"pycyphal {subject}"
    node = cyphal_can.CANTransport(pythoncan.PythonCANMedia(f"virtual:{channel}", 0, 8), 42)
    session = node.get_output_session(
        transport.OutputSessionSpecifier(transport.MessageDataSpecifier(subject), None),
        transport.PayloadMetadata(7),
    )
    with can.Bus(interface="virtual", channel=channel) as bus:
        deadline = asyncio.get_running_loop().time() + PATIENCE
        assert await session.send(first_transfer_of(dsdl_object), deadline)
        frame = bus.recv(timeout=PATIENCE)
        node.close()
    assert frame is not None
    return frame


def test_pycyphal_sends_the_same_frame_for_an_estimate(dsdl_types: dict[type, Any]) -> None:
    """Its node 42 sends a pair of x_hat and alpha by our DSDL file. The identifier is the same, too."""
    half_and_one = dsdl_types[Estimate](2**22, 1.0)
    frame = asyncio.run(frame_sent_by_pycyphal(subject=3000, dsdl_object=half_and_one))

    our_frame = encoded(Estimate(sender=42, x_hat=2**22, alpha=ALPHA_ONE, transfer_id=0))
    assert identifier_and_data(frame) == identifier_and_data(our_frame)


def test_pycyphal_sends_the_same_frame_for_a_heartbeat(dsdl_types: dict[type, Any]) -> None:
    """Health 2 and mode 1, which Cyphal calls CAUTION and INITIALIZATION, are our values of these names."""
    health, mode = dsdl_types[Health](value=2), dsdl_types[Mode](value=1)
    heartbeat = dsdl_types[Heartbeat](uptime=12345, health=health, mode=mode, vendor_specific_status_code=77)
    frame = asyncio.run(frame_sent_by_pycyphal(subject=7509, dsdl_object=heartbeat))

    our_heartbeat = Heartbeat(
        sender=42,
        uptime=12345,
        transfer_id=0,
        health=Health.CAUTION,
        mode=Mode.INITIALIZATION,
        vendor_status=77,
    )
    assert identifier_and_data(frame) == identifier_and_data(encoded(our_heartbeat))
