"""Files of a t-table: a C source for the firmware, JSON for other programs, and checks of both.

Omega and q determine both files to the byte, so a file is checked by generating it again.
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
from mcp_asdf_tools.common.files import make_folder, read_at_most, write_together
from mcp_asdf_tools.tables.thresholds import (
    GENERATOR_VERSION,
    MAX_MESSAGES,
    check_q,
    generate,
    parse_omega,
    worst_threshold_error,
)

_ARRAY_NAME = re.compile(r"\bmcp_asdf_t_table_omega([0-9]{2,9})_q([0-9]{1,3})\b")


def table_name(omega: Decimal, q: int) -> str:
    """Return the name of a table's files without suffix, such as ``t_table_omega05_q127``.

    Omega is the type II error probability of the test, q the number of neighbours with an exact threshold.
    After "omega" stand the decimal places of omega in its shortest form, at least two of them: 05 is 0.05, 10
    is 0.1, 125 is 0.125. No two tables share a name. In its shortest form 0.10 and 0.1 are the same omega,
    and so have the same name.
    """
    _, _, decimal_places = f"{omega.normalize():f}".partition(".")
    two_or_more_places = decimal_places.ljust(2, "0")
    return f"t_table_omega{two_or_more_places}_q{q}"


def describe_table(omega: Decimal, q: int) -> dict[str, Any]:
    """Return what the JSON file of a table holds: its properties, its checksums and its entries.

    The table is for ``omega``, the type II error probability of the test, and has exact thresholds for up to
    ``q`` neighbours. Raises UsageError for an omega or a q that no table has.
    """
    table = generate(omega, q)
    table_words = table.words()
    error = worst_threshold_error(omega, table)
    # The words as they lie in the memory of a controller with little-endian numbers.
    packed_words = struct.pack(f"<{len(table_words)}I", *table_words)
    return {
        "symbol": f"mcp_asdf_{table_name(omega, q)}",
        "omega": float(omega),
        "omega_word": table.omega_word,
        "q": q,
        "degrees_of_freedom": "m - 1",
        "format_version": FORMAT_VERSION,
        "generator": "mcp-asdf table",
        "generator_version": GENERATOR_VERSION,
        "bytes": len(packed_words),
        "bytes_formula": "12 + 4 q",
        "worst_threshold_error": {"rounding": error.rounding, "beyond_q": error.beyond_q},
        "checksum": table_words[-1],
        "sha256": hashlib.sha256(packed_words).hexdigest(),
        "fraction_bits": FRACTION_BITS,
        "entries": list(table.entries),
    }


def format_json(omega: Decimal, q: int) -> str:
    """Return the text of a table's JSON file."""
    return json.dumps(describe_table(omega, q), indent=2) + "\n"


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


def format_c_source(omega: Decimal, q: int) -> str:
    """Return the C99 source of a table: one constant array, which needs only ``mcp_asdf_rom.h``."""
    description = describe_table(omega, q)
    error = description["worst_threshold_error"]
    if q < MAX_MESSAGES:
        error_beyond_q = f"at most {error['beyond_q']:.2%} for q < m <= {MAX_MESSAGES}"
    else:
        # With the largest q every number of messages has an entry of its own.
        error_beyond_q = f"there are never more than {MAX_MESSAGES} messages"
    texts = {
        "omega": f"{omega:f}",
        "stem": table_name(omega, q),
        "words": EXTRA_WORDS + q,  # the extra words are a header of two, and the checksum
        "rounding": f"{error['rounding']:.2e}",
        "beyond_q": error_beyond_q,
        "body": _format_initializers(generate(omega, q)),
    }
    # Where both have a value of one name, as for omega, the text is taken.
    return _C_FILE.format_map(description | texts)


def _format_initializers(table: Table) -> str:
    """Return the lines of a table's array in C: one word of 32 bits a line, with its meaning as a comment."""
    thresholds = [entry / 2**FRACTION_BITS for entry in table.entries]
    *exact_thresholds, common_threshold = thresholds
    # The words in their order: two of a header, k_m for m = 2 .. q, one for all m above q, and the checksum.
    comments = ["magic, q", "omega * 2^32"]
    comments += [f"m = {m}: {threshold:.9f}" for m, threshold in enumerate(exact_thresholds, start=2)]
    comments += [f"m > {table.q}: {common_threshold:.9f}", "checksum"]
    words_and_comments = zip(table.words(), comments, strict=True)
    return "\n".join(f"    0x{word:08X}U, /* {comment} */" for word, comment in words_and_comments)


def write_table(omega: Decimal, q: int, folder: Path) -> list[Path]:
    """Write a table's C and JSON file into ``folder``, which is created if need be; return their paths.

    Both are written, or neither. Raises UsageError if one cannot be.
    """
    name = table_name(omega, q)
    text_by_path = {
        folder / f"{name}.c": format_c_source(omega, q),
        folder / f"{name}.json": format_json(omega, q),
    }
    make_folder(folder)
    write_together(text_by_path)
    return list(text_by_path)


@dataclass(frozen=True)
class TableCheck:
    """The outcome of checking one file.

    Attributes:
        path: The file.
        omega: Type II error probability of the table that the file claims to be.
        q: Its number of neighbours.
        problem: The first line that differs from the generated file; None if the files are equal.
    """

    path: str
    omega: Decimal
    q: int
    problem: str | None = None


def check_file(path: Path) -> TableCheck:
    """Compare a ``.c`` or ``.json`` file with the generated one, line ends aside.

    The name of the array in it says which table it claims to be. The result has the first line that differs,
    or None if there is none. Raises UsageError if the file cannot be read or has no such name.
    """
    formatters = {".json": format_json, ".c": format_c_source}
    if path.suffix not in formatters:
        raise UsageError(f"{path} is neither .c nor .json; give a file that --output has written")
    file_text = _read_text(path)
    # The file may come from anyone: what it claims to be is all that is taken from it.
    omega, q = _claimed_omega_and_q(path, file_text)
    # Omega and q determine every byte, so the right file is the one that is generated from them now.
    generated_text = formatters[path.suffix](omega, q)
    return TableCheck(str(path), omega, q, _describe_first_difference(file_text, generated_text))


def _claimed_omega_and_q(path: Path, file_text: str) -> tuple[Decimal, int]:
    """Return the omega and q in the name of the array in a file's text.

    Raises UsageError, naming the path, if the text has no such name, or no table can have this omega and q.
    """
    match = _ARRAY_NAME.search(file_text)
    if match is None:
        raise UsageError(f"{path} names no array mcp_asdf_t_table_omega.._q..; make it anew with --output")
    # The name holds the decimal places of omega: omega05 stands for 0.05.
    decimal_places, q_text = match.groups()
    try:
        return parse_omega(f"0.{decimal_places}"), check_q(int(q_text))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def _read_text(path: Path) -> str:
    """Return the text of a file with Unix line ends. Raises UsageError if it is no text or too long."""
    try:
        return read_at_most(path).decode().replace("\r\n", "\n")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError:
        raise UsageError(f"{path} is not a text file; give a file that --output has written") from None
    except ValueError as error:  # it is too long
        raise UsageError(f"cannot read {path}: {error}; give a file that --output has written") from None


def _describe_first_difference(file_text: str, expected_text: str) -> str | None:
    """Return the first line that differs, as found and as expected, or None if the texts are equal.

    A text that ends early has None in place of the lines that the other one still has.
    """
    line_pairs = zip_longest(file_text.split("\n"), expected_text.split("\n"))
    for line_number, (line, expected_line) in enumerate(line_pairs, start=1):
        if line != expected_line:
            return f"line {line_number}: found {line!r}, expected {expected_line!r}"
    return None
