"""Finding t-tables inside a built image: ELF, Intel HEX, or plain binary."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from intelhex import IntelHex, IntelHexError  # type: ignore[import-untyped]

from firmware_py.table import FORMAT_VERSION, HEADER_WORDS, MAGIC, MAX_Q, MIN_Q
from host_tools.errors import UsageError
from host_tools.table_files import Finding, compare
from host_tools.tables import omega_from_word

_BYTE_ORDERS = {"<": "little-endian", ">": "big-endian"}
_DAMAGE = (ELFError, IntelHexError, UnicodeDecodeError, OverflowError, zlib.error)
"""What the two libraries let out when a file is damaged."""
_HEX_SUFFIXES = {".hex", ".ihex", ".ihx"}
_HEX_RECORD = re.compile(rb"\s*:[0-9A-Fa-f]{10}")
_TEXT_BYTES = b"\t\r\n" + bytes(range(0x20, 0x7F))


@dataclass(frozen=True)
class _Chunk:
    """Bytes of an image that lie together."""

    name: str
    address: int
    data: bytes


def verify_image(path: Path) -> list[Finding]:
    """Find every table in the image ``path`` and compare it with the one made anew.

    Returns one finding a table, never none: an image without a table is a finding with a problem.
    ELF is told by its first bytes, Intel HEX by its first record or the suffix (.hex, .ihex, .ihx); what
    is neither counts as plain binary, unless the bytes of an image cannot lie there as they are: in lines
    of text, such as S-records, and in UF2. A table is the magic word, in either byte order and at any
    alignment, followed by a sane word 1: the magic word alone also stands in the firmware's code, which
    compares with it. Raises UsageError if the file cannot be read or is in another format.
    """
    findings = [_finding(path, chunk, *hit) for chunk in _chunks(path) for hit in _hits(chunk.data)]
    return findings or [Finding(str(path), problem="no t-table found; is one linked in, and used?")]


def _chunks(path: Path) -> list[_Chunk]:
    try:
        data = path.read_bytes()
        return _chunks_of(data, path)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except _DAMAGE as error:
        raise UsageError(f"cannot read {path}: {error}; the file is damaged, build it again") from error


def _chunks_of(data: bytes, path: Path) -> list[_Chunk]:
    if data.startswith(b"\x7fELF"):
        return _elf_chunks(data)
    if _HEX_RECORD.match(data):
        return _hex_chunks(data)
    foreign = _foreign_format(data)
    if foreign:
        raise UsageError(
            f"{path} is {foreign}; give the ELF, Intel HEX or plain binary file of the same build "
            "(of S-records, objcopy -I srec -O binary makes one)"
        )
    return _hex_chunks(data) if path.suffix.lower() in _HEX_SUFFIXES else [_Chunk("", 0, data)]


def _foreign_format(data: bytes) -> str | None:
    """What ``data`` is, if it is no image: a table, were there one, would not be found in it."""
    if data.startswith(b"UF2\n"):
        return "in UF2"
    is_text = b"\n" in data and not data.translate(None, _TEXT_BYTES)
    return "text, but not Intel HEX" if is_text else None


def _elf_chunks(data: bytes) -> list[_Chunk]:
    """Sections that are loaded; segments if the sections were stripped."""
    elf = ELFFile(BytesIO(data))
    sections = [
        _Chunk(section.name, section["sh_addr"], section.data())
        for section in elf.iter_sections()
        if section["sh_flags"] & SH_FLAGS.SHF_ALLOC and section["sh_type"] != "SHT_NOBITS"
    ]
    return sections or [
        _Chunk("segment", segment["p_vaddr"], segment.data()) for segment in elf.iter_segments("PT_LOAD")
    ]


def _hex_chunks(data: bytes) -> list[_Chunk]:
    image = IntelHex()
    image.loadhex(StringIO(data.decode("ascii")))
    return [_Chunk("", start, image.tobinstr(start, end - 1)) for start, end in image.segments()]


def _hits(data: bytes) -> Iterator[tuple[int, str, int]]:
    """Offset, byte order and q of every table."""
    for order in _BYTE_ORDERS:
        magic = struct.pack(order + "I", MAGIC)
        offset = data.find(magic)
        while offset >= 0:
            q = _q_of(_words(data[offset : offset + 4 * HEADER_WORDS], order))
            if q is not None:
                yield offset, order, q
            offset = data.find(magic, offset + 1)


def _words(data: bytes, order: str) -> tuple[int, ...]:
    count = len(data) // 4
    return struct.unpack(f"{order}{count}I", data[: 4 * count])


def _q_of(header: tuple[int, ...]) -> int | None:
    """Return q if word 1 is one that a table can have."""
    if len(header) < HEADER_WORDS:
        return None
    version, q, fraction_bits, low = header[1].to_bytes(4, "big")
    sane = version == FORMAT_VERSION and MIN_Q <= q <= MAX_Q and 1 <= fraction_bits <= 31 and low == 0
    return q if sane else None


def _finding(path: Path, chunk: _Chunk, offset: int, order: str, q: int) -> Finding:
    words = _words(chunk.data[offset : offset + 4 * (HEADER_WORDS + q)], order)
    where = f"{chunk.name}+{offset:#x}" if chunk.name else f"{chunk.address + offset:#x}"
    place = f"{path}: {where} ({_BYTE_ORDERS[order]})"
    omega = omega_from_word(words[2])
    if omega is None:
        return Finding(place, q=q, problem=f"word 2 (omega) is {words[2]:#010x}, which no omega gives")
    return compare(place, omega, words, q)
