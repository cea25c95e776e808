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
  mcp-asdf dbc --output mcp_asdf.dbc                # entries for any node
      wrote mcp_asdf.dbc
  mcp-asdf dbc --per-node 0 1 2 --output swarm.dbc  # entries for each kind of frame and node
Entries for any node have the identifiers of node 0. Tell your tool to ignore the lower 8 bits, as in
`cantools decode -m {ANY_NODE_MASK:#X} mcp_asdf.dbc`. If it cannot, use --per-node.
exit code: 0 done, 2 bad usage"""
LIBRARIES = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``--output``, ``--per-node``, nodes with entries of their own, and the format of estimates."""
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="write to this file (default: standard output)"
    )
    parser.add_argument(
        "--per-node",
        metavar="ID",
        type=int,
        nargs="+",
        help="write entries for each of these nodes, ids 0 to 127 (default: entries for any node)",
    )
    options.add_estimate_format(parser)


def run(args: argparse.Namespace) -> int:
    """Write the DBC file and print its path, or print its text without ``--output``; return exit code 0.

    With --json path and text are printed as JSON in either case. Raises UsageError for nodes or a format that
    are impossible, and if the file cannot be written.
    """
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
