"""The frames as OpenCyphal sees them: pycyphal reads ours by our DSDL, and we read what it sends."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, MAX_B_HAT, Action, Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Command, Estimate, Heartbeat, Telemetry
from messages import DEFAULT, KINDS, encoded, estimates, messages, write_regulated_types
from robots import ALPHA_MIN, ALPHA_ONE
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


def contents_in_dsdl(message: Any) -> list[Any]:
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


def contents_of_dsdl_object(dsdl_object: Any) -> list[Any]:
    """Return the fields of an object that pycyphal has read, enumerated ones as numbers."""
    return [getattr(value, "value", value) for value in vars(dsdl_object).values()]


@fixed_examples
@given(messages)
@example(Estimate(0, 0, 0, 0))
@example(Estimate(127, 2**23, ALPHA_MAX, 31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255))
@example(Telemetry(127, 2**23, MAX_B_HAT, 255, 31))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_pycyphal_reads_our_frames(dsdl_types: dict[type, Any], message: Any) -> None:
    transfer = read_with_pycyphal(encoded(message))
    assert transfer is not None
    assert transfer.subject == KINDS[type(message)].subject
    assert transfer.sender == message.sender
    assert transfer.transfer_id == message.transfer_id
    dsdl_object = pycyphal.dsdl.deserialize(dsdl_types[type(message)], transfer.payload)

    assert contents_of_dsdl_object(dsdl_object) == contents_in_dsdl(message)


def test_actions_of_the_dsdl_are_ours(dsdl_types: dict[type, Any]) -> None:
    command_type = dsdl_types[Command]
    for action in Action:
        assert getattr(command_type, action.name) == action.value


def test_the_dsdl_s_target_for_every_robot_is_ours(dsdl_types: dict[type, Any]) -> None:
    assert dsdl_types[Command].EVERY_ROBOT == EVERY_ROBOT


def test_the_dsdl_states_the_units_of_our_frames(dsdl_types: dict[type, Any]) -> None:
    assert dsdl_types[Estimate].X_LSB == 2**-23
    assert dsdl_types[Telemetry].X_LSB == 2**-23
    assert dsdl_types[Telemetry].B_HAT_LSB == 2**-24


def flip_bit(frame: can.Message, bit: int) -> None:
    """Flip a bit of a frame: 0 to 28 are those of its identifier, the next 64 those of its data."""
    if bit < 29:
        frame.arbitration_id ^= 1 << bit
    else:
        byte_index, bit_of_byte = divmod(bit - 29, 8)
        frame.data[byte_index] ^= 1 << bit_of_byte


@fixed_examples
@given(estimates, st.integers(0, 29 + 64 - 1))
def test_we_and_pycyphal_agree_whether_a_frame_with_a_flipped_bit_is_an_estimate(
    message: Estimate, bit: int
) -> None:
    """Only we look at the content, so a frame that we reject for its content is a transfer for pycyphal."""
    frame = frames.encode_estimate(message, DEFAULT)
    flip_bit(frame, bit)
    decoded = frames.decode_estimate(frame, DEFAULT)
    is_ours = isinstance(decoded, Estimate) or decoded in (Rejection.X_HAT, Rejection.ALPHA)
    transfer = read_with_pycyphal(frame)
    # The default subject of estimates is 3000; anonymous nodes, which have no id, send none.
    is_theirs = transfer is not None and transfer.subject == 3000 and transfer.sender is not None
    assert is_ours == is_theirs
    if isinstance(decoded, Estimate):
        assert transfer is not None
        assert (decoded.sender, decoded.transfer_id) == (transfer.sender, transfer.transfer_id)


# --- We read what pycyphal sends -------------------------------------------------------------------------


async def frames_sent_by_pycyphal(subject: int, dsdl_objects: Sequence[Any]) -> list[can.Message]:
    """Return the frames that pycyphal's node 42 sends for objects, with transfer ids 0, 1, ..."""
    channel = f"pycyphal {subject}"
    node = cyphal_can.CANTransport(pythoncan.PythonCANMedia(f"virtual:{channel}", 0, 8), 42)
    session = node.get_output_session(
        transport.OutputSessionSpecifier(transport.MessageDataSpecifier(subject), None),
        transport.PayloadMetadata(7),
    )
    with can.Bus(interface="virtual", channel=channel) as bus:
        for transfer_id, dsdl_object in enumerate(dsdl_objects):
            transfer = transport.Transfer(
                timestamp=transport.Timestamp.now(),
                priority=transport.Priority(4),
                transfer_id=transfer_id,
                fragmented_payload=list(pycyphal.dsdl.serialize(dsdl_object)),
            )
            deadline = asyncio.get_running_loop().time() + PATIENCE
            assert await session.send(transfer, deadline)
        received_frames = [bus.recv(PATIENCE) for _ in dsdl_objects]
        node.close()
    assert None not in received_frames
    return [frame for frame in received_frames if frame is not None]


def frames_of_estimates(
    dsdl_types: dict[type, Any], contents: Sequence[tuple[int, float]]
) -> list[can.Message]:
    """Return the frames that pycyphal's node 42 sends for estimates with these x_hat and alpha."""
    dsdl_objects = [dsdl_types[Estimate](x_hat, alpha) for x_hat, alpha in contents]
    return asyncio.run(frames_sent_by_pycyphal(3000, dsdl_objects))


def test_we_decode_the_estimates_of_pycyphal(dsdl_types: dict[type, Any]) -> None:
    frames_of_pycyphal = frames_of_estimates(dsdl_types, [(2**23, 0.0), (5, 2.0**-24), (0, 1.0)])
    assert [frames.decode_estimate(frame, DEFAULT) for frame in frames_of_pycyphal] == [
        Estimate(sender=42, x_hat=2**23, alpha=0, transfer_id=0),
        Estimate(sender=42, x_hat=5, alpha=ALPHA_MIN, transfer_id=1),
        Estimate(sender=42, x_hat=0, alpha=ALPHA_ONE, transfer_id=2),
    ]


@pytest.mark.parametrize(
    ("alpha", "alpha_word"),
    [
        (alpha_from_word(ALPHA_MAX), ALPHA_MAX),
        (float32_value(0x7F7FFFFF), ALPHA_MAX),  # the largest binary32 number
        (float32_value(1), 0),  # the smallest one
        (1.5 * 2.0**-24, ALPHA_MIN),
    ],
)
def test_an_alpha_of_pycyphal_that_robots_cannot_have_is_rounded_down(
    dsdl_types: dict[type, Any], alpha: float, alpha_word: int
) -> None:
    """Robots have multiples of 2**-24 up to a largest alpha; pycyphal may send any binary32 number."""
    frame = frames_of_estimates(dsdl_types, [(5, alpha)])[0]
    assert frames.decode_estimate(frame, DEFAULT) == Estimate(42, 5, alpha_word, transfer_id=0)


def test_the_frames_of_pycyphal_have_our_identifiers(dsdl_types: dict[type, Any]) -> None:
    frame = frames_of_estimates(dsdl_types, [(5, 1.0)])[0]
    assert frame.arbitration_id == encoded(Estimate(42, 5, ALPHA_ONE, 0)).arbitration_id


def test_the_transfer_ids_of_pycyphal_wrap_as_ours_do(dsdl_types: dict[type, Any]) -> None:
    transfer_ids = []
    for frame in frames_of_estimates(dsdl_types, [(5, 1.0)] * 35):
        estimate = frames.decode_estimate(frame, DEFAULT)
        assert isinstance(estimate, Estimate)
        transfer_ids.append(estimate.transfer_id)

    assert transfer_ids == [*range(32), 0, 1, 2]


def test_we_decode_the_heartbeat_of_pycyphal(dsdl_types: dict[type, Any]) -> None:
    health, mode = dsdl_types[Health](2), dsdl_types[Mode](1)
    heartbeat = dsdl_types[Heartbeat](12345, health, mode, 77)
    frame = asyncio.run(frames_sent_by_pycyphal(7509, [heartbeat]))[0]

    assert frames.decode_heartbeat(frame) == Heartbeat(
        sender=42,
        uptime=12345,
        transfer_id=0,
        health=Health.CAUTION,
        mode=Mode.INITIALIZATION,
        vendor_status=77,
    )


def test_we_decode_the_telemetry_of_pycyphal(dsdl_types: dict[type, Any]) -> None:
    telemetry = dsdl_types[Telemetry](5, 2**23, 9)
    frame = asyncio.run(frames_sent_by_pycyphal(3001, [telemetry]))[0]
    assert frames.decode_telemetry(frame) == Telemetry(sender=42, x=5, b_hat=2**23, updates=9, transfer_id=0)


def test_we_decode_the_command_of_pycyphal(dsdl_types: dict[type, Any]) -> None:
    command = dsdl_types[Command](7, 255, 3)
    frame = asyncio.run(frames_sent_by_pycyphal(3002, [command]))[0]

    assert frames.decode_command(frame) == Command(
        sender=42, tick=7, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=0
    )
