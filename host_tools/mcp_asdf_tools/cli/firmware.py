"""``mcp-asdf firmware``: write the C firmware, a t-table and build files into a project."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report

EPILOG = """\
examples:
  mcp-asdf firmware vendor/mcp_asdf                       # core, the paper's table, build files
  mcp-asdf firmware vendor/mcp_asdf --neighbours 30       # a shorter table: 372 bytes of flash
With CMake: add_subdirectory(vendor/mcp_asdf), link mcp_asdf::mcp_asdf. Without: compile all .c files there.
Of several such folders in one CMake project the first makes the library, and each adds its table.
Its own files it replaces, and leaves one table; sha256sums.txt says which files are as they were written.
exit code: 0 done, 2 bad usage"""
LIBRARIES = ("mpmath",)

_USAGE = """\
The table is: extern const uint32_t {symbol}[];
A robot's filter: static const mcp_asdf_config_t config = MCP_ASDF_CONFIG_ROBUST;
  or, where you doubt its sensor, MCP_ASDF_CONFIG_ASDF({symbol}), and
  where its sensor is calibrated, MCP_ASDF_CONFIG_OFF
Its sensor is right 95 times in 100: b_hat is MCP_ASDF_PROBABILITY(95, 100)
Its answer, to be printed: mcp_asdf_thousandths(mcp_asdf_x(&robot))"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of the command."""
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder for the files, made if need be")
    parser.add_argument("--force", action="store_true", help="also replace files that somebody has changed")
    options.add_table_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write the files into the folder, and print their names and how to use them; return exit code 0."""
    from mcp_asdf_tools.tables.firmware_folder import write_firmware
    from mcp_asdf_tools.tables.table_files import describe_table

    omega, q = options.table_of(args)
    files = [str(path) for path in write_firmware(omega, q, args.folder, args.force)]
    symbol = describe_table(omega, q)["symbol"]
    if args.json:
        print(json_report({"files": files, "symbol": symbol}))
    else:
        print(f"wrote {len(files)} files into {args.folder}")
        print(_USAGE.format(symbol=symbol))
    return 0
