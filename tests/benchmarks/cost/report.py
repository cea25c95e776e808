"""The tables of docs/internals/cost.md, with a row for each target or level, and the README's table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .images import AVR, KILOBOT_CLOCK, ROOT, TARGETS
from .measurement import Cost, Figures
from .robots import UPDATED

README, PAGE = ROOT / "README.md", ROOT / "docs/internals/cost.md"
FLASH, RAM = 32 * 1024, 2 * 1024
"""Bytes of an ATmega328P."""
CHIPS = {"ATmega328P": 8, "Cortex-M0+": 48, "Cortex-M4": 64}
"""The targets of the README's table, and the megahertz at which it has their times."""
NEIGHBOURS = 10
"""How many neighbours a robot of the README's table hears in a round."""
CYCLES_PER_INSTRUCTION = 2
"""Assumed for a Cortex-M, whose instructions alone are counted."""
Cells = dict[tuple[str, str], Cost]
"""Measurements by the names of target and level."""
Kilobots = tuple[tuple[int, int], ...]
"""Bytes of flash and of RAM: with the paper's filter alone, with both, with the robust one alone."""
Row = dict[str, str]
"""Cells by the titles of their columns."""


def fill(text: str, sections: dict[str, str]) -> str:
    """Return the text with new sections between ``<!-- NAME -->`` and ``<!-- end of NAME -->``.

    Raises ValueError if a section has no such lines.
    """
    for name, section in sections.items():
        before, mark, after = text.partition(f"<!-- {name} -->\n")
        text = before + mark + section + after.removeprefix(section_in(text, name))
    return text


def section_in(text: str, name: str) -> str:
    """Return what stands between ``<!-- NAME -->`` and ``<!-- end of NAME -->``, which must be there once."""
    start, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
    if text.count(start) != 1 or text.count(end) != 1:
        raise ValueError(f"there is no {start} or {end}, or more than one")
    return text.partition(start)[2].partition(end)[0]


def sections(cells: Cells, kilobots: Kilobots) -> dict[Path, dict[str, str]]:
    """Return for each page what stands between its markers, from measurements of all targets and levels."""
    texts = {name: table(rows) for name, rows in rows_by_table(cells).items()}
    texts["targets"] += f"\n\n{_kilobot(cells[AVR.name, '-Os'].paper_alone, kilobots)}"
    return {README: {"cost table": texts.pop("cost table")}, PAGE: texts}


def rows_by_table(cells: Cells) -> dict[str, list[Row]]:
    """Return the rows that measurements give in each table of the pages, by the names of the tables."""

    def rows(row: Callable[[str, Cost], Row]) -> list[Row]:
        return [
            row(f"{name} {level}", cost) for (name, level), cost in cells.items() if is_in_page(name, level)
        ]

    chips = {name: cost for (name, level), cost in cells.items() if level == "-Os" and name in CHIPS}
    fast = {name: cost for (name, level), cost in cells.items() if level == "-O2"}
    return {
        "cost table": [chip_row(name, cost.robust) for name, cost in chips.items()],
        "targets": [short_row(name, cost.paper_alone) for name, cost in fast.items()],
        "calls": rows(lambda name, cost: call_row("paper's filter", name, cost.paper_alone)),
        "memory": rows(lambda name, cost: memory_row(name, cost.paper_alone)),
        "robust calls": rows(lambda name, cost: call_row("robust filter", name, cost.robust_alone)),
        "robust memory": rows(lambda name, cost: filter_memory_row(name, cost.robust, cost.robust_alone)),
    }


def is_in_page(name: str, level: str) -> bool:
    """Return whether docs/internals/cost.md has the build.

    A Cortex-M3 has nearly the figures of a Cortex-M4, and one chip shows what -O2 gains.
    """
    return name != "Cortex-M3" and (level == "-Os" or name == "Cortex-M4")


def chip_row(name: str, figures: Figures) -> Row:
    """Return the row of the README's table for a chip: what a robot with the robust filter takes there."""
    calls = {"step": 1, "receive": NEIGHBOURS, "x": 1}
    observation = sum(number * _microseconds(name, figures, call) for call, number in calls.items())
    return {
        "chip and clock": f"{name}, {CHIPS[name]} MHz",
        "flash, bytes": str(figures.code[0]),
        "RAM with stack, bytes": str(figures.ram + figures.tick_stack()),
        "an observation, µs": f"{observation:.0f}",
        "the filter's test, µs": f"{_microseconds(name, figures, UPDATED):.0f}",
    }


def _microseconds(name: str, figures: Figures, kind: str) -> float:
    """Return how many microseconds the longest call of a kind took at the chip's clock."""
    cycles = figures.largest(kind, "cycles") or CYCLES_PER_INSTRUCTION * figures.largest(kind)
    return cycles / CHIPS[name]


def short_row(name: str, fast: Figures) -> Row:
    """Return the row of a target: its mean cost with the paper's filter alone, beside plain C."""
    titles = {"step": "step with 10 neighbours", "receive": "receive", "x": "x", UPDATED: UPDATED}
    times = {
        kind: f"{fast.times[kind]:.1f}" if kind in fast.times else "none" for kind in ("double", "float")
    }
    return {
        "instructions at -O2, mean": name,
        **{title: f"{fast.mean[kind]:.0f}" for kind, title in titles.items()},
        "plain C, double, times as many": times["double"],
        "plain C, float, times as many": times["float"],
    }


def call_row(filter_name: str, name: str, figures: Figures) -> Row:
    """Return a row with the most instructions of calls, or on an AVR the most cycles."""
    unit = "cycles" if name.startswith(AVR.name) else "instructions"
    calls = {kind: str(figures.largest(kind, unit)) for kind in ("step", UPDATED, "receive", "x")}
    return {f"{filter_name} alone, worst observed": name, **calls}


def memory_row(name: str, figures: Figures) -> Row:
    """Return a row with the bytes of flash, RAM and stack."""
    bytes_of = {
        "code": figures.code[0],
        "code with save and restore": figures.code[1],
        "RAM of a robot": figures.ram,
        "stack of a tick": figures.tick_stack(),
        "stack of restore": figures.stack["restore"],
        "stack of invariants_hold": figures.stack["invariants_hold"],
    }
    return {"bytes, paper's filter alone": name, **{title: str(each) for title, each in bytes_of.items()}}


def filter_memory_row(name: str, both: Figures, alone: Figures) -> Row:
    """Return flash, RAM and stack in bytes, with both filters built and with the robust one alone."""
    bytes_of = {
        "code, both filters": both.code[0],
        "code, robust filter alone": alone.code[0],
        "RAM of a robot": both.ram,
        "stack of a tick, both filters": both.tick_stack(),
        "stack of a tick, robust filter alone": alone.tick_stack(),
    }
    return {"bytes": name, **{title: str(each) for title, each in bytes_of.items()}}


def table(rows: list[Row]) -> str:
    """Return a table in Markdown: rows under their titles."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _kilobot(avr: Figures, kilobots: Kilobots) -> str:
    compilers = ", ".join(sorted({target.version() for target in TARGETS}))
    paper, both, alone = map(share, kilobots)
    rates = (
        KILOBOT_CLOCK // round(1.05 * avr.largest(kind, "cycles")) for kind in ("step", UPDATED)
    )  # 5 % spare
    return (
        f"The compilers are {compilers}.\n\n"
        "A whole Kilobot (ATmega328P, -Os) takes\n\n"
        f"- {paper} with the paper's filter,\n"
        f"- {alone} with the robust filter,\n"
        f"- {both} with both.\n\n"
        f"At 8 MHz it takes at least {next(rates)} steps per second with the paper's filter, "
        f"or {next(rates)} if each of them tests."
    )


def share(kilobot: tuple[int, int]) -> str:
    """Return the shares of its memories that a Kilobot's firmware takes."""
    return f"{kilobot[0] / FLASH:.0%} of its flash and {kilobot[1] / RAM:.0%} of its RAM"
