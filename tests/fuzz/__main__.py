"""Fuzz the firmware: ``python -m fuzz --minutes 10``, from the project with ``PYTHONPATH=tests``.

A finding becomes a test when ``xxd -p -c 0`` of its file is added as a line in tests/fuzz/corpus.
"""

from __future__ import annotations

import argparse

from fuzz.harnesses import BUILD, CHECKED, FAST, HARNESSES


def main() -> None:
    """Fuzz with all harnesses, or with one, and try the new inputs again under the address sanitizer."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("harness", nargs="?", choices=HARNESSES, help="only this one")
    parser.add_argument("--minutes", type=float, default=5.0, help="for all together (5)")
    given = parser.parse_args()
    chosen = [given.harness] if given.harness else list(HARNESSES)
    seconds = max(1, round(60 * given.minutes / len(chosen)))
    for name in chosen:
        print(f"{name}: {seconds} s", flush=True)
        inputs = HARNESSES[name].unpack(BUILD / name / "inputs")
        HARNESSES[name].run(inputs, FAST, f"-max_total_time={seconds}")
        HARNESSES[name].run(inputs, CHECKED, "-runs=0")


if __name__ == "__main__":
    main()
