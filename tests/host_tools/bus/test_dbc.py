"""The DBC file: cantools, which shares no code with ours, reads our frames by it and writes frames for us."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import example, given, settings

from mcp_asdf.fixed_point import ALPHA_MAX, word_to_alpha
from mcp_asdf_tools.bus import frames
from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_entries, dbc_text
from mcp_asdf_tools.bus.frames import (
    EVERY_ROBOT,
    MAX_B_HAT,
    MIN_B_HAT,
    Action,
    Command,
    FrameFormat,
    Health,
    Heartbeat,
    Message,
    Mode,
    Rejection,
    Telemetry,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.recording import Recording
from messages import DEFAULT, encoded, messages
from robots import ALPHA_ONE
from support import draws

pytestmark = pytest.mark.random

cantools = pytest.importorskip("cantools", reason="cantools is not installed (pip install cantools)")

UNITS = {"x_hat": 2.0**-23, "x": 2.0**-23, "b_hat": 2.0**-24}
fixed = settings(derandomize=True, deadline=None, max_examples=draws(300))

NAMES = {Message: "Estimate", Heartbeat: "Heartbeat", Telemetry: "Telemetry", Command: "Command"}


def load(text: str) -> Any:
    return cantools.database.load_string(text, "dbc", strict=True)


@pytest.fixture(scope="module")
def database() -> Any:
    return load(dbc_text(dbc_entries(DEFAULT)))


def decode(frame: can.Message, name: str) -> Any:
    if name == "Estimate":
        return frames.decode(frame, DEFAULT)
    decoders: dict[str, Callable[[can.Message], Any]] = {
        "Heartbeat": frames.decode_heartbeat,
        "Telemetry": frames.decode_telemetry,
        "Command": frames.decode_command,
    }
    return decoders[name](frame)


def physical(message: Any) -> dict[str, float]:
    """The message as cantools shows it: in the paper's units, with the tail byte, without the sender."""
    values = {item.name: getattr(message, item.name) for item in fields(message) if item.name != "sender"}
    values = {key: value.value if isinstance(value, Enum) else value for key, value in values.items()}
    if "alpha" in values:
        values["alpha"] = word_to_alpha(values["alpha"])
    scaled = {key: value * UNITS.get(key, 1) for key, value in values.items()}
    return scaled | {"start_end_toggle": 7}


def frame_of(database: Any, name: str, values: dict[str, float], node: int = 0, **how: Any) -> can.Message:
    """The values, sent by ``node``, as cantools decodes them."""
    kind = database.get_message_by_name(name)
    return can.Message(arbitration_id=kind.frame_id | node, data=kind.encode(values, **how))


@fixed
@given(messages)
@example(Message(0, 0, 0, 0))
@example(Message(127, 2**23, ALPHA_MAX, 31))
@example(Message(127, 2**23, 0x100, 31))
@example(Heartbeat(127, 2**32 - 1, 31, Health.WARNING, Mode.SOFTWARE_UPDATE, 255))
@example(Telemetry(127, 2**23, MAX_B_HAT, 255, 31))
@example(Telemetry(0, 0, MIN_B_HAT, 0, 0))
@example(Command(127, 2**32 - 1, EVERY_ROBOT, Action.SETTLE, 31))
def test_cantools_and_we_read_each_other(database: Any, message: Any) -> None:
    name, frame = NAMES[type(message)], encoded(message)
    kind = database.get_message_by_frame_id(frame.arbitration_id & ANY_NODE_MASK)
    assert kind.name == name
    assert kind.is_extended_frame
    assert kind.decode(frame.data, decode_choices=False) == physical(message)
    theirs = frame_of(database, name, physical(message), message.sender)
    assert (theirs.arbitration_id, theirs.data) == (frame.arbitration_id, frame.data)
    assert decode(theirs, name) == message


@pytest.mark.parametrize("name", NAMES.values())
def test_every_corner_of_the_stated_ranges_is_legal(database: Any, name: str) -> None:
    signals = database.get_message_by_name(name).signals
    ends = [(signal.minimum, signal.maximum) for signal in signals]
    for corner in itertools.product(*ends):
        values = {signal.name: value for signal, value in zip(signals, corner, strict=True)}
        message = decode(frame_of(database, name, values, node=3), name)
        assert not isinstance(message, Rejection), values
        # A larger alpha than the firmware has is taken for its largest.
        kept = {"alpha": min(values["alpha"], word_to_alpha(ALPHA_MAX))} if "alpha" in values else {}
        assert physical(message) == values | kept


LEGAL = {NAMES[type(message)]: physical(message) for message in (
    Message(1, 2, 0x300, 4), Heartbeat(1, 2, 3), Telemetry(1, 2, 16, 3, 4), Command(1, 2, 3, Action.SETTLE, 4)
)}  # fmt: skip
BEYOND = [
    ("Estimate", "x_hat", 1 + 2**-23, Rejection.X_HAT),
    ("Estimate", "alpha", -0.0, Rejection.ALPHA),
    ("Estimate", "alpha", -(2.0**-149), Rejection.ALPHA),
    ("Estimate", "alpha", float("inf"), Rejection.ALPHA),
    ("Estimate", "alpha", float("nan"), Rejection.ALPHA),
    ("Estimate", "start_end_toggle", 6, Rejection.MULTI_FRAME),
    ("Heartbeat", "mode", 4, Rejection.MODE),
    ("Telemetry", "x", 1 + 2**-23, Rejection.X),
    ("Telemetry", "b_hat", 2**-20 - 2**-24, Rejection.B_HAT),
    ("Telemetry", "b_hat", 1 - 2**-20 + 2**-24, Rejection.B_HAT),
    ("Command", "target", 128, Rejection.TARGET),
    ("Command", "target", 254, Rejection.TARGET),
    ("Command", "action", 4, Rejection.ACTION),
]


@pytest.mark.parametrize(("name", "signal", "value", "reason"), BEYOND)
def test_one_step_beyond_is_refused(
    database: Any, name: str, signal: str, value: float, reason: Rejection
) -> None:
    frame = frame_of(database, name, LEGAL[name] | {signal: value}, strict=False)
    assert decode(frame, name) is reason


@pytest.mark.parametrize(
    ("message", "signal", "kind"),
    [("Heartbeat", "health", Health), ("Heartbeat", "mode", Mode), ("Command", "action", Action)],
)
def test_values_have_their_names(database: Any, message: str, signal: str, kind: type[Enum]) -> None:
    choices = database.get_message_by_name(message).get_signal_by_name(signal).choices
    assert {number: str(name) for number, name in choices.items()} == {each.value: each.name for each in kind}


def test_messages_of_each_node() -> None:
    chosen = [0, 7, 127]
    database = load(dbc_text(dbc_entries(FrameFormat(1234, 1), chosen)))
    assert len(database.messages) == 4 * len(chosen)
    for node in chosen:
        frame = frames.encode(Message(node, 5, 0x600, 7), FrameFormat(1234, 1))
        kind = database.get_message_by_frame_id(frame.arbitration_id)  # no mask
        assert (kind.name, kind.senders) == (f"Estimate_{node}", [f"Robot_{node}"])
        assert kind.decode(frame.data, decode_choices=False) == physical(Message(node, 5, 0x600, 7))
        beat = encoded(Heartbeat(node, 1, 2))
        assert database.get_message_by_frame_id(beat.arbitration_id).name == f"Heartbeat_{node}"


def decoded_by_the_command_line(lines: str, folder: Path) -> list[str]:
    """Output of ``cantools decode`` for candump's lines."""
    assert main(["dbc", "--output", str(folder / "ours.dbc")]) == 0
    done = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "-s", "-m", f"{ANY_NODE_MASK:#x}", folder / "ours.dbc"],
        input=lines,
        capture_output=True,
        text=True,
        check=True,
    )
    return re.findall(r"(\w+\(.*\))", done.stdout)


def test_the_command_line_of_cantools_decodes_our_log(tmp_path: Path) -> None:
    sent = (Message(42, 2**22, ALPHA_ONE, 0), Telemetry(42, 3 * 2**21, 2**23, 7, 5))
    with Recording(tmp_path / "run.log", None, print) as (write, _):
        assert write is not None
        for message in sent:
            write(encoded(message))
    assert decoded_by_the_command_line((tmp_path / "run.log").read_text(), tmp_path) == [
        "Estimate(x_hat: 0.5, alpha: 1.0, transfer_id: 0, start_end_toggle: 7)",
        "Telemetry(x: 0.75, b_hat: 0.5, updates: 7, transfer_id: 5, start_end_toggle: 7)",
    ]


def test_ids_and_ranges(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "--per-node", "3", "10-11", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [message["name"] for message in out["messages"][::4]] == [
        "Estimate_3",
        "Estimate_10",
        "Estimate_11",
    ]
    assert out["messages"][0]["identifier"] == 0x106BB803
    assert load(out["dbc"]).messages


def test_without_a_file_the_text_is_printed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["dbc", "--subject", "100", "--priority", "2"]) == 0
    printed = capsys.readouterr().out
    assert printed == dbc_text(dbc_entries(FrameFormat(100, 2)))
    path = tmp_path / "a.dbc"
    assert main(["dbc", "--subject", "100", "--priority", "2", "--output", str(path)]) == 0
    assert path.read_text() == printed
    assert capsys.readouterr().out == f"wrote {path} (4 messages)\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--per-node", "128"], "node 128 does not exist; ids are 0 to 127"),
        (["--per-node", "0-9999999999"], "node 9999999999 does not exist"),
        (["--per-node", "5", "3-6"], "node 5 is listed twice"),
        (["--per-node", "6-3"], "give 3-6"),
        (["--per-node", "x"], "--per-node x: give ids and ranges such as 3 or 0-19"),
        (["--per-node", "1-2-3"], "--per-node 1-2-3"),
        (["--per-node", "1-"], "--per-node 1-"),
        (["--per-node", "²"], "--per-node ²"),
        (["--subject", "6144"], "subject is 6144; it must be 0 to 6143"),
        (["--subject", "3001"], "subject 3001 is that of telemetry or commands"),
        (["--subject", "3002"], "subject 3002 is that of telemetry or commands"),
        (["--priority", "8"], "priority is 8; it must be 0 to 7"),
    ],
)
def test_bad_usage_is_named(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", *arguments]) == 2
    assert says in capsys.readouterr().err
