"""One flipped bit anywhere in a running robot's memory: what sees it, and what it does.

``python -m bit_flips.flips`` with ``PYTHONPATH=tests`` writes the table of ``docs/trust.md`` again.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.cost.report import fill
from mcp_asdf import Filter
from support import CORE, ROOT, TABLE, run

HERE = Path(__file__).parent
PAGE = ROOT / "docs/trust.md"
FLIPS = 50
"""Of each bit, for the published table."""
FILTERS = (Filter.ADAPTIVE, Filter.ROBUST)
OUTCOMES = ("in_time", "late", "no_effect", "less", "more")
COUNTS = ("flips", *OUTCOMES, "still", "unexplained")
"""As the program prints them for each member."""
Member = dict[str, int]


def members(folder: Path, flips: int, kind: Filter, *flags: str) -> dict[str, Member]:
    """Outcomes of so many flips of each bit of a robot with this filter, by member."""
    program = folder / "bit_flips"
    run("gcc", "-std=c99", "-O2", f"-I{CORE.parent}", *flags, HERE / "bit_flips.c", TABLE, "-o", program)
    lines = (line.split() for line in run(program, str(flips), str(int(kind))).splitlines())
    return {name: dict(zip(COUNTS, map(int, counts), strict=True)) for name, *counts in lines}


def total(found: Iterable[Member]) -> Member:
    """Of all members together."""
    found = list(found)
    return {name: sum(member[name] for member in found) for name in COUNTS}


def table(found: dict[Filter, dict[str, Member]]) -> str:
    """For the page, in per cent of all flips."""
    head = (
        *("filter", "bits", "seen before x is off", "seen after"),
        *("unseen: x right", "less off", "off by 1 %", "so after 600 ticks"),
    )
    rows = []
    for kind, counts in found.items():
        every = total(counts.values())
        shares = (_share(every, each) for each in (*OUTCOMES, "still"))
        rows.append((kind.name.lower(), every["flips"] // FLIPS, *shares))
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in (head, ["---"] * len(head), *rows))


def _share(member: Member, name: str) -> str:
    share = 100 * member[name] / member["flips"]
    return "" if share == 0 else f"{share:.2g}" if share < 10 else f"{share:.0f}"


def main() -> None:
    """Write the table into the page."""
    with TemporaryDirectory() as name:
        found = table({kind: members(Path(name), FLIPS, kind) for kind in FILTERS})
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), {"bit flips": found}), encoding="utf-8")


if __name__ == "__main__":
    main()
