"""Makes the tables of docs/internals/cost.md and of the README from the figures that were measured."""

from __future__ import annotations

from support import ROOT

from .images import AVR, TARGETS
from .measurement import BOTH, Build, Figures
from .robots import UPDATED

README, PAGE = ROOT / "README.md", ROOT / "docs/internals/cost.md"
FLASH, RAM = 32 * 1024, 2 * 1024
"""The bytes of flash and of RAM that an ATmega328P has."""
CHIPS = {"ATmega328P": 8, "Cortex-M0+": 48, "Cortex-M4": 64}
"""The targets of the README's table, and the megahertz at which it has their times."""
NEIGHBOURS = 10
"""How many neighbours a robot of the README's table hears in a round."""
CYCLES_PER_INSTRUCTION = 2
"""The cycles that an instruction of a Cortex-M is assumed to take. Only its instructions are counted."""
Measurements = dict[tuple[str, str, Build], Figures]
"""The figures of each build that was measured. The key has the target's name, the level and the build."""
Row = dict[str, str | int]
"""The cells of a row of a table by the titles of their columns."""


def sections(measurements: Measurements) -> dict[str, str]:
    """Return the tables by the names of the sections, in README and PAGE, that contain them."""
    memory, calls = [], []
    for (target, level, build), figures in measurements.items():
        name = f"{target} {level}, {build.name}"
        memory.append(memory_row(name, figures))
        calls.append(call_row(name, figures, unit="cycles" if target == AVR.name else "instructions"))
    chips = [chip_row(name, measurements[name, "-Os", BOTH]) for name in CHIPS]
    return {"cost table": table(chips), "memory": table(memory), "calls": table(calls)}


def compilers() -> str:
    """Return the sentence that names the compilers of the tables and their versions."""
    return f"The compilers are {', '.join(sorted({target.version() for target in TARGETS}))}."


def chip_row(name: str, figures: Figures) -> Row:
    """Return the row of the README's table that has what a robot with the robust filter takes on a chip."""
    calls = {"step": 1, "receive": NEIGHBOURS, "x": 1}
    observation = sum(number * _microseconds(name, figures, call) for call, number in calls.items())
    return {
        "chip and clock": f"{name}, {CHIPS[name]} MHz",
        "flash, bytes": figures.code[0],
        "RAM with stack, bytes": figures.ram + figures.tick_stack(),
        "an observation, µs": f"{observation:.0f}",
        "the filter's test, µs": f"{_microseconds(name, figures, UPDATED):.0f}",
    }


def _microseconds(name: str, figures: Figures, kind: str) -> float:
    """Return how many microseconds the longest call of a kind took at the chip's clock."""
    cycles = figures.largest(kind, "cycles") or CYCLES_PER_INSTRUCTION * figures.largest(kind)
    return cycles / CHIPS[name]


def call_row(name: str, figures: Figures, unit: str) -> Row:
    """Return a row with the largest cost of each call, and the bound of the longest one."""
    costs: Row = {kind: figures.largest(kind, unit) for kind in ("receive", "x", "step", UPDATED)}
    return {"worst observed": name, **costs, "bound of that": figures.bound.get(UPDATED, "")}


def memory_row(name: str, figures: Figures) -> Row:
    """Return a row with the bytes of flash, RAM and stack."""
    return {
        "bytes": name,
        "code": figures.code[0],
        "code with save and restore": figures.code[1],
        "RAM of a robot": figures.ram,
        "stack of a tick": figures.tick_stack(),
        "stack of restore": figures.stack["restore"],
    }


def table(rows: list[Row]) -> str:
    """Return a table in Markdown: rows under their titles."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(map(str, row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def kilobot_row(build: Build, flash: int, ram: int) -> str:
    """Return the row of the shares of its memories that a Kilobot's firmware takes."""
    return f"| {build.name} | {flash / FLASH:.0%} | {ram / RAM:.0%} |"
