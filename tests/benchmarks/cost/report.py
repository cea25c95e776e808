"""The tables of docs/cost.md and of the README, from the figures."""

from __future__ import annotations

import re
from pathlib import Path

from .images import AVR, KILOBOT_CLOCK, LEVELS, ROOT, TARGETS
from .measurement import STACK_CALLS, Figures
from .robots import SHORT, TESTED, UPDATED

README, PAGE = ROOT / "README.md", ROOT / "docs/cost.md"
PAGES = (README, PAGE)
FLASH, RAM = 32 * 1024, 2 * 1024
"""Bytes of an ATmega328P."""
Cells = dict[tuple[str, str], Figures]
"""Measurements by target and level."""
Rows = dict[str, str]
"""A target's column by title."""


def fill(text: str, sections: dict[str, str]) -> str:
    """The text with new sections between ``<!-- NAME -->`` and ``<!-- end of NAME -->``.

    Raises ValueError if a section has no such lines.
    """
    for name, section in sections.items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        if text.count(start) != 1 or text.count(end) != 1:
            raise ValueError(f"there is no {start} or {end}, or more than one")
        head, rest = text.split(start)
        text = f"{head}{start}\n{section}\n{end}{rest.split(end)[1]}"
    return text


def sections(cells: Cells, kilobot: tuple[int, int]) -> dict[Path, dict[str, str]]:
    """For every page what stands between its markers."""
    columns = {target.name: (cells[target.name, "-Os"], cells[target.name, "-O2"]) for target in TARGETS}
    short = {name: short_column(*both) for name, both in columns.items()}
    calls = {f"{name} {level}": call_column(cells[name, level]) for name in columns for level in LEVELS}
    memory = {name: memory_column(*both) for name, both in columns.items()}
    return {
        README: {"cost table": f"{table('at -O2', short)}\n\n{_kilobot(cells[AVR.name, '-Os'], kilobot)}"},
        PAGE: {
            "calls": table("worst observed : bound", calls, transposed=True),
            "memory": table("bytes", memory),
        },
    }


def short_column(small: Figures, fast: Figures) -> Rows:
    """The README's figures of a target."""
    said = {"step": "step with 10 neighbours", "receive": "receive", "x": "x", UPDATED: UPDATED}
    times = {
        kind: f"{fast.times[kind]:.1f}" if kind in fast.times else "none" for kind in ("double", "float")
    }
    return {
        **{
            f"{each}: mean (max)": f"{fast.mean[name]:.0f} ({fast.most[name]})" for name, each in said.items()
        },
        **{f"plain {kind} C, step and x: times as many": each for kind, each in times.items()},
        "code without save and restore: bytes of flash, -Os (-O2)": f"{small.code[0]} ({fast.code[0]})",
        "RAM of a robot, bytes": str(fast.ram),
        "deepest stack of a tick, bytes": str(fast.tick_stack()),
    }


def call_column(found: Figures) -> Rows:
    """The most instructions of calls, with bounds where there are any; cycles where they are counted."""
    rows = {}
    for name in ("step", SHORT, TESTED, UPDATED, "receive", "x"):
        bound = f" : {found.bound[name]}" if name in found.bound else ""
        cycles = f", {found.cycles[name]} cycles" if found.cycles[name] else ""
        rows[name] = f"{found.most[name]}{bound}{cycles}"
    return {**rows, "divisions": str(found.divisions)}


def memory_column(small: Figures, fast: Figures) -> Rows:
    """Bytes of a target at -Os / -O2."""
    return {
        "code": f"{small.code[0]} / {fast.code[0]}",
        "all code, save and restore among it": f"{small.code[1]} / {fast.code[1]}",
        "RAM of a robot": str(fast.ram),
        "stack of a tick": f"{small.tick_stack()} / {fast.tick_stack()}",
        **{f"stack of {name}": f"{small.stack[name][0]} / {fast.stack[name][0]}" for name in STACK_CALLS[6:]},
    }


def _kilobot(avr: Figures, kilobot: tuple[int, int]) -> str:
    compilers = ", ".join(sorted({target.version() for target in TARGETS}))
    flash, ram = kilobot
    rates = (KILOBOT_CLOCK // round(1.05 * avr.cycles[name]) for name in ("step", UPDATED))  # 5 % in reserve
    return (
        f"With {compilers}. A t-table takes 12 + 4 q bytes of flash. A whole Kilobot (ATmega328P, -Os:\n"
        f"core, t-table, frames, main loop, radio) takes {flash / FLASH:.0%} of its flash and "
        f"{ram / RAM:.0%} of its RAM, stack included; at 8 MHz it\ntakes at least {next(rates)} "
        f"steps per second, or {next(rates)} if each of them tests and updates."
    )


def table(corner: str, columns: dict[str, Rows], transposed: bool = False) -> str:
    """A table of one column for each target, or of one row."""
    titles = list(next(iter(columns.values())))
    cells = [[corner, *columns], *([title, *(rows[title] for rows in columns.values())] for title in titles)]
    rows = ["| " + " | ".join(row) + " |" for row in (zip(*cells, strict=True) if transposed else cells)]
    return "\n".join([rows[0], "|---" * (rows[0].count("|") - 1) + "|", *rows[1:]])


Numbers = dict[tuple[str, str], list[float]]
"""Numbers in each cell of a table, by titles of its row and its column."""


def read(path: Path, section: str) -> Numbers:
    """The table of a page between its markers."""
    _, _, after = path.read_text(encoding="utf-8").partition(f"<!-- {section} -->\n")
    return numbers(re.split(r"\n\n|\n<!--", after)[0])


def numbers(text: str) -> Numbers:
    """Numbers of a table, without its words."""
    head, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines())
    return {
        (row[0], title): [float(each) for each in re.findall(r"[\d.]+", cell)]
        for row in rows
        for title, cell in zip(head[1:], row[1:], strict=True)
    }
