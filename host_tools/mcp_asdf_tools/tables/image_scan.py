"""Finding t-tables inside a built image: ELF, Intel HEX, or plain binary."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO, StringIO
from itertools import zip_longest
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from intelhex import IntelHex, IntelHexError  # type: ignore[import-untyped]

from mcp_asdf.table import EXTRA_WORDS, FRACTION_BITS, MAGIC, MAX_Q, MIN_Q, checksum
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_at_most
from mcp_asdf_tools.tables.table_files import TableCheck
from mcp_asdf_tools.tables.thresholds import generate, omega_from_word

_BYTE_ORDERS = {"<": "little-endian", ">": "big-endian"}
_MAGIC_BYTES = MAGIC.to_bytes(4, "big")[:3]
_FIRST_WORDS = {
    "<": re.compile(b"(?=." + _MAGIC_BYTES[::-1] + b")", re.DOTALL),
    ">": re.compile(b"(?=" + _MAGIC_BYTES + b".)", re.DOTALL),
}
"""Places where the magic stands beside a byte for q, in each byte order; two such places may overlap."""
_OF_ELF = (TypeError, AttributeError, LookupError)
"""What pyelftools raises, too, where a link in the file leads nowhere."""
_DAMAGE = (ELFError, IntelHexError, ValueError, OverflowError, zlib.error, *_OF_ELF)
"""Exceptions of the two libraries when a file is damaged."""
_LARGEST_IMAGE = 2**28
_HEX_RECORD = re.compile(rb"\s*:[0-9A-Fa-f]{10}")
_NOT_FOUND = "no t-table found; is one linked in and used, and is this ELF, Intel HEX or plain binary?"


@dataclass(frozen=True)
class _Chunk:
    """Bytes of an image that lie together."""

    name: str
    address: int
    data: bytes


def verify_image(path: Path) -> list[TableCheck]:
    """Find every table in the image ``path`` and compare it with the one made anew.

    Returns one finding per table, and at least one: an image without a table is a finding with a problem.
    ELF is recognised by its first bytes, Intel HEX by its first record; all else counts as plain binary. A
    table is the magic and a possible q, in either byte order and at any alignment, with either the right
    checksum or, for a damaged one, at least half of its entries in the range of such entries: the magic alone
    also stands in the firmware's code, and in texts such as "ITCM". Raises UsageError if the file cannot be
    read or is damaged.
    """
    findings = [_finding(path, chunk, *hit) for chunk in _chunks(path) for hit in _hits(chunk.data)]
    return findings or [TableCheck(str(path), problem=_NOT_FOUND)]


def _chunks(path: Path) -> list[_Chunk]:
    try:
        data = read_at_most(path, _LARGEST_IMAGE)
        if data.startswith(b"\x7fELF"):
            return _elf_chunks(data)
        if _HEX_RECORD.match(data):
            return _hex_chunks(data)
        return [_Chunk("", 0, data)]
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except _DAMAGE as error:
        raise UsageError(f"cannot read {path}: {error}; the file is damaged, build it again") from error


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


def _hits(data: bytes) -> Iterator[tuple[str, int, tuple[int, ...]]]:
    """Byte order, offset and words of every table; fewer words than it should have at the end of the data."""
    for order, first_word in _FIRST_WORDS.items():
        for start in (each.start() for each in first_word.finditer(data)):
            words = _words(data[start : start + 4 * (EXTRA_WORDS + MAX_Q)], order)
            q = words[0] & 0xFF
            words = words[: EXTRA_WORDS + q]
            if MIN_Q <= q <= MAX_Q and _is_table(words, q):
                yield order, start, words


def _words(data: bytes, order: str) -> tuple[int, ...]:
    count = len(data) // 4
    return struct.unpack(f"{order}{count}I", data[: 4 * count])


def _is_table(words: tuple[int, ...], q: int) -> bool:
    if len(words) == EXTRA_WORDS + q and checksum(words[:-1]) == words[-1]:
        return True
    possible = sum(_possible(word, m) for m, word in enumerate(words[2 : q + 2], start=2))
    return 2 * possible >= q


def _possible(entry: int, m: int) -> bool:
    """True if k_m can be this for some omega: it is above 1 and below 1 + 64 / (m - 1)."""
    excess = entry - (1 << FRACTION_BITS)
    return excess > 0 and excess * (m - 1) < 64 << FRACTION_BITS


def _finding(path: Path, chunk: _Chunk, order: str, offset: int, words: tuple[int, ...]) -> TableCheck:
    where = f"{chunk.name}+{offset:#x}" if chunk.name else f"{chunk.address + offset:#x}"
    place, q = f"{path}: {where} ({_BYTE_ORDERS[order]})", words[0] & 0xFF
    omega = omega_from_word(words[1])
    if omega is None:
        return TableCheck(place, q=q, problem=f"word 1 (omega) is {words[1]:#010x}, which no omega gives")
    return TableCheck(place, omega, q, _first_difference(words, generate(omega, q).words()))


def _first_difference(found: tuple[int, ...], expected: tuple[int, ...]) -> str | None:
    q = len(expected) - EXTRA_WORDS
    names = ["the magic", "omega", *(f"entry {m - 2} (m = {m})" for m in range(2, q + 1))]
    names += [f"entry {q - 1} (m > {q})", "the checksum"]
    for name, left, right in zip_longest(names, found, expected):
        if left != right:
            shown = "nothing" if left is None else f"{left} ({left:#010x})"
            return f"{name}: found {shown}, expected {right} ({right:#010x})"
    return None
