"""``mcp-asdf dbc``: write a DBC file of the frames."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_text
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.cli.again import json_report
from mcp_asdf_tools.common.files import write_atomically

EPILOG = f"""\
examples:
  mcp-asdf dbc                                      # to the screen
  mcp-asdf dbc --output mcp_asdf.dbc                # one entry for each kind of frame, for any node
  mcp-asdf dbc --per-node 0 1 2 --output swarm.dbc # an entry for each kind and node
The entries for any node are those of node 0: let the tool ignore the lower 8 bits of the identifier,
`cantools decode -m {ANY_NODE_MASK:#X} mcp_asdf.dbc`. Where a tool cannot, use --per-node.
exit code: 0 done, 2 bad usage"""

_DEFAULTS = FrameFormat()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of the command."""
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="write this file (default: standard output)"
    )
    parser.add_argument(
        "--per-node",
        metavar="ID",
        type=int,
        nargs="+",
        help="nodes with entries of their own: ids 0 to 127",
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
    """Write the DBC file, or print its text without ``--output``; return exit code 0."""
    text = dbc_text(FrameFormat(args.subject, args.priority), args.per_node)
    if args.output is not None:
        write_atomically(args.output, text)
    if args.json:
        path = None if args.output is None else str(args.output)
        print(json_report({"file": path, "dbc": text}))
    elif args.output is None:
        sys.stdout.write(text)
    else:
        print(f"wrote {args.output}")
    return 0
