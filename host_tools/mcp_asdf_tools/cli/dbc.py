"""``mcp-asdf dbc``: write a DBC file of the frames."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mcp_asdf_tools.bus.dbc import ANY_NODE_MASK, dbc_text
from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report

EPILOG = f"""\
examples:
  mcp-asdf dbc                                      # to the screen
  mcp-asdf dbc --output mcp_asdf.dbc                # one entry for each kind of frame, for any node
  mcp-asdf dbc --per-node 0 1 2 --output swarm.dbc # an entry for each kind and node
The entries for any node are those of node 0: let the tool ignore the lower 8 bits of the identifier,
`cantools decode -m {ANY_NODE_MASK:#X} mcp_asdf.dbc`. Where a tool cannot, use --per-node.
exit code: 0 done, 2 bad usage"""
LIBRARIES = ()


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
    options.add_estimate_format(parser)


def run(args: argparse.Namespace) -> int:
    """Write the DBC file, or print its text without ``--output``; return exit code 0."""
    from mcp_asdf_tools.common.files import write_atomically

    dbc_content = dbc_text(options.estimate_format_of(args), args.per_node)
    if args.output is not None:
        write_atomically(args.output, dbc_content)
    if args.json:
        path_text = None if args.output is None else str(args.output)
        print(json_report({"file": path_text, "dbc": dbc_content}))
    elif args.output is None:
        sys.stdout.write(dbc_content)
    else:
        print(f"wrote {args.output}")
    return 0
