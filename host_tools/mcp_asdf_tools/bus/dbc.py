"""The frames as a DBC file, from which CAN tools decode them. It is written from ``frame_layout``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mcp_asdf_tools.bus.frame_layout import (
    COMMAND,
    ESTIMATE,
    FRAME_BYTES,
    HEARTBEAT,
    TELEMETRY,
    Field,
    FrameKind,
)
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    TELEMETRY_FORMAT,
    FrameFormat,
    Heartbeat,
    encode_heartbeat,
)
from mcp_asdf_tools.common.errors import UsageError

ANY_NODE_MASK = 0x1FFF_FF00
"""Mask of the identifier bits to compare when one entry serves all nodes."""

_EXTENDED_IDENTIFIER = 1 << 31
"""Mark of a 29-bit identifier in a DBC file."""

_LARGEST_FLOAT32 = "3.4028234663852886E+38"
"""Largest finite binary32 number, in the decimal digits that identify it."""


@dataclass(frozen=True)
class _Entry:
    """A message of the file: one kind of frame as one node, or any node, sends it.

    Attributes:
        kind: The kind of frame.
        identifier: Its identifier as the file has it, with the mark of a 29-bit one.
        node_suffix: What follows the names of message and node: "" for any node, otherwise "_" and its id.
    """

    kind: FrameKind
    identifier: int
    node_suffix: str


def dbc_text(estimate_format: FrameFormat, nodes: Sequence[int] | None = None) -> str:
    """Return the text of a DBC file with all kinds of frames.

    Each of ``nodes`` gets its own entries; if it is None, one entry for each kind serves any node and has the
    identifier of node 0. Raises UsageError if a node is not 0 .. 127 or listed twice, or if the subject of
    the estimates is that of telemetry or of commands. O(len(nodes)).
    """
    if estimate_format.subject in (TELEMETRY_FORMAT.subject, COMMAND_FORMAT.subject):
        raise UsageError(
            f"subject {estimate_format.subject} is that of telemetry or commands; "
            "choose another for estimates"
        )
    suffix_by_node = _suffix_by_node(nodes)
    entries = _create_entries(estimate_format, suffix_by_node)
    node_names = " ".join(f"Robot{suffix}" for suffix in suffix_by_node.values())
    # NS_ (new symbols) and BS_ (bit rate) are empty, but have to be there.
    sections = ['VERSION ""\n', "NS_ :\n", "BS_:\n", f"BU_: {node_names}\n"]
    sections += [_message_section(entry) for entry in entries]
    # The format wants all comments first, then the names of values, then the signals that are floats.
    for make_lines in (_comment_lines, _value_name_lines, _float_type_lines):
        lines: list[str] = []
        for entry in entries:
            lines += make_lines(entry)
        sections.append("".join(lines))
    return "\n".join(sections)


def _suffix_by_node(nodes: Sequence[int] | None) -> dict[int, str]:
    """Return the suffix of the names in a node's entries, which is ``_`` and the node's id, by that id.

    If ``nodes`` is None, the result is node 0 with an empty suffix, for entries that serve any node. Raises
    UsageError if a node is listed twice.
    """
    if nodes is None:
        # Whoever reads the file leaves out the bits of the node (ANY_NODE_MASK).
        return {0: ""}
    for node in nodes:
        if nodes.count(node) > 1:
            raise UsageError(f"node {node} is listed twice; each id belongs to one node")
    return {node: f"_{node}" for node in nodes}


def _create_entries(estimate_format: FrameFormat, suffix_by_node: dict[int, str]) -> list[_Entry]:
    """Return the entries of all nodes, node by node; a node has an entry for each kind of frame."""
    entries = []
    for node, suffix in suffix_by_node.items():
        for kind, identifier in _identified_kinds(estimate_format, node):
            entries.append(_Entry(kind, identifier | _EXTENDED_IDENTIFIER, suffix))
    return entries


def _identified_kinds(estimate_format: FrameFormat, node: int) -> list[tuple[FrameKind, int]]:
    """Return all kinds of frames, each with the 29-bit identifier that it has from a node."""
    any_heartbeat = encode_heartbeat(Heartbeat(node, uptime=0, transfer_id=0))
    return [
        (ESTIMATE, estimate_format.identifier(node)),
        (HEARTBEAT, any_heartbeat.arbitration_id),  # heartbeats have one format, and no FrameFormat
        (TELEMETRY, TELEMETRY_FORMAT.identifier(node)),
        (COMMAND, COMMAND_FORMAT.identifier(node)),
    ]


def _message_section(entry: _Entry) -> str:
    """Return a BO_ section: the message, its sender, and a line for each signal."""
    node_name = f"Robot{entry.node_suffix}"
    header = f"BO_ {entry.identifier} {entry.kind.name}{entry.node_suffix}: {FRAME_BYTES} {node_name}\n"
    # "Vector__XXX" is DBC's word for "no particular receiver".
    signals = [f' {_signal(field)} "" Vector__XXX\n' for field in entry.kind.fields_and_tail]
    return header + "".join(signals)


def _signal(field: Field) -> str:
    """Return a signal's name, bits, scale and range, such as ``SG_ x : 0|24@1+ (1,0) [0|5]``.

    There, 0 is the first bit, 24 the number of bits, 1 stands for little endian and + for unsigned, - for a
    number with a sign; (1,0) are factor and offset, and [0|5] is the range. If the field may also have a
    special value above its range, the range ends with that value.
    """
    if field.is_float:
        sign = "-"
        minimum = "0"
        maximum = _LARGEST_FLOAT32
    else:
        sign = "+"
        # The file has no way to describe a gap, so a special value belongs to the range.
        largest_integer = field.maximum
        if field.special_value is not None:
            largest_integer = max(field.maximum, field.special_value)
        minimum = _format_number(field.minimum * field.unit)
        maximum = _format_number(largest_integer * field.unit)
    bits = f"{field.first_bit}|{field.bit_count}@1{sign}"
    return f"SG_ {field.name} : {bits} ({_format_number(field.unit)},0) [{minimum}|{maximum}]"


def _format_number(value: float) -> str:
    """Return a number with all its digits, without a point if it is an integer."""
    if value.is_integer():
        return str(int(value))
    # repr() has all digits, and the file's exponents have a capital E.
    return repr(value).upper()


def _comment_lines(entry: _Entry) -> list[str]:
    """Return the CM_ lines: the meaning of the message and of each signal."""
    lines = [f'CM_ BO_ {entry.identifier} "{entry.kind.meaning}";\n']
    for field in entry.kind.fields_and_tail:
        lines.append(f'CM_ SG_ {entry.identifier} {field.name} "{field.meaning}";\n')
    return lines


def _value_name_lines(entry: _Entry) -> list[str]:
    """Return the VAL_ lines: the names of values, for each signal whose values have names."""
    lines = []
    for field in entry.kind.fields:
        if field.value_names:
            names = " ".join(f'{value} "{name}"' for value, name in field.value_names.items())
            lines.append(f"VAL_ {entry.identifier} {field.name} {names} ;\n")
    return lines


def _float_type_lines(entry: _Entry) -> list[str]:
    """Return the SIG_VALTYPE_ lines: the signals that are binary32 numbers."""
    binary32 = 1  # DBC's number for this type
    return [
        f"SIG_VALTYPE_ {entry.identifier} {field.name} : {binary32};\n"
        for field in entry.kind.fields
        if field.is_float
    ]
