"""The DBC file: cantools, which shares no code with ours, reads our frames by it and writes frames for us."""

from __future__ import annotations

import json
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings

from mcp_asdf.fixed_point import ALPHA_MAX, alpha_from_word
from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_text
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, MAX_B_HAT, MIN_B_HAT, Action, Health, Mode
from mcp_asdf_tools.bus.frames import Command, Estimate, FrameFormat, Heartbeat, Telemetry, encode_estimate
from mcp_asdf_tools.cli.main import main
from messages import DEFAULT_FORMAT, encoded, messages
from support import draws

pytestmark = pytest.mark.random

cantools = pytest.importorskip("cantools", reason="cantools is not installed (pip install cantools)")

UNITS = {"x_hat": 2.0**-23, "x": 2.0**-23, "b_hat": 2.0**-24}
"""Units of the fields that frames carry as integers."""
fixed_examples = settings(derandomize=True, deadline=None, max_examples=draws(300))


def load_database(text: str) -> Any:
    """Return what cantools reads in a DBC file's text; it is strict about overlapping signals."""
    return cantools.database.load_string(text, "dbc", strict=True)


@pytest.fixture(scope="module")
def database() -> Any:
    """The file for the default format, as cantools reads it."""
    return load_database(dbc_text(DEFAULT_FORMAT))


def physical_values(message: Any) -> dict[str, float]:
    """Return a message's signals as cantools shows them: in the paper's units, with the tail byte.

    The sender is no signal: it stands in the identifier.
    """
    values = {"start_end_toggle": 7.0}  # the three bits by which a tail byte marks a transfer of one frame
    for field in fields(message):
        if field.name != "sender":
            values[field.name] = physical_value(field.name, getattr(message, field.name))
    return values


def physical_value(name: str, value: Any) -> float:
    """Return the value of one field in the paper's units; an enumerated one is its number."""
    if isinstance(value, Enum):
        return float(value.value)
    if name == "alpha":
        return alpha_from_word(value)
    return float(value * UNITS.get(name, 1))


# cantools and our codec read each other's frames

LARGEST_ESTIMATE = Estimate(sender=127, x_hat=2**23, alpha=ALPHA_MAX, transfer_id=31)
LEAST_CONFIDENT_ESTIMATE = Estimate(sender=127, x_hat=2**23, alpha=0x100, transfer_id=31)
LARGEST_HEARTBEAT = Heartbeat(
    127, uptime=2**32 - 1, transfer_id=31, health=Health.WARNING, mode=Mode.SOFTWARE_UPDATE, vendor_status=255
)
LARGEST_TELEMETRY = Telemetry(127, x=2**23, b_hat=MAX_B_HAT, updates=255, transfer_id=31)
SMALLEST_TELEMETRY = Telemetry(sender=0, x=0, b_hat=MIN_B_HAT, updates=0, transfer_id=0)
LARGEST_COMMAND = Command(127, tick=2**32 - 1, target=EVERY_ROBOT, action=Action.SETTLE, transfer_id=31)


@fixed_examples
@given(messages)
@example(LARGEST_ESTIMATE)
@example(LEAST_CONFIDENT_ESTIMATE)
@example(LARGEST_HEARTBEAT)
@example(LARGEST_TELEMETRY)
@example(SMALLEST_TELEMETRY)
@example(LARGEST_COMMAND)
def test_cantools_decodes_our_frames_and_encodes_the_same_data(database: Any, message: Any) -> None:
    """With our DBC file, ``database``, cantools finds the values that we have encoded in a frame.

    A DBC file describes frames to other programs. Its entry for a kind of frame serves all nodes, and says
    that identifiers are extended ones, of 29 bits.
    """
    frame = encoded(message)
    identifier_without_node = frame.arbitration_id & ANY_NODE_MASK
    entry = database.get_message_by_frame_id(identifier_without_node)
    decoded_values = entry.decode(frame.data, decode_choices=False)  # numbers, not names of numbers

    assert entry.is_extended_frame
    assert decoded_values == physical_values(message)
    assert entry.encode(decoded_values) == frame.data


# The ranges, and the names of values

MAX_FLOAT32 = 2.0**128 - 2.0**104
"""The largest finite binary32 number."""


def test_the_file_states_the_range_of_every_signal(database: Any) -> None:
    """A signal is a field of a frame, and the DBC file has the smallest and largest value of each.

    The expected ranges are those of the specification, by the names of message and signal.
    """
    expected_ranges = {
        ("Estimate", "x_hat"): (0, 1),
        ("Estimate", "alpha"): (0, MAX_FLOAT32),
        ("Estimate", "transfer_id"): (0, 31),
        ("Estimate", "start_end_toggle"): (7, 7),
        ("Heartbeat", "uptime"): (0, 2**32 - 1),
        ("Heartbeat", "health"): (0, 3),
        ("Heartbeat", "mode"): (0, 3),
        ("Heartbeat", "vendor_status"): (0, 255),
        ("Heartbeat", "transfer_id"): (0, 31),
        ("Heartbeat", "start_end_toggle"): (7, 7),
        ("Telemetry", "x"): (0, 1),
        ("Telemetry", "b_hat"): (2.0**-20, 1 - 2.0**-20),
        ("Telemetry", "updates"): (0, 255),
        ("Telemetry", "transfer_id"): (0, 31),
        ("Telemetry", "start_end_toggle"): (7, 7),
        ("Command", "tick"): (0, 2**32 - 1),
        ("Command", "target"): (0, 255),
        ("Command", "action"): (0, 3),
        ("Command", "transfer_id"): (0, 31),
        ("Command", "start_end_toggle"): (7, 7),
    }
    stated_ranges = {}
    for message in database.messages:
        for signal in message.signals:
            stated_ranges[message.name, signal.name] = (signal.minimum, signal.maximum)

    assert stated_ranges == expected_ranges


@pytest.mark.parametrize(
    ("message", "signal", "enum"),
    [("Heartbeat", "health", Health), ("Heartbeat", "mode", Mode), ("Command", "action", Action)],
)
def test_the_file_names_the_numbers_of_health_mode_and_action(
    database: Any, message: str, signal: str, enum: type[Enum]
) -> None:
    """Other programs that read the DBC file show such a name in place of the number in a frame.

    The names and numbers are those of our enumeration.
    """
    names_by_number = database.get_message_by_name(message).get_signal_by_name(signal).choices
    assert len(names_by_number) == len(enum)
    for member in enum:
        assert str(names_by_number[member.value]) == member.name


# The command mcp-asdf dbc


def test_dbc_prints_the_dbc_file_or_writes_it_to_the_path_of_the_option_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A DBC file describes the frames to other programs. With the option only the path is printed."""
    text_of_file = dbc_text(FrameFormat())
    assert main(["dbc"]) == 0
    assert capsys.readouterr().out == text_of_file

    file = tmp_path / "swarm.dbc"
    assert main(["dbc", "--output", str(file)]) == 0
    assert capsys.readouterr().out == f"wrote {file}\n"
    assert file.read_text() == text_of_file


def test_dbc_reports_the_path_and_the_text_of_its_file_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without ``--output`` no file is written, and the report has no path."""
    text_of_file = dbc_text(FrameFormat())
    file = str(tmp_path / "swarm.dbc")
    assert main(["dbc", "--json", "--output", file]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": file, "dbc": text_of_file}
    assert main(["dbc", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": None, "dbc": text_of_file}


def database_of_command(options: str, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return what cantools reads in the file that ``mcp-asdf dbc`` prints with some options."""
    assert main(["dbc", *options.split()]) == 0
    return load_database(capsys.readouterr().out)


def test_dbc_for_three_nodes_has_four_messages_for_each_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    """Programs that cannot mask the id of the node in an identifier need an entry for each kind and node."""
    database = database_of_command("--per-node 0 7 127", capsys)
    kinds, nodes = 4, 3
    assert len(database.messages) == kinds * nodes


@pytest.mark.parametrize("node", [0, 7, 127])
def test_dbc_for_each_node_decodes_its_estimates_by_their_whole_identifier(
    node: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The entry is found by all bits of the identifier: subject, priority, and the id of the node.

    It has the node in its name and as the sender.
    """
    database = database_of_command("--per-node 0 7 127 --subject 1234 --priority 1", capsys)
    estimate = Estimate(node, x_hat=5, alpha=0x600, transfer_id=7)
    frame = encode_estimate(estimate, FrameFormat(subject=1234, priority=1))
    entry = database.get_message_by_frame_id(frame.arbitration_id)

    assert entry.name == f"Estimate_{node}"
    assert entry.senders == [f"Robot_{node}"]
    assert entry.decode(frame.data) == physical_values(estimate)


@pytest.mark.parametrize("node", [0, 7, 127])
def test_dbc_for_each_node_has_an_entry_for_its_heartbeats(
    node: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The entry is found by all bits of the identifier, the id of the node among them."""
    database = database_of_command("--per-node 0 7 127", capsys)
    heartbeat = encoded(Heartbeat(node, uptime=1, transfer_id=2))
    assert database.get_message_by_frame_id(heartbeat.arbitration_id).name == f"Heartbeat_{node}"


@pytest.mark.parametrize(
    ("options", "expected_error"),
    [
        ("--per-node 128", "sender is 128; it must be 0 to 127"),
        ("--per-node 3 5 5", "node 5 is listed twice"),
        ("--subject 3001", "subject 3001 is that of telemetry or commands"),
        ("--subject 3002", "subject 3002 is that of telemetry or commands"),
    ],
)
def test_dbc_refuses_a_wrong_node_or_subject_by_its_number(
    options: str, expected_error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A node has an id up to 127, once, and other messages have the subjects 3001 and 3002."""
    exit_code_of_wrong_usage = 2
    assert main(["dbc", *options.split()]) == exit_code_of_wrong_usage
    assert expected_error in capsys.readouterr().err
