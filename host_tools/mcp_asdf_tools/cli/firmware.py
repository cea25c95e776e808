"""``mcp-asdf firmware``: write the C firmware, a t-table and build files into a project."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report

EPILOG = """\
examples:
  mcp-asdf firmware vendor/mcp_asdf                       # core, the paper's table, build files
      wrote 25 files into vendor/mcp_asdf
  mcp-asdf firmware vendor/mcp_asdf --neighbours 30       # a smaller table: 132 bytes of flash, not 520
With CMake: add_subdirectory(vendor/mcp_asdf), link mcp_asdf::mcp_asdf. Without: compile all .c files there.
If a CMake project has several such folders, the first makes the library, and each adds its table.
A second run replaces the files and leaves one table. It stops if you have changed a file (sha256sums.txt).
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
    """Declare the folder to be written, ``--force``, to replace changed files, and the t-table's options."""
    parser.add_argument(
        "folder", metavar="DIR", type=Path, help="folder for the files; it is made if it does not exist"
    )
    parser.add_argument(
        "--force", action="store_true", help="also replace files that were changed since they were written"
    )
    options.add_table_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write the files into the folder, and print their number and how to use them; return exit code 0.

    With --json their names are printed instead. Raises UsageError for an omega or a number of neighbours that
    no table has, if a file cannot be written or, without --force, if one was changed.
    """
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
