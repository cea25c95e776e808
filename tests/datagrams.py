"""Datagrams for a multicast group: what python-can writes, and what nobody should."""

from __future__ import annotations

import random
from typing import Any

import msgpack  # type: ignore[import-untyped]

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from robots import ALPHA_ONE

NAMES = (
    *("timestamp", "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "channel"),
    *("dlc", "data", "is_fd", "bitrate_switch", "error_state_indicator"),
)
"""The fields in python-can's order."""

VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 8, 127, 128, 255, 256, 2**16, 2**29 - 1, 2**29, 2**32 - 1, 2**32, 2**63),
    *(0.5, 1e300, float("nan"), "", "x y", "c" * 31, "c" * 32, "c" * 200, "c" * 256, "\N{SNOWMAN}" * 9),
    *(b"", b"1234567", b"12345678", b"123456789", b"\xff" * 200, [], [1, [2, [3]]], {}, {"a": {"b": 1}}),
)


def fields(sender: int = 7) -> dict[str, Any]:
    """Return the fields of an estimate as python-can sends them, in its order."""
    frame = encode_estimate(Estimate(sender, 1, ALPHA_ONE, 3), FrameFormat())
    return {name: bytes(frame.data) if name == "data" else getattr(frame, name) for name in NAMES}


def packed(sender: int = 7, **changes: Any) -> bytes:
    """Return the datagram of an estimate, with some fields changed."""
    return bytes(msgpack.packb(fields(sender) | changes))


def odd_datagrams() -> list[bytes]:
    """Return some 800 datagrams that python-can would not write for a data frame, and a few that it would."""
    usual, usual_fields = packed(), fields()
    odd = [b"", b"\xc1", bytes(401), bytes(2000), b"\x91" * 300, b"\x81\xa1" * 150, usual + b"\0", usual * 3]
    odd += [msgpack.packb(value) for value in VALUES]
    for name in NAMES:
        odd += [packed(**{name: value}) for value in VALUES]
        without_name = {key: value for key, value in usual_fields.items() if key != name}
        odd.append(msgpack.packb(without_name))
    odd.append(msgpack.packb(dict(reversed(usual_fields.items()))))
    odd.append(msgpack.packb(list(usual_fields.items())))
    odd += [packed(unknown=1), packed(is_rx=True), packed(dlc=7, data=b"1234567")]
    odd.append(packed(arbitration_id=0x800, is_extended_id=False))
    odd.append(packed(arbitration_id=5, is_extended_id=False))
    # Numbers in more bytes than they need, and names and values of other kinds than msgpack chooses.
    for number in (b"\xcc\x08", b"\xcd\0\x08", b"\xce\0\0\0\x08", b"\xd0\x08"):
        odd.append(usual.replace(b"\xa3dlc\x08", b"\xa3dlc" + number))
    for head in (b"\xc5\0\x08", b"\xa8", b"\xd9\x08"):
        odd.append(usual.replace(b"data\xc4\x08", b"data" + head))
    odd += [usual.replace(b"\xa4data", b"\xd9\x04data"), b"\xde\0\x0b" + usual[1:]]
    odd += [packed(channel="c" * size) for size in range(190, 256, 5)]  # the limit of 400 bytes is among them
    odd += [usual[:size] for size in range(len(usual))]
    rng = random.Random(35)
    for _ in range(200):
        damaged = bytearray(usual)
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        odd.append(bytes(damaged))
    return odd
