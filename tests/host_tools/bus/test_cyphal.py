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

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_to_word, alpha_units, alpha_word, word_to_alpha
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.frames import (
    COMMANDS,
    EVERY_ROBOT,
    HEARTBEAT_SUBJECT,
    MAX_B_HAT,
    MIN_B_HAT,
    TELEMETRY,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    Telemetry,
    float_of,
)
from support import PATIENCE, ROOT, draws

pytestmark = pytest.mark.random

pycyphal = pytest.importorskip("pycyphal", reason="pycyphal is not installed (pip install pycyphal)")
transport = importlib.import_module("pycyphal.transport")
media = importlib.import_module("pycyphal.transport.can.media")
pythoncan = importlib.import_module("pycyphal.transport.can.media.pythoncan")
cyphal_can = importlib.import_module("pycyphal.transport.can")

DEFAULT = FrameFormat()
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


nodes, transfers, words = st.integers(0, 127), st.integers(0, 31), st.integers(0, 2**32 - 1)
bytes_, ratios, priorities = st.integers(0, 255), st.integers(0, 2**23), st.integers(0, 7)
formats = st.builds(FrameFormat, subject=st.integers(0, 6143), priority=priorities)
alphas = words.map(lambda word: alpha_word(alpha_units(word)))
"""Words with the smallest shift, as decoding gives them."""
messages = st.builds(Message, nodes, ratios, alphas, transfers)
heartbeats = st.builds(
    Heartbeat, nodes, words, transfers, st.sampled_from(Health), st.sampled_from(Mode), bytes_
)
telemetries = st.builds(Telemetry, nodes, ratios, st.integers(MIN_B_HAT, MAX_B_HAT), bytes_, transfers)
targets = st.one_of(nodes, st.just(EVERY_ROBOT))
commands = st.builds(Command, nodes, words, targets, st.sampled_from(Action), transfers)


def contained(frame: can.Message, where: FrameFormat, message: Any, kind: Any) -> Any:
    """The frame's content as an object of the DSDL type ``kind``; its envelope is checked."""
    seen = seen_by_pycyphal(frame)
    assert seen is not None
    envelope = (seen.subject, seen.priority, seen.sender, seen.transfer_id)
    assert envelope == (where.subject, where.priority, message.sender, message.transfer_id)
    return pycyphal.dsdl.deserialize(kind, [memoryview(seen.payload)])


@fixed
@given(messages, formats)
@example(Message(0, 0, 0, 0), FrameFormat(0, 0))
@example(Message(127, 2**23, ALPHA_MAX, 31), FrameFormat(6143, 7))
def test_estimates(types: Types, message: Message, where: FrameFormat) -> None:
    content = contained(frames.encode(message, where), where, message, types.estimate)
    assert (content.x_q23, content.alpha) == (message.x_hat, word_to_alpha(message.alpha))
    assert content.x_q23 * types.estimate.X_LSB == message.x_hat / 2**23


@fixed
@given(heartbeats, priorities)
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255), 7)
def test_heartbeats(types: Types, heartbeat: Heartbeat, priority: int) -> None:
    seen = seen_by_pycyphal(frames.encode_heartbeat(heartbeat, priority))
    assert seen is not None
    assert (seen.subject, seen.priority, seen.sender) == (HEARTBEAT_SUBJECT, priority, heartbeat.sender)
    assert seen.transfer_id == heartbeat.transfer_id
    content = pycyphal.dsdl.deserialize(types.heartbeat, [memoryview(seen.payload)])
    assert (content.uptime, content.vendor_specific_status_code) == (
        heartbeat.uptime,
        heartbeat.vendor_status,
    )
    assert (content.health.value, content.mode.value) == (heartbeat.health.value, heartbeat.mode.value)


@fixed
@given(telemetries, formats)
@example(Telemetry(127, 2**23, MAX_B_HAT, 255, 31), TELEMETRY)
def test_telemetry(types: Types, telemetry: Telemetry, where: FrameFormat) -> None:
    content = contained(frames.encode_telemetry(telemetry, where), where, telemetry, types.telemetry)
    found = (content.x_q23, content.b_hat_q24, content.updates)
    assert found == (telemetry.x, telemetry.b_hat, telemetry.updates)
    assert content.b_hat_q24 * types.telemetry.B_HAT_LSB == telemetry.b_hat / 2**24


@fixed
@given(commands, formats)
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31), COMMANDS)
def test_commands(types: Types, command: Command, where: FrameFormat) -> None:
    content = contained(frames.encode_command(command, where), where, command, types.command)
    found = (content.tick, content.target, content.action)
    assert found == (command.tick, command.target, command.action.value)


def test_the_constants_of_the_dsdl_are_ours(types: Types) -> None:
    assert types.command.EVERY_ROBOT == EVERY_ROBOT
    assert {action.name: getattr(types.command, action.name) for action in Action} == {
        action.name: action.value for action in Action
    }
    assert (types.estimate.X_LSB, types.telemetry.X_LSB, types.telemetry.B_HAT_LSB) == (
        2**-23,
        2**-23,
        2**-24,
    )


CONTENT = {Rejection.X_HAT, Rejection.ALPHA}
"""Conditions that Cyphal does not check."""


@fixed
@given(messages, st.integers(0, 28 + 64))
def test_a_flipped_bit_is_seen_alike(message: Message, bit: int) -> None:
    """We and pycyphal take the same frames for estimates' transfers, but for the content."""
    frame = frames.encode(message, DEFAULT)
    if bit < 29:
        frame.arbitration_id ^= 1 << bit
    else:
        frame.data[(bit - 29) // 8] ^= 1 << (bit - 29) % 8
    ours, seen = frames.decode(frame, DEFAULT), seen_by_pycyphal(frame)
    is_theirs = seen is not None and seen.subject == 3000 and seen.sender is not None
    assert is_theirs == (isinstance(ours, Message) or ours in CONTENT)
    if isinstance(ours, Message):
        assert seen is not None
        assert (seen.sender, seen.transfer_id) == (ours.sender, ours.transfer_id)


class Cyphal:
    """A pycyphal node on python-can's bus of the same process."""

    def __init__(self, channel: str, node: int) -> None:
        self._transport = cyphal_can.CANTransport(pythoncan.PythonCANMedia(f"virtual:{channel}", 0, 8), node)

    async def send(self, subject: int, priority: int, transfer_id: int, content: Any) -> None:
        session = self._transport.get_output_session(
            transport.OutputSessionSpecifier(transport.MessageDataSpecifier(subject), None),
            transport.PayloadMetadata(7),
        )
        transfer = transport.Transfer(
            timestamp=transport.Timestamp.now(),
            priority=transport.Priority(priority),
            transfer_id=transfer_id,
            fragmented_payload=list(pycyphal.dsdl.serialize(content)),
        )
        assert await session.send(transfer, asyncio.get_running_loop().time() + PATIENCE)

    def listen(self, subject: int) -> Any:
        """A session that keeps what arrives from now on."""
        specifier = transport.InputSessionSpecifier(transport.MessageDataSpecifier(subject), None)
        return self._transport.get_input_session(specifier, transport.PayloadMetadata(7))

    def close(self) -> None:
        self._transport.close()


async def exchanged(channel: str, subject: int, priority: int, contents: Sequence[Any]) -> list[can.Message]:
    """The frames that pycyphal's node 42 puts on the bus for the contents, transfer ids from 0."""
    cyphal = Cyphal(channel, 42)
    with can.Bus(interface="virtual", channel=channel) as bus:
        for count, content in enumerate(contents):
            await cyphal.send(subject, priority, count, content)
        received = [bus.recv(PATIENCE) for _ in contents]
        cyphal.close()
    assert None not in received
    return [frame for frame in received if frame is not None]


def test_we_read_the_estimates_that_pycyphal_sends(types: Types) -> None:
    """Of alpha any binary32 number, which need not be on the firmware's grid, and may be beyond it."""
    grid = [(0, 0.0), (2**23, word_to_alpha(ALPHA_MAX)), (1, 2.0**-24), (2**22, 1.0)]
    others = [(3, float_of(LARGEST_BITS)), (4, float_of(1)), (5, 3 * 2.0**-25)]
    values = (grid + others) * 6  # transfer ids wrap
    contents = [types.estimate(x, alpha) for x, alpha in values]
    received = asyncio.run(exchanged("estimates", 3000, 4, contents))
    for count, (frame, (x_hat, alpha)) in enumerate(zip(received, values, strict=True)):
        message = Message(42, x_hat, alpha_to_word(alpha), count % 32)
        assert frames.decode(frame, DEFAULT) == message
        ours = frames.encode(message, DEFAULT)
        assert frame.arbitration_id == ours.arbitration_id
        assert (frame.data == ours.data) == ((x_hat, alpha) in grid)


def test_we_refuse_what_the_type_alone_does_not(types: Types) -> None:
    contents = [types.estimate(2**23 + 1, 1.0), types.estimate(0, -1.0), types.estimate(0, float("nan"))]
    received = asyncio.run(exchanged("refused", 3000, 4, contents))
    reasons = [frames.decode(frame, DEFAULT) for frame in received]
    assert reasons == [Rejection.X_HAT, Rejection.ALPHA, Rejection.ALPHA]


def test_we_read_the_other_kinds_that_pycyphal_sends(types: Types) -> None:
    beat = types.heartbeat(123456, types.health(2), types.mode(1), 77)
    (frame,) = asyncio.run(exchanged("beats", HEARTBEAT_SUBJECT, 4, [beat]))
    assert frames.decode_heartbeat(frame) == Heartbeat(42, 123456, 0, Health.CAUTION, Mode.INITIALIZATION, 77)
    (frame,) = asyncio.run(exchanged("telemetry", 3001, 6, [types.telemetry(5, 2**23, 9)]))
    assert frames.decode_telemetry(frame) == Telemetry(42, 5, 2**23, 9, 0)
    order = types.command(7, 255, types.command.SETTLE)
    (frame,) = asyncio.run(exchanged("commands", 3002, 3, [order]))
    assert frames.decode_command(frame) == Command(42, 7, EVERY_ROBOT, Action.SETTLE, 0)


async def heard(channel: str, subject: int, sent: Sequence[can.Message]) -> list[Any]:
    """The transfers that pycyphal's node receives when the frames are sent."""
    cyphal = Cyphal(channel, 100)
    session = cyphal.listen(subject)
    with can.Bus(interface="virtual", channel=channel) as bus:
        for frame in sent:
            bus.send(frame, timeout=PATIENCE)
        deadline = asyncio.get_running_loop().time() + PATIENCE
        transfers = [await session.receive(deadline) for _ in sent]
        cyphal.close()
    return transfers


def test_pycyphal_hears_a_swarm_of_robots(types: Types) -> None:
    sent = [Message(node, 1000 * node + turn, turn << 8, turn) for turn in range(32) for node in (0, 1, 125)]
    transfers = asyncio.run(heard("swarm", 3000, [frames.encode(message, DEFAULT) for message in sent]))
    for transfer, message in zip(transfers, sent, strict=True):
        content = pycyphal.dsdl.deserialize(types.estimate, transfer.fragmented_payload)
        found = (transfer.source_node_id, content.x_q23, content.alpha, transfer.transfer_id)
        assert found == (message.sender, message.x_hat, word_to_alpha(message.alpha), message.transfer_id)


def test_pycyphal_hears_heartbeats(types: Types) -> None:
    sent = [Heartbeat(9, uptime, uptime % 32) for uptime in range(40)]
    transfers = asyncio.run(heard("alive", HEARTBEAT_SUBJECT, [frames.encode_heartbeat(b) for b in sent]))
    contents = [pycyphal.dsdl.deserialize(types.heartbeat, t.fragmented_payload) for t in transfers]
    assert [content.uptime for content in contents] == list(range(40))
    assert {(content.health.value, content.mode.value) for content in contents} == {(0, 0)}
    assert {transfer.source_node_id for transfer in transfers} == {9}
