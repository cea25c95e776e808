"""The tables of docs/cost.md and of the README, from the figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

from .budgets import AVR, BUDGETS, measured, most, stack_of_tick
from .demo import CLOCK, FLASH, RAM
from .images import LEVELS, ROOT
from .measurement import OTHER_CALLS, STEPS, TICK_CALLS, Figures
from .robots import SHORT, UNITS, UPDATED

README, PAGE = (ROOT / name for name in ("README.md", "docs/cost.md"))
USUAL = "step, m = 10"
"""The step that stands for all in short tables."""
_RESERVE = 1.05
"""On top of the most cycles that a search found, where a rate is said to hold at least: it proves no most."""


def pages(figures: Figures) -> dict[Path, dict[str, str]]:
    """For every page what stands between its markers."""
    return {
        README: {"cost table": _short(figures)},
        PAGE: {
            "compilers": _compilers(figures),
            "budgets": _budgets(figures),
            "memory": _memory(figures),
            **{f"calls on {name}": _calls(levels) for name, levels in figures["targets"].items()},
            "baselines": _baselines(figures),
            "stack": _stack(figures),
            "bounds": _bounds(figures),
            "static bounds": _static_bounds(figures),
            "static bounds of all calls": _all_bounds(figures),
            "longest steps": _longest_steps(figures),
            "integers on an AVR": _on_avr(figures),
            "whole firmware": _whole_firmware(figures),
        },
    }


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


def filled(figures: Figures) -> dict[Path, str]:
    """All pages with new sections. Raises ValueError as ``fill`` does."""
    return {
        path: fill(path.read_text(encoding="utf-8"), sections) for path, sections in pages(figures).items()
    }


# ---- Tables ----


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    lines = ["| " + " | ".join(map(str, cells)) + " |" for cells in (list(head), *rows)]
    return "\n".join([lines[0], "|---" * (lines[0].count("|") - 1) + "|", *lines[1:]])


def _short(figures: Figures) -> str:
    targets = figures["targets"]
    cores = [levels["-O2"]["firmware"] for levels in targets.values()]

    def instructions(title: str, mean_of: str, most_of: str) -> list[object]:
        spans = [
            f"{core['calls'][mean_of]['instructions'][1]:.0f} ({most(core['calls'], most_of)})"
            for core in cores
        ]
        return [title, *spans]

    rows: list[list[object]] = [
        instructions("step with 10 neighbours: instructions, mean (max)", USUAL, "step"),
        ["step: cycles, max", *(_cycles(name, core) for name, core in zip(targets, cores, strict=True))],
        instructions("receive: instructions, mean (max)", "receive", "receive"),
        instructions("x: instructions, mean (max)", "x", "x"),
        instructions("step with test and update: instructions, mean (max)", UPDATED, UPDATED),
        *(
            [f"plain {kind} C, step and x: times as many instructions", *_ratios(targets, kind)]
            for kind in ("double", "float")
        ),
        ["code without save and restore: bytes of flash, -Os (-O2)", *map(_code, targets.values())],
        ["RAM of a robot, bytes", *(core["ram"] for core in cores)],
        ["deepest stack of a tick, bytes", *(stack_of_tick(core) for core in cores)],
    ]
    return f"{_table(['at -O2', *targets], rows)}\n\n{_kilobot(figures)}"


def _kilobot(figures: Figures) -> str:
    demo, calls = figures["demo"], figures["targets"][AVR]["-Os"]["firmware"]["calls"]
    steps, updates = (_at_least(_reserved(most(calls, name, "cycles"))) for name in ("step", UPDATED))
    flash, ram = demo["flash"] / FLASH, (demo["variables"] + demo["stack"]) / RAM
    fixed, per_entry = figures["table"]
    compilers = ", ".join(sorted(set(figures["compilers"].values())))
    return (
        f"With {compilers}. ~ marks estimates from above.\n"
        f"A t-table takes {fixed} + {per_entry} q bytes of flash. "
        f"A whole Kilobot (ATmega328P, -Os: core, t-table, frames, main loop, radio)\n"
        f"takes {flash:.0%} of its flash and {ram:.0%} of its RAM, stack included; at 8 MHz it takes at "
        f"least {steps} steps per second,\nor {updates} if each of them tests and updates."
    )


def _reserved(cycles: int) -> int:
    return math.ceil(_RESERVE * cycles)


def _at_least(cycles: int) -> int:
    """Times per second."""
    return CLOCK // cycles


def _cycles(target: str, core: Figures) -> str:
    return f"{'' if target == AVR else '~ '}{most(core['calls'], 'step', 'cycles')}"


def _ratios(targets: Figures, kind: str) -> list[object]:
    return [_ratio(levels["-O2"], kind) for levels in targets.values()]


def _ratio(figures: Figures, kind: str) -> str:
    """Instructions of the baseline's step and x in those of the firmware's."""
    if kind not in figures:
        return "none"
    plain, own = (
        sum(figures[robot]["calls"][name]["instructions"][1] for name in (USUAL, "x"))
        for robot in (kind, "firmware")
    )
    return f"{plain / own:.1f}"


def _code(levels: Figures) -> str:
    return f"{levels['-Os']['flash']['least']} ({levels['-O2']['flash']['least']})"


def _compilers(figures: Figures) -> str:
    return _table(["target", "compiler"], figures["compilers"].items())


def _budgets(figures: Figures) -> str:
    rows = ([budget.target, budget.what, budget.limit, measured(budget, figures)] for budget in BUDGETS)
    return _table(["target", "what", "limit", "measured"], rows)


def _memory(figures: Figures) -> str:
    fixed, per_entry = figures["table"]
    rows = [
        [
            name,
            *(levels[level]["flash"][kind] for kind in ("least", "whole") for level in LEVELS),
            levels["-O2"]["firmware"]["ram"],
            *(stack_of_tick(levels[level]["firmware"]) for level in LEVELS),
        ]
        for name, levels in figures["targets"].items()
    ]
    head = [f"{what}, {level}" for what in ("code", "all code") for level in LEVELS]
    table = _table(["bytes", *head, "RAM", *(f"stack, {level}" for level in LEVELS)], rows)
    return f"{table}\n\nA t-table takes {fixed} + {per_entry} q bytes: {fixed + 30 * per_entry} for q = 30."


def _calls(levels: Figures) -> str:
    head = [f"{level}: {unit}" for level in LEVELS for unit in UNITS]
    names = levels["-O2"]["firmware"]["calls"]
    rows = [
        [
            name,
            *(_span(levels[level]["firmware"]["calls"][name][unit]) for level in LEVELS for unit in UNITS),
        ]
        for name in sorted(names, key=_order)
    ]
    return _table(["call", *head], rows)


def _order(name: str) -> tuple[int, int]:
    firsts = (
        "observe",
        "receive",
        "settle",
        "settle, filter due",
        "step, m",
        SHORT,
        "step with test",
        UPDATED,
        "x",
        "encode",
        "decode",
    )
    number = re.search(r"\d+", name)
    first = max((first for first in firsts if name.startswith(first)), key=len)
    return firsts.index(first), int(number[0]) if number else 0


def _span(span: list[float]) -> str:
    least, mean, most_ = span
    return f"{least:.0f} / {mean:.0f} / {most_:.0f}"


def _baselines(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        both = levels["-O2"]
        for kind in ("double", "float"):
            if kind in both:
                rows.append([name, kind, *_compared(both, levels["-Os"], kind)])
    head = ("target", "type", "step and x", "receive", UPDATED, "flash at -Os", "RAM", "stack")
    return _table(head, rows)


def _compared(figures: Figures, small: Figures, kind: str) -> list[str]:
    own, plain = figures["firmware"], figures[kind]

    def cell(own_value: float, plain_value: float) -> str:
        return f"{plain_value:.0f} : {own_value:.0f} = {plain_value / own_value:.1f}"

    def mean(robot: Figures, *names: str) -> float:
        return sum(float(robot["calls"][name]["cycles"][1]) for name in names)

    return [
        cell(mean(own, USUAL, "x"), mean(plain, USUAL, "x")),
        cell(mean(own, "receive"), mean(plain, "receive")),
        cell(mean(own, UPDATED), mean(plain, UPDATED)),
        cell(small["flash"]["least"], small["flash"][kind]),
        cell(own["ram"], plain["ram"]),
        cell(stack_of_tick(own), plain["stack"]),
    ]


def _stack(figures: Figures) -> str:
    targets = figures["targets"]
    names = next(iter(targets.values()))["-O2"]["firmware"]["stack"]
    rows = [
        [
            name,
            *(
                " / ".join(str(levels[level]["firmware"]["stack"][name][0]) for level in LEVELS)
                for levels in targets.values()
            ),
        ]
        for name in names
    ]
    return _table([f"bytes at {' / '.join(LEVELS)}", *targets], rows)


def _bounds(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        series = levels["-O2"]["firmware"]["series"]
        spans = [
            f"{min(low for _, low, _ in points)} .. {max(high for _, _, high in points)}"
            for points in (series["step"], series["receive"], series["settle"])
        ]
        rows.append([name, series["unit"], *spans])
    return _table(
        ["target", "unit", "step, t from 1 to 2^31", "receive, message 1 to 127", "settle, m from 1 to 127"],
        rows,
    )


def most_seen(core: Figures, call: str, unit: str) -> int:
    """Most instructions or cycles of a call that a search found."""
    if call in core["others"]:
        return int(core["others"][call][UNITS.index(unit)])
    kinds = (name for name in core["calls"] if name.split(",")[0].split(" ")[0] == call)
    return max(most(core["calls"], name, unit) for name in kinds)


def _beside(core: Figures, call: str, unit: str) -> str:
    bound, seen = core["bounds"][call][unit], most_seen(core, call, unit)
    return f"{bound} : {seen} = {bound / seen:.2f}"


def largest_ratio(core: Figures, calls: Iterable[str]) -> float:
    """The most that a bound is above what was seen."""
    ratios = [core["bounds"][call][unit] / most_seen(core, call, unit) for call in calls for unit in UNITS]
    return float(max(ratios))


def _static_bounds(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        for level in LEVELS:
            core = levels[level]["firmware"]
            spans = [_beside(core, "step", unit) for unit in UNITS]
            counts = [core["bounds"]["step"][each] for each in ("divisions", "turns")]
            rows.append([f"{name}, {level}", *spans, *counts, f"{largest_ratio(core, TICK_CALLS):.2f}"])
    head = ("step", *UNITS, "divisions", "turns of loops", "largest ratio of a tick's calls")
    return _table(head, rows)


def _all_bounds(figures: Figures) -> str:
    rows = []
    for name, levels in figures["targets"].items():
        for call in (*TICK_CALLS, *OTHER_CALLS):
            cores = [levels[level]["firmware"] for level in LEVELS]
            spans = [_beside(core, call, unit) for core in cores for unit in UNITS]
            counts = [
                " / ".join(str(core["bounds"][call][each]) for core in cores)
                for each in ("divisions", "turns")
            ]
            rows.append([name, call, *spans, *counts])
    spans = [f"{unit}, {level}" for level in LEVELS for unit in UNITS]
    both = " / ".join(LEVELS)
    return _table(["target", "call", *spans, f"divisions, {both}", f"turns, {both}"], rows)


def _way(longest: int | None, seen: int) -> str:
    return "not recorded" if longest is None else f"{longest} ({seen})"


def _longest_steps(figures: Figures) -> str:
    def row(name: str, levels: Figures) -> list[str]:
        cores = [levels[level]["firmware"] for level in LEVELS]
        kinds = [(kind, core) for kind in STEPS for core in cores]
        return [name, *(_way(core["longest seen"][kind], most(core["calls"], kind)) for kind, core in kinds)]

    head = [f"{kind}; {level}" for kind in STEPS for level in LEVELS]
    recorded = [target for target in figures["targets"].items() if target[0] != AVR]
    return _table(["instructions", *head], (row(*target) for target in recorded))


def _on_avr(figures: Figures) -> str:
    """Cost of plain floats as a share of the firmware's."""
    own, plain = (figures["targets"][AVR]["-O2"][kind]["calls"] for kind in ("firmware", "float"))
    kinds = {"step and x": (USUAL, "x"), "receive": ("receive",)}
    shares = {
        kind: sum(plain[name]["cycles"][1] for name in names) / sum(own[name]["cycles"][1] for name in names)
        for kind, names in kinds.items()
    }
    said = " and ".join(f"{share:.0%} of the cycles of {name}" for name, share in shares.items())
    return f"On an AVR plain floats take {said}."


def _whole_firmware(figures: Figures) -> str:
    demo, small = figures["demo"], figures["targets"][AVR]["-Os"]["firmware"]["calls"]
    ram = demo["variables"] + demo["stack"]

    def cycles(*names: str) -> int:
        return sum(most(small, name, "cycles") for name in names)

    rounds = cycles("encode") + 10 * cycles("decode", "receive")
    kinds = {"": "step", " that test and update": UPDATED}
    steps = [(f"steps per second{kind}, at least", _reserved(cycles(step))) for kind, step in kinds.items()]
    ticks = [
        (f"ticks with 10 neighbours per second{kind}, at least", _reserved(cycles(step) + rounds))
        for kind, step in kinds.items()
    ]
    costliest = ticks[-1][1]
    rows: list[list[object]] = [
        ["flash", f"{demo['flash']} of {FLASH} bytes", f"{demo['flash'] / FLASH:.0%}"],
        [
            "RAM: variables and deepest stack",
            f"{demo['variables']} + {demo['stack']} of {RAM} bytes",
            f"{ram / RAM:.0%}",
        ],
        *([name, f"{CLOCK} / {each} cycles", _at_least(each)] for name, each in steps + ticks),
        [
            "the costliest of these, 10 per second, at most",
            f"{costliest} of {CLOCK // 10} cycles",
            f"{10 * costliest / CLOCK:.1%}",
        ],
    ]
    return _table(["ATmega328P at -Os", "", ""], rows)
