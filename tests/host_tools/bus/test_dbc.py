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
from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    Telemetry,
    encode,
)
from mcp_asdf_tools.cli.main import main
from messages import DEFAULT, KINDS, encoded, messages
from support import draws

pytestmark = pytest.mark.random

cantools = pytest.importorskip("cantools", reason="cantools is not installed (pip install cantools)")

UNITS = {"x_hat": 2.0**-23, "x": 2.0**-23, "b_hat": 2.0**-24}
fixed = settings(derandomize=True, deadline=None, max_examples=draws(300))


def load(text: str) -> Any:
    return cantools.database.load_string(text, "dbc", strict=True)


@pytest.fixture(scope="module")
def database() -> Any:
    return load(dbc_text(DEFAULT))


def physical(message: Any) -> dict[str, float]:
    """The message as cantools shows it: in the paper's units, with the tail byte, without the sender."""
    values = {item.name: getattr(message, item.name) for item in fields(message) if item.name != "sender"}
    values = {key: value.value if isinstance(value, Enum) else value for key, value in values.items()}
    if "alpha" in values:
        values["alpha"] = alpha_from_word(values["alpha"])
    return {key: value * UNITS.get(key, 1) for key, value in values.items()} | {"start_end_toggle": 7}


def decoded(database: Any, kind: type, values: dict[str, float], node: int = 0, **how: Any) -> Any:
    """What we read in a frame of ``node`` that cantools encodes."""
    entry = database.get_message_by_name(kind.__name__.replace("Message", "Estimate"))
    frame = can.Message(arbitration_id=entry.frame_id | node, data=entry.encode(values, **how))
    return KINDS[kind].decode(frame)


@fixed
@given(messages)
@example(Message(127, 2**23, ALPHA_MAX, 31))
@example(Message(127, 2**23, 0x100, 31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_cantools_and_we_read_each_other(database: Any, message: Any) -> None:
    frame = encoded(message)
    entry = database.get_message_by_frame_id(frame.arbitration_id & ANY_NODE_MASK)
    assert entry.is_extended_frame
    assert entry.decode(frame.data, decode_choices=False) == physical(message)
    assert decoded(database, type(message), physical(message), message.sender) == message


LEGAL = (
    Message(1, 2, 0x300, 4), Heartbeat(1, 2, 3), Telemetry(1, 2, 16, 3, 4), Command(1, 2, 3, Action.SETTLE, 4)
)  # fmt: skip
BEYOND = {"alpha": (-0.0, float("inf"))}
"""Values just outside a range, where they are not a unit away from its ends."""
REASONS = {"start_end_toggle": Rejection.MULTI_FRAME}


@pytest.mark.parametrize("legal", LEGAL, ids=lambda legal: type(legal).__name__)
def test_a_stated_range_is_what_is_taken(database: Any, legal: Any) -> None:
    """Its ends are legal, and just beyond them a frame is rejected, but for the target of a command, which
    has a gap. A larger alpha than the firmware has is taken for its largest."""
    refused, kind = set(), type(legal)
    for signal in database.get_message_by_name(kind.__name__.replace("Message", "Estimate")).signals:
        unit, reaches = signal.scale, (2**signal.length - 1) * signal.scale
        around = [each for each in (signal.minimum - unit, signal.maximum + unit) if 0 <= each <= reaches]
        for value in (signal.minimum, signal.maximum):
            found = decoded(database, kind, physical(legal) | {signal.name: value})
            most = alpha_from_word(ALPHA_MAX) if signal.name == "alpha" else value
            assert physical(found)[signal.name] == min(value, most)
        for value in BEYOND.get(signal.name, around):
            found = decoded(database, kind, physical(legal) | {signal.name: value}, strict=False)
            assert found is REASONS.get(signal.name) or found is Rejection[signal.name.upper()], value
            refused.add(signal.name)
    names = {Message: "x_hat alpha", Heartbeat: "mode", Telemetry: "x b_hat", Command: "action"}
    assert refused == {*names[kind].split(), "start_end_toggle"}


@pytest.mark.parametrize(
    ("message", "signal", "kind"),
    [("Heartbeat", "health", Health), ("Heartbeat", "mode", Mode), ("Command", "action", Action)],
)
def test_values_have_their_names(database: Any, message: str, signal: str, kind: type[Enum]) -> None:
    choices = database.get_message_by_name(message).get_signal_by_name(signal).choices
    assert {number: str(name) for number, name in choices.items()} == {each.value: each.name for each in kind}


def test_messages_of_each_node(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen, file = ("0", "7", "127"), str(tmp_path / "swarm.dbc")
    words = ["dbc", "--per-node", *chosen, "--subject=1234", "--priority=1"]
    for options in ([], ["--output", file], ["--json"], ["--json", "--output", file]):
        assert main([*words, *options]) == 0
    lines = capsys.readouterr().out.partition(f"wrote {file}\n")
    text = Path(file).read_text()
    assert lines[0] == text
    assert json.loads(f"[{lines[2]}]".replace("}\n{", "},{")) == [
        {"file": None, "dbc": text},
        {"file": file, "dbc": text},
    ]
    database = load(text)
    assert len(database.messages) == 4 * len(chosen)
    for node in map(int, chosen):
        frame = encode(Message(node, 5, 0x600, 7), FrameFormat(1234, 1))
        entry = database.get_message_by_frame_id(frame.arbitration_id)  # no mask
        assert (entry.name, entry.senders) == (f"Estimate_{node}", [f"Robot_{node}"])
        assert entry.decode(frame.data, decode_choices=False) == physical(Message(node, 5, 0x600, 7))
        beat = encoded(Heartbeat(node, 1, 2))
        assert database.get_message_by_frame_id(beat.arbitration_id).name == f"Heartbeat_{node}"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("--per-node 128", "sender is 128; it must be 0 to 127"),
        ("--per-node 3 5 5", "node 5 is listed twice"),
        ("--subject 3001", "subject 3001 is that of telemetry or commands"),
        ("--subject 3002", "subject 3002 is that of telemetry or commands"),
    ],
)
def test_bad_usage_is_named(arguments: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", *arguments.split()]) == 2
    assert says in capsys.readouterr().err
