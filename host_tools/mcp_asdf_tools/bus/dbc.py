"""The frames as a DBC file, from which CAN tools decode them (``docs/frame.md`` is its source)."""

from __future__ import annotations

from collections.abc import Sequence

from mcp_asdf_tools.bus.frames import COMMANDS, TELEMETRY, FrameFormat, Heartbeat, encode_heartbeat
from mcp_asdf_tools.common.errors import UsageError

ANY_NODE_MASK = 0x1FFF_FF00
"""Mask of the identifier bits to compare when one entry serves all nodes."""

_EXTENDED = 1 << 31

# Signals are first bit | bits @ little endian, sign (factor, offset) [least | most]; # is the identifier.
_KINDS = {
    "Estimate": """\
CM_ BO_ # "A robot's broadcast";
SG_ x_hat : 0|24@1+ (1.1920928955078125E-07,0) [0|1]
CM_ SG_ # x_hat "local estimate (eq. 3)";
SG_ alpha : 24|32@1- (1,0) [0|3.4028234663852886E+38]
CM_ SG_ # alpha "local confidence (eq. 4)";
SIG_VALTYPE_ # alpha : 1;
""",
    "Heartbeat": """\
CM_ BO_ # "A node's heartbeat, once per second";
SG_ uptime : 0|32@1+ (1,0) [0|4294967295]
CM_ SG_ # uptime "seconds since start";
SG_ health : 32|2@1+ (1,0) [0|3]
CM_ SG_ # health "health of the node";
VAL_ # health 0 "NOMINAL" 1 "ADVISORY" 2 "CAUTION" 3 "WARNING" ;
SG_ mode : 40|3@1+ (1,0) [0|3]
CM_ SG_ # mode "operating mode of the node";
VAL_ # mode 0 "OPERATIONAL" 1 "INITIALIZATION" 2 "MAINTENANCE" 3 "SOFTWARE_UPDATE" ;
SG_ vendor_status : 48|8@1+ (1,0) [0|255]
CM_ SG_ # vendor_status "the application's own code";
""",
    "Telemetry": """\
CM_ BO_ # "A robot's state for observers of the bus";
SG_ x : 0|24@1+ (1.1920928955078125E-07,0) [0|1]
CM_ SG_ # x "informed estimate (eq. 7)";
SG_ b_hat : 24|24@1+ (5.960464477539063E-08,0) [9.5367431640625E-07|0.9999990463256836]
CM_ SG_ # b_hat "assumed accuracy";
SG_ updates : 48|8@1+ (1,0) [0|255]
CM_ SG_ # updates "number of re-estimates of b_hat (eq. 8) modulo 256";
""",
    "Command": """\
CM_ BO_ # "A simulator's order";
SG_ tick : 0|32@1+ (1,0) [0|4294967295]
CM_ SG_ # tick "number of the control tick";
SG_ target : 32|8@1+ (1,0) [0|255]
CM_ SG_ # target "id of the robot addressed";
VAL_ # target 255 "EVERY_ROBOT" ;
SG_ action : 40|8@1+ (1,0) [0|3]
CM_ SG_ # action "half of a tick to do";
VAL_ # action 0 "OBSERVE_WHITE" 1 "OBSERVE_BLACK" 2 "OBSERVE_NONE" 3 "SETTLE" ;
""",
}
_TAIL = """\
SG_ transfer_id : 56|5@1+ (1,0) [0|31]
CM_ SG_ # transfer_id "number of the sender's messages of this kind modulo 32";
SG_ start_end_toggle : 61|3@1+ (1,0) [7|7]
CM_ SG_ # start_end_toggle "7: the transfer is this one frame";
"""


def dbc_text(estimates: FrameFormat, nodes: Sequence[int] | None = None) -> str:
    """The text of a DBC file: all kinds from each of ``nodes`` or, if None, one entry a kind for any node.

    Entries for any node have the identifier of node 0. Raises UsageError if a node is not 0 .. 127 or listed
    twice, or if the subject of ``estimates`` is that of telemetry or of commands. O(len(nodes)).
    """
    if estimates.subject in (TELEMETRY.subject, COMMANDS.subject):
        raise UsageError(
            f"subject {estimates.subject} is that of telemetry or commands; choose another for estimates"
        )
    if nodes is not None and len(set(nodes)) < len(nodes):
        twice = next(node for node in nodes if nodes.count(node) > 1)
        raise UsageError(f"node {twice} is listed twice; each id belongs to one node")
    senders = [(0, "")] if nodes is None else [(node, f"_{node}") for node in nodes]
    entries = [
        (kind, suffix, identifier | _EXTENDED)
        for node, suffix in senders
        for kind, identifier in zip(_KINDS, _identifiers(estimates, node), strict=True)
    ]
    parts = [
        'VERSION ""\n',
        "NS_ :\n",
        "BS_:\n",
        f"BU_: {' '.join(f'Robot{suffix}' for _, suffix in senders)}\n",
    ]
    for kind, suffix, identifier in entries:
        signals = "".join(f' {line} "" Vector__XXX\n' for line in _lines(kind, identifier, "SG_"))
        parts.append(f"BO_ {identifier} {kind}{suffix}: 8 Robot{suffix}\n{signals}")
    for section in ("CM_", "VAL_", "SIG_VALTYPE_"):
        lines = [line for kind, _, identifier in entries for line in _lines(kind, identifier, section)]
        parts.append("".join(f"{line}\n" for line in lines))
    return "\n".join(parts)


def _identifiers(estimates: FrameFormat, node: int) -> tuple[int, ...]:
    heartbeat = encode_heartbeat(Heartbeat(node, 0, 0)).arbitration_id
    return estimates.identifier(node), heartbeat, TELEMETRY.identifier(node), COMMANDS.identifier(node)


def _lines(kind: str, identifier: int, keyword: str) -> list[str]:
    """The lines of a message that begin with a keyword."""
    text = (_KINDS[kind] + _TAIL).replace("#", str(identifier))
    return [line for line in text.splitlines() if line.startswith(f"{keyword} ")]
