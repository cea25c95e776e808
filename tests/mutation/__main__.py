"""Make small mistakes in Python files, one at a time, and see whether the tests of the package notice them.

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
from mutation.python_killers import folders_with_tests_of, is_noticed, run_baseline
from mutation.python_mutants import Mutant, mutants


def choose_mutants(paths: list[str], sample: int | None = None, seed: int = 0) -> list[Mutant]:
    """Return the mutants of files and folders; ``FILE#NUMBER`` is a single one.

    With ``sample``, as many are drawn from all of them at random. Mutants that are listed as equivalent are
    left out, also of a sample.
    """
    all_mutants: list[Mutant] = []
    for path in paths:
        file, _, number = path.partition("#")
        all_mutants += [mutant for mutant in mutants(Path(file)) if number in ("", str(mutant.number))]
    if sample is not None:
        all_mutants = random.Random(seed).sample(all_mutants, min(sample, len(all_mutants)))
    return [mutant for mutant in all_mutants if mutant.name not in equivalents("python")]


def print_survivors(
    tried_mutants: list[Mutant], test_folders: list[Path] | None = None, with_slow: bool = False
) -> int:
    """Print a line for each mutant that no test notices, which names and repeats it; return their number.

    The tests are those of each mutant's package, or those of ``test_folders``; slow ones only count
    ``with_slow``. A test that fails without a mistake is named, too.
    """
    folders_by_mutant = {
        mutant: test_folders or folders_with_tests_of(mutant.path) for mutant in tried_mutants
    }
    all_folders = [folder for folders in folders_by_mutant.values() for folder in folders]
    baseline = run_baseline(tried_mutants, all_folders, marks="" if with_slow else "not slow")
    for test_id in baseline.failed:
        print(f"fails without a mistake, and is left out: {test_id}", flush=True)
    survivor_count = 0
    for tried_count, (mutant, folders) in enumerate(folders_by_mutant.items(), start=1):
        if not is_noticed(mutant, baseline, folders):
            survivor_count += 1
            note = "" if baseline.tests_that_run(mutant, folders) else " (no test runs it)"
            print(f"survives: {mutant} {mutant.name}{note}", flush=True)
        if sys.stderr.isatty():
            print(f"\r{tried_count} of {len(tried_mutants)} ", end="", file=sys.stderr)
    return survivor_count


def main() -> None:
    """Try all mutants, or some at random, and print those that survive. The exit code is 1 if any does."""
    parser = argparse.ArgumentParser(
        prog="python -m mutation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "path", nargs="*", default=["host_tools/mcp_asdf_tools"], help="file, folder, FILE#NUMBER"
    )
    parser.add_argument("--sample", type=int, metavar="N", help="try N of them, at random")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 32), help="of the sample")
    parser.add_argument(
        "--tests", nargs="+", type=Path, metavar="PATH", help="instead of the package's tests"
    )
    parser.add_argument("--slow", action="store_true", help="let slow tests count, too")
    args = parser.parse_args()
    if args.sample is not None:
        print(f"seed {args.seed}")
    tried_mutants = choose_mutants(args.path, args.sample, args.seed)
    survivor_count = print_survivors(tried_mutants, args.tests, args.slow)
    print(f"{len(tried_mutants)} mutants, {survivor_count} survive")
    sys.exit(bool(survivor_count))


if __name__ == "__main__":
    main()
