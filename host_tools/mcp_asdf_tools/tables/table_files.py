"""A t-table as files: a C source for the firmware and JSON for machines, and checking them.

Both are a pure function of omega and q, byte for byte, so checking a file is making it again.
"""

from __future__ import annotations

import hashlib
import json
import re
import struct
from dataclasses import dataclass
from decimal import Decimal
from itertools import zip_longest
from pathlib import Path
from typing import Any

from mcp_asdf.table import EXTRA_WORDS, FORMAT_VERSION, FRACTION_BITS, Table
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_at_most, write_files
from mcp_asdf_tools.tables.thresholds import (
    GENERATOR_VERSION,
    MAX_MESSAGES,
    check_q,
    generate,
    parse_omega,
    worst_threshold_error,
)

_SYMBOL = re.compile(r"\bmcp_asdf_t_table_omega([0-9]{2,9})_q([0-9]{1,3})\b")


def stem(omega: Decimal, q: int) -> str:
    """Return the file name without suffix, such as ``t_table_omega05_q127``.

    After "omega" stand the decimal places of omega in its shortest form, at least two of them: 05 is
    0.05, 10 is 0.1, 125 is 0.125. No two tables share a name.
    """
    places = f"{omega.normalize():f}".partition(".")[2]
    return f"t_table_omega{places:0<2}_q{q}"


def describe(omega: Decimal, q: int) -> dict[str, Any]:
    """Return the content of the JSON file: what the table is and its entries."""
    table = generate(omega, q)
    words = table.words()
    error = worst_threshold_error(omega, table)
    return {
        "symbol": f"mcp_asdf_{stem(omega, q)}",
        "omega": float(omega),
        "omega_word": table.omega_word,
        "q": q,
        "degrees_of_freedom": "m - 1",
        "format_version": FORMAT_VERSION,
        "generator": "mcp-asdf table",
        "generator_version": GENERATOR_VERSION,
        "bytes": 4 * len(words),
        "bytes_formula": "12 + 4 q",
        "worst_threshold_error": {"rounding": error.rounding, "beyond_q": error.beyond_q},
        "checksum": words[-1],
        "sha256": hashlib.sha256(struct.pack(f"<{len(words)}I", *words)).hexdigest(),
        "fraction_bits": FRACTION_BITS,
        "entries": list(table.entries),
    }


def json_text(omega: Decimal, q: int) -> str:
    """Return the JSON file. Omega has at most 9 digits, so it reads back as the decimal it was."""
    return json.dumps(describe(omega, q), indent=2) + "\n"


_C_FILE = """\
/* A t-table for MCP-ASDF: thresholds of the hypothesis test. Generated; to change it, make another.
 *
 *   omega               {omega} (type II error probability)
 *   q                   {q} (maximum number of messages in a round that has an entry of its own)
 *   degrees of freedom  m - 1, for m messages
 *   entries             k_m = (t_{{m-1,(1-omega)/2}} / sqrt(m) + 1)^2 m / (m - 1) for m = 2 .. q, to nearest;
 *                       one more for all m > q: k at m = q + 1 with the normal quantile in place of t
 *   format              version {format_version}: magic and q, omega, entries (2^-{fraction_bits}), checksum
 *   size                {bytes} bytes = {bytes_formula}
 *   threshold error     relative, at most {rounding} for m <= q ({beyond_q})
 *   generator version   {generator_version}
 *
 * made with   mcp-asdf table --omega {omega} --neighbours {q} --output .
 * check with  mcp-asdf table --check {stem}.c
 * use with    extern const uint32_t {symbol}[{words}];
 */
#include "mcp_asdf_rom.h"

extern const uint32_t {symbol}[{words}];

/* clang-format off */
const uint32_t {symbol}[{words}] MCP_ASDF_ROM = {{
{body}
}};
"""


def c_text(omega: Decimal, q: int) -> str:
    """Return the C99 source: one constant array, which needs ``mcp_asdf_rom.h`` and nothing else."""
    facts = describe(omega, q)
    error = facts["worst_threshold_error"]
    beyond = f"at most {error['beyond_q']:.2%} for q < m <= {MAX_MESSAGES}"
    return _C_FILE.format_map(
        facts
        | {
            "omega": f"{omega:f}",
            "stem": stem(omega, q),
            "words": EXTRA_WORDS + q,
            "rounding": f"{error['rounding']:.2e}",
            "beyond_q": beyond if q < MAX_MESSAGES else f"there are never more than {MAX_MESSAGES} messages",
            "body": _c_body(generate(omega, q)),
        }
    )


def _c_body(table: Table) -> str:
    values = [entry / 2**FRACTION_BITS for entry in table.entries]
    meanings = ["magic, q", "omega * 2^32"]
    meanings += [f"m = {m}: {value:.9f}" for m, value in enumerate(values[:-1], start=2)]
    meanings += [f"m > {table.q}: {values[-1]:.9f}", "checksum"]
    lines = zip(table.words(), meanings, strict=True)
    return "\n".join(f"    0x{word:08X}U, /* {meaning} */" for word, meaning in lines)


def write(omega: Decimal, q: int, folder: Path) -> list[Path]:
    """Write the C and the JSON file into ``folder``, which is made if need be; returns their paths.

    Both are written, or neither. Raises UsageError if one cannot be.
    """
    name = stem(omega, q)
    return write_files(folder, {f"{name}.c": c_text(omega, q), f"{name}.json": json_text(omega, q)})


@dataclass(frozen=True)
class TableCheck:
    """The outcome of checking one table.

    Attributes:
        place: The file, and where in it if it is an image.
        omega, q: The table that it claims to be; None if it is unknown.
        problem: What is wrong; None if nothing is.
    """

    place: str
    omega: Decimal | None = None
    q: int | None = None
    problem: str | None = None


def check_file(path: Path) -> TableCheck:
    """Compare a generated ``.c`` or ``.json`` file with the one made anew, line ends aside.

    The name of its array says which table it is. Raises UsageError if the file cannot be read or has no such
    name.
    """
    makers = {".json": json_text, ".c": c_text}
    if path.suffix not in makers:
        raise UsageError(f"{path} is neither .c nor .json; for a built image use --verify")
    text = _read_text(path)
    symbol = _SYMBOL.search(text)
    if symbol is None:
        raise UsageError(f"{path} names no array mcp_asdf_t_table_omega.._q..; make it anew with --output")
    try:
        omega, q = parse_omega(f"0.{symbol[1]}"), check_q(int(symbol[2]))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return TableCheck(str(path), omega, q, _first_changed_line(text, makers[path.suffix](omega, q)))


def _read_text(path: Path) -> str:
    try:
        return read_at_most(path).decode().replace("\r\n", "\n")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except ValueError:  # it is too long, or no UTF-8
        raise UsageError(f"{path} is not a text file; for a built image use --verify") from None


def _first_changed_line(found: str, expected: str) -> str | None:
    lines = zip_longest(found.split("\n"), expected.split("\n"))
    for number, (left, right) in enumerate(lines, start=1):
        if left != right:
            return f"line {number}: found {left!r}, expected {right!r}"
    return None
