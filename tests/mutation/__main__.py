"""Make small mistakes in sources, one at a time, and name those that no test of their package notices.

Examples:
  python -m mutation host_tools/mcp_asdf_tools/radio/*.py --sample 40
  python -m mutation c_ref/src/mcp_asdf_frame.c
"""

from __future__ import annotations

import argparse
import random
import sys
from pathlib import Path

from mutation import c_killers, python_killers
from mutation.mutants import mistakes


def is_noticed(path: Path, source: str) -> bool:
    """Return whether a test of its package fails if a file has another text."""
    if path.suffix == ".py":
        return python_killers.is_noticed(path, source)
    return c_killers.is_noticed(path, source)


def main() -> None:
    """Try all mutants, or some at random, and print those that survive. The exit code is 1 if any does."""
    parser = argparse.ArgumentParser(
        prog="python -m mutation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", nargs="+", type=Path, help="source in C or Python")
    parser.add_argument("--sample", type=int, metavar="N", help="try N mistakes, at random")
    args = parser.parse_args()
    tried_mutants = [mutant for file in args.file for mutant in mistakes(file.resolve())]
    if args.sample is not None:
        tried_mutants = random.sample(tried_mutants, min(args.sample, len(tried_mutants)))
    # If tests failed without a mistake, they would seem to notice any. One file stands for its folder.
    for path in {mutant.path.parent: mutant.path for mutant in tried_mutants}.values():
        if is_noticed(path, path.read_text(encoding="utf-8")):
            parser.error(f"tests of {path} fail without a mistake, too: run and mend them first")
    survivor_count = 0
    for mutant in tried_mutants:
        if not is_noticed(mutant.path, mutant.source()):
            survivor_count += 1
            print("survives:", mutant.name, flush=True)
    print(f"{len(tried_mutants)} mutants, {survivor_count} survive")
    sys.exit(bool(survivor_count))


if __name__ == "__main__":
    main()
