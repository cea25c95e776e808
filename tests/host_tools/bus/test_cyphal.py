"""The frames as OpenCyphal sees them: pycyphal reads ours by our DSDL, and we read what it sends."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word, alpha_word_from_float
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, MAX_B_HAT, Action, Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import Command, Estimate, Heartbeat, Telemetry
from messages import DEFAULT, KINDS, encoded, estimates, messages, write_regulated_types
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

fixed = settings(derandomize=True, deadline=None, max_examples=draws(200))


@pytest.fixture(scope="module")
def types(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[type, Any]]:
    """Classes that pycyphal's compiler made from DSDL, by our kinds of messages."""
    folder, compiled = tmp_path_factory.mktemp("dsdl"), tmp_path_factory.mktemp("compiled")
    write_regulated_types(folder, "7509.Heartbeat.1.0.dsdl", "Health.1.0.dsdl", "Mode.1.0.dsdl")
    ours = ROOT / "host_tools/mcp_asdf_tools/bus/dsdl/mcp_asdf_messages"
    pycyphal.dsdl.compile_all([ours, folder / "uavcan"], output_directory=compiled)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(compiled)
        made, node = importlib.import_module("mcp_asdf_messages"), importlib.import_module("uavcan.node")
        yield {
            Estimate: made.Estimate_1_0,
            Telemetry: made.Telemetry_1_0,
            Command: made.Command_1_0,
            Heartbeat: node.Heartbeat_1_0,
            Health: node.Health_1_0,
            Mode: node.Mode_1_0,
        }


def seen_by_pycyphal(frame: can.Message) -> Any:
    """Message transfer that a fresh receiver finds in one frame; None unless it is complete."""
    data = media.DataFrame(media.FrameFormat.EXTENDED, frame.arbitration_id, bytearray(frame.data))
    capture = cyphal_can.CANCapture(transport.Timestamp.now(), data, own=False)
    trace = cyphal_can.CANTransport.make_tracer().update(capture)
    is_transfer = isinstance(trace, transport.TransferTrace)
    is_message = is_transfer and isinstance(session_of(trace.transfer)[0], transport.MessageDataSpecifier)
    return trace.transfer if is_message else None


def session_of(transfer: Any) -> tuple[Any, int | None, int]:
    """Data specifier, sender and transfer id."""
    session = transfer.metadata.session_specifier
    return session.data_specifier, session.source_node_id, transfer.metadata.transfer_id


def members(message: Any) -> tuple[Any, ...]:
    """What an object of the message's DSDL type holds, in its order."""
    names = [item.name for item in fields(message) if item.name not in ("sender", "transfer_id")]
    first, *rest = (plain(getattr(message, name)) for name in names)
    return (first, alpha_from_word(*rest)) if isinstance(message, Estimate) else (first, *rest)


def plain(value: Any) -> Any:
    return getattr(value, "value", value)


@fixed
@given(messages)
@example(Estimate(0, 0, 0, 0))
@example(Estimate(127, 2**23, ALPHA_MAX, 31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255))
@example(Telemetry(127, 2**23, MAX_B_HAT, 255, 31))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_pycyphal_reads_our_frames(types: dict[type, Any], message: Any) -> None:
    seen = seen_by_pycyphal(encoded(message))
    subject = transport.MessageDataSpecifier(KINDS[type(message)].subject)
    assert session_of(seen) == (subject, message.sender, message.transfer_id)
    found = pycyphal.dsdl.deserialize(types[type(message)], seen.fragmented_payload)
    assert tuple(map(plain, vars(found).values())) == members(message)


def test_units_and_names_of_the_dsdl_are_ours(types: dict[type, Any]) -> None:
    command, estimate, telemetry = types[Command], types[Estimate], types[Telemetry]
    assert command.EVERY_ROBOT == EVERY_ROBOT
    assert all(getattr(command, each.name) == each.value for each in Action)
    assert (estimate.X_LSB, telemetry.X_LSB, telemetry.B_HAT_LSB) == (2**-23, 2**-23, 2**-24)


@fixed
@given(estimates, st.integers(0, 28 + 64))
def test_a_flipped_bit_is_seen_alike(message: Estimate, bit: int) -> None:
    """We and pycyphal take the same frames for estimates' transfers, but for the content."""
    frame = frames.encode_estimate(message, DEFAULT)
    if bit < 29:
        frame.arbitration_id ^= 1 << bit
    else:
        frame.data[(bit - 29) // 8] ^= 1 << (bit - 29) % 8
    ours, seen = frames.decode_estimate(frame, DEFAULT), seen_by_pycyphal(frame)
    subject, sender, transfer_id = (None, None, None) if seen is None else session_of(seen)
    is_theirs = subject == transport.MessageDataSpecifier(3000) and sender is not None
    assert is_theirs == (isinstance(ours, Estimate) or ours in (Rejection.X_HAT, Rejection.ALPHA))
    if isinstance(ours, Estimate):
        assert (sender, transfer_id) == (ours.sender, ours.transfer_id)


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


def test_we_read_what_pycyphal_sends(types: dict[type, Any]) -> None:
    """Alpha may be any binary32 number, which need not be on the firmware's grid, and may be beyond it."""
    alphas = (
        0.0,
        alpha_from_word(ALPHA_MAX),
        2.0**-24,
        1.0,
        float32_value(0x7F7FFFFF),
        float32_value(1),
        3 * 2.0**-25,
    )
    sent = [(2**23 - x, alpha) for x, alpha in enumerate(alphas * 5)]  # transfer ids wrap
    contents = [types[Estimate](*each) for each in sent]
    received = asyncio.run(sent_by_pycyphal("estimates", 3000, contents))
    for count, (frame, (x_hat, alpha)) in enumerate(zip(received, sent, strict=True)):
        message = Estimate(42, x_hat, alpha_word_from_float(alpha), count % 32)
        assert frames.decode_estimate(frame, DEFAULT) == message
        assert frame.arbitration_id == encoded(message).arbitration_id
    beat = Heartbeat(42, 12345, 0, Health.CAUTION, Mode.INITIALIZATION, 77)
    others: list[tuple[Any, tuple[Any, ...]]] = [
        (beat, (12345, types[Health](2), types[Mode](1), 77)),
        (Telemetry(42, 5, 2**23, 9, 0), (5, 2**23, 9)),
        (Command(42, 7, EVERY_ROBOT, Action.SETTLE, 0), (7, 255, 3)),
    ]
    for other, content in others:
        subject, name, _, decode = KINDS[type(other)]
        (frame,) = asyncio.run(sent_by_pycyphal(name, subject, [types[type(other)](*content)]))
        assert decode(frame) == other
