"""Fuzz the firmware: ``python -m fuzz --minutes 10``, from the project with ``PYTHONPATH=tests``."""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from fuzz.harnesses import BUILD, FAST, HARNESSES, Harness, run


def main() -> None:
    """All harnesses or some, for a time or a number of executions each."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("harness", nargs="*", help=f"{', '.join(HARNESSES)} (all)")
    parser.add_argument("--minutes", type=float, default=5.0, help="for all together (5)")
    parser.add_argument("--runs", type=int, help="executions of each, instead of a time")
    parser.add_argument("--seed", type=int, help="of the fuzzer, to do the same again (random)")
    parser.add_argument(
        "--keep", action="store_true", help="write the inputs that reach most into tests/fuzz/corpus"
    )
    given = parser.parse_args()
    unknown = set(given.harness) - set(HARNESSES)
    if unknown:
        parser.error(f"there is no harness {sorted(unknown)[0]}; choose {', '.join(HARNESSES)}")
    chosen = [HARNESSES[name] for name in given.harness] or list(HARNESSES.values())
    seed = random.randrange(1, 1 << 31) if given.seed is None else given.seed
    extent = f"-max_total_time={max(1, round(60 * given.minutes / len(chosen)))}"
    if given.runs is not None:
        extent = f"-runs={given.runs}"
    found = [_fuzz(each, seed, extent, given.keep) for each in chosen]
    sys.exit(any(found))


def _fuzz(harness: Harness, seed: int, extent: str, keeps: bool) -> bool:
    """One harness; then its new inputs once more under the address sanitizer. Whether it found anything."""
    folder = BUILD / "run" / harness.name
    shutil.rmtree(folder, ignore_errors=True)
    harness.unpack(folder)
    program = harness.build(FAST)
    options = (
        f"-seed={seed}",
        f"-max_len={harness.longest}",
        "-entropic=0",
        "-reduce_inputs=0",
        "-timeout=10",
    )
    print(
        f"{harness.name}: {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, seed {seed}, {extent[1:]} ...", flush=True
    )
    begin, used = time.monotonic(), _processor()
    outcome = run(program, folder, *options, extent)
    seconds, used = time.monotonic() - begin, _processor() - used
    rate = outcome.executions / max(used, 1e-3)
    print(
        f"{harness.name}: {outcome.executions} executions in {seconds:.0f} s, {rate:.0f} a second of one core"
    )
    if not outcome.finding:
        outcome = run(harness.build(), folder, "-runs=0")
    if outcome.finding:
        print(f"{harness.name}: FOUND {outcome.finding.hex()}\n{outcome.said[-2000:]}")
        print(f"add that line to {harness.corpus} and run pytest tests/fuzz to see it again")
    elif keeps:
        _minimise(harness, program, folder)
    return bool(outcome.finding)


def _processor() -> float:
    """Seconds that programs started here have computed."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


def _minimise(harness: Harness, program: Path, folder: Path) -> None:
    """Keep the fewest inputs that reach what all together reach."""
    merged = folder.with_name(f"{folder.name}-merged")
    shutil.rmtree(merged, ignore_errors=True)
    merged.mkdir()
    subprocess.run((program, "-set_cover_merge=1", merged, folder), check=True, capture_output=True)
    harness.keep(merged)
    print(f"{harness.name}: {len(harness.corpus.read_text().split())} inputs kept")


if __name__ == "__main__":
    main()
