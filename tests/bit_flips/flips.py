"""One flipped bit anywhere in a running robot's memory: what sees it, and what it does.

``python -m bit_flips.flips`` with ``PYTHONPATH=tests`` writes the tables of ``docs/trust.md`` again.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.cost.images import TARGETS, build
from benchmarks.cost.machines import UnicornMachine
from benchmarks.cost.report import fill
from support import CORE, ROOT, TABLE, run

HERE = Path(__file__).parent
PAGE = ROOT / "docs/trust.md"
FLIPS = 50
"""Of each bit, for the published table."""
COUNTS = (
    *(
        "flips",
        "in_time",
        "late",
        "crash",
        "hang",
        "no_effect",
        "less",
        "more",
        "told",
        "still",
        "unexplained",
    ),
    *("at_rest", "at_rest_unseen", "at_rest_wrong"),
)
"""As the program prints them for each member."""
Member = dict[str, int]


def members(folder: Path, flips: int, *flags: str) -> dict[str, Member]:
    """Outcomes of so many flips of each bit, by member."""
    program = folder / "bit_flips"
    run("gcc", "-std=c99", "-O2", f"-I{CORE.parent}", *flags, HERE / "bit_flips.c", TABLE, "-o", program)
    lines = (line.split() for line in run(program, str(flips)).splitlines())
    return {name: dict(zip(COUNTS, map(int, counts), strict=True)) for name, *counts in lines}


def total(found: Iterable[Member]) -> Member:
    """Of all members together."""
    found = list(found)
    return {name: sum(member[name] for member in found) for name in COUNTS}


def table(found: dict[str, Member]) -> str:
    """For the page, in per cent of all flips."""
    shown = ("in_time", "late", "crash", "hang", "no_effect", "less", "more", "still", "told")
    head = (
        *("member", "bits", "seen before x is off", "seen after", "crash", "hang"),
        *("unseen: x right", "less off", "off by 1 %", "so after 600 ticks", "told neighbours"),
    )
    every = total(found.values())
    row = ["all", every["flips"] // FLIPS, *(_share(every, each) for each in shown)]
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in (head, ["---"] * len(head), row))


def _share(member: Member, name: str) -> str:
    share = 100 * member[name] / member["flips"]
    return "" if share == 0 else f"{share:.2g}" if share < 10 else f"{share:.0f}"


def seals(folder: Path) -> dict[str, int]:
    """Instructions of a Cortex-M4 at -O2: a step, the invariants, and a tick's two seals."""
    target = next(each for each in TARGETS if each.name == "Cortex-M4")
    cost = HERE.parent / "benchmarks/cost"
    sources = [cost / "firmware.c", HERE / "sealed.c", *sorted(CORE.parent.glob("*.c")), TABLE]
    kept = [f"-Wl,-u,{name}" for name in ("seal_words", "seal_image", "bench_start", "bench_set")]
    machine = UnicornMachine(build(target, folder / "sealed", sources, "-O2", "-DWHOLE", *kept))
    robot = ("pointer", machine.image.address("robot"))
    machine.call("bench_start", ("word", 0xF3333333))
    machine.call("bench_set", *(("word", number) for number in (1000, 1 << 31, 1000, 700)))
    return {
        "step": machine.call("mcp_asdf_step", robot, ("enum", 1)).instructions,
        "invariants": machine.call("mcp_asdf_invariants_hold", robot).instructions,
        "words": 2 * machine.call("seal_words", robot).instructions,
        "image": 2 * machine.call("seal_image", robot).instructions,
    }


def sealed(found: dict[str, Member], counts: dict[str, int]) -> str:
    """Flips that sealing would detect, and its cost in instructions, for the page."""
    every = total(found.values())
    unseen, wrong = (100 * every[name] / every["at_rest"] for name in ("at_rest_unseen", "at_rest_wrong"))
    return (
        f"Of {every['at_rest']} flips between ticks the invariants miss {unseen:.0f} %, which a seal sees; "
        f"{wrong:.1f} % move x by 1 %.\n"
        f"A tick's two seals take {counts['words']} instructions of a Cortex-M4 as checksums over the robot, "
        f"and {counts['image']} as images\nthat are compared; its step takes {counts['step']}, "
        f"`invariants_hold` {counts['invariants']}."
    )


def page(text: str, found: dict[str, Member], counts: dict[str, int]) -> str:
    """The page with both parts new."""
    return fill(text, {"bit flips": table(found), "sealed robot": sealed(found, counts)})


def main() -> None:
    """Write the page."""
    with TemporaryDirectory() as name:
        found, instructions = members(Path(name), FLIPS), seals(Path(name))
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), found, instructions), encoding="utf-8")


if __name__ == "__main__":
    main()
