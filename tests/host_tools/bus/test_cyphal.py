"""The frames as OpenCyphal sees them: pycyphal reads ours by our DSDL, and we read what it sends."""

from __future__ import annotations

import asyncio
import importlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_to_word, word_to_alpha
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    MAX_B_HAT,
    Action,
    Command,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    Telemetry,
    float_of,
)
from messages import DEFAULT, encoded, estimates, messages
from support import PATIENCE, ROOT, draws

pytestmark = pytest.mark.random

pycyphal = pytest.importorskip("pycyphal", reason="pycyphal is not installed (pip install pycyphal)")
transport = importlib.import_module("pycyphal.transport")
media = importlib.import_module("pycyphal.transport.can.media")
pythoncan = importlib.import_module("pycyphal.transport.can.media.pythoncan")
cyphal_can = importlib.import_module("pycyphal.transport.can")

LARGEST_BITS = 0x7F7FFFFF
fixed = settings(derandomize=True, deadline=None, max_examples=draws(200))

# The specification's types, without their comments: pycyphal does not bring them along.
REGULATED = {
    "Health.1.0.dsdl": "uint2 value\n@sealed\n",
    "Mode.1.0.dsdl": "uint3 value\n@sealed\n",
    "7509.Heartbeat.1.0.dsdl": "uint32 uptime\nHealth.1.0 health\nMode.1.0 mode\n"
    "uint8 vendor_specific_status_code\n@extent 12 * 8\n",
}


@dataclass(frozen=True)
class Types:
    """Classes that pycyphal's compiler made from DSDL."""

    estimate: Any
    telemetry: Any
    command: Any
    heartbeat: Any
    health: Any
    mode: Any


@pytest.fixture(scope="module")
def types(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Types]:
    folder = tmp_path_factory.mktemp("dsdl")
    regulated, compiled = folder / "uavcan/node", folder / "compiled"
    regulated.mkdir(parents=True)
    for name, text in REGULATED.items():
        (regulated / name).write_text(text)
    ours = ROOT / "host_tools/mcp_asdf_tools/bus/dsdl/mcp_asdf_messages"
    pycyphal.dsdl.compile_all([ours, regulated.parent], output_directory=compiled)
    before = set(sys.modules)
    sys.path.insert(0, str(compiled))
    try:
        yield load_types()
    finally:
        sys.path.remove(str(compiled))
        for name in set(sys.modules) - before:
            if name.partition(".")[0] in ("mcp_asdf_messages", "uavcan", "nunavut_support"):
                del sys.modules[name]


def load_types() -> Types:
    ours = importlib.import_module("mcp_asdf_messages")
    node = importlib.import_module("uavcan.node")
    return Types(
        ours.Estimate_1_0,
        ours.Telemetry_1_0,
        ours.Command_1_0,
        node.Heartbeat_1_0,
        node.Health_1_0,
        node.Mode_1_0,
    )


@dataclass(frozen=True)
class Seen:
    """A message transfer as pycyphal found it in a frame."""

    subject: int
    sender: int
    priority: int
    transfer_id: int
    payload: bytes


def seen_by_pycyphal(frame: can.Message) -> Seen | None:
    """Transfer that a fresh receiver finds in one frame; None unless it holds a complete message."""
    data = media.DataFrame(media.FrameFormat.EXTENDED, frame.arbitration_id, bytearray(frame.data))
    capture = cyphal_can.CANCapture(transport.Timestamp.now(), data, own=False)
    trace = cyphal_can.CANTransport.make_tracer().update(capture)
    if not isinstance(trace, transport.TransferTrace):
        return None
    metadata = trace.transfer.metadata
    session = metadata.session_specifier
    if not isinstance(session.data_specifier, transport.MessageDataSpecifier):
        return None
    return Seen(
        session.data_specifier.subject_id,
        session.source_node_id,
        metadata.priority.value,
        metadata.transfer_id,
        b"".join(bytes(part) for part in trace.transfer.fragmented_payload),
    )


def dsdl_of(types: Types, message: Any) -> tuple[int, Any, tuple[Any, ...]]:
    """Subject of a message, its DSDL type, and what an object of that has to hold."""
    match message:
        case Message():
            return 3000, types.estimate, (message.x_hat, word_to_alpha(message.alpha))
        case Heartbeat():
            content = (message.uptime, message.health.value, message.mode.value, message.vendor_status)
            return 7509, types.heartbeat, content
        case Telemetry():
            return 3001, types.telemetry, (message.x, message.b_hat, message.updates)
        case _:
            return 3002, types.command, (message.tick, message.target, message.action.value)


def content_of(found: Any) -> tuple[Any, ...]:
    """Members of an object of a DSDL type, in its order."""
    return tuple(getattr(value, "value", value) for value in vars(found).values())


@fixed
@given(messages)
@example(Message(0, 0, 0, 0))
@example(Message(127, 2**23, ALPHA_MAX, 31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255))
@example(Telemetry(127, 2**23, MAX_B_HAT, 255, 31))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_pycyphal_reads_our_frames(types: Types, message: Any) -> None:
    seen, (subject, kind, expected) = seen_by_pycyphal(encoded(message)), dsdl_of(types, message)
    assert seen is not None
    assert (seen.subject, seen.sender, seen.transfer_id) == (subject, message.sender, message.transfer_id)
    assert content_of(pycyphal.dsdl.deserialize(kind, [memoryview(seen.payload)])) == expected


def test_units_and_names_of_the_dsdl_are_ours(types: Types) -> None:
    assert types.command.EVERY_ROBOT == EVERY_ROBOT
    assert {each.name: getattr(types.command, each.name) for each in Action} == {
        each.name: each.value for each in Action
    }
    units = (types.estimate.X_LSB, types.telemetry.X_LSB, types.telemetry.B_HAT_LSB)
    assert units == (2**-23, 2**-23, 2**-24)


@fixed
@given(estimates, st.integers(0, 28 + 64))
def test_a_flipped_bit_is_seen_alike(message: Message, bit: int) -> None:
    """We and pycyphal take the same frames for estimates' transfers, but for the content."""
    frame = frames.encode(message, DEFAULT)
    if bit < 29:
        frame.arbitration_id ^= 1 << bit
    else:
        frame.data[(bit - 29) // 8] ^= 1 << (bit - 29) % 8
    ours, seen = frames.decode(frame, DEFAULT), seen_by_pycyphal(frame)
    is_theirs = seen is not None and seen.subject == 3000 and seen.sender is not None
    assert is_theirs == (isinstance(ours, Message) or ours in (Rejection.X_HAT, Rejection.ALPHA))
    if isinstance(ours, Message):
        assert seen is not None
        assert (seen.sender, seen.transfer_id) == (ours.sender, ours.transfer_id)


async def sent_by_pycyphal(channel: str, subject: int, contents: Sequence[Any]) -> list[can.Message]:
    """The frames that pycyphal's node 42 puts on the bus for the contents, transfer ids from 0."""
    node = cyphal_can.CANTransport(pythoncan.PythonCANMedia(f"virtual:{channel}", 0, 8), 42)
    session = node.get_output_session(
        transport.OutputSessionSpecifier(transport.MessageDataSpecifier(subject), None),
        transport.PayloadMetadata(7),
    )
    with can.Bus(interface="virtual", channel=channel) as bus:
        for count, content in enumerate(contents):
            transfer = transport.Transfer(
                timestamp=transport.Timestamp.now(),
                priority=transport.Priority(4),
                transfer_id=count,
                fragmented_payload=list(pycyphal.dsdl.serialize(content)),
            )
            assert await session.send(transfer, asyncio.get_running_loop().time() + PATIENCE)
        received = [bus.recv(PATIENCE) for _ in contents]
        node.close()
    assert None not in received
    return [frame for frame in received if frame is not None]


def test_we_read_the_estimates_that_pycyphal_sends(types: Types) -> None:
    """Alpha may be any binary32 number, which need not be on the firmware's grid, and may be beyond it."""
    grid = [(0, 0.0), (2**23, word_to_alpha(ALPHA_MAX)), (1, 2.0**-24), (2**22, 1.0)]
    others = [(3, float_of(0x7F7FFFFF)), (4, float_of(1)), (5, 3 * 2.0**-25)]
    values = (grid + others) * 6  # transfer ids wrap
    contents = [types.estimate(x, alpha) for x, alpha in values]
    received = asyncio.run(sent_by_pycyphal("estimates", 3000, contents))
    for count, (frame, (x_hat, alpha)) in enumerate(zip(received, values, strict=True)):
        message = Message(42, x_hat, alpha_to_word(alpha), count % 32)
        assert frames.decode(frame, DEFAULT) == message
        assert frame.arbitration_id == frames.encode(message, DEFAULT).arbitration_id


def test_we_read_the_other_kinds_that_pycyphal_sends(types: Types) -> None:
    beat = types.heartbeat(123456, types.health(2), types.mode(1), 77)
    (frame,) = asyncio.run(sent_by_pycyphal("beats", 7509, [beat]))
    assert frames.decode_heartbeat(frame) == Heartbeat(42, 123456, 0, Health.CAUTION, Mode.INITIALIZATION, 77)
    (frame,) = asyncio.run(sent_by_pycyphal("telemetry", 3001, [types.telemetry(5, 2**23, 9)]))
    assert frames.decode_telemetry(frame) == Telemetry(42, 5, 2**23, 9, 0)
    (frame,) = asyncio.run(sent_by_pycyphal("commands", 3002, [types.command(7, 255, types.command.SETTLE)]))
    assert frames.decode_command(frame) == Command(42, 7, EVERY_ROBOT, Action.SETTLE, 0)
