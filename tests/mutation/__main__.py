"""Plant small mistakes in Python and see whether the tests of the room notice.

Examples:
  python -m mutation host_tools/mcp_asdf_tools/radio --sample 40 --seed 1
  python -m mutation firmware_py/mcp_asdf/mirror.py --tests tests/firmware_py
  python -m mutation host_tools/mcp_asdf_tools/bus/dbc.py#17          # one of them again
"""

from __future__ import annotations

import argparse
import random
import sys
from pathlib import Path

from mutation.equivalents import equivalents
from mutation.python_killers import dies, record, tests_of
from mutation.python_mutants import Mutant, mutants


def chosen(paths: list[str], sample: int | None = None, seed: int = 0) -> list[Mutant]:
    """Mutants of files and folders, each ``FILE#NUMBER`` alone; a random sample of all if that is given.

    Mutants that are listed as equivalent are left out.
    """
    found: list[Mutant] = []
    for path in paths:
        file, _, number = path.partition("#")
        found += [each for each in mutants(Path(file)) if number in ("", str(each.number))]
    if sample is not None:
        found = random.Random(seed).sample(found, min(sample, len(found)))
    return [each for each in found if each.name not in equivalents("python")]


def survivors(of: list[Mutant], tests: list[Path] | None = None, with_slow: bool = False) -> list[str]:
    """Lines that name and replay the mutants that pass the tests of their room, or these tests."""
    folders = {each: tests or tests_of(each.path) for each in of}
    marks = "" if with_slow else "not slow"
    known = record(of, (folder for each in folders.values() for folder in each), marks)
    for test in known.failed:
        print(f"fails without a mistake, and is left out: {test}", flush=True)
    lines = []
    for number, mutant in enumerate(of, 1):
        if not dies(mutant, known, folders[mutant]):
            idle = "" if known.running(mutant, folders[mutant]) else " (no test runs it)"
            lines.append(f"survives: {mutant} {mutant.name}{idle}")
            print(lines[-1], flush=True)
        if sys.stderr.isatty():
            print(f"\r{number} of {len(of)} ", end="", file=sys.stderr)
    return lines


def main() -> None:
    """Try all mutants, or some at random, and print what survives."""
    parser = argparse.ArgumentParser(
        prog="python -m mutation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "path", nargs="*", default=["host_tools/mcp_asdf_tools"], help="file, folder, FILE#NUMBER"
    )
    parser.add_argument("--sample", type=int, metavar="N", help="try N of them, at random")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 32), help="of the sample")
    parser.add_argument("--tests", nargs="+", type=Path, metavar="PATH", help="instead of those of the room")
    parser.add_argument("--slow", action="store_true", help="let slow tests count, too")
    given = parser.parse_args()
    if given.sample is not None:
        print(f"seed {given.seed}")
    tried = chosen(given.path, given.sample, given.seed)
    survived = survivors(tried, given.tests, given.slow)
    print(f"{len(tried)} mutants, {len(survived)} survive")
    sys.exit(bool(survived))


if __name__ == "__main__":
    main()
