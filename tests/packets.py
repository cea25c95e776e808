"""Packets in which robots send frames over a serial modem, as c_ref/ports/packet_radio.c specifies them."""

from __future__ import annotations

import can

PACKET_MARK = 0x7E
"""The byte with which a packet begins."""
PACKET_SIZE = 14
"""Bytes of a packet: the mark, four of the identifier, eight of data and the checksum."""


def crc_8(content: bytes) -> int:
    """Return the CRC-8 with the polynomial 0x07: the remainder of a division, bit by bit."""
    value = int.from_bytes(content, "big") << 8
    for bit in reversed(range(8, 8 + 8 * len(content))):
        if value >> bit & 1:
            value ^= 0x107 << (bit - 8)
    return value


def packet_of(frame: can.Message) -> bytes:
    """Return the packet of a frame: mark, identifier, data and checksum."""
    content = frame.arbitration_id.to_bytes(4, "little") + bytes(frame.data)
    return bytes([PACKET_MARK]) + content + bytes([crc_8(content)])


def frame_of_packet(packet: bytes) -> can.Message | None:
    """Return the frame of a packet, or None if its checksum is wrong."""
    content, checksum = packet[1:-1], packet[-1]
    if crc_8(content) != checksum:
        return None
    return can.Message(arbitration_id=int.from_bytes(content[:4], "little"), data=content[4:])
