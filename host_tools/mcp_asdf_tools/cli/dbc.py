"""``mcp-asdf dbc``: write a DBC file of the frames."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path

from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_entries, dbc_text
from mcp_asdf_tools.bus.frames import MAX_NODE_ID, FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import write_atomically

EPILOG = f"""\
examples:
  mcp-asdf dbc                                      # to the screen
  mcp-asdf dbc --output mcp_asdf.dbc                # one entry for each kind of frame, for any node
  mcp-asdf dbc --per-node 0-19 --output swarm.dbc   # an entry for each kind and node
The entries for any node are those of node 0: let the tool ignore the lower 8 bits of the identifier,
`cantools decode -m {ANY_NODE_MASK:#X} mcp_asdf.dbc`. Where a tool cannot, use --per-node.
exit code: 0 done, 2 bad usage"""

_DEFAULTS = FrameFormat()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="write this file (default: standard output)"
    )
    parser.add_argument(
        "--per-node",
        metavar="ID",
        nargs="+",
        help="nodes with entries of their own: ids 0 to 127 and ranges such as 0-19",
    )
    parser.add_argument(
        "--subject",
        type=int,
        default=_DEFAULTS.subject,
        help="Cyphal subject of the estimates, 0 to 6143 (default %(default)s)",
    )
    parser.add_argument(
        "--priority",
        type=int,
        default=_DEFAULTS.priority,
        help="of the estimates, 0 (first) to 7 (default %(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Write the file."""
    nodes = None if args.per_node is None else [node for text in args.per_node for node in _ids(text)]
    try:
        messages = dbc_entries(FrameFormat(args.subject, args.priority), nodes)
    except ValueError as error:
        raise UsageError(str(error)) from error
    text = dbc_text(messages)
    if args.output is not None:
        write_atomically(args.output, text)
    if args.json:
        listed = [{"name": entry.name, "identifier": entry.identifier} for entry in messages]
        path = None if args.output is None else str(args.output)
        print(json.dumps({"file": path, "dbc": text, "messages": listed}, indent=2))
    elif args.output is None:
        sys.stdout.write(text)
    else:
        print(f"wrote {args.output} ({len(messages)} messages)")
    return 0


def _ids(text: str) -> Iterable[int]:
    """The ids that ``text``, a number or a range, stands for. Raises UsageError if it is neither."""
    parts = text.split("-")
    if len(parts) > 2 or not all(part.isascii() and part.isdigit() for part in parts):
        raise UsageError(f"--per-node {text}: give ids and ranges such as 3 or 0-19")
    first, last = int(parts[0]), int(parts[-1])
    if last > MAX_NODE_ID:
        raise UsageError(f"--per-node {text}: node {last} does not exist; ids are 0 to {MAX_NODE_ID}")
    if last < first:
        raise UsageError(f"--per-node {text}: the range ends before it begins; give {last}-{first}")
    return range(first, last + 1)
