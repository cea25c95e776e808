"""The DBC file: cantools, which shares no code with ours, reads our frames by it and writes frames for us."""

from __future__ import annotations

import json
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import example, given, settings

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word
from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_text
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Health, Mode, Rejection
from mcp_asdf_tools.bus.frames import (
    Command,
    Estimate,
    FrameFormat,
    Heartbeat,
    Telemetry,
    encode_estimate,
)
from mcp_asdf_tools.cli.main import main
from messages import DEFAULT, KINDS, encoded, messages
from support import draws

pytestmark = pytest.mark.random

cantools = pytest.importorskip("cantools", reason="cantools is not installed (pip install cantools)")

UNITS = {"x_hat": 2.0**-23, "x": 2.0**-23, "b_hat": 2.0**-24}
fixed_examples = settings(derandomize=True, deadline=None, max_examples=draws(300))


def load_database(text: str) -> Any:
    return cantools.database.load_string(text, "dbc", strict=True)


@pytest.fixture(scope="module")
def database() -> Any:
    return load_database(dbc_text(DEFAULT))


def physical_values(message: Any) -> dict[str, float]:
    """Return a message's signals as cantools shows them: in the paper's units, with the tail byte."""
    values = {"start_end_toggle": 7.0}
    for field in fields(message):
        value = getattr(message, field.name)
        if field.name == "sender":
            continue  # it stands in the identifier
        if isinstance(value, Enum):
            value = value.value
        if field.name == "alpha":
            value = alpha_from_word(value)
        values[field.name] = value * UNITS.get(field.name, 1)
    return values


def decode_what_cantools_encodes(
    database: Any, message_type: type, values: dict[str, float], node: int = 0, *, strict: bool = True
) -> Any:
    entry = database.get_message_by_name(message_type.__name__)
    data = entry.encode(values, strict=strict)
    return KINDS[message_type].decode(can.Message(arbitration_id=entry.frame_id | node, data=data))


EXTREME_MESSAGES = (
    Estimate(127, 2**23, ALPHA_MAX, 31),
    Estimate(127, 2**23, 0x100, 31),
    Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255),
    Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31),
)


@fixed_examples
@given(messages)
@example(EXTREME_MESSAGES[0])
@example(EXTREME_MESSAGES[1])
@example(EXTREME_MESSAGES[2])
@example(EXTREME_MESSAGES[3])
def test_cantools_decodes_our_frames(database: Any, message: Any) -> None:
    frame = encoded(message)
    entry = database.get_message_by_frame_id(frame.arbitration_id & ANY_NODE_MASK)
    assert entry.is_extended_frame
    assert entry.decode(frame.data, decode_choices=False) == physical_values(message)


@fixed_examples
@given(messages)
@example(EXTREME_MESSAGES[0])
@example(EXTREME_MESSAGES[1])
@example(EXTREME_MESSAGES[2])
@example(EXTREME_MESSAGES[3])
def test_we_decode_the_frames_of_cantools(database: Any, message: Any) -> None:
    values = physical_values(message)
    assert decode_what_cantools_encodes(database, type(message), values, message.sender) == message


LEGAL_MESSAGES = (
    Estimate(1, 2, 0x300, 4),
    Heartbeat(1, 2, 3),
    Telemetry(1, 2, 16, 3, 4),
    Command(1, 2, 3, Action.SETTLE, 4),
)
for_each_kind = pytest.mark.parametrize("legal", LEGAL_MESSAGES, ids=lambda legal: type(legal).__name__)


@for_each_kind
def test_the_ends_of_every_stated_range_are_legal(database: Any, legal: Any) -> None:
    for signal in database.get_message_by_name(type(legal).__name__).signals:
        for value in (signal.minimum, signal.maximum):
            values = physical_values(legal) | {signal.name: value}
            message = decode_what_cantools_encodes(database, type(legal), values)
            # Alpha may be any finite number, but beyond the firmware's largest it becomes that.
            largest = alpha_from_word(ALPHA_MAX) if signal.name == "alpha" else value
            assert physical_values(message)[signal.name] == min(value, largest)


VALUES_BEYOND_ALPHA = (-0.0, float("inf"))
"""Alpha has no unit to step beyond its range with."""
SIGNALS_WITH_ILLEGAL_VALUES = {
    "Estimate": {"x_hat", "alpha", "start_end_toggle"},
    "Heartbeat": {"mode", "start_end_toggle"},
    "Telemetry": {"x", "b_hat", "start_end_toggle"},
    "Command": {"action", "start_end_toggle"},
}
"""In the others every bit pattern is legal, but for a command's target, whose range has a gap."""


def values_beyond(signal: Any) -> list[float]:
    """Return the values that the signal's bits can hold next to its stated range."""
    if signal.name == "alpha":
        return list(VALUES_BEYOND_ALPHA)
    largest_that_fits = (2**signal.length - 1) * signal.scale
    neighbours = (signal.minimum - signal.scale, signal.maximum + signal.scale)
    return [value for value in neighbours if 0 <= value <= largest_that_fits]


@for_each_kind
def test_a_value_beyond_a_stated_range_is_rejected_by_name(database: Any, legal: Any) -> None:
    name = type(legal).__name__
    rejected_signals = set()
    for signal in database.get_message_by_name(name).signals:
        for value in values_beyond(signal):
            values = physical_values(legal) | {signal.name: value}
            rejection = decode_what_cantools_encodes(database, type(legal), values, strict=False)
            tail = signal.name == "start_end_toggle"
            assert rejection is (Rejection.MULTI_FRAME if tail else Rejection[signal.name.upper()]), value
            rejected_signals.add(signal.name)
    assert rejected_signals == SIGNALS_WITH_ILLEGAL_VALUES[name]


@pytest.mark.parametrize(
    ("message", "signal", "enum"),
    [("Heartbeat", "health", Health), ("Heartbeat", "mode", Mode), ("Command", "action", Action)],
)
def test_enumerated_values_have_their_names(
    database: Any, message: str, signal: str, enum: type[Enum]
) -> None:
    choices = database.get_message_by_name(message).get_signal_by_name(signal).choices
    assert {number: str(name) for number, name in choices.items()} == {
        member.value: member.name for member in enum
    }


# The command mcp-asdf dbc


def test_dbc_prints_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc"]) == 0
    assert capsys.readouterr().out == dbc_text(DEFAULT)


def test_dbc_writes_the_file_and_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "swarm.dbc"
    assert main(["dbc", "--output", str(file)]) == 0
    assert capsys.readouterr().out == f"wrote {file}\n"
    assert file.read_text() == dbc_text(DEFAULT)


def test_dbc_reports_the_file_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "swarm.dbc")
    assert main(["dbc", "--json", "--output", file]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": file, "dbc": dbc_text(DEFAULT)}


def test_dbc_prints_its_text_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": None, "dbc": dbc_text(DEFAULT)}


@pytest.fixture
def database_per_node(capsys: pytest.CaptureFixture[str]) -> Any:
    """The file with entries for three nodes and a format of our own."""
    assert main(["dbc", "--per-node", "0", "7", "127", "--subject=1234", "--priority=1"]) == 0
    return load_database(capsys.readouterr().out)


def test_dbc_per_node_has_four_messages_for_each_node(database_per_node: Any) -> None:
    assert len(database_per_node.messages) == 4 * 3


@pytest.mark.parametrize("node", [0, 7, 127])
def test_dbc_per_node_decodes_a_node_s_estimates_without_a_mask(database_per_node: Any, node: int) -> None:
    estimate = Estimate(node, 5, 0x600, 7)
    frame = encode_estimate(estimate, FrameFormat(1234, 1))
    entry = database_per_node.get_message_by_frame_id(frame.arbitration_id)
    assert (entry.name, entry.senders) == (f"Estimate_{node}", [f"Robot_{node}"])
    assert entry.decode(frame.data, decode_choices=False) == physical_values(estimate)


@pytest.mark.parametrize("node", [0, 7, 127])
def test_dbc_per_node_knows_a_node_s_heartbeat(database_per_node: Any, node: int) -> None:
    identifier = encoded(Heartbeat(node, 1, 2)).arbitration_id
    assert database_per_node.get_message_by_frame_id(identifier).name == f"Heartbeat_{node}"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ("--per-node 128", "sender is 128; it must be 0 to 127"),
        ("--per-node 3 5 5", "node 5 is listed twice"),
        ("--subject 3001", "subject 3001 is that of telemetry or commands"),
        ("--subject 3002", "subject 3002 is that of telemetry or commands"),
    ],
)
def test_dbc_names_the_wrong_argument(arguments: str, error: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", *arguments.split()]) == 2
    assert error in capsys.readouterr().err
